"""Documents with generated sections, and what makes each section.

Sections derive from the code, or from what a study has measured and noted; so they can be made
again in seconds, and a test demands that they are current. Those of docs/applications.md that
:mod:`ukf_docs.applications` makes are of a run of all applications instead.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from ukf_docs import DOCS, README
from ukf_docs.markdown import table, thousands
from ukf_docs.studies import STUDIES
from ukf_docs.studies.elementary import exact_table
from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.generate import description
from ukf_hdl.interfaces.register_page import register_map
from ukf_sw.engine.disassembler import disassemble
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.mnemonics import Mnemonics
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.design_report import paper_2018
from ukf_tools.vivado.commands import COMMANDS, PROPERTIES, VERSIONS

__all__ = ["DOCUMENTS", "make_sections"]

#: Numbers of processing elements of the table of cycles; the paper has all but the last.
PES = (*paper_2018.LATENCY, 22)


def _cycles() -> str:
    """Cycles of an iteration, from the schedules."""
    rows: list[tuple[object, ...]] = []
    for pes in PES:
        paper = paper_2018.LATENCY.get(pes)
        cells: list[str] = []
        for form in (Form.SQUARE_ROOT, Form.COVARIANCE):
            code = microcode(replace(NANOSAT, pes=pes, form=form), Pipeline())
            predict, update = code.clocks(Program.PREDICT), code.clocks(Program.UPDATE)
            cells.append(f"{predict} + {update} = **{predict + update}**")
        rows.append((pes, *cells, "–" if paper is None else thousands(paper.cycles)))
    headings = (
        "PEs", "square-root form: PREDICT + UPDATE", "covariance form", "2018 paper",
    )  # fmt: skip
    return table(headings, rows, left=0)


def _registers() -> str:
    """Registers and buffer of the nanosatellite's core."""
    return register_map(description(UkfCore(replace(NANOSAT, pes=2))))


def _vivado() -> str:
    """What the scripts use of Vivado, and where that was read."""
    entries = [
        *((f"`{name}`", entry) for name, entry in COMMANDS.items()),
        *((f"`{name}` of a {kind}", entry) for (kind, name), entry in PROPERTIES.items()),
    ]
    rows = [
        (
            what,
            " ".join(f"`{option}`" for option in sorted(entry.valued | entry.flags)) or "–",
            *map(entry.status, VERSIONS),
            entry.read,
        )
        for what, entry in entries
    ]
    headings = ("Command or property", "Options", VERSIONS[0], VERSIONS[-1][:4], "Read in")
    return table(headings, rows, left=len(headings))


def _listing() -> str:
    """A short program, disassembled."""
    code = microcode(UkfParams(n=2, m=1, pes=2), Pipeline())
    found = disassemble(code, Program.PREDICT)
    return f"```text\n{Mnemonics(code).listing(Routine(Program.PREDICT), found)}\n```"


def _printed(*arguments: str) -> str:
    """What a command prints on 100 columns, in a process of its own: a console has one width."""
    done = subprocess.run(
        [sys.executable, "-m", "ukf_tools", *arguments], env={**os.environ, "COLUMNS": "100"},
        capture_output=True, encoding="utf-8", check=True,
    )  # fmt: skip
    return "".join(f"{line.rstrip()}\n" for line in done.stdout.splitlines())


def _explained() -> str:
    """Where the clocks of a program go."""
    core = ("--problem", "nanosat", "--pes", "10")
    return f"```text\n{_printed('latency', *core, '--explain', '--program', 'UPDATE')}```"


def _pes() -> str:
    """Numbers of processing elements, the last thing that is printed."""
    printed = _printed("latency", "--problem", "nanosat", "--pes", "10", "--explain")
    return f"```text\n{printed[printed.index('Numbers of PEs') :]}```"


#: Functions that make sections, by document and name of the section.
DOCUMENTS: dict[Path, dict[str, Callable[[], str]]] = {
    README: {"cycles": _cycles},
    DOCS / "registers.md": {"registers": _registers},
    DOCS / "board.md": {"vivado": _vivado},
    DOCS / "inside.md": {"listing": _listing},
    DOCS / "design-space.md": {"explained": _explained, "pes": _pes},
    DOCS / "numerics.md": {"exact-functions": exact_table},
}
for _study in STUDIES.values():
    DOCUMENTS.setdefault(_study.document, {}).update(
        {name: partial(_study.section, name) for name in _study.tables}
    )


def make_sections(document: Path) -> dict[str, str]:
    """Make the sections of a document, by name."""
    return {name: make() for name, make in DOCUMENTS[document].items()}
