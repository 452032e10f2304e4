"""Mistakes with models on the core, each with its message.

What a single model must not do is a table in test_tracing_refusals.py, which this one goes on with:
what does not fit the problem, its data, the format or the numbers that a filter meets.
"""

import itertools
import time
from dataclasses import replace

import numpy as np
import pytest

from ukf_sw.errors import FormatOverflowError, ModelNotFiniteError, TraceError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.spec.float_format import BINARY16, FloatFormat

STEPS = 6
DATA = Data(
    times=0.1 * np.arange(1, STEPS + 1), measurements=np.zeros((STEPS, 1)),
    inputs=np.ones((STEPS, 1)),
)  # fmt: skip
DRAW = np.random.default_rng(1)
NUMBER = itertools.count()
ODD_FORMAT = FloatFormat(exponent_bits=6, fraction_bits=17)


def move(x, w, u):
    return np.array([x[0] + 0.1 * x[1], x[1] + u[0]]) + w


def see(x, v):
    return x[:1] + v


def see_with(x, v, *, gain, kind="near"):
    return gain * x[:1] * (2.0 if kind == "far" else 1.0) + v


def problem_of(f=move, h=see, m=None, **changes):
    options = {"data": DATA, "x0": [0.3, 0.1]} | changes
    return Problem(
        name="mine", f=f, sensors=Sensor(h, R=[[1.0]], m=m), Q=1e-3 * np.eye(2),
        P0=1e-4 * np.eye(2), **options,
    )  # fmt: skip


def filter_of(*arguments, models="core", **changes):
    return UnscentedKalmanFilter(problem_of(*arguments, **changes), "golden", models=models)


def see_at(x, v, *, step):
    return x[:1] * step + v


TWO_KINDS = replace(
    DATA,
    observation_arguments=[{"gain": 1.0, "kind": ("near", "far")[k % 2]} for k in range(STEPS)],
)
#: Observations are not counted by a call of h.
COUNTED = {"m": 1}


def long_data():
    """Data that count their steps by an argument of h."""
    count = 20
    return Data(
        times=0.1 * np.arange(1, count + 1), measurements=np.zeros((count, 1)),
        inputs=np.ones((count, 1)), observation_arguments=[{"step": k} for k in range(count)],
    )  # fmt: skip


def drawn(x, w, u):
    """What draws is written in C, and takes its array from NumPy."""
    out = np.empty(2)
    out[:] = x + w + 1e-3 * DRAW.normal(size=2)
    return out


def drawn_anew(x, w, u):
    return x + w + np.random.default_rng().exponential(1e-3, 2)


def counted(x, w, u):
    return x + w * next(NUMBER)


def by_the_clock(x, w, u):
    return x + w + 1e-9 * time.perf_counter()


def none_given(x, w, u):
    x[0] = x[0] + w[0]


DRAWN = "must not keep a state or draw random numbers, as two calls differ in row 0; let"

