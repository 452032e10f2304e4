"""The core over its bus, against the golden model and on a stand-in for the engine."""

import random

import pytest
from amaranth.sim import Simulator

from support.axi4_lite_bench import AxiLiteManager, check_axi4_lite
from support.random_models import sane_models, with_models
from support.stub_engine import StubEngine
from ukf_hdl.core.axi4_lite import Response
from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.generate import Toplevel
from ukf_sw.golden import GoldenCore
from ukf_sw.spec.float_format import BINARY16
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.registers import (
    CONTROL,
    CYCLES,
    ERROR,
    GATE_LOW,
    ID,
    INTERRUPT_ENABLE,
    INTERRUPT_PENDING,
    MASK,
    NIS_LOW,
    REGISTERS,
    STATUS,
    ErrorCode,
)
from ukf_sw.spec.sequence import OF_MODELS, Step

SMALLEST = UkfParams(n=1, m=1)
FAST = Pipeline(multiply=1, add=1, reciprocal_sqrt=1)
STEPS = [step for step in Step if step is not Step.IDLE]
OF_TWO_SENSORS = UkfParams(
    n=2, m=2, q=1, r=1, sensors=(1, 1), pes=3, observation_noise=Noise.AUGMENTED, format=BINARY16
)


def start_bit(step):
    return CONTROL[step.name].mask


class Bench:
    """A core, its clock and a bus manager."""

    def __init__(self, core, rng=None, pause=0.0):
        self.core = core
        self.manager = AxiLiteManager(core.s_axi, rng, pause)

    def simulate(self, testbench):
        async def run(ctx):
            self.ctx = ctx
            await testbench(self)

        async def check(ctx):
            await check_axi4_lite(ctx, self.core.s_axi)

        sim = Simulator(self.core)
        sim.add_clock(10e-9)
        sim.add_testbench(run)
        sim.add_testbench(check, background=True)
        sim.run()

    async def read(self, address):
        """Read a word; gives it and whether it was answered with OKAY."""
        data, response, _ = await self.manager.read(self.ctx, address)
        return data, response == Response.OKAY

    async def write(self, address, data, strobe=0xF):
        """Write a word; gives whether it was answered with OKAY."""
        response, _ = await self.manager.write(self.ctx, address, data, strobe)
        return response == Response.OKAY

    async def idle(self):
        while STATUS["STATE"].get((await self.read(STATUS.offset))[0]):
            pass


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((3,), r"^Parameters must be a UkfParams, not 3$"),
        ((SMALLEST, 3), r"^Pipeline must be a Pipeline, not 3$"),
    ],
)
def test_wrong_params_are_rejected(args, message):
    with pytest.raises(TypeError, match=message):
        UkfCore(*args)


