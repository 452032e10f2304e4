import random
from dataclasses import dataclass, field
from operator import attrgetter

import numpy as np
import pytest
from amaranth.sim import Simulator

from support.axi4_lite_bench import AccessManager
from support.random_models import any_models, with_models
from ukf_hdl.core.control import Control
from ukf_sw.spec import registers
from ukf_sw.spec.float_format import BINARY16, BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, UkfParams
from ukf_sw.spec.registers import (
    CONFIG,
    CONTROL,
    CYCLES,
    ERROR,
    GATE_HIGH,
    GATE_LOW,
    ID,
    INTERRUPT_ENABLE,
    INTERRUPT_PENDING,
    MASK,
    MODELS,
    NIS_HIGH,
    NIS_LOW,
    REGISTERS,
    SENSORS,
    SIZES,
    STATUS,
    W0_HIGH,
    W0_LOW,
    ErrorCode,
)
from ukf_sw.spec.sequence import OF_MODELS, Program, Step

STEPS = [step for step in Step if step is not Step.IDLE]
PARAMS = [
    pytest.param(UkfParams(n=1, m=1), id="smallest", marks=pytest.mark.slow),
    pytest.param(
        UkfParams(n=7, m=6, q=7, r=6, pes=10), id="nanosat", marks=pytest.mark.slow
    ),
    pytest.param(
        UkfParams(n=2, m=32, format=BINARY16, form=Form.COVARIANCE), id="half",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(n=2, m=6, sensors=(2, 1, 3)), id="sensors", marks=pytest.mark.slow
    ),
    pytest.param(
        with_models(
            UkfParams(n=2, m=6, sensors=(2, 1, 3)),
            any_models(random.Random(1), UkfParams(n=2, m=6, sensors=(2, 1, 3)), steps=2),
        ),
        id="models",
    ),
    pytest.param(
        UkfParams(
            n=3, m=2, q=3, r=2, W0=0.1, format=BINARY64, process_noise=Noise.ADDITIVE,
            observation_noise=Noise.ADDITIVE,
        ),
        id="double", marks=pytest.mark.slow,
    ),
]  # fmt: skip


def start_bit(step):
    return CONTROL[step.name].mask


