"""The command line: what it prints, what it writes, what it refuses."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from ukf_hdl.generate import files_of
from ukf_sw import __version__
from ukf_sw.engine.microcode import microcode
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import PARAMETERS
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.cli import app
from ukf_tools.cli.apps import apps_app
from ukf_tools.estimate.latency import latency
from ukf_tools.estimate.recommendation import recommended

TINY = ["--n", "2", "--m", "1", "--q", "1", "--r", "1", "--pes", "2"]
TINY_PARAMS = UkfParams(n=2, m=1, q=1, r=1, pes=2)


def test_version(ukf):
    assert ukf("--version").stdout == f"{__version__}\n"


def test_module_is_the_command(ukf):
    result = subprocess.run(
        [sys.executable, "-m", "ukf_tools", "latency", *TINY, "--json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert result.stdout == ukf("latency", *TINY, "--json").stdout


INTERRUPTED = """
import os, signal, sys

class Interrupter:
    def find_spec(self, name, path=None, target=None):
        if name == "ukf_tools.cli.apps":
            os.kill(os.getpid(), signal.SIGINT)

signal.signal(signal.SIGINT, signal.SIG_IGN if sys.argv[2:] else signal.default_int_handler)
sys.meta_path.insert(0, Interrupter())
from ukf_tools.__main__ import main

sys.argv[1:] = ["--version"]
main()
"""


@pytest.mark.parametrize("ignored", [False, True], ids=["heard", "ignored"])
def test_interrupt_while_the_command_is_loaded(ignored):
    """It ends at once, without a traceback; in the background, where it is ignored, it goes on."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, "--version", *(["ignored"] * ignored)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == (0 if ignored else -signal.SIGINT)
    assert done.stderr == ""


def test_commands_have_the_same_options_of_a_core():
    commands = get_command(app).commands
    expected = {"problem", *PARAMETERS}
    for name in ("generate", "latency", "cosim", "run", "resources", "timing", "sweep", "package",
                 "testbench", "export", "c-loop", "c-arm", "disassemble"):  # fmt: skip
        options = {option.name: option.opts for option in commands[name].params}
        assert expected <= options.keys(), name
        assert options["W0"] == ["--w0"]
        assert options["multiply_stages"] == ["--multiply-stages"]


def test_help_names_the_commands(ukf):
    text = ukf("--help").stdout
    for command in ("generate", "cosim", "run", "latency", "new", "disassemble"):
        assert command in text


# Latency.


@pytest.mark.parametrize("form", list(Form))
def test_latency(ukf, form):
    record = json.loads(
        ukf("latency", "--problem", "nanosat", "--pes", 10, "--form", form.value, "--json").stdout
    )
    params = UkfParams(n=7, m=6, q=7, r=6, pes=10, form=form)
    code = microcode(params, Pipeline())
    assert record["programs"] == {
        routine.program.name: code.clocks(*routine) for routine in code.programs
    }
    # The points of the next iteration come from UPDATE.
    assert record["steps"] == {
        "SIG_GEN": 0, "PREDICT": code.clocks(Program.PREDICT), "UPDATE": code.clocks(Program.UPDATE)
    }  # fmt: skip
    assert record["total"] == sum(record["steps"].values())


def test_latency_of_several_sensors(ukf):
    """The first finds the residuals of the prediction, the others draw; so do all if it redraws."""
    sizes = ("--n", 3, "--m", 4, "--q", 3, "--sensors", "1+3")
    found = {}
    for noise in ("augmented", "additive"):
        options = (*sizes, "--process-noise", noise, "--json")
        found[noise] = json.loads(ukf("latency", *options).stdout)
    augmented, additive = found["augmented"], found["additive"]
    assert list(augmented["steps"]) == [
        "PREDICT", "SIG_GEN", "UPDATE of sensor 0", "UPDATE of sensor 1",
    ]  # fmt: skip
    for record, first in ((augmented, "UPDATE"), (additive, "UPDATE_REDRAWN")):
        programs = record["programs"]
        assert record["steps"]["UPDATE of sensor 0"] == programs[f"{first} of sensor 0"]
        assert record["steps"]["UPDATE of sensor 1"] == programs["UPDATE_REDRAWN of sensor 1"]
        assert record["total"] == sum(record["steps"].values())
    assert augmented["steps"]["SIG_GEN"] == 0
    assert additive["steps"]["SIG_GEN"] == additive["programs"]["SIG_GEN_PREDICTED"]
    assert "UPDATE of sensor 1" in ukf("latency", *sizes).stdout


