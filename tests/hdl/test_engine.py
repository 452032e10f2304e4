"""The engine against the golden model, word for word."""

import random

import numpy as np
import pytest
from amaranth.sim import Simulator

from ukf_hdl.core.engine import Engine
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.engine.microcode import STEP_OVERHEAD
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.float_format import BINARY16, BINARY32, BINARY64
from ukf_sw.spec.memory_map import FirstColumn, MemoryMap
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Program

CONFIGURATIONS = [
    pytest.param(UkfParams(n=1, m=1), Pipeline(), id="smallest"),
    pytest.param(
        UkfParams(n=2, m=2, q=1, r=2, pes=3),
        Pipeline(multiply=1, add=1, reciprocal_sqrt=1),
        id="shallow",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(
            n=2, m=1, q=2, r=1, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
            form=Form.COVARIANCE, format=BINARY16, pes=7,
        ),
        Pipeline(multiply=4, add=5, reciprocal_sqrt=7),
        id="additive",
    ),
    pytest.param(
        UkfParams(n=3, m=2, r=2, pes=4, format=BINARY64, W0=0.5), Pipeline(), id="binary64",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(n=2, m=4, r=4, sensors=(1, 3), observation_noise=Noise.ADDITIVE, pes=3),
        Pipeline(), id="sensors",
    ),
]  # fmt: skip

FORMS = [(Form.SQUARE_ROOT, 4), pytest.param(Form.COVARIANCE, 3, marks=pytest.mark.slow)]


class Bench:
    """An engine and its golden model, driven alike."""

    def __init__(self, ctx, dut, params, pipeline):
        self.ctx, self.dut = ctx, dut
        self.golden = Interpreter(params, pipeline)
        self.map = MemoryMap(params)
        self.format = params.format

    async def put(self, symbol, row, column, word, **banks):
        lane, address = self.golden.layout.buffer_location(symbol, row, column, **banks)
        self.golden.memory[lane, address] = word
        ctx, dut = self.ctx, self.dut
        ctx.set(dut.memory.lane, lane)
        ctx.set(dut.memory.address, address)
        ctx.set(dut.memory.write_data, word)
        ctx.set(dut.memory.write_strobe, -1)
        ctx.set(dut.memory.write, 1)
        await ctx.tick()
        ctx.set(dut.memory.write, 0)

    async def fill(self, symbol, values, **banks):
        region = self.map[symbol]
        words = self.format.encode(np.reshape(values, (region.rows, region.columns)))
        first = 0 if region.first_column is FirstColumn.STORED else 1
        for (row, column), word in np.ndenumerate(words):
            if column >= first:
                await self.put(symbol, row, column, int(word), **banks)

    async def run(
        self, program, *, sensor=0, mask=-1, state_bank=0, factor_bank=0, stop_after=None,
        compare=True,
    ):  # fmt: skip
        ctx, dut = self.ctx, self.dut
        expected = self.golden.run(
            program, sensor=sensor, mask=mask, state_bank=state_bank, factor_bank=factor_bank,
            stop_after=stop_after,
        )  # fmt: skip
        ctx.set(dut.run.observation_mask, mask)
        ctx.set(dut.banks.state, state_bank)
        ctx.set(dut.banks.factor, factor_bank)
        ctx.set(dut.run.program, program)
        ctx.set(dut.run.sensor, sensor)
        ctx.set(dut.run.start, 1)
        await ctx.tick()
        ctx.set(dut.run.start, 0)
        clocks = 1
        while not ctx.get(dut.run.done):
            assert ctx.get(dut.busy)
            if stop_after is not None and clocks == stop_after + 1:
                ctx.set(dut.run.stop, 1)
                await ctx.tick()
                ctx.set(dut.run.stop, 0)
                break
            clocks += 1
            await ctx.tick()
        else:
            assert clocks == expected.clocks - STEP_OVERHEAD + 2
            result = (ctx.get(dut.run.error_code), ctx.get(dut.run.error_index))
            assert result == expected[:2]
            assert ctx.get(dut.run.innovation_overflow) == expected.innovation_overflow
            if expected.nis is not None:
                assert ctx.get(dut.run.nis) == expected.nis
            await ctx.tick()
        assert not ctx.get(dut.busy)
        if compare:
            await self.compare()
        return expected

    async def compare(self):
        """Every word of every memory."""
        golden = self.golden.memory
        ctx, dut = self.ctx, self.dut
        found = np.zeros_like(golden)
        places = [(lane, a) for lane in range(golden.shape[0]) for a in range(golden.shape[1])]
        for clock, (lane, address) in enumerate(places + [(0, 0)] * LOAD_LATENCY):
            if clock >= LOAD_LATENCY:
                found[places[clock - LOAD_LATENCY]] = ctx.get(dut.memory.read_data)
            ctx.set(dut.memory.lane, lane)
            ctx.set(dut.memory.address, address)
            await ctx.tick()
        np.testing.assert_array_equal(found, golden)


