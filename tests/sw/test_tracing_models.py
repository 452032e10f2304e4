"""Models of problems, traced: all of the catalogue, and what their data say about arguments."""

from dataclasses import replace

import numpy as np
import pytest

from support.beacons import STEPS, rover, see_heading, with_data
from ukf_sw.errors import FormatOverflowError, TraceError
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.spec.float_format import BINARY16, BINARY32, BINARY64
from ukf_sw.spec.parameters import Noise
from ukf_sw.tracing import check as checking
from ukf_sw.tracing.check import call_model, check
from ukf_sw.tracing.models import trace_problem
from ukf_sw.tracing.operations import Operation
from ukf_sw.tracing.report import constants_of, record_of

POINTS = 1000
#: The largest difference of a row from NumPy's, in units of the last bit of its largest result.
ULPS = 4.0
#: Models whose operations NumPy does in the same order, so that all bits are equal.
EXACT = set(CATALOGUE) - {"reentry", "reentry-earth"}


def some(name, steps=60):
    return CATALOGUE[name].scenario(0, steps)


def random_points(problem, model, scale=1.0):
    """Points around the first estimate, noise, and the arguments of a step of the data."""
    draws = np.random.default_rng(7)
    deviations = np.sqrt(np.diag(problem.P0))[:, None]
    x = problem.x0[:, None] + scale * deviations * draws.standard_normal((len(deviations), POINTS))
    noise = draws.standard_normal((model.call.terms, POINTS))
    return x, np.zeros_like(noise) if model.call.additive else noise


def given_of(problem, model, step):
    record = problem.record
    if model.sensor is None:
        return {"u": None if record.inputs is None else record.inputs[step]}
    kinds = record.observation_arguments or [{}] * record.steps
    own = [each for each in kinds if model.constants.items() <= each.items()]
    return own[step % len(own)]


@pytest.mark.parametrize("name", CATALOGUE)
def test_models_of_the_catalogue_give_what_numpy_gives(name):
    problem = some(name)
    traced = trace_problem(problem)
    assert set(traced.h) == set(problem.sensor_names)
    for model in traced.models:
        for step in (0, 17):
            x, noise = random_points(problem, model)
            given = given_of(problem, model, step)
            expected = call_model(model.call, x, noise, given)
            found = model.graph.evaluate({**given, "x": x, model.call.noise: noise})
            if name in EXACT:
                np.testing.assert_array_equal(found, expected)
            largest = np.abs(expected).max(axis=1, keepdims=True)
            assert (np.abs(found - expected) <= ULPS * np.spacing(largest)).all()


@pytest.mark.parametrize("name", CATALOGUE)
def test_two_traces_are_equal(name):
    first, again = (trace_problem(some(name, 3)) for _ in range(2))
    assert [model.graph for model in first.models] == [model.graph for model in again.models]


def test_operations_of_the_catalogue():
    """As in the study of models on the core, but for the zeros that an additive noise adds."""

    def total(model):
        return sum(model.graph.counts().values())

    nanosat = trace_problem(some("nanosat"))
    assert [total(model) for model in nanosat.models] == [45, 30]
    pendulum = trace_problem(some("pendulum"))
    assert pendulum.f.graph.counts() == {
        Operation.ADD: 3, Operation.SUBTRACT: 1, Operation.MULTIPLY: 2, Operation.SIN: 1,
    }  # fmt: skip
    ctrv = trace_problem(some("ctrv"))
    assert ctrv.f.graph.counts(per_point=False) == {Operation.MULTIPLY: 2}
    assert [model.title for model in ctrv.models] == [
        "f", "h (device='radar')", "h (device='lidar')",
    ]  # fmt: skip
    assert ctrv.h["sensor"][1].graph.counts() == {Operation.ADD: 2, Operation.MULTIPLY: 3}


# Problems of a user.


def test_each_value_of_a_constant_is_a_program():
    traced = trace_problem(rover())
    near, far = traced.h["beacon"]
    assert [near.constants, far.constants] == [{"beacon": "near"}, {"beacon": "far"}]
    assert near.title == "h of beacon (beacon='near')"
    assert near.name == "observation model h of beacon (see_beacon)"
    assert [source.label for source in near.graph.inputs] == ["x[0]", "v[0]", "place[0]"]
    assert Operation.HYPOT in near.graph.counts()
    assert Operation.HYPOT not in far.graph.counts()
    assert len(traced.models) == 5
    assert traced.f.title == "f"


