"""Unpacker: one word a clock from the packets of a program memory."""

from amaranth import Cat, Module, Mux, Signal, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ukf_hdl.memory_style import ram_style, rom_style
from ukf_sw.engine.packets import DISTANCE_WIDTH

__all__ = ["Unpacker", "word_layout"]


def word_layout(fields):
    """Layout of a word of :class:`ukf_sw.engine.control_word.ControlField`, from bit 0 on."""
    return data.StructLayout({field.name: field.width for field in fields})


class Unpacker(wiring.Component):
    """Unpacks one half of the control words.

    On the clock of :py:`start` the address of the first packet goes to the memory. From the next
    clock on, :py:`run` is high, and every clock gives a word: a packet's own, or one that repeats
    an earlier one, which a small memory holds. A packet is fetched as soon as the one before it
    has given its word, and waits in the memory's output register until the repetitions are over.

    Parameters
    ----------
    stream : :class:`ukf_sw.engine.packets.PacketStream`
        Packets.

    Members
    -------
    start : :py:`In(1)`
        Start of a program.
    program, sensor, variant : :py:`In(range(...))`
        Which one, as in :class:`ukf_hdl.core.signatures.RunSignature`; valid with :py:`start`.
    run : :py:`In(1)`
        The next word is taken. High from the clock after the start until the program ends.
    word : :py:`Out(StructLayout)`
        Next word, without a register.
    """

    def __init__(self, stream):
        self._stream = stream
        super().__init__({
            "start":   In(1),
            "program": In(range(1 + max(routine.program for routine in stream.entry))),
            "sensor":  In(range(1 + max(routine.sensor for routine in stream.entry))),
            "variant": In(range(1 + max(routine.variant for routine in stream.entry))),
            "run":     In(1),
            "word":    Out(word_layout(stream.format.fields)),
        })  # fmt: skip

    def elaborate(self, platform):
        m = Module()
        packets, fmt = self._stream.packets, self._stream.format
        word = word_layout(fmt.fields)
        packet = data.StructLayout({
            "word":     word,
            "count":    fmt.count.width,
            "distance": fmt.distance.width,
            "steps":    data.StructLayout(dict.fromkeys(fmt.half.counting, 1)),
        })  # fmt: skip
        m.submodules.packets = memory = Memory(
            shape=unsigned(fmt.width),
            depth=max(len(packets), 2),
            init=packets,
            attrs=rom_style(len(packets), fmt.width),
        )
        port = memory.read_port()
        fetched = packet(port.data)

        # Repetitions that are left of the packet before the one in the memory's output register.
        left = Signal.like(fetched.count)
        repeat = Signal()  # there are some
        fetch = Signal()
        following = Signal(range(len(packets) + 2))  # address after that of the last fetch
        with m.If(self.start):
            with m.Switch(Cat(self.program, self.sensor, self.variant)):
                for routine, entry in self._stream.entry.items():
                    number = routine.variant << len(self.sensor) | routine.sensor
                    with m.Case(number << len(self.program) | routine.program):
                        m.d.comb += port.addr.eq(entry)
        with m.Else():
            m.d.comb += port.addr.eq(following)
        m.d.comb += [fetch.eq(self.run & ~repeat), port.en.eq(self.start | fetch)]
        with m.If(port.en):
            m.d.sync += following.eq(port.addr + 1)

        # The words given last, read without a clock, so distributed memory.
        m.submodules.history = history = Memory(
            shape=unsigned(fmt.word_width),
            depth=1 << DISTANCE_WIDTH,
            init=[],
            attrs=ram_style(1 << DISTANCE_WIDTH, fmt.word_width, clocked=False),
        )
        write = history.write_port()
        earlier = history.read_port(domain="comb")
        newest = Signal(DISTANCE_WIDTH)  # where the word of this clock goes
        repeated = Signal(DISTANCE_WIDTH)  # where the word that the next one repeats is
        steps = Signal(packet["steps"].shape)
        m.d.comb += [
            write.addr.eq(newest),
            write.data.eq(self.word),
            write.en.eq(self.run),
            earlier.addr.eq(repeated),
        ]

        with m.If(self.start):
            m.d.sync += [left.eq(0), repeat.eq(0)]
        with m.Elif(self.run):
            m.d.sync += newest.eq(newest + 1)
            with m.If(repeat):
                m.d.sync += [
                    left.eq(left - 1),
                    repeat.eq(left != 1),
                    repeated.eq(repeated + 1),
                ]
            with m.Else():
                m.d.sync += [
                    left.eq(fetched.count),
                    repeat.eq(fetched.count != 0),
                    repeated.eq(newest - fetched.distance),
                    steps.eq(fetched.steps),
                ]

        before = word(earlier.data)
        again = Signal(word)
        m.d.comb += again.eq(before)
        for name in fmt.half.counting:
            m.d.comb += again[name].eq(before[name] + steps[name])
        for name in fmt.half.once:
            m.d.comb += again[name].eq(0)
        m.d.comb += self.word.eq(Mux(repeat, again, fetched.word))
        return m
