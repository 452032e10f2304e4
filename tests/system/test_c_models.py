"""Models of one's own in C, and C in the loop for any problem, against the filter in Python."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.turntable import model
from ukf_sim.c_in_the_loop.compiler import (
    LINUX_MAIN,
    CompilerError,
    Toolchain,
    compile_application,
    compile_c,
    write_headers,
    write_models,
)
from ukf_sim.c_in_the_loop.loop import first_difference, golden_results
from ukf_sw.errors import StepError
from ukf_sw.lowering.software import in_core_arithmetic
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.problems.scenario_files import export_scenario, read_results
from ukf_sw.spec.parameters import UkfParams
from ukf_tools.arm.emulator import arm_available
from ukf_tools.arm.register_server import RegisterServer
from ukf_tools.evaluate.band_plot import plot_bands

from .test_new import SIZES

needs_cc = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")
FOLDER = Path(model.__file__).parent
MODELS = (FOLDER / "table.c", FOLDER / "sensors" / "sensors.c")
OPTIONS = tuple(part for file in MODELS for part in ("--c-models", file))
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
#: Compiles in half the time, and rounds alike.
PLAIN = ("-O0",)
KINDS = [
    pytest.param("augmented", id="augmented"),
    pytest.param("additive", id="additive", marks=pytest.mark.slow),
]


def natively(problem, models, folder, steps, flags=PLAIN):
    """Run a program on a golden model; gives the process, and its results.

    Without models it has those that are written from the ones in Python.
    """
    write_headers(problem.params, folder)
    if not models:
        write_models(problem, folder)
    binary, _ = export_scenario(problem, steps, folder)
    program = compile_application(
        folder / "program", folder, models, main=LINUX_MAIN, flags=flags, warn=pytest.fail
    )
    results = folder / "results.bin"
    with RegisterServer.of_golden(folder / "socket", problem.params) as server:
        done = subprocess.run(
            [str(program), f"remote:{folder / 'socket'}", str(binary), str(results)],
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        done.words = server.words
    return done, read_results(results, problem.params, steps) if results.exists() else None


# Bit for bit.


@needs_cc
@pytest.mark.system
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_two_sensors_on_the_verilog(ukf_with_cores, tmp_path, kind):
    """At different rates, at uneven intervals; the estimate goes through half a turn."""
    name = f"support.turntable.model:{kind}"
    arguments = ("--problem", name, *OPTIONS, "--plot", "band.png", "--json")
    record = json.loads(ukf_with_cores("c-loop", *arguments).stdout)
    assert record["mismatch"] is None
    assert (record["steps"], record["errors"], record["attitude"]) == (60, 0, None)
    assert record["band"]["plot"] == "band.png"
    assert all(share > 0.9 for share in record["band"]["within_band"].values())
    assert (tmp_path / "band.png").read_bytes().startswith(b"\x89PNG")
    made = Recipe.of(name).scenario()
    updates = [made.samples(sensor)[1].any(axis=1).sum() for sensor in made.sensor_names]
    assert updates == [60, 20]
    assert (np.abs(np.diff(made.record.truth[:, 0])) > np.pi).any()
    assert len(set(made.record.inputs[:, 0])) == 2


@needs_cc
@pytest.mark.parametrize("kind", ["augmented", "additive"])
def test_two_sensors_with_an_angle(kind, tmp_path):
    """The same on the golden model, with the checks that a compiler has."""
    made = getattr(model, kind).with_data(steps=40)
    flags = SANITIZED if kind == "augmented" else PLAIN
    done, results = natively(made, MODELS, tmp_path, 40, flags)
    assert done.returncode == 0, done.stderr
    expected = golden_results(made, 40)
    assert first_difference(results, expected) is None
    assert np.isfinite(results.nis).all()
    encoder = replace(made.sensor("encoder"), angles=())
    for other in (
        replace(made, state_angles=()),
        replace(made, sensors={"encoder": encoder, "inertial": made.sensor("inertial")}),
    ):
        assert first_difference(results, golden_results(other, 40)) is not None, "angles matter"


@needs_cc
@pytest.mark.parametrize("number", range(len(SIZES)))
def test_projects_of_any_size(ukf, monkeypatch, tmp_path, number):
    """What `ukf new` writes runs in C as well."""
    options, params = SIZES[number]
    name = f"c_strut_{number}"
    ukf("new", name, *options)
    monkeypatch.syspath_prepend(tmp_path / name)
    made = Recipe.of(f"{name}.model:problem").scenario(40)
    assert made.params == params
    done, results = natively(made, (), tmp_path, 40)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, golden_results(in_core_arithmetic(made), 40)) is None


@needs_cc
def test_a_step_that_fails_ends_the_comparison(tmp_path):
    """In both, with the same code and the same estimate; the C application goes on."""
    exact = replace(
        model.augmented, Q=[[0.0]], P0=np.zeros((2, 2)),
        sensors={
            name: replace(model.augmented.sensor(name), R=0.0 * model.augmented.sensor(name).R)
            for name in model.augmented.sensor_names
        },
    ).with_data(steps=6)  # fmt: skip
    done, results = natively(exact, MODELS, tmp_path, 6)
    assert done.returncode == 0, done.stderr
    expected = golden_results(exact, 6)
    stop = run(exact, "golden", ends_at=(StepError,)).stop
    assert stop.iteration == 0
    assert expected.results.tolist() == [stop.code] == [3]
    assert results.results.all()
    assert first_difference(results, expected) is None
    other = replace(expected, results=np.array([4], np.uint32))
    assert first_difference(results, other) == "results of step 0: 3, not 4"
    x = expected.x + 1e-6
    assert first_difference(results, replace(expected, x=x)).startswith("x of step 0: ")
    fewer = replace(results, x=results.x[:0])
    assert first_difference(fewer, expected) == "0 steps, not 1"


@pytest.mark.skipif(
    not arm_available(), reason="gcc-arm-linux-gnueabihf or qemu-user is not installed"
)
def test_on_the_arm(ukf, tmp_path):
    name = "support.turntable.model:additive"
    result = ukf("c-arm", "--problem", name, *OPTIONS, "--steps", 8, "--output", "arm", "--json")
    record = json.loads(result.stdout)
    assert record["mismatch"] is None
    assert (record["steps"], record["errors"]) == (8, 0)
    assert (tmp_path / record["program"]).read_bytes()[18:20] == b"\x28\0", "an executable for ARM"


# What may be wrong.


def copy_of_models(folder, change):
    """Copies of the files, the first one of them with a text replaced."""
    text = MODELS[0].read_text()
    assert change[0] in text
    file = folder / "table.c"
    file.write_text(text.replace(*change))
    return (file, MODELS[1])


@needs_cc
def test_models_of_other_sizes_are_named(tmp_path):
    made = model.augmented.with_data(steps=2)
    models = copy_of_models(tmp_path, ("scenario->inputs == 2u", "scenario->inputs == 1u"))
    done, results = natively(made, models, tmp_path, 2)
    assert done.returncode == 2
    assert results is not None
    assert not len(results.x)
    assert done.stderr == (
        "the models are not for these sizes: ukf_application() gives none: the scenario has n 2, "
        "m 3, q 1, r 3, inputs 2, the core n 2, m 3, q 1, r 3\n"
    )
    assert done.words == 0


@needs_cc
def test_noise_terms_that_do_not_fit_are_named(tmp_path):
    made = model.augmented.with_data(steps=2)
    done, _ = natively(made, copy_of_models(tmp_path, (".terms = 2u", ".terms = 1u")), tmp_path, 2)
    assert done.returncode == 2
    assert done.stderr.startswith("a model is missing, or the sensors have not the noise terms of")


@needs_cc
def test_scenarios_for_another_core_are_named(tmp_path):
    made = model.augmented.with_data(steps=2)
    _, results = natively(made, MODELS, tmp_path, 2)
    assert results is not None
    binary, _ = export_scenario(model.additive.with_data(steps=2), 2, tmp_path)
    with RegisterServer.of_golden(tmp_path / "socket", made.params):
        done = subprocess.run(
            [str(tmp_path / "program"), f"remote:{tmp_path / 'socket'}", str(binary),
             str(tmp_path / "out")],
            capture_output=True, text=True, check=False, timeout=60,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == (
        "the scenario is not for a core of these sizes: the scenario has n 2, m 3, q 2, r 3, "
        "inputs 2, the core n 2, m 3, q 1, r 3\n"
    )


@pytest.mark.parametrize("command", ["c-loop", "c-arm"])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "must not branch on data, as in `angle > TURN / 2.0`"),
        ((), "or write the models in C yourself, and give them with --c-models FILE.c"),
        (("--c-models", "none.c"), "--c-models must be files that exist, not 'none.c'"),
        (("--c-models", "."), "--c-models must be C files, which end with .c, not '.'"),
        (("--c-models", FOLDER / "model.py"), "--c-models must be C files, which end with .c, not"),
        ((*OPTIONS, "--format", "float6.17"), "--format must be one that C has, binary32 or bin"),
        ((*OPTIONS, "--steps", 0), "--steps must be at least 1, not 0"),
        (
            ("--problem", "battery", "--models", "core", "--c-models", MODELS[0]),
            "--c-models must not be given with all models on the core, which calls none in C, not",
        ),
    ],
)
def test_mistakes_are_named_before_the_work(ukf, command, options, message):
    if "--problem" not in options:
        options = ("--problem", "support.turntable.model:augmented", *options)
    result = ukf(command, *options, code=2)
    assert message in result.stderr
    assert "Traceback" not in result.stderr


def test_models_are_of_a_problem(ukf):
    """Of sizes alone there is nothing to write in C oneself."""
    result = ukf("c-loop", "--n", 2, "--m", 3, *OPTIONS, code=2)
    assert "--c-models must be of a --problem, not of sizes alone" in result.stderr


@needs_cc
def test_what_the_compiler_says_is_shown(ukf, tmp_path):
    """Errors, and what is missing, before the core is compiled."""
    problem = ("--problem", "support.turntable.model:augmented")
    models = copy_of_models(tmp_path, ("next[1] = rate;", "next[1] = speed;"))
    result = ukf("c-loop", *problem, "--c-models", models[0], "--c-models", models[1], code=1)
    assert "error: 'speed' undeclared" in result.stderr.replace("‘", "'").replace("’", "'")
    assert "table.c:" in result.stderr
    result = ukf("c-loop", *problem, "--c-models", models[1], code=1)
    assert "ukf_application" in result.stderr
    assert not (tmp_path / "build").exists()


@needs_cc
def test_warnings_about_models_are_told_and_no_errors(tmp_path):
    """A user's file may be compiled less strictly than ours, also as GNU C."""
    told = []
    models = copy_of_models(
        tmp_path, ("(void)context;\n    next[0] =", "int unused = M_PI > 3;\n    next[0] =")
    )
    models[0].write_text("#include <math.h>\n" + models[0].read_text())
    write_headers(model.augmented.params, tmp_path)
    compile_application(
        tmp_path / "program", tmp_path, models, main=LINUX_MAIN, flags=PLAIN, warn=told.append
    )
    assert len(told) == 1
    assert "unused" in told[0]


