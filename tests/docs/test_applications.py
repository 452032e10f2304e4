"""Tables and figures of docs/applications.md."""

import json
from dataclasses import replace

import pytest

from support.command_line import runner_of
from support.swampsat_study import study_of
from ukf_docs import __main__ as commands
from ukf_docs import applications
from ukf_sw.problems import catalogue, finding
from ukf_tools.cli import app
from ukf_tools.evaluate import evaluation, swampsat


@pytest.fixture
def results(tmp_path, monkeypatch):
    """Folder of the results of `ukf apps all`, the study of SwampSat apart."""
    entry = replace(catalogue.CATALOGUE["pendulum"], runs=2)
    for module in (catalogue, evaluation, finding):
        monkeypatch.setattr(module, "CATALOGUE", {entry.name: entry})
    runner_of(app, tmp_path, monkeypatch)("apps", "all")
    return tmp_path / "build" / "apps"


def test_document_is_made_of_results(documents, results, tmp_path, monkeypatch):
    records = json.loads((results / "errors.json").read_text())
    study = swampsat.evaluate_study(study_of()).as_dict()
    records.append(study | {"plots": records[0]["plots"]})
    (results / "errors.json").write_text(json.dumps(records))
    file = tmp_path / "page.md"
    monkeypatch.setattr(applications, "DOCUMENT", file)
    monkeypatch.setattr(commands, "DOCS", tmp_path)
    file.write_text("")
    message = "swampsat.json: No such file or directory; run `ukf apps all` first"
    assert message in documents("applications", code=1).stderr
    (results / "swampsat.json").write_text(json.dumps(study_of()))
    assert "page.md: text must have the markers" in documents("applications", code=1).stderr
    file.write_text("\n".join(
        f"<!-- BEGIN GENERATED {name} -->\n<!-- END GENERATED {name} -->"
        for name in applications.SECTIONS
    ))  # fmt: skip
    documents("applications")
    text = file.read_text()
    assert "| [pendulum](#pendulum) | 2 | angle / rad |" in text
    assert "| 2 s | 5 | 1 (5.63) **missed** |" in text
    assert "| 1 | 0 % | 1.05 | 50 % | 1 | 1 |" in text
    assert (tmp_path / "figures" / "pendulum.png").is_file()
    (tmp_path / records[0]["plots"][0]).unlink()
    message = "pendulum must have its figure, not without"
    assert message in documents("applications", code=1).stderr
