import copy
import pickle
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from support.problems import core_of
from ukf_sw.backends import Backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import (
    CoreTimeoutError,
    EstimateLostError,
    FormatOverflowError,
    NotFiniteError,
    NotRecoveredError,
    SingularObservationError,
)
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.models import wrap
from ukf_sw.problem import Problem, Sensor
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64
from ukf_sw.spec.parameters import Form, Noise, UkfParams
from ukf_sw.spec.registers import CONTROL, GATE_LOW

BACKENDS = ["reference", "golden"]
PARAMS = UkfParams(n=3, m=2, q=2, r=2, format=BINARY64, pes=3)
#: Without W0 there is no sigma point 0.
EVERY_W0 = [0.0, 0.5]
#: Sigma points that models are called for, the first and the last of them, and how often a model is
#: called again to see whether it is a function.
K, FIRST, LAST = len(PARAMS.points), PARAMS.points[0], PARAMS.points[-1]
PROBES = 3
X0 = np.array([1.0, 0.5, -0.2])
P0 = np.array([[1.0, 0.2, 0.0], [0.2, 0.5, 0.1], [0.0, 0.1, 0.3]])
Q = np.diag([0.01, 0.02])
R = np.array([[0.1, 0.02], [0.02, 0.2]])


def f(x, w, u):
    """Works for one point and for all; adds two noise terms to three states."""
    force = 0.0 if u is None else u
    a = x[0] + 0.1 * x[1]
    b = x[1] - 0.1 * np.sin(x[0]) + force
    c = 0.9 * x[2] + 0.05 * x[0] * x[1]
    return np.array([a + w[0], b + w[1], c + 0.1 * w[-1] * x[0]])


def h(x, v, gain=1.0):
    return np.array([gain * np.hypot(x[0], 1.0 + x[2]) + v[0], x[1] * x[0] + v[1]])


def make(backend="reference", params=PARAMS, **options):
    given = {"f": f, "x0": X0, "P0": P0, "Q": Q, **core_of(params)} | options
    sensor = {"h": h, "R": R, "m": params.m}
    sensor |= {name: given.pop(name) for name in ("h", "R", "angles") if name in given}
    given = {"sensors": Sensor(**sensor)} | given
    return UnscentedKalmanFilter(Problem(name="test", **given), backend)


def on_core(**options):
    """Make a filter on a golden core, and that core."""
    core = GoldenCore(PARAMS)
    driver = Driver(GoldenBus(core), PARAMS, timeout=0.001)
    return make(driver, **options), core


@pytest.fixture(params=BACKENDS)
def ukf(request):
    return make(request.param)


def estimate(ukf):
    return ukf.x.tolist(), ukf.P.tolist()


# What a problem and the constructor refuse.

BAD = [
    ({"f": 3}, TypeError, "f must be callable, not 3"),
    ({"h": None}, TypeError, "h must be callable, not None"),
    ({"sensors": 3}, TypeError, "sensors must be a Sensor, or some of them by name, not 3"),
    ({"x0": [1.0, 2.0]}, ValueError, "P0 must have the shape (2, 2), not (3, 3)"),
    ({"x0": [1.0, 2.0], "states": "abc"}, TypeError, "states must be names and units, as {'a': "),
    ({"x0": [1.0, 2.0], "states": ("a", "b", "c")}, ValueError,
     "x0 must have the shape (3,), not (2,)"),
    ({"x0": None}, TypeError, "x0 must be an array of real numbers, not None"),
    ({"x0": [1.0, 2.0, np.nan]}, ValueError, "x0 must be finite, not [1.0, 2.0, nan]"),
    ({"x0": "abc"}, TypeError, "x0 must be an array of real numbers, not 'abc'"),
    ({"x0": [1j, 0, 0]}, TypeError, "x0 must be an array of real numbers, not [1j, 0, 0]"),
    ({"x0": [[1], [1, 2]]}, TypeError, "x0 must be an array of real numbers, not [[1], [1, 2]]"),
    ({"P0": np.eye(2)}, ValueError, "P0 must have the shape (3, 3), not (2, 2)"),
    ({"P0": np.diag([1.0, np.inf, 1.0])}, ValueError, "P0 must be finite, not [[1.0, 0.0, 0.0], "),
    ({"P0": np.eye(3) + np.eye(3, k=1)}, ValueError,
     "P0 must be symmetric, not 1.0 at (0, 1) and 0.0 at (1, 0)"),
    ({"P0": np.diag([1.0, -2.0, 1.0])}, ValueError,
     "P0 must be positive semidefinite, and is not in row 1: its variance is -2.0"),
    ({"P0": np.diag([1e6, 1.0, -1e-8])}, ValueError,
     "P0 must be positive semidefinite, and is not in row 2: its variance is -1e-08"),
    ({"P0": np.diag([1.0, 0.0, 1.0]), "form": Form.COVARIANCE}, ValueError,
     "P0 must be positive definite, and is not in row 1: its variance is 0.0"),
    ({"Q": -np.eye(2)}, ValueError,
     "Q must be positive semidefinite, and is not in row 0: its variance is -1.0"),
    ({"P0": None}, TypeError, "P0 must be a matrix of shape (3, 3), not None"),
    ({"Q": np.ones((2, 3))}, ValueError, "Q must have the shape (2, 2), not (2, 3)"),
    ({"process_noise": Noise.ADDITIVE}, ValueError, "Q must have the shape (3, 3), not (2, 2)"),
    ({"R": np.eye(3), "observation_noise": Noise.ADDITIVE}, ValueError,
     "R must have the shape (2, 2), not (3, 3)"),
    ({"R": np.ones(2)}, ValueError, "R must have the shape (2, 2), not (2,)"),
    ({"backend": "fpga"}, ValueError, "backend must be one of reference, golden, uio, pynq"),
    ({"backend": 3}, TypeError, "backend must be a name or a Backend, not 3"),
    ({"backend": ReferenceUkf(UkfParams(n=1, m=1))}, ValueError,
     "n of a core for test must be 3, not 1"),
    ({"backend": ReferenceUkf(replace(PARAMS, W0=0.5))}, ValueError,
     "W0 of a core for test must be 0.0, not 0.5"),
    ({"state_angles": (3,)}, ValueError, "state_angles must be between 0 and 2, not 3"),
    ({"state_angles": ("heading",)}, ValueError,
     "state_angles must be indices, as the rows have no names, not 'heading'"),
    ({"state_angles": ("d",), "states": ("a", "b", "c")}, ValueError,
     "state_angles must be among a, b, c, not 'd'"),
    ({"angles": (-1,)}, ValueError, "angles must be between 0 and 1, not -1"),
    ({"angles": 1}, TypeError, "angles must be a tuple of indices or names, as (0,), not 1"),
    ({"state_angles": "12"}, TypeError,
     "state_angles must be a tuple of indices or names, as (0,), not '12'"),
    ({"angles": (1, 1)}, ValueError, "angles must be different indices, not (1, 1)"),
    ({"angles": (3.5,)}, TypeError, "each of angles must be an int, not 3.5"),
    ({"vectorized": "no"}, TypeError, "vectorized must be a bool, not 'no'"),
    ({"redraw": 1}, TypeError, "redraw must be a bool, not 1"),
    ({"f": lambda x, w: x}, TypeError,
     "process model f (<lambda>) must take (x, w, u), not (x, w)"),
    ({"h": lambda x: x[:2]}, TypeError, "observation model h (<lambda>) must take (x, v), not (x)"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "kind", "message"), BAD)
