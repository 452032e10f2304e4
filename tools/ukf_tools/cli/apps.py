"""Command line of the applications: ``ukf apps``."""

import json
import time
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from ukf_tools.cli.console import (
    JsonOption,
    fail,
    messages,
    number,
    print_json,
    progress_teller,
    results,
)

# What takes long to import is imported by the commands that need it.

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
    Path, typer.Option("--output", help="Folder for figures and tables.")
]  # fmt: skip
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the data.")]
WorkersOption = Annotated[int, typer.Option("--workers", min=1, help="Processes.")]
FOLDER = Path("build/apps")


def _name_of(error: str, unit: str) -> str:
    return f"{error} / {unit}" if unit else error


def _measured(verdict: dict[str, Any], unit: str) -> str:
    """Name what a verdict is about."""
    kind = {"maximum": "largest ", "diverged": "diverged: "}.get(verdict["measure"], "")
    return kind + _name_of(verdict["error"], unit)


def _errors_table(record: dict[str, Any]) -> Table:
    """Make the table of one run."""
    since = "" if record["settled"] is None else f", after {record['settled']:g} s"
    runs = "" if record["runs"] == 1 else f", {record['runs']} runs"
    table = Table(
        title=f"{record['name']}, {record['backend']}: {record['steps']} steps{runs}{since}"
    )
    columns = ("error", "rms", "largest", "rms of float64", "published or independent", "bound")
    for heading in columns:
        table.add_column(heading, justify="left" if heading == "error" else "right")
    verdicts = {(v["error"], v["measure"]): v for v in record["verdicts"]}
    for row in record["errors"]:
        verdict = verdicts.get((row["error"], "rms")) or verdicts.get((row["error"], "maximum"))
        reference, bound = "-", "-"
        if verdict is not None:
            kind = "" if verdict["measure"] == "rms" else "largest "
            colour = "green" if verdict["okay"] else "bold red"
            reference = kind + number(verdict["reference"])
            limits = f"{number(verdict['low'])} to {number(verdict['high'])}"
            bound = f"[{colour}]{kind}{limits}[/]"
        table.add_row(
            _name_of(row["error"], row["unit"]), number(row["rms"]), number(row["maximum"]),
            number(row["float64_rms"]), reference, bound,
        )  # fmt: skip
    return table


def _print_record(record: dict[str, Any]) -> None:
    if record["errors"]:
        results.print(_errors_table(record))
    if record["stopped"] is not None:
        results.print(f"[bold red]Stopped:[/] {record['stopped']}", soft_wrap=True)
    if record["backend"] == "cosim":
        if record["mismatch"] is None:
            results.print(
                f"[bold green]Bit-exact[/]: {record['words_compared']} words equal the golden "
                "model's"
            )
        else:
            results.print(f"[bold red]Not bit-exact:[/] {record['mismatch']}", soft_wrap=True)
    elif not record["judged"]:
        results.print("Not judged: bounds are those of whole runs.")
    for plot in record["plots"]:
        results.print(f"Plot: {plot}", soft_wrap=True)


@apps_app.command("list")
def list_entries(as_json: JsonOption = False) -> None:
    """List the catalogue."""
    from ukf_sw.problems.catalogue import CATALOGUE
    from ukf_tools.evaluate.runner import EXTRA

    rows: list[dict[str, Any]] = []
    for entry in CATALOGUE.values():
        row: dict[str, Any] = {"name": entry.name, "doc": entry.doc, "source": entry.source}
        try:
            p = entry.scenario(0, 1).params
        except ModuleNotFoundError:
            row["needs"] = EXTRA
        else:
            row |= {"n": p.n, "q": p.q, "r": p.r, "m": p.m, "sigma_points": p.N}
        rows.append(row)
    if as_json:
        print_json(rows)
        return
    table = Table(title="Applications")
    for heading in ("name", "n q r m", "what", "source"):
        table.add_column(heading)
    for row in rows:
        sizes = row.get("needs") or f"{row['n']} {row['q']} {row['r']} {row['m']}"
        table.add_row(row["name"], sizes, row["doc"], row["source"])
    results.print(table)


@apps_app.command("run")
def run_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Entry, as `ukf apps list` says.")],
    backend: BackendOption = AppBackend.GOLDEN,
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
    from ukf_sim.simulators import SimulatorError
    from ukf_tools.evaluate.runner import run_entry

    with progress_teller() as tell:
        try:
            record = run_entry(
                name, backend.value, steps=steps, seed=seed, output=output, progress=tell
            )
        except ValueError as error:
            fail(str(error))
        except SimulatorError as error:
            fail(str(error), 1)
    if as_json:
        print_json(record)
    else:
        _print_record(record)
    if not record["okay"]:
        raise typer.Exit(1)


