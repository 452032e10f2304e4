"""Constants of the filter that the core keeps in memory: weights and sigma coefficients.

Residuals of sigma points are not multiplied by the square roots of their weights. All weights but
that of point 0 are equal, W1, so the core works in units of sqrt(W1) instead: point 0's residual,
and the columns of additive noise, are the only ones that need a factor.
"""

from fractions import Fraction
from math import sqrt

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
    itself. So the last point takes what is left of 1, or point 0 where the last one cannot, or as
    many from the last one on as it needs. Only where the format has no such numbers, as with
    W0 = 1e-6 in bfloat16, does a part of the rounding error of the largest weight remain.
    """
    row = np.full(params.N, params.W1)
    row[0] = params.W0
    row = params.format.round(row)
    left = 1 - sum(map(Fraction, row))
    for points in ([params.N - 1], [0], range(params.N - 1, 0, -1)):
        given, rest = row.copy(), left
        for k in points:
            weight = params.format.round(float(Fraction(row[k]) + rest))
            if weight > 0:
                given[k], rest = weight, rest + Fraction(row[k]) - Fraction(float(weight))
        if not rest:
            break
    return given


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