def test_latency_for_people(ukf):
    text = ukf("latency", "--problem", "nanosat").stdout
    clocks = microcode(NANOSAT, Pipeline()).clocks(Program.UPDATE)
    assert "UPDATE" in text
    assert str(clocks) in text


def test_latency_depends_on_the_pipeline(ukf):
    stages = ("--multiply-stages", 5, "--add-stages", 6, "--reciprocal-sqrt-stages", 12)
    record = json.loads(ukf("latency", *TINY, *stages, "--json").stdout)
    pipeline = Pipeline(multiply=5, add=6, reciprocal_sqrt=12)
    clocks = microcode(TINY_PARAMS, pipeline).clocks(Program.UPDATE)
    assert record["steps"]["UPDATE"] == clocks
    assert record["pipeline"] == {"multiply": 5, "add": 6, "reciprocal_sqrt": 12}


def names_of(code):
    """Names of the programs that a core has, in the order of the enumeration."""
    return [routine.program.name for routine in sorted(code.programs)]


@pytest.mark.parametrize("command", [("disassemble",), ("latency", "--explain")])
def test_programs_that_a_core_does_not_have(ukf, command):
    result = ukf(*command, *TINY, "--program", "MODEL_F", code=2)
    assert "--program must be one that the core has, INIT, SIG_GEN, " in result.stderr
    assert result.stderr.strip().endswith("COVARIANCE_PREDICTED, not MODEL_F")


def test_latency_explained(ukf):
    """Every program with what its clocks are spent on, then the numbers of PEs."""
    record = json.loads(ukf("latency", *TINY, "--explain", "--json").stdout)
    assert record["total"] == json.loads(ukf("latency", *TINY, "--json").stdout)["total"]
    code = microcode(TINY_PARAMS, Pipeline())
    assert [each["program"] for each in record["explanations"]] == names_of(code)
    for each in record["explanations"]:
        assert each["clocks"] == len(code.words_of(Program[each["program"]]))
        idle = each["idle"]
        assert each["issued"] + idle["clocks"] == each["clocks"]
        assert sum(idle["reasons"].values()) == len(idle["by_clock"]) == idle["clocks"]
        assert each["ratio_to_largest_bound"] == each["clocks"] / max(each["bounds"].values())
        assert 0 < each["lanes"]["useful"] <= each["lanes"]["of_beats"]
        assert each["chain"][0]["waits_for"] is None
        assert all(step["text"] and step["part"] for step in each["chain"])
        assert sum(stretch["clocks"] for stretch in each["stretches"]) == each["clocks"]
    choices = record["pes"]["choices"]
    assert [choice["pes"] for choice in choices] == list(range(1, TINY_PARAMS.columns + 1))
    assert choices[1]["cycles"] == record["total"]
    assert "recommended" in record["pes"]["rule"]


def test_latency_explained_for_people(ukf):
    result = ukf("latency", *TINY, "--explain")
    code = microcode(TINY_PARAMS, Pipeline())
    for program, *_ in code.programs:
        length = len(code.words_of(program))
        assert f"{program.name}: {length} clocks, " in result.stdout
    assert "row 0" in result.stdout
    assert "program ends" in result.stdout
    cycles = {
        pes: latency(replace(TINY_PARAMS, pes=pes), Pipeline(), redraws=False)["total"]
        for pes in range(1, TINY_PARAMS.columns + 1)
    }
    good = ", ".join(map(str, recommended(cycles)))
    fastest = min(cycles, key=lambda pes: cycles[pes])
    assert f"Recommended: {good}. Fastest: {fastest}. A number of PEs is" in result.stdout
    assert "Scheduling for other numbers of PEs" in result.stderr


def test_latency_of_a_program_explained(ukf):
    """That of each sensor; nothing about other programs, and no other core is scheduled."""
    options = ("--n", 2, "--m", 3, "--sensors", "1+2", "--explain", "--program", "update")
    record = json.loads(ukf("latency", *options, "--json").stdout)
    names = [f"UPDATE of sensor {k}" for k in (0, 1)]
    assert [each["program"] for each in record["explanations"]] == names
    assert "pes" not in record
    text = ukf("latency", *options).stdout
    assert "SIG_GEN" not in text
    assert "Recommended" not in text
    assert all(name in text for name in names)