def test_wrong_arguments_are_refused(options, kind, message):
    with pytest.raises(kind, match="^" + re.escape(message)):
        make(**options)


BAD_CALLS = [
    (lambda ukf: setattr(ukf, "x", [1.0]), ValueError, "x must have the shape (3,), not (1,)"),
    (lambda ukf: setattr(ukf, "P", -P0), ValueError, "P must be positive semidefinite, and"),
    (lambda ukf: setattr(ukf, "Q", P0), ValueError, "Q must have the shape (2, 2), not (3, 3)"),
    (lambda ukf: setattr(ukf, "R", [[1.0, 2.0], [2.0, 1.0]]), ValueError,
     "R must be positive semidefinite, and is not in row 1: "),
    (lambda ukf: setattr(ukf, "gate", -1.0), ValueError, "gate must be at least 0, not -1.0"),
    (lambda ukf: setattr(ukf, "gate", np.nan), ValueError, "gate must be at least 0, not nan"),
    (lambda ukf: setattr(ukf, "gate", "9"), TypeError, "gate must be a number, not '9'"),
    (lambda ukf: setattr(ukf, "gate", True), TypeError, "gate must be a number, not True"),
    (lambda ukf: setattr(ukf, "mask", [1, 2]), TypeError,
     "mask must be an array of bool, or of 0 and 1, not [1, 2]"),
    (lambda ukf: ukf.update([1.0, 2.0], mask=[True, None]), TypeError,
     "mask must be an array of bool, or of 0 and 1, not [True, None]"),
    (lambda ukf: setattr(ukf, "gat", 3), AttributeError, ".*no attribute 'gat'"),
    (lambda ukf: ukf.reset(P=np.diag([1.0, -1.0, 1.0])), ValueError,
     "P must be positive semidefinite, and is not in row 1: its variance is -1.0"),
    (lambda ukf: ukf.update([1.0, 2.0], mask=[True]), ValueError,
     "mask must have the shape (2,), not (1,)"),
    (lambda ukf: ukf.update([1.0]), ValueError, "z must have the shape (2,), not (1,)"),
    (lambda ukf: ukf.update([1.0, np.nan]), ValueError,
     "z must be finite where sampled, not [1.0, nan]"),
    (lambda ukf: ukf.update([1.0, np.nan], mask=[False, True]), ValueError,
     "z must be finite where sampled, not [1.0, nan]"),
    (lambda ukf: ukf.update("no"), TypeError, "z must be an array of real numbers, not 'no'"),
    (lambda ukf: ukf.reset(x=[1.0]), ValueError, "x must have the shape (3,), not (1,)"),
    (lambda ukf: ukf.reset(P=np.eye(2)), ValueError, "P must have the shape (3, 3), not (2, 2)"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "kind", "message"), BAD_CALLS)
def test_wrong_calls_are_refused_and_lose_nothing(ukf, call, kind, message):
    twin = make("reference")
    for each in (ukf, twin):
        each.predict(0.1)
    before = estimate(ukf)
    with pytest.raises(kind, match="^" + re.escape(message).replace(r"\.\*", ".*")):
        call(ukf)
    assert estimate(ukf) == before
    for each in (ukf, twin):
        each.update([2.0, 1.0])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)


# What models must not return.


def returns(value):
    return lambda: lambda *_: value


def breaks_at(index, good, bad):
    """Make a model that returns something else in one call."""

    def make_model():
        calls = iter(range(100))
        return lambda *_: bad if next(calls) == index else good

    return make_model


#: With the numbers of the sigma points of each call.
BAD_MODELS = [
    (returns([1.0, 2.0]), ValueError, "must return the shape (3,), at sigma point {0}, not (2,)"),
    (returns(None), TypeError, "must return real numbers, at sigma point {0}, not None"),
    (returns("abc"), TypeError, "must return real numbers, at sigma point {0}, not 'abc'"),
    (returns([1j] * 3), TypeError,
     "must return real numbers, at sigma point {0}, not [1j, 1j, 1j]"),
    (returns([[1], [1, 2]]), TypeError, "must return an array of numbers, at sigma point {0}"),
    (returns(np.array([1.0, None, 2.0])), TypeError,
     "must return real numbers, at sigma point {0}"),
    (returns(1.0), ValueError, "must return the shape (3,), at sigma point {0}, not ()"),
    (returns([[1.0], [2.0], [3.0]]), ValueError,
     "must return the shape (3,), at sigma point {0}, not (3, 1)"),
    (breaks_at(3, np.zeros(3), None), TypeError,
     "must return real numbers, at sigma point {3}, not None"),
    (breaks_at(4, np.zeros(3), [0.0, np.nan, 0.0]), ValueError,
     "must return finite numbers, at sigma point {4}, not nan in row 1"),
    (breaks_at(K - 1, np.zeros(3), [np.inf, 0.0, 0.0]), ValueError,
     f"must return finite numbers, at sigma point {{{K - 1}}}, not inf in row 0"),
]  # fmt: skip


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("model", "kind", "message"), BAD_MODELS)
def test_wrong_results_of_the_process_model_are_named(backend, model, kind, message, W0):
    params = replace(PARAMS, W0=W0)
    ukf = make(backend, params, f=model())
    before = estimate(ukf)
    named = "process model f (<lambda>) " + message.format(*params.points)
    with pytest.raises(kind, match="^" + re.escape(named)):
        ukf.predict()
    assert estimate(ukf) == before


def test_wrong_results_of_the_observation_model_are_named(ukf):
    ukf.predict()
    before = estimate(ukf)
    ukf._h[0].function = lambda x, v: [0.0, 1.0, 2.0]
    with pytest.raises(
        ValueError, match=r"^observation model h \(h\) must return the shape \(2,\)"
    ):
        ukf.update([0.0, 0.0])
    assert estimate(ukf) == before