def simulate(params, pipeline, scenario):
    dut = Engine(params, pipeline)

    async def testbench(ctx):
        await scenario(Bench(ctx, dut, params, pipeline))

    sim = Simulator(dut)
    sim.add_clock(1e-8)
    sim.add_testbench(testbench)
    sim.run()


@pytest.mark.parametrize(("params", "pipeline"), CONFIGURATIONS)
def test_agrees_with_golden_model(params, pipeline):
    rng = np.random.default_rng(1)
    n, m = params.n, params.m

    async def scenario(bench):
        await bench.fill("x", rng.normal(size=n))
        await bench.fill("L", np.tril(rng.normal(size=(n, n))))
        for symbol in ("LQ", "LR"):
            if symbol in bench.map:
                region = bench.map[symbol]
                await bench.fill(symbol, np.tril(rng.normal(size=(region.rows, region.columns))))
        assert (await bench.run(Program.INIT)).error_code == 0
        assert (await bench.run(Program.SIG_GEN)).error_code == 0
        await bench.fill("X", rng.normal(size=(n, params.N)))
        assert (await bench.run(Program.PREDICT)).error_code == 0
        await bench.run(Program.COVARIANCE_PREDICTED, state_bank=1)
        await bench.fill("Z", rng.normal(size=(m, params.N)))
        await bench.fill("z", rng.normal(size=m))
        await bench.run(Program.UPDATE, state_bank=1, stop_after=60)
        for stop_after in (37, 50, 71):  # the next program meets what is left in the pipelines
            await bench.run(Program.UPDATE, state_bank=1, stop_after=stop_after, compare=False)
        update = await bench.run(Program.UPDATE, state_bank=1)
        assert update.error_code == 0
        assert update.nis is not None
        await bench.run(Program.COVARIANCE, factor_bank=1)
        last = len(params.sensor_rows) - 1
        await bench.run(Program.UPDATE_REDRAWN, sensor=last, mask=-2, factor_bank=1)
        await bench.fill("X", rng.normal(size=(n, params.N)))
        await bench.run(Program.PREDICT, state_bank=1)
        await bench.run(Program.UPDATE, sensor=last)
        await bench.run(Program.SIG_GEN_PREDICTED)

    simulate(params, pipeline, scenario)


@pytest.mark.parametrize("hostile", ["nan", "infinity", "subnormal", "payload"])
def test_numbers_that_are_not_finite_are_stopped(hostile):
    params, pipeline = UkfParams(n=2, m=2, q=1, pes=2), Pipeline()
    word = {
        "nan": BINARY32.nan, "infinity": BINARY32.infinity | 1 << 31, "subnormal": 5,
        "payload": BINARY32.infinity | 5,
    }[hostile]  # fmt: skip
    rng = np.random.default_rng(2)

    async def scenario(bench):
        await bench.fill("x", rng.normal(size=2))
        await bench.fill("L", np.eye(2))
        await bench.fill("LQ", [[1.0]])
        assert (await bench.run(Program.INIT)).error_code == 0
        await bench.run(Program.SIG_GEN)
        await bench.fill("X", rng.normal(size=(2, params.N)))
        await bench.put("X", 1, random.Random(3).choice(params.points), word)
        predicted = await bench.run(Program.PREDICT)
        assert predicted.error_code == (0 if hostile == "subnormal" else ErrorCode.NOT_FINITE)
        # A masked observation may hold anything.
        await bench.fill("X", rng.normal(size=(2, params.N)))
        await bench.run(Program.PREDICT)
        await bench.fill("Z", rng.normal(size=(2, params.N)))
        await bench.fill("z", rng.normal(size=2))
        await bench.put("Z", 0, 1, word)
        await bench.put("z", 0, 0, word)
        masked = await bench.run(Program.UPDATE, mask=0b10, state_bank=1)
        assert masked.error_code == 0
        await bench.run(Program.UPDATE, state_bank=1)

    simulate(params, pipeline, scenario)


def test_bad_pivots_are_reported():
    params, pipeline = UkfParams(n=2, m=2, pes=2), Pipeline()
    rng = np.random.default_rng(4)

    async def scenario(bench):
        await bench.fill("L", np.eye(2))
        await bench.run(Program.INIT)
        await bench.run(Program.SIG_GEN)
        points = rng.normal(size=(2, params.N))
        points[1] = 0.0  # a state without uncertainty is legal
        await bench.fill("X", points)
        assert (await bench.run(Program.PREDICT)).error_code == 0
        observations = rng.normal(size=(2, params.N))
        observations[1] = 0.0
        await bench.fill("Z", observations)
        singular = await bench.run(Program.UPDATE, state_bank=1)
        assert singular[:2] == (ErrorCode.SINGULAR_OBSERVATION, 1)
        assert (await bench.run(Program.UPDATE, mask=1, state_bank=1)).error_code == 0

    simulate(params, pipeline, scenario)


