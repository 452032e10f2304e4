"""After any error the C filter is as before, as after, or refuses until ukf_recover().

Each function is broken off at every access to the core, and at every step. What is left is
compared, to the last bit, with filters that have not called it, and that have: the estimate, the
settings, and what follows from them in further steps.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from support.breaking_bus import BreakingBus
from support.c_binding import CFilter, CFilterError, Result, compile_library
from support.step_bus import Clock, StepBus, finish_when_given_up
from ukf_sim.c_in_the_loop.compiler import Toolchain
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Noise, UkfParams
from ukf_sw.spec.registers import GATE_HIGH, GATE_LOW, INTERRUPT_ENABLE

pytestmark = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")

AUGMENTED = UkfParams(n=2, m=2, q=1, r=2)
ADDITIVE = UkfParams(
    n=2, m=2, q=2, r=2, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE
)
WIDE = UkfParams(n=2, m=2, q=2, r=2, process_noise=Noise.ADDITIVE, format=BINARY64)
#: Sigma point 0 has a weight.
WEIGHTED = UkfParams(n=2, m=2, q=1, r=2, W0=0.25)
NAMES = {AUGMENTED: "augmented", ADDITIVE: "additive", WIDE: "binary64", WEIGHTED: "W0"}
P1 = np.array([[0.7, 0.1], [0.1, 0.4]])
L1 = np.array([[0.8, 0.0], [0.1, 0.6]])


def f(x, w, u):
    return [x[0] + 0.1 * x[1] + w[0], 0.9 * x[1] - 0.1 * np.sin(x[0]) + u + 0.5 * w[-1]]


def h(x, v):
    return [np.hypot(x[0], 1.0) + v[0], x[0] * x[1] + v[1]]


@dataclass(frozen=True)
class Case:
    """Kind of filter, whether the last step that it has done is a predict, and whether x has been
    read since, so that it is known.
    """

    params: UkfParams
    redraw: bool
    predicted: bool
    known: bool = False

    def open(self, library, *, opened=True, interrupt=False):
        """Make a filter, on a bus of its own."""
        bus = StepBus(self.params)
        return CFilter(
            library, bus, self.params, f, h, redraw=self.redraw, opened=opened, clock=Clock(),
            timeout_us=10_000, interrupt=bus.wait_for_interrupt if interrupt else None,
        ), bus  # fmt: skip

    def begin(self, ukf):
        """Start a filter."""
        ukf.start([1.0, -0.5], np.eye(2), 0.1 * np.eye(self.params.q), 0.2 * np.eye(2))

    def start(self, library, **options):
        """Make a filter that has done this and that; gives also its bus."""
        ukf, bus = self.open(library, **options)
        self.begin(ukf)
        ukf.set_gate(50.0)
        ukf.predict(0.1)
        ukf.update([1.5, 0.2])
        if self.predicted:
            ukf.predict(0.3)
        if self.known:
            assert np.isfinite(ukf.x).all()
        return ukf, bus

    def __str__(self):
        kind = "redrawing" if self.redraw else "plain"
        known = "-known" * self.known
        return f"{NAMES[self.params]}-{kind}-{'predicted' * self.predicted}{known}"


USUAL = [
    Case(params, redraw, predicted)
    for params, redraw in ((AUGMENTED, False), (ADDITIVE, True))
    for predicted in (False, True)
] + [Case(AUGMENTED, False, predicted, known=True) for predicted in (False, True)]
CASES = USUAL + [
    pytest.param(Case(params, redraw, predicted, known), marks=pytest.mark.slow)
    for params, redraw, known in (
        (ADDITIVE, False, False), (ADDITIVE, True, True), (WIDE, False, False),
        (WIDE, False, True), (WIDE, True, False), (WEIGHTED, False, False),
        (WEIGHTED, False, True), (WEIGHTED, True, True),
    )
    for predicted in (False, True)
]  # fmt: skip


def noise(ukf, size):
    return np.diag([0.3, 0.4])[:size, :size]


OPERATIONS = {
    "predict": lambda ukf: ukf.predict(0.4),
    "update": lambda ukf: ukf.update([1.4, 0.1]),
    "update of one": lambda ukf: ukf.update([1.4, np.nan], np.array([True, False])),
    "rejected update": lambda ukf: ukf.update([90.0, 0.1]),
    "redraw": lambda ukf: ukf.redraw(),
    "start": lambda ukf: ukf.start([0.5, 0.6], P1, noise(ukf, ukf.params.q), noise(ukf, 2)),
    "restore": lambda ukf: ukf.restore([0.5, 0.6], L1),
    "set_state": lambda ukf: setattr(ukf, "x", [0.5, 0.6]),
    "set_covariance": lambda ukf: setattr(ukf, "P", P1),
    "set_noise": lambda ukf: ukf.set_noise(noise(ukf, ukf.params.q), noise(ukf, 2)),
    "set_gate": lambda ukf: ukf.set_gate(7.0),
    "state": lambda ukf: ukf.x,
    "covariance": lambda ukf: ukf.P,
    "save": lambda ukf: ukf.save(),
    "recover": lambda ukf: ukf.recover(),
}
BEGINNING = ("start", "restore", "recover")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Function that gives the library of a core, compiled once."""
    return cache(lambda params: compile_library(params, tmp_path_factory.mktemp("c")))


