import itertools

import numpy as np
import pytest

from ukf_sw.drivers.bus import WordCodec
from ukf_sw.drivers.driver import Driver
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.engine.programs import RunResult
from ukf_sw.errors import BusError
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.registers import (
    CONFIG,
    CONTROL,
    CYCLES,
    ERROR,
    GATE_HIGH,
    GATE_LOW,
    ID,
    INTERRUPT_ENABLE,
    INTERRUPT_PENDING,
    MASK,
    NIS_HIGH,
    NIS_LOW,
    REGISTERS,
    SENSORS,
    SIZES,
    STATUS,
    W0_HIGH,
    W0_LOW,
    ErrorCode,
    Register,
)
from ukf_sw.spec.sequence import OF_MODELS, Bank, Flag, Program, Step

SMALL = UkfParams(n=2, m=1, q=1, r=1, pes=2)
EVERY_W0 = [0.0, 0.5]
FORMATS = [BINARY16, BFLOAT16, BINARY32, BINARY64, FloatFormat(exponent_bits=6, fraction_bits=9)]
ENABLE = CONTROL["ENABLE"].mask
RESET = CONTROL["RESET"].mask
START = {step: CONTROL[step.name].mask for step in Step if step is not Step.IDLE}
#: Steps of a core without models.
STEPS = set(START) - OF_MODELS
ILLEGAL = (int(ErrorCode.ILLEGAL_STEP), 0)
CLOCKS = 77


class FakeEngine(Interpreter):
    """Memories of an engine; programs only report."""

    def __init__(self, params):
        super().__init__(params)
        self.ran = []
        self.sensors = []
        self.error = (0, 0)
        self.innovation_overflow = False
        self.nis = 0

    def run(
        self, program, *, sensor=0, variant=0, mask=-1, state_bank=0, factor_bank=0,
        stop_after=None,
    ):  # fmt: skip
        self.sensors.append(sensor)
        self.ran.append((program, mask, state_bank, factor_bank, stop_after))
        nis = self.nis if program in (Program.UPDATE, Program.UPDATE_REDRAWN) else None
        return RunResult(*self.error, nis, CLOCKS, self.innovation_overflow)


@pytest.fixture
def core():
    core = GoldenCore(SMALL, engine=FakeEngine(SMALL))
    assert core.write(CONTROL.offset, ENABLE)
    return core


def read(core, register: Register) -> int:
    data, okay = core.read(register.offset)
    assert okay
    return data


def start(core, step: Step) -> tuple[int, int]:
    """Start a step; gives the error."""
    assert core.write(CONTROL.offset, ENABLE | START[step])
    return error(core)


def error(core) -> tuple[int, int]:
    word = read(core, ERROR)
    return ERROR["CODE"].get(word), ERROR["INDEX"].get(word)


def flags(core) -> dict[str, int]:
    word = read(core, STATUS)
    names = ("INITIALISED", "POINTS", "RESIDUALS", "GATED")
    return {name: STATUS[name].get(word) for name in names if STATUS[name].get(word)}


def done(core) -> set[Step]:
    word = read(core, STATUS)
    return {step for step in START if STATUS[step.name].get(word)}


def last_program(core) -> Program:
    return core.engine.ran[-1][0]


def follow(core, *steps: Step) -> None:
    for step in steps:
        assert start(core, step) == (0, 0)


# Registers.


@pytest.mark.parametrize("number_format", FORMATS)
def test_registers_after_power_up(number_format):
    params = UkfParams(
        n=3, m=2, q=3, r=1, pes=4, format=number_format, form=Form.COVARIANCE,
        process_noise=Noise.ADDITIVE, W0=0.1,
    )  # fmt: skip
    core = GoldenCore(params)
    expected = dict.fromkeys(REGISTERS, 0)
    expected |= {
        ID: 0x554B_0006,
        SIZES: 0x02_01_03_03,
        CONFIG: 4 | number_format.exponent_bits << 8 | number_format.fraction_bits << 12 | 3 << 18,
        MASK: 0b11,
        GATE_LOW: number_format.infinity & 0xFFFF_FFFF,
        GATE_HIGH: number_format.infinity >> 32,
        W0_LOW: 0x9999_999A,
        W0_HIGH: 0x3FB9_9999,
        SENSORS: 1,
    }  # fmt: skip
    assert {register: read(core, register) for register in REGISTERS} == expected


