"""Applications: commands, records, figures."""

import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from support.swampsat_study import study_of
from ukf_sw.errors import NotFiniteError
from ukf_sw.problems import catalogue, finding
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.core import Placement
from ukf_sw.spec.sequence import Step
from ukf_tools.cli import console
from ukf_tools.evaluate import evaluation, swampsat


@pytest.fixture
def apps(ukf):
    """Function that runs `ukf apps` in an empty folder."""
    return partial(ukf, "apps")


@pytest.fixture
def one_entry(monkeypatch):
    """Function that makes a catalogue of one entry, which may be changed."""

    def one_entry(name, **changes):
        entry = replace(catalogue.CATALOGUE[name], **changes)
        for module in (catalogue, evaluation, finding):
            monkeypatch.setattr(module, "CATALOGUE", {name: entry})
        return entry

    return one_entry


def test_list_names_every_entry(apps, monkeypatch):
    monkeypatch.setattr(console.results, "width", 400)  # a narrow terminal breaks lines
    text = apps("list").stdout
    records = json.loads(apps("list", "--json").stdout)
    assert [record["name"] for record in records] == list(catalogue.CATALOGUE)
    assert all(record["name"] in text and record["doc"] in text for record in records)
    sizes = {record["name"]: [record[key] for key in "nqrm"] for record in records}
    assert sizes["gps-ins"] == [15, 12, 6, 6]


def test_run_judges_whole_runs(apps, tmp_path):
    record = json.loads(apps("run", "ctrv", "--json").stdout)
    assert record["judged"]
    assert record["okay"]
    assert record["steps"] == 500
    assert [verdict["error"] for verdict in record["verdicts"]] == [
        "x", "y", "velocity x", "velocity y",
    ]  # fmt: skip
    for row, verdict in zip(record["errors"], record["verdicts"], strict=True):
        assert verdict["value"] == row["rms"]
        assert row["rms"] == pytest.approx(row["float64_rms"], rel=1e-3)
        assert verdict["origin"]
    image = tmp_path / record["plots"][0]
    assert image.read_bytes().startswith(b"\x89PNG")
    assert 8_000 < image.stat().st_size < 80_000


def test_models_on_the_core_are_judged_as_well(apps, tmp_path):
    """By the same bounds, beside float64: at 1 % but for named exceptions."""
    made = [json.loads(apps("run", "ctrv-masked", "--models", each, "--json").stdout)
            for each in ("software", "core")]  # fmt: skip
    assert [record["models"] for record in made] == ["software", "core"]
    for record in made:
        assert record["okay"]
        assert len(record["verdicts"]) == len(record["rounding"]) == 4
        assert all(each["high"] == 1.01 * each["reference"] for each in record["rounding"])
    assert made[0]["verdicts"][0]["value"] != made[1]["verdicts"][0]["value"]
    assert made[0]["verdicts"][0]["float64"] == made[1]["verdicts"][0]["float64"]
    plots = [Path(record["plots"][0]).name for record in made]
    assert plots == ["ctrv-masked-golden.png", "ctrv-masked-golden-models-core.png"]
    assert (tmp_path / made[1]["plots"][0]).is_file()


def test_run_does_not_judge_beginnings(apps):
    result = apps("run", "battery", "--backend", "reference", "--steps", 30, "--output", "out")
    assert "Not judged" in result.stdout
    assert "Plot: out/battery-reference.png" in result.stdout


def test_seeds_matter(apps):
    first, second = (
        json.loads(apps("run", "pendulum", "--steps", 20, "--seed", seed, "--json").stdout)
        for seed in (0, 1)
    )
    assert first["errors"][0]["rms"] != second["errors"][0]["rms"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "clock"], "NAME must be one of nanosat, "),
        (["run", "ctrv", "--steps", 501], "steps must be between 1 and 500, not 501"),
        (
            ["run", "ctrv", "--backend", "reference", "--models", "f"],
            "--models must be software of the reference, not 'f'",
        ),
        (["all", "--models", "cores"], "--models must be one of software, core, f, h, not 'cores'"),
    ],
)
def test_mistakes_are_named(apps, arguments, message):
    assert message in apps(*arguments, code=2).stderr


