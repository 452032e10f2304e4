"""Floating-point multiplier."""

from amaranth import Cat, Const, Module, Signal

from ukf_hdl.arithmetic.float_unit import FloatUnit
from ukf_hdl.arithmetic.pipelining import CutPoints
from ukf_sw.spec.parameters import Pipeline

__all__ = ["FloatMultiplier"]

# Where registers stand, for each number of stages.
_CUTS = {
    1: (),
    2: ("product",),
    3: ("partial", "product"),
    4: ("input", "partial", "product"),
    5: ("input", "partial", "product", "normalised"),
}

# Widest unsigned factor on the narrower side of a DSP48E1; the product of the low half is shifted
# by as many bits for the cascade to the next one.
_PIECE_BITS = 17
_WIDE_BITS = 24


class FloatMultiplier(FloatUnit):
    """Floating-point multiplier, one product per clock.

    Gives the product of :py:`a` and :py:`b`, rounded to nearest with ties to even, on
    :py:`product`, :py:`stages` clocks after them; equal to
    :func:`ukf_sw.engine.arithmetic.multiply`. There is no handshake: a pair is taken on every
    clock. The product does not depend on :py:`stages`.

    Subnormal operands read as zeros of their sign. A product that is below the smallest normal
    number after rounding is a zero of its sign. Overflow gives infinity. The sign is that of the
    operands' signs multiplied, also for zeros. A NaN operand, and zero times infinity, give the
    NaN of the format.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    stages : :class:`int`
        Latency in clocks, 1 to 16. From 6 on, additional registers only delay the product.

    Members
    -------
    a : :py:`In(fmt.width)`
        First operand.
    b : :py:`In(fmt.width)`
        Second operand.
    product : :py:`Out(fmt.width)`
        Product.

    Attributes
    ----------
    DEFAULT_STAGES : :class:`int`
        Fewest stages that support 100 MHz on a 7-series FPGA in the binary32 format.
    """

    DEFAULT_STAGES = Pipeline.multiply

    def __init__(self, fmt, *, stages=DEFAULT_STAGES):
        super().__init__(fmt, stages, operands=("a", "b"), result="product")

    def elaborate(self, platform):
        m = Module()
        fmt = self._fmt
        pipeline = CutPoints(m, self._stages, _CUTS)
        a, b = pipeline.cut("input", self.a, self.b)

        control = self._elaborate_control(m, a, b)
        significand_a = Cat(a[: fmt.fraction_bits], Const(1, 1))
        significand_b = Cat(b[: fmt.fraction_bits], Const(1, 1))
        pieces = [
            significand_b[start : start + _PIECE_BITS]
            for start in range(0, fmt.precision, _PIECE_BITS)
        ]
        partials = []
        for index, piece in enumerate(pieces):
            partial = Signal(fmt.precision + len(piece), name=f"partial_{index}")
            m.d.comb += partial.eq(significand_a * piece)
            partials.append(partial)
        control = pipeline.cut("partial", *control)
        partials = pipeline.cut("partial", *partials)

        # The sums of a chain of DSPs, each of which takes the one before it shifted.
        total = Signal(2 * fmt.precision)
        low_bits = []
        upper = partials[0]
        for index, partial in enumerate(partials[1:]):
            low_bits.append(upper[:_PIECE_BITS])
            chained = Signal(2 * fmt.precision - _PIECE_BITS * (index + 1), name=f"chain_{index}")
            m.d.comb += chained.eq(partial + upper[_PIECE_BITS:])
            upper = chained
        m.d.comb += total.eq(Cat(*low_bits, upper))
        (total,) = pipeline.cut("product", total)
        control = pipeline.cut("product", *control)

        normalised = pipeline.cut("normalised", *self._elaborate_normalisation(m, total), *control)
        pipeline.output(self.product, self._elaborate_rounding(m, *normalised))

        return m

    def _elaborate_control(self, m, a, b):
        """Sign, exponent and special results."""
        fmt = self._fmt
        exponent_a, exponent_b = a[fmt.fraction_bits : -1], b[fmt.fraction_bits : -1]
        fraction_a, fraction_b = a[: fmt.fraction_bits], b[: fmt.fraction_bits]

        sign = Signal()
        # One less than the exponent field of a product below two.
        exponent = Signal(fmt.exponent_bits + 2)
        zero = Signal()
        infinite = Signal()
        nan = Signal()
        zero_a, zero_b = Signal(), Signal()
        special_a, special_b = Signal(), Signal()
        m.d.comb += [
            zero_a.eq(exponent_a == 0),
            zero_b.eq(exponent_b == 0),
            special_a.eq(exponent_a.all()),
            special_b.eq(exponent_b.all()),
            exponent.eq(exponent_a + exponent_b - (fmt.bias + 1)),
            zero.eq(zero_a | zero_b),
            infinite.eq(special_a | special_b),
            nan.eq(
                (special_a & fraction_a.any()) | (special_b & fraction_b.any())
                | (special_a & zero_b) | (special_b & zero_a)
            ),
            sign.eq((a[-1] ^ b[-1]) & ~nan),
        ]  # fmt: skip
        return sign, exponent, zero, infinite, nan

    def _elaborate_normalisation(self, m, total):
        """Bring the leading one to the top, and decide on rounding."""
        fmt = self._fmt
        high = Signal()
        fraction = Signal(fmt.fraction_bits)
        round_up = Signal()
        low = fmt.fraction_bits - 1
        sticky = total[:low].any()
        m.d.comb += high.eq(total[-1])
        with m.If(high):
            m.d.comb += [
                fraction.eq(total[low + 2 :]),
                round_up.eq(total[low + 1] & (total[low + 2] | total[low] | sticky)),
            ]
        with m.Else():
            m.d.comb += [
                fraction.eq(total[low + 1 :]),
                round_up.eq(total[low] & (total[low + 1] | sticky)),
            ]
        return high, fraction, round_up

    def _elaborate_rounding(self, m, high, fraction, round_up, sign, exponent, zero, infinite, nan):
        """Round; the carry goes on into the exponent."""
        fmt = self._fmt
        rounded = Signal(fmt.fraction_bits + fmt.exponent_bits + 3)
        m.d.comb += rounded.eq(
            Cat(Const(1, 1), fraction, exponent)
            + Cat(round_up, Const(0, fmt.fraction_bits), Const(1, 1) + high)
        )
        # The exponent is between minus its bias and twice its bias.
        field = rounded[1 + fmt.fraction_bits :]
        underflow = Signal()
        overflow = Signal()
        m.d.comb += [
            underflow.eq(field[-1] | (field == 0)),
            overflow.eq(~field[-1] & (field[-2] | field[:-2].all())),
        ]

        result = Signal(fmt.width)
        m.d.comb += result.eq(Cat(rounded[1 : fmt.width], sign))
        with m.If(nan):
            m.d.comb += result.eq(fmt.nan)
        with m.Elif(infinite):
            m.d.comb += result[:-1].eq(fmt.infinity)
        with m.Elif(zero | underflow):
            m.d.comb += result[:-1].eq(0)
        with m.Elif(overflow):
            m.d.comb += result[:-1].eq(fmt.infinity)
        return result
