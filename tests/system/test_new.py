"""Projects that `ukf new` writes: they work as they are, and mistakes are named."""

import ast
import json
import re
import subprocess
import sys
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from typer.main import get_command

from ukf_sim.cosimulation import cosimulate
from ukf_sw.problem import Problem
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.pendulum import pendulum
from ukf_sw.spec.fields import parameters_of
from ukf_sw.spec.parameters import Noise, UkfParams
from ukf_tools.cli import app
from ukf_tools.new.project_writer import TEMPLATES, check_name


@pytest.fixture
def new(ukf):
    """Function that runs `ukf new` in an empty folder."""
    return partial(ukf, "new")


SIZES = [
    ((), UkfParams(n=3, m=2, q=3, r=2)),
    (("--n", 1, "--m", 1, "--pes", 2), UkfParams(n=1, m=1, q=1, r=1, pes=2)),
    (("--n", 2, "--m", 3, "--q", 0, "--observation-noise", "additive"),
     UkfParams(n=2, m=3, r=3, observation_noise=Noise.ADDITIVE)),
    (("--n", 4, "--m", 2, "--q", 6, "--r", 5),
     UkfParams(n=4, m=2, q=6, r=5)),
    (("--n", 5, "--m", 3, "--process-noise", "additive", "--observation-noise", "additive"),
     UkfParams(n=5, m=3, q=5, r=3, process_noise=Noise.ADDITIVE,
               observation_noise=Noise.ADDITIVE)),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(SIZES)))
def test_filter_of_any_size_is_consistent(new, tmp_path, monkeypatch, number):
    options, params = SIZES[number]
    name = f"strut_{number}"
    new(name, *options)
    monkeypatch.syspath_prepend(tmp_path / name)
    scenario = Recipe.of(f"{name}.model:problem").scenario(300)
    assert scenario.params == params
    results = run(scenario)
    nis = results.nis[100:]
    assert abs(nis.mean() - params.m) < 5.0 * np.sqrt(2.0 * params.m / len(nis))
    first = np.abs(scenario.x0 - scenario.record.truth[0]).max()
    assert np.abs(results.errors[100:]).max() < 0.2 * first


def test_files_are_listed_and_complete(new, tmp_path):
    record = json.loads(new("strut", "--json").stdout)
    wanted = sorted(f"strut/{target.replace('NAME', 'strut')}" for target in TEMPLATES)
    assert sorted(record["files"]) == wanted
    for file in record["files"]:
        text = (tmp_path / file).read_text()
        assert "{" + "{" not in text
        assert max(map(len, text.splitlines())) <= 120
        if file.endswith(".py"):
            ast.parse(text)


def test_folders_with_files_stay_as_they_are(new, tmp_path):
    (tmp_path / "strut").mkdir()
    new("strut")  # an empty one is fine
    (tmp_path / "strut" / "Makefile").write_text("mine")
    message = "DIR must be a new or an empty folder, not the folder with files strut"
    assert message in new("strut", code=2).stderr
    assert (tmp_path / "strut" / "Makefile").read_text() == "mine"
    (tmp_path / "file").write_text("")
    assert "not the file file" in new("file", code=2).stderr


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("my-filter", "must be lower-case letters, digits and underscores, first a letter, not"),
        ("3d", "must be lower-case letters, digits and underscores, first a letter, not '3d'"),
        ("Strut", "must be lower-case letters, digits and underscores, first a letter, not"),
        ("größe", "must be lower-case letters, digits and underscores, first a letter, not"),
        ("lambda", "must not be a word of Python's, not 'lambda'"),
        ("json", "must not be that of another Python package, not 'json'"),
        ("numpy", "must not be that of another Python package, not 'numpy'"),
        ("ukf_sw", "must not be that of another Python package, not 'ukf_sw'"),
        ("_", "must be lower-case letters, digits and underscores, first a letter, not '_'"),
        ("__init__", "must be lower-case letters, digits and underscores, first a letter, not"),
        ("conftest", "must not be one that means something to a tool, "),
        ("build", "must not be one that means something to a tool, "),
        ("makefile", "must not be one that means something to a tool, "),
        ("tests", "must not be one that means something to a tool, "),
    ],
)
def test_names_are_checked(new, tmp_path, name, message):
    with pytest.raises(ValueError, match="^The name " + message):
        check_name(name)
    assert message in new(name, code=2).stderr
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--n", 33), "n must be between 1 and 32, not 33"),
        (("--m", 3, "--r", 2),
         "r must be at least m = 3, noise for every sensor, not 2"),
        (("--q", 2, "--process-noise", "additive"), "q must be 0 or n = 3 for additive noise"),
        (("--pes", 99), "pes must be between 1 and the number of columns, 10"),
    ],
)  # fmt: skip
def test_sizes_are_checked(new, tmp_path, options, message):
    assert message in new("strut", *options, code=2).stderr
    assert not (tmp_path / "strut").exists()


