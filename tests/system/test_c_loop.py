"""C in the loop: the C driver and application drive the Verilog, against the golden model."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from ukf_sim.c_in_the_loop.compiler import CompilerError, Toolchain
from ukf_sim.c_in_the_loop.loop import first_difference, golden_results, run_c_in_the_loop
from ukf_sim.session import step_timeout
from ukf_sim.simulators import SimulatorError
from ukf_sw.engine.microcode import microcode
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.scenario_files import HEADER, export_scenario, read_results
from ukf_sw.problems.systems.nanosat import (
    NANOSAT,
    attitude_deviations,
    nanosat,
    nanosat_2014_rates,
)
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Program
from ukf_tools.cli import app
from ukf_tools.cli.c_software import describe_attitude

STEPS = 5


def scenario(steps=STEPS, pes=2):
    made = nanosat(steps=steps)
    return replace(made, pes=pes)


# The loop.

needs_cc = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")


@needs_cc
@pytest.mark.system
def test_c_drives_the_verilog_bit_for_bit(core_cache):
    """One compilation serves three runs: interrupt, polling, and a slow bus."""
    made = scenario()
    code = microcode(made.params, Pipeline())
    steps = sum(code.clocks(program) for program in (Program.PREDICT, Program.UPDATE))
    p = made.params
    n, m, points = p.n, p.m, len(p.points)
    # Points up to n + 1, and x; what f and h make of all; z.
    words = n * (n + 2 - p.points.start) + n + (n + m) * points + m
    # x, factors and points of the noises at the beginning, P at the end.
    once = 2 * n + n**2 + p.q**2 + p.r**2 + (p.q + p.r) * points + n * (n + 1) // 2
    # Of each step NIS, and of its three steps of the core start, interrupt, STATUS, ERROR.
    registers = 1 + 3 * 4
    for options in ({}, {"interrupt": False}, {"word_clocks": 15.6}):
        outcome = run_c_in_the_loop(made, STEPS, cache=core_cache, optimise=False, **options)
        assert outcome.mismatch is None
        assert not outcome.results.results.any()
        rest = outcome.words - words * STEPS - once
        if options.get("interrupt", True):
            # INIT, COVARIANCE, what the core is, reset, gate and mask come on top.
            assert registers * STEPS < rest < registers * STEPS + 30
        assert rest > 0
        assert outcome.clocks >= outcome.bus_clocks + ("interrupt" not in options) * steps * STEPS
        word = outcome.bus_clocks / outcome.words
        if "word_clocks" in options:
            assert word == pytest.approx(15.6, rel=1e-3)
        else:
            assert 2.0 <= word <= 6.0
        assert outcome.cpu_seconds > 0.0
        assert outcome.seconds > 0.0
        assert outcome.results.covariances is None
    plain = outcome.results
    outcome = run_c_in_the_loop(
        made, STEPS, cache=core_cache, optimise=False, covariances=True
    )  # fmt: skip
    assert outcome.mismatch is None
    assert not outcome.build.compiled
    assert outcome.results.x.tobytes() == plain.x.tobytes(), "reading P changes nothing"
    assert outcome.results.covariances.shape == (STEPS, 7, 7)
    assert (outcome.results.covariances[-1] == plain.P).all()
    # The triangle, the start bit, STATUS and INTERRUPT_PENDING, ERROR, at each step.
    assert outcome.words > (words + 28 + 4) * STEPS


@needs_cc
@pytest.mark.system
@pytest.mark.slow
def test_a_thousand_iterations(core_cache):
    made = scenario(1000)
    outcome = run_c_in_the_loop(made, 1000, cache=core_cache)
    assert outcome.mismatch is None
    assert not outcome.results.results.any()
    last = slice(500, None)
    assert made.error(outcome.results.x[last], made.record.truth[last])[:, 0].max() < 0.2


def test_missing_tools_are_named_at_once(core_cache, monkeypatch, tmp_path):
    """Before anything is generated."""
    told = []
    for missing, error in (("cc", CompilerError), ("c++", SimulatorError)):
        folder = tmp_path / missing
        folder.mkdir()
        for name in {"cc", "make", "perl", "c++"} - {missing}:
            (folder / name).write_text("#!/bin/sh\n")
            (folder / name).chmod(0o755)
        monkeypatch.setenv("PATH", str(folder))
        with pytest.raises(error, match=rf"^{re.escape(missing)}( |, ).*is not installed$"):
            run_c_in_the_loop(scenario(), STEPS, cache=core_cache, progress=told.append)
    assert not told


def test_differences_are_found():
    """In one bit of any result, and when a run ended early."""
    expected = golden_results(scenario(pes=1), STEPS)
    assert first_difference(golden_results(scenario(pes=1), STEPS), expected) is None
    x = expected.x.copy()
    x.view(np.uint64)[3, 2] ^= 1
    assert first_difference(replace(expected, x=x), expected).startswith("x of step 3: ")
    nis = expected.nis.copy()
    nis[1] = np.nan
    assert first_difference(replace(expected, nis=nis), expected).startswith("nis of step 1: nan")
    results = expected.results.copy()
    results[4] = 65
    assert first_difference(replace(expected, results=results), expected) == (
        "results of step 4: 65, not 0"
    )
    said = "step 3: time-out (65)\nstep 4: bad model (72): failed at sigma point 1, row 0\n"
    assert first_difference(replace(expected, results=results), expected, said) == (
        "results of step 4: 65, not 0 (step 4: bad model (72): failed at sigma point 1, row 0)"
    )
    assert first_difference(replace(expected, x=x[:2]), expected) == "2 steps, not 5"
    assert first_difference(replace(expected, P=None), expected) == "P at the end"
    assert first_difference(replace(expected, P=-expected.P), expected) == "P at the end"
    expected = golden_results(scenario(pes=1), STEPS, covariances=True)
    assert (expected.covariances[-1] == expected.P).all()
    P = expected.covariances.copy()
    P.view(np.uint64)[3, 2, 1] ^= 1
    found = first_difference(replace(expected, covariances=P), expected)
    assert found.startswith("covariances of step 3: ")


def test_a_step_has_the_time_it_needs():
    clocks = microcode(NANOSAT, Pipeline()).clocks(Program.UPDATE)
    assert step_timeout(NANOSAT, Pipeline()) > clocks / 100e6
    assert step_timeout(NANOSAT, Pipeline(), 15.6) > step_timeout(NANOSAT, Pipeline())


# Files.


def test_equal_scenarios_give_equal_files(tmp_path):
    for folder in ("a", "b"):
        export_scenario(nanosat(steps=3), 3, tmp_path / folder)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_the_header_has_the_numbers_of_the_binary_file(tmp_path):
    """Every number, every bit, in the same order."""
    made = nanosat_2014_rates(gaps="random", P0=0.01, steps=30)
    binary, header = export_scenario(made, 30, tmp_path)
    data = binary.read_bytes()
    words = np.frombuffer(data, "<u4", 12)
    assert words.tolist() == [0x53464B55, 2, 7, 6, 7, 6, 3, 30, 0, 1, 0, 0]
    behind = 4 * (30 + 1 + 30)  # masks, noise terms, variants
    numbers = np.frombuffer(data, "<f8", (len(data) - 48 - behind) // 8, 48)
    text = header.read_text()
    interval = float.fromhex(re.search(r"(\S+), /\* interval \*/", text)[1])
    constants = [
        float.fromhex(word)
        for line in text.splitlines()
        if line.startswith("    ") and "p" in line and "/*" not in line
        for word in line.replace(",", " ").split()
    ]
    assert constants.pop() == 0.0, "an array must not be empty: nothing is told to a core"
    assert numbers.tolist() == [interval, *constants]
    assert interval == 1e-3
    assert constants[:7] == made.x0.tolist()
    observed, sampled = made.samples()
    expected = np.where(sampled, observed, 0.0)
    assert numbers[-30 * 6 :].tolist() == expected.reshape(-1).tolist()
    masks = np.frombuffer(data, "<u4", 30, len(data) - behind)
    assert (masks == sampled @ (1 << np.arange(6))).all()
    assert {0, 0b111, 0b111000} <= set(masks.tolist()) <= {0, 0b111, 0b111000, 0b111111}


@pytest.mark.parametrize("interval", [1e-3, 0.05, 1 / 30, 2.0])
@pytest.mark.parametrize("first", [0.0, 0.05, 1e3])
def test_the_interval_is_that_of_the_steps(interval, first, tmp_path):
    """Wherever the times begin; and none if the steps are not equally long."""
    made = nanosat(steps=30)
    times = first + np.arange(30) * interval
    binary, header = export_scenario(
        replace(made, data=replace(made.record, times=times)), 3, tmp_path
    )
    assert np.frombuffer(binary.read_bytes(), "<f8", 1, 48) == interval
    assert f"    {interval.hex()}, /* interval */" in header.read_text()
    times[7] += interval / 1000.0
    binary, header = export_scenario(
        replace(made, data=replace(made.record, times=times)), 3, tmp_path
    )
    assert np.isnan(np.frombuffer(binary.read_bytes(), "<f8", 1, 48)).all()
    assert "    NAN, /* interval */" in header.read_text()


@pytest.mark.parametrize("steps", [0, 4])
def test_steps_must_be_there(steps, tmp_path):
    with pytest.raises(ValueError, match=f"^steps must be between 1 and 3, not {steps}$"):
        export_scenario(nanosat(steps=3), steps, tmp_path)


def test_arguments_of_observation_models_are_inputs(tmp_path):
    """Behind u, in the step in which they are given."""
    made = CATALOGUE["battery"].scenario(0, 3)
    binary, _ = export_scenario(made, 3, tmp_path)
    assert np.frombuffer(binary.read_bytes(), "<u4", 1, 24) == 2
    p = made.params
    first = 48 + 8 * (1 + p.n + p.n**2 + p.q**2 + p.r**2)
    numbers = np.frombuffer(binary.read_bytes(), "<f8", 6, first).reshape(3, 2)
    assert numbers[:, 0].tolist() == np.asarray(made.record.inputs).tolist()
    assert numbers[:, 1].tolist() == [
        given["current"] for given in made.record.observation_arguments
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        (["left"] * 3, "^u must be a finite number in every step, and is none at step 0$"),
        (np.full((3, 1), np.nan), r"^u\[0\] must be a finite number in every step"),
        (
            np.zeros((3, 33)),
            "^scenario must have at most 32 numbers that the models take in a step,",
        ),
        ([np.zeros(1), np.zeros(2), np.zeros(1)], r"^u must have the shape \(1,\) in every step"),
    ],
    ids=["text", "nan", "33", "ragged"],
)
def test_inputs_are_numbers(inputs, message, tmp_path):
    made = nanosat(steps=3)
    made = replace(made, inputs=(), data=replace(made.record, inputs=inputs))
    with pytest.raises(ValueError, match=message):
        export_scenario(made, 3, tmp_path)


def test_an_input_may_be_a_number(tmp_path):
    made = random_scenario(UkfParams(n=2, m=1), steps=3)
    made = replace(made, data=replace(made.record, inputs=[1.5, -2.0, 3]))
    binary, _ = export_scenario(made, 3, tmp_path)
    data = binary.read_bytes()
    assert np.frombuffer(data, "<u4", 8)[6:].tolist() == [1, 3]
    behind = 4 * (3 + 1 + 3)
    assert np.frombuffer(data, "<f8", 3, len(data) - behind - 24 - 24).tolist() == [1.5, -2.0, 3.0]


def test_sensors_stand_beside_each_other(tmp_path):
    """Measurements and masks of all rows, in the order of the sensors."""
    made = random_scenario(UkfParams(n=2, m=3, r=3, sensors=(1, 2)), steps=4)
    record = made.record
    sampled = {
        "s0": np.array([[1], [0], [1], [0]]),
        "s1": np.array([[1, 1], [1, 0], [0, 1], [0, 0]]),
    }
    made = replace(made, data=replace(record, sampled=sampled))
    binary, _ = export_scenario(made, 4, tmp_path)
    data = binary.read_bytes()
    words = np.frombuffer(data, "<u4", 4 + 2 + 8, len(data) - 56).tolist()
    assert words == [0b111, 0b010, 0b101, 0, 1, 2, *[0] * 8], "masks, noise terms, variants"
    found = np.frombuffer(data, "<f8", 12, len(data) - 56 - 96).reshape(4, 3)
    taken = np.hstack([sampled["s0"], sampled["s1"]])
    measured = np.hstack([record.measurements["s0"], record.measurements["s1"]])
    assert found.tolist() == np.where(taken, measured, 0.0).tolist()
    numbers = np.frombuffer(data, "<f8", (len(data) - 48 - 56) // 8, 48)
    assert numbers[7:16].tolist() == made.R.reshape(-1).tolist()


def test_a_file_of_results_must_be_whole(tmp_path):
    path = tmp_path / "results.bin"
    path.write_bytes(bytes(100))
    with pytest.raises(
        ValueError, match=r"results.bin must have 464 bytes, or whole steps, not 100$"
    ):
        read_results(path, NANOSAT, 1)


def test_results_with_the_covariance_of_each_step(tmp_path):
    rng = np.random.default_rng(0)
    kind = [("x", "<f8", 7), ("P", "<f8", (7, 7)), ("nis", "<f8"), ("codes", "<u4", 2)]
    rows = np.zeros(3, dtype=kind)
    rows["x"], rows["P"] = rng.standard_normal((3, 7)), rng.standard_normal((3, 7, 7))
    rows["nis"], rows["codes"] = rng.standard_normal(3), [[0, 0], [65, 0], [0, 1]]
    path = tmp_path / "results.bin"
    for end in (b"", rows["P"][-1].tobytes()):
        path.write_bytes(rows.tobytes() + end)
        found = read_results(path, NANOSAT, 3, covariances=True)
        assert (found.x == rows["x"]).all()
        assert (found.covariances == rows["P"]).all()
        assert (found.nis == rows["nis"]).all()
        assert found.results.tolist() == [0, 65, 0]
        assert found.gated.tolist() == [False, False, True]
        assert (found.P is None) == (not end)
    assert (rows["P"][-1] == found.P).all()


# Plot.


def test_the_plot_says_when_the_error_is_below_its_line(tmp_path):
    """What is printed beside it, from errors that are known."""
    made = scenario(60, pes=1)
    expected = golden_results(made, 60, covariances=True)
    x = made.record.truth.copy()
    errors = np.full(60, 0.05)
    errors[[0, 3, 20]] = 0.5, 0.5, 0.11
    half = np.radians(errors)[:, None] / 2.0
    q = made.record.truth[:, :4]
    about_x = np.array([q[:, 3], q[:, 2], -q[:, 1], -q[:, 0]]).T
    x[:, :4] = q * np.cos(half) + about_x * np.sin(half)
    found = replace(expected, x=x)
    image = tmp_path / "new" / "attitude.png"
    told = describe_attitude(image, made, found, "title")
    assert image.read_bytes().startswith(b"\x89PNG")
    assert told["error_at_end"] == pytest.approx(0.05)
    assert told["below_limit_from"] == made.times[21]
    band = 3.0 * attitude_deviations(x, expected.covariances)[:, 0]
    assert told["within_band"] == pytest.approx((errors < band).mean())
    assert told["within_band"] > 0.5
    x[-1] = x[0]
    assert describe_attitude(image, made, found, "title")["below_limit_from"] is None


# Command line.


def test_export_command(tmp_path):
    result = CliRunner().invoke(
        app,
        ["export", "--problem", "nanosat-additive", "--steps", "2", "--output", str(tmp_path),
         "--json"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["files"] == [
        str(tmp_path / "scenario.bin"), str(tmp_path / HEADER)
    ]  # fmt: skip
    export_scenario(CATALOGUE["nanosat"].scenario(steps=2), 2, tmp_path / "augmented")
    assert (tmp_path / HEADER).read_text() != (tmp_path / "augmented" / HEADER).read_text()


def test_export_complains(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    result = CliRunner().invoke(
        app, ["export", "--problem", "nanosat", "--steps", "2", "--output", str(file)]
    )
    assert result.exit_code == 2
    assert "--output must be a folder" in result.output
