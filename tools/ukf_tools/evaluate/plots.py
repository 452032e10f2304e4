"""Plots of estimation errors."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problems.judging import LIMIT
from ukf_sw.problems.scenario import Scenario

__all__ = ["plot_errors"]


def plot_errors(
    file: Path, scenario: Scenario, estimates: Mapping[str, NDArray[np.float64]], title: str
) -> Path:
    """Draw the errors of filters over time.

    Parameters
    ----------
    file
        Image to write; its folder is made if absent.
    scenario
        The scenario.
    estimates
        Estimates of its first steps, shape (K, n), by the name of the filter.
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

    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    attitude = scenario.error_units[0] == "degrees"
    styles = ("-", "--", ":")
    for style, (name, x) in zip(styles, estimates.items(), strict=False):
        errors = scenario.error(x, scenario.truth[: len(x)])
        size = errors[:, 0] if attitude else np.linalg.norm(errors, axis=1)
        marker = "." if len(x) <= 50 else None
        axes.plot(scenario.times[: len(x)], size, style, label=name, marker=marker, linewidth=1.2)
    if attitude:
        axes.axhline(LIMIT, color="0.6", linewidth=0.8, label=f"{LIMIT} degrees")
    axes.set_yscale("log")
    axes.set_xlabel("time / s" if attitude else "step")
    axes.set_ylabel("attitude error / degrees" if attitude else "norm of the error of x")
    axes.set_title(title, fontsize=10)
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
    return file
