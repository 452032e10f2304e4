"""Quotients and roots."""

from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.spec.forms import Condition, Root, Sign
from ukf_sw.spec.model_programs import Operand, Temporary

__all__ = ["divide", "hypot", "integer_power", "larger_and_smaller", "ratio", "reciprocal", "sqrt"]


def reciprocal(builder: SequenceBuilder, x: Temporary, *, negate: bool = False) -> Temporary:
    """Give 1/x or -1/x: infinite for zero, with its sign; NaN from a quarter of the largest on.

    A root squared, and a step of Newton's, which is NaN for zeros and infinities and then left out.
    """
    root = builder.root(x, Root.SIGNED)
    result = builder.product(root, root, sign=Sign.CLEAR, negate=negate)
    rest = builder.product_plus(1.0, x, result, subtract=not negate)
    return builder.grown(result, rest, condition=Condition.FINITE, into=result)


def divide(builder: SequenceBuilder, a: Operand | float, x: Temporary) -> Temporary:
    """Give a/x, with the limits of the reciprocal; NaN for 0/0 and for infinity over infinity."""
    return builder.product(a, reciprocal(builder, x))


def sqrt(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the square root: a zero for itself, NaN for negative numbers and for infinity."""
    return builder.product(x, builder.root(x, Root.PLAIN))


def larger_and_smaller(
    builder: SequenceBuilder, x: Temporary, y: Temporary
) -> tuple[Temporary, Temporary, Temporary]:
    """Give the larger and the smaller magnitude, and a word that is negative if |y| is larger."""
    larger = builder.scaled(1.0, x, sign=Sign.CLEAR)
    steeper = builder.scaled(1.0, y, plus=larger, sign=Sign.CLEAR, subtract=True)
    smaller = builder.scaled(1.0, y, sign=Sign.CLEAR)
    builder.copied(larger, into=smaller, condition=Condition.NEGATIVE, where=steeper)
    builder.copied(y, sign=Sign.COPY, into=larger, condition=Condition.NEGATIVE, where=steeper)
    return larger, smaller, steeper


def ratio(builder: SequenceBuilder, smaller: Temporary, larger: Temporary) -> Temporary:
    """Give smaller/larger of magnitudes: all of the range, and 0/0 is 0; inf/inf is NaN."""
    root = builder.root(larger, Root.PLAIN)
    rest = builder.product_plus(1.0, builder.product(larger, root), root, subtract=True)
    result = builder.product(builder.product(smaller, root), root)
    return builder.grown(result, rest, condition=Condition.FINITE, into=result)


def hypot(builder: SequenceBuilder, x: Temporary, y: Temporary) -> Temporary:
    """Give sqrt(x*x + y*y), without intermediate overflow; NaN if both are infinite."""
    larger, smaller, _ = larger_and_smaller(builder, x, y)
    slope = ratio(builder, smaller, larger)
    root = sqrt(builder, builder.product_plus(1.0, slope, slope))
    return builder.product(larger, root)


def integer_power(builder: SequenceBuilder, x: Temporary, exponent: int) -> Temporary:
    """Give x to a positive integer, as products.

    Raises
    ------
    ValueError
        If it is not positive.
    """
    if exponent < 1:
        raise ValueError(f"exponent must be positive, not {exponent!r}")
    result: Temporary | None = None
    square = x
    while True:
        if exponent & 1:
            result = square if result is None else builder.product(result, square)
        exponent >>= 1
        if not exponent:
            return result or square
        square = builder.product(square, square)
