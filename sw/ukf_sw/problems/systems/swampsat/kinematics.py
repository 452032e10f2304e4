"""Attitude kinematics with the paper's conventions."""

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problems.systems.nanosat import multiply, rotation_matrix

__all__ = ["attitude_matrix", "cross_matrix", "propagate"]

Array = NDArray[np.float64]


def attitude_matrix(q: Array) -> Array:
    """Matrix C_BI of quaternions (4, ...), inertial to body: (3, 3, ...) (equation 4).

    It is multiplied by the squared length of a quaternion that is not of unit length.
    """
    return np.swapaxes(rotation_matrix(q), 0, 1)


def cross_matrix(a: Array) -> Array:
    """Matrix [a x] of a vector, shape (3,): ``cross_matrix(a) @ b`` is the cross product."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def propagate(q: Array, rates: Array, dt: Array | float) -> Array:
    """Turn quaternions with a constant body rate (equation 14); the length is kept.

    Parameters
    ----------
    q
        Quaternions, shape (4, ...).
    rates
        Body rates, shape (3, ...), rad/s.
    dt
        Time, s, of a shape that broadcasts.

    Returns
    -------
    array of shape (4, ...)
    """
    half = 0.5 * dt * np.sqrt(rates[0] * rates[0] + rates[1] * rates[1] + rates[2] * rates[2])
    # sin(half) / |rates|, also at rest; numpy's sinc has a factor pi.
    psi = (0.5 * dt * np.sinc(half / np.pi)) * rates
    return multiply(q, np.array([psi[0], psi[1], psi[2], np.cos(half)]))