@dataclass
class Model:
    """What the registers and the steps do, clock by clock; written from the documentation."""

    params: UkfParams
    words: dict = field(default_factory=dict)
    stored: dict = field(default_factory=dict)  # bits of those that a write stores
    step: Step = Step.IDLE
    program: Program = Program.INIT
    sensor: int = 0
    variant: int = 0
    chosen: tuple = (0, 0)  # sensor and variant of the step
    initialised: int = 0
    points: int = 0
    predicted: int = 0
    residuals: int = 0
    propagated: int = 0
    gated: int = 0
    ended: set = field(default_factory=set)
    error: tuple = (0, 0)
    nis: int = 0
    cycles: int = 0
    pending: int = 0
    state_bank: int = 0
    factor_bank: int = 0
    mask: int = 0
    start: int = 0
    stop: int = 0
    seen: set = field(default_factory=set)  # kinds of events, to prove that a test meets them

    def __post_init__(self):
        infinity = self.params.format.infinity
        number = (1 << self.params.format.width) - 1
        observations = (1 << self.params.m) - 1
        self.words = {
            CONTROL: 0, INTERRUPT_ENABLE: 0, MASK: observations,
            GATE_LOW: infinity & 0xFFFF_FFFF, GATE_HIGH: infinity >> 32,
        }  # fmt: skip
        self.stored = {
            CONTROL: 1, INTERRUPT_ENABLE: 0b11, MASK: observations,
            GATE_LOW: number & 0xFFFF_FFFF, GATE_HIGH: number >> 32,
        }  # fmt: skip

    @property
    def outputs(self):
        return {
            "busy": self.step != Step.IDLE,
            "irq": bool(self.pending & self.words[INTERRUPT_ENABLE]),
            "run.start": self.start,
            "run.stop": self.stop,
            "run.program": self.program,
            "run.sensor": self.sensor,
            "run.variant": self.variant,
            "run.observation_mask": self.mask,
            "banks.state": self.state_bank,
            "banks.factor": self.factor_bank,
        }

    def read(self, address):
        register = find(address)
        if register is None:
            return None
        if register in self.words:
            return self.words[register]
        p = self.params
        return {
            ID: registers.MAGIC << 16 | registers.VERSION,
            SIZES: p.n | p.q << 8 | p.r << 16 | p.m << 24,
            CONFIG: (
                p.pes | p.format.exponent_bits << 8 | p.format.fraction_bits << 12
                | (p.form is Form.COVARIANCE) << 18 | (p.process_noise is Noise.ADDITIVE) << 19
                | (p.observation_noise is Noise.ADDITIVE) << 20
                | (p.models.f is not None) << 21 | bool(p.models.h) << 22
            ),
            STATUS: (
                self.step | self.initialised << 4 | self.points << 5 | self.residuals << 6
                | self.gated << 7 | sum(start_bit(step) for step in self.ended)
            ),
            ERROR: self.error[0] | self.error[1] << 8,
            INTERRUPT_PENDING: self.pending,
            CYCLES: self.cycles,
            NIS_LOW: self.nis & 0xFFFF_FFFF,
            NIS_HIGH: self.nis >> 32,
            W0_LOW: int(np.float64(p.W0).view(np.uint64)) & 0xFFFF_FFFF,
            W0_HIGH: int(np.float64(p.W0).view(np.uint64)) >> 32,
            SENSORS: 0b1101 if p.sensors else 1,
            MODELS: p.models.digest,
        }[register]  # fmt: skip

    def clock(self, *, write=None, state_written=False, factor_written=False, done=None):
        """Advance by a clock; a write takes effect at its end."""
        events = 0
        clear = 0
        gate = self.words[GATE_LOW] | self.words[GATE_HIGH] << 32
        busy = self.step != Step.IDLE
        self.start = self.stop = 0
        self.cycles += busy
        if state_written:
            self.points = self.residuals = 0
        if factor_written:
            self.points = self.residuals = self.predicted = 0
        register = find(write[0]) if write else None
        action = 0
        if register is not None:
            mask = sum(0xFF << 8 * i for i in range(4) if write[2] >> i & 1)
            action = write[1] & mask
            if register in self.words:
                kept = self.words[register] & ~mask
                self.words[register] = (kept | action) & self.stored[register]
            elif register is INTERRUPT_PENDING:
                clear = action
        reset = False
        if register is CONTROL:
            reset = bool(action & CONTROL["RESET"].mask)
            steps = [step for step in STEPS if action & start_bit(step)]
            if steps and not reset:
                events |= self._start(steps, busy, action >> 16 & 0x1F, action >> 21 & 0xF)
        if done is not None and busy and not reset:
            events |= self._end(gate, *done)
        if reset:
            self.seen.add("reset while busy" if busy else "reset while idle")
            if busy and done is not None:
                self.seen.add("reset on done")
            if self.step in OF_MODELS and self.program is Program.PREDICT:
                self.seen.add("reset of a chained program")
            self.step, self.stop = Step.IDLE, 1
            self.initialised = self.points = self.predicted = self.residuals = self.gated = 0
            self.propagated = 0
            self.ended, self.error, self.cycles = set(), (0, 0), 0
        if events & clear:
            self.seen.add("set against clear")
        self.pending = self.pending & ~clear | events

    def _start(self, steps, busy, sensor, variant):
        step = steps[0]
        f, h = self.params.models.f, self.params.models.h
        sees = sensor < len(h) and variant < len(h[sensor])
        legal = (
            self.words[CONTROL] & 1
            and not busy
            and len(steps) == 1
            and {
                Step.INIT: True,
                Step.SIG_GEN: self.initialised,
                Step.PREDICT: self.points,
                Step.UPDATE: (
                    (self.residuals or self.points) and sensor < (3 if self.params.sensors else 1)
                ),
                Step.COVARIANCE: self.initialised,
                Step.F: self.points and f is not None,
                Step.H: (self.points or (self.residuals and self.propagated)) and sees,
                Step.ITERATE: self.points and f is not None and sees,
            }[step]
        )
        if not legal:
            self.error = (ErrorCode.ILLEGAL_STEP, 0)
            self.seen.add("illegal while busy" if busy else "illegal while idle")
            return 0b10
        self.error = (0, 0)
        self.cycles = 0
        self.ended -= {step}
        if step in (Step.UPDATE, Step.H, Step.ITERATE):
            self.gated = 0
        if step is Step.SIG_GEN and self.points:
            self.ended |= {step}
            self.seen.add("at once")
            return 0b01
        self.step = step
        self.chosen = sensor, variant
        self.mask = self.words[MASK]
        self._run({
            Step.INIT: Program.INIT,
            Step.SIG_GEN: Program.SIG_GEN_PREDICTED if self.predicted else Program.SIG_GEN,
            Step.PREDICT: Program.PREDICT,
            Step.UPDATE: Program.UPDATE if self.residuals else Program.UPDATE_REDRAWN,
            Step.COVARIANCE: (
                Program.COVARIANCE_PREDICTED if self.predicted else Program.COVARIANCE
            ),
            Step.F: Program.MODEL_F,
            Step.H: Program.MODEL_H,
            Step.ITERATE: Program.MODEL_F,
        }[step])  # fmt: skip
        return 0

    def _run(self, program):
        """Start a program of the step."""
        sensor, variant = self.chosen
        of_sensor = (Program.UPDATE, Program.UPDATE_REDRAWN, Program.MODEL_H)
        self.start, self.program = 1, program
        self.sensor = sensor if program in of_sensor else 0
        self.variant = variant if program is Program.MODEL_H else 0
        if self.sensor:
            self.seen.add("another sensor")
        if self.variant:
            self.seen.add("another variant")

    def _end(self, gate, code, index, nis, overflow):
        program, step = self.program, self.step
        update = program in (Program.UPDATE, Program.UPDATE_REDRAWN)
        magnitude = (1 << (self.params.format.width - 1)) - 1
        gate &= magnitude
        if overflow and gate < self.params.format.infinity:
            code, index, nis = 0, 0, self.params.format.infinity
            self.seen.add("overflow gated")
        kind = "failed" if code else "ended"
        if code:
            self.error = (code, index)
        success = not code
        if update and success:
            self.nis = nis
            if nis & magnitude > gate:
                self.gated, success, kind = 1, False, "gated"
        self.seen.add((kind, program))
        self._leave(program, success, update)
        following = self._following(step, program)
        if not code and following is not None:
            self.seen.add((step, program, following))
            self._run(following)
            return 0
        self.ended |= {step}
        self.step = Step.IDLE
        return 0b01 | (0b10 if code else 0)

    def _following(self, step, program):
        """Program with which a step goes on; None if it ends."""
        if program is Program.MODEL_F:
            return Program.PREDICT
        if program is Program.PREDICT and step is Step.ITERATE:
            return Program.MODEL_H
        if program is Program.MODEL_H:
            return Program.UPDATE if self.residuals else Program.UPDATE_REDRAWN
        return None

    def _leave(self, program, success, update):
        """What a program leaves."""
        if program is Program.MODEL_F and not success:
            self.points = self.predicted = self.residuals = self.propagated = 0
        elif program in (Program.INIT, Program.PREDICT):
            self.propagated = int(success and program is Program.PREDICT)
        elif update or (program in (Program.SIG_GEN, Program.SIG_GEN_PREDICTED) and success):
            self.propagated = 0
        if program is Program.INIT:
            self.initialised = int(success)
            self.points = self.predicted = self.residuals = 0
        elif program in (Program.SIG_GEN, Program.SIG_GEN_PREDICTED) and success:
            self.points, self.predicted, self.residuals = 1, 0, 0
            self.factor_bank ^= program is Program.SIG_GEN_PREDICTED
        elif program is Program.PREDICT:
            self.points = 0
            self.predicted = self.residuals = int(success)
            self.state_bank ^= success
        elif update and success:
            self.points, self.predicted, self.residuals = 1, 0, 0
            self.state_bank ^= 1
            self.factor_bank ^= 1
        elif program is Program.UPDATE_REDRAWN:
            self.points = self.predicted = self.residuals = 0


