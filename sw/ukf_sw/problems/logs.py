"""Recorded data: logs of sensors, as files or arrays, merged into steps in the order of time.

::

    data = read_log(problem, "flight.csv")
    data = read_log(problem, {"gps": "gps.csv", "baro": "baro.parquet", "imu": imu_columns})
    found = run(replace(problem, data=data), "golden")

A log has a column ``time`` and columns that are called like the observations of the sensors, the
inputs, or ``truth.`` and a state; where a name is not enough, ``gps.x``. A unit in brackets, as in
``heading [deg]``, is compared with that of the problem, and converted if it is known how. All other
columns have to be named as ignored, so that no sensor is left out by a slip of the pen.

Every time in any of the logs is a step: a predict to that time, with the newest inputs by then, and
an update with each sensor that has a sample at it. Gaps, empty cells and NaN were not sampled.
Times of several logs that differ only by rounding are of one step: by no more than half of the last
decimal place that the times of each log have (or of the spacing of binary32, if they are such
numbers), or by 1e-6 of the shortest interval between two rows of any log, but never if by more than
0.01 of that interval. Two rows of one log are always two steps.

If the problem has an input ``dt``, it is the time since the step before, always. A column ``dt`` is
compared with the times of its own log, and used for the first step only: where nothing else says
when the first estimate was.
"""

import math
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Data, Problem
from ukf_sw.problems.log_tables import TIME, LogError, Source, Table, factor, read_tables
from ukf_sw.problems.log_times import LogWarning, Steps, check_equidistant, check_overlap, merge
from ukf_sw.spec.fields import as_number

__all__ = ["LogError", "LogFiles", "LogWarning", "read_log"]

Array = NDArray[np.float64]

DT, TRUTH = "dt", "truth"

#: Part of an interval that a dt may differ by: clocks are read. What is meant otherwise, as another
#: unit, a nominal rate or a row that is missing, differs by more.
_DT_DIFFERS = 0.05

#: Part of an interval that times which are rounded may excuse in a dt.
_DT_ROUNDED = 0.25


class _Meaning(NamedTuple):
    """What a column is: its unit in the problem, and whether it is an angle, in radians."""

    unit: str
    is_angle: bool = False


#: Number of a log, and name of a column of it.
_Place = tuple[int, str]


@dataclass(frozen=True, kw_only=True)
class LogFiles:
    """Files to :func:`read_log`.

    Parameters
    ----------
    files
        Names and files; a single one needs no name, "".
    ignore, start
        As of that.
    """

    files: tuple[tuple[str, Path], ...]
    ignore: tuple[str, ...] = ()
    start: float | None = None

    @classmethod
    def of(
        cls, texts: Iterable[str], ignore: Iterable[str] | str = (), start: float | None = None
    ) -> "LogFiles":
        """Make them of texts such as ``flight.csv``, or ``gps=gps.csv`` for each of several.

        Raises
        ------
        LogError
            If there are several, and one has no name or that of another.
        """
        files: dict[str, Path] = {}
        for text in texts:
            name, found, path = text.partition("=")
            label = name if found else ""
            if label in files and not label:
                raise LogError(
                    f"data must have a name for each file, as gps=gps.csv, not only {files['']} "
                    f"and {path or text}"
                )
            if label in files:
                raise LogError(f"data must have one file named {label!r}, not several")
            files[label] = Path(path if found else text).absolute()
        if "" in files and len(files) > 1:
            raise LogError(
                f"data must have a name for each file, as gps=gps.csv, not only {files['']}"
            )
        names = (ignore,) if isinstance(ignore, str) else tuple(ignore)
        return cls(files=tuple(files.items()), ignore=names, start=start)

    def read(self, problem: Problem) -> Data:
        """Read them for a problem; raises as :func:`read_log`."""
        files = dict(self.files)
        return read_log(problem, files.get("", files), ignore=self.ignore, start=self.start)


def read_log(
    problem: Problem,
    source: Source | Mapping[str, Source],
    *,
    ignore: Iterable[str] | str = (),
    start: float | None = None,
) -> Data:
    """Read recorded data for a problem.

    Parameters
    ----------
    problem
        Whose sensors, inputs and states the columns are of.
    source
        A CSV or Parquet file; or columns by name, as arrays; or several of these by name, each with
        times of its own. In one that is called like a sensor, its columns need no prefix.
    ignore
        Columns to leave out: a name, or several. They may have anything in them.
    start
        Time that the first estimate belongs to, in seconds: the first dt begins there, and rows
        before it are no steps; the newest inputs among them are known. None is the first time in
        the logs, or a dt before it if there is one.

    Returns
    -------
    Data
        Without truth, unless there is a column for each state.

    Raises
    ------
    LogError
        If a log does not fit.
    TypeError
        If something is of the wrong kind.
    OSError
        If a file cannot be read.
    MissingExtraError
        If it is a Parquet file, and the extra ``sweep`` is not installed.

    Warns
    -----
    LogWarning
        If logs do not overlap in time, or inputs end before half of it.
    """
    if start is not None:
        start = as_number("start", start)
        if not np.isfinite(start):
            raise LogError(f"start must be a finite time in seconds, not {start!r}")
    meanings = _meanings(problem)
    known = {TIME, *meanings, *(key.partition(".")[2] for key in _all_observations(problem))}
    left_out = [ignore] if isinstance(ignore, str) else ignore
    tables = read_tables(source, left_out, known)
    places, clocks = _find_columns(problem, meanings, tables)
    tables = _scaled(meanings, tables, places)
    check_overlap(tables)
    steps = merge(tables, start)
    since = _since(problem, steps, clocks, start)
    if DT not in problem.inputs:
        check_equidistant(steps, DT)
    truth = [key for key in _truth(problem) if key in places]
    return Data(
        times=steps.times,
        measurements={
            sensor: np.column_stack([steps.column(*places[key]) for key in keys])
            for sensor, keys in _observations(problem).items()
        },
        inputs=_inputs(problem, steps, since, places),
        truth=np.column_stack([steps.column(*places[key]) for key in truth]) if truth else None,
    )


