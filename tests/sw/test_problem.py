"""Problems: what they refuse and why, what they complete, and filters with several sensors."""

import re
from dataclasses import replace

import numpy as np
import pytest

from support.problems import change_data
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.nanosat import nanosat
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.float_format import BINARY32, BINARY64
from ukf_sw.spec.parameters import Form, Noise, UkfParams

F = np.array([[1.0, 0.1, 0.0], [0.0, 0.9, 0.1], [0.0, 0.0, 1.0]])
H = {"gps": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.2]]), "compass": np.array([[0.1, 0.0, 1.0]])}
R = {"gps": np.array([[0.3, 0.1], [0.1, 0.2]]), "compass": np.array([[0.05]])}
BACKENDS = ["reference", "golden"]


def move(x, w, u):
    return F @ x + w


def sensor(name, **options):
    return Sensor(lambda x, v: H[name] @ x + v, **{"R": R[name]} | options)


def make(**options):
    """A linear problem of two sensors, of 3 states and 2 + 1 observations."""
    return Problem(**{
        "name": "cart", "f": move, "Q": 0.01 * np.eye(3),
        "sensors": {"gps": sensor("gps"), "compass": sensor("compass")},
        "x0": [1.0, 0.0, 0.5], "P0": np.eye(3), "format": BINARY64,
    } | options)  # fmt: skip


TIMES = np.arange(4.0)
MEASURED = {"gps": np.ones((4, 2)), "compass": np.zeros((4, 1))}


def data(**options):
    return Data(**{"times": TIMES, "measurements": MEASURED} | options)


def sensors(**changes):
    """The sensors, of which those named are changed."""
    return {"sensors": {name: sensor(name, **changes.get(name, {})) for name in H}}


# What is refused.


def raising(x, v):
    raise KeyError("device")


