"""Reciprocal square root as a fixed-point recipe, derived from a number format.

A positive normal number is written as ``r * 4**q`` with ``1 <= r < 4``; then
``1/sqrt(x) = 2**-q / sqrt(r)`` and ``1/sqrt(r)`` lies between one half and one. Where in its
interval ``r`` lies is known from the parity of the exponent and the significand ``m``:

- A table holds a polynomial of degree 1 or 2 for each of ``2**index_bits`` equal intervals of ``m``
  and each parity. With ``d`` the distance of ``m`` from the middle of its interval, it is
  ``c0 + d * (c1 + d * c2)``. Only ``c1`` is negative.
- Formats with a long fraction take the polynomial as a seed ``y`` and add one step of Newton's
  iteration, ``y + y * (1 - r * y * y) / 2``.

Every step is an integer operation; what is dropped is dropped by an arithmetic shift (floor). The
half unit that rounds the result to nearest is part of ``c0``.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

from ukf_sw.spec.float_format import FloatFormat

__all__ = ["ReciprocalSqrtParams"]

# Error of the best polynomial on an interval of width h is at most this times h**(degree + 1).
_LINEAR_ERROR = Fraction(3, 64)
_QUADRATIC_ERROR = Fraction(15, 1536)
# Share of the error budget 2**-accuracy_bits that goes to the polynomial; rounded coefficients and
# dropped bits get the rest.
_POLYNOMIAL_SHARE = Fraction(32, 100)
# Beyond these the table would outgrow LUTs (linear) or one RAMB18 (quadratic).
_LINEAR_MAX_INDEX_BITS = 6
_QUADRATIC_MAX_INDEX_BITS = 8
# Fraction bits of the exact roots.
_ROOT_BITS = 80


@dataclass(frozen=True, kw_only=True)
class ReciprocalSqrtParams:
    """Reciprocal square root in a number format.

    Widths and tables follow from the format alone. :meth:`compute` is the bit-exact model.

    Parameters
    ----------
    fmt
        Number format.

    Raises
    ------
    TypeError
        If the format is not a :class:`FloatFormat`.
    """

    fmt: FloatFormat

    def __post_init__(self) -> None:
        if not isinstance(self.fmt, FloatFormat):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise TypeError(f"Format must be a FloatFormat, not {self.fmt!r}")

    @cached_property
    def newton(self) -> bool:
        """Whether a Newton step follows the polynomial."""
        return _index_bits(2, self.fmt.fraction_bits + 2) > _QUADRATIC_MAX_INDEX_BITS

    @cached_property
    def accuracy_bits(self) -> int:
        """The polynomial errs by less than two to the minus this."""
        fraction_bits = self.fmt.fraction_bits
        return (fraction_bits + 1) // 2 + 3 if self.newton else fraction_bits + 2

    @cached_property
    def degree(self) -> int:
        """Degree of the polynomial: 1 or 2."""
        return 1 if _index_bits(1, self.accuracy_bits) <= _LINEAR_MAX_INDEX_BITS else 2

    @cached_property
    def index_bits(self) -> int:
        """Leading fraction bits that select an interval."""
        return _index_bits(self.degree, self.accuracy_bits)

    @cached_property
    def distance_fraction_bits(self) -> int:
        """Fraction bits of the distance ``d``."""
        return min(self.fmt.fraction_bits, self.accuracy_bits + 3)

    @property
    def distance_bits(self) -> int:
        """Width of the distance ``d``, a signed number."""
        return self.distance_fraction_bits - self.index_bits

    @property
    def c0_fraction_bits(self) -> int:
        """Fraction bits of the constant coefficient."""
        return self.accuracy_bits + (2 if self.newton else 1)

    @property
    def c1_fraction_bits(self) -> int:
        """Fraction bits of the linear coefficient."""
        return self.accuracy_bits - self.index_bits

    @property
    def c2_fraction_bits(self) -> int:
        """Fraction bits of the quadratic coefficient."""
        return self.accuracy_bits - 2 * self.index_bits - 1

    @property
    def slope_fraction_bits(self) -> int:
        """Fraction bits of ``c1 + d * c2``."""
        return self.c1_fraction_bits + (6 if self.degree == 2 else 0)

    @property
    def root_fraction_bits(self) -> int:
        """Fraction bits of what the polynomial gives."""
        return self.accuracy_bits + 1 if self.newton else self.fmt.fraction_bits + 1

    @property
    def residual_bits(self) -> int:
        """Width of the residual ``1 - r * y * y``, a signed number."""
        return self.product_fraction_bits - self.accuracy_bits + 4

    @property
    def product_fraction_bits(self) -> int:
        """Fraction bits of ``r * y``, and of the residual ``1 - r * y * y``."""
        return self.fmt.fraction_bits + 6

    @cached_property
    def table(self) -> tuple[tuple[int, int, int], ...]:
        """Coefficients ``(c0, c1, c2)`` as integers; ``c2`` is 0 where the degree is 1.

        The index is the parity (1 for an odd exponent) followed by the leading fraction bits.
        """
        intervals = 1 << self.index_bits
        return tuple(
            self._fit(odd, Fraction(2 * interval + 1, 2 * intervals) + 1)
            for odd in (0, 1)
            for interval in range(intervals)
        )

    def _fit(self, odd: int, middle: Fraction) -> tuple[int, int, int]:
        """Coefficients for the interval around a significand."""
        half_width = Fraction(1, 2 << self.index_bits)

        def exact(position: Fraction) -> Fraction:
            return _reciprocal_sqrt((middle + position * half_width) * (1 + odd))

        # Interpolation at the roots of the Chebyshev polynomial of degree 3 or 2. Only the constant
        # is fitted again after rounding the others; its residual is sampled over the interval.
        node = Fraction(866, 1000) if self.degree == 2 else Fraction(707, 1000)
        above, centre, below = exact(node), exact(Fraction(0)), exact(-node)
        slope = (above - below) / (2 * node * half_width)
        c1 = round(slope * (1 << self.c1_fraction_bits))
        c2 = 0
        if self.degree == 2:
            curvature = (above + below - 2 * centre) / (2 * (node * half_width) ** 2)
            c2 = round(curvature * (1 << self.c2_fraction_bits))

        # In integers: the distances, and so the residuals, have few bits after the point.
        step_bits = self.index_bits + 4
        line_bits = step_bits + self.c1_fraction_bits
        square_bits = 2 * step_bits + self.c2_fraction_bits
        bits = max(_ROOT_BITS, line_bits, square_bits)
        first = int(middle * (1 << step_bits))
        residuals: list[int] = []
        for step in range(-8, 9):
            root = _scaled_root(1 << step_bits, (first + step) * (1 + odd))
            line = step * c1 << (bits - line_bits)
            square = step * step * c2 << (bits - square_bits)
            residuals.append((root << (bits - _ROOT_BITS)) - line - square)
        constant = Fraction(max(residuals) + min(residuals), 2 << bits)
        rounding = 1 << (self.c0_fraction_bits - self.root_fraction_bits - 1)
        return round(constant * (1 << self.c0_fraction_bits)) + rounding, c1, c2

    def polynomial(self, odd: int, fraction: int) -> int:
        """Evaluate the polynomial.

        Parameters
        ----------
        odd
            Whether the exponent is odd.
        fraction
            Fraction of the significand.

        Returns
        -------
        int
            Approximate ``1/sqrt(r)`` with :attr:`root_fraction_bits` fraction bits.
        """
        fraction_bits = self.fmt.fraction_bits
        index = fraction >> (fraction_bits - self.index_bits)
        c0, c1, c2 = self.table[(odd << self.index_bits) | index]
        low = fraction >> (fraction_bits - self.distance_fraction_bits)
        low &= (1 << self.distance_bits) - 1
        distance = low - (1 << (self.distance_bits - 1))

        slope = c1
        if self.degree == 2:
            fine_bits = self.c2_fraction_bits + self.distance_fraction_bits
            fine = (c1 << (fine_bits - self.c1_fraction_bits)) + distance * c2
            slope = fine >> (fine_bits - self.slope_fraction_bits)
        scale_bits = self.slope_fraction_bits + self.distance_fraction_bits
        root = (c0 << (scale_bits - self.c0_fraction_bits)) + distance * slope
        return root >> (scale_bits - self.root_fraction_bits)

    def significand_root(self, odd: int, fraction: int) -> int:
        """Approximate ``1/sqrt(r)``.

        Parameters
        ----------
        odd
            Whether the exponent is odd.
        fraction
            Fraction of the significand.

        Returns
        -------
        int
            Root with as many fraction bits as a significand has bits. It is one, exactly, for
            ``r = 1`` and less for any other.
        """
        root = self.polynomial(odd, fraction)
        if not self.newton:
            return root
        fraction_bits = self.fmt.fraction_bits
        radicand = ((1 << fraction_bits) | fraction) << odd
        # r * y, then 1 - r * y * y, then y times half of that.
        product = radicand * root >> (self.root_fraction_bits - 6)
        residual = (1 << (self.product_fraction_bits + self.root_fraction_bits)) - product * root
        residual >>= self.root_fraction_bits
        drop = self.product_fraction_bits + self.root_fraction_bits + 1 - self.fmt.precision
        correction = (root * residual + (1 << (drop - 1))) >> drop
        return (root << (self.fmt.precision - self.root_fraction_bits)) + correction

    def compute(self, word: int) -> int:
        """Reciprocal square root of a word.

        Parameters
        ----------
        word
            Number in the format.

        Returns
        -------
        int
            ``1/sqrt`` of it, off by less than one unit in the last place. A zero or subnormal
            number of either sign, and infinity, give plus zero; a negative number and NaN give
            NaN.
        """
        fmt = self.fmt
        fraction = word & ((1 << fmt.fraction_bits) - 1)
        exponent = (word >> fmt.fraction_bits) & fmt.max_exponent_field
        if exponent == 0:
            return 0
        if word >> (fmt.width - 1) or (exponent == fmt.max_exponent_field and fraction):
            return fmt.nan
        if exponent == fmt.max_exponent_field:
            return 0
        # The bias is odd, so an even field is an odd exponent.
        odd = ~exponent & 1
        root = self.significand_root(odd, fraction)
        one = root >> fmt.precision
        half_exponent = (exponent - fmt.bias - odd) // 2
        result_exponent = fmt.bias - half_exponent - 1 + one
        return (result_exponent << fmt.fraction_bits) | (root & ((1 << fmt.fraction_bits) - 1))


def _index_bits(degree: int, accuracy_bits: int) -> int:
    """Fewest index bits for which a polynomial reaches an accuracy."""
    scale = _LINEAR_ERROR if degree == 1 else _QUADRATIC_ERROR
    bits = 0
    while scale / (1 << (bits * (degree + 1))) > _POLYNOMIAL_SHARE / (1 << accuracy_bits):
        bits += 1
    return bits


def _reciprocal_sqrt(value: Fraction) -> Fraction:
    """Reciprocal square root of a number between 1 and 4, to about 80 bits."""
    return Fraction(_scaled_root(value.denominator, value.numerator), 1 << _ROOT_BITS)


def _scaled_root(numerator: int, denominator: int) -> int:
    """Square root of a ratio in units of 2**-80."""
    return math.isqrt((numerator << (2 * _ROOT_BITS)) // denominator)