def test_only_writable_fields_change(core):
    before = {register: read(core, register) for register in REGISTERS}
    everything = 0xFFFF_FFFF & ~RESET & ~sum(START.values())
    for register in REGISTERS:
        assert core.write(register.offset, everything if register is CONTROL else 0xFFFF_FFFF)
    after = {register: read(core, register) for register in REGISTERS}
    assert after == before | {INTERRUPT_ENABLE: 0b11, GATE_LOW: 0xFFFF_FFFF}


@pytest.mark.parametrize(
    ("number_format", "low", "high"),
    [
        (BINARY16, 0xFFFF, 0),
        (FloatFormat(exponent_bits=8, fraction_bits=31), 0xFFFF_FFFF, 0xFF),
        (BINARY64, 0xFFFF_FFFF, 0xFFFF_FFFF),
    ],
)
def test_bits_that_a_core_has_no_use_for_are_reserved(number_format, low, high):
    params = UkfParams(n=2, m=3, format=number_format)
    core = GoldenCore(params, engine=FakeEngine(params))
    for register, stored in ((MASK, 0b111), (GATE_LOW, low), (GATE_HIGH, high)):
        for word in (0xFFFF_FFFF, 0, 0xA5A5_A5A5):
            core.write(register.offset, word)
            assert read(core, register) == word & stored


@pytest.mark.parametrize("register", [MASK, GATE_LOW, GATE_HIGH])
@pytest.mark.parametrize("strobe", range(16))
def test_byte_strobes_of_registers(register, strobe):
    params = UkfParams(n=1, m=32, format=BINARY64)
    core = GoldenCore(params, engine=FakeEngine(params))
    core.write(register.offset, 0x11223344)
    core.write(register.offset, 0xAABBCCDD, strobe)
    expected = bytes(
        new if strobe >> i & 1 else old
        for i, (old, new) in enumerate(zip(b"\x44\x33\x22\x11", b"\xdd\xcc\xbb\xaa", strict=True))
    )
    assert read(core, register) == int.from_bytes(expected, "little")


def test_a_start_bit_acts_only_when_its_byte_is_strobed(core):
    core.write(CONTROL.offset, START[Step.INIT], 0b0001)
    assert (core.engine.ran, read(core, CONTROL)) == ([], 0)  # but ENABLE was written
    core.write(CONTROL.offset, ENABLE, 0b0010)
    assert read(core, CONTROL) == 0
    core.write(CONTROL.offset, ENABLE)
    core.write(CONTROL.offset, START[Step.INIT], 0b0010)
    assert last_program(core) is Program.INIT


@pytest.mark.parametrize("offset", range(4))
def test_low_address_bits_do_not_matter(core, offset):
    assert core.read(ID.offset + offset) == (0x554B_0006, True)


def test_unmapped_addresses_are_refused(core):
    memory_map = MemoryMap(SMALL)
    mapped = {register.offset for register in REGISTERS} | {
        memory_map.address(region.symbol, row, column)
        for region in memory_map
        for row in range(region.rows)
        for column in range(region.columns)
    }
    for address in range(0, 1 << memory_map.address_width, 4):
        okay = address in mapped
        assert core.read(address)[1] is okay
        assert core.write(address, 0) is okay
        if not okay:
            assert core.read(address) == (0, False)
            assert core.read_many(np.array([address])) is None
    assert core.read(1 << memory_map.address_width) == (0, False)
    assert core.read(-4) == (0, False)


# Sequence of steps.


