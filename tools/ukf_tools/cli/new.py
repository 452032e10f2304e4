"""Command ``ukf new``."""

from pathlib import Path
from typing import Annotated

import typer

from ukf_sw.spec.parameters import Noise, UkfParams
from ukf_tools.cli.console import JsonOption, checked, fail, print_json, results

__all__ = ["new"]

SIZES = "Sizes and noise"


def new(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to make; its name names the project.")
    ],
    n: Annotated[int, typer.Option("--n", help="States.", rich_help_panel=SIZES)] = 3,
    m: Annotated[int, typer.Option("--m", help="Observations.", rich_help_panel=SIZES)] = 2,
    q: Annotated[
        int | None,
        typer.Option(
            "--q", help="Process noise terms; by default n.", rich_help_panel=SIZES
        ),
    ] = None,
    r: Annotated[
        int | None,
        typer.Option(
            "--r", help="Observation noise terms, m or more; by default m.", rich_help_panel=SIZES
        ),
    ] = None,
    process_noise: Annotated[
        Noise,
        typer.Option("--process-noise", help="How it enters the model.", rich_help_panel=SIZES),
    ] = Noise.AUGMENTED,
    observation_noise: Annotated[
        Noise,
        typer.Option("--observation-noise", help="How it enters the model.", rich_help_panel=SIZES),
    ] = Noise.AUGMENTED,
    pes: Annotated[
        int, typer.Option("--pes", help="Processing elements.", rich_help_panel=SIZES)
    ] = 1,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Write a small project that works at once, to put your own model into.

    It has models, simulated data, tests, a Makefile, which runs the filter, generates Verilog,
    co-simulates it and plots, and workflows for GitHub and GitLab. The problem is a heated strut: n
    cells, m sensors.
    """
    from ukf_tools.new.project_writer import write_project

    with checked():
        params = UkfParams(
            n=n, m=m, q=n if q is None else q, r=m if r is None else r, process_noise=process_noise,
            observation_noise=observation_noise, pes=pes,
        )  # fmt: skip
        try:
            written = write_project(directory, params)
        except OSError as error:
            fail(str(error))
    if as_json:
        print_json({"files": [str(file) for file in written]})
        return
    for file in written:
        results.print(str(file), highlight=False, soft_wrap=True)
    results.print(f"Next: cd {directory}; make run; make cosim; make test", soft_wrap=True)
