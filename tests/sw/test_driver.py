import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from ukf_sw.backends import Backend
from ukf_sw.drivers.bus import OneCore, WordCodec
from ukf_sw.drivers.driver import Driver, Traffic
from ukf_sw.errors import (
    BusError,
    CoreError,
    CoreTimeoutError,
    IllegalStepError,
    NotFiniteError,
    NotPositiveDefiniteError,
    NotRecoveredError,
    SingularObservationError,
    StepLostError,
    UkfError,
    WrongCoreError,
)
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FORMATS
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.model_programs import Constant, CoreModels, ModelProgram
from ukf_sw.spec.parameters import Form, Noise, UkfParams
from ukf_sw.spec.registers import (
    CONTROL,
    CYCLES,
    ERROR,
    IDENTITY,
    INTERRUPT_PENDING,
    MASK,
    REGISTERS,
    STATUS,
    ErrorCode,
)
from ukf_sw.spec.sequence import Flag, Step

SMALL = UkfParams(n=2, m=2, q=1, r=2)
#: Sigma points of it that have a weight.
K = len(SMALL.points)
EVERY_W0 = [0.0, 0.5]
ADDITIVE = {"process_noise": Noise.ADDITIVE, "observation_noise": Noise.ADDITIVE}
REGISTER_SPACE = max(register.offset for register in REGISTERS) + 4


class SingleBus:
    """A bus without block accesses: notes them all, and can be told to lie or to fail."""

    def __init__(self, core):
        self.core = core
        self.bus = GoldenBus(core)
        self.lies = {}
        self.refuse = None
        self.reads, self.writes = [], []

    def read(self, address):
        self.reads.append(address)
        if address == self.refuse:
            raise BusError(address, "read")
        lie = self.lies.get(address)
        return self.bus.read(address) if lie is None else lie

    def write(self, address, word):
        if address == self.refuse:
            raise BusError(address, "write")
        self.writes.append((address, word))
        self.bus.write(address, word)


class Clock:
    """Time that passes by looking at it."""

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        self.time += 0.25
        return self.time


def start(params=SMALL, *, bus=None, core=None, **options):
    """Make a driver that has been through INIT, and what it needs."""
    core = core or GoldenCore(params)
    bus = bus or SingleBus(core)
    driver = Driver(bus, params, **options)
    n, q, r = params.n, params.q, params.r
    driver.initialise(np.arange(1.0, n + 1), np.eye(n), np.eye(q) * 0.01, np.eye(r) * 0.1)
    return driver, bus, core


def iterate(driver, z=None):
    params = driver.params
    W, V = driver.noise_points()
    points = driver.sigma_points()
    moved = points.copy()
    moved[: len(W)] += W[: params.n]
    points = driver.predict(moved)
    observed = np.resize(points, (params.m, points.shape[1])) + (V if params.r == params.m else 0.0)
    z = np.zeros(params.m) if z is None else z
    return driver.update(observed, z, np.ones(params.m, dtype=bool))


def test_is_a_backend():
    assert isinstance(start()[0], Backend)


# What core is there.


@pytest.mark.parametrize(
    ("register", "field"),
    [(register, field.name) for register in IDENTITY for field in register if field.name != "PES"],
)
def test_wrong_core_is_named(register, field):
    core = GoldenCore(SMALL)
    bus = SingleBus(core)
    word = bus.read(register.offset)
    expected = register[field].get(word)
    bus.lies[register.offset] = word ^ register[field].put(1)
    message = (
        rf"^{register.name}\.{field} of the core must be {expected:#x}, not {expected ^ 1:#x}$"
    )
    with pytest.raises(WrongCoreError, match=message) as caught:
        Driver(bus, SMALL)
    error = caught.value
    assert (error.field, error.expected, error.found) == (
        f"{register.name}.{field}", expected, expected ^ 1
    )  # fmt: skip
    assert bus.writes == []