def test_latency_drawn(ukf, tmp_path):
    text = ukf("latency", *TINY, "--plot", "pictures/update.svg").stdout
    assert text.endswith("Plot: pictures/update.svg\n")
    assert "total" in text
    drawn = (tmp_path / "pictures/update.svg").read_text()
    assert drawn.startswith("<?xml")
    options = ("--plot", "other.png", "--program", "PREDICT", "--json")
    assert json.loads(ukf("latency", *TINY, *options).stdout)["plot"] == "other.png"
    assert (tmp_path / "other.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("pes", "limit"), [(1, 6000), (2, 3200), (5, 1650), (10, 1200), (22, 1000)]
)
def test_square_root_form_is_fast_enough(ukf, pes, limit):
    options = ("--problem", "nanosat", "--pes", pes, "--json")
    assert json.loads(ukf("latency", *options).stdout)["total"] <= limit


@pytest.mark.parametrize(("pes", "limit"), [(1, 4200), (2, 2200), (5, 1200), (10, 900)])
def test_covariance_form_is_fast_enough(ukf, pes, limit):
    options = ("--problem", "nanosat", "--pes", pes, "--form", "covariance", "--json")
    assert json.loads(ukf("latency", *options).stdout)["total"] <= limit


# Disassembly.


@pytest.mark.parametrize("program", ["UPDATE", "init"])
def test_disassemble_a_program(ukf, program):
    lines = ukf("disassemble", *TINY, "--program", program).stdout.splitlines()
    code = microcode(TINY_PARAMS, Pipeline())
    chosen = Program[program.upper()]
    operations = len(code.programs[Routine(chosen)].plan.operations)
    words = len(code.words_of(chosen))
    assert f"{chosen.name}: {words} words, {operations} operations" in lines
    points, rhs = TINY_PARAMS.points, code.layout.rhs
    assert f"Columns: {points.start}..{points[-1]} sigma points, {rhs} right-hand side." in lines
    start = lines.index("clock  done  operation") + 1
    # Reads fill the first column, writes the second; a line without reads is a root's.
    assert sum(bool(line[6:11].strip()) for line in lines[start:]) >= operations
    assert max(map(len, lines)) <= 100
    assert sum("words, " in line for line in lines) == 1


def test_disassemble_all_as_json(ukf):
    record = json.loads(ukf("disassemble", *TINY, "--json").stdout)
    code = microcode(TINY_PARAMS, Pipeline())
    assert record["columns"] == {
        "sigma points": list(TINY_PARAMS.points), "right-hand side": [code.layout.rhs],
    }  # fmt: skip
    assert [each["program"] for each in record["programs"]] == names_of(code)
    for each in record["programs"]:
        plan = code.programs[Routine(Program[each["program"]], each["sensor"])].plan
        assert each["words"] == plan.length
        assert sorted(entry["clock"] for entry in each["operations"]) == sorted(plan.issue)


# Generate.


def test_generate(ukf, tmp_path):
    record = json.loads(ukf("generate", *TINY, "--output", "rtl", "--json").stdout)
    found = {path for path in record["files"] if not path.startswith("rtl/c/")}
    assert found == {f"rtl/ukf_core.{kind}" for kind in ("dtso", "json", "md", "svd", "v", "vlt")}
    for name in ("README.md", "ukf_core.h", "ukf_driver.c", "ukf_filter.h", "ports/uio.c"):
        assert f"rtl/c/{name}" in record["files"]
    assert all((tmp_path / path).stat().st_size for path in record["files"])
    described = json.loads((tmp_path / "rtl" / "ukf_core.json").read_text())
    assert described["parameters"]["n"] == 2
    assert "module ukf_core" in (tmp_path / "rtl" / "ukf_core.v").read_text()


def test_generate_takes_the_place_in_the_system(ukf, tmp_path):
    ukf("generate", *TINY, "--base-address", "0x40000000", "--interrupt", 84, "--output", "rtl")
    overlay = (tmp_path / "rtl" / "ukf_core.dtso").read_text()
    assert "ukf_core@40000000" in overlay
    assert "interrupts = <0 52 4>" in overlay


def test_generate_is_reproducible(ukf, tmp_path):
    for folder in ("a", "b"):
        files_of.cache_clear()
        ukf("generate", *TINY, "--format", "binary16", "--w0", "0.25", "--output", folder)
    files = [path for path in (tmp_path / "a").rglob("*") if path.is_file()]
    assert len(files) == 8
    for file in files:
        other = tmp_path / "b" / file.relative_to(tmp_path / "a")
        assert file.read_bytes() == other.read_bytes()


