"""Figures of the applications."""

from collections.abc import Mapping
from pathlib import Path
from textwrap import fill

import numpy as np

from ukf_sw.catalogue import Entry
from ukf_sw.scenario import Results

__all__ = ["draw_errors"]

#: More points than this are thinned, to the largest error of each stretch: figures stay small.
POINTS = 2000


def _thin(times: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Keep of each stretch of samples the one with the largest error, shape (K,) each."""
    stretch = -(-len(times) // POINTS)
    if stretch <= 1:
        return times, errors
    whole = len(times) // stretch * stretch
    parts = np.abs(errors[:whole]).reshape(-1, stretch)
    parts = np.where(np.isnan(parts), -np.inf, parts)
    largest = parts.argmax(axis=1) + np.arange(0, whole, stretch)
    return times[largest], errors[largest]


def draw_errors(file: Path, entry: Entry, estimates: Mapping[str, Results]) -> Path:
    """Draw the errors of filters over time, one panel for each, with a caption below.

    Parameters
    ----------
    file
        Image to write; its folder is made if absent.
    entry
        The entry.
    estimates
        Results of the same scenario by the name of what computed them.

    Returns
    -------
    Path
        The file.
    """
    # Slow to import.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    first = next(iter(estimates.values()))
    scenario = first.scenario
    count = len(scenario.error_names)
    figure = Figure(figsize=(8.0, 1.6 + 1.7 * count), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    thinned = False
    for k, (name, unit) in enumerate(zip(scenario.error_names, scenario.error_units, strict=True)):
        panel = panels[k]
        for style, (label, results) in zip(("-", "--", ":"), estimates.items(), strict=False):
            errors = results.errors[:, k].copy()
            if scenario.judged is not None:
                errors[~scenario.judged[: len(errors)]] = np.nan
            times, values = _thin(results.times, errors)
            thinned |= len(times) < len(results.times)
            marker = "." if len(times) <= 50 else None
            panel.plot(times, values, style, label=label, marker=marker, linewidth=1.0)
        panel.set_ylabel(f"{name} / {unit}" if unit else name)
        panel.grid(visible=True, alpha=0.3)
        settled = first.errors[first.times > entry.settled, k]
        limit = 1.2 * np.nanmax(np.abs(settled)) if settled.size else 0.0
        # What came before the filter settled may leave the panel.
        if limit > 0.0 and np.isfinite(limit):
            panel.set_ylim(0.0 if np.nanmin(first.errors[:, k]) >= 0.0 else -limit, limit)
    panels[0].legend(loc="upper right", fontsize=8)
    panels[-1].set_xlabel("time / s")
    panels[0].set_title(f"{entry.name}: errors of the estimates", fontsize=10)
    peaks = f" Drawn are the largest errors of {POINTS} stretches of time." if thinned else ""
    caption = f"{entry.doc} Source: {entry.source}. {len(first.times)} steps.{peaks}"
    figure.supxlabel(fill(caption, 110), fontsize=8, x=0.01, ha="left")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    return file