def settings(ukf, bus):
    """Words of the gate and of the factors of Q and R in the core."""
    regions = MemoryMap(ukf.params)
    places = [GATE_LOW.offset, GATE_HIGH.offset]
    for symbol in ("LQ", "LR"):
        region = regions[symbol]
        places += [
            regions.address(symbol, i, j) + 4 * word
            for i in range(region.rows)
            for j in range(region.columns)
            for word in range(ukf.params.format.bus_words)
        ]
    return [bus.core.read(place)[0] for place in places]


def estimate(ukf, bus):
    """Give x, and check that it is what the core has, whether or not it has been read just now."""
    fmt, words = ukf.params.format, range(ukf.params.format.bus_words)
    regions = MemoryMap(ukf.params)
    x = ukf.x
    held = [
        sum(bus.core.read(regions.address("x", 0, i) + 4 * word)[0] << 32 * word for word in words)
        for i in range(ukf.params.n)
    ]
    assert x.tobytes() == fmt.decode(np.array(held, dtype=np.uint64)).tobytes()
    return x


def traits(ukf, bus):
    """All that tells filters apart: estimate and settings, and what further steps make of them."""
    seen = [estimate(ukf, bus), ukf.P, settings(ukf, bus)]
    for z in ([1.45, 0.15], [60.0, 9.0]):
        seen += [[ukf.update(z), ukf.nis, ukf.gated], estimate(ukf, bus), ukf.P]
    ukf.predict(0.1)
    ukf.update([1.3, 0.2])
    return np.concatenate(
        [np.ravel(each) for each in (*seen, estimate(ukf, bus), ukf.P, [ukf.nis])]
    )


@pytest.fixture(scope="module")
def allowed(library):
    """Function that gives traits of filters as before, and as after an operation.

    If the core has been reset in a step, the estimate is that from before a prediction that had yet
    to be factorised.
    """

    @cache
    def get(case, name, reset=False):
        operate = case.begin if name == "begin" else OPERATIONS[name]
        ways = {"before": [], "after": [operate]}
        if name == "predict" and case.predicted and not case.redraw:
            # It begins with a redraw, which stays.
            ways["redrawn"] = [lambda ukf: ukf.redraw()]
        if reset and case.predicted and not case.redraw:
            undo = CFilter.undo_predict
            ways |= {f"{way}, undone": [undo, *calls] for way, calls in ways.items()}
        # Sigma points drawn anew, after a reset of the core, differ by a rounding error.
        ways |= {f"{way}, drawn anew": [*calls, CFilter.recover] for way, calls in ways.items()}
        found = {}
        for way, calls in ways.items():
            ukf, bus = case.start(library(case.params))
            for call in calls:
                call(ukf)
            found[way] = traits(ukf, bus)
        return found

    return get


def attempt(operate, ukf):
    """Do something; gives the result."""
    try:
        operate(ukf)
    except CFilterError as error:
        return error.result
    return Result.OK


def check_refusal(ukf, bus):
    """Check that a filter in doubt refuses whatever needs the core, without an access."""
    bus.break_at(None, False)
    for name, operate in OPERATIONS.items():
        if name not in BEGINNING:
            assert attempt(operate, ukf) is Result.NOT_RECOVERED
    assert attempt(lambda ukf: ukf.start([np.nan, 0.0], P1, P1, P1), ukf) is Result.BAD_ARGUMENT
    assert attempt(lambda ukf: ukf.restore([0.0, 0.0], P1 + np.inf), ukf) is Result.BAD_ARGUMENT
    assert ukf.doubtful
    assert bus.count == 0


