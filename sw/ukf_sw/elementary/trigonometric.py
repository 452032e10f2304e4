"""Sine, cosine and tangent.

The argument is reduced by the nearest multiple k of a period, in parts of pi whose products with k
are exact. So that no argument is reduced wrongly, the number of periods is formed times a power of
two with which it overflows where there are too many. Then k is infinite, and what is left is NaN,
because not all parts have the same sign.
"""

from math import pi

from ukf_sw.elementary.coefficients import coefficients
from ukf_sw.elementary.quotients import reciprocal
from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.forms import Condition, Sign
from ukf_sw.spec.model_programs import Operand, Temporary

__all__ = ["angle_limit", "cos", "sin", "sincos", "tan"]


def angle_limit(fmt: FloatFormat) -> float:
    """Give the magnitude below which arguments are reduced; somewhere above, they give NaN."""
    # The number of periods, in cosines one half more, is rounded before it overflows.
    return pi * (2.0 ** coefficients(fmt).turn_bits - 0.5) * (1.0 - 2.0 * fmt.epsilon)


def _reduced(
    builder: SequenceBuilder, x: Operand, quarters: int, *, offset: float | None = None
) -> tuple[Temporary, Operand]:
    """Give x without the nearest multiple of some quarter turns, and k as a word with its bits.

    With an offset, multiples are ``k - offset``.
    """
    fmt, table = builder.fmt, coefficients(builder.fmt)
    middle = 1.5 * 2.0**fmt.fraction_bits
    period = quarters * pi / 2
    scale = 2.0 ** (fmt.bias + 1 - (table.turn_bits + 2 - quarters))
    plus = None if offset is None else offset * scale
    periods = builder.scaled(scale / period, x, plus=plus)
    word = builder.scaled(1.0 / scale, periods, plus=middle)
    k = builder.shifted(word, middle, subtract=True)
    if offset is not None:
        k = builder.shifted(k, offset, subtract=True)
    r = x if table.angle_scale == 1.0 else builder.scaled(table.angle_scale, x)
    for part in table.half_pi:
        r = builder.scaled(quarters * part, k, plus=r, subtract=True)
    if table.angle_scale != 1.0:
        r = builder.scaled(1.0 / table.angle_scale, r)
    return word, r


def _odd(
    builder: SequenceBuilder, r: Operand, z: Operand, polynomial: tuple[float, ...]
) -> Temporary:
    """Give r + r * z * P(z)."""
    return builder.grown(r, builder.product(builder.polynomial(polynomial, z), z))


def sin(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the sine, up to :func:`angle_limit`; the sine of minus zero is plus zero."""
    return _half_turn(builder, *_reduced(builder, x, 2))


def cos(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the cosine, as a sine beside an odd multiple of pi/2; limits as of the sine."""
    return _half_turn(builder, *_reduced(builder, x, 2, offset=0.5))


def _half_turn(builder: SequenceBuilder, word: Temporary, r: Operand) -> Temporary:
    """Give the sine of r up to pi/2, turned if the bit 0 of a word says so."""
    z = builder.product(r, r)
    factor = builder.product(builder.polynomial(coefficients(builder.fmt).sine, z), z)
    signed = builder.scaled(1.0, r, sign=Sign.BIT_0, sign_of=word)
    return builder.grown(signed, factor)


def sincos(builder: SequenceBuilder, x: Temporary) -> tuple[Temporary, Temporary]:
    """Give sine and cosine; limits as of the sine."""
    table = coefficients(builder.fmt)
    word, r = _reduced(builder, x, 1)
    z = builder.product(r, r)
    sine = _odd(builder, r, z, table.quarter_sine)
    cosine = builder.product_plus(1.0, builder.polynomial(table.quarter_cosine, z), z)
    # By odd numbers of quarter turns they change places, and the sine its sign.
    kept = builder.copied(cosine)
    builder.copied(sine, negate=True, condition=Condition.ODD, where=word, into=cosine)
    builder.copied(kept, condition=Condition.ODD, where=word, into=sine)
    return (
        builder.scaled(1.0, sine, sign=Sign.BIT_1, sign_of=word),
        builder.scaled(1.0, cosine, sign=Sign.BIT_1, sign_of=word),
    )


def tan(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the tangent; limits as of the sine."""
    word, r = _reduced(builder, x, 1)
    z = builder.product(r, r)
    result = _odd(builder, r, z, coefficients(builder.fmt).tangent)
    turned = reciprocal(builder, result, negate=True)
    return builder.copied(turned, condition=Condition.ODD, where=word, into=result)
