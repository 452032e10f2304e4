"""Constants of the filter that the core keeps in memory: weights and sigma coefficients."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ukf_sw.parameters import UkfParams

__all__ = ["noise_coefficients", "state_coefficients", "weights"]


def _W1(params: UkfParams) -> float:
    """Weight of every sigma point but point 0 (2018, equation 5)."""
    return (1.0 - params.W0) / (params.M + 1)


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

    Returns
    -------
    list of n arrays of shape (n + 2,)
    """
    return [_coefficients(params, j)[: params.n + 2] for j in range(1, params.n + 1)]


def noise_coefficients(params: UkfParams) -> list[NDArray[np.float64]]:
    """Coefficients of the augmented noise terms, w before v.

    Returns
    -------
    list of M - n arrays of shape (N,)
    """
    return [_coefficients(params, j) for j in range(params.n + 1, params.M + 1)]