def outcome(ukf, bus, expected):
    """Tell what a filter is."""
    found = traits(ukf, bus)
    for state, each in expected.items():
        if np.array_equal(found, each):
            return state
    raise AssertionError(f"neither as before nor as after, {found} is none of {expected}")


# Accesses.


@pytest.mark.parametrize(
    "done", [pytest.param(False, marks=pytest.mark.slow), True], ids=["refused", "done"]
)
@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_access_may_fail(library, allowed, case, name, done):
    expected = allowed(case, name)
    outcomes, doubts, access = [], 0, 0
    while True:
        access += 1
        ukf, bus = case.start(library(case.params))
        bus.break_at(access, done)
        result = attempt(OPERATIONS[name], ukf)
        if result is Result.OK:
            break
        assert result is Result.BUS_ERROR
        bus.break_at(None, False)
        if ukf.doubtful:
            doubts += 1
            check_refusal(ukf, bus)
            ukf.recover()
        outcomes.append(outcome(ukf, bus, expected))
    assert len(outcomes) >= {
        "state": 0 if case.known else case.params.n, "recover": 1, "set_gate": 1, "set_state": 2,
        "redraw": 3, "set_covariance": 4,
    }.get(name, 6)  # fmt: skip
    if name in ("state", "set_state"):
        assert doubts == (0 if name == "state" else len(outcomes))


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
@pytest.mark.parametrize(
    "name", ["predict", "update", "redraw", "start", "set_state", "set_covariance", "set_noise"]
)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_recovering_may_fail_as_well(library, allowed, case, name, done):
    """At every access of it, after functions that have been broken off here and there."""
    expected = allowed(case, name)
    broken = 0
    for access in range(1, 24):
        ukf, bus = case.start(library(case.params))
        bus.break_at(7 * access % 23 + 2, not done)
        attempt(OPERATIONS[name], ukf)
        bus.break_at(access, done)
        result = attempt(CFilter.recover, ukf)
        if result is not Result.OK:
            assert result is Result.BUS_ERROR
            broken += 1
            bus.break_at(None, False)
            if ukf.doubtful:
                ukf.recover()
        bus.break_at(None, False)
        outcome(ukf, bus, expected)
    assert broken > 0


@pytest.mark.parametrize("case", USUAL, ids=str)
def test_starting_again_where_a_new_noise_broke_off(library, case):
    """Half of it may be in the core: all rows are written, not only those that differ."""
    ukf, bus = case.start(library(case.params))
    case.begin(ukf)
    expected = traits(ukf, bus)
    access = 0
    while True:
        access += 1
        ukf, bus = case.start(library(case.params))
        bus.break_at(access, True)
        if attempt(OPERATIONS["set_noise"], ukf) is Result.OK:
            break
        bus.break_at(None, False)
        case.begin(ukf)
        assert np.array_equal(traits(ukf, bus), expected)
    assert access > 8


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
def test_opening_may_fail(library, done):
    """The filter refuses everything then, without an access, until it has been opened."""
    case = USUAL[0]
    expected = traits(*case.start(library(case.params)))
    access = 0
    while True:
        access += 1
        ukf, bus = case.open(library(case.params), opened=False)
        bus.break_at(access, done)
        result = attempt(CFilter.open, ukf)
        if result is Result.OK:
            break
        assert result is Result.BUS_ERROR
        bus.break_at(None, False)
        for operate in (*OPERATIONS.values(), CFilter.undo_predict):
            assert attempt(operate, ukf) is Result.NOT_OPEN
        assert bus.count == 0
        ukf.open()
    assert access > 7, "accesses of opening"
    bus.break_at(None, False)
    case.begin(ukf)
    ukf.set_gate(50.0)
    ukf.predict(0.1)
    ukf.update([1.5, 0.2])
    assert np.array_equal(traits(ukf, bus), expected)


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
@pytest.mark.parametrize("params", NAMES, ids=NAMES.get)
def test_the_first_start_may_fail(library, params, done):
    case = Case(params, redraw=True, predicted=False)
    ukf, bus = case.open(library(params))
    for name, operate in OPERATIONS.items():
        if name != "start":
            assert attempt(operate, ukf) is Result.NOT_STARTED
    case.begin(ukf)
    expected = traits(ukf, bus)
    access = 0
    while True:
        access += 1
        ukf, bus = case.open(library(params))
        bus.break_at(access, done)
        result = attempt(case.begin, ukf)
        if result is Result.OK:
            break
        assert result is Result.BUS_ERROR
        check_refusal_before_start(ukf, bus)
        ukf.recover()
        assert np.array_equal(traits(ukf, bus), expected)
    assert access > 15


