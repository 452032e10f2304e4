"""After any error or interrupt, a filter is as before, as after, or refuses until recover().

Each operation of the filter is broken off at every access to the core, and at places in Python.
What is left is compared, to the last bit, with filters that have not done it, and that have: the
estimate, the settings, and what follows from them in further steps.
"""

import contextlib
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import ukf_sw
from support.breaking_bus import BreakingBus, golden_core
from support.problems import core_of
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import BusError, NotRecoveredError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden import GoldenBus
from ukf_sw.problem import Problem, Sensor
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.parameters import Noise, UkfParams

AUGMENTED = UkfParams(n=2, m=2, q=1, r=2)
ADDITIVE = UkfParams(
    n=2, m=2, q=2, r=2, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE
)
P1 = np.array([[0.7, 0.1], [0.1, 0.4]])


def f(x, w, u):
    return np.array([x[0] + 0.1 * x[1] + w[0], 0.9 * x[1] - 0.1 * np.sin(x[0]) + u + 0.5 * w[-1]])


def h(x, v):
    return np.array([np.hypot(x[0], 1.0) + v[0], x[0] * x[1] + v[1]])


@dataclass(frozen=True)
class Case:
    """Kind of filter, and whether the last thing that it has done is a predict."""

    params: UkfParams
    redraw: bool
    predicted: bool

    def start(self, bus=None):
        """Make a filter that has done this and that; without a bus on the reference."""
        backend = ReferenceUkf(self.params) if bus is None else Driver(bus, self.params)
        problem = Problem(
            name="recovery", f=f, sensors=Sensor(h, R=0.2 * np.eye(2)), x0=[1.0, -0.5],
            P0=np.eye(2), Q=0.1 * np.eye(self.params.q), redraw=self.redraw,
            **core_of(self.params),
        )  # fmt: skip
        ukf = UnscentedKalmanFilter(problem, backend)
        ukf.gate = 50.0
        ukf.predict(0.1)
        ukf.update([1.5, 0.2])
        if self.predicted:
            ukf.predict(0.3)
        return ukf

    def __str__(self):
        kind = "additive" if self.params is ADDITIVE else "augmented"
        return f"{kind}-{'redrawing' if self.redraw else 'plain'}-{'predicted' * self.predicted}"


USUAL = [
    Case(params, redraw, predicted)
    for params, redraw in ((AUGMENTED, False), (ADDITIVE, True))
    for predicted in (False, True)
]
CASES = USUAL + [
    pytest.param(Case(ADDITIVE, False, predicted), marks=pytest.mark.slow)
    for predicted in (False, True)
]


def read(name):
    def read_it(ukf):
        getattr(ukf, name)

    return read_it


def assign(name, value):
    def assign_it(ukf):
        setattr(ukf, name, value if name != "Q" else value[: ukf.params.q, : ukf.params.q])

    return assign_it


OPERATIONS = {
    "predict": lambda ukf: ukf.predict(0.4),
    "update": lambda ukf: ukf.update([1.4, 0.1]),
    "update of one": lambda ukf: ukf.update([1.4, np.nan], mask=[1, 0]),
    "rejected update": lambda ukf: ukf.update([90.0, 0.1]),
    "redraw": lambda ukf: ukf.redraw(),
    "reset": lambda ukf: ukf.reset([0.5, 0.6], P1),
    "x =": assign("x", [0.5, 0.6]),
    "P =": assign("P", P1),
    "Q =": assign("Q", np.diag([0.3, 0.4])),
    "R =": assign("R", np.diag([0.3, 0.4])),
    "gate =": assign("gate", 7.0),
    "x": read("x"),
    "P": read("P"),
    "recover": lambda ukf: ukf.recover(),
}


