"""Why a schedule is as long as it is: what its operations wait for.

An operation can issue when its operands are there, and what it overwrites has been read: it is
ready. Then it needs every stage that it passes through. Both are judged in the schedule as it is,
with all other operations where they are.
"""

from bisect import bisect_left
from collections import Counter
from enum import Enum
from functools import cached_property
from typing import NamedTuple

from ukf_sw.engine.scheduler import Schedule, dependences
from ukf_tools.estimate.occupancy import Stage, StageKind, occupancy, stages

__all__ = ["Link", "Reason", "Waits"]


class Reason(Enum):
    """What an operation, or a clock without an issue, waits for."""

    DOT = "waits for DOT"  #: The sum of a dot product.
    ROOT = "waits for 1/sqrt"  #: The reciprocal square root of a pivot, or in a model.
    SCALE = "waits for SCALE"
    AXPY = "waits for AXPY"
    MULTIPLY = "waits for MULTIPLY"
    LOAD = "waits for LOAD"
    SLOT = "waits for SLOT"
    OVERWRITE = "waits to overwrite"  #: The old contents are still to be read, or written.
    ISSUE = "issue slot taken"  #: Another operation issues then, or when a later beat would.
    ADDERS = "adders taken"  #: The tree of a dot product would meet lane operations.
    WRITE_PORT = "write port taken"
    SCALAR_BUS = "scalar bus taken"
    HELD_BACK = "held back"  #: Something could issue, and the schedule lets it wait.
    ENDS = "program ends"  #: Nothing is left to issue; the last results are under way.


class Link(NamedTuple):
    """An operation of the longest chain: one that waits for the one before it.

    Parameters
    ----------
    operation
        Its index, in program order.
    ready
        First clock on which it could have issued, but for the stages.
    issue
        Clock on which it issues.
    waits_for
        Result of the operation before it that came last; None of the first.
    result_clocks
        Clocks from the issue of the operation before it until it is ready.
    stage_clocks
        Clocks from being ready to its issue, by their reasons.
    """

    operation: int
    ready: int
    issue: int
    waits_for: Reason | None
    result_clocks: int
    stage_clocks: dict[Reason, int]


