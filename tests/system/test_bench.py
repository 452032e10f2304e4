"""Studies of speed and growth: what they measure, not how fast it is."""

import json

import numpy as np
import pytest

from ukf_docs import sections
from ukf_docs.studies import bench, growth, routing
from ukf_sw.problems.configurations import random_scenario
from ukf_sw.problems.judging import make_backend, run_problem
from ukf_sw.spec.parameters import Form, UkfParams


class Reference:
    """A problem, as far as the reference wants one."""

    def __init__(self, params):
        self.params = params


def test_filterpy_solves_the_same_problem():
    """Or the ratio of speeds would say nothing."""
    params = UkfParams(n=3, m=2, q=3, r=2)
    scenario = random_scenario(params, steps=20)
    ours = run_problem(make_backend("reference", Reference(params)), scenario, 20)["x"]
    np.testing.assert_allclose(bench.run_filterpy(scenario, 20), ours, atol=1e-9)


def test_growth_is_studied_over_all_states_and_elements():
    points = growth.points()
    assert len(points) == len(set(points))
    assert {point.base.n for point in points} == set(range(4, 32))
    nanosat = [point for point in points if point.configuration == "nanosat"]
    assert {(point.pes, point.form) for point in nanosat} == {
        (pes, form) for pes in range(1, 23) for form in Form
    }
    for point in points:
        assert point.params.pes == point.pes


RECORDS = {
    bench: {
        "computer": {"processors": 2, "machine": "x86_64", "python": "3.11.2", "load": 0.5},
        "configuration": "nanosat",
        "models": {"golden": 1000.4, "reference": 5000.0, "filterpy": 500.0,
                   "golden_to_filterpy": 2.0008},
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
    bench: ["| golden model to filterpy | 2.00 |", "12.3 iterations, 45679 clocks a second",
            "| n = 7: schedule, then generate | 0.2 s, 3.2 s |", "load 0.5 at the start"],
    growth: ["| bus words | states | 4 to 31 | 2 PEs | +1.99 | 25% |"],
    routing: ["| 2 | 3 | 51.3 MHz | 20.0 ns | 60% | 8000 | 900 | 4 | 30 |"],
}  # fmt: skip


@pytest.mark.parametrize("study", RECORDS, ids=lambda module: module.__name__)
def test_tables_have_the_figures(study, tmp_path, monkeypatch):
    file = tmp_path / "study.json"
    monkeypatch.setattr(study, "MEASURED", file)
    assert sections.measured(study) == "Not measured yet; `make study` does.\n"
    file.write_text(json.dumps(RECORDS[study]))
    text = sections.measured(study)
    for line in EXPECTED[study]:
        assert line in text
    widths = {line.count("|") for line in text.splitlines() if line.startswith("|")}
    assert len(widths) == 1
