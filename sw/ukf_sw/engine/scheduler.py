"""List scheduler: when every operation of a program issues.

There are no interlocks in the hardware, so the schedule is what makes a program right. Operations
are placed one by one, the one with the longest chain of successors first, each on the earliest
clock on which its operands are there and no stage that it passes through is taken, or a little
later if that keeps lanes and dot products apart; operations of less urgency fill the gaps. Several
strategies are tried. Clocks taken are bits of one large integer per stage, so that a search
is a few shifts however full the schedule is.
"""

import heapq
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ukf_sw.engine.layout import Word, is_banked
from ukf_sw.engine.operations import Operation, Route, Scalar
from ukf_sw.engine.timing import Timing

__all__ = ["MARGIN", "Schedule", "dependences", "schedule", "schedules"]


@dataclass(frozen=True)
class Schedule:
    """A program with the clock on which every operation issues.

    Parameters
    ----------
    operations
        Operations, in program order.
    issue
        Clock of the first beat of each.
    timing
        Latencies that the schedule is made for.
    length
        Clocks until the last result is written.
    """

    operations: Sequence[Operation]
    issue: Sequence[int]
    timing: Timing
    length: int


def dependences(operations: Sequence[Operation], timing: Timing) -> list[list[tuple[int, int]]]:
    """For each operation its predecessors and the least distance of the two issues.

    Reads wait until the word has been written by all who write a part of it before; writes wait
    until all reads of the old contents are over, and keep their order.
    """
    interval = timing.beat_interval
    writers: dict[Word, list[tuple[int, int, int]]] = defaultdict(list)  # index, delay, lanes
    readers: dict[Word, list[tuple[int, int]]] = defaultdict(list)  # index, delay
    scalars: dict[Scalar, tuple[int, int]] = {}
    result: list[list[tuple[int, int]]] = []

    for index, operation in enumerate(operations):
        distances: dict[int, int] = {}
        delay = timing.result(operation)
        waits: list[tuple[int, int]] = []  # predecessor, distance
        if operation.scalar is not None:
            writer, written = scalars[operation.scalar]
            waits.append((writer, written + 1))
        reads: list[tuple[Word, int]] = []
        for k, beat in enumerate(operation.beats):
            for word in (beat.word_0, beat.word_1):
                if word is not None:
                    reads.append((word, k * interval))
                    waits += [
                        (writer, written + 1 - k * interval) for writer, written, _ in writers[word]
                    ]
        writes: list[tuple[Word, int, int]] = []
        if operation.destination is not None:
            writes.append((operation.destination, delay, operation.lanes))
        if operation.root is not None:
            written = delay + timing.pipeline.reciprocal_sqrt
            writes.append((operation.root, written, operation.root_lanes))
        for word, written, _ in writes:
            if not is_banked(word):  # else the next bank is written, the current one read
                waits += [(reader, read + 1 - written) for reader, read in readers[word]]
            waits += [(writer, other + 1 - written) for writer, other, _ in writers[word]]
        for predecessor, distance in waits:
            distances[predecessor] = max(distance, distances.get(predecessor, distance))

        for word, read in reads:
            readers[word].append((index, read))
        for word, written, lanes in writes:
            if is_banked(word):
                continue
            kept = [entry for entry in writers[word] if operation.keeps or entry[2] & ~lanes]
            writers[word] = [*kept, (index, written, lanes)]
            if not kept:
                readers[word] = []
        if operation.result is not None:
            scalars[operation.result] = (index, delay)
        result.append(list(distances.items()))
    return result


class _Demand(NamedTuple):
    """What an operation takes of the array, in clocks from its issue.

    Parameters
    ----------
    route, beats
        Its way, and its issues, one every :attr:`Timing.beat_interval`.
    port, bus
        When it needs the write port, and when the scalar bus.
    """

    route: Route
    beats: int
    port: tuple[int, ...]
    bus: tuple[int, ...]


def _demand(operation: Operation, timing: Timing) -> _Demand:
    delay = timing.result(operation)
    root = (delay + timing.pipeline.reciprocal_sqrt,) if operation.root else ()
    return _Demand(
        operation.kind.route,
        len(operation.beats),
        (delay, *root) if operation.destination is not None else root,
        (delay, *root) if operation.kind.is_scalar else root,
    )


