"""Logs as tables: CSV, Parquet and arrays, read and checked each by itself.

What the columns are is not known here, but for ``time``; see :mod:`ukf_sw.problems.logs`.
"""

import csv
import io
import math
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.extras import importing

__all__ = ["TIME", "Columns", "LogError", "Source", "Table", "factor", "read_tables"]

Array = NDArray[np.float64]
Columns = Mapping[str, ArrayLike]
Source = str | PathLike[str] | Columns
#: Gives the indices of those of some headings that are read.
Kept = Callable[[list[str]], list[int]]

TIME = "time"

#: Factors from a unit of a log to one of a problem.
_DEGREE = math.pi / 180.0
_FACTORS = {
    ("deg", "rad"): _DEGREE, ("degrees", "rad"): _DEGREE, ("°", "rad"): _DEGREE,
    ("deg/s", "rad/s"): _DEGREE, ("degrees/s", "rad/s"): _DEGREE, ("°/s", "rad/s"): _DEGREE,
    ("ms", "s"): 1e-3, ("us", "s"): 1e-6, ("ns", "s"): 1e-9,
    ("mm", "m"): 1e-3, ("cm", "m"): 1e-2, ("km", "m"): 1e3, ("km/h", "m/s"): 1.0 / 3.6,
    ("hPa", "Pa"): 1e2, ("mbar", "Pa"): 1e2, ("mV", "V"): 1e-3, ("mA", "A"): 1e-3,
}  # fmt: skip

#: Letters of units that are written in several ways: the micro sign, the Greek letter, powers.
_LETTERS = str.maketrans({"\u00b5": "u", "\u03bc": "u", "²": "^2", "³": "^3"})

#: What files that are no text begin with, and are then.
_BEGINNINGS = {
    b"\xff\xfe": "text in UTF-16", b"\xfe\xff": "text in UTF-16",
    b"\x1f\x8b": "compressed by gzip", b"PK\x03\x04": "an archive, as .xlsx and .zip are",
}  # fmt: skip
_PARQUET = b"PAR1"

#: Roundings of 64 bits that a time has behind it: its own, and those of a unit's factor.
_ROUNDINGS = 4

#: Letters of a value that a message shows.
_SHOWN = 40


class LogError(ValueError):
    """A log that does not fit; the message names it, and row and column where there are any."""


def shown(value: object) -> str:
    """Value of a message, cut if it is long."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def factor(unit: str, wanted: str, what: str) -> float:
    """Factor from a unit to another; 1 if one of them is not said.

    Raises
    ------
    LogError
        If it is not known; `what` is called so then.
    """
    given, plain = unit.translate(_LETTERS), wanted.translate(_LETTERS)
    if given == plain or not given or not plain:
        return 1.0
    if (given, plain) not in _FACTORS:
        raise LogError(f"{what} must be in {wanted}, not in {unit}")
    return _FACTORS[given, plain]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A log: columns of equal length, with a name and numbers of rows for messages.

    Parameters
    ----------
    label
        What it was called among several, or "".
    name
        File or label.
    columns, units, headings
        Numbers, shape (K,), NaN where there was none; units that were given; and what was written
        above them: by name. Times are in seconds.
    rows
        Number of each row, shape (K,): of a text file its line, else its index.
    resolution
        What the times differ by if they differ at all, in seconds, as far as can be seen.
    """

    label: str
    name: str
    columns: dict[str, Array]
    units: dict[str, str]
    headings: dict[str, str]
    rows: NDArray[np.int64]
    resolution: float

    @property
    def times(self) -> Array:
        """Time of each row, shape (K,), rising, in seconds."""
        return self.columns[TIME]

    def row(self, index: int) -> str:
        """Name a row of data."""
        return f"row {self.rows[index]} of {self.name}"


