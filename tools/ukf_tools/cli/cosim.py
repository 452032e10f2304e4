"""Command ``ukf cosim``."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from ukf_sim.simulators import Simulator, SimulatorError
from ukf_sw.folders import check_file
from ukf_sw.problems.recipe import Recipe
from ukf_sw.spec.core import Core
from ukf_sw.spec.sequence import WAYS, Step
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    needs,
    print_json,
    progress_teller,
    results,
)
from ukf_tools.cli.judgement import print_judgement, print_stop
from ukf_tools.cli.names import with_sensor
from ukf_tools.cli.options import (
    COSIM,
    DATA,
    BusLatencyOption,
    InterruptOption,
    PlotOption,
    with_recipe,
)
from ukf_tools.cli.paths import IMAGES, file_option, folder_option

# What takes long to import is imported by the command itself.
if TYPE_CHECKING:
    from ukf_sim.cosimulation import Cosimulation
    from ukf_sw.problems.judging import Judgement

__all__ = ["cosim"]


@needs("hdl", "sim", "golden")
@with_recipe
def cosim(
    core: Core,
    recipe: Recipe,
    steps: Annotated[
        int, typer.Option("--steps", min=1, help="Iterations.", rich_help_panel=DATA)
    ] = 20,
    plot: PlotOption = None,
    simulator: Annotated[
        Simulator, typer.Option("--simulator", help="Simulator.", rich_help_panel=COSIM)
    ] = Simulator.VERILATOR,
    interrupt: InterruptOption = True,
    bus_latency: BusLatencyOption = 0.0,
    cache: Annotated[
        Path,
        folder_option("--cache", "Folder of compiled cores.", rich_help_panel=COSIM),
    ] = Path("build/cosim"),
    waves: Annotated[
        Path | None,
        file_option(
            "--waves",
            "Waveform to write, with lists of signals for GTKWave and Surfer: "
            + ", ".join(f"{each.tool.waves.suffix} for {each.value}" for each in Simulator)
            + ". Compiles and simulates slower.",
            rich_help_panel=COSIM,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run the software on the Verilog, compared with the golden model bit for bit.

    The exit code is 0 if every word agreed, also when both stopped with the same error, and 1 if
    not. Without a problem, a random system of the given sizes is estimated.
    """
    try:
        simulator.require()
        if waves is not None:
            with checked():
                simulator.require_waves(waves)
    except SimulatorError as error:
        fail(str(error), 1)
    from ukf_sim.cosimulation import cosimulate
    from ukf_sim.signal_lists import signal_lists
    from ukf_sw.errors import StepError
    from ukf_sw.problems.judging import judge
    from ukf_sw.problems.running import run
    from ukf_tools.evaluate.plots import plot_runs

    phases = {
        "generate": "Generating Verilog",
        "compile": f"Compiling for {simulator.value}",
        "simulate": "Simulating",
    }
    with checked():
        image = plot or Path("build/plots") / f"cosim-{core.stem}.png"
        check_file("--plot", image, IMAGES)
    with progress_teller() as tell, checked():
        try:
            found = cosimulate(
                recipe.scenario, steps, pipeline=core.pipeline, simulator=simulator,
                interrupt=interrupt, word_clocks=bus_latency, cache=cache, waves=waves,
                progress=lambda phase, done: tell(
                    phases[phase], done, steps if phase == "simulate" else None
                ),
            )  # fmt: skip
        except SimulatorError as error:
            fail(str(error), 1)
    with checked():
        reference = run(found.run.problem, steps=steps, ends_at=(StepError,))
        judged = judge(found.run, reference)
    if found.run.steps:
        drawn = {"core, simulated": found.run, "float64 reference": reference}
        plot_runs(image, drawn, core.title)
    else:
        image = None
    record = _record(core, recipe, simulator.value, found, judged)
    record["plot"] = None if image is None else str(image)
    record["waves"] = None
    if waves is not None:
        lists = {viewer: str(file) for viewer, file in signal_lists(waves).items()}
        record["waves"] = {"file": str(waves), **lists}
    if as_json:
        print_json(record)
    else:
        _print_cosim(core, record, found, judged)
    if found.mismatch is not None:
        raise typer.Exit(1)


