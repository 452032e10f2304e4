"""Command line of the applications: ``ukf apps``."""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from ukf_sw.backends import require_backend
from ukf_sw.extras import MissingExtraError
from ukf_sw.spec.core import PARAMETERS, Placement
from ukf_tools.cli.backends import need_simulation
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    messages,
    needs,
    number,
    print_json,
    progress_teller,
    results,
)
from ukf_tools.cli.judgement import name_of
from ukf_tools.cli.lists import entries
from ukf_tools.cli.paths import folder_option

# What takes long to import is imported by the commands that need it.
if TYPE_CHECKING:
    from ukf_sw.problems.judging import Judgement, Verdict
    from ukf_tools.evaluate.evaluation import Evaluation

__all__ = ["apps_app"]

apps_app = typer.Typer(
    name="apps",
    help="Systems that come with the package: from the papers, textbooks, and recorded data.",
    no_args_is_help=True,
)


class AppBackend(str, Enum):
    """What computes an entry."""

    REFERENCE = "reference"
    GOLDEN = "golden"
    COSIM = "cosim"


BackendOption = Annotated[
    AppBackend,
    typer.Option(
        "--backend",
        help="float64 reference, golden model, or Verilog in lockstep with the golden model.",
    ),
]
OutputOption = Annotated[
    Path, folder_option("--output", "Folder for figures and tables.")
]  # fmt: skip
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the data.")]
WorkersOption = Annotated[int, typer.Option("--workers", min=1, help="Processes.")]
FOLDER = Path("build/apps")


def _computer(made: "Evaluation") -> str:
    """Say what computed, with where the models were if they were not in software."""
    there = made.models is Placement.SOFTWARE
    return made.backend if there else f"{made.backend}, models {made.models.value}"


def _bound(verdict: "Verdict") -> str:
    """Show a bound, in the colour of the verdict."""
    colour = "green" if verdict.okay else "bold red"
    return f"[{colour}]{number(verdict.bound.low)} to {number(verdict.bound.high)}[/]"


def _difference(verdict: "Verdict | None") -> str:
    """Show by how much an error differs from that of the float64 reference."""
    if verdict is None or verdict.difference is None:
        return "-"
    return f"[{'green' if verdict.okay else 'bold red'}]{verdict.difference:+.2%}[/]"


def _errors_table(made: "Evaluation", judged: "Judgement") -> Table:
    """Make the table of one entry."""
    since = "" if made.settled is None else f", after {made.settled:g} s"
    runs = "" if made.runs == 1 else f", {made.runs} runs"
    table = Table(title=f"{made.name}, {_computer(made)}: {made.steps} steps{runs}{since}")
    columns = (
        "error", "rms", "largest", "rms of float64", "difference", "published or independent",
        "bound",
    )  # fmt: skip
    for heading in columns:
        table.add_column(heading, justify="left" if heading == "error" else "right")
    verdicts = {(v.error, v.bound.measure): v for v in made.verdicts or ()}
    others = judged.reference
    rounding = {v.error: v for v in made.rounding or ()}
    for k, error in enumerate(judged.errors):
        verdict = verdicts.get((error.name, "rms")) or verdicts.get((error.name, "maximum"))
        reference, bound = "-", "-"
        if verdict is not None:
            kind = "" if verdict.bound.measure == "rms" else "largest "
            reference = kind + number(verdict.bound.reference)
            bound = kind + _bound(verdict)
        table.add_row(
            name_of(error.name, error.unit), number(error.rms), number(error.maximum),
            number(None if others is None else others.errors[k].rms),
            _difference(rounding.get(error.name)), reference, bound,
        )  # fmt: skip
    return table


def _print_evaluation(made: "Evaluation") -> None:
    if made.judgement is not None and made.judgement.errors:
        results.print(_errors_table(made, made.judgement))
    if made.stopped is not None:
        results.print(f"[bold red]Stopped:[/] {made.stopped}", soft_wrap=True)
    if made.observed is not None:
        if made.observed.mismatch is None:
            results.print(
                f"[bold green]Bit-exact[/]: {made.observed.words_compared} words equal the golden "
                "model's"
            )
        else:
            results.print(f"[bold red]Not bit-exact:[/] {made.observed.mismatch}", soft_wrap=True)
    elif made.verdicts is None:
        results.print("Not judged: bounds are those of whole runs.")
    for plot in made.plots:
        results.print(f"Plot: {plot}", soft_wrap=True)


