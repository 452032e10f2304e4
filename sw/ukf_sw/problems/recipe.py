"""How to make a scenario, anywhere: a problem with its data.

Problems hold functions, so they do not leave their process; recipes do.

::

    from ukf_sw.problems.recipe import Recipe

    recipe = Recipe.of("pendulum", seed=3, pes=2)
    scenario = recipe.scenario(100)
"""

import hashlib
import pickle
import uuid
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ukf_sw.problem import Problem
from ukf_sw.problems.entry import Entry
from ukf_sw.problems.finding import digest_of_modules, find, is_own
from ukf_sw.problems.logs import LogFiles
from ukf_sw.problems.placing import core_models
from ukf_sw.problems.systems.random_system import STEPS, random_scenario
from ukf_sw.spec.model_programs import NO_MODELS
from ukf_sw.spec.parameters import UkfParams

__all__ = ["Recipe"]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How to make a scenario; equal recipes make equal scenarios.

    Parameters
    ----------
    name
        A problem, of the catalogue or as ``strut.model:problem``; None is a random system of these
        sizes.
    params
        The core: of a problem its sizes and kinds of noise, with form, format, W0 and number of
        processing elements as wanted.
    seed
        Seed of the data.
    P0
        First variance of every state; None is what the problem has, or 1.
    logs
        Recorded data; None are the data of the problem.
    folder
        Where the module of a problem is looked for first; None is the current one. It is kept, for
        processes that work in another.

    Raises
    ------
    ValueError
        If there is no such problem, the core does not fit it, it is a record and the seed is not 0,
        P0 is not positive, or there are logs and no problem.
    """

    name: str | None = None
    params: UkfParams
    seed: int = 0
    P0: float | None = None
    logs: LogFiles | None = None
    folder: Path | None = None

    def __post_init__(self) -> None:
        if self.name is not None:
            if self.folder is None and is_own(self.name):
                object.__setattr__(self, "folder", Path.cwd())
            if not self._entry.fits(self.params):
                raise ValueError(
                    f"params must have the sizes and kinds of noise of {self.name}, "
                    f"{self._entry.params!r}, not {self.params!r}"
                )
            self.check_seed(self.seed)
        elif self.logs is not None:
            raise ValueError("data must be of a problem, not of sizes alone")
        if self.P0 is not None and not (self.P0 > 0.0 and np.isfinite(self.P0)):
            raise ValueError(f"P0 must be more than 0, not {self.P0!r}")

    @classmethod
    def of(
        cls,
        name: str,
        *,
        seed: int = 0,
        P0: float | None = None,
        logs: LogFiles | None = None,
        **changes: Any,
    ) -> "Recipe":
        """Make the recipe of a problem.

        Parameters
        ----------
        name, seed, P0, logs
            As above.
        **changes
            Parameters of its core to replace, such as ``pes=4``, or ``models="core"``.

        Raises
        ------
        ValueError
            As above.
        """
        params = replace(find(name).params, **(changes | {"models": NO_MODELS}))
        wanted = changes.get("models", NO_MODELS)
        if isinstance(wanted, str):
            wanted = core_models(name, wanted, params.format)
        params = replace(params, models=wanted)
        return cls(name=name, params=params, seed=seed, P0=P0, logs=logs)

    @property
    def _entry(self) -> Entry:
        assert self.name is not None
        found = find(self.name, folder=self.folder)
        return found if self.logs is None else replace(found, recorded=True)

    def check_seed(self, seed: int, runs: int = 1) -> None:
        """Check the seed of a run, or of the first of some; raises as :class:`Recipe`."""
        if self.name is not None:
            self._entry.check_seed(seed, runs)

    def scenario(self, steps: int | None = None) -> Problem:
        """Make the scenario.

        Parameters
        ----------
        steps
            How many steps; None is all, of a random system 1000.

        Raises
        ------
        ValueError
            If there are no data, or not as many steps.
        LogError, OSError
            If a log does not fit, or cannot be read.
        MissingExtraError
            If the problem, or a log, needs packages that are not installed.
        """
        if self.name is None:
            P0 = 1.0 if self.P0 is None else self.P0
            count = STEPS if steps is None else steps
            return random_scenario(self.params, self.seed, P0=P0, steps=count)
        if self.logs is None:
            made = self._entry.scenario(self.seed, steps)
        else:
            problem = self._entry.problem
            made = replace(problem, data=self.logs.read(problem)).with_data(steps=steps)
        _ = made.record  # it has some
        if self.P0 is not None:
            made = replace(made, P0=self.P0 * np.eye(self.params.n))
        return made.for_core(self.params)

    def identity(self, steps: int | None) -> dict[str, Any]:
        """Everything that a scenario depends on, the core and this project's sources apart.

        Of problems of the user that is the source of their modules, and the data that they gave.
        """
        known: dict[str, Any] = {"name": self.name, "seed": self.seed, "P0": self.P0}
        if self.logs is not None or (self.name is not None and is_own(self.name)):
            assert self.name is not None
            data = self.scenario(steps).record
            try:
                content = hashlib.sha256(pickle.dumps(data)).hexdigest()
            except (pickle.PicklingError, AttributeError, TypeError):
                content = str(uuid.uuid4())  # what cannot be told apart is always another
            known["data"] = content
            if is_own(self.name):
                known["modules"] = digest_of_modules(self.name)
        return known | {"steps": steps}