BAD = [
    ({"sensors": {}}, TypeError, "sensors must be a Sensor, or some of them by name, not {}"),
    ({"sensors": {"left wheel": sensor("gps")}}, ValueError,
     "sensors must have names like gps, not 'left wheel'"),
    ({"name": ""}, TypeError, "name must be text, not ''"),
    ({"name": 3}, TypeError, "name must be text, not 3"),
    ({"sensors": {3: sensor("gps")}}, ValueError, "sensors must have names like gps, not 3"),
    ({"sensors": {"gps": move}}, TypeError, "sensors must be of the class Sensor, and gps is not"),
    ({"sensors": {"gps": Sensor("h")}}, TypeError, "h of gps must be callable, not 'h'"),
    ({"sensors": {"gps": Sensor(lambda x: x)}}, TypeError,
     "observation model h of gps (<lambda>) must take (x, v), not (x)"),
    ({"sensors": Sensor(lambda x: x)}, TypeError,
     "observation model h (<lambda>) must take (x, v), not (x)"),
    ({"sensors": {"gps": Sensor(raising)}}, ValueError,
     "h of gps must take the first estimate and zeros as v, to count its observations; give m, "),
    ({"sensors": {"gps": Sensor(lambda x, v: 3.0)}}, ValueError,
     "h of gps must return a vector of observations for the first estimate, not the shape ()"),
    ({"sensors": Sensor(lambda x, v: [])}, ValueError,
     "h must return a vector of observations for the first estimate, not the shape (0,)"),
    (sensors(gps={"m": 0}), ValueError, "m of gps must be at least 1, not 0"),
    (sensors(gps={"m": 2.5}), TypeError, "m of gps must be an int, not 2.5"),
    (sensors(gps={"m": 3, "observations": ("a", "b")}), ValueError,
     "m of gps must be 2, the number of names, not 3"),
    (sensors(gps={"observations": ("east", "east")}), ValueError,
     "observations of gps must have different names, not ('east', 'east')"),
    (sensors(gps={"observations": {"east": 1}}), TypeError,
     "observations of gps must have names and units that are text, not 1"),
    (sensors(gps={"observations": "m"}), TypeError,
     "observations of gps must be names and units, as {'a': 'm'}, not 'm'"),
    (sensors(compass={"R": np.eye(2)[:1]}), ValueError,
     "R of compass must have the shape (1, 1), not (1, 2)"),
    (sensors(compass={"R": -np.eye(1)}), ValueError,
     "R of compass must be positive semidefinite, and is not in row 0: its variance is -1.0"),
    (sensors(compass={"R": 0.05}), TypeError,
     "R of compass must be an array of real numbers, not 0.05"),
    (sensors(gps={"R": np.eye(3)}) | {"observation_noise": Noise.ADDITIVE}, ValueError,
     "h of gps must take the first estimate and zeros as v"),
    (sensors(gps={"R": np.eye(3), "m": 2}) | {"observation_noise": Noise.ADDITIVE}, ValueError,
     "R of gps must have the shape (2, 2), not (3, 3)"),
    (sensors(compass={"angles": (1,)}), ValueError,
     "angles of compass must be between 0 and 0, not 1"),
    (sensors(gps={"angles": ("east",)}), ValueError,
     "angles of gps must be indices, as the rows have no names, not 'east'"),
    (sensors(gps={"angles": ("up",), "observations": ("east", "north")}), ValueError,
     "angles of gps must be among east, north, not 'up'"),
    ({"states": ("a", "a", "b")}, ValueError,
     "states must have different names, not ('a', 'a', 'b')"),
    ({"states": ("a", "b")}, ValueError, "x0 must have the shape (2,), not (3,)"),
    ({"states": 3}, TypeError, "states must be names and units, as {'a': 'm'}, not 3"),
    ({"inputs": ("u", "u")}, ValueError, "inputs must have different names, not ('u', 'u')"),
    ({"process_noise": Noise.ADDITIVE, "Q": np.eye(2)}, ValueError,
     "Q must have the shape (3, 3), not (2, 2)"),
    ({"process_noise": 3}, TypeError, "process_noise must be a Noise, not 3"),
    ({"form": "triangular"}, ValueError,
     "form must be one of square-root, covariance, not 'triangular'"),
    ({"W0": 1.0}, ValueError, "W0 must be at least 0 and less than 1, not 1.0"),
    ({"pes": 0}, ValueError, "pes must be at least 1, not 0"),
    ({"x0": [], "P0": np.eye(0), "Q": None, "sensors": Sensor(raising, m=1)}, ValueError,
     "n must be between 1 and 32, not 0"),
    ({"error_names": ("x",)}, ValueError, "error_units must have 1 entries, not 0"),
    ({"data": "flight.csv"}, TypeError,
     "data must be Data or a function that makes them, not 'flight.csv'"),
    ({"data": data(measurements=np.ones((4, 3)))}, ValueError,
     "measurements must be by sensor, gps, compass, not one array"),
    ({"data": data(measurements={"gps": MEASURED["gps"]})}, ValueError,
     "measurements must be of gps, compass, not gps"),
    ({"data": data(measurements=MEASURED | {"sonar": np.ones((4, 1))})}, ValueError,
     "measurements must be of gps, compass, not gps, compass, sonar"),
    ({"data": data(measurements=MEASURED | {"gps": np.ones((4, 3))})}, ValueError,
     "measurements of gps must have the shape (4, 2), not (4, 3)"),
    ({"data": data(measurements=MEASURED | {"gps": np.full((4, 2), "a")})}, TypeError,
     "measurements of gps must be an array of real numbers, not array([['a', 'a']"),
    ({"data": data(sampled={"gps": np.ones((4, 2), bool)})}, ValueError,
     "sampled must be of gps, compass, not gps"),
    ({"data": data(sampled=MEASURED | {"compass": np.ones((4, 2), bool)})}, ValueError,
     "sampled of compass must have the shape (4, 1), not (4, 2)"),
    ({"data": data(truth=np.ones((4, 2)))}, ValueError,
     "truth must have the shape (4, 3) to be compared with the states, not (4, 2): give an error"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "kind", "message"), BAD)
def test_wrong_problems_are_refused(options, kind, message):
    with pytest.raises(kind, match="^" + re.escape(message)):
        make(**options)


@pytest.mark.parametrize(
    "name", ["measurements", "sampled", "inputs", "observation_arguments", "truth", "judged"]
)
def test_data_of_different_lengths_are_refused(name):
    short = {"gps": np.ones((4, 2)), "compass": np.ones((3, 1))}
    value = short if name in ("measurements", "sampled") else [None] * 3
    of = " of compass" if value is short else ""
    with pytest.raises(ValueError, match=f"^{name}{of} must have 4 steps, not 3$"):
        data(**{name: value})


