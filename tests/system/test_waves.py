"""Waveforms: their signals have the values of the golden model, on the right clocks."""

import json
import subprocess
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from support.waveform import Waveform
from ukf_sim.builds import Build, build
from ukf_sim.cosimulation import Cosimulation, cosimulate
from ukf_sim.session import Job
from ukf_sim.signal_lists import NUMBER, PLAIN, Signals, write_signal_lists
from ukf_sim.simulators import Simulator, SimulatorError
from ukf_sw.drivers.driver import Driver
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.mnemonics import Mnemonics
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import OF_MODELS, WAYS, Program, Routine, Step

STEPS = 1
ENGINE, CONTROL = "ukf_core.core.engine", "ukf_core.core.control"

#: Of each simulator, a core; they differ in form, format and noise.
CORES = {
    Simulator.VERILATOR: UkfParams(n=2, m=1, q=1, r=1, pes=2),
    Simulator.ICARUS: UkfParams(
        n=2, m=1, q=2, r=1, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
        form=Form.COVARIANCE, format=BINARY16, pes=2,
    ),
}  # fmt: skip


class Clock(NamedTuple):
    """What the golden model has after some words of a program."""

    memory: np.ndarray
    scalars: np.ndarray
    nis: int | None
    error_code: int


class Execution(NamedTuple):
    """A program that the golden model has run; clocks from before its first word on."""

    program: Program
    state_bank: int
    factor_bank: int
    clocks: list[Clock]


class Recorder(Interpreter):
    """An engine that notes what every word of its programs does."""

    def __init__(self, params):
        super().__init__(params)
        self.executions = []

    def run(self, program, *, stop_after=None, **options):
        before = self.memory.copy(), self._scalars.copy()
        clocks = []
        words = len(self.microcode.words_of(program))
        if program is Program.UPDATE_REDRAWN:
            words += len(self.microcode.words_of(Program.UPDATE))
        for count in range(words + 1):
            self.memory[:], self._scalars[:] = before
            result = super().run(program, stop_after=count, **options)
            scalars = self.params.format.encode(self._scalars)
            clocks.append(Clock(self.memory.copy(), scalars, result.nis, result.error_code))
        self.executions.append(
            Execution(program, options["state_bank"], options["factor_bank"], clocks)
        )
        return result


class RecordingBus(GoldenBus):
    """The golden model's bus, which notes what is written."""

    def __init__(self, core):
        super().__init__(core)
        self.writes = []

    def write(self, address, word):
        self.writes.append((address, word))
        super().write(address, word)

    def write_many(self, addresses, words):
        self.writes += zip(addresses.tolist(), words.tolist(), strict=True)
        super().write_many(addresses, words)

    def wait_for_interrupt(self, timeout):
        return self.core.irq


class Found(NamedTuple):
    """A waveform, and what the golden model did."""

    params: UkfParams
    simulator: Simulator
    waves: Waveform
    folder: object
    run: object
    executions: list[Execution]
    writes: list[tuple[int, int]]


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(Simulator.VERILATOR, marks=pytest.mark.slow, id="verilator"),
        pytest.param(Simulator.ICARUS, id="icarus"),
    ],
)
def found(request, core_cache, tmp_path_factory):
    pytest.importorskip("pywellen", reason="pywellen, which reads waveforms, is not installed")
    simulator, params = request.param, CORES[request.param]
    if not simulator.available:
        pytest.skip(f"{simulator.value} is not installed")
    # A folder that is not there yet, and has a space.
    folder = tmp_path_factory.mktemp("waves") / "a folder"
    file = folder / f"run{simulator.tool.waves.suffix}"
    recipe = Recipe(name=None, params=params)
    try:
        simulated = cosimulate(
            recipe.scenario, STEPS, simulator=simulator, cache=core_cache, optimise=False,
            waves=file,
        )  # fmt: skip
    except SimulatorError as error:
        if "needs to write waveforms" not in str(error):
            raise
        pytest.skip(str(error))
    assert simulated.okay
    engine = Recorder(params)
    bus = RecordingBus(GoldenCore(params, engine=engine))
    driver = Driver(bus, params, interrupt=bus.wait_for_interrupt)
    run(recipe.scenario(STEPS), driver, steps=STEPS, covariance=True)
    return Found(
        params, simulator, Waveform(file), folder, simulated.run, engine.executions, bus.writes
    )


