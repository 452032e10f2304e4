"""Commands about what a core takes: ``ukf resources``, ``ukf timing``."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from ukf_sw.spec.core import Core
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    needs,
    print_json,
    progress_bars,
    results,
)
from ukf_tools.cli.lists import numbers
from ukf_tools.cli.options import with_core
from ukf_tools.cli.paths import folder_option

__all__ = ["resources", "timing"]

CacheOption = Annotated[
    Path, folder_option("--cache", "Folder of results, shared with `ukf sweep`.")
]
_CACHE = Path("build/design-space")


def _netlist(core: Core, cache: Path) -> Any:
    """Give the netlist of a core, with a bar while it is made."""
    from ukf_tools.design_space.cache import Cache
    from ukf_tools.design_space.parts import Synthesis
    from ukf_tools.design_space.sweep import find
    from ukf_tools.estimate.series7 import Netlist, YosysError

    part = Synthesis(params=core.params, pipeline=core.pipeline)
    try:
        with progress_bars(counted=False) as bars:
            bars.add_task(f"Synthesising {core.title}", total=None)
            return Netlist(**find(part, Cache(cache)))
    except (YosysError, OSError) as error:
        fail(str(error), 1)


@needs("hdl", "synth")
@with_core
def resources(core: Core, cache: CacheOption = _CACHE, as_json: JsonOption = False) -> None:
    """Estimate what the core takes of a 7-series FPGA: Yosys, before packing."""
    netlist = _netlist(core, cache)
    from ukf_tools.design_space.devices import DEVICES, share
    from ukf_tools.estimate.series7 import FLOW, tool_version

    found = netlist.resources
    fits = {device.name: share(found, device) for device in DEVICES}
    if as_json:
        print_json({
            **core.record(),
            "tool": f"{tool_version()}, {FLOW}",
            "resources": found.as_dict(), "cells": netlist.cells, "shares": fits,
        })  # fmt: skip
        return
    results.print(f"[bold]{core.title}[/]", soft_wrap=True)
    table = Table()
    table.add_column("resource")
    for heading in ("used", *(f"of {device.name}" for device in DEVICES)):
        table.add_column(heading, justify="right")
    used = {
        "LUT": found.lut, "FF": found.ff, "DSP48E1": found.dsp48e1, "BRAM36": found.bram36,
    }  # fmt: skip
    for name, value in used.items():
        table.add_row(name, f"{value:g}", *(f"{fits[d.name][name]:.1%}" for d in DEVICES))
    results.print(table)
    results.print(
        f"LUT: {found.lut_logic} logic, {found.lut_memory} memory, {found.lut_shift} shift "
        f"registers. {tool_version()}, {FLOW}"
    )


@needs("hdl", "synth")
@with_core
def timing(
    core: Core,
    clock_mhz: Annotated[
        float, typer.Option("--clock-mhz", min=1.0, help="Clock to compare with, in MHz.")
    ] = 100.0,
    ecp5: Annotated[
        bool,
        typer.Option("--ecp5", help="Place and route for a Lattice ECP5 as well: minutes."),
    ] = False,
    seeds: Annotated[str, typer.Option("--seeds", help="Seeds of its placement.")] = "1",
    cache: CacheOption = _CACHE,
    as_json: JsonOption = False,
) -> None:
    """Estimate the longest path of the core.

    On 7-series: delays of cells only, by Yosys; nothing is placed. With --ecp5: placed and routed
    for another family, which says what the architecture allows there, and not how fast a Zynq is.
    """
    with checked():
        chosen = numbers("--seeds", seeds)
    netlist = _netlist(core, cache)
    from ukf_tools.estimate.series7 import PATH, tool_version

    logic = netlist.path_ps / 1000
    record: dict[str, Any] = {
        **core.record(),
        "tool": tool_version(),
        "logic_ns": logic, "logic_ns_is": PATH, "clock_mhz": clock_mhz,
        "share_of_period": logic * clock_mhz / 1000, "ecp5": [],
    }  # fmt: skip
    if ecp5:
        record["ecp5"] = _route(core, chosen, cache)
    if as_json:
        print_json(record)
        return
    results.print(f"[bold]{core.title}[/]", soft_wrap=True)
    results.print(
        f"Logic path on 7-series: {logic:.2f} ns, {record['share_of_period']:.0%} of the period at "
        f"{clock_mhz:g} MHz. It is the {PATH}.",
        soft_wrap=True,
    )
    for row in record["ecp5"]:
        results.print(
            f"Routed on ECP5 ({row['device']}), seed {row['seed']}: {row['mhz']:.1f} MHz; "
            f"{row['path_ns']:.2f} ns, of these {row['routing_ns']:.2f} ns routing. "
            f"{row['lut4']} LUT4, {row['ff']} FF, {row['multipliers']} MULT18X18D, "
            f"{row['block_rams']} DP16KD",
            soft_wrap=True,
        )
    if ecp5:
        results.print("ECP5 is a proxy: another family, whose figures do not carry over to Zynq.")


def _route(core: Core, seeds: list[int], cache: Path) -> list[dict[str, Any]]:
    """Place and route with each seed."""
    from ukf_tools.design_space.cache import Cache
    from ukf_tools.design_space.parts import Routing
    from ukf_tools.design_space.sweep import find
    from ukf_tools.estimate.series7 import YosysError

    rows: list[dict[str, Any]] = []
    with progress_bars() as bars:
        bar = bars.add_task("Placing and routing for ECP5", total=len(seeds))
        for seed in seeds:
            part = Routing(params=core.params, pipeline=core.pipeline, seed=seed)
            try:
                rows.append({"seed": seed, **find(part, Cache(cache))})
            except (YosysError, OSError) as error:
                fail(str(error), 1)
            bars.advance(bar)
    return rows