BAD_CALLS = [
    (lambda ukf: ukf.update([1.0, 2.0]), TypeError, "sensor must be one of gps, compass, not None"),
    (lambda ukf: ukf.update([1.0], sensor="sonar"), ValueError,
     "sensor must be one of gps, compass, not 'sonar'"),
    (lambda ukf: ukf.update([1.0, 2.0], sensor="compass"), ValueError,
     "z must have the shape (1,), not (2,)"),
    (lambda ukf: ukf.update([1.0], mask=[True, False], sensor="compass"), ValueError,
     "mask must have the shape (1,), not (2,)"),
    (lambda ukf: ukf.set_R(np.eye(1)), TypeError, "sensor must be one of gps, compass, not None"),
    (lambda ukf: ukf.set_R(np.eye(2), "compass"), ValueError,
     "R of compass must have the shape (1, 1), not (2, 2)"),
    (lambda ukf: ukf.set_R(np.eye(1), "sonar"), ValueError,
     "sensor must be one of gps, compass, not 'sonar'"),
    (lambda ukf: setattr(ukf, "R", np.eye(3) + 0.1), ValueError,
     "R must be zero between sensors, which have an update each, not 0.1 at (0, 2)"),
]  # fmt: skip


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("call", "kind", "message"), BAD_CALLS)
def test_wrong_calls_are_refused_and_change_nothing(backend, call, kind, message):
    ukf = UnscentedKalmanFilter(make(), backend)
    ukf.predict()
    before = ukf.x.tolist(), ukf.P.tolist(), ukf.R.tolist()
    with pytest.raises(kind, match="^" + re.escape(message) + "$"):
        call(ukf)
    assert (ukf.x.tolist(), ukf.P.tolist(), ukf.R.tolist()) == before


def test_a_filter_takes_a_problem():
    with pytest.raises(TypeError, match=r"^problem must be a Problem, not <function"):
        UnscentedKalmanFilter(move)


# What is completed.


def test_sizes_follow_from_the_rest():
    assert make().params == UkfParams(n=3, m=3, q=3, r=3, sensors=(2, 1), format=BINARY64)
    one = make(sensors=sensor("gps"), Q=None)
    assert one.params == UkfParams(n=3, m=2, q=0, r=2, format=BINARY64)
    assert one.sensor_names == ("sensor",)
    assert one.Q.shape == (0, 0)
    two = np.zeros((3, 2))
    many = make(sensors=Sensor(lambda x, v: H["gps"] @ x + two[:2] @ v[:2], R=np.eye(5)))
    assert (many.params.m, many.params.r) == (2, 5)
    quiet = {"gps": sensor("gps", m=2), "compass": sensor("compass", R=None, m=1)}
    assert make(sensors=quiet).params.r == 2
    additive = make(sensors=quiet, observation_noise=Noise.ADDITIVE)
    assert additive.params.r == 3  # all or none
    np.testing.assert_array_equal(additive.R[2], np.zeros(3))


def test_observations_are_counted_by_calling_h():
    calls = []

    def h(x, v):
        calls.append((x.copy(), v.copy()))
        return x[:2] + v

    for vectorized in (False, True):
        made = make(sensors=Sensor(h, R=np.eye(2)), vectorized=vectorized)
        assert made.params.m == 2
        (x, v) = calls.pop()
        assert x.ravel().tolist() == [1.0, 0.0, 0.5]
        assert v.ravel().tolist() == [0.0, 0.0]
        assert x.ndim == 1 + vectorized
    for known in ({"m": 2}, {"observations": ("east", "north")}):
        made = make(sensors=Sensor(h, R=np.eye(2), **known))
        replace(made, W0=0.5)
    assert not calls


def test_names_and_units():
    made = make(
        states={"heading": "rad", "speed": "m/s", "bias": "rad"},
        state_angles=("bias", "heading"),
        inputs=["force"],
        sensors={
            "gps": sensor("gps", observations={"east": "m", "north": "m"}),
            "compass": sensor("compass", observations=["bearing"], angles=["bearing"]),
        },
    )
    assert made.state_angles == (2, 0)
    assert made.inputs == {"force": ""}
    assert made.sensor("gps").observations == {"east": "m", "north": "m"}
    assert made.sensor("compass").observations == {"bearing": ""}
    assert made.sensor("compass").angles == (0,)
    assert (made.error_names, made.error_units) == (
        ("heading", "speed", "bias"), ("rad", "m/s", "rad"),
    )  # fmt: skip
    plain = make()
    assert list(plain.sensor("gps").observations) == ["gps[0]", "gps[1]"]
    assert list(plain.sensor("compass").observations) == ["compass"]
    assert plain.error_names == ("x[0]", "x[1]", "x[2]")
    assert list(make(sensors=sensor("gps")).sensor("sensor").observations) == ["z[0]", "z[1]"]


