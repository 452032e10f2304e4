"""List scheduler: when every operation of a program issues.

There are no interlocks in the hardware, so the schedule is what makes a program right. Operations
are placed one by one, the one with the longest chain of successors first, each on the earliest
clock on which its operands are there and no stage that it passes through is taken; operations of
less urgency fill the gaps. Clocks taken are bits of one large integer per stage, so that a search
is a few shifts however full the schedule is.
"""

import heapq
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from ukf_sw.engine.layout import BANK_NONE, Word
from ukf_sw.engine.operations import Operation, Route, Scalar
from ukf_sw.engine.timing import Timing

__all__ = ["Schedule", "dependences", "schedule"]


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
            every_lane = (1 << timing.pes) - 1
            writes.append((operation.root, delay + timing.pipeline.reciprocal_sqrt, every_lane))
        for word, written, _ in writes:
            if word[1] == BANK_NONE:  # else the next bank is written, the current one read
                waits += [(reader, read + 1 - written) for reader, read in readers[word]]
            waits += [(writer, other + 1 - written) for writer, other, _ in writers[word]]
        for predecessor, distance in waits:
            distances[predecessor] = max(distance, distances.get(predecessor, distance))

        for word, read in reads:
            readers[word].append((index, read))
        for word, written, lanes in writes:
            if word[1] != BANK_NONE:
                continue
            kept = [entry for entry in writers[word] if entry[2] & ~lanes]
            writers[word] = [*kept, (index, written, lanes)]
            if not kept:
                readers[word] = []
        if operation.result is not None:
            scalars[operation.result] = (index, delay)
        result.append(list(distances.items()))
    return result


class _Reservations:
    """Stages of the array, each with the clocks on which it is taken."""

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._issue: int = 0
        self._write_port: int = 0
        self._scalar_bus: int = 0
        # Issues that would meet a dot product in an adder, and the other way round.
        self._no_lanes: int = 0
        self._no_scale: int = 0
        self._no_dot: int = 0

    def place(self, operation: Operation, ready: int) -> int:
        """Take the stages that an operation needs, from the earliest possible clock on."""
        timing = self._timing
        route, beats = operation.kind.route, len(operation.beats)
        taken = self._issue
        if route is Route.TREE:
            one = self._issue | self._no_dot
            taken = 0
            for k in range(beats):
                taken |= one >> k * timing.beat_interval
        elif route is Route.LAST_LANE:
            taken |= self._no_scale
        elif route is not Route.PORT:
            taken |= self._no_lanes
        delay = timing.result(operation)
        root = delay + timing.pipeline.reciprocal_sqrt
        on_port = [delay] * (operation.destination is not None) + [root] * bool(operation.root)
        on_bus = [delay] * operation.kind.is_scalar + [root] * bool(operation.root)
        for offset in on_port:
            taken |= self._write_port >> offset
        for offset in on_bus:
            taken |= self._scalar_bus >> offset

        taken >>= ready
        clock = ready + (~taken & (taken + 1)).bit_length() - 1

        for offset in on_port:
            self._write_port |= 1 << clock + offset
        for offset in on_bus:
            self._scalar_bus |= 1 << clock + offset
        levels = [level * timing.pipeline.add for level in range(1, timing.levels + 1)]
        for k in range(beats):
            issue = clock + k * timing.beat_interval
            self._issue |= 1 << issue
            if route is Route.TREE:
                for offset in levels:
                    self._no_lanes |= 1 << issue + offset
                self._no_scale |= 1 << issue + timing.accumulate - timing.product
            elif route is not Route.PORT:
                for offset in levels[-1:] if route is Route.LAST_LANE else levels:
                    if issue >= offset:
                        self._no_dot |= 1 << issue - offset
        return clock


def schedule(operations: Sequence[Operation], timing: Timing) -> Schedule:
    """Place the operations of a program.

    Parameters
    ----------
    operations
        Operations, in program order.
    timing
        Latencies of the array.
    """
    predecessors = dependences(operations, timing)
    successors: list[list[tuple[int, int]]] = [[] for _ in operations]
    for index, edges in enumerate(predecessors):
        for predecessor, distance in edges:
            successors[predecessor].append((index, distance))

    # Urgency: clocks from issue to the end of the longest chain that begins here.
    finish = [_finish(operation, timing) for operation in operations]
    urgency = list(finish)
    for index in reversed(range(len(operations))):
        for successor, distance in successors[index]:
            urgency[index] = max(urgency[index], distance + urgency[successor])

    waiting = [len(edges) for edges in predecessors]
    ready = [0] * len(operations)
    issue = [0] * len(operations)
    heap = [(-urgency[index], index) for index, count in enumerate(waiting) if not count]
    heapq.heapify(heap)
    reservations = _Reservations(timing)
    while heap:
        _, index = heapq.heappop(heap)
        issue[index] = reservations.place(operations[index], ready[index])
        for successor, distance in successors[index]:
            ready[successor] = max(ready[successor], issue[index] + distance)
            waiting[successor] -= 1
            if not waiting[successor]:
                heapq.heappush(heap, (-urgency[successor], successor))
    length = max((at + end for at, end in zip(issue, finish, strict=True)), default=0)
    return Schedule(operations, issue, timing, length)


def _finish(operation: Operation, timing: Timing) -> int:
    """Clocks from issue until everything that the operation writes is written."""
    end = timing.result(operation) + 1
    return end + (timing.pipeline.reciprocal_sqrt if operation.root else 0)
