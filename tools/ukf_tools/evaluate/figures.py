"""Figures of the applications: errors of every entry, equivalents of the papers' figures."""

from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from ukf_sw.problems.entry import Entry
from ukf_sw.problems.running import Run
from ukf_sw.problems.systems.nanosat import LIMIT, attitude_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw", "draw_errors", "make_figure", "save"]

#: More points than this are thinned, to the largest error of each stretch: figures stay small.
POINTS = 800
#: Resolution, in dots per inch, and colours of an image.
DOTS, COLOURS = 90, 24
#: Line styles of the estimates, in order: the second is seen on top of the first.
STYLES = ({"color": "C0", "linewidth": 1.6}, {"color": "C1", "linewidth": 0.9, "linestyle": "--"})

Estimates = Mapping[str, Run]


def make_figure(
    size: tuple[float, float], rows: int, columns: int = 1, *, share_x: bool = False
) -> tuple["Figure", list["Axes"]]:
    """Make a figure without a display: the figure, and its panels row by row."""
    # Slow to import, and asks for a display unless told.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=share_x).flat)
    for panel in panels:
        panel.grid(visible=True, alpha=0.3)
    return figure, panels


def save(figure: "Figure", file: Path, caption: str) -> Path:
    """Write a figure with its caption below; the folder is made if absent."""
    from PIL import Image

    width = round(16.0 * figure.get_size_inches()[0])
    figure.supxlabel(fill(caption, width), fontsize=8, x=0.01, ha="left")
    file.parent.mkdir(parents=True, exist_ok=True)
    buffer = BytesIO()
    figure.savefig(buffer, dpi=DOTS)
    # A palette makes the file three times smaller.
    with Image.open(buffer) as image:
        coverage = Image.Quantize.MAXCOVERAGE  # keeps colours of few pixels apart
        image.convert("RGB").quantize(COLOURS, coverage).save(file, optimize=True)
    return file


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


def draw_errors(file: Path, entry: Entry, estimates: Estimates) -> Path:
    """Draw the errors of filters over time, one panel for each, with a caption below.

    Parameters
    ----------
    file
        Image to write; its folder is made if absent.
    entry
        The entry.
    estimates
        Runs of the same scenario by the name of what computed them.

    Returns
    -------
    Path
        The file.
    """
    first = next(iter(estimates.values()))
    problem = first.problem
    begin, end = float(first.times[0]), float(first.times[-1])
    # Where nothing is known about it, a twentieth of the run is taken for the filter to settle.
    settled_at = problem.settled if np.isfinite(problem.settled) else begin + 0.05 * (end - begin)
    count = len(problem.error_names)
    figure, panels = make_figure((8.0, 1.4 + 1.5 * count), count, share_x=True)
    thinned = False
    for k, (name, unit) in enumerate(zip(problem.error_names, problem.error_units, strict=True)):
        panel = panels[k]
        for style, (label, found) in zip(STYLES, estimates.items(), strict=False):
            errors = found.errors[:, k].copy()
            if problem.record.judged is not None:
                errors[~problem.record.judged[: len(errors)]] = np.nan
            times, values = _thin(found.times, errors)
            thinned |= len(times) < found.steps
            marker = "." if len(times) <= 50 else None
            panel.plot(times, values, label=label, marker=marker, **style)
        panel.set_ylabel(f"{name} / {unit}" if unit else name)
        settled = first.errors[first.times > settled_at, k]
        limit = 1.2 * np.nanmax(np.abs(settled)) if settled.size else 0.0
        # What came before the filter settled may leave the panel.
        if limit > 0.0 and np.isfinite(limit):
            panel.set_ylim(0.0 if np.nanmin(first.errors[:, k]) >= 0.0 else -limit, limit)
    panels[0].legend(loc="upper right", fontsize=8)
    panels[-1].set_xlabel("time / s")
    panels[0].set_title(f"{entry.name}: errors of the estimates", fontsize=10)
    peaks = f" Drawn are the largest errors of {POINTS} stretches of time." if thinned else ""
    caption = f"{entry.doc} Source: {entry.source}. {first.steps} steps.{peaks}"
    return save(figure, file, caption)


# The papers' figures of the nanosatellite.


def _draw_attitude(panel: "Axes", estimates: Estimates, until: float) -> None:
    """Draw total attitude errors up to a time."""
    for style, (label, found) in zip(STYLES, estimates.items(), strict=False):
        chosen = found.times <= until + 1e-9
        times, errors = _thin(found.times[chosen], found.errors[chosen, 0])
        panel.plot(times, errors, label=label, **style)
    panel.axhline(LIMIT, color="0.5", linewidth=0.8, linestyle=":", label=f"{LIMIT} degrees")
    panel.set_xlim(0.0, until)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("time / s")
    panel.set_ylabel("attitude error / degrees")


