"""The core: bus, registers, buffer and engine."""

from amaranth import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ukf_hdl.core import axi4_lite
from ukf_hdl.core.access_decoder import AccessDecoder
from ukf_hdl.core.axi4_lite import AxiLiteSubordinate
from ukf_hdl.core.buffer import Buffer
from ukf_hdl.core.control import Control
from ukf_hdl.core.engine import Engine
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline, UkfParams

__all__ = ["UkfCore"]


class UkfCore(wiring.Component):
    """Unscented Kalman filter on AXI4-Lite, with an interrupt.

    The processor sees the map of :class:`ukf_sw.spec.memory_map.MemoryMap`: region 0 holds the
    registers of :mod:`ukf_sw.spec.registers`, the others are the buffer. Counted from the clock on
    which the last part of a request is taken to the first clock of its response: 3 clocks for a
    register and for a write to the buffer, 6 for a read from the buffer.

    Parameters
    ----------
    params : :class:`UkfParams`
        What the core computes.
    pipeline : :class:`Pipeline`
        How it is built.
    engine : :class:`wiring.Component`
        In the place of :class:`ukf_hdl.core.engine.Engine`, for tests.

    Members
    -------
    s_axi : :py:`In(axi4_lite.Signature(...))`
        Bus.
    irq : :py:`Out(1)`
        Interrupt, high while an enabled event is pending.

    Raises
    ------
    TypeError
        If a parameter is of the wrong kind.
    """

    def __init__(self, params, pipeline=None, *, engine=None):
        pipeline = Pipeline() if pipeline is None else pipeline
        if not isinstance(params, UkfParams):
            raise TypeError(f"Parameters must be a UkfParams, not {params!r}")
        if not isinstance(pipeline, Pipeline):
            raise TypeError(f"Pipeline must be a Pipeline, not {pipeline!r}")
        self._params = params
        self._pipeline = pipeline
        if engine is None:
            engine = Engine(params, pipeline)
        self._engine = engine
        self._map = MemoryMap(params)
        self._control = Control(params)
        self._buffer = Buffer(params, engine.layout)
        super().__init__({
            "s_axi": In(axi4_lite.Signature(addr_width=self._map.address_width)),
            "irq":   Out(1),
        })  # fmt: skip

    @property
    def params(self):
        """Parameters given to the constructor."""
        return self._params

    @property
    def pipeline(self):
        """Pipeline given to the constructor."""
        return self._pipeline

    @property
    def register_map(self):
        """Map of the registers as the CSR library resolved it; addresses count words."""
        return self._control.memory_map

    def elaborate(self, platform):
        m = Module()
        m.submodules.front_end = front_end = AxiLiteSubordinate(addr_width=self._map.address_width)
        m.submodules.decoder = decoder = AccessDecoder(self._map)
        m.submodules.control = control = self._control
        m.submodules.buffer = buffer = self._buffer
        m.submodules.engine = engine = self._engine
        connect(m, flipped(self.s_axi), front_end.s_axi)

        connect(m, front_end.access, decoder.access)
        connect(m, decoder.registers, control.access)
        connect(m, decoder.buffer, buffer.access)
        connect(m, control.run, engine.run)
        connect(m, control.banks, engine.banks, buffer.banks)
        connect(m, buffer.memory, engine.memory)
        connect(m, buffer.written, control.written)
        m.d.comb += [buffer.busy.eq(control.busy), self.irq.eq(control.irq)]
        return m
