"""Programs of models on the array: the words that a core executes against the steps themselves."""

import dataclasses
import itertools
import random
from collections import defaultdict
from functools import cache

import numpy as np
import pytest

from support.model_memory import ModelMemory, model_of
from support.random_cores import random_configuration
from support.random_models import any_models, with_models
from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.engine.checker import ScheduleError, check_schedule
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.engine.layout import TEMPORARY
from ukf_sw.engine.microcode import microcode, routines
from ukf_sw.engine.scheduler import dependences
from ukf_sw.lowering.endings import end
from ukf_sw.lowering.program import lower
from ukf_sw.problem import Problem, Sensor
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.forms import Condition
from ukf_sw.spec.model_programs import CoreModels, ModelProgram, Source, SourceKind
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Program, Routine
from ukf_sw.tracing.models import trace_problem

#: Models of the catalogue with the processing elements of their cores.
SYSTEMS = {"pendulum": 1, "nanosat-additive": 7, "ctrv": 4}
SLOW = {"battery": 2, "nanosat": 5, "gps-ins": 6, "ctrv-masked": 3, "recorded-odometry": 2,
        "reentry-earth": 4, "swampsat": 5}  # fmt: skip


@cache
def of_catalogue(name, **changes):
    """A problem and its core with models."""
    problem = CATALOGUE[name].scenario(0, 100)
    params = dataclasses.replace(CATALOGUE[name].params, **changes)
    return problem, with_models(params, lower(trace_problem(problem), problem, params.format))


@cache
def at_random(seed):
    """A core of any sizes with models of any steps, and its pipeline."""
    rng = random.Random(seed)
    params, pipeline = random_configuration(rng, largest=4)
    params = dataclasses.replace(params, pes=min(params.pes, 6))
    return with_models(params, any_models(rng, params)), pipeline


def routines_of_models(params):
    found = [
        each for each in routines(params) if each.program in (Program.MODEL_F, Program.MODEL_H)
    ]
    assert len(found) == len([*params.models]) > 0
    return found


def run_and_compare(params, pipeline, rng, draw=None, mask=-1):
    """Run every model once; gives how many numbers were compared."""
    compared = 0
    for routine in routines_of_models(params):
        engine = Interpreter(params, pipeline)
        memory = ModelMemory(engine.layout, rng, draw)
        memory.poison(routine.program)
        engine.memory[:] = memory.words
        result = engine.run(
            routine.program, sensor=routine.sensor, variant=routine.variant, mask=mask
        )
        assert result.error_code == 0, routine
        assert result.nis is None
        free = memory.lent(routine.program)
        expected = memory.expect(routine, mask)
        np.testing.assert_array_equal(engine.memory[~free], expected[~free], str(routine))
        assert (engine.memory[free] != memory.words[free]).any() or not needs_temporaries(
            params, routine
        )
        compared += sum(row.size for row in memory.results(routine)[0])
    return compared


def needs_temporaries(params, routine):
    return bool(microcode(params, Pipeline()).programs[routine].places)


@pytest.mark.parametrize(
    "name", [*SYSTEMS, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]
)
@pytest.mark.parametrize("W0", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_models_of_the_catalogue(name, W0):
    problem, params = of_catalogue(name, pes=(SYSTEMS | SLOW)[name], W0=W0)
    rng = np.random.default_rng(1)
    deviations = np.sqrt(np.diag(problem.P0))

    def draw(kind, rows, columns):
        numbers = rng.normal(size=(rows, columns))
        if kind is SourceKind.STATE:
            return problem.x0[:, None] + deviations[:, None] * numbers
        return 0.01 * numbers if kind is SourceKind.NOISE else numbers

    assert run_and_compare(params, Pipeline(), rng, draw) >= len([*params.models]) * params.n
    check(params, Pipeline())


@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 80))]
)
def test_models_of_any_steps(seed):
    params, pipeline = at_random(seed)
    rng = np.random.default_rng(seed)
    assert run_and_compare(params, pipeline, rng)
    check(params, pipeline)


