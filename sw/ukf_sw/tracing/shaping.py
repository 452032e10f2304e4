"""NumPy's functions and methods that move numbers about and compute nothing."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.values import (
    TracedArray,
    TracedNumber,
    Values,
    lift,
    records,
    trace_of,
    wrap,
)

__all__ = ["METHODS", "PROPERTIES", "SHAPING", "table"]

#: Functions that do with arrays of objects what they do with numbers.
_NAMES = (
    "reshape", "transpose", "moveaxis", "swapaxes", "rollaxis", "squeeze", "expand_dims",
    "atleast_1d", "atleast_2d", "atleast_3d", "broadcast_to", "broadcast_arrays", "append",
    "insert", "delete", "repeat", "tile", "roll", "rot90", "flip", "fliplr", "flipud", "ravel",
    "diag", "diagonal", "diagflat", "tril", "triu", "split", "array_split", "hsplit", "vsplit",
    "take", "resize",
)  # fmt: skip
#: Functions that join arrays.
_JOINING = ("concatenate", "stack", "vstack", "hstack", "dstack", "column_stack", "block")


def table(functions: dict[str, Callable[..., Any]]) -> dict[Any, Callable[..., Any]]:
    """Find functions of NumPy by name; not every version has all of them."""
    return {getattr(np, name): made for name, made in functions.items() if hasattr(np, name)}


def _unwrapped(trace: Trace, value: Any) -> Any:
    """Give arrays of objects in the place of arrays that record, also in lists."""
    if isinstance(value, (TracedArray, TracedNumber)):
        return lift(trace, value)
    if isinstance(value, (list, tuple)) and trace_of(value) is not None:
        return [_unwrapped(trace, part) for part in cast("list[Any]", value)]
    return cast("Any", value)


def _wrapped(trace: Trace, value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        made = [_wrapped(trace, part) for part in cast("list[Any]", value)]
        return tuple(made) if isinstance(value, tuple) else made
    return wrap(trace, value)


def _moving(function: Callable[..., Any]) -> Callable[..., Any]:
    def moved(trace: Trace, *arguments: Any, **options: Any) -> Any:
        plain = [_unwrapped(trace, argument) for argument in arguments]
        named = {key: _unwrapped(trace, value) for key, value in options.items()}
        return _wrapped(trace, function(*plain, **named))

    return moved


def _joining(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give a function that takes a sequence of arrays, or an array of which it takes the rows."""

    def parts(trace: Trace, value: Any) -> Any:
        if isinstance(value, (list, tuple)):
            return [parts(trace, part) for part in cast("list[Any]", value)]
        return lift(trace, value)

    def joined(trace: Trace, arrays: Any, *arguments: Any, **options: Any) -> Any:
        rows: Any = arrays
        if isinstance(arrays, TracedArray):
            rows = list(arrays)
        return wrap(trace, function(parts(trace, rows), *arguments, **options))

    return joined


def _astype(trace: Trace, values: Values, dtype: Any, **_: Any) -> Any:
    wanted = np.dtype(dtype)
    if wanted == np.bool_:
        return wrap(trace, values) != 0.0
    if wanted != np.float64 and records(values):
        remedy = "use np.floor, np.trunc or np.rint" if wanted.kind in "iu" else "leave it out"
        raise trace.error(f"make data of the type {wanted.name}", remedy)
    return wrap(trace, values.copy())


def _fill(trace: Trace, values: Values, value: Any) -> None:
    values[...] = lift(trace, value)


def _reshaped(trace: Trace, values: Values, *shape: Any, order: Any = "C") -> Any:
    return TracedArray(trace, values.reshape(*shape, order=order))


def _same(name: str) -> Callable[..., Any]:
    """Give a method that arrays of objects have as well."""

    def made(trace: Trace, values: Values, *arguments: Any, **options: Any) -> Any:
        return wrap(trace, getattr(values, name)(*arguments, **options))

    return made


def _item(_: Trace, values: Values, *index: Any) -> Any:
    return values.item(*index)


def _tolist(_: Trace, values: Values) -> Any:
    return values.tolist()


def _as_it_is(trace: Trace, values: Any) -> Any:
    return wrap(trace, lift(trace, values))


def _copy(trace: Trace, a: Any, order: Any = "K", subok: bool = False) -> Any:
    return wrap(trace, lift(trace, a).copy())


def _shape(trace: Trace, a: Any) -> Any:
    return lift(trace, a).shape


def _ndim(trace: Trace, a: Any) -> Any:
    return lift(trace, a).ndim


def _size(trace: Trace, a: Any, axis: int | None = None) -> Any:
    return np.size(lift(trace, a), axis)


def _no(trace: Trace, a: Any) -> bool:
    return False


def _yes(trace: Trace, a: Any) -> bool:
    return True


def _float64(trace: Trace, *_: Any) -> Any:
    return np.dtype(np.float64)


#: Functions that move numbers about, and those that only look at the shape.
SHAPING: dict[Any, Callable[..., Any]] = {
    **table({name: _moving(getattr(np, name)) for name in _NAMES if hasattr(np, name)}),
    **table({name: _joining(getattr(np, name)) for name in _JOINING}),
    **table(
        {
            "copy": _copy,
            "shape": _shape,
            "ndim": _ndim,
            "size": _size,
            "real": _as_it_is,
            "iscomplexobj": _no,
            "isrealobj": _yes,
            "result_type": _float64,
        }
    ),
}

#: Methods of arrays and numbers.
METHODS: dict[str, Callable[..., Any]] = {
    **{
        name: _same(name)
        for name in ("copy", "flatten", "ravel", "squeeze", "transpose", "swapaxes")
    },
    "reshape": _reshaped,
    "astype": _astype,
    "fill": _fill,
    "item": _item,
    "tolist": _tolist,
    "view": _as_it_is,
    "conj": _as_it_is,
}

#: Properties of arrays and numbers.
PROPERTIES: dict[str, Callable[[Trace, Values], Any]] = {
    "T": lambda trace, values: wrap(trace, values.T),
    "shape": lambda trace, values: values.shape,
    "ndim": lambda trace, values: values.ndim,
    "size": lambda trace, values: values.size,
    "dtype": lambda trace, values: np.dtype(np.float64),
    "real": lambda trace, values: wrap(trace, values),
    "flat": lambda trace, values: wrap(trace, values.reshape(-1)),
}
