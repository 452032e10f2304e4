"""Floating-point multiplier."""

from dataclasses import dataclass

from amaranth import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib.data import View

from ukf_hdl.arithmetic.float_layout import SPECIAL, FloatLayout
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


@dataclass(frozen=True, eq=False)
class _Scale:
    """What is known of the product without the significands."""

    exponent: Value  # one less than that of a product below two
    special: View


@dataclass(frozen=True, eq=False)
class _Normalised:
    """A product with its leading one at the top."""

    fraction: Value
    round_up: Value
    high: Value  # the product of the significands is at least two
    scale: _Scale


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
        number = FloatLayout(fmt)
        pipeline = CutPoints(m, self._stages, _CUTS)
        a, b = (pipeline.cut("input", number(word)) for word in (self.a, self.b))

        scale = self._elaborate_scale(m, a, b)
        partials = []
        for index, start in enumerate(range(0, fmt.precision, _PIECE_BITS)):
            piece = b.significand[start : start + _PIECE_BITS]
            partial = Signal(fmt.precision + len(piece), name=f"partial_{index}")
            m.d.comb += partial.eq(a.significand * piece)
            partials.append(pipeline.cut("partial", partial))
        scale = pipeline.cut("partial", scale)

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
        total = pipeline.cut("product", total)
        scale = pipeline.cut("product", scale)

        normalised = pipeline.cut("normalised", self._elaborate_normalisation(m, total, scale))
        pipeline.output(self.product, self._elaborate_rounding(m, normalised))

        return m

    def _elaborate_scale(self, m, a, b):
        """Exponent, sign and special results."""
        fmt = self._fmt
        exponent = Signal(fmt.exponent_bits + 2)
        nan = Signal()
        special = Signal(SPECIAL)
        m.d.comb += [
            exponent.eq(a.exponent + b.exponent - (fmt.bias + 1)),
            nan.eq(a.is_nan | b.is_nan | (~a.is_finite & b.is_zero) | (~b.is_finite & a.is_zero)),
            special.sign.eq((a.sign ^ b.sign) & ~nan),
            special.zero.eq(a.is_zero | b.is_zero),
            special.infinite.eq(~a.is_finite | ~b.is_finite),
            special.nan.eq(nan),
        ]
        return _Scale(exponent, special)

    def _elaborate_normalisation(self, m, total, scale):
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
        return _Normalised(fraction, round_up, high, scale)

    def _elaborate_rounding(self, m, normalised):
        """Round; the carry goes on into the exponent."""
        fmt = self._fmt
        exponent, before = normalised.scale.exponent, normalised.scale.special
        rounded = Signal(fmt.fraction_bits + fmt.exponent_bits + 3)
        m.d.comb += rounded.eq(
            Cat(Const(1, 1), normalised.fraction, exponent)
            + Cat(normalised.round_up, Const(0, fmt.fraction_bits), Const(1, 1) + normalised.high)
        )
        # The exponent is between minus its bias and twice its bias.
        field = rounded[1 + fmt.fraction_bits :]
        underflow = Signal()
        overflow = Signal()
        magnitude = Signal(fmt.width - 1)
        special = Signal(SPECIAL)
        m.d.comb += [
            underflow.eq(field[-1] | (field == 0)),
            overflow.eq(~field[-1] & (field[-2] | field[:-2].all())),
            magnitude.eq(Mux(overflow, fmt.infinity, rounded[1 : fmt.width])),
            special.eq(before),
            special.zero.eq(before.zero | underflow),
        ]
        return self._elaborate_result(m, magnitude, special)
