"""Studies: what they measure, not how fast it is; and their tables."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ukf_docs.studies import (
    STUDIES,
    baseline,
    bench,
    growth,
    iteration,
    numerics,
    rounding,
    routing,
    study,
)
from ukf_docs.studies.rounded_filter import RoundedFilter, Roundings
from ukf_sw.engine.microcode import microcode
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE, nanosat
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program
from ukf_tools.baseline import whole
from ukf_tools.baseline.counting import SECTIONS
from ukf_tools.baseline.report import PAPER


def test_filterpy_solves_the_same_problem():
    """Or the ratio of speeds would say nothing."""
    params = UkfParams(n=3, m=2, q=3, r=2)
    scenario = random_scenario(params, steps=20)
    ours = run(scenario, "reference")
    np.testing.assert_allclose(bench.run_filterpy(scenario, 20), ours.x, atol=1e-9)


def test_growth_is_studied_over_all_states_and_elements():
    points = growth.points()
    assert len(points) == len({(point.problem, point.core) for point in points})
    cores = [point.core.params for point in points if point.problem is None]
    expected = {(n, n, pes, form) for n in range(4, 32) for pes in (2, 8) for form in Form}
    assert {(core.n, core.q, core.pes, core.form) for core in cores} == expected
    nanosat = [point.core.params for point in points if point.problem == "nanosat"]
    assert {(core.pes, core.form) for core in nanosat} == {
        (pes, form) for pes in range(1, 23) for form in Form
    }
    assert {replace(core, pes=1, form=Form.SQUARE_ROOT) for core in nanosat} == {NANOSAT}


RECORDS = {
    bench: {
        "computer": {"processors": 2, "machine": "x86_64", "python": "3.11.2", "load": 0.5},
        "configuration": "nanosat",
        "models": {"golden": 1000.4, "reference": 5000.0, "filterpy": 500.0,
                   "golden_to_filterpy": 2.0008},
        "first_step": {"cold_seconds": 20.04, "warm_seconds": 1.54},
        "cosimulation": {"iterations_per_second": 12.34, "clocks_per_second": 45678.9},
        "generator": [{"n": 7, "schedule_seconds": 0.25, "generate_seconds": 3.21}],
        "sweep": {"points": 44, "workers": 2, "points_per_second": 5.25,
                  "cached_points_per_second": 999.9},
    },
    growth: [{"figure": "bus_words", "over": "n", "group": "2 PEs", "low": 4, "high": 31,
              "points": 28, "exponent": 1.987, "worst": 1.25}],
    routing: {
        "configuration": "nanosat", "tools": "tools",
        "rows": [{"pes": 2, "seed": 3, "mhz": 51.26, "path_ns": 20.0, "routing_ns": 12.0,
                  "lut4": 8000, "ff": 900, "multipliers": 4, "block_rams": 30}],
    },
}  # fmt: skip
EXPECTED = {
    bench: ["| golden model to filterpy | 2.00 |", "of the next one | 20.0 s, 1.5 s |",
            "12.3 iterations, 45679 clocks a second",
            "| n = 7: schedule, then generate | 0.2 s, 3.2 s |", "load 0.5 at the start"],
    growth: ["| bus words | states | 4 to 31 | 2 PEs | +1.99 | 25% |"],
    routing: ["| 2 | 3 | 51.3 MHz | 20.0 ns | 60% | 8000 | 900 | 4 | 30 |"],
}  # fmt: skip


@pytest.mark.parametrize("module", RECORDS, ids=lambda module: module.STUDY.name)
def test_tables_have_the_figures(module):
    (render,) = module.STUDY.tables.values()
    text = render(RECORDS[module])
    for line in EXPECTED[module]:
        assert line in text
    widths = {line.count("|") for line in text.splitlines() if line.startswith("|")}
    assert len(widths) == 1


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """A study that notes a number, and its document."""
    document = tmp_path / "page.md"
    document.write_text("<!-- BEGIN GENERATED count -->\n<!-- END GENERATED count -->\n")
    made = study.Study(
        name="counted", document=document, measure=lambda tell: {"count": 3},
        tables={"count": lambda record: f"It is {record['count']}."},
    )  # fmt: skip
    monkeypatch.setattr(study, "DOCS", tmp_path)
    monkeypatch.setitem(STUDIES, "bench", made)
    monkeypatch.setattr("ukf_docs.documents.DOCUMENTS", {
        document: {"count": lambda: made.section("count")}
    })  # fmt: skip
    return made


def test_measurements_are_noted_and_shown(counted, documents):
    assert counted.section("count") == "Not measured yet; `make counted` does.\n"
    assert "It is 3." in documents("measure", "bench").stdout
    assert json.loads(counted.file.read_text()) == counted.read() == {"count": 3}
    assert "It is 3." in counted.document.read_text()


def test_what_cannot_be_measured_leaves_the_note(counted, documents, monkeypatch):
    documents("measure", "bench")

    def fail(tell):
        raise RuntimeError("the core differs")

    monkeypatch.setitem(STUDIES, "bench", replace(counted, measure=fail))
    assert "Error: the core differs" in documents("measure", "bench", code=1).stderr
    assert counted.read() == {"count": 3}
    result = documents("measure", "bench", "weather", code=2)
    assert f"NAME must be one of {', '.join(STUDIES)}, not 'weather'" in result.stderr


# Roundings.


def states(problem, roundings):
    """Estimates of runs with some roundings, shape (steps, runs, n)."""
    filters = RoundedFilter(problem, np.tile(problem.x0, (len(roundings), 1)), roundings)
    z, _ = problem.samples()
    found = []
    for k in range(problem.steps):
        inputs = problem.record.inputs[k]
        filters.step(np.tile(inputs, (len(roundings), 1)), np.tile(z[k], (len(roundings), 1)))
        found.append(filters.x)
    return np.array(found)


@pytest.mark.parametrize("noise", Noise)
def test_with_all_roundings_it_is_the_golden_model_and_without_any_the_reference(noise):
    problem = replace(nanosat(1, noise=noise, steps=60), pes=4)
    cases = [Roundings(), *rounding.CASES.values()]
    x = states(problem, cases)
    np.testing.assert_array_equal(x[:, 1], run(problem, "golden").x)
    reference = run(problem, "reference").x
    np.testing.assert_allclose(x[:, 0], reference, rtol=0, atol=1e-9)
    # Each set of roundings does something, and something else than the others; an origin helps.
    assert len(np.unique(x[-1], axis=0)) == len(cases)
    off = np.sqrt(((x - reference[:, None])[10:, :, :4] ** 2).mean(axis=(0, 2)))
    assert off[-1] < off[1] / 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"form": Form.COVARIANCE}, "must have the square-root form, binary32 and W0 = 0"),
        ({"W0": 0.5}, "must have the square-root form, binary32 and W0 = 0"),
        ({"redraw": True}, "redraw must be False"),
    ],
)
def test_other_filters_are_not_emulated(change, message):
    problem = replace(nanosat(steps=1), **change)
    with pytest.raises(ValueError, match=message):
        RoundedFilter(problem, problem.x0[None], [Roundings()])


def test_roundings_are_measured_and_shown():
    problems = [
        replace(nanosat(seed, noise=Noise.ADDITIVE, steps=100), settled=0.05) for seed in (0, 1)
    ]
    row, *others = rounding.measure_roundings(problems, lambda *what: None)
    assert len(others) == len(rounding.CASES) - 1
    assert row["case"] == "all, as the core"
    assert len(row["loss"]) == 2
    assert all(abs(loss) < 0.5 for loss in row["loss"])
    assert 0.9 < row["deviation"] < 1.1
    text = rounding.STUDY.tables["roundings"]({"roundings": [{**row, "loss": [0.01, 0.03]}]})
    assert "| additive | all, as the core | +2.00 ± 1.00 % | 1.41 % |" in text


def test_resolution_is_that_of_the_state_that_moves_least():
    assert 2.0 < rounding.measure_resolution("battery", steps=300) < 1e6
    text = rounding.STUDY.tables["resolution"]({"resolution": {"nanosat": 0.9191}})
    assert "| nanosat | 0.92 |" in text


# Time of an iteration.


def test_times_add_up():
    traffic = iteration.IterationTraffic(words=362, control=8, clocks=10_743, cycles=4971, pes=1)
    assert traffic.microseconds(0) == pytest.approx(3.70 * 15.6 + 21.0)
    assert traffic.microseconds(4971) == pytest.approx(3.70 * 15.6 + 21.0 + 49.71)
    # What is kept is what the schedule and the bus say, but for the beginning of a wait.
    for name, found in iteration.load(iteration.STUDY.read()).items():
        expected = (found.words + found.control) * iteration.BUS_CLOCKS + found.cycles
        assert found.clocks == pytest.approx(expected, rel=0.02), name
    table = iteration.STUDY.section("iteration")
    assert "| total | 660 | 363 | 272 | 228 | 212 | **" in table


# Software alone.


def test_published_figures_hang_together():
    record = baseline.STUDY.read()
    assert record["paper"] == PAPER
    for variant in record["software"].values():
        sections = variant["us"]
        for bound in (0, 1):
            parts = sum(sections[name][bound] for name in SECTIONS)
            assert sections["total"][bound] == pytest.approx(parts)
            assert parts - sections["models"][bound] == pytest.approx(
                sections["without_models"][bound]
            )
    for rows in record["core"].values():
        for row in rows:
            low, high = row["total_us"]
            gsl = record["software"]["gsl"]["us"]
            assert low == pytest.approx(row["hardware_us"] + row["bus_us"] + row["models_us"][0])
            assert row["speedup_over"]["gsl"]["iteration"][0] == pytest.approx(
                min(gsl["total"][0] / low, gsl["total"][1] / high)
            )
    # What the document says about the check against the paper.
    check = record["check_against_paper"]
    assert check["models"][0] < PAPER["models"] < check["models"][1]
    assert check["update"][0] < PAPER["update"] < check["update"][1]
    assert check["predict"][1] < PAPER["predict"]
    for section in ("models", "update"):
        low, high = check[section]
        assert (low * high) ** 0.5 == pytest.approx(PAPER[section], rel=0.15)
        assert 3.0 < high / low < 4.0


def test_cycles_are_current():
    """Run `make baseline` if this fails."""
    record = baseline.STUDY.read()
    for noise, params in (("augmented", NANOSAT), ("additive", NANOSAT_ADDITIVE)):
        for row in record["core"][noise]:
            code = microcode(replace(params, pes=row["pes"]), Pipeline())
            assert row["cycles"] == code.clocks(Program.PREDICT) + code.clocks(Program.UPDATE)
        found = whole.measure(record["software"])[noise]
        assert json.loads(json.dumps(found)) == record["whole"][noise]


def test_what_is_said_of_whole_iterations():
    """The conclusions of docs/baseline.md, and the first page's."""
    for noise, rows in baseline.STUDY.read()["whole"].items():
        by_pes = {row["pes"]: row for row in rows}
        for pes, row in by_pes.items():
            low, high = row["software_us"]
            middle = (low * high) ** 0.5
            assert (row["iteration_us"] < middle) == (pes >= 10), (noise, pes)
            assert (row["iteration_us"] > high) == (pes <= 2), (noise, pes)
            assert row["iteration_us"] > low
            assert row["processor_us"] == pytest.approx(3.1, abs=0.05)
            assert row["words"] + row["register_words"] == 20
            if pes >= 10:
                assert 2.1 <= row["speedup"][1] < 3.55
    found = baseline.STUDY.read()["whole"]["augmented"][3]
    assert (found["pes"], round(found["iteration_us"])) == (10, 14)


