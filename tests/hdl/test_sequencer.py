"""The sequencer gives the control words of every program, clock by clock."""

import random

import pytest
from amaranth.sim import Simulator

from ukf_hdl.core.sequencer import Sequencer
from ukf_sw.engine.microcode import STEP_OVERHEAD, Microcode
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine

CONFIGURATIONS = [
    pytest.param(UkfParams(n=1, m=1), Pipeline(), id="smallest"),
    pytest.param(UkfParams(n=3, m=2, q=3, r=2), Pipeline(), id="one"),
    pytest.param(UkfParams(n=2, m=4, sensors=(1, 2, 1)), Pipeline(), id="three sensors"),
    pytest.param(
        UkfParams(
            n=4, m=3, process_noise=Noise.ADDITIVE, form=Form.COVARIANCE, q=4, r=3, pes=3
        ),
        Pipeline(multiply=3, add=1),
        id="covariance",
    ),
]  # fmt: skip


def words_of(code, routine):
    """Words that a step executes: UPDATE_REDRAWN runs on into UPDATE."""
    words = code.words[code.entry[routine] :]
    last = code.format.fields["last"]
    length = next(k for k, word in enumerate(words) if word >> last.lsb & 1) + 1
    return words[:length]


@pytest.mark.parametrize(("params", "pipeline"), CONFIGURATIONS)
def test_every_program_word_by_word(params, pipeline):
    """Programs in random order, some stopped on the way and followed by the next at once."""
    code = Microcode(params, pipeline)
    dut = Sequencer(code)
    rng = random.Random(1)
    routines = list(code.programs)
    runs = [*routines, *rng.choices(routines, k=6)]

    async def testbench(ctx):
        for number, routine in enumerate(runs):
            expected = words_of(code, routine)
            stop_at = rng.randrange(len(expected)) if number >= len(routines) else None
            ctx.set(dut.start, 1)
            ctx.set(dut.program, routine.program)
            ctx.set(dut.sensor, routine.sensor)
            ctx.set(dut.variant, routine.variant)
            await ctx.tick()
            ctx.set(dut.start, 0)
            assert ctx.get(dut.busy)
            await ctx.tick()
            for clock, word in enumerate(expected):
                assert ctx.get(dut.word.as_value()) == word, (routine, clock)
                assert ctx.get(dut.busy)
                assert not ctx.get(dut.done)
                ctx.set(dut.stop, clock == stop_at)
                await ctx.tick()
                ctx.set(dut.stop, 0)
                if clock == stop_at:
                    break
            assert ctx.get(dut.word.as_value()) == 0
            assert ctx.get(dut.done) == (stop_at is None)
            if stop_at is None:
                assert len(expected) + STEP_OVERHEAD == code.clocks(*routine)
                await ctx.tick()
            assert not ctx.get(dut.busy)
            for _ in range(rng.choice([0, 1, 5])):
                await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(testbench)
    simulator.run()


def test_a_long_group_repeats():
    """As many interleaved rows as the memory of past words is long, and repeated runs of it."""
    params = UkfParams(n=9, m=6, q=9, r=6, pes=1)
    code = Microcode(params, Pipeline())
    distances = {
        number >> stream.format.distance.lsb & (1 << stream.format.distance.width) - 1
        for stream in code.streams.values()
        for number in stream.packets
    }
    assert len(distances) > 10
    dut = Sequencer(code)

    async def testbench(ctx):
        ctx.set(dut.start, 1)
        ctx.set(dut.program, Program.UPDATE)
        await ctx.tick()
        ctx.set(dut.start, 0)
        await ctx.tick()
        for clock, word in enumerate(words_of(code, Routine(Program.UPDATE))[:3000]):
            assert ctx.get(dut.word.as_value()) == word, clock
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(testbench)
    simulator.run()
