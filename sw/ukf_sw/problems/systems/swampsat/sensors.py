"""Models of the sensors (equations 1 to 3)."""

from dataclasses import dataclass, fields
from math import isfinite, radians, sqrt

import numpy as np
from numpy.typing import NDArray

__all__ = ["SWAMPSAT_SENSORS", "Sensors"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Errors of sun sensor, magnetometer and gyroscope.

    Parameters
    ----------
    sigma_sun, sigma_magnetometer
        Standard deviations of each component of a measured direction; directions have length 1.
    angle_random_walk
        Density of the rate noise eta_1, sigma_v, rad/sqrt(s).
    rate_random_walk
        Density of the bias noise eta_2, sigma_u, rad/s/sqrt(s).
    bias
        Standard deviation of the bias at the start, rad/s.

    Raises
    ------
    ValueError
        If a parameter is negative or not finite.
    """

    sigma_sun: float = 0.05
    sigma_magnetometer: float = 0.05
    angle_random_walk: float = radians(2.0) / 60.0
    rate_random_walk: float = radians(7e-4)
    bias: float = radians(1.0)

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isfinite(value) and value >= 0.0):
                raise ValueError(f"{field.name} must be finite and at least 0, not {value!r}")

    @property
    def sigma_vectors(self) -> Array:
        """Standard deviations of the directions of Sun and field, shape (2,)."""
        return np.array([self.sigma_sun, self.sigma_magnetometer])

    def vectors(self, attitude: Array, references: Array, draws: Array) -> Array:
        """Measure directions in the body frame (equation 1).

        Parameters
        ----------
        attitude
            Matrices C_BI, shape (3, 3, K).
        references
            Directions of Sun and field, inertial, shape (K, 2, 3).
        draws
            Standard normal numbers, shape (K, 2, 3).

        Returns
        -------
        array of shape (K, 2, 3)
            Of length 1 but for the noise.
        """
        true = np.einsum("ijk,ksj->ksi", attitude, references)
        return true + self.sigma_vectors[:, None] * draws

    def gyroscope(self, rates: Array, dt: float, start: Array, draws: Array) -> tuple[Array, Array]:
        """Measure rates, with an error that walks (equations 2 and 3).

        Farrenkopf's model in discrete time, exact for white noise: a sample is the mean rate over
        its slot, of length dt (Crassidis and Junkins 2004, equation 7.42).

        Parameters
        ----------
        rates
            Mean rates of each slot, shape (K, 3), rad/s.
        dt
            Length of a slot, s.
        start
            Three standard normal numbers, for the bias at the start.
        draws
            Standard normal numbers, shape (K, 2, 3): rate noise, bias noise.

        Returns
        -------
        samples : array of shape (K, 3)
            Measured rates, rad/s.
        bias : array of shape (K + 1, 3)
            True bias at the ends of the slots, rad/s.
        """
        bias = np.empty((len(rates) + 1, 3))
        bias[0] = self.bias * start
        bias[1:] = bias[0] + np.cumsum(self.rate_random_walk * sqrt(dt) * draws[:, 1], axis=0)
        noise = sqrt(self.angle_random_walk**2 / dt + self.rate_random_walk**2 * dt / 12.0)
        return rates + (bias[1:] + bias[:-1]) / 2.0 + noise * draws[:, 0], bias


#: Sun sensor and magnetometer with "5%" noise; gyroscope from the data sheet of the ADIS16405.
SWAMPSAT_SENSORS = Sensors()