def test_a_problem_has_copies_of_what_it_was_given():
    x0, P0 = np.zeros(3), np.eye(3)
    made = make(x0=x0, P0=P0)
    x0[0] = P0[0, 0] = 9.0
    assert made.x0.tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(made.P0, np.eye(3))


# Cores.


def test_the_same_problem_for_another_core():
    made = make()
    other = replace(made.params, W0=0.3, form=Form.COVARIANCE, format=BINARY32, pes=2)
    assert made.for_core(other).params == other
    assert made.params.pes == 1
    for change in ({"n": 4}, {"sensors": (1, 2)}, {"r": 2}, {"process_noise": Noise.ADDITIVE}):
        (name,) = change
        with pytest.raises(ValueError, match=f"^{name} of a core for cart must be .*, not "):
            made.for_core(replace(made.params, **change))
    with pytest.raises(ValueError, match=r"^P0 must be positive definite"):
        make(P0=np.zeros((3, 3))).for_core(other)


def test_a_filter_has_a_problem_for_its_core_without_data():
    ukf = UnscentedKalmanFilter(make(data=data()), "golden")
    assert ukf.problem.data is None
    assert ukf.params == ukf.problem.params == make().params


@pytest.mark.parametrize(
    ("noise", "redraw", "redraws"),
    [
        (Noise.AUGMENTED, None, False),
        (Noise.ADDITIVE, None, True),
        (Noise.ADDITIVE, False, False),
        (Noise.AUGMENTED, True, True),
    ],
)
def test_predicts_redraw_after_additive_noise_by_default(noise, redraw, redraws):
    assert make(process_noise=noise, redraw=redraw).redraws is redraws


# Data.


def test_what_is_nan_was_not_sampled():
    gps = np.array([[1.0, np.nan], [2.0, 3.0], [np.nan, np.nan], [0.0, 1.0]])
    made = make(data=data(measurements=MEASURED | {"gps": gps}))
    _, sampled = made.samples("gps")
    assert sampled.tolist() == [[True, False], [True, True], [False, False], [True, True]]
    told = make(data=data(sampled={name: np.zeros_like(part) for name, part in MEASURED.items()}))
    assert not told.samples("compass")[1].any()
    with pytest.raises(TypeError, match=r"^sensor must be one of gps, compass, not None$"):
        made.samples()


def test_the_only_sensor_has_the_array_alone():
    made = make(sensors={"gps": sensor("gps")}, data=data(measurements=MEASURED["gps"]))
    assert list(made.record.measurements) == ["gps"]
    np.testing.assert_array_equal(made.samples()[0], MEASURED["gps"])


def test_data_may_be_made_by_a_function():
    def simulate(seed, steps):
        count = 6 if steps is None else steps
        rng = np.random.default_rng(seed)
        parts = {"gps": rng.normal(size=(count, 2)), "compass": rng.normal(size=(count, 1))}
        return Data(times=np.arange(float(count)), measurements=parts)

    made = make(data=simulate)
    with pytest.raises(ValueError, match=r"must be Data, not the function that makes them: use wi"):
        _ = made.steps
    assert made.with_data().steps == 6
    one, other = made.with_data(3, 2), made.with_data(4, 2)
    assert one.times.tolist() == [0.0, 1.0]
    assert (one.samples("gps")[0] != other.samples("gps")[0]).all()
    with pytest.raises(
        ValueError, match=r"^data of the problem 'cart' must be Data, not None: it needs d"
    ):
        run(make())


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, np.nan, 2.0, 3.0], "^times must be finite, not nan at step 1$"),
        ([0.0, 1.0, np.inf, 3.0], "^times must be finite, not inf at step 2$"),
        ([0.0, 1.0, 1.0, 3.0], "^times must rise, not go from 1.0 at step 1 to 1.0$"),
        ([0.0, 2.0, 1.0, 3.0], "^times must rise, not go from 2.0 at step 1 to 1.0$"),
        (np.zeros((4, 1)), "^times must be a vector of numbers, not array"),
        (["0", "1", "2", "3"], "^times must be a vector of numbers, not "),
    ],
)
def test_times_rise(times, message):
    with pytest.raises(ValueError, match=message):
        data(times=times)
    assert data(times=[0, 1, 2, 4]).times.tolist() == [0.0, 1.0, 2.0, 4.0]


