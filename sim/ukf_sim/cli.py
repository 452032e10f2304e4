"""Command line: ``ukf``."""

import functools
import inspect
import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn
from rich.progress import TimeElapsedColumn as Elapsed
from rich.table import Table

from ukf_sim.apps.commands import apps_app
from ukf_sim.configurations import CONFIGURATIONS, Problem
from ukf_sw.float_format import FORMATS, FloatFormat
from ukf_sw.parameters import Form, Noise, Pipeline, UkfParams

# What takes long to import is imported by the commands that need it.

__all__ = ["app"]

app = typer.Typer(
    name="ukf",
    help="Unscented Kalman filter core for FPGAs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)
app.add_typer(apps_app)

#: Progress and messages; standard output is for results.
_messages = Console(stderr=True)
_results = Console()


class SimulatorName(StrEnum):
    """Simulators."""

    VERILATOR = "verilator"
    ICARUS = "icarus"


class BackendName(StrEnum):
    """What computes a run."""

    GOLDEN = "golden"
    REFERENCE = "reference"


_CORE, _BUILD, _DATA, _COSIM = "The core", "How it is built", "Data", "Co-simulation"

ConfigOption = Annotated[
    str | None,
    typer.Option("--config", help=f"Configuration: {', '.join(CONFIGURATIONS)}; or give sizes.",
                 rich_help_panel=_CORE),
]  # fmt: skip
NOption = Annotated[int | None, typer.Option("--n", help="States.", rich_help_panel=_CORE)]
MOption = Annotated[int | None, typer.Option("--m", help="Observations.", rich_help_panel=_CORE)]
QOption = Annotated[
    int | None, typer.Option("--q", help="Process noise terms.", rich_help_panel=_CORE)
]
ROption = Annotated[
    int | None, typer.Option("--r", help="Observation noise terms.", rich_help_panel=_CORE)
]
ProcessNoiseOption = Annotated[
    Noise | None,
    typer.Option("--process-noise", help="How process noise enters.", rich_help_panel=_CORE),
]
ObservationNoiseOption = Annotated[
    Noise | None,
    typer.Option("--observation-noise", help="How observation noise enters.",
                 rich_help_panel=_CORE),
]  # fmt: skip
W0Option = Annotated[
    float | None,
    typer.Option("--w0", help="Weight of sigma point 0, in [0, 1).", rich_help_panel=_CORE),
]
PesOption = Annotated[
    int, typer.Option("--pes", help="Processing elements.", rich_help_panel=_CORE)
]
FormOption = Annotated[
    Form, typer.Option("--form", help="How the update is computed.", rich_help_panel=_CORE)
]
FormatOption = Annotated[
    str,
    typer.Option("--format", help=f"Number format: {', '.join(FORMATS)}, or widths as float6.17.",
                 rich_help_panel=_CORE),
]  # fmt: skip
MultiplyOption = Annotated[
    int,
    typer.Option("--multiply-stages", help="Latency of a product.", rich_help_panel=_BUILD),
]
AddOption = Annotated[
    int, typer.Option("--add-stages", help="Latency of a sum.", rich_help_panel=_BUILD)
]
RootOption = Annotated[
    int,
    typer.Option("--reciprocal-sqrt-stages", help="Latency of 1/sqrt.", rich_help_panel=_BUILD),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Seed of the data.", rich_help_panel=_DATA)
]
P0Option = Annotated[
    float, typer.Option("--p0", help="First variance of every state.", rich_help_panel=_DATA)
]
PlotOption = Annotated[
    Path | None, typer.Option("--plot", help="Image of the errors.", rich_help_panel=_DATA)
]

_STAGES = Pipeline()


def _fail(message: str, code: int = 2) -> NoReturn:
    """Print a message and exit."""
    _messages.print(f"[bold red]Error:[/] {message}", highlight=False, soft_wrap=True)
    raise typer.Exit(code)


@contextmanager
def _checked() -> Iterator[None]:
    """Turn complaints about arguments into messages."""
    try:
        yield
    except (ValueError, TypeError) as error:
        _fail(str(error))


def _format(name: str) -> FloatFormat:
    if name in FORMATS:
        return FORMATS[name]
    exponent, point, fraction = name.removeprefix("float").partition(".")
    if not (name.startswith("float") and point and exponent.isdecimal() and fraction.isdecimal()):
        known = ", ".join(FORMATS)
        raise ValueError(f"--format must be one of {known}, or like float6.17, not {name!r}")
    return FloatFormat(exponent_bits=int(exponent), fraction_bits=int(fraction))


@dataclass(frozen=True, kw_only=True)
class Core:
    """The core that options describe.

    Parameters
    ----------
    config
        Name of its configuration, or None.
    params, pipeline
        What it computes, and how it is built.
    """

    config: str | None
    params: UkfParams
    pipeline: Pipeline

    @property
    def stem(self) -> str:
        """Name for files."""
        p = self.params
        name = self.config or f"n{p.n}m{p.m}q{p.q}r{p.r}"
        return f"{name}-{p.pes}pe-{p.form.value}-{p.format.name}"

    @property
    def title(self) -> str:
        """Name for people."""
        p = self.params
        name = self.config or f"Random system, n = {p.n}, m = {p.m}"
        return f"{name}, {p.form.value} form, {p.format.name}, {p.pes} PE{'s' * (p.pes != 1)}"


def _core(
    *,
    config: ConfigOption = None,
    n: NOption = None,
    m: MOption = None,
    q: QOption = None,
    r: ROption = None,
    process_noise: ProcessNoiseOption = None,
    observation_noise: ObservationNoiseOption = None,
    w0: W0Option = None,
    pes: PesOption = 1,
    form: FormOption = Form.SQUARE_ROOT,
    number_format: FormatOption = "binary32",
    multiply: MultiplyOption = _STAGES.multiply,
    add: AddOption = _STAGES.add,
    root: RootOption = _STAGES.reciprocal_sqrt,
) -> Core:
    """Make a core of its options."""
    common: dict[str, Any] = {"pes": pes, "form": form, "format": _format(number_format)}
    if w0 is not None:
        common["W0"] = w0
    noises = {"process_noise": process_noise, "observation_noise": observation_noise}
    given = {name: noise for name, noise in noises.items() if noise is not None}
    if config is not None:
        if config not in CONFIGURATIONS:
            known = ", ".join(CONFIGURATIONS)
            raise ValueError(f"--config must be one of {known}, not {config!r}")
        if given or any(size is not None for size in (n, m, q, r)):
            raise ValueError("--config says sizes and noises already: give it or them, not both")
        params = replace(CONFIGURATIONS[config].params, **common)
    elif n is None or m is None:
        raise ValueError("--config, or at least --n and --m, must be given")
    else:
        params = UkfParams(n=n, m=m, q=q or 0, r=r or 0, **given, **common)
    return Core(
        config=config,
        params=params,
        pipeline=Pipeline(multiply=multiply, add=add, reciprocal_sqrt=root),
    )


def _with_core(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, which takes a core first, the options that describe one."""
    shared = inspect.signature(_core).parameters
    own = list(inspect.signature(command).parameters.values())[1:]

    @functools.wraps(command)
    def wrapped(**arguments: Any) -> None:
        with _checked():
            core = _core(**{name: arguments.pop(name) for name in shared})
        command(core, **arguments)

    parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in (*shared.values(), *own)
    ]
    wrapped.__signature__ = inspect.Signature(parameters)
    wrapped.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return wrapped


def _print_json(record: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(record, indent=2) + "\n")


@contextmanager
def _progress(*, counted: bool = True) -> Iterator[Progress]:
    columns = [SpinnerColumn(), TextColumn("{task.description}"), BarColumn()]
    if counted:
        columns.append(MofNCompleteColumn())
    with Progress(*columns, Elapsed(), console=_messages, transient=True) as progress:
        yield progress


@app.command()
@_with_core
def generate(
    core: Core,
    output: Annotated[Path, typer.Option("--output", help="Folder to write to.")] = Path(
        "build/rtl"
    ),
    as_json: JsonOption = False,
) -> None:
    """Write the core: Verilog, register map as JSON, C header. Equal inputs give equal bytes."""
    if output.exists() and not output.is_dir():
        _fail(f"--output must be a folder, not the file {str(output)!r}")
    from ukf_hdl.generate import generate as write

    with _progress(counted=False) as progress:
        progress.add_task("Generating", total=None)
        try:
            files = write(core.params, core.pipeline, output)
        except OSError as error:
            _fail(f"{output}: {error.strerror}", 1)
    if as_json:
        _print_json({"files": [str(file) for file in files]})
        return
    for file in files:
        _results.print(f"{file}  {file.stat().st_size} bytes", highlight=False, soft_wrap=True)


@app.command()
@_with_core
def latency(core: Core, as_json: JsonOption = False) -> None:
    """Print the cycles of every step, from the schedule: what the core's counter will read."""
    from ukf_sim.report import describe_params
    from ukf_sim.report import latency as compute

    record = compute(core.params, core.pipeline)
    if as_json:
        _print_json(record | {"parameters": describe_params(core.params, core.pipeline)})
        return
    _results.print(f"[bold]{core.title}[/]", soft_wrap=True)
    table = Table()
    table.add_column("step")
    table.add_column("cycles", justify="right")
    for name, cycles in record["steps"].items():
        table.add_row(name, str(cycles))
    table.add_row("total", str(record["total"]), style="bold", end_section=True)
    for name in ("INIT", "SIG_GEN", "SIG_GEN_PREDICTED", "UPDATE_REDRAWN", "COVARIANCE",
                 "COVARIANCE_PREDICTED"):  # fmt: skip
        table.add_row(name, str(record["programs"][name]))
    _results.print(table)
    _results.print(
        "SIG_GEN costs nothing after an UPDATE, which leaves the next sigma points. Below the "
        "total: the programs that an iteration does not run."
    )


@app.command()
@_with_core
def cosim(
    core: Core,
    steps: Annotated[
        int, typer.Option("--steps", min=1, help="Iterations.", rich_help_panel=_DATA)
    ] = 20,
    seed: SeedOption = 0,
    p0: P0Option = 1.0,
    plot: PlotOption = None,
    simulator: Annotated[
        SimulatorName, typer.Option("--simulator", help="Simulator.", rich_help_panel=_COSIM)
    ] = SimulatorName.VERILATOR,
    interrupt: Annotated[
        bool,
        typer.Option(
            "--interrupt/--polling", help="How the driver waits for a step.", rich_help_panel=_COSIM
        ),
    ] = True,
    bus_latency: Annotated[
        float,
        typer.Option(
            "--bus-latency",
            min=0.0,
            rich_help_panel=_COSIM,
            help="Clocks that a bus word takes at least, on average; 0: as few as the "
            "core needs; 15.6: the bus of the 2018 paper.",
        ),
    ] = 0.0,
    cache: Annotated[
        Path,
        typer.Option("--cache", help="Folder of compiled cores.", rich_help_panel=_COSIM),
    ] = Path("build/cosim"),
    as_json: JsonOption = False,
) -> None:
    """Run the software on the Verilog, compared with the golden model bit for bit.

    The exit code is 0 if every word agreed, also when both stopped with the same error, and 1 if
    not. Without a configuration, a random system of the given sizes is estimated.
    """
    with _checked():
        if not math.isfinite(bus_latency):
            raise ValueError(f"--bus-latency must be a number of clocks, not {bus_latency!r}")
        problem = Problem(configuration=core.config, params=core.params, seed=seed, P0=p0)
        scenario = problem.scenario(steps)
    from ukf_sim.cosimulation import Job, cosimulate
    from ukf_sim.plots import plot_errors
    from ukf_sim.report import cosimulation_record
    from ukf_sim.running import make_backend, run_problem
    from ukf_sim.simulators import Simulator, SimulatorError

    reference = run_problem(make_backend("reference", problem), scenario, steps)["x"]
    job = Job(
        params=core.params,
        pipeline=core.pipeline,
        task="ukf_sim.tasks:run_problem",
        arguments={"problem": problem, "steps": steps},
        interrupt=interrupt,
        word_clocks=bus_latency,
    )
    chosen = Simulator(simulator.value)
    phases = {
        "generate": "Generating Verilog",
        "compile": f"Compiling for {chosen.value}",
        "simulate": "Simulating",
    }
    with _progress() as progress:
        bar = progress.add_task("Starting", total=None)

        def tell(phase: str, done: int) -> None:
            total = steps if phase == "simulate" else None
            progress.update(bar, description=phases[phase], completed=done, total=total)

        try:
            outcome = cosimulate(job, chosen, cache=cache, progress=tell)
        except SimulatorError as error:
            _fail(str(error), 1)
    record = cosimulation_record(problem, job, chosen, steps, outcome, reference)
    image = plot or cache.parent / "plots" / f"cosim-{core.stem}.png"
    if len(outcome.result["x"]):
        count = len(outcome.result["x"])
        estimates = {"core, simulated": outcome.result["x"], "float64 reference": reference[:count]}
        record["plot"] = str(plot_errors(image, scenario, estimates, core.title))
    else:
        record["plot"] = None
    if as_json:
        _print_json(record)
    else:
        _print_cosim(record, core.title)
    if not record["bit_exact"]:
        raise typer.Exit(1)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _print_stop(record: dict[str, Any]) -> None:
    stopped = record["stopped"]
    if stopped is not None:
        index = "" if stopped["index"] is None else f", index {stopped['index']}"
        _results.print(
            f"[bold yellow]Stopped[/] after {stopped['iteration']} iterations, in "
            f"{stopped['step']}: {stopped['error']}, code {stopped['code']}{index}. "
            f"{stopped['message']}.",
            soft_wrap=True,
        )
        last = ", ".join(f"{value:.6g}" for value in record["last_estimate"] or [])
        _results.print(f"Last good estimate: ({last})", soft_wrap=True)


def _print_accuracy(judged: dict[str, Any]) -> None:
    if not judged:
        return
    reference = judged.get("reference")
    after = f", from {judged['since']:g} s on" if judged["since"] else ""
    _results.print(f"Errors over {judged['steps']} steps{after}:")
    table = Table()
    for heading in ("error", "rms", "largest", *(["rms of the reference"] if reference else [])):
        table.add_column(heading, justify="left" if heading == "error" else "right")
    for name, unit in judged["units"].items():
        row = [f"{name} / {unit}" if unit else name]
        row += [_number(judged["rms"][name]), _number(judged["maximum"][name])]
        if reference:
            row.append(_number(reference["rms"][name]))
        table.add_row(*row)
    _results.print(table)
    if "below_0.1_degrees" in judged:
        also = f", reference {reference['below_0.1_degrees']:.2%}" if reference else ""
        _results.print(
            f"Attitude below 0.1 degrees: {judged['below_0.1_degrees']:.2%} of steps{also}"
        )
    if reference:
        _results.print(
            f"Ratio of rms to the reference: {_number(reference['rms_ratio'])}; largest "
            f"difference of x: {_number(reference['largest_difference_of_x'])}"
        )


def _print_cosim(record: dict[str, Any], title: str) -> None:
    cycles, bus = record["cycles"], record["bus"]
    _results.print(f"[bold]{title}[/]", soft_wrap=True)
    table = Table()
    for heading in ("step", "core", "schedule"):
        table.add_column(heading, justify="left" if heading == "step" else "right")
    for name, predicted in cycles["predicted"].items():
        table.add_row(name, str(cycles["steps"].get(name, "-")), str(predicted))
    table.add_row("total", str(cycles["total"]), str(cycles["predicted_total"]), style="bold")
    _results.print(table)
    if bus["clocks_per_word"] is not None:
        _results.print(
            f"Bus words per iteration: {bus['words_per_iteration']} "
            f"({bus['words_read']} read, {bus['words_written']} written), and "
            f"{bus['control_reads']} + {bus['control_writes']} of the registers; "
            f"{bus['clocks_per_word']:.1f} clocks a word"
        )
        _results.print(
            f"Iteration, software apart: {record['clocks_per_iteration']} clocks. "
            f"Simulated {record['steps']} iterations with {record['simulator']}, "
            f"{record['mode']}, at {record['iterations_per_second']:.1f} a second"
        )
    _print_accuracy(record["accuracy"])
    _print_stop(record)
    if record["plot"]:
        _results.print(f"Plot: {record['plot']}", soft_wrap=True)
    if record["bit_exact"]:
        _results.print(
            f"[bold green]Bit-exact[/]: {record['words_compared']} words of the core equal the "
            "golden model's"
        )
    else:
        _results.print(f"[bold red]Not bit-exact[/]: {record['mismatch']}", soft_wrap=True)


@app.command()
@_with_core
def run(
    core: Core,
    backend: Annotated[
        BackendName, typer.Option("--backend", help="What computes.", rich_help_panel=_DATA)
    ] = BackendName.GOLDEN,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            min=1,
            help="Iterations; all of the scenario by default.",
            rich_help_panel=_DATA,
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
    with _checked():
        problem = Problem(configuration=core.config, params=core.params, seed=seed, P0=p0)
        with _messages.status("Simulating the sensors"):
            scenario = problem.scenario(steps)
    from ukf_sim.plots import plot_errors
    from ukf_sim.running import accuracy, make_backend, run_problem

    total = scenario.steps
    runs = {}
    names = dict.fromkeys((backend.value, "reference"))
    with _progress() as progress:
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
        _print_json(record)
    else:
        _results.print(f"{core.title}: {count} of {total} steps")
        _print_accuracy(record["accuracy"])
        _print_stop(record)
        if record["plot"]:
            _results.print(f"Plot: {record['plot']}", soft_wrap=True)
    if record["stopped"] is not None:
        raise typer.Exit(1)


if __name__ == "__main__":
    app()