class _Strategy(NamedTuple):
    """What to place first, and how long an operation may wait for its phase.

    The adders of the lanes also form the tree of the dot products. If all dot products begin on
    clocks of one phase of the adders' latency, and all operations of the lanes on others, none ever
    meets the other there. To wait for that costs clocks here and gains some later.

    Parameters
    ----------
    dots, lanes
        Clocks that a dot product, and an operation of the lanes, waits at most.
    counts_issues
        Whether the urgency of an operation counts the issue slots of its chain beside the clocks.
    """

    dots: int
    lanes: int
    counts_issues: bool

    @property
    def rhythm(self) -> tuple[int, bool]:
        """What decides how regular a schedule is."""
        return self.lanes, self.counts_issues


_FOR_EVER = 1 << 30

#: What is tried, the most promising first; but the very first lets nothing wait.
_STRATEGIES = (
    _Strategy(0, 0, counts_issues=False),
    *(
        _Strategy(dots, lanes, counts_issues=counts_issues)
        for dots in (8, _FOR_EVER, 2)
        for lanes, counts_issues in ((0, True), (1, True), (8, False), (0, False), (1, False),
                                     (8, True))
    ),
    _Strategy(0, 0, counts_issues=True),
    *(
        _Strategy(0, lanes, counts_issues=counts_issues)
        for lanes in (1, 8)
        for counts_issues in (True, False)
    ),
)  # fmt: skip
#: Where lanes and dot products never meet, nobody waits.
_WITHOUT_PHASES = tuple(_Strategy(0, 0, counts_issues=each) for each in (False, True))
#: Operations that are placed at most: of a long program not all strategies are tried.
WORK = 20_000
#: Operations of a program of which all schedules are kept.
SHORT = 300

#: How much longer than the shortest a schedule may be that has other merits: one part in so many.
MARGIN = 128


class _Reservations:
    """Stages of the array, each with the clocks on which it is taken."""

    def __init__(self, timing: Timing, strategy: _Strategy) -> None:
        self._interval = timing.beat_interval
        self._levels = [level * timing.pipeline.add for level in range(1, timing.levels + 1)]
        self._accumulate = timing.accumulate - timing.product
        self._strategy = strategy
        self._issue: int = 0
        self._write_port: int = 0
        self._scalar_bus: int = 0
        # Issues that would meet a dot product in an adder, and the other way round.
        self._no_lanes: int = 0
        self._no_scale: int = 0
        self._no_dot: int = 0

    def place(self, demand: _Demand, ready: int) -> int:
        """Take the stages that an operation needs, from the earliest possible clock on."""
        route, beats, on_port, on_bus = demand
        taken = self._issue
        if route is Route.TREE:
            one = self._issue | self._no_dot
            taken = 0
            for k in range(beats):
                taken |= one >> k * self._interval
        elif route is Route.LAST_LANE:
            taken |= self._no_scale
        elif route is not Route.PORT:
            taken |= self._no_lanes
        for offset in on_port:
            taken |= self._write_port >> offset
        for offset in on_bus:
            taken |= self._scalar_bus >> offset

        clock = self._choose(route, taken, ready)

        for offset in on_port:
            self._write_port |= 1 << clock + offset
        for offset in on_bus:
            self._scalar_bus |= 1 << clock + offset
        for k in range(beats):
            issue = clock + k * self._interval
            self._issue |= 1 << issue
            if route is Route.TREE:
                for offset in self._levels:
                    self._no_lanes |= 1 << issue + offset
                self._no_scale |= 1 << issue + self._accumulate
            elif route is not Route.PORT:
                for offset in self._levels[-1:] if route is Route.LAST_LANE else self._levels:
                    if issue >= offset:
                        self._no_dot |= 1 << issue - offset
        return clock

    def _choose(self, route: Route, taken: int, ready: int) -> int:
        """Give the clock to issue on: the first that is free, or one of the right phase if near."""
        first = clock = _first_free(taken, ready)
        if route in (Route.TREE, Route.LANES):
            is_dot = route is Route.TREE
            last = first + (self._strategy.dots if is_dot else self._strategy.lanes)
            while (clock % self._interval == 0) is not is_dot:
                clock = _first_free(taken, clock + 1)
                if clock > last:
                    return first
        return clock


