"""C applications whose models are on the core, whole or in part: programs on a golden model."""

import json
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from support.problems import change_data
from support.rover import BAD_U, rover
from ukf_sim.c_in_the_loop.compiler import (
    BARE_METAL_MAIN,
    DRIVER,
    LINUX_MAIN,
    RUN,
    Toolchain,
    compile_application,
    compile_objects,
    write_headers,
    write_models,
)
from ukf_sim.c_in_the_loop.loop import first_difference, golden_results, in_software
from ukf_sw.lowering.placement import place_models
from ukf_sw.lowering.software import in_core_arithmetic
from ukf_sw.problems.scenario_files import HEADER, export_scenario, read_results
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.parameters import Form, Noise
from ukf_sw.spec.registers import ErrorCode
from ukf_tools.arm.emulator import arm_available
from ukf_tools.arm.register_server import RegisterServer

pytestmark = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
#: Compiles in half the time, and rounds alike.
PLAIN = ("-O0",)
WIDE = {"noise": Noise.ADDITIVE, "W0": 0.25, "form": Form.COVARIANCE, "format": BINARY64}


def on_core(problem, which):
    """The problem with some of its models on the core."""
    return replace(problem, models=place_models(problem, which).models)


def with_gaps(**kind):
    """The rover with data of 24 steps; in some no sensor is sampled, or a part of one."""
    made = rover(steps=24, **kind)
    k = np.arange(24)[:, None]
    sampled = {
        "aim": (k % 2 == 0) & (k % 6 != 4) & np.array([[True, True]]),
        "odometer": (k % 2 == 1) & (k % 5 != 0),
    }
    sampled["aim"][6, 1] = False
    return change_data(made, sampled=sampled)


def run(problem, folder, *, models=(), flags=PLAIN, scenario=None):
    """Run a program for a problem; gives the process and its results."""
    write_headers(problem.params, folder)
    write_models(problem, folder)
    program = compile_application(
        folder / "program", folder, in_software(problem, models), main=LINUX_MAIN, flags=flags,
        warn=pytest.fail,
    )  # fmt: skip
    scenario = problem if scenario is None else scenario
    binary, _ = export_scenario(scenario, scenario.record.steps, folder)
    with RegisterServer.of_golden(folder / "socket", problem.params) as server:
        done = subprocess.run(
            [str(program), f"remote:{folder / 'socket'}", str(binary), str(folder / "results")],
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        done.words = server.words
    return done, read_results(folder / "results", problem.params, scenario.record.steps)


@pytest.mark.parametrize(
    "redraw", [pytest.param(False, marks=pytest.mark.slow), True], ids=["plain", "redrawing"]
)
def test_all_models_on_the_core_need_no_c_file(redraw, tmp_path):
    """Two sensors with gaps, arguments of h, variants; the checks of a compiler, and binary64."""
    kind = WIDE if redraw else {}
    made = on_core(with_gaps(redraw=redraw, **kind), "core")
    done, results = run(made, tmp_path, flags=PLAIN if redraw else SANITIZED)
    assert done.returncode == 0, done.stderr
    expected = golden_results(made, 24)
    assert first_difference(results, expected) is None
    assert 0 < np.isnan(results.nis).sum() < 20
    # One variant would give other estimates.
    arguments = [given | {"mode": "near"} if given else {}
                 for given in made.record.observation_arguments]  # fmt: skip
    one = on_core(change_data(made, observation_arguments=arguments), "core")
    assert first_difference(results, golden_results(one, 24)) is not None


@pytest.mark.parametrize("which", ["f", pytest.param("h", marks=pytest.mark.slow)])
def test_one_model_on_the_core_and_the_other_in_c(tmp_path, which):
    """Two sensors with gaps, arguments of h and variants: in C they are inputs of a predict."""
    made = on_core(with_gaps(), which)
    assert (made.models.f is None, not made.models.h) == (which == "h", which == "f")
    done, results = run(made, tmp_path)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, golden_results(in_core_arithmetic(made), 24)) is None


@pytest.mark.slow
def test_single_precision(tmp_path):
    """Only the factors of P0, Q and R are computed in software; the rest is the core's."""
    made = on_core(with_gaps(), "core")
    done, results = run(made, tmp_path, flags=("-DUKF_REAL=float",))
    assert done.returncode == 0, done.stderr
    assert np.abs(results.x - golden_results(made, 24).x).max() < 1e-4


