"""Command ``ukf generate``: write a core."""

from pathlib import Path
from typing import Annotated

import typer

from ukf_sw.spec.core import Core
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    needs,
    print_files,
    progress_bars,
)
from ukf_tools.cli.options import with_core
from ukf_tools.cli.paths import folder_option

__all__ = ["generate"]


def _address(text: str) -> int:
    """Read a number, decimal or as 0x..."""
    try:
        return int(text, 0)
    except ValueError as error:
        raise ValueError(f"--base-address must be a number, as 0x43c00000, not {text!r}") from error


@needs("hdl")
@with_core
def generate(
    core: Core,
    output: Annotated[Path, folder_option("--output", "Folder to write to.")] = Path("build/rtl"),
    base_address: Annotated[
        str,
        typer.Option(
            "--base-address", metavar="ADDRESS", help="Of the core in the system, in bytes."
        ),
    ] = "0x43c00000",
    interrupt: Annotated[
        int, typer.Option("--interrupt", help="Number at the interrupt controller.")
    ] = 61,
    as_json: JsonOption = False,
) -> None:
    """Write the core: Verilog, register map as JSON, SVD, device tree, Markdown; and its C driver.

    Equal inputs give equal bytes.
    """
    from ukf_hdl.generate import generate as write

    with checked():
        address = _address(base_address)
    with progress_bars(counted=False) as bars:
        bars.add_task("Generating", total=None)
        try:
            with checked():
                files = write(
                    core.params, core.pipeline, output, base_address=address, interrupt=interrupt
                )
        except OSError as error:
            fail(f"{output}: {error.strerror}", 1)
    print_files(files, as_json=as_json)