def _first_free(taken: int, start: int) -> int:
    """Give the first clock from `start` on that is not taken."""
    taken >>= start
    return start + (~taken & (taken + 1)).bit_length() - 1


def schedules(operations: Sequence[Operation], timing: Timing) -> list[Schedule]:
    """Place the operations of a program by several strategies.

    Equal arguments give equal schedules.

    Parameters
    ----------
    operations
        Operations, in program order.
    timing
        Latencies of the array.

    Returns
    -------
    list of Schedule
        Those that are not much longer than the shortest: see :data:`MARGIN`. The shortest comes
        first. Unless the program is short, only the shortest of each rhythm.
    """
    scheduler = _Scheduler(operations, timing)
    has_phases = timing.levels > 0 and timing.beat_interval > 1
    strategies = _STRATEGIES if has_phases else _WITHOUT_PHASES
    found: dict[_Strategy, Schedule] = {}
    most: int | None = None  # clocks that a schedule may take
    for strategy in strategies[: max(WORK // max(len(operations), 1), 2)]:
        rivals = [
            each for each in found if each.rhythm == strategy.rhythm and len(operations) > SHORT
        ]
        limits = [found[rival].length for rival in rivals]
        if most is not None:
            limits.append(most)
        issue = scheduler.place(strategy, min(limits, default=None))
        if issue is not None:
            length = scheduler.length(issue)
            for rival in rivals:
                del found[rival]
            found[strategy] = Schedule(operations, issue, timing, length)
            longest = length + length // MARGIN + 1
            most = longest if most is None else min(most, longest)
    plans = sorted(found.values(), key=lambda plan: plan.length)
    return [plan for plan in plans if most is not None and plan.length < most]


def schedule(operations: Sequence[Operation], timing: Timing) -> Schedule:
    """Give the shortest of the :func:`schedules` of a program."""
    return schedules(operations, timing)[0]


class _Scheduler:
    """Places the operations of a program, the most urgent of those that are ready first."""

    def __init__(self, operations: Sequence[Operation], timing: Timing) -> None:
        self._timing = timing
        self._demands = [_demand(operation, timing) for operation in operations]
        self._finish = [timing.end(operation) for operation in operations]
        self._waiting: list[int] = []
        self._successors: list[list[tuple[int, int]]] = [[] for _ in operations]
        for index, edges in enumerate(dependences(operations, timing)):
            self._waiting.append(len(edges))
            for predecessor, distance in edges:
                self._successors[predecessor].append((index, distance))
        #: Clocks from issue to the end of the longest chain that begins with an operation.
        self._chain = self._urgency(0)
        self._chain_of_issues = self._urgency(1)

    def _urgency(self, cost: int) -> list[int]:
        """Give the length of the longest chain from each operation, with `cost` for each issue."""
        urgency = list(self._finish)
        for index in reversed(range(len(urgency))):
            issues = cost * self._demands[index].beats
            for successor, distance in self._successors[index]:
                urgency[index] = max(urgency[index], issues + distance + urgency[successor])
        return urgency

    def length(self, issue: Sequence[int]) -> int:
        """Clocks until the last result is written."""
        return max((at + end for at, end in zip(issue, self._finish, strict=True)), default=0)

    def place(self, strategy: _Strategy, limit: int | None) -> list[int] | None:
        """Give the clock on which each operation issues; None if that takes `limit` clocks."""
        urgency = self._chain_of_issues if strategy.counts_issues else self._chain
        reservations = _Reservations(self._timing, strategy)
        left = list(self._waiting)
        ready = [0] * len(left)
        issue = [0] * len(left)
        heap = [(-urgency[index], index) for index, count in enumerate(left) if not count]
        heapq.heapify(heap)
        while heap:
            _, index = heapq.heappop(heap)
            clock = issue[index] = reservations.place(self._demands[index], ready[index])
            if limit is not None and clock + self._chain[index] >= limit:
                return None
            for successor, distance in self._successors[index]:
                ready[successor] = max(ready[successor], clock + distance)
                left[successor] -= 1
                if not left[successor]:
                    heapq.heappush(heap, (-urgency[successor], successor))
        return issue