@pytest.mark.parametrize(("form", "pes"), FORMS)
def test_a_pivot_that_is_rounding_noise_is_reported(form, pes):
    """Rows that depend on others leave rounding errors; precise sensors leave small pivots."""
    params, pipeline = UkfParams(n=2, m=3, r=3, form=form, pes=pes), Pipeline()
    rng = np.random.default_rng(6)
    #: Variance of the noise, in parts of that of a state.
    noise = {Form.SQUARE_ROOT: 1e-10, Form.COVARIANCE: 1e-5}[form]
    errors = []

    async def scenario(bench):
        await bench.fill("L", np.eye(2))
        await bench.fill("LR", np.eye(3))
        await bench.run(Program.INIT, compare=False)
        await bench.run(Program.SIG_GEN, compare=False)
        points = rng.normal(size=(2, params.N))
        await bench.fill("X", points)
        await bench.run(Program.PREDICT, compare=False)
        rows = [points[0] * 700.0, points[1], (points[0] + points[1]) * 0.01]
        for mask in (0b111, 0b011, 0b101, 0b110):
            await bench.fill("Z", rows)
            errors.append((await bench.run(Program.UPDATE, mask=mask, state_bank=1))[:2])
        rows[2] = rows[2] + 0.01 * np.sqrt(noise) * rng.normal(size=params.N)
        for scale in (1.0, 1e-8):  # what the last program left does not matter
            await bench.fill("Z", [scale * row for row in rows])
            errors.append((await bench.run(Program.UPDATE, state_bank=1))[:2])

    simulate(params, pipeline, scenario)
    # The covariance form then finds nothing left of P, which is no fault of the observation.
    assert errors[0] == (ErrorCode.SINGULAR_OBSERVATION, 2)
    assert all(code != ErrorCode.SINGULAR_OBSERVATION for code, _ in errors[1:])


@pytest.mark.parametrize(("form", "pes"), FORMS)
def test_an_innovation_too_large_for_the_format_is_told_from_other_overflow(form, pes):
    params, pipeline = UkfParams(n=2, m=2, r=2, form=form, pes=pes), Pipeline()
    rng = np.random.default_rng(7)
    found = []

    async def scenario(bench):
        await bench.fill("L", np.eye(2))
        await bench.fill("LR", np.eye(2))
        await bench.run(Program.INIT, compare=False)
        await bench.run(Program.SIG_GEN, compare=False)
        await bench.fill("X", rng.normal(size=(2, params.N)))
        await bench.run(Program.PREDICT, compare=False)
        observations = 1e-3 * rng.normal(size=(2, params.N))
        largest = BINARY32.max_finite
        for z, scale in (
            ([1e15, 0.0], 1.0), ([0.0, 1e30], 1.0), ([-largest, largest], 1.0), ([1e30, 0.0], 1e23),
            ([0.0, np.inf], 1.0), ([0.0, np.nan], 1.0),
        ):  # fmt: skip
            await bench.fill("Z", observations * scale)
            await bench.fill("z", z)
            result = await bench.run(Program.UPDATE, state_bank=1)
            found.append((result.error_code, result.innovation_overflow))

    simulate(params, pipeline, scenario)
    overflow = (ErrorCode.NOT_FINITE, True)
    other = (ErrorCode.NOT_FINITE, False)
    assert found == [(0, False), overflow, overflow, other, other, other]


def test_overflow_in_the_lanes_is_stopped():
    """Sigma points beyond the largest number, from a factor that is finite."""
    params, pipeline = UkfParams(n=2, m=1, q=2, pes=3), Pipeline()

    async def scenario(bench):
        await bench.fill("L", np.eye(2) * 2e38)
        assert (await bench.run(Program.INIT)).error_code == 0
        assert (await bench.run(Program.SIG_GEN)).error_code == ErrorCode.NOT_FINITE

    simulate(params, pipeline, scenario)


def test_a_program_does_not_meet_beats_of_one_that_was_stopped():
    """Beats of a dot product are in the adder tree when the next program starts at once."""
    params = UkfParams(n=2, m=2, pes=4)
    pipeline = Pipeline(multiply=1, add=8, reciprocal_sqrt=2)
    rng = np.random.default_rng(5)

    async def scenario(bench):
        await bench.fill("x", rng.normal(size=2))
        await bench.fill("L", np.eye(2))
        await bench.run(Program.INIT, compare=False)
        for stop_after in (2, 3, 5, 8):
            await bench.run(Program.PREDICT, stop_after=stop_after, compare=False)
            await bench.run(Program.SIG_GEN)

    simulate(params, pipeline, scenario)