@pytest.mark.parametrize(
    ("model", "shape"),
    [
        (lambda x, w, u: x[:2], f"(2, {K})"),
        (lambda x, w, u: x.T, f"({K}, 3)"),
        (lambda x, w, u: x.sum(axis=1), "(3,)"),
        (lambda x, w, u: x[:, :1], "(3, 1)"),
    ],
)
def test_wrong_results_of_vectorized_models_are_named(model, shape):
    text = f"must return the shape (3, {K}), one column a sigma point, not {shape}"
    with pytest.raises(ValueError, match="^" + re.escape("process model f (<lambda>) " + text)):
        make(f=model, vectorized=True).predict()


def test_what_a_model_raises_names_the_sigma_point(ukf):
    calls = iter(range(100))
    ukf._f.function = lambda x, w, u: f(x, w, u) if next(calls) < 6 else 1 / 0
    with pytest.raises(ZeroDivisionError) as caught:
        ukf.predict()
    where = f"at sigma point {PARAMS.points[6]}"
    assert caught.value.__notes__ == [
        f"in process model f (f), {where}, called with x of shape (3,) and w of shape (2,)"
    ]


# What models must not do.


def wrong_size(x, w, u):
    return np.eye(4) @ x


def with_input(x, w, u):
    return x + np.asarray(u)[0]


def with_time(x, w, u, *, dt):
    return x


def all_at_once(x, w, u):
    return np.array([x[0, :], x[1, :], x[2, :]])


def one_point_only(x, w, u):
    return x if x[0] > 0.0 else -x


MODELS_THAT_RAISE = [
    (wrong_size, False, ValueError, f"at sigma point {FIRST}, called with x of shape (3,) and"),
    (wrong_size, True, ValueError,
     f"one column a sigma point, called with x of shape (3, {K}) and"),
]  # fmt: skip


@pytest.mark.parametrize(("model", "vectorized", "kind", "note"), MODELS_THAT_RAISE)
def test_what_a_model_raises_names_call_and_shapes(model, vectorized, kind, note):
    ukf = make(f=model, vectorized=vectorized)
    before = estimate(ukf)
    with pytest.raises(kind) as caught:
        ukf.predict()
    assert caught.value.__notes__[0].startswith(f"in process model f ({model.__name__}), {note}")
    assert estimate(ukf) == before


AMBIGUOUS = "The truth value of an array with more than one element is ambiguous. Use a.any() or a"
MISTAKES = [
    (with_input, False, TypeError, "process model f (with_input) raised IndexError (too many ",
     f"), at sigma point {FIRST}: predict was given no u, so u is None"),
    (with_time, False, TypeError, "predict must be given what process model f (with_time) takes, ",
     "(x, w, u, *, dt): missing a required argument: 'dt'"),
    (one_point_only, True, ValueError,
     f"process model f (one_point_only) raised ValueError ({AMBIGUOUS}",
     "one column a sigma point, but works for a single one: leave out vectorized=True, or let it"),
    (all_at_once, False, ValueError, "process model f (all_at_once) raised IndexError (too many ",
     f"), at sigma point {FIRST}, but works for several at once: say vectorized=True"),
]  # fmt: skip


@pytest.mark.parametrize(("model", "vectorized", "kind", "start", "end"), MISTAKES)
def test_mistakes_are_said(model, vectorized, kind, start, end):
    ukf = make(f=model, vectorized=vectorized)
    before = estimate(ukf)
    with pytest.raises(kind, match=f"^{re.escape(start)}.*{re.escape(end)}") as caught:
        ukf.predict()
    assert caught.value.__cause__ is not None
    assert estimate(ukf) == before


@pytest.mark.parametrize("u", [np.zeros(2), [0.0, 0.0]], ids=["array", "list"])
def test_what_a_model_raises_is_kept_whatever_u_is(u):
    ukf = make(f=lambda x, w, u: x[np.arange(9)] + u[0])
    with pytest.raises(IndexError, match=r"^index 3 is out of bounds") as caught:
        ukf.predict(u)
    note = f"in process model f (<lambda>), at sigma point {FIRST}, "
    assert caught.value.__notes__[0].startswith(note)


def test_an_argument_that_the_observation_model_does_not_know():
    ukf = make()
    message = "update must be given what observation model h (h) takes, (x, v, gain=1.0): got an "
    with pytest.raises(TypeError, match=re.escape(message) + "unexpected keyword argument 'gian'"):
        ukf.update([1.0, 2.0], gian=2.0)


class Counting:
    """Keeps a state: the number of its calls."""

    calls = 0

    def __call__(self, x, *others):
        self.calls += 1
        return (f if len(others) == 2 else h)(x, *others) + 1e-6 * self.calls


def remembering():
    """Model that mixes in the argument of the call before."""
    last = np.zeros(3)

    def drag(x, w, u):
        nonlocal last
        result, last = f(x, w, u) + 0.01 * last[(slice(None), *([None] * (x.ndim - 1)))], x.copy()
        return result

    return drag


def noisy():
    rng = np.random.default_rng(0)

    def noisy_model(x, w, u):
        return f(x, w, u) + 1e-6 * rng.standard_normal(x.shape)

    return noisy_model


def norm_of_all(x, w, u):
    return x / np.linalg.norm(x)


def mean_of_all(x, w, u):
    return x - x.mean(axis=1, keepdims=True)


def relative_to_first(x, w, u):
    return x - 1e-3 * x[:, :1]


def first_column_for_all(x, w, u):
    return np.tile(f(x[:, 0], w[:, 0], u), (x.shape[1], 1)).T


def sorted_columns(x, w, u):
    return np.sort(x, axis=1)


