"""Which stages of the array the operations of a program take, and on which clocks.

A stage takes one thing a clock: the issue slot a beat's reads, an adder a pair of terms, the scalar
bus and the write port a result. The adders are seen as the dot product sees them: in levels, of
which the last one accumulates in the last lane. A lane operation takes those of all levels at once.
"""

from collections import defaultdict
from enum import Enum
from functools import cache
from typing import NamedTuple

from ukf_sw.engine.operations import Operation, Route
from ukf_sw.engine.scheduler import Schedule
from ukf_sw.engine.timing import Timing

__all__ = ["Stage", "StageKind", "Use", "occupancy", "stages", "tracks"]


class StageKind(Enum):
    """Kinds of stages, with their names for people."""

    ISSUE = "issue slot"
    ADDERS = "adders"
    WRITE_PORT = "write port"
    SCALAR_BUS = "scalar bus"


class Stage(NamedTuple):
    """A stage of the array.

    Parameters
    ----------
    kind
        What it is.
    level
        Of the adders their level in the tree of the dot product, 0 beside the products; else 0.
    """

    kind: StageKind
    level: int = 0


class Use(NamedTuple):
    """A stage that an operation takes.

    Parameters
    ----------
    stage
        Which one.
    offset
        When, in clocks from the issue of the operation.
    """

    stage: Stage
    offset: int


def stages(operation: Operation, timing: Timing) -> tuple[Use, ...]:
    """Give the stages that an operation passes through, in the order of their kinds."""
    stored, rooted = operation.destination is not None, operation.root is not None
    result = timing.result(operation)
    return _stages(operation.kind.route, len(operation.beats), stored, rooted, result, timing)


@cache
def _stages(
    route: Route, beats: int, stored: bool, rooted: bool, result: int, timing: Timing
) -> tuple[Use, ...]:
    """Give the stages of a way through the array whose result comes after some clocks."""
    adders = [Stage(StageKind.ADDERS, level) for level in range(timing.levels + 1)]
    issues = [k * timing.beat_interval for k in range(beats)]
    uses = [Use(Stage(StageKind.ISSUE), at) for at in issues]
    for product in (at + timing.product for at in issues):
        if route is Route.TREE:
            uses += [Use(each, product + each.level * timing.pipeline.add) for each in adders]
        elif route is Route.LAST_LANE:
            uses.append(Use(adders[-1], product))
        elif route is Route.LANES:
            uses += [Use(each, product) for each in adders]
    root = result + timing.pipeline.reciprocal_sqrt
    for kind, there in (
        (StageKind.WRITE_PORT, stored),
        (StageKind.SCALAR_BUS, route is not Route.LANES),
    ):
        uses += [Use(Stage(kind), at) for at in [result] * there + [root] * rooted]
    return tuple(uses)


def occupancy(plan: Schedule) -> dict[Stage, dict[int, int]]:
    """Give the clocks on which each stage is taken, and the operation, by its index, that does."""
    found: dict[Stage, dict[int, int]] = defaultdict(dict)
    for index, (operation, issue) in enumerate(zip(plan.operations, plan.issue, strict=True)):
        for stage, offset in stages(operation, plan.timing):
            found[stage][issue + offset] = index
    return found


def tracks(plan: Schedule) -> dict[str, list[dict[int, int]]]:
    """Give what pictures show: operations, by their indices, over the clocks.

    Returns
    -------
    dict
        Lines of each track by its name, and of each line the operation of every clock on which
        there is one. The adders are two tracks, since lane operations and dot products take them;
        that of the dot products has a line for each level of the tree, the last one accumulates.
        1/sqrt has an operation from the clock of its pivot on until its result is on the bus.
    """
    timing = plan.timing
    lines = {
        "issue": 1, "lanes": 1, "tree": timing.levels + 1, "scalar bus": 1, "1/sqrt": 1,
        "write port": 1,
    }  # fmt: skip
    found = {name: [dict[int, int]() for _ in range(count)] for name, count in lines.items()}
    for stage, taken in occupancy(plan).items():
        for clock, index in taken.items():
            match stage.kind:
                case StageKind.ISSUE:
                    found["issue"][0][clock] = index
                case StageKind.ADDERS if plan.operations[index].kind.route is Route.TREE:
                    found["tree"][stage.level][clock] = index
                case StageKind.ADDERS:
                    found["lanes"][0][clock] = index
                case _:
                    found[stage.kind.value][0][clock] = index
    for index, operation in enumerate(plan.operations):
        if operation.root is not None:
            start = plan.issue[index] + timing.result(operation)
            for clock in range(start, start + timing.pipeline.reciprocal_sqrt):
                found["1/sqrt"][0][clock] = index
    return {name: [dict(sorted(line.items())) for line in each] for name, each in found.items()}
