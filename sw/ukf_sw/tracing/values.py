"""Numbers and arrays that record what a model does with them.

A :class:`TracedNumber` is a number at every sigma point, as ``x[0]``; a :class:`TracedArray` is an
array of them, as ``x``. Constants are among them as well: where only constants are, they convert to
plain numbers and arrays. Neither is an ``np.ndarray`` to ``isinstance``.

Whatever NumPy offers its arguments arrives at :mod:`ukf_sw.tracing.dispatch`. Arrays of objects, as
NumPy itself makes of a list of traced numbers, compute with the operators and methods of these.
"""

from collections.abc import Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.graph import Node
from ukf_sw.tracing.recording import Recorder
from ukf_sw.tracing.remedies import MASK, of_number

__all__ = [
    "NO_NUMBER",
    "TracedArray",
    "TracedNumber",
    "Values",
    "lift",
    "records",
    "trace_of",
    "wrap",
]

#: Rule that something else than a number breaks.
NO_NUMBER = "compute with what is no real number"
#: Array of objects that are traced numbers.
Values = NDArray[Any]


class TracedNumber(Recorder):
    """A number at every sigma point.

    Parameters
    ----------
    origin
        The trace that it belongs to.
    number
        Its node.
    """

    def __init__(self, origin: Trace, number: int) -> None:
        self.origin = origin
        self.number = number

    @property
    def node(self) -> Node:
        """Its node."""
        return self.origin.builder.node(self.number)

    @property
    def known(self) -> float | bool | None:
        """Its value, if it is a constant."""
        return self.node.value

    def _known(self) -> Any:
        return self.known

    def __repr__(self) -> str:
        node = self.node
        shown = node.value if node.source is None else node.source.label
        return f"<traced {node.operation.label if shown is None else shown}>"

    def __copy__(self) -> "TracedNumber":
        return self

    def __deepcopy__(self, memo: Any) -> "TracedNumber":
        return self


class TracedArray(Recorder):
    """An array of traced numbers.

    Slices of it are views, as with NumPy.

    Parameters
    ----------
    origin
        The trace that it belongs to.
    values
        Traced numbers, as an array of objects.
    """

    def __init__(self, origin: Trace, values: Values) -> None:
        self.origin = origin
        self.values = values

    def _known(self) -> Any:
        return None if records(self) else np.asarray(self)

    def __repr__(self) -> str:
        return f"<traced array of shape {self.shape}>"

    @property
    def shape(self) -> tuple[int, ...]:
        """As that of a NumPy array."""
        return self.values.shape

    @shape.setter
    def shape(self, shape: tuple[int, ...]) -> None:
        self.values = self.values.reshape(shape)

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self.values)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Give a plain array: of float64 if all is constant, else of objects."""
        found = [number.known for number in self.values.flat]
        if any(value is None for value in found):
            plain: NDArray[Any] = self.values.copy()
        else:
            plain = np.array(found).reshape(self.shape)
        return plain if dtype is None else plain.astype(dtype)

    def _plain_key(self, key: Any) -> Any:
        """Make an index plain; what depends on data is refused."""
        if isinstance(key, tuple):
            return tuple(map(self._plain_key, cast("tuple[Any, ...]", key)))
        if not records(key):
            return np.asarray(key) if isinstance(key, TracedArray) else key
        if _is_mask(lift(self.origin, key)):
            raise self.origin.error(*MASK)
        place = self.origin.place
        raise self.origin.error(*of_number(place, "int"), place)

    def __getitem__(self, key: Any) -> Any:
        found = self.values[self._plain_key(key)]
        return found if isinstance(found, TracedNumber) else TracedArray(self.origin, found)

    def __setitem__(self, key: Any, value: Any) -> None:
        *before, last = cast("tuple[Any, ...]", key if isinstance(key, tuple) else (key,))
        new = lift(self.origin, value)
        if records(last):
            mask = lift(self.origin, last)
            target = self.values[self._plain_key(tuple(before))]
            if _is_mask(mask) and target.shape[target.ndim - mask.ndim :] == mask.shape:
                if new.ndim:
                    raise self.origin.error(*MASK)
                target[...] = lift(
                    self.origin, np.where(TracedArray(self.origin, mask), new[()], target)
                )
                return
        plain = self._plain_key(key)
        if not new.ndim:
            self.values[plain] = new[()]
        else:
            self.values[plain] = new


def _is_mask(values: Values) -> bool:
    """Whether numbers are conditions."""
    return bool(values.size) and all(number.node.is_condition for number in values.flat)


def _parts(value: Any) -> Iterator[Any]:
    """Numbers and arrays in a value, also in lists of lists."""
    if isinstance(value, (list, tuple)):
        for part in cast("list[Any]", value):
            yield from _parts(part)
    elif isinstance(value, np.ndarray) and cast("Values", value).dtype == object:
        yield from cast("Values", value).flat
    else:
        yield value


def records(value: Any) -> bool:
    """Whether something is in a value that is another at every sigma point."""
    for part in _parts(value):
        if isinstance(part, TracedNumber) and part.known is None:
            return True
        if isinstance(part, TracedArray) and any(n.known is None for n in part.values.flat):
            return True
    return False


def trace_of(value: Any) -> Trace | None:
    """Give the trace of what is in a value, if something is."""
    return next((part.origin for part in _parts(value) if isinstance(part, Recorder)), None)


def _number(trace: Trace, value: Any) -> TracedNumber:
    """Make a number record."""
    if isinstance(value, TracedNumber):
        if value.origin is not trace:
            raise trace.error("keep data from one call to the next", "let it be part of the state")
        return value
    plain: Any = value
    if isinstance(value, (bool, np.bool_)):
        return TracedNumber(trace, trace.builder.constant(bool(plain)))
    if isinstance(value, (int, float, np.integer, np.floating)):
        return TracedNumber(trace, trace.builder.constant(float(plain)))
    kind = type(plain).__name__
    raise trace.error(f"{NO_NUMBER}, of type {kind}", "use numbers")


def lift(trace: Trace, value: Any) -> Values:
    """Make an array of traced numbers of what a model may compute with.

    Raises
    ------
    TraceError
        If there is something else in it, or a number of another trace.
    """
    if isinstance(value, TracedArray):
        if value.origin is not trace:
            raise trace.error("keep data from one call to the next", "let it be part of the state")
        return value.values
    if isinstance(value, (list, tuple)) and trace_of(value) is not None:
        parts = [lift(trace, part) for part in cast("list[Any]", value)]
        if len({part.shape for part in parts}) > 1:
            shapes = ", ".join(str(part.shape) for part in parts)
            raise trace.error(f"make an array of parts of the shapes {shapes}", "make them equal")
        return np.stack(parts)
    found = np.empty((), dtype=object)
    if isinstance(value, (list, tuple, np.ndarray)):
        given: Values = np.asarray(cast("Any", value))
        if given.dtype == object and all(
            isinstance(number, TracedNumber) and number.origin is trace for number in given.flat
        ):
            return given  # which may be a view
        found = np.empty(given.shape, dtype=object)
        for index in np.ndindex(*given.shape):
            found[index] = _number(trace, given[index])
    else:
        found[()] = _number(trace, value)
    return found


def wrap(trace: Trace, values: Any) -> Any:
    """Give traced numbers as the model is to see them: one of them, or an array."""
    numbers = lift(trace, values)
    return TracedArray(trace, numbers) if numbers.ndim else numbers[()]
