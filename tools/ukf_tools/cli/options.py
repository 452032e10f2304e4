"""Options that describe a core, shared by the commands that take one."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ukf_sw.problems.configurations import CONFIGURATIONS
from ukf_sw.spec.float_format import FORMATS, FloatFormat
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_tools.cli.console import checked

__all__ = [
    "BUILD",
    "CORE",
    "COSIM",
    "DATA",
    "BusLatencyOption",
    "Core",
    "InterruptOption",
    "P0Option",
    "PlotOption",
    "SeedOption",
    "parse_format",
    "with_core",
]

#: Panels of the help.

CORE, BUILD, DATA, COSIM = "The core", "How it is built", "Data", "Co-simulation"

ConfigOption = Annotated[
    str | None,
    typer.Option("--config", help=f"Configuration: {', '.join(CONFIGURATIONS)}; or give sizes.",
                 rich_help_panel=CORE),
]  # fmt: skip
NOption = Annotated[int | None, typer.Option("--n", help="States.", rich_help_panel=CORE)]
MOption = Annotated[int | None, typer.Option("--m", help="Observations.", rich_help_panel=CORE)]
QOption = Annotated[
    int | None, typer.Option("--q", help="Process noise terms.", rich_help_panel=CORE)
]
ROption = Annotated[
    int | None, typer.Option("--r", help="Observation noise terms.", rich_help_panel=CORE)
]
ProcessNoiseOption = Annotated[
    Noise | None,
    typer.Option("--process-noise", help="How process noise enters.", rich_help_panel=CORE),
]
ObservationNoiseOption = Annotated[
    Noise | None,
    typer.Option("--observation-noise", help="How observation noise enters.",
                 rich_help_panel=CORE),
]  # fmt: skip
W0Option = Annotated[
    float | None,
    typer.Option("--w0", help="Weight of sigma point 0, in [0, 1).", rich_help_panel=CORE),
]
PesOption = Annotated[int, typer.Option("--pes", help="Processing elements.", rich_help_panel=CORE)]
FormOption = Annotated[
    Form, typer.Option("--form", help="How the update is computed.", rich_help_panel=CORE)
]
FormatOption = Annotated[
    str,
    typer.Option("--format", help=f"Number format: {', '.join(FORMATS)}, or widths as float6.17.",
                 rich_help_panel=CORE),
]  # fmt: skip
MultiplyOption = Annotated[
    int,
    typer.Option("--multiply-stages", help="Latency of a product.", rich_help_panel=BUILD),
]
AddOption = Annotated[
    int, typer.Option("--add-stages", help="Latency of a sum.", rich_help_panel=BUILD)
]
RootOption = Annotated[
    int,
    typer.Option("--reciprocal-sqrt-stages", help="Latency of 1/sqrt.", rich_help_panel=BUILD),
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Seed of the data.", rich_help_panel=DATA)
]
P0Option = Annotated[
    float, typer.Option("--p0", help="First variance of every state.", rich_help_panel=DATA)
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
        rich_help_panel=COSIM,
        help="Clocks that a bus word takes at least, on average; 0: as few as the "
        "core needs; 15.6: the bus of the 2018 paper.",
    ),
]
PlotOption = Annotated[
    Path | None, typer.Option("--plot", help="Image of the errors.", rich_help_panel=DATA)
]

_STAGES = Pipeline()


def parse_format(name: str) -> FloatFormat:
    """Give the format of a name, or of widths as in float6.17.

    Raises
    ------
    ValueError
        If it is neither.
    """
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
    common: dict[str, Any] = {"pes": pes, "form": form, "format": parse_format(number_format)}
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


def with_core(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command, which takes a core first, the options that describe one."""
    shared = inspect.signature(_core).parameters
    own = list(inspect.signature(command).parameters.values())[1:]

    @functools.wraps(command)
    def wrapped(**arguments: Any) -> None:
        with checked():
            core = _core(**{name: arguments.pop(name) for name in shared})
        command(core, **arguments)

    parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in (*shared.values(), *own)
    ]
    wrapped.__signature__ = inspect.Signature(parameters)
    wrapped.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return wrapped
