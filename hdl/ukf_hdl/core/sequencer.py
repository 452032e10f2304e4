"""Sequencer: gives the control words of a program."""

from amaranth import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ukf_hdl.core.signatures import RunSignature
from ukf_hdl.core.unpacker import Unpacker, word_layout

__all__ = ["Sequencer"]


class Sequencer(wiring.Component):
    """Gives a program's control words, one a clock, from the second clock after its start.

    On the clock of :py:`start` the addresses of the first packets go to the program memories; the
    first word is unpacked one clock later, and executed on the clock after that. The clock after
    the last word has :py:`done`.

    When there is no word to execute, the word is zero, which does nothing. :py:`stop` ends the
    program: the word of its clock is the last to be executed. A start while a program runs is not
    allowed.

    Parameters
    ----------
    microcode : :class:`ukf_sw.engine.microcode.Microcode`
        Programs.

    Members
    -------
    start : :py:`In(1)`
        Start of a program.
    program, sensor, variant : :py:`In(range(...))`
        Which one, as in :class:`ukf_hdl.core.signatures.RunSignature`; valid with :py:`start`.
    stop : :py:`In(1)`
        End it.
    word : :py:`Out(StructLayout)`
        Control word.
    busy : :py:`Out(1)`
        High from the clock after the start up to and including the clock of :py:`done`.
    done : :py:`Out(1)`
        Strobe after the last word, not after a stop.
    """

    def __init__(self, microcode):
        self._microcode = microcode
        run = RunSignature(microcode.params)
        super().__init__({
            "start":   In(1),
            "program": In(run.members["program"].shape),
            "sensor":  In(run.members["sensor"].shape),
            "variant": In(run.members["variant"].shape),
            "stop":    In(1),
            "word":    Out(word_layout(microcode.format.fields.values())),
            "busy":    Out(1),
            "done":    Out(1),
        })  # fmt: skip

    def elaborate(self, platform):
        m = Module()
        running = Signal()  # the unpackers give a word
        execute = Signal()  # the register has one
        ends = Signal()
        m.d.comb += ends.eq(execute & self.word.last)
        with m.If(self.start):
            m.d.sync += running.eq(1)
        m.d.sync += [execute.eq(running), self.done.eq(ends & ~self.stop)]
        with m.If(ends | self.stop):
            m.d.sync += [running.eq(0), execute.eq(0)]

        for half, stream in self._microcode.streams.items():
            m.submodules[half.name] = unpacker = Unpacker(stream)
            m.d.comb += [
                unpacker.start.eq(self.start),
                unpacker.program.eq(self.program),
                unpacker.sensor.eq(self.sensor),
                unpacker.variant.eq(self.variant),
                unpacker.run.eq(running),
            ]
            for name in self._microcode.format.present(half.fields):
                m.d.sync += self.word[name].eq(Mux(running, unpacker.word[name], 0))
        with m.If(ends | self.stop):
            m.d.sync += self.word.eq(0)
        m.d.comb += self.busy.eq(running | execute | self.done)
        return m
