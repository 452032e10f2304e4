"""Applications: commands, records, figures, conversion."""

import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ukf_docs import applications as document
from ukf_docs.convert import convert_inertial, convert_odometry
from ukf_docs.studies import iteration as timing
from ukf_docs.studies import numerics
from ukf_sw.errors import NotFiniteError
from ukf_sw.problems import catalogue, data
from ukf_sw.spec.sequence import Step
from ukf_tools.cli import console
from ukf_tools.evaluate import runner, swampsat


@pytest.fixture
def apps(ukf):
    """Function that runs `ukf apps` in an empty folder."""
    return partial(ukf, "apps")


@pytest.fixture
def one_entry(monkeypatch):
    """Function that makes a catalogue of one entry, which may be changed."""

    def one_entry(name, **changes):
        entry = replace(catalogue.CATALOGUE[name], **changes)
        for module in (catalogue, runner):
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
        (["numerics", "--document", "none.md"], "--document must be a file, not 'none.md'"),
        (["document", "--document", "none.md"], "--document must be a file, not 'none.md'"),
        (["convert", "photo", "a", "b"], "KIND must be one of inertial, odometry, not 'photo'"),
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


def test_all_runs_everything(apps, one_entry):
    one_entry("pendulum", runs=2)
    assert "All within their bounds" in apps("all").stdout
    record = json.loads(apps("all", "--backend", "reference", "--json").stdout)[0]
    assert (record["runs"], record["backend"], record["okay"]) == (2, "reference", True)


def test_an_error_of_the_core_is_told(apps, monkeypatch):
    def broken(*arguments, **keywords):
        raise NotFiniteError(Step.PREDICT)

    monkeypatch.setattr(runner, "run_scenario", broken)
    record = json.loads(apps("run", "ctrv", "--json", code=1).stdout)
    assert record["stopped"] == "reference, seed 0: NotFiniteError: PREDICT met NaN or infinity"
    assert not record["okay"]
    assert "Stopped:" in apps("run", "ctrv", code=1).stdout


@pytest.mark.system
@pytest.mark.parametrize("name", ["pendulum", "ctrv-masked"])
def test_verilog_runs_an_application(apps, name):
    record = json.loads(apps("run", name, "--backend", "cosim", "--steps", 6, "--json").stdout)
    assert record["okay"]
    assert record["mismatch"] is None
    assert record["steps"] == 6
    assert record["words_compared"] > 300
    assert record["cycles"]["UPDATE"] > 0
    golden = json.loads(apps("run", name, "--steps", 6, "--json").stdout)
    rms = [[row["rms"] for row in entry["errors"]] for entry in (record, golden)]
    assert rms[0] == rms[1]


@pytest.mark.system
@pytest.mark.slow
@pytest.mark.parametrize("name", list(catalogue.CATALOGUE))
def test_verilog_runs_every_application(apps, name):
    assert json.loads(apps("run", name, "--backend", "cosim", "--json").stdout)["okay"]


@pytest.mark.parametrize("name", list(catalogue.CATALOGUE))
def test_co_simulations_have_updates(name):
    scenario = catalogue.CATALOGUE[name].scenario(0, runner.COSIM_STEPS)
    assert scenario.sampled is None or scenario.sampled.any()


def test_entries_are_run_by_several_processes(tmp_path):
    names = ("ctrv", "ctrv-masked")
    one, two = (
        list(runner.run_catalogue("reference", output=tmp_path / str(w), workers=w, names=names))
        for w in (1, 2)
    )
    assert [records[0]["name"] for records in two] == list(names)
    for key in ("errors", "verdicts", "okay", "runs"):
        assert [records[0][key] for records in one] == [records[0][key] for records in two]
    assert (tmp_path / "2" / "ctrv-reference.png").is_file()
    with pytest.raises(ValueError, match=r"^workers must be at least 1, not 0$"):
        list(runner.run_catalogue(output=tmp_path, workers=0))


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


# The document.