def traits(ukf):
    """All that tells filters apart: estimate and settings, and what further steps make of them."""
    seen = [ukf.x, ukf.P, ukf.Q, ukf.R, [ukf.gate]]
    for z in ([1.45, 0.15], [60.0, 9.0]):
        seen += [[ukf.update(z), ukf.nis, ukf.gated], ukf.x, ukf.P]
    ukf.predict(0.1)
    ukf.update([1.3, 0.2])
    return np.concatenate([np.ravel(each) for each in (*seen, ukf.x, ukf.P, [ukf.nis])])


class SingleBus(BreakingBus):
    """Hides the block accesses from the driver, so that every word counts."""

    def __getattribute__(self, name):
        if name in ("read_many", "write_many"):
            raise AttributeError(name)
        return super().__getattribute__(name)


def draw_anew(ukf):
    """Reset the core, if that does not undo a predict."""
    if ukf._backend._before is None:
        ukf.backend.reset()


@cache
def allowed(case, name, on_core):
    """Traits of filters as before, and as after an operation."""
    nothing = [lambda ukf: None]
    ways = {"before": nothing, "after": [OPERATIONS[name]]}
    if name == "predict" and case.predicted and not case.redraw:
        # It begins with a redraw, which stays.
        ways["redrawn"] = [lambda ukf: ukf.redraw()]
    if on_core:
        # Sigma points drawn anew, after a reset of the core, differ by a rounding error.
        ways |= {f"{way}, drawn anew": [*operations, draw_anew] for way, operations in ways.items()}
    found = {}
    for way, operations in ways.items():
        ukf = case.start(SingleBus(case.params) if on_core else None)
        for operate in operations:
            operate(ukf)
        found[way] = traits(ukf)
    return found


def check_refusal(ukf):
    """Check that a filter in doubt refuses whatever needs the core."""
    for name, operate in OPERATIONS.items():
        if name not in ("reset", "recover"):
            with pytest.raises(NotRecoveredError, match=r"call recover\(\)"):
                operate(ukf)


def outcome(ukf, expected):
    """Tell what a filter is."""
    found = traits(ukf)
    for state, each in expected.items():
        if np.array_equal(found, each):
            return state
    raise AssertionError(f"neither as before nor as after, {found} is none of {expected}")


# Accesses.


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_access_may_fail(case, name, done):
    expected = allowed(case, name, True)
    outcomes, doubts, access = [], 0, 0
    while True:
        access += 1
        bus = SingleBus(case.params)
        ukf = case.start(bus)
        bus.break_at(access, done)
        try:
            OPERATIONS[name](ukf)
        except BusError:
            pass
        else:
            break
        bus.break_at(None, False)
        if ukf._certainty.doubtful:
            doubts += 1
            if access % 5 == 1:
                check_refusal(ukf)
            ukf.recover()
        outcomes.append(outcome(ukf, expected))
    assert len(outcomes) >= {
        "x": 0, "recover": 1, "gate =": 1, "x =": 2, "redraw": 3, "P =": 4,
    }.get(name, 6)  # fmt: skip
    # Only to read x leaves no doubt: it has no effect.
    assert doubts == (0 if name == "x" else len(outcomes))


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
@pytest.mark.parametrize("name", ["predict", "update", "redraw", "reset", "x =", "P =", "Q ="])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_recovering_may_fail_as_well(case, name, done):
    """At every access of it, after operations that have been broken off here and there."""
    expected = allowed(case, name, True)
    broken = 0
    for access in range(1, 24):
        bus = SingleBus(case.params)
        ukf = case.start(bus)
        bus.break_at(7 * access % 23 + 2, not done)
        with contextlib.suppress(BusError):
            OPERATIONS[name](ukf)
        bus.break_at(access, done)
        try:
            ukf.recover()
        except BusError:
            assert ukf._certainty.doubtful
            broken += 1
            bus.break_at(None, False)
            ukf.recover()
        bus.break_at(None, False)
        outcome(ukf, expected)
    assert broken > 0


