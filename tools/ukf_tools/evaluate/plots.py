"""Plots of estimation errors."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ukf_sw.problems.running import Run

__all__ = ["plot_errors"]


def plot_errors(file: Path, runs: Mapping[str, Run], title: str) -> Path:
    """Draw an error of filters over time: the first one, or the norm of those without a unit.

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

    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    problem = next(iter(runs.values())).problem
    unit = problem.error_units[0]
    steps = max(found.steps for found in runs.values())
    for style, (name, found) in zip(("-", "--", ":"), runs.items(), strict=False):
        size = np.abs(found.errors[:, 0]) if unit else np.linalg.norm(found.errors, axis=1)
        marker = "." if steps <= 50 else None
        axes.plot(found.times, size, style, label=name, marker=marker, linewidth=1.2)
    if problem.limit is not None:
        label = f"{problem.limit:g} {unit}"
        axes.axhline(problem.limit, color="0.6", linewidth=0.8, label=label)
    axes.set_yscale("log")
    axes.set_xlabel("time / s" if unit else "step")
    axes.set_ylabel(
        f"{problem.error_names[0]} error / {unit}" if unit else "norm of the error of x"
    )  # fmt: skip
    axes.set_title(title, fontsize=10)
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
    return file