SAME = "must give equal results for equal arguments, at sigma point "
COLUMNS = "must give equal results for equal arguments, whatever the other columns are, at sigma"
#: With the number of the sigma point that is sent first again.
NOT_FUNCTIONS = [
    (Counting, False, f"(Counting) {SAME}{{0}}, not "),
    (Counting, True, f"(Counting) {COLUMNS}"),
    (remembering, False, f"(drag) {SAME}"),
    (noisy, False, f"(noisy_model) {SAME}{{0}}, not "),
    (noisy, True, f"(noisy_model) {COLUMNS}"),
    (lambda: norm_of_all, True, f"(norm_of_all) {COLUMNS}"),
    (lambda: mean_of_all, True, f"(mean_of_all) {COLUMNS}"),
    (lambda: relative_to_first, True, f"(relative_to_first) {COLUMNS}"),
    (lambda: first_column_for_all, True, f"(first_column_for_all) {COLUMNS}"),
    (lambda: sorted_columns, True, f"(sorted_columns) {COLUMNS}"),
]  # fmt: skip


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("model", "vectorized", "message"), NOT_FUNCTIONS)
def test_models_that_are_not_functions_are_found(backend, model, vectorized, message, W0):
    ukf = make(backend, replace(PARAMS, W0=W0), f=model(), vectorized=vectorized)
    before = estimate(ukf)
    # It is another one than the first in all, and these two differ in every row.
    said = message.format(1 if W0 else LAST)
    with pytest.raises(ValueError, match="^process model f " + re.escape(said)) as caught:
        ukf.predict()
    probes = rf"point ({LAST}|1), not \S+ and then \S+ in row [012]$"
    assert re.search(probes, str(caught.value))
    assert estimate(ukf) == before


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize(
    "model", [norm_of_all, mean_of_all, relative_to_first, first_column_for_all, sorted_columns]
)
def test_mixed_columns_are_found_in_the_smallest_filter(model, W0):
    """It has two sigma points beside point 0."""
    f = (lambda x, w, u: np.tile(x[:, :1], x.shape[1])) if model is first_column_for_all else model
    problem = Problem(
        name="small", f=f, sensors=Sensor(lambda x, v: x, m=1), x0=[0.5], P0=[[1.0]], W0=W0,
        vectorized=True,
    )  # fmt: skip
    ukf = UnscentedKalmanFilter(problem)
    assert ukf.params.M == 1
    with pytest.raises(ValueError, match=re.escape(COLUMNS)):
        ukf.predict()


@pytest.mark.parametrize("late", [2, 3, 5])
def test_models_that_stop_being_functions_are_found_later(ukf, late):
    """By the next call whose number is a power of two."""
    drifting = Counting()
    for call in range(1, 9):
        ukf.predict()
        ukf._h[0].function = h if call < late else drifting
        if call in (2, 4, 8) and call >= late:
            with pytest.raises(ValueError, match=r"^observation model h \(h\) must give equal"):
                ukf.update([1.0, 2.0])
            return
        ukf.update([1.0, 2.0])
    raise AssertionError


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("backend", BACKENDS)
def test_how_often_models_are_called(backend, W0):
    calls = []
    params = replace(PARAMS, W0=W0)
    ukf = make(backend, params, f=lambda *arguments: calls.append(None) or f(*arguments))
    counts = []
    for _ in range(9):
        calls.clear()
        ukf.predict()
        counts.append(len(calls))
    count = len(params.points)
    assert counts == [count + (PROBES if call in (1, 2, 4, 8) else 0) for call in range(1, 10)]


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("argument", ["x", "w", "v"])
def test_models_must_not_change_their_arguments(vectorized, argument, W0):
    def spoil(x, noise, *others):
        result = f(x, noise, *others) if others else h(x, noise)
        (x if argument == "x" else noise)[0] += 1.0
        return result

    model, name = ("h", "observation model h") if argument == "v" else ("f", "process model f")
    params = replace(PARAMS, W0=W0)
    ukf = make(params=params, vectorized=vectorized, **{model: spoil})
    noise = dict(zip("wv", ukf._noise_points, strict=True))
    given = noise.get(argument, ukf._backend.sigma_points())[:, 0].tolist()
    if model == "h":
        ukf.predict()
    before = estimate(ukf)
    text = (
        f"{name} (spoil) must not change its argument {argument}, at sigma point "
        f"{params.points[0]}, from {given}"
    )
    with pytest.raises(ValueError, match="^" + re.escape(text)):
        ukf.update([1.0, 2.0]) if model == "h" else ukf.predict()
    assert estimate(ukf) == before


def test_partial_functions_have_the_name_of_their_function():
    ukf = make(h=partial(h, gain=None))
    with pytest.raises(TypeError) as caught:
        ukf.update([1.0, 2.0])
    assert caught.value.__notes__[0].startswith(
        f"in observation model h (h), at sigma point {FIRST}, "
    )


def test_rounding_of_vectorized_models_is_no_mixing():
    """Libraries may sum in another order when there are fewer columns; and sums may cancel."""

    def f(x, w, u):
        terms = np.array([0.1, 0.2, 0.3, -0.6])[:, None] * x[0]
        zero = sum(terms if x.shape[1] == K else terms[::-1])
        assert np.abs(zero).max() > 0.0
        return np.array([x[0], zero, x[2]])

    ukf = make(f=f, vectorized=True)
    for _ in range(2):
        ukf.predict()


# What it computes.


@pytest.mark.parametrize("backend", BACKENDS)
def test_vectorized_models_give_the_same(backend):
    estimates = []
    for vectorized in (False, True):
        ukf = make(backend, vectorized=vectorized)
        for k in range(5):
            ukf.predict(0.1 * k)
            ukf.update([1.0 + k, 2.0], gain=1.5)
        estimates.append(estimate(ukf))
    assert estimates[0] == estimates[1]


def random_walk(ukf, seed, steps=150):
    """Do random things to a filter; gives what is seen on the way."""
    rng = np.random.default_rng(seed)
    seen, done = [], set()
    for _ in range(steps):
        action = rng.choice(
            ["predict", "update", "update", "mask", "redraw", "x", "P", "Q", "R", "none", "gate",
             "reset", "look"],
            p=[0.3, 0.14, 0.1, 0.12, 0.06, 0.03, 0.03, 0.03, 0.03, 0.03, 0.05, 0.02, 0.06],
        )  # fmt: skip
        z = h(ukf.x, np.zeros(2)) + 0.3 * rng.standard_normal(2)
        if action == "predict":
            ukf.predict(0.1 * rng.standard_normal())
        elif action == "update":
            seen.append(float(ukf.update(z)))
        elif action == "mask":
            mask = rng.random(2) < 0.5
            seen.append(float(ukf.update(np.where(mask, z, np.nan), mask)))
        elif action == "redraw":
            ukf.redraw()
        elif action == "none":
            seen.append(float(ukf.update(None)))
        elif action == "x":
            ukf.x = ukf.x + 0.1 * rng.standard_normal(3)
        elif action == "P":
            ukf.P = np.diag(rng.random(3))
        elif action == "Q":
            ukf.Q = np.diag(rng.random(len(ukf.Q))) * 0.02
        elif action == "R":
            ukf.R = np.diag(rng.random(2)) * 0.2 + 0.01
        elif action == "gate":
            ukf.gate = rng.choice([0.1, 1.0, np.inf])
        elif action == "reset":
            ukf.reset(x=X0 + rng.standard_normal(3))
        done.add(str(action))
        done |= {"gated"} if ukf.gated else set()
        seen.extend(ukf.x)
        seen.append(-1.0 if ukf.nis is None else ukf.nis)
        if action == "look" or rng.random() < 0.3:
            seen.extend(ukf.P.ravel())
    return np.array(seen), done


