"""The models of the catalogue in C, bit for bit as the golden model executes them."""

import numpy as np
import pytest

from support.c_model_programs import execute_c, execute_golden, words
from ukf_sim.c_in_the_loop.compiler import Toolchain
from ukf_sw.factors import lower_factor
from ukf_sw.lowering.software import software_models
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_tools.arm.emulator import arm_available

from .test_c_model_programs import hostile, said

needs_cc = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")
#: Points of the usual test, and of the others.
FEW, MANY = 1000, 100_000
#: Entries of the usual test; those left out have the functions of one of these.
DIFFERENT = (
    "nanosat", "nanosat-additive", "swampsat", "pendulum", "ctrv", "reentry", "battery", "gps-ins",
    "recorded-imu", "recorded-odometry",
)  # fmt: skip
BUILDS = [(toolchain, flags) for toolchain in Toolchain for flags in (("-O2",), ("-O3",))]


def models_of(name):
    """Programs of an entry, by name."""
    models = software_models(CATALOGUE[name].scenario(0, 60))
    stem = name.replace("-", "_")
    programs = {f"{stem}_f": models.f}
    for sensor, variants in models.h.items():
        for number, program in enumerate(variants):
            programs[f"{stem}_{sensor}_{number}"] = program
    return models, programs


def points_of(models, rng, count):
    """Hostile numbers in a half of the points; the others are near the first estimate and far."""
    problem = models.problem
    p = problem.params
    inputs = models.inputs.table(problem, problem.steps)
    points = {
        kind: hostile(models.fmt, rng, (count, max(columns, 1)))
        for kind, columns in (("x", p.n), ("noise", max(p.q, p.r)), ("u", inputs.shape[1]))
    }
    usual = {
        "x": problem.x0 + (rng.standard_normal((count, p.n)) @ lower_factor(problem.P0).T)
        * 10.0 ** rng.uniform(-3.0, 1.5, (count, 1)),
        "noise": rng.standard_normal(points["noise"].shape),
        "u": inputs[rng.integers(problem.steps, size=count)],
    }  # fmt: skip
    for kind, numbers in usual.items():
        if numbers.shape[1]:
            points[kind][::2] = numbers[::2]
    return points


def compare(names, count, folder, builds):
    """Demand equal bits; gives how many functions there are, and results that are usual."""
    programs, points = {}, {}
    for number, name in enumerate(names):
        models, own = models_of(name)
        programs |= own
        points |= dict.fromkeys(own, points_of(models, np.random.default_rng(number), count))
    expected = {name: execute_golden(program, points[name]) for name, program in programs.items()}
    for toolchain, flags in builds:
        found = execute_c(programs, points, folder, toolchain=toolchain, flags=flags)
        for name, program in programs.items():
            different = words(found[name]) != words(expected[name])
            assert not different.any(), said(
                program, points[name], found[name], expected[name], different
            )
    numbers = {
        name: np.count_nonzero(np.isfinite(rows) & (rows != 0.0), axis=0)
        for name, rows in expected.items()
    }
    for name, rows in numbers.items():
        # Half of the points are usual.
        assert (rows > 0.4 * count).all(), (name, rows / count)
    return len(programs)


@needs_cc
def test_every_kind_of_function(tmp_path):
    """f and h of each, of ctrv two h."""
    functions = compare(DIFFERENT, FEW, tmp_path, BUILDS[:1])
    assert functions == 2 * len(DIFFERENT) + 1


@needs_cc
@pytest.mark.slow
@pytest.mark.skipif(
    not arm_available(), reason="gcc-arm-linux-gnueabihf or qemu-user is not installed"
)
@pytest.mark.parametrize("name", CATALOGUE)
def test_many_points(name, tmp_path):
    """For this processor and for the Cortex-A9, and however the compiler optimises."""
    compare([name], MANY, tmp_path, BUILDS)