# Numerics.


def test_numerics_are_measured():
    told = []
    record = numerics.measure(lambda *what: told.append(what), ["pendulum"], steps=100)
    assert json.loads(json.dumps(record)) == record
    assert told == [("pendulum: formats", 0, 2), ("pendulum: W0", 1, 2)]
    rows = [line.split(" | ") for line in numerics.STUDY.tables["formats"](record).splitlines()]
    # binary32 and binary64 are as good as float64; 16 bits are not.
    for row in rows[2:]:
        assert row[4] == "1"
        assert row[5] == "1 |"
        assert row[3] != "1"
    assert len(rows) == 2 + 2
    assert len(numerics.STUDY.tables["weights"](record).splitlines()) == 2 + 2


@pytest.mark.parametrize(("name", "steps"), [("ctrv-masked", 500), ("battery", 600)])
def test_numerics_take_what_a_scenario_has(name, steps):
    found = numerics._prepare(name, 600)
    assert found.problem.steps == found.steps == steps


def test_numerics_say_where_a_core_stops():
    # In the covariance form bfloat16 leaves rounding noise of the nanosatellite's observations.
    measured = numerics.measure_formats("nanosat", 10)
    assert str(measured[numerics.Form.COVARIANCE, "bfloat16"]).startswith(
        "stops at 0: UPDATE SingularObservation "
    )
    assert measured[numerics.Form.SQUARE_ROOT, "binary32"].ratio == pytest.approx(1.0, rel=1e-3)