@pytest.mark.parametrize(
    ("params", "pipeline", "count"),
    [
        pytest.param(SMALLEST, Pipeline(), 400, id="smallest", marks=pytest.mark.slow),
        pytest.param(
            UkfParams(n=2, m=1, q=1, r=1, pes=3, observation_noise=Noise.ADDITIVE), FAST, 400,
            id="square root", marks=pytest.mark.slow,
        ),
        pytest.param(
            UkfParams(n=2, m=2, pes=2, form=Form.COVARIANCE, format=BINARY16), FAST, 600,
            id="covariance", marks=pytest.mark.slow,
        ),
        pytest.param(
            UkfParams(
                n=2, m=3, r=3, sensors=(1, 2), pes=2, observation_noise=Noise.ADDITIVE,
                format=BINARY16,
            ),
            FAST, 400, id="sensors", marks=pytest.mark.slow,
        ),
        pytest.param(
            with_models(OF_TWO_SENSORS, sane_models(random.Random(1), OF_TWO_SENSORS)), FAST, 400,
            id="models",
        ),
    ],
)  # fmt: skip
def test_agrees_with_golden_core(params, pipeline, count):
    """Random accesses, steps and values: equal answers, equal interrupts, equal clocks."""
    rng = random.Random(repr(params))
    memory_map = MemoryMap(params)
    golden = GoldenCore(params, pipeline)
    elements = [
        memory_map.address(region.symbol, row, column)
        for region in memory_map
        for row in range(region.rows)
        for column in range(region.columns)
    ]
    seen = set()
    own = [step for step in STEPS if params.models or step not in OF_MODELS]

    def value():
        if rng.random() < (0.01 if params.models else 0.12):
            return rng.choice([params.format.infinity, params.format.nan])
        return int(params.format.encode(rng.choice([0.0, 0.5, 1.0, rng.uniform(-2, 2)])))

    def met():
        """Whether every step has succeeded, and failed in the ways that there are."""
        codes = {code for _, code in seen - {"while running"}}
        return (
            "while running" in seen
            and {step for step, code in seen - {"while running"} if code == 0} == set(own)
            and ErrorCode.ILLEGAL_STEP in codes
            and codes & {ErrorCode.NOT_FINITE, ErrorCode.SINGULAR_OBSERVATION, ErrorCode.MODEL_F}
        )

    async def testbench(bench):
        async def write(address, data, strobe=0xF):
            okay = await bench.write(address, data, strobe)
            assert okay == golden.write(address, data, strobe), hex(address)
            return okay

        async def read(address):
            answer = await bench.read(address)
            assert answer == golden.read(address), hex(address)
            return answer[0]

        # A first filter, so that steps succeed; the rest is chance.
        for i in range(params.n):
            for j in range(params.n):
                await write(memory_map.address("L", i, j), int(params.format.encode(float(i == j))))
        for symbol in ("LQ", "LR"):
            if symbol in memory_map:
                for i in range(memory_map[symbol].rows):
                    one = int(params.format.encode(1.0))
                    column = min(i, memory_map[symbol].columns - 1)
                    await write(memory_map.address(symbol, i, column), one)
        await write(CONTROL.offset, start_bit(Step.INIT) | 1)
        await bench.idle()
        if params.models:
            for column in range(memory_map["U"].columns):
                await write(memory_map.address("U", 0, column), int(params.format.encode(0.5)))
        # Steps that succeed, before chance has its way.
        script = [Step.SIG_GEN, Step.F, Step.H, Step.ITERATE, Step.H] if params.models else []
        for accesses in range(4 * count):
            if accesses >= count and met():
                break
            choice = 0.0 if script else rng.random()
            if choice < 0.35:
                step = rng.choice([*own, Step.SIG_GEN, Step.PREDICT, Step.UPDATE, Step.UPDATE])
                reset = CONTROL["RESET"].mask * (rng.random() < 0.03)
                golden.hold = True
                sensor = CONTROL["SENSOR"].put(rng.choice([0, 0, 1, 2]) if params.sensors else 0)
                variant = CONTROL["VARIANT"].put(rng.choice([0, 0, 0, 1, 2]) if own[5:] else 0)
                enable = rng.random() < 0.98
                if script:
                    step, sensor, variant, enable, reset = script.pop(0), 0, 0, True, 0
                await write(CONTROL.offset, start_bit(step) | sensor | variant | enable | reset)
                if golden.busy:
                    if rng.random() < 0.3:  # a few clocks, which is less than any step takes
                        seen.add("while running")
                        await rng.choice(
                            [
                                lambda: write(CONTROL.offset, start_bit(rng.choice(STEPS)) | 1),
                                lambda: write(rng.choice(elements), value()),
                                lambda: read(rng.choice(elements)),
                                lambda: read(STATUS.offset),
                            ]
                        )()
                    golden.finish()
                await bench.idle()
                for register in (STATUS, ERROR, CYCLES, NIS_LOW):
                    await read(register.offset)
                if not reset:
                    seen.add((step, golden.read(ERROR.offset)[0] & 0xFF))
            elif choice < 0.75:
                await write(rng.choice(elements), value(), rng.choice([0xF] * 9 + [3]))
            elif choice < 0.9:
                await read(rng.choice([*elements, rng.choice(REGISTERS).offset]))
            else:
                register = rng.choice([INTERRUPT_ENABLE, INTERRUPT_PENDING, MASK, GATE_LOW])
                data = value() if register is GATE_LOW else rng.getrandbits(32)
                await write(register.offset, data, rng.getrandbits(4))
            assert bench.ctx.get(bench.core.irq) == golden.irq
        for address in [*elements, *(register.offset for register in REGISTERS)]:
            await read(address)

    Bench(UkfCore(params, pipeline), rng, 0.2).simulate(testbench)
    assert met(), seen