def test_inputs_are_as_wide_as_their_names():
    message = r"^inputs must have 2 numbers in each step, for speed, turn, not "
    for wrong, width in ((TIMES, 1), (np.zeros((4, 3)), 3)):
        with pytest.raises(ValueError, match=f"{message}{width}$"):
            make(inputs=("speed", "turn"), data=data(inputs=wrong))
    for right in (np.zeros((4, 2)), [(0.0, 1.0)] * 4, [{"speed": 1.0}] * 4, None):
        make(inputs=("speed", "turn"), data=data(inputs=right))
    make(inputs=("speed",), data=data(inputs=TIMES))


def test_angles_are_in_radians():
    with pytest.raises(ValueError, match=r"^state_angles must be in rad, and b is in 'deg'$"):
        make(states={"a": "m", "b": "deg", "c": ""}, state_angles=("b",))
    with pytest.raises(ValueError, match=r"^angles of compass must be in rad, and yaw is in '°'$"):
        make(sensors={"compass": Sensor(lambda x, v: x[:1], observations={"yaw": "°"},
                                        angles=("yaw",))})  # fmt: skip
    made = make(states={"a": "m", "b": "rad", "c": "deg"}, state_angles=("b",))
    assert made.state_angles == (1,)


def test_what_the_function_of_the_data_does_wrong_is_told():
    def fails(seed, steps):
        return 1 // seed

    with pytest.raises(ValueError, match=(
        r"^data of the problem 'cart' must be made by data\(seed, steps\), and for seed 0 and all "
        r"steps it raised ZeroDivisionError: .* \(.*test_problem\.py, line \d+\)$"
    )):  # fmt: skip
        make(data=fails).with_data()
    with pytest.raises(ValueError, match=r"and 3 steps it raised TypeError: .* positional"):
        make(data=lambda seed: data()).with_data(steps=3)
    with pytest.raises(TypeError, match=r"must be Data, and its function gave None$"):
        make(data=lambda seed, steps: None).with_data()
    # One that disregards steps gives more than are asked for.
    stubborn = make(data=lambda seed, steps: data())
    assert stubborn.with_data(steps=2).steps == 2
    with pytest.raises(ValueError, match=r"^steps must be between 1 and 4, not 5$"):
        stubborn.with_data(steps=5)


def test_inputs_are_finite():
    inputs = np.zeros((4, 2))
    inputs[3, 1] = np.nan
    message = "^inputs must be finite, not nan in "
    with pytest.raises(ValueError, match=f"{message}turn of step 3$"):
        make(inputs=("speed", "turn"), data=data(inputs=inputs))
    with pytest.raises(ValueError, match=f"{message}speed of step 2$"):
        make(inputs=("speed",), data=data(inputs=[0.0, 1.0, np.nan, 2.0]))
    # What has no name is the model's affair.
    assert make(data=data(inputs=inputs)).steps == 4
    assert make(data=data(inputs=["a", "b", "c", "d"])).steps == 4


COMPARE = "must compare x of shape (4, 3) with the truth of shape (4, 3)"
COLUMNS = "must give the shape (4, 1), a column for each of error_names (e), not "


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (lambda x, truth: x[:, :2], f"{COLUMNS}(4, 2)"),
        (lambda x, truth: x[:, 0], f"{COLUMNS}(4,)"),
        (lambda x, truth: None, f"{COLUMNS}()"),
        (lambda x, truth: 1 / 0, f"{COMPARE}, and raised ZeroDivisionError: division by zero ("),
    ],
)
def test_a_wrong_error_function_is_named(error, message):
    made = make(
        data=data(truth=np.zeros((4, 3))), error=error, error_names=("e",), error_units=("m",)
    )
    with pytest.raises(ValueError, match=re.escape(f"error of the problem 'cart' {message}")):
        made.errors_of(np.zeros((4, 3)))


def test_an_error_function_needs_names():
    with pytest.raises(ValueError, match=r"^error_names must name what error gives, .*, not \(\)$"):
        make(error=lambda x, truth: x)


