"""The golden core with models: F, H and ITERATE are what their programs are, in order."""

import copy
import dataclasses
import random

import numpy as np
import pytest

from support.random_models import any_models, sane_models, with_models
from ukf_sw.drivers.bus import WordCodec
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.golden import GoldenCore
from ukf_sw.spec.float_format import BFLOAT16, BINARY32, BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, UkfParams
from ukf_sw.spec.registers import (
    CONFIG,
    CONTROL,
    CYCLES,
    ERROR,
    GATE_HIGH,
    GATE_LOW,
    INTERRUPT_PENDING,
    MASK,
    MODELS,
    NIS_HIGH,
    NIS_LOW,
    STATUS,
    ErrorCode,
)
from ukf_sw.spec.sequence import Flag, Program, Step

ENABLE, RESET = CONTROL["ENABLE"].mask, CONTROL["RESET"].mask
ILLEGAL = (int(ErrorCode.ILLEGAL_STEP), 0)
NONE = (0, 0)
SIZES = [
    UkfParams(n=2, m=3, q=1, r=2, sensors=(1, 2), pes=2),
    UkfParams(
        n=2, m=2, q=2, r=2, pes=3, W0=0.25, form=Form.COVARIANCE, format=BINARY64,
        process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
    ),
]  # fmt: skip


class Counting(Interpreter):
    """An engine that notes what it ran."""

    def __init__(self, params):
        super().__init__(params)
        self.ran = []

    def run(self, program, **arguments):
        self.ran.append((program, arguments["sensor"], arguments["variant"]))
        return super().run(program, **arguments)


def with_sane_models(params):
    return with_models(params, sane_models(random.Random(repr(params)), params))


class Core(GoldenCore):
    """A golden core with a filter in it."""

    def __init__(self, params):
        super().__init__(params, engine=Counting(params))
        self.map = MemoryMap(params)
        self.codec = WordCodec(params.format)
        rng = np.random.default_rng(1)
        self.fill("x", rng.normal(size=(1, params.n)))
        self.fill("L", np.tril(0.3 * rng.normal(size=(params.n, params.n))) + np.eye(params.n))
        for symbol in ("LQ", "LR"):
            if symbol in self.map:
                region = self.map[symbol]
                self.fill(symbol, 0.5 * np.eye(region.rows, region.columns))
        if "LR" in self.map and params.additive_r and len(params.sensor_rows) == 1:
            self.fill("LR", 0.5 * np.eye(params.m))
        self.fill("U", np.full((1, len(params.models.inputs)), 0.5))
        self.fill("z", rng.normal(size=(params.m, 1)))
        assert self.step(Step.INIT) == NONE

    def fill(self, symbol, values):
        region = self.map[symbol]
        size = self.params.format.bus_words
        values = np.reshape(values, (region.rows, region.columns))
        for (row, column), value in np.ndenumerate(values):
            for k, word in enumerate(self.codec.to_words(np.array([value])).tolist()):
                address = self.map.address(symbol, row, column) + 4 * k
                assert self.write(address, word), (symbol, size)

    def get(self, register):
        return self.read(register.offset)[0]

    @property
    def error(self):
        word = self.get(ERROR)
        return ERROR["CODE"].get(word), ERROR["INDEX"].get(word)

    def step(self, step, sensor=0, variant=0):
        word = CONTROL["SENSOR"].put(sensor) | CONTROL["VARIANT"].put(variant)
        self.write(CONTROL.offset, ENABLE | CONTROL[step.name].mask | word)
        return self.error

    def left(self):
        """All that a step leaves: memories, flags, banks, and what registers show of its result."""
        status = self.get(STATUS) & 0xFF
        return (
            self.engine.memory.tolist(), self.flags, self.banks, status, self.error,
            self.get(NIS_LOW), self.get(NIS_HIGH),
        )  # fmt: skip