@pytest.mark.parametrize("sensors", [(), (1, 1, 1)])
@pytest.mark.parametrize("sensor", [0, 1, 2, 3, 31])
def test_an_update_of_a_sensor_that_is_not_there_is_illegal(sensors, sensor):
    params = UkfParams(n=2, m=3, sensors=sensors)
    core = GoldenCore(params, engine=FakeEngine(params))
    chosen = CONTROL["SENSOR"].put(sensor) | ENABLE
    for step in (Step.INIT, Step.SIG_GEN):
        core.write(CONTROL.offset, chosen | START[step])
    assert (error(core), core.engine.sensors) == ((0, 0), [0, 0]), "it counts for UPDATE only"
    core.write(CONTROL.offset, chosen | START[Step.UPDATE])
    if sensor < max(len(sensors), 1):
        assert (error(core), core.engine.sensors[2:]) == ((0, 0), [sensor])
    else:
        assert (error(core), core.engine.sensors[2:]) == (ILLEGAL, [])


def test_steps_are_legal_only_in_sequence(core):
    allowed = {
        (): {Step.INIT},
        (Step.INIT,): {Step.INIT, Step.SIG_GEN, Step.COVARIANCE},
        (Step.INIT, Step.SIG_GEN): STEPS,
        (Step.INIT, Step.SIG_GEN, Step.PREDICT): STEPS - {Step.PREDICT},
        (Step.INIT, Step.SIG_GEN, Step.PREDICT, Step.UPDATE): STEPS,
        (Step.INIT, Step.SIG_GEN, Step.INIT): {Step.INIT, Step.SIG_GEN, Step.COVARIANCE},
    }
    for history, steps in allowed.items():
        for step in START:
            core.write(CONTROL.offset, ENABLE | RESET)
            follow(core, *history)
            before, ran = flags(core), len(core.engine.ran)
            finished = done(core)
            assert start(core, step) == ((0, 0) if step in steps else ILLEGAL)
            if step not in steps:
                assert (flags(core), done(core), len(core.engine.ran)) == (before, finished, ran)


@pytest.mark.parametrize("control", [START[Step.INIT], ENABLE | sum(START.values())])
def test_a_start_without_enable_or_with_another_is_illegal(core, control):
    core.write(CONTROL.offset, control)
    assert error(core) == ILLEGAL
    assert core.engine.ran == []
    assert read(core, INTERRUPT_PENDING) == INTERRUPT_PENDING["ERROR"].mask


def test_enable_and_start_in_one_write():
    core = GoldenCore(SMALL, engine=FakeEngine(SMALL))
    follow(core, Step.INIT)
    assert done(core) == {Step.INIT}


def test_programs_and_banks(core):
    core.write(MASK.offset, 0xFFFF_FFF0)
    expected = []

    def step(which, program, mask=0):
        expected.append((program, mask, core.state_bank, core.factor_bank, None))
        follow(core, which)
        assert core.engine.ran == expected
        assert read(core, CYCLES) == CLOCKS

    step(Step.INIT, Program.INIT)
    step(Step.SIG_GEN, Program.SIG_GEN)
    step(Step.PREDICT, Program.PREDICT)
    assert (core.state_bank, core.factor_bank) == (1, 0)
    step(Step.COVARIANCE, Program.COVARIANCE_PREDICTED)
    step(Step.UPDATE, Program.UPDATE)
    assert (core.state_bank, core.factor_bank) == (0, 1)
    step(Step.COVARIANCE, Program.COVARIANCE)
    step(Step.UPDATE, Program.UPDATE_REDRAWN)
    step(Step.PREDICT, Program.PREDICT)
    step(Step.SIG_GEN, Program.SIG_GEN_PREDICTED)
    assert (core.state_bank, core.factor_bank) == (0, 1)
    step(Step.UPDATE, Program.UPDATE_REDRAWN)
    assert flags(core) == {"INITIALISED": 1, "POINTS": 1}
    assert done(core) == STEPS


def test_sig_gen_with_points_there_ends_at_once(core):
    follow(core, Step.INIT, Step.SIG_GEN)
    ran = list(core.engine.ran)
    core.write(INTERRUPT_PENDING.offset, 0b11)
    core.hold = True
    follow(core, Step.SIG_GEN)
    assert core.engine.ran == ran
    assert not core.busy
    assert read(core, CYCLES) == 0
    assert done(core) == {Step.INIT, Step.SIG_GEN}
    assert read(core, INTERRUPT_PENDING) == INTERRUPT_PENDING["DONE"].mask


