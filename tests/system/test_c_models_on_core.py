"""The C driver and filter with models on the core: every access is that of Python's."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from support.c_binding import CFilter, CFilterError, Result, compile_library, describe_core
from support.noting_bus import NotingBus
from support.rover import AIMED, BAD_U, SENSORS, TURNED, placed_rover, rover, rover_on_c
from ukf_sim.c_in_the_loop.compiler import Toolchain
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import BusError, StepError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden import GoldenCore
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise
from ukf_sw.spec.registers import CONTROL, ErrorCode
from ukf_sw.spec.sequence import STEPS, Step

pytestmark = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")

#: Kinds of cores: binary32 with augmented noise; all that is not so.
KINDS = {
    "augmented": {},
    "additive": {
        "noise": Noise.ADDITIVE, "W0": 0.25, "form": Form.COVARIANCE, "format": BINARY64,
    },
}  # fmt: skip
PLACES = ("core", "f", "h")
#: Those of the usual tests: kind, what is on the core, whether predict redraws.
USUAL = [("augmented", "core", False), ("augmented", "h", True), ("additive", "f", True)]
U = np.array([0.25, 0.5])


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    """Function that gives the library, compiled once, and that of a core."""
    compiled = cache(lambda params: compile_library(params, tmp_path_factory.mktemp("c")))
    described = cache(lambda params: describe_core(params, tmp_path_factory.mktemp("core")))
    usual = placed_rover(rover(), "core")[1]
    return lambda params: (compiled(usual), described(params))


def both(libraries, kind, which, *, redraw=False, interrupt=False):
    """A C filter and a Python filter, each with a golden model of its own, and their buses."""
    problem = rover(redraw=redraw, **KINDS[kind])
    placed, params = placed_rover(problem, which)
    buses = [NotingBus(GoldenCore(params)) for _ in range(2)]
    waits = [bus.bus.wait_for_interrupt if interrupt else None for bus in buses]
    c = rover_on_c(libraries(params), buses[0], problem, placed, params, interrupt=waits[0])
    driver = Driver(buses[1], params, interrupt=waits[1])
    python = UnscentedKalmanFilter(problem, driver)
    c.start(problem.x0, problem.P0, problem.Q, problem.R)
    return c, python, *buses


def outcome(ukf, method, *arguments, sensor=None, **keywords):
    """What a call gives: whether the estimate was corrected, or the core's error."""
    if sensor is not None:
        keywords["sensor"] = sensor if isinstance(ukf, CFilter) else SENSORS[sensor]
    try:
        corrected = getattr(ukf, method)(*arguments, **keywords)
    except CFilterError as error:
        return (error.result, *map(error.fault.get, ("step", "index")))
    except StepError as error:
        return error.error_code, error.step, getattr(error, "index", 0)
    return corrected, ukf.gated, ukf.nis if corrected else None


def same(c, python, *call, **keywords):
    """Do the same with both, and compare what comes of it; gives that."""
    found = outcome(c, *call, **keywords)
    assert found == outcome(python, *call, **keywords)
    python._last_x = None  # so that both read it
    assert c.x.tobytes() == python.x.tobytes()
    return found[0]


