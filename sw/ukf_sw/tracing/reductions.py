"""NumPy's functions that make one number of many.

Sums and products go from the first element to the last, one at a time. NumPy adds eight or more
elements in another order, so last bits may differ.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.shaping import table
from ukf_sw.tracing.values import Values, lift, wrap

__all__ = ["REDUCTIONS", "accumulate", "reduce"]

Axes = int | tuple[int, ...] | None


def _along(values: Values, axis: Axes) -> tuple[Values, list[int]]:
    """Put what is to become one number last; gives also the axes that it was."""
    wanted = range(values.ndim) if axis is None else axis if isinstance(axis, tuple) else (axis,)
    axes = [range(values.ndim)[each] for each in wanted]
    kept = [each for each in range(values.ndim) if each not in axes]
    moved = values.transpose([*kept, *axes])
    return moved.reshape(*(values.shape[each] for each in kept), -1), axes


def reduce(trace: Trace, ufunc: Any, a: Any, axis: Axes = None, keepdims: bool = False) -> Any:
    """Combine the elements along axes, from the first to the last."""
    values = lift(trace, a)
    rows, axes = _along(values, axis)
    found = np.empty(rows.shape[:-1], dtype=object)
    for index in np.ndindex(*found.shape):
        elements = list(rows[index])
        if not elements and ufunc.identity is None:
            raise trace.error(f"call np.{ufunc.__name__} for no elements", "give it some")
        total = elements[0] if elements else lift(trace, float(ufunc.identity))[()]
        for element in elements[1:]:
            total = ufunc(total, element)
        found[index] = total
    if keepdims:
        found = found.reshape([1 if i in axes else size for i, size in enumerate(values.shape)])
    return wrap(trace, found)


def accumulate(trace: Trace, ufunc: Any, a: Any, axis: int | None = None) -> Any:
    """Combine each element with those before it."""
    values = lift(trace, a)
    values = values.reshape(-1) if axis is None else values
    found = np.moveaxis(values.copy(), axis or 0, 0)
    for k in range(1, len(found)):
        total = lift(trace, ufunc(wrap(trace, found[k - 1]), wrap(trace, found[k])))
        found[k] = total if total.ndim else total[()]
    return wrap(trace, np.moveaxis(found, 0, axis or 0))


def _numbers(trace: Trace, a: Any) -> Any:
    """Count conditions as 1 and 0: a sum of them is how many are true."""
    values = lift(trace, a)
    conditions = [number.node.is_condition for number in values.flat]
    return np.where(wrap(trace, values), 1.0, 0.0) if conditions and all(conditions) else a


def _reduction(ufunc: Any) -> Callable[..., Any]:
    def made(trace: Trace, a: Any, axis: Axes = None, *, keepdims: bool = False) -> Any:
        return reduce(trace, ufunc, a, axis, keepdims)

    return made


def _sum(trace: Trace, a: Any, axis: Axes = None, *, keepdims: bool = False) -> Any:
    return reduce(trace, np.add, _numbers(trace, a), axis, keepdims)


def _mean(trace: Trace, a: Any, axis: Axes = None, *, keepdims: bool = False) -> Any:
    values = lift(trace, a)
    return _sum(trace, a, axis, keepdims=keepdims) / float(_along(values, axis)[0].shape[-1])


def _variance(
    trace: Trace, a: Any, axis: Axes = None, *, ddof: int = 0, keepdims: bool = False
) -> Any:
    difference = wrap(trace, lift(trace, a)) - _mean(trace, a, axis, keepdims=True)
    total = _sum(trace, difference * difference, axis, keepdims=keepdims)
    return total / float(_along(lift(trace, a), axis)[0].shape[-1] - ddof)


def _deviation(trace: Trace, a: Any, axis: Axes = None, **options: Any) -> Any:
    return np.sqrt(_variance(trace, a, axis, **options))


def _range(_: Trace, a: Any, axis: Axes = None) -> Any:
    return np.max(a, axis) - np.min(a, axis)


def _accumulation(ufunc: Any) -> Callable[..., Any]:
    def made(trace: Trace, a: Any, axis: int | None = None) -> Any:
        return accumulate(trace, ufunc, a, axis)

    return made


def _difference(_: Trace, a: Any, n: int = 1, axis: int = -1) -> Any:
    found = a
    for _each in range(n):
        moved = np.moveaxis(found, axis, 0)
        found = np.moveaxis(moved[1:] - moved[:-1], 0, axis)
    return found


def _trace_of_matrix(_: Trace, a: Any) -> Any:
    return np.sum(np.diagonal(a))


REDUCTIONS: dict[Any, Callable[..., Any]] = table(
    {
        "sum": _sum,
        "prod": _reduction(np.multiply),
        **dict.fromkeys(("max", "amax"), _reduction(np.maximum)),
        **dict.fromkeys(("min", "amin"), _reduction(np.minimum)),
        "any": _reduction(np.logical_or),
        "all": _reduction(np.logical_and),
        "mean": _mean,
        "var": _variance,
        "std": _deviation,
        "ptp": _range,
        "cumsum": _accumulation(np.add),
        "cumprod": _accumulation(np.multiply),
        "diff": _difference,
        "trace": _trace_of_matrix,
    }
)
