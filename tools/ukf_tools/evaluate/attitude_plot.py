"""Plot of an attitude's errors beside what the filter thinks of them."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Problem
from ukf_sw.problems.systems.nanosat import attitude_deviations

__all__ = ["SIGMAS", "plot_attitude"]

#: Half the width of the band, in standard deviations.
SIGMAS = 3.0

_ERROR, _BAND, _LIMIT = "#1b4f8a", "#b9d4ee", "#c0392b"
#: Share of the steps after which the components' scale holds the band.
_SETTLING = 0.03


def plot_attitude(
    file: Path,
    problem: Problem,
    x: NDArray[np.float64],
    P: NDArray[np.float64],
    *,
    limit: float,
    title: str,
) -> Path:
    """Draw the attitude error over time with a band of 3 standard deviations, and its components.

    Parameters
    ----------
    file
        Image to write; its folder is made if absent.
    problem
        A nanosatellite.
    x
        Estimates of its first steps, shape (K, n).
    P
        Their covariances, shape (K, n, n).
    limit
        Error that the filter should stay below, in degrees; a line.
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

    times = problem.times[: len(x)]
    errors = problem.errors_of(x)
    band = SIGMAS * attitude_deviations(x, P)
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplot_mosaic([["total"] * 3, ["x", "y", "z"]], height_ratios=(3, 2))

    total = panels["total"]
    floor = 0.5 * min(errors[:, 0].min(), limit)
    total.fill_between(times, floor, band[:, 0], color=_BAND, linewidth=0.0,
                       label=f"{SIGMAS:g} standard deviations, by the filter")  # fmt: skip
    total.plot(times, errors[:, 0], color=_ERROR, linewidth=1.1, label="error")
    total.axhline(limit, color=_LIMIT, linewidth=1.1, linestyle="--", label=f"{limit:g} degrees")
    total.set_yscale("log")
    total.set_ylim(bottom=floor)
    total.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    total.set_ylabel("attitude error / degrees")
    total.set_title(title, fontsize=11)
    total.legend(loc="upper right", framealpha=0.95)

    settled = band[int(_SETTLING * len(x)) :, 1:]
    scale = 1.1 * max(settled.max(), np.abs(errors[-len(settled) :, 1:]).max())
    for k, name in enumerate("xyz", start=1):
        axes = panels[name]
        axes.fill_between(times, -band[:, k], band[:, k], color=_BAND, linewidth=0.0)
        axes.plot(times, errors[:, k], color=_ERROR, linewidth=0.9)
        axes.axhline(0.0, color="0.3", linewidth=0.6)
        axes.set_ylim(-scale, scale)
        axes.set_title(f"about the body's {name} axis", fontsize=9)
        if k == 1:
            axes.set_ylabel("degrees")
        else:
            axes.tick_params(labelleft=False)
    for axes in panels.values():
        axes.set_xlim(0.0, times[-1])
        axes.set_xlabel("time / s")
        axes.grid(visible=True, which="major", alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)
    return file