@pytest.fixture(scope="module", params=range(len(SIZES)), ids=["square root", "covariance"])
def pristine(request):
    """A core with sigma points."""
    core = Core(with_sane_models(SIZES[request.param]))
    assert core.step(Step.SIG_GEN) == NONE
    return core


@pytest.fixture
def pair(pristine):
    """The same core twice."""
    return copy.copy(pristine), copy.copy(pristine)


def poison(core, u=np.nan):
    """Make every result of a model that takes u a NaN, where it does."""
    core.fill("U", np.full((1, len(core.params.models.inputs)), u))


#: What is done to a core before, and what of it goes wrong.
OUTCOMES = {
    "success": lambda core: None,
    "gate": lambda core: (core.write(GATE_LOW.offset, 1), core.write(GATE_HIGH.offset, 0)),
    "mask": lambda core: core.write(MASK.offset, 0b01),
    "all masked": lambda core: core.write(MASK.offset, 0),
    "z is NaN": lambda core: core.fill("z", np.full((core.params.m, 1), np.nan)),
    "z is large": lambda core: core.fill("z", np.full((core.params.m, 1), 1e38)),
    "u is NaN": poison,
}

SOME_OUTCOMES = [
    outcome
    if outcome in ("success", "gate", "u is NaN")
    else pytest.param(outcome, marks=pytest.mark.slow)
    for outcome in OUTCOMES
]


