"""NumPy's products of vectors and matrices.

Each element is a sum of products from the first to the last. NumPy leaves large ones to a library
that has an order of its own, so last bits may differ. Factors that are zero stay: 0 times infinity
is no number.
"""

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.shaping import table
from ukf_sw.tracing.values import Values, lift, wrap

__all__ = ["PRODUCTS", "dot"]


def _contract(trace: Trace, inputs: list[str], output: str, operands: list[Values]) -> Any:
    """Sum products of elements, each index named by a letter."""
    sizes: dict[str, int] = {}
    for letters, operand in zip(inputs, operands, strict=True):
        if len(letters) != operand.ndim:
            raise ValueError(f"einsum must name {operand.ndim} indices, not {letters!r}")
        for letter, size in zip(letters, operand.shape, strict=True):
            if sizes.setdefault(letter, size) != size:
                raise ValueError(
                    f"shapes must agree, not {' and '.join(str(each.shape) for each in operands)}"
                )
    summed = [letter for letter in sizes if letter not in output]
    found = np.empty([sizes[letter] for letter in output], dtype=object)
    for index in np.ndindex(*found.shape):
        at = dict(zip(output, index, strict=True))
        total: Any = None
        for inner in product(*(range(sizes[letter]) for letter in summed)):
            at.update(zip(summed, inner, strict=True))
            term: Any = None
            for letters, operand in zip(inputs, operands, strict=True):
                factor = operand[tuple(at[letter] for letter in letters)]
                term = factor if term is None else term * factor
            total = term if total is None else total + term
        found[index] = lift(trace, 0.0 if total is None else total)[()]
    return wrap(trace, found)


def _einsum(trace: Trace, subscripts: Any, *operands: Any, optimize: Any = False) -> Any:
    text = subscripts.replace(" ", "") if isinstance(subscripts, str) else ""
    if not text or "." in text:
        raise trace.error("call np.einsum without a letter for every index", "name them all")
    left, arrow, output = text.partition("->")
    inputs = left.split(",")
    if not arrow:
        letters = left.replace(",", "")
        output = "".join(sorted(x for x in set(letters) if letters.count(x) == 1))
    return _contract(trace, inputs, output, [lift(trace, operand) for operand in operands])


def dot(trace: Trace, a: Any, b: Any, *, matmul: bool = False) -> Any:
    """Multiply vectors, matrices, or with `matmul` stacks of matrices."""
    first, second = lift(trace, a), lift(trace, b)
    if not first.ndim or not second.ndim:
        return wrap(trace, first) * wrap(trace, second)
    letters = "abcdefgh"
    left = letters[: first.ndim - 1] + "z"
    right = [*letters[first.ndim : first.ndim + second.ndim - 1]]
    right.insert(max(second.ndim - 2, 0), "z")
    if matmul and max(first.ndim, second.ndim) > 2:
        return _stacked(trace, first, second)
    output = (left + "".join(right)).replace("z", "")
    return _contract(trace, [left, "".join(right)], output, [first, second])


def _matmul(trace: Trace, a: Any, b: Any) -> Any:
    return dot(trace, a, b, matmul=True)


def _stacked(trace: Trace, first: Values, second: Values) -> Any:
    """Multiply stacks of matrices."""
    if min(first.ndim, second.ndim) < 2:
        return dot(trace, wrap(trace, first), wrap(trace, second))
    shape = np.broadcast_shapes(first.shape[:-2], second.shape[:-2])
    a = np.broadcast_to(first, shape + first.shape[-2:])
    b = np.broadcast_to(second, shape + second.shape[-2:])
    letters = "abcdefgh"[: len(shape)]
    return _contract(trace, [f"{letters}xz", f"{letters}zy"], f"{letters}xy", [a, b])


def _vdot(trace: Trace, a: Any, b: Any) -> Any:
    return dot(trace, lift(trace, a).reshape(-1), lift(trace, b).reshape(-1))


def _inner(trace: Trace, a: Any, b: Any) -> Any:
    return dot(trace, a, wrap(trace, np.moveaxis(lift(trace, b), -1, max(np.ndim(b) - 2, 0))))


def _outer(trace: Trace, a: Any, b: Any) -> Any:
    first, second = (wrap(trace, lift(trace, value).reshape(-1)) for value in (a, b))
    return first[:, np.newaxis] * second


def _cross(
    trace: Trace,
    a: Any,
    b: Any,
    axisa: int = -1,
    axisb: int = -1,
    axisc: int = -1,
    axis: int | None = None,
) -> Any:
    places = (axisa, axisb, axisc) if axis is None else (axis,) * 3
    first, second = (
        np.moveaxis(lift(trace, value), place, 0)
        for value, place in ((a, places[0]), (b, places[1]))
    )
    if len(first) != 3 or len(second) != 3:
        raise trace.error("take the cross product of other vectors than of 3", "write it out")
    a1, a2, a3 = wrap(trace, first)
    b1, b2, b3 = wrap(trace, second)
    parts = (a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1)
    return wrap(trace, np.moveaxis(lift(trace, parts), 0, places[2]))


def _kron(trace: Trace, a: Any, b: Any) -> Any:
    return wrap(trace, np.kron(lift(trace, a), lift(trace, b)))


def _tensordot(trace: Trace, a: Any, b: Any, axes: Any = 2) -> Any:
    return wrap(trace, np.asarray(np.tensordot(lift(trace, a), lift(trace, b), axes)))


def _norm(trace: Trace, x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    values = lift(trace, x)
    flat = axis is None and (ord is None or ord == "fro")
    vector = values.ndim == 1 or isinstance(axis, int)
    if not (flat or (vector and ord in (None, 1, 2, np.inf))):
        raise trace.error(
            f"call np.linalg.norm of order {ord!r} for this array", "write it with np.sum"
        )
    found = wrap(trace, values)
    if ord in (1, np.inf):
        combine = np.sum if ord == 1 else np.max
        return combine(np.abs(found), axis=axis, keepdims=keepdims)
    return np.sqrt(np.sum(found * found, axis=axis, keepdims=keepdims))


PRODUCTS: dict[Any, Callable[..., Any]] = {
    **table(
        {
            "dot": dot,
            "vdot": _vdot,
            "inner": _inner,
            "outer": _outer,
            "einsum": _einsum,
            "cross": _cross,
            "kron": _kron,
            "tensordot": _tensordot,
        }
    ),
    np.linalg.norm: _norm,
    # From NumPy 2 on.
    **{
        getattr(np.linalg, name): made
        for name, made in (("cross", _cross), ("outer", _outer), ("matmul", _matmul))
        if hasattr(np.linalg, name)
    },
}
