"""Models of SwampSat for the unscented Kalman filter core.

The state is (q1, q2, q3, q4, beta), quaternion and gyroscope bias in rad/s; the process noise has
the same seven terms, the observation noise six: M = 20. The quaternion is never normalised: its
length is observed, because z = A(q) r grows with it, and normalising sigma points diverges.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.models import ObservationModel, ProcessModel
from ukf_sw.problems.systems.swampsat.kinematics import propagate
from ukf_sw.spec.parameters import UkfParams

__all__ = [
    "OBSERVATIONS",
    "STATES",
    "SWAMPSAT",
    "UkfEstimator",
    "observation_model",
    "process_covariance",
    "process_model",
]

Array = NDArray[np.float64]

#: All noise augmented, as in the papers on the core: M = 20, N = 22; ten processing elements.
SWAMPSAT = UkfParams(n=7, m=6, q=7, r=6, pes=10)
#: Names and units of the states, and names of the observations.
STATES = {
    "q1": "", "q2": "", "q3": "", "q4": "",
    "bias x": "rad/s", "bias y": "rad/s", "bias z": "rad/s",
}  # fmt: skip
OBSERVATIONS = ("Sun x", "Sun y", "Sun z", "field x", "field y", "field z")


def _move(x: Array, w: Array, u: Array, *, time: float) -> Array:
    rates = np.array([u[0] - x[4], u[1] - x[5], u[2] - x[6]])
    moved = x + w
    moved[:4] = propagate(x[:4], rates, time) + w[:4]
    return moved


def process_model(dt: float) -> ProcessModel:
    """Process model f(x, w, u): the exact step of equation 14, plus w.

    The input u is the gyroscope's sample, shape (3,), in rad/s. The keyword argument ``time``
    replaces dt for one step; w is then that of such a step.

    Parameters
    ----------
    dt
        Sampling interval of the gyroscope, s.
    """
    return partial(_move, time=dt)


def process_covariance(sigma_v: float, sigma_u: float, dt: float) -> Array:
    """Covariance of w, shape (7, 7).

    An angle alpha moves the quaternion by alpha / 2, hence sigma_v^2 dt / 4.

    Parameters
    ----------
    sigma_v
        Angle random walk, rad/sqrt(s).
    sigma_u
        Rate random walk, rad/s/sqrt(s).
    dt
        Sampling interval of the gyroscope, s.
    """
    return np.diag([sigma_v**2 * dt / 4.0] * 4 + [sigma_u**2 * dt] * 3)


def _observe(x: Array, v: Array, references: Array) -> Array:
    q1, q2, q3, q4 = x[:4]
    s1, s2, s3, s4 = q1 * q1, q2 * q2, q3 * q3, q4 * q4
    xy, zw, xz = 2.0 * q1 * q2, 2.0 * q3 * q4, 2.0 * q1 * q3
    yw, yz, xw = 2.0 * q2 * q4, 2.0 * q2 * q3, 2.0 * q1 * q4
    xx, yy, zz = s4 + s1 - s2 - s3, s4 - s1 + s2 - s3, s4 - s1 - s2 + s3
    z = np.array(v)
    for row, (rx, ry, rz) in zip((0, 3), references, strict=True):
        z[row] += xx * rx + (xy + zw) * ry + (xz - yw) * rz
        z[row + 1] += (xy - zw) * rx + yy * ry + (yz + xw) * rz
        z[row + 2] += (xz + yw) * rx + (yz - xw) * ry + zz * rz
    return z


def observation_model() -> ObservationModel:
    """Observation model h(x, v, references): directions in the body frame (equation 1).

    The keyword argument ``references`` has the directions of Sun and field, inertial, shape (2, 3).
    """
    return _observe


class UkfEstimator:
    """A filter as the estimator of :mod:`ukf_sw.problems.systems.swampsat.platform`.

    Parameters
    ----------
    ukf
        Filter with the models of this module.
    sigma_v, sigma_u
        Angle random walk, rad/sqrt(s), and rate random walk, rad/s/sqrt(s).
    """

    def __init__(self, ukf: UnscentedKalmanFilter, sigma_v: float, sigma_u: float) -> None:
        self._ukf = ukf
        self._sigma = sigma_v, sigma_u
        self._time = 0.0

    @property
    def q(self) -> Array:
        """Attitude, inertial to body, shape (4,); its length is close to 1."""
        return self._ukf.x[:4]

    @property
    def bias(self) -> Array:
        """Bias of the gyroscope, shape (3,), rad/s."""
        return self._ukf.x[4:]

    def predict(self, gyroscope: Array, dt: float) -> None:
        """Propagate by a time dt, s, with a sample of the gyroscope, shape (3,), rad/s."""
        # Slots differ by rounding, and every change of Q costs a factorisation.
        if abs(dt - self._time) > 1e-9:
            self._ukf.Q = process_covariance(*self._sigma, dt)
            self._time = dt
        self._ukf.predict(gyroscope, time=dt)

    def update(self, measured: Array, references: Array, mask: NDArray[np.bool_]) -> None:
        """Correct with directions in body and inertial frame, shape (2, 3); mask has shape (2,)."""
        self._ukf.update(measured.reshape(6), np.repeat(mask, 3), references=references)