#: Another value of every parameter that must agree.
OTHER = {
    "n": 3, "m": 3, "q": 1, "r": 1, "sensors": (1, 1), "process_noise": Noise.ADDITIVE,
    "observation_noise": Noise.ADDITIVE, "W0": 0.5 + 2**-53, "form": Form.COVARIANCE,
    "format": BFLOAT16,
    "models": CoreModels(
        f=ModelProgram(
            title="f", fmt=BINARY32, inputs=(), steps=(), outputs=(Constant(0.0), Constant(0.0))
        )
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHER)
def test_a_core_that_differs_in_any_parameter_is_refused(name):
    params = UkfParams(n=2, m=2, q=2, r=2, W0=0.5)
    with pytest.raises(WrongCoreError):
        Driver(GoldenBus(GoldenCore(params)), replace(params, **{name: OTHER[name]}))
    assert {*OTHER, "pes"} == set(vars(params))


@pytest.mark.parametrize(
    "params",
    [
        UkfParams(n=1, m=1),
        UkfParams(n=2, m=3, q=2, r=3, format=BINARY64, **ADDITIVE),
        UkfParams(n=3, m=1, q=3, r=2, format=BFLOAT16, process_noise=Noise.ADDITIVE),
        UkfParams(n=3, m=2, q=1, r=2, form=Form.COVARIANCE, observation_noise=Noise.ADDITIVE),
    ],
)
def test_right_core_is_accepted(params):
    driver, _, core = start(params)
    assert Flag.INITIALISED in core.flags
    assert driver.params == params


def test_number_of_processing_elements_is_read_and_may_differ():
    core = GoldenCore(UkfParams(n=2, m=2, q=1, r=2, pes=3))
    driver, _, _ = start(core=core)
    assert driver.pes == 3
    iterate(driver)


@pytest.mark.parametrize("timeout", [0.0, -1.0, float("nan")])
def test_wrong_timeout_is_refused(timeout):
    with pytest.raises(ValueError, match=r"^timeout must be more than 0 s, not "):
        Driver(SingleBus(GoldenCore(SMALL)), SMALL, timeout=timeout)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"timeout": "1"}, "timeout must be a number, not '1'"),
        ({"interrupt": True}, "interrupt must be callable, not True"),
        ({"clock": None}, "clock must be callable, not None"),
    ],
)
def test_options_of_the_wrong_kind_are_refused(options, message):
    with pytest.raises(TypeError, match=f"^{message}$"):
        Driver(SingleBus(GoldenCore(SMALL)), SMALL, **options)


def test_wrong_params_are_refused():
    with pytest.raises(TypeError, match=r"^params must be a UkfParams, not 3$"):
        Driver(SingleBus(GoldenCore(SMALL)), 3)


# Numbers.


@pytest.mark.parametrize("number_format", FORMATS.values(), ids=FORMATS)
def test_words_are_those_of_the_format(number_format):
    codec = WordCodec(number_format)
    rng = np.random.default_rng(2)
    tiny, huge = number_format.min_normal, number_format.max_finite
    edges = [
        0.0, -0.0, tiny, -tiny, tiny / 2, tiny * (1 - 2.0**-25), tiny * (1 - 2.0**-24),
        np.nextafter(tiny, 0.0), 1e-320, np.inf, -np.inf, np.nan, huge, -huge,
    ]  # fmt: skip
    samples = rng.standard_normal(1000)
    for values in (samples, np.array(edges), *np.array(edges)[:, None]):
        words = number_format.encode(values)
        ours = codec.to_words(values)
        if number_format is BINARY64:
            pairs = ours.reshape(-1, 2).astype(np.uint64)
            np.testing.assert_array_equal(pairs[:, 0] | pairs[:, 1] << np.uint64(32), words)
        else:
            np.testing.assert_array_equal(ours, words)
        np.testing.assert_array_equal(codec.from_words(ours), number_format.decode(words))
    raw = rng.integers(0, 1 << 32, 1000, dtype=np.uint32)
    wide = raw if number_format.bus_words == 1 else raw[::2] | raw[1::2].astype(np.uint64) << 32
    np.testing.assert_array_equal(codec.from_words(raw), number_format.decode(wide))