def find(address):
    return next((r for r in REGISTERS if r.offset == address & ~3), None)


def test_wrong_params_are_rejected():
    with pytest.raises(TypeError, match=r"^Parameters must be a UkfParams, not 3$"):
        Control(3)


def simulate(dut, testbench):
    sim = Simulator(dut)
    sim.add_clock(10e-9)
    sim.add_testbench(testbench)
    sim.run()


class Stimulus:
    """Random accesses and step results that lead deep into the state machine."""

    def __init__(self, params, rng, address_width):
        self.params = params
        self.rng = rng
        self.address_width = address_width

    def strobe(self):
        return 0xF if self.rng.random() < 0.8 else self.rng.getrandbits(4)

    def number(self):
        """A number like any other, so that gates and NIS are close to each other."""
        fmt = self.params.format
        return self.rng.choice([0, 1, 2, fmt.infinity, fmt.infinity - 1, fmt.nan,
                                self.rng.getrandbits(fmt.width)])  # fmt: skip

    def access(self, model):
        rng = self.rng
        choice = rng.random()
        if choice < 0.35:
            return (0, rng.choice(REGISTERS).offset + rng.getrandbits(2), 0, 0)
        if choice < 0.80:
            usual = [*set(STEPS) - OF_MODELS, Step.SIG_GEN, Step.PREDICT, Step.UPDATE]
            if self.params.models:
                usual += [*sorted(OF_MODELS), Step.H, Step.ITERATE]
            bits = start_bit(rng.choice(sorted(usual)))
            if rng.random() < 0.03:
                bits = start_bit(rng.choice(sorted(OF_MODELS)))
            if rng.random() < 0.05:
                bits |= start_bit(rng.choice(STEPS))
            if rng.random() < 0.04:
                bits |= CONTROL["RESET"].mask
            if rng.random() < 0.95:
                bits |= CONTROL["ENABLE"].mask
            if rng.random() < 0.3:
                bits |= rng.choice([0, 1, 2, 2, 3, 31]) << 16
            if rng.random() < 0.3:
                bits |= rng.choice([0, 1, 1, 2, 15]) << 21
            bits |= rng.getrandbits(32) & ~0x1FFFF03 if rng.random() < 0.2 else 0
            return (1, CONTROL.offset, bits, self.strobe())
        if choice < 0.90:
            gate = self.number()
            low = rng.random() < 0.5
            register = GATE_LOW if low else GATE_HIGH
            return (1, register.offset, (gate if low else gate >> 32) & 0xFFFF_FFFF, self.strobe())
        if choice < 0.97:
            register = rng.choice([r for r in REGISTERS if r is not CONTROL])
            return (1, register.offset, rng.getrandbits(32), self.strobe())
        return (rng.getrandbits(1), rng.getrandbits(self.address_width), rng.getrandbits(32), 0xF)

    def result(self, program):
        """Error code and index, NIS, and whether the error is an innovation that is too large."""
        update = program in (Program.UPDATE, Program.UPDATE_REDRAWN)
        overflow = update and self.rng.random() < 0.15
        code = 2 * overflow or (0 if self.rng.random() < 0.72 else self.rng.choice([2, 3, 4]))
        return code, self.rng.getrandbits(8) if code else 0, self.number(), overflow


