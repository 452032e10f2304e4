"""Generated tables of the documentation."""

import subprocess
from pathlib import Path

import pytest

from ukf_docs import sections

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"


@pytest.mark.parametrize("document", sections.DOCUMENTS, ids=lambda file: file.name)
def test_tables_are_current(document):
    """Run `make readme` if this fails."""
    text = document.read_text(encoding="utf-8")
    assert sections.refresh(text, sections.DOCUMENTS[document]) == text


@pytest.mark.parametrize("name", sections.SECTIONS)
def test_missing_markers_are_an_error(name):
    text = README.read_text(encoding="utf-8").replace(f"<!-- BEGIN GENERATED {name} -->", "")
    with pytest.raises(ValueError, match=f"^text must have the markers of the section '{name}'$"):
        sections.refresh(text)


def test_make_sweeps_the_whole_design_space():
    """Commas separate the arguments of functions of make."""
    command = ["make", "--dry-run", "sweep"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "--pes 1,2,4,5,8,10,11,16,22 --form square-root,covariance" in printed
