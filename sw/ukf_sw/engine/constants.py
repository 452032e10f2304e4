"""Constants of the filter that the core keeps in memory: weights and sigma coefficients.

Residuals of sigma points are not multiplied by the square roots of their weights. All weights but
that of point 0 are equal, W1, so the core works in units of sqrt(W1) instead: point 0's residual,
and the columns of additive noise, are the only ones that need a factor.
"""

from fractions import Fraction
from math import frexp, sqrt

import numpy as np
from numpy.typing import NDArray

from ukf_sw.spec.parameters import UkfParams

__all__ = ["noise_coefficients", "state_coefficients", "unit", "weights"]


def unit(params: UkfParams) -> float:
    """Unit of residuals and of the working copy of the factor: the square root of W1."""
    return sqrt(params.W1)


def weights(params: UkfParams) -> NDArray[np.float64]:
    """Weights of the sigma points in the format, shape (N,) (2018, equation 5).

    Rounded weights need not sum to 1, and a sum that is not 1 shifts every mean by that part of
    itself. So the others share what the rounded W0 leaves, and their rounding errors are made up
    for by the points from the last one on, a unit in the last place each: in a single one they
    would shift the mean of the sigma points towards that point. What is less than a unit goes to
    point 0, whose weight is small then. So the sum is exactly 1.
    """
    fmt = params.format
    W0 = Fraction(float(min(fmt.round(params.W0), 1.0 - fmt.epsilon / 2.0)))
    row = fmt.round(np.array([float(W0)] + [float((1 - W0) / (params.M + 1))] * (params.M + 1)))
    left = 1 - sum(map(Fraction, row))
    given = True
    while left and given:
        given = False
        for k in range(params.M + 1, 0, -1):
            unit = Fraction(2) ** (frexp(row[k])[1] - 1 - fmt.fraction_bits)
            weight = float(Fraction(row[k]) + (unit if left > 0 else -unit))
            if abs(left) >= unit and weight >= fmt.min_normal:
                row[k], left, given = weight, left + Fraction(row[k]) - Fraction(weight), True
    row[0] = float(Fraction(row[0]) + left)
    return row


def _coefficients(params: UkfParams, j: int) -> NDArray[np.float64]:
    """Row j (from 1) of the spherical simplex coefficients, shape (N,) (2018, equation 7)."""
    a = 1.0 / sqrt(j * (j + 1) * params.W1)
    row = np.zeros(params.N)
    row[1 : j + 1] = -a
    row[j + 1] = j * a
    return row


def state_coefficients(params: UkfParams) -> list[NDArray[np.float64]]:
    """Coefficients of the states, up to the last column that can differ from zero.

    They are multiplied by the unit, for they meet the working copy of the factor.

    Returns
    -------
    list of n arrays of shape (n + 2,)
    """
    return [unit(params) * _coefficients(params, j)[: params.n + 2] for j in range(1, params.n + 1)]


def noise_coefficients(params: UkfParams) -> list[NDArray[np.float64]]:
    """Coefficients of the augmented noise terms, w before v.

    Returns
    -------
    list of M - n arrays of shape (N,)
    """
    return [_coefficients(params, j) for j in range(params.n + 1, params.M + 1)]
