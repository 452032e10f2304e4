"""After any error in a step of models on the core, filters in C and in Python are as before, or as
after, or refuse until they have recovered.

Each function is broken off at every access to the core, and at every step. What is left is
compared, to the last bit, with filters that have not called it, and that have.
"""

from dataclasses import dataclass
from functools import cache
from itertools import count

import numpy as np
import pytest

from support.c_binding import CFilter, CFilterError, Result, compile_library, describe_core
from support.rover import AIMED, BAD_U, SENSORS, TURNED, placed_rover, rover, rover_on_c
from support.step_bus import Clock, StepBus, finish_when_given_up
from ukf_sim.c_in_the_loop.compiler import Toolchain
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import (
    BusError,
    CoreTimeoutError,
    EstimateLostError,
    NotRecoveredError,
    StepError,
    StepLostError,
)
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise

pytestmark = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")

U, U1, U2 = (np.array(u) for u in ([0.25, 0.5], [0.3, 0.1], [0.2, 0.4]))
#: z of the first sensor; the second one is beyond the gate.
AIM, FAR = [3.5, 0.1], [3.5, 90.0]
WIDE = {"noise": Noise.ADDITIVE, "W0": 0.25, "form": Form.COVARIANCE, "format": BINARY64}


def _undo(ukf, _):
    ukf.undo_predict()


def _recover(ukf, _):
    ukf.recover()


class SingleWords:
    """A bus without transfers of many words, so that each word may be broken off."""

    def __init__(self, bus):
        self.bus = bus

    def read(self, address):
        return self.bus.read(address)

    def write(self, address, word):
        self.bus.write(address, word)


def call(ukf, method, *arguments, sensor=None, **keywords):
    """Call a filter in C or in Python; the number of a sensor becomes what it is called there."""
    if sensor is not None:
        keywords["sensor"] = sensor if isinstance(ukf, CFilter) else SENSORS[sensor]
    return getattr(ukf, method)(*arguments, **keywords)


@dataclass(frozen=True)
class Case:
    """Language and kind of filter, what is on the core, whether the last step that it has done is a
    predict, and whether x has been read since.
    """

    language: str
    which: str
    redraw: bool = False
    predicted: bool = False
    known: bool = False
    wide: bool = False

    def arguments(self, given):
        """Arguments of h: in software those in C cannot change."""
        return AIMED if self.which == "f" else given

    def start(self, libraries, *, interrupt=False):
        """Make a filter that has done this and that; gives also its bus."""
        problem = rover(redraw=self.redraw, **(WIDE if self.wide else {}))
        placed, params = placed_rover(problem, self.which)
        bus = StepBus(params)
        waits = bus.wait_for_interrupt if interrupt else None
        if self.language == "C":
            ukf = rover_on_c(
                libraries(params), bus, problem, placed, params, clock=Clock(), timeout_us=10_000,
                interrupt=waits,
            )  # fmt: skip
            ukf.start(problem.x0, problem.P0, problem.Q, problem.R)
            ukf.set_gate(50.0)
        else:
            driver = Driver(SingleWords(bus), params, clock=Clock(), timeout=0.01, interrupt=waits)
            ukf = UnscentedKalmanFilter(problem, driver)
            ukf.gate = 50.0
        ukf.predict(U)
        call(ukf, "update", [2.5, 0.2], sensor=0, **AIMED)
        if self.predicted:
            ukf.predict(U1)
        if self.known:
            assert np.isfinite(ukf.x).all()
        return ukf, bus

    def __str__(self):
        said = (
            self.language, self.which, "redrawing" * self.redraw, "predicted" * self.predicted,
            "known" * self.known, "binary64" * self.wide,
        )  # fmt: skip
        return "-".join(filter(None, said))


#: What is done, by name: a function of filter and case.
OPERATIONS = {
    "predict": lambda ukf, case: ukf.predict(U2),
    "update": lambda ukf, case: call(ukf, "update", AIM, sensor=0, **case.arguments(TURNED)),
    "rejected update": lambda ukf, case: call(
        ukf, "update", FAR, sensor=0, **case.arguments(TURNED)
    ),
    "iterate": lambda ukf, case: call(ukf, "iterate", U2, AIM, sensor=0, **case.arguments(TURNED)),
    "rejected iterate": lambda ukf, case: call(
        ukf, "iterate", U2, FAR, sensor=0, **case.arguments(TURNED)
    ),
    "predict with a bad f": lambda ukf, case: ukf.predict(BAD_U),
    "iterate with a bad f": lambda ukf, case: call(
        ukf, "iterate", BAD_U, AIM, sensor=0, **case.arguments(TURNED)
    ),
    "update with a bad h": lambda ukf, case: call(
        ukf, "update", AIM, sensor=0, mode="far", scale=-1.0
    ),
    "iterate with a bad h": lambda ukf, case: call(
        ukf, "iterate", U2, AIM, sensor=0, mode="far", scale=-1.0
    ),
}