@needs_cc
def test_files_of_one_name_do_not_overwrite_each_other(tmp_path):
    for name, file in zip(("a", "b"), MODELS, strict=True):
        (tmp_path / name).mkdir()
        shutil.copy(file, tmp_path / name / "ukf_driver.c")
    shutil.copy(FOLDER / "sensors" / "sensors.h", tmp_path / "b")
    models = [tmp_path / name / "ukf_driver.c" for name in ("a", "b")]
    write_headers(model.augmented.params, tmp_path)
    options = {"main": LINUX_MAIN, "flags": PLAIN}
    assert compile_application(tmp_path / "program", tmp_path, models, **options).is_file()
    with pytest.raises(CompilerError, match="ukf_application"):
        compile_application(tmp_path / "program", tmp_path, models[1:], **options)


@needs_cc
def test_the_models_of_the_page_compile(tmp_path):
    """With the flags for our own sources."""
    page = (Path(__file__).parents[2] / "docs" / "zynq.md").read_text(encoding="utf-8")
    programs = re.findall(r"^```c\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (program,) = [text for text in programs if "*ukf_application(" in text]
    (tmp_path / "model.c").write_text(program)
    write_headers(UkfParams(n=2, m=1, q=1, r=1), tmp_path)
    compile_c([tmp_path / "model.c"], tmp_path / "model.o", [tmp_path], flags=("-c",))


@needs_cc
def test_headers_are_made_without_a_word(tmp_path):
    """Amaranth would complain of a core that is described and not elaborated, at any time."""
    program = (
        "import gc, pathlib, sys\n"
        "from ukf_sim.c_in_the_loop.compiler import write_headers\n"
        "from ukf_sw.spec.parameters import UkfParams\n"
        "write_headers(UkfParams(n=1, m=1), pathlib.Path(sys.argv[1]))\n"
        "gc.collect()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# Plot.


@pytest.mark.parametrize("truth", [True, False])
def test_bands(tmp_path, truth):
    made = model.augmented.with_data(steps=20)
    P = np.broadcast_to(np.diag([0.01, 0.04]), (20, 2, 2))
    x = made.record.truth + np.array([0.29, 0.61])
    x[:5, 1] = made.record.truth[:5, 1]
    if not truth:
        made = replace(made, data=replace(made.record, truth=None))
    file = tmp_path / "new" / "band.png"
    shares = plot_bands(file, made, x, P, title="title")
    assert file.read_bytes().startswith(b"\x89PNG")
    assert shares == ({"angle": 1.0, "rate": 0.25} if truth else None)
