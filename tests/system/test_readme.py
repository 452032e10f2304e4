"""Generated tables of the documentation."""

from pathlib import Path

import pytest

from ukf_sim.documentation import readme

README = Path(__file__).parents[2] / "README.md"


@pytest.mark.parametrize("document", readme.DOCUMENTS, ids=lambda file: file.name)
def test_tables_are_current(document):
    """Run `make readme` if this fails."""
    text = document.read_text(encoding="utf-8")
    assert readme.refresh(text, readme.DOCUMENTS[document]) == text


@pytest.mark.parametrize("name", readme.SECTIONS)
def test_missing_markers_are_an_error(name):
    text = README.read_text(encoding="utf-8").replace(f"<!-- BEGIN GENERATED {name} -->", "")
    with pytest.raises(ValueError, match=f"^text must have the markers of the section '{name}'$"):
        readme.refresh(text)
