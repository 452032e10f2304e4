"""The filter with its models on the golden core: what they give, and which programs they are."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.executed_models import with_executed_models
from ukf_sw.backends import golden_driver
from ukf_sw.errors import TraceError, UkfError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.lowering.placement import place_models
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.placing import core_models
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.model_programs import NO_MODELS
from ukf_sw.spec.parameters import Form

STEPS = 8
ODD_FORMAT = FloatFormat(exponent_bits=7, fraction_bits=19)


def on_core(name, steps, **changes):
    return Recipe.of(name, models="core", **changes).scenario(steps)


def check_equal(problem, steps, **options):
    """The core gives what a filter gives whose models execute the same steps in software."""
    there, here = (
        run(each, "golden", steps=steps, ends_at=(UkfError,), covariance=True, **options)
        for each in (problem, with_executed_models(problem))
    )
    assert there.steps == here.steps
    np.testing.assert_array_equal(there.x, here.x)
    np.testing.assert_array_equal(there.nis, here.nis)
    np.testing.assert_array_equal(there.gated, here.gated)
    if there.stop is None:
        np.testing.assert_array_equal(there.P, here.P)
    return there, here


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("battery", {"pes": 3}),
        ("pendulum", {"pes": 2, "format": BINARY64, "W0": 0.25}),
        ("nanosat-additive", {"pes": 5, "form": Form.COVARIANCE}),
        *(
            pytest.param(name, {"pes": pes, "form": form, "format": fmt}, marks=pytest.mark.slow)
            for name, pes in (
                ("nanosat", 1), ("nanosat", 2), ("nanosat", 5), ("nanosat", 11), ("nanosat", 22),
                ("battery", 1), ("battery", 11), ("gps-ins", 5), ("reentry", 2), ("reentry", 11),
                ("pendulum", 5), ("nanosat-2014-gaps", 10),
            )
            for form in Form
            for fmt in (BINARY32, BINARY64)
        ),
    ],
)  # fmt: skip
def test_models_on_the_core_are_their_steps(name, changes):
    there, _ = check_equal(on_core(name, 12, **changes), 12)
    assert there.stop is None


@pytest.mark.parametrize(
    ("name", "fmt", "size"),
    [
        ("pendulum", BINARY16, 1.0),
        ("pendulum", BFLOAT16, 40.0),
        *(
            pytest.param(name, fmt, size, marks=pytest.mark.slow)
            for name in ("nanosat", "battery", "nanosat-additive")
            for fmt in (BINARY16, BFLOAT16, BINARY32)
            for size in (1.0, 1e3, 1e5)
        ),
    ],
)
def test_coarse_formats_and_wild_observations(name, fmt, size):
    """Whatever comes of them, numbers or an error, comes of both."""
    problem = on_core(name, STEPS, format=fmt, pes=2)
    data = problem.record
    (sensor,) = problem.sensor_names
    z = data.measurements[sensor] * np.where(np.arange(STEPS) % 4 == 3, size, 1.0)[:, None]
    sampled = np.ones(z.shape, dtype=bool)
    sampled[2, 0] = sampled[5] = False
    wild = replace(data, measurements={sensor: z}, sampled={sensor: sampled})
    there, here = check_equal(replace(problem, data=wild), STEPS)
    if there.stop is not None and here.stop is not None:
        assert there.stop.index == here.stop.index


def drive(x, w, u):
    """A cart with an unknown scale of its odometer."""
    place, speed, scale = x
    return np.array([place + 0.5 * speed, speed + u[0] + w[0], 0.75 * scale + 0.25])


def see_place(x, v):
    return np.array([x[0] + v[0], x[0] * x[2] - 0.5 * v[1]])


def see_speed(x, v, *, gain):
    return np.where(x[1:2] > 0.0, x[1:2] * gain, 0.0) + v


def cart(**changes):
    """Two sensors, augmented noise, and nothing that needs coefficients: it has every format."""
    draws = np.random.default_rng(5)
    data = Data(
        times=np.arange(1.0, STEPS + 1.0), inputs=draws.normal(size=(STEPS, 1)),
        measurements={
            "gps": draws.normal(size=(STEPS, 2)), "odometer": draws.normal(size=(STEPS, 1)),
        },
    )  # fmt: skip
    arguments = [{"gain": float(gain)} for gain in draws.uniform(0.5, 1.5, STEPS)]
    sensors = {
        "gps": Sensor(lambda x, v, *, gain: see_place(x, v), R=0.1 * np.eye(2), m=2),
        "odometer": Sensor(see_speed, R=[[0.2]], m=1),
    }
    return Problem(
        name="cart", f=drive, sensors=sensors, Q=[[0.1]], x0=[0.0, 0.5, 1.0], P0=np.eye(3),
        data=replace(data, observation_arguments=arguments), **changes,
    )  # fmt: skip


def with_programs(problem, models):
    placed = place_models(problem, models)
    return replace(problem, models=placed.models)


#: Cores of the cart; the first one also with one of the models on it.
CARTS = [
    {"pes": 1, "format": ODD_FORMAT},
    {"pes": 2, "form": Form.COVARIANCE, "W0": 0.25},
    {"pes": 5, "format": BINARY64, "redraw": True},
    {"pes": 11, "format": BFLOAT16, "W0": 0.5},
    {"pes": 3, "format": BINARY16, "form": Form.COVARIANCE},
]


@pytest.mark.parametrize(
    ("models", "changes"),
    [
        ("core", CARTS[0]), ("f", CARTS[0]), ("h", CARTS[0]), ("core", CARTS[1]),
        *(
            pytest.param(models, changes, marks=pytest.mark.slow)
            for models in ("core", "f", "h")
            for changes in CARTS[1:]
        ),
    ],
)  # fmt: skip
def test_sensors_masks_and_gates_in_any_order(models, changes):
    """Whatever is done to a filter gives equal numbers, or the same error, in both."""
    problem = with_programs(cart(**changes), models)
    filters = [UnscentedKalmanFilter(each, "golden")
               for each in (problem, with_executed_models(problem))]  # fmt: skip
    draws, done = np.random.default_rng(7), {"gated": 0, "error": 0, "masked": 0}
    for k in range(40):
        what = ("iterate", "update", "predict", "iterate", "gate", "redraw")[int(draws.integers(6))]
        sensor = ("gps", "odometer")[int(draws.integers(2))]
        z = draws.normal(size=2 if sensor == "gps" else 1) * (1e4 if k % 9 == 8 else 1.0)
        mask = draws.random(len(z)) < 0.8
        given = {"mask": mask, "sensor": sensor, "gain": float(draws.uniform(0.5, 1.5))}
        u = draws.normal(size=1)
        found = []
        for ukf in filters:
            try:
                match what:
                    case "iterate":
                        ukf.iterate(u, z, **given)
                    case "update":
                        ukf.update(z, **given)
                    case "predict":
                        ukf.predict(u)
                    case "redraw":
                        ukf.redraw()
                    case "gate":
                        ukf.gate = (3.0, np.inf)[k % 2]
                error = None
            except UkfError as raised:
                error = getattr(raised, "index", None)
                done["error"] += 1
                ukf.reset()
            found.append((error, ukf.x.tolist(), ukf.P.tolist(), ukf.nis, ukf.gated))
        assert found[0] == found[1], (k, what)
        done["gated"] += ukf.gated
        done["masked"] += what == "iterate" and not mask.all()
    assert done["gated"] > 0
    assert done["masked"] > 0


# Which programs of a core they are.


def move(x, w, u):
    return np.array([x[0] + 0.1 * x[1], 0.9 * x[1] + u["force"]]) + w


def see(x, v, *, kind, gain):
    """A program for each kind."""
    return (x[:1] if kind == "place" else 0.5 * np.sin(x[1:])) * gain + v


def kinds(*names, f=move, h=see, **changes):
    """A problem whose data call for these kinds of observation, one after the other."""
    count = len(names)
    data = Data(
        times=0.1 * np.arange(1, count + 1), measurements=0.1 * np.ones((count, 1)),
        inputs=[{"force": 0.01 * k} for k in range(count)],
        observation_arguments=[
            {"kind": name, "gain": 1.0 + 0.1 * k} for k, name in enumerate(names)
        ],
    )  # fmt: skip
    return Problem(
        name="kinds", f=f, sensors=Sensor(h, R=[[0.1]], m=1), Q=1e-3 * np.eye(2), x0=[0.3, 0.1],
        P0=np.eye(2), data=data, pes=2, **changes,
    )  # fmt: skip


BOTH = ("place", "rate", "rate", "place")


@pytest.fixture(scope="module")
def core():
    """Parameters of a core with both programs, that of "place" first."""
    problem = kinds(*BOTH)
    return replace(problem.params, models=place_models(problem, "core").models)


@pytest.mark.parametrize("names", [BOTH, ("rate", "place"), ("rate",), ("place", "place")])
def test_a_core_may_have_more_programs_than_the_data_call_for(core, names):
    """And in another order: what counts is what they compute."""
    problem = kinds(*names)
    own = UnscentedKalmanFilter(problem, "golden", models="core").backend.params.models
    assert (own == core.models) is (names == BOTH)
    runs = [run(problem.for_core(replace(core, models=each)), "golden", covariance=True)
            for each in (core.models, own)]  # fmt: skip
    np.testing.assert_array_equal(runs[0].x, runs[1].x)
    np.testing.assert_array_equal(runs[0].P, runs[1].P)
    check_equal(problem.for_core(core), len(names))


def test_programs_of_a_record_are_those_of_all_its_steps(tmp_path, monkeypatch):
    """Also of what comes late in it; of data that are made, 100 steps are."""
    (tmp_path / "late_kind.py").write_text(
        "from dataclasses import replace\n"
        "from test_filter_with_models import kinds\n"
        "recorded = kinds(*['place'] * 120, 'rate')\n"
        "made = replace(recorded, data=lambda seed, steps: kinds(*['place'] * steps).data)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.chdir(tmp_path)
    counts = [
        len(core_models(f"late_kind:{name}", "core", BINARY32).h[0])
        for name in ("recorded", "made")
    ]
    assert counts == [2, 1]


def test_lists_are_arrays_as_in_software():
    problem = Recipe.of("nanosat", models="core", pes=10).scenario(1)
    found = []
    for kind in (np.array, list, tuple):
        ukf = UnscentedKalmanFilter(problem, "golden")
        ukf.predict(kind(problem.record.inputs[0]))
        found.append(ukf.x.tolist())
    assert found[0] == found[1] == found[2]


def other_move(x, w, u):
    return 2.0 * move(x, w, u)


def see_without_gain(x, v, *, kind, gain):
    return x[:1] + v


@pytest.mark.parametrize(
    ("problem", "missing"),
    [
        (kinds(*BOTH, f=other_move), "f"),
        (kinds(*BOTH, h=see_without_gain), "h (kind='place')"),
    ],
)
def test_a_core_without_a_program_is_refused(core, problem, missing):
    message = (
        f"models of a core for kinds must be those of the problem, {missing} among them, not "
        f"{core.models.digest:#010x}"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        UnscentedKalmanFilter(problem, golden_driver(core))


def with_time(x, w, u):
    return move(x, w, u) * (1.0 + 0.0 * u["dt"])


def test_a_core_without_an_input_is_refused(core):
    problem = kinds("place")
    data = replace(problem.data, inputs=[{"force": 0.0, "dt": 0.1}])
    message = "must be those of the problem, f: u['dt'] among them, not 0x"
    with pytest.raises(ValueError, match=message.replace("[", "\\[")):
        UnscentedKalmanFilter(replace(problem, f=with_time, data=data), golden_driver(core))


@pytest.mark.parametrize("models", ["software", {"f": "core"}, {"h": "core"}])
def test_a_core_with_models_has_no_others(core, models):
    message = r"models must be those that the core has, \['f', 'h'\], not "
    with pytest.raises(ValueError, match=message):
        UnscentedKalmanFilter(kinds(*BOTH), golden_driver(core), models=models)
    bare = golden_driver(replace(core, models=NO_MODELS))
    if models != "software":
        with pytest.raises(ValueError, match=r"models must be those that the core has, \[\], not "):
            UnscentedKalmanFilter(kinds(*BOTH), bare, models=models)


@pytest.mark.parametrize("kind", ["f", "h"])
def test_a_model_in_software_may_be_any_function(kind):
    """With the other one on the core: only what is there must be such as can be traced."""
    problem = Recipe.of("pendulum").scenario(STEPS)
    sensor = problem.sensor("sensor")

    def branching(x, noise, *rest):
        model = problem.f if kind == "f" else sensor.h
        if x.sum() > 1e6:
            raise ValueError("x must be near the origin")
        return model(x, noise, *rest)

    if kind == "f":
        free = replace(problem, f=branching, vectorized=problem.vectorized)
        places = {"h": "core"}
    else:
        free = replace(problem, sensors=replace(sensor, h=branching))
        places = {"f": "core"}
    both = [UnscentedKalmanFilter(each, "golden", models=places) for each in (problem, free)]
    data = problem.record
    for k in range(STEPS):
        for ukf in both:
            u = None if data.inputs is None else data.inputs[k]
            ukf.iterate(u, data.measurements["sensor"][k])
    np.testing.assert_array_equal(both[0].x, both[1].x)
    with pytest.raises(TraceError, match="must not branch on data"):
        UnscentedKalmanFilter(free, "golden", models="core")
