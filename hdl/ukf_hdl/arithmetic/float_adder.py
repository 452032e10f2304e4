"""Floating-point adder."""

from dataclasses import dataclass, replace

from amaranth import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib.data import View

from ukf_hdl.arithmetic.float_layout import SPECIAL, FloatLayout
from ukf_hdl.arithmetic.float_unit import FloatUnit
from ukf_hdl.arithmetic.leading_zeros import (
    Coarse,
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


@dataclass(frozen=True, eq=False)
class _Terms:
    """What is known of both operands."""

    exponent: Value  # of the larger one
    sign: Value  # of the larger one
    subtract: Value  # their signs differ
    zero_sign: Value  # sign of the sum if both are zero
    not_finite: Value  # both are infinite or NaN


@dataclass(frozen=True, eq=False)
class _Ordered:
    """Operands, the smaller one chosen by the exponents alone."""

    small: Value  # significand to be shifted
    shift: Value  # places to shift it to the right
    large: Value  # fraction of the larger one
    swap: Value  # the exponents are equal, and `other` is the smaller fraction
    other: Value
    terms: _Terms


@dataclass(frozen=True, eq=False)
class _Aligned:
    """Operands, the smaller one shifted and with guard, round and sticky bits below it."""

    small: Value
    large: Value  # fraction
    terms: _Terms


@dataclass(frozen=True, eq=False)
class _Summed:
    """Sum or difference."""

    total: Value
    exponent: Value
    zero_sign: Value
    special: View


@dataclass(frozen=True, eq=False)
class _Counted:
    """The sum, shifted by as many 16 places as there are to shift."""

    total: Value
    coarse: Coarse
    exponent: Value
    special: View


@dataclass(frozen=True, eq=False)
class _Normalised:
    """The sum with its leading one at the top."""

    total: Value
    exponent: Value  # without the last digit of the shift
    ones: Value  # that digit
    special: View


@dataclass(frozen=True, eq=False)
class _NearDifference:
    """Difference of the near path."""

    difference: Value  # complemented if `swap`
    possible: Value  # the exponents are those of the near path
    swap: Value


@dataclass(frozen=True, eq=False)
class _Parted:
    """Operands of the far path, and what the near path made of them."""

    far: _Aligned
    near: _NearDifference
    any_nan: Value


@dataclass(frozen=True, eq=False)
class _FarSum:
    """Rounded sum of the far path."""

    total: Value
    last: Value  # the place below


@dataclass(frozen=True, eq=False)
class _NearResult:
    """Normalised difference of the near path."""

    is_sum: Value  # it is the sum: a leading place was cancelled
    significand: Value
    exponent: Value
    is_zero: Value
    underflow: Value


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
        a, b = (FloatLayout(self._fmt)(word) for word in (self.a, self.b))
        if self._stages <= _MAX_TWO_PATH_STAGES:
            self._elaborate_two_paths(m, a, b)
        else:
            self._elaborate_single_path(m, a, b)
        return m

    def _elaborate_two_paths(self, m, a, b):
        """Add along the far and the near path, and select.

        The far path takes sums, and differences of operands whose exponents differ: what it gives
        moves by at most one place, but is rounded. The near path takes differences whose exponents
        differ by at most one and whose leading place is cancelled: they move by any number of
        places, but are exact.
        """
        pipeline = CutPoints(m, self._stages, _TWO_PATH_CUTS)
        ordered = self._elaborate_order(m, a, b)
        parted = _Parted(
            near=self._elaborate_near_difference(m, a, b, ordered),
            far=self._elaborate_far_alignment(m, a, b, ordered),
            any_nan=a.is_nan | b.is_nan,
        )
        parted = pipeline.cut("aligned", parted)
        terms = parted.far.terms
        one_less = Signal.like(terms.exponent)
        m.d.comb += one_less.eq(terms.exponent - 1)
        far = self._elaborate_far_sum(m, parted.far)
        near = self._elaborate_near_normalisation(m, parted.near, one_less)
        result = self._elaborate_selection(m, far, near, terms, one_less, parted.any_nan)
        pipeline.output(self.sum, result)

    def _elaborate_near_difference(self, m, a, b, ordered):
        """Near path: subtract operands whose exponents differ by at most one.

        The difference of the exponents is known from two bits of each. Where it is zero, the
        difference of the operands may be negative; then one less than it is made, and complemented.
        """
        precision = self._fmt.precision
        exponent_difference = Signal(2)
        minuend = Signal(precision + 1)
        subtrahend = Signal(precision + 1)
        m.d.comb += exponent_difference.eq(a.exponent[:2] - b.exponent[:2])
        with m.Switch(exponent_difference):
            with m.Case(0):
                m.d.comb += [minuend.eq(a.significand << 1), subtrahend.eq(b.significand << 1)]
            with m.Case(1):
                m.d.comb += [minuend.eq(a.significand << 1), subtrahend.eq(b.significand)]
            with m.Default():
                m.d.comb += [minuend.eq(b.significand << 1), subtrahend.eq(a.significand)]
        swap = ordered.swap
        wide = Signal(precision + 2)
        difference = Signal(precision + 1)
        possible = Signal()
        m.d.comb += [
            wide.eq(Cat(~swap, minuend) + Cat(~swap, ~subtrahend)),
            difference.eq(wide[1:]),
            possible.eq(
                ordered.terms.subtract
                & (ordered.shift < 2)
                & ~a.is_zero
                & ~b.is_zero
                & a.is_finite
                & b.is_finite
            ),
        ]
        return _NearDifference(difference, possible, swap)

    def _elaborate_far_alignment(self, m, a, b, ordered):
        """Far path: shift the smaller operand. Equal exponents need no order of the fractions."""
        large = Mux(b.exponent > a.exponent, b.fraction, a.fraction)
        return self._elaborate_alignment(m, replace(ordered, large=large, swap=Const(0, 1)))

    def _elaborate_far_sum(self, m, aligned):
        """Far path: add and round.

        All that is below the last place of the larger operand comes from the smaller one, so the
        sum or that plus one, in the last place, is the rounded one.
        """
        precision = self._fmt.precision
        small, subtract = aligned.small, aligned.terms.subtract
        first = Cat(aligned.large, Const(1, 2))
        second = Cat(small[3:], Const(0, 1)) ^ subtract.replicate(precision + 1)
        plain = Signal(precision + 1)
        plus_one = Signal(precision + 1)
        below = Signal(3)
        exact_difference = Signal()
        m.d.comb += [
            plain.eq(first + second),
            plus_one.eq((Cat(Const(1, 1), first) + Cat(Const(1, 1), second))[1:]),
            # Negated for a difference.
            below[0].eq(small[0]),
            below[1].eq(small[1] ^ (subtract & small[0])),
            below[2].eq(small[2] ^ (subtract & small[:2].any())),
            exact_difference.eq(subtract & (small[:3] == 0)),
        ]
        # Places of the leading one before rounding: the top, the next or the one after that. What
        # is next to a power of two and might round to another place is right in either.
        carry, normal = plain[-1] & ~subtract, plain[-2]
        up = Signal()
        up_carry = Signal()
        up_normal = Signal()
        up_left = Signal()
        total = Signal(precision + 1)
        last = Signal()
        m.d.comb += [
            up_carry.eq(plain[0] & (plain[1] | below.any())),
            up_normal.eq(below[2] & (plain[0] | below[:2].any())),
            up_left.eq(below[2] & below[1] & (below[0] | below[2])),
            up.eq(exact_difference | Mux(carry, up_carry, Mux(normal, up_normal, up_left))),
            total.eq(Mux(up, plus_one, plain)),
            # The place below, needed where the difference moves to the left. Rounded up it is 0 if
            # it was 1, and 1 if it was 0.
            last.eq(below[2] ^ (below[1] & (below[0] | below[2]))),
        ]
        return _FarSum(total, last)

    def _elaborate_near_normalisation(self, m, near, one_less):
        """Near path: shift the leading one to the top.

        The exponent is that of the larger operand, minus one (`one_less`), minus the shift. Its
        upper bits are found for either borrow before the last digit of the shift is known.
        """
        precision, exponent_bits = self._fmt.precision, self._fmt.exponent_bits
        is_sum = Signal()
        magnitude = Signal(precision)
        m.d.comb += [
            magnitude.eq(near.difference[:-1] ^ near.swap.replicate(precision)),
            is_sum.eq(near.possible & ~(near.difference[-1] ^ near.swap)),
        ]
        digits, is_zero = normalisation_digits(m, magnitude)
        partly = shift_left_digit(m, magnitude, digits.sixteens, 16)
        coarsely = shift_left_digit(m, partly, digits.fours, 4)
        ones = leading_units_digit(m, coarsely)
        normalised = shift_left_digit(m, coarsely, ones, 1)
        coarse = digits.value
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
        return _NearResult(is_sum, normalised, exponent, is_zero, underflow)

    def _elaborate_selection(self, m, far, near, terms, one_less, any_nan):
        """Take one of the paths, or a special result.

        Special results keep the exponent of the larger operand: all zeros or all ones. They are
        never near.
        """
        fmt, exponent = self._fmt, terms.exponent
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
            nan.eq(infinite & (any_nan | (terms.not_finite & terms.subtract))),
            special.eq(both_zero | infinite),
            far_carry.eq(far.total[-1] & ~terms.subtract & ~special),
            far_normal.eq(far.total[-2] | special),
            overflow.eq(far_carry & (exponent == fmt.max_exponent_field - 1)),
            path.eq(Mux(near.is_sum, 0, Mux(far_carry, 1, Mux(far_normal, 2, 3)))),
        ]
        # Clearing comes last: it becomes the reset of the output register.
        result = Signal(FloatLayout(fmt))
        fractions = [
            near.significand[:-1], far.total[1:-1], far.total[:-2], Cat(far.last, far.total[:-3]),
        ]  # fmt: skip
        exponents = [near.exponent, exponent + 1, exponent, one_less]
        m.d.comb += [
            result.fraction.eq(select(path, fractions)),
            result.exponent.eq(select(path, exponents)),
            result.sign.eq(terms.sign),
        ]
        with m.If(near.is_sum & near.is_zero):
            m.d.comb += result.sign.eq(0)
        with m.If(both_zero):
            m.d.comb += result.sign.eq(terms.zero_sign)
        with m.If(nan):
            m.d.comb += result.sign.eq(0)
        with m.If((near.is_sum & near.underflow) | overflow | special):
            m.d.comb += result.fraction.eq(0)
        with m.If(nan):
            m.d.comb += result.fraction[-1].eq(1)
        with m.If(near.is_sum & (near.is_zero | near.underflow)):
            m.d.comb += result.exponent.eq(0)
        return result

    def _elaborate_single_path(self, m, a, b):
        """Align, add, normalise and round, one after the other: slower, but smaller."""
        pipeline = CutPoints(m, self._stages, _CUTS)

        ordered = pipeline.cut("ordered", self._elaborate_order(m, a, b))
        aligned = pipeline.cut("aligned", self._elaborate_alignment(m, ordered))
        summed = pipeline.cut("summed", self._elaborate_sum(m, aligned))
        counted = pipeline.cut("leading_zeros", self._elaborate_leading_zeros(m, summed))
        normalised = pipeline.cut("normalised", self._elaborate_normalisation(m, counted))
        pipeline.output(self.sum, self._elaborate_rounding(m, normalised))

    def _elaborate_order(self, m, a, b):
        """Find the larger operand.

        The operand to be shifted is selected by the exponents alone, which are quick to compare.
        Where they are equal nothing is shifted, and a comparison of the fractions that comes late
        can still swap the two.
        """
        fmt = self._fmt
        difference = Signal(fmt.exponent_bits + 1)
        opposite = Signal(fmt.exponent_bits)
        exponent_less = Signal()
        swap = Signal()
        m.d.comb += [
            difference.eq(a.exponent - b.exponent),
            opposite.eq(b.exponent - a.exponent),
            exponent_less.eq(difference[-1]),
            swap.eq((a.exponent == b.exponent) & (a.fraction < b.fraction)),
        ]

        shift = Signal(fmt.exponent_bits)
        small_is_zero = Signal()
        small = Signal(fmt.precision)
        m.d.comb += [
            shift.eq(Mux(exponent_less, opposite, difference)),
            small_is_zero.eq(a.is_zero | b.is_zero),
            small.eq(Mux(small_is_zero, 0, Cat(Mux(exponent_less, a.fraction, b.fraction), 1))),
        ]

        large_is_b = Signal()
        large = Signal(fmt.fraction_bits)
        exponent = Signal(fmt.exponent_bits)
        sign = Signal()
        m.d.comb += [
            large_is_b.eq(exponent_less | swap),
            large.eq(Mux(large_is_b, b.fraction, a.fraction)),
            exponent.eq(Mux(exponent_less, b.exponent, a.exponent)),
            sign.eq(Mux(large_is_b, b.sign, a.sign)),
        ]

        terms = _Terms(
            exponent=exponent,
            sign=sign,
            subtract=a.sign ^ b.sign,
            zero_sign=a.sign & b.sign,
            not_finite=a.exponent.all() & b.exponent.all(),
        )
        return _Ordered(small, shift, large, swap, other=a.fraction, terms=terms)

    def _elaborate_alignment(self, m, ordered):
        """Shift the smaller operand to the right, with guard, round and sticky bits."""
        width = self._fmt.precision + 2
        shift = ordered.shift
        value = Signal(width, name="small_extended")
        m.d.comb += value.eq(Cat(Const(0, 2), ordered.small))

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

        small = Signal(width + 1, name="aligned")
        m.d.comb += small.eq(Cat(sticky, value))
        with m.If(ordered.swap):
            # The exponents are equal: nothing was shifted.
            m.d.comb += small.eq(Cat(Const(0, 3), ordered.other, 1))
        return _Aligned(small, ordered.large, ordered.terms)

    def _elaborate_sum(self, m, aligned):
        """Add or subtract; the difference is never negative. Decide on special results."""
        small, large, terms = aligned.small, aligned.large, aligned.terms
        total = Signal(len(small) + 1)
        first = Cat(Const(0, 3), large, Const(1, 2))
        second = Mux(terms.subtract, ~small, small)
        # A carry into the lowest place, as an additional place below it.
        wide = Signal(len(total) + 1)
        m.d.comb += [
            wide.eq(Cat(terms.subtract, first) + Cat(terms.subtract, second, terms.subtract)),
            total.eq(wide[1:]),
        ]

        infinite = Signal()
        special = Signal(SPECIAL)
        m.d.comb += [
            infinite.eq(terms.exponent.all()),
            special.sign.eq(terms.sign),
            special.zero.eq(terms.exponent == 0),
            special.infinite.eq(infinite),
            # The larger operand is NaN if any is. If it is infinity, the smaller one is not NaN.
            special.nan.eq(infinite & (large.any() | (terms.not_finite & terms.subtract))),
        ]
        return _Summed(total, terms.exponent, terms.zero_sign, special)

    def _elaborate_leading_zeros(self, m, summed):
        """Count leading zeros in steps of 4, and shift by multiples of 16."""
        total, exponent, before = summed.total, summed.exponent, summed.special
        coarse, is_zero = normalisation_digits(m, total)
        partly = shift_left_digit(m, total, coarse.sixteens, 16)

        cleared_sign = Signal()
        overflow = Signal()
        special = Signal(SPECIAL)
        m.d.comb += [
            cleared_sign.eq(Mux(before.zero, summed.zero_sign, before.sign & ~is_zero)),
            # Rounding that carries into the exponent clears the fraction by itself.
            overflow.eq(total[-1] & (exponent == self._fmt.max_exponent_field - 1)),
            # The exponent of infinity and NaN is forced, their sign is not cleared.
            special.sign.eq(~before.nan & Mux(before.infinite, before.sign, cleared_sign)),
            special.zero.eq(~before.infinite & (before.zero | is_zero)),
            special.infinite.eq(before.infinite | overflow),
            special.nan.eq(before.nan),
        ]
        return _Counted(partly, coarse, exponent, special)

    def _elaborate_normalisation(self, m, counted):
        """Shift the leading one to the top."""
        coarsely = shift_left_digit(m, counted.total, counted.coarse.fours, 4)
        ones = leading_units_digit(m, coarsely)
        normalised = shift_left_digit(m, coarsely, ones, 1)

        # The top place of the sum is worth one more than the exponent.
        exponent = Signal(self._fmt.exponent_bits + 2, name="coarse_exponent")
        underflow = Signal()
        special = Signal(SPECIAL)
        m.d.comb += [
            exponent.eq(counted.exponent - Cat(Const(0, 2), counted.coarse.value)),
            # At most 0 after `ones` is subtracted and 1 added. No rounding changes that: so small
            # a sum is exact.
            underflow.eq(exponent[-1] | ((exponent[2:] == 0) & (exponent[:2] < ones))),
            special.eq(counted.special),
            special.zero.eq(counted.special.zero | underflow),
        ]
        return _Normalised(normalised, exponent, ones, special)

    def _elaborate_rounding(self, m, normalised):
        """Round, and finish the exponent in the same carry chain."""
        fmt = self._fmt
        total, ones = normalised.total, normalised.ones
        low = len(total) - fmt.precision
        fraction = total[low:-1]
        guard = total[low - 1]
        sticky = total[: low - 1].any()
        round_up = Signal()
        exponent_step = Signal(fmt.exponent_bits)
        rounded = Signal(fmt.width)
        m.d.comb += [
            round_up.eq(guard & (sticky | fraction[0])),
            # 1 - ones
            exponent_step.eq(Cat(~ones[0], (ones == 2) | (ones == 3), *[ones[1]] * 62)),
            rounded.eq(
                Cat(Const(1, 1), fraction, normalised.exponent[: fmt.exponent_bits])
                + Cat(round_up, Const(0, fmt.fraction_bits), exponent_step)
            ),
        ]
        return self._elaborate_result(m, rounded[1:], normalised.special)
