"""Signs, choices, comparisons and rounding to integers.

A mask is a word that is true where it is negative. Minus zero is negative and NaN is not, so a
mask may be anything. Comparisons are right for all numbers, also for zeros and for numbers whose
difference is flushed; but an infinity compares with itself as NaN does, because the difference is.
"""

from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.spec.forms import Condition, Sign
from ukf_sw.spec.model_programs import Constant, Operand, Temporary

__all__ = [
    "absolute",
    "ceil",
    "clip",
    "copysign",
    "equal",
    "floor",
    "greater",
    "greater_equal",
    "less",
    "less_equal",
    "logical_and",
    "logical_not",
    "logical_or",
    "maximum",
    "minimum",
    "not_equal",
    "rint",
    "sign",
    "where",
]


def absolute(builder: SequenceBuilder, x: Operand) -> Temporary:
    """Give the magnitude."""
    return builder.scaled(1.0, x, sign=Sign.CLEAR)


def copysign(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the magnitude of x with the sign of y; that of NaN is plus."""
    return builder.scaled(1.0, x, sign=Sign.COPY, sign_of=y)


def sign(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give -1, a zero or 1; NaN of NaN."""
    # No number but zero is below 1 after that.
    result = builder.scaled(1.0 / builder.fmt.min_normal, x)
    beyond = builder.complement(1.0, result)
    return builder.signed_one(1.0, x, condition=Condition.NEGATIVE, where=beyond, into=result)


def where(builder: SequenceBuilder, mask: Operand, x: Operand, y: Operand) -> Temporary:
    """Give x where a mask is true, else y."""
    result = builder.copied(y)
    return builder.copied(x, condition=Condition.NEGATIVE, where=mask, into=result)


def _difference(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give a word that is negative where x < y.

    A difference that is flushed has the right sign. Only ``-0 - 0`` would be negative, so minus
    zero is not let in.
    """
    if isinstance(y, Constant):
        # Minus zero as what to compare with does the same for nothing.
        return builder.shifted(x, y.value or -0.0, subtract=True)
    if isinstance(x, Constant):
        return builder.reflected(x.value or 0.0, y)
    return builder.sum(builder.sum(x, 0.0), y, subtract=True)


def less(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the mask of x < y."""
    return _difference(builder, x, y)


def greater(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the mask of x > y."""
    return _difference(builder, y, x)


def less_equal(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the mask of x <= y: that of x > y turned, but false where there is a NaN."""
    return builder.copied(_difference(builder, y, x), negate=True)


def greater_equal(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the mask of x >= y."""
    return less_equal(builder, y, x)


def equal(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the mask of x == y."""
    result = less_equal(builder, x, y)
    below = less(builder, x, y)
    return builder.copied(
        below, negate=True, condition=Condition.NEGATIVE, where=result, into=result
    )


def not_equal(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the mask of x != y; true where there is a NaN."""
    return logical_not(builder, equal(builder, x, y))


def logical_not(builder: SequenceBuilder, mask: Operand) -> Temporary:
    """Give the mask that is true where one is not: -1 or 1."""
    return builder.signed_one(1.0, mask, negate=True)


def logical_and(builder: SequenceBuilder, first: Operand, second: Operand) -> Temporary:
    """Give the mask that is true where both are."""
    result = builder.copied(first)
    return builder.copied(second, condition=Condition.NEGATIVE, where=first, into=result)


def logical_or(builder: SequenceBuilder, first: Operand, second: Operand) -> Temporary:
    """Give the mask that is true where one or both are."""
    result = builder.copied(first)
    return builder.copied(second, condition=Condition.NOT_NEGATIVE, where=first, into=result)


def _beside_constant(
    builder: SequenceBuilder, x: Temporary, limit: Constant, *, larger: bool
) -> Temporary:
    """Move x to a limit, where it is beyond. NaN stays: a difference with it is not negative."""
    if larger:
        beyond = builder.shifted(x, limit.value, subtract=True)
    else:
        beyond = builder.reflected(limit.value, x)
    return builder.copied(limit, condition=Condition.NEGATIVE, where=beyond, into=x)


def _extreme(builder: SequenceBuilder, x: Operand, y: Operand, *, larger: bool) -> Temporary:
    for value, limit in ((x, y), (y, x)):
        if isinstance(limit, Constant):
            return _beside_constant(builder, builder.copied(value), limit, larger=larger)
    # The sum is NaN where there is one, and right where both are the same infinity.
    result = builder.sum(x, y)
    below = builder.sum(x, y, subtract=True)
    above = builder.copied(below, negate=True)
    first, second = (y, x) if larger else (x, y)
    builder.copied(first, condition=Condition.NEGATIVE, where=below, into=result)
    return builder.copied(second, condition=Condition.NEGATIVE, where=above, into=result)


def maximum(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the larger one; NaN if one is."""
    return _extreme(builder, x, y, larger=True)


def minimum(builder: SequenceBuilder, x: Operand, y: Operand) -> Temporary:
    """Give the smaller one; NaN if one is."""
    return _extreme(builder, x, y, larger=False)


def clip(builder: SequenceBuilder, x: Operand, low: Operand, high: Operand) -> Temporary:
    """Give x, but not below one and then not above another limit; NaN if one of them is."""
    result = maximum(builder, x, low)
    if isinstance(high, Constant):
        return _beside_constant(builder, result, high, larger=False)
    return minimum(builder, result, high)


def rint(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the nearest integer, the even one of two, with the sign of x; all of the range."""
    return _with_large(builder, x, _nearest(builder, x))


def _nearest(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Round what is below 2**F, beyond which numbers are integers."""
    whole = 2.0**builder.fmt.fraction_bits
    rounded = builder.scaled(1.0, x, plus=whole, sign=Sign.CLEAR)
    magnitude = builder.shifted(rounded, whole, subtract=True)
    return builder.scaled(1.0, magnitude, sign=Sign.COPY, sign_of=x)


def _with_large(builder: SequenceBuilder, x: Temporary, result: Temporary) -> Temporary:
    """Take what is an integer anyway, and NaN, as it is."""
    whole = 2.0**builder.fmt.fraction_bits
    beyond = builder.scaled(1.0, x, plus=-whole, sign=Sign.CLEAR)
    return builder.copied(x, condition=Condition.NOT_NEGATIVE, where=beyond, into=result)


def floor(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the largest integer that is not above; all of the range."""
    result = _nearest(builder, x)
    rest = builder.sum(x, result, subtract=True)
    builder.shifted(
        result, 1.0, subtract=True, condition=Condition.NEGATIVE, where=rest, into=result
    )
    return _with_large(builder, x, result)


def ceil(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the smallest integer that is not below; all of the range. Zeros may have either sign."""
    result = _nearest(builder, x)
    rest = builder.sum(result, x, subtract=True)
    builder.shifted(result, 1.0, condition=Condition.NEGATIVE, where=rest, into=result)
    return _with_large(builder, x, result)