@pytest.mark.parametrize("name", ["Q =", "R ="])
@pytest.mark.parametrize("case", USUAL, ids=str)
def test_starting_again_where_a_new_noise_broke_off(case, name):
    """Half of it may be in the core: all rows are written, not only those that differ."""
    expected = []
    for done in (False, True):
        ukf = case.start(SingleBus(case.params))
        if done:
            OPERATIONS[name](ukf)
        ukf.reset()
        expected.append(traits(ukf))
    access, found = 0, set()
    while True:
        access += 1
        bus = SingleBus(case.params)
        ukf = case.start(bus)
        bus.break_at(access, True)
        try:
            OPERATIONS[name](ukf)
        except BusError:
            bus.break_at(None, False)
            ukf.reset()
            seen = traits(ukf)
            found.add([np.array_equal(seen, each) for each in expected].index(True))
        else:
            break
    assert 0 in found, "a filter as before, whose core had other factors"
    assert access > 8


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
def test_undoing_may_fail(done):
    case = Case(AUGMENTED, redraw=False, predicted=True)
    ukf = case.start(SingleBus(case.params))
    expected = {"before": traits(ukf)}
    ukf = case.start(SingleBus(case.params))
    ukf.undo_predict()
    expected["after"] = traits(ukf)
    outcomes = []
    for access in range(1, 6):
        bus = SingleBus(case.params)
        ukf = case.start(bus)
        bus.break_at(access, done)
        with pytest.raises(BusError):
            ukf.undo_predict()
        bus.break_at(None, False)
        ukf.recover()
        outcomes.append(outcome(ukf, expected))
    assert set(outcomes) == ({"after"} if done else {"before", "after"})


@pytest.mark.parametrize("done", [False, True], ids=["refused", "done"])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_constructor_may_fail(case, done):
    """There is no filter then, and the core takes the next one."""
    expected = traits(case.start(SingleBus(case.params)))
    for access in range(1, 60, 2):
        bus = SingleBus(case.params)
        bus.break_at(access, done)
        try:
            case.start(bus)
        except BusError:
            bus.break_at(None, False)
            assert np.array_equal(traits(case.start(bus)), expected)


# Interrupts.

SOURCES = str(Path(ukf_sw.__file__).parent)


class Interruption:
    """Raises KeyboardInterrupt at a place in the sources: the so-manieth instruction."""

    def __init__(self, place):
        self.left = place

    def __call__(self, frame, event, _):
        if not frame.f_code.co_filename.startswith(SOURCES):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            self.left -= 1
            if self.left == 0:
                raise KeyboardInterrupt
        return self


def interrupt(place, operate, ukf):
    """Do something, interrupted at a place; tells whether it came there."""
    interruption = Interruption(place)
    sys.settrace(interruption)
    try:
        operate(ukf)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(None)
    assert interruption.left > 0
    return False


def interrupt_everywhere(case, name, on_core, stride):
    """Interrupt an operation at every place, or every so-manieth; gives what became of it."""
    expected = allowed(case, name, on_core)
    outcomes = []
    place = 1
    while True:
        ukf = case.start(GoldenBus(golden_core(case.params)) if on_core else None)
        if not interrupt(place, OPERATIONS[name], ukf):
            break
        if ukf._certainty.doubtful:
            ukf.recover()
        outcomes.append(outcome(ukf, expected))
        place += stride
    return outcomes


@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.parametrize("on_core", [False, True], ids=["reference", "golden"])
@pytest.mark.parametrize("case", USUAL, ids=str)
def test_interrupts_here_and_there(case, name, on_core):
    outcomes = interrupt_everywhere(case, name, on_core, 193)
    assert len(outcomes) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.parametrize("on_core", [False, True], ids=["reference", "golden"])
@pytest.mark.parametrize("case", USUAL, ids=str)
def test_interrupts_everywhere(case, name, on_core):
    outcomes = interrupt_everywhere(case, name, on_core, 1)
    assert len(outcomes) > 20
