"""NumPy's functions that make arrays like others."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.shaping import table
from ukf_sw.tracing.values import TracedArray, lift

__all__ = ["MAKING"]


def _like(value: float | None) -> Callable[..., Any]:
    """Make what makes an array of one value, or of one that is given, like another array."""

    def made(
        trace: Trace,
        like: Any,
        fill_value: Any = value,
        dtype: Any = None,
        order: Any = "K",
        subok: bool = True,
        shape: Any = None,
    ) -> Any:
        if dtype is not None and np.dtype(dtype) != np.float64:
            return np.full(np.shape(like) if shape is None else shape, fill_value, dtype)
        size = lift(trace, like).shape if shape is None else shape
        return TracedArray(trace, np.broadcast_to(lift(trace, fill_value), size).copy())

    return made


def _fixed(value: float) -> Callable[..., Any]:
    """The same, of one value."""
    make = _like(value)

    def made(trace: Trace, like: Any, dtype: Any = None, **options: Any) -> Any:
        return make(trace, like, dtype=dtype, **options)

    return made


#: What nobody has written is no number, so that it is seen in the result.
MAKING: dict[Any, Callable[..., Any]] = table(
    {
        "zeros_like": _fixed(0.0),
        "ones_like": _fixed(1.0),
        "empty_like": _fixed(float("nan")),
        "full_like": _like(None),
    }
)
