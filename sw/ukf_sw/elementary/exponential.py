"""Exponential, logarithm, powers and hyperbolic tangent."""

from math import e, log2

from ukf_sw.elementary.coefficients import coefficients
from ukf_sw.elementary.primitives import is_narrow
from ukf_sw.elementary.quotients import divide, integer_power, reciprocal, sqrt
from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.forms import Addend, Condition, Reading, Sign, exponent_step
from ukf_sw.spec.model_programs import Constant, Operand, Temporary

__all__ = ["exp", "log", "power", "tanh"]


#: Beyond, products would take more slots than logarithm and exponential.
_LARGEST_PRODUCT = 1024


def _middle(fmt: FloatFormat) -> float:
    """Give the number from which powers and exponents are counted.

    Raises
    ------
    ValueError
        If a fraction is too short to count exponents.
    """
    if exponent_step(fmt) > 2:
        raise ValueError(
            f"fraction bits of a format with exp, log or power must be at least its exponent bits "
            f"- 1, not {fmt.name!r}"
        )
    return 1.5 * 2.0**fmt.fraction_bits


def exp(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the exponential, everywhere.

    It overflows to infinity; results below the square root of two times the smallest normal number
    are zero.
    """
    fmt, table = builder.fmt, coefficients(builder.fmt)
    step = exponent_step(fmt)
    # Where a power of two is as large as the format goes, it is half of what it should be.
    middle = _middle(fmt) - 2 // step
    word = builder.scaled(log2(e) / step, x, plus=middle)
    k = builder.shifted(word, middle, subtract=True)
    r: Operand = x
    for part in table.ln_2:
        r = builder.scaled(part, k, plus=r, subtract=True)
    factor = builder.polynomial(table.exponential, r)
    # The power of two alone, which is right where the product is not finite: it may overflow, and
    # far from zero the polynomial means nothing.
    if step == 1:
        result = builder.scaled(2.0, word, reading=Reading.POWER)
        return builder.product(
            factor, word, reading=Reading.POWER, addend=Addend.PLUS_ZERO,
            condition=Condition.FINITE, into=result,
        )  # fmt: skip
    power = builder.scaled(1.0, word, reading=Reading.POWER)
    result = builder.product(power, power)
    return builder.product(
        builder.product(factor, power), power, addend=Addend.PLUS_ZERO,
        condition=Condition.FINITE, into=result,
    )  # fmt: skip


def log(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the natural logarithm: minus infinity of zeros, NaN of negative numbers.

    If the step of exponents is 1, NaN also beyond the largest number divided by the square root
    of two.
    """
    fmt, table = builder.fmt, coefficients(builder.fmt)
    step, middle = exponent_step(fmt), _middle(fmt)
    scaled = builder.scaled(2.0**0.5, x) if step == 1 else x
    k = builder.scaled(1.0, scaled, plus=1.0 - middle, reading=Reading.EXPONENT)
    word = builder.reflected(middle, k)
    significand = x
    for _ in range(step):
        significand = builder.product(significand, word, reading=Reading.POWER)
    f = builder.scaled(0.5**step, significand, plus=-1.0)
    polynomial = builder.polynomial(table.logarithm, f)
    if is_narrow(fmt):  # f * f would be flushed
        result = builder.product(f, builder.product_plus(1.0, f, polynomial))
    else:
        result = builder.grown(f, builder.product(f, polynomial))
    high, *low = table.ln_2
    result = builder.scaled(sum(low), k, plus=result)
    # What is infinite there is already what is to come out.
    return builder.scaled(high, k, plus=result, condition=Condition.FINITE, into=k)


def power(builder: SequenceBuilder, x: Temporary, exponent: Operand | float) -> Operand:
    """Give x to a power.

    A constant integer is products, also of negative x; a half of an odd integer is products and a
    square root. Other powers are ``exp(exponent * log(x))``, NaN of negative x.
    """
    if isinstance(exponent, Temporary):
        return exp(builder, builder.product(exponent, log(builder, x)))
    value = float(exponent.value if isinstance(exponent, Constant) else exponent)
    if abs(value) <= _LARGEST_PRODUCT and (2.0 * value).is_integer():
        return _product(builder, x, value)
    return exp(builder, builder.scaled(value, log(builder, x)))


def _product(builder: SequenceBuilder, x: Temporary, exponent: float) -> Operand:
    """Give x to an integer or half of an odd one."""
    whole = int(abs(exponent))
    factors = [integer_power(builder, x, whole)] if whole else []
    if whole != abs(exponent):
        factors.append(sqrt(builder, x))
    if not factors:
        return builder.constant(1.0)
    result = factors[0] if len(factors) == 1 else builder.product(*factors)
    return reciprocal(builder, result) if exponent < 0.0 else result


def tanh(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the hyperbolic tangent, everywhere.

    With tanh(x / 2) = a / (2 * b) it is ``a * b / (b * b + a * a / 4)``.
    """
    table = coefficients(builder.fmt)
    z = builder.product(x, x)
    a = builder.product(builder.polynomial(table.tanh_dividend, z), x)
    b = builder.polynomial(table.tanh_divisor, z)
    divisor = builder.scaled(0.25, builder.product(a, a), plus=builder.product(b, b))
    result = divide(builder, builder.product(a, b), divisor)
    beyond = builder.scaled(1.0, x, plus=table.tanh_limit, sign=Sign.CLEAR, subtract=True)
    return builder.signed_one(1.0, x, condition=Condition.NEGATIVE, where=beyond, into=result)