def test_generate_takes_every_option(ukf, tmp_path):
    ukf(
        "generate", "--n", 2, "--m", 3, "--q", 2, "--r", 3, "--sensors", "2+1",
        "--process-noise", "additive",
        "--observation-noise", "additive", "--w0", 0.5, "--pes", 3, "--form", "covariance",
        "--format", "float6.17", "--multiply-stages", 1, "--add-stages", 2,
        "--reciprocal-sqrt-stages", 3, "--output", "rtl",
    )  # fmt: skip
    described = json.loads((tmp_path / "rtl" / "ukf_core.json").read_text())
    assert described["parameters"] == {
        "n": 2, "m": 3, "q": 2, "r": 3, "sensors": [2, 1], "process_noise": "additive",
        "observation_noise": "additive", "W0": 0.5, "form": "covariance",
        "format": {"name": "float6.17", "exponent_bits": 6, "fraction_bits": 17}, "pes": 3,
    }  # fmt: skip
    assert described["pipeline"] == {"multiply": 1, "add": 2, "reciprocal_sqrt": 3}


# Run.


@pytest.mark.parametrize("backend", ["golden", "reference"])
def test_run(ukf, tmp_path, backend):
    record = json.loads(
        ukf("run", "--problem", "nanosat-2014", "--backend", backend, "--steps", 1200, "--json")
        .stdout
    )  # fmt: skip
    (run,) = record["runs"]
    assert run["steps"] == record["steps_requested"] == 1200
    assert run["stopped"] is None
    judged = record["accuracy"]
    assert (judged["since"], judged["steps"]) == (1.0, 200)
    attitude = judged["errors"][0]
    assert (attitude["error"], attitude["unit"]) == ("attitude", "degrees")
    assert attitude["rms"] < 1.0
    assert judged["limit"] == 0.1
    assert 0.0 <= judged["below_limit"] <= 1.0
    if backend == "golden":
        assert attitude["rms"] != attitude["float64_rms"]
        assert judged["reference"]["rms_ratio"] == pytest.approx(1.0, abs=0.01)
    assert (tmp_path / record["plot"]).read_bytes().startswith(b"\x89PNG")


def test_run_reports_where_the_core_stopped(ukf):
    """Covariance form with a large P0, in binary32: the first bad pivot, and no NaN."""
    core = ("--problem", "nanosat-2014", "--form", "covariance", "--pes", 2)
    options = ("run", *core, "--p0", 100, "--steps", 50)
    (record,) = json.loads(ukf(*options, "--json", code=1).stdout)["runs"]
    stopped = record["stopped"]
    assert record["steps"] == stopped["iteration"] < 50
    codes = {"SINGULAR_OBSERVATION": 3, "NOT_POSITIVE_DEFINITE": 4}
    assert stopped["code"] == codes[stopped["error"]]
    assert 0 <= stopped["index"] < 7
    assert np.isfinite(record["last_estimate"]).all()
    text = ukf(*options, code=1).stdout
    assert stopped["error"] in text
    assert "Last good estimate" in text


def test_run_takes_sizes(ukf):
    record = json.loads(ukf("run", *TINY, "--steps", 40, "--seed", 5, "--json").stdout)
    assert record["problem"] is None
    assert [error["error"] for error in record["accuracy"]["errors"]] == ["x0", "x1"]
    assert record["accuracy"]["limit"] is None


def test_run_takes_any_system_of_the_catalogue(ukf, tmp_path):
    options = ("run", "--problem", "ctrv", "--steps", 40, "--pes", 3)
    record = json.loads(ukf(*options, "--json").stdout)
    assert (record["problem"], record["parameters"]["pes"]) == ("ctrv", 3)
    names = [error["error"] for error in record["accuracy"]["errors"]]
    assert names == ["x", "y", "velocity x", "velocity y"]
    assert record["accuracy"]["reference"]["rms_ratio"] == pytest.approx(1.0, abs=0.01)
    assert (tmp_path / record["plot"]).read_bytes().startswith(b"\x89PNG")
    # Its own first covariance is another than the one that is asked for.
    other = json.loads(ukf(*options, "--p0", 9.0, "--json").stdout)
    assert record["runs"][0]["last_estimate"] != other["runs"][0]["last_estimate"]