#: Models that are refused: their mistake, how it is made, and what is said.
REFUSED = {
    "random numbers of a generator": (lambda: filter_of(drawn), TraceError, DRAWN),
    "random numbers of a new generator": (lambda: filter_of(drawn_anew), TraceError, DRAWN),
    "a counter": (lambda: filter_of(counted), TraceError, DRAWN),
    "the time of day": (lambda: filter_of(by_the_clock), TraceError, DRAWN),
    "nothing returned": (
        lambda: filter_of(none_given), TypeError,
        "process model f (none_given) must return real numbers, at a sigma point, not None",
    ),
    "too many rows": (
        lambda: filter_of(lambda x, w, u: [x[0], x[1], w[0]]), ValueError,
        "must return the shape (2,), at a sigma point, not (3,)",
    ),
    "shapes that do not agree": (
        lambda: filter_of(lambda x, w, u: np.eye(3) @ x), ValueError,
        "shapes must agree, not (3, 3) and (2,)",
    ),
    "no u": (
        lambda: filter_of(lambda x, w: x + w), TypeError,
        "process model f (<lambda>) must take (x, w, u), not (x, w)",
    ),
    "no v": (
        lambda: filter_of(h=lambda x: x[:1]), TypeError,
        "observation model h (<lambda>) must take (x, v), not (x)",
    ),
    "a branch in h": (
        lambda: filter_of(h=lambda x, v: x[:1] if x[0] > 0.0 else v), TraceError,
        "observation model h (<lambda>) must not branch on data, as in `x[0] > 0.0`",
    ),
    "an input of another shape in the data": (
        lambda: filter_of(data=replace(DATA, inputs=[[1.0], [1.0, 2.0], *[[1.0]] * 4])),
        ValueError,
        "u must have the same shape in every step to be traced, not [()] and then [(), ()]",
    ),
    "text as an input": (
        lambda: filter_of(data=replace(DATA, inputs=["left"] * STEPS)), TypeError,
        "u must be None, a number, an array, or a tuple, list or dict of them, to be traced",
    ),
    "a constant beyond the format": (
        lambda: filter_of(lambda x, w, u: x * 1e6 + w, format=BINARY16), FormatOverflowError,
        "each constant of f must be at most 65504, the largest number of the format, not 1000000.0",
    ),
    "constants that become one beyond the format": (
        lambda: filter_of(lambda x, w, u: x * (300.0 * 300.0) + w, format=BINARY16),
        FormatOverflowError, "must be at most 65504, the largest number of the format, not 90000.0",
    ),
    "a function in a format without coefficients": (
        lambda: filter_of(lambda x, w, u: np.sin(x) + w, format=ODD_FORMAT), ValueError,
        "format of elementary functions must be one of binary16, bfloat16, binary32, binary64",
    ),
    "no inputs in the data": (
        lambda: filter_of(data=replace(DATA, inputs=None)), TypeError,
        ("'NoneType' object is not subscriptable\n"
        "in process model f (move), traced with x of shape (2,), w of shape (2,) and u like None\n"
        "u is None: there are no inputs in the data of the problem, or no names"),
    ),
    "neither data nor names of inputs": (
        lambda: filter_of(data=None), TypeError, "u is None: there are no inputs in the data",
    ),
    "fewer names of inputs than inputs": (
        lambda: filter_of(lambda x, w, u: x * u[1] + w, data=None, inputs=("force",)), IndexError,
        ("index 1 is out of bounds for axis 0 with size 1\nin process model f (<lambda>), traced "
        "with x of shape (2,), w of shape (2,) and u of shape (1,)"),
    ),
    "an argument of h that the data do not have": (
        lambda: filter_of(h=see_with, **COUNTED), TypeError,
        ("see_with() missing 1 required keyword-only argument: 'gain'\n"
        "in observation model h (see_with), traced with x of shape (2,) and v of shape (1,)"),
    ),
    "a number of steps as a whole number": (
        lambda: filter_of(h=see_at, data=long_data(), **COUNTED), ValueError,
        ("observation model h (see_at) must be called with at most 16 combinations of constants, "
        "not 20 of step: each is a program of its own, so let numbers that change be floats"),
    ),
    "models in no place": (
        lambda: filter_of(models="cores"), ValueError,
        "models must be 'core', 'software', 'f', 'h', or a dict as {'f': 'core'}, not 'cores'",
    ),
    "no such model": (
        lambda: filter_of(models={"g": "core"}), ValueError, "models must be 'core', 'software'",
    ),
    "models as a list": (
        lambda: filter_of(models=["f"]), TypeError, "models must be a str or a dict, not ['f']",
    ),
    "the reference has no core": (
        lambda: UnscentedKalmanFilter(problem_of(), "reference", models="core"), ValueError,
        "models must be in software for a backend 'reference'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_does_not_fit_is_refused(mistake):
    make, error, message = REFUSED[mistake]
    with pytest.raises(error) as caught:
        make()
    assert message in "\n".join([str(caught.value), *getattr(caught.value, "__notes__", [])])


# What a filter is given, or meets, when its models are on the core.


def near(x, w, u):
    return np.array([np.log(x[0]) + u[0], np.arcsin(x[1])]) + w


def far(x, w, u):
    return np.array([np.sin(1e6 * u[0] * x[0]), x[1] / (x[0] - x[0] + u[0] - 1.0)]) + w


#: What is done to a filter, with its models, its error, and what is said.
GIVEN = {
    "input that is NaN": ({}, lambda ukf: ukf.predict([np.nan]), ValueError,
                          "u[0] must be finite, not nan"),
    "infinite input": ({}, lambda ukf: ukf.predict([np.inf]), ValueError,
                       "u[0] must be finite, not inf"),
    "input beyond the format": (
        {}, lambda ukf: ukf.predict([1e39]), FormatOverflowError,
        "f: u[0] must be at most 3.40282e+38, the largest number of the format, not 1e+39",
    ),
    "no input": ({}, lambda ukf: ukf.predict(), ValueError,
                 "u must have the shape with which process model f (move) was traced, (1,)"),
    "two inputs": ({}, lambda ukf: ukf.predict([1.0, 2.0]), ValueError,
                   "process model f (move) was traced, (1,), not (2,)"),
    "a number for a vector": ({}, lambda ukf: ukf.predict(1.0), ValueError, "(1,), not ()"),
    "lists of different lengths": ({}, lambda ukf: ukf.predict([[1.0], [1.0, 2.0]]), ValueError,
                                   "(1,), not [[()], [(), ()]]"),
    "text": ({}, lambda ukf: ukf.predict(["left"]), TypeError,
             "u[0] must be a real number, not np.str_('left')"),
    "an argument of f": ({}, lambda ukf: ukf.predict([1.0], dt=0.1), TypeError,
                         "predict must have no arguments beside u with f on the core, not ['dt']"),
    "an argument that h has not": (
        {}, lambda ukf: ukf.iterate([1.0], [0.2], gain=1.0), TypeError,
        "update must have the arguments of h as traced, [], not ['gain']",
    ),
    "no argument of h": (
        {"h": see_with}, lambda ukf: ukf.iterate([1.0], [0.2], gain=1.0), TypeError,
        "update must have the arguments of h as traced, ['gain', 'kind'], not ['gain']",
    ),
    "a constant that was not in the data": (
        {"h": see_with}, lambda ukf: ukf.iterate([1.0], [0.2], gain=1.0, kind="between"),
        ValueError, ("constants of h must be those of a program on the core, {'kind': 'near'}, "
        "{'kind': 'far'}, not {'kind': 'between'}"),
    ),
    "an argument that is NaN": (
        {"h": see_with}, lambda ukf: ukf.iterate([1.0], [0.2], gain=np.nan, kind="far"),
        ValueError, "gain must be finite, not nan",
    ),
    "logarithm of what is negative": (
        {"f": near, "x0": [-0.3, 0.1]}, lambda ukf: ukf.predict([1.0]), ModelNotFiniteError,
        "F met NaN or infinity: f gave it in row 0 of x",
    ),
    "arcsine of more than 1": (
        {"f": near, "x0": [0.9, 1.1]}, lambda ukf: ukf.predict([1.0]), ModelNotFiniteError,
        "F met NaN or infinity: f gave it in row 1 of x",
    ),
    "sine of a very large angle": (
        {"f": far}, lambda ukf: ukf.predict([2.0]), ModelNotFiniteError,
        "F met NaN or infinity: f gave it in row 0 of x",
    ),
    "division by zero": (
        {"f": far}, lambda ukf: ukf.iterate([1.0 + 2**-60], [0.2]), ModelNotFiniteError,
        "ITERATE met NaN or infinity: f gave it in row 0 of x",
    ),
    "infinite observation": (
        {"h": lambda x, v: np.exp(1e3 * np.abs(x[:1])) + v},
        lambda ukf: ukf.iterate([1.0], [0.2]), ModelNotFiniteError,
        "ITERATE met NaN or infinity: h gave it in row 0 of z",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", GIVEN)
def test_what_a_filter_is_given_is_refused_and_nothing_is_lost(mistake):
    changes, do, error, message = GIVEN[mistake]
    if changes.get("h") is see_with:
        changes = changes | {"data": TWO_KINDS, **COUNTED}
    ukf, twin = filter_of(**changes), filter_of(**changes)
    with pytest.raises(error) as caught:
        do(ukf)
    assert message in str(caught.value)
    if "row 0 of z" in message:  # what came before the observation is done
        twin.predict([1.0])
    assert (ukf.x.tolist(), ukf.P.tolist()) == (twin.x.tolist(), twin.P.tolist())


def test_there_are_enough_mistakes():
    assert len(REFUSED) + len(GIVEN) >= 25