def check(params, pipeline):
    code = microcode(params, pipeline)
    for routine in routines_of_models(params):
        found = code.programs[routine]
        check_schedule(
            found.plan, pes=params.pes, pipeline=pipeline, registers=found.registers,
            places=found.places,
        )  # fmt: skip
        assert len(code.words_of(*routine)) == found.plan.length
        assert model_of(params, routine).steps


def test_random_models_have_everything():
    """Else the tests above would not test much."""
    seen = set()
    for seed in range(10):
        params, _ = at_random(seed)
        seen |= {params.form, params.W0 > 0.0, params.process_noise, params.format.name}
        seen |= {len(params.sensor_rows) > 1, params.observation_noise}
        for program in params.models:
            seen |= {type(step).__name__ for step in program.steps} | program.roots
            seen |= {source.kind for _, source in program.inputs}
            seen.add(("measurements", bool(program.measurements)))
            for form in program.forms:
                seen |= {form.multiplier, form.addend, form.reading, form.sign, form.condition}
    assert len(seen) >= 40, len(seen)


def test_noise_of_a_sensor_is_its_own():
    """Those of the h of a sensor stand behind the noise terms of the sensors before."""

    def see(scale):
        return lambda x, v: np.array([scale * x[0] + v[0], x[1] * v[1]])

    problem = Problem(
        name="two", states=("a", "b"), f=lambda x, w, u: x, Q=np.zeros((0, 0)),
        sensors={"s": Sensor(see(1.0), R=np.eye(2), m=2), "t": Sensor(see(2.0), R=np.eye(2), m=2)},
        x0=np.zeros(2), P0=np.eye(2),
    )  # fmt: skip
    models = lower(trace_problem(problem), problem, BINARY32)
    for sensor, ((program,), first) in enumerate(zip(models.h, (0, 2), strict=True)):
        rows = [source.index for _, source in program.inputs if source.kind is SourceKind.NOISE]
        assert rows == [first, first + 1], sensor


# Errors.


def slots_of(fmt, rows, build):
    """A model of x0, x1 and u0, u1, by a function of a builder and of them."""
    builder = SequenceBuilder(fmt)
    x = [builder.input() for _ in range(2)]
    u = [builder.input() for _ in range(2)]
    results = build(builder, *x, *u)
    assert len(results) == rows
    inputs = [*((t, Source(SourceKind.STATE, k)) for k, t in enumerate(x)),
              *((t, Source(SourceKind.INPUT, k)) for k, t in enumerate(u))]  # fmt: skip
    return builder, results, tuple(inputs)


def finished(fmt, rows, build, *, is_f):
    builder, results, inputs = slots_of(fmt, rows, build)
    states = {t: s.index for t, s in inputs if s.kind is SourceKind.STATE}
    ended = end(builder, results, states if is_f else None)
    return ModelProgram(
        title="f" if is_f else "h", fmt=fmt, inputs=inputs, steps=tuple(builder.steps),
        outputs=ended,
    )  # fmt: skip


def scaled_rows(builder, x0, x1, u0, u1):
    """Rows that are as finite as u0 and u1, on the way through what may be NaN at all points."""
    never = builder.product(builder.scaled(np.inf, x0), 0.0)  # NaN
    kept = builder.copied(0.25)
    builder.copied(never, condition=Condition.FINITE, into=kept)
    return [builder.scaled(u0, x0, plus=kept), builder.scaled(u1, x1, plus=kept)]


@pytest.fixture(scope="module")
def small():
    """Two states and three observations of two sensors, whose rows are u0 and u1 times x."""
    fmt = BINARY32
    f = finished(fmt, 2, scaled_rows, is_f=True)
    one = finished(fmt, 1, lambda b, *a: scaled_rows(b, *a)[:1], is_f=False)
    two = finished(fmt, 2, scaled_rows, is_f=False)
    return UkfParams(
        n=2, m=3, sensors=(1, 2), pes=2,
        models=CoreModels(f=f, h=((one,), (two,)), inputs=("u0", "u1")),
    )  # fmt: skip


