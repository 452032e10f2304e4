"""Resources of the reference configuration: ``python -m ukf_docs.studies.resources``."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.progress import Progress

from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Pipeline
from ukf_tools.design_report import paper_2018
from ukf_tools.design_space.cache import CACHE, Cache
from ukf_tools.design_space.parts import Synthesis
from ukf_tools.design_space.sweep import find
from ukf_tools.estimate.series7 import FLOW, Netlist, tool_version

__all__ = ["MEASURED", "markdown"]

#: Numbers of processing elements of the 2018 paper's table 2.
PES = (1, 2, 5, 10)
#: The core, but for its number of processing elements.
CORE = Core(params=NANOSAT, configuration="nanosat")
#: Where the figures of the README come from.
MEASURED = Path(__file__).parents[2] / "measured" / "resources.json"


def _thousands(value: int) -> str:
    return f"{value:,}".replace(",", " ")


def markdown(record: dict[str, Any]) -> str:
    """Write the figures of :func:`main` as a table, beside those of the paper."""
    rows = [
        "| PEs | LUT | FF | DSP48E1 | BRAM36 | logic path | 2018 paper: LUT / FF / DSP / BRAM |",
        "|----:|----:|---:|--------:|-------:|-----------:|----------------------------------:|",
    ]
    for pes, row in record["pes"].items():
        used = paper_2018.RESOURCES[int(pes)]
        paper = f"{_thousands(used.lut)} / {_thousands(used.ff)} / {used.dsp} / {used.bram36:g}"
        rows.append(
            f"| {pes} | {row['lut']} | {row['ff']} | {row['dsp48e1']} | {row['bram36']:g} "
            f"| {row['logic_ns']:.2f} ns | {paper} |"
        )
    return "\n".join([*rows, "", f"{record['configuration']}; {record['tool']}.", ""])


def main() -> None:
    """Synthesise it, and write ``docs/measured/resources.json``."""
    rows: dict[str, dict[str, float]] = {}
    with Progress() as progress:
        for pes in progress.track(PES, description="synthesis"):
            part = Synthesis(params=replace(NANOSAT, pes=pes), pipeline=Pipeline())
            rows[str(pes)] = Netlist(**find(part, Cache(CACHE))).resources.as_dict()
    MEASURED.parent.mkdir(parents=True, exist_ok=True)
    record = {
        "configuration": f"{CORE.title_without('pes')}, default pipeline depths",
        "tool": f"{tool_version()}, {FLOW}",
        "pes": rows,
    }
    MEASURED.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
