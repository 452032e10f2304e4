"""Command ``ukf run``."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from ukf_sw.backends import make_backend
from ukf_sw.folders import check_file
from ukf_sw.problems.recipe import Recipe
from ukf_sw.spec.core import Core
from ukf_tools.cli.backends import need_backend
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    needs,
    number,
    print_json,
    progress_teller,
    results,
)
from ukf_tools.cli.judgement import print_judgement, print_stop
from ukf_tools.cli.options import DATA, PlotOption, with_recipe
from ukf_tools.cli.paths import IMAGES

# What takes long to import is imported by the command itself.
if TYPE_CHECKING:
    from ukf_sw.problems.judging import Judgement
    from ukf_sw.problems.running import Run

__all__ = ["run"]


@needs()
@with_recipe
def run(
    core: Core,
    recipe: Recipe,
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            metavar="NAME",
            help="What computes: golden, reference, cosim, uio:NUMBER, pynq:ADDRESS.",
            rich_help_panel=DATA,
        ),
    ] = "golden",
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            min=1,
            help="Iterations; all of the data by default.",
            rich_help_panel=DATA,
        ),
    ] = None,
    runs: Annotated[
        int,
        typer.Option(
            "--runs",
            min=1,
            help="Runs with seeds that follow each other, judged together.",
            rich_help_panel=DATA,
        ),
    ] = 1,
    plot: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run a filter over data on any backend, and judge the estimates beside the float64 reference.

    The plot is that of the first run. The exit code is 1 if an error of the core stopped a run.
    """
    need_backend(backend, core)
    from ukf_sw.errors import StepError, UkfError
    from ukf_sw.problems.judging import judge
    from ukf_sw.problems.running import run as run_filter
    from ukf_tools.evaluate.plots import plot_runs

    seeds = range(recipe.seed, recipe.seed + runs)
    with checked():
        recipe.check_seed(recipe.seed, runs)
        recipes = [replace(recipe, seed=each) for each in seeds]
        image = plot or Path("build/plots") / f"run-{backend.replace(':', '-')}-{core.stem}.png"
        check_file("--plot", image, IMAGES)
    found: dict[str, list[Run]] = {name: [] for name in dict.fromkeys((backend, "reference"))}
    with progress_teller() as tell:
        for number_of, each in enumerate(recipes, start=1):
            with checked():
                problem = each.scenario(steps)
            for name, made in found.items():
                what = f"Running the {name}" + f", {number_of} of {runs}" * (runs > 1)
                try:
                    with checked():
                        computer = make_backend(name, core.params, core.pipeline)
                        made.append(
                            run_filter(
                                problem, computer, ends_at=(StepError,), every=200,
                                progress=partial(tell, what),
                            )
                        )  # fmt: skip
                except UkfError as error:
                    fail(str(error), 1)
    own = found[backend]
    others = None if backend == "reference" else found["reference"]
    with checked():
        judged = judge(own, others)
        each_judged = [judge(*pair) for pair in zip(own, others or [None] * runs, strict=True)]
    if own[0].steps:
        drawn = {backend: own[0]}
        if others is not None:
            drawn["float64 reference"] = others[0]
        plot_runs(image, drawn, core.title)
    else:
        image = None
    if as_json:
        print_json({
            "problem": core.problem,
            **core.record(),
            "backend": backend,
            "P0": recipe.P0,
            "steps_requested": own[0].problem.steps,
            "runs": [
                _record(*row) for row in zip(seeds, own, each_judged, strict=True)
            ],
            "accuracy": judged.as_dict(),
            "reference_stopped": [
                one.stop.as_dict() for one in others or [] if one.stop is not None
            ],
            "plot": None if image is None else str(image),
        })  # fmt: skip
    else:
        wanted = own[0].problem.steps * runs
        results.print(f"{core.title}: {sum(one.steps for one in own)} of {wanted} steps")
        if runs > 1:
            _print_each(seeds, each_judged)
        print_judgement(judged)
        for one in own:
            print_stop(one)
        for one in others or []:
            if one.stop is not None:
                results.print(
                    f"[bold yellow]The reference stopped[/] after {one.stop.iteration} iterations, "
                    f"so there is no comparison: {one.stop.message}.",
                    soft_wrap=True,
                )
        if image is not None:
            results.print(f"Plot: {image}", soft_wrap=True)
    if any(one.stop is not None for one in own):
        raise typer.Exit(1)


def _record(seed: int, found: "Run", judged: "Judgement") -> dict[str, Any]:
    """Describe one run, ready for JSON."""
    return {
        "seed": seed,
        "steps": found.steps,
        "stopped": None if found.stop is None else found.stop.as_dict(),
        "last_estimate": None if found.last_x is None else found.last_x.tolist(),
        "accuracy": judged.as_dict(),
    }


def _print_each(seeds: range, judgements: "list[Judgement]") -> None:
    """Print a line for each run: its first error, beside that of the reference."""
    first = next((one for one in judgements if one.errors), None)
    if first is None:
        return
    table = Table("seed", f"rms of {first.errors[0].name}", "ratio to the reference")
    if first.limit is not None:
        table.add_column(f"below {first.limit:g} {first.errors[0].unit}")
    for seed, judged in zip(seeds, judgements, strict=True):
        row = [str(seed), number(judged.errors[0].rms if judged.errors else None)]
        row.append(number(judged.rms_ratio))
        if first.limit is not None:
            row.append("-" if judged.below_limit is None else f"{judged.below_limit:.2%}")
        table.add_row(*row)
    results.print(table)