class _Headings:
    """Names and units of columns, and which of them are read.

    Parameters
    ----------
    known
        Names that a column may have, brackets included.
    ignore
        Columns to leave out.
    """

    def __init__(self, known: Collection[str], ignore: Iterable[str]) -> None:
        self._known = known
        self._ignored = set(ignore)
        self._met: set[str] = set()
        self._others: dict[str, None] = {}

    def split(self, heading: str) -> tuple[str, str]:
        """Name and unit of a heading such as ``heading [deg]``."""
        heading = heading.strip()
        if heading in self._known:
            return heading, ""
        found = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))?", heading, re.DOTALL)
        assert found is not None
        return found[1], (found[2] or found[3] or "").strip()

    def takes(self, label: str, heading: str) -> bool:
        """Whether a column of a log is to be read."""
        own, _ = self.split(heading)
        names = {heading.strip(), own, f"{label}.{own}" if label else own}
        self._others[own] = None
        self._met |= names & self._ignored
        return not names & self._ignored

    def check(self) -> None:
        """Check that each column that is to be left out was there."""
        for name in sorted(self._ignored - self._met, key=repr):
            raise LogError(
                f"ignore must name columns of the logs, {', '.join(self._others)}, not {name!r}"
            )


def read_tables(
    source: Source | Mapping[str, Source], ignore: Iterable[str], known: Collection[str]
) -> list[Table]:
    """Read all logs; columns that are ignored are not looked into.

    Parameters
    ----------
    source
        A file or columns; or several by name.
    ignore
        Columns to leave out, as they are headed, with or without their unit, or as ``gps.x``.
    known
        Names that a column may have.

    Raises
    ------
    LogError
        If a log is none.
    TypeError
        If something is of the wrong kind.
    OSError
        If a file cannot be read.
    MissingExtraError
        If it is a Parquet file, and the extra ``sweep`` is not installed.
    """
    headings = _Headings(known, ignore)
    logs = _logs(source, headings)
    names = _names(logs)
    tables = [_table(label, names[label], each, headings) for label, each in logs.items()]
    headings.check()
    return tables


def _logs(source: Source | Mapping[str, Source], headings: _Headings) -> dict[str, Source]:
    """Logs by label; that of a single one is ""."""
    if isinstance(source, Mapping):
        for name in source:
            if not isinstance(cast("object", name), str):
                raise TypeError(f"data must have names of columns or logs, not {name!r}")
    if isinstance(source, Mapping) and not any(headings.split(name)[0] == TIME for name in source):
        logs = {label: cast("Source", each) for label, each in source.items()}
    else:
        logs = {"": cast("Source", source)}
    if not logs:
        raise LogError("data must be a file, columns or several of these, not nothing")
    for label, each in logs.items():
        if not isinstance(cast("object", each), (str, PathLike, Mapping)):
            what = f"data of {label}" if label else "data"
            raise TypeError(
                f"{what} must be a CSV or Parquet file, or columns by name, one of them {TIME}, as "
                f"{{'{TIME}': array, ...}}, not of the class {type(each).__name__}"
            )
    return logs


def _names(logs: Mapping[str, Source]) -> dict[str, str]:
    """What messages call the logs: files by their last part, if that says which."""
    files = {label: Path(each) for label, each in logs.items() if not isinstance(each, Mapping)}
    short = [path.name for path in files.values()]
    return {
        label: f"the columns {label}".rstrip()
        if label not in files
        else files[label].name
        if short.count(files[label].name) == 1
        else str(files[label])
        for label in logs
    }


