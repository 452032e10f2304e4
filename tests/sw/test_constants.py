"""Weights of the sigma points as the core has them."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from ukf_sw.engine.constants import weights
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.pendulum import pendulum
from ukf_sw.reference import sigma_coefficients
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.float_format import FORMATS as NAMED
from ukf_sw.spec.parameters import UkfParams

FORMATS = [BINARY16, BFLOAT16, BINARY32, BINARY64, FloatFormat(exponent_bits=6, fraction_bits=17)]


@pytest.mark.parametrize("number_format", FORMATS)
@pytest.mark.parametrize("W0", [0.0, 1e-6, 1e-3, 0.1, 1 / 3, 0.5, 0.9, 0.99, 0.999])
def test_weights_sum_to_one_exactly(number_format, W0):
    for M in [*range(1, 33), 40, 63, 64, 65, 96]:
        n, q = min(M, 32), min(max(M - 32, 0), 32)
        try:
            params = UkfParams(n=n, m=1, q=q, r=M - n - q, W0=W0, format=number_format)
        except ValueError:
            continue  # the format does not have so small a W1
        assert params.M == M
        row = weights(params)
        np.testing.assert_array_equal(row, number_format.round(row))
        assert (row >= 0.0).all()
        assert sum(map(Fraction, row)) == 1
        # Point 0 has W0, but for a rounding error of the largest weight.
        assert abs(row[0] - W0) <= number_format.epsilon * max(W0, params.W1)
        # The others are equal, but for a unit in the last place.
        assert np.ptp(row[1:]) <= number_format.epsilon * row[1:].max()


@pytest.mark.parametrize("number_format", NAMED.values(), ids=NAMED)
def test_without_W0_point_0_has_no_weight_at_all(number_format):
    """So nothing is lost where it is left out: what rounding leaves goes to the others."""
    legal = 0
    for M in range(1, 97):
        n, q = min(M, 32), min(max(M - 32, 0), 32)
        try:
            params = UkfParams(n=n, m=1, q=q, r=M - n - q, format=number_format)
        except ValueError:
            continue
        assert params.M == M
        legal += 1
        row = weights(params)
        assert row[0] == 0.0
        assert len(row[1:]) == len(params.points)
        assert sum(map(Fraction, row[1:])) == 1
        assert (row[1:] > 0.0).all()
    assert legal == 96


@pytest.mark.parametrize("number_format", [BFLOAT16, BINARY16, BINARY32])
@pytest.mark.parametrize(("n", "W0"), [(15, 0.9), (15, 0.0), (31, 0.9), (20, 0.0), (6, 1 / 3)])
def test_the_mean_of_the_sigma_points_is_not_shifted(number_format, n, W0):
    """With all that is left on one point it was up to 0.02 standard deviations in bfloat16."""
    params = UkfParams(n=n, m=1, W0=W0, format=number_format)
    shift = sigma_coefficients(n, W0) @ weights(params)
    assert np.abs(shift).max() < 0.25 * number_format.epsilon


@pytest.mark.parametrize(("W0", "number_format"), [(0.999, BINARY16), (1 - 2**-52, BINARY16)])
def test_weights_below_the_format_are_refused(W0, number_format):
    with pytest.raises(ValueError, match=r"^W0 must leave each other sigma point a weight of at"):
        UkfParams(n=32, m=1, W0=W0, format=number_format)


@pytest.mark.parametrize("W0", [0.0, 0.3])
def test_means_are_not_biased(W0):
    """With weights that only were rounded these differences were two to seven times as large.

    Rounding errors of sums differ by data and order, so they are taken over some of both.
    """
    squares = []
    for seed in range(4):
        scenario = replace(pendulum(seed, steps=200), W0=W0)
        expected = run(scenario, "reference").x
        for pes in (1, 3):
            squares.append(np.square(run(replace(scenario, pes=pes), "golden").x - expected))
    assert (np.sqrt(np.mean(squares, axis=(0, 1))) < [1e-6, 2e-6]).all()