@pytest.mark.parametrize("W0", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("kinds", "form"),
    [
        ({}, Form.SQUARE_ROOT),
        ({}, Form.COVARIANCE),
        ({"process_noise": Noise.ADDITIVE}, Form.SQUARE_ROOT),
        ({"observation_noise": Noise.ADDITIVE}, Form.SQUARE_ROOT),
        ({"process_noise": Noise.ADDITIVE, "observation_noise": Noise.ADDITIVE}, Form.SQUARE_ROOT),
        ({"process_noise": Noise.ADDITIVE, "observation_noise": Noise.ADDITIVE}, Form.COVARIANCE),
    ],
)
def test_core_agrees_with_the_reference_whatever_happens(kinds, form, seed, W0):
    q = 3 if "process_noise" in kinds else 2
    params = UkfParams(n=3, m=2, q=q, r=2, W0=W0, format=BINARY64, pes=4, form=form, **kinds)
    options = {"Q": np.eye(q) * 0.01, "redraw": seed == 3}
    expected, done = random_walk(make("reference", params, **options), seed)
    found, also_done = random_walk(make("golden", params, **options), seed)
    assert done == also_done
    assert {"predict", "update", "mask", "gated"} <= done
    np.testing.assert_allclose(found, expected, atol=1e-8, rtol=1e-8)


def test_redrawing_is_an_option(ukf):
    twin = make("reference", redraw=True)
    ukf.predict()
    ukf.redraw()
    ukf.update([1.0, 1.0])
    twin.predict()
    twin.update([1.0, 1.0])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-12)
    plain = make()
    plain.predict()
    plain.update([1.0, 1.0])
    assert np.abs(plain.x - twin.x).max() > 1e-6


def test_nothing_sampled_changes_nothing(ukf):
    ukf.predict()
    before = estimate(ukf)
    assert ukf.update(None) is False
    assert ukf.update([np.nan, np.nan], mask=[False, False]) is False
    assert estimate(ukf) == before
    assert ukf.nis is None


def test_mask_property_is_the_default(ukf):
    twin = make()
    ukf.mask = [1, 0]
    assert ukf.mask.tolist() == [True, False]
    ukf.predict()
    assert ukf.update([1.0, np.nan]) is True
    twin.predict()
    twin.update([1.0, 55.0], mask=[True, False])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-12)


def test_masked_results_of_the_model_do_not_matter(ukf):
    twin = make()
    ukf._h[0].function = lambda x, v: [h(x, v)[0], np.nan]
    for each in (ukf, twin):
        each.predict()
        each.update([1.0, 2.0], mask=[True, False])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-12)


def test_gate(ukf):
    ukf.gate = 9
    assert ukf.gate == 9.0
    ukf.predict()
    before = estimate(ukf)
    assert ukf.update([1e3, 0.0]) is False
    assert ukf.gated
    assert ukf.nis > 9.0
    assert estimate(ukf) == before
    ukf.gate = np.inf
    assert ukf.update([1e3, 0.0]) is True
    assert not ukf.gated
    assert estimate(ukf) != before


def test_after_a_rejected_update_the_predicted_points_still_serve(ukf):
    twin = make()
    for each in (ukf, twin):
        each.predict()
    ukf.gate = 9.0
    assert ukf.update([1e3, 0.0]) is False
    for each in (ukf, twin):
        each.update([2.0, 1.0])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)


def test_a_new_filter_on_the_same_core_has_its_own_settings():
    driver = Driver(GoldenBus(GoldenCore(PARAMS)), PARAMS)
    make(driver).gate = 1e-9
    ukf = make(driver)
    ukf.predict()
    assert ukf.update([2.0, 1.0]) is True


def test_reset_starts_again(ukf):
    ukf.predict()
    ukf.update([1.0, 2.0])
    first = estimate(ukf)
    ukf.gate = 1e-9
    ukf.reset()
    assert ukf.nis is None
    np.testing.assert_allclose(ukf.x, X0, atol=1e-15)
    np.testing.assert_allclose(ukf.P, P0, atol=1e-15)
    ukf.predict()
    assert ukf.update([1.0, 2.0]) is False  # settings stay
    ukf.gate = np.inf
    ukf.reset()
    ukf.predict()
    ukf.update([1.0, 2.0])
    assert estimate(ukf) == first


def assign_element(ukf, name):
    getattr(ukf, name)[(0,) * getattr(ukf, name).ndim] = 1.0


def assign_slice(ukf, name):
    getattr(ukf, name)[:1] = 1.0


def add_to_element(ukf, name):
    getattr(ukf, name).T[0] += 1.0


@pytest.mark.parametrize("write", [assign_element, assign_slice, add_to_element])
@pytest.mark.parametrize("name", ["x", "P", "Q", "R", "mask"])
def test_what_a_filter_gives_cannot_be_written(ukf, name, write):
    before = np.array(getattr(ukf, name))
    with pytest.raises(ValueError, match=r"assign the whole, as in x = ukf\.x\.copy\(\)"):
        write(ukf, name)
    np.testing.assert_array_equal(getattr(ukf, name), before)


def test_in_place_operators_assign(ukf):
    x, mine = np.array(ukf.x), ukf.x
    mine += 5.0
    np.testing.assert_array_equal(ukf.x, x)
    assert type(mine) is np.ndarray
    ukf.x += 0.5
    ukf.P *= 2.0
    ukf.mask &= [True, False]
    np.testing.assert_allclose(ukf.x, x + 0.5, atol=1e-15)
    np.testing.assert_allclose(ukf.P, 2.0 * P0, atol=1e-15)
    assert ukf.mask.tolist() == [True, False]


def test_what_is_made_of_what_a_filter_gives_is_an_array(ukf):
    x = ukf.x
    copies = [x.copy(), copy.copy(x), copy.deepcopy(x), pickle.loads(pickle.dumps(x)), np.array(x)]
    for each in [*copies, x + 1.0, np.sqrt(x * x), ukf.P @ x, np.linalg.inv(ukf.P), np.outer(x, x)]:
        assert type(each) is np.ndarray
        each[0] = 9.0
    assert type(x.sum()) is np.float64
    assert repr(x) == repr(np.array(x))
    taken = x[[0, 1]]
    taken[0] = 9.0  # what has been copied by an index can be written
    taken += 1.0
    assert taken[0] == 10.0
    np.testing.assert_allclose(ukf.x, X0, atol=1e-15)


def test_the_filter_has_the_rest(ukf):
    assert isinstance(ukf.backend, Backend)
    assert ukf.params == PARAMS


