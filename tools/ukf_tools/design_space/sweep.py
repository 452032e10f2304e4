"""All parts of all points of a sweep, those that are missing computed."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ukf_sw.problems.finding import find as find_problem
from ukf_sw.problems.logs import LogFiles
from ukf_sw.problems.recipe import Recipe
from ukf_sw.spec.parameters import UkfParams
from ukf_tools.design_space.cache import Cache
from ukf_tools.design_space.executors import Executor, FailedPart
from ukf_tools.design_space.parts import (
    Accuracy,
    Part,
    Reference,
    SchedulePart,
    Synthesis,
)
from ukf_tools.design_space.points import Point
from ukf_tools.design_space.rows import Conditions, figures

__all__ = ["Findings", "Questions", "find", "sweep"]

#: Called with what has just been found, the work done, and its total, in about seconds.
Progress = Callable[[str, float, float], None]


@dataclass(frozen=True, kw_only=True)
class Questions:
    """What to find out about every core.

    Parameters
    ----------
    resources
        Whether to synthesise.
    application
        Problem to judge accuracy on, by its name, or None. Cores of other sizes are not judged.
    steps, seed
        Steps of it, and seed of its data.
    logs
        Recorded data in the place of its own.
    conditions
        Clock and bus.

    Raises
    ------
    ValueError
        If there is no such problem, it has no such seed, or there is no step.
    """

    resources: bool = True
    application: str | None = None
    steps: int = 2000
    seed: int = 0
    logs: LogFiles | None = None
    conditions: Conditions = field(default_factory=Conditions)

    def __post_init__(self) -> None:
        if self.application is not None:
            entry = find_problem(self.application, "application")
            replace(entry, recorded=entry.recorded or self.logs is not None).check_seed(self.seed)
        if self.steps < 1:
            raise ValueError(f"steps must be at least 1, not {self.steps!r}")

    def judges(self, params: UkfParams) -> bool:
        """Whether accuracy is judged of a core of these sizes."""
        return self.application is not None and find_problem(self.application).fits(params)

    def parts(self, point: Point) -> dict[str, Part]:
        """Give the parts of a point, by name.

        Raises
        ------
        ValueError
            If there is no such core.
        """
        core = point.core
        params, pipeline = core.params, core.pipeline
        parts: dict[str, Part] = {
            "schedule": SchedulePart(params=params, pipeline=pipeline, redraws=core.redraws),
        }
        if self.resources:
            parts["resources"] = Synthesis(params=params, pipeline=pipeline)
        if self.judges(params):
            recipe = Recipe(name=self.application, params=params, seed=self.seed, logs=self.logs)
            parts["accuracy"] = Accuracy(recipe=recipe, steps=self.steps)
            parts["reference"] = Reference.of(recipe, self.steps)
        return parts


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What came of a sweep.

    Parameters
    ----------
    rows
        A row of figures for each point, in the order of the points.
    found, computed, failed
        Number of parts that were in the cache, that were computed, and that could not be.
    seconds
        How long it took.
    """

    rows: list[dict[str, Any]]
    found: int
    computed: int
    failed: int
    seconds: float


def find(part: Part, cache: Cache) -> dict[str, Any]:
    """Give the result of a part, computed here if it is not in the cache."""
    kept = part.load(cache)
    return part.store(cache, part.prepared(cache).compute()) if kept is None else kept


def sweep(
    points: Sequence[Point],
    questions: Questions,
    cache: Cache,
    executor: Executor,
    progress: Progress | None = None,
) -> Findings:
    """Find out about cores what the cache does not know yet. Each result is kept at once.

    Parameters
    ----------
    points
        The cores. One that is not legal, or that fails, has the reason in its row.
    questions
        What to find out.
    cache
        Where results are and go.
    executor
        What computes.
    progress
        Called after each part.

    Raises
    ------
    YosysError
        If resources are asked for and Yosys is not installed.
    """
    started = time.perf_counter()
    wanted: list[dict[str, Part]] = []
    illegal: dict[int, str] = {}
    for number, point in enumerate(points):
        try:
            wanted.append(questions.parts(point))
        except ValueError as error:
            illegal[number] = str(error)
            wanted.append({})
    outcomes: dict[Part, dict[str, Any] | FailedPart] = {}
    missing: list[Part] = []
    for part in dict.fromkeys(part for parts in wanted for part in parts.values()):
        kept = part.load(cache)
        if kept is None:
            missing.append(part)
        else:
            outcomes[part] = kept
    found = len(outcomes)
    total, done = sum(part.cost for part in missing), 0.0
    if progress is not None:
        progress("", done, total)
    for part, outcome in executor.run([part.prepared(cache) for part in missing]):
        outcomes[part] = (
            outcome if isinstance(outcome, FailedPart) else part.store(cache, outcome)
        )  # fmt: skip
        done += part.cost
        if progress is not None:
            progress(part.kind, done, total)
    rows = [
        _row(point, parts, outcomes, illegal.get(number), questions)
        for number, (point, parts) in enumerate(zip(points, wanted, strict=True))
    ]
    failed = sum(isinstance(outcome, FailedPart) for outcome in outcomes.values())
    return Findings(
        rows=rows,
        found=found,
        computed=len(missing) - failed,
        failed=failed + len(illegal),
        seconds=time.perf_counter() - started,
    )


def _row(
    point: Point,
    parts: dict[str, Part],
    outcomes: dict[Part, dict[str, Any] | FailedPart],
    illegal: str | None,
    questions: Questions,
) -> dict[str, Any]:
    """Make the row of a point."""
    results = {name: outcomes[part] for name, part in parts.items()}
    failures = {
        name: result.message for name, result in results.items() if isinstance(result, FailedPart)
    }
    good = {name: result for name, result in results.items() if not isinstance(result, FailedPart)}
    if illegal is not None:
        failures["core"] = illegal
    row = figures(point, good, failures, questions.conditions)
    if "accuracy" in parts:
        row["application"] = questions.application
    return row
