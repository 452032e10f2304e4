"""Writes a core with everything to build a system of it in Vivado.

The scripts in ``vivado/`` are the same for every core and board. What differs is in one generated
file, ``settings.tcl``, which has it from the core itself.
"""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from ukf_hdl.generate import VIVADO_ATTRIBUTES, generate
from ukf_hdl.instance import Instance, address_range
from ukf_hdl.packaging.boards import Board
from ukf_sw import __version__
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Pipeline, UkfParams

__all__ = ["SCRIPTS", "check_place", "package"]

SCRIPTS = ("install_board.tcl", "package_ip.tcl", "block_design.tcl", "build.tcl")
_BUS, _BLOCK = "s_axi", "reg0"
#: Addresses of the processor's port M_AXI_GP0.
_WINDOW = range(0x4000_0000, 0x8000_0000)
#: Numbers of the processor's interrupts from the logic, IRQ_F2P[0] to IRQ_F2P[15].
_INTERRUPTS = (*range(61, 69), *range(84, 92))


def _port(kind: str) -> str:
    """Name of the port that carries a signal of a kind."""
    (port,) = (
        port
        for port, attributes in VIVADO_ATTRIBUTES.items()
        if attributes["X_INTERFACE_INFO"].startswith(f"xilinx.com:signal:{kind}:")
    )
    return port


def check_place(params: UkfParams, instance: Instance) -> None:
    """Check that a core can be at this place of a Zynq-7000.

    Raises
    ------
    ValueError
        If the processor has no such address or interrupt for the logic.
    """
    instance.check(params)
    last = instance.base_address + address_range(params) - 1
    if instance.base_address not in _WINDOW or last not in _WINDOW:
        raise ValueError(
            f"base_address must be from {_WINDOW[0]:#x} to {_WINDOW[-1]:#x}, the window of "
            f"M_AXI_GP0, not {instance.base_address:#x}"
        )
    if instance.interrupt not in _INTERRUPTS:
        raise ValueError(
            f"interrupt must be from 61 to 68 or from 84 to 91, those of IRQ_F2P, "
            f"not {instance.interrupt!r}"
        )


def _settings(core: Core, board: Board, instance: Instance) -> str:
    ports = {kind: _port(kind) for kind in ("clock", "reset", "interrupt")}
    values = {
        "core_name": instance.name,
        "core_vendor": "ukf",
        "core_version": ".".join(__version__.split(".")[:2]),
        "core_description": f"{{Unscented Kalman filter: {core.description}}}",
        "core_bus": _BUS,
        "core_block": _BLOCK,
        **{f"core_{kind}": port for kind, port in ports.items()},
        "core_interfaces": f"{{{' '.join((_BUS, *ports.values()))}}}",
        "core_base": f"{instance.base_address:#x}",
        "core_range": str(address_range(core.params)),
        "core_interrupt_bit": str(_INTERRUPTS.index(instance.interrupt)),
        "clock_mhz": f"{instance.clock_mhz:g}",
        "design_name": f"{instance.prefix.lower()}_system",
        "part": board.part,
        "board_parts": f"{{{' '.join(board.board_parts)}}}",
        "board_items": f"*:{board.name}:*",
    }
    lines = [f"set {name} {value}" for name, value in values.items()]
    return "\n".join([
        f"# What is special about this core on the {board.name}. Generated, do not edit.",
        "set root [file dirname [file dirname [file normalize [info script]]]]",
        *lines,
        "",
    ])  # fmt: skip


def _constraints(instance: Instance) -> str:
    return (
        "# For synthesis of the core by itself; in the block design its clock is FCLK_CLK0.\n"
        "# No port of the system is a pin of ours: those of the processor are in its preset.\n"
        f"create_clock -period {1000 / instance.clock_mhz:.3f} [get_ports {_port('clock')}]\n"
    )


def package(
    params: UkfParams,
    pipeline: Pipeline | None,
    board: Board,
    output: Path,
    *,
    engine=None,
    instance: Instance | None = None,
    models: Mapping[str, str] | None = None,
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
    instance
        Name of the core and its place; None is the usual one.
    models
        Models in C, as for :func:`ukf_hdl.generate.generate`.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    ValueError
        If the core cannot be at this place.
    OSError
        If the folder cannot be written.
    """
    instance = Instance() if instance is None else instance
    check_place(params, instance)
    written = generate(
        params, pipeline, output / "rtl", engine=engine, instance=instance, models=models
    )
    scripts = output / "vivado"
    scripts.mkdir(parents=True, exist_ok=True)
    sources = files("ukf_hdl.packaging") / "vivado"
    core = Core(params=params, pipeline=pipeline or Pipeline())
    contents = {
        scripts / "settings.tcl": _settings(core, board, instance),
        **{scripts / name: (sources / name).read_text(encoding="utf-8") for name in SCRIPTS},
        scripts / f"{instance.name}_ooc.xdc": _constraints(instance),
    }
    for path, text in contents.items():
        path.write_text(text, encoding="utf-8")
    return [*written, *contents]
