"""Murrell's version of the extended Kalman filter (figure 4, equations 4 to 15).

Six states: three attitude errors and three bias errors. The quaternion is kept beside them.
Directions are processed one after the other, so that no matrix larger than 3 by 3 is inverted.
"""

from math import cos, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.problems.systems.nanosat import multiply
from ukf_sw.problems.systems.swampsat.kinematics import attitude_matrix, cross_matrix, propagate
from ukf_sw.problems.systems.swampsat.quest import quest

__all__ = ["MurrellEkf", "process_noise", "transition_matrix"]

Array = NDArray[np.float64]

#: Below this angle, in rad, the series of sine and cosine replace their differences.
SMALL_ANGLE = 1e-3


def transition_matrix(rates: Array, dt: float) -> Array:
    """Transition matrix Phi of the errors, shape (6, 6) (below equation 15).

    Parameters
    ----------
    rates
        Body rates, shape (3,), rad/s.
    dt
        Sampling interval, s.
    """
    W = cross_matrix(rates)
    WW = W @ W
    rate = float(np.sqrt(rates @ rates))
    angle = rate * dt
    if angle < SMALL_ANGLE:
        first, second = dt * (1.0 - angle**2 / 6.0), dt**2 * (0.5 - angle**2 / 24.0)
        third = dt**3 * (1.0 / 6.0 - angle**2 / 120.0)
    else:
        first, second = sin(angle) / rate, (1.0 - cos(angle)) / rate**2
        third = (angle - sin(angle)) / rate**3
    phi = np.zeros((6, 6))
    phi[:3, :3] = phi[3:, 3:] = np.eye(3)
    phi[:3, :3] += WW * second - W * first
    phi[:3, 3:] = W * second - dt * np.eye(3) - WW * third
    return phi


def process_noise(sigma_v: float, sigma_u: float, dt: float) -> Array:
    """Covariance G Q G^T of the process noise, shape (6, 6) (below equation 15).

    Parameters
    ----------
    sigma_v
        Angle random walk, rad/sqrt(s).
    sigma_u
        Rate random walk, rad/s/sqrt(s).
    dt
        Sampling interval, s.
    """
    noise = np.zeros((6, 6))
    identity = np.eye(3)
    noise[:3, :3] = (sigma_v**2 * dt + sigma_u**2 * dt**3 / 3.0) * identity
    # A positive bias error turns the estimate backwards.
    noise[:3, 3:] = noise[3:, :3] = -(sigma_u**2 * dt**2 / 2.0) * identity
    noise[3:, 3:] = sigma_u**2 * dt * identity
    return noise


def _correct(
    error: Array, P: Array, measured: Array, predicted: Array, variance: float
) -> tuple[Array, Array]:
    """Process one direction: the error state (6,) and its covariance (equations 5 to 9)."""
    H = np.zeros((3, 6))
    H[:, :3] = cross_matrix(predicted)
    PH = np.asarray(P @ H.T, dtype=np.float64)
    K = np.asarray(np.linalg.solve(H @ PH + variance * np.eye(3), PH.T).T, dtype=np.float64)
    innovation = measured - predicted - H @ error
    return error + K @ innovation, P - K @ PH.T