def run_with(params, routine, u, mask=-1):
    engine = Interpreter(params)
    memory = ModelMemory(engine.layout, np.random.default_rng(3))
    memory.poison(routine.program)
    for k, value in enumerate(u):
        memory.put(engine.layout.U[0], k, value)
    engine.memory[:] = memory.words
    result = engine.run(routine.program, sensor=routine.sensor, mask=mask)
    return engine, (result.error_code, result.error_index)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
def test_a_row_that_is_not_finite_is_the_error_of_its_model(small, bad):
    f, first, second = (
        Routine(Program.MODEL_F), Routine(Program.MODEL_H, 0), Routine(Program.MODEL_H, 1)
    )  # fmt: skip
    none = (ErrorCode.NONE, 0)
    # Temporaries are NaN in each of them.
    for routine in (f, first, second):
        assert run_with(small, routine, (1.0, 2.0))[1] == none
    assert run_with(small, f, (bad, 1.0))[1] == (ErrorCode.MODEL_F, 0)
    assert run_with(small, f, (1.0, bad))[1] == (ErrorCode.MODEL_F, 1)
    assert run_with(small, first, (bad, 1.0))[1] == (ErrorCode.MODEL_H, 0)
    assert run_with(small, first, (1.0, bad))[1] == none
    assert run_with(small, second, (bad, 1.0))[1] == (ErrorCode.MODEL_H, 1)
    assert run_with(small, second, (1.0, bad))[1] == (ErrorCode.MODEL_H, 2)


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_a_masked_row_is_zero_and_no_error(small, bad):
    routine = Routine(Program.MODEL_H, 1)
    engine, found = run_with(small, routine, (bad, 1.0), mask=0b101)
    assert found == (ErrorCode.NONE, 0)
    layout = engine.layout
    for column in small.points:
        rows = [layout.Z[row].element(column) for row in (1, 2)]
        words = [int(engine.memory[lane, word[0]]) for word, lane in rows]
        assert words[0] == 0
        assert words[1] != 0
    assert run_with(small, routine, (1.0, bad), mask=0b101)[1] == (ErrorCode.MODEL_H, 2)
    assert run_with(small, routine, (bad, bad), mask=0b001)[1] == (ErrorCode.NONE, 0)


def test_a_mask_does_not_matter_for_f(small):
    assert run_with(small, Routine(Program.MODEL_F), (1.0, np.nan), mask=0)[1] == (
        ErrorCode.MODEL_F, 1,
    )  # fmt: skip


@pytest.mark.parametrize(
    "seed", [11, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(8, 11))]
)
def test_errors_of_random_models_are_of_a_row_that_is_wrong(seed):
    """A mask of chance; what is masked is no error, and what is not is one."""
    rng = random.Random(seed)
    params, pipeline = random_configuration(rng, largest=4)
    params = with_models(params, any_models(rng, params, finite=0.8))
    draws = np.random.default_rng(seed)
    for routine in routines_of_models(params):
        engine = Interpreter(params, pipeline)
        memory = ModelMemory(engine.layout, draws)
        memory.poison(routine.program)
        engine.memory[:] = memory.words
        mask = rng.getrandbits(params.m)
        result = engine.run(
            routine.program, sensor=routine.sensor, variant=routine.variant, mask=mask
        )
        is_f = routine.program is Program.MODEL_F
        first = 0 if is_f else params.rows_of(routine.sensor).start
        bad = {
            first + row
            for row, values in enumerate(memory.results(routine)[0])
            if not np.isfinite(values).all() and (is_f or mask >> (first + row) & 1)
        }
        if bad:
            assert result.error_code == (ErrorCode.MODEL_F if is_f else ErrorCode.MODEL_H)
            assert result.error_index in bad
        else:
            assert (result.error_code, result.error_index) == (0, 0)


# Schedules that are wrong.


@pytest.fixture(scope="module")
def compiled():
    """Programs of models with conditions, shared places and tight operations."""
    params, pipeline = at_random(4)
    code = microcode(params, pipeline)
    return [(params, pipeline, code.programs[each]) for each in routines_of_models(params)]


