"""What the engine has for models only, with control words written by hand."""

import numpy as np
from amaranth.sim import Simulator

from ukf_hdl.core import engine
from ukf_hdl.core.engine import Engine
from ukf_sw.elementary.primitives import evaluate, evaluate_root
from ukf_sw.engine.control_word import READ, WRITE, BusSource, ControlFormat, steering
from ukf_sw.engine.microcode import Microcode, routines
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Root, Sign
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Program

#: Words that the programs use: from where to where.
FROM, TO, ONES = 8, 64, 7


class HandWritten(Microcode):
    """Microcode with all fields and with given words in the place of the programs of the filter."""

    def __init__(self, params, pipeline, programs):
        super().__init__(params, pipeline)
        every = (1 << params.pes) - 1
        self.lane_sets = (every, *(1 << lane for lane in range(params.pes)))
        self.scalars = 4
        self.format = ControlFormat(
            address_width=self.layout.address_width, scalar_width=2,
            lane_sets=len(self.lane_sets), pes=params.pes, observations=params.m,
            rows=params.m + params.n, of_models=READ.fields + WRITE.fields,
        )  # fmt: skip
        self._encoded = {}
        for routine in routines(params):
            words = [dict(word) for word in programs.get(routine.program, [{}])]
            words[-1]["last"] = 1
            self._encoded[routine] = [self.format.encode(word) for word in words]


class Words:
    """Control words of a program: what is read on a clock, and what is written later."""

    def __init__(self, timing):
        self.timing = timing
        self.words = []

    def at(self, clock, **fields):
        while len(self.words) <= clock:
            self.words.append({})
        assert self.words[clock].keys().isdisjoint(fields)
        self.words[clock] |= fields

    def slot(self, clock, form, address_0, address_1, destination, **fields):
        self.at(clock, address_0=address_0, address_1=address_1, **steering(form))
        self.at(clock + self.timing.lanes, write=1, write_address=destination, **fields)


class Bench:
    def __init__(self, ctx, dut, params):
        self.ctx, self.dut, self.params = ctx, dut, params

    async def put(self, address, words):
        ctx, memory = self.ctx, self.dut.memory
        for lane, word in enumerate(np.broadcast_to(words, self.params.pes).tolist()):
            ctx.set(memory.lane, lane)
            ctx.set(memory.address, address)
            ctx.set(memory.write_data, word)
            ctx.set(memory.write_strobe, -1)
            ctx.set(memory.write, 1)
            await ctx.tick()
        ctx.set(memory.write, 0)

    async def get(self, address):
        ctx, memory = self.ctx, self.dut.memory
        words = []
        for lane in range(self.params.pes):
            ctx.set(memory.lane, lane)
            ctx.set(memory.address, address)
            await ctx.tick().repeat(LOAD_LATENCY)
            words.append(ctx.get(memory.read_data))
        return words

    async def run(self, program, mask=-1):
        ctx, run = self.ctx, self.dut.run
        ctx.set(run.observation_mask, mask)
        ctx.set(run.program, program)
        ctx.set(run.start, 1)
        await ctx.tick()
        ctx.set(run.start, 0)
        while not ctx.get(run.done):
            await ctx.tick()
        found = ErrorCode(ctx.get(run.error_code)), ctx.get(run.error_index)
        assert not ctx.get(run.innovation_overflow)
        await ctx.tick()
        return found


def simulate(monkeypatch, params, pipeline, programs, scenario):
    code = HandWritten(params, pipeline, programs)
    monkeypatch.setattr(engine, "microcode", lambda *_: code)
    dut = Engine(params, pipeline)

    async def testbench(ctx):
        await scenario(Bench(ctx, dut, params))

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(testbench)
    simulator.run()


