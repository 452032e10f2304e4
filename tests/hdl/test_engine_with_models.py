"""The engine with models against the golden model, word for word."""

import random

import numpy as np
import pytest
from amaranth.sim import Simulator

from support.model_memory import ModelMemory
from support.random_models import any_models, with_models
from ukf_hdl.core.engine import Engine
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.engine.microcode import STEP_OVERHEAD, routines
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Program

CONFIGURATIONS = [
    pytest.param(
        UkfParams(n=2, m=2, q=1, r=1, sensors=(1, 1), pes=2, format=BINARY16), Pipeline(),
        id="sensors",
    ),
    pytest.param(
        UkfParams(
            n=2, m=1, q=2, r=1, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
            form=Form.COVARIANCE, format=BFLOAT16, pes=3, W0=0.25,
        ),
        Pipeline(multiply=1, add=1, reciprocal_sqrt=2), id="additive",
    ),
    pytest.param(UkfParams(n=1, m=1), Pipeline(), id="smallest", marks=pytest.mark.slow),
    pytest.param(
        UkfParams(n=3, m=3, q=1, r=2, pes=5, sensors=(2, 1)),
        Pipeline(multiply=4, add=5, reciprocal_sqrt=7), id="deep", marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(n=2, m=2, q=1, r=1, pes=4, format=BINARY64, W0=0.5), Pipeline(),
        id="binary64", marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(n=2, m=2, q=2, pes=6, form=Form.COVARIANCE, format=BINARY32),
        Pipeline(multiply=2, add=3, reciprocal_sqrt=1), id="covariance", marks=pytest.mark.slow,
    ),
]  # fmt: skip


class Bench:
    """An engine and its golden model, with equal memories."""

    def __init__(self, ctx, dut, params, pipeline):
        self.ctx, self.dut = ctx, dut
        self.golden = Interpreter(params, pipeline)

    async def load(self, words):
        """Write all words that differ from what is there."""
        ctx, memory = self.ctx, self.dut.memory
        ctx.set(memory.write_strobe, -1)
        ctx.set(memory.write, 1)
        for lane, address in np.argwhere(self.golden.memory != words).tolist():
            ctx.set(memory.lane, lane)
            ctx.set(memory.address, address)
            ctx.set(memory.write_data, int(words[lane, address]))
            await ctx.tick()
        ctx.set(memory.write, 0)
        self.golden.memory[:] = words

    async def run(self, routine, mask, stop_after=None):
        """Run a program on both; gives what the model says of it."""
        ctx, run = self.ctx, self.dut.run
        expected = self.golden.run(
            routine.program, sensor=routine.sensor, variant=routine.variant, mask=mask,
            stop_after=stop_after,
        )  # fmt: skip
        ctx.set(run.observation_mask, mask)
        ctx.set(run.program, routine.program)
        ctx.set(run.sensor, routine.sensor)
        ctx.set(run.variant, routine.variant)
        ctx.set(run.start, 1)
        await ctx.tick()
        ctx.set(run.start, 0)
        clocks = 1
        while not ctx.get(run.done):
            assert ctx.get(self.dut.busy)
            if stop_after is not None and clocks == stop_after + 1:
                ctx.set(run.stop, 1)
                await ctx.tick()
                ctx.set(run.stop, 0)
                return expected
            clocks += 1
            await ctx.tick()
        assert clocks == expected.clocks - STEP_OVERHEAD + 2
        found = ctx.get(run.error_code), ctx.get(run.error_index)
        assert found == (expected.error_code, expected.error_index)
        assert not ctx.get(run.innovation_overflow)
        await ctx.tick()
        assert not ctx.get(self.dut.busy)
        return expected

    async def compare(self):
        """Every word of every memory."""
        ctx, memory, golden = self.ctx, self.dut.memory, self.golden.memory
        found = np.zeros_like(golden)
        places = [tuple(place) for place in np.argwhere(np.ones(golden.shape)).tolist()]
        for clock, (lane, address) in enumerate(places + [(0, 0)] * LOAD_LATENCY):
            if clock >= LOAD_LATENCY:
                found[places[clock - LOAD_LATENCY]] = ctx.get(memory.read_data)
            ctx.set(memory.lane, lane)
            ctx.set(memory.address, address)
            await ctx.tick()
        np.testing.assert_array_equal(found, golden)


@pytest.mark.parametrize(("params", "pipeline"), CONFIGURATIONS)
def test_models_agree_with_golden_model(params, pipeline):
    """Random models, on NaN where a model may write first; with errors, masks and stops."""
    rng = random.Random(repr(params))
    params = with_models(params, any_models(rng, params, steps=14, finite=0.9))
    dut = Engine(params, pipeline)
    draws = np.random.default_rng(1)
    codes = []

    async def testbench(ctx):
        bench = Bench(ctx, dut, params, pipeline)
        chosen = [
            each for each in routines(params) if each.program in (Program.MODEL_F, Program.MODEL_H)
        ]
        assert len({each.sensor for each in chosen}) == len(params.sensor_rows)
        for routine in chosen * 2:
            memory = ModelMemory(bench.golden.layout, draws)
            memory.poison(routine.program)
            await bench.load(memory.words)
            # One that is stopped leaves something in the pipelines.
            await bench.run(routine, -1, stop_after=rng.randrange(2, 30))
            mask = rng.choice([-1, -1, 0b01, 0b10])
            result = await bench.run(routine, mask)
            codes.append(result.error_code)
            await bench.compare()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(testbench)
    simulator.run()
    assert 0 in codes
    assert set(codes) <= {0, ErrorCode.MODEL_F, ErrorCode.MODEL_H}
