"""Command ``ukf cosim``."""

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from ukf_sim.simulators import Simulator, SimulatorError
from ukf_sw.problems.configurations import Problem
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
from ukf_tools.cli.judgement import print_accuracy, print_stop
from ukf_tools.cli.options import (
    COSIM,
    DATA,
    BusLatencyOption,
    InterruptOption,
    P0Option,
    PlotOption,
    SeedOption,
    with_core,
)

__all__ = ["cosim"]


@needs("hdl", "sim", "golden")
@with_core
def cosim(
    core: Core,
    steps: Annotated[
        int, typer.Option("--steps", min=1, help="Iterations.", rich_help_panel=DATA)
    ] = 20,
    seed: SeedOption = 0,
    p0: P0Option = 1.0,
    plot: PlotOption = None,
    simulator: Annotated[
        Simulator, typer.Option("--simulator", help="Simulator.", rich_help_panel=COSIM)
    ] = Simulator.VERILATOR,
    interrupt: InterruptOption = True,
    bus_latency: BusLatencyOption = 0.0,
    cache: Annotated[
        Path,
        typer.Option("--cache", help="Folder of compiled cores.", rich_help_panel=COSIM),
    ] = Path("build/cosim"),
    as_json: JsonOption = False,
) -> None:
    """Run the software on the Verilog, compared with the golden model bit for bit.

    The exit code is 0 if every word agreed, also when both stopped with the same error, and 1 if
    not. Without a configuration, a random system of the given sizes is estimated.
    """
    try:
        simulator.require()
    except SimulatorError as error:
        fail(str(error), 1)
    with checked():
        if not math.isfinite(bus_latency):
            raise ValueError(f"--bus-latency must be a number of clocks, not {bus_latency!r}")
        problem = Problem(configuration=core.configuration, params=core.params, seed=seed, P0=p0)
        scenario = problem.scenario(steps)
    from ukf_sim.session import Job, cosimulate
    from ukf_sw.problems.judging import make_backend, run_problem
    from ukf_tools.evaluate.cosimulation_record import cosimulation_record
    from ukf_tools.evaluate.plots import plot_errors

    reference = run_problem(make_backend("reference", problem), scenario, steps)["x"]
    job = Job(
        params=core.params,
        pipeline=core.pipeline,
        task="ukf_sim.tasks:run_problem",
        arguments={"problem": problem, "steps": steps},
        interrupt=interrupt,
        word_clocks=bus_latency,
    )
    phases = {
        "generate": "Generating Verilog",
        "compile": f"Compiling for {simulator.value}",
        "simulate": "Simulating",
    }
    with progress_bars() as bars:
        bar = bars.add_task("Starting", total=None)

        def tell(phase: str, done: int) -> None:
            total = steps if phase == "simulate" else None
            bars.update(bar, description=phases[phase], completed=done, total=total)

        try:
            outcome = cosimulate(job, simulator, cache=cache, progress=tell)
        except SimulatorError as error:
            fail(str(error), 1)
    record = cosimulation_record(problem, job, simulator, steps, outcome, reference)
    image = plot or cache.parent / "plots" / f"cosim-{core.stem}.png"
    if len(outcome.result["x"]):
        count = len(outcome.result["x"])
        estimates = {"core, simulated": outcome.result["x"], "float64 reference": reference[:count]}
        record["plot"] = str(plot_errors(image, scenario, estimates, core.title))
    else:
        record["plot"] = None
    if as_json:
        print_json(record)
    else:
        _print_cosim(record, core.title)
    if not record["bit_exact"]:
        raise typer.Exit(1)


def _print_cosim(record: dict[str, Any], title: str) -> None:
    cycles, bus = record["cycles"], record["bus"]
    results.print(f"[bold]{title}[/]", soft_wrap=True)
    table = Table()
    for heading in ("step", "core", "schedule"):
        table.add_column(heading, justify="left" if heading == "step" else "right")
    for name, predicted in cycles["predicted"].items():
        table.add_row(name, str(cycles["steps"].get(name, "-")), str(predicted))
    table.add_row("total", str(cycles["total"]), str(cycles["predicted_total"]), style="bold")
    results.print(table)
    if bus["clocks_per_word"] is not None:
        results.print(
            f"Bus words per iteration: {bus['words_per_iteration']} "
            f"({bus['words_read']} read, {bus['words_written']} written), and "
            f"{bus['control_reads']} + {bus['control_writes']} of the registers; "
            f"{bus['clocks_per_word']:.1f} clocks a word"
        )
        results.print(
            f"Iteration, software apart: {record['clocks_per_iteration']} clocks. "
            f"Simulated {record['steps']} iterations with {record['simulator']}, "
            f"{record['mode']}, at {record['iterations_per_second']:.1f} a second"
        )
    print_accuracy(record["accuracy"])
    print_stop(record)
    if record["plot"]:
        results.print(f"Plot: {record['plot']}", soft_wrap=True)
    if record["bit_exact"]:
        results.print(
            f"[bold green]Bit-exact[/]: {record['words_compared']} words of the core equal the "
            "golden model's"
        )
    else:
        results.print(f"[bold red]Not bit-exact[/]: {record['mismatch']}", soft_wrap=True)