LOGGED = """
import numpy as np
from ukf_sw.problem import Problem, Sensor

problem = Problem(
    name="cart", f=lambda x, w, u: np.array([x[0] + u[0] * x[1], x[1] + u[0] * u[1]]),
    inputs={"dt": "s", "push": "m/s^2"}, x0=[0.0, 0.0], P0=np.eye(2),
    sensors={
        "gps": Sensor(lambda x, v: x[:1] + v, R=[[4.0]], observations=["place"]),
        "odometer": Sensor(lambda x, v: x[1:] + v, R=[[1.0]], observations=["speed"]),
    },
)
"""


@pytest.fixture
def logged(tmp_path):
    """Options of a problem with data of two files: the inputs begin a second after the rest."""
    (tmp_path / "logged_cart.py").write_text(LOGGED)
    rows = "".join(f"{0.1 * k:.1f},{0.01 * k},no,0.1\n" for k in range(10, 20))
    (tmp_path / "imu.csv").write_text(f"time,push,state,dt\n{rows}")
    rows = "".join(f"{0.1 * k:.1f},1,2\n" for k in range(20))
    (tmp_path / "rest.csv").write_text(f"time,place,speed\n{rows}")
    data = ("--data", "imu=imu.csv", "--data", "rest=rest.csv", "--ignore", "state")
    return "run", "--problem", "logged_cart:problem", "--backend", "reference", *data


def test_data_from_a_start_on(logged, ukf):
    message = (
        "push must be there from the first time on, 0.0 s, not only later in imu.csv, from 1.0"
    )
    told = ukf(*logged, code=2).stderr
    assert message in told
    assert "--start 1.0, leaves out what is before" in told
    record = json.loads(ukf(*logged, "--start", "1.0", "--json").stdout)
    assert record["runs"][0]["steps"] == 10
    for start, message in (
        ("nan", "a finite time in seconds"),
        ("9", "at most 1.9 s, the last ti"),
    ):
        assert f"--start must be {message}" in ukf(*logged, "--start", start, code=2).stderr
    nothing = ukf("run", "--problem", "nanosat", "--start", "1", code=2)
    assert "--start must come with --data" in nothing.stderr
    unknown = ukf(*logged, "--ignore", "none", code=2)
    assert "--ignore must name columns of the logs, time, push, state, dt, place" in unknown.stderr


def test_data_of_a_sweep_need_accuracy(logged, ukf):
    options = ("--pes", "1", "--no-resources", *logged[1:3], *logged[5:])
    told = ukf("sweep", *options, code=2).stderr
    assert "--data must come with --accuracy, which is judged on them" in told


def test_a_nis_that_means_a_wrong_unit_is_told(logged, ukf, tmp_path):
    rows = "".join(f"{0.1 * k:.1f},{1e3 * k},2\n" for k in range(20))
    (tmp_path / "rest.csv").write_text(f"time,place,speed\n{rows}")
    told = ukf(*logged, "--start", "1.0").stderr
    assert "Warning: The mean NIS of gps is " in told


RAISING = """
import numpy as np
from ukf_sw.problem import Data, Problem, Sensor

def f(x, w, u):
    if u > 1.0:
        raise RuntimeError("no such table")
    return x + w

problem = Problem(
    name="raising", f=f, x0=[0.0, 0.0], P0=np.eye(2), Q=[[1.0]],
    sensors={"gps": Sensor(lambda x, v: x[:1] + v, R=[[4.0]])},
    process_noise="augmented", observation_noise="augmented", pes=2,
    data=Data(
        times=np.arange(4.0), measurements=np.ones((4, 1)), inputs=np.arange(4.0),
        truth=np.zeros((4, 2)),
    ),
)
"""


@pytest.mark.parametrize(
    "command",
    ["run", pytest.param("cosim", marks=[pytest.mark.system, pytest.mark.slow])],
    ids=["run", "cosim"],
)
def test_a_model_that_raises_is_told_in_sentences(command, ukf, tmp_path, core_cache):
    (tmp_path / "raising.py").write_text(RAISING)
    cosim = ("--steps", 4, "--cache", core_cache)
    options = cosim if command == "cosim" else ("--backend", "reference")
    code = {"run": 2, "cosim": 1}[command]
    told = ukf(command, "--problem", "raising:problem", *options, code=code).stderr
    assert "Traceback" not in told
    lines = [line.strip() for line in told.splitlines()]
    (first,) = (k for k, line in enumerate(lines) if line.startswith("Error: "))
    assert lines[first] == (
        f"Error: RuntimeError: no such table ({tmp_path / 'raising.py'}, line 7)"
    )
    # Without W0 the first point is number 1.
    assert lines[first + 1].startswith("in process model f (f), at sigma point 1, called with x")
    assert lines[first + 2] == "after 2 iterations, at 2 s"