def _draw_beginning(file: Path, estimates: Estimates, caption: str) -> Path:
    """Draw the first tenth of a second, and the first second."""
    figure, panels = make_figure((8.0, 5.4), 2)
    for panel, until in zip(panels, (0.1, 1.0), strict=True):
        _draw_attitude(panel, estimates, until)
    panels[1].set_ylim(0.0, 4.0 * LIMIT)
    panels[0].legend(loc="upper right", fontsize=8)
    return save(figure, file, caption)


def _draw_whole(file: Path, estimates: Estimates, caption: str) -> Path:
    """Draw the whole run."""
    figure, (panel,) = make_figure((8.0, 3.6), 1)
    times = next(iter(estimates.values())).times
    _draw_attitude(panel, estimates, float(times[-1]))
    panel.set_ylim(0.0, 3.0 * LIMIT)
    panel.legend(loc="upper right", fontsize=8)
    return save(figure, file, caption)


def _draw_gyroscope(file: Path, found: Run, caption: str) -> Path:
    """Draw the true rates of the body, and those that the gyroscope gives."""
    data = found.problem.record
    every = max(1, data.steps // POINTS)
    # The input of a step is the sample before it; truth holds attitude and bias after it.
    times, measured = data.times[:-1:every], np.degrees(np.asarray(data.inputs)[1::every])
    attitude = np.asarray(data.truth)[:, :4]
    dt = data.times[1] - data.times[0]
    # The error of an attitude, taken for an estimate of the one before it, is the turn in between.
    true = attitude_error(attitude[1:], attitude[:-1])[::every, 1:] / dt
    figure, panels = make_figure((8.0, 5.4), 2, share_x=True)
    for axis, (name, line) in enumerate(zip("xyz", ("-", "-", "--"), strict=True)):
        panels[0].plot(times, true[:, axis], line, label=name, linewidth=1.2)
        panels[1].plot(times, measured[:, axis], line, label=name, linewidth=0.8)
    panels[0].set_ylabel("true rate / (degrees/s)")
    panels[1].set_ylabel("measured / (degrees/s)")
    panels[1].set_xlabel("time / s")
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
    return save(figure, file, caption)


_SAME = "Absolute attitude error of the core's golden model in binary32 and of the float64 filter"


def _draw_2018(folder: Path, estimates: Estimates) -> list[Path]:
    paper = "as figure 12{} of Soh and Wu 2018 has it: nanosatellite, slow tumbling, 1 kHz, P0 = I."
    return [
        _draw_beginning(
            folder / "nanosat-figure-12a.png", estimates,
            f"{_SAME}: the first tenth of a second and the first second, {paper.format('a')}",
        ),
        _draw_whole(
            folder / "nanosat-figure-12b.png", estimates,
            f"{_SAME}, the largest of each stretch of time: the whole run, {paper.format('b')}",
        ),
    ]  # fmt: skip


def _draw_2014(folder: Path, estimates: Estimates) -> list[Path]:
    paper = (
        "as figure {} of Soh and Wu 2014 has it: nanosatellite, 5 degrees at 0.1 Hz about all "
        "axes, 1 kHz, P0 = I."
    )
    return [
        _draw_gyroscope(
            folder / "nanosat-2014-figure-1.png", next(iter(estimates.values())),
            "True rates of the body, and samples of the gyroscope with noise and a bias that "
            f"drifts, {paper.format(1)} The rates about x and z nearly coincide.",
        ),
        _draw_whole(
            folder / "nanosat-2014-figure-6.png", estimates,
            f"{_SAME}, the largest of each stretch of time: the whole run, {paper.format(6)}",
        ),
        _draw_beginning(
            folder / "nanosat-2014-figure-7.png", estimates,
            f"{_SAME}: the first tenth of a second and the first second, {paper.format(7)}",
        ),
    ]  # fmt: skip


#: Further figures of entries, drawn of whole runs.
FURTHER: dict[str, Callable[[Path, Estimates], list[Path]]] = {
    "nanosat": _draw_2018,
    "nanosat-2014": _draw_2014,
}


def draw(folder: Path, entry: Entry, backend: str, estimates: Estimates) -> list[Path]:
    """Draw the figures of an entry.

    Parameters
    ----------
    folder
        Where to; it is made if absent.
    entry
        The entry.
    backend
        What computed, for the name of the file.
    estimates
        Runs of the same scenario by the name of what computed them.

    Returns
    -------
    list of Path
        Images: errors over time, then, of the papers' nanosatellites, the equivalents of the
        papers' figures.
    """
    files = [draw_errors(folder / f"{entry.name}-{backend}.png", entry, estimates)]
    times = next(iter(estimates.values())).times
    if entry.name in FURTHER and times[-1] >= 1.0:
        files += FURTHER[entry.name](folder, estimates)
    return files