EVENTS = {
    "illegal while busy", "illegal while idle", "reset while busy", "reset while idle", "at once",
    "set against clear", "reset on done", "overflow gated",
    *((kind, program) for program in Program if "MODEL" not in program.name
      for kind in ("ended", "failed")),
    ("gated", Program.UPDATE), ("gated", Program.UPDATE_REDRAWN),
}  # fmt: skip
#: The same of a core with models.
EVENTS_OF_MODELS = {
    "another variant",
    *((kind, program) for program in (Program.MODEL_F, Program.MODEL_H)
      for kind in ("ended", "failed")),
    (Step.F, Program.MODEL_F, Program.PREDICT), (Step.H, Program.MODEL_H, Program.UPDATE),
    (Step.H, Program.MODEL_H, Program.UPDATE_REDRAWN),
    (Step.ITERATE, Program.MODEL_F, Program.PREDICT),
    (Step.ITERATE, Program.PREDICT, Program.MODEL_H),
    (Step.ITERATE, Program.MODEL_H, Program.UPDATE),
    "reset of a chained program",
}  # fmt: skip


#: Clocks within which chance must have met everything.
LONGEST = 64000


@pytest.mark.parametrize("params", PARAMS)
def test_agrees_with_model_on_every_clock(params):
    rng = random.Random(repr(params))
    dut = Control(params)
    access = dut.access
    model = Model(params)
    stimulus = Stimulus(params, rng, len(access.address))
    wanted = EVENTS | ({"another sensor"} if params.sensors else set())
    wanted |= EVENTS_OF_MODELS if params.models else set()

    async def testbench(ctx):
        request = None
        answer = None
        age = 0
        for clock in range(LONGEST):
            if clock >= 16000 and model.seen >= wanted:
                break
            # Everything that happens on this clock. A step ends while a write takes effect rather
            # often, so that the races are met.
            if request is None and rng.random() < 0.8:
                request = stimulus.access(model)
                if model.step != Step.IDLE and rng.random() < 0.4:
                    request = (1, INTERRUPT_PENDING.offset, rng.getrandbits(2), 0xF)
                elif model.step in OF_MODELS and rng.random() < 0.08:
                    request = (1, CONTROL.offset, CONTROL["RESET"].mask | 1, 0xF)
                age = 0
            taking_effect = request is not None and age == 1
            busy = model.step != Step.IDLE
            end = rng.random() < (0.6 if taking_effect else 0.1)
            result = stimulus.result(model.program)
            written = (0, 0)
            if not busy and request is None:
                written = (rng.random() < 0.1, rng.random() < 0.1)
            ctx.set(access.valid, request is not None)
            if request is not None:
                for signal, value in zip(
                    (access.write, access.address, access.data, access.strobe), request, strict=True
                ):
                    ctx.set(signal, value)
            ctx.set(dut.run.done, end)
            ctx.set(dut.run.error_code, result[0] if end else rng.getrandbits(8))
            ctx.set(dut.run.error_index, result[1])
            ctx.set(dut.run.nis, result[2])
            ctx.set(dut.run.innovation_overflow, result[3])
            ctx.set(dut.written.state, written[0])
            ctx.set(dut.written.factor, written[1])

            outputs = {name: ctx.get(attrgetter(name)(dut)) for name in model.outputs}
            assert outputs == model.outputs
            write = None
            if request is not None:
                is_write, address, data, strobe = request
                if age == 0:
                    answer = model.read(address)
                    assert not ctx.get(access.ack)
                else:
                    assert ctx.get(access.ack)
                    assert ctx.get(access.error) == (find(address) is None)
                    if not is_write:
                        name = register.name if (register := find(address)) else address
                        assert ctx.get(access.read_data) == (answer or 0), name
                    else:
                        write = (address, data, strobe)
            model.clock(
                write=write,
                state_written=written[0],
                factor_written=written[1],
                done=result if end else None,
            )
            if taking_effect:
                request = None
            age += 1
            await ctx.tick()

    simulate(dut, testbench)
    assert model.seen >= wanted, f"the stimulus never met {wanted - model.seen}"