def _table(label: str, name: str, source: Source, headings: _Headings) -> Table:
    """Read a log and check its numbers and times."""

    def kept(given: list[str]) -> list[int]:
        """Indices of the columns that are read; their names must differ."""
        indices = [k for k, heading in enumerate(given) if headings.takes(label, heading)]
        own = [given[k].strip() for k in indices]
        if len(set(own)) < len(own):
            raise LogError(f"{name} must have different headings, not {', '.join(own)}")
        return indices

    if isinstance(source, Mapping):
        for heading in source:
            if not isinstance(cast("object", heading), str):
                raise TypeError(f"{name} must have names that are text, not {heading!r}")
        given = list(source)
        raw = _from_arrays(source, [given[k] for k in kept(given)], name)
        rows = None
    else:
        raw, rows = _from_file(Path(source), name, kept)
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    written: dict[str, str] = {}
    for heading, numbers in raw.items():
        own, unit = headings.split(heading)
        if own in columns:
            raise LogError(f"{name} must have one column {own}, not several")
        columns[own], units[own], written[own] = numbers, unit, heading
    if TIME not in columns:
        raise LogError(
            f"{name} must have a column {TIME}, not only {', '.join(columns) or 'what is ignored'}"
        )
    scale = factor(units[TIME], "s", f"{TIME} of {name}")
    resolution = scale * _resolution(columns[TIME])
    columns[TIME] = columns[TIME] * scale
    table = Table(
        label=label, name=name, columns=columns, units=units, headings=written,
        rows=np.arange(len(columns[TIME])) if rows is None else rows, resolution=resolution,
    )  # fmt: skip
    _check_numbers(table)
    return table


def _check_numbers(table: Table) -> None:
    """Check that what is there is finite, and that the times rise."""
    times = table.times
    if not len(times):
        raise LogError(f"{table.name} must have a row, not none")
    for name, numbers in table.columns.items():
        wrong = np.flatnonzero(~np.isfinite(numbers) if name == TIME else np.isinf(numbers))
        if len(wrong):
            row = int(wrong[0])
            rule = "a number" if name == TIME else "finite, or missing"
            raise LogError(
                f"{name} must be {rule}, not {float(numbers[row])!r} in {table.row(row)}"
            )
    falls = np.flatnonzero(np.diff(times) <= 0.0)
    if len(falls):
        row = int(falls[0]) + 1
        raise LogError(
            f"{TIME} must rise, not from {float(times[row - 1])!r} to {float(times[row])!r} s in "
            f"{table.row(row)}"
        )


def _resolution(times: Array) -> float:
    """What times differ by if they differ at all, in their unit: as far as can be seen in them.

    That is the last decimal place if no time has more of them, the spacing of binary32 if all are
    numbers of that format, but no less than what binary64 can tell.
    """
    finite = np.abs(times[np.isfinite(times)])
    if not len(finite):
        return 0.0
    largest = float(finite.max())
    found = _ROUNDINGS * float(np.spacing(largest))
    if largest < np.finfo(np.float32).max and (finite.astype(np.float32) == finite).all():
        found = max(found, float(np.spacing(np.float32(largest))))
    for decimals in range(16):
        if largest * 10.0**decimals >= 2.0**53:
            break
        if (np.round(finite, decimals) == finite).all():
            return max(found, 10.0**-decimals)
    return found


# Kinds of logs.


def _from_arrays(source: Columns, wanted: Iterable[str], name: str) -> dict[str, Array]:
    """Columns that are given as arrays; what is masked in one is missing."""
    found: dict[str, Array] = {}
    for heading in wanted:
        values = cast("Any", source[heading])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # older NumPy makes objects of unequal rows
                array = cast("Any", np.ma.asarray(values))
        except ValueError:
            array = cast("Any", np.ma.asarray(None))
        if array.dtype.kind not in "fiub" or array.ndim != 1:
            raise LogError(f"{heading} of {name} must be a row of numbers, not {shown(values)}")
        found[heading] = np.ma.filled(array.astype(np.float64), np.nan)
    lengths = {heading: len(array) for heading, array in found.items()}
    if len(set(lengths.values())) > 1:
        raise LogError(f"{name} must have one length, not {lengths!r}")
    return found


def _from_file(
    path: Path, name: str, kept: Kept
) -> tuple[dict[str, Array], NDArray[np.int64] | None]:
    """Columns of a file, whose content says what it is; and numbers of its rows, if it has any."""
    try:
        content = path.read_bytes()
    except ValueError as error:  # NUL in its name
        raise LogError(f"data must be a file, not {shown(str(path))}: {error}") from None
    if content.startswith(_PARQUET) or path.suffix.lower() == ".parquet":
        return _from_parquet(content, name, kept), None
    return _from_csv(_text(content, name), name, kept)