# What the columns are.


def _observations(problem: Problem) -> dict[str, list[str]]:
    """Keys of the observations of each sensor."""
    return {
        sensor: [f"{sensor}.{name}" for name in problem.sensor(sensor).observations]
        for sensor in problem.sensor_names
    }


def _all_observations(problem: Problem) -> list[str]:
    """Keys of the observations of all sensors."""
    return [key for keys in _observations(problem).values() for key in keys]


def _truth(problem: Problem) -> list[str]:
    """Keys of the true states."""
    return [f"{TRUTH}.{name}" for name in problem.states or _numbered(problem)]


def _numbered(problem: Problem) -> list[str]:
    """Names of states that were given none."""
    return [f"x[{i}]" for i in range(len(problem.x0))]


def _meanings(problem: Problem) -> dict[str, _Meaning]:
    """What a log may have: observations, inputs and true states, by key."""
    found: list[tuple[str, _Meaning, str]] = []
    for sensor, keys in _observations(problem).items():
        observed = problem.sensor(sensor)
        units = cast("Mapping[str, str]", observed.observations).values()
        found += [
            (key, _Meaning(unit, row in observed.angles), f"an observation of {sensor}")
            for row, (key, unit) in enumerate(zip(keys, units, strict=True))
        ]
    inputs = cast("Mapping[str, str]", problem.inputs)
    found += [(name, _Meaning(unit), "an input") for name, unit in inputs.items()]
    states = cast("Mapping[str, str]", problem.states)
    units = list(states.values()) or [""] * len(problem.x0)
    found += [
        (key, _Meaning(unit, row in problem.state_angles), "a true state")
        for row, (key, unit) in enumerate(zip(_truth(problem), units, strict=True))
    ]
    kinds = {TIME: "the time"}
    for key, _, kind in found:
        if key in kinds:
            raise LogError(
                f"{key} must be one thing in a log, and is {kinds[key]} and {kind}: give one of "
                "them another name in the problem"
            )
        kinds[key] = kind
    return {key: meaning for key, meaning, _ in found}


def _key_of(problem: Problem, known: Mapping[str, _Meaning], table: Table, column: str) -> str:
    """What a column of a log is."""
    if f"{table.label}.{column}" in known:
        return f"{table.label}.{column}"
    if column in known:
        return column
    own = [key for key in _all_observations(problem) if key.partition(".")[2] == column]
    if len(own) > 1:
        raise LogError(f"{column} of {table.name} must say whose it is, as {' or '.join(own)}")
    if not own:
        also = ", or give the problem inputs={'dt': 's'} if f takes it" if column == DT else ""
        raise LogError(
            f"columns must be of {', '.join([TIME, *known])}, not {table.headings[column]!r} of "
            f"{table.name}: name it in ignore if it is to be left out{also}"
        )
    return own[0]


def _find_columns(
    problem: Problem, known: Mapping[str, _Meaning], tables: list[Table]
) -> tuple[dict[str, _Place], list[_Place]]:
    """Where each of the keys is, and columns dt; and a check that all that is needed is there."""
    places: dict[str, _Place] = {}
    clocks: list[_Place] = []
    for number, table in enumerate(tables):
        for column in table.columns:
            if column == TIME:
                continue
            key = _key_of(problem, known, table, column)
            if key == DT:
                clocks.append((number, column))
                continue
            if key in places:
                raise LogError(
                    f"{key} must be in one log, not in {tables[places[key][0]].name} and "
                    f"{table.name}"
                )
            places[key] = number, column
    needed = _all_observations(problem)
    needed += [name for name in problem.inputs if name != DT]
    truth = _truth(problem)
    if any(key in places for key in truth):
        needed += truth
    missing = [key for key in needed if key not in places]
    if missing:
        names = ", ".join(table.name for table in tables)
        raise LogError(f"{', '.join(missing)} must be a column of {names}, and is not")
    return places, clocks


