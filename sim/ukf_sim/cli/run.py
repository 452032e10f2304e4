"""Command ``ukf run``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ukf_sim.cli.console import JsonOption, checked, messages, print_json, progress_bars, results
from ukf_sim.cli.judgement import print_accuracy, print_stop
from ukf_sim.cli.options import DATA, Core, P0Option, PlotOption, SeedOption, with_core
from ukf_sim.configurations import Problem

__all__ = ["run"]


class BackendName(StrEnum):
    """What computes a run."""

    GOLDEN = "golden"
    REFERENCE = "reference"


@with_core
def run(
    core: Core,
    backend: Annotated[
        BackendName, typer.Option("--backend", help="What computes.", rich_help_panel=DATA)
    ] = BackendName.GOLDEN,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            min=1,
            help="Iterations; all of the scenario by default.",
            rich_help_panel=DATA,
        ),
    ] = None,
    seed: SeedOption = 0,
    p0: P0Option = 1.0,
    plot: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a scenario on the golden model or on the float64 reference, and judge the estimates.

    The exit code is 1 if an error of the core stopped the run.
    """
    with checked():
        problem = Problem(configuration=core.config, params=core.params, seed=seed, P0=p0)
        with messages.status("Simulating the sensors"):
            scenario = problem.scenario(steps)
    from ukf_sim.plots import plot_errors
    from ukf_sim.running import accuracy, make_backend, run_problem

    total = scenario.steps
    runs = {}
    names = dict.fromkeys((backend.value, "reference"))
    with progress_bars() as progress:
        bars = {name: progress.add_task(f"Running the {name}", total=total) for name in names}
        for name in names:
            runs[name] = run_problem(
                make_backend(name, problem),
                scenario,
                total,
                lambda done, bar=bars[name]: progress.update(bar, completed=done),
            )
    result = runs[backend.value]
    count = len(result["x"])
    other = runs["reference"]["x"] if backend is not BackendName.REFERENCE else None
    image = plot or Path("build/plots") / f"run-{backend.value}-{core.stem}.png"
    from ukf_sim.report import describe_params

    record = {
        "configuration": core.config,
        "parameters": describe_params(core.params, core.pipeline),
        "backend": backend.value,
        "seed": seed,
        "P0": p0,
        "steps_requested": total,
        "steps": count,
        "stopped": result["stopped"],
        "last_estimate": result["last_x"].tolist(),
        "accuracy": accuracy(scenario, result["x"], None if other is None else other[:count]),
        "plot": None,
    }
    if count:
        estimates = {f"{backend.value}": result["x"]}
        if other is not None:
            estimates["float64 reference"] = other[:count]
        record["plot"] = str(plot_errors(image, scenario, estimates, core.title))
    if as_json:
        print_json(record)
    else:
        results.print(f"{core.title}: {count} of {total} steps")
        print_accuracy(record["accuracy"])
        print_stop(record)
        if record["plot"]:
            results.print(f"Plot: {record['plot']}", soft_wrap=True)
    if record["stopped"] is not None:
        raise typer.Exit(1)
