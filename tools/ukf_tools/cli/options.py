"""Options that describe a core, shared by the commands that take one."""

import functools
import inspect
from collections.abc import Callable, Collection, Mapping
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from ukf_sw.problems.finding import find
from ukf_sw.problems.logs import LogFiles
from ukf_sw.problems.placing import core_models
from ukf_sw.problems.recipe import Recipe
from ukf_sw.spec.core import PARAMETERS, Core
from ukf_sw.spec.fields import parameters_of
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.parameters import Pipeline
from ukf_tools.cli.console import checked
from ukf_tools.cli.lists import entries, read_entry, split
from ukf_tools.cli.names import option_of
from ukf_tools.cli.paths import IMAGES, file_option
from ukf_tools.design_space.points import Point, grid

__all__ = [
    "BUILD",
    "CORE",
    "COSIM",
    "DATA",
    "BusLatencyOption",
    "IgnoreOption",
    "InterruptOption",
    "LogOption",
    "PlotOption",
    "SeedOption",
    "StartOption",
    "log_files",
    "with_core",
    "with_points",
    "with_recipe",
]

#: Panels of the help.

CORE, BUILD, DATA, COSIM = "The core", "How it is built", "Data", "Co-simulation"

SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Seed of the data.", rich_help_panel=DATA)
]
P0Option = Annotated[
    float | None,
    typer.Option(
        "--p0",
        help="First variance of every state; by default that of the problem.",
        rich_help_panel=DATA,
    ),
]
LogOption = Annotated[
    list[str] | None,
    typer.Option(
        "--data",
        metavar="FILE",
        help="Log to take in the place of the problem's data: CSV or Parquet; several as "
        "--data gps=gps.csv --data baro=baro.csv.",
        rich_help_panel=DATA,
    ),
]
IgnoreOption = Annotated[
    list[str] | None,
    typer.Option(
        "--ignore",
        metavar="COLUMN",
        help="Column of the log to leave out; may be given several times.",
        rich_help_panel=DATA,
    ),
]
StartOption = Annotated[
    float | None,
    typer.Option(
        "--start",
        metavar="SECONDS",
        help="Time of the log that the first estimate belongs to; what is before it is left out.",
        rich_help_panel=DATA,
    ),
]
InterruptOption = Annotated[
    bool,
    typer.Option(
        "--interrupt/--polling", help="How the driver waits for a step.", rich_help_panel=COSIM
    ),
]
BusLatencyOption = Annotated[
    float,
    typer.Option(
        "--bus-latency",
        min=0.0,
        max=1e6,
        rich_help_panel=COSIM,
        help="Clocks that a bus word takes at least, on average; 0: as few as the "
        "core needs; 15.6: the bus of the 2018 paper.",
    ),
]
PlotOption = Annotated[
    Path | None,
    file_option(
        "--plot", f"Image to draw of the run: {', '.join(IMAGES)}.", IMAGES, rich_help_panel=DATA
    ),
]


def _switch(label: str) -> str:
    """Options of a parameter that is a bool."""
    return f"{option_of(label)}/--no-{option_of(label)[2:]}"


def _core_options(*, lists: bool) -> list[inspect.Parameter]:
    """Options of all parameters of a core; if `lists`, each takes many values."""
    options: dict[str, tuple[Any, Any]] = {
        "problem": (
            str | None,
            typer.Option(
                "--problem",
                help="Problems: of `ukf apps list`, or MODULE:ATTRIBUTE, as nanosat,"
                "strut.model:problem; or give sizes."
                if lists
                else "Problem: of `ukf apps list`, as nanosat; or MODULE:ATTRIBUTE, as "
                "strut.model:problem; or give sizes.",
                rich_help_panel=CORE,
            ),
        )
    }
    built = parameters_of(Pipeline)
    for label, entry in PARAMETERS.items():
        # Of an Enum the parser knows and shows the choices.
        chosen = entry.choices and (lists or not issubclass(entry.kind, Enum))
        text = f"{entry.meaning.doc[:-1]}: {', '.join(entry.choices)}" if chosen else ""
        if entry.kind is FloatFormat:
            text += ", or widths as float6.17"
        option = typer.Option(
            _switch(label) if entry.kind is bool and not lists else option_of(label),
            help=f"{text}." if text else entry.meaning.doc,
            metavar="LIST" if lists else None,
            rich_help_panel=BUILD if label in built else CORE,
            # A problem says what is not given, so the default is not known here.
            show_default=False if entry.default is None else entry.text(entry.default),
        )
        text_only = lists or entry.kind in (FloatFormat, tuple)
        options[label] = (str if text_only else entry.kind) | None, option
    return [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[kind, option]
        )
        for name, (kind, option) in options.items()
    ]


def _required() -> str:
    """Options of what has no default."""
    return " and ".join(option_of(label) for label, e in PARAMETERS.items() if e.default is None)


