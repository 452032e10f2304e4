"""A problem in C: written from its models in Python, and called by the filter in C."""

import ctypes
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from support.beacons import rover
from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.generate import description
from ukf_hdl.instance import Instance
from ukf_hdl.interfaces.c_driver import c_headers
from ukf_sim.c_in_the_loop.compiler import (
    Toolchain,
    compile_c,
    write_headers,
    write_models,
)
from ukf_sim.c_in_the_loop.loop import first_difference, golden_results
from ukf_sw.c_sources import CNames
from ukf_sw.lowering.c_problem import c_problem_files
from ukf_sw.lowering.software import in_core_arithmetic, software_models
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.float_format import BINARY16, BINARY32, BINARY64
from ukf_sw.spec.parameters import UkfParams
from ukf_tools.arm.emulator import arm_available, run_on_arm

from .test_c_models import natively

needs_cc = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")
QUICK = ("battery", "ctrv")
#: Compiles in half the time.
LIBRARY = ("-shared", "-fPIC", "-O0")


# Whole runs.


@needs_cc
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CATALOGUE],
)
def test_every_application_runs_in_c(name, tmp_path):
    """With arguments, variants and angles: bit for bit, on the golden model of its core."""
    made = CATALOGUE[name].scenario(0, 20)
    done, results = natively(made, (), tmp_path, 20)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, golden_results(in_core_arithmetic(made), 20)) is None
    assert first_difference(results, golden_results(made, 20)) is not None, "models round"


@needs_cc
@pytest.mark.parametrize("models", ["f", pytest.param("h", marks=pytest.mark.slow)])
def test_one_model_in_c_and_the_other_on_the_core(models, tmp_path):
    """Arguments of h arrive though f is not called."""
    made = Recipe.of("battery", models=models).scenario(12)
    done, results = natively(made, (), tmp_path, 12)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, golden_results(in_core_arithmetic(made), 12)) is None


@needs_cc
def test_in_binary64(tmp_path):
    """There too, with arguments of h and two variants of each of two sensors."""
    made = replace(rover(), format=BINARY64)
    done, results = natively(made, (), tmp_path, 6)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, golden_results(in_core_arithmetic(made), 6)) is None


@needs_cc
def test_a_random_system_runs_in_c(tmp_path):
    """Sizes alone are a problem, too."""
    made = random_scenario(UkfParams(n=3, m=2, q=1, r=2), steps=10)
    done, results = natively(made, (), tmp_path, 10)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, golden_results(in_core_arithmetic(made), 10)) is None


@pytest.mark.slow
@pytest.mark.skipif(
    not arm_available(), reason="gcc-arm-linux-gnueabihf or qemu-user is not installed"
)
@pytest.mark.parametrize("name", ["battery", "ctrv", "gps-ins", "swampsat"])
def test_applications_on_the_arm(name, tmp_path):
    outcome = run_on_arm(CATALOGUE[name].scenario(0, 12), 12, tmp_path)
    assert outcome.mismatch is None
    assert not outcome.results.results.any()


# Functions, one by one.

Model = ctypes.CFUNCTYPE(ctypes.c_bool, *[ctypes.c_void_p] * 4)
Process = ctypes.CFUNCTYPE(ctypes.c_bool, *[ctypes.c_void_p] * 5)
OnPredict = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 2)


class Sensor(ctypes.Structure):
    """A struct ukf_sensor."""

    _fields_ = (
        ("observe", Model), ("terms", ctypes.c_uint32), ("angles", ctypes.c_uint32),
        ("variant", ctypes.c_uint32),
    )  # fmt: skip


class Models(ctypes.Structure):
    """A struct ukf_models."""

    _fields_ = (
        ("context", ctypes.c_void_p), ("process", Process),
        ("sensors", ctypes.POINTER(Sensor)), ("state_angles", ctypes.c_uint32),
        ("on_predict", OnPredict),
    )  # fmt: skip


def compiled(problem, folder, real=ctypes.c_double):
    """Compile a problem, and give functions of it that take and give arrays."""
    write_headers(problem.params, folder)
    write_models(problem, folder)
    name = {ctypes.c_double: "double", ctypes.c_float: "float"}[real]
    sources = [folder / "ukf_model.c", folder / "ukf_problem.c"]
    flags = (*LIBRARY, f"-DUKF_REAL={name}")
    library = ctypes.CDLL(str(compile_c(sources, folder / "problem.so", [folder], flags=flags)))
    models = Models.in_dll(library, "ukf_problem")

    def address(array):
        return None if array is None else array.ctypes.data

    def call(model, rows, *arrays):
        arrays = [None if a is None else np.ascontiguousarray(a, real) for a in arrays]
        result = np.full(rows, 7.0, real)
        if not model(None, *map(address, arrays), address(result)):
            return None
        return result

    def give(numbers):
        library.ukf_problem_set(ctypes.c_void_p(np.array(numbers, real).ctypes.data))

    def f(x, w, u):
        """Do what ukf_predict() does, for one sigma point."""
        given = None if u is None else np.ascontiguousarray(u, real)
        models.on_predict(None, address(given))
        return call(models.process, len(x), x, w, given)

    return SimpleNamespace(
        models=models,
        give=give,
        f=f,
        h=lambda number, rows, x, v: call(models.sensors[number].observe, rows, x, v),
    )


