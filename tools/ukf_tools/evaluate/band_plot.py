"""Plot of states, or of their errors, beside what the filter thinks of them."""

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Problem

__all__ = ["SIGMAS", "plot_bands"]

#: Half the width of the band, in standard deviations.
SIGMAS = 3.0

_LINE, _BAND = "#1b4f8a", "#b9d4ee"
#: States above which the panels stand in two columns.
_ONE_COLUMN = 4


def plot_bands(
    file: Path,
    problem: Problem,
    x: NDArray[np.float64],
    P: NDArray[np.float64],
    *,
    title: str,
) -> dict[str, float] | None:
    """Draw each state over time with a band of 3 standard deviations.

    If the truth is known for the states it is their errors that are drawn, else the estimates.

    Parameters
    ----------
    file
        Image to write; its folder is made if absent.
    problem
        The problem, with its data.
    x
        Estimates of its first steps, shape (K, n).
    P
        Their covariances, shape (K, n, n).
    title
        Title.

    Returns
    -------
    dict or None
        In which part of the steps the error of each state was within its band, by name; None if the
        errors are not known.
    """
    # Slow to import, and asks for a display unless told.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n = x.shape[1]
    named = cast("dict[str, str]", problem.states) or {f"x[{i}]": "" for i in range(n)}
    # With an error function of its own, a problem's truth may be anything.
    known = problem.record.truth is not None and problem.error is None
    values = problem.errors_of(x) if known else x
    half = SIGMAS * np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    columns = 1 if n <= _ONE_COLUMN else 2
    rows = -(-n // columns)
    figure = Figure(figsize=(8.0 if columns == 1 else 12.0, 1.0 + 1.8 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels: list[Any] = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel().tolist()
    times = problem.times[: len(x)]
    for i, (axes, (name, unit)) in enumerate(zip(panels, named.items(), strict=False)):
        middle = 0.0 if known else values[:, i]
        axes.fill_between(
            times, middle - half[:, i], middle + half[:, i], color=_BAND, linewidth=0.0,
            label=f"{SIGMAS:g} standard deviations, by the filter",
        )  # fmt: skip
        label = "error" if known else "estimate"
        axes.plot(times, values[:, i], color=_LINE, linewidth=1.0, label=label)
        axes.set_ylabel(f"{name} / {unit}" if unit else name)
        axes.grid(visible=True, alpha=0.3)
    for axes in panels[n:]:
        axes.set_visible(False)
    panels[0].legend(fontsize=8)
    panels[n - 1].set_xlabel("time / s")
    figure.suptitle(title, fontsize=10)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=120)
    if not known:
        return None
    within = np.mean(np.abs(values) < half, axis=0)
    return dict(zip(named, within.tolist(), strict=True))
