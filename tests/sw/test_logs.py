"""Logs of sensors as steps: merged in time, and what does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from ukf_sw.problem import Problem, Sensor
from ukf_sw.problems.log_tables import read_tables
from ukf_sw.problems.log_times import merge
from ukf_sw.problems.logs import LogError, LogFiles, LogWarning, read_log
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
    with pytest.raises(LogError, match=r"^start must be at most 0.1 s, the last time, not 3.0$"):
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


# The input dt, and times that are of one step.


def three_logs(offset=0.003):
    """An inertial unit at 100 Hz for 6 s, and sensors of which one is off by so many seconds."""
    k = np.arange(600)
    return {
        "imu": {"time": 0.01 * k, "push": np.sin(0.01 * k)},
        "gps": {"time": 0.01 * k[::20], "x": 0.1 * k[::20], "v": np.ones(30)},
        "odometer": {"time": 0.01 * k[::4] + offset, "v": np.ones(150)},
        "level": {"time": 0.01 * k[::2], "tilt": np.zeros(300)},
    }


@pytest.mark.parametrize("heading", ["dt", "dt [ms]"])
def test_a_column_dt_does_not_count_time_twice(heading):
    logs = three_logs()
    data = read_log(PROBLEM, logs)
    column = np.full(600, 10.0 if "ms" in heading else 0.01)
    column[0] = 0.0
    logs["imu"][heading] = column
    again = read_log(PROBLEM, logs)
    assert again.inputs[:, 0].sum() == pytest.approx(data.times[-1] - data.times[0])
    np.testing.assert_array_equal(again.inputs, data.inputs)
    # The first is of a time that the log does not have; it says when the first estimate was.
    column[0] = 0.5 * column[1]
    assert read_log(PROBLEM, logs).inputs[0, 0] == pytest.approx(0.005)
    np.testing.assert_array_equal(read_log(PROBLEM, logs).inputs[1:], data.inputs[1:])
    assert read_log(PROBLEM, logs, start=-1.0).inputs[0, 0] == 1.0
    # Where the log begins later than others its first dt is not that of the first step.
    logs["gps"]["time"] = logs["gps"]["time"] - 0.1
    logs["start"] = {"time": [-0.2], "push": [0.0]}
    del logs["imu"]["push"]
    assert read_log(PROBLEM, logs).inputs[0, 0] == 0.0


@pytest.mark.parametrize(
    ("row", "value", "message"),
    [
        (5, -10.0, "be the time since the row before, 0.01 s, not -10 s in row 5 of "),
        (5, 10.0, "be the time since the row before, 0.01 s, not 10 s in row 5 of "),
        (5, 0.011, "be the time since the row before, 0.01 s, not 0.011 s in row 5 of "),
        (0, 5.0, "be between 0 and 0.0105 s, as there is between rows, not 5 s in row 0 of "),
        (0, -0.01, "be between 0 and 0.0105 s, as there is between rows, not -0.01 s in "),
    ],
)
def test_a_column_dt_that_contradicts_the_times_is_refused(row, value, message):
    logs = three_logs()
    logs["imu"]["dt"] = np.full(600, 0.01)
    logs["imu"]["dt"][100] = np.nan
    assert read_log(PROBLEM, logs).steps == 750
    logs["imu"]["dt"][row] = value
    with pytest.raises(LogError) as error:
        read_log(PROBLEM, logs)
    assert str(error.value).startswith(f"dt must {message}")
    assert str(error.value).endswith("can be left out: ignore='dt', or --ignore dt")
    assert read_log(PROBLEM, logs, ignore="dt").steps == 750


def test_dt_is_in_the_unit_of_the_problem():
    timed = replace(PROBLEM, inputs={"dt": "ms", "push": "m/s^2"})
    dt = read_log(timed, three_logs()).inputs[:, 0]
    assert dt.sum() == pytest.approx(5990.0)
    logs = three_logs()
    logs["imu"]["dt"] = np.full(600, 10.0)
    logs["imu"]["dt"][0] = 0.0
    np.testing.assert_array_equal(read_log(timed, logs).inputs[:, 0], dt)
    with pytest.raises(LogError, match=r"^the input dt must be in s, not in fortnights$"):
        read_log(replace(PROBLEM, inputs={"dt": "fortnights", "push": ""}), three_logs())


ROUNDED = {
    "in ms": lambda time: ("time [ms]", 1e3 * time),
    "in us": lambda time: ("time [us]", np.round(1e6 * time)),
    "in ns": lambda time: ("time [ns]", np.round(1e9 * time).astype(np.int64)),
    "to 6 decimals": lambda time: ("time", np.round(time, 6)),
    "to binary32": lambda time: ("time", time.astype(np.float32)),
    "added up": lambda time: ("time", np.append(0.0, np.cumsum(np.diff(time)))),
}


@pytest.mark.parametrize("interval", [0.01, 1.0 / 30.0, 1.0 / 128.0])
@pytest.mark.parametrize("way", ROUNDED)
def test_times_that_differ_by_rounding_are_one_step(way, interval):
    logs = three_logs(offset=0.0)
    for columns in logs.values():
        columns["time"] = columns["time"] * (interval / 0.01)
    problem = replace(
        PROBLEM, f=lambda x, w, u: f(x, w, np.array([interval, u[0]])), inputs={"push": "m/s^2"}
    )
    exact = read_log(problem, logs)
    assert exact.steps == 600
    for name in ("odometer", "imu", "level"):
        columns = logs[name]
        heading, times = ROUNDED[way](columns.pop("time"))
        columns[heading] = times
        found = read_log(problem, logs)
        assert found.steps == 600
        np.testing.assert_array_equal(found.inputs, exact.inputs)
        for sensor, z in found.measurements.items():
            np.testing.assert_array_equal(z, exact.measurements[sensor])
        if name == "odometer":
            np.testing.assert_array_equal(found.times, exact.times)


@pytest.mark.parametrize("offset", [1e-3, 2e-4, -2e-4])
def test_times_that_differ_by_more_are_steps_of_their_own(offset):
    logs = three_logs()
    logs["odometer"]["time"] = np.round(0.04 * np.arange(1, 150) + offset, 6)
    logs["odometer"]["v"] = np.ones(149)
    assert read_log(PROBLEM, logs).steps == 600 + 149
    # Not even if a time of the others could be rounded from it, to the decimals that they have.
    for columns in (logs["imu"], logs["gps"], logs["level"]):
        columns["time"] = np.round(columns["time"], 2)
    assert read_log(PROBLEM, logs).steps == 600 + 149
    # A log with rows that are near each other keeps them.
    logs["gps"] = {"time": [0.0, 1.0, 1.0 + 1e-7, 2.0], "x": np.zeros(4), "v": np.zeros(4)}
    assert read_log(PROBLEM, logs).steps == 600 + 149 + 1
    assert np.isfinite(read_log(PROBLEM, logs).measurements["gps"][:, 0]).sum() == 4


def test_logs_of_one_row_have_no_interval_to_compare_with():
    logs = {
        "gps": {"time": [1.0], "x": [1.0], "v": [1.0]},
        "odometer": {"time": [1.3], "v": [2]},
        "level": {"time": [1.3], "tilt": [0.0]},
        "controller": {"time": [0.9], "push": [1]},
    }
    assert read_log(PROBLEM, logs).times.tolist() == [0.9, 1.0, 1.3]


def test_start_leaves_out_what_is_before_but_knows_the_inputs():
    logs = three_logs()
    whole = read_log(PROBLEM, logs)
    assert whole.steps == 750
    late = read_log(PROBLEM, logs, start=2.0)
    np.testing.assert_array_equal(late.times, whole.times[whole.times >= 2.0])
    assert late.inputs[0].tolist() == [0.0, np.sin(2.0)]
    np.testing.assert_array_equal(late.inputs[1:], whole.inputs[-len(late.times) + 1 :])
    between = read_log(PROBLEM, logs, start=2.001)
    assert between.inputs[0] == pytest.approx([0.002, np.sin(2.0)])
    logs["imu"] = {name: column[100:] for name, column in logs["imu"].items()}
    with pytest.raises(LogError) as error:
        read_log(PROBLEM, logs)
    assert str(error.value) == (
        "push must be there from the first time on, 0.0 s, not only later in the columns imu, from "
        "1.0 s in row 0 on: start=1.0, or --start 1.0, leaves out what is before"
    )
    assert read_log(PROBLEM, logs, start=1.0).steps == 500 + 125


@pytest.mark.parametrize(
    ("start", "error", "message"),
    [
        (np.nan, LogError, "start must be a finite time in seconds, not nan"),
        (-np.inf, LogError, "start must be a finite time in seconds, not -inf"),
        ("0", TypeError, "start must be a number, not '0'"),
        (True, TypeError, "start must be a number, not True"),
    ],
)
def test_a_wrong_start_is_refused(start, error, message):
    with pytest.raises(error) as found:
        read_log(PROBLEM, three_logs(), start=start)
    assert str(found.value).startswith(message)


def test_inputs_that_end_long_before_the_rest_are_told():
    logs = three_logs()
    logs["imu"] = {name: column[:150] for name, column in logs["imu"].items()}
    with pytest.warns(LogWarning) as told:
        assert read_log(PROBLEM, logs).steps == 525
    assert str(told[0].message) == (
        "inputs should go on as long as the logs, to 5.98 s, and push of the columns imu ends at "
        "1.49 s and is held from there on: is its time, or that of another log, in another unit?"
    )
    assert told[0].filename == __file__
    # More than half is taken as it is; so is an input that is constant.
    logs = three_logs()
    logs["imu"] = {name: column[:310] for name, column in logs["imu"].items()}
    read_log(PROBLEM, logs)


def test_times_that_are_too_large_to_tell_the_intervals_are_refused():
    logs = three_logs()
    for columns in logs.values():
        columns["time"] = columns["time"] + 1.7e9
    assert read_log(PROBLEM, logs).steps == 750
    for columns in logs.values():
        columns["time"] = (columns["time"] - 1.7e9) * 1e-3 + 1.7e9
    with pytest.raises(LogError) as error:
        read_log(PROBLEM, logs)
    assert str(error.value) == (
        "times must be from a nearer origin: those of the columns imu are as large as 1700000000 s "
        "and rounded to 2.38e-07 s, where rows are 9.78e-06 s apart"
    )


def test_logs_that_do_not_overlap_are_told():
    logs = three_logs()
    logs["odometer"]["time"] = logs["odometer"]["time"] + 1.7e9
    with pytest.warns(LogWarning) as told:
        assert read_log(PROBLEM, logs).steps == 750
    assert str(told[0].message) == (
        "logs should overlap in time, and these do not: the columns imu from 0.0 to 5.99 s, the "
        "columns gps from 0.0 to 5.8 s, the columns level from 0.0 to 5.98 s, the columns odometer "
        "from 1700000000.003 to 1700000005.963 s; is one in another unit, or of another clock?"
    )
    assert told[0].filename == __file__
    # An input that is constant has one row; others meet through a log that goes on.
    logs = three_logs()
    logs["imu"] = {"time": [-1.0], "push": [0.5]}
    logs["gps"] = {name: column[:10] for name, column in logs["gps"].items()}
    logs["odometer"] = {name: column[100:] for name, column in logs["odometer"].items()}
    assert read_log(PROBLEM, logs).inputs[-1, 1] == 0.5


# What is read, and what is not.


def test_what_is_ignored_is_not_looked_into(tmp_path):
    import polars

    text = GOOD.replace("tilt\n", "tilt,status,place [deg]\n").replace("0.1\n", "0.1,fix,52° N\n")
    text = text.replace("3,\n", '3,,"lost\nagain",\n')
    file = tmp_path / "log.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(LogError, match=r"^status must be a number or empty, not 'fix' in row 2 of"):
        read_log(PROBLEM, file, ignore="place")
    good = tmp_path / "good.csv"
    good.write_text(GOOD, encoding="utf-8")
    for ignore in (["status", "place"], {"status", "place [deg]"}, ("place", "status")):
        assert same(read_log(PROBLEM, file, ignore=ignore), read_log(PROBLEM, good))
    nan = np.nan
    columns = {"time": [0.0, 0.1], "push": [0.1, 0.1], "gps.x": [1.0, nan], "gps.v": [2.0, nan],
               "odometer.v": [3, 3], "tilt": [0.1, nan],
               "status": ["fix", "lost"]}  # fmt: skip
    assert same(read_log(PROBLEM, columns, ignore="status"), read_log(PROBLEM, good))
    frame = polars.DataFrame(columns).with_columns(polars.lit([1.0, 2.0]).alias("more"))
    frame.write_parquet(tmp_path / "log.PARQUET")
    with pytest.raises(LogError, match=r"^status of log.PARQUET must be numbers, not String$"):
        read_log(PROBLEM, tmp_path / "log.PARQUET", ignore="more")
    read = read_log(PROBLEM, tmp_path / "log.PARQUET", ignore=["status", "more"])
    assert same(read, read_log(PROBLEM, good))
    frame.write_parquet(tmp_path / "log.csv")  # the content says what it is
    assert same(read_log(PROBLEM, tmp_path / "log.csv", ignore=["status", "more"]), read)
    with pytest.raises(
        LogError, match=r"^ignore must name columns of the logs, time, push, gps.x, .*, not 'none'$"
    ):
        read_log(PROBLEM, good, ignore=["none"])
    # Of one of several logs.
    logs = at_random(0)
    logs["gps"]["age"] = logs["level"]["age"] = ["old"]
    with pytest.raises(LogError, match=r"^age of the columns level must be a row of numbers, not "):
        read_log(PROBLEM, logs, ignore="gps.age")
    assert same(read_log(PROBLEM, logs, ignore="age"), read_log(PROBLEM, at_random(0)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (GOOD.encode("utf-16"), "must be text in UTF-8, or Parquet, not text in UTF-16"),
        (GOOD.encode("utf-16-le"), "must be text in UTF-8, or Parquet, and has the byte 0x00 in "),
        (GOOD.replace("tilt", "tilt [°]").encode("latin-1"),
         ("must be text in UTF-8, or Parquet, and has the byte 0xb0 in row 1: is it of another "
          "encoding?")),
        (GOOD.encode() + b"\xff",
         "must be text in UTF-8, or Parquet, and has the byte 0xff in row 4: "),
        (b"\x1f\x8b\x08", "must be text in UTF-8, or Parquet, not compressed by gzip"),
        (b"PAR1" + bytes(50) + b"PAR1", "must be a Parquet file, and cannot be read: "),
    ],
)  # fmt: skip
def test_files_that_are_neither_are_refused(tmp_path, content, message):
    file = tmp_path / "log.csv"
    file.write_bytes(content)
    with pytest.raises(LogError) as error:
        read_log(PROBLEM, file)
    assert str(error.value).startswith(f"log.csv {message}")
    assert len(str(error.value)) < 200


@pytest.mark.parametrize("content", [b"", b"time,push\n0,1\n", b"PAR1"])
def test_parquet_that_is_none_is_refused(tmp_path, content):
    file = tmp_path / "log.parquet"
    file.write_bytes(content)
    with pytest.raises(
        LogError, match=r"^log.parquet must be a Parquet file, and cannot be read: "
    ):
        read_log(PROBLEM, file)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("inf", "gps.v must be finite, or empty, not 'inf' in row 2 of log.csv"),
        ("1e400", "gps.v must be finite, or empty, not '1e400' in row 2 of log.csv"),
        ("1_000", "gps.v must be a number or empty, not '1_000' in row 2 of log.csv"),
        ("\u0661\u0662", "gps.v must be a number or empty, not '\u0661\u0662' in row 2 of log.csv"),
        ('"1', "gps.v must be a number or empty, not '1,3,0.1\\n"),
        ('"1' + 200_000 * "2", "row 2 of log.csv must be cells, and is not: field larger than"),
    ],
)
def test_cells_that_are_no_numbers_are_refused(tmp_path, cell, message):
    file = tmp_path / "log.csv"
    rows = "".join(f"{1.0 + k},0.1,1,2,3,0.1\n" for k in range(100))
    text = GOOD.replace("1,2,3", f"1,{cell},3") + rows
    if cell == '"1':
        text = text.replace('"1,3,0.1', '"1,3,0.1') + '",3,0.1\n'
    file.write_text(text, encoding="utf-8")
    with pytest.raises(LogError) as error:
        read_log(PROBLEM, file)
    assert str(error.value).startswith(message)
    assert len(str(error.value)) < 120


def test_arrays_must_be_finite(tmp_path):
    import polars

    logs = at_random(0)
    logs["level"]["tilt"][3] = -np.inf
    message = r"^tilt must be finite, or missing, not -inf in row 3 of "
    with pytest.raises(LogError, match=message + "the columns level$"):
        read_log(PROBLEM, logs)
    polars.DataFrame(logs["level"]).write_parquet(tmp_path / "level.parquet")
    with pytest.raises(LogError, match=message + r"level\.parquet$"):
        read_log(PROBLEM, logs | {"level": tmp_path / "level.parquet"})


def test_rows_are_numbered_as_in_the_file(tmp_path):
    file = tmp_path / "log.csv"
    head = "time,push,gps.x,gps.v,odometer.v,tilt\n0.0,0.1,1,2,3,0.1\n\n"
    file.write_text(head + '0.1,,,"3\n",3,\n0.2,,,x,3,\n', encoding="utf-8")
    with pytest.raises(LogError, match=r"^gps.v must be a number or empty, not 'x' in row 6 of"):
        read_log(PROBLEM, file)
    file.write_text(head + '0.1,,,"3\n",3,\n0.1,,,,3,\n', encoding="utf-8")
    with pytest.raises(LogError, match=r"^time must rise, not from 0.1 to 0.1 s in row 6 of log"):
        read_log(PROBLEM, file)


def test_files_of_one_name_are_told_apart(tmp_path):
    logs = at_random(0)
    for folder, name in (("first", "gps"), ("second", "level")):
        (tmp_path / folder).mkdir()
        write_csv(tmp_path / folder / "data.csv", logs[name])
        logs[name] = tmp_path / folder / "data.csv"
    assert same(read_log(PROBLEM, logs), read_log(PROBLEM, at_random(0)))
    logs["level"].write_text("time,tilt\n0,x\n", encoding="utf-8")
    with pytest.raises(LogError, match=r"in row 2 of .*second.data.csv$"):
        read_log(PROBLEM, logs)


# Names, units and kinds.

NAMELESS = Problem(
    name="two", f=lambda x, w, u: x + 0.0, Q=0.01 * np.eye(2), process_noise=Noise.ADDITIVE,
    observation_noise=Noise.ADDITIVE, x0=[0.0, 0.0], P0=np.eye(2),
    sensors=Sensor(lambda x, v: x, R=np.eye(2)),
)  # fmt: skip


@pytest.mark.parametrize("stem", ["z", "sensor.z"])
@pytest.mark.parametrize("unit", ["", " [m]"])
def test_observations_without_names_are_read(tmp_path, stem, unit):
    file = tmp_path / "log.csv"
    text = f"time [s],{stem}[0]{unit},{stem}[1]{unit},truth.x[0],truth.x[1]\n1,2,3,4,5\n2,,4,5,6\n"
    file.write_text(text, encoding="utf-8")
    data = read_log(NAMELESS, file)
    np.testing.assert_array_equal(data.measurements["sensor"], [[2, 3], [np.nan, 4]])
    np.testing.assert_array_equal(data.truth, [[4, 5], [5, 6]])
    several = replace(
        NAMELESS, sensors={"a": NAMELESS.sensor("sensor"), "b": Sensor(lambda x, v: x, R=np.eye(2))}
    )
    file.write_text("time,a.z[0],a.z[1],b[0],b[1]\n1,2,3,4,5\n", encoding="utf-8")
    np.testing.assert_array_equal(read_log(several, file).measurements["b"], [[4, 5]])


def test_names_may_have_brackets_of_their_own(tmp_path):
    names = {"p [m]": "", "p (left)": "Pa"}
    problem = replace(NAMELESS, sensors=Sensor(lambda x, v: x, R=np.eye(2), observations=names))
    columns = {"time": [1.0], "p [m]": [2.0], "p (left) [hPa]": [3.0]}
    np.testing.assert_array_equal(read_log(problem, columns).measurements["sensor"], [[2, 300]])


@pytest.mark.parametrize(
    "heading", ["time [us]", "time [\u00b5s]", "time [\u03bcs]", "time (\u03bcs)"]
)
def test_micro_may_be_written_in_three_ways(heading):
    data = read_log(NAMELESS, {heading: [1e6, 2e6], "z[0]": [1, 2], "z[1]": [1, 2]})
    assert data.times.tolist() == [1.0, 2.0]


def test_units_are_compared_however_they_are_written():
    for own, other in (("\u00b5T", "\u03bcT"), ("m/s\u00b2", "m/s^2"), ("uT", "\u00b5T")):
        sensor = Sensor(lambda x, v: x, R=np.eye(2), observations={"a": own, "b": own})
        columns = {"time": [1.0], f"a [{other}]": [2.0], "b": [3.0]}
        data = read_log(replace(NAMELESS, sensors=sensor), columns)
        np.testing.assert_array_equal(data.measurements["sensor"], [[2, 3]])


def test_angles_are_in_radians_also_without_a_unit_and_in_truth():
    angled = replace(
        NAMELESS, state_angles=[1], sensors=Sensor(lambda x, v: x, R=np.eye(2), angles=[0])
    )
    columns = {"time": [1.0], "z[0] [deg]": [180.0], "z[1]": [90.0]}
    data = read_log(angled, columns)
    np.testing.assert_allclose(data.measurements["sensor"], [[np.pi, 90.0]])
    truth = {"truth.x[0]": [90.0], "truth.x[1]": [90.0]}
    with pytest.raises(LogError, match=r"^truth.x\[1\] must be in radians, not 90.0 in row 0 of "):
        read_log(angled, columns | truth)
    data = read_log(angled, columns | {"truth.x[0]": [90.0], "truth.x[1] [deg]": [90.0]})
    np.testing.assert_allclose(data.truth, [[90.0, np.pi / 2]])


def test_names_that_clash_are_refused():
    truth = Sensor(lambda x, v: x[:1] + v, R=[[1.0]], observations=["a"])
    named = {"states": ["a", "b"], "sensors": {"truth": truth}}
    with pytest.raises(LogError) as error:
        read_log(replace(NAMELESS, **named), {"time": [1.0], "truth.a": [1.0]})
    assert str(error.value) == (
        "truth.a must be one thing in a log, and is an observation of truth and a true state: give "
        "one of them another name in the problem"
    )
    with pytest.raises(
        LogError, match=r"^time must be one thing in a log, and is the time and an i"
    ):
        read_log(replace(NAMELESS, inputs=["time"]), {"time": [1.0]})
    named["states"] = ["c", "d"]
    data = read_log(replace(NAMELESS, **named), {"time": [1.0], "truth.a": [1.0]})
    assert data.measurements["truth"].tolist() == [[1.0]]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (3, "data must be a CSV or Parquet file, or columns by name, one of them time, as "),
        ({"gps": 3}, "data of gps must be a CSV or Parquet file, or columns by name, one of them "),
        ({"t": np.ones(3)}, "data of t must be .*, not of the class ndarray$"),
        ({3: "gps.csv"}, "data must have names of columns or logs, not 3$"),
        ({"time": [1.0], 0: [1.0]}, "data must have names of columns or logs, not 0$"),
        (
            {"gps": {"time": [1.0], 0: [1.0]}},
            "the columns gps must have names that are text, not 0",
        ),
    ],
)
def test_other_kinds_are_refused(source, message):
    with pytest.raises(TypeError, match="^" + message):
        read_log(PROBLEM, source)


def test_frames_are_refused():
    import polars

    frame = polars.DataFrame({"time": [1.0], "x": [1.0]})
    for source, message in ((frame, "data must "), ({"gps": frame}, "data of gps must ")):
        with pytest.raises(TypeError, match=f"^{message}be a CSV .* not of the class DataFrame$"):
            read_log(PROBLEM, source)


def test_columns_of_rows_are_refused():
    logs = at_random(0)
    logs["gps"]["x"] = [[1.0], [1.0, 2.0]]
    with pytest.raises(
        LogError, match=r"^x of the columns gps must be a row of numbers, not \[\[1"
    ):
        read_log(PROBLEM, logs)


def test_files_by_name_take_what_read_log_does(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text(GOOD, encoding="utf-8")
    files = LogFiles.of([str(file)], start=0.05)
    assert files.read(PROBLEM).times.tolist() == [0.1]
    assert LogFiles.of([str(file)], ignore="status").ignore == ("status",)


@pytest.mark.parametrize("seed", range(20))
def test_no_row_is_lost_or_moved_when_logs_are_merged(seed):
    """Steps rise, rows of a log are apart, equal times together."""
    rng = np.random.default_rng(seed)
    bases = np.array([0.0, 1.0, 2.0, 0.001, 0.5, 1e-6, 1.9999, 2.00001])
    for _ in range(50):
        logs = {}
        for number in range(rng.integers(2, 5)):
            rows = rng.integers(1, 8)
            times = rng.choice(bases, rows) + rng.choice([0.0, 1e-9, 1e-5, 1e-3, 5e-3], rows)
            times = np.unique(np.round(times, rng.integers(1, 7)))
            logs[f"log{number}"] = {"time": times}
        tables = read_tables(logs, (), {"time"})
        steps = merge(tables, None)
        assert (np.diff(steps.times) > 0.0).all()
        assert set(np.concatenate(steps.places)) == set(range(len(steps.times)))
        intervals = [np.diff(table.times).min() for table in tables if len(table.times) > 1]
        step_of = {}
        for table, places in zip(tables, steps.places, strict=True):
            assert (np.diff(places) > 0).all()
            moved = np.abs(steps.times[places] - table.times)
            assert (moved <= 0.0100001 * min(intervals, default=1e-9)).all()
            for time, place in zip(table.times, places, strict=True):
                assert step_of.setdefault(time, place) == place
