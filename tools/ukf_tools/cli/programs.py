"""Option ``--program`` of commands that look into the programs of a core."""

from collections.abc import Iterable
from typing import Annotated, Any

import typer

from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.cli.console import checked, fail

__all__ = ["ProgramOption", "chosen"]

_NAMES = ", ".join(each.name for each in Program)


def _find(name: Any) -> Program:
    """Give the program of a name, before its command begins."""
    with checked():
        try:
            return Program[name.upper()]
        except KeyError:
            raise ValueError(f"--program must be one of {_NAMES}, not {name!r}") from None


ProgramOption = Annotated[
    Program | None,
    typer.Option(
        "--program", metavar="NAME", parser=_find, help=f"{_NAMES}; all of them by default."
    ),
]


def chosen(program: Program | None, routines: Iterable[Routine]) -> list[Routine]:
    """Give the routines of a program, or of all, in the order of the programs.

    A program that the core does not have, as that of a model in software, ends the command.

    Parameters
    ----------
    program
        What the option says.
    routines
        Those of the core.
    """
    wanted = list(Program) if program is None else [program]
    known = list(routines)
    found = [each for one in wanted for each in known if each.program is one]
    if not found and program is not None:
        names = ", ".join(dict.fromkeys(each.program.name for each in sorted(known)))
        fail(f"--program must be one that the core has, {names}, not {program.name}")
    return found