BEFORE = {
    "points": (Step.INIT, Step.SIG_GEN),
    "predicted": (Step.INIT, Step.SIG_GEN, Step.PREDICT),
}
FAILED = [
    ("points", Step.INIT, {}),
    ("points", Step.PREDICT, {"INITIALISED": 1}),
    ("points", Step.UPDATE, {"INITIALISED": 1}),
    ("points", Step.COVARIANCE, {"INITIALISED": 1, "POINTS": 1}),
    ("predicted", Step.SIG_GEN, {"INITIALISED": 1, "RESIDUALS": 1}),
    ("predicted", Step.UPDATE, {"INITIALISED": 1, "RESIDUALS": 1}),
    ("predicted", Step.COVARIANCE, {"INITIALISED": 1, "RESIDUALS": 1}),
]


@pytest.mark.parametrize(("before", "step", "after"), FAILED)
def test_failed_steps_commit_nothing(core, before, step, after):
    follow(core, *BEFORE[before])
    banks = core.state_bank, core.factor_bank
    core.write(INTERRUPT_PENDING.offset, 0b11)
    core.engine.error = (int(ErrorCode.NOT_POSITIVE_DEFINITE), 5)
    core.engine.nis = 123
    assert start(core, step) == core.engine.error
    assert flags(core) == after
    assert (core.state_bank, core.factor_bank) == banks
    assert read(core, NIS_LOW) == 0
    assert read(core, INTERRUPT_PENDING) == 0b11
    assert step in done(core)
    if before == "predicted" and step is not Step.COVARIANCE:
        core.engine.error = (0, 0)
        follow(core, Step.SIG_GEN)
        assert last_program(core) is Program.SIG_GEN_PREDICTED


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("number_format", [BINARY16, BINARY32, BINARY64])
def test_gate(before, number_format):
    params = UkfParams(n=2, m=1, format=number_format)
    core = GoldenCore(params, engine=FakeEngine(params))
    follow(core, *BEFORE[before])
    banks = core.state_bank, core.factor_bank
    gate, above = (int(word) for word in number_format.encode([9.0, 9.5]))
    negative = gate | 1 << (number_format.width - 1)  # magnitudes are compared
    core.write(GATE_LOW.offset, negative & 0xFFFF_FFFF)
    core.write(GATE_HIGH.offset, negative >> 32)
    core.engine.nis = above
    follow(core, Step.UPDATE)
    kept = {"RESIDUALS": 1} if before == "predicted" else {}
    assert flags(core) == {"INITIALISED": 1, "GATED": 1, **kept}
    assert (core.state_bank, core.factor_bank) == banks
    assert read(core, NIS_LOW) | read(core, NIS_HIGH) << 32 == above
    if before == "points":
        follow(core, Step.SIG_GEN)
    core.engine.nis = gate
    follow(core, Step.UPDATE)
    assert flags(core) == {"INITIALISED": 1, "POINTS": 1}


@pytest.mark.parametrize("number_format", [BINARY16, BINARY32, BINARY64])
def test_an_innovation_too_large_for_the_format_is_above_every_gate_that_is_not_off(number_format):
    params = UkfParams(n=2, m=1, format=number_format)
    core = GoldenCore(params, engine=FakeEngine(params))
    follow(core, *BEFORE["predicted"])
    core.engine.error = (int(ErrorCode.NOT_FINITE), 0)
    core.engine.innovation_overflow = True
    assert start(core, Step.UPDATE) == (ErrorCode.NOT_FINITE, 0)
    assert "GATED" not in flags(core)
    highest = number_format.infinity - 1
    core.write(GATE_LOW.offset, highest & 0xFFFF_FFFF)
    core.write(GATE_HIGH.offset, highest >> 32)
    core.write(INTERRUPT_PENDING.offset, 0b11)
    assert start(core, Step.UPDATE) == (0, 0)
    assert flags(core) == {"INITIALISED": 1, "RESIDUALS": 1, "GATED": 1}
    assert read(core, NIS_LOW) | read(core, NIS_HIGH) << 32 == number_format.infinity
    assert read(core, INTERRUPT_PENDING) == 0b01


