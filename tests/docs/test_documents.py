"""Generated sections of the documents."""

import subprocess

import pytest

from ukf_docs import DOCS, README, ROOT, sections
from ukf_docs import __main__ as commands
from ukf_docs.applications import DOCUMENT as APPLICATIONS
from ukf_docs.applications import SECTIONS as OF_APPLICATIONS
from ukf_docs.diagrams import DIAGRAMS
from ukf_docs.documents import DOCUMENTS, make_sections
from ukf_docs.markdown import table

TEXT = "before\n<!-- BEGIN GENERATED x -->\nold\n<!-- END GENERATED x -->\nafter\n"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: file.name)
def test_sections_are_current(document):
    """Run `make refresh` if this fails."""
    text = document.read_text(encoding="utf-8")
    assert sections.refresh(text, make_sections(document)) == text


@pytest.mark.parametrize("document", [README, *DOCS.glob("*.md")], ids=lambda file: file.name)
def test_every_section_is_made_by_something(document):
    known = list(DOCUMENTS.get(document, {}))
    if document == APPLICATIONS:
        known += OF_APPLICATIONS
    text = document.read_text(encoding="utf-8")
    assert sorted(sections.find(text)) == sorted(known)
    assert text.count("<!-- BEGIN") == text.count("<!-- END") == len(known)


def test_sections_are_replaced_and_the_rest_stays():
    new = TEXT.replace("old", "| new |")
    assert sections.refresh(TEXT, {"x": "\n| new |\n"}) == new
    assert sections.refresh(new, {"x": "| new |"}) == new
    assert sections.refresh(TEXT, {}) == TEXT
    assert sections.find(TEXT) == ["x"]


@pytest.mark.parametrize("marker", ["BEGIN", "END"])
def test_missing_markers_are_an_error(tmp_path, marker):
    file = tmp_path / "page.md"
    file.write_text(TEXT.replace(f"<!-- {marker} GENERATED x -->", ""))
    message = r"text must have the markers of the section 'x'$"
    with pytest.raises(ValueError, match="^" + message):
        sections.refresh(file.read_text(), {"x": "new"})
    with pytest.raises(ValueError, match=r"^page\.md: " + message):
        sections.update(file, {"x": "new"})


def test_refresh_writes_what_changed(tmp_path, documents, monkeypatch):
    stale, current = tmp_path / "stale.md", tmp_path / "current.md"
    stale.write_text(TEXT)
    current.write_text(TEXT.replace("old", "new"))
    made = {stale: {"x": lambda: "new"}, current: {"x": lambda: "new"}}
    monkeypatch.setattr("ukf_docs.documents.DOCUMENTS", made)
    monkeypatch.setattr("ukf_docs.diagrams.FOLDER", tmp_path / "diagrams")
    *diagrams, document = documents("refresh").stdout.splitlines()
    assert document.startswith(f"{stale}  ")
    assert len(diagrams) == len(DIAGRAMS)
    assert documents("refresh").stdout == ""
    assert stale.read_text() == current.read_text() == TEXT.replace("old", "new")


def test_tables_are_rectangular():
    assert table(("a", "b"), [(1, "x")]) == "| a | b |\n|---|---:|\n| 1 | x |\n"
    with pytest.raises(ValueError, match=r"^row must have 2 cells, not \(1,\)$"):
        table(("a", "b"), [(1,)])


def test_every_study_has_a_target_of_make():
    """Its name stands where a section has not been measured."""
    for name in commands.STUDIES:
        command = ["make", "--dry-run", name]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        assert f"-m ukf_docs measure {name}\n" in done.stdout


def test_make_sweeps_the_whole_design_space():
    """Commas separate the arguments of functions of make."""
    command = ["make", "--dry-run", "sweep"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "--pes 1,2,4,5,8,10,11,16,22 --form square-root,covariance" in printed
