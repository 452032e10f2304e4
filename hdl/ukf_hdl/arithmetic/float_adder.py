"""Floating-point adder."""

from amaranth import Cat, Const, Module, Mux, Signal

from ukf_hdl.arithmetic.float_unit import FloatUnit
from ukf_hdl.arithmetic.leading_zeros import (
    leading_units_digit,
    normalisation_digits,
    select,
    shift_left_digit,
)
from ukf_hdl.arithmetic.pipelining import CutPoints
from ukf_sw.spec.parameters import Pipeline

__all__ = ["FloatAdder"]

# Where registers stand, for each number of stages.
_CUTS = {
    3: ("aligned", "leading_zeros"),
    4: ("aligned", "summed", "normalised"),
    5: ("aligned", "summed", "leading_zeros", "normalised"),
    6: ("ordered", "aligned", "summed", "leading_zeros", "normalised"),
}
_TWO_PATH_CUTS = {
    1: (),
    2: ("aligned",),
}
_MAX_TWO_PATH_STAGES = max(_TWO_PATH_CUTS)


class FloatAdder(FloatUnit):
    """Floating-point adder, one sum per clock.

    Gives the sum of :py:`a` and :py:`b`, rounded to nearest with ties to even, on :py:`sum`,
    :py:`stages` clocks after them; equal to :func:`ukf_sw.engine.arithmetic.add`. There is no
    handshake: a pair is taken on every clock. The sum does not depend on :py:`stages`.

    Subnormal operands read as zeros of their sign, and a sum that would be subnormal is a zero of
    its sign. :py:`x + -x` is plus zero and :py:`-0 + -0` is minus zero. Overflow gives infinity.
    A NaN operand, and infinities of opposite signs, give the NaN of the format.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    stages : :class:`int`
        Latency in clocks, 1 to 16. Up to 2, two paths work side by side, which is larger by a
        quarter than the single path from 3 on. From 7 on, additional registers only delay the sum.

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
    """

    DEFAULT_STAGES = Pipeline.add

    def __init__(self, fmt, *, stages=DEFAULT_STAGES):
        super().__init__(fmt, stages, operands=("a", "b"), result="sum")

    def elaborate(self, platform):
        m = Module()
        if self._stages <= _MAX_TWO_PATH_STAGES:
            self._elaborate_two_paths(m)
        else:
            self._elaborate_single_path(m)
        return m

    def _elaborate_two_paths(self, m):
        """Add along the far and the near path, and select.

        The far path takes sums, and differences of operands whose exponents differ: what it gives
        moves by at most one place, but is rounded. The near path takes differences whose exponents
        differ by at most one and whose leading place is cancelled: they move by any number of
        places, but are exact.
        """
        pipeline = CutPoints(m, self._stages, _TWO_PATH_CUTS)
        order = self._elaborate_order(m)
        _, swap, _, shift, _, exponent, sign, subtract, zero_sign, infinities = order
        near, may_be_near = self._elaborate_near_difference(m, swap, shift, subtract)
        aligned, large, any_nan = self._elaborate_far_alignment(m, order)
        (
            aligned, near, may_be_near, swap, large, exponent, sign, subtract, zero_sign,
            infinities, any_nan,
        ) = pipeline.cut(
            "aligned", aligned, near, may_be_near, swap, large, exponent, sign, subtract, zero_sign,
            infinities, any_nan,
        )  # fmt: skip
        one_less = Signal(self._fmt.exponent_bits)
        m.d.comb += one_less.eq(exponent - 1)
        far, far_last = self._elaborate_far_sum(m, aligned, large, subtract)
        near_result = self._elaborate_near_normalisation(m, near, may_be_near, swap, one_less)
        pipeline.output(
            self.sum,
            self._elaborate_selection(
                m, far, far_last, near_result, exponent, one_less, sign, subtract, zero_sign,
                infinities, any_nan,
            ),
        )  # fmt: skip

    def _elaborate_near_difference(self, m, swap, shift, subtract):
        """Near path: subtract operands whose exponents differ by at most one.

        The difference of the exponents is known from two bits of each. Where it is zero, the
        difference of the operands may be negative; then one less than it is made, and complemented.
        """
        fraction_bits, precision = self._fmt.fraction_bits, self._fmt.precision
        exponent_a, exponent_b = self.a[fraction_bits:-1], self.b[fraction_bits:-1]
        full_a = Cat(self.a[:fraction_bits], Const(1, 1))
        full_b = Cat(self.b[:fraction_bits], Const(1, 1))
        near_difference = Signal(2)
        minuend = Signal(precision + 1)
        subtrahend = Signal(precision + 1)
        m.d.comb += near_difference.eq(exponent_a[:2] - exponent_b[:2])
        with m.Switch(near_difference):
            with m.Case(0):
                m.d.comb += [minuend.eq(full_a << 1), subtrahend.eq(full_b << 1)]
            with m.Case(1):
                m.d.comb += [minuend.eq(full_a << 1), subtrahend.eq(full_b)]
            with m.Default():
                m.d.comb += [minuend.eq(full_b << 1), subtrahend.eq(full_a)]
        near = Signal(precision + 1)
        near_wide = Signal(precision + 2)
        may_be_near = Signal()
        m.d.comb += [
            near_wide.eq(Cat(~swap, minuend) + Cat(~swap, ~subtrahend)),
            near.eq(near_wide[1:]),
            may_be_near.eq(
                subtract
                & (shift < 2)
                & (exponent_a != 0)
                & (exponent_b != 0)
                & ~exponent_a.all()
                & ~exponent_b.all()
            ),
        ]
        return near, may_be_near

    def _elaborate_far_alignment(self, m, order):
        """Far path: shift the smaller operand. Equal exponents need no order of the fractions."""
        fraction_bits = self._fmt.fraction_bits
        fraction_a, exponent_a = self.a[:fraction_bits], self.a[fraction_bits:-1]
        fraction_b, exponent_b = self.b[:fraction_bits], self.b[fraction_bits:-1]
        any_nan = Signal()
        m.d.comb += any_nan.eq(
            (exponent_a.all() & fraction_a.any()) | (exponent_b.all() & fraction_b.any())
        )
        large = Mux(exponent_b > exponent_a, fraction_b, fraction_a)
        aligned, *_ = self._elaborate_alignment(m, fraction_a, Const(0, 1), *order[2:])
        return aligned, large, any_nan

    def _elaborate_far_sum(self, m, aligned, large, subtract):
        """Far path: add and round.

        All that is below the last place of the larger operand comes from the smaller one, so the
        sum or that plus one, in the last place, is the rounded one.
        """
        precision = self._fmt.precision
        first = Cat(large, Const(1, 2))
        second = Cat(aligned[3:], Const(0, 1)) ^ subtract.replicate(precision + 1)
        plain = Signal(precision + 1)
        plus_one = Signal(precision + 1)
        below = Signal(3)
        exact_difference = Signal()
        m.d.comb += [
            plain.eq(first + second),
            plus_one.eq((Cat(Const(1, 1), first) + Cat(Const(1, 1), second))[1:]),
            # Negated for a difference.
            below[0].eq(aligned[0]),
            below[1].eq(aligned[1] ^ (subtract & aligned[0])),
            below[2].eq(aligned[2] ^ (subtract & aligned[:2].any())),
            exact_difference.eq(subtract & (aligned[:3] == 0)),
        ]
        # Places of the leading one before rounding: the top, the next or the one after that. What
        # is next to a power of two and might round to another place is right in either.
        carry, normal = plain[-1] & ~subtract, plain[-2]
        up = Signal()
        up_carry, up_normal, up_left = Signal(), Signal(), Signal()
        far = Signal(precision + 1)
        far_last = Signal()
        m.d.comb += [
            up_carry.eq(plain[0] & (plain[1] | below.any())),
            up_normal.eq(below[2] & (plain[0] | below[:2].any())),
            up_left.eq(below[2] & below[1] & (below[0] | below[2])),
            up.eq(exact_difference | Mux(carry, up_carry, Mux(normal, up_normal, up_left))),
            far.eq(Mux(up, plus_one, plain)),
            # The place below, needed where the difference moves to the left. Rounded up it is 0 if
            # it was 1, and 1 if it was 0.
            far_last.eq(below[2] ^ (below[1] & (below[0] | below[2]))),
        ]
        return far, far_last

    def _elaborate_near_normalisation(self, m, near, may_be_near, swap, one_less):
        """Near path: shift the leading one to the top.

        The exponent is that of the larger operand, minus one (`one_less`), minus the shift. Its
        upper bits are found for either borrow before the last digit of the shift is known.
        """
        precision, exponent_bits = self._fmt.precision, self._fmt.exponent_bits
        is_near = Signal()
        magnitude = Signal(precision)
        m.d.comb += [
            magnitude.eq(near[:-1] ^ swap.replicate(precision)),
            is_near.eq(may_be_near & ~(near[-1] ^ swap)),
        ]
        sixteens, fours, is_zero = normalisation_digits(m, magnitude)
        partly = shift_left_digit(m, magnitude, sixteens, 16)
        coarsely = shift_left_digit(m, partly, fours, 4)
        ones = leading_units_digit(m, coarsely)
        normalised = shift_left_digit(m, coarsely, ones, 1)
        coarse = Cat(fours, sixteens)
        upper = Signal(exponent_bits - 2)
        upper_less = Signal(exponent_bits - 2)
        borrow = Signal()
        exponent = Signal(exponent_bits, name="near_exponent")
        underflow = Signal(name="near_underflow")
        m.d.comb += [
            upper.eq(one_less[2:] - coarse),
            upper_less.eq((Cat(Const(0, 1), one_less[2:]) - Cat(Const(1, 1), coarse))[1:]),
            borrow.eq(one_less[:2] < ones),
            exponent.eq(Cat((one_less[:2] - ones)[:2], Mux(borrow, upper_less, upper))),
            # The exponent is at most zero: at least as many places to shift as it has left.
            underflow.eq(
                (one_less[2:] < coarse) | ((one_less[2:] == coarse) & (one_less[:2] <= ones))
            ),
        ]
        return is_near, normalised, exponent, is_zero, underflow

    def _elaborate_selection(
        self, m, far, far_last, near_result, exponent, one_less, sign, subtract, zero_sign,
        infinities, any_nan,
    ):  # fmt: skip
        """Take one of the paths, or a special result.

        Special results keep the exponent of the larger operand: all zeros or all ones. They are
        never near.
        """
        fmt = self._fmt
        is_near, normalised, near_exponent, near_is_zero, near_underflow = near_result
        both_zero = Signal()
        infinite = Signal()
        nan = Signal()
        special = Signal()
        far_carry = Signal()
        far_normal = Signal()
        overflow = Signal()
        path = Signal(2)
        m.d.comb += [
            both_zero.eq(exponent == 0),
            infinite.eq(exponent.all()),
            nan.eq(infinite & (any_nan | (infinities & subtract))),
            special.eq(both_zero | infinite),
            far_carry.eq(far[-1] & ~subtract & ~special),
            far_normal.eq(far[-2] | special),
            overflow.eq(far_carry & (exponent == fmt.max_exponent_field - 1)),
            path.eq(Mux(is_near, 0, Mux(far_carry, 1, Mux(far_normal, 2, 3)))),
        ]
        # Clearing comes last: it becomes the reset of the output register.
        result_fraction = Signal(fmt.fraction_bits)
        result_exponent = Signal(fmt.exponent_bits)
        result_sign = Signal()
        m.d.comb += [
            result_fraction.eq(
                select(path, [normalised[:-1], far[1:-1], far[:-2], Cat(far_last, far[:-3])])
            ),
            result_exponent.eq(select(path, [near_exponent, exponent + 1, exponent, one_less])),
            result_sign.eq(sign),
        ]
        with m.If(is_near & near_is_zero):
            m.d.comb += result_sign.eq(0)
        with m.If(both_zero):
            m.d.comb += result_sign.eq(zero_sign)
        with m.If(nan):
            m.d.comb += result_sign.eq(0)
        with m.If((is_near & near_underflow) | overflow | special):
            m.d.comb += result_fraction.eq(0)
        with m.If(nan):
            m.d.comb += result_fraction[-1].eq(1)
        with m.If(is_near & (near_is_zero | near_underflow)):
            m.d.comb += result_exponent.eq(0)
        return Cat(result_fraction, result_exponent, result_sign)

    def _elaborate_single_path(self, m):
        """Align, add, normalise and round, one after the other: slower, but smaller."""
        pipeline = CutPoints(m, self._stages, _CUTS)

        ordered = pipeline.cut("ordered", *self._elaborate_order(m))
        aligned = pipeline.cut("aligned", *self._elaborate_alignment(m, *ordered))
        summed = pipeline.cut("summed", *self._elaborate_sum(m, *aligned))
        counted = pipeline.cut("leading_zeros", *self._elaborate_leading_zeros(m, *summed))
        normalised = pipeline.cut("normalised", *self._elaborate_normalisation(m, *counted))
        pipeline.output(self.sum, self._elaborate_rounding(m, *normalised))

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
            beyond = shift[position + len(digit) :].any() if last else Const(0, 1)
            counts = range(1 << len(digit))
            m.d.comb += [
                shifted.eq(select(digit, [value >> (step * count) for count in counts])),
                lost.eq(select(digit, [value[: step * count].any() for count in counts])),
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
        ones = leading_units_digit(m, coarsely)
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
