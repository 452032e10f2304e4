"""Tables and figures of docs/applications.md."""

import json
from dataclasses import asdict, replace

import pytest

from support.command_line import runner_of
from support.swampsat_study import study_of
from ukf_docs import __main__ as commands
from ukf_docs import applications
from ukf_docs.markdown import thousands
from ukf_sw.drivers.driver import Traffic
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
    assert "missed" not in text.partition("END GENERATED errors")[0]
    assert "| 2 s | 5 | 1 (5.63) **missed** |" in text
    assert "| 1 | 0 % | 1.05 | 50 % | 1 | 1 |" in text
    assert (tmp_path / "figures" / "pendulum.png").is_file()
    (tmp_path / records[0]["plots"][0]).unlink()
    message = "pendulum must have its figure, not without"
    assert message in documents("applications", code=1).stderr


def cosimulation(models, **changes):
    """The record of a co-simulation."""
    cycles = {"PREDICT": 34, "SIG_GEN": 69, "UPDATE": 145}
    traffic = asdict(Traffic(words_read=10, words_written=20, starts=1, control_reads=7))
    record = {
        "name": "pendulum", "backend": "cosim", "models": models, "pes": 1, "steps": 30,
        "okay": True, "words_compared": 2030, "cycles": cycles, "traffic": traffic,
    }  # fmt: skip
    return record | changes


def test_models_in_software_and_on_the_core_are_beside_each_other(results):
    records = json.loads((results / "errors.json").read_text())
    software, core = records
    assert (software["models"], core["models"]) == ("software", "core")
    records += [
        cosimulation("software"),
        cosimulation("core", words_compared=1433, cycles={"F": 141, "SIG_GEN": 69, "H": 245}),
        cosimulation("software", name="other", okay=False),
    ]  # fmt: skip
    study = swampsat.evaluate_study(study_of()).as_dict()
    made = applications.sections([*records, study], study_of())
    lines = [line.split(" | ") for line in made["errors"].splitlines()[2:]]
    for line, there, here in zip(lines, software["errors"], core["errors"], strict=True):
        numbers = [there["float64_rms"], there["rms"], here["rms"]]
        assert [line[k] for k in (3, 4, 6)] == [f"{number:.4g}" for number in numbers]
        for column, error in ((5, there), (7, here)):
            difference = error["rms"] / error["float64_rms"] - 1.0
            assert line[column] == f"{difference:+.2%}"
    pairs = made["cosimulations"].splitlines()[2:]
    assert pairs[0] == "| pendulum | 1 | 30 | 2 030 | 248 | 31 | 1 433 | 455 | 31 |".replace(
        "2 030", thousands(2030)
    ).replace("1 433", thousands(1433))
    assert pairs[1] == "| other | 1 | 30 | **differs** | 248 | 31 | – | – | – |"
    core["rounding"][0]["okay"] = core["verdicts"][1]["okay"] = False
    first, second = applications.sections([*records, study], study_of())["errors"].splitlines()[2:]
    assert first.split(" | ")[7].endswith("% **missed**")
    assert second.endswith(" **missed** |")
    core |= {"errors": [], "rounding": [], "verdicts": []}  # it stopped
    first, _ = applications.sections([*records, study], study_of())["errors"].splitlines()[2:]
    assert first.split(" | ")[6:8] == ["–", "–"]