# Traffic.


@pytest.mark.parametrize(("W0", "limits"), [(0.0, (350, 180)), (0.5, (365, 196))])
@pytest.mark.parametrize("is_additive", [False, True])
def test_traffic_of_the_nanosatellite(is_additive, W0, limits):
    params = replace(NANOSAT_ADDITIVE if is_additive else NANOSAT, W0=W0)
    n, m, count = params.n, params.m, len(params.points)
    driver, bus, _ = start(params)
    moved, observed = np.ones((n, count)), np.ones((m, count))
    moved[:, 0] = observed[:, 0] = 2.0
    observed *= np.random.default_rng(1).standard_normal(observed.shape)
    # Points up to n + 1, those that there are, and x. Then all points, twice, and z.
    read = n * (n + 2 - params.points.start) + n
    written = (n + m) * count + m
    driver.state()  # of an estimate whose x is known it is not read again
    for _ in range(3):
        before = driver.traffic
        reads, writes = len(bus.reads), len(bus.writes)
        driver.sigma_points()
        driver.predict(moved + np.random.default_rng(1).standard_normal(moved.shape))
        driver.update(observed, np.zeros(m), np.ones(m, dtype=bool))
        driver.state()
        traffic = driver.traffic - before
        assert (traffic.words_read, traffic.words_written) == (read, written)
        assert traffic.words == read + written + traffic.starts <= limits[is_additive]
        assert len(bus.reads) - reads == traffic.words_read + traffic.control_reads
        assert len(bus.writes) - writes == (
            traffic.words_written + traffic.control_writes + traffic.starts
        )
    # Three steps: start, STATUS and ERROR of each; NIS. The mask is written only once.
    assert traffic == Traffic(
        words_read=read, words_written=written, starts=3, control_reads=7, control_writes=0
    )


@pytest.mark.parametrize("number_format", [BINARY16, BINARY32, BINARY64])
@pytest.mark.parametrize("noise", [{}, ADDITIVE])
def test_blocks_and_single_accesses_are_the_same(number_format, noise):
    params = UkfParams(n=2, m=2, q=2, r=2, format=number_format, **noise)
    outcomes = []
    for make in (SingleBus, GoldenBus):
        core = GoldenCore(params)
        driver, _, _ = start(params, bus=make(core), core=core)
        results = [iterate(driver), iterate(driver, np.array([1.0, 3.0]))]
        driver.set_noise(np.eye(2) * 0.5, np.eye(2) * 0.25)
        results.append(iterate(driver))
        outcomes.append(
            (results, driver.traffic, driver.state().tolist(), driver.covariance().tolist(),
             core.engine.memory.tolist())
        )  # fmt: skip
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("W0", EVERY_W0)
def test_only_distinct_columns_are_read(W0):
    params = replace(SMALL, W0=W0)
    driver, bus, _ = start(params)
    bus.reads.clear()
    points = driver.sigma_points()
    memory_map, n = MemoryMap(params), params.n
    drawn = [k for k in params.points if k <= n + 1]
    expected = [memory_map.address("X", i, k) for i in range(n) for k in drawn]
    if not W0:  # there is no point 0, which is x
        expected += [memory_map.address("x", 0, i) for i in range(n)]
    assert [address for address in bus.reads if address >= REGISTER_SPACE] == expected
    assert points.shape == (n, len(params.points))
    others = len(params.points) - len(drawn)
    assert others > 0
    np.testing.assert_array_equal(points[:, len(drawn) :].T, [[1.0, 2.0]] * others)