class MurrellEkf:
    """Extended Kalman filter of attitude and gyroscope bias.

    ::

        ekf = MurrellEkf.from_quest(measured, references, P0=P0, sigma=[0.05, 0.05],
                                    sigma_v=sigma_v, sigma_u=sigma_u)
        for gyroscope, measured, references in data:
            ekf.predict(gyroscope, dt)
            ekf.update(measured, references)
            print(ekf.q, ekf.bias)

    Parameters
    ----------
    q
        First attitude, inertial to body, shape (4,), not zero.
    P0
        Covariance of the errors of attitude (rad, about the body axes) and bias (rad/s), shape
        (6, 6).
    sigma
        Standard deviation of each direction, shape (k,), more than 0.
    sigma_v, sigma_u
        Angle random walk, rad/sqrt(s), and rate random walk, rad/s/sqrt(s).
    bias
        First bias, shape (3,), rad/s; zero in the paper.

    Attributes
    ----------
    q : array of shape (4,)
        Attitude, of unit length.
    bias : array of shape (3,)
        Gyroscope bias, rad/s.

    Raises
    ------
    ValueError
        If an argument has a wrong shape or value.
    """

    def __init__(
        self,
        q: ArrayLike,
        *,
        P0: ArrayLike,
        sigma: ArrayLike,
        sigma_v: float,
        sigma_u: float,
        bias: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.q: Array = _shaped(q, "q", (4,))
        length = np.linalg.norm(self.q)
        if not length > 0.0:
            raise ValueError(f"q must not be zero, not {self.q.tolist()!r}")
        self.q /= length
        self.bias: Array = _shaped(bias, "bias", (3,))
        self._covariance: Array = _shaped(P0, "P0", (6, 6))
        deviations = np.array(sigma, dtype=np.float64)
        if deviations.ndim != 1 or not (deviations > 0.0).all():
            raise ValueError(f"sigma must be a list of numbers more than 0, not {sigma!r}")
        self._variances: Array = deviations * deviations
        for name, value in (("sigma_v", sigma_v), ("sigma_u", sigma_u)):
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and at least 0, not {value!r}")
        self._sigma_v, self._sigma_u = sigma_v, sigma_u
        self._noise: tuple[float, Array] = (0.0, np.zeros((6, 6)))

    @classmethod
    def from_quest(
        cls,
        measured: ArrayLike,
        references: ArrayLike,
        *,
        P0: ArrayLike,
        sigma: ArrayLike,
        sigma_v: float,
        sigma_u: float,
    ) -> "MurrellEkf":
        """Make a filter that starts from QUEST and a bias of zero, as figure 4 has it.

        Parameters
        ----------
        measured, references
            First directions in body and inertial frame, shape (k, 3).
        P0, sigma, sigma_v, sigma_u
            As for the class.
        """
        weights = 1.0 / np.square(np.asarray(sigma, dtype=np.float64))
        q = quest(measured, references, weights)
        return cls(q, P0=P0, sigma=sigma, sigma_v=sigma_v, sigma_u=sigma_u)

    @property
    def P(self) -> Array:
        """Covariance of the errors of attitude and bias, shape (6, 6), a copy."""
        return self._covariance.copy()

    def predict(self, gyroscope: ArrayLike, dt: float) -> None:
        """Propagate attitude and covariance (equations 13 to 15).

        Parameters
        ----------
        gyroscope
            Sample of the gyroscope, shape (3,), rad/s.
        dt
            Time since the step before, s, more than 0.
        """
        if not (np.isfinite(dt) and dt > 0.0):
            raise ValueError(f"dt must be finite and more than 0, not {dt!r}")
        rates = _shaped(gyroscope, "gyroscope", (3,)) - self.bias
        if self._noise[0] != dt:
            self._noise = dt, process_noise(self._sigma_v, self._sigma_u, dt)
        phi = transition_matrix(rates, dt)
        self.q = propagate(self.q, rates, dt)
        self._covariance = phi @ self._covariance @ phi.T + self._noise[1]

    def update(
        self, measured: ArrayLike, references: ArrayLike, mask: ArrayLike | None = None
    ) -> None:
        """Correct attitude and bias (equations 5 to 12).

        Parameters
        ----------
        measured, references
            Directions in body and inertial frame, shape (k, 3), of length 1 but for noise.
        mask
            Which directions were sampled, shape (k,); None is all.
        """
        shape = (len(self._variances), 3)
        b, r = _shaped(measured, "measured", shape), _shaped(references, "references", shape)
        used = np.ones(shape[0], dtype=np.bool_) if mask is None else np.asarray(mask)
        if used.shape != shape[:1]:
            raise ValueError(f"mask must have the shape {shape[:1]}, not {used.shape!r}")
        error: Array = np.zeros(6)
        covariance = self._covariance
        predicted = r @ attitude_matrix(self.q).T
        for i in np.flatnonzero(used):
            variance = float(self._variances[i])
            error, covariance = _correct(error, covariance, b[i], predicted[i], variance)
        self._covariance = (covariance + covariance.T) / 2.0
        q = self.q + 0.5 * multiply(self.q, np.append(error[:3], 0.0))
        self.q = q / np.linalg.norm(q)
        self.bias = self.bias + error[3:]


def _shaped(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Copy an array after checking its shape and that it is finite."""
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, not {array.shape!r}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, not {array.tolist()!r}")
    return array