def is_refused(params, pipeline, code, plan=None, places=None):
    try:
        check_schedule(
            plan or code.plan, pes=params.pes, pipeline=pipeline, registers=code.registers,
            places=code.places if places is None else places,
        )  # fmt: skip
    except ScheduleError:
        return True
    return False


def test_checker_sees_temporaries_that_share_a_place_too_early(compiled):
    """One that is written between the only write of another and a read of that."""
    refused = 0
    for params, pipeline, code in compiled:
        assert not is_refused(params, pipeline, code)
        writes, reads = accesses_of(code.plan)
        for one, other in itertools.permutations(sorted(code.places), 2):
            if len(writes[one]) != 1:
                continue
            ((born, _),) = writes[one]
            if any(
                born < clock <= read and lanes & read_lanes
                for clock, lanes in writes[other]
                for read, read_lanes in reads[one]
            ):
                places = code.places | {other: code.places[one]}
                assert is_refused(params, pipeline, code, places=places), (one, other)
                refused += 1
    assert refused > 20


def accesses_of(plan):
    """Clocks and lanes of the writes and of the reads of each temporary."""
    writes, reads = defaultdict(list), defaultdict(list)
    for operation, issue in zip(plan.operations, plan.issue, strict=True):
        done = issue + plan.timing.result(operation)
        root = done + plan.timing.pipeline.reciprocal_sqrt
        if operation.destination is not None:
            writes[operation.destination].append((done, operation.lanes))
        if operation.root is not None:
            writes[operation.root].append((root, operation.root_lanes))
        for beat in operation.beats:
            for word in (beat.word_0, beat.word_1):
                reads[word].append((issue, beat.lanes))
    return writes, reads


def lives_of(plan):
    """First and last clock on which a temporary is used: told by the operations alone."""
    writes, reads = accesses_of(plan)
    clocks = {word: [clock for clock, _ in [*writes[word], *reads[word]]] for word in [*writes]}
    return {word: (min(each), max(each)) for word, each in clocks.items() if word[1] == TEMPORARY}


def test_places_are_shared_and_never_too_early(compiled):
    """Told by the lives of the temporaries, and not by the checker."""
    shared = 0
    for params, _, code in compiled:
        lives = lives_of(code.plan)
        assert set(lives) == set(code.places)
        own = len(set(code.places.values()))
        shared += len(code.places) - own
        for one, other in itertools.combinations(sorted(code.places), 2):
            if code.places[one] == code.places[other]:
                (born, last), (born_too, last_too) = lives[one], lives[other]
                assert last < born_too or last_too < born
        assert params.models
    assert shared > 10


def test_checker_sees_operations_that_are_a_clock_too_early(compiled):
    """An operation that waits for another by exactly as much as it must."""
    tight = 0
    for params, pipeline, code in compiled:
        plan = code.plan
        for index, edges in enumerate(dependences(plan.operations, plan.timing)):
            if any(plan.issue[index] - plan.issue[other] == least for other, least in edges):
                issue = list(plan.issue)
                issue[index] -= 1
                moved = dataclasses.replace(plan, issue=issue)
                assert is_refused(params, pipeline, code, moved), index
                tight += 1
    assert tight > 10


def test_checker_sees_conditional_writes_in_another_order(compiled):
    """What is written last counts, and what is kept is of the one before."""
    swapped = 0
    for params, pipeline, code in compiled:
        plan = code.plan
        last = {}
        for index, operation in enumerate(plan.operations):
            before = last.get(operation.destination)
            if operation.keeps and before is not None and plan.operations[before].form is not None:
                operations = list(plan.operations)
                issue = list(plan.issue)
                issue[index], issue[before] = issue[before], issue[index]
                if issue[index] != issue[before]:
                    other = dataclasses.replace(plan, operations=operations, issue=issue)
                    assert is_refused(params, pipeline, code, other), (before, index)
                    swapped += 1
            if operation.destination is not None:
                last[operation.destination] = index
    assert swapped > 3