@apps_app.command("list")
def list_entries(as_json: JsonOption = False) -> None:
    """List the catalogue."""
    from ukf_sw.problems.catalogue import CATALOGUE

    rows: list[dict[str, Any]] = []
    for entry in CATALOGUE.values():
        p = entry.params
        row: dict[str, Any] = {"name": entry.name, "doc": entry.doc, "source": entry.source}
        row |= {"n": p.n, "q": p.q, "r": p.r, "m": p.m, "sigma_points": len(p.points)}
        try:
            entry.scenario(0, 1)
        except MissingExtraError as error:
            row["needs"] = error.command
        rows.append(row)
    if as_json:
        print_json(rows)
        return
    table = Table(title="Applications")
    for heading in ("name", "n q r m", "what", "source"):
        table.add_column(heading)
    for row in rows:
        sizes = f"{row['n']} {row['q']} {row['r']} {row['m']}"
        needs = f" Needs {row['needs']}." if "needs" in row else ""
        table.add_row(row["name"], sizes, escape(row["doc"] + needs), row["source"])
    results.print(table)


@apps_app.command("run")
@needs()
def run_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Entry, as `ukf apps list` says.")],
    backend: BackendOption = AppBackend.GOLDEN,
    models: Annotated[
        Placement, typer.Option("--models", help=PARAMETERS["models"].meaning.doc)
    ] = Placement.SOFTWARE,
    steps: Annotated[
        int | None,
        typer.Option("--steps", min=1, help="Steps; all by default, a few for a co-simulation."),
    ] = None,
    seed: SeedOption = 0,
    output: OutputOption = FOLDER,
    as_json: JsonOption = False,
) -> None:
    """Run an entry, compare its errors with the reference values, and draw them.

    The exit code is 1 if an error is outside of its bound, if the core stopped, or if the Verilog
    differs from the golden model.
    """
    require_backend(backend.value)
    if backend is AppBackend.COSIM:
        need_simulation()
    from ukf_sim.simulators import SimulatorError
    from ukf_tools.evaluate.evaluation import evaluate

    with progress_teller() as tell, checked():
        try:
            made = evaluate(
                name, backend.value, models=models, steps=steps, seed=seed, output=output,
                progress=tell,
            )  # fmt: skip
        except SimulatorError as error:
            fail(str(error), 1)
    if as_json:
        print_json(made.as_dict())
    else:
        _print_evaluation(made)
    if not made.okay:
        raise typer.Exit(1)


@apps_app.command("all")
@needs()
def run_all(
    backend: BackendOption = AppBackend.GOLDEN,
    models: Annotated[
        str | None,
        typer.Option(
            "--models",
            metavar="LIST",
            help="Where the models are, one run of each: software,core by default, of the "
            "reference software.",
        ),
    ] = None,
    cosim_steps: Annotated[
        int, typer.Option("--cosim-steps", min=0, help="Co-simulate so many steps of each as well.")
    ] = 0,
    study: Annotated[
        bool, typer.Option("--study/--no-study", help="Fly the whole study of SwampSat as well.")
    ] = True,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    output: OutputOption = FOLDER,
    as_json: JsonOption = False,
) -> None:
    """Run every entry; table of errors at the end.

    The exit code is 1 if anything is outside of its bound.
    """
    require_backend(backend.value)
    if cosim_steps or backend is AppBackend.COSIM:
        need_simulation()
    from ukf_sim.simulators import SimulatorError
    from ukf_sw.problems.catalogue import CATALOGUE
    from ukf_tools.evaluate.evaluation import evaluate_all

    with checked():
        placements = None
        if models is not None:
            placements = entries("--models", models, PARAMETERS["models"], ())
    evaluations: list[Evaluation] = []
    started = time.perf_counter()
    with progress_teller() as tell, checked():

        def keep(made: "list[Evaluation]") -> None:
            evaluations.extend(made)
            word = "okay" if all(each.okay for each in made) else "[bold red]wrong[/]"
            seconds = sum(each.seconds for each in made)
            messages.print(f"{made[0].name}: {word}, {seconds:.0f} s", highlight=False)

        try:
            for k, made in enumerate(
                evaluate_all(
                    backend.value, models=placements, cosim_steps=cosim_steps, seed=seed,
                    output=output, workers=workers,
                )
            ):  # fmt: skip
                keep(made)
                tell("Applications", k + 1, len(CATALOGUE))
        except SimulatorError as error:
            fail(str(error), 1)
        flown = (each.name == "swampsat" and each.stopped is None for each in evaluations)
        if study and any(flown):
            keep([_fly(output, backend.value, range(seed, seed + 5), workers, tell)])
    output.mkdir(parents=True, exist_ok=True)
    records = [each.as_dict() for each in evaluations]
    text = json.dumps(records, indent=2) + "\n"
    (output / "errors.json").write_text(text, encoding="utf-8")
    if as_json:
        print_json(records)
    else:
        _print_summary(evaluations)
        took = f"{(time.perf_counter() - started) / 60.0:.1f} minutes"
        results.print(f"{took} with {workers} worker{'s' * (workers != 1)}", highlight=False)
    if not all(each.okay for each in evaluations):
        raise typer.Exit(1)