def there(name, which):
    """Whether the model that is bad is on the core."""
    return not (("bad f" in name and which == "h") or ("bad h" in name and which == "f"))


def attempt(operate, *arguments):
    """Do something; gives the result, as C names it."""
    try:
        operate(*arguments)
    except CFilterError as error:
        return error.result
    except NotRecoveredError:
        return Result.NOT_RECOVERED
    except EstimateLostError:
        return Result.ESTIMATE_LOST
    except BusError:
        return Result.BUS_ERROR
    except CoreTimeoutError:
        return Result.TIMEOUT
    except StepLostError:
        return Result.STEP_LOST
    except StepError as error:
        return Result(error.error_code)
    return Result.OK


def is_doubtful(ukf):
    return ukf.doubtful if isinstance(ukf, CFilter) else ukf._certainty.doubtful


def estimate(ukf, bus):
    """Give x, and check that it is what the core has, whether or not it has been read just now."""
    params, regions = ukf.params, MemoryMap(ukf.params)
    held = [
        sum(bus.core.read(regions.address("x", 0, i) + 4 * word)[0] << 32 * word
            for word in range(params.format.bus_words))
        for i in range(params.n)
    ]  # fmt: skip
    x = ukf.x
    assert x.tobytes() == params.format.decode(np.array(held, dtype=np.uint64)).tobytes()
    return x


def traits(ukf, bus, *, lost=False):
    """All that tells filters apart: the estimate, and what further steps make of it.

    If points that f on the core has given are lost, an update draws new ones.
    """
    seen = [estimate(ukf, bus), ukf.P]
    if lost:
        ukf.redraw()
    for z in ([2.75, 0.15], FAR):
        corrected = call(ukf, "update", z, sensor=0, **AIMED)
        seen += [[corrected, ukf.nis], estimate(ukf, bus), ukf.P]
    call(ukf, "iterate", U2, [0.25], sensor=1)
    seen += [estimate(ukf, bus), ukf.P, [ukf.nis]]
    return np.concatenate([np.ravel(each) for each in seen])


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    """Function that gives the library, compiled once, and that of a core."""
    compiled = cache(lambda params: compile_library(params, tmp_path_factory.mktemp("c")))
    described = cache(lambda params: describe_core(params, tmp_path_factory.mktemp("core")))
    usual = placed_rover(rover(), "core")[1]
    return lambda params: (compiled(usual), described(params))


@pytest.fixture(scope="module")
def allowed(libraries):
    """Function that gives traits of filters as before, and as after an operation, and in between.

    If the core has been reset in a step, the estimate is that from before a prediction that had yet
    to be factorised.
    """

    @cache
    def get(case, name, reset=False):
        ways = {"before": [], "after": [OPERATIONS[name]]}
        begins = "predict" in name or "iterate" in name
        if begins and case.predicted and not case.redraw:
            ways["redrawn"] = [lambda ukf, _: ukf.redraw()]
        if "iterate" in name:
            ways["predicted"] = [lambda ukf, _: ukf.predict(BAD_U if "bad f" in name else U2)]
        if reset and case.predicted and not case.redraw:
            ways |= {f"{way}, undone": [_undo, *calls] for way, calls in ways.items()}
        # Sigma points drawn anew, after a reset of the core, differ by a rounding error.
        ways |= {f"{way}, drawn anew": [*calls, _recover] for way, calls in ways.items()}
        found = {}
        for way, calls in ways.items():
            for lost in (False, True) if case.which == "f" else (False,):
                ukf, bus = case.start(libraries)
                for operate in calls:
                    attempt(operate, ukf, case)
                found[way + ", points lost" * lost] = traits(ukf, bus, lost=lost)
        return found

    return get


def outcome(ukf, bus, expected):
    """Tell what a filter is."""
    found = traits(ukf, bus)
    for state, each in expected.items():
        if np.array_equal(found, each, equal_nan=True):
            return state
    raise AssertionError(f"neither as before nor as after, {found} is none of {expected}")


def check_refusal(ukf, bus, case):
    """Check that a filter in doubt refuses whatever needs the core, without an access."""
    bus.break_at(None, False)
    for name, operate in OPERATIONS.items():
        if there(name, case.which):
            assert attempt(operate, ukf, case) is Result.NOT_RECOVERED, name
    assert bus.count == 0


