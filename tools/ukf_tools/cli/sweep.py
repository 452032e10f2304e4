"""Commands about many cores: ``ukf sweep``, ``ukf report``."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from ukf_sw.problems.configurations import CONFIGURATIONS
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    messages,
    number,
    print_files,
    print_json,
    results,
)
from ukf_tools.cli.lists import numbers, pick, split
from ukf_tools.cli.options import BUILD, CORE, DATA, parse_format

__all__ = ["report", "sweep"]

_STAGES = Pipeline()
#: Panels of the help.
ASK, RUN = "What to find out", "Where to compute"


def _sizes(option: str, text: str | None, same_as: dict[str, int]) -> list[int | str]:
    """Numbers, or the letter of a size that it shall equal."""
    if text is None:
        return [0]
    if text.strip() in same_as:
        return [text.strip()]
    return list(numbers(option, text))


def _bases(
    config: str | None,
    sizes: dict[str, str | None],
    noises: dict[str, Noise | None],
    W0: float | None,
) -> list[tuple[str | None, UkfParams]]:
    """Make what a sweep starts from: configurations, or sizes.

    Raises
    ------
    ValueError
        If neither or both are given, or sizes are illegal.
    """
    given = {name: noise for name, noise in noises.items() if noise is not None}
    common: dict[str, Any] = {} if W0 is None else {"W0": W0}
    if config is not None:
        if given or any(text is not None for text in sizes.values()):
            raise ValueError("--config says sizes and noises already: give it or them, not both")
        names = split("--config", config)
        for name in names:
            if name not in CONFIGURATIONS:
                known = ", ".join(CONFIGURATIONS)
                raise ValueError(f"--config must be one of {known}, not {name!r}")
        return [(name, replace(CONFIGURATIONS[name].params, **common)) for name in names]
    if sizes["n"] is None or sizes["m"] is None:
        raise ValueError("--config, or at least --n and --m, must be given")
    lists: dict[str, list[int | str]] = {}
    for name, text in sizes.items():
        lists[name] = _sizes(f"--{name}", text, dict.fromkeys(lists, 0))
    bases: list[tuple[str | None, UkfParams]] = []
    for values in product(*lists.values()):
        chosen: dict[str, int] = {}
        for name, value in zip(lists, values, strict=True):
            chosen[name] = chosen[value] if isinstance(value, str) else value
        bases.append((None, UkfParams(**chosen, **given, **common)))
    return bases


def sweep(
    config: Annotated[
        str | None,
        typer.Option(
            help=f"Configurations: {', '.join(CONFIGURATIONS)}; or give sizes.",
            rich_help_panel=CORE,
        ),
    ] = None,
    n: Annotated[str | None, typer.Option(help="States.", rich_help_panel=CORE)] = None,
    m: Annotated[str | None, typer.Option(help="Observations; or n.", rich_help_panel=CORE)] = None,
    q: Annotated[
        str | None, typer.Option(help="Process noise terms; or n.", rich_help_panel=CORE)
    ] = None,
    r: Annotated[
        str | None, typer.Option(help="Observation noise terms; or m.", rich_help_panel=CORE)
    ] = None,
    process_noise: Annotated[
        Noise | None, typer.Option(help="How process noise enters.", rich_help_panel=CORE)
    ] = None,
    observation_noise: Annotated[
        Noise | None, typer.Option(help="How observation noise enters.", rich_help_panel=CORE)
    ] = None,
    w0: Annotated[
        float | None,
        typer.Option("--w0", help="Weight of sigma point 0, in [0, 1).", rich_help_panel=CORE),
    ] = None,
    pes: Annotated[str, typer.Option(help="Processing elements.", rich_help_panel=CORE)] = "1",
    form: Annotated[
        str, typer.Option(help="Forms: square-root, covariance.", rich_help_panel=CORE)
    ] = Form.SQUARE_ROOT.value,
    number_format: Annotated[
        str,
        typer.Option(
            "--format", help="Number formats, such as binary32,float6.17.", rich_help_panel=CORE
        ),
    ] = "binary32",
    multiply: Annotated[
        str,
        typer.Option("--multiply-stages", help="Latencies of a product.", rich_help_panel=BUILD),
    ] = str(_STAGES.multiply),
    add: Annotated[
        str, typer.Option("--add-stages", help="Latencies of a sum.", rich_help_panel=BUILD)
    ] = str(_STAGES.add),
    root: Annotated[
        str,
        typer.Option(
            "--reciprocal-sqrt-stages", help="Latencies of 1/sqrt.", rich_help_panel=BUILD
        ),
    ] = str(_STAGES.reciprocal_sqrt),
    resources: Annotated[
        bool, typer.Option(help="Synthesise: minutes for a core.", rich_help_panel=ASK)
    ] = True,
    accuracy: Annotated[
        str | None,
        typer.Option(
            help="Application to judge accuracy on: a configuration, or a name of `ukf apps list`.",
            rich_help_panel=ASK,
        ),
    ] = None,
    steps: Annotated[int, typer.Option(min=1, help="Its steps.", rich_help_panel=DATA)] = 2000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of its data.", rich_help_panel=DATA)] = 0,
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
    cache: Annotated[Path, typer.Option(help="Folder of results.", rich_help_panel=RUN)] = Path(
        "build/design-space"
    ),
    output: Annotated[
        Path, typer.Option(help="Folder for sweep.parquet and sweep.csv.", rich_help_panel=RUN)
    ] = Path("build/sweep"),
    as_json: JsonOption = False,
) -> None:
    """Find out about many cores: cycles, resources, accuracy, time of an iteration.

    Options of the core take lists, as --pes 1,2,4-6; every combination is a point. Results are
    kept: what was found once is not computed again, and an interrupted sweep goes on where it was.
    The exit code is 1 if a point failed; the others are not lost.
    """  # fmt: skip
    from ukf_tools.design_space.accuracy import Application
    from ukf_tools.design_space.cache import Cache
    from ukf_tools.design_space.executors import ClusterExecutor, ExecutorError, LocalExecutor
    from ukf_tools.design_space.points import grid
    from ukf_tools.design_space.rows import Conditions
    from ukf_tools.design_space.sweep import Questions
    from ukf_tools.design_space.sweep import sweep as compute
    from ukf_tools.design_space.table import TableError, write
    from ukf_tools.estimate.resources import YosysError

    if output.exists() and not output.is_dir():
        fail(f"--output must be a folder, not the file {str(output)!r}")
    with checked():
        bases = _bases(
            config,
            {"n": n, "m": m, "q": q, "r": r},
            {"process_noise": process_noise, "observation_noise": observation_noise},
            w0,
        )
        stages = [
            numbers(option, text)
            for option, text in (
                ("--multiply-stages", multiply), ("--add-stages", add),
                ("--reciprocal-sqrt-stages", root),
            )
        ]  # fmt: skip
        points = grid(
            bases,
            pes=numbers("--pes", pes),
            forms=pick("--form", form, Form),
            formats=pick("--format", number_format, parse_format),
            pipelines=[
                Pipeline(multiply=a, add=b, reciprocal_sqrt=c) for a, b, c in product(*stages)
            ],
        )
        application = None
        if accuracy is not None:
            application = Application(name=accuracy, steps=steps, seed=seed)
            if not any(application.fits(base) for _, base in bases):
                raise ValueError(f"--accuracy must have the sizes of a point, not {accuracy!r}")
        questions = Questions(
            resources=resources,
            application=application,
            conditions=Conditions(clock_mhz=clock_mhz, word_clocks=bus_latency),
        )
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


def _bar() -> Progress:
    """Show one bar with the time left; work is weighed by the time that it takes."""
    return Progress(
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"), TextColumn("left"), TimeRemainingColumn(),
        console=messages, transient=True,
        # Parts take minutes; the estimate needs more of the past than by default.
        speed_estimate_period=3600.0,
    )  # fmt: skip


def _print_rows(rows: list[dict[str, Any]]) -> None:
    """Print what differs between points, and their main figures."""
    figures = {
        "cycles": "cycles", "iteration_us": "iteration / µs", "lut": "LUT", "ff": "FF",
        "dsp48e1": "DSP", "bram36": "BRAM36", "logic_ns": "logic / ns", "rms_ratio": "rms ratio",
    }  # fmt: skip
    names = [
        name
        for name in (
            "configuration", "n", "m", "q", "r", "form", "format", "multiply_stages", "add_stages",
            "reciprocal_sqrt_stages", "pes",
        )
        if name == "pes" or len({row[name] for row in rows}) > 1
    ]  # fmt: skip
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


def report(
    sweep_file: Annotated[Path, typer.Option("--sweep", help="Parquet file of a sweep.")] = Path(
        "build/sweep/sweep.parquet"
    ),
    output: Annotated[Path, typer.Option(help="Page to write.")] = Path("build/report.html"),
    figures: Annotated[
        Path | None, typer.Option(help="Folder for the charts as PNG; none by default.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a page of a sweep: charts, the 2018 paper's tables beside ours, a table to sort.

    It needs no network.
    """  # fmt: skip
    from ukf_tools.design_space.table import TableError, read

    try:
        from ukf_tools.design_report.charts import draw, save
        from ukf_tools.design_report.page import render
    except ModuleNotFoundError as error:
        fail(f"Install the extra `sweep` for reports ({error})", 1)
    try:
        rows = read(sweep_file)
        with checked():
            charts = draw(rows)
            page = render(rows, charts)
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(page, encoding="utf-8")
        files = [output, *(save(charts, figures) if figures is not None else [])]
    except FileNotFoundError:
        fail(f"--sweep must be a file of `ukf sweep`, not {str(sweep_file)!r}")
    except (TableError, OSError) as error:
        fail(str(error), 1)
    if as_json:
        print_json({"files": [str(file) for file in files], "points": len(rows)})
        return
    print_files(files)
