"""A check that a graph computes what its model does: both are called with the same numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.models import ROW_TOLERANCE, TOLERANCE
from ukf_sw.tracing.graph import Graph
from ukf_sw.tracing.tracer import Call

__all__ = ["call_model", "check"]

Array = NDArray[np.float64]

#: Rounding is so many times what changes of the last bit of all intermediate values do to a result.
ROUNDINGS = 16.0
DISTURBED = 3
EPSILON = float(np.finfo(np.float64).eps)


def call_model(call: Call, x: Array, noise: Array, given: Mapping[str, Any]) -> Array:
    """Call a model for sigma points, as the filter does; gives shape (rows, K)."""
    positional = [given[name] for name in call.positional]
    keywords = {name: given.get(name, value) for name, value in call.keywords.items()}
    with np.errstate(all="ignore"):
        if call.vectorized:
            return np.asarray(call.function(x.copy(), noise.copy(), *positional, **keywords))
        columns = [
            call.function(x[:, k].copy(), noise[:, k].copy(), *positional, **keywords)
            for k in range(x.shape[1])
        ]
    return np.stack([np.asarray(column) for column in columns], axis=1)


def _rounding(graph: Graph, arguments: Mapping[str, Any], found: Array) -> Array:
    """Find out by how much results change if every intermediate value changes in its last bit."""
    draws = np.random.default_rng(0)
    largest = np.zeros(found.shape)

    def disturb(values: Array) -> Array:
        return values * (1.0 + EPSILON * draws.choice((-1.0, 1.0), values.shape))

    for _ in range(DISTURBED):
        with np.errstate(all="ignore"):
            moved = np.abs(graph.evaluate(arguments, disturb) - found)
        largest = np.fmax(largest, np.where(np.isfinite(moved), moved, 0.0))
    return largest


def check(call: Call, graph: Graph, x: Array, noise: Array, given: Mapping[str, Any]) -> None:
    """Compare a graph with its model.

    Parameters
    ----------
    call, graph
        The model, and what was traced of it.
    x, noise
        Sigma points, shapes (n, K) and (terms, K).
    given
        Values of the other arguments by name.

    Raises
    ------
    ValueError
        If they differ by more than rounding; the message has the row, both values and the point.
    """
    arguments = {**given, "x": x, call.noise: noise}
    expected = call_model(call, x, noise, given)
    if expected.shape != (call.rows, x.shape[1]):
        raise ValueError(
            f"{call.name} must return the shape {(call.rows, x.shape[1])}, one column a sigma "
            f"point, not {expected.shape!r}"
        )
    found = np.broadcast_to(graph.evaluate(arguments), expected.shape)
    with np.errstate(all="ignore"):
        largest = np.abs(np.where(np.isfinite(expected), expected, 0.0))
        tolerance = np.maximum(
            ROW_TOLERANCE * largest.max(axis=1, keepdims=True), TOLERANCE * largest.max()
        )
        difference = np.abs(found - expected)
    equal = (difference <= tolerance) | (found == expected) | (np.isnan(found) & np.isnan(expected))
    if not equal.all():  # what cancels is rounded more than its size tells
        equal |= difference <= tolerance + ROUNDINGS * _rounding(graph, arguments, found)
    if equal.all():
        return
    row, k = (int(i) for i in np.argwhere(~equal)[0])
    point = ", ".join(
        f"{name} = {np.asarray(value).tolist()!r}"
        for name, value in {"x": x[:, k], call.noise: noise[:, k], **given}.items()
        if value is not None and np.size(value)
    )
    raise ValueError(
        f"{call.name} must give what was traced of it, {float(found[row, k])!r}, and not "
        f"{float(expected[row, k])!r} in row {row} for {point}"
    )
