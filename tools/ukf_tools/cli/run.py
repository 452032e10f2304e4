"""Command ``ukf run``."""

from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from ukf_sw.problems.configurations import Problem
from ukf_sw.spec.core import Core
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    needs,
    number,
    print_json,
    progress_bars,
    results,
)
from ukf_tools.cli.judgement import print_accuracy, print_stop
from ukf_tools.cli.options import DATA, P0Option, PlotOption, SeedOption, with_core

__all__ = ["run"]


class BackendName(str, Enum):
    """What computes a run."""

    GOLDEN = "golden"
    REFERENCE = "reference"


@needs()
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
    runs: Annotated[
        int,
        typer.Option(
            "--runs",
            min=1,
            help="Runs with seeds that follow each other, judged together.",
            rich_help_panel=DATA,
        ),
    ] = 1,
    p0: P0Option = 1.0,
    plot: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a scenario on the golden model or on the float64 reference, and judge the estimates.

    The plot is that of the first run. The exit code is 1 if an error of the core stopped a run.
    """
    from ukf_sw.problems.judging import Track, accuracy, make_backend, run_problem
    from ukf_tools.evaluate.plots import plot_errors

    names = tuple(dict.fromkeys((backend.value, "reference")))
    tracks, records = [], []
    with progress_bars() as progress:
        bar = progress.add_task("Starting", total=None)
        for number in range(runs):
            with checked():
                problem = Problem(
                    configuration=core.configuration, params=core.params, seed=seed + number, P0=p0
                )
                scenario = problem.scenario(steps)
            found = {}
            for name in names:
                what = f"Running the {name}" + f", {number + 1} of {runs}" * (runs > 1)
                found[name] = run_problem(
                    make_backend(name, problem),
                    scenario,
                    scenario.steps,
                    lambda done, what=what, total=scenario.steps: progress.update(
                        bar, description=what, completed=done, total=total
                    ),
                )
            result = found[backend.value]
            other = None if backend is BackendName.REFERENCE else found["reference"]["x"]
            tracks.append(Track(scenario, result["x"], other))
            records.append({
                "seed": problem.seed,
                "steps": len(result["x"]),
                "stopped": result["stopped"],
                "last_estimate": result["last_x"].tolist(),
                "accuracy": accuracy(tracks[-1]),
            })  # fmt: skip
    record = {
        "configuration": core.configuration,
        **core.record(),
        "backend": backend.value,
        "P0": p0,
        "steps_requested": tracks[0].scenario.steps,
        "runs": records,
        "accuracy": accuracy(*tracks),
        "plot": None,
    }
    if len(tracks[0].x):
        estimates = {backend.value: tracks[0].x}
        if tracks[0].reference is not None:
            estimates["float64 reference"] = tracks[0].reference[: len(tracks[0].x)]
        image = plot or Path("build/plots") / f"run-{backend.value}-{core.stem}.png"
        record["plot"] = str(plot_errors(image, tracks[0].scenario, estimates, core.title))
    if as_json:
        print_json(record)
    else:
        _print_runs(record, core.title)
    if any(one["stopped"] is not None for one in records):
        raise typer.Exit(1)


def _print_runs(record: dict[str, Any], title: str) -> None:
    runs = record["runs"]
    wanted = record["steps_requested"] * len(runs)
    results.print(f"{title}: {sum(one['steps'] for one in runs)} of {wanted} steps")
    if len(runs) > 1:
        _print_each(runs)
    print_accuracy(record["accuracy"])
    for one in runs:
        print_stop(one)
    if record["plot"]:
        results.print(f"Plot: {record['plot']}", soft_wrap=True)


def _print_each(runs: list[dict[str, Any]]) -> None:
    """Print a line for each run: its first error, beside that of the reference."""
    judged = [one["accuracy"] for one in runs]
    name = next((next(iter(one["rms"])) for one in judged if one), "")
    attitude = any("below_0.1_degrees" in one for one in judged)
    table = Table("seed", f"rms of {name}", "ratio to the reference")
    if attitude:
        table.add_column("below 0.1 degrees")
    for one, found in zip(runs, judged, strict=True):
        reference = found.get("reference", {})
        row = [str(one["seed"]), number(found["rms"][name]) if found else "-"]
        row.append(number(reference.get("rms_ratio")))
        if attitude:
            row.append(f"{found['below_0.1_degrees']:.2%}" if found else "-")
        table.add_row(*row)
    results.print(table)
