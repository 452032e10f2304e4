"""Command ``ukf baseline``."""

from pathlib import Path
from typing import Annotated

import typer

from ukf_tools.cli.console import JsonOption, fail, print_json, progress_bars, results
from ukf_tools.cli.paths import source_option

__all__ = ["baseline"]


def baseline(
    steps: Annotated[int, typer.Option("--steps", min=1, help="Iterations to count.")] = 20,
    sysroot: Annotated[
        Path | None,
        source_option(
            "--sysroot",
            "Folder of GSL for ARM, as fetch-gsl.sh beside its sources fetches it.",
            "a folder that is there",
            "FOLDER",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the core with the filter wholly in software on a Cortex-A9.

    Software is counted under qemu and costed by LLVM's model of the processor, so its times are
    brackets. Needs gcc-arm-linux-gnueabihf, qemu-user and llvm-14 (Debian).
    """
    from ukf_tools.baseline.executable import BaselineError
    from ukf_tools.baseline.report import markdown, measure

    try:
        with progress_bars(counted=False) as bars:
            bars.add_task("Compiling and counting", total=None)
            record = measure(steps, sysroot)
    except (BaselineError, ValueError, OSError) as error:
        fail(str(error), 1)
    if as_json:
        print_json(record)
        return
    for table in markdown(record).values():
        results.print(table, highlight=False, soft_wrap=True, markup=False)