@pytest.mark.parametrize("outcome", OUTCOMES)
@pytest.mark.parametrize("second", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_iterate_is_f_then_h(pair, outcome, second):
    """Everything that they leave is equal; CYCLES add up, and so do the programs."""
    whole, parts = pair
    sensor = len(whole.params.sensor_rows) - 1 if second else 0
    variant = 0 if sensor else int(second)
    for core in pair:
        OUTCOMES[outcome](core)
        core.engine.ran.clear()
    found = whole.step(Step.ITERATE, sensor, variant)
    cycles = parts.step(Step.F) and parts.get(CYCLES)
    if parts.error == NONE:
        parts.step(Step.H, sensor, variant)
        cycles += parts.get(CYCLES)
    assert whole.left() == parts.left()
    assert whole.get(CYCLES) == cycles
    assert whole.engine.ran == parts.engine.ran
    programs = [program for program, *_ in whole.engine.ran]
    expected = [Program.MODEL_F, Program.PREDICT, Program.MODEL_H, Program.UPDATE]
    assert programs == expected[: len(programs)]
    assert cycles == sum(
        whole.engine.clocks(program, sensor if program in (Program.MODEL_H, Program.UPDATE) else 0,
                            variant if program is Program.MODEL_H else 0)
        for program in programs
    )  # fmt: skip
    assert STATUS["ITERATE"].get(whole.get(STATUS)) == 1
    gated = STATUS["GATED"].get(whole.get(STATUS))
    if outcome in ("success", "mask"):
        assert (found, gated, len(programs)) == (NONE, 0, 4)
    elif outcome == "gate":
        assert (found, gated, len(programs)) == (NONE, 1, 4)
    elif outcome == "z is NaN":
        assert found == (ErrorCode.NOT_FINITE, 0)
    elif outcome == "u is NaN":
        assert found[0] in (ErrorCode.MODEL_F, ErrorCode.MODEL_H)


@pytest.mark.parametrize("outcome", SOME_OUTCOMES)
def test_f_and_h_are_their_programs(pair, outcome):
    """F is MODEL_F and then PREDICT; H is MODEL_H and then UPDATE, on the same memories."""
    core, reference = pair
    OUTCOMES[outcome](core)
    OUTCOMES[outcome](reference)
    core.step(Step.F)
    engine = reference.engine
    result = Interpreter.run(engine, Program.MODEL_F, state_bank=reference.state_bank,
                             factor_bank=reference.factor_bank)  # fmt: skip
    if not result.error_code:
        assert reference.step(Step.PREDICT) == NONE
        assert core.error == NONE
        assert core.banks == reference.banks
    np.testing.assert_array_equal(core.engine.memory, engine.memory)
    if result.error_code:
        assert core.error == (result.error_code, result.error_index)
        assert core.flags == Flag.INITIALISED
        return
    core.step(Step.H, 0, 0)
    mask = reference.get(MASK)
    result = Interpreter.run(
        engine, Program.MODEL_H, mask=mask, state_bank=reference.state_bank,
        factor_bank=reference.factor_bank,
    )  # fmt: skip
    if not result.error_code:
        reference.step(Step.UPDATE)
        assert core.left() == reference.left()
    np.testing.assert_array_equal(core.engine.memory, engine.memory)


class Failing(Counting):
    """An engine one of whose programs ends with an error, whatever its numbers are."""

    failing = None
    error = NONE

    def run(self, program, **arguments):
        result = super().run(program, **arguments)
        if program is self.failing and arguments.get("stop_after") is None:
            return result._replace(error_code=self.error[0], error_index=self.error[1])
        return result


@pytest.mark.parametrize(
    ("program", "code", "flags", "after"),
    [
        (Program.MODEL_F, ErrorCode.MODEL_F, Flag.INITIALISED, 1),
        (Program.PREDICT, ErrorCode.NOT_FINITE, Flag.INITIALISED, 2),
        (
            Program.MODEL_H, ErrorCode.MODEL_H,
            Flag.INITIALISED | Flag.RESIDUALS | Flag.PREDICTED | Flag.PROPAGATED, 3,
        ),
        (
            Program.UPDATE, ErrorCode.SINGULAR_OBSERVATION,
            Flag.INITIALISED | Flag.RESIDUALS | Flag.PREDICTED, 4,
        ),
    ],
)  # fmt: skip
def test_an_error_ends_a_step_where_it_is(pair, program, code, flags, after):
    core, _ = pair
    banks = core.banks
    core.engine.__class__ = Failing
    core.engine.failing, core.engine.error = program, (int(code), 1)
    core.engine.ran.clear()
    core.write(INTERRUPT_PENDING.offset, 0b11)
    assert core.step(Step.ITERATE) == (code, 1)
    assert len(core.engine.ran) == after
    assert core.flags == flags
    assert core.get(INTERRUPT_PENDING) == 0b11
    assert STATUS["ITERATE"].get(core.get(STATUS)) == 1
    assert STATUS["STATE"].get(core.get(STATUS)) == Step.IDLE
    assert core.banks ^ banks == (1 if after > 2 else 0), "PREDICT turns the bank of x alone"
    assert core.get(CYCLES) == sum(core.engine.clocks(*each) for each in core.engine.ran)


def test_what_may_follow_a_rejected_update(pair):
    """Its prediction is there, so UPDATE may be tried again; its sigma points are not, so H not."""
    core, _ = pair
    last = len(core.params.sensor_rows) - 1
    OUTCOMES["gate"](core)
    assert core.step(Step.ITERATE) == NONE
    assert STATUS["GATED"].get(core.get(STATUS)) == 1
    assert core.flags & Flag.RESIDUALS
    assert not core.flags & Flag.PROPAGATED
    for step in (Step.H, Step.F, Step.ITERATE):
        assert core.step(step, last) == ILLEGAL, step
    assert core.step(Step.SIG_GEN) == NONE
    assert core.engine.ran[-1][0] is Program.SIG_GEN_PREDICTED
    core.write(GATE_LOW.offset, core.params.format.infinity & 0xFFFF_FFFF)
    core.write(GATE_HIGH.offset, core.params.format.infinity >> 32)
    assert core.step(Step.H, last) == NONE
    assert [each[0] for each in core.engine.ran[-2:]] == [Program.MODEL_H, Program.UPDATE_REDRAWN]


def test_h_after_an_update_draws_nothing_and_reads_the_new_points(pair):
    core, _ = pair
    assert core.step(Step.ITERATE) == NONE
    assert core.flags == Flag.INITIALISED | Flag.POINTS
    assert core.step(Step.H) == NONE
    assert [each[0] for each in core.engine.ran[-2:]] == [Program.MODEL_H, Program.UPDATE_REDRAWN]
    assert core.step(Step.ITERATE) == NONE


def test_writing_the_estimate_forbids_what_needs_points(pair):
    core, _ = pair
    assert core.step(Step.F) == NONE
    core.fill("x", np.zeros((1, core.params.n)))
    for step in (Step.H, Step.F, Step.ITERATE):
        assert core.step(step) == ILLEGAL
    assert core.step(Step.SIG_GEN) == NONE
    assert core.step(Step.ITERATE) == NONE


# What is illegal.


def without(params, *names):
    return with_models(params, dataclasses.replace(params.models, **{
        name: None if name == "f" else () for name in names
    }))  # fmt: skip


@pytest.mark.parametrize("missing", [(), ("f",), ("h",), ("f", "h")])
def test_steps_of_models_that_a_core_has_not_are_illegal(missing):
    params = without(with_sane_models(SIZES[0]), *missing)
    core = GoldenCore(params)
    config = core.read(CONFIG.offset)[0]
    assert CONFIG["HAS_F"].get(config) == ("f" not in missing)
    assert CONFIG["HAS_H"].get(config) == ("h" not in missing)
    assert (core.read(MODELS.offset)[0] == 0) == (len(missing) == 2)
    needed = {Step.F: {"f"}, Step.H: {"h"}, Step.ITERATE: {"f", "h"}}
    for step, needs in needed.items():
        core.write(CONTROL.offset, ENABLE | RESET)
        for before in (Step.INIT, Step.SIG_GEN):
            core.write(CONTROL.offset, ENABLE | CONTROL[before.name].mask)
        core.write(CONTROL.offset, ENABLE | CONTROL[step.name].mask)
        found = ERROR["CODE"].get(core.read(ERROR.offset)[0]) == ErrorCode.ILLEGAL_STEP
        assert found == bool(needs & set(missing)), step


@pytest.mark.parametrize("step", [Step.F, Step.H, Step.ITERATE, Step.UPDATE, Step.PREDICT])
def test_sensors_and_variants_that_are_not_there(pristine, step):
    models = pristine.params.models
    for sensor in (0, 1, 2, 31):
        for variant in (0, 1, 2, 15):
            core = copy.copy(pristine)
            core.engine.ran.clear()
            there = sensor < len(models.h)
            if step in (Step.H, Step.ITERATE):
                there = there and variant < len(models.h[sensor])
            elif step is not Step.UPDATE:
                there = True
            found = core.step(step, sensor, variant)
            assert (found == ILLEGAL) is not there, (sensor, variant)
            assert bool(core.engine.ran) is there
            if there and step in (Step.H, Step.ITERATE):
                assert (Program.MODEL_H, sensor, variant) in core.engine.ran


def test_variants_are_other_models(pair):
    first, second = pair
    assert first.step(Step.ITERATE, 0, 0) == NONE
    assert second.step(Step.ITERATE, 0, 1) == NONE
    assert first.left()[0] != second.left()[0]


# While a step runs.


def test_a_held_step_runs_as_one(pristine):
    """Registers see one step, and its cycles from its start."""
    core, reference = copy.copy(pristine), copy.copy(pristine)
    reference.step(Step.ITERATE)
    core.hold = True
    core.step(Step.ITERATE)
    core.advance(7)
    assert STATUS["STATE"].get(core.get(STATUS)) == Step.ITERATE
    assert core.get(CYCLES) == 7
    assert core.step(Step.F) == ILLEGAL
    core.finish()
    assert core.get(CYCLES) == reference.get(CYCLES)
    assert core.left()[0:3] == reference.left()[0:3]


@pytest.mark.parametrize(
    "step",
    [*(pytest.param(step, marks=pytest.mark.slow) for step in (Step.F, Step.H)), Step.ITERATE],
)
def test_reset_in_a_chained_step(pristine, step):
    """Programs that have ended count, and the one that runs is dropped where it is."""
    start = copy.copy(pristine)
    programs = {
        Step.F: [Program.MODEL_F, Program.PREDICT],
        Step.H: [Program.MODEL_H, Program.UPDATE_REDRAWN],
        Step.ITERATE: [Program.MODEL_F, Program.PREDICT, Program.MODEL_H, Program.UPDATE],
    }[step]  # fmt: skip
    lengths = [start.engine.clocks(program) for program in programs]
    rng = random.Random(5)
    ends = np.cumsum([0, *lengths]).tolist()
    moments = {0, 1, *(end + k for end in ends for k in (-1, 0, 1, 2) if end + k >= 0)}
    moments |= {rng.randrange(ends[-1]) for _ in range(10)}
    for clocks in sorted(moments):
        core = copy.copy(pristine)
        core.hold = True
        assert core.step(step) == NONE
        core.advance(clocks)
        core.write(CONTROL.offset, ENABLE | RESET)
        # The same with the engine alone.
        engine = copy.deepcopy(pristine.engine)
        banks = pristine.banks
        left = clocks
        for index, (program, length) in enumerate(zip(programs, lengths, strict=True)):
            ended = left >= length and index + 1 < len(programs)
            Interpreter.run(
                engine, program, state_bank=int(bool(banks & 1)), factor_bank=int(bool(banks & 2)),
                stop_after=None if ended else left, mask=core.get(MASK),
            )  # fmt: skip
            if not ended:
                break
            left -= length
            banks ^= 1 if program is Program.PREDICT else 0
        np.testing.assert_array_equal(core.engine.memory, engine.memory, f"after {clocks}")
        assert core.banks == banks
        assert core.flags == 0
        assert not core.busy
        assert core.get(STATUS) == core.get(ERROR) == core.get(CYCLES) == 0


def test_an_error_before_a_reset_has_ended_the_step(pair):
    """MODEL_F fails; what a reset long after finds is a core that is idle."""
    core, reference = pair
    for each in pair:
        each.engine.__class__ = Failing
        each.engine.failing, each.engine.error = Program.MODEL_F, (int(ErrorCode.MODEL_F), 1)
        each.write(INTERRUPT_PENDING.offset, 0b11)
    reference.step(Step.ITERATE)
    reference.write(CONTROL.offset, ENABLE | RESET)
    core.hold = True
    core.step(Step.ITERATE)
    core.advance(core.engine.clocks(Program.MODEL_F) + 3)
    core.write(CONTROL.offset, ENABLE | RESET)
    assert core.left() == reference.left()
    assert core.get(INTERRUPT_PENDING) == reference.get(INTERRUPT_PENDING) == 0b11


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_models_of_any_steps_keep_iterate_equal(seed):
    """Whatever NaN they make, and in whichever part."""
    rng = random.Random(seed)
    params = dataclasses.replace(
        SIZES[0], format=(BINARY32, BFLOAT16, BINARY32)[seed], pes=1 + seed,
    )  # fmt: skip
    params = with_models(params, any_models(rng, params, steps=12, finite=0.7))
    codes = set()
    core = Core(params)
    assert core.step(Step.SIG_GEN) == NONE
    for sensor in (0, 1):
        for mask in range(8):
            whole, parts = copy.copy(core), copy.copy(core)
            for each in (whole, parts):
                each.write(MASK.offset, mask)
            whole.step(Step.ITERATE, sensor)
            if parts.step(Step.F) == NONE:
                parts.step(Step.H, sensor)
            assert whole.left() == parts.left()
            codes.add(whole.error[0])
    assert codes