def _print_summary(evaluations: "list[Evaluation]") -> None:
    """Print the table of all errors against their bounds."""
    table = Table(title="Errors of all applications")
    for heading in (
        "application", "backend", "error", "measured", "float64", "difference", "reference",
        "bound",
    ):  # fmt: skip
        left = heading in ("application", "backend", "error")
        table.add_column(heading, justify="left" if left else "right")
    kinds = {"maximum": "largest ", "diverged": "diverged: "}
    for made in evaluations:
        name, backend = made.name, _computer(made)
        if made.observed is not None:
            words = f"{made.observed.words_compared} words equal"
            verdict = f"[green]{words}[/]" if made.okay else "[bold red]differs[/]"
            table.add_row(name, backend, f"{made.steps} steps", "-", "-", "-", "-", verdict)
            continue
        if made.stopped is not None:
            table.add_row(name, backend, "stopped", "-", "-", "-", "-", "[bold red]stopped[/]")
        rounding = {verdict.error: verdict for verdict in made.rounding or ()}
        for each in made.verdicts or ():
            measure = each.bound.measure
            table.add_row(
                name, backend,
                kinds.get(measure, "") + name_of(each.error, each.unit),
                number(each.value),
                number(each.float64) if measure == "rms" else "-",
                _difference(rounding.pop(each.error, None) if measure == "rms" else None),
                number(each.bound.reference),
                _bound(each),
            )  # fmt: skip
        for each in rounding.values():  # errors without a bound of their own
            table.add_row(
                name, backend, name_of(each.error, each.unit), number(each.value),
                number(each.float64), _difference(each), "-", "-",
            )  # fmt: skip
    results.print(table)
    wrong = [made.name for made in evaluations if not made.okay]
    if wrong:
        results.print(f"[bold red]Outside of its bound:[/] {', '.join(wrong)}")
    else:
        results.print("[bold green]All within their bounds[/]")


def _fly(
    output: Path,
    backend: str,
    seeds: range,
    workers: int,
    tell: Callable[[str, int, int | None], None],
    duration: float | None = None,
) -> "Evaluation":
    """Run the study of SwampSat, keep it and its figures."""
    from ukf_sw.problems.systems.swampsat.flight import SETTINGS
    from ukf_tools.evaluate.swampsat import evaluate_study, plot_study, run_study

    started = time.perf_counter()
    found = run_study(
        seeds=seeds, duration=SETTINGS.duration if duration is None else duration,
        backend="reference" if backend == "reference" else "golden", workers=workers,
        progress=lambda done, total: tell("SwampSat", done, total),
    )  # fmt: skip
    plots = tuple(plot_study(found, output))
    text = json.dumps(found, allow_nan=False) + "\n"
    (output / "swampsat.json").write_text(text, encoding="utf-8")
    return replace(evaluate_study(found), plots=plots, seconds=time.perf_counter() - started)


@apps_app.command("swampsat")
@needs("apps")
def swampsat(
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Flights of each case.")] = 5,
    duration: Annotated[
        float | None, typer.Option("--duration", help="Seconds of a flight; 3000 by default.")
    ] = None,
    backend: Annotated[str, typer.Option("--backend", help="golden or reference.")] = "golden",
    workers: WorkersOption = 1,
    output: OutputOption = FOLDER,
    as_json: JsonOption = False,
) -> None:
    """Study SwampSat: QUEST, Murrell's filter and the core at every sampling interval.

    The exit code is 1 if an error is outside of its bound; whole flights of 5 seeds are judged.
    """
    require_backend(backend)
    with progress_teller() as tell, checked():
        made = _fly(output, backend, range(seeds), workers, tell, duration)
    if as_json:
        print_json(made.as_dict())
    else:
        from ukf_tools.evaluate.swampsat import table

        header, *rows = table(json.loads((output / "swampsat.json").read_text(encoding="utf-8")))
        printed = Table(*header)
        for row in rows:
            printed.add_row(*row)
        results.print(printed)
        if made.verdicts is not None:
            _print_summary([made])
        else:
            results.print("Not judged: bounds are those of the whole study.")
        for figure in made.plots:
            results.print(str(figure), highlight=False, soft_wrap=True)
    if not made.okay:
        raise typer.Exit(1)
