"""Writes a core with everything to build a system of it in Vivado.

The scripts in ``vivado/`` are the same for every core and board. What differs is in one generated
file, ``settings.tcl``, which has it from the core itself.
"""

from importlib.resources import files
from pathlib import Path

from ukf_hdl.generate import BASE_ADDRESS, NAME, VIVADO_ATTRIBUTES, generate
from ukf_hdl.packaging.boards import Board
from ukf_sw import __version__
from ukf_sw.spec.core import Core
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline, UkfParams

__all__ = ["BASE", "CLOCK_MHZ", "SCRIPTS", "package"]

#: Physical address of the core: in the window of the processor's port M_AXI_GP0.
BASE = BASE_ADDRESS
#: Clock of the core; the estimates of resources and delays are for this one.
CLOCK_MHZ = 100
SCRIPTS = ("package_ip.tcl", "block_design.tcl", "build.tcl")
DESIGN = "ukf_system"
_BUS, _BLOCK = "s_axi", "reg0"
#: Smallest segment of Vivado's address editor, and page of Linux.
_PAGE = 4096


def _port(kind: str) -> str:
    """Name of the port that carries a signal of a kind."""
    (port,) = (
        port
        for port, attributes in VIVADO_ATTRIBUTES.items()
        if attributes["X_INTERFACE_INFO"].startswith(f"xilinx.com:signal:{kind}:")
    )
    return port


def address_range(params: UkfParams) -> int:
    """Bytes of the core's segment of the address space."""
    return max(1 << MemoryMap(params).address_width, _PAGE)


def _settings(core: Core, board: Board) -> str:
    ports = {kind: _port(kind) for kind in ("clock", "reset", "interrupt")}
    values = {
        "core_name": NAME,
        "core_vendor": "ukf",
        "core_version": ".".join(__version__.split(".")[:2]),
        "core_description": f"{{Unscented Kalman filter: {core.description}}}",
        "core_bus": _BUS,
        "core_block": _BLOCK,
        **{f"core_{kind}": port for kind, port in ports.items()},
        "core_interfaces": f"{{{' '.join((_BUS, *ports.values()))}}}",
        "core_base": f"{BASE:#x}",
        "core_range": str(address_range(core.params)),
        "clock_mhz": str(CLOCK_MHZ),
        "design_name": DESIGN,
        "part": board.part,
        "board_parts": f"{{{' '.join(board.board_parts)}}}",
    }
    lines = [f"set {name} {value}" for name, value in values.items()]
    return "\n".join([
        f"# What is special about this core on the {board.name}. Generated, do not edit.",
        "set root [file dirname [file dirname [file normalize [info script]]]]",
        *lines,
        "",
    ])  # fmt: skip


def _constraints() -> str:
    return (
        "# For synthesis of the core by itself; in the block design its clock is FCLK_CLK0.\n"
        "# No port of the system is a pin of ours: those of the processor are in its preset.\n"
        f"create_clock -period {1000 / CLOCK_MHZ:.3f} [get_ports {_port('clock')}]\n"
    )


def package(
    params: UkfParams, pipeline: Pipeline | None, board: Board, output: Path, *, engine=None
) -> list[Path]:
    """Write a core and its packaging to a folder. Equal inputs give equal files, byte for byte.

    Parameters
    ----------
    params, pipeline
        The core, as :func:`ukf_hdl.generate.generate` takes it.
    board
        The board.
    output
        Folder to write to; made if absent.
    engine
        As for :func:`ukf_hdl.generate.generate`, for tests.

    Returns
    -------
    list of Path
        The files written.
    """
    written = generate(params, pipeline, output / "rtl", engine=engine)
    scripts = output / "vivado"
    scripts.mkdir(parents=True, exist_ok=True)
    sources = files("ukf_hdl.packaging") / "vivado"
    core = Core(params=params, pipeline=pipeline or Pipeline())
    contents = {
        scripts / "settings.tcl": _settings(core, board),
        **{scripts / name: (sources / name).read_text(encoding="utf-8") for name in SCRIPTS},
        scripts / f"{NAME}_ooc.xdc": _constraints(),
    }
    for path, text in contents.items():
        path.write_text(text, encoding="utf-8")
    return [*written, *contents]