def test_errors_outside_of_their_bounds_have_an_exit_code(apps, one_entry, tmp_path):
    bound = catalogue.Bound(error="angle", high=1e-6, origin="nothing is so good")
    one_entry("pendulum", bounds=(bound,), runs=1)
    assert json.loads(apps("run", "pendulum", "--json", code=1).stdout)["okay"] is False
    result = apps("all", "--output", tmp_path / "out", code=1)
    assert "Outside of its bound: pendulum" in result.stdout
    records = json.loads((tmp_path / "out" / "errors.json").read_text())
    assert [verdict["okay"] for verdict in records[0]["verdicts"]] == [False]


def test_models_on_the_core_that_are_beyond_have_an_exit_code(apps, one_entry, monkeypatch):
    """Though with models in software all is well."""
    judge = evaluation.judge

    def judged(runs, reference):
        found = judge(runs, reference)
        worse = 1.02 if runs[0].problem.models else 1.0
        errors = [replace(each, rms=worse * each.rms) for each in found.errors]
        return replace(found, errors=tuple(errors))

    monkeypatch.setattr(evaluation, "judge", judged)
    one_entry("pendulum", runs=1, bounds=())
    records = json.loads(apps("all", "--json", code=1).stdout)
    assert [(each["models"], each["okay"]) for each in records] == [
        ("software", True), ("core", False),
    ]  # fmt: skip


def test_models_on_the_core_may_stop_alone(apps, one_entry, monkeypatch):
    run = evaluation.run

    def broken(problem, backend, **options):
        if problem.models:
            problem = replace(problem, x0=[1e9, 0.0])  # beyond what a sine takes
        return run(problem, backend, **options)

    monkeypatch.setattr(evaluation, "run", broken)
    one_entry("pendulum", runs=2)
    there, here = json.loads(apps("all", "--models", "core,software", "--json", code=1).stdout)
    assert there["stopped"].startswith("golden, models core, seed 0: ModelNotFiniteError: ")
    assert (there["runs"], here["runs"], here["okay"]) == (0, 2, True)


def test_all_runs_everything(apps, one_entry):
    one_entry("pendulum", runs=2)
    assert "All within their bounds" in apps("all").stdout
    record = json.loads(apps("all", "--backend", "reference", "--json").stdout)[0]
    assert (record["runs"], record["backend"], record["okay"]) == (2, "reference", True)


def test_an_error_of_the_core_is_told(apps, monkeypatch):
    def broken(*arguments, **keywords):
        raise NotFiniteError(Step.PREDICT)

    monkeypatch.setattr(ReferenceUkf, "predict", broken)
    record = json.loads(apps("run", "ctrv", "--json", code=1).stdout)
    assert record["stopped"] == "reference, seed 0: NotFiniteError: PREDICT met NaN or infinity"
    assert not record["okay"]
    assert "Stopped:" in apps("run", "ctrv", code=1).stdout


@pytest.mark.system
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) for name in ("pendulum", "ctrv-masked")]
)
def test_verilog_runs_an_application(apps, name, monkeypatch):
    record = json.loads(apps("run", name, "--backend", "cosim", "--steps", 6, "--json").stdout)
    assert record["okay"]
    assert record["mismatch"] is None
    assert record["steps"] == 6
    assert record["words_compared"] > 300
    assert record["cycles"]["UPDATE"] > 0
    monkeypatch.setattr(evaluation, "PES", 1)  # as the simulated core
    golden = json.loads(apps("run", name, "--steps", 6, "--json").stdout)
    rms = [[row["rms"] for row in entry["errors"]] for entry in (record, golden)]
    assert rms[0] == rms[1]


@pytest.mark.system
@pytest.mark.slow
@pytest.mark.parametrize("models", ["software", "core"])
@pytest.mark.parametrize("name", list(catalogue.CATALOGUE))
def test_verilog_runs_every_application(apps, name, models):
    command = ("run", name, "--backend", "cosim", "--models", models, "--json")
    record = json.loads(apps(*command).stdout)
    assert (record["okay"], record["models"], record["steps"]) == (True, models, 30)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(catalogue.CATALOGUE))
