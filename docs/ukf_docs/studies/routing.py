"""Routed timing of the reference configuration on ECP5, a proxy: nothing open routes 7-series."""

from dataclasses import replace
from typing import Any

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.resources import CONFIGURATION
from ukf_docs.studies.study import Study, Tell
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.parameters import Pipeline
from ukf_tools.design_space.cache import CACHE, Cache
from ukf_tools.design_space.parts import Routing
from ukf_tools.design_space.sweep import find
from ukf_tools.estimate import ecp5, series7

__all__ = ["STUDY"]

#: What is routed: processing elements, and seed of the placement. 10 take ten minutes.
CASES = ((1, 1), (1, 2), (2, 1), (2, 2), (5, 1), (10, 1))


def _measure(tell: Tell) -> dict[str, Any]:
    """Route it."""
    rows: list[dict[str, Any]] = []
    for k, (pes, seed) in enumerate(CASES):
        tell(f"Routing, {pes} PEs, seed {seed}", k, len(CASES))
        part = Routing(params=replace(NANOSAT, pes=pes), pipeline=Pipeline(), seed=seed)
        rows.append({"pes": pes, "seed": seed, **find(part, Cache(CACHE))})
    return {
        "configuration": CONFIGURATION,
        "tools": f"{series7.tool_version()}, {ecp5.tool_version()}",
        "rows": rows,
    }


def _table(record: dict[str, Any]) -> str:
    headings = (
        "PEs", "seed", "clock", "longest path", "of it routing", "LUT4", "FF", "MULT18X18D",
        "DP16KD",
    )  # fmt: skip
    rows = [
        (
            row["pes"], row["seed"], f"{row['mhz']:.1f} MHz", f"{row['path_ns']:.1f} ns",
            f"{row['routing_ns'] / row['path_ns']:.0%}", row["lut4"], row["ff"],
            row["multipliers"], row["block_rams"],
        )
        for row in record["rows"]
    ]  # fmt: skip
    notes = f"\n{record['configuration']}; {record['tools']}; {ecp5.DEVICE}.\n"
    return table(headings, rows, left=0) + notes


STUDY = Study(
    name="routing", document=DOCS / "design-space.md", measure=_measure, tables={"routing": _table}
)