def _record(
    core: Core,
    recipe: Recipe,
    simulator: str,
    found: "Cosimulation",
    judged: "Judgement",
) -> dict[str, Any]:
    """Describe a co-simulation, ready for JSON."""
    from ukf_tools.estimate.latency import latency

    predicted = latency(core.params, core.pipeline, redraws=found.run.problem.redraws)
    fullest, cycles = found.fullest, found.cycles
    words = sum(each.bus_words for each in found.iterations)
    own = found.run
    return {
        "problem": core.problem,
        **core.record(),
        "simulator": simulator,
        "mode": "interrupt" if found.job.interrupt else "polling",
        "bus_latency": found.job.word_clocks,
        "seed": recipe.seed,
        "P0": recipe.P0,
        "steps_requested": found.steps,
        "steps": own.steps,
        "bit_exact": found.mismatch is None,
        "mismatch": found.mismatch,
        "words_compared": found.words_compared,
        "stopped": None if own.stop is None else own.stop.as_dict(),
        "last_estimate": None if own.last_x is None else own.last_x.tolist(),
        "cycles": {
            "steps": {name: cycles[name] for name in predicted["steps"] if name in cycles},
            "total": sum(cycles.get(name, 0) for name in predicted["steps"]),
            "first": found.first_cycles | (found.iterations[0].cycles if fullest else {}),
            "predicted": predicted["steps"],
            "predicted_total": predicted["total"],
            "as_predicted": _as_predicted(found, predicted["programs"]),
        },
        "bus": {
            "words_per_iteration": 0 if fullest is None else fullest.traffic.words,
            "register_words": 0 if fullest is None else fullest.traffic.register_words,
            **({} if fullest is None else asdict(fullest.traffic)),
            "clocks_per_word": sum(each.bus_clocks for each in found.iterations) / words
            if words
            else None,
        },
        "clocks_per_iteration": None if fullest is None else fullest.clocks,
        "iterations_per_second": own.steps / found.seconds if own.steps else None,
        "compiled": found.build.compiled,
        "build_seconds": found.build.seconds,
        "simulation_seconds": found.simulation_seconds,
        "accuracy": judged.as_dict(),
    }


def _as_predicted(found: "Cosimulation", programs: dict[str, int]) -> bool:
    """Whether every step took the clocks of its schedule.

    Each reading was compared with the golden model's; this is the comparison with the schedule.
    """

    def possible(step: str) -> list[int]:
        name, of, sensor = step.partition(" of ")
        return [
            0 if way.program is None else programs[f"{way.program.name}{of}{sensor}"]
            for way in WAYS[Step[name]]
        ]

    return found.first_cycles.get("INIT") == programs["INIT"] and all(
        clocks in possible(step)
        for each in found.iterations
        for step, clocks in each.cycles.items()
    )


def _print_cosim(
    core: Core, record: dict[str, Any], found: "Cosimulation", judged: "Judgement"
) -> None:
    """Print a co-simulation; clocks and words as the record has them."""
    cycles, bus = record["cycles"], record["bus"]
    results.print(f"[bold]{core.title}[/]", soft_wrap=True)
    table = Table()
    for heading in ("step", "core", "schedule"):
        table.add_column(heading, justify="left" if heading == "step" else "right")
    for name, predicted in cycles["predicted"].items():
        row = (str(cycles["steps"].get(name, "-")), str(predicted))
        table.add_row(with_sensor(name, core.problem), *row)
    table.add_row("total", str(cycles["total"]), str(cycles["predicted_total"]), style="bold")
    results.print(table)
    if cycles["steps"].get("SIG_GEN", 0) > cycles["predicted"]["SIG_GEN"]:
        results.print(
            "SIG_GEN beyond the schedule of an iteration: nothing had been sampled after the "
            "predict before, so this one had to draw new sigma points first"
        )
    if found.iterations:
        traffic = found.traffic
        results.print(
            f"Bus words per iteration: {traffic.words} ({traffic.words_read} read, "
            f"{traffic.words_written} written, {traffic.starts} starts of steps), and "
            f"{traffic.register_words} to see their end, for NIS and masks; "
            f"{bus['clocks_per_word']:.1f} clocks a word"
        )
        results.print(
            f"Iteration, software apart: {record['clocks_per_iteration']} clocks. "
            f"Simulated {found.run.steps} iterations with {record['simulator']}, "
            f"{record['mode']}, at {record['iterations_per_second']:.1f} a second"
        )
    print_judgement(judged)
    print_stop(found.run)
    if record["plot"]:
        results.print(f"Plot: {record['plot']}", soft_wrap=True)
    if record["waves"]:
        save, commands = (Path(record["waves"][viewer]) for viewer in ("gtkwave", "surfer"))
        results.print(
            f"Waveform: {record['waves']['file']}. In that folder: gtkwave {save.name}, or "
            f"surfer --command-file {commands.name}",
            soft_wrap=True,
        )
    if found.mismatch is None:
        stop = found.run.stop
        until = "" if stop is None else f", until both stopped after {stop.iteration} iterations"
        results.print(
            f"[bold green]Bit-exact[/]: {found.words_compared} words of the core equal the "
            f"golden model's{until}"
        )
    else:
        results.print(f"[bold red]Not bit-exact[/]: {found.mismatch}", soft_wrap=True)