def test_every_application_is_as_accurate_with_models_on_the_core(name):
    assert evaluation.evaluate(name, models=Placement.CORE).okay


@pytest.mark.parametrize("name", list(catalogue.CATALOGUE))
def test_co_simulations_have_updates(name):
    _, sampled = catalogue.CATALOGUE[name].scenario(0, evaluation.COSIM_STEPS).samples()
    assert sampled.any()


def test_entries_are_run_by_several_processes(tmp_path):
    names = ("ctrv", "ctrv-masked")
    one, two = (
        list(evaluation.evaluate_all("reference", output=tmp_path / str(w), workers=w, names=names))
        for w in (1, 2)
    )
    assert [made[0].name for made in two] == list(names)
    for key in ("judgement", "verdicts", "okay", "runs"):
        assert [getattr(made[0], key) for made in one] == [getattr(made[0], key) for made in two]
    assert (tmp_path / "2" / "ctrv-reference.png").is_file()
    with pytest.raises(ValueError, match=r"^workers must be at least 1, not 0$"):
        list(evaluation.evaluate_all(output=tmp_path, workers=0))


@pytest.fixture
def without_extra(monkeypatch):
    """The packages of the extra "apps" are not installed."""
    for module in list(sys.modules):
        if module.startswith(("ukf_sw.problems.systems.swampsat", "ukf_tools.evaluate.swampsat")):
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "erfa", None)


def test_what_is_not_installed_is_told(apps, without_extra, monkeypatch):
    row = {row["name"]: row for row in json.loads(apps("list", "--json").stdout)}["swampsat"]
    assert row["needs"] == "pip install 'ukf-core[apps]'"
    record = json.loads(apps("run", "swampsat", "--steps", 30, "--json", code=1).stdout)
    assert record["stopped"] == "erfa is not installed: pip install 'ukf-core[apps]'"
    assert "erfa is not installed: pip" in apps("swampsat", code=1).stderr


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("nanosat", ["nanosat-reference", "nanosat-figure-12a", "nanosat-figure-12b"]),
        (
            "nanosat-2014",
            ["nanosat-2014-reference", *(f"nanosat-2014-figure-{k}" for k in (1, 6, 7))],
        ),
    ],
)
def test_figures_of_the_papers_are_drawn(apps, name, files):
    command = ("run", name, "--backend", "reference", "--steps", 1000, "--json")
    record = json.loads(apps(*command).stdout)
    assert [Path(plot).stem for plot in record["plots"]] == files


# The study of SwampSat.


def test_studies_are_judged():
    made = swampsat.evaluate_study(study_of(1.05))
    okay = {verdict.error: verdict.okay for verdict in made.verdicts}
    assert okay["5 s, EKF"]
    assert okay["5 s, UKF golden"]
    assert not okay["2 s, UKF golden"]
    assert not okay["latency 1 s, naive"]
    assert not made.okay
    # A filter that broke off is outside of any bound.
    (verdict,) = (v for v in swampsat.compare(study_of(None)) if v.error == "5 s, EKF")
    assert not verdict.okay
    assert verdict.as_dict()["value"] is None
    short = swampsat.evaluate_study(study_of() | {"duration_s": 40.0})
    assert short.verdicts is None
    assert short.okay


def test_study_has_an_exit_code(apps, tmp_path, monkeypatch):
    monkeypatch.setattr(swampsat, "run_study", lambda **keywords: study_of())
    result = apps("swampsat", code=1)
    assert "Outside of its bound: swampsat study" in result.stdout
    assert json.loads((tmp_path / "build/apps/swampsat.json").read_text()) == study_of()
    assert (tmp_path / "build/apps/swampsat-platform.png").is_file()
    monkeypatch.setattr(swampsat, "run_study", lambda **keywords: study_of() | {"seeds": [0]})
    assert "Not judged" in apps("swampsat", "--seeds", 1).stdout
