"""Checks that a schedule means what its program means. It shares nothing with the scheduler.

A program means: one operation after the other. A schedule means what the array does with it: reads
find what has been written by then. The checker replays the schedule clock by clock and demands
that every read finds the very value it would find in program order, and that no port, bus or adder
is used twice on a clock.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping

from ukf_sw.engine.adder_tree import adder_tree
from ukf_sw.engine.layout import Word, is_banked
from ukf_sw.engine.operations import Operation, Route, Scalar
from ukf_sw.engine.scheduler import Schedule
from ukf_sw.engine.timing import READ_LATENCY
from ukf_sw.spec.parameters import Pipeline

__all__ = ["ScheduleError", "check_schedule"]

#: A lane of a word of the current or of the next bank, or a register of the scalar file.
_Place = tuple[str, Word, int]


class ScheduleError(Exception):
    """A schedule that does not mean what its program means."""


def check_schedule(
    schedule: Schedule,
    *,
    pes: int,
    pipeline: Pipeline,
    registers: Mapping[Scalar, int] | None = None,
    places: Mapping[Word, Word] | None = None,
) -> None:
    """Check a schedule.

    Parameters
    ----------
    schedule
        What to check.
    pes, pipeline
        The array that is to execute it.
    registers
        Place in the scalar file of the scalars that are kept; None: each has its own.
    places
        Places in the memories of temporaries; those that are missing have their own.

    Raises
    ------
    ScheduleError
        If a stage is used twice, a read finds a wrong value, or a result comes after the end.
    """
    taken: dict[tuple[str, int, int], int] = {}

    def take(stage: str, clock: int, index: int, lane: int = 0) -> None:
        other = taken.setdefault((stage, clock, lane), index)
        if other != index or clock < 0:
            raise ScheduleError(
                f"{stage} of lane {lane} is used by operations {other} and {index} on clock {clock}"
            )

    # Per clock: what is read, by whom and of whom it is to be, and what is written at its end, by
    # whom. Places are lanes of words, of the current or of the next bank, and registers of the
    # scalar file. Two temporaries may share one, so a place does not say what is to be there.
    reads: dict[int, list[tuple[_Place, int, int]]] = defaultdict(list)
    writes: dict[int, list[tuple[_Place, int]]] = defaultdict(list)
    kept: dict[int, list[tuple[_Place, int, int]]] = defaultdict(list)
    latest: dict[_Place, int] = {}

    def place_of(bank: str, word: Word, lane: int) -> _Place:
        return bank, word if places is None else places.get(word, word), lane

    def register(scalar: Scalar) -> _Place:
        return ("scalar", (scalar.number if registers is None else registers[scalar], 0), 0)

    nodes, _ = adder_tree(pes)
    levels = 1 + max((node.level for node in nodes), default=-1)
    producer: dict[Scalar, int] = {}
    for index, (operation, issue) in enumerate(
        zip(schedule.operations, schedule.issue, strict=True)
    ):
        end = _check_stages(operation, index, issue, pipeline, pes, levels, take)
        for k, beat in enumerate(operation.beats):
            clock = issue + k * pipeline.add
            for word in (beat.word_0, beat.word_1):
                if word is None:
                    continue
                for lane in range(pes):
                    if beat.lanes >> lane & 1:
                        place = place_of("current", word, lane)
                        writer = latest.get(("current", word, lane), -1)
                        reads[clock].append((place, index, writer))
        if operation.scalar is not None:
            place = register(operation.scalar)
            reads[issue].append((place, index, producer[operation.scalar]))
        if operation.result is not None:
            producer[operation.result] = index
            if registers is None or operation.result in registers:
                writes[end].append((register(operation.result), index))
        written = [(operation.destination, end, operation.lanes)]
        written.append((operation.root, end + pipeline.reciprocal_sqrt, operation.root_lanes))
        for word, clock, lanes in written:
            if word is None:
                continue
            if clock >= schedule.length:
                raise ScheduleError(f"operation {index} writes on clock {clock}, after the end")
            for lane in range(pes):
                if lanes >> lane & 1:
                    bank = "next" if is_banked(word) else "current"
                    place = place_of(bank, word, lane)
                    if operation.keeps:
                        kept[clock].append((place, index, latest.get((bank, word, lane), -1)))
                    writes[clock].append((place, index))
                    latest[bank, word, lane] = index

    found: dict[_Place, int] = {}
    for clock in sorted({*reads, *writes}):
        landing = {place for place, _ in writes[clock]}
        for place, index, writer in reads[clock]:
            if found.get(place, -1) != writer:
                raise ScheduleError(
                    f"operation {index} on clock {clock} reads {place} of operation "
                    f"{found.get(place, -1)} instead of {writer}"
                )
            if place in landing and place[0] != "scalar":
                raise ScheduleError(f"{place} is read and written on clock {clock}")
        for place, index, writer in kept[clock]:
            if found.get(place, -1) != writer:
                raise ScheduleError(
                    f"operation {index} on clock {clock} keeps {place} of operation "
                    f"{found.get(place, -1)} instead of {writer}"
                )
        for place, index in writes[clock]:
            found[place] = index


def _check_stages(
    operation: Operation,
    index: int,
    issue: int,
    pipeline: Pipeline,
    pes: int,
    levels: int,
    take: Callable[..., None],
) -> int:
    """Take every stage that an operation passes through; give the clock of its result."""
    nodes, _ = adder_tree(pes)
    end, route = issue, operation.kind.route
    for k, _ in enumerate(operation.beats):
        clock = issue + k * pipeline.add
        take("read ports", clock, index)
        products = clock + READ_LATENCY + pipeline.multiply
        if route is Route.PORT:
            end = clock + READ_LATENCY + 1
        elif route is Route.TREE:
            for node in nodes:
                take("adder", products + node.level * pipeline.add, index, node.lane)
            accumulate = products + levels * pipeline.add
            take("adder", accumulate, index, pes - 1)
            end = accumulate + pipeline.add
        else:
            for lane in [pes - 1] if route is Route.LAST_LANE else range(pes):
                take("adder", products, index, lane)
            end = products + pipeline.add
    if route is not Route.LANES:
        take("scalar bus", end, index)
    if operation.destination is not None:
        take("write port", end, index)
    if operation.root is not None:
        take("scalar bus", end + pipeline.reciprocal_sqrt, index)
        take("write port", end + pipeline.reciprocal_sqrt, index)
    return end