def test_the_first_steps_of_data():
    whole = make(data=data(inputs=TIMES, truth=np.ones((4, 3)), judged=TIMES > 0.0))
    assert whole.with_data() is whole
    short = whole.with_data(steps=3)
    assert (short.steps, len(short.record.inputs), len(short.samples("gps")[1])) == (3, 3, 3)
    assert short.record.judged.tolist() == [False, True, True]
    for steps in (0, 5):
        with pytest.raises(ValueError, match=f"^steps must be between 1 and 4, not {steps}$"):
            whole.with_data(steps=steps)


def test_nothing_sampled_is_of_no_sensor():
    ukf = UnscentedKalmanFilter(make())
    assert ukf.update(None) is ukf.update(None, sensor="gps") is False
    with pytest.raises(ValueError, match=r"^sensor must be one of gps, compass, not 'sonar'$"):
        ukf.update(None, sensor="sonar")


def test_errors_are_differences_and_of_angles_within_half_a_turn():
    truth = np.array([[1.0, 3.0, 0.0]] * 4)
    made = make(data=data(truth=truth), state_angles=(1,))
    x = np.array([[1.5, -3.0, 7.0], [1.0, 3.1, 0.0]])
    np.testing.assert_allclose(
        made.errors_of(x), [[0.5, 2 * np.pi - 6.0, 7.0], [0.0, 0.1, 0.0]], atol=1e-12
    )
    own = replace(
        change_data(made, truth=truth), error=lambda x, truth: x[:, :1] - truth[:, :1] + 1.0,
        error_names=("e",), error_units=("m",),
    )  # fmt: skip
    assert own.errors_of(x).tolist() == [[1.5], [1.0]]


# Several sensors.


@pytest.mark.parametrize("kind", Noise)
def test_two_updates_are_the_joint_one_if_the_models_are_linear(kind):
    """Sensors whose noises are independent, one after the other or all rows at once."""

    def joint(x, v):
        return np.concatenate([H["gps"] @ x, H["compass"] @ x]) + v

    made = make(observation_noise=kind)
    one = make(observation_noise=kind, sensors=Sensor(joint, R=made.R))
    filters = [UnscentedKalmanFilter(made, backend) for backend in BACKENDS]
    whole = UnscentedKalmanFilter(one)
    rng = np.random.default_rng(4)
    for _ in range(20):
        z = rng.standard_normal(3)
        for ukf in (*filters, whole):
            ukf.predict()
        nis = []
        for ukf in filters:
            ukf.update(z[:2], sensor="gps")
            first = ukf.nis
            ukf.update(z[2:], sensor="compass")
            nis.append(first + ukf.nis)
        whole.update(z)
        for ukf, found in zip(filters, nis, strict=True):
            np.testing.assert_allclose(ukf.x, whole.x, atol=1e-9)
            np.testing.assert_allclose(ukf.P, whole.P, atol=1e-9)
            assert found == pytest.approx(whole.nis, rel=1e-9)


@pytest.mark.parametrize("process", Noise)
@pytest.mark.parametrize("kind", Noise)
@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("rows", [(1, 2), (2, 1, 1), (3,)])
def test_golden_model_agrees_with_the_reference(form, kind, process, rows):
    m = sum(rows)
    params = UkfParams(
        n=3, m=m, q=3, r=m, sensors=rows, process_noise=process, observation_noise=kind,
        form=form, format=BINARY64, pes=2, W0=0.1,
    )  # fmt: skip
    scenario = random_scenario(params, 5, steps=40)
    assert scenario.params == params
    # Sensors that are silent at times, all at once as well, or see some of their rows only.
    rng = np.random.default_rng(1)
    measured = {}
    for name in scenario.sensor_names:
        z, _ = scenario.samples(name)
        seen = rng.random(z.shape) < 0.6
        seen[5] = False
        measured[name] = np.where(seen, z, np.nan)
    scenario = change_data(scenario, measurements=measured, sampled=None)
    expected, found = run(scenario), run(scenario, "golden")
    np.testing.assert_allclose(found.x, expected.x, atol=1e-9)
    np.testing.assert_allclose(found.nis_of_sensors, expected.nis_of_sensors, atol=1e-8)
    assert found.nis_of_sensors.shape == (40, len(rows))
    for number, name in enumerate(scenario.sensor_names):
        silent = ~scenario.samples(name)[1].any(axis=1)
        np.testing.assert_array_equal(np.isnan(found.nis_of_sensors[:, number]), silent)
    assert np.isnan(found.nis[5])
    known = ~np.isnan(found.nis)
    np.testing.assert_allclose(
        found.nis[known], np.nansum(found.nis_of_sensors, axis=1)[known], rtol=1e-15
    )