def test_folder_that_cannot_be_made(new):
    assert (
        "DIR must be a folder that can be written, not '/proc/strut'"
        in new("/proc/strut", code=2).stderr
    )


def test_noises_have_the_same_default_everywhere(new, tmp_path):
    """That of the core itself; `ukf new` with `--n 2` is for `ukf generate` with `--n 2`."""
    commands = get_command(app).commands
    for option in commands["new"].params:
        if option.name.endswith("_noise"):
            assert option.default == parameters_of(UkfParams)[option.name].default


def test_data_that_do_not_fit_are_refused_before_a_sweep(new, ukf, tmp_path, monkeypatch):
    new("strut_sweep")
    monkeypatch.chdir(tmp_path / "strut_sweep")
    (tmp_path / "strut_sweep" / "log.csv").write_text("time,heater\n1.0,30.0\n")
    problem = ("--problem", "strut_sweep.model:problem", "--accuracy", "strut_sweep.model:problem")
    options = ("sweep", *problem, "--no-resources")
    message = "must be a column of log.csv, and is not"
    assert message in ukf(*options, "--data", "log.csv", code=2).stderr.replace("\n", " ")
    longer, shorter = (
        Recipe.of("strut_sweep.model:problem").scenario(steps).record for steps in (1000, 10)
    )
    np.testing.assert_array_equal(longer.truth[:10], shorter.truth)
    assert not (tmp_path / "strut_sweep" / "build" / "sweep").exists()


def test_workflows_run_the_commands_of_the_makefile(new, tmp_path):
    """The targets that they make are there, and so is the report that they keep."""
    new("strut")
    makefile = (tmp_path / "strut" / "Makefile").read_text()
    for file in (".github/workflows/test.yml", ".gitlab-ci.yml"):
        text = (tmp_path / "strut" / file).read_text()
        jobs = yaml.safe_load(text)
        assert "jobs" in jobs or "script" in jobs["test"]
        targets = re.findall(r"- (?:run: )?make (\w+)", text)
        assert targets == ["test"]
        assert all(f"\n{target}:" in makefile for target in targets)
        (report,) = re.findall(r"build/\S+\.xml", text)
        assert f"--junitxml={report}" in makefile


def test_scenarios_must_be_found_by_the_simulator():
    with pytest.raises(ValueError, match=r"^make must be a function at the top level of a module"):
        cosimulate(lambda steps: pendulum(steps=steps), 3)
    with pytest.raises(ValueError, match=r"^steps must be between 1 and 3, not 4"):
        cosimulate(three_steps, 4)
    program = (
        "from ukf_sim.cosimulation import cosimulate\n"
        "def make(steps): return None\n"
        "cosimulate(make, 3)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert "make must be in a module that can be imported, not in the script" in done.stderr


def three_steps(steps: int) -> Problem:
    return pendulum(steps=3)


@pytest.mark.system
@pytest.mark.slow  # tests/wheel/check.py does it too
def test_project_works_as_it_is(new, tmp_path, core_cache):
    """Its own tests, and all of its commands; on one compiled core, which is kept."""
    new("strut", "--n", 1, "--m", 1)
    project = tmp_path / "strut"
    core_cache.mkdir(parents=True, exist_ok=True)
    (project / "build").mkdir()
    (project / "build" / "cosim").symlink_to(core_cache)

    def make(*arguments):
        done = subprocess.run(
            ["make", "--silent", f"PYTHON={sys.executable}", *arguments],
            cwd=project, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert "3 passed" in make("test")
    assert '-m pytest -m "not cosim"' in make("--dry-run", "test-fast")
    tests = ElementTree.parse(project / "build" / "junit.xml").getroot().iter("testcase")
    assert "test_verilog_is_the_golden_model" in {test.get("name") for test in tests}
    assert "Errors over 700 steps, from 200 s on" in make("run")
    text = make("cosim")
    assert "Bit-exact: " in text
    assert "UPDATE" in text
    text = make("c-loop")
    assert "Bit-exact: " in text.replace("[/]", "")
    assert "Errors within the filter's own 3 standard deviations: cell 0 " in text
    assert "UPDATE" in make("latency")
    assert "build/rtl/ukf_core.v" in make("generate")
    assert "module ukf_core" in (project / "build" / "rtl" / "ukf_core.v").read_text()
    for image in ("run.png", "cosim.png", "c-loop.png"):
        assert (project / "build" / image).read_bytes().startswith(b"\x89PNG")
    for target in ("run", "cosim", "c-loop", "latency", "generate", "test", "test-fast", "clean"):
        assert f"\n{target} " in "\n" + make("help")