#: Numbers beside those at which binary32 rounds, flushes and overflows.
EDGES = [
    0.0, -0.0, 1.0, 1.0 + 2.0**-24, 1.0 + 2.0**-23, 1.0 + 3 * 2.0**-24, 2.0**-126, 2.0**-149,
    2.0**-126 - 2.0**-151, 2.0**-126 - 1.5 * 2.0**-151, -(2.0**-126) + 2.0**-150,
    5e-324, 3.4028235677973366e38, -3.4028235677973362e38, 1e300, np.inf, np.nan,
]  # fmt: skip


@needs_cc
@pytest.mark.parametrize("real", [ctypes.c_double, ctypes.c_float], ids=["double", "float"])
@pytest.mark.parametrize(
    "fmt",
    [
        pytest.param(BINARY32, id="binary32"),
        pytest.param(BINARY64, id="binary64", marks=pytest.mark.slow),
    ],
)
def test_numbers_are_rounded_as_in_python(fmt, real, tmp_path):
    """At every edge of the format of the core, on their way to a model."""
    problem = replace(rover(), format=fmt)
    models = software_models(problem)
    c = compiled(problem, tmp_path, real)
    rng = np.random.default_rng(3)
    dtype = np.dtype(real)
    for _ in range(200):
        with np.errstate(over="ignore"):
            x, w, v, u = (
                rng.choice([*EDGES, rng.standard_normal()], size).astype(dtype)
                for size in (2, 1, 1, 6)
            )
            u[4:] = rng.integers(0, 2, 2)
            wide = [array.astype(np.float64) for array in (x, w, v, u)]
            found = [c.f(x, w, u), c.h(0, 1, x, v), c.h(1, 1, x, v)]
            beacons = [("near", "far")[int(number)] for number in u[4:]]
            columns = [array[:, None] for array in wide]
            expected = [
                models.evaluate_f(columns[0], columns[1], wide[3][:2]),
                *(
                    models.evaluate_h(
                        sensor, columns[0], columns[2], beacon=beacon, place=wide[3][2:4]
                    )
                    for sensor, beacon in zip(("beacon", "compass"), beacons, strict=True)
                ),
            ]
            for one, other in zip(found, expected, strict=True):
                # There is one NaN.
                other = other[:, 0].astype(dtype)
                assert np.where(np.isnan(one), np.nan, one).tobytes() == other.tobytes()


@needs_cc
def test_models_without_their_numbers_fail(tmp_path):
    """Before any were given; if a sensor has no such model; and not of what another one lacks."""
    c = compiled(rover(), tmp_path)
    x, w, v = np.ones(2), np.ones(1), np.ones(1)
    assert c.f(x, w, None) is None
    assert c.h(0, 1, x, v) is None
    c.give([0.5, 0.25, 3.0, 1.0, 0.0, 1.0])
    near = c.h(0, 1, x, v)
    assert c.f(x, w, None) is not None
    for bad in (-1.0, 2.0, np.nan, 1e30):
        c.give([0.5, 0.25, 3.0, 1.0, bad, 1.0])
        assert c.h(0, 1, x, v) is None
        assert c.h(1, 1, x, v) is not None
    after = c.f(x, w, np.array([0.5, 0.25, 3.0, 1.0, 1.0, 1.0]))
    assert after is not None
    assert c.h(0, 1, x, v) != near, "the predict has chosen the other one"


@needs_cc
def test_sensors_and_angles(tmp_path):
    """Noise terms, and rows that are angles, are those of the problem."""
    problem = replace(rover(), state_angles=(1,))
    compass = replace(problem.sensor("compass"), angles=(0,))
    problem = replace(problem, sensors={"beacon": problem.sensor("beacon"), "compass": compass})
    models = compiled(problem, tmp_path).models
    assert models.state_angles == 2
    assert [(models.sensors[i].terms, models.sensors[i].angles) for i in (0, 1)] == [(1, 0), (1, 1)]


# Texts.


def test_the_header_says_what_the_numbers_are():
    text = c_problem_files(software_models(rover()))["ukf_problem.h"]
    assert "#define UKF_PROBLEM_INPUTS 6u" in text
    assert " * - input[0]: u[0], speed in m/s\n * - input[1]: u[1], turn in rad/s\n" in text
    assert " * - input[3]: place[1] of h\n" in text
    assert " * - input[4]: which h of beacon: 0 beacon='near', 1 beacon='far'\n" in text


