"""Processing element: a lane of the array."""

from amaranth import Cat, Const, Module, Mux, Signal, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ukf_hdl.arithmetic.float_adder import FloatAdder
from ukf_hdl.arithmetic.float_layout import FloatLayout
from ukf_hdl.arithmetic.float_multiplier import FloatMultiplier
from ukf_hdl.arithmetic.pipelining import delay
from ukf_hdl.core.operand_reader import CONDITIONS, READINGS, OperandReader
from ukf_hdl.memory_style import ram_style

__all__ = ["OperandSignature", "ProcessingElement", "WriteSignature"]


class OperandSignature(wiring.Signature):
    """What lanes read and make operands of, seen from who decides.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    address_width : :class:`int`
        Width of an address within a lane.
    steering : iterable of :class:`str`
        Those of :data:`STEERING` that there are.

    Members
    -------
    address_0, address_1 : :py:`Out(address_width)`
        Words to read.
    scalar : :py:`Out(fmt.width)`
        Scalar operand.
    steering : :py:`Out(StructLayout(...))`
        Steering of the operands.
    """

    def __init__(self, fmt, address_width, steering):
        super().__init__({
            "address_0": Out(address_width),
            "address_1": Out(address_width),
            "scalar":    Out(fmt.width),
            "steering":  Out(data.StructLayout(dict.fromkeys(steering, 1))),
        })  # fmt: skip


