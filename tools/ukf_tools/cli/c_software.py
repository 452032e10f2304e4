"""Commands about the C software: ``ukf export``, ``ukf c-loop``, ``ukf c-arm``."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.table import Table

from ukf_sw.errors import TraceError, add_note
from ukf_sw.extras import require
from ukf_sw.problems.finding import is_own
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.systems.nanosat import attitude_error
from ukf_sw.spec.core import Core, Placement
from ukf_sw.spec.float_format import BINARY32, BINARY64
from ukf_tools.cli.console import (
    JsonOption,
    checked,
    fail,
    messages,
    needs,
    print_files,
    print_json,
    progress_bars,
    results,
)
from ukf_tools.cli.options import (
    COSIM,
    DATA,
    BusLatencyOption,
    InterruptOption,
    PlotOption,
    with_recipe,
)
from ukf_tools.cli.paths import folder_option

if TYPE_CHECKING:
    from ukf_sw.problem import Problem
    from ukf_sw.problems.scenario_files import CResults

__all__ = ["c_arm", "c_loop", "export"]

#: Iterations by default.
STEPS, ARM_STEPS = 1000, 100


def _steps_option(default: int) -> Any:
    """Option of a number of steps."""
    text = f"Iterations; by default {default}, or as many as a problem of yours has data for."
    return typer.Option("--steps", min=1, help=text, rich_help_panel=DATA)


CModelsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--c-models",
        metavar="FILE.c",
        help="C file with models of your own and ukf_application(); may be given several times. By "
        "default the models in C are written from those in Python.",
        rich_help_panel=DATA,
    ),
]


def _check_models(core: Core, models: list[Path]) -> None:
    """Check that there can be models in C for a problem, and a driver for the core."""
    if core.problem is None and models:
        raise ValueError("--c-models must be of a --problem, not of sizes alone")
    if models and Placement.of(core.params.models) is Placement.CORE:
        raise ValueError(
            "--c-models must not be given with all models on the core, which calls none in C, not "
            f"{str(models[0])!r}"
        )
    for file in models:
        if file.suffix != ".c":
            raise ValueError(f"--c-models must be C files, which end with .c, not {str(file)!r}")
        if not file.is_file():
            raise ValueError(f"--c-models must be files that exist, not {str(file)!r}")
    if core.params.format not in (BINARY32, BINARY64):
        raise ValueError(
            "--format must be one that C has, binary32 or binary64, not "
            f"{core.params.format.name!r}"
        )


@contextmanager
def _models_written() -> Iterator[None]:
    """Say what to do about a model that cannot be written in C."""
    try:
        yield
    except TraceError as error:
        add_note(error, "or write the models in C yourself, and give them with --c-models FILE.c")
        raise


def _scenario(recipe: Recipe, steps: int | None, default: int) -> "tuple[Problem, int]":
    """Make a scenario, and say how many of its steps are to be run."""
    own = recipe.logs is not None or (recipe.name is not None and is_own(recipe.name))
    if steps is None and own:
        made = recipe.scenario()
        return made, min(made.steps, default)
    count = default if steps is None else steps
    return recipe.scenario(count), count


def _print_warnings(text: str) -> None:
    """Print what the compiler says about the files of the user."""
    messages.print(text.rstrip(), highlight=False, soft_wrap=True, markup=False)


@needs()
@with_recipe
def export(
    core: Core,
    recipe: Recipe,
    steps: Annotated[int | None, _steps_option(STEPS)] = None,
    random: Annotated[
        bool,
        typer.Option("--random", help="A random system of the given sizes.", rich_help_panel=DATA),
    ] = False,
    output: Annotated[Path, folder_option("--output", "Folder to write to.")] = Path(
        "build/scenario"
    ),
    as_json: JsonOption = False,
) -> None:
    """Write parameters and sensor data for C programs: a binary file and a C header.

    Inputs are what the models that `ukf generate` writes take: its ukf_problem.h lists them.
    """
    from ukf_sw.problems.placing import example_of
    from ukf_sw.problems.scenario_files import export_scenario
    from ukf_sw.tracing.inputs import InputVector

    with checked():
        if (core.problem is None) is not random:
            raise ValueError(
                "export must have --problem, whose data it writes, or sizes and --random for a "
                f"random system, not {'sizes alone' if core.problem is None else 'both'}"
            )
        try:
            made, steps = _scenario(recipe, steps, STEPS)
            inputs = InputVector.of(made)
            if inputs.choices and recipe.name is not None:
                # The models are numbered in the order in which `ukf generate` meets them.
                known = InputVector.of(example_of(recipe.name))
                inputs = known if set(known.choices) == set(inputs.choices) else inputs
            files = export_scenario(made, steps, output, inputs)
        except OSError as error:
            fail(f"{output}: {error.strerror}", 1)
    print_files(files, as_json=as_json)


@needs("hdl", "golden")
@with_recipe
def c_loop(
    core: Core,
    recipe: Recipe,
    c_models: CModelsOption = None,
    steps: Annotated[int | None, _steps_option(STEPS)] = None,
    plot: PlotOption = None,
    interrupt: InterruptOption = True,
    bus_latency: BusLatencyOption = 0.0,
    beside_cocotb: Annotated[
        int,
        typer.Option(
            "--beside-cocotb",
            min=0,
            rich_help_panel=COSIM,
            help="Run so many steps with the Python driver under cocotb as well, for its speed.",
        ),
    ] = 0,
    as_json: JsonOption = False,
) -> None:
    """Run the C driver and models in C on the simulated core, against the golden model.

    The models are written from those in Python, and compute what a core with them would; or they
    are yours, with --c-models: files that have what sw/c/apps/application.h asks for. With --models
    core there are none in C. The exit code is 1 if a bit differs from the filter in Python. For a
    plot, the covariance is read after each step as well.
    """
    from ukf_sim.c_in_the_loop.compiler import CompilerError
    from ukf_sim.c_in_the_loop.loop import require_tools, run_c_in_the_loop
    from ukf_sim.cosimulation import cosimulate
    from ukf_sim.simulators import SimulatorError

    with checked():
        _check_models(core, c_models or [])
    if beside_cocotb:
        require("sim")
    try:
        require_tools()
    except (CompilerError, SimulatorError) as error:
        fail(str(error), 1)
    with checked():
        problem, steps = _scenario(recipe, steps, STEPS)
        if beside_cocotb > steps:
            recipe.scenario(beside_cocotb)
    with progress_bars(counted=False) as bars, checked(), _models_written():
        bar = bars.add_task("Starting", total=None)
        try:
            outcome = run_c_in_the_loop(
                problem, steps, models=c_models or (), pipeline=core.pipeline, interrupt=interrupt,
                word_clocks=bus_latency, covariances=plot is not None, warn=_print_warnings,
                progress=lambda what: bars.update(bar, description=what.capitalize()),
            )  # fmt: skip
            cocotb = None
            if beside_cocotb:
                bars.update(bar, description="cocotb")
                # The Python driver, in lockstep.
                cocotb = cosimulate(
                    recipe.scenario, beside_cocotb, pipeline=core.pipeline, interrupt=interrupt,
                    word_clocks=bus_latency,
                )  # fmt: skip
        except (CompilerError, SimulatorError) as error:
            fail(str(error), 1)
    record = {
        "steps": len(outcome.results.x),
        "mismatch": outcome.mismatch,
        "errors": _errors(outcome.results),
        "clocks_per_iteration": outcome.clocks / steps,
        "words_per_iteration": outcome.words / steps,
        "bus_clocks_per_iteration": outcome.bus_clocks / steps,
        "rates": _rates(steps, outcome.seconds, outcome.cpu_seconds),
        "cocotb_rates": None
        if cocotb is None
        else _rates(beside_cocotb, cocotb.seconds, cocotb.cpu_seconds),
        "attitude": None,
        "band": None,
    }
    if plot is not None:
        what, describe = "band", describe_band
        if problem.error is attitude_error and problem.limit is not None:
            what, describe = "attitude", describe_attitude
        record[what] = describe(plot, problem, outcome.results, core.title)
    if as_json:
        print_json(record)
    else:
        _print(core, record)
    if outcome.mismatch is not None:
        raise typer.Exit(1)


@needs("hdl", "golden")
@with_recipe
def c_arm(
    core: Core,
    recipe: Recipe,
    c_models: CModelsOption = None,
    steps: Annotated[int | None, _steps_option(ARM_STEPS)] = None,
    output: Annotated[
        Path, folder_option("--output", "Folder for the program and its samples.")
    ] = Path("build/arm"),
    as_json: JsonOption = False,
) -> None:
    """Cross-compile models in C for a Cortex-A9 and run them under QEMU, on the golden model.

    They are written from those in Python, or given with --c-models, as in c-loop. The exit code is
    1 if a bit differs. Needs gcc-arm-linux-gnueabihf and qemu-user.
    """
    from ukf_sim.c_in_the_loop.compiler import CompilerError
    from ukf_tools.arm.emulator import require_arm, run_on_arm

    with checked():
        _check_models(core, c_models or [])
    try:
        require_arm()
    except CompilerError as error:
        fail(str(error), 1)
    with progress_bars(counted=False) as bars, checked(), _models_written():
        bars.add_task("Running", total=None)
        try:
            outcome = run_on_arm(
                *_scenario(recipe, steps, ARM_STEPS), output, models=c_models or (),
                warn=_print_warnings,
            )  # fmt: skip
        except (CompilerError, OSError) as error:
            fail(str(error), 1)
    record = {
        "program": str(outcome.program),
        "steps": len(outcome.results.x),
        "mismatch": outcome.mismatch,
        "errors": _errors(outcome.results),
        "words": outcome.words,
        "seconds": outcome.seconds,
    }
    if as_json:
        print_json(record)
    else:
        results.print(
            f"{core.title}: {record['steps']} iterations of {outcome.program} under QEMU, "
            f"{outcome.words} bus words, {outcome.seconds:.0f} s",
            soft_wrap=True, highlight=False,
        )  # fmt: skip
        _print_verdict(record)
    if outcome.mismatch is not None:
        raise typer.Exit(1)


def describe_band(plot: Path, problem: "Problem", found: "CResults", title: str) -> dict[str, Any]:
    """Draw each state with its band, and give in numbers what the plot shows.

    Parameters
    ----------
    plot
        Image to write.
    problem
        The problem, with its data.
    found
        Results with covariances.
    title
        Name of the core.

    Raises
    ------
    ValueError
        If there are no covariances.
    """
    from ukf_tools.evaluate.band_plot import plot_bands

    if found.covariances is None:
        raise ValueError("found must have the covariances")
    title = f"{title}: C driver on the simulated core"
    try:
        within = plot_bands(plot, problem, found.x, found.covariances, title=title)
    except OSError as error:
        fail(f"{plot}: {error.strerror}", 1)
    return {"plot": str(plot), "within_band": within}


def describe_attitude(
    plot: Path, problem: "Problem", found: "CResults", title: str
) -> dict[str, Any]:
    """Draw an attitude with its band, and give in numbers what the plot shows.

    Parameters
    ----------
    plot
        Image to write.
    problem
        A nanosatellite, with a limit of its first error.
    found
        Results with covariances.
    title
        Name of the core.

    Raises
    ------
    ValueError
        If there are no covariances.
    """
    from ukf_sw.problems.systems.nanosat import attitude_deviations
    from ukf_tools.evaluate.attitude_plot import SIGMAS, plot_attitude

    x, P = found.x, found.covariances
    if P is None:
        raise ValueError("found must have the covariances")
    limit = problem.limit
    assert limit is not None
    title = f"{title}: C driver on the simulated core"
    try:
        plot_attitude(plot, problem, x, P, limit=limit, title=title)
    except OSError as error:
        fail(f"{plot}: {error.strerror}", 1)
    errors = problem.errors_of(x)[:, 0]
    above = np.flatnonzero(errors >= limit)
    settled = 0 if not above.size else int(above[-1]) + 1
    return {
        "plot": str(plot),
        "limit": limit,
        "error_at_end": float(errors[-1]),
        "below_limit_from": float(problem.times[settled]) if settled < len(errors) else None,
        "within_band": float(np.mean(errors < SIGMAS * attitude_deviations(x, P)[:, 0])),
    }


def _errors(found: "CResults") -> int:
    """Number of steps that failed."""
    return int((found.results != 0).sum())


def _rates(steps: int, seconds: float, cpu_seconds: float) -> dict[str, float]:
    """Iterations per second of time, and of the processor."""
    return {"time": steps / seconds, "processor": steps / cpu_seconds}


def _print(core: Core, record: dict) -> None:
    results.print(f"[bold]{core.title}, C driver and application[/]", soft_wrap=True)
    table = Table(show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_row("iterations", str(record["steps"]))
    also = "" if record["attitude"] is None else ", and the reading of P"
    table.add_row(f"clocks an iteration, driver and bus included{also}",
                  f"{record['clocks_per_iteration']:.0f}")  # fmt: skip
    table.add_row("bus words an iteration", f"{record['words_per_iteration']:.1f}")
    for kind, words in (("time", "iterations a second"),
                        ("processor", "iterations a second of the processor")):  # fmt: skip
        rate = record["rates"][kind]
        table.add_row(words, f"{rate:.0f}")
        if record["cocotb_rates"] is not None:
            other = record["cocotb_rates"][kind]
            table.add_row("the same with Python under cocotb", f"{other:.1f}")
            table.add_row("ratio", f"{rate / other:.1f}")
    results.print(table)
    if record["attitude"] is not None:
        _print_attitude(record["attitude"])
    if record["band"] is not None:
        _print_band(record["band"])
    _print_verdict(record)


def _print_attitude(attitude: dict[str, Any]) -> None:
    since = attitude["below_limit_from"]
    below = "not below" if since is None else f"from {since:.3f} s on below"
    results.print(
        f"Attitude error: {attitude['error_at_end']:.3f} degrees at the end, {below} "
        f"{attitude['limit']:g} degrees; within the filter's own 3 standard deviations for "
        f"{attitude['within_band']:.1%} of the steps\nPlot: {attitude['plot']}",
        soft_wrap=True, highlight=False,
    )  # fmt: skip


def _print_band(band: dict[str, Any]) -> None:
    shares = ", ".join(f"{name} {share:.1%}" for name, share in (band["within_band"] or {}).items())
    if shares:
        results.print(
            f"Errors within the filter's own 3 standard deviations: {shares} of the steps",
            soft_wrap=True, highlight=False,
        )  # fmt: skip
    results.print(f"Plot: {band['plot']}", soft_wrap=True, highlight=False)


def _print_verdict(record: dict[str, Any]) -> None:
    mismatch, errors = record["mismatch"], record["errors"]
    if mismatch is not None:
        results.print(f"[bold red]Not bit-exact:[/] {mismatch}", soft_wrap=True)
    elif errors:
        results.print(
            "[bold green]Bit-exact[/] up to the first step that failed, in C and in the golden "
            f"model. The C application went on: {errors} steps failed.",
            soft_wrap=True,
        )
    else:
        results.print(
            "[bold green]Bit-exact[/]: estimates, NIS and covariance equal the golden model's"
        )
