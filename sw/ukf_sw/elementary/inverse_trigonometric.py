"""Arcsine, arccosine and arctangents."""

from math import pi

from ukf_sw.elementary.coefficients import coefficients
from ukf_sw.elementary.quotients import larger_and_smaller, ratio, reciprocal
from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.spec.forms import Addend, Condition, Root, Sign
from ukf_sw.spec.model_programs import Temporary

__all__ = ["arccos", "arcsin", "arctan", "arctan2"]


def _arcsine(builder: SequenceBuilder, x: Temporary) -> tuple[Temporary, Temporary]:
    """Give an angle, and a word that is negative where the angle is beside pi/2.

    Up to 1/2 the angle is the arcsine. Beyond, it is ``-2 * arcsin(sqrt(w))`` with the sign of x,
    where ``w = (1 - abs(x)) / 2``, so its sign is the other one than that of x.
    """
    w = builder.complement(0.5, x)
    root = builder.product(w, builder.root(w, Root.PLAIN))
    large = builder.shifted(w, 0.25, subtract=True)
    r = builder.scaled(2.0, root, sign=Sign.COPY, sign_of=x, subtract=True)
    builder.copied(x, condition=Condition.NOT_NEGATIVE, where=large, into=r)
    z = builder.product(x, x)
    builder.copied(w, condition=Condition.NEGATIVE, where=large, into=z)
    polynomial = builder.polynomial(coefficients(builder.fmt).arcsine, z)
    # Plus zero, where z is: minus zero would lose the sign of r.
    return builder.grown(r, builder.product(polynomial, z, addend=Addend.PLUS_ZERO)), large


def arcsin(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the arcsine; NaN beyond 1."""
    angle, large = _arcsine(builder, x)
    return builder.shifted(
        angle, pi / 2, sign=Sign.COPY, subtract=True,
        condition=Condition.NEGATIVE, where=large, into=angle,
    )  # fmt: skip


def arccos(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the arccosine; NaN beyond 1."""
    angle, large = _arcsine(builder, x)
    result = builder.copied(angle, negate=True)
    builder.reflected(pi, angle, condition=Condition.NEGATIVE, where=x, into=result)
    return builder.reflected(
        pi / 2, angle, condition=Condition.NOT_NEGATIVE, where=large, into=result
    )


def _arctangent(builder: SequenceBuilder, r: Temporary) -> Temporary:
    """Give the arctangent of numbers up to 1."""
    z = builder.product(r, r)
    polynomial = builder.polynomial(coefficients(builder.fmt).arctangent, z)
    return builder.grown(r, builder.product(polynomial, z, addend=Addend.PLUS_ZERO))


def arctan(builder: SequenceBuilder, x: Temporary) -> Temporary:
    """Give the arctangent; limits as of the reciprocal."""
    r = reciprocal(builder, x, negate=True)
    small = builder.complement(1.0, x)
    builder.copied(x, condition=Condition.NOT_NEGATIVE, where=small, into=r)
    angle = _arctangent(builder, r)
    return builder.shifted(
        angle, pi / 2, sign=Sign.COPY, subtract=True,
        condition=Condition.NEGATIVE, where=small, into=angle,
    )  # fmt: skip


def arctan2(builder: SequenceBuilder, y: Temporary, x: Temporary) -> Temporary:
    """Give the angle of (x, y), with the signs of zeros as usual; NaN if both are infinite."""
    larger, smaller, steeper = larger_and_smaller(builder, x, y)
    angle = _arctangent(builder, ratio(builder, smaller, larger))
    builder.reflected(pi / 2, angle, condition=Condition.NEGATIVE, where=steeper, into=angle)
    builder.reflected(pi, angle, condition=Condition.NEGATIVE, where=x, into=angle)
    return builder.scaled(1.0, angle, sign=Sign.COPY, sign_of=y)
