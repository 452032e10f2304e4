"""How cycles grow with states and with processing elements: ``make growth`` finds out."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.progress import Progress

from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Form
from ukf_tools.design_report.growth import growths
from ukf_tools.design_space.cache import CACHE, Cache
from ukf_tools.design_space.executors import LocalExecutor
from ukf_tools.design_space.points import Point, grid
from ukf_tools.design_space.sweep import Questions, sweep

__all__ = ["MEASURED", "markdown", "points"]

#: Where the figures go.
MEASURED = Path(__file__).parents[2] / "measured" / "growth.json"
#: States of the first study, with as many process noise terms; observations as the nanosatellite.
STATES = range(4, 32)
#: Processing elements at which states grow.
FIXED_PES = (2, 8)


def points() -> list[Point]:
    """Cores of both studies: states at fixed processing elements, and the other way round."""
    nanosat = Point.of(Core(params=NANOSAT, configuration="nanosat"))
    forms = tuple(Form)
    return [
        *grid([Point()], n=STATES, m=(6,), q=("n",), r=(6,), pes=FIXED_PES, form=forms),
        *grid([nanosat], pes=range(1, NANOSAT.columns + 1), form=forms),
    ]


def markdown(record: list[dict[str, Any]]) -> str:
    """Write fitted exponents as a table."""
    over = {"n": "states", "pes": "processing elements"}
    lines = [
        "| Figure | over | range | cores | exponent | worst core off the fit |",
        "|--------|------|------:|-------|---------:|-----------------------:|",
    ]
    lines += [
        f"| {row['figure'].replace('_', ' ')} | {over[row['over']]} | {row['low']} to "
        f"{row['high']} | {row['group']} | {row['exponent']:+.2f} | {row['worst'] - 1.0:.0%} |"
        for row in record
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Sweep, fit, and write ``docs/measured/growth.json``."""
    cores = points()
    with Progress() as bars:
        bar = bars.add_task(f"{len(cores)} cores")
        outcome = sweep(
            cores, Questions(resources=False), Cache(CACHE), LocalExecutor(),
            lambda what, done, total: bars.update(bar, completed=done, total=total),
        )  # fmt: skip
    # The nanosatellite is one of the sizes, and would be there twice.
    states = [row for row in outcome.rows if row["configuration"] is None]
    elements = [row for row in outcome.rows if row["configuration"] is not None]
    record = [asdict(growth) for rows in (states, elements) for growth in growths(rows)]
    MEASURED.parent.mkdir(parents=True, exist_ok=True)
    MEASURED.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