def _check_given(problem: str | None, given: Collection[str]) -> None:
    """Check that sizes and noises are given once: by a problem or by their options."""
    if problem is None:
        if any(entry.default is None and name not in given for name, entry in PARAMETERS.items()):
            raise ValueError(f"--problem, or at least {_required()}, must be given")
    elif any(PARAMETERS[name].meaning.problem for name in given):
        raise ValueError("--problem says sizes and noises already: give it or them, not both")


def _core_of(problem: str) -> Core:
    """Give the core of a problem."""
    found = find(problem, "--problem")
    return Core(params=found.params, problem=problem, redraw=found.redraw)


def _core(problem: str | None, given: Mapping[str, Any]) -> Core:
    """Make a core of the options that are given.

    Raises
    ------
    ValueError
        If there is no such core.
    """
    _check_given(problem, given)
    values = {
        label: read_entry(option_of(label), value, PARAMETERS[label])
        if isinstance(value, str)
        else value
        for label, value in given.items()
    }
    if problem is None:
        return Core.from_values(values)
    base = _core_of(problem)
    return Core.from_values(base.values() | values, problem, redraw=base.redraw, place=core_models)


def _points(problems: str | None, given: Mapping[str, str]) -> list[Point]:
    """Make the cores of a sweep of the options that are given, each a list.

    Raises
    ------
    ValueError
        If an option is not such a list.
    """
    _check_given(problems, given)
    axes: dict[str, list[Any]] = {}
    for label, text in given.items():
        # A size may follow one before it, as in --q n.
        before = [name for name in axes if PARAMETERS[name].kind is PARAMETERS[label].kind]
        axes[label] = entries(option_of(label), text, PARAMETERS[label], before)
    bases = [Point()]
    if problems is not None:
        bases = [Point.of(_core_of(name)) for name in split("--problem", problems)]
    return grid(bases, **axes)


def log_files(
    texts: list[str] | None, ignore: list[str] | None, start: float | None
) -> LogFiles | None:
    """Make logs of the options that are given.

    Raises
    ------
    ValueError
        If one is no file, or there is something to ignore in none, or a start of none.
    """
    if not texts:
        if ignore:
            raise ValueError("--ignore must come with --data, whose columns it leaves out")
        if start is not None:
            raise ValueError("--start must come with --data, of whose times it is one")
        return None
    logs = LogFiles.of(texts, ignore or (), start)
    for _, file in logs.files:
        if not file.is_file():
            raise ValueError(f"--data must be a file, and maybe its name before it, not {file}")
        try:
            file.open("rb").close()
        except OSError as error:
            raise ValueError(
                f"--data must be a file that can be read, not {file}: {error.strerror}"
            ) from error
    return logs


def _with_options(
    command: Callable[..., None], make: Callable[..., Any], *, lists: bool
) -> Callable[..., None]:
    """Give a command the options of a core; its first argument is what is made of them."""
    shared = _core_options(lists=lists)
    own = list(inspect.signature(command).parameters.values())[1:]

    @functools.wraps(command)
    def wrapped(problem: str | None, **arguments: Any) -> None:
        given = {label: arguments.pop(label) for label in PARAMETERS}
        with checked():
            made = make(problem, {k: v for k, v in given.items() if v is not None})
        command(made, **arguments)

    return _described(wrapped, [*shared, *own])


def _described(command: Any, parameters: list[inspect.Parameter]) -> Callable[..., None]:
    """Give a function a signature."""
    parameters = [entry.replace(kind=inspect.Parameter.KEYWORD_ONLY) for entry in parameters]
    command.__signature__ = inspect.Signature(parameters)
    command.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    return command


def with_core(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, which takes a core first, the options that describe one."""
    return _with_options(command, _core, lists=False)


def with_points(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, which takes the cores of a sweep first, the same options as lists."""
    return _with_options(command, _points, lists=True)


#: Options of a scenario.
_SCENARIO = [
    inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )
    for name, default, annotation in (
        ("seed", 0, SeedOption), ("p0", None, P0Option), ("data", None, LogOption),
        ("ignore", None, IgnoreOption), ("start", None, StartOption),
    )
]  # fmt: skip


def with_recipe(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, which takes a core and a recipe first, the options that describe both."""
    core, _, *own = inspect.signature(command).parameters.values()

    @functools.wraps(command)
    def wrapped(
        core: Core,
        seed: int,
        p0: float | None,
        data: list[str] | None,
        ignore: list[str] | None,
        start: float | None,
        **arguments: Any,
    ) -> None:
        with checked():
            recipe = Recipe(
                name=core.problem, params=core.params, seed=seed, P0=p0,
                logs=log_files(data, ignore, start),
            )  # fmt: skip
        command(core, recipe, **arguments)

    return with_core(_described(wrapped, [core, *_SCENARIO, *own]))
