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
an update with each sensor that has a sample at it. Gaps, empty cells and NaN were not sampled. If
the problem has an input ``dt``, it is the time since the step before.
"""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.extras import importing
from ukf_sw.problem import Data, Problem

__all__ = ["LogError", "LogFiles", "read_log"]

Array = NDArray[np.float64]
Columns = Mapping[str, ArrayLike]
Source = str | PathLike[str] | Columns

TIME, DT, TRUTH = "time", "dt", "truth"

#: Factors from a unit of a log to one of a problem.
_DEGREE = math.pi / 180.0
_FACTORS = {
    ("deg", "rad"): _DEGREE, ("degrees", "rad"): _DEGREE, ("°", "rad"): _DEGREE,
    ("deg/s", "rad/s"): _DEGREE, ("degrees/s", "rad/s"): _DEGREE, ("°/s", "rad/s"): _DEGREE,
    ("ms", "s"): 1e-3, ("us", "s"): 1e-6, ("ns", "s"): 1e-9,
    ("mm", "m"): 1e-3, ("cm", "m"): 1e-2, ("km", "m"): 1e3, ("km/h", "m/s"): 1.0 / 3.6,
    ("hPa", "Pa"): 1e2, ("mbar", "Pa"): 1e2, ("mV", "V"): 1e-3, ("mA", "A"): 1e-3,
}  # fmt: skip

#: Intervals of a problem without an input dt may differ by this part: clocks are read, too.
_JITTER = 0.01


class LogError(ValueError):
    """A log that does not fit; the message names it, and row and column where there are any."""


@dataclass(frozen=True, kw_only=True)
class _Table:
    """A log: columns of equal length, with a name and numbers of rows for messages.

    Parameters
    ----------
    label
        What it was called among several, or "".
    name
        File or label.
    columns, units
        Numbers, and units that were given, by name.
    first_row
        Number of the first row of data: of a file the line behind the header.
    """

    label: str
    name: str
    columns: dict[str, Array]
    units: dict[str, str]
    first_row: int

    def row(self, index: int) -> str:
        """Name a row of data."""
        return f"row {self.first_row + index} of {self.name}"


@dataclass(frozen=True, kw_only=True)
class LogFiles:
    """Files to :func:`read_log`.

    Parameters
    ----------
    files
        Names and files; a single one needs no name, "".
    ignore
        Columns to leave out.
    """

    files: tuple[tuple[str, Path], ...]
    ignore: tuple[str, ...] = ()

    @classmethod
    def of(cls, texts: Iterable[str], ignore: Iterable[str] = ()) -> "LogFiles":
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
            if label in files:
                raise LogError(f"data must have one file named {label!r}, not several")
            files[label] = Path(path if found else text).absolute()
        if "" in files and len(files) > 1:
            raise LogError(
                f"data must have a name for each file, as gps=gps.csv, not only {files['']}"
            )
        return cls(files=tuple(files.items()), ignore=tuple(ignore))

    def read(self, problem: Problem) -> Data:
        """Read them for a problem; raises as :func:`read_log`."""
        files = dict(self.files)
        return read_log(problem, files.get("", files), ignore=self.ignore)


def read_log(
    problem: Problem,
    source: Source | Mapping[str, Source],
    *,
    ignore: Iterable[str] = (),
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
        Columns to leave out.
    start
        Time that the first estimate belongs to, in seconds: the first dt begins there. None is the
        first time in the log.

    Returns
    -------
    Data
        Without truth, unless there is a column for each state.

    Raises
    ------
    LogError
        If a log does not fit.
    OSError
        If a file cannot be read.
    MissingExtraError
        If it is a Parquet file, and the extra ``sweep`` is not installed.
    """
    tables = [_scaled(problem, table) for table in _tables(source, ignore)]
    places = _find_columns(problem, tables)
    times, first_rows = _merged_times(tables)
    if start is not None and start > times[0]:
        first = float(times[0])
        raise LogError(f"start must be at most {first!r} s, the first time, not {start!r}")

    def column(key: str) -> Array:
        """A column at the times of the steps, NaN where its log has no row."""
        table, name = places[key]
        whole = np.full(len(times), np.nan)
        whole[np.searchsorted(times, table.columns[TIME])] = table.columns[name]
        return whole

    measurements = {
        sensor: np.column_stack([column(key) for key in keys])
        for sensor, keys in _observations(problem).items()
    }
    intervals = np.diff(times, prepend=times[0] if start is None else start)
    if DT not in problem.inputs:
        _check_equidistant(intervals[1:], first_rows)
    truth = [key for key in (f"{TRUTH}.{state}" for state in problem.states) if key in places]
    return Data(
        times=times,
        measurements=measurements,
        inputs=_inputs(problem, times, intervals, places),
        truth=np.column_stack([column(key) for key in truth]) if truth else None,
    )


