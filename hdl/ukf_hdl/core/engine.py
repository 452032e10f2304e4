"""Engine: the array of processing elements, its special unit, and the sequencer that drives it."""

from amaranth import Array, Cat, Const, Module, Mux, Signal, unsigned
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from ukf_hdl.arithmetic.reciprocal_sqrt import ReciprocalSqrt
from ukf_hdl.core.processing_element import ProcessingElement
from ukf_hdl.core.sequencer import Sequencer
from ukf_sw.engine.adder_tree import adder_tree
from ukf_sw.engine.control_word import STEERING, BusSource
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Program

__all__ = ["Engine"]


class Engine(wiring.Component):
    """Executes the programs of the filter.

    There are no interlocks: the schedule of the programs decides what meets where, and
    :meth:`Microcode.clocks` says how long each takes, whatever the data.

    A pivot that is not legal, and a number that is not finite and about to be written, is an
    error. The first error is kept, and neither its word nor any later one of the program writes
    anything. The program runs to its end all the same.

    Between programs the memories are accessible. A read gives the data :py:`LOAD_LATENCY` clocks
    after lane and address.

    Parameters
    ----------
    params : :class:`UkfParams`
        What the core computes.
    pipeline : :class:`Pipeline`
        How it is built.

    Members
    -------
    start : :py:`In(1)`
        Start of a program.
    program : :py:`In(Program)`
        Which one; valid with :py:`start`.
    stop : :py:`In(1)`
        Drops the program that runs.
    busy, done : :py:`Out(1)`
        High from the clock after the start up to and including the clock of :py:`done`; strobe.
    error_code, error_index : :py:`Out(8)`
        First error of the program, as in the register ERROR; valid from :py:`done` until the next
        start.
    nis : :py:`Out(params.format.width)`
        Normalised innovation squared of the last update that reached it.
    observation_mask : :py:`In(params.m)`
        Bit i takes observation i into an update.
    state_bank, factor_bank : :py:`In(1)`
        Current copies of x and of L; a program reads these and writes the others.
    buffer_lane, buffer_address : :py:`In(...)`
        Word to read or write, while not :py:`busy`.
    buffer_read_data : :py:`Out(params.format.width)`
        Word read.
    buffer_write : :py:`In(1)`
        Write on this clock.
    buffer_write_data, buffer_write_strobe : :py:`In(...)`
        Word to write, and its bytes.

    Raises
    ------
    TypeError
        If a parameter is of the wrong kind.
    """

    def __init__(self, params, pipeline):
        if not isinstance(params, UkfParams):
            raise TypeError(f"Parameters must be a UkfParams, not {params!r}")
        if not isinstance(pipeline, Pipeline):
            raise TypeError(f"Pipeline must be a Pipeline, not {pipeline!r}")
        self._params = params
        self._code = microcode(params, pipeline)
        number = params.format.width
        super().__init__({
            "start": In(1), "program": In(range(len(Program))), "stop": In(1),
            "busy": Out(1), "done": Out(1),
            "error_code": Out(8), "error_index": Out(8), "nis": Out(number),
            "observation_mask": In(params.m), "state_bank": In(1), "factor_bank": In(1),
            "buffer_lane": In(range(params.pes)),
            "buffer_address": In(self.layout.address_width),
            "buffer_read_data": Out(number),
            "buffer_write": In(1), "buffer_write_data": In(number),
            "buffer_write_strobe": In(-(-number // 8)),
        })  # fmt: skip

    @property
    def layout(self):
        """Where the vectors live in the memories."""
        return self._code.layout

    def elaborate(self, platform):
        m = Module()
        params, code = self._params, self._code
        fmt, pes = params.format, params.pes

        m.submodules.sequencer = sequencer = Sequencer(code)
        m.d.comb += [
            sequencer.start.eq(self.start),
            sequencer.program.eq(self.program),
            sequencer.stop.eq(self.stop),
            self.busy.eq(sequencer.busy),
            self.done.eq(sequencer.done),
        ]
        word = sequencer.word

        words = self.layout.initial_words()
        lanes = []
        for lane in range(pes):
            element = ProcessingElement(fmt, code.pipeline, [int(w) for w in words[lane]])
            m.submodules[f"lane_{lane}"] = element
            lanes.append(element)

        bus = Signal(fmt.width)
        self._elaborate_reads(m, word, lanes, bus)
        self._elaborate_tree(m, word, lanes)
        loaded = self._elaborate_load(m, word, lanes)
        self._elaborate_bus(m, word, lanes, loaded, bus)
        self._elaborate_writes(m, word, lanes, bus)
        return m

    def _delay(self, m, value, clocks, name):
        """Give a value some clocks later.

        The last register has a reset, which keeps it out of a shift register: those are slow to
        leave.
        """
        for left in reversed(range(clocks)):
            register = Signal(value.shape(), name=name, reset_less=left > 0)
            m.d.sync += register.eq(value)
            value = register
        return value

    def _lane_set(self, number):
        """Lanes of a numbered set."""
        sets = self._code.lane_sets
        return Array(Const(lanes, self._params.pes) for lanes in sets)[number]

    def _elaborate_reads(self, m, word, lanes, bus):
        """Addresses, the scalar file, and the steering of the operands."""
        width = self.layout.address_width
        address_0, address_1 = Signal(width), Signal(width)
        bank_0 = word.bank_state_0 & self.state_bank | word.bank_factor_0 & self.factor_bank
        m.d.comb += address_1.eq(
            word.address_1 | (word.bank_factor_1 & self.factor_bank) << (width - 1)
        )
        with m.If(self.busy):
            m.d.comb += address_0.eq(word.address_0 | bank_0 << (width - 1))
        with m.Else():
            m.d.comb += address_0.eq(self.buffer_address)

        # Read without a clock, so distributed memory; its register is the memories' read clock.
        scalar_file = Memory(
            shape=unsigned(self._params.format.width), depth=max(self._code.scalars, 2), init=[]
        )
        m.submodules.scalar_file = scalar_file
        read, self._scalar_write = scalar_file.read_port(domain="comb"), scalar_file.write_port()
        m.d.comb += [read.addr.eq(word.scalar_address), self._scalar_write.data.eq(bus)]
        scalar = self._delay(m, read.data, 1, "scalar")
        steering = {name: self._delay(m, word[name], 1, name) for name in STEERING}
        for lane in lanes:
            m.d.comb += [
                lane.address_0.eq(address_0),
                lane.address_1.eq(address_1),
                lane.scalar.eq(scalar),
                *(getattr(lane, name).eq(value) for name, value in steering.items()),
            ]

    def _elaborate_tree(self, m, word, lanes):
        """The adders as the tree of the dot product, and the last one as its accumulator."""
        pes, timing = self._params.pes, self._code.timing
        add = timing.pipeline.add
        counted = self._lane_set(self._delay(m, word.select, timing.product - 1, "select"))
        counted = self._delay(m, counted, 1, "counted")
        # Beats of a program that was stopped must not meet those of the next.
        beats = Signal(timing.accumulate)
        m.d.sync += beats.eq(Mux(self.start, 0, Cat(word.dot, beats)))
        dot = [beats[timing.product + level * add - 1] for level in range(timing.levels + 1)]
        first = self._delay(m, word.first, timing.accumulate, "first")

        def term(source):
            lane = lanes[source.lane]
            value = lane.sum if source.is_sum else lane.product
            return self._delay(m, value, source.wait * add, f"waiting_{source.lane}")

        nodes, root = adder_tree(pes)
        for node in nodes:
            m.d.comb += [
                lanes[node.lane].in_tree.eq(dot[node.level]),
                lanes[node.lane].left.eq(term(node.left)),
                lanes[node.lane].right.eq(term(node.right)),
            ]
        # The sum so far leaves the accumulator just as the next beat enters it.
        accumulator = lanes[-1]
        m.d.comb += [
            accumulator.in_tree.eq(dot[timing.levels]),
            accumulator.left.eq(term(root)),
            accumulator.right.eq(Mux(first, 0, accumulator.sum)),
        ]
        for number, lane in enumerate(lanes):
            m.d.comb += lane.drop_product.eq(dot[0] & ~counted[number])

    def _elaborate_load(self, m, word, lanes):
        """One lane of port 0."""
        select = Signal(range(max(len(lanes), 2)))
        m.d.comb += select.eq(Mux(self.busy, word.select, self.buffer_lane))
        select = self._delay(m, select, LOAD_LATENCY - 1, "load_select")
        loaded = Signal(self._params.format.width, reset_less=True)
        m.d.sync += loaded.eq(Array(lane.word_0 for lane in lanes)[select])
        m.d.comb += self.buffer_read_data.eq(loaded)
        return loaded

    def _elaborate_bus(self, m, word, lanes, loaded, bus):
        """The scalar bus, and the reciprocal square root behind it."""
        fmt = self._params.format
        m.submodules.reciprocal_sqrt = unit = ReciprocalSqrt(
            fmt, stages=self._code.pipeline.reciprocal_sqrt
        )
        source = Signal(fmt.width)
        with m.Switch(word.bus_source):
            with m.Case(BusSource.LOAD):
                m.d.comb += source.eq(loaded)
            with m.Case(BusSource.ROOT):
                m.d.comb += source.eq(unit.root)
            with m.Default():
                m.d.comb += source.eq(lanes[-1].sum)
        m.d.comb += unit.a.eq(source)
        with m.If(~self.busy):
            m.d.comb += bus.eq(self.buffer_write_data)
        with m.Elif(~self._is_masked(word.bus_observation)):
            m.d.comb += bus.eq(source)
        self._bus_source = source

    def _is_masked(self, observation):
        """Whether 1 + an observation, or 0 for none, is masked."""
        return ~Cat(1, self.observation_mask).bit_select(observation, 1)

    def _elaborate_writes(self, m, word, lanes, bus):
        """Checks, and the writes that pass them."""
        params, width = self._params, self.layout.address_width
        fmt = params.format
        written = self._lane_set(word.write_lanes)
        bus_exponent = bus[fmt.fraction_bits : fmt.width - 1]
        not_finite = Signal()
        m.d.comb += not_finite.eq(
            word.write & Cat(~lane.is_finite for lane in lanes).__and__(written).any()
            | word.scalar_write & bus_exponent.all()
        )

        # A pivot: what is on the bus before any mask.
        pivot = self._bus_source
        magnitude = pivot[: fmt.width - 1]
        exponent = magnitude[fmt.fraction_bits :]
        is_zero = exponent == 0  # subnormal numbers count as zero
        is_positive = ~pivot[-1] & ~is_zero & (magnitude <= fmt.infinity)
        row = (word.pivot - 1)[: len(word.pivot)]
        is_observation = word.pivot <= params.m
        in_use = Cat(1, self.observation_mask).bit_select(word.pivot, 1)
        zero_is_legal = Mux(is_observation, ~in_use, Const(params.form is Form.SQUARE_ROOT, 1))
        bad_pivot = Signal()
        m.d.comb += bad_pivot.eq((word.pivot != 0) & ~(is_positive | is_zero & zero_is_legal))

        failed = self.error_code != ErrorCode.NONE
        passed = Signal()
        m.d.comb += passed.eq(~failed & ~bad_pivot & ~not_finite)
        with m.If(self.start):
            m.d.sync += [self.error_code.eq(ErrorCode.NONE), self.error_index.eq(0)]
        with m.Elif(~failed):
            with m.If(bad_pivot & is_observation):
                m.d.sync += [
                    self.error_code.eq(ErrorCode.SINGULAR_OBSERVATION),
                    self.error_index.eq(row),
                ]
            with m.Elif(bad_pivot):
                m.d.sync += [
                    self.error_code.eq(ErrorCode.NOT_POSITIVE_DEFINITE),
                    self.error_index.eq(row - params.m),
                ]
            with m.Elif(not_finite):
                m.d.sync += self.error_code.eq(ErrorCode.NOT_FINITE)
        with m.If(passed & word.nis):
            m.d.sync += self.nis.eq(bus)
        m.d.comb += [
            self._scalar_write.addr.eq(word.scalar_write_address),
            self._scalar_write.en.eq(passed & word.scalar_write),
        ]

        # What is written goes into the bank that is not current.
        bank = word.write_bank_state & ~self.state_bank | word.write_bank_factor & ~self.factor_bank
        lanes_masked = self._is_masked(word.lanes_observation)
        for number, lane in enumerate(lanes):
            with m.If(self.busy):
                m.d.comb += [
                    lane.write_address.eq(word.write_address | bank << (width - 1)),
                    lane.write_enable.eq((passed & word.write & written[number]).replicate(
                        len(lane.write_enable))),
                    lane.write_bus.eq(word.write_bus),
                ]  # fmt: skip
            with m.Elif(self.buffer_write & (self.buffer_lane == number)):
                m.d.comb += [
                    lane.write_address.eq(self.buffer_address),
                    lane.write_enable.eq(self.buffer_write_strobe),
                    lane.write_bus.eq(1),
                ]
            m.d.comb += [lane.clear.eq(lanes_masked), lane.bus.eq(bus)]
