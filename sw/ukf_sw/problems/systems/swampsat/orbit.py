"""Two-body orbit."""

from dataclasses import dataclass
from math import cos, isfinite, pi, radians, sin, sqrt, tan

import numpy as np
from numpy.typing import NDArray

__all__ = ["EARTH_RADIUS_KM", "SWAMPSAT_ORBIT", "Orbit"]

Array = NDArray[np.float64]

#: Gravitational parameter of the Earth, km^3/s^2 (IERS Conventions 2010, table 1.1).
GRAVITATION = 398600.4418
#: Equatorial radius of the Earth, km (IERS Conventions 2010, table 1.1).
EARTH_RADIUS_KM = 6378.1366


@dataclass(frozen=True, kw_only=True)
class Orbit:
    """Orbit of a satellite around a spherical Earth.

    Parameters
    ----------
    semimajor_axis_km
        Semimajor axis, km.
    eccentricity
        Eccentricity, at least 0 and less than 1.
    inclination, node, perigee, anomaly
        Inclination, right ascension of the ascending node, argument of the perigee, and true
        anomaly at time 0, rad.

    Raises
    ------
    ValueError
        If an element is out of range or the perigee lies below ground.
    """

    semimajor_axis_km: float
    eccentricity: float
    inclination: float
    node: float
    perigee: float
    anomaly: float

    def __post_init__(self) -> None:
        for name in ("inclination", "node", "perigee", "anomaly"):
            if not isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, not {getattr(self, name)!r}")
        if not 0.0 <= self.eccentricity < 1.0:
            raise ValueError(
                f"eccentricity must be at least 0 and less than 1, not {self.eccentricity!r}"
            )
        lowest = self.semimajor_axis_km * (1.0 - self.eccentricity)
        if not (lowest > EARTH_RADIUS_KM and isfinite(lowest)):
            raise ValueError(f"The perigee must be above {EARTH_RADIUS_KM} km, not {lowest!r}")

    @property
    def period(self) -> float:
        """Orbital period, s."""
        return 2.0 * pi * sqrt(self.semimajor_axis_km**3 / GRAVITATION)

    def position(self, times: Array) -> Array:
        """Find the satellite.

        Parameters
        ----------
        times
            Times, shape (K,), s.

        Returns
        -------
        array of shape (3, K)
            Position from the centre of the Earth, inertial (GCRS), km.
        """
        e = self.eccentricity
        first = 2.0 * np.arctan2(sqrt(1.0 - e) * tan(self.anomaly / 2.0), sqrt(1.0 + e))
        mean = first - e * sin(first) + 2.0 * pi / self.period * np.asarray(times)
        eccentric = mean + e * np.sin(mean)
        for _ in range(50):  # Newton's method for Kepler's equation
            change = (eccentric - e * np.sin(eccentric) - mean) / (1.0 - e * np.cos(eccentric))
            eccentric = eccentric - change
            if np.abs(change).max(initial=0.0) < 1e-13:
                break
        a = self.semimajor_axis_km
        plane = np.array([a * (np.cos(eccentric) - e), a * sqrt(1.0 - e * e) * np.sin(eccentric)])
        return self._axes() @ plane

    def _axes(self) -> Array:
        """Directions of the perigee and of the motion there, the columns of a (3, 2) matrix."""
        ci, si = cos(self.inclination), sin(self.inclination)
        cn, sn = cos(self.node), sin(self.node)
        cp, sp = cos(self.perigee), sin(self.perigee)
        return np.array(
            [
                [cn * cp - sn * sp * ci, -cn * sp - sn * cp * ci],
                [sn * cp + cn * sp * ci, -sn * sp + cn * cp * ci],
                [sp * si, cp * si],
            ]
        )


#: Table 1, with the eccentricity that leaves the orbit above ground; the period is 94.99 minutes.
SWAMPSAT_ORBIT = Orbit(
    semimajor_axis_km=6896.31,
    eccentricity=0.0007944,
    inclination=radians(18.6052),
    node=radians(89.9812),
    perigee=0.0,
    anomaly=radians(90.3386),
)