def test_a_step_updates_with_each_sensor_in_their_order():
    made = make(data=data(measurements=MEASURED | {"gps": np.full((4, 2), [[1.0, np.nan]])}))
    by_hand = UnscentedKalmanFilter(made)
    x = []
    for _ in range(4):
        by_hand.predict()
        by_hand.update([1.0, 0.0], mask=[True, False], sensor="gps")
        by_hand.update([0.0], sensor="compass")
        x.append(by_hand.x)
    np.testing.assert_array_equal(run(made).x, x)


def test_a_step_is_gated_if_one_of_its_updates_is():
    found = run(
        make(data=data(measurements=MEASURED | {"gps": np.full((4, 2), 1e3)})),
        after_step=lambda done, ukf: setattr(ukf, "gate", 50.0),
    )
    assert found.gated.all()
    assert (found.nis_of_sensors[:, 0] > 50.0).all()
    assert (found.nis_of_sensors[:, 1] < 50.0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_noise_of_one_sensor_is_replaced(backend):
    ukf, twin = (UnscentedKalmanFilter(make(), each) for each in (backend, "reference"))
    ukf.set_R([[0.7]], "compass")
    whole = np.diag([0.0, 0.0, 0.7])
    whole[:2, :2] = R["gps"]
    twin.R = whole
    np.testing.assert_array_equal(ukf.R, twin.R)
    for each in (ukf, twin):
        each.predict()
        each.update([1.0, 2.0], sensor="gps")
        each.update([3.0], sensor="compass")
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
def test_masks_of_several_sensors(backend):
    """The filter's own mask has the rows of all sensors."""
    ukf, twin = (UnscentedKalmanFilter(make(), each) for each in (backend, "reference"))
    ukf.mask = [False, True, False]
    for each in (ukf, twin):
        each.predict()
    assert ukf.update([np.nan, 2.0], sensor="gps")
    assert not ukf.update([5.0], sensor="compass")
    assert ukf.update([5.0], mask=[True], sensor="compass")
    twin.update([np.nan, 2.0], mask=[False, True], sensor="gps")
    twin.update([5.0], sensor="compass")
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)


def test_random_systems_have_as_many_sensors_as_are_asked_for():
    params = UkfParams(n=4, m=5, q=2, r=3, sensors=(1, 3, 1))
    made = random_scenario(params, 2, steps=5)
    assert made.sensor_names == ("s0", "s1", "s2")
    assert made.params == params
    assert [len(made.sensor(name).R) for name in made.sensor_names] == [0, 2, 1]
    assert random_scenario(replace(params, sensors=()), steps=1).sensor_names == ("s0",)


@pytest.mark.parametrize("noise", list(Noise))
def test_two_sensors_of_the_nanosatellite_follow_float64(noise):
    """Accelerometer and magnetometer one after the other: as float64 does the same two updates."""
    joint = nanosat(0, noise=noise, steps=300)
    h, R = joint.sensor("sensor").h, joint.R
    z, _ = joint.samples()

    def seen_by(rows):
        def h_of_rows(x, v):
            return h(x, np.zeros((6, *x.shape[1:])))[rows] + v

        return h_of_rows

    rows = {"accelerometer": slice(0, 3), "magnetometer": slice(3, 6)}
    apart = replace(
        joint,
        sensors={name: Sensor(seen_by(own), R=R[own, own]) for name, own in rows.items()},
        data=replace(joint.record, measurements={name: z[:, own] for name, own in rows.items()},
                     sampled=None),
    )  # fmt: skip
    deviations = np.sqrt(np.diag(run(apart, "reference", covariance=True).P))
    golden, reference, together = (
        run(problem, backend)
        for problem, backend in ((apart, "golden"), (apart, "reference"), (joint, "reference"))
    )
    difference = np.abs(golden.x - reference.x)[-100:].max(axis=0)
    assert (difference < 0.03 * deviations).all()
    # The models are not linear, so the joint update is another filter, though nearly the same.
    assert 0.0 < np.abs(together.x - reference.x)[-1].max() < deviations.max()
