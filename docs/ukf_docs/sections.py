"""Tables in the documentation that derive from the code or from measurements.

``python -m ukf_docs.sections`` refreshes them.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType

from ukf_docs.studies import bench, growth, resources, routing
from ukf_sw.engine.microcode import microcode
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec import registers
from ukf_sw.spec.parameters import Form, Pipeline
from ukf_sw.spec.sequence import Program
from ukf_tools.design_report import paper_2018

__all__ = ["DOCUMENTS", "SECTIONS", "refresh"]

README = Path(__file__).parents[2] / "README.md"

#: Numbers of processing elements of the table of cycles; the paper has all but the last.
PES = (*paper_2018.LATENCY, 22)


def _thousands(value: int) -> str:
    """Number with a space between thousands."""
    return f"{value:,}".replace(",", " ")


def cycles() -> str:
    """Cycles of an iteration, from the schedules."""
    rows = [
        "| PEs | square-root form: PREDICT + UPDATE | covariance form | 2018 paper |",
        "|----:|-----------------------------------:|----------------:|-----------:|",
    ]
    for pes in PES:
        paper = (
            _thousands(paper_2018.LATENCY[pes].cycles) if pes in paper_2018.LATENCY else "–"
        )  # fmt: skip
        cells: list[str] = []
        for form in (Form.SQUARE_ROOT, Form.COVARIANCE):
            code = microcode(replace(NANOSAT, pes=pes, form=form), Pipeline())
            predict, update = code.clocks(Program.PREDICT), code.clocks(Program.UPDATE)
            cells.append(f"{predict} + {update} = **{predict + update}**")
        rows.append(f"| {pes} | {cells[0]} | {cells[1]} | {paper} |")
    return "\n".join(rows) + "\n"


def measured(tables: ModuleType) -> str:
    """Table of the figures that a module has measured, or who measures them."""
    if not tables.MEASURED.exists():
        return f"Not measured yet; `make {tables.MEASURED.stem}` does.\n"
    return tables.markdown(json.loads(tables.MEASURED.read_text(encoding="utf-8")))


#: Function that renders each generated section of the README.
SECTIONS = {
    "cycles": cycles,
    "resources": partial(measured, resources),
    "registers": registers.markdown,
}

#: Documents with generated sections.
DOCUMENTS = {
    README: SECTIONS,
    README.parent / "docs" / "design-space.md": {
        "growth": partial(measured, growth),
        "ecp5": partial(measured, routing),
        "bench": partial(measured, bench),
    },
}


def refresh(text: str, sections: Mapping[str, Callable[[], str]] = SECTIONS) -> str:
    """Replace the generated sections of a Markdown text.

    Raises
    ------
    ValueError
        If the markers of a section are missing.
    """
    for name, render in sections.items():
        begin, end = f"<!-- BEGIN GENERATED {name} -->\n", f"<!-- END GENERATED {name} -->"
        head, found, rest = text.partition(begin)
        _, closed, tail = rest.partition(end)
        if not (found and closed):
            raise ValueError(f"text must have the markers of the section {name!r}")
        text = head + begin + render() + end + tail
    return text


if __name__ == "__main__":
    for document, sections in DOCUMENTS.items():
        old = document.read_text(encoding="utf-8")
        document.write_text(refresh(old, sections), encoding="utf-8")