@pytest.mark.parametrize("W0", EVERY_W0)
def test_x_is_read_once(W0):
    """And again when a step may have changed it, or it has been written."""
    params = replace(SMALL, W0=W0)
    driver, bus, _ = start(params)
    x = {MemoryMap(params).address("x", 0, i) for i in range(params.n)}

    def reads_of_x(call):
        bus.reads.clear()
        call()
        count = sum(address in x for address in bus.reads)
        driver.state()
        known = bool(count) or not any(address in x for address in bus.reads)
        bus.reads.clear()
        driver.state()[:] = np.nan  # what is given is a copy
        assert not bus.reads
        return count, known

    def update(gate):
        driver.set_gate(gate)
        points = np.random.default_rng(1).normal(size=(params.m, len(params.points)))
        driver.update(points, np.full(params.m, 9.0), np.ones(params.m, dtype=bool))

    once, at_once = (params.n, True), (0, True)
    assert reads_of_x(driver.sigma_points) == (at_once if W0 else once)  # point 0 is x
    assert reads_of_x(driver.sigma_points) == at_once
    moved = driver.sigma_points() + np.arange(len(params.points))
    for call in (
        lambda: driver.predict(moved),
        lambda: update(np.inf),
        lambda: driver.set_state(np.ones(params.n)),
        lambda: driver.initialise(np.ones(params.n), np.eye(2), np.eye(1), np.eye(2)),
    ):
        assert reads_of_x(call) == (0, False)
    assert reads_of_x(driver.redraw) == at_once
    assert reads_of_x(lambda: update(0.1)) == at_once
    assert reads_of_x(lambda: driver.set_covariance(np.eye(2))) == at_once
    assert reads_of_x(lambda: driver.set_noise(np.eye(1), np.eye(2))) == at_once


def test_covariance_reads_the_lower_triangle():
    driver, bus, _ = start(UkfParams(n=4, m=1, q=0, r=1))
    P = np.eye(4) + 0.5
    driver.set_covariance(P)
    bus.reads.clear()
    np.testing.assert_allclose(driver.covariance(), P, rtol=1e-6)
    assert sum(address >= REGISTER_SPACE for address in bus.reads) == 10


def test_mask_is_written_when_it_changes():
    driver, bus, _ = start()
    points = driver.predict(driver.sigma_points() + 0.1)
    bus.writes.clear()
    for mask in ([True, False], [True, False], [False, True]):
        driver.update(points, np.zeros(2), np.array(mask))
        points = driver.sigma_points()
    assert [word for address, word in bus.writes if address == MASK.offset] == [0b01, 0b10]


# Steps.


def test_cycles_are_counted_if_asked():
    driver, _, core = start(count_cycles=True)
    iterate(driver)
    driver.covariance()
    assert set(driver.last_cycles) == {"INIT", "SIG_GEN", "PREDICT", "UPDATE", "COVARIANCE"}
    assert driver.last_cycles["COVARIANCE"] == core.read(CYCLES.offset)[0] > 0
    driver.set_state(driver.state())
    for _ in range(2):  # the second one costs nothing, and is not the last that cost something
        driver.redraw()
        assert driver.last_cycles["SIG_GEN"] > 0
    assert start()[0].last_cycles == {}


@pytest.mark.parametrize(
    ("code", "expected", "message"),
    [
        (ErrorCode.ILLEGAL_STEP, IllegalStepError, r"^PREDICT must not start"),
        (ErrorCode.NOT_FINITE, NotFiniteError, r"^PREDICT met NaN or infinity$"),
        (ErrorCode.SINGULAR_OBSERVATION, SingularObservationError, r"singular at row 3$"),
        (ErrorCode.NOT_POSITIVE_DEFINITE, NotPositiveDefiniteError, r"definite at row 3$"),
        (77, CoreError, r"^PREDICT ended with the unknown error 77, index 3$"),
    ],
)
def test_error_codes(code, expected, message):
    driver, bus, _ = start()
    points = driver.sigma_points()
    bus.lies[ERROR.offset] = ERROR["CODE"].put(code) | ERROR["INDEX"].put(3)
    with pytest.raises(expected, match=message) as caught:
        driver.predict(points)
    assert isinstance(caught.value, UkfError)
    assert caught.value.step is Step.PREDICT
    assert getattr(caught.value, "index", 3) == 3