@pytest.fixture
def starts(found):
    """Clocks on which programs start."""
    return [clock for clock, start in enumerate(found.waves[f"{CONTROL}.run__start"]) if start == 1]


@pytest.mark.system
def test_steps(found, starts):
    """State register, program and banks, from start to done; every program has its clocks."""
    waves, code = found.waves, microcode(found.params, Pipeline())
    steps = {way.program: step for step, ways in WAYS.items() for way in ways}
    programs = Counter(execution.program for execution in found.executions)
    updates = programs[Program.UPDATE] + programs[Program.UPDATE_REDRAWN]
    assert programs[Program.PREDICT] == updates == STEPS
    assert len(starts) == len(found.executions)
    for start, execution in zip(starts, found.executions, strict=True):
        # One clock to begin with, two until the first word, and one behind the last.
        end = start + 2 + len(execution.clocks) - 1
        assert end - start + 1 == code.clocks(execution.program)
        assert {waves[f"{CONTROL}.state"][k] for k in range(start, end + 1)} == {
            steps[execution.program]
        }
        assert waves[f"{CONTROL}.state"][end + 1] == Step.IDLE
        assert waves[f"{CONTROL}.run__program"][start] == execution.program
        done = [k for k in range(start, end + 2) if waves[f"{CONTROL}.run__done"][k] == 1]
        assert done == [end]
        assert waves[f"{CONTROL}.banks__state"][start] == execution.state_bank
        assert waves[f"{CONTROL}.banks__factor"][start] == execution.factor_bank


@pytest.mark.system
def test_every_clock(found, starts):
    """Control word, memories, scalar file, NIS and error, after every word of every program."""
    waves, code = found.waves, microcode(found.params, Pipeline())
    signals = Signals(code)
    elements = [
        (signal, int(signal.scope.rpartition("_")[2]))
        for group in signals.groups
        for signal in group.signals
        if signal.name == "memory_0"
    ]
    assert len(elements) > 50
    word_name = found.simulator.tool.waves.surfer_word
    changed = 0
    for start, execution in zip(starts, found.executions, strict=True):
        words = code.words[code.entry[Routine(execution.program)] :]
        for count, golden in enumerate(execution.clocks):
            clock = start + 2 + count
            if count < len(execution.clocks) - 1:
                assert waves[f"{ENGINE}.sequencer.word"][clock] == words[count]
            for signal, lane in elements:
                array = word_name.format(array=signal.name, index=signal.index)
                value = waves[f"{signal.scope}.{array}"][clock]
                assert value == golden.memory[lane, signal.index], (execution.program, count)
            for k in range(code.scalars):
                array = word_name.format(array="scalar_file", index=k)
                assert waves[f"{ENGINE}.{array}"][clock] == golden.scalars[k]
            if golden.nis is not None:
                assert waves[f"{ENGINE}.run__nis"][clock] == golden.nis
            assert waves[f"{ENGINE}.run__error_code"][clock] == golden.error_code
        changed += np.count_nonzero(execution.clocks[0].memory != execution.clocks[-1].memory)
    assert changed > 50


@pytest.mark.system
def test_results(found, starts):
    """Scalar bus on the clock of the NIS, the register of it, and what the filter read."""
    waves, code = found.waves, microcode(found.params, Pipeline())
    mark = code.format.fields["nis"]
    # The last number that is marked is the NIS, those before are on the way to it.
    words = enumerate(code.words_of(Program.UPDATE))
    *_, in_update = (k for k, word in words if word >> mark.lsb & 1)
    updates = [
        (start, execution)
        for start, execution in zip(starts, found.executions, strict=True)
        if execution.program in (Program.UPDATE, Program.UPDATE_REDRAWN)
    ]
    for (start, execution), nis in zip(updates, found.run.nis, strict=True):
        entries = (code.entry[Routine(each)] for each in (Program.UPDATE, execution.program))
        at = in_update + next(entries) - next(entries)
        golden = execution.clocks[at + 1].nis
        assert waves[f"{ENGINE}.bus"][start + 2 + at] == golden
        after = start + 2 + len(execution.clocks)
        assert waves[f"{CONTROL}.nis"][after] == golden
        assert found.params.format.decode(np.array([golden], np.uint64))[0] == nis