def test_reset_of_the_package_is_active_low():
    top = Toplevel(UkfCore(SMALLEST, engine=StubEngine(SMALLEST)))

    async def testbench(ctx):
        async def clocks(count):
            for _ in range(count):
                ctx.set(top.aclk, 1)
                await ctx.delay(5e-9)
                ctx.set(top.aclk, 0)
                await ctx.delay(5e-9)

        async def read_gate():
            ctx.set(top.s_axi_araddr, GATE_LOW.offset)
            ctx.set(top.s_axi_arvalid, 1)
            await clocks(1)
            ctx.set(top.s_axi_arvalid, 0)
            await clocks(3)
            assert ctx.get(top.s_axi_rvalid)
            return ctx.get(top.s_axi_rdata)

        ctx.set(top.aresetn, 1)
        for signal, data in (
            (top.s_axi_awaddr, GATE_LOW.offset), (top.s_axi_wdata, 0x1234), (top.s_axi_wstrb, 0xF),
            (top.s_axi_awvalid, 1), (top.s_axi_wvalid, 1), (top.s_axi_bready, 1),
        ):  # fmt: skip
            ctx.set(signal, data)
        await clocks(1)
        ctx.set(top.s_axi_awvalid, 0)
        ctx.set(top.s_axi_wvalid, 0)
        await clocks(5)
        assert await read_gate() == 0x1234
        # With the response still there.
        ctx.set(top.aresetn, 0)
        await clocks(1)
        assert not ctx.get(top.s_axi_rvalid)
        await clocks(2)
        ctx.set(top.aresetn, 1)
        assert await read_gate() == SMALLEST.format.infinity

    sim = Simulator(top)
    sim.add_testbench(testbench)
    sim.run()


def test_clocks_of_accesses():
    """From the last part of the request taken to the response: as the docstring promises."""
    params = UkfParams(n=3, m=2, q=1, r=1, pes=3)
    memory_map = MemoryMap(params)
    element = memory_map.address("X", 1, 2)

    async def testbench(bench):
        for address, writing, reading in ((ID.offset, 3, 3), (element, 3, 6)):
            _, clocks = await bench.manager.write(bench.ctx, address, 0)
            assert clocks - 1 == writing
            _, _, clocks = await bench.manager.read(bench.ctx, address)
            assert clocks - 1 == reading

    Bench(UkfCore(params, engine=StubEngine(params))).simulate(testbench)


def test_buffer_refuses_and_registers_answer_while_a_step_runs():
    params = UkfParams(n=2, m=1)
    x = MemoryMap(params).address("x", 0, 1)
    core = UkfCore(params, engine=(engine := StubEngine(params)))

    async def testbench(bench):
        bench.ctx.set(engine.stub_duration, 200)
        assert await bench.write(x, 0x1234)
        assert await bench.write(CONTROL.offset, start_bit(Step.INIT) | 1)
        assert await bench.read(x) == (0, False)
        assert not await bench.write(x, 0x5678)
        assert STATUS["STATE"].get((await bench.read(STATUS.offset))[0]) == Step.INIT
        first, _ = await bench.read(CYCLES.offset)
        second, _ = await bench.read(CYCLES.offset)
        assert 0 < first < second
        await bench.idle()
        assert await bench.read(x) == (0x1234, True)
        assert await bench.read(CYCLES.offset) == (201, True)

    Bench(core).simulate(testbench)


def test_reset_in_a_step_frees_the_buffer():
    params = UkfParams(n=2, m=1)
    x = MemoryMap(params).address("x", 0, 1)
    core = UkfCore(params, engine=(engine := StubEngine(params)))

    async def testbench(bench):
        bench.ctx.set(engine.stub_duration, 10_000)
        assert await bench.write(CONTROL.offset, start_bit(Step.INIT) | 1)
        assert not await bench.write(x, 1)
        assert await bench.write(CONTROL.offset, CONTROL["RESET"].mask | 1)
        assert await bench.write(x, 2)
        assert await bench.read(x) == (2, True)
        assert await bench.read(STATUS.offset) == (0, True)
        assert not bench.ctx.get(engine.busy)

    Bench(core).simulate(testbench)


@pytest.mark.parametrize("region", ["x", "L", "X"])
def test_a_write_to_the_estimate_invalidates_what_came_from_it(region):
    params = UkfParams(n=2, m=1)
    address = MemoryMap(params).address(region, 0, 1)
    core = UkfCore(params, engine=StubEngine(params))

    async def flags(bench):
        status, _ = await bench.read(STATUS.offset)
        return STATUS["POINTS"].get(status), STATUS["RESIDUALS"].get(status)

    async def testbench(bench):
        await bench.write(CONTROL.offset, start_bit(Step.INIT) | 1)
        await bench.write(CONTROL.offset, start_bit(Step.SIG_GEN) | 1)
        assert await flags(bench) == (1, 0)
        await bench.write(address, 5, strobe=0)
        assert await flags(bench) == (1, 0)
        await bench.write(address, 5, strobe=0b1000)
        assert await flags(bench) == (int(region == "X"), 0)
        await bench.write(CONTROL.offset, start_bit(Step.SIG_GEN) | 1)
        await bench.write(CONTROL.offset, start_bit(Step.PREDICT) | 1)
        assert await flags(bench) == (0, 1)
        await bench.write(address, 5)
        assert await flags(bench) == (0, int(region == "X"))

    Bench(core).simulate(testbench)