def test_overflow_on_the_way_to_the_core_is_its_error():
    driver, _, _ = start()
    points = driver.sigma_points()
    before = driver.state()
    moved = points.copy()
    moved[1, 3] = 1e300
    with pytest.raises(NotFiniteError):
        driver.predict(moved)
    np.testing.assert_array_equal(driver.state(), before)
    np.testing.assert_array_equal(driver.sigma_points(), points)


def test_a_step_out_of_sequence_is_illegal():
    driver, _, _ = start()
    with pytest.raises(IllegalStepError):
        driver.update(np.zeros((2, K)), np.zeros(2), np.ones(2, dtype=bool))


def test_a_step_dropped_by_another_is_lost():
    driver, bus, _ = start()
    bus.lies[STATUS.offset] = STATUS["INITIALISED"].mask
    with pytest.raises(StepLostError, match=r"^SIG_GEN was dropped by a reset"):
        driver.sigma_points()


def test_polling_times_out_and_the_driver_recovers():
    driver, _, core = start(clock=Clock(), timeout=5.0)
    points = driver.sigma_points()
    core.hold = True
    with pytest.raises(CoreTimeoutError, match=r"^PREDICT did not end within 5\.0 s: it still runs"
                       r", STATUS\.STATE was PREDICT$") as caught:  # fmt: skip
        driver.predict(points + 1.0)
    assert isinstance(caught.value, TimeoutError)
    assert caught.value.timeout == 5.0
    for ask in (driver.state, driver.sigma_points, driver.redraw, driver.reset, driver.covariance,
                driver.noise_points, lambda: driver.set_gate(1.0)):  # fmt: skip
        with pytest.raises(NotRecoveredError, match=r"call recover\(\)"):
            ask()
    assert driver.recover() is None
    core.hold = False
    np.testing.assert_array_equal(driver.state(), [1.0, 2.0])
    np.testing.assert_array_equal(driver.sigma_points(), points)
    iterate(driver)


def test_initialising_needs_no_recovery():
    driver, bus, _ = start()
    bus.refuse = STATUS.offset
    with pytest.raises(BusError):
        driver.redraw()
    bus.refuse = None
    driver.initialise(np.array([3.0, 4.0]), np.eye(2), np.eye(1), np.eye(2))
    np.testing.assert_array_equal(driver.state(), [3.0, 4.0])


def test_a_clock_that_stands_still_is_not_polled_for_ever():
    driver, bus, core = start(clock=lambda: 7.0, timeout=1e-4)
    core.hold = True
    bus.reads.clear()
    with pytest.raises(CoreTimeoutError, match=r"^SIG_GEN did not end within 0\.0001 s"):
        driver.sigma_points()
    assert 1000 <= bus.reads.count(STATUS.offset) <= 100_000


def test_an_interrupt_that_stays_high_is_not_awaited_for_ever():
    core = GoldenCore(SMALL)
    driver, _, _ = start(core=core, clock=lambda: 7.0, timeout=1e-4, interrupt=lambda left: True)
    core.hold = True
    with pytest.raises(CoreTimeoutError):
        driver.sigma_points()