def check_refusal_before_start(ukf, bus):
    bus.break_at(None, False)
    for name, operate in OPERATIONS.items():
        if name not in BEGINNING:
            assert attempt(operate, ukf) is Result.NOT_RECOVERED
    assert attempt(OPERATIONS["restore"], ukf) is Result.NOT_STARTED
    assert bus.count == 0


# Steps.


@pytest.mark.parametrize("interrupt", [False, True], ids=["polling", "interrupt"])
@pytest.mark.parametrize("end", ["late", "never", "lost", "handled"])
@pytest.mark.parametrize(
    "name", ["predict", "update", "redraw", "start", "set_noise", "covariance", "save"]
)
@pytest.mark.parametrize("case", USUAL, ids=str)
def test_every_step_may_fail_to_end(library, allowed, case, name, end, interrupt):
    """It ends after the time-out, or never, or somebody else resets the core; or it ends just when
    it is given up, and a handler of interrupts clears the event.
    """
    expected = allowed(case, name, end != "late")
    started = allowed(case, "start")
    outcomes, step = [], 0
    while True:
        step += 1
        ukf, bus = case.start(library(case.params), interrupt=interrupt)
        bus.hold(step, resets=end == "lost")
        result = attempt(OPERATIONS[name], ukf)
        if bus.step > 0:
            break
        if result is Result.OK:  # there was nothing to do for that step
            continue
        assert result is (Result.STEP_LOST if end == "lost" else Result.TIMEOUT)
        assert ukf.doubtful
        check_refusal(ukf, bus)
        bus.hold(None)
        if end == "late":
            bus.core.finish()
        if end == "handled":
            finish_when_given_up(bus)
        result = attempt(CFilter.recover, ukf)
        if result is Result.OK:
            outcomes.append(outcome(ukf, bus, expected))
        else:
            # Whether a prediction has been factorised is open; nothing else can be lost.
            assert result is Result.ESTIMATE_LOST
            assert (case.predicted and not case.redraw) or name == "predict"
            assert end in ("lost", "handled")
            assert attempt(CFilter.recover, ukf) is Result.ESTIMATE_LOST
            OPERATIONS["start"](ukf)
            outcomes.append(outcome(ukf, bus, started))
    assert outcomes or (name in ("redraw", "save") and end != "lost")
    if end in ("late", "never"):
        assert bus.core.read(INTERRUPT_ENABLE.offset)[0] == (0b11 if interrupt else 0)


# What is refused is certain.


@pytest.mark.parametrize("redraw", [False, True])
def test_a_predict_whose_covariance_overflows(library, redraw):
    """With redrawing it is one step, which has not been done; without, it can be undone."""
    models = {"grows": False}

    def process(x, w, u):
        values = f(x, w, u)
        return [1e30 * value for value in values] if models["grows"] else values

    bus = BreakingBus(AUGMENTED)
    ukf = CFilter(library(AUGMENTED), bus, AUGMENTED, process, h, redraw=redraw)
    case = Case(AUGMENTED, redraw=redraw, predicted=False)
    case.begin(ukf)
    ukf.predict(0.1)
    ukf.update([1.5, 0.2])
    x, P = ukf.x, ukf.P
    assert attempt(CFilter.undo_predict, ukf) is Result.BAD_ARGUMENT
    models["grows"] = True
    if redraw:
        assert attempt(lambda ukf: ukf.predict(0.1), ukf) is Result.NOT_FINITE
        assert ukf.fault["step"] == 2
    else:
        ukf.predict(0.1)
        assert attempt(lambda ukf: ukf.P, ukf) is Result.NOT_FINITE
        assert attempt(CFilter.redraw, ukf) is Result.NOT_FINITE
        ukf.undo_predict()
    assert not ukf.doubtful
    assert attempt(CFilter.undo_predict, ukf) is Result.BAD_ARGUMENT
    assert (ukf.x == x).all()
    assert (ukf.P == P).all()
    models["grows"] = False
    ukf.predict(0.1)
    ukf.update([1.5, 0.2])


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
def test_undoing_may_fail(library, done):
    case = Case(AUGMENTED, redraw=False, predicted=True)
    ukf, bus = case.start(library(AUGMENTED))
    expected = {"before": traits(ukf, bus)}
    ukf, bus = case.start(library(AUGMENTED))
    ukf.undo_predict()
    expected["after"] = traits(ukf, bus)
    outcomes, access = [], 0
    while True:
        access += 1
        ukf, bus = case.start(library(AUGMENTED))
        bus.break_at(access, done)
        result = attempt(CFilter.undo_predict, ukf)
        if result is Result.OK:
            break
        assert result is Result.BUS_ERROR
        check_refusal(ukf, bus)
        ukf.recover()
        outcomes.append(outcome(ukf, bus, expected))
    assert len(outcomes) >= 5
    assert set(outcomes) == ({"after"} if done else {"before", "after"})


