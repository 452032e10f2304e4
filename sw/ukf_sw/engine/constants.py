"""Constants of the filter that the core keeps in memory: weights and sigma coefficients.

Residuals of sigma points are not multiplied by the square roots of their weights. All weights but
that of point 0 are equal, W1, so the core works in units of sqrt(W1) instead: point 0's residual,
and the columns of additive noise, are the only ones that need a factor.
"""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ukf_sw.spec.parameters import UkfParams

__all__ = ["noise_coefficients", "state_coefficients", "unit", "weights"]


def _W1(params: UkfParams) -> float:
    """Weight of every sigma point but point 0 (2018, equation 5)."""
    return (1.0 - params.W0) / (params.M + 1)


def unit(params: UkfParams) -> float:
    """Unit of residuals and of the working copy of the factor: the square root of W1."""
    return sqrt(_W1(params))


def weights(params: UkfParams) -> NDArray[np.float64]:
    """Weights of the sigma points, shape (N,) (2018, equation 5)."""
    row = np.full(params.N, _W1(params))
    row[0] = params.W0
    return row


def _coefficients(params: UkfParams, j: int) -> NDArray[np.float64]:
    """Row j (from 1) of the spherical simplex coefficients, shape (N,) (2018, equation 7)."""
    a = 1.0 / sqrt(j * (j + 1) * _W1(params))
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