@pytest.mark.parametrize("polling", [False, True])
def test_a_step_that_has_ended_is_in_time_however_late_we_look(polling):
    """The process may have been asleep, and the interrupt may have been lost."""
    core = GoldenCore(SMALL)
    driver, bus, _ = start(
        core=core, clock=Clock(), timeout=1.0, interrupt=None if polling else lambda left: False
    )
    core.hold = True
    read, polls = bus.read, 0

    def end_unseen(address):
        nonlocal polls
        if address == STATUS.offset:
            polls += 1
            if core.busy and (not polling or polls == 2):
                driver._clock.time += 1000.0
                core.finish()
        return read(address)

    bus.read = end_unseen
    points = driver.sigma_points()
    assert points.shape == (2, K)
    assert Flag.POINTS in core.flags


def test_polling_waits():
    """A step that ends late, but in time."""
    core = GoldenCore(SMALL)
    clock = Clock()
    driver, bus, _ = start(core=core, clock=clock, timeout=5.0)
    driver.sigma_points()
    core.hold = True
    read = bus.read
    polls = 0

    def finish_on_the_third(address):
        nonlocal polls
        polls += address == STATUS.offset
        if polls == 3 and core.busy:
            core.finish()
        return read(address)

    bus.read = finish_on_the_third
    driver.predict(np.ones((2, K)))
    assert polls == 3


def test_points_overwritten_in_part_are_drawn_again():
    driver, bus, core = start()
    points = driver.sigma_points()
    bus.refuse = MemoryMap(SMALL).address("X", 1, 2)
    with pytest.raises(BusError) as caught:
        driver.predict(points + 1.0)
    assert caught.value.address == bus.refuse
    bus.refuse = None
    assert Flag.POINTS in core.flags  # so SIG_GEN alone would do nothing
    assert driver.recover() is None
    np.testing.assert_array_equal(driver.sigma_points(), points)
    np.testing.assert_array_equal(driver.state(), [1.0, 2.0])


@pytest.mark.parametrize("refused", [CONTROL, STATUS, ERROR])
def test_refused_register_accesses_are_passed_on(refused):
    driver, bus, _ = start()
    bus.refuse = refused.offset
    with pytest.raises(BusError, match=rf"at address {refused.offset:#x}$"):
        driver.sigma_points()


# Interrupts.


def test_interrupts_are_awaited_and_cleared():
    core = GoldenCore(SMALL)
    waits = []

    def interrupt(timeout):
        waits.append(timeout)
        return core.irq

    driver, bus, _ = start(core=core, interrupt=interrupt, timeout=2.0)
    count = len(waits)
    polled, _, _ = start()
    bus.reads.clear()
    assert iterate(driver) == iterate(polled)
    assert len(waits) - count == 3
    assert bus.reads.count(STATUS.offset) == 3
    assert all(0.0 < wait <= 2.0 for wait in waits)
    assert not core.irq
    assert core.read(INTERRUPT_PENDING.offset) == (0, True)


def test_a_missing_interrupt_is_waited_for_once_and_no_error():
    waits = []
    driver, _, core = start(interrupt=waits.append, timeout=2.0)
    assert len(waits) == 1
    core.hold = True
    with pytest.raises(CoreTimeoutError, match=r"^SIG_GEN did not end within 2\.0 s: it still "
                       r"runs, STATUS\.STATE was SIG_GEN$"):  # fmt: skip
        driver.redraw()


def test_a_spurious_interrupt_is_not_the_end():
    core = GoldenCore(SMALL)
    driver, _, _ = start(core=core, interrupt=lambda timeout: core.irq)
    answers = iter([True, True, None])

    def interrupt(timeout):
        if next(answers) is None:
            core.finish()
        return True

    driver._interrupt = interrupt
    core.hold = True
    driver.sigma_points()
    assert Flag.POINTS in core.flags


def test_events_from_before_the_driver_are_cleared():
    core = GoldenCore(SMALL)
    core.write(CONTROL.offset, CONTROL["ENABLE"].mask | CONTROL["PREDICT"].mask)
    assert core.read(INTERRUPT_PENDING.offset) == (INTERRUPT_PENDING["ERROR"].mask, True)
    Driver(SingleBus(core), SMALL, interrupt=lambda timeout: core.irq)
    assert core.read(INTERRUPT_PENDING.offset) == (0, True)