def test_only_steps_with_the_sensor_count():
    sampled = {"beacon": np.zeros((STEPS, 1), dtype=bool), "compass": np.ones((STEPS, 1), bool)}
    sampled["beacon"][::2] = True
    traced = trace_problem(with_data(sampled=sampled))
    assert [model.constants["beacon"] for model in traced.h["beacon"]] == ["near"]
    assert len(traced.h["compass"]) == 2


def test_too_many_programs_are_refused():
    arguments = [{"beacon": f"b{k}", "place": np.ones(2), "height": k} for k in range(20)]
    data = Data(
        times=np.arange(20.0),
        measurements={name: np.zeros((20, 1)) for name in ("beacon", "compass")},
        inputs=np.ones((20, 2)),
        observation_arguments=arguments,
    )
    message = (
        r"^observation model h of beacon \(see_beacon\) must be called with at most 16 "
        r"combinations of constants, not 20 of beacon, height: .* be floats"
    )
    with pytest.raises(ValueError, match=message):
        trace_problem(rover(data=data))


def test_without_data_u_is_a_vector_of_the_named_inputs():
    problem = rover(data=None, sensors=Sensor(see_heading, R=[[1.0]]))
    traced = trace_problem(problem)
    assert [source.label for source in traced.f.graph.inputs][-2:] == ["u[0]", "u[1]"]
    later = trace_problem(replace(problem, data=lambda seed, steps: None))
    assert later.f.graph == traced.f.graph
    still = trace_problem(
        Problem(
            name="still", f=lambda x, w, u: x, sensors=Sensor(lambda x, v: x), x0=[1.0], P0=[[1]]
        )
    )
    assert still.f.graph.counts() == {}


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        (
            [np.ones(2)] * 5 + [np.ones(3)],
            r"u must have the same shape in every step .* \(2,\) and",
        ),
        ([None] * 5 + [1.0], r"u must have the same shape in every step to be traced, not None"),
    ],
)
def test_u_has_one_shape(inputs, message):
    problem = rover()
    data = replace(problem.record, inputs=inputs)
    with pytest.raises(ValueError, match=message):
        trace_problem(rover(inputs=(), data=data))


def test_u_that_is_no_number_is_refused():
    with pytest.raises(TypeError, match=r"^u must be None, a number, an array, or a tuple, list"):
        trace_problem(rover(inputs=(), data=replace(rover().record, inputs=["left"] * STEPS)))


def test_arguments_that_are_missing_are_told():
    with pytest.raises(TypeError, match="missing 2 required keyword-only arguments") as caught:
        trace_problem(with_data(observation_arguments=None))
    assert "observation model h of beacon" in caught.value.__notes__[0]


def test_each_model_is_named_in_refusals():
    def branch(x, w, u):
        return x if x[0] > 0 else -x

    with pytest.raises(TraceError, match=r"^process model f \(branch\) must not branch on data"):
        trace_problem(rover(f=branch))
    sensors = {**rover().sensors, "compass": Sensor(lambda x, v, **_: branch(x, v, 0)[1:], m=1)}
    with pytest.raises(TraceError, match=r"^observation model h of compass \(<lambda>\) must not"):
        trace_problem(rover(sensors=sensors))


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("noise", Noise)
def test_kinds_of_models(vectorized, noise):
    def f(x, w, u):
        return np.array([x[0] + x[1], x[1] * 0.5]) + w

    problem = Problem(
        name="line", f=f, sensors=Sensor(lambda x, v: x[:1] + v, R=[[1.0]]), x0=[0.0, 1.0],
        P0=np.eye(2), Q=np.eye(2), process_noise=noise, observation_noise=noise,
        vectorized=vectorized,
    )  # fmt: skip
    traced = trace_problem(problem)
    noises = [source for source in traced.f.graph.inputs if source.argument == "w"]
    assert len(noises) == (2 if noise is Noise.AUGMENTED else 0)
    assert traced.f.call.shape == ((2, 1) if vectorized else (2,))


# Comparing.


class Sly:
    """Does one thing when traced, and another one with numbers."""

    def __init__(self, otherwise):
        self.otherwise = otherwise

    def __call__(self, x, w, u):
        return x * 2.0 if type(x).__name__ == "TracedArray" else self.otherwise(x)