@pytest.mark.system
def test_bus(found):
    """What is written on AXI4-Lite is what the driver writes to the golden model, in its order."""
    waves = found.waves

    def taken(channel, payload):
        valid, ready = (waves[f"ukf_core.s_axi_{channel}{what}"] for what in ("valid", "ready"))
        values = waves[f"ukf_core.s_axi_{payload}"]
        return [values[k] for k in range(waves.clocks) if valid[k] == 1 == ready[k]]

    writes = list(zip(taken("aw", "awaddr"), taken("w", "wdata"), strict=True))
    assert len(writes) > 20
    assert writes == found.writes


@pytest.mark.system
def test_lists_name_what_is_there(found):
    """Every signal of the lists is in the waveform, as wide as they say; every value has a text."""
    code = microcode(found.params, Pipeline())
    signals, tool = Signals(code), found.simulator.tool.waves
    commands = (found.folder / "run.sucl").read_text(encoding="utf-8").splitlines()
    added = [line.partition(" ")[2] for line in commands if line.startswith("variable_add ")]
    shown = [signal for group in signals.groups for signal in group.signals]
    # The control word is there as what it reads, and as what it writes.
    assert len(added) == len(set(added)) + 1 == len(shown)
    save = (found.folder / "run.gtkw").read_text(encoding="utf-8").splitlines()
    for signal, name in zip(shown, added, strict=True):
        assert found.waves.widths[name] == signal.width, name
        path = f"{signal.scope}.{signal.name}"
        if signal.index is not None:
            word = tool.gtkwave_word.format(array=signal.name, index=signal.index)
            path = f"{signal.scope}.{word}"
        bits = f"[{signal.width - 1}:0]" if signal.width > 1 else ""
        assert f"+{{{signal.label}}} {path}{bits}" in save
        if signal.shown not in (PLAIN, NUMBER):
            values = {value for _, value in found.waves.changes(name) if isinstance(value, int)}
            assert values <= set(signals.names[signal.shown]), signal
    assert (found.folder / commands[0].partition(" ")[2]).exists()
    assert f'[dumpfile] "run{tool.suffix}"' in save


# What is beside a waveform, without one.


@pytest.fixture
def listed(tmp_path):
    """Function that writes the lists of a core, and gives its signals."""

    def write(simulator=Simulator.VERILATOR, **parameters):
        signals = Signals(microcode(UkfParams(**{"n": 2, "m": 1} | parameters), Pipeline()))
        write_signal_lists(tmp_path / "run.fst", signals, simulator)
        return signals

    return write


def table(file):
    """Texts of a table by value, which is a word of text itself."""
    lines = file.read_text(encoding="utf-8").splitlines()
    return dict(line.split(" ", 1) for line in lines)


