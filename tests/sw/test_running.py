"""One way to run a filter over a problem and to judge it; recipes."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from support.problems import change_data
from ukf_sw.backends import golden_driver, make_backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import BusError, NotFiniteError, StepError, UkfError
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.finding import find
from ukf_sw.problems.judging import Bound, judge
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import Estimates, Run, Stop, run
from ukf_sw.problems.systems.pendulum import pendulum
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.registers import STATUS
from ukf_sw.spec.sequence import Step

TINY = UkfParams(n=2, m=1, q=1, r=1)


class FailingUkf(ReferenceUkf):
    """A filter that fails in the update of a step, from 0."""

    def __init__(self, params, at, error):
        super().__init__(params)
        self._left, self._error = at, error

    def update(self, points, z, mask, sensor=0):
        if not self._left:
            raise self._error
        self._left -= 1
        return super().update(points, z, mask, sensor)


# Running.


def test_hook_sees_the_start_and_every_step():
    seen = []
    found = run(random_scenario(TINY, steps=4), after_step=lambda k, ukf: seen.append((k, ukf.x)))
    assert [done for done, _ in seen] == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal([x for _, x in seen[1:]], found.x)
    np.testing.assert_array_equal(seen[0][1], found.problem.x0)


@pytest.mark.parametrize("kind", [KeyError, ValueError])
def test_a_model_that_fails_says_at_which_step(kind):
    scenario = random_scenario(TINY, steps=4)

    def failing(x, w, u):
        if np.array_equal(u, scenario.record.inputs[2]):
            raise kind("device")
        return scenario.f(x, w, u)

    broken = replace(scenario, f=failing, vectorized=scenario.vectorized)
    with pytest.raises(kind) as caught:
        run(broken)
    assert caught.value.__notes__[-1] == f"after 2 iterations, at {scenario.times[2]:.9g} s"


def test_covariance_is_taken_on_request():
    scenario = random_scenario(TINY, steps=3)
    driver = golden_driver(TINY)
    driver.count_cycles = True
    assert run(scenario, driver).P is None
    assert "COVARIANCE" not in driver.last_cycles
    found = run(scenario, driver, covariance=True)
    assert "COVARIANCE" in driver.last_cycles
    np.testing.assert_array_equal(found.P, driver.covariance())


@pytest.mark.parametrize("at", [0, 3])
def test_run_ends_at_an_error_or_raises_it(at):
    scenario = random_scenario(TINY, steps=8)
    error = NotFiniteError(Step.UPDATE)
    with pytest.raises(NotFiniteError):
        run(scenario, FailingUkf(TINY, at, error))
    with pytest.raises(NotFiniteError):
        run(scenario, FailingUkf(TINY, at, error), ends_at=(ValueError,))
    failing = FailingUkf(TINY, at, error)
    found = run(scenario, failing, ends_at=(StepError,), covariance=True)
    assert found.stop == Stop(
        iteration=at, kind=NotFiniteError, message="UPDATE met NaN or infinity", step="UPDATE",
        code=2,
    )  # fmt: skip
    assert found.stop.as_dict()["error"] == "NOT_FINITE"
    assert found.steps == len(found.nis) == len(found.gated) == len(found.errors) == at
    np.testing.assert_array_equal(found.x, run(scenario).x[:at])
    np.testing.assert_array_equal(found.last_x, failing.state())
    assert found.P is None


def test_errors_that_are_not_of_a_step_are_named_by_their_class():
    found = run(
        random_scenario(TINY, steps=5), FailingUkf(TINY, 2, UkfError("lost")), ends_at=(UkfError,)
    )
    assert (found.stop.error, found.stop.step, found.stop.code) == ("UkfError", None, None)
    np.testing.assert_array_equal(found.last_x, found.x[1])


def test_core_says_where_its_covariance_is_bad():
    recipe = Recipe.of("nanosat-2014", pes=2, form=Form.COVARIANCE, P0=100.0)
    found = run(recipe.scenario(50), "golden", ends_at=(StepError,))
    codes = {"SINGULAR_OBSERVATION": 3, "NOT_POSITIVE_DEFINITE": 4}
    assert found.stop.code == codes[found.stop.error]
    assert 0 <= found.stop.index < 7
    assert found.stop.iteration == found.steps < 50
    assert np.isfinite(found.last_x).all()


def test_estimates_pass_between_processes():
    found = run(random_scenario(TINY, steps=3), "golden", covariance=True)
    passed = pickle.loads(pickle.dumps(found.estimates))
    assert type(passed) is Estimates
    again = Run.of(found.problem, passed)
    for name in ("x", "nis", "gated", "last_x", "P", "errors", "times"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


def test_pipeline_of_the_golden_driver_decides_cycles_only():
    scenario = random_scenario(TINY, steps=3)
    runs, cycles = [], []
    for pipeline in (None, Pipeline(multiply=5, add=6)):
        driver = make_backend("golden", TINY, pipeline)
        driver.count_cycles = True
        runs.append(run(scenario, driver))
        cycles.append(driver.last_cycles["UPDATE"])
    np.testing.assert_array_equal(runs[0].x, runs[1].x)
    assert cycles[0] < cycles[1]


# Judging.


def test_judgement_is_that_of_the_settled_steps():
    scenario = replace(random_scenario(TINY, steps=30), settled=10.0, limit=0.1)
    found, reference = run(scenario, "golden"), run(scenario)
    judged = judge(found, reference)
    errors, others = found.errors[10:], reference.errors[10:]
    assert (judged.since, judged.steps, judged.reference.steps) == (10.0, 20, 20)
    np.testing.assert_allclose(judged.rms, np.sqrt(np.mean(errors**2, axis=0)))
    np.testing.assert_array_equal(judged.maximum, np.abs(errors).max(axis=0))
    np.testing.assert_allclose(judged.reference.rms, np.sqrt(np.mean(others**2, axis=0)))
    assert judged.rms_ratio == judged.rms[0] / judged.reference.rms[0]
    # Errors have signs, and the limit is one of magnitudes.
    assert judged.below_limit == np.mean(np.abs(errors[:, 0]) < 0.1)
    assert 0.0 < judged.below_limit < 1.0
    assert judged.largest_difference_of_x == np.abs(found.x - reference.x)[10:].max() > 0.0
    (verdict,) = judged.compare([Bound(error="x0", high=9.0, origin="")])
    assert (verdict.value, verdict.float64) == (judged.rms[0], judged.reference.rms[0])


def test_short_runs_are_judged_from_the_beginning():
    scenario = replace(random_scenario(TINY, steps=5), settled=10.0)
    judged = judge(run(scenario))
    assert (judged.since, judged.steps) == (None, 5)
    assert judged.reference is judged.rms_ratio is judged.below_limit is None


def test_several_runs_are_judged_as_one():
    runs = [run(random_scenario(TINY, seed, steps=steps)) for seed, steps in ((0, 20), (1, 50))]
    judged = judge(runs, after=5.0)
    errors = np.concatenate([found.errors[5:] for found in runs])
    assert judged.steps == len(errors) == 60
    np.testing.assert_allclose(judged.rms, np.sqrt(np.mean(errors**2, axis=0)))
    with pytest.raises(ValueError, match=r"^runs must hold at least one run, not \[\]$"):
        judge([])


def test_runs_that_stopped_are_judged_as_far_as_they_went():
    scenario = random_scenario(TINY, steps=20)
    whole = run(scenario)
    error = NotFiniteError(Step.UPDATE)
    nothing, some = (
        run(scenario, FailingUkf(TINY, at, error), ends_at=(StepError,)) for at in (0, 12)
    )
    judged = judge(nothing, whole)
    assert (judged.steps, judged.errors, judged.rms_ratio) == (0, (), None)
    assert judged.as_dict()["errors"] == []
    assert judge(some, whole).reference.steps == judge(some).steps == 11
    # A reference that did fewer steps says nothing about all of them.
    assert judge(whole, some).reference is None
    assert judge([nothing, some], [whole, whole]).steps == 11


# Recipes.


def test_recipes_make_the_same_scenario_anywhere():
    recipe = Recipe.of("pendulum", seed=3, pes=2)
    again = pickle.loads(pickle.dumps(recipe))
    assert again == recipe
    one, other = recipe.scenario(10), again.scenario(10)
    assert one.params == other.params == replace(CATALOGUE["pendulum"].params, pes=2)
    np.testing.assert_array_equal(one.samples()[0], pendulum(3, steps=10).samples()[0])
    np.testing.assert_array_equal(one.samples()[0], other.samples()[0])
    assert recipe.scenario().steps == 500
    assert Recipe(params=TINY).scenario().steps == 1000


def test_recipes_replace_the_first_variance():
    own = Recipe.of("pendulum").scenario(1).P0
    np.testing.assert_array_equal(own, pendulum(steps=1).P0)
    np.testing.assert_array_equal(Recipe.of("pendulum", P0=4.0).scenario(1).P0, 4.0 * np.eye(2))
    small, large = (Recipe(params=TINY, P0=P0).scenario(1) for P0 in (None, 4.0))
    np.testing.assert_array_equal(small.P0, np.eye(2))
    np.testing.assert_array_equal(large.P0, 4.0 * np.eye(2))


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_entries_say_the_parameters_of_their_core(name):
    assert CATALOGUE[name].params == CATALOGUE[name].scenario(0, 1).params
    assert CATALOGUE[name].fits(replace(CATALOGUE[name].params, pes=2, form=Form.COVARIANCE))
    assert not CATALOGUE[name].fits(TINY)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Recipe.of("moon"), r"^problem must be one of nanosat, .*, not 'moon'$"),
        (lambda: find("moon", "NAME"), r"^NAME must be one of nanosat, .*, not 'moon'$"),
        (
            lambda: Recipe(name="nanosat", params=TINY),
            r"^params must have the sizes and kinds of noise of nanosat, UkfParams\(n=7, .*, not U",
        ),
        (lambda: Recipe(params=TINY, P0=0.0), r"^P0 must be more than 0, not 0\.0$"),
        (lambda: Recipe.of("nanosat", P0=np.inf), r"^P0 must be more than 0, not inf$"),
        (lambda: Recipe(params=TINY).scenario(0), r"^steps must be at least 1, not 0$"),
    ],
)
def test_bad_recipes(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_scenario_without_truth_can_be_run_but_not_judged():
    scenario = change_data(pendulum(0, steps=3), truth=None)
    found = run(scenario)
    assert np.isfinite(found.x).all()
    message = r"^the problem 'pendulum' must have truth, not None, to have errors: it can be run"
    with pytest.raises(ValueError, match=message):
        _ = found.errors
    judged = judge(found)
    assert (judged.steps, judged.errors, judged.rms_ratio) == (3, (), None)
    with pytest.raises(ValueError, match=r"^problem must have truth, not None, for errors"):
        _ = judged.rms


def test_the_estimate_after_an_error_that_leaves_a_doubt_is_that_before_it():
    class Failing(GoldenBus):
        left = -1

        def read(self, address):
            self.left -= address == STATUS.offset
            if self.left == 0:
                raise BusError(address, "read")
            return super().read(address)

    scenario = pendulum(0, steps=5)
    bus = Failing(GoldenCore(scenario.params))
    driver = Driver(bus, scenario.params)
    bus.left = 18
    found = run(scenario, driver, ends_at=(BusError,))
    assert 0 < found.steps < 5
    np.testing.assert_array_equal(found.last_x, found.x[-1])


# What may be wrong, or masked.


def test_numbers_of_steps_are_checked():
    scenario = random_scenario(TINY, steps=3)
    with pytest.raises(TypeError, match=r"^steps must be an int, not 2\.5$"):
        run(scenario, steps=2.5)
    with pytest.raises(ValueError, match=r"^every must be at least 1, not 0$"):
        run(scenario, every=0)
    assert run(scenario, steps=np.int64(2)).steps == 2


@pytest.mark.parametrize("data", [None, 3.0, np.array(3.0)])
@pytest.mark.parametrize("name", ["times", "measurements"])
def test_data_of_a_scenario_are_arrays(name, data):
    with pytest.raises(TypeError, match=rf"^{name} must have an entry for each step, not "):
        change_data(random_scenario(TINY, steps=3), **{name: data})


def test_masked_measurements_were_not_sampled():
    params = UkfParams(n=2, m=2, q=1, r=2)
    scenario = random_scenario(params, steps=4)
    sampled = np.array([[1, 1], [0, 1], [0, 0], [1, 0]], dtype=np.bool_)
    masked = np.ma.masked_array(scenario.samples()[0], mask=~sampled)
    found = run(change_data(scenario, measurements=masked, sampled=None))
    expected = run(change_data(scenario, sampled=sampled))
    assert np.array_equal(scenario.samples()[1], np.ones((4, 2)))
    both = run(change_data(scenario, measurements=masked))
    np.testing.assert_array_equal(both.x, expected.x)
    np.testing.assert_array_equal(found.x, expected.x)
    np.testing.assert_array_equal(found.nis, expected.nis)
    assert np.isnan(found.nis[2])
