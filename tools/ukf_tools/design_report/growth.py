"""How figures grow with the number of states or of processing elements."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ukf_sw.spec.core import PARAMETERS
from ukf_tools.design_report.series import FACTORS, PROBLEM, Row, said, varying

__all__ = ["FIGURES", "Growth", "growths"]

#: Figures whose growth is fitted.
FIGURES = ("cycles", "lut", "ff", "dsp48e1", "bram36", "bus_words")
#: A line through fewer points says nothing.
_POINTS = 3


@dataclass(frozen=True, kw_only=True)
class Growth:
    """A power law fitted to a figure: a straight line through the logarithms.

    Parameters
    ----------
    figure
        Name of the figure.
    over
        What it grows with: ``n`` or ``pes``.
    group
        What the cores have in common.
    low, high, points
        Smallest and largest value of what it grows with, and number of cores.
    exponent
        The figure grows with this power.
    worst
        Largest ratio between a figure and the fit, or its inverse; 1 is a perfect fit.
    """

    figure: str
    over: str
    group: str
    low: int
    high: int
    points: int
    exponent: float
    worst: float


def _fit(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Exponent, and worst ratio to the fit."""
    log_x, log_y = np.log(x), np.log(y)
    exponent, offset = np.polyfit(log_x, log_y, 1)
    worst = np.exp(np.abs(log_y - (exponent * log_x + offset)).max())
    return float(exponent), float(worst)


def growths(rows: Sequence[Row]) -> list[Growth]:
    """Fit every figure over the states at fixed processing elements, and the other way round.

    Parameters
    ----------
    rows
        Rows of a sweep. Only groups of three cores or more are fitted; sizes other than n may
        follow n.

    Returns
    -------
    list of Growth
        Those that can be fitted.
    """
    found: list[Growth] = []
    sizes = [name for name in PROBLEM if PARAMETERS[name].kind is int]
    different = varying(rows)
    named = [
        name
        for name in FACTORS
        if name not in ("problem", *sizes)
        and (PARAMETERS[name].meaning.always or name in different)
    ]
    for over, fixed in (
        ("n", ["pes", *(f for f in FACTORS if f not in ("problem", *sizes))]),
        ("pes", FACTORS),
    ):
        groups: dict[tuple[object, ...], list[Row]] = {}
        for row in rows:
            groups.setdefault(tuple(row[name] for name in fixed), []).append(row)
        for group in groups.values():
            first = group[0]
            common = ("problem",) if first["problem"] else ("n", "m")
            if over == "n":
                common = ("pes",)
            for figure in FIGURES:
                if over == "pes" and figure == "bus_words":
                    continue  # they do not depend on it
                # One core for each value: with two, something else differs as well.
                points = {row[over]: row[figure] for row in group if row[figure]}
                if len(points) < _POINTS or len(points) < sum(bool(r[figure]) for r in group):
                    continue
                exponent, worst = _fit(list(points), list(points.values()))
                found.append(
                    Growth(
                        figure=figure,
                        over=over,
                        group=", ".join(said(name, first[name]) for name in (*common, *named)),
                        low=min(points),
                        high=max(points),
                        points=len(points),
                        exponent=exponent,
                        worst=worst,
                    )
                )
    return found
