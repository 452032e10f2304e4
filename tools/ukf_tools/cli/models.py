"""Command line of the models of a problem: ``ukf models``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ukf_sw.problems.finding import find
from ukf_sw.problems.placing import example_of
from ukf_sw.spec.fields import parameters_of
from ukf_sw.spec.parameters import UkfParams
from ukf_tools.cli.console import JsonOption, checked, needs, print_json
from ukf_tools.cli.lists import numbers, read_entry

# What takes long to import is imported by the command itself.
if TYPE_CHECKING:
    from ukf_sw.spec.float_format import FloatFormat
    from ukf_sw.tracing.models import TracedProblem

__all__ = ["models_app"]

models_app = typer.Typer(
    name="models", help="What the models of a problem compute.", no_args_is_help=True
)


@models_app.callback()
def models() -> None:
    """What the models of a problem compute."""


@models_app.command("show")
@needs("golden")
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
        int | None,
        typer.Option(
            "--steps",
            min=1,
            help="Steps of the data to look at for inputs and arguments; by default all that are "
            "recorded, and 100 of what is made.",
        ),
    ] = None,
    pes: Annotated[
        str | None,
        typer.Option(
            "--pes", metavar="P[,P...]", help="Numbers of PEs to schedule the programs for."
        ),
    ] = None,
    with_listing: Annotated[
        bool, typer.Option("--listing", help="Print the operations as well, row by row.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print the operations that f and each h consist of, once what is equal is computed once.

    Then what each needs as a program of a core, and with --pes how many clocks it takes. A model
    that cannot be a program of a core is refused, with the line that is the cause.
    """
    from ukf_sw.tracing.models import trace_problem
    from ukf_sw.tracing.report import listing_of, record_of

    with checked():
        wanted = [] if pes is None else numbers("--pes", pes)
        find(problem, "--problem")
        found = example_of(problem, steps)
        chosen = found.format
        if format is not None:
            chosen = read_entry("--format", format, parameters_of(UkfParams)["format"])
        traced = trace_problem(found)
        records = [record_of(model, found, chosen) for model in traced.models]
        programs = _programs(found, traced, chosen, wanted)
    records = [
        record | {"program": program} for record, program in zip(records, programs, strict=True)
    ]
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
        *_program_lines(record["program"], format),
    ]


#: What the fields of the control word ask of the lanes, for people.
_FORMS = {
    "minus_zero": "products with their sign of zero", "scalar_addend": "scalar as addend",
    "one": "one as factor", "power": "powers of two", "exponent": "exponents",
    "clear_sign": "magnitudes", "copy_sign": "signs copied", "turn_bit_0": "signs by bit 0",
    "turn_bit_1": "signs by bit 1", "if_negative": "writes if negative",
    "if_not_negative": "writes if not negative", "if_odd": "writes if odd",
    "if_finite": "writes if finite",
}  # fmt: skip


def _programs(
    problem: Any, traced: "TracedProblem", format: "FloatFormat", pes: Sequence[int]
) -> list[dict[str, Any]]:
    """Describe the programs of models, in their order, or why there are none in a format."""
    from ukf_sw.errors import FormatOverflowError
    from ukf_sw.lowering.program import lower
    from ukf_tools.estimate.model_costs import clocks_of_models, cost_of

    params = replace(problem.params, format=format)
    try:
        models = lower(traced, problem, format)
    except FormatOverflowError:
        raise
    except ValueError as error:
        # The format has no coefficients for a function.
        return [{"refused": str(error)} for _ in traced.models]
    clocks = clocks_of_models(replace(params, models=models), pes)
    return [
        cost_of(program, [operation.label for operation in model.graph.functions])
        | {"clocks": {str(number): count for number, count in counts.items()}}
        for model, program, counts in zip(traced.models, models, clocks.values(), strict=True)
    ]


def _program_lines(program: Mapping[str, Any], format: str) -> list[str]:
    """Give what is known of the program of a model in lines."""
    if "refused" in program:
        return [f"  program: none, {program['refused']}"]
    errors = [
        f"{entry['name']} " + ("?" if entry["error_ulp"] is None else f"{entry['error_ulp']:.2f}")
        for entry in program["functions"]
    ]
    forms = [_FORMS[name] for name in program["forms"]]
    forms += ["signed 1/sqrt"] if program["signed_roots"] else []
    needs = (
        f"{program['slots']} issue slots a beat and {program['once']} once, words through 1/sqrt: "
        f"{program['streams']}, temporaries: {program['temporaries']} at most"
    )
    scalars, words = len(program["scalars"]), len(program["words"])
    lines = [
        f"  program: {needs}",
        f"  constants of it: {scalars} as scalars, {words} as words",
        f"  largest errors of functions in {format}, in ulp: {', '.join(errors) or 'none'}",
        f"  lanes need: {', '.join(forms) or 'nothing more'}",
        "  powers and exponents: "
        + ("built in" if program["powers"] or program["exponents"] else "not built in"),
    ]
    if program["clocks"]:
        said = ", ".join(f"{count} with {pes} PEs" for pes, count in program["clocks"].items())
        lines.append(f"  clocks: {said}")
    return lines
