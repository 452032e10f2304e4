"""Commands about many cores: ``ukf sweep``, ``ukf report``."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from ukf_sw.extras import require
from ukf_sw.problems.recipe import Recipe
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    make_progress,
    messages,
    needs,
    number,
    print_files,
    print_json,
    results,
)
from ukf_tools.cli.options import (
    DATA,
    IgnoreOption,
    LogOption,
    SeedOption,
    StartOption,
    log_files,
    with_points,
)
from ukf_tools.cli.paths import file_option, folder_option, source_option
from ukf_tools.design_space.points import Point

if TYPE_CHECKING:
    from ukf_tools.design_space.sweep import Questions

__all__ = ["report", "sweep"]

#: Steps of a run that accuracy is judged on, if there are as many.
STEPS = 2000
#: Panels of the help.
ASK, RUN = "What to find out", "Where to compute"


@needs("sweep", "hdl", "golden")
@with_points
def sweep(
    points: list[Point],
    resources: Annotated[
        bool, typer.Option(help="Synthesise: minutes for a core.", rich_help_panel=ASK)
    ] = True,
    accuracy: Annotated[
        str | None,
        typer.Option(
            help="Problem to judge accuracy on: of `ukf apps list`, or MODULE:ATTRIBUTE.",
            rich_help_panel=ASK,
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1, help=f"Its steps; {STEPS}, or all if it has fewer.", rich_help_panel=DATA
        ),
    ] = None,
    seed: SeedOption = 0,
    data: LogOption = None,
    ignore: IgnoreOption = None,
    start: StartOption = None,
    clock_mhz: Annotated[
        float, typer.Option(help="Clock for times, in MHz.", rich_help_panel=ASK)
    ] = 100.0,
    bus_latency: Annotated[
        float,
        typer.Option(
            help="Clocks of a bus word for times; 15.6: the 2018 paper's.", rich_help_panel=ASK
        ),
    ] = 15.6,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, help="Processes; one for each processor core by default.", rich_help_panel=RUN
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Dask scheduler to compute with, as tcp://host:8786.", rich_help_panel=RUN
        ),
    ] = None,
    cache: Annotated[
        Path, folder_option("--cache", "Folder of results.", rich_help_panel=RUN)
    ] = Path("build/design-space"),
    output: Annotated[
        Path,
        folder_option("--output", "Folder for sweep.parquet and sweep.csv.", rich_help_panel=RUN),
    ] = Path("build/sweep"),
    as_json: JsonOption = False,
) -> None:
    """Find out about many cores: cycles, resources, accuracy, time of an iteration.

    Options of the core take lists, as --pes 1,2,4-6, and --q n is q = n; every combination is a
    point. Results are kept: what was found once is not computed again, and an interrupted sweep
    goes on where it was. Points that are no legal core are named before the others are computed.
    The exit code is 1 if a point failed; the others are not lost.
    """  # fmt: skip
    from ukf_tools.design_space.cache import Cache
    from ukf_tools.design_space.executors import ClusterExecutor, ExecutorError, LocalExecutor
    from ukf_tools.design_space.rows import Conditions
    from ukf_tools.design_space.sweep import Questions
    from ukf_tools.design_space.sweep import sweep as compute
    from ukf_tools.design_space.table import TableError, write
    from ukf_tools.estimate.series7 import YosysError

    require(*["synth"] * resources, *["cluster"] * (scheduler is not None))
    with checked():
        questions = Questions(
            resources=resources,
            application=accuracy,
            seed=seed,
            logs=log_files(data, ignore, start),
            conditions=Conditions(clock_mhz=clock_mhz, word_clocks=bus_latency),
        )
        if accuracy is None and questions.logs is not None:
            raise ValueError("--data must come with --accuracy, which is judged on them")
        if accuracy is not None and not any(_judges(questions, point) for point in points):
            raise ValueError(f"--accuracy must have the sizes of a point, not {accuracy!r}")
        if accuracy is not None:
            # What is wrong with the data is said now, not in every row.
            made = Recipe.of(accuracy, seed=seed, logs=questions.logs).scenario(steps)
            questions = replace(questions, steps=steps or min(STEPS, made.steps))
    _tell_illegal(points)
    try:
        with checked():
            executor = (
                LocalExecutor(workers) if scheduler is None else ClusterExecutor(scheduler)
            )  # fmt: skip
        with _bar() as bars:
            bar = bars.add_task(f"{len(points)} points", total=None)

            def tell(what: str, done: float, total: float) -> None:
                text = f"{len(points)} points" + (f", last: {what}" if what else "")
                bars.update(bar, description=text, completed=done, total=total or None)

            outcome = compute(points, questions, Cache(cache), executor, tell)
        if isinstance(executor, ClusterExecutor):
            executor.close()
        files = write(outcome.rows, output)
    except (ExecutorError, TableError, YosysError, OSError) as error:
        fail(str(error), 1)
    except KeyboardInterrupt:
        messages.print("Interrupted. The same command goes on from here.")
        raise typer.Exit(130) from None
    if as_json:
        print_json({
            "points": outcome.rows, "found": outcome.found, "computed": outcome.computed,
            "failed": outcome.failed, "seconds": outcome.seconds,
            "files": [str(file) for file in files],
        })  # fmt: skip
    else:
        _print_rows(outcome.rows)
        results.print(
            f"{len(points)} points in {outcome.seconds:.1f} s: {outcome.computed} results "
            f"computed, {outcome.found} known before, {outcome.failed} failed"
        )
        for file in files:
            results.print(str(file), highlight=False, soft_wrap=True)
    if outcome.failed:
        raise typer.Exit(1)


def _judges(questions: "Questions", point: Point) -> bool:
    """Whether a core is legal, and its accuracy judged."""
    try:
        return questions.judges(point.core.params)
    except ValueError:
        return False


def _tell_illegal(points: list[Point]) -> None:
    """Say which points are no legal core, and why."""
    for point in points:
        try:
            _ = point.core
        except ValueError as error:
            messages.print(f"No core, and not computed: {error}", highlight=False, soft_wrap=True)


def _bar() -> Progress:
    """Show one bar with the time left; work is weighed by the time that it takes."""
    return make_progress(
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"), TextColumn("left"), TimeRemainingColumn(),
        # Parts take minutes; the estimate needs more of the past than by default.
        speed_estimate_period=3600.0,
    )  # fmt: skip


def _print_rows(rows: list[dict[str, Any]]) -> None:
    """Print what differs between points, and their main figures."""
    from ukf_tools.design_report.series import varying

    figures = {
        "cycles": "cycles", "iteration_us": "iteration / µs", "lut": "LUT", "ff": "FF",
        "dsp48e1": "DSP", "bram36": "BRAM36", "logic_ns": "logic / ns", "rms_ratio": "rms ratio",
    }  # fmt: skip
    if all(row["rms_ratio"] is None for row in rows):
        # Without truth, what is known is how far float64 is.
        figures["rms"] = next((row["error_name"] for row in rows if row["rms"] is not None), "rms")
    names = [*varying(rows), "pes"]
    shown = [name for name in figures if any(row[name] is not None for row in rows)]
    table = Table()
    for name in names:
        table.add_column(name.replace("_", " "))
    for name in shown:
        table.add_column(figures[name], justify="right")
    for row in rows:
        cells = ["-" if row[name] is None else str(row[name]) for name in names]
        for name in shown:
            value = row[name]
            if name == "rms_ratio" and row["stopped"] is not None:
                cells.append("stopped")
            else:
                cells.append(str(value) if isinstance(value, int) else number(value))
        table.add_row(*cells)
    results.print(table)
    for row in rows:
        label = ", ".join(f"{name} {row[name]}" for name in names)
        if row["stopped"] is not None:
            results.print(
                f"[yellow]{label}[/]: stopped after {row['steps']} steps, {row['stopped']}",
                highlight=False, soft_wrap=True,
            )  # fmt: skip
        if row["error"] is not None:
            results.print(
                f"[bold red]{label}[/]: {row['error']}", highlight=False, soft_wrap=True
            )  # fmt: skip


@needs("sweep")
def report(
    sweep_file: Annotated[
        Path, source_option("--sweep", "Parquet file of a sweep.", "a file of `ukf sweep`", "FILE")
    ] = Path("build/sweep/sweep.parquet"),
    output: Annotated[Path, file_option("--output", "Page to write.")] = Path("build/report.html"),
    figures: Annotated[
        Path | None, folder_option("--figures", "Folder for the charts as PNG; none by default.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a page of a sweep: charts, the 2018 paper's tables beside ours, a table to sort.

    It needs no network.
    """  # fmt: skip
    from ukf_tools.design_report.charts import draw, save
    from ukf_tools.design_report.page import render
    from ukf_tools.design_space.table import TableError, read

    try:
        rows = read(sweep_file)
        with checked():
            charts = draw(rows)
            page = render(rows, charts)
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(page, encoding="utf-8")
        files = [output, *(save(charts, figures) if figures is not None else [])]
    except (TableError, OSError) as error:
        fail(str(error), 1)
    if as_json:
        print_json({"files": [str(file) for file in files], "points": len(rows)})
        return
    print_files(files)