def test_another_result_is_refused_with_row_values_and_point():
    def otherwise(x):
        return np.array([x[0] * 2.0, x[1] * 2.0 + 1e-6])

    message = (
        r"^process model f \(Sly\) must give what was traced of it, 1\.0, and not 1\.000001 in row "
        r"1 for x = \[1\.0, 0\.5\], w = \[0\.0\], u = \[1\.0, 1\.0\]$"
    )
    with pytest.raises(ValueError, match=message):
        trace_problem(rover(f=Sly(otherwise)))


@pytest.mark.parametrize(
    "otherwise",
    [
        lambda x: np.where(np.abs(x) > 20.0, 0.0, x * 2.0),  # far from the first estimate
        lambda x: np.where(x == 0.5, 0.0, x * 2.0),  # at the first estimate only
        lambda x: np.where(x > 2.5, np.nan, x * 2.0),
        lambda x: np.where(x > 2.5, np.inf, x * 2.0),
    ],
)
def test_another_result_is_found_near_and_far(otherwise):
    with pytest.raises(ValueError, match="must give what was traced of it"):
        trace_problem(rover(f=Sly(otherwise)))


def test_another_result_for_the_input_of_one_step_is_found():
    def f(x, w, u):
        traced = type(x).__name__ == "TracedArray"
        return x + (u[0] if traced or u[0] < 5.0 else 0.0)

    inputs = np.ones((STEPS, 2))
    inputs[-1, 0] = 6.0
    with pytest.raises(ValueError, match=r"must give what was traced of it, 7\.0, and not 1\.0"):
        trace_problem(rover(f=f, data=replace(rover().record, inputs=inputs)))


def test_rounding_is_no_difference():
    traced = trace_problem(rover(f=Sly(lambda x: x + x * (1.0 + 1e-13))))
    assert traced.f.graph.counts() == {Operation.MULTIPLY: 2}
    # What cancels is rounded more than its size tells.
    far = rover(f=lambda x, w, u: (x + 1e9) * 3.0 - (1e9 + x) * 3.0 + (x**3 - x * x * x))
    trace_problem(far)


def test_columns_must_not_mix():
    def f(x, w, u):
        return x - x.mean(axis=1, keepdims=True)

    with pytest.raises(ValueError, match=r"must give what was traced of it, 0\.0, and not"):
        trace_problem(rover(f=f, vectorized=True))


def test_shapes_of_several_columns_are_checked():
    def f(x, w, u):
        return x if x.shape[1] == 1 else x[:, :2]

    message = r"must return the shape \(2, 16\), one column a sigma point, not \(2, 2\)"
    with pytest.raises(ValueError, match=message):
        trace_problem(rover(f=f, vectorized=True))


def test_check_demands_equal_nan_and_infinity():
    traced = trace_problem(some("pendulum")).f
    x = np.array([[np.nan, np.inf], [0.0, -np.inf]])
    check(traced.call, traced.graph, x, np.zeros((2, 2)), {"u": None})
    assert checking.ROUNDINGS > 1.0


# What is told about them.


def test_constants_in_the_format_of_a_core():
    model = trace_problem(some("reentry")).f
    assert all(entry.exact for entry in constants_of(model, BINARY64))
    in_single = {entry.value: entry.exact for entry in constants_of(model, BINARY32)}
    assert in_single[6374.0]
    assert not in_single[0.1]
    message = (
        r"^each constant of process model f \(_move\) must be at most 65504, .* not -398600.0$"
    )
    with pytest.raises(FormatOverflowError, match=message):
        constants_of(model, BINARY16)


def test_records_have_what_is_known():
    problem = some("ctrv")
    traced = trace_problem(problem)
    f, radar, _ = (record_of(model, problem, BINARY32) for model in traced.models)
    assert f["model"] == "f"
    assert f["sensor"] is None
    assert f["inputs"][0] == {"label": "x[0]", "name": "x", "per_point": True}
    assert f["inputs"][-1] == {"label": "u", "name": "interval", "per_point": False}
    assert f["operations"]["once"] == {"multiply": 2}
    assert f["functions"] == ["divide", "sin", "cos"]
    assert f["depth"] == 10
    assert {"value": 0.5, "rounded": 0.5, "exact": True} in f["constants"]
    assert radar["title"] == "h (device='radar')"
    assert radar["constant_arguments"] == {"device": "radar"}
    assert radar["rows"] == ["z[0]", "z[1]", "z[2]"]