@pytest.mark.parametrize("simulator", list(Simulator))
def test_tables_of_names(listed, tmp_path, simulator):
    signals = listed(simulator, pes=2)
    code = microcode(UkfParams(n=2, m=1, pes=2), Pipeline())
    mnemonics, digits = Mnemonics(code), -(-code.format.width // 4)
    for half in ("reads", "writes"):
        texts = table(tmp_path / "run.gtkwave" / f"{half}.txt")
        describe = getattr(mnemonics, half)
        assert texts == {f"{word:0{digits}x}": describe(word) for word in {0, *code.words}}
    assert table(tmp_path / "run.gtkwave" / "step.txt") == {
        str(step.value): step.name for step in Step if step not in OF_MODELS
    }
    for name in signals.names:
        shown = table(tmp_path / ".surfer" / "mappings" / f"run-{name}.txt")
        assert {int(value, 2): text for value, text in shown.items()} == signals.names[name]
        # All values have the signal's width, which tells it to Surfer.
        (width,) = {len(value) - 2 for value in shown}
        known = {"step": 3, "program": 3, "error": 8}
        assert width == known.get(name, code.format.width)
        assert f"item_set_format run-{name}" in (tmp_path / "run.sucl").read_text().splitlines()


def test_rows_have_their_names(listed):
    """Elements under the names of the equations, at their places in the memories."""
    signals = listed(pes=3, q=1)
    layout = microcode(UkfParams(n=2, m=1, pes=3, q=1), Pipeline()).layout
    places = {
        signal.label: (int(signal.scope[-1]), signal.index)
        for group in signals.groups
        for signal in group.signals
        if signal.name == "memory_0"
    }
    for bank in (0, 1):
        for k in range(2):
            assert places[f"x[{k}] in bank {bank}"] == layout.buffer_location(
                "x", 0, k, state_bank=bank
            )
            assert places[f"L[1][{k}] in bank {bank}"] == layout.buffer_location(
                "L", 1, k, factor_bank=bank
            )
    for column in range(layout.columns):
        (address, _), lane = layout.X[1].element(column)
        assert places[f"X[1][{column}]"] == (lane, address)
    assert f"X[1][{layout.columns}]" not in places
    assert places["root[2]"] == (0, layout.roots[2].address)


@pytest.mark.parametrize(
    "fmt", [BINARY32, BINARY64, BINARY16, BFLOAT16, FloatFormat(exponent_bits=6, fraction_bits=17)]
)
def test_words_are_shown_as_numbers(listed, tmp_path, fmt):
    listed(format=fmt)
    rng = np.random.default_rng(1)
    words = rng.integers(0, 1 << fmt.width, size=200, dtype=np.uint64)
    special = [0.0, -0.0, 1.0, -1.5, 0.1, np.inf, -np.inf, np.nan]
    words = np.concatenate([words, fmt.encode(np.array(special))])
    text = "".join(f"{word:0{fmt.width // 4}X}\n" for word in words.tolist()) + "xx\n"
    shown = subprocess.run(
        [tmp_path / "run.gtkwave" / "number.py"], input=text, capture_output=True, text=True,
        check=True,
    ).stdout.splitlines()  # fmt: skip
    assert shown.pop() == "xx"
    assert shown[-len(special) :] == ["0", "-0", "1", "-1.5", shown[-4], "inf", "-inf", "NaN"]
    # As many digits as the format has, up to 8; a half of the last is lost.
    digits = min(int(np.ceil(fmt.precision * np.log10(2.0))), 8)
    np.testing.assert_allclose(
        [float(number) for number in shown], fmt.decode(words), rtol=5.0 * 10.0**-digits
    )


@pytest.mark.parametrize(
    ("fmt", "name"),
    [
        (BINARY32, "FP: 32-bit IEEE 754"),
        (BFLOAT16, "FP: bfloat16"),
        (FloatFormat(exponent_bits=6, fraction_bits=17), "Hexadecimal"),
    ],
)
def test_surfer_is_told_the_format(listed, tmp_path, fmt, name):
    listed(format=fmt)
    lines = (tmp_path / "run.sucl").read_text(encoding="utf-8").splitlines()
    at = lines.index("variable_add ukf_core.core.engine.bus")
    assert lines[at + 1] == f"item_set_format {name}"
    # A heading is one word for its parser.
    headings = [line.removeprefix("divider_add ") for line in lines if "divider_add" in line]
    assert all(heading.isidentifier() for heading in headings)
    assert {"steps", "X_1", "x_in_bank_1"} <= set(headings)


def test_names_of_filters_have_no_spaces(tmp_path):
    """GTKWave takes what follows a space for an argument, and then shows no numbers."""
    signals = Signals(microcode(UkfParams(n=1, m=1), Pipeline()))
    write_signal_lists(tmp_path / "run 1 (a).vcd", signals, Simulator.ICARUS)
    lines = (tmp_path / "run 1 (a).gtkw").read_text(encoding="utf-8").splitlines()
    filters = [line for line in lines if line.startswith("^")]
    assert "^>1 ./run_1__a_.gtkwave/number.py" in filters
    assert (tmp_path / "run_1__a_.gtkwave" / "number.py").exists()
    assert all(line.count(" ") == 1 for line in filters)


# Files that cannot be.


@pytest.mark.parametrize("simulator", list(Simulator))
@pytest.mark.parametrize("name", ["run", "run.lxt", "run.fst.gz"])
def test_suffix_must_agree(simulator, name, tmp_path):
    suffix = simulator.tool.waves.suffix
    with pytest.raises(ValueError, match=f"^waves must be a {suffix} file, which is what "):
        simulator.require_waves(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_file_must_be_one_that_can_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.vcd").mkdir()
    with pytest.raises(ValueError, match=r"^waves must be a file that can be written, not '"):
        Simulator.ICARUS.require_waves(tmp_path / "file" / "run.vcd")
    with pytest.raises(ValueError, match=r"^waves must be a file, not the folder '"):
        Simulator.ICARUS.require_waves(tmp_path / "folder.vcd")
    Simulator.ICARUS.require_waves(tmp_path / "new" / "run.vcd")
    assert not (tmp_path / "new" / "run.vcd").exists()


def test_missing_header_is_named(tmp_path, monkeypatch):
    tool = Simulator.VERILATOR.tool
    waves = replace(tool.waves, headers=("no_such_header.h",), installation="some command")
    monkeypatch.setattr(Simulator.VERILATOR, "tool", replace(tool, waves=waves))
    with pytest.raises(
        SimulatorError,
        match=r"^no_such_header\.h, which verilator needs to write waveforms, is not installed "
        r"\(some command\)$",
    ):
        Simulator.VERILATOR.require_waves(tmp_path / "run.fst")


@pytest.mark.parametrize(("simulator", "name"), [("verilator", "run.vcd"), ("icarus", "run.fst")])
def test_command_refuses_before_the_work(ukf, tmp_path, simulator, name):
    if not Simulator(simulator).available:
        pytest.skip(f"{simulator} is not installed")
    result = ukf(
        "cosim", "--n", 2, "--m", 1, "--simulator", simulator, "--waves", name, code=2
    )  # fmt: skip
    assert f"waves must be a {Simulator(simulator).tool.waves.suffix} file" in result.stderr
    assert result.stdout == ""
    assert not list(tmp_path.iterdir())


def test_command_says_where_the_waveform_is(ukf, icarus, monkeypatch):
    """What it asks for and what it prints, without the simulation."""
    asked = []
    recipe = Recipe(name=None, params=UkfParams(n=1, m=1))
    golden = run(recipe.scenario(1), "golden", steps=1)

    def simulate(make, steps, *, waves, simulator, **options):
        asked.append((waves, simulator))
        return Cosimulation(
            mismatch=None, words_compared=1, first_cycles={}, iterations=(), seconds=1.0,
            cpu_seconds=1.0, steps=1, run=golden, job=Job(params=recipe.params, task=""),
            build=Build(
                simulator=simulator, top="", folder=Path(), compiled=False, seconds=0.0
            ),
            simulation_seconds=1.0,
        )  # fmt: skip

    monkeypatch.setattr("ukf_sim.cosimulation.cosimulate", simulate)
    options = ("cosim", "--n", 1, "--m", 1, "--steps", 1, "--simulator", "icarus")
    text = ukf(*options, "--waves", "w/run.vcd").stdout
    assert (
        "Waveform: w/run.vcd. In that folder: gtkwave run.gtkw, or surfer --command-file run.sucl\n"
    ) in text
    record = json.loads(ukf(*options, "--waves", "w/run.vcd", "--json").stdout)
    assert record["waves"] == {
        "file": "w/run.vcd", "gtkwave": "w/run.gtkw", "surfer": "w/run.sucl",
    }  # fmt: skip
    assert json.loads(ukf(*options, "--json").stdout)["waves"] is None
    waveform = Path("w/run.vcd")
    assert asked == [(file, icarus) for file in (waveform, waveform, None)]


@pytest.mark.system
def test_without_waves_nothing_is_other(icarus, tmp_path):
    """The build that is asked for no waveform is the one that there was: it knows of none."""
    source = tmp_path / "core.v"
    source.write_text("module core; reg [7:0] memory [3:0]; endmodule\n", encoding="ascii")
    plain, traced = (
        build(source, "core", icarus, tmp_path / "cache", waves=words)
        for words in (None, ["core.memory[1]", "core.memory[2]"])
    )
    assert plain.folder != traced.folder
    record = json.loads((plain.folder / "built.json").read_text(encoding="utf-8"))
    identity = record["identity"]
    assert "waves" not in identity
    assert identity["flags"] == [*icarus.tool.cocotb_flags, *icarus.tool.flags, "", ""]
    assert not (plain.folder / "waves.v").exists()
    probe = (traced.folder / "waves.v").read_text(encoding="utf-8")
    for statement in ("core", "core.memory[1]", "core.memory[2]"):
        assert f"$dumpvars(0, {statement});" in probe
    again = build(source, "core", icarus, tmp_path / "cache", waves=["core.memory[1]"])
    assert again.compiled
    assert again.folder not in (plain.folder, traced.folder)