@pytest.mark.parametrize("value", [np.float32(9.0), np.int64(9), np.array(9.0), 9])
def test_numbers_of_numpy_are_numbers(ukf, value):
    ukf.gate = value
    assert ukf.gate == 9.0
    assert type(ukf.gate) is float
    make(vectorized=np.bool_(True), redraw=np.bool_(False), angles=np.array([1]))


@pytest.mark.parametrize("mask", [[1, 0], np.array([1, 0]), np.array([1.0, 0.0]), [True, False]])
def test_masks_of_zeros_and_ones(ukf, mask):
    twin = make()
    assert ukf.update([1.0, np.nan], mask=mask)
    twin.update([1.0, np.nan], mask=[True, False])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-12)


# Copies.


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda ukf: pickle.loads(pickle.dumps(ukf))],
                         ids=["deepcopy", "pickle"])  # fmt: skip
@pytest.mark.parametrize("predicted", [False, True])
def test_copies_go_on_as_the_filter(ukf, clone, predicted):
    ukf.predict(0.1)
    ukf.update([1.0, 2.0])
    if predicted:
        ukf.predict(0.2)
    before = estimate(ukf)
    twin = clone(ukf)
    with pytest.raises(ValueError, match="assign the whole"):
        twin.x[0] = 1.0
    ukf.update([1.5, 1.0])
    ukf.predict(-0.1)
    assert estimate(twin) == before
    twin.update([1.5, 1.0])
    twin.predict(-0.1)
    assert estimate(twin) == estimate(ukf)


@pytest.mark.parametrize("backend", BACKENDS)
def test_semidefinite_covariances(backend):
    """A state and a noise without uncertainty."""
    P = np.diag([1.0, 0.0, 0.5])
    singular = np.array([[0.04, 0.02], [0.02, 0.01]])
    ukf = make(backend, P0=P, Q=singular, R=R)
    twin = make("reference", P0=P, Q=singular, R=R)
    for each in (ukf, twin):
        each.predict()
        each.update([1.0, 0.5])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)
    np.testing.assert_allclose(ukf.P, twin.P, atol=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_noise_terms_at_all(backend):
    problem = Problem(
        name="walk", f=lambda x, w, u: x + u, sensors=Sensor(lambda x, v: x), x0=[0.0], P0=[[4.0]],
        format=BINARY64,
    )  # fmt: skip
    assert problem.params == UkfParams(n=1, m=1, format=BINARY64)
    ukf = UnscentedKalmanFilter(problem, backend)
    ukf.predict(2.0)
    np.testing.assert_allclose([*ukf.x, *ukf.P[0]], [2.0, 4.0], atol=1e-12)
    ukf.update([3.0])
    np.testing.assert_allclose([*ukf.x, *ukf.P[0]], [3.0, 0.0], atol=1e-12)
    ukf.P = [[0.0]]
    with pytest.raises(SingularObservationError, match=r"singular at row 0$"):
        ukf.update([3.0])
    np.testing.assert_allclose(ukf.x, [3.0], atol=1e-12)


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("backend", BACKENDS)
def test_additive_noise_reaches_the_models_as_zeros(backend, W0):
    seen = []

    def note(x, noise, *_):
        seen.append((noise.shape, noise.any()))
        return x[: 2 if noise.size == 2 else 1]

    problem = Problem(
        name="noted", f=note, sensors=Sensor(note, R=np.eye(1), m=1), x0=[0, 0], P0=np.eye(2),
        Q=np.eye(2), process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE, W0=W0,
    )  # fmt: skip
    ukf = UnscentedKalmanFilter(problem, backend)
    ukf.predict()
    ukf.update([1.0])
    assert set(seen) == {((2,), False), ((1,), False)}
    assert len(seen) == 2 * (len(ukf.params.points) + PROBES)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("turns", [-1, 0, 2])
def test_angles_are_wrapped(backend, turns):
    """A heading at the cut behaves as one far from it."""
    results = []
    for heading, cut in ((0.0, False), (np.pi, True)):

        def turn(x, w, u, cut=cut):
            return np.arctan2(np.sin(x + w), np.cos(x + w)) if cut else x + w

        def see(x, v, cut=cut):
            return np.arctan2(np.sin(x + v), np.cos(x + v)) if cut else x + v

        problem = Problem(
            name="turn", f=turn, sensors=Sensor(see, R=[[0.02]], angles=(0,)), x0=[heading],
            P0=[[0.1]], Q=[[0.01]], state_angles=(0,), format=BINARY64,
        )  # fmt: skip
        ukf = UnscentedKalmanFilter(problem, backend)
        for z in (0.1, -0.2, 0.05):
            ukf.predict()
            ukf.update([heading + z + 2 * np.pi * turns])
        results.append((ukf.x - heading, ukf.P, ukf.nis))
    (x, P, nis), (x_cut, P_cut, nis_cut) = results
    np.testing.assert_allclose(wrap(x_cut, 0.0), x, atol=1e-12)
    np.testing.assert_allclose(P_cut, P, atol=1e-12)
    assert nis_cut == pytest.approx(nis, abs=1e-12)


def test_wrap_leaves_near_angles_as_they_are():
    angles = np.array([-3.0, 0.1, 3.0])
    np.testing.assert_array_equal(wrap(angles, 0.0), angles)
    np.testing.assert_allclose(wrap(angles, 32 * np.pi + 0.1), angles + 32 * np.pi)


# Failing steps.


@pytest.mark.parametrize("backend", BACKENDS)
def test_overflow_loses_nothing(backend):
    ukf = make(backend)
    for scale in (1e200, 1.0):
        ukf.predict()
        before = estimate(ukf)
        ukf._h[0].function = lambda x, v, scale=scale: h(x, v) * scale
        if scale > 1.0:
            with pytest.raises(NotFiniteError):
                ukf.update([1.0, 1.0])
            assert estimate(ukf) == before
            ukf._h[0].function = h
        ukf.update([1.0, 1.0])
    twin = make("reference")
    for _ in range(2):
        twin.predict()
        twin.update([1.0, 1.0])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("redraw", [False, True])
def test_overflow_of_the_covariance_of_a_prediction(backend, redraw):
    """With redrawing, predict is one step; without, it can be undone."""
    growth = 1.5e19 if backend == "golden" else 1.5e154
    problem = Problem(
        name="growth", f=lambda x, w, u: growth * x, sensors=Sensor(lambda x, v: x[:1]),
        x0=[1.0, 2.0], P0=np.diag([1e-4, 4.0]), redraw=redraw,
        format=BINARY32 if backend == "golden" else BINARY64,
    )  # fmt: skip
    ukf = UnscentedKalmanFilter(problem, backend)
    before = estimate(ukf)
    if redraw:
        with pytest.raises(NotFiniteError):
            ukf.predict()
    elif backend == "golden":
        ukf.predict()
        with pytest.raises(NotFiniteError):
            _ = ukf.P
        with pytest.raises(NotFiniteError):
            ukf.predict()
        ukf.undo_predict()
    else:
        with pytest.raises(NotFiniteError):
            ukf.predict()
    assert estimate(ukf) == before
    with pytest.raises(ValueError, match=r"^undo_predict must follow a predict"):
        ukf.undo_predict()
    assert ukf.update([1.0]) is True


def test_a_predict_can_be_undone(ukf):
    ukf.update([2.0, 1.0])
    before = estimate(ukf)
    ukf.predict(0.3)
    ukf.undo_predict()
    assert estimate(ukf) == before
    ukf.predict(0.1)
    ukf.update([2.0, 1.0])
    with pytest.raises(ValueError, match=r"^undo_predict must follow a predict"):
        ukf.undo_predict()
    twin = make()
    twin.update([2.0, 1.0])
    twin.predict(0.1)
    twin.update([2.0, 1.0])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)