class Bench:
    """Register accesses by name, and the engine played by hand."""

    def __init__(self, ctx, dut):
        self.ctx = ctx
        self.dut = dut
        self.manager = AccessManager(dut.access)

    async def read(self, register):
        data, error, _ = await self.manager.read(self.ctx, register.offset)
        assert not error
        return data

    async def get(self, register, name):
        return register[name].get(await self.read(register))

    async def write(self, register, data, strobe=0xF):
        error, _ = await self.manager.write(self.ctx, register.offset, data, strobe)
        assert not error

    async def start(self, step):
        await self.write(CONTROL, start_bit(step) | 1)

    async def end(self, clocks=3, code=0, index=0, nis=0):
        ctx, dut = self.ctx, self.dut
        for _ in range(clocks - 1):
            await ctx.tick()
        ctx.set(dut.run.done, 1)
        ctx.set(dut.run.error_code, code)
        ctx.set(dut.run.error_index, index)
        ctx.set(dut.run.nis, nis)
        await ctx.tick()
        ctx.set(dut.run.done, 0)

    async def run(self, step, **result):
        await self.start(step)
        await self.end(**result)


def with_bench(params=PARAMS[0].values[0]):
    """Run a coroutine of a bench in the simulator."""

    def wrap(test):
        def run():
            dut = Control(params)

            async def testbench(ctx):
                await test(Bench(ctx, dut))

            simulate(dut, testbench)

        run.__name__ = test.__name__
        run.__doc__ = test.__doc__
        return run

    return wrap


