"""Options that describe a core, shared by the commands that take one."""

import functools
import inspect
from collections.abc import Callable, Collection, Mapping
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from ukf_sw.problems.catalogue import find
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
    "InterruptOption",
    "P0Option",
    "PlotOption",
    "SeedOption",
    "with_core",
    "with_points",
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
        help="First variance of every state; by default that of the system.",
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
        "--plot", f"Image of the errors: {', '.join(IMAGES)}.", IMAGES, rich_help_panel=DATA
    ),
]


def _switch(label: str) -> str:
    """Options of a parameter that is a bool."""
    return f"{option_of(label)}/--no-{option_of(label)[2:]}"


def _core_options(*, lists: bool) -> list[inspect.Parameter]:
    """Options of all parameters of a core; if `lists`, each takes many values."""
    options: dict[str, tuple[Any, Any]] = {
        "configuration": (
            str | None,
            typer.Option(
                "--config",
                help="Systems of `ukf apps list`, as nanosat,ctrv; or give sizes."
                if lists
                else "System of `ukf apps list`, as nanosat; or give sizes.",
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
            # A configuration says what is not given, so the default is not known here.
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


def _check_given(configuration: str | None, given: Collection[str]) -> None:
    """Check that sizes and noises are given once: by a configuration or by their options."""
    if configuration is None:
        if any(entry.default is None and name not in given for name, entry in PARAMETERS.items()):
            raise ValueError(f"--config, or at least {_required()}, must be given")
    elif any(PARAMETERS[name].meaning.problem for name in given):
        raise ValueError("--config says sizes and noises already: give it or them, not both")


def _configured(configuration: str) -> Core:
    """Give the core of a configuration."""
    return Core(params=find(configuration, "--config").params, configuration=configuration)


def _core(configuration: str | None, given: Mapping[str, Any]) -> Core:
    """Make a core of the options that are given.

    Raises
    ------
    ValueError
        If there is no such core.
    """
    _check_given(configuration, given)
    values = {
        label: read_entry(option_of(label), value, PARAMETERS[label])
        if isinstance(value, str)
        else value
        for label, value in given.items()
    }
    base = {} if configuration is None else _configured(configuration).values()
    return Core.from_values(base | values, configuration)


def _points(configurations: str | None, given: Mapping[str, str]) -> list[Point]:
    """Make the cores of a sweep of the options that are given, each a list.

    Raises
    ------
    ValueError
        If an option is not such a list.
    """
    _check_given(configurations, given)
    axes: dict[str, list[Any]] = {}
    for label, text in given.items():
        # A size may follow one before it, as in --q n.
        before = [name for name in axes if PARAMETERS[name].kind is PARAMETERS[label].kind]
        axes[label] = entries(option_of(label), text, PARAMETERS[label], before)
    bases = [Point()]
    if configurations is not None:
        bases = [Point.of(_configured(name)) for name in split("--config", configurations)]
    return grid(bases, **axes)


def _with_options(
    command: Callable[..., None], make: Callable[..., Any], *, lists: bool
) -> Callable[..., None]:
    """Give a command the options of a core; its first argument is what is made of them."""
    shared = _core_options(lists=lists)
    own = list(inspect.signature(command).parameters.values())[1:]

    @functools.wraps(command)
    def wrapped(configuration: str | None, **arguments: Any) -> None:
        given = {label: arguments.pop(label) for label in PARAMETERS}
        with checked():
            made = make(configuration, {k: v for k, v in given.items() if v is not None})
        command(made, **arguments)

    parameters = [
        *shared, *(entry.replace(kind=inspect.Parameter.KEYWORD_ONLY) for entry in own),
    ]  # fmt: skip
    described: Any = wrapped
    described.__signature__ = inspect.Signature(parameters)
    described.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    return described


def with_core(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, which takes a core first, the options that describe one."""
    return _with_options(command, _core, lists=False)


def with_points(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, which takes the cores of a sweep first, the same options as lists."""
    return _with_options(command, _points, lists=True)