def test_gated_is_cleared_by_the_next_update_even_if_it_fails(core):
    follow(core, *BEFORE["predicted"])
    core.write(GATE_LOW.offset, 0)
    core.engine.nis = 1
    follow(core, Step.UPDATE)
    assert "GATED" in flags(core)
    core.engine.error = (int(ErrorCode.NOT_FINITE), 0)
    start(core, Step.UPDATE)
    assert "GATED" not in flags(core)
    assert read(core, NIS_LOW) == 1


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("strobe", [0b0001, 0b1111, 0])
def test_writes_to_the_estimate_outdate_what_was_made_of_it(core, before, strobe):
    memory_map = MemoryMap(SMALL)
    address = memory_map.address
    follow(core, *BEFORE[before])
    as_before = flags(core)
    for symbol in ("X", "W", "V", "Z", "z", "P", "LQ", "LR"):
        for column in range(memory_map[symbol].columns):
            core.write(address(symbol, 0, column), 0)
    assert flags(core) == as_before
    core.write(address("x", 0, 1), 0, strobe)
    assert flags(core) == (as_before if strobe == 0 else {"INITIALISED": 1})
    assert (Flag.PREDICTED in core.flags) == (before == "predicted")
    core.write(address("L", 1, 0), 0, strobe)
    assert flags(core) == (as_before if strobe == 0 else {"INITIALISED": 1})
    assert (Flag.PREDICTED in core.flags) == (before == "predicted" and strobe == 0)


# Interrupts.


def test_interrupts_are_pending_events_that_are_enabled(core):
    follow(core, Step.INIT)
    assert not core.irq
    core.write(INTERRUPT_ENABLE.offset, INTERRUPT_ENABLE["ERROR"].mask)
    assert not core.irq
    start(core, Step.PREDICT)
    assert core.irq
    core.write(INTERRUPT_PENDING.offset, 0b11, 0b1110)
    assert read(core, INTERRUPT_PENDING) == 0b11
    core.write(INTERRUPT_PENDING.offset, INTERRUPT_PENDING["ERROR"].mask)
    assert read(core, INTERRUPT_PENDING) == INTERRUPT_PENDING["DONE"].mask
    assert not core.irq
    core.write(INTERRUPT_ENABLE.offset, 0b11)
    assert core.irq


# While a step runs.


def test_a_running_step_refuses_the_buffer_and_other_starts(core):
    x = MemoryMap(SMALL).address("x", 0, 0)
    follow(core, Step.INIT)
    core.write(x, 5)
    core.hold = True
    follow(core, Step.SIG_GEN)
    assert STATUS["STATE"].get(read(core, STATUS)) == Step.SIG_GEN
    assert Step.SIG_GEN not in done(core)
    assert core.read(x) == (0, False)
    assert core.write(x, 7) is False
    assert core.write_many(np.array([x]), np.array([7], np.uint32)) == 0
    assert start(core, Step.SIG_GEN) == ILLEGAL
    core.write(CONTROL.offset, 0)  # not enabled: the step goes on
    core.finish()
    assert error(core) == ILLEGAL  # stays readable
    assert flags(core) == {"INITIALISED": 1, "POINTS": 1}
    assert core.read(x) == (5, True)


def test_an_error_of_the_step_replaces_an_illegal_start(core):
    core.hold = True
    follow(core, Step.INIT)
    assert start(core, Step.INIT) == ILLEGAL
    core.engine.error = (int(ErrorCode.NOT_FINITE), 3)
    core.finish()
    assert error(core) == core.engine.error