@apps_app.command("all")
def run_all(
    backend: BackendOption = AppBackend.GOLDEN,
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
    from ukf_sim.simulators import SimulatorError
    from ukf_sw.problems.catalogue import CATALOGUE
    from ukf_tools.evaluate.runner import run_catalogue

    records: list[dict[str, Any]] = []
    started = time.perf_counter()
    with progress_teller() as tell:

        def keep(own: list[dict[str, Any]]) -> None:
            records.extend(own)
            word = "okay" if all(record["okay"] for record in own) else "[bold red]wrong[/]"
            seconds = sum(record["seconds"] for record in own)
            messages.print(f"{own[0]['name']}: {word}, {seconds:.0f} s", highlight=False)

        try:
            for k, own in enumerate(
                run_catalogue(
                    backend.value, cosim_steps=cosim_steps, seed=seed, output=output,
                    workers=workers,
                )
            ):  # fmt: skip
                keep(own)
                tell("Applications", k + 1, len(CATALOGUE))
        except SimulatorError as error:
            fail(str(error), 1)
        flown = (r["name"] == "swampsat" and r["stopped"] is None for r in records)
        if study and any(flown):
            keep([_fly(output, backend.value, range(seed, seed + 5), workers, tell)])
    output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(records, indent=2) + "\n"
    (output / "errors.json").write_text(text, encoding="utf-8")
    okay = all(record["okay"] for record in records)
    if as_json:
        print_json(records)
    else:
        _print_summary(records)
        took = f"{(time.perf_counter() - started) / 60.0:.1f} minutes"
        results.print(f"{took} with {workers} worker{'s' * (workers != 1)}", highlight=False)
    if not okay:
        raise typer.Exit(1)


def _print_summary(records: list[dict[str, Any]]) -> None:
    """Print the table of all errors against their bounds."""
    table = Table(title="Errors of all applications")
    for heading in ("application", "backend", "error", "measured", "float64", "reference", "bound"):
        left = heading in ("application", "backend", "error")
        table.add_column(heading, justify="left" if left else "right")
    for record in records:
        name, backend = record["name"], record["backend"]
        if record["backend"] == "cosim":
            words = f"{record['words_compared']} words equal"
            verdict = f"[green]{words}[/]" if record["okay"] else "[bold red]differs[/]"
            table.add_row(name, backend, f"{record['steps']} steps", "-", "-", "-", verdict)
            continue
        if record["stopped"] is not None:
            table.add_row(name, backend, "stopped", "-", "-", "-", "[bold red]stopped[/]")
        rows = {row["error"]: row for row in record["errors"]}
        for verdict in record["verdicts"]:
            row = rows[verdict["error"]]
            colour = "green" if verdict["okay"] else "bold red"
            table.add_row(
                name, backend,
                _measured(verdict, row["unit"]),
                number(verdict["value"]),
                number(row["float64_rms"]) if verdict["measure"] == "rms" else "-",
                number(verdict["reference"]),
                f"[{colour}]{number(verdict['low'])} to {number(verdict['high'])}[/]",
            )  # fmt: skip
    results.print(table)
    wrong = [record["name"] for record in records if not record["okay"]]
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
) -> dict[str, Any]:
    """Run the study of SwampSat, keep it and its figures; gives its record."""
    from ukf_tools.evaluate.runner import EXTRA

    try:
        from ukf_tools.evaluate.swampsat import plot_study, run_study, study_record
    except ModuleNotFoundError as error:
        fail(f"{error.name} is not installed: {EXTRA}", 1)
    started = time.perf_counter()
    keywords = {} if duration is None else {"duration": duration}
    found = run_study(
        seeds=seeds, backend="reference" if backend == "reference" else "golden", workers=workers,
        progress=lambda done, total: tell("SwampSat", done, total), **keywords,
    )  # fmt: skip
    record = study_record(found)
    record["plots"] = [str(file) for file in plot_study(found, output)]
    text = json.dumps(found, allow_nan=False) + "\n"
    (output / "swampsat.json").write_text(text, encoding="utf-8")
    record["seconds"] = time.perf_counter() - started
    return record


@apps_app.command("swampsat")
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
    with progress_teller() as tell:
        try:
            record = _fly(output, backend, range(seeds), workers, tell, duration)
        except ValueError as error:
            fail(str(error))
    if as_json:
        print_json(record)
    else:
        from ukf_tools.evaluate.swampsat import table

        header, *rows = table(json.loads((output / "swampsat.json").read_text(encoding="utf-8")))
        printed = Table(*header)
        for row in rows:
            printed.add_row(*row)
        results.print(printed)
        if record["judged"]:
            _print_summary([record])
        else:
            results.print("Not judged: bounds are those of the whole study.")
        for figure in record["plots"]:
            results.print(figure, highlight=False, soft_wrap=True)
    if not record["okay"]:
        raise typer.Exit(1)