def _scaled(
    known: Mapping[str, _Meaning], tables: list[Table], places: Mapping[str, _Place]
) -> list[Table]:
    """The same logs in the units of the problem."""
    columns = [dict(table.columns) for table in tables]
    for key, (number, column) in places.items():
        table, meaning = tables[number], known[key]
        unit = table.units[column]
        wanted = meaning.unit or ("rad" if meaning.is_angle else "")
        scale = factor(unit, wanted, f"{column} of {table.name}")
        columns[number][column] = table.columns[column] * scale
        if meaning.is_angle and not unit:
            _check_radians(table, column)
    return [replace(table, columns=own) for table, own in zip(tables, columns, strict=True)]


def _check_radians(table: Table, column: str) -> None:
    """Look for angles that are in degrees; those beyond a turn have to say that they are not."""
    beyond = np.flatnonzero(np.abs(table.columns[column]) > 2.0 * math.pi)
    if len(beyond):
        row = int(beyond[0])
        raise LogError(
            f"{column} must be in radians, not {float(table.columns[column][row])!r} in "
            f"{table.row(row)}, which looks like degrees: call it '{column} [deg]' if it is, and "
            f"'{column} [rad]' if it goes on beyond a turn"
        )


# What is held or follows from the times.


def _since(problem: Problem, steps: Steps, clocks: list[_Place], start: float | None) -> Array:
    """Time of each step since the one before, shape (K,), in seconds; columns dt are compared.

    The first is that since `start`; without one, what a column dt has for it.
    """
    since = np.diff(steps.times, prepend=steps.times[0])
    if start is not None:
        since[0] = max(float(steps.times[0]) - start, 0.0)
    given = cast("Mapping[str, str]", problem.inputs).get(DT, "")
    for number, column in clocks:
        table = steps.tables[number]
        unit = table.units[column] or given
        dt = table.columns[column] * factor(unit, "s", f"{column} of {table.name}")
        _check_dt(table, dt)
        if start is None and steps.places[number][0] == 0 and np.isfinite(dt[0]):
            since[0] = dt[0]
    return since


def _check_dt(table: Table, dt: Array) -> None:
    """Compare a column dt, in seconds, with the time since the row before.

    What was before the first row is not known, so its dt may be anything from 0 to the longest time
    between rows.
    """
    between = np.diff(table.times)
    allowed = np.maximum(_DT_DIFFERS * between, np.minimum(table.resolution, _DT_ROUNDED * between))
    wrong = np.flatnonzero(np.abs(dt[1:] - between) > allowed) + 1
    longest = float(between.max()) * (1.0 + _DT_DIFFERS) if len(between) else np.inf
    if dt[0] < 0.0 or dt[0] > longest:
        row, rule = 0, f"between 0 and {longest:.6g} s, as there is between rows"
    elif len(wrong):
        row = int(wrong[0])
        rule = f"the time since the row before, {float(between[row - 1]):.6g} s"
    else:
        return
    raise LogError(
        f"{DT} must be {rule}, not {float(dt[row]):.6g} s in {table.row(row)}; it follows from the "
        f"times, so the column can be left out: ignore='{DT}', or --ignore {DT}"
    )


def _inputs(
    problem: Problem, steps: Steps, since: Array, places: Mapping[str, _Place]
) -> Array | None:
    """Newest inputs by each step, shape (K, inputs); None if the problem names none."""
    if not problem.inputs:
        return None
    count = len(steps.times)
    inputs = np.empty((count, len(problem.inputs)))
    begin, end = float(steps.times[0]), float(steps.times[-1])
    late: list[tuple[str, Table, int]] = []
    for k, (name, unit) in enumerate(cast("Mapping[str, str]", problem.inputs).items()):
        if name == DT:
            inputs[:, k] = since / factor(unit, "s", f"the input {DT}")
            continue
        number, column = places[name]
        table = steps.tables[number]
        there = np.flatnonzero(np.isfinite(table.columns[column]))
        if not len(there):
            raise LogError(f"{name} must be a number in a row of {table.name}, and is in none")
        last = float(table.times[there[-1]])
        if len(there) > 1 and end - last > last - begin:
            warnings.warn(
                f"inputs should go on as long as the logs, to {end!r} s, and {name} of "
                f"{table.name} ends at {last!r} s and is held from there on: is its time, or that "
                "of another log, in another unit?",
                LogWarning,
                stacklevel=3,
            )
        newest = np.searchsorted(steps.places[number][there], np.arange(count), side="right") - 1
        if newest[0] < 0:
            late.append((name, table, int(there[0])))
        inputs[:, k] = table.columns[column][there][newest]
    if late:
        name, table, row = late[0]
        begin = max(float(table.times[row]) for _, table, row in late)
        raise LogError(
            f"{name} must be there from the first time on, {float(steps.times[0])!r} s, not only "
            f"later in {table.name}, from {float(table.times[row])!r} s in row {table.rows[row]} "
            f"on: start={begin!r}, or --start {begin!r}, leaves out what is before"
        )
    return inputs
