"""Running the scripts of a package on the model of Vivado."""

from dataclasses import dataclass
from pathlib import Path

from ukf_tools.vivado.ips import PS7, ScriptError
from ukf_tools.vivado.model import Vivado

__all__ = ["Checked", "check_package"]


@dataclass(frozen=True, kw_only=True)
class Checked:
    """What was found.

    Parameters
    ----------
    commands
        Number of Vivado's commands that ran.
    cells
        Cells of the block design.
    address, size
        Where the processor finds the core.
    clock_mhz
        Its clock, from the processor.
    """

    commands: int
    cells: tuple[str, ...]
    address: int
    size: int
    clock_mhz: float


def check_package(folder: Path) -> Checked:
    """Run the scripts of a package against the model.

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
    model = Vivado(folder)
    model.run(folder / "vivado" / "build.tcl")
    if not {f"{model.design}.bit", f"{model.design}.hwh", f"{model.design}.xsa"} <= model.outputs:
        raise ScriptError(f"build.tcl must end with bit, hwh and xsa, not {sorted(model.outputs)}")
    ((address, size),) = model.addresses.values()
    (processor,) = (config for ip, config in model.cells.values() if ip is PS7)
    return Checked(
        commands=model.commands,
        cells=tuple(name.lstrip("/") for name in model.cells),
        address=address,
        size=size,
        clock_mhz=float(processor["PCW_FPGA0_PERIPHERAL_FREQMHZ"]),
    )