@with_bench()
async def test_reset_values_are_those_of_the_description(bench):
    p = PARAMS[0].values[0]
    for register in REGISTERS:
        expected = sum(f.put(f.reset) for f in register)
        if register is SIZES:
            expected = p.n | p.m << 24
        elif register is CONFIG:
            expected = p.pes | 8 << 8 | 23 << 12
        elif register is MASK:
            expected = 1
        elif register is GATE_LOW:
            expected = 0x7F80_0000
        elif register is SENSORS:
            expected = 1
        assert await bench.read(register) == expected, register.name


@with_bench()
async def test_cycles_count_the_clocks_for_which_a_step_runs(bench):
    await bench.run(Step.INIT, clocks=5)
    assert await bench.read(CYCLES) == 5
    await bench.run(Step.SIG_GEN, clocks=1)
    assert await bench.read(CYCLES) == 1
    await bench.start(Step.SIG_GEN)
    assert await bench.read(CYCLES) == 0, "sigma points were there already"
    assert await bench.get(STATUS, "SIG_GEN") == 1


@with_bench()
async def test_start_follows_the_write_by_a_clock(bench):
    await bench.start(Step.INIT)
    assert bench.ctx.get(bench.dut.run.start)
    assert bench.ctx.get(bench.dut.busy)
    await bench.ctx.tick()
    assert not bench.ctx.get(bench.dut.run.start)


@with_bench()
async def test_a_read_right_after_a_write_sees_it(bench):
    for word in (0x1234_5678, 0xFFFF_0000, 0):
        await bench.write(GATE_LOW, word)
        assert await bench.read(GATE_LOW) == word


@with_bench()
async def test_bytes_that_are_not_strobed_stay(bench):
    await bench.write(GATE_LOW, 0x1122_3344)
    await bench.write(GATE_LOW, 0xAABB_CCDD, strobe=0b0110)
    assert await bench.read(GATE_LOW) == 0x11BB_CC44
    await bench.write(CONTROL, 1)
    await bench.write(CONTROL, start_bit(Step.INIT), strobe=0b0010)
    assert await bench.get(CONTROL, "ENABLE") == 1
    assert await bench.get(STATUS, "STATE") == Step.INIT
    await bench.end()
    await bench.write(INTERRUPT_PENDING, 0b11, strobe=0b1110)
    assert await bench.read(INTERRUPT_PENDING) == 0b01
    await bench.write(CONTROL, CONTROL["RESET"].mask | start_bit(Step.INIT), strobe=0b0000)
    assert await bench.get(STATUS, "INITIALISED") == 1


