"""Sequencer: fetches control words."""

from amaranth import Module, Mux, Signal, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ukf_sw.engine.programs import Program

__all__ = ["Sequencer", "control_layout"]


def control_layout(control_format):
    """Layout of the control word of a :class:`ukf_sw.engine.control_word.ControlFormat`."""
    return data.StructLayout({
        field.name: field.width for field in control_format.fields.values()
    })  # fmt: skip


class Sequencer(wiring.Component):
    """Fetches a program's control words, one a clock, from the second clock after its start.

    On the clock of :py:`start` the address of the first word goes to the program memory; the word
    is in the memory's output register one clock later, and is executed on the clock after that.
    The clock after the last word has :py:`done`.

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
    program : :py:`In(Program)`
        Which one; valid with :py:`start`.
    stop : :py:`In(1)`
        End it.
    word : :py:`Out(control_layout(microcode.format))`
        Control word.
    busy : :py:`Out(1)`
        High from the clock after the start up to and including the clock of :py:`done`.
    done : :py:`Out(1)`
        Strobe after the last word, not after a stop.
    """

    def __init__(self, microcode):
        self._microcode = microcode
        super().__init__({
            "start":   In(1),
            "program": In(range(len(Program))),
            "stop":    In(1),
            "word":    Out(control_layout(microcode.format)),
            "busy":    Out(1),
            "done":    Out(1),
        })  # fmt: skip

    def elaborate(self, platform):
        m = Module()
        code = self._microcode
        memory = Memory(
            shape=unsigned(code.format.width), depth=max(len(code.words), 2),
            init=code.words,
        )  # fmt: skip
        m.submodules.program_memory = memory
        read = memory.read_port()

        following = Signal(range(len(code.words) + 2))  # address after the one being fetched
        fetching = Signal()  # addresses go to the memory
        fetched = Signal()  # the memory's output register holds a word
        execute = Signal()  # so does the word register
        ends = Signal()

        with m.If(self.start):
            with m.Switch(self.program):
                for program in Program:
                    with m.Case(program):
                        m.d.comb += read.addr.eq(code.entry[program])
        with m.Else():
            m.d.comb += read.addr.eq(following)
        m.d.comb += [
            read.en.eq(self.start | fetching),
            ends.eq(execute & self.word.last),
        ]
        with m.If(read.en):
            m.d.sync += following.eq(read.addr + 1)
        m.d.sync += [
            fetched.eq(self.start | fetching),
            execute.eq(fetched),
            self.word.eq(Mux(fetched, read.data, 0)),
            self.done.eq(ends & ~self.stop),
        ]
        with m.If(self.start):
            m.d.sync += fetching.eq(1)
        with m.If(ends | self.stop):
            m.d.sync += [fetching.eq(0), fetched.eq(0), execute.eq(0), self.word.eq(0)]
        m.d.comb += self.busy.eq(fetching | fetched | execute | self.done)
        return m
