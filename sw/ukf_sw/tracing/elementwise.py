"""NumPy's functions of single numbers, by the operations of a graph.

Those that are no operation themselves are written with others:

- ``x**k`` with a whole k up to 64 is a product of squares, the lowest power first: ``x**3`` is
  ``x * (x * x)``, ``x**5`` is ``x * ((x * x) * (x * x))``, ``x**-2`` is ``1 / (x * x)``. ``x**0.5``
  is ``sqrt(x)``. All other powers are the operation power.
- ``a % b`` is ``a - b * floor(a / b)``, ``a // b`` is ``floor(a / b)``, ``fmod`` has trunc instead.
- sinh, cosh, log2, log10, exp2, expm1 and log1p are written with exp and log, so they are less
  accurate than NumPy's where they cancel.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.operations import Operation
from ukf_sw.tracing.values import TracedNumber

__all__ = ["UFUNCS", "Function", "choose"]

#: Largest power that is a product.
LARGEST_POWER = 64


@dataclass(frozen=True)
class Function:
    """A function of single numbers.

    Parameters
    ----------
    arity
        How many it takes.
    compute
        What it does with a trace and as many numbers.
    """

    arity: int
    compute: Callable[..., Any]


def _apply(trace: Trace, operation: Operation, *numbers: TracedNumber) -> TracedNumber:
    nodes = (number.number for number in numbers)
    return TracedNumber(trace, trace.builder.apply(operation, *nodes))


def _condition(number: Any) -> Any:
    """Make a condition of a number: whether it is not zero."""
    return number if number.node.is_condition else number != 0.0


def choose(trace: Trace, asked: TracedNumber, a: Any, b: Any) -> TracedNumber:
    """Give a where something is true, b elsewhere; of two conditions that is one again."""
    condition = _condition(asked)
    if a.node.is_condition and b.node.is_condition:
        return (condition & a) | (~condition & b)
    return _apply(trace, Operation.WHERE, condition, a, b)


def _operation(operation: Operation) -> Function:
    def compute(trace: Trace, *numbers: TracedNumber) -> TracedNumber:
        return _apply(trace, operation, *numbers)

    return Function(operation.arity, compute)


def _arithmetic(operation: Operation, logical: Operation | None) -> Function:
    """Give an operation of numbers that is another one if all are conditions, as with NumPy."""

    def compute(trace: Trace, *numbers: TracedNumber) -> TracedNumber:
        if not all(number.node.is_condition for number in numbers):
            return _apply(trace, operation, *numbers)
        if logical is None:
            raise trace.error(f"apply {operation.symbol} to conditions alone", "use ~a, or a != b")
        return _apply(trace, logical, *numbers)

    return Function(operation.arity, compute)


def _logical(operation: Operation) -> Function:
    """Give an operation of conditions; the bits of numbers are not for it."""

    def compute(trace: Trace, *numbers: TracedNumber) -> TracedNumber:
        if not all(number.node.is_condition for number in numbers):
            raise trace.error(
                f"apply {operation.symbol} to numbers",
                "put parentheses around comparisons: (a < b)",
            )
        return _apply(trace, operation, *numbers)

    return Function(operation.arity, compute)


def _power(trace: Trace, base: TracedNumber, exponent: TracedNumber) -> Any:
    k = exponent.known
    if base.known is not None or k is None:
        return _apply(trace, Operation.POWER, base, exponent)
    if abs(k) == 0.5:
        root = _apply(trace, Operation.SQRT, base)
        return root if k > 0 else 1.0 / root
    if not float(k).is_integer() or abs(k) > LARGEST_POWER:
        return _apply(trace, Operation.POWER, base, exponent)
    left, square, product = int(abs(k)), base, None
    while left:
        if left & 1:
            product = square if product is None else product * square
        left >>= 1
        if left:
            square = square * square
    if product is None:
        return TracedNumber(trace, trace.builder.constant(1.0))
    return product if k > 0 else 1.0 / product


def _exclusive(_: Trace, a: Any, b: Any) -> Any:
    return (a & ~b) | (~a & b)


def _one_of_two(trace: Trace, a: Any, b: Any) -> Any:
    return _exclusive(trace, _condition(a), _condition(b))


def _heaviside(_: Trace, x: Any, middle: Any) -> Any:
    return np.where(x == 0.0, middle, np.where(x < 0.0, 0.0, 1.0))


def _truncated(trace: Trace, a: Any) -> TracedNumber:
    up, down = _apply(trace, Operation.CEIL, a), _apply(trace, Operation.FLOOR, a)
    return choose(trace, a < 0.0, up, down)


def _is_infinite(a: Any) -> Any:
    return np.abs(a) == np.inf


def _one(compute: Callable[[Any], Any]) -> Function:
    """Make a function of one number of what is written with other functions."""

    def written(_: Trace, a: Any) -> Any:
        return compute(a)

    return Function(1, written)


def _two(compute: Callable[[Any, Any], Any]) -> Function:
    """Make a function of two numbers."""

    def written(_: Trace, a: Any, b: Any) -> Any:
        return compute(a, b)

    return Function(2, written)


#: Functions by NumPy's.
UFUNCS: dict[np.ufunc, Function] = {
    **{
        getattr(np, operation.label): _operation(operation)
        for operation in Operation
        if operation.arity and operation not in (Operation.WHERE, Operation.POWER)
    },
    np.add: _arithmetic(Operation.ADD, Operation.LOGICAL_OR),
    np.multiply: _arithmetic(Operation.MULTIPLY, Operation.LOGICAL_AND),
    np.subtract: _arithmetic(Operation.SUBTRACT, None),
    np.negative: _arithmetic(Operation.NEGATIVE, None),
    np.maximum: _arithmetic(Operation.MAXIMUM, Operation.LOGICAL_OR),
    np.minimum: _arithmetic(Operation.MINIMUM, Operation.LOGICAL_AND),
    np.bitwise_and: _logical(Operation.LOGICAL_AND),
    np.bitwise_or: _logical(Operation.LOGICAL_OR),
    np.invert: _logical(Operation.LOGICAL_NOT),
    np.bitwise_xor: Function(2, _exclusive),
    np.logical_xor: Function(2, _one_of_two),
    np.power: Function(2, _power),
    np.float_power: Function(2, _power),
    np.heaviside: Function(2, _heaviside),
    np.positive: _one(lambda a: a),
    np.conjugate: _one(lambda a: a),
    np.fabs: _one(np.absolute),
    np.square: _one(lambda a: a * a),
    np.reciprocal: _one(lambda a: 1.0 / a),
    np.trunc: Function(1, _truncated),
    np.remainder: _two(lambda a, b: a - b * np.floor(a / b)),
    np.floor_divide: _two(lambda a, b: np.floor(a / b)),
    np.fmod: _two(lambda a, b: a - b * np.trunc(a / b)),
    np.divmod: _two(lambda a, b: (a // b, a % b)),
    np.radians: _one(lambda a: a * (math.pi / 180.0)),
    np.deg2rad: _one(lambda a: a * (math.pi / 180.0)),
    np.degrees: _one(lambda a: a * (180.0 / math.pi)),
    np.rad2deg: _one(lambda a: a * (180.0 / math.pi)),
    np.sinh: _one(lambda a: 0.5 * (np.exp(a) - np.exp(-a))),
    np.cosh: _one(lambda a: 0.5 * (np.exp(a) + np.exp(-a))),
    np.exp2: _one(lambda a: np.exp(a * math.log(2.0))),
    np.expm1: _one(lambda a: np.exp(a) - 1.0),
    np.log1p: _one(lambda a: np.log(1.0 + a)),
    np.log2: _one(lambda a: np.log(a) / math.log(2.0)),
    np.log10: _one(lambda a: np.log(a) / math.log(10.0)),
    np.isnan: _one(lambda a: a != a),
    np.isfinite: _one(lambda a: a - a == 0.0),
    np.isinf: _one(_is_infinite),
    np.signbit: _one(lambda a: np.copysign(1.0, a) < 0.0),
}
