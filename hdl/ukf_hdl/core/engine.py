"""Engine: the array of processing elements, its special unit, and the sequencer that drives it."""

from dataclasses import dataclass

from amaranth import Array, Cat, Const, Module, Mux, Signal, unsigned
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out, connect

from ukf_hdl.arithmetic.float_layout import FloatLayout, FloatView
from ukf_hdl.arithmetic.pipelining import delay
from ukf_hdl.arithmetic.reciprocal_sqrt import ReciprocalSqrt
from ukf_hdl.core.processing_element import OperandSignature, ProcessingElement
from ukf_hdl.core.sequencer import Sequencer
from ukf_hdl.core.signatures import EstimateSignature, MemorySignature, RunSignature
from ukf_sw.engine.adder_tree import adder_tree
from ukf_sw.engine.control_word import STEERING, BusSource
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.pivots import noise_exponent
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode

__all__ = ["Engine"]


@dataclass(frozen=True, eq=False)
class _Bus:
    """The scalar bus."""

    source: FloatView  # what is led to it
    value: FloatView  # what is on it: zero in the place of a masked observation


class Engine(wiring.Component):
    """Executes the programs of the filter.

    There are no interlocks: the schedule of the programs decides what meets where, and
    :meth:`Microcode.clocks` says how long each takes, whatever the data.

    A pivot that is not legal, and a number that is not finite and about to be written, is an
    error. The first error is kept, and neither its word nor any later one of the program writes
    anything. The program runs to its end all the same. A number that is not finite in the result
    of a model is an error of that model, with the row of the result as its index; what words say
    is unchecked may be infinite or NaN.

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
    run : :py:`In(RunSignature(params))`
        Start, stop and result of a program. The result holds until the next start.
    busy : :py:`Out(1)`
        High from the clock after the start up to and including the clock of :py:`run.done`.
    banks : :py:`In(EstimateSignature())`
        Current copies of x and of L; a program reads these and writes the others.
    memory : :py:`In(MemorySignature(...))`
        Access to the memories, while not :py:`busy`.

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
        super().__init__({
            "run":    In(RunSignature(params)),
            "busy":   Out(1),
            "banks":  In(EstimateSignature()),
            "memory": In(MemorySignature(params, self.layout.address_width)),
        })  # fmt: skip

    @property
    def layout(self):
        """Where the vectors live in the memories."""
        return self._code.layout

    def elaborate(self, platform):
        m = Module()
        word = self._elaborate_sequencer(m)
        lanes = self._elaborate_lanes(m)

        # From the lanes to the scalar bus, and to what may be written.
        loaded = self._elaborate_load(m, word, lanes)
        bus = self._elaborate_bus(m, word, loaded, lanes[-1].sum)
        noise = self._elaborate_noise(m, word, bus)
        passed = self._elaborate_checks(m, word, bus, noise, lanes)

        # And back to the lanes.
        scalar = self._elaborate_scalar_file(m, word, bus, passed)
        self._elaborate_operands(m, word, scalar, lanes)
        self._elaborate_tree(m, word, lanes)
        self._elaborate_writes(m, word, bus, passed, lanes)
        return m

    def _elaborate_sequencer(self, m):
        """The control word of this clock."""
        m.submodules.sequencer = sequencer = Sequencer(self._code)
        m.d.comb += [
            sequencer.start.eq(self.run.start),
            sequencer.program.eq(self.run.program),
            sequencer.sensor.eq(self.run.sensor),
            sequencer.variant.eq(self.run.variant),
            sequencer.stop.eq(self.run.stop),
            self.busy.eq(sequencer.busy),
            self.run.done.eq(sequencer.done),
        ]
        return sequencer.word

    def _elaborate_lanes(self, m):
        """The processing elements, with the constants in their memories."""
        words = self.layout.initial_words()
        lanes = []
        for lane in range(self._params.pes):
            element = ProcessingElement(
                self._params.format, self._code.pipeline, [int(w) for w in words[lane]],
                self._code.format.present(STEERING),
            )  # fmt: skip
            m.submodules[f"lane_{lane}"] = element
            lanes.append(element)
        return lanes

    def _has(self, name):
        """Whether control words have a field."""
        return bool(self._code.format.present((name,)))

    def _lane_set(self, number):
        """Lanes of a numbered set."""
        sets = self._code.lane_sets
        return Array(Const(lanes, self._params.pes) for lanes in sets)[number]

    def _is_masked(self, observation):
        """Whether 1 + an observation, or 0 for none, is masked."""
        return ~Cat(1, self.run.observation_mask).bit_select(observation, 1)

    def _elaborate_load(self, m, word, lanes):
        """One lane of port 0: to the bus, and to who reads the memories."""
        select = Signal(range(max(len(lanes), 2)))
        m.d.comb += select.eq(Mux(self.busy, word.select, self.memory.lane))
        select = delay(m, select, LOAD_LATENCY - 1, "load_select")
        loaded = Signal(self._params.format.width, reset_less=True)
        m.d.sync += loaded.eq(Array(lane.word_0 for lane in lanes)[select])
        m.d.comb += self.memory.read_data.eq(loaded)
        return loaded

    def _elaborate_bus(self, m, word, loaded, accumulated):
        """The scalar bus, and the reciprocal square root behind it."""
        fmt = self._params.format
        has_signed = self._has("signed")
        m.submodules.reciprocal_sqrt = unit = ReciprocalSqrt(
            fmt, stages=self._code.pipeline.reciprocal_sqrt, has_signed=has_signed
        )
        number = FloatLayout(fmt)
        source = Signal(fmt.width)
        value = Signal(fmt.width, name="bus")
        bus = _Bus(source=number(source), value=number(value))
        with m.Switch(word.bus_source):
            with m.Case(BusSource.LOAD):
                m.d.comb += source.eq(loaded)
            with m.Case(BusSource.ROOT):
                m.d.comb += source.eq(unit.root)
            with m.Default():
                m.d.comb += source.eq(accumulated)
        m.d.comb += unit.a.eq(source)
        if has_signed:
            m.d.comb += unit.signed.eq(word.signed)
        with m.If(~self.busy):
            m.d.comb += value.eq(self.memory.write_data)
        with m.Elif(~self._is_masked(word.bus_observation)):
            m.d.comb += value.eq(source)
        return bus

    def _elaborate_noise(self, m, word, bus):
        """Below which exponent a pivot of the observation on the bus is rounding noise.

        For every observation row a small memory holds that of its largest coupling so far, once
        there is one.
        """
        params = self._params
        if params.m == 1:
            return Const(0)
        exponent = bus.source.exponent
        limit = Signal(params.format.exponent_bits + 1)
        margin = params.format.bias + noise_exponent(params)
        with m.If(exponent.shift_left(1) > margin):
            m.d.comb += limit.eq(exponent.shift_left(1) - margin)

        m.submodules.limits = limits = Memory(shape=limit.shape(), depth=params.m + 1, init=[])
        read = limits.read_port(domain="comb")
        write = limits.write_port()
        seen = Signal(params.m + 1)
        is_seen = seen.bit_select(word.row, 1)
        is_coupling = (word.row != 0) & word.coupling
        m.d.comb += [
            read.addr.eq(word.row),
            write.addr.eq(word.row),
            write.data.eq(limit),
            write.en.eq(is_coupling & (~is_seen | (limit > read.data))),
        ]
        with m.If(self.run.start):
            m.d.sync += seen.eq(0)
        with m.Elif(is_coupling):
            m.d.sync += seen.bit_select(word.row, 1).eq(1)
        return Mux(is_seen, read.data, 0)

    def _elaborate_checks(self, m, word, bus, noise, lanes):
        """The first error, the NIS, and whether what this word writes may be written."""
        run, rows = self.run, self._params.m
        written = self._lane_set(word.write_lanes)
        write, scalar_write = word.write, word.scalar_write
        if self._has("unchecked"):
            # A number on the bus that may be anything can meet a result of a model in the lanes.
            write &= word.of_model | ~word.unchecked
            scalar_write &= ~word.unchecked
        bad_lanes = Signal(self._params.pes)
        bad_scalar = Signal()
        m.d.comb += [
            bad_lanes.eq(Mux(write, ~Cat(lane.is_finite for lane in lanes) & written, 0)),
            bad_scalar.eq(scalar_write & ~bus.value.is_finite),
        ]

        # A pivot: what is on the bus before any mask.
        pivot = bus.source
        is_pivot = (word.row != 0) & ~word.coupling
        if self._has("of_model"):
            is_pivot = is_pivot & ~word.of_model
        is_positive = ~pivot.sign & ~pivot.is_zero & ~pivot.is_nan
        row = (word.row - 1)[: len(word.row)]
        is_observation = word.row <= rows
        in_use = Cat(1, run.observation_mask).bit_select(word.row, 1)
        square_root = Const(self._params.form is Form.SQUARE_ROOT, 1)
        zero_is_legal = Mux(is_observation, ~in_use, square_root)
        is_noise = is_observation & ~pivot.is_zero & pivot.is_finite & (pivot.exponent < noise)
        bad_pivot = Signal()
        m.d.comb += bad_pivot.eq(
            is_pivot & (~(is_positive | pivot.is_zero & zero_is_legal) | is_noise)
        )

        # What is not finite, and what of it does not come of a large innovation.
        lane = self.layout.elimination_rhs % self._params.pes
        of_innovation = Const(1 << lane, self._params.pes) & word.innovation.replicate(
            self._params.pes
        )
        bad_root = is_pivot & ~pivot.is_finite
        not_finite = Signal()
        other = Signal()
        m.d.comb += [
            not_finite.eq(bad_lanes.any() | bad_scalar | bad_root),
            other.eq((bad_lanes & ~of_innovation).any() | (bad_scalar & ~word.nis) | bad_root),
        ]

        failed = run.error_code != ErrorCode.NONE
        passed = Signal()
        m.d.comb += passed.eq(~failed & ~bad_pivot & ~not_finite)
        with m.If(run.start):
            m.d.sync += [
                run.error_code.eq(ErrorCode.NONE),
                run.error_index.eq(0),
                run.innovation_overflow.eq(0),
            ]
        with m.Elif(~failed):
            with m.If(bad_pivot & is_observation):
                m.d.sync += [
                    run.error_code.eq(ErrorCode.SINGULAR_OBSERVATION),
                    run.error_index.eq(row),
                ]
            with m.Elif(bad_pivot):
                m.d.sync += [
                    run.error_code.eq(ErrorCode.NOT_POSITIVE_DEFINITE),
                    run.error_index.eq(row - rows),
                ]
            with m.Elif(not_finite):
                m.d.sync += [
                    run.error_code.eq(ErrorCode.NOT_FINITE),
                    run.innovation_overflow.eq(~other),
                ]
                if self._has("of_model"):
                    with m.If(word.of_model & bad_lanes.any()):
                        m.d.sync += [
                            run.error_code.eq(
                                Mux(is_observation, ErrorCode.MODEL_H, ErrorCode.MODEL_F)
                            ),
                            run.error_index.eq(Mux(is_observation, row, row - rows)),
                            run.innovation_overflow.eq(0),
                        ]
        with m.If(passed & word.nis):
            m.d.sync += run.nis.eq(bus.value)
        return passed

    def _elaborate_scalar_file(self, m, word, bus, passed):
        """The scalar operand of the lanes, from what was on the bus before."""
        scalar_file = Memory(
            shape=unsigned(self._params.format.width), depth=max(self._code.scalars, 2), init=[]
        )
        m.submodules.scalar_file = scalar_file
        # Read without a clock; the register behind it is the memories' read clock, so a tool may
        # also take a block memory.
        read = scalar_file.read_port(domain="comb")
        write = scalar_file.write_port()
        m.d.comb += [
            read.addr.eq(word.scalar_address),
            write.addr.eq(word.scalar_write_address),
            write.data.eq(bus.value),
            write.en.eq(passed & word.scalar_write),
        ]
        return delay(m, read.data, 1, "scalar")

    def _elaborate_operands(self, m, word, scalar, lanes):
        """Addresses and steering, the same for all lanes."""
        width = self.layout.address_width
        names = self._code.format.present(STEERING)
        signature = OperandSignature(self._params.format, width, names)
        operands = signature.create(path=("operands",))
        bank_0 = word.bank_state_0 & self.banks.state | word.bank_factor_0 & self.banks.factor
        bank_1 = word.bank_factor_1 & self.banks.factor
        steering = delay(m, Cat(word[name] for name in names), 1, "steering")
        with m.If(self.busy):
            m.d.comb += operands.address_0.eq(word.address_0 | bank_0 << (width - 1))
        with m.Else():
            m.d.comb += operands.address_0.eq(self.memory.address)
        m.d.comb += [
            operands.address_1.eq(word.address_1 | bank_1 << (width - 1)),
            operands.scalar.eq(scalar),
            operands.steering.eq(steering),
        ]
        connect(m, operands, *(lane.operands for lane in lanes))

    def _elaborate_tree(self, m, word, lanes):
        """The adders as the tree of the dot product, and the last one as its accumulator."""
        pes, timing = self._params.pes, self._code.timing
        add = timing.pipeline.add
        counted = self._lane_set(delay(m, word.select, timing.product - 1, "select"))
        counted = delay(m, counted, 1, "counted")
        # Beats of a program that was stopped must not meet those of the next.
        beats = Signal(timing.accumulate)
        m.d.sync += beats.eq(Mux(self.run.start, 0, Cat(word.dot, beats)))
        dot = [beats[timing.product + level * add - 1] for level in range(timing.levels + 1)]
        first = delay(m, word.first, timing.accumulate, "first")

        def term(source):
            lane = lanes[source.lane]
            value = lane.sum if source.is_sum else lane.product
            return delay(m, value, source.wait * add, f"waiting_{source.lane}")

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

    def _elaborate_writes(self, m, word, bus, passed, lanes):
        """What the word writes, into the bank that is not current; or who writes the memories."""
        width = self.layout.address_width
        written = self._lane_set(word.write_lanes)
        state, factor = ~self.banks.state, ~self.banks.factor
        bank = word.write_bank_state & state | word.write_bank_factor & factor
        masked = self._is_masked(word.lanes_observation)
        for number, lane in enumerate(lanes):
            write = lane.write
            enable = passed & word.write & written[number]
            with m.If(self.busy):
                m.d.comb += [
                    write.address.eq(word.write_address | bank << (width - 1)),
                    write.enable.eq(enable.replicate(len(write.enable))),
                    write.from_bus.eq(word.write_bus),
                ]
            with m.Elif(self.memory.write & (self.memory.lane == number)):
                m.d.comb += [
                    write.address.eq(self.memory.address),
                    write.enable.eq(self.memory.write_strobe),
                    write.from_bus.eq(1),
                ]
            m.d.comb += [write.clear.eq(masked), write.bus.eq(bus.value)]
