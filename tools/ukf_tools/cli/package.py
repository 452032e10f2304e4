"""Commands that put a core into other people's tools: ``ukf package``, ``ukf testbench``."""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from ukf_hdl.packaging.boards import BOARDS
from ukf_sw.spec.core import Core
from ukf_tools.cli.console import (
    JsonOption,
    fail,
    needs,
    print_files,
    print_json,
    progress_bars,
    results,
)
from ukf_tools.cli.options import SeedOption, with_core
from ukf_tools.cli.paths import folder_option

__all__ = ["package", "write_testbench"]


@needs("hdl")
@with_core
def package(
    core: Core,
    board: Annotated[str, typer.Option("--board", help=f"Board: {', '.join(BOARDS)}.")],
    output: Annotated[Path, folder_option("--output", "Folder to write to.")] = Path(
        "build/package"
    ),
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Run the scripts on a model of Vivado.")
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Write the core with its C driver, scripts for Vivado, constraints, and device tree overlay.

    Vivado has not run the scripts: they are checked on a model of its commands.
    """
    if board not in BOARDS:
        fail(f"--board must be one of {', '.join(BOARDS)}, not {board!r}")
    if check:
        try:
            import_module("tkinter")
        except ModuleNotFoundError as error:
            fail(f"{error.name} is not installed (Debian: python3-tk); or give --no-check", 1)
    from ukf_hdl.packaging.package import package as write
    from ukf_tools.vivado.check import check_package
    from ukf_tools.vivado.ips import ScriptError

    with progress_bars(counted=False) as bars:
        bars.add_task("Packaging", total=None)
        try:
            files = write(core.params, core.pipeline, BOARDS[board], output)
            checked = check_package(output) if check else None
        except OSError as error:
            fail(f"{output}: {error.strerror}", 1)
        except ScriptError as error:
            fail(str(error), 1)
    if as_json:
        print_json({
            "files": [str(file) for file in files],
            "checked": None if checked is None else vars(checked),
        })  # fmt: skip
        return
    print_files(files)
    if checked is not None:
        results.print(
            f"Scripts: {checked.commands} commands on a model of Vivado, no mistake found; "
            f"core at {checked.address:#x}, {checked.size} bytes",
            highlight=False, soft_wrap=True,
        )  # fmt: skip


@needs("golden")
@with_core
def write_testbench(
    core: Core,
    output: Annotated[Path, folder_option("--output", "Folder to write to.")] = Path(
        "build/testbench"
    ),
    steps: Annotated[int, typer.Option("--steps", min=1, help="Iterations of the filter.")] = 3,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Write a testbench in Verilog that replays the golden model's bus and compares every word.

    For simulators that know nothing of Python. It prints PASS or FAIL.
    """
    from ukf_sim.testbench import write
    from ukf_sw.problems.recipe import Recipe

    try:
        recipe = Recipe(name=core.configuration, params=core.params, seed=seed)
        files = write(recipe, steps, output)
    except ValueError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{output}: {error.strerror}", 1)
    print_files(files, as_json=as_json)
