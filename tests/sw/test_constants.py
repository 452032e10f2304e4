"""Weights of the sigma points as the core has them."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from ukf_sw.engine.constants import weights
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.pendulum import pendulum
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.parameters import UkfParams

FORMATS = [BINARY16, BFLOAT16, BINARY32, BINARY64, FloatFormat(exponent_bits=6, fraction_bits=17)]


@pytest.mark.parametrize("number_format", FORMATS)
@pytest.mark.parametrize("W0", [0.0, 0.1, 1 / 3, 0.5, 0.9])
def test_weights_sum_to_one_exactly(number_format, W0):
    for M in [*range(1, 33), 40, 63, 64, 65, 96]:
        n, q = min(M, 32), min(max(M - 32, 0), 32)
        params = UkfParams(n=n, m=1, q=q, r=M - n - q, W0=W0, format=number_format)
        assert params.M == M
        row = weights(params)
        np.testing.assert_array_equal(row, number_format.round(row))
        assert sum(map(Fraction, row)) == 1
        # Those that took nothing are W0 and W1, rounded; few take anything.
        exact = np.array([W0] + [params.W1] * (M + 1))
        changed = row != number_format.round(exact)
        assert changed.sum() <= 1 + M // 8
        assert np.abs(row - exact).max() <= (M + 2) * number_format.epsilon * max(exact)


def test_what_the_format_cannot_give_stays_within_a_rounding_error():
    """W0 is smaller than a unit in the last place of the other weights."""
    row = weights(UkfParams(n=2, m=1, W0=1e-6, format=BFLOAT16))
    assert 0 < abs(sum(map(Fraction, row)) - 1) < BFLOAT16.epsilon / 4


@pytest.mark.parametrize(("W0", "number_format"), [(0.999, BINARY16), (1 - 2**-52, BINARY16)])
def test_weights_below_the_format_are_refused(W0, number_format):
    with pytest.raises(ValueError, match=r"^W0 must leave each other sigma point a weight of at"):
        UkfParams(n=32, m=1, W0=W0, format=number_format)


@pytest.mark.parametrize("W0", [0.0, 0.3])
def test_means_are_not_biased(W0):
    """With weights that only were rounded these differences were two to seven times as large."""
    scenario = pendulum(0, steps=200)
    pes = scenario.params.columns
    scenario = replace(scenario, W0=W0, pes=pes)
    difference = run(scenario, "golden").x - run(scenario, "reference").x
    assert (np.sqrt(np.mean(np.square(difference), axis=0)) < [1e-6, 2e-6]).all()
