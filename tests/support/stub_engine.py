"""A stand-in for the engine: its ports and memories, but no arithmetic.

It lets tests of the bus side run fast and choose what a step results in, and shows what
everything around the engine costs.
"""

from amaranth import Cat, Module, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from ukf_hdl.core.signatures import EstimateSignature, MemorySignature, RunSignature
from ukf_sw.engine.layout import Layout

__all__ = ["StubEngine"]


class StubEngine(wiring.Component):
    """Memories that can be written and read over the bus, and programs that do nothing.

    A program runs for :py:`duration` clocks after :py:`start` and gives the ``stub_`` result.

    Parameters
    ----------
    params : :class:`UkfParams`
        What the core computes.

    Members
    -------
    stub_duration : :py:`In(16)`
        Clocks from start to done, at least 1.
    stub_error_code, stub_error_index, stub_innovation_overflow, stub_nis : :py:`In(...)`
        Result, sampled on the last clock.
    ...
        As :class:`ukf_hdl.core.engine.Engine`.
    """

    def __init__(self, params):
        self.layout = Layout(params)
        width = params.format.width
        self._bytes = -(-width // 8)
        super().__init__({
            "run":                      In(RunSignature(params)),
            "busy":                     Out(1),
            "banks":                    In(EstimateSignature()),
            "memory":                   In(MemorySignature(params, self.layout.address_width)),
            "stub_duration":            In(16, init=1),
            "stub_error_code":          In(8),
            "stub_error_index":         In(8),
            "stub_innovation_overflow": In(1),
            "stub_nis":                 In(width),
        })  # fmt: skip
        depth = params.pes << self.layout.address_width
        self.words = memory.Memory(shape=8 * self._bytes, depth=depth, init=[])

    def word_index(self, lane: int, address: int) -> int:
        """Index in :attr:`words` of a word of a lane."""
        return lane << self.layout.address_width | address

    def elaborate(self, platform):
        """Build the hardware; see the class."""
        m = Module()
        m.submodules.words = self.words
        read = self.words.read_port()
        write = self.words.write_port(granularity=8)

        # Reads take three clocks: address, memory, output.
        place = Cat(self.memory.address, self.memory.lane)
        m.d.sync += [read.addr.eq(place), self.memory.read_data.eq(read.data)]
        m.d.comb += [
            write.addr.eq(place),
            write.data.eq(self.memory.write_data),
            write.en.eq(self.memory.write_strobe & self.memory.write.replicate(self._bytes)),
        ]

        left = Signal(16)
        m.d.comb += [self.busy.eq(left != 0), self.run.done.eq(left == 1)]
        with m.If(self.busy):
            m.d.sync += left.eq(left - 1)
        with m.If(self.run.start):
            m.d.sync += left.eq(self.stub_duration)
        with m.If(self.run.stop):
            m.d.sync += left.eq(0)
        with m.If(self.run.done):
            m.d.comb += [
                self.run.error_code.eq(self.stub_error_code),
                self.run.error_index.eq(self.stub_error_index),
                self.run.innovation_overflow.eq(self.stub_innovation_overflow),
                self.run.nis.eq(self.stub_nis),
            ]
        return m