def test_data_that_do_not_overlap_are_told_to_the_user(logged, ukf, tmp_path):
    rows = "".join(f"{1e3 + k:.1f},1,2\n" for k in range(20))
    (tmp_path / "rest.csv").write_text(f"time,place,speed\n{rows}")
    done = ukf(*logged, "--json")
    assert json.loads(done.stdout)["runs"][0]["steps"] == 30
    assert done.stderr.count("Warning: logs should overlap in time, and these do not: imu.csv") == 1


def test_data_whose_dt_contradicts_the_times_are_refused(logged, ukf, tmp_path):
    text = (tmp_path / "imu.csv").read_text()
    (tmp_path / "imu.csv").write_text(text.replace("0.15,no,0.1", "0.15,no,100"))
    told = ukf(*logged, "--start", "1.0", code=2).stderr
    assert "dt must be the time since the row before, 0.1 s, not 100 s in row 7 of imu.csv" in told
    assert "--ignore dt" in told
    ukf(*logged, "--start", "1.0", "--ignore", "dt")


def test_seed_changes_the_data(ukf):
    runs = [
        json.loads(ukf("run", *TINY, "--steps", 5, "--seed", seed, "--json").stdout)["runs"][0]
        for seed in (1, 2, 1)
    ]
    assert runs[0]["last_estimate"] == runs[2]["last_estimate"] != runs[1]["last_estimate"]


def test_runs_are_judged_together(ukf):
    options = ("run", "--problem", "nanosat", "--steps", 1100, "--runs", 2, "--seed", 3)
    record = json.loads(ukf(*options, "--json").stdout)
    first, second = (run["accuracy"] for run in record["runs"])
    assert [run["seed"] for run in record["runs"]] == [3, 4]
    both = record["accuracy"]
    assert both["steps"] == first["steps"] + second["steps"] == 200
    squares = [run["errors"][0]["rms"] ** 2 for run in (first, second)]
    assert both["errors"][0]["rms"] ** 2 == pytest.approx(sum(squares) / 2)
    shares = [run["below_limit"] for run in (first, second)]
    assert both["below_limit"] == pytest.approx(sum(shares) / 2)
    largest = max(run["errors"][0]["maximum"] for run in (first, second))
    assert both["errors"][0]["maximum"] == largest
    text = ukf(*options).stdout
    assert "2200 of 2200 steps" in text


# Co-simulation.


def tiny_words():
    """Bus words of an iteration: points up to n + 1 and x read, f's and h's points and z written,
    three starts of steps.
    """
    n, m, points = TINY_PARAMS.n, TINY_PARAMS.m, len(TINY_PARAMS.points)
    return n * (n + 1) + n + (n + m) * points + m + 3


@pytest.mark.system
@pytest.mark.parametrize("mode", ["interrupt", "polling"])
def test_cosim(ukf, tmp_path, core_cache, mode):
    options = (*TINY, "--steps", 4, f"--{mode}", "--cache", core_cache, "--plot", "errors.png")
    record = json.loads(ukf("cosim", *options, "--json").stdout)
    assert record["bit_exact"] is True
    assert record["mismatch"] is None
    assert record["words_compared"] > 0
    assert record["mode"] == mode
    assert record["steps"] == 4
    code = microcode(TINY_PARAMS, Pipeline())
    assert record["cycles"]["as_predicted"] is True
    assert record["cycles"]["steps"] == record["cycles"]["predicted"]
    assert record["cycles"]["steps"]["UPDATE"] == code.clocks(Program.UPDATE)
    assert record["bus"]["words_per_iteration"] == tiny_words()
    assert record["iterations_per_second"] > 0
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.system
def test_cosim_for_people(ukf, core_cache):
    text = ukf("cosim", *TINY, "--steps", 2, "--cache", core_cache, "--plot", "errors.png").stdout
    told = f"Bus words per iteration: {tiny_words()}"
    for words in ("Bit-exact", told, "Plot: errors.png", "UPDATE"):
        assert words in text