@pytest.mark.parametrize("running", [False, True])
def test_reset(core, running):
    follow(core, *BEFORE["predicted"])
    core.engine.nis = 44
    follow(core, Step.UPDATE)
    core.write(GATE_LOW.offset, 1234)
    core.write(MASK.offset, 1)
    core.write(INTERRUPT_ENABLE.offset, 1)
    banks = core.state_bank, core.factor_bank
    if running:
        core.hold = True
        follow(core, Step.PREDICT)
        core.advance(10)
        core.advance(5)
        assert read(core, CYCLES) == 15
    start(core, Step.COVARIANCE)
    core.write(CONTROL.offset, ENABLE | RESET | START[Step.INIT])  # RESET wins
    if running:
        assert core.engine.ran[-1] == (Program.PREDICT, 1, *banks, 15)
    assert (read(core, STATUS), error(core), read(core, CYCLES)) == (0, (0, 0), 0)
    assert Flag.PREDICTED not in core.flags
    kept = (CONTROL, MASK, GATE_LOW, NIS_LOW, INTERRUPT_ENABLE)
    assert [read(core, register) for register in kept] == [ENABLE, 1, 1234, 44, 1]
    assert read(core, INTERRUPT_PENDING)
    assert (core.state_bank, core.factor_bank) == banks
    assert core.engine.ran[-1][0] is not Program.INIT
    core.write(CONTROL.offset, RESET)
    assert read(core, CONTROL) == 0


def test_no_step_to_finish_or_to_advance(core):
    for method in (core.finish, lambda: core.advance(1)):
        with pytest.raises(RuntimeError, match=r"^A step must run, not STATUS\.STATE = IDLE$"):
            method()


# The buffer.


def elements(params):
    """Bus words of all regions: symbol, row, column, and word within the element."""
    return [
        (region.symbol, row, column, word)
        for region in MemoryMap(params)
        for row in range(region.rows)
        for column in range(region.columns)
        for word in range(params.format.bus_words)
    ]


