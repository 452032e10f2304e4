"""Logs of sensors as steps: merged in time, and what does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from ukf_sw.problem import Problem, Sensor
from ukf_sw.problems.logs import LogError, read_log
from ukf_sw.problems.running import run
from ukf_sw.spec.parameters import Noise


def f(x, w, u):
    dt, push = u
    return np.array([x[0] + dt * x[1], x[1] + dt * (push - 0.1 * np.sin(x[2])), x[2] + 0.01 * dt])


PROBLEM = Problem(
    name="cart",
    f=f,
    states={"position": "m", "speed": "m/s", "slope": "rad"},
    inputs={"dt": "s", "push": "m/s^2"},
    Q=1e-4 * np.eye(3),
    process_noise=Noise.ADDITIVE,
    observation_noise=Noise.ADDITIVE,
    sensors={
        "gps": Sensor(
            lambda x, v: x[:2], R=np.diag([4.0, 0.1]), observations={"x": "m", "v": "m/s"}
        ),
        "odometer": Sensor(lambda x, v: x[1:2], R=[[0.01]], observations={"v": "m/s"}),
        "level": Sensor(
            lambda x, v: x[2:], R=[[1e-4]], observations={"tilt": "rad"}, angles=("tilt",)
        ),
    },
    x0=[0.0, 1.0, 0.0],
    P0=np.eye(3),
)
#: The same with a clock: f has no input dt.
CLOCKED = replace(
    PROBLEM, f=lambda x, w, u: f(x, w, np.array([0.1, u[0]])), inputs={"push": "m/s^2"}
)


def at_random(seed):
    """Three sensors and an input at times of their own, with gaps, as arrays."""
    rng = np.random.default_rng(seed)

    def times(mean):
        return np.cumsum(rng.uniform(0.2, 1.8, int(30.0 / mean))) * mean

    gps, odometer, level, push = times(1.0), times(0.25), times(0.4), times(0.1)
    x = rng.standard_normal((len(gps), 2)) + np.column_stack((gps, np.ones(len(gps))))
    x[rng.random(x.shape) < 0.2] = np.nan
    return {
        "gps": {"time": gps, "x": x[:, 0], "v": x[:, 1]},
        "odometer": {"time": odometer, "v": 1.0 + 0.1 * rng.standard_normal(len(odometer))},
        "level": {"time": level, "tilt": 0.01 * rng.standard_normal(len(level))},
        "controller": {"time": np.append(0.0, push), "push": rng.standard_normal(len(push) + 1)},
    }


def write_csv(file, columns, separator=","):
    """Write columns with every bit; what is NaN is empty."""
    lines = [separator.join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(separator.join("" if np.isnan(cell) else repr(float(cell)) for cell in row))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def same(data, other):
    """Whether the estimates are equal, to the last bit."""
    found = [run(replace(PROBLEM, data=each), "reference") for each in (data, other)]
    assert found[0].nis_of_sensors.shape[1] == 3
    return all(
        np.array_equal(getattr(found[0], name), getattr(found[1], name), equal_nan=True)
        for name in ("x", "nis_of_sensors", "gated")
    )


@pytest.mark.parametrize("seed", range(3))
def test_files_give_what_arrays_give(tmp_path, seed):
    import polars

    logs = at_random(seed)
    files = {name: write_csv(tmp_path / f"{name}.csv", columns) for name, columns in logs.items()}
    files["odometer"] = tmp_path / "odometer.parquet"
    polars.DataFrame(logs["odometer"]).write_parquet(files["odometer"])
    data = read_log(PROBLEM, logs)
    assert data.steps == len({t for columns in logs.values() for t in columns["time"]})
    assert same(data, read_log(PROBLEM, files))
    # One file with a row for each time.
    whole = {"time": data.times, "push": np.full(data.steps, np.nan)}
    at = np.searchsorted(data.times, logs["controller"]["time"])
    whole["push"][at] = logs["controller"]["push"]
    for name in PROBLEM.sensor_names:
        for k, observation in enumerate(PROBLEM.sensor(name).observations):
            whole[f"{name}.{observation}"] = data.measurements[name][:, k]
    one = write_csv(tmp_path / "one.csv", whole, ";")
    assert same(data, read_log(PROBLEM, one))


def test_steps_are_the_times_of_all_logs():
    logs = {
        "gps": {"time": [1.0, 3.0], "x": [5.0, np.nan], "v": [1.0, 2.0]},
        "odometer": {"time [ms]": [500.0, 1000.0], "v [km/h]": [3.6, 7.2]},
        "level": {"time": [3.0], "tilt [deg]": [180.0]},
        "controller": {"time": [0.5, 2.0], "push": [0.25, 0.75]},
    }
    data = read_log(PROBLEM, logs, start=0.0)
    np.testing.assert_array_equal(data.times, [0.5, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(data.inputs, [[0.5, 0.25], [0.5, 0.25], [1, 0.75], [1, 0.75]])
    nan = np.nan
    np.testing.assert_array_equal(
        data.measurements["gps"], [[nan, nan], [5, 1], [nan, nan], [nan, 2]]
    )
    np.testing.assert_array_equal(data.measurements["odometer"].T, [[1.0, 2.0, nan, nan]])
    np.testing.assert_allclose(data.measurements["level"].T, [[nan, nan, nan, np.pi]])
    assert data.truth is None
    assert read_log(PROBLEM, logs).inputs[0, 0] == 0.0


def test_a_masked_array_and_a_column_that_is_ignored():
    logs = at_random(0)
    logs["gps"]["satellites"] = np.arange(len(logs["gps"]["time"]))
    logs["gps"]["x"] = np.ma.masked_invalid(logs["gps"]["x"])
    assert same(read_log(PROBLEM, logs, ignore=["satellites"]), read_log(PROBLEM, at_random(0)))


def test_truth_comes_along():
    logs = at_random(1)
    times = logs["gps"]["time"]
    logs["truth"] = {"time": times} | {
        f"truth.{name}": k + times for k, name in enumerate(PROBLEM.states)
    }
    data = read_log(PROBLEM, logs)
    there = np.isin(data.times, times)
    np.testing.assert_array_equal(data.truth[there], times[:, None] + np.arange(3))
    assert np.isnan(data.truth[~there]).all()


GOOD = "time,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,2,3,0.1\n0.1,0.1,,,3,\n"

WRONG = [
    ("time,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,2,3,0.1\n-0.1,,,,3,\n",
     "time must rise, not from 0.0 to -0.1 s in row 3 of log.csv"),
    ("time,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,2,3,0.1\n0.0,,,,3,\n",
     "time must rise, not from 0.0 to 0.0 s in row 3 of log.csv"),
    ("time,push,gps.x,gps.v,odometer.v,tilt\n,0.1,1,2,3,0.1\n",
     "time must be a number, not nan in row 2 of log.csv"),
    ("t,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,2,3,0.1\n",
     "log.csv must have a column time, not only t, push, gps.x, gps.v, odometer.v, tilt"),
    ("time,push,gps.x,gps.v,odometer.v,tilt,baro\n0.0,0.1,1,2,3,0.1,9\n",
     ("columns must be of time, gps.x, gps.v, odometer.v, level.tilt, dt, push, truth.position, "
      "truth.speed, truth.slope, not 'baro' of log.csv")),
    ("time,push,gps.x,gps.v,tilt\n0.0,0.1,1,2,0.1\n",
     "odometer.v must be a column of log.csv, and is not"),
    ("time,push,gps.x,v,tilt\n0.0,0.1,1,2,0.1\n",
     "v of log.csv must say whose it is, as gps.v or odometer.v"),
    ("time,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,2,3,93.5\n",
     "tilt must be in radians, not 93.5 in row 2 of log.csv, which looks like degrees"),
    ("time,push,gps.x,gps.v [knots],odometer.v,tilt\n0.0,0.1,1,2,3,0.1\n",
     "gps.v of log.csv must be in m/s, not in knots"),
    ("time,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,two,3,0.1\n",
     "gps.v must be a number or empty, not 'two' in row 2 of log.csv"),
    ("time,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,2,3\n",
     "row 2 of log.csv must have 6 cells, not 5"),
    ("time,push,gps.x,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,1,2,3,0.1\n",
     "log.csv must have different headings, not time, push, gps.x, gps.x, gps.v, odometer.v, tilt"),
    ("time,push,gps.x,gps.v,odometer.v,tilt\n0.0,,1,2,3,0.1\n0.1,0.1,,,3,\n",
     "push must be there from the first time on, 0.0 s, not only later in log.csv"),
    ("time,push,gps.x,gps.v,odometer.v,tilt\n", "log.csv must have a row, not none"),
    ("\n", "log.csv must begin with a line of headings"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_wrong_logs_are_refused(tmp_path, text, message):
    file = tmp_path / "log.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(LogError) as error:
        read_log(PROBLEM, file)
    assert str(error.value).startswith(message)


def test_what_else_is_refused(tmp_path):
    good = tmp_path / "log.csv"
    good.write_text(GOOD, encoding="utf-8")
    assert read_log(PROBLEM, good).steps == 2
    with pytest.raises(LogError, match=r"^start must be at most 0.0 s, the first time, not 3.0$"):
        read_log(PROBLEM, good, start=3.0)
    logs = at_random(0)
    with pytest.raises(LogError, match=r"^gps.x must be in one log, not in the columns gps and "):
        read_log(PROBLEM, logs | {"more": {"time": [1.0], "gps.x": [1.0]}})
    with pytest.raises(LogError, match=r"^the columns gps must have one length, not "):
        read_log(PROBLEM, logs | {"gps": {"time": [1.0], "x": [1.0, 2.0], "v": [1.0]}})
    with pytest.raises(LogError, match=r"^x of the columns gps must be a row of numbers, not "):
        read_log(PROBLEM, logs | {"gps": {"time": [1.0], "x": ["a"], "v": [1.0]}})
    with pytest.raises(LogError, match=r"^data must be a file, columns or several of these, not "):
        read_log(PROBLEM, {})


def test_a_problem_without_dt_needs_equal_intervals(tmp_path):
    file = tmp_path / "log.csv"
    rows = [f"{time},0.1,,,3,\n" for time in (0.0, 0.1, 0.2, 0.35, 0.45)]
    file.write_text(GOOD.splitlines()[0] + "\n" + "".join(rows), encoding="utf-8")
    with pytest.raises(LogError, match=r"^steps must be 0.1 s apart, as most are, since f has no "):
        read_log(CLOCKED, file)
    file.write_text(GOOD.splitlines()[0] + "\n" + "".join(rows[:3]), encoding="utf-8")
    assert read_log(CLOCKED, file).inputs.shape == (3, 1)
