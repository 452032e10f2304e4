"""Commands about the core itself: ``ukf generate``, ``ukf latency``."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from ukf_sw.spec.core import Core
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    needs,
    print_files,
    print_json,
    progress_bars,
    results,
)
from ukf_tools.cli.options import with_core

__all__ = ["generate", "latency"]


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
    output: Annotated[Path, typer.Option("--output", help="Folder to write to.")] = Path(
        "build/rtl"
    ),
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
    if output.exists() and not output.is_dir():
        fail(f"--output must be a folder, not the file {str(output)!r}")
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


@with_core
def latency(core: Core, as_json: JsonOption = False) -> None:
    """Print the cycles of every step, from the schedule: what the core's counter will read."""
    from ukf_tools.estimate.latency import latency as compute

    record = compute(core.params, core.pipeline)
    if as_json:
        print_json(record | core.record())
        return
    results.print(f"[bold]{core.title}[/]", soft_wrap=True)
    table = Table()
    table.add_column("step")
    table.add_column("cycles", justify="right")
    for name, cycles in record["steps"].items():
        table.add_row(name, str(cycles))
    table.add_row("total", str(record["total"]), style="bold", end_section=True)
    for name in ("INIT", "SIG_GEN", "SIG_GEN_PREDICTED", "UPDATE_REDRAWN", "COVARIANCE",
                 "COVARIANCE_PREDICTED"):  # fmt: skip
        table.add_row(name, str(record["programs"][name]))
    results.print(table)
    results.print(
        "SIG_GEN costs nothing after an UPDATE, which leaves the next sigma points. Below the "
        "total: the programs that an iteration does not run."
    )