@pytest.mark.parametrize(
    ("params", "mask", "low", "high"),
    [
        (UkfParams(n=1, m=1), 1, 0xFFFF_FFFF, 0),
        (UkfParams(n=1, m=6, sensors=(2, 4)), 0b11_1111, 0xFFFF_FFFF, 0),
        (UkfParams(n=1, m=32, format=BINARY16), 0xFFFF_FFFF, 0xFFFF, 0),
        (UkfParams(n=1, m=31, format=BINARY64), 0x7FFF_FFFF, 0xFFFF_FFFF, 0xFFFF_FFFF),
    ],
)
def test_bits_that_a_core_has_no_use_for_are_reserved(params, mask, low, high):
    dut = Control(params)

    async def testbench(ctx):
        bench = Bench(ctx, dut)
        assert await bench.read(MASK) == mask, "all observations take part after reset"
        for register, stored in ((MASK, mask), (GATE_LOW, low), (GATE_HIGH, high)):
            for word in (0xFFFF_FFFF, 0, 0xA5A5_A5A5):
                await bench.write(register, word)
                assert await bench.read(register) == word & stored, register.name

    simulate(dut, testbench)


@pytest.mark.parametrize("sensors", [(), (1, 1, 1)])
def test_an_update_of_a_sensor_that_is_not_there_is_illegal(sensors):
    dut = Control(UkfParams(n=1, m=3, sensors=sensors))

    async def testbench(ctx):
        bench = Bench(ctx, dut)
        for sensor in range(32):
            word = CONTROL["SENSOR"].put(sensor) | CONTROL["ENABLE"].mask
            await bench.write(CONTROL, word | start_bit(Step.INIT))
            await bench.end()
            await bench.run(Step.SIG_GEN)
            assert await bench.read(ERROR) == 0, "SENSOR counts for UPDATE only"
            before = await bench.read(STATUS)
            await bench.write(CONTROL, word | start_bit(Step.UPDATE))
            if sensor < max(len(sensors), 1):
                assert await bench.get(STATUS, "STATE") == Step.UPDATE
                assert ctx.get(dut.run.sensor) == sensor
                await bench.end()
            else:
                assert await bench.read(ERROR) == ErrorCode.ILLEGAL_STEP
                assert await bench.read(STATUS) == before

    simulate(dut, testbench)


@with_bench()
async def test_the_mask_is_that_of_the_start(bench):
    await bench.write(MASK, 1)
    await bench.start(Step.INIT)
    await bench.write(MASK, 0)
    assert bench.ctx.get(bench.dut.run.observation_mask) == 1, "a running step keeps its mask"
    await bench.end()
    await bench.start(Step.SIG_GEN)
    assert bench.ctx.get(bench.dut.run.observation_mask) == 0


@with_bench()
async def test_reset_stops_a_step_and_keeps_the_settings(bench):
    await bench.write(MASK, 1)
    await bench.write(GATE_LOW, 0x3F80_0000)
    await bench.write(INTERRUPT_ENABLE, 3)
    await bench.run(Step.INIT)
    await bench.run(Step.SIG_GEN)
    await bench.run(Step.UPDATE, nis=0x3F00_0000)
    assert await bench.read(NIS_LOW) == 0x3F00_0000
    await bench.start(Step.PREDICT)
    await bench.write(CONTROL, CONTROL["RESET"].mask | start_bit(Step.INIT) | 1)
    assert bench.ctx.get(bench.dut.run.stop)
    assert not bench.ctx.get(bench.dut.run.start)
    assert await bench.read(STATUS) == 0
    assert await bench.read(ERROR) == 0
    assert await bench.read(CYCLES) == 0
    assert await bench.read(CONTROL) == 1
    assert await bench.read(MASK) == 1
    assert await bench.read(GATE_LOW) == 0x3F80_0000
    assert await bench.read(NIS_LOW) == 0x3F00_0000
    assert await bench.read(INTERRUPT_ENABLE) == 3
    assert await bench.read(INTERRUPT_PENDING) == 1
    assert bench.ctx.get(bench.dut.banks.state) == 1
    assert bench.ctx.get(bench.dut.banks.factor) == 1
    await bench.end()  # too late
    assert await bench.read(STATUS) == 0