def test_a_beginning_that_the_core_refuses():
    """In doubt, as x and P have been written; recovering gives up Q and R."""
    noise = np.eye(1), np.eye(2)
    driver = Driver(GoldenBus(GoldenCore(SMALL)), SMALL)
    driver.initialise(np.zeros(2), np.eye(2), *noise)
    kept = driver.noise_points()
    for beginning in (driver.recover, lambda: driver.initialise(np.zeros(2), np.eye(2), *noise)):
        with pytest.raises(NotFiniteError, match=r"^INIT met NaN or infinity$"):
            driver.initialise(np.ones(2), 4.0 * np.eye(2), 1e77 * np.eye(1), noise[1])
        with pytest.raises(NotRecoveredError):
            driver.state()
        if beginning == driver.recover:
            with pytest.raises(NotFiniteError, match=r"^INIT met NaN or infinity$"):
                beginning()
            assert (driver.state() == 1.0).all()
        beginning()
        driver.sigma_points()
        for found, expected in zip(driver.noise_points(), kept, strict=True):
            assert (found == expected).all()


def test_after_a_reset_by_another_the_driver_initialises_again():
    driver, bus, core = start()
    points = driver.sigma_points()
    core.hold = True
    read = bus.read

    def reset_while_it_runs(address):
        if address == STATUS.offset and core.busy:
            core.write(CONTROL.offset, CONTROL["ENABLE"].mask | CONTROL["RESET"].mask)
            core.hold = False
        return read(address)

    bus.read = reset_while_it_runs
    with pytest.raises(StepLostError, match=r"^PREDICT was dropped"):
        driver.predict(points + 1.0)
    driver.recover()
    np.testing.assert_array_equal(driver.sigma_points(), points)


def test_polling_leaves_interrupts_off():
    _, _, core = start()
    assert not core.irq


# State.


@pytest.mark.parametrize("W0", EVERY_W0)
def test_noise_points_are_read_once_written(W0):
    params = UkfParams(n=2, m=1, q=2, r=1, W0=W0, observation_noise=Noise.ADDITIVE)
    driver, _, _ = start(params)
    W, V = driver.noise_points()
    assert W.shape == (2, len(params.points))
    assert V.shape == (1, len(params.points))
    assert not V.any()
    np.testing.assert_allclose(params.W1 * W @ W.T, np.eye(2) * 0.01, rtol=1e-6, atol=1e-9)
    driver.set_noise(np.array([[1.0, 0.5], [0.5, 2.0]]), np.eye(1))
    W, _ = driver.noise_points()
    np.testing.assert_allclose(params.W1 * W @ W.T, [[1.0, 0.5], [0.5, 2.0]], rtol=1e-6)


def test_noise_may_change_between_predict_and_update():
    driver, _, _ = start()
    driver.predict(driver.sigma_points() * 2.0)
    x, P = driver.state(), driver.covariance()
    driver.set_noise(np.eye(1), np.eye(2))
    np.testing.assert_array_equal(driver.state(), x)
    np.testing.assert_allclose(driver.covariance(), P, rtol=1e-6)


def test_set_state_keeps_a_predicted_covariance():
    driver, _, _ = start()
    driver.predict(driver.sigma_points() * 2.0)
    P = driver.covariance()
    driver.set_state(np.array([5.0, 6.0]))
    points = driver.sigma_points()
    np.testing.assert_array_equal(driver.state(), [5.0, 6.0])
    np.testing.assert_allclose(points.mean(axis=1), [5.0, 6.0], rtol=1e-6)
    np.testing.assert_allclose(driver.covariance(), P, rtol=1e-6)


def test_status_has_every_field():
    driver, _, _ = start()
    status = driver.status()
    assert set(status) == {f"{r.name}.{f.name}" for r in (STATUS, ERROR) for f in r}
    assert status["STATUS.INITIALISED"] == 1