# Reading.


def _tables(source: Source | Mapping[str, Source], ignore: Iterable[str]) -> Iterator[_Table]:
    """Read all logs."""
    left_out = set(ignore)
    if isinstance(source, Mapping) and not any(_split(str(name))[0] == TIME for name in source):
        logs = {str(label): cast("Source", each) for label, each in source.items()}
    else:
        logs = {"": cast("Source", source)}
    if not logs:
        raise LogError("data must be a file, columns or several of these, not nothing")
    for label, each in logs.items():
        yield _table(label, each, left_out)


def _split(heading: str) -> tuple[str, str]:
    """Name and unit of a heading such as ``heading [deg]``."""
    found = re.fullmatch(r"\s*(.*?)\s*(?:\[(.*?)\]|\((.*?)\))?\s*", heading)
    assert found is not None
    return found[1], (found[2] or found[3] or "").strip()


def _table(label: str, source: Source, ignore: set[str]) -> _Table:
    """Read a log and check its times."""
    if isinstance(source, Mapping):
        name, first_row = f"the columns {label}" if label else "the columns", 0
        raw = _from_arrays(source, name)
    else:
        path = Path(source)
        name, first_row = path.name, 2
        raw = _from_parquet(path) if path.suffix == ".parquet" else _from_csv(path)
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    for heading, numbers in raw.items():
        own, unit = _split(heading)
        if own in ignore or heading in ignore:
            continue
        if own in columns:
            raise LogError(f"{name} must have one column {own}, not several")
        columns[own], units[own] = numbers, unit
    if TIME not in columns:
        raise LogError(f"{name} must have a column {TIME}, not only {', '.join(columns)}")
    if units[TIME] not in ("", "s"):
        columns[TIME] = columns[TIME] * _factor(units[TIME], "s", f"{TIME} of {name}")
    table = _Table(label=label, name=name, columns=columns, units=units, first_row=first_row)
    times = columns[TIME]
    if not len(times):
        raise LogError(f"{name} must have a row, not none")
    if not np.isfinite(times).all():
        row = int(np.flatnonzero(~np.isfinite(times))[0])
        raise LogError(f"{TIME} must be a number, not {float(times[row])!r} in {table.row(row)}")
    falls = np.flatnonzero(np.diff(times) <= 0.0)
    if len(falls):
        row = int(falls[0]) + 1
        raise LogError(
            f"{TIME} must rise, not from {float(times[row - 1])!r} to {float(times[row])!r} s in "
            f"{table.row(row)}"
        )
    return table


def _from_arrays(source: Columns, name: str) -> dict[str, Array]:
    """Columns that are given as arrays; what is masked in one is missing."""
    found: dict[str, Array] = {}
    for heading, values in source.items():
        array = np.ma.asarray(cast("Any", values))
        if array.dtype.kind not in "fiub" or array.ndim != 1:
            raise LogError(f"{heading} of {name} must be a row of numbers, not {values!r}")
        found[heading] = np.ma.filled(array.astype(np.float64), np.nan)
    lengths = {heading: len(array) for heading, array in found.items()}
    if len(set(lengths.values())) > 1:
        raise LogError(f"{name} must have one length, not {lengths!r}")
    return found