def study_of(median=1.0):
    """A study in which every error is the same."""
    found = {"median": median, "seeds": [median] * 5, "diverged": 0}
    columns = ("quest_sample", "quest_held", "ekf", "ukf_reference", "ukf_golden")
    points = [
        {"latency_s": 1.0, "loss": 0.0, "age_s": 1.05, "used": 0.5, "naive": found,
         "compensated": found}
    ]  # fmt: skip
    return {
        "rows": [
            {"name": name, "interval_s": 2.0} | dict.fromkeys(columns, found)
            for name in ("2 s", "5 s")
        ],
        "platform": {"delays": points, "losses": [], "interval_s": 2.0, "seeds": [0]},
        "eclipse": {"sunlit": dict.fromkeys(columns, found), "seeds": [0],
                    "eclipse": dict.fromkeys(columns, found)},
        "curves": {
            "2 s": {
                column: {"times": [1.0, 2.0], "attitude": [median] * 2, "bias": [[0.1] * 3] * 2}
                for column in columns
            }
        },
        "duration_s": 3000.0, "settled_after_s": 1500.0, "seeds": list(range(5)),
        "unit": "degrees", "columns": list(columns),
    }  # fmt: skip


def test_studies_are_judged():
    record = swampsat.study_record(study_of(1.05))
    okay = {verdict["error"]: verdict["okay"] for verdict in record["verdicts"]}
    assert okay["5 s, EKF"]
    assert okay["5 s, UKF golden"]
    assert not okay["2 s, UKF golden"]
    assert not okay["latency 1 s, naive"]
    assert record["judged"]
    assert not record["okay"]
    # A filter that broke off is outside of any bound.
    (verdict,) = (v for name, v in swampsat.judge(study_of(None)) if name == "5 s, EKF")
    assert not verdict.okay
    short = swampsat.study_record(study_of() | {"duration_s": 40.0})
    assert not short["judged"]
    assert short["okay"]


def test_study_has_an_exit_code(apps, tmp_path, monkeypatch):
    monkeypatch.setattr(swampsat, "run_study", lambda **keywords: study_of())
    result = apps("swampsat", code=1)
    assert "Outside of its bound: swampsat study" in result.stdout
    assert json.loads((tmp_path / "build/apps/swampsat.json").read_text()) == study_of()
    assert (tmp_path / "build/apps/swampsat-platform.png").is_file()
    monkeypatch.setattr(swampsat, "run_study", lambda **keywords: study_of() | {"seeds": [0]})
    assert "Not judged" in apps("swampsat", "--seeds", 1).stdout


def test_document_is_made_of_results(apps, one_entry, tmp_path, monkeypatch):
    monkeypatch.setattr(document, "timing_table", lambda measured: "a table")
    one_entry("pendulum", runs=2)
    apps("all")
    folder = tmp_path / "build" / "apps"
    records = json.loads((folder / "errors.json").read_text())
    records.append(swampsat.study_record(study_of()) | {"plots": records[0]["plots"]})
    (folder / "errors.json").write_text(json.dumps(records))
    file = tmp_path / "page.md"
    file.write_text("")
    assert "swampsat.json: No such file" in apps("document", "--document", file, code=1).stderr
    (folder / "swampsat.json").write_text(json.dumps(study_of()))
    names = ("errors", "cosimulations", "timing", "swampsat", "platform")
    file.write_text("\n".join(f"<!-- BEGIN {name} -->\n<!-- END {name} -->" for name in names))
    apps("document", "--document", file, "--figures", "figures")
    text = file.read_text()
    assert "| [pendulum](#pendulum) | 2 | angle / rad |" in text
    assert "| 2 s | 5 | 1 (5.63) **missed** |" in text
    assert "| 1 | 0 % | 1.05 | 50 % | 1 | 1 |" in text
    assert (tmp_path / "figures" / "pendulum.png").is_file()
    (tmp_path / records[0]["plots"][0]).unlink()
    message = "pendulum must have its figure, not without"
    assert message in apps("document", "--document", file, code=1).stderr


def test_timing_adds_up():
    traffic = timing.Traffic(words=362, control=8, clocks=10_743, cycles=4971, pes=1)
    assert traffic.microseconds(0) == pytest.approx(3.70 * 15.6 + 21.0)
    assert traffic.microseconds(4971) == pytest.approx(3.70 * 15.6 + 21.0 + 49.71)
    # What is kept is what the schedule and the bus say, but for the beginning of a wait.
    for name, found in timing.load().items():
        expected = (found.words + found.control) * timing.BUS_CLOCKS + found.cycles
        assert found.clocks == pytest.approx(expected, rel=0.02), name
    table = timing.timing_table(timing.load())
    assert "| total | 660 | 363 | 272 | 228 | 212 | **" in table


# Conversion.