def _text(content: bytes, name: str) -> str:
    """Text of a file."""
    for beginning, what in _BEGINNINGS.items():
        if content.startswith(beginning):
            raise LogError(f"{name} must be text in UTF-8, or Parquet, not {what}")
    content = content.removeprefix(b"\xef\xbb\xbf")
    wrong = content.find(b"\0")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        wrong = error.start if wrong < 0 else min(wrong, error.start)
    else:
        if wrong < 0:
            return text
    row = len((content[:wrong] + b"x").splitlines())
    raise LogError(
        f"{name} must be text in UTF-8, or Parquet, and has the byte 0x{content[wrong]:02x} in row "
        f"{row}: is it of another encoding?"
    )


def _from_csv(text: str, name: str, kept: Kept) -> tuple[dict[str, Array], NDArray[np.int64]]:
    """Columns of a text with a line of headings; comma, semicolon or tab between."""
    first = io.StringIO(text, newline="").readline()
    separator = max(",;\t", key=first.count)
    records = _records(text, separator, name)
    _, given = next(records, (1, [""]))
    headings = [heading.strip() for heading in given]
    if not any(headings):
        raise LogError(f"{name} must begin with a line of headings, not {shown(first)}")
    indices = kept(headings)
    rows: list[int] = []
    numbers: list[list[float]] = []
    for row, cells in records:
        if not cells:
            continue
        if len(cells) != len(headings):
            raise LogError(f"row {row} of {name} must have {len(headings)} cells, not {len(cells)}")
        rows.append(row)
        numbers.append([_number(cells[k], headings[k], row, name) for k in indices])
    columns = np.array(numbers, dtype=np.float64).reshape(len(rows), len(indices))
    found = {headings[k]: columns[:, place] for place, k in enumerate(indices)}
    return found, np.array(rows, dtype=np.int64)


def _records(text: str, separator: str, name: str) -> Iterator[tuple[int, list[str]]]:
    """Cells of each record, and the line that it begins in."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    while True:
        row = reader.line_num + 1
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise LogError(f"row {row} of {name} must be cells, and is not: {error}") from None
        yield row, cells


def _number(cell: str, heading: str, row: int, name: str) -> float:
    """Read a cell; an empty one is missing."""
    text = cell.strip()
    if not text:
        return math.nan
    # Python reads more than files of numbers have: 1_000, and digits of all scripts.
    if text.isascii() and "_" not in text:
        try:
            number = float(text)
        except ValueError:
            pass
        else:
            if not math.isinf(number):
                return number
            raise LogError(
                f"{heading} must be finite, or empty, not {shown(cell)} in row {row} of {name}"
            )
    raise LogError(f"{heading} must be a number or empty, not {shown(cell)} in row {row} of {name}")


def _from_parquet(content: bytes, name: str, kept: Kept) -> dict[str, Array]:
    """Columns of a Parquet file."""
    with importing("sweep"):
        import polars
    panic: type[BaseException] = polars.exceptions.PanicException
    try:
        given = list(polars.read_parquet_schema(io.BytesIO(content)))
        wanted = [given[k] for k in kept(given)]
        frame = polars.read_parquet(io.BytesIO(content), columns=wanted)
    except (polars.exceptions.PolarsError, OSError, panic) as error:
        first = (str(error).splitlines() or [""])[0]
        raise LogError(f"{name} must be a Parquet file, and cannot be read: {first}") from None
    found: dict[str, Array] = {}
    for heading in wanted:
        series = frame[heading]
        if not series.dtype.is_numeric():
            raise LogError(f"{heading} of {name} must be numbers, not {series.dtype}")
        found[heading] = series.cast(polars.Float64).fill_null(math.nan).to_numpy()
    return found