@with_bench()
async def test_enable_counts_as_of_the_same_write(bench):
    await bench.write(CONTROL, start_bit(Step.INIT))
    assert await bench.get(ERROR, "CODE") == ErrorCode.ILLEGAL_STEP
    await bench.write(CONTROL, start_bit(Step.INIT) | 1)
    assert await bench.read(ERROR) == 0
    assert await bench.get(STATUS, "STATE") == Step.INIT
    await bench.write(CONTROL, 0)
    assert await bench.get(STATUS, "STATE") == Step.INIT, "a running step goes on"
    await bench.end()
    assert await bench.get(STATUS, "INITIALISED") == 1
    await bench.write(CONTROL, start_bit(Step.SIG_GEN))
    assert await bench.get(ERROR, "CODE") == ErrorCode.ILLEGAL_STEP


@with_bench()
async def test_an_illegal_start_does_not_disturb_the_running_step(bench):
    await bench.start(Step.INIT)
    await bench.start(Step.PREDICT)
    assert await bench.get(STATUS, "STATE") == Step.INIT
    await bench.end()
    assert await bench.get(ERROR, "CODE") == ErrorCode.ILLEGAL_STEP, "stays after a good end"
    await bench.start(Step.SIG_GEN)
    await bench.start(Step.SIG_GEN)
    await bench.end(code=ErrorCode.NOT_POSITIVE_DEFINITE, index=4)
    assert await bench.read(ERROR) == ErrorCode.NOT_POSITIVE_DEFINITE | 4 << 8


@with_bench()
async def test_an_event_wins_over_the_clear(bench):
    ctx, dut = bench.ctx, bench.dut
    await bench.write(INTERRUPT_ENABLE, 1)
    await bench.run(Step.INIT)
    await bench.start(Step.SIG_GEN)
    assert ctx.get(dut.irq)
    access = dut.access
    ctx.set(access.valid, 1)
    ctx.set(access.write, 1)
    ctx.set(access.address, INTERRUPT_PENDING.offset)
    ctx.set(access.data, 1)
    ctx.set(access.strobe, 0xF)
    await ctx.tick()
    ctx.set(dut.run.done, 1)
    await ctx.tick()
    ctx.set(dut.run.done, 0)
    ctx.set(access.valid, 0)
    assert ctx.get(dut.irq)
    await bench.write(INTERRUPT_PENDING, 1)
    assert not ctx.get(dut.irq)


@pytest.mark.parametrize("params", PARAMS)
def test_only_registers_answer(params):
    dut = Control(params)
    size = 1 << (MemoryMap(params).address_width - MemoryMap(params).region_bits)
    mapped = {register.offset for register in REGISTERS}

    async def testbench(ctx):
        manager = AccessManager(dut.access)
        for address in range(0, size, 4):
            data, error, clocks = await manager.read(ctx, address)
            assert (error, clocks) == (address not in mapped, 2), hex(address)
            assert not (error and data)
        before = [await manager.read(ctx, address) for address in sorted(mapped)]
        for address in range(0, size, 4):
            if address not in mapped:
                assert await manager.write(ctx, address, 0xFFFF_FFFF) == (1, 2), hex(address)
        assert [await manager.read(ctx, address) for address in sorted(mapped)] == before

    simulate(dut, testbench)