@pytest.mark.parametrize(
    ("models", "there", "missing"),
    [
        pytest.param(
            "f",
            ("ukf_model_h(",),
            (".process = process", "static bool process"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "h",
            (".process = process", "ukf_model_f("),
            ("ukf_model_h(", "observe_sensor"),
            marks=pytest.mark.slow,
        ),
        ("core", (".process = NULL", ".observe = NULL"), ("ukf_model.h", "round_numbers")),
    ],
)
def test_models_that_the_core_has_are_left_out(models, there, missing, tmp_path):
    """The rest compiles, without a warning."""
    problem = Recipe.of("nanosat", models=models).scenario(2)
    files = c_problem_files(software_models(problem))
    assert ("ukf_model.c" in files) == (models != "core")
    for text in there:
        assert text in files["ukf_problem.c"]
    for text in missing:
        assert text not in files["ukf_problem.c"]
    write_headers(problem.params, tmp_path)
    write_models(problem, tmp_path)
    for name in files:
        if name.endswith(".c"):
            compile_c([tmp_path / name], tmp_path / "o", [tmp_path], flags=("-c",))


def test_formats_that_c_has():
    with pytest.raises(ValueError, match=r"^format must be one that C has, .*, not 'binary16'$"):
        c_problem_files(software_models(replace(rover(), format=BINARY16)))


@needs_cc
def test_cores_of_other_names_can_be_in_one_program(tmp_path):
    """Files, functions and macros have the name of the core."""
    assert CNames().files == ("ukf_model.h", "ukf_model.c", "ukf_problem.h", "ukf_problem.c")
    problem = rover()
    sources = []
    for core in ("left", "right"):
        headers = c_headers(description(UkfCore(problem.params), Instance(name=core)))
        files = c_problem_files(software_models(problem), core)
        assert set(files) == set(CNames(core=core).files)
        for name, text in (headers | files).items():
            (tmp_path / name).write_text(text)
            sources += [tmp_path / name] if name.endswith(".c") else []
    assert compile_c(sources, tmp_path / "both.so", [tmp_path], flags=LIBRARY).is_file()


# Commands.


def files_in(folder):
    return {path.name for path in (folder / "c").iterdir()}


def test_generate_writes_them_beside_the_driver(ukf, tmp_path):
    record = json.loads(ukf("generate", "--problem", "battery", "--output", "out", "--json").stdout)
    names = {f"out/c/{name}" for name in CNames().files}
    assert names <= set(record["files"])
    text = (tmp_path / "out" / "c" / "ukf_problem.h").read_text()
    assert " * - input[1]: current of h\n" in text
    assert (tmp_path / "out" / "c" / "ukf_model.c").read_text() == c_problem_files(
        software_models(CATALOGUE["battery"].scenario(0, 100))
    )["ukf_model.c"]


@pytest.mark.parametrize(
    ("options", "why"),
    [
        pytest.param(
            ("--problem", "support.turntable.model:augmented"),
            "no models in C: process model f (f) must not branch on data, as in `angle > TURN / 2",
            id="branch",
        ),
        pytest.param(
            ("--problem", "battery", "--format", "binary16"),
            "no models in C: format must be one that C has, binary32 or binary64, not 'binary16'",
            id="format", marks=pytest.mark.slow,
        ),
        pytest.param(("--n", 2, "--m", 1), "", id="sizes", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_core_comes_without_them_and_says_why(ukf, tmp_path, options, why):
    """Those of another core, that were there before, go."""
    for name in CNames().files:
        (tmp_path / "out" / "c").mkdir(parents=True, exist_ok=True)
        (tmp_path / "out" / "c" / name).write_text("of another core")
    result = ukf("generate", *options, "--output", "out")
    assert why in result.stderr
    assert ("no models in C" in result.stderr) == bool(why)
    assert (tmp_path / "out" / "ukf_core.v").is_file()
    assert files_in(tmp_path / "out").isdisjoint(CNames().files)


@pytest.mark.parametrize("seed", [0, 1])
def test_an_export_numbers_models_as_generate_does(ukf, tmp_path, seed):
    """Also if its data begin with another one."""
    problem = ("--problem", "support.beacons:simulated")
    ukf("export", *problem, "--seed", seed, "--steps", 4, "--output", "data")
    p = rover().params
    first = 48 + 8 * (1 + p.n + p.n**2 + p.q**2 + p.r**2)
    data = (tmp_path / "data" / "scenario.bin").read_bytes()
    numbers = np.frombuffer(data, "<f8", 24, first).reshape(4, 6)
    assert numbers[:, 4].tolist() == numbers[:, 5].tolist() == [(k + seed) % 2 for k in range(4)]
