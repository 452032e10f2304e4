"""The core: bus, registers, buffer and engine."""

from amaranth import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ukf_hdl.core import axi4_lite
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
        m.submodules.control = control = self._control
        m.submodules.buffer = buffer = self._buffer
        m.submodules.engine = engine = self._engine
        connect(m, flipped(self.s_axi), front_end.s_axi)

        # Accesses: region 0 is the register block.
        access = front_end.access
        to_buffer = access.address[-self._map.region_bits :].any()
        for target in (control.access, buffer.access):
            m.d.comb += [
                target.write.eq(access.write),
                target.address.eq(access.address),
                target.data.eq(access.data),
                target.strobe.eq(access.strobe),
            ]
        with m.If(to_buffer):
            m.d.comb += [
                buffer.access.valid.eq(access.valid),
                access.ack.eq(buffer.access.ack),
                access.error.eq(buffer.access.error),
                access.read_data.eq(buffer.access.read_data),
            ]
        with m.Else():
            m.d.comb += [
                control.access.valid.eq(access.valid),
                access.ack.eq(control.access.ack),
                access.error.eq(control.access.error),
                access.read_data.eq(control.access.read_data),
            ]

        # Steps.
        m.d.comb += [
            self.irq.eq(control.irq),
            engine.start.eq(control.start),
            engine.program.eq(control.program),
            engine.stop.eq(control.stop),
            engine.observation_mask.eq(control.observation_mask),
            engine.state_bank.eq(control.state_bank),
            engine.factor_bank.eq(control.factor_bank),
            control.done.eq(engine.done),
            control.error_code.eq(engine.error_code),
            control.error_index.eq(engine.error_index),
            control.nis.eq(engine.nis),
        ]

        # Buffer.
        m.d.comb += [
            buffer.busy.eq(control.busy),
            buffer.state_bank.eq(control.state_bank),
            buffer.factor_bank.eq(control.factor_bank),
            control.state_written.eq(buffer.state_written),
            control.factor_written.eq(buffer.factor_written),
            engine.buffer_lane.eq(buffer.lane),
            engine.buffer_address.eq(buffer.address),
            engine.buffer_write.eq(buffer.write),
            engine.buffer_write_data.eq(buffer.write_data),
            engine.buffer_write_strobe.eq(buffer.write_strobe),
            buffer.read_data.eq(engine.buffer_read_data),
        ]
        return m
