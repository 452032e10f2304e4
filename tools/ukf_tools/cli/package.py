"""Commands that put a core into other people's tools: ``ukf package``, ``ukf testbench``."""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from ukf_hdl.instance import Instance
from ukf_hdl.packaging.boards import BOARDS, find_board
from ukf_sw.problems.recipe import Recipe
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
from ukf_tools.cli.instance import (
    BASE_ADDRESS,
    USUAL,
    BaseAddressOption,
    ClockOption,
    CoreInterruptOption,
    NameOption,
    read_address,
)
from ukf_tools.cli.models_in_c import models_in_c
from ukf_tools.cli.options import with_core, with_recipe
from ukf_tools.cli.paths import folder_option

__all__ = ["package", "write_testbench"]


@needs("hdl")
@with_core
def package(
    core: Core,
    board: Annotated[
        str | None, typer.Option("--board", help=f"Board: {', '.join(BOARDS)}.")
    ] = None,
    part: Annotated[
        str | None,
        typer.Option(
            "--part",
            help="Zynq-7000 in the place of a board, as xc7z045ffg900-2: pins and memory of the "
            "system are then yours to set.",
        ),
    ] = None,
    output: Annotated[Path, folder_option("--output", "Folder to write to.")] = Path(
        "build/package"
    ),
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Run the scripts on a model of Vivado.")
    ] = True,
    name: NameOption = USUAL.name,
    base_address: BaseAddressOption = BASE_ADDRESS,
    interrupt: CoreInterruptOption = USUAL.interrupt,
    clock_mhz: ClockOption = USUAL.clock_mhz,
    as_json: JsonOption = False,
) -> None:
    """Write the core with its C driver, scripts for Vivado, constraints, and device tree overlay.

    Of a problem, its models are written in C as well, as by `ukf generate`.
    Vivado has not run the scripts: they are checked on a model of its commands.
    """
    with checked():
        target = find_board(board, part)
        instance = Instance(
            name=name,
            base_address=read_address(base_address),
            interrupt=interrupt,
            clock_mhz=clock_mhz,
        )
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
            with checked():
                files = write(
                    core.params, core.pipeline, target, output, instance=instance,
                    models=models_in_c(core, name),
                )  # fmt: skip
            found = check_package(output) if check else None
        except OSError as error:
            fail(f"{output}: {error.strerror}", 1)
        except ScriptError as error:
            fail(str(error), 1)
    if as_json:
        print_json({
            "files": [str(file) for file in files],
            "checked": None if found is None else vars(found),
        })  # fmt: skip
        return
    print_files(files)
    if found is not None:
        results.print(
            f"Scripts: {found.commands} commands on a model of Vivado "
            f"{' and '.join(found.versions)}, no mistake found; "
            f"core at {found.address:#x}, {found.size} bytes, interrupt {found.interrupt}",
            highlight=False, soft_wrap=True,
        )  # fmt: skip


@needs("golden")
@with_recipe
def write_testbench(
    core: Core,
    recipe: Recipe,
    output: Annotated[Path, folder_option("--output", "Folder to write to.")] = Path(
        "build/testbench"
    ),
    steps: Annotated[int, typer.Option("--steps", min=1, help="Iterations of the filter.")] = 3,
    name: NameOption = USUAL.name,
    as_json: JsonOption = False,
) -> None:
    """Write a testbench in Verilog that replays the golden model's bus and compares every word.

    For simulators that know nothing of Python. It prints PASS or FAIL.
    """
    from ukf_sim.testbench import write

    try:
        files = write(recipe, steps, output, name=Instance(name=name).name)
    except ValueError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{output}: {error.strerror}", 1)
    print_files(files, as_json=as_json)
