"""How a floating-point number lies in its word, and what a unit knows of a result on the way."""

from amaranth import Cat, Const
from amaranth.lib import data

__all__ = ["SPECIAL", "FloatLayout", "FloatView"]

#: Sign of a result, and what takes the place of its number: NaN, which has no sign, wins over
#: infinity, and that over zero.
SPECIAL = data.StructLayout({"sign": 1, "zero": 1, "infinite": 1, "nan": 1})


class FloatLayout(data.StructLayout):
    """Layout of a number of a format.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.

    Members
    -------
    fraction : :py:`fmt.fraction_bits`
        Significand without its leading one.
    exponent : :py:`fmt.exponent_bits`
        Exponent with its bias.
    sign : :py:`1`
        High for a negative number.
    """

    def __init__(self, fmt):
        super().__init__({
            "fraction": fmt.fraction_bits,
            "exponent": fmt.exponent_bits,
            "sign":     1,
        })  # fmt: skip

    def __call__(self, target):
        """View a word as a number."""
        return FloatView(self, target)


class FloatView(data.View):
    """A word as a number of a :class:`FloatLayout`."""

    @property
    def magnitude(self):
        """The number without its sign."""
        return self.as_value()[:-1]

    @property
    def significand(self):
        """Fraction and leading one, as long as the number is not zero."""
        return Cat(self.fraction, Const(1, 1))

    @property
    def is_zero(self):
        """Whether it is zero; subnormal numbers count as zero."""
        return self.exponent == 0

    @property
    def is_finite(self):
        """Whether it is neither infinity nor NaN."""
        return ~self.exponent.all()

    @property
    def is_nan(self):
        """Whether it is NaN."""
        return self.exponent.all() & self.fraction.any()
