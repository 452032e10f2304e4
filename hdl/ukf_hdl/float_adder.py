"""Floating-point adder."""

from amaranth import Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ukf_hdl.leading_zeros import normalisation_digits, shift_left_digit
from ukf_hdl.pipelining import Pipeline
from ukf_sw.float_format import FloatFormat

__all__ = ["FloatAdder"]

# Where registers stand, for each number of stages.
_CUTS = {
    1: (),
    2: ("aligned",),
    3: ("aligned", "leading_zeros"),
    4: ("aligned", "summed", "normalised"),
    5: ("aligned", "summed", "leading_zeros", "normalised"),
    6: ("ordered", "aligned", "summed", "leading_zeros", "normalised"),
}
_MAX_STAGES = 16


class FloatAdder(wiring.Component):
    """Floating-point adder, one sum per clock.

    Gives the sum of :py:`a` and :py:`b`, rounded to nearest with ties to even, on :py:`sum`,
    :py:`stages` clocks after them; equal to :func:`ukf_sw.arithmetic.add`. There is no handshake:
    a pair is taken on every clock. The sum does not depend on :py:`stages`.

    Subnormal operands read as zeros of their sign, and a sum that would be subnormal is a zero of
    its sign. :py:`x + -x` is plus zero and :py:`-0 + -0` is minus zero. Overflow gives infinity.
    A NaN operand, and infinities of opposite signs, give the NaN of the format.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    stages : :class:`int`
        Latency in clocks, 1 to 16. From 7 on, additional registers only delay the sum.

    Members
    -------
    a : :py:`In(fmt.width)`
        First operand.
    b : :py:`In(fmt.width)`
        Second operand.
    sum : :py:`Out(fmt.width)`
        Sum.

    Attributes
    ----------
    DEFAULT_STAGES : :class:`int`
        Fewest stages that support 100 MHz on a 7-series FPGA in the binary32 format.

    Raises
    ------
    TypeError
        If :py:`fmt` is not a :class:`FloatFormat`.
    ValueError
        If :py:`stages` is not an integer in range.
    """

    DEFAULT_STAGES = 3

    def __init__(self, fmt, *, stages=DEFAULT_STAGES):
        if not isinstance(fmt, FloatFormat):
            raise TypeError(f"Format must be a FloatFormat, not {fmt!r}")
        if stages not in range(1, _MAX_STAGES + 1):
            raise ValueError(f"Stages must be between 1 and {_MAX_STAGES}, not {stages!r}")
        self._fmt = fmt
        self._stages = stages

        super().__init__({
            "a": In(fmt.width),
            "b": In(fmt.width),
            "sum": Out(fmt.width),
        })  # fmt: skip

    @property
    def fmt(self):
        """Format given to the constructor."""
        return self._fmt

    @property
    def stages(self):
        """Latency given to the constructor."""
        return self._stages

    def elaborate(self, platform):
        m = Module()
        pipeline = Pipeline(m, self._stages, _CUTS)

        ordered = pipeline.cut("ordered", *self._elaborate_order(m))
        aligned = pipeline.cut("aligned", *self._elaborate_alignment(m, *ordered))
        summed = pipeline.cut("summed", *self._elaborate_sum(m, *aligned))
        counted = pipeline.cut("leading_zeros", *self._elaborate_leading_zeros(m, *summed))
        normalised = pipeline.cut("normalised", *self._elaborate_normalisation(m, *counted))
        pipeline.output(self.sum, self._elaborate_rounding(m, *normalised))

        return m

    def _elaborate_order(self, m):
        """Find the larger operand.

        The operand to be shifted is selected by the exponents alone, which are quick to compare.
        Where they are equal nothing is shifted, and a comparison of the fractions that comes late
        can still swap the two (`swap`).
        """
        fmt = self._fmt
        fraction_bits, exponent_bits = fmt.fraction_bits, fmt.exponent_bits
        fraction_a, fraction_b = self.a[:fraction_bits], self.b[:fraction_bits]
        exponent_a, exponent_b = self.a[fraction_bits:-1], self.b[fraction_bits:-1]

        difference = Signal(exponent_bits + 1)
        opposite = Signal(exponent_bits)
        exponent_less = Signal()
        swap = Signal()
        m.d.comb += [
            difference.eq(exponent_a - exponent_b),
            opposite.eq(exponent_b - exponent_a),
            exponent_less.eq(difference[-1]),
            swap.eq((exponent_a == exponent_b) & (fraction_a < fraction_b)),
        ]

        shift = Signal(exponent_bits)
        small_is_zero = Signal()
        small = Signal(fmt.precision)
        m.d.comb += [
            shift.eq(Mux(exponent_less, opposite, difference)),
            small_is_zero.eq((exponent_a == 0) | (exponent_b == 0)),
            small.eq(
                Mux(
                    small_is_zero,
                    0,
                    Cat(Mux(exponent_less, fraction_a, fraction_b), 1),
                )
            ),
        ]

        large_is_b = Signal()
        large = Signal(fraction_bits)
        exponent = Signal(exponent_bits)
        m.d.comb += [
            large_is_b.eq(exponent_less | swap),
            large.eq(Mux(large_is_b, fraction_b, fraction_a)),
            exponent.eq(Mux(exponent_less, exponent_b, exponent_a)),
        ]

        sign = Signal()
        subtract = Signal()
        zero_sign = Signal()
        infinities = Signal()
        m.d.comb += [
            sign.eq(Mux(large_is_b, self.b[-1], self.a[-1])),
            subtract.eq(self.a[-1] ^ self.b[-1]),
            zero_sign.eq(self.a[-1] & self.b[-1]),
            infinities.eq(exponent_a.all() & exponent_b.all()),
        ]
        return (
            fraction_a,
            swap,
            small,
            shift,
            large,
            exponent,
            sign,
            subtract,
            zero_sign,
            infinities,
        )

    def _elaborate_alignment(
        self, m, fraction_a, swap, small, shift, large, exponent, sign, subtract, zero_sign,
        infinities,
    ):  # fmt: skip
        """Shift the smaller operand to the right, with guard, round and sticky bits."""
        width = small.shape().width + 2
        value = Signal(width, name="small_extended")
        m.d.comb += value.eq(Cat(Const(0, 2), small))

        # Two bits of the distance at a time: a multiplexer of four fills a LUT.
        sticky = Const(0, 1)
        position = 0
        while (1 << position) < width:
            digit = shift[position : position + 2]
            step = 1 << position
            last = step << len(digit) >= width
            shifted = Signal(width, name=f"shifted_{step}")
            lost = Signal(name=f"lost_{step}")
            options = [value >> (step * count) for count in range(1 << len(digit))]
            beyond = shift[position + len(digit) :].any() if last else Const(0, 1)
            with m.Switch(digit):
                for count, option in enumerate(options):
                    with m.Case(count):
                        m.d.comb += [
                            shifted.eq(option),
                            lost.eq(value[: step * count].any()),
                        ]
            if last:
                with m.If(beyond):
                    m.d.comb += [shifted.eq(0), lost.eq(value.any())]
            sticky = sticky | lost
            value = shifted
            position += 2

        aligned = Signal(width + 1)
        m.d.comb += aligned.eq(Cat(sticky, value))
        with m.If(swap):
            # The exponents are equal: nothing was shifted.
            m.d.comb += aligned.eq(Cat(Const(0, 3), fraction_a, 1))
        return aligned, large, exponent, sign, subtract, zero_sign, infinities

    def _elaborate_sum(self, m, aligned, large, exponent, sign, subtract, zero_sign, infinities):
        """Add or subtract; the difference is never negative. Decide on special results."""
        width = len(aligned) + 1
        total = Signal(width)
        first = Cat(Const(0, 3), large, Const(1, 2))
        second = Mux(subtract, ~aligned, aligned)
        # A carry into the lowest place, as an additional place below it.
        wide = Signal(width + 1)
        m.d.comb += [
            wide.eq(Cat(subtract, first) + Cat(subtract, second, subtract)),
            total.eq(wide[1:]),
        ]

        both_zero = Signal()
        nan = Signal()
        infinite = Signal()
        m.d.comb += [
            both_zero.eq(exponent == 0),
            infinite.eq(exponent.all()),
            # The larger operand is NaN if any is. If it is infinity, the smaller one is not NaN.
            nan.eq(infinite & (large.any() | (infinities & subtract))),
        ]
        return total, exponent, sign, zero_sign, both_zero, infinite, nan

    def _elaborate_leading_zeros(
        self, m, total, exponent, sign, zero_sign, both_zero, infinite, nan
    ):
        """Count leading zeros in steps of 4, and shift by multiples of 16."""
        sixteens, fours, is_zero = normalisation_digits(m, total)
        partly = shift_left_digit(m, total, sixteens, 16)

        zero = Signal()
        cleared_sign = Signal()
        overflow = Signal()
        m.d.comb += [
            zero.eq(~infinite & (both_zero | is_zero)),
            cleared_sign.eq(Mux(both_zero, zero_sign, sign & ~is_zero)),
            # Rounding that carries into the exponent clears the fraction by itself.
            overflow.eq(total[-1] & (exponent == self._fmt.max_exponent_field - 1)),
        ]
        # The exponent of infinity and NaN is forced, their sign is not cleared.
        final_sign = Signal()
        m.d.comb += final_sign.eq(~nan & Mux(infinite, sign, cleared_sign))
        return (
            partly, fours, Cat(fours, sixteens), exponent, final_sign, zero, infinite | overflow,
            nan,
        )  # fmt: skip

    def _elaborate_normalisation(
        self, m, partly, fours, coarse, exponent, sign, zero, infinite, nan
    ):
        """Shift the leading one to the top."""
        coarsely = shift_left_digit(m, partly, fours, 4)
        ones = Signal(2)
        with m.Switch(coarsely[-4:]):
            with m.Case("1---"):
                m.d.comb += ones.eq(0)
            with m.Case("01--"):
                m.d.comb += ones.eq(1)
            with m.Case("001-"):
                m.d.comb += ones.eq(2)
            with m.Default():
                m.d.comb += ones.eq(3)
        normalised = shift_left_digit(m, coarsely, ones, 1)

        # The top place of the sum is worth one more than the exponent.
        coarse_exponent = Signal(self._fmt.exponent_bits + 2)
        underflow = Signal()
        m.d.comb += [
            coarse_exponent.eq(exponent - Cat(Const(0, 2), coarse)),
            # At most 0 after `ones` is subtracted and 1 added. No rounding changes that: so small
            # a sum is exact.
            underflow.eq(
                coarse_exponent[-1] | ((coarse_exponent[2:] == 0) & (coarse_exponent[:2] < ones))
            ),
        ]
        return normalised, ones, coarse_exponent, sign, zero | underflow, infinite, nan

    def _elaborate_rounding(self, m, normalised, ones, coarse_exponent, sign, zero, infinite, nan):
        """Round, and finish the exponent in the same carry chain."""
        fmt = self._fmt
        low = len(normalised) - fmt.precision
        fraction = normalised[low:-1]
        guard = normalised[low - 1]
        sticky = normalised[: low - 1].any()
        round_up = Signal()
        exponent_step = Signal(fmt.exponent_bits)
        rounded = Signal(fmt.width)
        m.d.comb += [
            round_up.eq(guard & (sticky | fraction[0])),
            # 1 - ones
            exponent_step.eq(Cat(~ones[0], (ones == 2) | (ones == 3), *[ones[1]] * 62)),
            rounded.eq(
                Cat(Const(1, 1), fraction, coarse_exponent[: fmt.exponent_bits])
                + Cat(round_up, Const(0, fmt.fraction_bits), exponent_step)
            ),
        ]

        result = Signal(fmt.width)
        m.d.comb += result.eq(Cat(rounded[1 : fmt.width], sign))
        with m.If(nan):
            m.d.comb += result.eq(fmt.nan)
        with m.Elif(infinite):
            m.d.comb += result[:-1].eq(fmt.infinity)
        with m.Elif(zero):
            m.d.comb += result[:-1].eq(0)
        return result
