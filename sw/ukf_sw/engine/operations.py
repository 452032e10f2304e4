"""What the array can do, and the builder that collects operations into a program.

An operation issues on one clock, a dot product on several, one beat each. Reading order is
program order: an operation sees what the operations before it have written. When it issues is
the scheduler's affair.

=================  =========================================================================
``MULTIPLY``       destination = a * b, lane by lane
``AXPY``           destination = c + s * b or c - s * b, lane by lane, s a scalar, c may be zero
``SCALE``          scalar = c + s * b or c - s * b, in the last lane only
``DOT``            scalar = sum of a * b over the lanes that each beat selects
``LOAD``           scalar = one lane of a word
``SLOT``           destination = any other form of :mod:`ukf_sw.spec.forms`, lane by lane
=================  =========================================================================

:class:`Kind` is the one description of them: the way that an operation takes through the array
decides when its result is there, what it occupies and where the result goes.

A scalar result travels on the scalar bus: into the scalar file, into one or all lanes of a word,
through the reciprocal square root into all lanes of a word, or any of these at once.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from ukf_sw.engine.layout import Layout, Vector, Word
from ukf_sw.spec.forms import Condition, Form, Root

__all__ = ["Beat", "Kind", "Operation", "ProgramBuilder", "Route", "Scalar"]


class Route(Enum):
    """Way of an operation through the array."""

    LANES = "lanes"  #: Multiplier and adder of every lane, result in the lanes.
    LAST_LANE = "last lane"  #: Multiplier and adder of the last lane, result on the scalar bus.
    TREE = "tree"  #: All multipliers, the adders as a tree, result on the scalar bus.
    PORT = "port"  #: From port 0 of one lane to the scalar bus, past the units.


class Kind(Enum):
    """Kinds of operations.

    Attributes
    ----------
    route : Route
        Way through the array.
    steering : Mapping of str to int
        Fields of the control word that each of its beats sets, beside those of its operands.
    """

    route: Route
    steering: Mapping[str, int]

    MULTIPLY = "multiply", Route.LANES, {"zero": 1}
    AXPY = "axpy", Route.LANES, {"use_scalar": 1}
    SCALE = "scale", Route.LAST_LANE, {"use_scalar": 1}
    DOT = "dot", Route.TREE, {"dot": 1}
    LOAD = "load", Route.PORT
    SLOT = "slot", Route.LANES

    def __new__(cls, name: str, route: Route, steering: Mapping[str, int] | None = None) -> "Kind":
        """Make a kind whose value is its name."""
        kind = object.__new__(cls)
        kind._value_ = name
        kind.route = route
        kind.steering = steering or {}
        return kind

    @property
    def is_scalar(self) -> bool:
        """Whether the result travels on the scalar bus."""
        return self.route is not Route.LANES


@dataclass(frozen=True, eq=False, slots=True)
class Scalar:
    """A value of the scalar file; two scalars are the same only if they are one object."""

    number: int


@dataclass(frozen=True, slots=True)
class Beat:
    """One clock's reads: word of port 0 (a or c), word of port 1 (b), lanes that take part."""

    word_0: Word | None
    word_1: Word | None
    lanes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One operation; fields that do not apply are None or False.

    Parameters
    ----------
    kind
        What it does.
    beats
        Its reads, in order of issue; one except for a dot product.
    scalar
        Operand s.
    subtract
        Whether the product is subtracted.
    destination, lanes
        Word written, and its lanes as a bit mask.
    result
        Scalar written.
    form
        What a SLOT computes and writes.
    root, root_lanes, root_kind
        Word that takes the reciprocal square root of the result, its lanes as a bit mask, and what
        the unit gives of it.
    observation
        Observation that gates the result: zero is written if it is masked.
    pivot
        Row of the elimination whose pivot the result is.
    coupling
        Observation row that the result couples to one before it: an element of the factor of S.
    innovation
        Whether the lanes write the right-hand side of an update's elimination: what is not finite
        there comes of a large innovation.
    is_nis
        Whether the result is the normalised innovation squared, or on the way to it.
    model_row
        Row of the elimination, observations first, that the lanes write as a result of a model.
    unchecked
        Whether the result may be infinite or NaN.
    """

    kind: Kind
    beats: tuple[Beat, ...]
    scalar: Scalar | None = None
    subtract: bool = False
    destination: Word | None = None
    lanes: int = 0
    result: Scalar | None = None
    form: Form | None = None
    root: Word | None = None
    root_lanes: int = 0
    root_kind: Root = Root.PLAIN
    observation: int | None = None
    pivot: int | None = None
    coupling: int | None = None
    innovation: bool = False
    is_nis: bool = False
    model_row: int | None = None
    unchecked: bool = False

    @property
    def keeps(self) -> bool:
        """Whether some of the lanes may keep what the destination has."""
        return self.form is not None and self.form.condition is not Condition.ALWAYS


class ProgramBuilder:
    """Collects the operations of a program, in program order.

    Columns are given as (start, stop) pairs. Only the lanes of the given columns are written.

    Parameters
    ----------
    layout
        Where the vectors live.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.operations: list[Operation] = []
        self._pes = layout.params.pes

    def new_scalar(self) -> Scalar:
        """Give a scalar that nothing has written yet."""
        return Scalar(len(self.operations))

    def lanes_by_beat(self, columns: Iterable[tuple[int, int]]) -> dict[int, int]:
        """Lanes that hold one of the columns, as bit masks by beat, beats rising."""
        lanes: dict[int, int] = {}
        for start, stop in columns:
            for column in range(start, stop):
                beat, lane = divmod(column, self._pes)
                lanes[beat] = lanes.get(beat, 0) | 1 << lane
        return dict(sorted(lanes.items()))

    def multiply_beat(
        self,
        destination: Word,
        a: Word,
        b: Word,
        lanes: int,
        *,
        observation: int | None = None,
        innovation: bool = False,
    ) -> None:
        """Destination = a * b, in the given lanes of one beat."""
        self.operations.append(
            Operation(
                kind=Kind.MULTIPLY, beats=(Beat(a, b, lanes),), destination=destination,
                lanes=lanes, observation=observation, innovation=innovation,
            )
        )  # fmt: skip

    def multiply(
        self,
        destination: Vector,
        a: Vector,
        b: Vector,
        columns: Iterable[tuple[int, int]],
        *,
        broadcast: bool = False,
        observation: int | None = None,
    ) -> None:
        """Destination = a * b, in the given columns; `broadcast`: b is one word for all beats."""
        for beat, lanes in self.lanes_by_beat(columns).items():
            factor = b.word(0 if broadcast else beat)
            self.multiply_beat(
                destination.word(beat), a.word(beat), factor, lanes, observation=observation
            )

    def axpy_beat(
        self,
        destination: Word,
        c: Word | None,
        s: Scalar,
        b: Word,
        lanes: int,
        *,
        subtract: bool = False,
        observation: int | None = None,
        innovation: bool = False,
    ) -> None:
        """Destination = c + s * b, or c - s * b, in the given lanes of one beat."""
        self.operations.append(
            Operation(
                kind=Kind.AXPY, beats=(Beat(c, b, lanes),), scalar=s, subtract=subtract,
                destination=destination, lanes=lanes, observation=observation,
                innovation=innovation,
            )
        )  # fmt: skip

    def axpy(
        self,
        destination: Vector,
        c: Vector | None,
        s: Scalar,
        b: Vector,
        columns: Iterable[tuple[int, int]],
        *,
        subtract: bool = False,
        observation: int | None = None,
    ) -> None:
        """Destination = c + s * b, or c - s * b, in the given columns; without c it is zero."""
        for beat, lanes in self.lanes_by_beat(columns).items():
            self.axpy_beat(
                destination.word(beat), c.word(beat) if c else None, s, b.word(beat), lanes,
                subtract=subtract, observation=observation,
            )  # fmt: skip

    def scale(
        self,
        s: Scalar,
        b: Vector,
        *,
        subtract: bool = False,
        store: tuple[Vector, int] | None = None,
        coupling: int | None = None,
        is_nis: bool = False,
    ) -> Scalar:
        """Give s * b or -s * b of a word that is the same in all lanes; `store`: element too."""
        return self._to_scalar(
            Kind.SCALE, (Beat(None, b.word(0), 1 << (self._pes - 1)),), scalar=s,
            subtract=subtract, store=store, coupling=coupling, is_nis=is_nis,
        )  # fmt: skip

    def load(self, a: Vector, column: int, *, store: tuple[Vector, int] | None = None) -> Scalar:
        """Give an element of a vector; `store`: copy it to another element too."""
        word, lane = a.element(column)
        return self._to_scalar(Kind.LOAD, (Beat(word, None, 1 << lane),), store=store)

    def load_pivot(self, a: Vector, column: int, *, pivot: int, root: Vector) -> Scalar:
        """Give an element that is a pivot; its reciprocal square root goes to `root`."""
        word, lane = a.element(column)
        beats = (Beat(word, None, 1 << lane),)
        return self._to_scalar(Kind.LOAD, beats, store=None, pivot=pivot, root=root.word(0))

    def dot(
        self,
        pairs: Iterable[tuple[Word, Word, int]],
        *,
        store: tuple[Vector, int] | None = None,
        observation: int | None = None,
        pivot: int | None = None,
        root: Vector | None = None,
        is_nis: bool = False,
    ) -> Scalar:
        """Give the sum over beats, each of two words and the lanes that count."""
        beats = tuple(Beat(a, b, lanes) for a, b, lanes in pairs)
        return self._to_scalar(
            Kind.DOT, beats, store=store, observation=observation, pivot=pivot,
            root=root.word(0) if root else None, is_nis=is_nis,
        )  # fmt: skip

    def _to_scalar(
        self,
        kind: Kind,
        beats: tuple[Beat, ...],
        *,
        store: tuple[Vector, int] | None,
        scalar: Scalar | None = None,
        subtract: bool = False,
        observation: int | None = None,
        pivot: int | None = None,
        root: Word | None = None,
        coupling: int | None = None,
        is_nis: bool = False,
    ) -> Scalar:
        result = self.new_scalar()
        destination, lanes = None, 0
        if store is not None:
            destination, lane = store[0].element(store[1])
            lanes = 1 << lane
        self.operations.append(
            Operation(
                kind=kind, beats=beats, scalar=scalar, subtract=subtract, result=result,
                destination=destination, lanes=lanes, observation=observation, pivot=pivot,
                root=root, root_lanes=(1 << self._pes) - 1 if root else 0, coupling=coupling,
                is_nis=is_nis,
            )
        )  # fmt: skip
        return result
