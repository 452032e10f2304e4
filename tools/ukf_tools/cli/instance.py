"""Options that say what a core is called in a system and where it is there."""

from typing import Annotated

import typer

from ukf_hdl.instance import Instance

__all__ = [
    "BASE_ADDRESS",
    "USUAL",
    "BaseAddressOption",
    "ClockOption",
    "CoreInterruptOption",
    "NameOption",
    "read_address",
]

#: What a core is if nothing is said.
USUAL = Instance()
BASE_ADDRESS = f"{USUAL.base_address:#x}"
_SYSTEM = "The system"

NameOption = Annotated[
    str,
    typer.Option(
        "--name",
        help="Of the core: Verilog modules, files, IP, node of the device tree, and beginning of "
        "the macros in C (UKF for ukf_core). Cores of one system have different ones.",
        rich_help_panel=_SYSTEM,
    ),
]
BaseAddressOption = Annotated[
    str,
    typer.Option(
        "--base-address",
        metavar="ADDRESS",
        help="Of the registers, in bytes.",
        rich_help_panel=_SYSTEM,
    ),
]
CoreInterruptOption = Annotated[
    int,
    typer.Option(
        "--interrupt", help="Number at the interrupt controller.", rich_help_panel=_SYSTEM
    ),
]
ClockOption = Annotated[
    float,
    typer.Option("--clock-mhz", help="Frequency of the core's clock.", rich_help_panel=_SYSTEM),
]


def read_address(text: str) -> int:
    """Read ``--base-address``, decimal or as 0x...

    Raises
    ------
    ValueError
        If it is no number.
    """
    try:
        return int(text, 0)
    except ValueError as error:
        raise ValueError(f"--base-address must be a number, as 0x43c00000, not {text!r}") from error
