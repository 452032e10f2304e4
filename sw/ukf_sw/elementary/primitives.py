"""What a lane of the array can do in one issue slot for the user's models, bit by bit.

A lane reads two words and gets a scalar. It computes ``c + a * b``, with the product rounded and
then the sum, as :mod:`ukf_sw.engine.arithmetic` does, and writes that, or keeps what was there:

- a is word 0, or the scalar (:class:`Multiplier`);
- c is plus zero, minus zero, word 0, or the scalar (:class:`Addend`);
- b is read from word 1 in one of four ways (:class:`Reading`), gets one of five signs
  (:class:`Sign`), and is turned if the product is to be subtracted;
- the lane writes always, or where a word or the result says so (:class:`Condition`).

Beside that there is the one unit behind the scalar bus, 1/sqrt, which takes the numbers of a word
one by one (:class:`Root`).

Numbers are held as in :mod:`ukf_sw.engine.arithmetic`. The sign of NaN is plus, as in its word;
the sign of a zero counts. Bits are those of the word. Words that no result has, those of subnormal
numbers and of other NaN, stand for what they are read as.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.engine import arithmetic
from ukf_sw.spec.float_format import FloatFormat

__all__ = [
    "Addend",
    "Condition",
    "Form",
    "Multiplier",
    "Reading",
    "Root",
    "Sign",
    "evaluate_root",
    "exponent_step",
    "is_narrow",
    "round_constant",
]

_Numbers = NDArray[np.float64]


class Multiplier(Enum):
    """Operand a."""

    WORD = "word"  #: Word 0.
    SCALAR = "scalar"


class Addend(Enum):
    """Operand c."""

    PLUS_ZERO = "plus zero"  #: A product of minus zero becomes plus zero.
    MINUS_ZERO = "minus zero"  #: The product passes as it is, with its sign.
    WORD = "word"  #: Word 0.
    SCALAR = "scalar"


class Reading(Enum):
    """How b is read from word 1.

    With E and F the bits of exponent and fraction, and ``middle`` = 1.5 * 2**F: between 2**F and
    2**(F + 1) all numbers are integers, and the low bits of a word there are those of ``k`` in
    ``middle + k``. Adding ``middle`` to a number rounds it to an integer, and makes such a word. In
    a format with F above its bias there is no such number, and the last two mean nothing.
    """

    NUMBER = "number"  #: The number.
    #: Plus one, whatever word 1 is; word 1 may still be the condition.
    ONE = "one"
    #: ``2**(k + 1)`` of ``middle + k``. Plus zero, if that is below the smallest normal number or
    #: word 1 is below 2**F (negative numbers are); plus infinity, if it is above the largest power
    #: or word 1 is 2**(F + 1) or more. NaN of NaN.
    POWER = "power"
    #: ``middle + floor((e - 1) / step)`` of a positive normal number of exponent e; step is 1 if F
    #: >= E, and see :func:`exponent_step`. Minus infinity of a zero; NaN of anything else.
    EXPONENT = "exponent"


class Sign(Enum):
    """Sign of b, before a subtraction turns it."""

    KEEP = "keep"  #: As it was read.
    CLEAR = "clear"  #: Plus.
    COPY = "copy"  #: That of word 0.
    BIT_0 = "bit 0"  #: Turned if bit 0 of word 0 is set.
    BIT_1 = "bit 1"  #: Turned if bit 1 of word 0 is set.


class Condition(Enum):
    """Lanes that write; the others keep what the destination has."""

    ALWAYS = "always"
    NEGATIVE = "negative"  #: Word 1 has its sign set: minus zero is negative, NaN is not.
    NOT_NEGATIVE = "not negative"  #: All others.
    ODD = "odd"  #: Bit 0 of word 1 is set.
    FINITE = "finite"  #: The result is neither infinite nor NaN.


class Root(Enum):
    """What the unit 1/sqrt gives of a number."""

    #: ``1/sqrt(x)``. A zero of either sign and infinity give plus zero; negative numbers and NaN
    #: give NaN.
    PLAIN = "plain"
    #: ``1/sqrt(abs(x))`` with the sign of x. Zeros give infinities, infinities give zeros. Finite
    #: numbers from 2**(bias - 1) on give NaN, as NaN does: the square of the root, which is to be a
    #: reciprocal, would be below the smallest normal number, or be that.
    SIGNED = "signed"


def exponent_step(fmt: FloatFormat) -> int:
    """How many exponents :attr:`Reading.EXPONENT` counts as one: the fraction has F bits for E."""
    return 1 << max(0, fmt.exponent_bits - fmt.fraction_bits)


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


@dataclass(frozen=True, kw_only=True)
class Form:
    """What one issue slot computes and writes.

    Parameters
    ----------
    multiplier, addend, reading, sign
        Operands.
    subtract
        Whether the product is subtracted.
    condition
        Lanes that write.
    """

    multiplier: Multiplier = Multiplier.WORD
    addend: Addend = Addend.MINUS_ZERO
    reading: Reading = Reading.NUMBER
    sign: Sign = Sign.KEEP
    subtract: bool = False
    condition: Condition = Condition.ALWAYS

    @property
    def uses_word_0(self) -> bool:
        """Whether the result depends on word 0."""
        return (
            self.multiplier is Multiplier.WORD
            or self.addend is Addend.WORD
            or self.sign in (Sign.COPY, Sign.BIT_0, Sign.BIT_1)
        )

    @property
    def uses_word_1(self) -> bool:
        """Whether the result or the write depends on word 1."""
        return self.reading is not Reading.ONE or self.condition not in (
            Condition.ALWAYS,
            Condition.FINITE,
        )

    @property
    def uses_scalar(self) -> bool:
        """Whether the result depends on the scalar."""
        return self.multiplier is Multiplier.SCALAR or self.addend is Addend.SCALAR

    def evaluate(
        self,
        fmt: FloatFormat,
        word_0: ArrayLike = 0.0,
        word_1: ArrayLike = 0.0,
        scalar: ArrayLike = 0.0,
        before: ArrayLike = np.nan,
    ) -> NDArray[np.float64]:
        """Give what the destination has afterwards.

        Parameters
        ----------
        fmt
            Number format.
        word_0, word_1, scalar
            Operands, numbers of that format, of shapes that broadcast. What is not used does not
            matter.
        before
            What the destination has before.
        """
        word_0, word_1, scalar = (
            np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (word_0, word_1, scalar)
        )
        zeros = {Addend.PLUS_ZERO: 0.0, Addend.MINUS_ZERO: -0.0}
        a = word_0 if self.multiplier is Multiplier.WORD else scalar
        if self.addend in zeros:
            c = np.array([zeros[self.addend]])
        else:
            c = word_0 if self.addend is Addend.WORD else scalar
        b = self._read(fmt, word_0, word_1)
        result = arithmetic.add(fmt, c, arithmetic.multiply(fmt, a, b))
        result[np.isnan(result)] = np.nan
        if self.condition is Condition.ALWAYS:
            return result
        return np.where(self._writes(fmt, word_1, result), result, before)

    def _read(self, fmt: FloatFormat, word_0: _Numbers, word_1: _Numbers) -> _Numbers:
        """Give operand b."""
        if self.reading is Reading.NUMBER:
            b = word_1
        elif self.reading is Reading.ONE:
            b = np.ones(1)
        elif self.reading is Reading.POWER:
            b = _power(fmt, word_1)
        else:
            b = _exponent(fmt, word_1)
        if self.sign is Sign.CLEAR:
            b = np.abs(b)
        elif self.sign is Sign.COPY:
            b = np.where(_is_negative(word_0), -np.abs(b), np.abs(b))
        elif self.sign is not Sign.KEEP:
            b = np.where(_bit(fmt, word_0, 0 if self.sign is Sign.BIT_0 else 1), -b, b)
        return -b if self.subtract else b

    def _writes(self, fmt: FloatFormat, word_1: _Numbers, result: _Numbers) -> NDArray[np.bool_]:
        """Give the lanes that write."""
        if self.condition is Condition.FINITE:
            return np.isfinite(result)
        if self.condition is Condition.ODD:
            return _bit(fmt, word_1, 0)
        negative = _is_negative(word_1)
        return negative if self.condition is Condition.NEGATIVE else ~negative


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
