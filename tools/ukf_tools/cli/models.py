"""Command line of the models of a problem: ``ukf models``."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from ukf_sw.problems.finding import find
from ukf_sw.problems.placing import STEPS, example_of
from ukf_sw.spec.fields import parameters_of
from ukf_sw.spec.parameters import UkfParams
from ukf_tools.cli.console import JsonOption, checked, needs, print_json
from ukf_tools.cli.lists import read_entry

__all__ = ["models_app"]

models_app = typer.Typer(
    name="models", help="What the models of a problem compute.", no_args_is_help=True
)


@models_app.callback()
def models() -> None:
    """What the models of a problem compute."""


@models_app.command("show")
@needs()
def show(
    problem: Annotated[
        str,
        typer.Option(
            "--problem",
            metavar="NAME",
            help="Problem: of `ukf apps list`, as nanosat; or MODULE:ATTRIBUTE, as "
            "strut.model:problem.",
        ),
    ],
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Number format of the core; by default that of the problem.",
        ),
    ] = None,
    steps: Annotated[
        int,
        typer.Option(
            "--steps", min=1, help="Steps of the data to look at for inputs and arguments."
        ),
    ] = STEPS,
    with_listing: Annotated[
        bool, typer.Option("--listing", help="Print the operations as well, row by row.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print the operations that f and each h consist of, once what is equal is computed once.

    A model that cannot be a program of a core is refused, with the line that is the cause.
    """
    from ukf_sw.tracing.models import trace_problem
    from ukf_sw.tracing.report import listing_of, record_of

    with checked():
        find(problem, "--problem")
        found = example_of(problem, steps)
        chosen = found.format
        if format is not None:
            chosen = read_entry("--format", format, parameters_of(UkfParams)["format"])
        traced = trace_problem(found)
        records = [record_of(model, found, chosen) for model in traced.models]
    listings = [listing_of(model, found) if with_listing else "" for model in traced.models]
    if as_json:
        for record, text in zip(records, listings, strict=True):
            record |= {"listing": text.splitlines()} if with_listing else {}
        print_json({"problem": problem, "format": chosen.name, "models": records})
        return
    for record, text in zip(records, listings, strict=True):
        typer.echo("\n".join(_lines(record, chosen.name)))
        if text:
            typer.echo("".join(f"    {line}\n" for line in text.splitlines()), nl=False)


def _said(counts: Mapping[str, int]) -> str:
    """Say how many of each kind there are."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    return f"{sum(counts.values())}" + (f": {kinds}" if kinds else "")


def _lines(record: Mapping[str, Any], format: str) -> list[str]:
    """Give what is known of a model in lines."""
    inputs = [
        source["label"] if source["name"] is None else f"{source['label']} ({source['name']})"
        for source in record["inputs"]
    ]
    constants = [
        f"{entry['value']!r}" + ("" if entry["exact"] else "~") for entry in record["constants"]
    ]
    rounded = sum(not entry["exact"] for entry in record["constants"])
    note = f"; ~ is rounded in {format}" if rounded else f"; all exact in {format}"
    return [
        f"{record['title']}: {len(record['rows'])} rows, {record['depth']} operations deep",
        f"  inputs: {', '.join(inputs) or 'none'}",
        f"  operations at each sigma point: {_said(record['operations']['per_point'])}",
        f"  operations once: {_said(record['operations']['once'])}",
        f"  functions: {', '.join(record['functions']) or 'none'}",
        f"  constants: {', '.join(constants) + note if constants else 'none'}",
    ]