@pytest.mark.parametrize("number_format", FORMATS)
@pytest.mark.parametrize("noise", Noise)
@pytest.mark.parametrize("W0", EVERY_W0)
def test_buffer_keeps_words(number_format, noise, W0):
    """Every element is on its own, and keeps any word, also through blocks of accesses.

    Without W0 there is no sigma point 0: there column 0 of X is x, that of others is zero.
    """
    params = UkfParams(
        n=2, m=2, q=2, r=2, pes=3, format=number_format, process_noise=noise,
        observation_noise=noise, W0=W0,
    )  # fmt: skip
    memory_map = MemoryMap(params)
    rng = np.random.default_rng(1)
    places = elements(params)
    addresses = np.array(
        [memory_map.address(symbol, row, column) + 4 * word for symbol, row, column, word in places]
    )
    numbers = {place: i for i, place in enumerate(places)}

    def shown(words):
        """What is read after all are written."""
        read = (words & width).tolist()
        for i, (symbol, row, column, word) in enumerate(places):
            if not W0 and column == 0 and symbol in ("X", "W", "V", "Z"):
                read[i] = read[numbers["x", 0, row, word]] if symbol == "X" else 0
        return np.array(read, dtype=np.uint32)

    width = np.uint32(0xFFFF_FFFF >> max(32 - number_format.width, 0))
    raw = rng.integers(0, 1 << 32, len(addresses), dtype=np.uint32)
    raw[rng.random(len(raw)) < 0.3] = rng.choice([0, 1, 0x7FC0_0001, 0xFFFF_FFFF, 0x8000_0000])
    ordinary = WordCodec(number_format).to_words(
        rng.standard_normal(len(addresses) // number_format.bus_words)
    )
    for words, one_by_one in itertools.product((raw, ordinary), (False, True)):
        core = GoldenCore(params)
        core.banks = Bank.STATE
        order = rng.permutation(len(addresses)) if one_by_one else np.arange(len(addresses))
        if one_by_one:
            for i in order:
                assert core.write(int(addresses[i]), int(words[i]))
        else:
            assert core.write_many(addresses, words) == len(addresses)
        expected = shown(words)
        np.testing.assert_array_equal(core.read_many(addresses), expected)
        singly = [core.read(int(address)) for address in addresses]
        assert singly == [(int(word), True) for word in expected]
        np.testing.assert_array_equal(core.read_many(addresses[::-1]), expected[::-1])


@pytest.mark.parametrize("number_format", [BINARY16, BINARY32, BINARY64])
@pytest.mark.parametrize("strobe", range(16))
def test_byte_strobes_of_the_buffer(number_format, strobe):
    params = UkfParams(n=1, m=1, format=number_format)
    core = GoldenCore(params)
    first = MemoryMap(params).address("Z", 0, 1)
    width = min(number_format.width, 32)
    bits = sum(0xFF << 8 * i for i in range(4) if strobe >> i & 1) & (1 << width) - 1
    for address in range(first, first + 4 * number_format.bus_words, 4):
        core.write(address, 0x11223344)
    for address in range(first, first + 4 * number_format.bus_words, 4):
        core.write(address, 0xAABBCCDD, strobe)
        expected = (0x11223344 & ~bits | 0xAABBCCDD & bits) & (1 << width) - 1
        assert core.read(address) == (expected, True)


def test_blocks_stop_at_the_first_refused_access():
    core = GoldenCore(SMALL)
    x = MemoryMap(SMALL).address("x", 0, 0)
    unmapped = x + 4 * SMALL.n
    bus = GoldenBus(core)
    addresses = np.array([x, unmapped, x + 4])
    with pytest.raises(BusError, match=rf"^The core refused the write at address {unmapped:#x}$"):
        bus.write_many(addresses, np.array([1 << 30, 1 << 30, 1 << 30], dtype=np.uint32))
    assert [core.read(x), core.read(x + 4)] == [(1 << 30, True), (0, True)]
    with pytest.raises(BusError, match=rf"^The core refused the read at address {unmapped:#x}$"):
        bus.read_many(addresses)
    with pytest.raises(BusError) as caught:
        bus.read(unmapped)
    assert (caught.value.address, caught.value.access) == (unmapped, "read")
    with pytest.raises(BusError):
        bus.write(unmapped, 0)


def test_halves_of_different_elements_stay_apart():
    params = UkfParams(n=2, m=1, format=BINARY64)
    core = GoldenCore(params)
    first, second = (MemoryMap(params).address("x", 0, i) for i in range(2))
    addresses = np.array([first, second + 4])
    core.write_many(addresses, np.array([0, 0x3FF0_0000], dtype=np.uint32))
    singly = [core.read(int(a))[0] for a in (first, first + 4, second, second + 4)]
    assert singly == [0, 0, 0, 0x3FF0_0000]


def test_block_writes_follow_the_flags(core):
    memory_map = MemoryMap(SMALL)
    for symbol, predicted in (("Z", True), ("x", True), ("L", False)):
        follow(core, Step.INIT, Step.SIG_GEN, Step.PREDICT)
        core.write_many(
            np.array([memory_map.address("Z", 0, 0), memory_map.address(symbol, 0, 0)]),
            np.array([1 << 30, 1 << 30], dtype=np.uint32),
        )
        kept = (Flag.RESIDUALS in core.flags, Flag.PREDICTED in core.flags)
        assert kept == (symbol == "Z", predicted)


# With the real engine.


def test_a_dropped_step_leaves_the_estimate_and_can_be_repeated():
    params = UkfParams(n=2, m=1, q=1, r=1, pes=2)
    x, P = np.array([1.0, -2.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
    results = []
    for dropped in (None, 0, 1, 40, 200):
        core = GoldenCore(params, Pipeline())
        driver = Driver(GoldenBus(core), params)
        driver.initialise(x, P, np.eye(1), np.eye(1))
        points = driver.sigma_points()
        if dropped is not None:
            core.hold = True
            core.write(CONTROL.offset, ENABLE | START[Step.PREDICT])
            core.advance(dropped)
            driver.reset()
            core.hold = False
            np.testing.assert_array_equal(driver.state(), x)
            np.testing.assert_allclose(driver.covariance(), P, atol=1e-6)
            np.testing.assert_array_equal(driver.sigma_points(), points)
        driver.predict(points)
        driver.update(points[:1], np.array([0.5]), np.array([True]))
        results.append((driver.state().tolist(), driver.covariance().tolist()))
    assert all(result == results[0] for result in results)


@pytest.mark.parametrize("number_format", [BINARY16, BINARY32, BINARY64])
@pytest.mark.parametrize("noise", Noise)
@pytest.mark.parametrize("W0", EVERY_W0)
def test_column_0_of_sigma_points(number_format, noise, W0):
    """Without W0 X shows x there, whichever bank it is in; the others show zero, writes do nothing.

    With W0 there is a sigma point 0, which is stored as all others.
    """
    params = UkfParams(
        n=2, m=2, q=2, r=2, pes=2, format=number_format, process_noise=noise,
        observation_noise=noise, W0=W0,
    )  # fmt: skip
    core = GoldenCore(params)
    memory_map, codec = MemoryMap(params), WordCodec(number_format)
    size, banks = number_format.bus_words, set()
    driver = Driver(GoldenBus(core), params)
    driver.initialise(np.array([1.5, -2.0]), np.eye(2), np.eye(2) * 0.25, np.eye(2))

    def words_of(symbol, column=0):
        return np.array([
            memory_map.address(symbol, row, column) + 4 * word
            for row in range(memory_map[symbol].rows) for word in range(size)
        ])  # fmt: skip

    x = np.array([memory_map.address("x", 0, i) + 4 * k for i in range(2) for k in range(size)])
    columns = {symbol: words_of(symbol) for symbol in "XWVZ" if symbol in memory_map}
    addresses = np.concatenate([*columns.values()])
    assert len(columns) == (2 if noise is Noise.ADDITIVE else 4)

    def look():
        """Check what the columns show."""
        banks.add(Bank.STATE in core.banks)
        for symbol, column in columns.items():
            read = core.read_many(column)
            assert [core.read(int(a)) for a in column] == [(int(word), True) for word in read]
            if not W0:
                expected = core.read_many(x) if symbol == "X" else np.zeros(2 * size)
                np.testing.assert_array_equal(read, expected)

    def write():
        """Write to the columns, word by word and at once; gives whether nothing has changed."""
        before, seen = core.engine.memory.copy(), driver.state()
        flags, written = core.flags, codec.to_words(np.full(len(addresses) // size, 7.0))
        for address, word in zip(addresses.tolist(), written.tolist(), strict=True):
            assert core.write(address, word)
        singly = core.engine.memory.copy()
        core.engine.memory[:] = before
        assert core.write_many(addresses, written) == len(addresses)
        np.testing.assert_array_equal(core.engine.memory, singly)
        assert core.flags == flags
        np.testing.assert_array_equal(codec.from_words(core.read_many(x)), seen)
        if W0:
            np.testing.assert_array_equal(core.read_many(addresses), written)
        unchanged = np.array_equal(core.engine.memory, before)
        core.engine.memory[:] = before
        return unchanged

    rng = np.random.default_rng(1)
    for _ in range(2):
        points = driver.sigma_points()
        look()
        assert write() is (W0 == 0.0)
        driver.predict(points + np.array([[0.5], [1.0]]))
        look()
        assert write() is (W0 == 0.0)
        look()
        observed = rng.standard_normal((2, len(params.points)))
        driver.update(observed, np.array([1.0, 2.0]), np.array([True, True]))
        look()
        assert write() is (W0 == 0.0)
        driver.set_state(rng.standard_normal(2))
        look()
        # Mixed with other columns, which are written.
        mixed = np.concatenate((addresses, words_of("Z", 1), addresses[::-1]))
        words = codec.to_words(rng.standard_normal(len(mixed) // size))
        assert core.write_many(mixed, words) == len(mixed)
        kept = slice(len(addresses), len(addresses) + 2 * size)
        np.testing.assert_array_equal(core.read_many(mixed)[kept], words[kept])
        look()
    assert banks == {False, True}


def test_words_are_those_of_the_bus():
    core = GoldenCore(SMALL)
    address = MemoryMap(SMALL).address("Z", 0, 3)
    for word in (0x7FC1_2345, 0x0000_0001, 0x3F80_0000):
        core.write(address, word)
        lane, within = core.engine.layout.buffer_location("Z", 0, 3)
        assert core.engine.memory[lane, within] == word
