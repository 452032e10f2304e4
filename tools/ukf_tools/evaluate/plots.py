"""Plots of runs: errors, or estimates if the truth is not known, and the NIS of each sensor."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from ukf_sw.problems.running import Run

__all__ = ["plot_runs"]

STYLES = ("-", "--", ":")


def plot_runs(file: Path, runs: Mapping[str, Run], title: str) -> Path:
    """Draw the runs of filters over time.

    Above, an error: the first one, or the norm of those without a unit. Without truth, estimates: a
    panel for each unit. Below, the NIS of each sensor and what to expect of it.

    Parameters
    ----------
    file
        Image to write; its folder is made if absent.
    runs
        Runs of the same scenario by the name of what computed them; one at least.
    title
        Title.

    Returns
    -------
    Path
        The file.
    """
    # Slow to import, and asks for a display unless told.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    problem = next(iter(runs.values())).problem
    known = problem.record.truth is not None
    units = list(dict.fromkeys(_names(problem).values()))
    panels = 1 if known else len(units)
    figure = Figure(figsize=(8.0, 2.2 + 2.6 * panels), layout="constrained")
    FigureCanvasAgg(figure)
    *upper, below = figure.subplots(
        panels + 1, 1, sharex=True, squeeze=False, height_ratios=[3] * panels + [2]
    )[:, 0]  # fmt: skip
    if known:
        _draw_errors(upper[0], runs)
    else:
        for axes, unit in zip(upper, units, strict=True):
            _draw_states(axes, runs, unit)
    _draw_nis(below, runs)
    upper[0].set_title(title, fontsize=10)
    for axes in (*upper, below):
        axes.grid(visible=True, which="both", alpha=0.3)
        axes.legend(fontsize=8)
    below.set_xlabel("time / s")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
    return file


def _names(problem: Any) -> dict[str, str]:
    """Units of the states by name."""
    named = cast("dict[str, str]", problem.states)
    return named or {f"x[{i}]": "" for i in range(problem.params.n)}


def _marker(runs: Mapping[str, Run]) -> str | None:
    return "." if max(found.steps for found in runs.values()) <= 50 else None


def _draw_errors(axes: Any, runs: Mapping[str, Run]) -> None:
    """Draw the first error, or the norm of all."""
    problem = next(iter(runs.values())).problem
    unit = problem.error_units[0]
    for style, (name, found) in zip(STYLES, runs.items(), strict=False):
        size = np.abs(found.errors[:, 0]) if unit else np.linalg.norm(found.errors, axis=1)
        axes.plot(found.times, size, style, label=name, marker=_marker(runs), linewidth=1.2)
    if problem.limit is not None:
        label = f"{problem.limit:g} {unit}"
        axes.axhline(problem.limit, color="0.6", linewidth=0.8, label=label)
    axes.set_yscale("log")
    axes.set_ylabel(
        f"{problem.error_names[0]} error / {unit}" if unit else "norm of the error of x"
    )  # fmt: skip


def _draw_states(axes: Any, runs: Mapping[str, Run], unit: str) -> None:
    """Draw the estimates of the states that have a unit."""
    for style, (name, found) in zip(STYLES, runs.items(), strict=False):
        named = _names(found.problem).items()
        own = [(row, state) for row, (state, its) in enumerate(named) if its == unit]
        for colour, (row, state) in enumerate(own):
            axes.plot(
                found.times, found.x[:, row], style, color=f"C{colour % 10}", linewidth=1.2,
                label=f"{state}, {name}", marker=_marker(runs),
            )  # fmt: skip
    axes.set_ylabel(f"estimate / {unit}" if unit else "estimate")


def _draw_nis(axes: Any, runs: Mapping[str, Run]) -> None:
    """Draw the NIS of each sensor of the first run, and the mean that a consistent filter has."""
    found = next(iter(runs.values()))
    for number, name in enumerate(found.problem.sensor_names):
        nis = found.nis_of_sensors[:, number]
        there = ~np.isnan(nis)
        rows = len(found.problem.params.rows_of(number))
        axes.plot(found.times[there], nis[there], ".", markersize=2, label=name, color=f"C{number}")
        axes.axhline(rows, color=f"C{number}", linewidth=0.8)
    axes.set_yscale("log")
    axes.set_ylabel("NIS")