class WriteSignature(wiring.Signature):
    """A write to the memory of a lane, seen from who decides.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    address_width : :class:`int`
        Width of an address within a lane.

    Members
    -------
    address : :py:`Out(address_width)`
        Word to write.
    enable : :py:`Out(ceil(fmt.width / 8))`
        Bytes to write.
    bus : :py:`Out(fmt.width)`
        Scalar bus.
    from_bus, clear : :py:`Out(1)`
        What to write: the bus; zero in the place of the lane's sum.
    """

    def __init__(self, fmt, address_width):
        super().__init__({
            "address":  Out(address_width),
            "enable":   Out(-(-fmt.width // 8)),
            "bus":      Out(fmt.width),
            "from_bus": Out(1),
            "clear":    Out(1),
        })  # fmt: skip


class ProcessingElement(wiring.Component):
    """One multiplier, one adder and one slice of the memory.

    On every clock two words are read, at the addresses of :py:`operands`. Two clocks later they
    are operands: `a` is the first word, or the scalar if :py:`use_scalar`; `b` is what
    :class:`OperandReader` makes of the words, the second with its sign turned if
    :py:`subtract`; `c` is the first word, or the scalar if :py:`scalar_addend`, or if :py:`zero`,
    plus zero, minus zero if :py:`minus_zero` too. The steering inputs and the scalar are due one
    clock after the addresses.

    :py:`pipeline.multiply` clocks later, on the clock of :py:`drop_product` and :py:`in_tree`,
    :py:`product` is `a * b`, or zero if :py:`drop_product`, and the adder adds product and `c`, or
    if :py:`in_tree`, :py:`left` and :py:`right`. The result is on :py:`sum`,
    :py:`pipeline.add` clocks later.

    A write takes the bus if :py:`from_bus` or else, unless :py:`clear` makes it zero, :py:`sum`;
    the word can be read from the next clock on. A word that is read on the clock on which it is
    written is undefined.

    On the clock of :py:`sum` the lane keeps what it has, whatever :py:`write.enable` says, if the
    steering of its operands had a condition that is not met: those of :class:`OperandReader`, or
    :py:`if_finite`, if what would be written is not finite. The bus is always written.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    pipeline : :class:`ukf_sw.spec.parameters.Pipeline`
        Depths of multiplier and adder.
    words : :class:`list` of :class:`int`
        Initial contents of the memory; as many as it has words.
    steering : iterable of :class:`str`
        Those of :data:`ukf_sw.engine.control_word.STEERING` that there are.

    Members
    -------
    operands : :py:`In(OperandSignature(...))`
        Words to read, and what they become.
    word_0 : :py:`Out(fmt.width)`
        Operand `c`: the first word, two clocks after its address.
    drop_product, in_tree : :py:`In(1)`
        Steering of the adder.
    product, sum : :py:`Out(fmt.width)`
        Results.
    left, right : :py:`In(fmt.width)`
        What the adder adds as a part of the tree.
    write : :py:`In(WriteSignature(...))`
        Word to write, and what.
    is_finite : :py:`Out(1)`
        What would be written is neither infinite nor NaN, or the lane keeps what it has.
    """

    def __init__(self, fmt, pipeline, words, steering):
        self._fmt = fmt
        self._pipeline = pipeline
        self._words = words
        self._steering = tuple(steering)
        address_width = (len(words) - 1).bit_length()
        super().__init__({
            "operands":     In(OperandSignature(fmt, address_width, self._steering)),
            "word_0":       Out(fmt.width),
            "drop_product": In(1),
            "in_tree":      In(1),
            "product":      Out(fmt.width),
            "sum":          Out(fmt.width),
            "left":         In(fmt.width),
            "right":        In(fmt.width),
            "write":        In(WriteSignature(fmt, address_width)),
            "is_finite":    Out(1),
        })  # fmt: skip

    def elaborate(self, platform):
        m = Module()
        fmt, pipeline = self._fmt, self._pipeline
        operands, steering = self.operands, self.operands.steering
        word = unsigned(fmt.width)
        written = Signal(FloatLayout(fmt))
        enable = self.write.enable
        kept = Signal()  # whatever is enabled
        has_conditions = self._has(*CONDITIONS, "if_finite")
        if has_conditions:
            enable = enable & ~kept.replicate(len(enable))

        # One copy of the memory for each read port; both are written.
        words = []
        byte_wide = unsigned(8 * len(self.write.enable))
        for port, address in enumerate((operands.address_0, operands.address_1)):
            memory = Memory(
                shape=byte_wide,
                depth=len(self._words),
                init=self._words,
                attrs=ram_style(len(self._words), byte_wide.width),
            )
            m.submodules[f"memory_{port}"] = memory
            read = memory.read_port()
            write = memory.write_port(granularity=8)
            m.d.comb += [
                read.addr.eq(address),
                write.addr.eq(self.write.address),
                write.data.eq(written),
                write.en.eq(enable),
            ]
            words.append(read.data[: fmt.width])

        # Operands. A subtraction turns the sign of b, so that of the product.
        read_b = words[1] ^ (steering.subtract << (fmt.width - 1))
        keep = Const(0, 1)
        if self._has(*READINGS, *CONDITIONS):
            m.submodules.reader = reader = OperandReader(fmt, self._steering)
            m.d.comb += [
                reader.word_0.eq(words[0]),
                reader.word_1.eq(words[1]),
                reader.steering.eq(steering),
            ]
            read_b, keep = reader.b, reader.keep
        a, b, c = (Signal(word, name=name, reset_less=True) for name in "abc")
        m.d.sync += [
            a.eq(Mux(steering.use_scalar, operands.scalar, words[0])),
            b.eq(read_b),
            c.eq(self._addend(words[0])),
        ]

        # Multiplier, and c in step with it.
        m.submodules.multiplier = multiplier = FloatMultiplier(fmt, stages=pipeline.multiply)
        delayed = c
        for _ in range(pipeline.multiply):
            before, delayed = delayed, Signal(word, name="c_delayed", reset_less=True)
            m.d.sync += delayed.eq(before)
        m.d.comb += [
            self.word_0.eq(c),
            multiplier.a.eq(a),
            multiplier.b.eq(b),
            self.product.eq(Mux(self.drop_product, 0, multiplier.product)),
        ]

        m.submodules.adder = adder = FloatAdder(fmt, stages=pipeline.add)
        m.d.comb += [
            adder.a.eq(Mux(self.in_tree, self.left, self.product)),
            adder.b.eq(Mux(self.in_tree, self.right, delayed)),
            self.sum.eq(adder.sum),
        ]

        # Write.
        with m.If(self.write.from_bus):
            m.d.comb += written.eq(self.write.bus)
        with m.Elif(~self.write.clear):
            m.d.comb += written.eq(self.sum)
        is_finite = written.is_finite
        if has_conditions:
            m.d.comb += kept.eq(self._keeps(m, keep, written))
            is_finite = is_finite | kept
        m.d.comb += self.is_finite.eq(is_finite)
        return m

    def _has(self, *names):
        """Whether there is one of some steering inputs."""
        return not set(names).isdisjoint(self._steering)

    def _addend(self, word_0):
        """Operand c."""
        steering = self.operands.steering
        addend, zero = word_0, 0
        if self._has("scalar_addend"):
            addend = Mux(steering.scalar_addend, self.operands.scalar, word_0)
        if self._has("minus_zero"):
            zero = Cat(Const(0, self._fmt.width - 1), steering.minus_zero)
        return Mux(steering.zero, zero, addend)

    def _keeps(self, m, keep, written):
        """Whether the lane keeps what it has; decided with the operands, due with their sum."""
        latency = 1 + self._pipeline.multiply + self._pipeline.add
        reasons = []
        if self._has(*CONDITIONS):
            reasons.append(delay(m, keep, latency, "kept"))
        if self._has("if_finite"):
            if_finite = delay(m, self.operands.steering.if_finite, latency, "if_finite")
            reasons.append(if_finite & ~written.is_finite)
        return Cat(reasons).any() & ~self.write.from_bus
