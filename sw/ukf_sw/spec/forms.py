"""What a lane of the array can do in one issue slot: the forms of its operands.

A lane reads two words and gets a scalar. It computes ``c + a * b``, with the product rounded and
then the sum, and writes that, or keeps what was there:

- a is word 0, or the scalar (:class:`Multiplier`);
- c is plus zero, minus zero, word 0, or the scalar (:class:`Addend`);
- b is read from word 1 in one of four ways (:class:`Reading`), gets one of five signs
  (:class:`Sign`), and is turned if the product is to be subtracted;
- the lane writes always, or where a word or the result says so (:class:`Condition`).

Beside that there is the one unit behind the scalar bus, 1/sqrt, which takes the numbers of a word
one by one (:class:`Root`).

The programs of the filter need a few forms only; the others are for the user's models
(:mod:`ukf_sw.spec.models`). What a form computes, bit by bit, is in
:mod:`ukf_sw.elementary.primitives`.
"""

from dataclasses import dataclass
from enum import Enum

from ukf_sw.spec.float_format import FloatFormat

__all__ = ["Addend", "Condition", "Form", "Multiplier", "Reading", "Root", "Sign", "exponent_step"]


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
    #: >= E, and see :func:`exponent_step`. Minus infinity of a zero;
    #: NaN of anything else.
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


def exponent_step(fmt: FloatFormat) -> int:
    """How many exponents :attr:`Reading.EXPONENT` counts as one: the fraction has F bits for E."""
    return 1 << max(0, fmt.exponent_bits - fmt.fraction_bits)