@pytest.mark.parametrize(
    ("kind", "which", "redraw"),
    [
        case if case in USUAL else pytest.param(*case, marks=pytest.mark.slow)
        for case in product(KINDS, PLACES, (False, True))
    ],
)
@pytest.mark.parametrize("interrupt", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_every_access_is_that_of_the_python_driver(libraries, kind, which, redraw, interrupt):
    """Predict, update, both; sensors, variants, masks, gates, errors, settings, recovering."""
    c, python, c_bus, python_bus = both(libraries, kind, which, redraw=redraw, interrupt=interrupt)
    draws = np.random.default_rng(5)
    f_there, h_there = which != "h", which != "f"
    gated, errors = 0, set()
    for ukf in (c, python):  # C writes all inputs of h before the first update
        ukf.predict(U)
    same(c, python, "update", [3.0, 0.0], None, sensor=0, **AIMED)
    for k in range(28):
        u = draws.uniform(0.1, 0.5, 2) if k % 3 else U
        bad = {5: "f", 17: "h", 23: "z"}.get(k % 29)
        sensor = {"h": 0, "z": 1}.get(bad, int(draws.integers(2)))
        rows = 2 - sensor
        z = 2.0 * draws.standard_normal(rows) + 1.0
        mask = draws.random(rows) < 0.8
        mask[0] = mask[0] or bad is not None
        z[~mask] = np.nan
        arguments = {} if sensor or not h_there else dict(draws.choice([AIMED, TURNED]))
        if which == "f" and not sensor:
            arguments = AIMED
        if bad == "f" and f_there:
            u = BAD_U
        if bad == "h" and h_there:
            arguments["scale"] = -1.0
            mask[:] = True
            z[:] = 1.0
        if bad == "z":
            z[0] = 1e39
        if k in (6, 26):  # directly after an update
            for ukf in (c, python):
                ukf.recover()
                ukf.predict(U)
        python.gate = gate = 0.5 if k % 6 == 3 else np.inf
        c.set_gate(gate)
        if k % 4 == 0:
            found = same(c, python, "iterate", u, z, mask, sensor=sensor, **arguments)
        else:
            found = same(c, python, "predict", u)
            errors.add(found)
            if k % 4 != 2:
                found = same(c, python, "update", z, mask, sensor=sensor, **arguments)
        errors.add(found)
        gated += c.gated
        if k % 4 == 3:  # an update may follow an update, or a rejected one
            same(c, python, "update", [0.5], None, sensor=1)
        if k % 7 == 3:
            python.x = c.x = draws.standard_normal(3)
        if k % 11 == 4:
            python.P = c.P = np.eye(3) * (0.5 + 0.1 * k)
        if k == 12:
            python.Q = Q = 0.02 * np.eye(c.params.q)
            c.set_noise(Q, python.R)
        if k % 6 == 5:
            python._last_P = None
            assert c.P.tobytes() == python.P.tobytes()
        if k % 8 == 7:
            c.redraw()
            python.redraw()
    assert gated > 1
    assert errors >= {True, False} | ({ErrorCode.MODEL_F} if f_there else set())
    assert (ErrorCode.MODEL_H in errors) == h_there
    assert (ErrorCode.NOT_FINITE in errors) == (kind == "augmented")
    assert c_bus.log == python_bus.log
    assert not c.exceptions


def failing(call, *arguments, **keywords):
    with pytest.raises(CFilterError) as caught:
        call(*arguments, **keywords)
    return caught.value


def started(libraries, which="core", kind="augmented", redraw=False, **options):
    """A C filter that has been started, and its bus."""
    problem = rover(redraw=redraw, **KINDS[kind])
    placed, params = placed_rover(problem, which)
    bus = NotingBus(GoldenCore(params))
    c = rover_on_c(libraries(params), bus, problem, placed, params, **options)
    c.start(problem.x0, problem.P0, problem.Q, problem.R)
    return c, bus


def starts(bus, before=0):
    """Steps that were started since, by name."""
    words = [word for kind, address, word in bus.log[before:]
             if (kind, address) == ("write", CONTROL.offset)]  # fmt: skip
    return [step.name for word in words for step in STEPS if word & CONTROL[step.name].mask]


# What a step is.


@pytest.mark.parametrize(
    ("which", "redraw", "expected"),
    [
        ("core", False, ["ITERATE"]),
        ("core", True, ["F", "SIG_GEN", "H"]),
        ("f", False, ["F", "UPDATE"]),
        ("h", False, ["SIG_GEN", "PREDICT", "H"]),
    ],
)
def test_iterate_is_one_step_if_it_can_be(libraries, which, redraw, expected):
    c, bus = started(libraries, which, redraw=redraw)
    c.iterate(U, [3.0, 0.0], sensor=0, **AIMED)
    before = len(bus.log)
    c.iterate(U, [3.0, 0.0], sensor=0, **AIMED)
    assert starts(bus, before) == expected
    before = len(bus.log)
    c.iterate(U, [np.nan], np.array([False]), sensor=1)
    assert "UPDATE" not in starts(bus, before)
    assert "H" not in starts(bus, before)


@pytest.mark.parametrize(("which", "missing"), [("f", "h"), ("h", "f")])
def test_models_that_the_core_has_not_must_be_given(libraries, which, missing):
    problem = rover()
    placed, params = placed_rover(problem, which)
    models = {"f": lambda x, w, u: x, "h": [lambda x, v: x[:2], lambda x, v: x[:1]]}
    models[missing] = None if missing == "f" else [None, None]
    library, core = libraries(params)
    options = {"placed": placed, "core": core, "terms": (2, 1)}
    bus = NotingBus(GoldenCore(params))
    with pytest.raises(CFilterError) as caught:
        CFilter(library, bus, params, models["f"], models["h"], **options)
    assert caught.value.result is Result.BAD_ARGUMENT
    assert not bus.log


def test_models_that_the_core_has_are_not_called(libraries):
    """Given or not, the accesses are the same."""

    def refuse(*arguments):
        raise AssertionError

    c, bus = started(libraries)
    _, params = placed_rover(rover(), "core")
    library, core = libraries(params)
    other_bus = NotingBus(GoldenCore(params))
    placed, _ = placed_rover(rover(), "core")
    other = CFilter(
        library, other_bus, params, refuse, [refuse] * 2, placed=placed, core=core, terms=(2, 1)
    )
    problem = rover()
    other.start(problem.x0, problem.P0, problem.Q, problem.R)
    for ukf in (c, other):
        ukf.predict(U)
        ukf.update([3.0, 0.0], sensor=0, **AIMED)
        ukf.iterate(U, [0.25], sensor=1)
    assert bus.log == other_bus.log
    assert not other.exceptions


def test_no_sigma_points_cross_the_bus(libraries):
    """With all models on the core: z, what has changed of U, x; the points of the noise neither."""
    c, bus = started(libraries)
    assert c.iterate(U, [3.0, 0.0], sensor=0, **AIMED)
    assert np.isfinite(c.x).all()
    regions = MemoryMap(c.params)
    for k in range(3):
        before = len(bus.log)
        c.iterate(np.array([0.25, 0.125 * k]), [3.0, 0.0], sensor=0, **AIMED)
        assert np.isfinite(c.x).all()
        words = [entry[:2] for entry in bus.log[before:] if entry[1] >= regions.region_stride]
        assert words == [
            ("write", regions.address("U", 0, 1)),
            *(("write", regions.address("z", row, 0)) for row in range(2)),
            *(("read", regions.address("x", 0, i)) for i in range(3)),
        ]
    symbols = {
        region.symbol
        for region in regions
        for _, address, _ in bus.log
        if region.index == address // regions.region_stride
    }
    assert symbols == {"x", "L", "LQ", "LR", "U", "z"}


@pytest.mark.parametrize("method", ["update", "iterate"])
@pytest.mark.parametrize("language", ["C", "Python"])
def test_after_an_h_that_failed_its_points_are_there(libraries, language, method):
    """But not after an update that was rejected, which has overwritten them."""
    c, python, *buses = both(libraries, "augmented", "core")
    bus = buses[language == "Python"]
    ukf = c if language == "C" else python
    ukf.predict(U)
    arguments = (U, [3.0, 0.0]) if method == "iterate" else ([3.0, 0.0],)
    bad = {"mode": "near", "scale": -1.0}
    assert outcome(ukf, method, *arguments, sensor=0, **bad)[0] == ErrorCode.MODEL_H
    if language == "C":
        ukf.set_gate(0.01)
    else:
        ukf.gate = 0.01
    for expected in (["H"], ["SIG_GEN", "H"]):
        before = len(bus.log)
        assert outcome(ukf, "update", [3.0, 5.0], sensor=0, **AIMED)[0] is False
        assert starts(bus, before) == expected


# Inputs.


def test_inputs_are_checked(libraries):
    """Before any access; and all stay as they are."""
    c, bus = started(libraries)
    before = len(bus.log)
    c.set_inputs(0, [0.25, 0.5, 1.25])
    for first, values in ((0, [1.0] * 4), (3, [1.0]), (2, [1.0, 1.0]), (2**32 - 1, [1.0, 1.0])):
        assert failing(c.set_inputs, first, values).result is Result.BAD_ARGUMENT
    for value in (np.nan, np.inf, -np.inf, 1e39):
        assert failing(c.set_inputs, 0, [0.75, value]).result is Result.BAD_ARGUMENT
    c.set_inputs(3, [])
    assert len(bus.log) == before
    other, _ = started(libraries)
    c._placed = None
    c.predict()
    other.predict(U)
    assert c.x.tobytes() == other.x.tobytes()


def test_inputs_of_f_must_have_been_set(libraries):
    """The fault has the place of the first one that has not; nothing is done."""
    c, bus = started(libraries)
    c._placed = None
    before = len(bus.log)
    for place in range(2):
        for call in (c.predict, lambda: c.iterate(None, [3.0, 0.0])):
            error = failing(call)
            assert error.result is Result.BAD_ARGUMENT
            assert (error.fault["step"], error.fault["index"]) == (Step.F, place)
        c.set_inputs(place, [0.25])
    assert len(bus.log) == before
    c.predict()


def test_an_input_of_h_that_was_never_set_is_none(libraries):
    """The h that takes it fails; that of another sensor does not."""
    c, _ = started(libraries)
    c._placed = None
    c.set_inputs(0, U)
    c.predict()
    c.update([0.25], sensor=1)
    error = failing(c.update, [3.0, 0.0], sensor=0)
    assert (error.result, error.fault["index"]) == (Result.MODEL_H, 1)
    c.set_inputs(2, [1.25])
    assert c.update([3.0, 0.0], sensor=0)


def test_inputs_may_be_set_at_any_time(libraries):
    """Before the filter has been started, and in doubt; but not before it has been opened."""
    problem = rover()
    placed, params = placed_rover(problem, "core")
    bus = NotingBus(GoldenCore(params))
    c = rover_on_c(libraries(params), bus, problem, placed, params, opened=False)
    assert failing(c.set_inputs, 0, [0.25]).result is Result.NOT_OPEN
    c.open()
    c.set_inputs(0, U)
    c.start(problem.x0, problem.P0, problem.Q, problem.R)
    bus.refuse = CONTROL.offset
    assert failing(c.predict, U).result is Result.BUS_ERROR
    bus.refuse = None
    c.set_inputs(0, [0.75])
    c.recover()
    c._placed = None
    c.predict()
    other, _ = started(libraries)
    other.predict(np.array([0.75, U[1]]))
    assert c.x.tobytes() == other.x.tobytes()


@pytest.mark.parametrize("language", ["C", "Python"])
def test_a_start_writes_all_inputs_again(libraries, language):
    """To begin anew is to rely on nothing: the core may have been loaded again."""
    c, python, *buses = both(libraries, "augmented", "core")
    bus = buses[language == "Python"]
    ukf = c if language == "C" else python
    problem = rover()
    place = MemoryMap(c.params).address("U", 0, 0)
    for writes in (True, False):
        before = len(bus.log)
        ukf.predict(U)
        assert (place in [entry[1] for entry in bus.log[before:]]) == writes
    bus.bus.write(place, 0x7FC00000)  # NaN
    if language == "C":
        c.start(problem.x0, problem.P0, problem.Q, problem.R)
    else:
        python.reset()
    ukf.predict(U)


@pytest.mark.parametrize("language", ["C", "Python"])
def test_an_input_whose_writing_broke_off_is_written_again(libraries, language):
    """Also if it is to be what it was before: the core may have the other one."""
    c, python, *buses = both(libraries, "augmented", "core")
    bus = buses[language == "Python"]
    ukf = c if language == "C" else python
    ukf.predict(U)
    place = MemoryMap(c.params).address("U", 0, 0)

    def written_and_refused(address, word):
        if address == place:
            raise BusError(address, "write")

    bus.on_write = written_and_refused
    with pytest.raises((CFilterError, BusError)):
        ukf.predict(np.array([0.75, U[1]]))
    bus.on_write = None
    ukf.recover()
    before = len(bus.log)
    ukf.predict(U)
    assert [entry[2] for entry in bus.log[before:] if entry[1] == place] == [0x3E800000]


# Variants and errors.


def test_variants_that_are_not_there(libraries):
    """One that no core can have is refused without an access; another one by the core."""
    c, bus = started(libraries)
    c.predict(U)
    c.update([3.0, 0.0], sensor=0, **AIMED)
    c._placed = None
    x, P = c.x, c.P
    before = len(bus.log)
    c.set_variant(0, 16)
    for call in (lambda: c.update([3.0, 0.0]), lambda: c.iterate(None, [3.0, 0.0])):
        assert failing(call).result is Result.BAD_ARGUMENT
    assert len(bus.log) == before
    for call, step in (
        (lambda: c.update([3.0, 0.0]), Step.H), (lambda: c.iterate(None, [3.0, 0.0]), Step.ITERATE),
    ):  # fmt: skip
        c.set_variant(0, 2)
        error = failing(call)
        assert (error.result, error.fault["step"]) == (Result.ILLEGAL_STEP, step)
        assert c.doubtful
        c.recover()
        assert c.x.tobytes() == x.tobytes()
        assert c.P.tobytes() == P.tobytes()
        c.set_variant(0, 1)
    assert c.update([3.0, 0.0])


def test_variants_are_other_models(libraries):
    c, _ = started(libraries)
    other, _ = started(libraries)
    c.iterate(U, [3.0, 0.0], sensor=0, **AIMED)
    other.iterate(U, [3.0, 0.0], sensor=0, **(AIMED | {"mode": "far"}))
    assert (c.x != other.x).any()


def test_a_model_that_is_not_finite_is_named_with_its_row(libraries):
    """A row of all of z; an iterate whose h fails has made its prediction, which can be undone."""
    c, _ = started(libraries)
    c.iterate(U, [3.0, 0.0], sensor=0, **AIMED)
    x, P = c.x, c.P
    for call in (lambda: c.predict(BAD_U), lambda: c.iterate(BAD_U, [0.25], sensor=1)):
        error = failing(call)
        assert (error.result, error.fault["index"]) == (Result.MODEL_F, 1)
        assert c.result_name(error.result) == "f gives NaN or infinity"
        assert not c.doubtful
        assert c.x.tobytes() == x.tobytes()
        assert failing(c.undo_predict).result is Result.BAD_ARGUMENT
    error = failing(c.iterate, U, [3.0, 0.0], sensor=0, mode="far", scale=-1.0)
    assert (error.result, error.fault["index"]) == (Result.MODEL_H, 1)
    assert c.result_name(error.result) == "h gives NaN or infinity"
    assert (c.x != x).any()
    c.undo_predict()
    assert c.x.tobytes() == x.tobytes()
    assert np.allclose(c.P, P, rtol=1e-5)
    # A row that is masked may be what it likes.
    mask = np.array([True, False])
    assert c.iterate(U, [3.0, np.nan], mask, sensor=0, mode="far", scale=-1.0)


def test_iterate_checks_all_before_it_does_anything(libraries):
    for which in ("core", "f"):
        c, bus = started(libraries, which)
        before = len(bus.log)
        for z, sensor in (([np.nan, 0.0], 0), ([0.0], 2)):
            arguments = AIMED if sensor == 0 else {}
            c._placed = c._placed if sensor == 0 else None
            assert failing(c.iterate, U, z, sensor=sensor, **arguments).result is (
                Result.BAD_ARGUMENT
            )
        assert len(bus.log) == before


def test_a_gate_rejects_a_z_beyond_the_format(libraries):
    """Clamped as for models in software, by both languages; H draws new points after it."""
    c, python, c_bus, python_bus = both(libraries, "augmented", "core")
    python.gate = 10.0
    c.set_gate(10.0)
    for ukf in (c, python):
        ukf.predict(U)
    same(c, python, "update", [3.0, 0.0], None, sensor=0, **AIMED)
    for large in (1e39, -1e200):
        assert same(c, python, "update", [large], None, sensor=1) is False
        assert same(c, python, "iterate", U, [large], None, sensor=1) is False
        assert c.gated
    assert c_bus.log == python_bus.log
