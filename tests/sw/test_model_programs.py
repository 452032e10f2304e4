"""Programs of models on the array: the words that a core executes against the steps themselves."""

import dataclasses
import random
from functools import cache

import numpy as np
import pytest

from support.model_memory import ModelMemory, model_of
from support.random_cores import random_configuration
from support.random_models import any_models, with_models
from ukf_sw.engine.checker import check_schedule
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.engine.microcode import microcode, routines
from ukf_sw.lowering.program import lower
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.spec.model_programs import SourceKind
from ukf_sw.spec.parameters import Pipeline
from ukf_sw.spec.sequence import Program
from ukf_sw.tracing.models import trace_problem

#: Models of the catalogue with the processing elements of their cores.
SYSTEMS = {
    "pendulum": 1, "battery": 2, "nanosat": 5, "nanosat-additive": 7, "ctrv": 4, "gps-ins": 6,
}  # fmt: skip
SLOW = {"swampsat": 5}


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
    "seed", [*range(10), *(pytest.param(k, marks=pytest.mark.slow) for k in range(10, 80))]
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