def test_odometry_is_converted(apps, tmp_path, monkeypatch):
    table = np.random.default_rng(1).standard_normal((20, 7))
    np.savetxt(tmp_path / "raw.txt", table, header="t gyro vx vy theta px py", comments="")
    assert "odometry.npz" in apps("convert", "odometry", "raw.txt", "odometry.npz").stdout
    monkeypatch.setattr(data, "files", lambda package: tmp_path)
    found = data.load_odometry()
    np.testing.assert_allclose(found["times"], table[:, 0], rtol=1e-15)
    np.testing.assert_allclose(found["gyroscope"], table[:, 1], rtol=1e-7)
    np.testing.assert_allclose(found["speeds"], table[:, 2:4], rtol=1e-7)
    np.testing.assert_allclose(found["truth"], table[:, 4:], rtol=1e-7)
    (tmp_path / "other.txt").write_text("a b c\n1 2 3\n")
    with pytest.raises(ValueError, match=r"^other\.txt must start with t gyro .*, not \['a', 'b'"):
        convert_odometry(tmp_path / "other.txt", tmp_path / "x.npz")
    assert "none.txt: No such file" in apps("convert", "odometry", "none.txt", "x", code=1).stderr


def test_inertial_data_are_converted(tmp_path, monkeypatch):
    io = pytest.importorskip("scipy.io")
    rng = np.random.default_rng(2)
    truth = rng.standard_normal((30, 4))
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    truth[5] = np.nan
    raw = {
        "imu_gyr": rng.standard_normal((30, 3)), "imu_acc": 9.0 * rng.standard_normal((30, 3)),
        "imu_mag": 40.0 * rng.standard_normal((30, 3)), "opt_quat": truth,
        "movement": np.arange(30)[:, None] > 9, "sampling_rate": 100.0,
    }  # fmt: skip
    io.savemat(tmp_path / "raw.mat", raw)
    convert_inertial(tmp_path / "raw.mat", tmp_path / "inertial.npz")
    monkeypatch.setattr(data, "files", lambda package: tmp_path)
    found = data.load_inertial()
    np.testing.assert_allclose(found["gyroscope"], raw["imu_gyr"], atol=1e-4)
    np.testing.assert_allclose(found["accelerometer"], raw["imu_acc"], atol=1e-3)
    np.testing.assert_allclose(found["magnetometer"], raw["imu_mag"], atol=4e-3)
    np.testing.assert_allclose(found["truth"], truth, atol=1e-4)
    assert found["movement"].tolist() == [0.0] * 10 + [1.0] * 20
    assert float(found["rate"]) == 100.0
    io.savemat(tmp_path / "raw.mat", {"imu_gyr": raw["imu_gyr"]})
    with pytest.raises(ValueError, match=r"^raw\.mat must hold .*, not without \['imu_acc'"):
        convert_inertial(tmp_path / "raw.mat", tmp_path / "x.npz")


# Numerics.


def test_numerics_fill_the_document(tmp_path):
    file = tmp_path / "numerics.md"
    marked = "\n".join(
        f"<!-- BEGIN {name} -->\nold\n<!-- END {name} -->" for name in ("formats", "weights")
    )
    file.write_text(f"before\n{marked}\nafter\n")
    made = numerics.tables(["pendulum"], steps=100)
    document.update_document(file, made)
    text = file.read_text()
    assert text.startswith("before\n<!-- BEGIN formats -->\n\n| application")
    assert text.endswith("<!-- END weights -->\nafter\n")
    assert "old" not in text
    rows = [line.split(" | ") for line in made["formats"].splitlines()[2:]]
    # binary32 and binary64 are as good as float64; 16 bits are not.
    for row in rows:
        assert row[4] == "1"
        assert row[5] == "1 |"
        assert row[3] != "1"
    assert len(rows) == 2
    file.write_text("nothing")
    with pytest.raises(ValueError, match=r"^numerics\.md must have the markers <!-- BEGIN formats"):
        document.update_document(file, made)


@pytest.mark.parametrize(("name", "steps"), [("ctrv-masked", 500), ("battery", 600)])
def test_numerics_take_what_a_scenario_has(name, steps):
    scenario, errors, _ = numerics._prepare(name, 600)
    assert scenario.steps == len(errors) == steps


def test_numerics_say_where_a_core_stops():
    # The covariance form of CTRV in bfloat16 meets a pivot that is not positive.
    measured = numerics.measure_formats("ctrv", 30)
    stopped = str(measured[numerics.Form.COVARIANCE, "bfloat16"])
    assert stopped.startswith("stops at ")
    assert "NotPositiveDefinite" in stopped
    assert measured[numerics.Form.SQUARE_ROOT, "binary32"].ratio == pytest.approx(1.0, rel=1e-3)
