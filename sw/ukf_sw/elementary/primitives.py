"""What a form of the lanes computes, bit by bit.

Numbers are held as in :mod:`ukf_sw.engine.arithmetic`. The sign of NaN is plus, as in its word;
the sign of a zero counts. Bits are those of the word. Words that no result has, those of subnormal
numbers and of other NaN, stand for what they are read as.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.engine import arithmetic
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.forms import (
    Addend,
    Condition,
    Form,
    Multiplier,
    Reading,
    Root,
    Sign,
    exponent_step,
)

__all__ = ["evaluate", "evaluate_root", "is_narrow", "round_constant"]

_Numbers = NDArray[np.float64]


def is_narrow(fmt: FloatFormat) -> bool:
    """Whether a format's range is so narrow that rounding errors of numbers near 1 are flushed."""
    return fmt.bias < 2 * fmt.precision


def round_constant(fmt: FloatFormat, value: float) -> float:
    """Give the number of a format that is nearest to a constant."""
    return float(fmt.round(value))


def _bit(fmt: FloatFormat, values: _Numbers, number: int) -> NDArray[np.bool_]:
    """Give a bit of the fraction of each word."""
    shift = np.uint64(52 - fmt.fraction_bits + number)
    return (values.view(np.uint64) >> shift & np.uint64(1)).astype(np.bool_)


def _is_negative(values: _Numbers) -> NDArray[np.bool_]:
    return np.signbit(values) & ~np.isnan(values)


def _power(fmt: FloatFormat, word: _Numbers) -> _Numbers:
    low = 2.0**fmt.fraction_bits
    is_integer = (word >= low) & (word < 2.0 * low)
    exponent = np.where(is_integer, word, 1.5 * low) - 1.5 * low + 1.0
    result = np.ldexp(1.0, np.clip(exponent, 1 - fmt.bias, fmt.bias).astype(np.int64))
    result = np.where((word < low) | (exponent < 1 - fmt.bias), 0.0, result)
    result = np.where((word >= 2.0 * low) | (exponent > fmt.bias), np.inf, result)
    return np.where(np.isnan(word), np.nan, result)


def _exponent(fmt: FloatFormat, word: _Numbers) -> _Numbers:
    usable = (word > 0.0) & (word < np.inf)
    exponent = np.frexp(np.where(usable, word, 1.0))[1] - 1
    integer = (exponent - 1) // exponent_step(fmt)
    result = np.where(usable, 1.5 * 2.0**fmt.fraction_bits + integer, np.nan)
    return np.where(word == 0.0, -np.inf, result)


def evaluate(
    form: Form,
    fmt: FloatFormat,
    word_0: ArrayLike = 0.0,
    word_1: ArrayLike = 0.0,
    scalar: ArrayLike = 0.0,
    before: ArrayLike = np.nan,
) -> NDArray[np.float64]:
    """Give what the destination has afterwards.

    Parameters
    ----------
    form
        What the slot computes and writes.
    fmt
        Number format.
    word_0, word_1, scalar
        Operands, numbers of that format, in one dimension, of length K or 1. What is not used does
        not matter.
    before
        What the destination has before.
    """
    word_0, word_1, scalar = (
        np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (word_0, word_1, scalar)
    )
    zeros = {Addend.PLUS_ZERO: 0.0, Addend.MINUS_ZERO: -0.0}
    a = word_0 if form.multiplier is Multiplier.WORD else scalar
    if form.addend in zeros:
        c = np.array([zeros[form.addend]])
    else:
        c = word_0 if form.addend is Addend.WORD else scalar
    result = arithmetic.multiply_add(fmt, c, a, _read(form, fmt, word_0, word_1))
    result[np.isnan(result)] = np.nan
    if form.condition is Condition.ALWAYS:
        return result
    return np.where(_writes(form, fmt, word_1, result), result, before)


def _read(form: Form, fmt: FloatFormat, word_0: _Numbers, word_1: _Numbers) -> _Numbers:
    """Give operand b."""
    if form.reading is Reading.NUMBER:
        b = word_1
    elif form.reading is Reading.ONE:
        b = np.ones(1)
    elif form.reading is Reading.POWER:
        b = _power(fmt, word_1)
    else:
        b = _exponent(fmt, word_1)
    if form.sign is Sign.CLEAR:
        b = np.abs(b)
    elif form.sign is Sign.COPY:
        b = np.where(_is_negative(word_0), -np.abs(b), np.abs(b))
    elif form.sign is not Sign.KEEP:
        b = np.where(_bit(fmt, word_0, 0 if form.sign is Sign.BIT_0 else 1), -b, b)
    return -b if form.subtract else b


def _writes(form: Form, fmt: FloatFormat, word_1: _Numbers, result: _Numbers) -> NDArray[np.bool_]:
    """Give the lanes that write."""
    if form.condition is Condition.FINITE:
        return np.isfinite(result)
    if form.condition is Condition.ODD:
        return _bit(fmt, word_1, 0)
    negative = _is_negative(word_1)
    return negative if form.condition is Condition.NEGATIVE else ~negative


def evaluate_root(fmt: FloatFormat, root: Root, values: ArrayLike) -> NDArray[np.float64]:
    """Give what the unit 1/sqrt makes of numbers of a format."""
    x = np.asarray(values, dtype=np.float64)
    if root is Root.PLAIN:
        return arithmetic.reciprocal_sqrt(fmt, x)
    magnitude = np.abs(x)
    result = arithmetic.reciprocal_sqrt(fmt, magnitude)
    result = np.where(magnitude < fmt.min_normal, np.inf, result)
    is_large = (magnitude >= 2.0 ** (fmt.bias - 1)) & (magnitude < np.inf)
    return np.where(is_large | np.isnan(x), np.nan, np.copysign(result, x))