@pytest.mark.parametrize("call", [
    lambda ukf: setattr(ukf, "x", [1e39, 0.0, 0.0]),
    lambda ukf: setattr(ukf, "P", np.diag([1.0, 1e80, 1.0])),
    lambda ukf: setattr(ukf, "Q", np.diag([1e80, 1.0])),
    lambda ukf: setattr(ukf, "R", np.diag([1e80, 1.0])),
    lambda ukf: ukf.reset(x=[1.0, 2.0, 3.0], P=np.diag([1.0, 1e80, 1.0])),
    lambda ukf: ukf.reset(x=[1e39, 2.0, 3.0], P=np.eye(3)),
])  # fmt: skip
def test_overflow_of_the_format_is_found_before_anything_is_written(call):
    params = UkfParams(n=3, m=2, q=2, r=2, format=BINARY32, pes=3)
    ukf, twin = make("golden", params), make("golden", params)
    for each in (ukf, twin):
        each.predict(0.1)
    with pytest.raises(FormatOverflowError, match=r" must be at most 3\.40282e\+38, the largest"):
        call(ukf)
    for each in (ukf, twin):
        each.update([1.5, 1.0])
    assert estimate(ukf) == estimate(twin)
    np.testing.assert_array_equal(ukf.Q, twin.Q)


def test_noise_that_overflows_in_the_core_is_taken_back():
    params = UkfParams(n=3, m=2, q=2, r=2, pes=3)
    ukf, twin = make("golden", params), make("golden", params)
    for each in (ukf, twin):
        each.predict(0.1)
    with pytest.raises(NotFiniteError):
        ukf.Q = np.diag([4e76, 1.0])  # its root fits, not the sigma points
    np.testing.assert_array_equal(ukf.Q, Q)
    twin.redraw()
    for each in (ukf, twin):
        each.update([1.5, 1.0])
        each.predict(0.1)
    # Sigma points drawn anew differ by rounding.
    np.testing.assert_allclose(ukf.x, twin.x, rtol=1e-6)
    np.testing.assert_allclose(ukf.P, twin.P, rtol=1e-5)


def test_a_finite_gate_stays_finite():
    params = UkfParams(n=3, m=2, q=2, r=2, pes=3)
    ukf = make("golden", params)
    ukf.gate = 1e39
    assert ukf.gate == 1e39
    word = ukf.backend._bus.core.read(GATE_LOW.offset)[0]
    assert word == BINARY32.infinity - 1


# Steps that do not end.


def test_time_out_of_an_update_drops_the_prediction():
    ukf, core = on_core()
    x, P = estimate(ukf)
    ukf.predict()
    core.hold = True
    with pytest.raises(CoreTimeoutError, match=r"^UPDATE did not end within 0\.001 s"):
        ukf.update([1.0, 1.0])
    with pytest.raises(NotRecoveredError):
        _ = ukf.x
    ukf.recover()
    core.hold = False
    assert ukf.nis is None
    np.testing.assert_allclose(ukf.x, x, atol=1e-15)
    np.testing.assert_allclose(ukf.P, P, atol=1e-12)
    ukf.predict()
    ukf.update([1.0, 1.0])
    assert np.isfinite(ukf.x).all()


@pytest.mark.parametrize("step", ["redraw", "update"])
def test_a_step_that_ends_after_the_time_out_is_found_done(step):
    ukf, core = on_core()
    twin, _ = on_core()
    for each in (ukf, twin):
        each.predict()
    core.hold = True
    with pytest.raises(CoreTimeoutError):
        ukf.redraw() if step == "redraw" else ukf.update([1.5, 1.0])
    core.finish()
    core.hold = False
    ukf.recover()
    twin.redraw() if step == "redraw" else twin.update([1.5, 1.0])
    assert estimate(ukf) == estimate(twin)


def test_a_step_that_ends_while_it_is_being_dropped():
    """Then nobody can tell whether the factor is the new one."""
    ukf, core = on_core()
    ukf.predict()
    core.hold = True
    with pytest.raises(CoreTimeoutError, match=r"^SIG_GEN did not end"):
        ukf.redraw()
    bus = ukf.backend._bus
    write = bus.write

    def end_just_before_the_reset(address, word):
        if address == CONTROL.offset and core.busy:
            core.finish()
        write(address, word)

    bus.write = end_just_before_the_reset
    for _ in range(2):
        with pytest.raises(EstimateLostError, match=r"begin anew with reset\(\)$"):
            ukf.recover()
    core.hold = False
    with pytest.raises(NotRecoveredError):
        ukf.predict()
    ukf.reset()
    np.testing.assert_allclose(ukf.x, X0, atol=1e-15)
    ukf.predict()


def test_a_reset_by_another_during_a_factorisation_loses_the_estimate():
    ukf, core = on_core()
    ukf.predict()
    core.hold = True
    with pytest.raises(CoreTimeoutError):
        ukf.redraw()
    core.write(CONTROL.offset, CONTROL["ENABLE"].mask | CONTROL["RESET"].mask)
    core.hold = False
    with pytest.raises(EstimateLostError):
        ukf.recover()
    ukf.reset()
    ukf.predict()


def test_recovering_without_need_changes_nothing(ukf):
    for predicted in (False, True):
        if predicted:
            ukf.predict(0.2)
        before = estimate(ukf)
        ukf.recover()
        assert estimate(ukf) == before
    twin = make()
    twin.predict(0.2)
    for each in (ukf, twin):
        each.update([2.0, 1.0])
    np.testing.assert_allclose(ukf.x, twin.x, atol=1e-9)


