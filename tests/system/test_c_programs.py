"""The C application as programs: with sanitizers, for the ARM, without an operating system."""

import socket
import struct
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from ukf_sim.c_in_the_loop.compiler import (
    BARE_METAL_MAIN,
    DRIVER,
    LINUX_MAIN,
    RUN,
    CompilerError,
    Toolchain,
    compile_application,
    compile_c,
    compile_objects,
    models_in,
    write_headers,
    write_models,
)
from ukf_sim.c_in_the_loop.loop import first_difference, golden_results
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.lowering.software import in_core_arithmetic
from ukf_sw.problem import Sensor
from ukf_sw.problems.scenario_files import export_scenario, read_results
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE, nanosat, nanosat_2014_rates
from ukf_sw.spec.parameters import Noise, UkfParams
from ukf_sw.spec.registers import CONTROL, ERROR
from ukf_tools.arm.emulator import arm_available, run_on_arm
from ukf_tools.arm.register_server import RegisterServer

needs_cc = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
STEPS = 12


def compiled(scenario, folder, flags=()):
    """The program for Linux, native, with the models of a scenario."""
    write_headers(scenario.params, folder)
    write_models(scenario, folder)
    return compile_application(folder / "nanosat", folder, main=LINUX_MAIN, flags=flags)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The same for the nanosatellite, with sanitizers."""
    return compiled(nanosat(steps=STEPS), tmp_path_factory.mktemp("program"), SANITIZED)


def in_python(scenario, steps):
    """What Python computes with models in the same arithmetic."""
    return golden_results(in_core_arithmetic(scenario), steps)


def run(program, scenario, folder, *, bus=None, steps=STEPS, options=()):
    """Run a program against a golden model; gives the process and its results."""
    binary, _ = export_scenario(scenario, steps, folder)
    bus = bus or GoldenBus(GoldenCore(scenario.params))
    with RegisterServer(folder / "socket", bus) as server:
        done = subprocess.run(
            [str(program), f"remote:{folder / 'socket'}", str(binary),
             str(folder / "results.bin"), *options],
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        done.words = server.words
    return done, read_results(folder / "results.bin", scenario.params, steps)


@needs_cc
@pytest.mark.parametrize("options", [(), ("polling",)], ids=["interrupt", "polling"])
def test_the_program_computes_what_python_computes(program, options, tmp_path):
    scenario = nanosat(steps=STEPS)
    done, results = run(program, scenario, tmp_path, options=options)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{STEPS} steps, 0 errors, 0 recoveries\n"
    assert done.words > 350 * STEPS
    assert first_difference(results, in_python(scenario, STEPS)) is None


@needs_cc
def test_masks_come_with_the_samples(program, tmp_path):
    """Sensors with gaps: some updates of one sensor, many steps without any."""
    scenario = nanosat_2014_rates(gaps="random", P0=0.01, steps=40)
    done, results = run(program, scenario, tmp_path, steps=40)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, in_python(scenario, 40)) is None
    sampled = scenario.samples()[1].any(axis=1)
    assert 0 < sampled.sum() < 20
    assert (np.isnan(results.nis) == ~sampled).all()


def of_two_sensors(problem, sampled):
    """The same problem with an accelerometer and a magnetometer of their own."""
    (name,) = problem.sensor_names
    h = problem.sensor(name).h
    measurements, _ = problem.samples()
    halves = {"accelerometer": slice(3), "magnetometer": slice(3, 6)}

    def model(own):
        return lambda x, v: h(x, np.concatenate((v, v)))[own]

    return replace(
        problem,
        sensors={
            name: Sensor(model(own), R=problem.R[own, own], m=3) for name, own in halves.items()
        },
        data=replace(
            problem.record,
            measurements={name: measurements[:, own] for name, own in halves.items()},
            sampled={name: sampled[:, own] for name, own in halves.items()},
        ),
    )


@needs_cc
@pytest.mark.parametrize("noise", list(Noise), ids=lambda noise: noise.value)
def test_two_sensors(noise, tmp_path):
    """In each step those of which something was sampled, in their order; NIS is the sum."""
    one = replace(nanosat(steps=24), observation_noise=noise)
    scenario = of_two_sensors(one, np.random.default_rng(1).random((24, 6)) < 0.3)
    assert scenario.params.sensors == (3, 3)
    program = compiled(scenario, tmp_path, SANITIZED)
    done, results = run(program, scenario, tmp_path, steps=24)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, in_python(scenario, 24)) is None
    updates = sum(scenario.samples(name)[1].any(axis=1) for name in scenario.sensor_names)
    assert set(updates.tolist()) == {0, 1, 2}
    assert (np.isnan(results.nis) == (updates == 0)).all()


@needs_cc
def test_additive_noise(tmp_path):
    scenario = nanosat(noise=Noise.ADDITIVE, steps=STEPS)
    done, results = run(compiled(scenario, tmp_path), scenario, tmp_path)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, in_python(scenario, STEPS)) is None


@needs_cc
def test_single_precision(tmp_path):
    """With -DUKF_REAL=float nothing changes: models and core are in binary32 anyway."""
    scenario = nanosat(steps=STEPS)
    program = compiled(scenario, tmp_path, ("-DUKF_REAL=float",))
    done, results = run(program, scenario, tmp_path)
    assert done.returncode == 0, done.stderr
    assert first_difference(results, in_python(scenario, STEPS)) is None


class FailingBus(GoldenBus):
    """A golden model with a failure in one of its steps, counted by name."""

    def __init__(self, name, at, effect):
        super().__init__(GoldenCore(NANOSAT))
        self._mask = CONTROL[name].mask
        self._left = at
        self._effect = effect
        self._broken = False

    def write(self, address, word):
        starts = address == CONTROL.offset and word & self._mask
        if starts:
            self._left -= 1
        if starts and self._left == 0 and self._effect in ("hang", "die"):
            self.core.hold = True
        super().write(address, word)
        if starts and self._left == 0 and self._effect == "reset":
            super().write(address, CONTROL["RESET"].mask | CONTROL["ENABLE"].mask)
        if address == CONTROL.offset and word & CONTROL["RESET"].mask and self._effect == "hang":
            self.core.hold = False
        if starts and self._left == 0 and self._effect == "error":
            self._broken = True

    def read(self, address):
        if address == ERROR.offset and self._broken:
            self._broken = False
            return 37
        return super().read(address)


@needs_cc
@pytest.mark.parametrize("effect", ["hang", "error"])
def test_the_application_recovers(program, effect, tmp_path):
    """A core that hangs, or reports what nobody knows, in step 5: one sample is lost."""
    scenario = nanosat(steps=STEPS)
    bus = FailingBus("PREDICT", 6, effect)
    done, results = run(program, scenario, tmp_path, bus=bus)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{STEPS} steps, 1 errors, 1 recoveries\n"
    assert (
        done.stderr == f"step 5: {'time-out (65)' if effect == 'hang' else 'unknown error (37)'}\n"
    )
    expected = in_python(scenario, STEPS)
    assert (results.x[:5] == expected.x[:5]).all()
    assert (results.x[5] == expected.x[4]).all(), "it goes on from the estimate before"
    assert (results.results[np.arange(STEPS) != 5] == 0).all()
    assert np.abs(results.x[-1] - expected.x[-1])[:4].max() < 0.01


@needs_cc
def test_the_application_begins_anew_when_its_estimate_is_lost(program, tmp_path):
    """Somebody resets the core in UPDATE: the prediction is lost, its factor perhaps as well."""
    scenario = nanosat(steps=STEPS)
    done, results = run(program, scenario, tmp_path, bus=FailingBus("UPDATE", 6, "reset"))
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{STEPS} steps, 1 errors, 1 recoveries\n"
    assert done.stderr == "step 5: step lost (66)\n"
    assert (results.x[5] == scenario.x0.astype(np.float32)).all()


@needs_cc
def test_the_application_ends_when_the_core_cannot_be_recovered(program, tmp_path):
    """It hangs, and does so again after a reset."""
    done, results = run(
        program, nanosat(steps=STEPS), tmp_path, bus=FailingBus("PREDICT", 1, "die")
    )
    assert done.returncode == 1
    assert done.stderr.startswith("step 0: time-out (65)\ntime-out: step 1, ")
    assert len(results.x) == 1
    assert results.P is None


@needs_cc
def test_a_wrong_core_ends_the_program(program, tmp_path):
    binary, _ = export_scenario(nanosat(steps=1), 1, tmp_path)
    with RegisterServer.of_golden(tmp_path / "socket", NANOSAT_ADDITIVE):
        done = subprocess.run(
            [str(program), f"remote:{tmp_path / 'socket'}", str(binary), str(tmp_path / "out")],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("wrong format: step 0, code 0, index 0, address 0x8, ")


@needs_cc
@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, "usage: "),
        (("uio:/dev/no-such-device", "s", "r"), 1, "No such file"),
        (("remote:no-such-socket", "s", "r"), 1, "No such file"),
        (("remote:" + 200 * "x", "s", "r"), 1, "File name too long"),
        (("remote:x", "s", "r", "sometimes"), 2, "usage: "),
    ],
)
def test_bad_arguments(program, arguments, code, message):
    done = subprocess.run([str(program), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert message in done.stderr


@needs_cc
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", "cannot be read"),
        (lambda data: b"XKFS" + data[4:], "not a scenario of this byte order"),
        (lambda data: data[:4] + b"\1" + data[5:], "of another version"),
        (lambda data: data[:8] + b"\x21" + data[9:], "sizes must be at most 32"),
        (lambda data: data[:28] + b"\xff" * 4 + data[32:], "too many steps"),
        (lambda data: data[:-1], "too short"),
        (lambda data: data + b"\0", "too long"),
    ],
)  # fmt: skip
def test_bad_scenario_files(program, change, message, tmp_path):
    binary, _ = export_scenario(nanosat(steps=2), 2, tmp_path)
    binary.write_bytes(change(binary.read_bytes()))
    with RegisterServer.of_golden(tmp_path / "socket", NANOSAT):
        done = subprocess.run(
            [str(program), f"remote:{tmp_path / 'socket'}", str(binary), str(tmp_path / "out")],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == f"{binary}: {message}\n"


def test_the_server_refuses_what_it_does_not_know(tmp_path):
    with RegisterServer.of_golden(tmp_path / "socket", NANOSAT) as server:
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(tmp_path / "socket"))
            answers = []
            for request in ((0, 0, 0, 0), (0, 0xFFFF_FFF0, 0, 0), (7, 0, 0, 0)):
                client.sendall(struct.pack("=4I", *request))
                answers.append(struct.unpack("=2I", client.recv(8, socket.MSG_WAITALL)))
        assert answers == [(1, 0x554B_0006), (0, 0), (0, 0)]
        assert server.words == 2
    assert not (tmp_path / "socket").exists()


@pytest.mark.skipif(
    not arm_available(), reason="gcc-arm-linux-gnueabihf or qemu-user is not installed"
)
@pytest.mark.parametrize("interrupt", [True, False], ids=["interrupt", "polling"])
def test_the_program_for_the_cortex_a9(interrupt, tmp_path):
    """The very binary for the board, in an emulator of its processor: bit for bit."""
    outcome = run_on_arm(nanosat(steps=STEPS), STEPS, tmp_path, interrupt=interrupt)
    assert outcome.program.read_bytes()[18:20] == b"\x28\0", "an executable for ARM"
    assert outcome.mismatch is None
    assert not outcome.results.results.any()
    assert outcome.words > 350 * STEPS


def test_missing_tools_are_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CompilerError, match=r"^qemu-arm is not installed$"):
        run_on_arm(nanosat(steps=1), 1, tmp_path / "arm")
    with pytest.raises(CompilerError, match=r"^cc is not installed$"):
        compile_c([DRIVER[0]], tmp_path / "driver.o", [], flags=("-c",))


#: What a program without an operating system must bring: the mathematics and four functions that
#: compilers call by themselves.
FREESTANDING = {
    "sqrt", "rint", "fabs", "fmax", "fabsf", "copysignf",
    "memcpy", "memset", "memmove", "memcmp",
}  # fmt: skip


@pytest.mark.parametrize("toolchain", list(Toolchain), ids=lambda toolchain: toolchain.value)
def test_the_program_without_an_operating_system(toolchain, tmp_path):
    """It compiles for a freestanding environment and needs nothing else."""
    if not toolchain.available:
        pytest.skip(f"{toolchain.command[0]} is not installed")
    scenario = nanosat(steps=20)
    write_headers(NANOSAT, tmp_path)
    write_models(scenario, tmp_path)
    export_scenario(scenario, 20, tmp_path)
    sources = [*DRIVER, *RUN, *models_in(tmp_path), *BARE_METAL_MAIN]
    objects = compile_objects(
        sources, tmp_path, [tmp_path], toolchain=toolchain, flags=("-ffreestanding",)
    )
    linked = tmp_path / "program.o"
    subprocess.run(
        [*toolchain.command, "-nostdlib", "-r", "-o", str(linked), *map(str, objects)], check=True
    )
    nm = "nm" if toolchain is Toolchain.NATIVE else "arm-linux-gnueabihf-nm"
    symbols = subprocess.run([nm, str(linked)], capture_output=True, text=True, check=True).stdout
    kinds = {line.split()[-1]: line.split()[-2] for line in symbols.splitlines()}
    # The linker brings its table of addresses.
    undefined = {name for name, kind in kinds.items() if kind == "U"} - {"_GLOBAL_OFFSET_TABLE_"}
    # The compiler's own helpers for arithmetic begin with two underscores.
    assert {name for name in undefined if not name.startswith("__")} <= FREESTANDING
    assert kinds["main"] == kinds["ukf_run_interrupt"] == "T"


@needs_cc
def test_a_core_of_other_sizes_does_not_compile(tmp_path):
    write_headers(UkfParams(n=2, m=1), tmp_path)
    write_models(nanosat(steps=1), tmp_path)
    with pytest.raises(CompilerError, match=r"UKF_N == 7u.*this is another core"):
        compile_c([tmp_path / "ukf_problem.c"], tmp_path / "o", [tmp_path], flags=("-c",))
