"""NumPy's functions that choose between numbers, and others of single numbers."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.elementwise import choose
from ukf_sw.tracing.shaping import table
from ukf_sw.tracing.values import Values, lift, records, wrap

__all__ = ["CHOOSING"]

#: Points that a table may have.
LARGEST_TABLE = 256


def _where(trace: Trace, condition: Any, *values: Any) -> Any:
    if len(values) != 2:
        raise trace.error(
            "ask np.where for indices, which depend on data", "use np.where(condition, a, b)"
        )
    given = [lift(trace, value) for value in (condition, *values)]
    numbers: list[Values] = list(np.broadcast_arrays(*given))
    conditions, a, b = numbers
    found = np.empty(a.shape, dtype=object)
    for index in np.ndindex(*a.shape):
        asked: Any = conditions[index]
        found[index] = choose(trace, asked, a[index], b[index])
    return wrap(trace, found)


def _clip(
    trace: Trace, a: Any, a_min: Any = None, a_max: Any = None, *, min: Any = None, max: Any = None
) -> Any:
    low, high = (a_min if min is None else min), (a_max if max is None else max)
    found = a
    if low is not None:
        found = np.maximum(found, low)
    return found if high is None else np.minimum(found, high)


def _select(trace: Trace, condlist: Any, choicelist: Any, default: Any = 0.0) -> Any:
    found = default
    pairs = list(zip(condlist, choicelist, strict=True))
    for condition, choice in reversed(pairs):
        found = _where(trace, condition, choice, found)
    return found


def _piecewise(trace: Trace, x: Any, condlist: Any, funclist: Any) -> Any:
    parts = [part(x) if callable(part) else part for part in funclist]
    default = parts.pop() if len(parts) > len(condlist) else 0.0
    # The last condition that is true decides.
    return _select(trace, list(condlist)[::-1], parts[::-1], default)


def _sinc(_: Trace, x: Any) -> Any:
    scaled = np.pi * x
    return np.where(scaled == 0.0, 1.0, np.sin(scaled) / scaled)


def _round(_: Trace, a: Any, decimals: int = 0) -> Any:
    if decimals == 0:
        return np.rint(a)
    factor = 10.0 ** abs(decimals)
    if decimals > 0:
        return np.rint(a * factor) / factor
    return np.rint(a / factor) * factor


def _fix(_: Trace, x: Any) -> Any:
    return np.trunc(x)


def _interp(trace: Trace, x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None) -> Any:
    """Interpolate in a table of constant places, as NumPy does."""
    if records(xp):
        raise trace.error("interpolate between places that depend on data", "use np.where")
    places = np.asarray(xp, dtype=np.float64)
    values = list(lift(trace, fp))
    if not 2 <= len(places) <= LARGEST_TABLE:
        raise trace.error(
            f"interpolate in a table of {len(places)} points",
            f"use one of 2 to {LARGEST_TABLE}, or a polynomial",
        )
    found: Any = values[0] if left is None else left
    for k in range(len(places) - 1):
        slope = (values[k + 1] - values[k]) / (places[k + 1] - places[k])
        line = slope * (x - places[k]) + values[k]
        found = _where(trace, x >= places[k], line, found)
    found = _where(trace, x >= places[-1], values[-1], found)
    return found if right is None else _where(trace, x > places[-1], right, found)


def _polyval(trace: Trace, p: Any, x: Any) -> Any:
    """Evaluate a polynomial by Horner's rule, the highest power first."""
    coefficients = list(wrap(trace, lift(trace, p)))
    found = coefficients[0]
    for coefficient in coefficients[1:]:
        found = found * x + coefficient
    return found


CHOOSING: dict[Any, Callable[..., Any]] = table(
    {
        "where": _where,
        "clip": _clip,
        "select": _select,
        "piecewise": _piecewise,
        "sinc": _sinc,
        "round": _round,
        "around": _round,
        "fix": _fix,
        "interp": _interp,
        "polyval": _polyval,
    }
)
