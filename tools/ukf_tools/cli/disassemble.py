"""Command ``ukf disassemble``."""

from typing import Any

import typer

from ukf_sw.spec.core import Core
from ukf_tools.cli.console import JsonOption, print_json
from ukf_tools.cli.options import with_core
from ukf_tools.cli.programs import ProgramOption, chosen

__all__ = ["disassemble"]

#: How to read a listing.
_LEGEND = """\
clock: of the reads, from the first word of the program on; done: clock of the write.
Ez[0][4..7]: columns 4 to 7 of that row. A name alone: one number, the same in all lanes.
s3: register of the scalar file. x', L': the copies that become current at the end of the step.
A number in a program of a model: a word that is constant. Ex, Ez, G and root are lent there."""


@with_core
def disassemble(
    core: Core,
    program: ProgramOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the programs of a core as its control words say them: clock, operation, operands.

    What each beat of an operation reads stands on a line, with its clock.
    """
    from ukf_sw.engine import disassembler
    from ukf_sw.engine.microcode import microcode
    from ukf_sw.engine.mnemonics import Mnemonics, say_columns

    code = microcode(core.params, core.pipeline)
    mnemonics = Mnemonics(code)
    found = {each: disassembler.disassemble(code, *each) for each in chosen(program, code.programs)}
    if as_json:
        programs: list[dict[str, Any]] = [
            {
                "program": each.program.name,
                "sensor": each.sensor,
                "variant": each.variant,
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