def test_signed_and_plain_roots_alternate(monkeypatch):
    fmt, stages = BINARY32, 4
    params = UkfParams(n=5, m=1, pes=2, format=fmt)
    pipeline = Pipeline(reciprocal_sqrt=stages)
    large = (2 * fmt.bias - 1) << fmt.fraction_bits
    magnitudes = [
        0, 1, 1 << fmt.fraction_bits, fmt.bias << fmt.fraction_bits, large - 1, large,
        fmt.infinity - 1, fmt.infinity, fmt.infinity + 1, fmt.nan,
    ]  # fmt: skip
    numbers = [word | sign << (fmt.width - 1) for word in magnitudes for sign in (0, 1)]
    numbers += numbers[1::2] + numbers[::2]  # each as both kinds of root
    words = Words(Microcode(params, pipeline).timing)
    kinds = []
    for index in range(len(numbers)):
        group, place = divmod(index, stages)
        issue = 2 * stages * group + place
        signed = index % 2
        kinds.append(Root.SIGNED if signed else Root.PLAIN)
        words.at(issue, address_0=FROM + index // 2, select=index % 2)
        words.at(issue + LOAD_LATENCY, bus_source=BusSource.LOAD, signed=signed)
        words.at(
            issue + LOAD_LATENCY + stages, bus_source=BusSource.ROOT, write=1, write_bus=1,
            write_address=TO + index, unchecked=1,
        )  # fmt: skip

    async def scenario(bench):
        for index in range(0, len(numbers), 2):
            await bench.put(FROM + index // 2, numbers[index : index + 2])
        assert await bench.run(Program.INIT) == (ErrorCode.NONE, 0)
        for index, (word, kind) in enumerate(zip(numbers, kinds, strict=True)):
            value = fmt.decode(np.array([word], dtype=np.uint64))
            expected = int(fmt.encode(evaluate_root(fmt, kind, value))[0])
            assert await bench.get(TO + index) == [expected] * 2, (hex(word), kind)

    simulate(monkeypatch, params, pipeline, {Program.INIT: words.words}, scenario)


def test_errors_of_results_of_models(monkeypatch):
    params, pipeline = UkfParams(n=4, m=2, pes=2), Pipeline()
    fmt, m, rows = params.format, params.m, params.m + params.n
    timing = Microcode(params, pipeline).timing
    one, minus_two = (int(fmt.encode(value)) for value in (1.0, -2.0))
    infinity, nan = fmt.infinity, fmt.nan
    keep_all = Form(reading=Reading.NUMBER)
    of_models, unchecked, odd, scalars, meeting = (Words(timing) for _ in range(5))
    for row in range(rows):
        gate = {"lanes_observation": 1 + row} if row < m else {}
        of_models.slot(row, keep_all, FROM + row, ONES, TO + row, row=1 + row, of_model=1, **gate)
        unchecked.slot(row, keep_all, FROM + row, ONES, TO + row, unchecked=1)
    # Lane 0 alone; then what is finite; then what bit 0 of word 1 says.
    odd.slot(0, keep_all, FROM, ONES, TO, row=1, of_model=1, write_lanes=1)
    finite = Form(condition=Condition.FINITE)
    odd.slot(1, finite, FROM, ONES, TO + 1, row=1 + m, of_model=1)
    odd.slot(2, Form(condition=Condition.ODD), FROM, FROM + 1, TO + 2, row=2 + m, of_model=1)
    # Two scalars: the second may be anything, the first only by its program.
    for place, checked in enumerate((0, 1)):
        scalars.at(place, address_0=FROM + place, select=0)
        scalars.at(
            place + LOAD_LATENCY, bus_source=BusSource.LOAD, scalar_write=1,
            scalar_write_address=place, unchecked=checked,
        )  # fmt: skip
    form = Form(
        multiplier=Multiplier.SCALAR, addend=Addend.SCALAR, reading=Reading.ONE, sign=Sign.COPY
    )
    scalars.at(LOAD_LATENCY + 2, scalar_address=1, address_0=ONES, **steering(form))
    scalars.at(LOAD_LATENCY + 2 + timing.lanes, write=1, write_address=TO, unchecked=1)
    # A number on the bus that may be anything, on the clock of a result.
    meeting.slot(
        0, keep_all, FROM, ONES, TO, row=1 + m, of_model=1, unchecked=1, bus_source=BusSource.LOAD,
        scalar_write=1,
    )  # fmt: skip
    meeting.at(timing.lanes - LOAD_LATENCY, address_0=FROM + 1, select=0)
    programs = {
        Program.COVARIANCE_PREDICTED: meeting.words,
        Program.INIT: of_models.words, Program.SIG_GEN: unchecked.words,
        Program.PREDICT: odd.words, Program.COVARIANCE: scalars.words,
    }  # fmt: skip
    before = [5, 6]

    async def scenario(bench):
        async def prepare(words):
            await bench.put(ONES, one)
            for row in range(rows):
                await bench.put(FROM + row, words.get(row, [minus_two, minus_two]))
                await bench.put(TO + row, before)

        await prepare({})
        assert await bench.run(Program.INIT) == (ErrorCode.NONE, 0)
        assert [await bench.get(TO + row) for row in range(rows)] == [[minus_two] * 2] * rows
        for row in range(rows):
            bad = [[infinity, one], [one, nan], [infinity | 1 << 31, nan]][row % 3]
            await prepare({rows - 1: [one, nan], row: bad})
            error = (ErrorCode.MODEL_H, row) if row < m else (ErrorCode.MODEL_F, row - m)
            assert await bench.run(Program.INIT) == error
            found = [await bench.get(TO + r) for r in range(rows)]
            assert found == [[minus_two] * 2] * row + [before] * (rows - row)
            assert await bench.run(Program.SIG_GEN) == (ErrorCode.NONE, 0)
            assert await bench.get(TO + row) == bad

        # A masked observation may be anything, and is written as zero; no other row is.
        await prepare({1: [nan, nan], 2: [infinity, one]})
        assert await bench.run(Program.INIT, mask=0b01) == (ErrorCode.MODEL_F, 0)
        assert await bench.get(TO + 1) == [0, 0]
        assert await bench.run(Program.INIT, mask=0b10) == (ErrorCode.MODEL_H, 1)

        # A lane that is not written, by its set or by a condition, is no error.
        even, odd = one, one + 1
        await prepare({0: [one, infinity], 1: [odd, even]})
        assert await bench.run(Program.PREDICT) == (ErrorCode.NONE, 0)
        product = evaluate(Form(), fmt, fmt.decode(np.array([one])), fmt.decode(np.array([odd])))
        found = [await bench.get(TO + place) for place in range(3)]
        assert found == [[one, 6], [one, 6], [int(fmt.encode(product)[0]), 6]]
        await prepare({0: [one, infinity], 1: [odd, odd]})
        assert await bench.run(Program.PREDICT) == (ErrorCode.MODEL_F, 1)
        await prepare({0: [infinity, one]})
        assert await bench.run(Program.PREDICT) == (ErrorCode.MODEL_H, 0)

        await prepare({0: [one, one], 1: [infinity, one]})
        assert await bench.run(Program.COVARIANCE) == (ErrorCode.NONE, 0)
        assert await bench.get(TO) == [infinity] * 2
        await prepare({0: [one, one], 1: [nan, one]})
        assert await bench.run(Program.COVARIANCE_PREDICTED) == (ErrorCode.NONE, 0)
        await prepare({0: [one, nan], 1: [one, one]})
        assert await bench.run(Program.COVARIANCE_PREDICTED) == (ErrorCode.MODEL_F, 0)

        await prepare({0: [nan, one]})
        assert await bench.run(Program.COVARIANCE) == (ErrorCode.NOT_FINITE, 0)
        assert await bench.get(TO) == before

    simulate(monkeypatch, params, pipeline, programs, scenario)
