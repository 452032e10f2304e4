"""Resources of the reference configuration on Xilinx 7-series, as Yosys estimates them."""

from dataclasses import replace
from typing import Any

from ukf_docs import README
from ukf_docs.markdown import table, thousands
from ukf_docs.studies.study import Study, Tell
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Pipeline
from ukf_tools.design_report import paper_2018
from ukf_tools.design_space.cache import CACHE, Cache
from ukf_tools.design_space.parts import Synthesis
from ukf_tools.design_space.sweep import find
from ukf_tools.estimate.series7 import FLOW, Netlist, tool_version

__all__ = ["CONFIGURATION", "STUDY"]

#: Numbers of processing elements of the 2018 paper's table 2.
PES = (1, 2, 5, 10)
#: The core, but for its number of processing elements.
CONFIGURATION = (
    Core(params=NANOSAT, problem="nanosat").title_without("pes") + ", default pipeline depths"
)


def _measure(tell: Tell) -> dict[str, Any]:
    """Synthesise it."""
    rows: dict[str, dict[str, float]] = {}
    for k, pes in enumerate(PES):
        tell(f"Synthesis, {pes} PEs", k, len(PES))
        part = Synthesis(params=replace(NANOSAT, pes=pes), pipeline=Pipeline())
        rows[str(pes)] = Netlist(**find(part, Cache(CACHE))).resources.as_dict()
    return {
        "configuration": CONFIGURATION,
        "tool": f"{tool_version()}, {FLOW}",
        "pes": rows,
    }


def _table(record: dict[str, Any]) -> str:
    """Write the figures beside those of the paper."""
    headings = (
        "PEs", "LUT", "FF", "DSP48E1", "BRAM36", "logic path",
        "2018 paper: LUT / FF / DSP / BRAM",
    )  # fmt: skip
    rows: list[tuple[object, ...]] = []
    for pes, row in record["pes"].items():
        used = paper_2018.RESOURCES[int(pes)]
        paper = f"{thousands(used.lut)} / {thousands(used.ff)} / {used.dsp} / {used.bram36:g}"
        rows.append((
            pes, row["lut"], row["ff"], row["dsp48e1"], f"{row['bram36']:g}",
            f"{row['logic_ns']:.2f} ns", paper,
        ))  # fmt: skip
    return table(headings, rows, left=0) + f"\n{record['configuration']}; {record['tool']}.\n"


STUDY = Study(name="resources", document=README, measure=_measure, tables={"resources": _table})