class Waits:
    """What the operations of a schedule wait for.

    Parameters
    ----------
    plan
        The schedule.

    Attributes
    ----------
    predecessors : list of list of tuple
        For each operation those that it waits for, and the least distance of the two issues.
    ready : list of int
        First clock on which each operation could issue, but for the stages.
    ends : list of int
        Clocks from the issue of each until all that it writes is written.
    """

    def __init__(self, plan: Schedule) -> None:
        self.plan = plan
        self.predecessors = dependences(plan.operations, plan.timing)
        self.ready = [
            max([0, *(plan.issue[before] + distance for before, distance in edges)])
            for edges in self.predecessors
        ]
        self.ends = [plan.timing.end(operation) for operation in plan.operations]
        taken = occupancy(plan)
        self._issued = taken[Stage(StageKind.ISSUE)]
        #: What each operation passes through: the clocks that are taken, when, and the reason.
        self._passes = [
            [(taken[stage], offset, Reason[stage.kind.name]) for stage, offset in uses]
            for uses in (stages(operation, plan.timing) for operation in plan.operations)
        ]

    def longest_chain(self) -> int:
        """Give the clocks that the dependences alone demand: with stages without limit."""
        starts: list[int] = []
        for edges in self.predecessors:
            starts.append(max([0, *(starts[before] + distance for before, distance in edges)]))
        return max((a + b for a, b in zip(starts, self.ends, strict=True)), default=0)

    @cached_property
    def _urgency(self) -> list[int]:
        """Clocks from the issue of each operation to the end of the longest chain behind it."""
        urgency = list(self.ends)
        for index in reversed(range(len(urgency))):
            for before, distance in self.predecessors[index]:
                urgency[before] = max(urgency[before], distance + urgency[index])
        return urgency

    def _blocked(self, index: int, clock: int) -> Reason:
        """Say what keeps an operation that is ready from issuing on a clock."""
        for taken, offset, reason in self._passes[index]:
            if taken.get(clock + offset, index) != index:
                return reason
        return Reason.HELD_BACK

    def _reason(self, index: int, before: int, distance: int) -> Reason:
        """Say what of an operation another one waits for, if it does so at this distance."""
        operation, other = self.plan.operations[index], self.plan.operations[before]
        timing = self.plan.timing
        written = timing.result(other) + 1
        reads = [
            (word, k * timing.beat_interval)
            for k, beat in enumerate(operation.beats)
            for word in (beat.word_0, beat.word_1)
            if word is not None
        ]
        if other.root is not None:
            root = written + timing.pipeline.reciprocal_sqrt
            if any(word == other.root and root - at == distance for word, at in reads):
                return Reason.ROOT
        is_operand = operation.scalar is not None and operation.scalar is other.result
        if (is_operand and written == distance) or any(
            word == other.destination and written - at == distance for word, at in reads
        ):
            return Reason[other.kind.name]
        return Reason.OVERWRITE

    def _last(self, index: int) -> tuple[Reason, int, int] | None:
        """Give what an operation gets last, from which one, and the distance of their issues.

        None if it could issue on the first clock.

        Of several that come on the same clock, a result goes before what is overwritten, then the
        operation that issues last.
        """
        if not self.ready[index]:
            return None
        found = [
            (self._reason(index, before, distance), before, distance)
            for before, distance in self.predecessors[index]
            if self.plan.issue[before] + distance == self.ready[index]
        ]
        return max(
            found,
            key=lambda entry: (entry[0] is not Reason.OVERWRITE, self.plan.issue[entry[1]]),
        )

    def idle(self) -> dict[int, Reason]:
        """Give the clocks without an issue, each with its reason.

        If operations are ready that issue later, the stage that the most urgent of them lacks is
        the reason; if one lacks none, they were held back. Else it is the result that the most
        urgent of all that issue later waits for. Urgent is what has the longest chain behind it.
        """
        plan = self.plan
        free = [clock for clock in range(plan.length) if clock not in self._issued]
        last_issue = max(self._issued, default=0)
        order = sorted(range(len(plan.operations)), key=lambda i: (-self._urgency[i], i))
        reasons: dict[int, Reason] = {}
        for index in order:
            low, high = (bisect_left(free, at) for at in (self.ready[index], plan.issue[index]))
            for clock in free[low:high]:
                if reasons.get(clock) is not Reason.HELD_BACK:
                    reason = self._blocked(index, clock)
                    if clock not in reasons or reason is Reason.HELD_BACK:
                        reasons[clock] = reason
        waiting = iter(order)
        first = next(waiting, None)
        for clock in free:
            while first is not None and plan.issue[first] < clock:
                first = next(waiting, None)
            if clock not in reasons:
                last = None if first is None else self._last(first)
                # Between its beats, a dot product waits for the sum so far.
                between = Reason.DOT if clock < last_issue else Reason.ENDS
                reasons[clock] = between if last is None else last[0]
        return {clock: reasons[clock] for clock in free}

    def chain(self) -> list[Link]:
        """Give the operations that made the schedule as long as it is, the first one first.

        The last one ends it. Each waits for the one before it: for its result, which is the last
        of its operands, then for stages that others take.
        """
        plan = self.plan
        links: list[Link] = []
        index = next(
            (k for k, end in enumerate(self.ends) if plan.issue[k] + end == plan.length), None
        )
        while index is not None:
            last = self._last(index)
            reason, before, distance = last or (None, None, 0)
            ready, issue = self.ready[index], plan.issue[index]
            blocked = Counter(self._blocked(index, clock) for clock in range(ready, issue))
            links.append(Link(index, ready, issue, reason, distance, dict(blocked)))
            index = before
        return links[::-1]
