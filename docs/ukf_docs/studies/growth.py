"""How cycles grow with states and with processing elements."""

from dataclasses import asdict
from typing import Any

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.study import Study, Tell
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Form
from ukf_tools.design_report.growth import growths
from ukf_tools.design_space.cache import CACHE, Cache
from ukf_tools.design_space.executors import LocalExecutor
from ukf_tools.design_space.points import Point, grid
from ukf_tools.design_space.sweep import Questions, sweep

__all__ = ["STUDY", "points"]

#: States of the first study, with as many process noise terms; observations as the nanosatellite.
STATES = range(4, 32)
#: Processing elements at which states grow.
FIXED_PES = (2, 8)


def points() -> list[Point]:
    """Cores of both studies: states at fixed processing elements, and the other way round."""
    nanosat = Point.of(Core(params=NANOSAT, problem="nanosat"))
    forms = tuple(Form)
    return [
        *grid([Point()], n=STATES, m=(6,), q=("n",), r=(6,), pes=FIXED_PES, form=forms),
        *grid([nanosat], pes=range(1, NANOSAT.columns + 1), form=forms),
    ]


def _measure(tell: Tell) -> list[dict[str, Any]]:
    """Sweep, and fit."""
    outcome = sweep(points(), Questions(resources=False), Cache(CACHE), LocalExecutor(), tell)
    # The nanosatellite is one of the sizes, and would be there twice.
    states = [row for row in outcome.rows if row["problem"] is None]
    elements = [row for row in outcome.rows if row["problem"] is not None]
    return [asdict(growth) for rows in (states, elements) for growth in growths(rows)]


def _table(record: list[dict[str, Any]]) -> str:
    """Write fitted exponents."""
    over = {"n": "states", "pes": "processing elements"}
    rows = [
        (
            row["figure"].replace("_", " "), over[row["over"]], f"{row['low']} to {row['high']}",
            row["group"], f"{row['exponent']:+.2f}", f"{row['worst'] - 1.0:.0%}",
        )
        for row in record
    ]  # fmt: skip
    headings = ("figure", "over", "range", "cores", "exponent", "worst core off the fit")
    return table(headings, rows, left=4)


STUDY = Study(
    name="growth", document=DOCS / "design-space.md", measure=_measure, tables={"growth": _table}
)