@pytest.mark.system
def test_cosim_on_icarus(ukf, core_cache, icarus):
    options = (*TINY, "--steps", 1, "--simulator", icarus.value, "--cache", core_cache)
    record = json.loads(ukf("cosim", *options, "--plot", "errors.png", "--json").stdout)
    assert record["bit_exact"] is True
    assert record["simulator"] == "icarus"


def test_missing_simulator(ukf, tmp_path, monkeypatch):
    # Verilator does the rest; only the search for programs is empty.
    monkeypatch.setattr(shutil, "which", lambda *arguments, **options: None)
    result = ukf("cosim", *TINY, "--simulator", "icarus", "--plot", "x.png", code=1)
    assert "icarus is not installed" in result.stderr


# Bad arguments.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("latency", "--problem", "cubesat"), "--problem must be one of nanosat, "),
        (("latency",), "--problem, or at least --n and --m, must be given"),
        (("latency", "--n", 3), "--problem, or at least --n and --m, must be given"),
        (("latency", "--problem", "nanosat", "--n", 3), "give it or them, not both"),
        (("latency", "--problem", "nanosat", "--process-noise", "additive"), "not both"),
        (
            ("latency", "--problem", "nanosat", "--pes", 23),
            "pes must be between 1 and the number of columns, 22, not 23",
        ),
        (("latency", "--problem", "nanosat", "--pes", 0), "--pes must be at least 1, not 0"),
        (("latency", "--n", 33, "--m", 1), "n must be between 1 and 32, not 33"),
        (("latency", "--n", 2, "--m", 1, "--w0", 1.5), "--w0 must be at least 0 and less than 1"),
        (
            ("latency", "--n", 2, "--m", 1, "--format", "fp32"),
            "--format must be one of binary16",
        ),
        (("latency", "--n", 2, "--m", 1, "--format", "float99.3"), "Exponent bits must be"),
        (
            ("latency", "--n", 2, "--m", 1, "--add-stages", 0),
            "--add-stages must be between 1 and 8",
        ),
        (("latency", "--n", 2, "--m", 1, "--form", "cubic"), "--form: 'cubic' is not one of"),
        (
            ("latency", "--n", 2, "--m", 1, "--explain", "--program", "draw"),
            "--program must be one of INIT, SIG_GEN, ",
        ),
        (
            ("latency", "--n", 2, "--m", 1, "--program", "UPDATE"),
            "--program must come with --explain or --plot",
        ),
        (
            ("latency", "--n", 2, "--m", 1, "--plot", "update.txt"),
            "--plot must end with .png or .svg or .pdf or .jpg, not 'update.txt'",
        ),
        (("latency", "--n", "two", "--m", 1), "--n must be a whole number, not 'two'"),
        (
            ("generate", "--n", 2, "--m", 1, "--q", 1, "--process-noise", "additive"),
            "--q must be 0",
        ),
        (
            ("run", "--problem", "nanosat", "--steps", 100_001),
            "--steps must be between 1 and 1",
        ),
        (("run", "--problem", "nanosat", "--steps", 0), "--steps must be at least 1, not 0"),
        (
            ("run", "--problem", "nanosat", "--backend", "gpu"),
            "--backend must be one of reference,",
        ),
        (
            ("disassemble", "--problem", "nanosat", "--program", "draw"),
            "UPDATE, COVARIANCE, COVARIANCE_PREDICTED, MODEL_F, MODEL_H, not 'draw'",
        ),
        (("run", "--problem", "nanosat", "--p0", -1), "--p0 must be more than 0"),
        (("run", "--n", 2, "--m", 1, "--p0", 0), "--p0 must be more than 0"),
        (
            ("cosim", "--problem", "nanosat", "--simulator", "spice"),
            "--simulator: 'spice'",
        ),
        (
            ("cosim", "--problem", "nanosat", "--bus-latency", -1),
            "--bus-latency must be at least",
        ),
        (
            ("cosim", "--problem", "nanosat", "--bus-latency", "inf"),
            "--bus-latency must be at most",
        ),
        (("c-loop", "--problem", "nanosat", "--bus-latency", "nan"), "--bus-latency must be at"),
        (("sweep", "--n", "3-1", "--m", 1), "--n must have ranges that rise, like 4-6, not '3-1'"),
        (("sweep", "--n", 2, "--m", 1, "--clock-mhz", 0), "--clock-mhz must be more than 0, not 0"),
        (("sweep", "--n", 2, "--m", 1, "--multiply-stages", "1-9"), "--multiply-stages must be"),
        (("latency", "--n", 2, "--m", 1, "--w", 1), "No such option: --w"),
        (("package", "--n", 2, "--m", 1), "--board must be given, one of zedboard, pynq-z2"),
    ],
)
def test_bad_arguments(ukf, arguments, message):
    result = ukf(*arguments, code=2)
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""