CASES = [
    *(Case("C", which, redraw, predicted=True, known=known)
      for which in ("core", "f", "h")
      for redraw, known in ((False, False), (False, True), (True, False))),
    *(Case("C", which) for which in ("core", "f", "h")),
    Case("C", "core", wide=True),
    *(Case("Python", which, predicted=True) for which in ("core", "f", "h")),
]  # fmt: skip
TRIALS = [(case, name) for case in CASES for name in OPERATIONS if there(name, case.which)]
#: What is tried in the usual tests: with a prediction that has yet to be factorised, and without.
PREDICTED, FRESH = Case("C", "core", predicted=True), Case("C", "core")
USUAL = [(PREDICTED, "predict"), (PREDICTED, "iterate with a bad h"), (FRESH, "iterate")]
#: Steps that may fail to end: of what is not refused.
STEPS = [
    (case, name)
    for case in (PREDICTED, FRESH, *(case for case in CASES if case.language == "Python"))
    for name in ("predict", "update", "iterate", "rejected iterate")
]


def some(trials, usual):
    """Trials; those that are not usual are slow."""
    return [
        trial if trial in usual else pytest.param(*trial, marks=pytest.mark.slow)
        for trial in trials
    ]


@pytest.mark.parametrize("done", [pytest.param(False, marks=pytest.mark.slow), True])
@pytest.mark.parametrize(("case", "name"), some(TRIALS, USUAL), ids=str)
def test_every_access_may_fail(libraries, allowed, case, name, done):
    expected = allowed(case, name)
    outcomes = []
    for access in count(1):
        ukf, bus = case.start(libraries)
        bus.break_at(access, done)
        result = attempt(OPERATIONS[name], ukf, case)
        broken = bus.count >= access
        bus.break_at(None, False)
        if not broken:
            break
        assert result is Result.BUS_ERROR
        if is_doubtful(ukf):
            check_refusal(ukf, bus, case)
            ukf.recover()
        outcomes.append(outcome(ukf, bus, expected))
    assert len(outcomes) > 5


@pytest.mark.parametrize("language", ["C", "Python"])
def test_a_predict_that_broke_off_is_undone(libraries, language):
    """Wherever that was: the last access tells whether f has failed."""
    case = Case(language, "core", known=True)
    for access in count(1):
        ukf, bus = case.start(libraries)
        x = ukf.x
        bus.break_at(access, True)
        if attempt(OPERATIONS["predict"], ukf, case) is Result.OK:
            break
        bus.break_at(None, False)
        ukf.recover()
        assert np.array_equal(ukf.x, x)
    assert access > 3


@pytest.mark.parametrize("language", ["C", "Python"])
def test_there_is_nothing_to_undo_if_f_has_failed(libraries, language):
    """Also if what tells that, the last access of an iterate, is broken off."""
    case = Case(language, "core")
    ukf, bus = case.start(libraries)
    bus.break_at(None, False)
    assert attempt(OPERATIONS["iterate with a bad f"], ukf, case) is Result.MODEL_F
    last = bus.count
    ukf, bus = case.start(libraries)
    bus.break_at(last, False)
    assert attempt(OPERATIONS["iterate with a bad f"], ukf, case) is Result.BUS_ERROR
    bus.break_at(None, False)
    ukf.recover()
    with pytest.raises((CFilterError, ValueError)):
        ukf.undo_predict()


@pytest.mark.parametrize("interrupt", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("end", ["late", "never", "lost", "handled"])
@pytest.mark.parametrize(
    ("case", "name"), some(STEPS, [(PREDICTED, "update"), (FRESH, "iterate")]), ids=str
)
def test_every_step_may_fail_to_end(libraries, allowed, case, name, end, interrupt):
    """It ends after the time-out, or never, or somebody else resets the core; or it ends just when
    it is given up, and a handler of interrupts clears the event.
    """
    if case.language == "Python" and end == "handled":
        pytest.skip("the driver in Python has no such handler beside it")
    expected = allowed(case, name, end != "late")
    outcomes = []
    for step in count(1):
        ukf, bus = case.start(libraries, interrupt=interrupt)
        bus.hold(step, resets=end == "lost")
        result = attempt(OPERATIONS[name], ukf, case)
        if bus.step > 0:
            break
        if result not in (Result.TIMEOUT, Result.STEP_LOST):  # nothing to do for that step
            continue
        assert result is (Result.STEP_LOST if end == "lost" else Result.TIMEOUT)
        check_refusal(ukf, bus, case)
        bus.hold(None)
        if end == "late":
            bus.core.finish()
        if end == "handled":
            finish_when_given_up(bus)
        result = attempt(lambda ukf: ukf.recover(), ukf)
        if result is Result.OK:
            outcomes.append(outcome(ukf, bus, expected))
        else:
            # Whether a prediction has been factorised is open; nothing else can be lost.
            assert result is Result.ESTIMATE_LOST
            assert end in ("lost", "handled")
            assert (case.predicted and not case.redraw) or name != "update"
            outcomes.append("lost")
    assert outcomes
