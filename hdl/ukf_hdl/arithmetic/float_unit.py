"""What the floating-point units have in common."""

from amaranth import Cat, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ukf_sw.spec.float_format import FloatFormat

__all__ = ["FloatUnit"]

MAX_STAGES = 16


class FloatUnit(wiring.Component):
    """A pipelined function of floating-point numbers, one result per clock.

    There is no handshake: operands are taken on every clock, and the result follows
    :py:`stages` clocks later. It does not depend on :py:`stages`.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    stages : :class:`int`
        Latency in clocks, 1 to 16. Beyond the places that a unit has for registers, additional
        ones only delay the result.
    operands : :class:`tuple` of :class:`str`
        Names of the inputs.
    result : :class:`str`
        Name of the output.
    others : :class:`dict`
        Members beside those.

    Raises
    ------
    TypeError
        If :py:`fmt` is not a :class:`FloatFormat`.
    ValueError
        If :py:`stages` is not an integer in range.
    """

    def __init__(self, fmt, stages, *, operands, result, others=None):
        if not isinstance(fmt, FloatFormat):
            raise TypeError(f"Format must be a FloatFormat, not {fmt!r}")
        if stages not in range(1, MAX_STAGES + 1):
            raise ValueError(f"Stages must be between 1 and {MAX_STAGES}, not {stages!r}")
        self._fmt = fmt
        self._stages = stages
        super().__init__({
            **{name: In(fmt.width) for name in operands},
            result: Out(fmt.width),
            **(others or {}),
        })  # fmt: skip

    @property
    def fmt(self):
        """Format given to the constructor."""
        return self._fmt

    @property
    def stages(self):
        """Latency given to the constructor."""
        return self._stages

    def _elaborate_result(self, m, magnitude, special):
        """Put a sign to a number, or something special in its place."""
        fmt = self._fmt
        result = Signal(fmt.width)
        m.d.comb += result.eq(Cat(magnitude, special.sign))
        with m.If(special.nan):
            m.d.comb += result.eq(fmt.nan)
        with m.Elif(special.infinite):
            m.d.comb += result[:-1].eq(fmt.infinity)
        with m.Elif(special.zero):
            m.d.comb += result[:-1].eq(0)
        return result
