"""Accuracy of the elementary functions against MPFR, and that the documents say what it is."""

import numpy as np
import pytest

from ukf_docs.studies.elementary import (
    DOMAINS,
    EXACT,
    STUDY,
    arguments_of,
    errors,
    every_number,
    is_inside,
    measure_function,
    points,
    worst,
)
from ukf_sw.elementary.functions import FUNCTIONS, sequence
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FORMATS

ALL_FORMATS = pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
#: What binary32 must reach, in units in the last place.
LIMITS = {
    "tan": 4.5, "arctan": 4.5, "arctan2": 4.5, "arcsin": 4.5, "arccos": 4.5, "tanh": 4.5,
    "divide": 3.5, "hypot": 3.0, "power": 20.0,
}  # fmt: skip


@ALL_FORMATS
@pytest.mark.parametrize("name", EXACT)
def test_errors_are_no_larger_than_the_documents_say(name, fmt):
    noted = STUDY.read()[name][fmt.name]
    arguments = points(name, fmt, 60, np.random.default_rng(20))
    if FUNCTIONS[name].arguments == 1:  # hostile ones come first
        arguments = [np.random.default_rng(21).permutation(arguments[0])[:2500]]
    error, place = worst(name, fmt, arguments)
    assert error <= noted["error"] + 0.005, place
    steps = sequence(name, fmt)
    assert (steps.slots, steps.loads) == (noted["slots"], noted["loads"])


@pytest.mark.slow
@ALL_FORMATS
@pytest.mark.parametrize("name", EXACT)
def test_what_the_documents_say_is_measured(name, fmt):
    """On all numbers there are, for functions of one argument in 16 bits."""
    assert measure_function(name, fmt) == STUDY.read()[name][fmt.name]


def test_binary32_reaches_its_limits():
    for name, measured in STUDY.read().items():
        assert measured["binary32"]["error"] <= LIMITS.get(name, 2.5), name
    assert set(STUDY.read()) == set(EXACT) == set(DOMAINS)


def test_quotients_by_numbers_that_are_not_huge_are_as_good_as_others():
    """Of a divisor beyond, the correction of its reciprocal is flushed."""
    rng = np.random.default_rng(23)
    a, x = points("divide", BINARY32, 3000, rng)
    limit = 2.0 ** (BINARY32.bias - 1 - BINARY32.fraction_bits)
    usual = np.abs(x) < limit
    error, place = worst("divide", BINARY32, [a[usual], x[usual]])
    assert error <= 2.5, place
    a, x = BINARY32.round(rng.uniform(1.0, 2.0, (2, 50_000)))
    assert worst("divide", BINARY32, [a, x])[0] <= 2.5
    beyond, _ = worst("divide", BINARY32, [a * limit, x * 2.0**20 * limit])
    assert beyond > 2.5


@pytest.mark.parametrize("name", ["sin", "cos", "sincos", "tan"])
def test_angles_beside_every_zero_and_pole(name):
    """All multiples of an eighth turn, where the reduction has to be best."""
    noted = STUDY.read()[name]["binary32"]["error"]
    x = BINARY32.round(np.arange(-4100, 4101) * (np.pi / 4))
    error, place = worst(name, BINARY32, [x])
    assert error <= noted + 0.005, place


def test_errors_are_seen():
    """By one unit, at least, what a result is wrong by."""
    x = np.array([0.5, 2.0, 3.0])
    right = errors("sqrt", BINARY32, x)
    assert (right < 2.0).all()
    for name, wrong in (("exp", "log"), ("sin", "tanh"), ("arcsin", "sin")):
        measured = errors_of(name, wrong, np.array([0.75]))
        assert measured > 1e5


def errors_of(name, wrong, x):
    """Errors of one function if another one takes its place."""
    from ukf_docs.studies import elementary

    exact = {**elementary.EXACT, wrong: elementary.EXACT[name]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(elementary, "EXACT", exact)
        return errors(wrong, BINARY32, x)[0]


def test_what_an_error_is():
    import gmpy2

    from ukf_docs.studies.elementary import _error

    def error(fmt, exact, found, inside=True, early=1.0):
        return _error(fmt, gmpy2.mpfr(exact), found, inside=inside, early=early)

    inf, nan, tiny, huge = np.inf, np.nan, BINARY32.min_normal, BINARY32.max_finite
    assert error(BINARY32, 1.0, 1.0 + 2.0**-23) == 1.0
    assert error(BINARY32, 2.0 - 2.0**-23, 2.0) == 1.0
    assert error(BINARY16, -3.0, -3.0 + 2.0**-9) == 1.0
    # NaN, where there is a number, and a number, where there is none.
    assert error(BINARY32, 1.0, nan) == inf
    assert error(BINARY32, 1.0, nan, inside=False) == 0.0
    assert error(BINARY32, nan, nan) == 0.0
    assert error(BINARY32, nan, 1.0) == error(BINARY32, nan, 0.0, inside=False) == inf
    # Infinities, and signs of them.
    assert error(BINARY32, inf, inf) == error(BINARY32, -2.0 * huge, -inf) == 0.0
    assert error(BINARY32, inf, -inf) == error(BINARY32, huge / 2, inf) == inf
    assert error(BINARY32, inf, huge) == inf
    # What is flushed.
    assert error(BINARY32, tiny / 2, 0.0) == error(BINARY32, -tiny * 0.99, 0.0) == 0.0
    assert error(BINARY32, tiny * 1.4, 0.0) > 1e6
    assert error(BINARY32, tiny * 1.4, 0.0, early=2.0**0.5) == 0.0
    assert error(BINARY32, 0.0, tiny) == 1.0


def test_points_are_hostile():
    rng = np.random.default_rng(22)
    for name in EXACT:
        for fmt in FORMATS.values():
            rows = points(name, fmt, 30, rng)
            assert len(rows) == FUNCTIONS[name].arguments
            inside = is_inside(name, fmt, rows)
            assert inside.sum() > 50
            for row in rows:
                np.testing.assert_array_equal(row, fmt.round(row))
            if name != "power":
                assert {0.0, np.inf, -np.inf, fmt.max_finite} <= set(rows[0])
                assert np.isnan(rows[0]).any()
            if name in ("sin", "tan", "reciprocal", "sqrt", "log", "hypot", "arctan2"):
                assert not inside.all()
    (x,) = points("sin", BINARY32, 5000, rng)
    x = x[np.isfinite(x)]
    near = np.abs(x / np.pi - np.rint(x / np.pi)) < 1e-5
    assert (near & (np.abs(x) > 1.0)).sum() > 500
    assert every_number(BINARY16).size == 2 * (30 * 1024 + 1 + 1) + 1
    assert every_number(BFLOAT16).size == 2 * (254 * 128 + 1 + 1) + 1
    assert arguments_of("sin", BINARY64, 5, rng)[0].size < 1e5
