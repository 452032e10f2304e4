"""How to make a scenario, anywhere: a problem with its data.

Problems hold functions, so they do not leave their process; recipes do.

::

    from ukf_sw.problems.recipe import Recipe

    recipe = Recipe.of("pendulum", seed=3, pes=2)
    scenario = recipe.scenario(100)
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ukf_sw.problem import Problem
from ukf_sw.problems.catalogue import find
from ukf_sw.problems.systems.random_system import STEPS, random_scenario
from ukf_sw.spec.parameters import UkfParams

__all__ = ["Recipe"]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How to make a scenario; equal recipes make equal scenarios.

    Parameters
    ----------
    name
        An entry of the catalogue, or None for a random system of these sizes.
    params
        The core: of an entry its sizes and kinds of noise, with form, format, W0 and number of
        processing elements as wanted.
    seed
        Seed of the data.
    P0
        First variance of every state; None is what the entry has, or 1.

    Raises
    ------
    ValueError
        If there is no such entry, the core does not fit it, it is a record and the seed is not 0,
        or P0 is not positive.
    """

    name: str | None = None
    params: UkfParams
    seed: int = 0
    P0: float | None = None

    def __post_init__(self) -> None:
        if self.name is not None and not find(self.name).fits(self.params):
            wanted = find(self.name).params
            raise ValueError(
                f"params must have the sizes and kinds of noise of {self.name}, {wanted!r}, "
                f"not {self.params!r}"
            )
        if self.name is not None:
            find(self.name).check_seed(self.seed)
        if self.P0 is not None and not (self.P0 > 0.0 and np.isfinite(self.P0)):
            raise ValueError(f"P0 must be more than 0, not {self.P0!r}")

    @classmethod
    def of(cls, name: str, *, seed: int = 0, P0: float | None = None, **changes: Any) -> "Recipe":
        """Make the recipe of an entry of the catalogue.

        Parameters
        ----------
        name, seed, P0
            As above.
        **changes
            Parameters of its core to replace, such as ``pes=4``.

        Raises
        ------
        ValueError
            As above.
        """
        return cls(name=name, params=replace(find(name).params, **changes), seed=seed, P0=P0)

    def scenario(self, steps: int | None = None) -> Problem:
        """Make the scenario.

        Parameters
        ----------
        steps
            How many steps; None is all, of a random system 1000.

        Raises
        ------
        ValueError
            If the scenario does not have as many steps.
        MissingExtraError
            If an entry needs packages that are not installed.
        """
        if self.name is None:
            P0 = 1.0 if self.P0 is None else self.P0
            count = STEPS if steps is None else steps
            return random_scenario(self.params, self.seed, P0=P0, steps=count)
        made = find(self.name).scenario(self.seed, steps)
        if self.P0 is not None:
            made = replace(made, P0=self.P0 * np.eye(self.params.n))
        return made.for_core(self.params)
