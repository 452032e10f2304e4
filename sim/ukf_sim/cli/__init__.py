"""Command line: ``ukf``. One module for each group of commands."""

import typer

from ukf_sim.cli.apps import apps_app
from ukf_sim.cli.baseline import baseline
from ukf_sim.cli.c_software import c_arm, c_loop, export
from ukf_sim.cli.core import generate, latency
from ukf_sim.cli.cosim import cosim
from ukf_sim.cli.estimates import resources, timing
from ukf_sim.cli.new import new
from ukf_sim.cli.package import package, write_testbench
from ukf_sim.cli.run import run
from ukf_sim.cli.sweep import report, sweep

# What takes long to import is imported by the commands that need it.

__all__ = ["app"]

app = typer.Typer(
    name="ukf",
    help="Unscented Kalman filter core for FPGAs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)
for command in (
    generate,
    latency,
    cosim,
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