def test_a_noise_that_the_core_refuses_is_not_taken(library):
    """INIT scales the factor, and overflows; also when it comes to that in ukf_recover()."""
    case = USUAL[0]
    expected = {"drawn": traits(*with_call(case, library, CFilter.redraw))}
    expected["drawn anew"] = traits(*with_call(case, library, CFilter.recover))
    huge = np.array([[1e38**2 * 9.0]]), np.eye(2)
    access = 0
    while True:
        access += 1
        ukf, bus = case.start(library(case.params))
        bus.break_at(access, access % 2 == 0)
        result = attempt(lambda ukf: ukf.set_noise(*huge), ukf)
        broken = bus.count >= access
        bus.break_at(None, False)
        if ukf.doubtful:
            assert result is Result.BUS_ERROR
            result = attempt(CFilter.recover, ukf)
        assert result is Result.NOT_FINITE
        assert not ukf.doubtful
        outcome(ukf, bus, expected)
        if not broken:
            break
    assert access > 15


def with_call(case, library, call):
    ukf, bus = case.start(library(case.params))
    call(ukf)
    return ukf, bus


def test_a_start_that_the_core_refuses(library):
    """In doubt, as x and P are in the core already; ukf_recover() gives up Q and R."""
    case = USUAL[0]
    expected = traits(*with_call(case, library, OPERATIONS["start"]))
    ukf, bus = case.start(library(case.params))
    huge = np.array([[1e38**2 * 9.0]])
    assert attempt(lambda ukf: ukf.start([0.5, 0.6], P1, huge, P1), ukf) is Result.NOT_FINITE
    check_refusal(ukf, bus)
    OPERATIONS["start"](ukf)
    # The gate is that from before.
    assert np.array_equal(traits(ukf, bus), expected)

    def start_with_noise_from_before(ukf):
        ukf.start([0.5, 0.6], P1, 0.1 * np.eye(case.params.q), 0.2 * np.eye(2))

    kept = traits(*with_call(case, library, start_with_noise_from_before))
    ukf, bus = case.start(library(case.params))
    assert attempt(lambda ukf: ukf.start([0.5, 0.6], P1, huge, P1), ukf) is Result.NOT_FINITE
    assert attempt(CFilter.recover, ukf) is Result.NOT_FINITE
    assert not ukf.doubtful
    assert np.array_equal(traits(ukf, bus), kept)
    OPERATIONS["start"](ukf)
    assert np.array_equal(traits(ukf, bus), expected)


def test_a_first_start_that_the_core_refuses(library):
    """There are no Q and R from before: it is not started."""
    case = USUAL[0]
    expected = traits(*with_call(case, library, OPERATIONS["start"]))
    huge = np.array([[1e38**2 * 9.0]])
    for gives_up in (False, True):
        ukf, bus = case.open(library(case.params))
        assert attempt(lambda ukf: ukf.start([0.5, 0.6], P1, huge, P1), ukf) is Result.NOT_FINITE
        check_refusal_before_start(ukf, bus)
        if gives_up:
            assert attempt(CFilter.recover, ukf) is Result.NOT_FINITE
            assert not ukf.doubtful
            for name, operate in OPERATIONS.items():
                if name != "start":
                    assert attempt(operate, ukf) is Result.NOT_STARTED
        OPERATIONS["start"](ukf)
        ukf.set_gate(50.0)
        assert np.array_equal(traits(ukf, bus), expected)
