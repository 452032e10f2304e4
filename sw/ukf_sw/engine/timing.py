"""When the stages of an operation happen, in clocks from its issue."""

from dataclasses import dataclass

from ukf_sw.engine.operations import Operation, Route
from ukf_sw.spec.parameters import Pipeline

__all__ = ["READ_LATENCY", "Timing"]

#: From the address of a memory or of the scalar file to the operand registers.
READ_LATENCY = 2

#: From the address to the scalar bus, for a load: one more register behind the lane selection.
LOAD_LATENCY = READ_LATENCY + 1


@dataclass(frozen=True)
class Timing:
    """Latencies of an array.

    A beat issued on clock t has its operands at t + read, its products at t + :attr:`product`,
    and its lane results at t + :attr:`lanes`, when they are written; what is written on one clock
    can be read on the next.

    The adders of the lanes also form the tree of the dot product: adders of tree level k work on
    a beat from t + product + k * add on, the accumulator (the adder of the last lane) from
    t + :attr:`accumulate` on. The sum of the previous beat comes out just then if that was issued
    `add` clocks before.

    Parameters
    ----------
    pes
        Number of lanes.
    pipeline
        Depths of the units.
    """

    pes: int
    pipeline: Pipeline

    @property
    def levels(self) -> int:
        """Levels of the adder tree below the accumulator."""
        return (self.pes - 1).bit_length()

    @property
    def beat_interval(self) -> int:
        """Clocks between the beats of a dot product."""
        return self.pipeline.add

    @property
    def product(self) -> int:
        """Products are ready."""
        return READ_LATENCY + self.pipeline.multiply

    @property
    def lanes(self) -> int:
        """Results of the lanes are written."""
        return self.product + self.pipeline.add

    @property
    def accumulate(self) -> int:
        """The sum of a beat enters the accumulator."""
        return self.product + self.levels * self.pipeline.add

    @property
    def dot(self) -> int:
        """The result of the dot product is on the scalar bus, from the issue of its last beat."""
        return self.accumulate + self.pipeline.add

    def last_beat(self, beats: int) -> int:
        """Issue of the last of several beats, from the first."""
        return (beats - 1) * self.beat_interval

    def result(self, operation: Operation) -> int:
        """Clocks from the first issue until the result is written or on the scalar bus."""
        match operation.kind.route:
            case Route.TREE:
                return self.last_beat(len(operation.beats)) + self.dot
            case Route.PORT:
                return LOAD_LATENCY
            case Route.LANES | Route.LAST_LANE:
                return self.lanes

    def end(self, operation: Operation) -> int:
        """Clocks from the first issue until all that the operation writes is written."""
        return self.result(operation) + 1 + (self.pipeline.reciprocal_sqrt if operation.root else 0)
