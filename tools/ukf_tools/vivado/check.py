"""Running the scripts of a package on the model of Vivado."""

from dataclasses import dataclass
from pathlib import Path

from ukf_tools.vivado.commands import VERSIONS
from ukf_tools.vivado.ips import PS7, ScriptError
from ukf_tools.vivado.model import Vivado

__all__ = ["Checked", "check_package"]


@dataclass(frozen=True, kw_only=True)
class Checked:
    """What was found; the same in every version.

    Parameters
    ----------
    versions
        Versions of Vivado.
    commands
        Number of Vivado's commands that ran.
    cells
        Cells of the block design.
    address, size
        Where the processor finds the core.
    interrupt
        Its number at the interrupt controller.
    clock_mhz
        Its clock, from the processor.
    """

    versions: tuple[str, ...]
    commands: int
    cells: tuple[str, ...]
    address: int
    size: int
    interrupt: int
    clock_mhz: float


def check_package(folder: Path) -> Checked:
    """Run the scripts of a package against the model, in all versions.

    Parameters
    ----------
    folder
        What :func:`ukf_hdl.packaging.package.package` wrote.

    Returns
    -------
    Checked

    Raises
    ------
    ScriptError
        At the first thing that is wrong.
    ModuleNotFoundError
        If Python has no tkinter, whose Tcl interpreter this needs (Debian: python3-tk).
    """
    for version in VERSIONS[:-1]:
        _check(folder, version)
    return _check(folder, VERSIONS[-1])


def _check(folder: Path, version: str) -> Checked:
    model = Vivado(folder, version)
    model.run(folder / "vivado" / "build.tcl")
    if model.board_part:
        store = Vivado(folder, version)
        store.run(folder / "vivado" / "install_board.tcl")
        model.commands += store.commands
    wanted = {f"{model.design}.{kind}" for kind in ("bit", "bit.bin", "hwh", "xsa")}
    if not wanted <= model.outputs:
        raise ScriptError(
            f"build.tcl must end with bit, bit.bin, hwh and xsa, not {sorted(model.outputs)}"
        )
    ((address, size),) = model.addresses.values()
    (processor,) = (config for ip, config in model.cells.values() if ip is PS7)
    return Checked(
        versions=VERSIONS,
        commands=model.commands,
        cells=tuple(name.lstrip("/") for name in model.cells),
        address=address,
        size=size,
        interrupt=model.interrupt(),
        clock_mhz=float(processor["PCW_FPGA0_PERIPHERAL_FREQMHZ"]),
    )