def test_output_must_be_a_folder(ukf, tmp_path):
    (tmp_path / "file").write_text("")
    assert "--output must be a folder" in ukf(
        "generate", *TINY, "--output", "file", code=2
    ).stderr  # fmt: skip


def test_command_is_installed():
    """The package brings `ukf`, which starts without the HDL toolchain."""
    program = (
        "import sys; import ukf_tools.cli; sys.exit(any(m in sys.modules for m in "
        "('amaranth', 'cocotb', 'matplotlib.pyplot')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


# Paths.


PATHS = [
    ((*group, name), option.opts[0])
    for group, commands in (
        ((), get_command(app).commands),
        (("apps",), get_command(apps_app).commands),
    )
    for name, command in commands.items()
    for option in command.params
    if option.param_type_name == "option" and option.type_descriptor.annotation is Path
]


@pytest.mark.parametrize(("words", "option"), PATHS)
def test_paths_are_judged_before_the_work(ukf, words, option):
    for path in ("/dev/null/x.png", "/proc/absent/x.png", ""):
        message = ukf(*words, option, path, code=2).stderr
        assert message.startswith(f"Error: {option} must be ")
        assert repr(path) in message


@pytest.mark.parametrize("command", ["run", "cosim"])
def test_place_of_the_plot_is_judged_also_if_it_is_the_default(ukf, tmp_path, command):
    (tmp_path / "build").write_text("in the way")
    result = ukf(command, *TINY, *(["--cache", "x"] if command == "cosim" else []), code=2)
    assert "--plot must be a file that can be written, not 'build/plots/" in result.stderr


# Data that has no seed.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "--problem", "ctrv", "--seed", 3), "--seed must be 0 for ctrv, which is a record"),
        (("run", "--problem", "ctrv", "--runs", 2), "--runs must be 1 for ctrv, which is a record"),
        (("cosim", "--problem", "recorded-imu", "--seed", 3), "--seed must be 0 for recorded-imu"),
        (("apps", "run", "ctrv-masked", "--seed", 3), "--seed must be 0 for ctrv-masked"),
        (("export", "--problem", "ctrv", "--seed", 1), "--seed must be 0 for ctrv"),
        (("sweep", "--problem", "ctrv", "--accuracy", "ctrv", "--seed", 1), "--seed must be 0 for"),
    ],
)
def test_records_have_no_seed(ukf, arguments, message):
    assert message in ukf(*arguments, code=2).stderr


# What is missing is told before the work.


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("run", "--problem", "nanosat", "--backend", "cosim"),
            "c++, which verilator needs, is not",
        ),
        (("run", "--problem", "nanosat", "--backend", "cosim:icarus"), "icarus is not installed"),
        (("run", "--problem", "nanosat", "--backend", "uio:99"), "/dev/uio99: no such UIO device"),
        (("cosim", "--problem", "nanosat", "--simulator", "icarus"), "icarus is not installed"),
        (("apps", "run", "nanosat", "--backend", "cosim"), "c++, which verilator needs"),
        (("apps", "all", "--cosim-steps", 1), "c++, which verilator needs, is not installed"),
        (("c-loop", "--problem", "nanosat"), "cc is not installed"),
        (("c-arm", "--problem", "nanosat"), "qemu-arm is not installed"),
        (("baseline",), "arm-linux-gnueabihf-gcc is not installed"),
    ],
)
def test_missing_tools_are_told_before_the_work(ukf, tmp_path, monkeypatch, arguments, message):
    (tmp_path / "bin").mkdir()
    for name in ("make", "perl"):
        (tmp_path / "bin" / name).symlink_to(shutil.which(name))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))

    def work(*_, **__):
        raise AssertionError("the work has begun")

    for place in ("ukf_sw.problems.recipe.Recipe.scenario", "ukf_tools.baseline.report._software",
                  "ukf_sw.problems.catalogue.Entry.scenario"):  # fmt: skip
        monkeypatch.setattr(place, work)
    assert message in ukf(*arguments, code=1).stderr