def _from_csv(path: Path) -> dict[str, Array]:
    """Columns of a text file with a line of headings; comma, semicolon or tab between."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        first = file.readline()
        separator = max(",;\t", key=first.count)
        headings = [
            heading.strip() for row in csv.reader([first], delimiter=separator) for heading in row
        ]
        if not any(headings):
            raise LogError(f"{path.name} must begin with a line of headings, not {first!r}")
        rows: list[list[float]] = []
        for number, cells in enumerate(csv.reader(file, delimiter=separator), start=2):
            if not cells:
                continue
            if len(cells) != len(headings):
                raise LogError(
                    f"row {number} of {path.name} must have {len(headings)} cells, not {len(cells)}"
                )
            rows.append([
                _number(cell, heading, number, path)
                for cell, heading in zip(cells, headings, strict=True)
            ])  # fmt: skip
    if len(set(headings)) < len(headings):
        raise LogError(f"{path.name} must have different headings, not {', '.join(headings)}")
    numbers = np.array(rows, dtype=np.float64).reshape(-1, len(headings))
    return {heading: numbers[:, k] for k, heading in enumerate(headings)}


def _number(cell: str, heading: str, row: int, path: Path) -> float:
    """Read a cell; an empty one is missing."""
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise LogError(
            f"{heading} must be a number or empty, not {cell!r} in row {row} of {path.name}"
        ) from None


def _from_parquet(path: Path) -> dict[str, Array]:
    """Columns of a Parquet file."""
    with importing("sweep"):
        import polars
    frame = polars.read_parquet(path)
    found: dict[str, Array] = {}
    for heading in frame.columns:
        series = frame[heading]
        if not series.dtype.is_numeric():
            raise LogError(f"{heading} of {path.name} must be numbers, not {series.dtype}")
        found[heading] = series.cast(polars.Float64).fill_null(math.nan).to_numpy()
    return found


# What the columns are.


def _observations(problem: Problem) -> dict[str, list[str]]:
    """Keys of the observations of each sensor."""
    return {
        sensor: [f"{sensor}.{name}" for name in problem.sensor(sensor).observations]
        for sensor in problem.sensor_names
    }


def _keys(problem: Problem) -> dict[str, str]:
    """What a log may have, with units: observations, inputs and true states."""
    keys: dict[str, str] = {}
    for sensor in problem.sensor_names:
        units = cast("Mapping[str, str]", problem.sensor(sensor).observations)
        keys |= {f"{sensor}.{name}": unit for name, unit in units.items()}
    keys |= cast("Mapping[str, str]", problem.inputs)
    states = cast("Mapping[str, str]", problem.states)
    return keys | {f"{TRUTH}.{name}": unit for name, unit in states.items()}


def _key_of(problem: Problem, table: _Table, column: str) -> str | None:
    """What a column of a log is; None if that is not known."""
    keys = _keys(problem)
    if table.label in problem.sensor_names and f"{table.label}.{column}" in keys:
        return f"{table.label}.{column}"
    if column in keys:
        return column
    own = [
        f"{sensor}.{column}" for sensor in problem.sensor_names
        if column in problem.sensor(sensor).observations
    ]  # fmt: skip
    if len(own) > 1:
        raise LogError(f"{column} of {table.name} must say whose it is, as {' or '.join(own)}")
    return own[0] if own else None


def _find_columns(problem: Problem, tables: list[_Table]) -> dict[str, tuple[_Table, str]]:
    """Where each of the keys is, and a check that all that is needed is there, once."""
    places: dict[str, tuple[_Table, str]] = {}
    for table in tables:
        for column in table.columns:
            key = TIME if column == TIME else _key_of(problem, table, column)
            if key is None:
                known = ", ".join([TIME, *_keys(problem)])
                raise LogError(
                    f"columns must be of {known}, not {column!r} of {table.name}: name it in "
                    "ignore if it is to be left out"
                )
            if key in places and key != TIME:
                raise LogError(
                    f"{key} must be in one log, not in {places[key][0].name} and {table.name}"
                )
            places[key] = table, column
    needed = [key for keys in _observations(problem).values() for key in keys]
    needed += [name for name in problem.inputs if name != DT]
    truth = [f"{TRUTH}.{state}" for state in problem.states]
    if any(key in places for key in truth):
        needed += truth
    missing = [key for key in needed if key not in places]
    if missing:
        names = ", ".join(table.name for table in tables)
        raise LogError(f"{', '.join(missing)} must be a column of {names}, and is not")
    return places


def _factor(unit: str, wanted: str, what: str) -> float:
    """Factor from a unit to another."""
    if unit == wanted or not unit or not wanted:
        return 1.0
    if (unit, wanted) not in _FACTORS:
        raise LogError(f"{what} must be in {wanted}, not in {unit}")
    return _FACTORS[unit, wanted]


def _scaled(problem: Problem, table: _Table) -> _Table:
    """The same log in the units of the problem."""
    units = _keys(problem)
    columns = dict(table.columns)
    for column in columns:
        key = None if column == TIME else _key_of(problem, table, column)
        if key is None:
            continue
        what = f"{column} of {table.name}"
        columns[column] = columns[column] * _factor(table.units[column], units[key], what)
        if _is_angle(problem, key) and not table.units[column]:
            _check_radians(table, column)
    return _Table(
        label=table.label, name=table.name, columns=columns, units=table.units,
        first_row=table.first_row,
    )  # fmt: skip


def _is_angle(problem: Problem, key: str) -> bool:
    """Whether it is an observation that is an angle."""
    sensor, _, name = key.partition(".")
    if sensor not in problem.sensor_names:
        return False
    observed = problem.sensor(sensor)
    return list(observed.observations).index(name) in observed.angles


def _check_radians(table: _Table, column: str) -> None:
    """Look for angles that are in degrees; those beyond a turn have to say that they are not."""
    beyond = np.flatnonzero(np.abs(table.columns[column]) > 2.0 * math.pi)
    if len(beyond):
        row = int(beyond[0])
        raise LogError(
            f"{column} must be in radians, not {float(table.columns[column][row])!r} in "
            f"{table.row(row)}, which looks like degrees: call it '{column} [deg]' if it is, and "
            f"'{column} [rad]' if it goes on beyond a turn"
        )


# Steps.


def _merged_times(tables: list[_Table]) -> tuple[Array, list[tuple[float, str]]]:
    """All times, rising, and for each the row that has it."""
    rows: dict[float, str] = {}
    for table in tables:
        for index, time in enumerate(table.columns[TIME].tolist()):
            rows.setdefault(time, table.row(index))
    ordered = sorted(rows.items())
    return np.array([time for time, _ in ordered]), ordered


def _check_equidistant(intervals: Array, rows: list[tuple[float, str]]) -> None:
    """Check the intervals of a problem whose f is not told them."""
    if not len(intervals):
        return
    usual = float(np.median(intervals))
    off = np.flatnonzero(np.abs(intervals - usual) > _JITTER * usual)
    if len(off):
        index = int(off[0])
        raise LogError(
            f"steps must be {usual:.6g} s apart, as most are, since f has no input {DT}, not "
            f"{float(intervals[index]):.6g} s before {rows[index + 1][1]}"
        )


def _inputs(
    problem: Problem, times: Array, intervals: Array, places: Mapping[str, tuple[_Table, str]]
) -> Array | None:
    """Newest inputs by each step, shape (K, inputs); None if the problem names none."""
    if not problem.inputs:
        return None
    inputs = np.empty((len(times), len(problem.inputs)))
    for k, name in enumerate(problem.inputs):
        if name == DT and DT not in places:
            inputs[:, k] = intervals
            continue
        table, column = places[name]
        there = np.isfinite(table.columns[column])
        known, values = table.columns[TIME][there], table.columns[column][there]
        newest = np.searchsorted(known, times, side="right") - 1
        if not len(known) or newest[0] < 0:
            raise LogError(
                f"{name} must be there from the first time on, {float(times[0])!r} s, not only "
                f"later in {table.name}"
            )
        inputs[:, k] = values[newest]
    return inputs
