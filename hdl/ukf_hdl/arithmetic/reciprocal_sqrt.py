"""Reciprocal square root."""

from dataclasses import dataclass, replace

from amaranth import Cat, Const, Module, Mux, Signal, Value, signed
from amaranth.lib.data import View
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In

from ukf_hdl.arithmetic.float_layout import SPECIAL, FloatLayout
from ukf_hdl.arithmetic.float_unit import FloatUnit
from ukf_hdl.arithmetic.pipelining import CutPoints
from ukf_sw.engine.reciprocal_sqrt import ReciprocalSqrtParams
from ukf_sw.spec.parameters import Pipeline

__all__ = ["ReciprocalSqrt"]

# Where registers stand, for each number of stages: without and with Newton's iteration.
_CUTS = {
    1: (),
    2: ("slope",),
    3: ("table", "slope"),
    4: ("table", "slope", "root"),
    5: ("table", "slope_product", "slope", "root"),
    6: ("table", "slope_product", "slope", "root_product", "root"),
}
_NEWTON_CUTS = {
    1: (),
    2: ("root",),
    3: ("slope", "root"),
    4: ("slope", "root", "residual"),
    5: ("slope", "root", "product", "residual"),
    6: ("table", "slope", "root", "product", "residual"),
    7: ("table", "slope", "root", "product", "residual", "correction"),
    8: ("table", "slope_product", "slope", "root", "product", "residual", "correction"),
    9: (
        "table", "slope_product", "slope", "root_product", "root", "product", "residual",
        "correction",
    ),
}  # fmt: skip

# Width of the widest port of a RAMB18.
_BLOCK_BITS = 36
_BLOCK_MIN_DEPTH = 128


@dataclass(frozen=True, eq=False)
class _Operand:
    """What is known of the root before it is approximated."""

    distance: Value  # from the middle of the segment of the table
    radicand: Value  # for Newton's iteration, which is the only one to use it
    exponent: Value  # of a root below one
    special: View


@dataclass(frozen=True, eq=False)
class _Horner:
    """A value on the way from the highest coefficient to the polynomial."""

    value: Value
    coefficients: tuple[Value, ...]  # those that are still to be added
    operand: _Operand


@dataclass(frozen=True, eq=False)
class _Newton:
    """A value on the way from an estimate of the root to a better one."""

    value: Value
    root: Value  # the estimate
    operand: _Operand


