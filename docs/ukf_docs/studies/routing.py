"""Routed timing of the reference configuration: ``python -m ukf_docs.studies.routing``."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.progress import Progress

from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Pipeline
from ukf_tools.design_space.cache import CACHE, Cache
from ukf_tools.design_space.parts import Routing
from ukf_tools.design_space.sweep import find
from ukf_tools.estimate import ecp5, series7

__all__ = ["MEASURED", "markdown"]

#: The core, but for its number of processing elements.
CORE = Core(params=NANOSAT, configuration="nanosat")
#: Where the figures of the documentation come from.
MEASURED = Path(__file__).parents[2] / "measured" / "ecp5.json"
#: What is routed for them: processing elements, and seed of the placement. 10 take ten minutes.
CASES = ((1, 1), (1, 2), (2, 1), (2, 2), (5, 1), (10, 1))


def markdown(record: dict[str, Any]) -> str:
    """Write the figures of :func:`main` as a table."""
    lines = [
        "| PEs | seed | clock | longest path | of it routing | LUT4 | FF | MULT18X18D | DP16KD |",
        "|----:|-----:|------:|-------------:|--------------:|-----:|---:|-----------:|-------:|",
    ]
    lines += [
        f"| {row['pes']} | {row['seed']} | {row['mhz']:.1f} MHz | {row['path_ns']:.1f} ns "
        f"| {row['routing_ns'] / row['path_ns']:.0%} | {row['lut4']} | {row['ff']} "
        f"| {row['multipliers']} | {row['block_rams']} |"
        for row in record["rows"]
    ]
    return "\n".join(
        [*lines, "", f"{record['configuration']}; {record['tools']}; {ecp5.DEVICE}.", ""]
    )


def main() -> None:
    """Route it, and write ``docs/measured/ecp5.json``."""
    rows: list[dict[str, Any]] = []
    with Progress() as bars:
        for pes, seed in bars.track(CASES, description="routing"):
            part = Routing(params=replace(NANOSAT, pes=pes), pipeline=Pipeline(), seed=seed)
            rows.append({"pes": pes, "seed": seed, **find(part, Cache(CACHE))})
    record = {
        "configuration": f"{CORE.title_without('pes')}, default pipeline depths",
        "tools": f"{series7.tool_version()}, {ecp5.tool_version()}",
        "rows": rows,
    }
    MEASURED.parent.mkdir(parents=True, exist_ok=True)
    MEASURED.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
