"""A problem that has a name, with what is expected of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from ukf_sw.problem import Problem
from ukf_sw.problems.judging import Bound
from ukf_sw.spec.fields import parameters_of
from ukf_sw.spec.parameters import UkfParams

__all__ = ["Entry"]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A problem by name: of the catalogue, or of a module of the user.

    Parameters
    ----------
    name
        Name on the command line.
    doc
        What it is, in a line.
    source
        Where the problem comes from.
    params
        Sizes and kinds of noise of its core.
    factory
        Makes the problem, with its data: ``factory(seed, steps)``, where None is all steps.
    bounds
        Expected errors, of whole runs with any seed.
    runs
        Number of runs, with seeds that follow each other, that are judged together.
    rounding
        By which part the errors of a core in binary32 may differ from those of the float64
        reference on the same data.
    exceptions
        The same of single errors, by name, where it is another.
    recorded
        Whether all of the data is a record, so that the only seed is 0.
    redraw
        Whether every predict ends with drawing new sigma points; None: if there is additive process
        noise.
    own
        The problem as it is, if there is one before its data.
    """

    name: str
    doc: str = ""
    source: str = ""
    params: UkfParams
    factory: Callable[[int, int | None], Problem]
    bounds: tuple[Bound, ...] = ()
    runs: int = 1
    rounding: float = 0.01
    exceptions: Mapping[str, float] = field(default_factory=dict[str, float])
    recorded: bool = False
    redraw: bool | None = None
    own: Problem | None = None

    @classmethod
    def of(cls, name: str, problem: Problem) -> "Entry":
        """Give a name to a problem."""
        return cls(
            name=name,
            params=problem.params,
            factory=problem.with_data,
            recorded=problem.data is not None and not callable(problem.data),
            redraw=problem.redraw,
            own=problem,
        )

    @property
    def redraws(self) -> bool:
        """Whether every predict ends with drawing new sigma points."""
        return self.params.additive_q > 0 if self.redraw is None else self.redraw

    @cached_property
    def problem(self) -> Problem:
        """The problem, to be given other data.

        Raises
        ------
        MissingExtraError
            If it needs packages that are not installed.
        """
        return self.factory(0, 1) if self.own is None else self.own

    def check_seed(self, seed: int, runs: int = 1) -> None:
        """Check the seed of a run, or of the first of some runs.

        Raises
        ------
        ValueError
            If the data is a record, which has one seed, and this is another or there are more.
        """
        if self.recorded and seed:
            raise ValueError(f"seed must be 0 for {self.name}, which is a record, not {seed!r}")
        if self.recorded and runs > 1:
            raise ValueError(f"runs must be 1 for {self.name}, which is a record, not {runs!r}")

    def scenario(self, seed: int = 0, steps: int | None = None) -> Problem:
        """Make a scenario: the problem with its data.

        Parameters
        ----------
        seed
            Seed of the data; records disregard it.
        steps
            How many steps; None is all.

        Raises
        ------
        ValueError
            If there are no data, or not as many steps.
        MissingExtraError
            If it needs packages that are not installed.
        """
        return self.factory(seed, steps)

    def fits(self, params: UkfParams) -> bool:
        """Whether a core has the sizes and the kinds of noise of this problem."""
        return all(
            getattr(params, entry.name) == getattr(self.params, entry.name)
            for entry in parameters_of(UkfParams).values()
            if entry.meaning.problem
        )