class ReciprocalSqrt(FloatUnit):
    """Reciprocal square root, one per clock.

    Gives :py:`1 / sqrt(a)` on :py:`root`, :py:`stages` clocks after :py:`a`; equal to
    :py:`ReciprocalSqrtParams(fmt=fmt).compute(a)`. There is no handshake: a number is taken on
    every clock. The root does not depend on :py:`stages`.

    The root of a positive normal number is off by less than one unit in the last place, and exact
    for powers of four. A zero of either sign gives plus zero, not infinity, and so do subnormal
    numbers and plus infinity. Other negative numbers and NaN give the NaN of the format.

    With :py:`signed`, the root is that of the magnitude, with the sign of the number, as
    :attr:`ukf_sw.spec.forms.Root.SIGNED` says: zeros give infinities, infinities give zeros, and
    finite numbers from ``2**(bias - 1)`` on give NaN.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    stages : :class:`int`
        Latency in clocks, 1 to 16. From 7 on, or 10 in formats that use Newton's iteration,
        additional registers only delay the root.
    has_signed : :class:`bool`
        Whether there is :py:`signed`.

    Members
    -------
    a : :py:`In(fmt.width)`
        Operand.
    signed : :py:`In(1)`
        Which root it is.
    root : :py:`Out(fmt.width)`
        Reciprocal square root.

    Attributes
    ----------
    DEFAULT_STAGES : :class:`int`
        Fewest stages that support 100 MHz on a 7-series FPGA in the binary32 format.
    """

    DEFAULT_STAGES = Pipeline.reciprocal_sqrt

    def __init__(self, fmt, *, stages=DEFAULT_STAGES, has_signed=False):
        others = {"signed": In(1)} if has_signed else {}
        super().__init__(fmt, stages, operands=("a",), result="root", others=others)
        self._has_signed = has_signed
        self._params = ReciprocalSqrtParams(fmt=fmt)

    def elaborate(self, platform):
        m = Module()
        params, fmt = self._params, self.fmt
        cuts = _NEWTON_CUTS if params.newton else _CUTS
        pipeline = CutPoints(m, self._stages, cuts)
        a = FloatLayout(fmt)(self.a)

        operand = self._elaborate_operand(m, a)
        index = Cat(a.fraction[-params.index_bits :], ~a.exponent[0])
        *rest, last = self._elaborate_table(m, index, pipeline)
        operand = pipeline.cut("table", operand)

        # c1 + d * c2
        if params.degree == 2:
            product = Signal(signed(params.distance_bits + len(last)), name="slope_product")
            m.d.comb += product.eq(operand.distance * last)
            term = pipeline.cut("slope_product", _Horner(product, tuple(rest), operand))
            *rest, c1 = term.coefficients
            fine_bits = params.c2_fraction_bits + params.distance_fraction_bits
            total = Signal(signed(fine_bits + 1), name="slope_total")
            m.d.comb += total.eq((c1 << (fine_bits - params.c1_fraction_bits)) + term.value)
            slope = total[fine_bits - params.slope_fraction_bits :].as_signed()
            slope = _Horner(slope, tuple(rest), term.operand)
        else:
            slope = pipeline.cut("slope_product", _Horner(last, tuple(rest), operand))
        slope = pipeline.cut("slope", slope)

        # c0 + d * (c1 + d * c2)
        scale_bits = params.slope_fraction_bits + params.distance_fraction_bits
        product = Signal(signed(params.distance_bits + len(slope.value)), name="root_product")
        m.d.comb += product.eq(slope.operand.distance * slope.value)
        term = pipeline.cut("root_product", replace(slope, value=product))
        (c0,) = term.coefficients
        total = Signal(scale_bits + 1, name="root_total")
        m.d.comb += total.eq((c0 << (scale_bits - params.c0_fraction_bits)) + term.value)
        root = total[scale_bits - params.root_fraction_bits :]
        root = pipeline.cut("root", _Horner(root, (), term.operand))

        if params.newton:
            root = self._elaborate_newton(m, pipeline, root)
        operand = root.operand
        # A root of one is one doubling above the others; its fraction is zero.
        exponent = (operand.exponent + root.value[fmt.precision])[: fmt.exponent_bits]
        magnitude = Cat(root.value[: fmt.fraction_bits], exponent)
        pipeline.output(self.root, self._elaborate_result(m, magnitude, operand.special))

        return m

    def _elaborate_operand(self, m, a):
        """Distance, radicand, exponent and special results."""
        params, fmt = self._params, self.fmt
        low = a.fraction[fmt.fraction_bits - params.distance_fraction_bits : -params.index_bits]
        distance = Cat(low[:-1], ~low[-1]).as_signed()
        odd = ~a.exponent[0]
        radicand = Mux(odd, Cat(Const(0, 1), a.significand), Cat(a.significand, Const(0, 1)))
        exponent = Signal(fmt.exponent_bits)
        is_negative = ~a.is_zero & a.sign
        nan = is_negative | a.is_nan
        special = Signal(SPECIAL)
        if self._has_signed:
            is_large = a.is_finite & (a.exponent >= 2 * fmt.bias - 1)
            nan = Mux(self.signed, is_large, is_negative) | a.is_nan
            m.d.comb += [
                special.sign.eq(self.signed & a.sign),
                special.infinite.eq(self.signed & a.is_zero),
            ]
        m.d.comb += [
            # Half the bias, rounded up, comes back when the stored exponent is halved.
            exponent.eq((3 * fmt.bias - 1 - a.exponent) >> 1),
            special.zero.eq(a.is_zero | ~a.is_finite),
            special.nan.eq(nan),
        ]
        return _Operand(distance, radicand if params.newton else Const(0, 1), exponent, special)

    def _elaborate_table(self, m, index, pipeline):
        """Look up the coefficients, with the register of the cut "table" inside the memories."""
        params = self._params
        fractions = [params.c0_fraction_bits, params.c1_fraction_bits, params.c2_fraction_bits]
        columns = list(zip(*params.table, strict=True))
        if params.degree == 1:
            del columns[2]
        widths = []
        # The leading bits that all entries of a coefficient share are not stored.
        shared = []
        for column, fraction_bits in zip(columns, fractions, strict=False):
            full = fraction_bits + 1
            words = [value & ((1 << full) - 1) for value in column]
            width = full
            while len({word >> (width - 1) for word in words}) == 1:
                width -= 1
            widths.append(width)
            shared.append(Const(words[0] >> width, full - width))

        def pack(row):
            packed = position = 0
            for value, width in zip(row, widths, strict=False):
                packed |= (value & ((1 << width) - 1)) << position
                position += width
            return packed

        # A deep table goes to one block RAM, as far as its width reaches, and for the rest to LUTs.
        # That rest includes the coefficient that is multiplied first, which is needed early.
        init = [pack(row) for row in params.table]
        total = sum(widths)
        registered = pipeline.uses("table")
        block_bits = min(total, _BLOCK_BITS)
        if not registered or len(init) < _BLOCK_MIN_DEPTH:
            block_bits = 0
        parts = []
        for name, start, end in (("block", 0, block_bits), ("logic", block_bits, total)):
            if start == end:
                continue
            mask = (1 << (end - start)) - 1
            attributes = {"rom_style": "block"} if name == "block" else {}
            memory = Memory(
                shape=end - start,
                depth=len(init),
                init=[(word >> start) & mask for word in init],
                attrs=attributes,
            )
            port = memory.read_port(domain="sync" if registered else "comb")
            m.submodules[f"{name}_table"] = memory
            m.d.comb += port.addr.eq(index)
            parts.append(port.data)

        row = Cat(*parts)
        coefficients = []
        position = 0
        for width, leading in zip(widths, shared, strict=True):
            coefficients.append(Cat(row[position : position + width], leading))
            position += width
        c0, *others = coefficients
        return c0, *(c.as_signed() for c in others)

    def _elaborate_newton(self, m, pipeline, estimate):
        """Add half of y * (1 - r * y * y) to the root y."""
        params, precision = self._params, self.fmt.precision
        root, operand = estimate.value, estimate.operand
        # r * y
        product = Signal(params.product_fraction_bits + 2, name="newton_product")
        m.d.comb += product.eq((operand.radicand * root) >> (params.root_fraction_bits - 6))
        scaled = pipeline.cut("product", _Newton(product, root, operand))

        # What is above the residual is known: it is small.
        residual_end = params.root_fraction_bits + params.residual_bits
        square = Signal(residual_end, name="newton_square")
        residual = Signal(signed(params.residual_bits), name="newton_residual")
        m.d.comb += [
            square.eq(-(scaled.value * scaled.root)),
            residual.eq(square[params.root_fraction_bits :]),
        ]
        error = pipeline.cut("residual", replace(scaled, value=residual))

        drop = params.product_fraction_bits + params.root_fraction_bits + 1 - precision
        correction = Signal(signed(params.residual_bits + len(root) + 1), name="correction")
        m.d.comb += correction.eq(error.root * error.value + (1 << (drop - 1)))
        step = pipeline.cut("correction", replace(error, value=correction))

        refined = Signal(precision + 1)
        m.d.comb += refined.eq(
            (step.root << (precision - params.root_fraction_bits)) + (step.value >> drop)
        )
        return replace(step, value=refined)
