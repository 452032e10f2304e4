"""Logs merged in time: which rows of which log are of the same step."""

import math
import warnings
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problems.log_tables import LogError, Table

__all__ = ["LogWarning", "Steps", "check_equidistant", "check_overlap", "merge"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Intervals of a problem without an input dt may differ by this part: clocks are read, too. Times
#: of several logs are of one instant only if they are nearer than this part of any interval.
_JITTER = 0.01

#: Times that are nearer than this part of any interval are of one instant: nothing moves in it.
_INSTANT = 1e-6

#: Part of the shortest interval that times may be rounded by.
_ROUNDED = 1e-3


class LogWarning(UserWarning):
    """Logs that can be taken, but hardly are what was meant."""


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What the rows of logs are steps of.

    Parameters
    ----------
    tables
        The logs.
    times
        Time of each step, shape (K,), rising, in seconds.
    places
        Of each log the step of each row; -1 if it is before the first step.
    """

    tables: list[Table]
    times: Array
    places: list[Indices]

    def row(self, step: int) -> str:
        """Name a row that is of a step."""
        for table, places in zip(self.tables, self.places, strict=True):
            found = np.flatnonzero(places == step)
            if len(found):
                return table.row(int(found[0]))
        raise AssertionError(step)

    def column(self, table: int, name: str) -> Array:
        """A column of a log at the times of the steps, shape (K,); NaN where it has no row."""
        places = self.places[table]
        whole = np.full(len(self.times), np.nan)
        whole[places[places >= 0]] = self.tables[table].columns[name][places >= 0]
        return whole


def merge(tables: list[Table], start: float | None) -> Steps:
    """Find the steps: all times of all logs.

    Times of several logs are of one step if they differ only by rounding: by no more than half of
    the last decimal place that the times of each log have, or half of the spacing of binary32 if
    they are of that format, or a few roundings of binary64, or 1e-6 of the shortest interval that
    any log has; but never by more than 0.01 of that interval, so that no two rows of a log are
    merged. The step has the time of the log with the most rows.

    Parameters
    ----------
    tables
        The logs.
    start
        Time before which rows are no steps, in seconds; None is the first time.

    Raises
    ------
    LogError
        If nothing is left, or times are too large to tell the intervals.
    """
    shortest = min((float(np.diff(t.times).min()) for t in tables if len(t.times) > 1),
                   default=math.inf)  # fmt: skip
    for table in tables:
        spacing = float(np.spacing(np.abs(table.times).max()))
        if spacing > _ROUNDED * shortest:
            raise LogError(
                f"times must be from a nearer origin: those of {table.name} are as large as "
                f"{float(table.times[-1]):.10g} s and rounded to {spacing:.3g} s, where rows are "
                f"{shortest:.3g} s apart"
            )
    instant = _INSTANT * shortest if math.isfinite(shortest) else 0.0
    near = [_near(table, shortest) for table in tables]
    times = np.concatenate([table.times for table in tables])
    owners = np.repeat(np.arange(len(tables)), [len(table.times) for table in tables])
    order = np.lexsort((owners, times))
    steps = np.empty(len(times), dtype=np.int64)
    # Of each step the log whose time it has, those with more rows first, and that time.
    found: list[tuple[int, int, float]] = []
    first = last = -math.inf
    reach = 0.0
    for index in cast("list[int]", order.tolist()):
        time, owner = float(times[index]), int(owners[index])
        own, rank = near[owner], (-len(tables[owner].times), owner, time)
        if time == last or (time - last <= reach + own and time - first <= _JITTER * shortest):
            reach = max(reach, own)
            found[-1] = min(found[-1], rank)
        else:
            first, reach = time, own
            found.append(rank)
        last = time
        steps[index] = len(found) - 1
    merged = np.array([time for _, _, time in found])
    skipped = 0
    if start is not None:
        skipped = int(np.searchsorted(merged, start - instant))
        if skipped == len(merged):
            raise LogError(
                f"start must be at most {float(merged[-1])!r} s, the last time, not {start!r}"
            )
    ends = np.cumsum([len(table.times) for table in tables])[:-1]
    places = np.split(np.maximum(steps - skipped, -1), ends)
    return Steps(tables=tables, times=merged[skipped:], places=places)


def _near(table: Table, shortest: float) -> float:
    """How far a time of a log may be from an instant, in seconds, by rounding."""
    if not math.isfinite(shortest):  # no log has two rows
        return 2.0 * float(np.spacing(np.abs(table.times).max()))
    return 0.5 * max(table.resolution, _INSTANT * shortest)


def check_overlap(tables: list[Table]) -> None:
    """Warn if there is a time between all rows of some logs and all rows of the others.

    A log of one row, as of an input that is constant, may be before the others, by no more than
    they last.
    """
    ordered = sorted(tables, key=lambda table: float(table.times[0]))
    end = -math.inf
    for index, table in enumerate(ordered):
        begin = float(table.times[0])
        before, after = ordered[:index], ordered[index:]
        if before and begin > end:
            spans = [max(float(t.times[-1] - t.times[0]) for t in part) for part in (before, after)]
            if min(spans) > 0.0 or begin - end > max(spans) > 0.0:
                told = ", ".join(
                    f"{t.name} from {float(t.times[0])!r} to {float(t.times[-1])!r} s"
                    for t in ordered
                )
                warnings.warn(
                    f"logs should overlap in time, and these do not: {told}; is one in another "
                    "unit, or of another clock?",
                    LogWarning,
                    stacklevel=3,
                )
                return
        end = max(end, float(table.times[-1]))


def check_equidistant(steps: Steps, dt: str) -> None:
    """Check the intervals of a problem whose f is not told them, by an input called `dt`.

    Raises
    ------
    LogError
        If one is longer or shorter than most are.
    """
    intervals = np.diff(steps.times)
    if not len(intervals):
        return
    usual = float(np.median(intervals))
    off = np.flatnonzero(np.abs(intervals - usual) > _JITTER * usual)
    if len(off):
        index = int(off[0])
        raise LogError(
            f"steps must be {usual:.6g} s apart, as most are, since f has no input {dt}, not "
            f"{float(intervals[index]):.6g} s before {steps.row(index + 1)}"
        )
