"""Models in software that compute what a core would."""

import numpy as np
import pytest

from support.beacons import rover
from ukf_sw.lowering.software import in_core_arithmetic, software_models
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.spec.float_format import BINARY16, BINARY64

#: Problems with variants, arguments, and angles of both kinds; the others are slow.
QUICK = ("battery", "ctrv")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CATALOGUE],
)
def test_a_core_with_the_models_computes_the_same(name):
    """To the last bit: a core of models, and one whose models in software compute as it would."""
    steps = 8
    rounded = run(in_core_arithmetic(CATALOGUE[name].scenario(0, steps)), "golden", covariance=True)
    core = run(Recipe.of(name, models="core").scenario(steps), "golden", covariance=True)
    assert rounded.x.tobytes() == core.x.tobytes()
    assert rounded.P.tobytes() == core.P.tobytes()
    assert np.array_equal(rounded.nis, core.nis, equal_nan=True)
    plain = run(CATALOGUE[name].scenario(0, steps), "golden")
    assert rounded.x.tobytes() != plain.x.tobytes(), "models in float64 round otherwise"


def test_the_arithmetic_is_seen_in_a_filter_of_float64():
    """Of a narrow format it is coarse, and of binary64 there is hardly a difference."""
    problem = CATALOGUE["pendulum"].scenario(0, 20)
    exact = run(problem, "reference").x
    errors = [
        np.abs(run(in_core_arithmetic(problem, fmt), "reference").x - exact).max()
        for fmt in (BINARY64, None, BINARY16)
    ]
    assert errors[0] < 1e-12 < 1e-8 < errors[1] < 1e-5 < 1e-4 < errors[2] < 0.1


def test_models_of_one_point_become_vectorized():
    """Sensors keep their noise, angles and names; arguments and their constants are passed on."""
    problem = rover()
    rounded = in_core_arithmetic(problem)
    assert rounded.vectorized
    assert rounded.params == problem.params
    rng = np.random.default_rng(1)
    x, w, v = rng.standard_normal((2, 5)), rng.standard_normal((1, 5)), rng.standard_normal((1, 5))
    u, place = np.array([0.5, -0.25]), np.array([3.0, 1.0])
    found = rounded.f(x, w, u)
    assert found.shape == (2, 5)
    assert (found == found.astype(np.float32)).all()
    expected = np.stack([problem.f(x[:, k], w[:, k], u) for k in range(5)], axis=1)
    assert np.allclose(found, expected, rtol=1e-5, atol=1e-6)
    for beacon in ("near", "far"):
        arguments = {"beacon": beacon, "place": place}
        found = rounded.sensor("beacon").h(x, v, **arguments)
        h = problem.sensor("beacon").h
        expected = np.stack([h(x[:, k], v[:, k], **arguments) for k in range(5)], axis=1)
        assert np.allclose(found, expected, rtol=1e-5, atol=1e-6)
    message = (
        r"^constants of h of beacon must be those of a program, \{'beacon': 'near'\}, "
        r"\{'beacon': 'far'\}, not \{'beacon': 'lost'\}$"
    )
    with pytest.raises(ValueError, match=message):
        rounded.sensor("beacon").h(x, v, beacon="lost", place=place)


def test_each_sensor_has_its_own_noise():
    """The terms of a program are those of its sensor, from 0 on, and not rows of all noise."""
    models = software_models(rover())
    for sensor in ("beacon", "compass"):
        for program in models.h[sensor]:
            rows = {source.index for _, source in program.inputs if source.kind.value == "noise"}
            assert rows == {0}


def test_angles_are_left_to_the_filter():
    problem = CATALOGUE["ctrv"].scenario(0, 8)
    x = np.zeros((5, 2))
    x[3], x[4] = [0.0, 5.0], 1.0
    step = software_models(problem).evaluate_f(x, np.zeros((2, 2)), 1.0)
    assert step[3].tolist() == [1.0, 6.0], "they may be more than half a turn apart"
    assert problem.state_angles == in_core_arithmetic(problem).state_angles