def test_reset_in_a_prediction_goes_back_to_before_it():
    """The core forgets the covariance of the prediction, so x is that of its factor again."""
    driver, _, _ = start()
    x, P = driver.state(), driver.covariance()
    driver.predict(driver.sigma_points() * 2.0 + 1.0)
    driver.reset()
    np.testing.assert_array_equal(driver.state(), x)
    np.testing.assert_array_equal(driver.covariance(), P)
    assert not driver.undo_predict()


def test_a_predict_without_having_read_the_points_can_be_undone():
    driver, _, _ = start()
    driver.redraw()
    before = driver.traffic
    driver.predict(np.ones((2, K)))
    assert (driver.traffic - before).words_read == 2  # x
    assert driver.undo_predict()
    np.testing.assert_array_equal(driver.state(), [1.0, 2.0])


def test_a_driver_of_a_device_cannot_be_copied():
    class Device(OneCore, SingleBus):
        pass

    driver, _, _ = start(bus=Device(GoldenCore(SMALL)))
    for take in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match=r"^A filter or driver whose core is behind a Device "):
            take(driver)


def test_a_predict_that_has_failed_unseen_has_not_happened():
    driver, bus, _ = start()
    points = driver.sigma_points()
    bus.refuse = ERROR.offset
    with pytest.raises(BusError):
        driver.predict(points * 1e300)
    bus.refuse = None
    assert driver.recover() is None
    assert not driver.undo_predict()
    np.testing.assert_array_equal(driver.sigma_points(), points)


@pytest.mark.parametrize("make_bus", [GoldenBus, SingleBus])
def test_a_shallow_copy_has_a_core_of_its_own(make_bus):
    driver, _, core = start(bus=make_bus(GoldenCore(SMALL)))
    twin = copy.copy(driver)
    twin.set_state(np.array([7.0, 8.0]))
    np.testing.assert_array_equal(driver.state(), [1.0, 2.0])
    np.testing.assert_array_equal(twin.state(), [7.0, 8.0])
    assert not np.shares_memory(copy.copy(core).engine.memory, core.engine.memory)


def test_a_z_beyond_the_format_stays_without_a_finite_gate():
    driver, _, _ = start()
    points = driver.sigma_points()
    for gate in (None, np.inf):
        if gate is not None:
            driver.set_gate(gate)
        driver.redraw()
        with pytest.raises(NotFiniteError, match=r"z is -1e\+39 in row 0"):
            driver.update(points, np.array([-1e39, 0.0]), np.array([True, True]))
    driver.set_gate(1e39)
    driver.redraw()
    assert driver.update(points, np.array([-1e39, 0.0]), np.array([True, True]))[1]
    driver.redraw()
    with pytest.raises(NotFiniteError, match=r"z is inf in row 0"):
        driver.update(points, np.array([np.inf, 0.0]), np.array([True, True]))


@pytest.mark.parametrize("W0", [0.0, 0.5])
def test_points_of_another_shape_are_refused_before_the_core_is_asked(W0):
    """With W0 = 0 there is no point 0, which software may not know yet."""
    params = replace(NANOSAT, W0=W0)
    driver, _, _ = start(params)
    driver.sigma_points()
    n, m, count = params.n, params.m, len(params.points)
    before = driver.traffic
    for columns in (count - 1, count + 1):
        message = rf"^points must have the shape \(7, {count}\), not \(7, {columns}\)$"
        with pytest.raises(ValueError, match=message):
            driver.predict(np.ones((n, columns)))
        message = rf"^points must have the shape \(6, {count}\), not \(6, {columns}\)$"
        with pytest.raises(ValueError, match=message):
            driver.update(np.ones((m, columns)), np.ones(m), np.ones(m, dtype=np.bool_))
    assert driver.traffic == before
