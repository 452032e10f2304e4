"""Picture of a schedule: what takes the stages of the array, clock by clock."""

from pathlib import Path
from typing import Any

import numpy as np

from ukf_sw.engine.microcode import Microcode
from ukf_sw.spec.sequence import Routine
from ukf_tools.estimate.occupancy import tracks
from ukf_tools.estimate.parts import Part, parts, runs

__all__ = ["plot_schedule"]

#: Colours of what is no row of the elimination; other parts are white.
_COLOURS = {
    "residuals": "#555555", "joint covariance": "#8c6d4f", "NIS": "#000000", "state": "#e58fc5",
    "factor": "#9d7fb8", "sigma points": "#a8a8a8", "covariance": "#555555", "checks": "#d0d0d0",
    "inputs": "#d0d0d0", "stream through 1/sqrt": "#8c6d4f", "model": "#9d7fb8",
    "results": "#e58fc5",
}  # fmt: skip
#: Most numbers that fit beside the bar of colours.
_NUMBERS = 16
#: What makes files of equal contents equal, by the end of their names.
_UNDATED = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def plot_schedule(file: Path, code: Microcode, routine: Routine, title: str) -> Path:
    """Draw which part of a program takes each stage, over the clocks.

    Parameters
    ----------
    file
        Image to write; its folder is made if absent. Equal programs give equal bytes.
    code, routine
        Programs of a core, and which one.
    title
        Title.

    Returns
    -------
    Path
        The file.
    """
    # Slow to import, and asks for a display unless told.
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.figure import Figure

    plan = code.programs[routine].plan
    found = parts(plan.operations, code.layout)
    rows = sorted({part.row for part in found if part.row is not None})
    shades = matplotlib.colormaps["turbo"](np.linspace(0.08, 0.95, len(rows)))
    by_row = dict(zip(rows, shades, strict=True))

    def colour(part: Part) -> Any:
        return _COLOURS.get(part.name, "white") if part.row is None else by_row[part.row]

    figure = Figure(figsize=(12.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    heights: list[tuple[str, float]] = []
    top = 0.0
    for name, lines in tracks(plan).items():
        height = 1.0 if len(lines) == 1 else 0.5  # of a line
        for number, line in enumerate(lines):
            there = runs(line, found)
            axes.broken_barh(
                [(run.first, run.clocks) for run in there],
                (top + number * height, 0.9 * height),
                facecolors=[colour(run.part) for run in there],
            )
        heights.append((name, top + len(lines) * height / 2))
        top += len(lines) * height + 0.4
    axes.set_yticks([middle for _, middle in heights], [name for name, _ in heights])
    axes.set_ylim(top, -0.4)
    axes.set_xlim(0, plan.length)
    axes.set_xlabel("clock")
    axes.set_title(title, fontsize=10)
    _draw_legend(axes, found, colour)
    if rows:
        edges = BoundaryNorm([row - 0.5 for row in (*rows, rows[-1] + 1)], len(rows))
        scale: Any = ScalarMappable(edges, ListedColormap(shades))
        bar = figure.colorbar(scale, ax=axes, label="row of the elimination", pad=0.01)
        bar.set_ticks(rows[:: -(-len(rows) // _NUMBERS)])
        bar.minorticks_off()
    file.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.hashsalt": "ukf"}):
        figure.savefig(file, dpi=120, metadata=_UNDATED.get(file.suffix.lower()))
    return file


def _draw_legend(axes: Any, found: list[Part], colour: Any) -> None:
    """Say what the colours beside those of the rows mean."""
    from matplotlib.patches import Patch

    others = [part for part in dict.fromkeys(found) if part.row is None]
    if others:
        axes.legend(
            handles=[Patch(color=colour(part), label=part.name) for part in others],
            loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=len(others), fontsize=8,
            frameon=False,
        )  # fmt: skip