def test_shallow_copies_are_full_ones(ukf):
    ukf.predict(0.1)
    ukf.update([1.0, 2.0])
    before = estimate(ukf)
    twin = copy.copy(ukf)
    assert estimate(twin) == before
    assert twin.backend is not ukf.backend
    twin.x = [9.0, 9.0, 9.0]
    twin.P = np.eye(3)
    twin.gate = 1e-9
    assert estimate(ukf) == before
    assert ukf.update([1.5, 1.0]) is True


# What is masked or too large.


@pytest.mark.parametrize("z", [
    np.ma.masked_array([1.0, 99.0], mask=[False, True]),
    np.ma.masked_array([1.0, np.nan], mask=[False, True]),
])  # fmt: skip
def test_masked_elements_of_z_were_not_sampled(ukf, z):
    twin = copy.deepcopy(ukf)
    assert ukf.update(z)
    assert twin.update([1.0, 0.0], mask=[True, False])
    assert estimate(ukf) == estimate(twin)
    before = estimate(ukf)
    assert ukf.update(z, mask=[False, True]) is False
    ukf.mask = [False, True]
    assert ukf.update(z) is False
    assert estimate(ukf) == before


def test_a_masked_array_with_nothing_masked_is_an_array(ukf):
    assert ukf.update(np.ma.masked_array([1.0, 2.0]))
    ukf.x = np.ma.masked_array(X0)


MASKED = np.ma.masked_array(P0, mask=np.eye(3, dtype=bool))


@pytest.mark.parametrize(("name", "set_to"), [
    ("x", lambda ukf: setattr(ukf, "x", MASKED[0])),
    ("x", lambda ukf: ukf.reset(x=MASKED[0])),
    ("P", lambda ukf: setattr(ukf, "P", MASKED)),
    ("P", lambda ukf: setattr(ukf, "P", list(MASKED))),
    ("Q", lambda ukf: setattr(ukf, "Q", MASKED[:2, :2])),
    ("R", lambda ukf: setattr(ukf, "R", MASKED[:2, :2])),
    ("mask", lambda ukf: setattr(ukf, "mask", MASKED[0, :2] == 1.0)),
    ("mask", lambda ukf: ukf.update([1.0, 2.0], mask=MASKED[0, :2] == 1.0)),
    ("x0", lambda ukf: make(x0=MASKED[0])),
    ("P0", lambda ukf: make(P0=MASKED)),
])  # fmt: skip
def test_other_masked_arrays_are_refused(ukf, name, set_to):
    with pytest.raises(TypeError, match=f"^{name} must have no masked elements, not "):
        set_to(ukf)


def test_masked_results_of_a_model_are_refused(ukf):
    bad = make(f=lambda x, w, u: np.ma.masked_array(f(x, w, u), mask=[True, False, False]))
    message = f" must return no masked elements, at sigma point {FIRST}, not "
    with pytest.raises(TypeError, match=message):
        bad.predict()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("number_format", "z"), [
    (BINARY16, 1e15), (BFLOAT16, -1e39), (BINARY32, 1e39), (BINARY32, -1e200), (BINARY64, 1.7e308),
])  # fmt: skip
def test_a_gate_rejects_every_finite_z(backend, number_format, z):
    params = UkfParams(n=3, m=2, q=2, r=2, format=number_format)
    ukf = make(backend, params)
    ukf.predict()
    before = estimate(ukf)
    ukf.gate = 10.0
    assert ukf.update([1.0, z]) is False
    assert ukf.gated
    assert estimate(ukf) == before


def test_a_gate_of_the_reference_rejects_an_infinite_innovation():
    problem = Problem(
        name="far", f=lambda x, w, u: x, sensors=Sensor(lambda x, v: x, R=[[1.0]]),
        observation_noise=Noise.ADDITIVE, x0=[-(2.0**1023)], P0=[[1.0]],
    )  # fmt: skip
    ukf = UnscentedKalmanFilter(problem)
    with pytest.raises(NotFiniteError):
        ukf.update([1.7e308])
    ukf.gate = 10.0
    assert ukf.update([1.7e308]) is False
    assert ukf.gated


def test_without_a_gate_a_z_beyond_the_format_is_named():
    ukf = make("golden", UkfParams(n=3, m=2, q=2, r=2))
    before = estimate(ukf)
    message = "UPDATE met NaN or infinity: z is 1e+39 in row 1, and the format ends at 3.40282e+38"
    with pytest.raises(NotFiniteError, match=f"^{re.escape(message)}$"):
        ukf.update([1.0, 1e39])
    assert estimate(ukf) == before
    assert ukf.update([1.0, 1e39], mask=[True, False])


# Messages about covariances.


def test_covariances_that_come_from_float32_in_float64():
    g = np.array([0.1, 0.7, 0.3], dtype=np.float32)
    singular = np.outer(g, g).astype(np.float64)
    hint = "; if it comes from float32, its rounding is allowed for when given as float32"
    with pytest.raises(ValueError, match=rf"at least -\S+ is needed{hint}$"):
        make(P0=singular)
    make(P0=singular.astype(np.float32))
    lopsided = np.eye(3)
    lopsided[0, 1] = 1e-7
    with pytest.raises(ValueError, match=rf"at \(1, 0\), which may differ by 1e-09{hint}$"):
        make(P0=lopsided)
    make(P0=lopsided.astype(np.float32))


def test_a_definite_covariance_of_float16_names_the_bound():
    params = UkfParams(n=3, m=2, q=2, r=2, form=Form.COVARIANCE)
    P = np.array([[1.0, 0.99, 0.0], [0.99, 1.0, 0.0], [0.0, 0.0, 1.0]], dtype=np.float16)
    message = r"^P0 must be positive definite, .* is 0\.00\d+, and at least 0\.0117 is needed$"
    with pytest.raises(ValueError, match=message):
        make("golden", params, P0=P)


@pytest.mark.parametrize("backend", BACKENDS)
def test_variances_near_the_largest_number(backend):
    P = np.diag([1e308, 1.0, 1.0])
    np.testing.assert_allclose(make(backend, P0=P).P, P, rtol=1e-12)
    P[0, 1] = -1.7e308
    P[1, 0] = 1.7e308
    with pytest.raises(ValueError, match=r"^P0 must be symmetric, not -1\.7e\+308 at "):
        make(backend, P0=P)


def test_a_gate_beyond_float():
    message = r"^gate must be at most 1\.79769e\+308, the largest float, not an int of 1329 bits$"
    with pytest.raises(ValueError, match=message):
        make().gate = 10**400
