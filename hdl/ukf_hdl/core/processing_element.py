"""Processing element: a lane of the array."""

from amaranth import Module, Mux, Signal, unsigned
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ukf_hdl.arithmetic.float_adder import FloatAdder
from ukf_hdl.arithmetic.float_multiplier import FloatMultiplier
from ukf_sw.engine.control_word import STEERING

__all__ = ["ProcessingElement"]


class ProcessingElement(wiring.Component):
    """One multiplier, one adder and one slice of the memory.

    On every clock two words are read, at :py:`address_0` and :py:`address_1`. Two clocks later
    they are operands: `a` is the first word, or the scalar if :py:`use_scalar`; `b` is the second
    word, with its sign turned if :py:`subtract`; `c` is the first word, or zero if :py:`zero`.
    The steering inputs and the scalar are due one clock after the addresses.

    :py:`pipeline.multiply` clocks later, on the clock of :py:`drop_product` and :py:`in_tree`,
    :py:`product` is `a * b`, or zero if :py:`drop_product`, and the adder adds product and `c`, or
    if :py:`in_tree`, :py:`left` and :py:`right`. The result is on :py:`sum`,
    :py:`pipeline.add` clocks later.

    A write takes :py:`bus` or, unless :py:`clear` makes it zero, :py:`sum`; the word can be read
    from the next clock on. A word that is read on the clock on which it is written is undefined.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    pipeline : :class:`ukf_sw.spec.parameters.Pipeline`
        Depths of multiplier and adder.
    words : :class:`list` of :class:`int`
        Initial contents of the memory; as many as it has words.

    Members
    -------
    address_0, address_1 : :py:`In(address_width)`
        Words to read.
    scalar : :py:`In(fmt.width)`
        Scalar operand.
    use_scalar, zero, subtract : :py:`In(1)`
        Steering of the operands: the fields of :py:`STEERING`.
    word_0 : :py:`Out(fmt.width)`
        Operand `c`: the first word, two clocks after its address.
    drop_product, in_tree : :py:`In(1)`
        Steering of the adder.
    product, sum : :py:`Out(fmt.width)`
        Results.
    left, right : :py:`In(fmt.width)`
        What the adder adds as a part of the tree.
    write_address : :py:`In(address_width)`
        Word to write.
    write_enable : :py:`In(ceil(fmt.width / 8))`
        Bytes to write.
    write_bus, clear : :py:`In(1)`
        What to write.
    bus : :py:`In(fmt.width)`
        Scalar bus.
    is_finite : :py:`Out(1)`
        What would be written is neither infinite nor NaN.
    """

    def __init__(self, fmt, pipeline, words):
        self._fmt = fmt
        self._pipeline = pipeline
        self._words = words
        address_width = (len(words) - 1).bit_length()
        number, flag = fmt.width, 1
        super().__init__({
            "address_0": In(address_width), "address_1": In(address_width),
            "scalar": In(number), **{name: In(width) for name, width in STEERING.items()},
            "word_0": Out(number),
            "drop_product": In(flag), "in_tree": In(flag),
            "product": Out(number), "sum": Out(number), "left": In(number), "right": In(number),
            "write_address": In(address_width), "write_enable": In(-(-fmt.width // 8)),
            "write_bus": In(flag), "clear": In(flag), "bus": In(number),
            "is_finite": Out(flag),
        })  # fmt: skip

    def elaborate(self, platform):
        m = Module()
        fmt, pipeline = self._fmt, self._pipeline
        word = unsigned(fmt.width)
        written = Signal(word)

        # One copy of the memory for each read port; both are written.
        data = []
        byte_wide = unsigned(8 * len(self.write_enable))
        for port, address in enumerate((self.address_0, self.address_1)):
            memory = Memory(shape=byte_wide, depth=len(self._words), init=self._words)
            m.submodules[f"memory_{port}"] = memory
            read = memory.read_port()
            write = memory.write_port(granularity=8)
            m.d.comb += [
                read.addr.eq(address),
                write.addr.eq(self.write_address),
                write.data.eq(written),
                write.en.eq(self.write_enable),
            ]
            data.append(read.data[: fmt.width])

        # Operands. A subtraction turns the sign of b, so that of the product.
        a, b, c = (Signal(word, name=name, reset_less=True) for name in "abc")
        m.d.sync += [
            a.eq(Mux(self.use_scalar, self.scalar, data[0])),
            b.eq(data[1] ^ (self.subtract << (fmt.width - 1))),
            c.eq(Mux(self.zero, 0, data[0])),
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
        with m.If(self.write_bus):
            m.d.comb += written.eq(self.bus)
        with m.Elif(~self.clear):
            m.d.comb += written.eq(self.sum)
        exponent = written[fmt.fraction_bits : fmt.width - 1]
        m.d.comb += self.is_finite.eq(~exponent.all())
        return m
