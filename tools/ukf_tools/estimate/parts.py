"""Which part of a program an operation belongs to: a row of the elimination, or what is around it.

An operation belongs to row j of the elimination if

- it gives pivot j,
- it multiplies with 1/sqrt of pivot j: row j itself, or what couples another row to it,
- or it subtracts row j, so multiplied, from another one.

Of all others, what makes a scalar belongs to the same as the first reader of the scalar: so the
inner products that couple rows to row j belong to row j. Else the vector that is written decides.
In a program of a model the parts are what is loaded, what streams through 1/sqrt, and steps and
results of the model.
Rows have the numbers that ERROR reports: those of the observations, then those of the states.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ukf_sw.engine.layout import TEMPORARY, Layout, Word
from ukf_sw.engine.operations import Kind, Operation, Scalar

__all__ = ["Part", "Run", "parts", "runs"]


class Part(NamedTuple):
    """A part of a program.

    Parameters
    ----------
    name
        For people.
    row
        Row of the elimination, or None.
    """

    name: str
    row: int | None = None


class Run(NamedTuple):
    """Clocks that follow each other and have operations of one part.

    Parameters
    ----------
    part
        The part.
    first, clocks
        From which clock on, and how many.
    """

    part: Part
    first: int
    clocks: int


_NIS = Part("NIS")
#: Of results that nobody reads: passing over the scalar bus is what checks them.
_CHECKS = Part("checks")
#: Of programs of models.
_INPUTS, _STREAMS, _STEPS, _RESULTS = (
    Part(name) for name in ("inputs", "stream through 1/sqrt", "model", "results")
)
#: Parts by the vectors that they write.
_WRITERS = {
    **dict.fromkeys(("Ex", "Ez"), Part("residuals")),
    **dict.fromkeys(("Ax", "Az"), Part("joint covariance")),
    **dict.fromkeys(("X", "W", "V"), Part("sigma points")),
    **dict.fromkeys(("L", "F"), Part("factor")),
    "x": Part("state"),
    "P": Part("covariance"),
}


def _words(operation: Operation) -> list[Word]:
    """Words that an operation reads."""
    return [
        word
        for beat in operation.beats
        for word in (beat.word_0, beat.word_1)
        if word is not None
    ]  # fmt: skip


def _rows(operations: Sequence[Operation]) -> list[int | None]:
    """Row of the elimination of each operation, as far as its words say; else None."""
    rows: list[int | None] = []
    roots: dict[Word, int] = {}
    #: Words that hold a row of the elimination times its 1/sqrt.
    multiplied: dict[Word, int] = {}
    for operation in operations:
        row = next((roots[word] for word in _words(operation) if word in roots), None)
        if operation.pivot is not None:
            row = operation.pivot
            if operation.root is not None:
                roots[operation.root] = row
        elif row is None and operation.kind is Kind.AXPY:
            row = multiplied.get(operation.beats[0].word_1 or (-1, 0))
        if operation.destination is not None:
            multiplied.pop(operation.destination, None)
            if row is not None and operation.kind is Kind.MULTIPLY:
                multiplied[operation.destination] = row
        rows.append(row)
    return rows


def _of_model(operation: Operation) -> Part | None:
    """Part of an operation of a model; None of what is of the filter, or makes a scalar."""
    if operation.root is not None and operation.root[1] == TEMPORARY:
        return _STREAMS
    if operation.destination is None:
        return None
    if operation.destination[1] == TEMPORARY:
        return _STEPS if operation.kind is Kind.SLOT else _INPUTS
    return _RESULTS if operation.kind is Kind.SLOT else None


def parts(operations: Sequence[Operation], layout: Layout) -> list[Part]:
    """Give the part that each operation of a program belongs to.

    Parameters
    ----------
    operations
        Operations, in program order.
    layout
        Where their vectors are.
    """
    readers: dict[Scalar, Part] = {}  # the first one's
    found: list[Part] = []
    for operation, row in reversed(list(zip(operations, _rows(operations), strict=True))):
        if row is not None:
            part = Part(f"row {row}", row)
        elif (of_model := _of_model(operation)) is not None:
            part = of_model
        elif operation.is_nis:
            part = _NIS
        elif operation.result in readers:
            part = readers[operation.result]
        elif operation.destination is not None:
            vector, _ = layout.find(operation.destination)
            name = vector.name.partition("[")[0]
            part = _WRITERS.get(name, Part(name))
        else:
            part = _CHECKS
        if operation.scalar is not None:
            readers[operation.scalar] = part
        found.append(part)
    return found[::-1]


def runs(line: Mapping[int, int], found: Sequence[Part]) -> list[Run]:
    """Join the clocks of a line of a track, rising, that have the same part.

    Parameters
    ----------
    line
        Index of the operation of each clock.
    found
        Part of each operation.
    """
    joined: list[Run] = []
    for clock, index in line.items():
        part, before = found[index], joined[-1] if joined else None
        if before is not None and before.part == part and before.first + before.clocks == clock:
            joined[-1] = before._replace(clocks=before.clocks + 1)
        else:
            joined.append(Run(part, clock, 1))
    return joined
