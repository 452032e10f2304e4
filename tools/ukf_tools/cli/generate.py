"""Command ``ukf generate``: write a core."""

from pathlib import Path
from typing import Annotated

from ukf_hdl.instance import Instance
from ukf_sw.spec.core import Core
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    needs,
    print_files,
    progress_bars,
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
from ukf_tools.cli.options import with_core
from ukf_tools.cli.paths import folder_option

__all__ = ["generate"]


@needs("hdl")
@with_core
def generate(
    core: Core,
    output: Annotated[Path, folder_option("--output", "Folder to write to.")] = Path("build/rtl"),
    name: NameOption = USUAL.name,
    base_address: BaseAddressOption = BASE_ADDRESS,
    interrupt: CoreInterruptOption = USUAL.interrupt,
    clock_mhz: ClockOption = USUAL.clock_mhz,
    as_json: JsonOption = False,
) -> None:
    """Write the core: Verilog, register map as JSON, SVD, device tree, Markdown; and its C driver.

    Of a problem, its models are written in C as well, for the filter in C: they compute what a core
    with these models would. Equal inputs give equal bytes.
    """
    with checked():
        instance = Instance(
            name=name,
            base_address=read_address(base_address),
            interrupt=interrupt,
            clock_mhz=clock_mhz,
        )
    from ukf_hdl.generate import generate as write

    with progress_bars(counted=False) as bars:
        bars.add_task("Generating", total=None)
        try:
            with checked():
                files = write(
                    core.params, core.pipeline, output, instance=instance,
                    models=models_in_c(core, name),
                )  # fmt: skip
        except OSError as error:
            fail(f"{output}: {error.strerror}", 1)
    print_files(files, as_json=as_json)