def test_a_model_that_is_not_finite_loses_a_step(tmp_path):
    """In both languages with the same code; the application goes on."""
    made = with_gaps()
    inputs = made.record.inputs.copy()
    inputs[9] = BAD_U
    bad = on_core(made, "core")
    bad = change_data(bad, inputs=inputs)
    done, results = run(bad, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "24 steps, 1 errors, 0 recoveries\n"
    assert done.stderr == "step 9: f gives NaN or infinity (5)\n"
    assert np.flatnonzero(results.results).tolist() == [9]
    expected = golden_results(bad, 24)
    assert expected.results[-1] == ErrorCode.MODEL_F
    assert first_difference(results, expected) is None


def test_a_scenario_for_other_models_is_named(tmp_path):
    made = with_gaps()
    done, results = run(on_core(made, "core"), tmp_path, scenario=on_core(made, "h"))
    assert done.returncode == 2
    assert not len(results.x)
    assert done.words == 0
    assert done.stderr.startswith("the scenario is not for the models that the core has: ")


def test_the_program_without_an_operating_system(tmp_path):
    """It needs no ukf_application(), and its samples are in the header."""
    made = on_core(with_gaps(), "core")
    write_headers(made.params, tmp_path)
    export_scenario(made, 24, tmp_path)
    objects = compile_objects(
        [*DRIVER, *RUN, *BARE_METAL_MAIN], tmp_path, [tmp_path], flags=("-ffreestanding",)
    )
    linked = tmp_path / "program.o"
    subprocess.run(["cc", "-nostdlib", "-r", "-o", str(linked), *map(str, objects)], check=True)
    symbols = subprocess.run(
        ["nm", "-u", str(linked)], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not [name for name in symbols if name.startswith("ukf")]
    assert "ukf_scenario_core_input" in (tmp_path / HEADER).read_text()


@pytest.mark.skipif(
    not arm_available(), reason="gcc-arm-linux-gnueabihf or qemu-user is not installed"
)
@pytest.mark.slow
def test_on_the_arm(ukf):
    """No sigma points cross the bus: few words are left."""
    options = ("--problem", "battery", "--models", "core", "--steps", 8, "--json")
    record = json.loads(ukf("c-arm", *options).stdout)
    assert record["mismatch"] is None
    assert (record["steps"], record["errors"]) == (8, 0)
    assert record["words"] < 8 * 24 + 100


@pytest.mark.system
@pytest.mark.slow
@pytest.mark.parametrize("name", ["nanosat", "battery", "ctrv"])
def test_any_problem_on_the_verilog(ukf_with_cores, name):
    """Bit for bit, without a C file: inputs, arguments of h, variants, angles."""
    options = ("--problem", name, "--models", "core", "--pes", 2, "--steps", 60, "--json")
    record = json.loads(ukf_with_cores("c-loop", *options).stdout)
    assert record["mismatch"] is None
    assert (record["steps"], record["errors"]) == (60, 0)
    assert record["words_per_iteration"] < 40


# Files.


def test_the_scenario_says_what_the_models_are_told(tmp_path):
    """Each step what the filter in Python would send; what a step does not need is as before."""
    made = on_core(with_gaps(), "core")
    binary, _ = export_scenario(made, 24, tmp_path)
    data = binary.read_bytes()
    assert np.frombuffer(data, "<u4", 12).tolist() == [
        0x53464B55, 2, 3, 3, 2, 3, 0, 24, 0, 2, 3, 0
    ]  # fmt: skip
    words = np.frombuffer(data, "<u4", 24 + 2 + 48, len(data) - 4 * 74)
    assert words[24:26].tolist() == [2, 1], "noise terms"
    record, sampled = made.record, made.samples("aim")[1].any(axis=1)
    taken = [k for k in range(24) if sampled[k] and record.observation_arguments[k]]
    assert len({record.observation_arguments[k]["mode"] for k in taken}) == 2
    table = np.frombuffer(data, "<f8", 72, len(data) - 4 * 74 - 8 * 72).reshape(24, 3)
    assert (table[:, :2] == record.inputs).all()
    variants = words[26:].reshape(24, 2)
    assert not variants[:, 1].any()
    first = record.observation_arguments[taken[0]]["mode"]
    scale = 0.0
    for k in range(24):
        given = record.observation_arguments[k]
        if k in taken:
            scale = given["scale"]
            assert variants[k, 0] == (given["mode"] != first)
        else:
            assert variants[k, 0] == 0
        assert table[k, 2] == scale


def test_inputs_may_be_of_any_shape(tmp_path):
    """They are what the models on the core are told, or the inputs of those in C."""
    made = rover()
    inputs = [{"drive": u[0], "push": u[1]} for u in made.record.inputs]
    plain = made.f
    made = replace(made, f=lambda x, w, u: plain(x, w, (u["drive"], u["push"])))
    made = change_data(made, inputs=inputs)
    binary, _ = export_scenario(on_core(made, "core"), 8, tmp_path)
    header = np.frombuffer(binary.read_bytes(), "<u4", 12)
    assert (header[6], header[10]) == (0, 3)
    binary, _ = export_scenario(on_core(made, "h"), 8, tmp_path)
    header = np.frombuffer(binary.read_bytes(), "<u4", 12)
    # u, the scale, and which h of the sensor that has two.
    assert (header[6], header[10]) == (4, 1)


def test_models_of_other_data_are_refused(tmp_path):
    """The programs of the core would not be those of the problem."""
    made = on_core(rover(), "core")
    plain = made.f
    other = replace(made, f=lambda x, w, u: 0.5 * plain(x, w, u))
    with pytest.raises(ValueError, match=r"^models of a core for rover must be those of the"):
        export_scenario(other, 8, tmp_path)
