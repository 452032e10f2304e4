"""Command ``ukf disassemble``."""

from typing import Annotated, Any

import typer

from ukf_sw.spec.core import Core
from ukf_sw.spec.sequence import Program
from ukf_tools.cli.console import JsonOption, checked, print_json
from ukf_tools.cli.options import with_core

__all__ = ["disassemble"]

#: How to read a listing.
_LEGEND = """\
clock: of the reads, from the first word of the program on; done: clock of the write.
Ez[0][4..7]: columns 4 to 7 of that row. A name alone: one number, the same in all lanes.
s3: register of the scalar file. x', L': the copies that become current at the end of the step."""


@with_core
def disassemble(
    core: Core,
    program: Annotated[
        str | None,
        typer.Option(
            "--program",
            metavar="NAME",
            help=f"{', '.join(each.name for each in Program)}; all of them by default.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Print the programs of a core as its control words say them: clock, operation, operands.

    What each beat of an operation reads stands on a line, with its clock.
    """
    from ukf_sw.engine import disassembler
    from ukf_sw.engine.microcode import microcode
    from ukf_sw.engine.mnemonics import Mnemonics, say_columns

    chosen = list(Program) if program is None else [_find(program)]
    code = microcode(core.params, core.pipeline)
    mnemonics = Mnemonics(code)
    found = {
        each: disassembler.disassemble(code, *each)
        for wanted in chosen for each in code.programs if each.program is wanted
    }  # fmt: skip
    if as_json:
        programs: list[dict[str, Any]] = [
            {
                "program": each.program.name,
                "sensor": each.sensor,
                "words": len(code.words_of(*each)),
                "operations": [mnemonics.record(entry) for entry in instructions],
            }
            for each, instructions in found.items()
        ]
        columns = {name: list(range(*span)) for name, span in code.layout.spans.items()}
        print_json({**core.record(), "columns": columns, "programs": programs})
        return
    typer.echo(core.title)
    spans = (f"{say_columns(range(*span))} {name}" for name, span in code.layout.spans.items())
    typer.echo(f"Columns: {', '.join(spans)}.\n{_LEGEND}")
    for each, instructions in found.items():
        typer.echo("\n" + mnemonics.listing(each, instructions))


def _find(name: str) -> Program:
    """Give the program of a name."""
    with checked():
        try:
            return Program[name.upper()]
        except KeyError:
            known = ", ".join(each.name for each in Program)
            raise ValueError(f"--program must be one of {known}, not {name!r}") from None
