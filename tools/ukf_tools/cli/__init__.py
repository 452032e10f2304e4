"""Command line: ``ukf``. One module for each group of commands."""

from typing import Annotated

import typer

from ukf_sw import __version__
from ukf_tools.cli.apps import apps_app
from ukf_tools.cli.baseline import baseline
from ukf_tools.cli.c_software import c_arm, c_loop, export
from ukf_tools.cli.commands import Commands
from ukf_tools.cli.cosim import cosim
from ukf_tools.cli.disassemble import disassemble
from ukf_tools.cli.estimates import resources, timing
from ukf_tools.cli.generate import generate
from ukf_tools.cli.latency import latency
from ukf_tools.cli.models import models_app
from ukf_tools.cli.new import new
from ukf_tools.cli.package import package, write_testbench
from ukf_tools.cli.run import run
from ukf_tools.cli.sweep import report, sweep

# What takes long to import is imported by the commands that need it.

__all__ = ["app"]

app = typer.Typer(
    name="ukf",
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def ukf(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Unscented Kalman filter core for FPGAs."""


for command in (
    generate,
    latency,
    cosim,
    disassemble,
    run,
    new,
    resources,
    timing,
    sweep,
    report,
    package,
    export,
    c_loop,
    c_arm,
    baseline,
):
    app.command()(command)
app.command("testbench")(write_testbench)
app.add_typer(apps_app)
app.add_typer(models_app)
