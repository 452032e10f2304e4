"""A flight: true motion, and what the sensors measure at 10 Hz."""

from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from functools import lru_cache
from math import isfinite, radians

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problems.systems.swampsat.environment import in_eclipse, magnetic_field, sun_direction
from ukf_sw.problems.systems.swampsat.kinematics import attitude_matrix, propagate
from ukf_sw.problems.systems.swampsat.orbit import SWAMPSAT_ORBIT, Orbit
from ukf_sw.problems.systems.swampsat.sensors import SWAMPSAT_SENSORS, Sensors

__all__ = ["CALIBRATED", "SETTINGS", "Flight", "SwampsatSettings", "simulate"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SwampsatSettings:
    """Orbit, motion, sensors, and what the filters know at the start.

    Parameters
    ----------
    epoch
        Time 0, with time zone. The paper names none.
    orbit
        Orbit.
    rates
        Body rates, constant, rad/s. (A cube has equal moments of inertia.)
    sensors
        Sensors.
    dt
        Sampling interval of the gyroscope, the length of a slot, s.
    duration
        Length, s.
    sigma_attitude
        First standard deviation of the attitude about each axis, rad.
    sigma_bias
        First standard deviation of the bias of each gyroscope in the filters, rad/s.
    eclipse
        Whether the sun sensor is blind in the Earth's shadow, which the paper does not mention.

    Raises
    ------
    ValueError
        If a parameter is out of range.
    """

    epoch: datetime = datetime(2013, 11, 20, 12, tzinfo=timezone.utc)
    orbit: Orbit = SWAMPSAT_ORBIT
    rates: tuple[float, float, float] = (radians(2.0), radians(-2.0), radians(2.0))
    sensors: Sensors = SWAMPSAT_SENSORS
    dt: float = 0.1
    duration: float = 3000.0
    sigma_attitude: float = radians(4.8)
    sigma_bias: float = radians(2.4)
    eclipse: bool = False

    def __post_init__(self) -> None:
        for name in ("dt", "duration", "sigma_attitude", "sigma_bias"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be finite and more than 0, not {value!r}")
        if not all(isfinite(rate) for rate in self.rates):
            raise ValueError(f"rates must be finite, not {self.rates!r}")
        if self.steps < 1:
            raise ValueError(f"duration must be at least {self.dt} s, not {self.duration!r}")

    @property
    def steps(self) -> int:
        """Number of slots."""
        return round(self.duration / self.dt)


#: The paper's simulation.
SETTINGS = SwampsatSettings()
#: With a bias calibrated to 0.05 degrees per second, so that a minute without vectors is bearable.
CALIBRATED = replace(
    SETTINGS, sensors=replace(SWAMPSAT_SENSORS, bias=radians(0.05)), sigma_bias=radians(0.05)
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """Truth and samples of a flight of K slots.

    Parameters
    ----------
    settings
        Settings it was simulated with.
    times
        Ends of the slots and time 0, shape (K + 1,), s.
    attitude
        True attitude then, inertial to body, shape (K + 1, 4).
    bias
        True bias then, shape (K + 1, 3), rad/s.
    references
        Directions of Sun and field then, inertial, shape (K + 1, 2, 3).
    lit
        Whether the sun sensor sees the Sun then, shape (K + 1,).
    vectors
        Measured directions then, in the body frame, shape (K + 1, 2, 3).
    gyroscope
        Measured rate of each slot, shape (K, 3), rad/s.
    """

    settings: SwampsatSettings
    times: Array
    attitude: Array = field(repr=False)
    bias: Array = field(repr=False)
    references: Array = field(repr=False)
    lit: NDArray[np.bool_] = field(repr=False)
    vectors: Array = field(repr=False)
    gyroscope: Array = field(repr=False)

    @property
    def steps(self) -> int:
        """Number of slots, K."""
        return len(self.gyroscope)

    def attitude_at(self, time: float) -> Array:
        """True attitude at any time, shape (4,)."""
        return propagate(self.attitude[0], np.array(self.settings.rates), time)

    def references_at(self, time: float) -> Array:
        """Directions of Sun and field at any time of the flight, inertial, shape (2, 3)."""
        place = min(max(time / self.settings.dt, 0.0), float(self.steps))
        k = min(int(place), self.steps - 1)
        part = place - k
        between = (1.0 - part) * self.references[k] + part * self.references[k + 1]
        return between / np.linalg.norm(between, axis=1, keepdims=True)

    def vectors_at(self, time: float) -> Array:
        """Measured directions at any time of the flight, in the body frame, shape (2, 3).

        The noise is that of the nearest end of a slot, so that flights that are sampled at other
        times differ by their times only.
        """
        k = min(max(round(time / self.settings.dt), 0), self.steps)
        noise = self.vectors[k] - self.references[k] @ attitude_matrix(self.attitude[k]).T
        return self.references_at(time) @ attitude_matrix(self.attitude_at(time)).T + noise

    def lit_at(self, time: float) -> bool:
        """Whether the sun sensor sees the Sun."""
        return bool(self.lit[min(max(round(time / self.settings.dt), 0), self.steps)])


@lru_cache(maxsize=8)
def _environment(
    epoch: datetime, orbit: Orbit, dt: float, steps: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Directions of Sun and field (K + 1, 2, 3), and where the Sun is visible (K + 1,)."""
    times = np.arange(steps + 1, dtype=np.float64) * dt
    position = orbit.position(times)
    sun = sun_direction(epoch, times)
    field_vector = magnetic_field(epoch, times, position)
    field_vector /= np.linalg.norm(field_vector, axis=0)
    references = np.stack((sun.T, field_vector.T), axis=1)
    visible = ~in_eclipse(position, sun)
    references.setflags(write=False)
    visible.setflags(write=False)
    return references, visible


def simulate(seed: int = 0, settings: SwampsatSettings = SETTINGS) -> Flight:
    """Simulate a flight.

    Parameters
    ----------
    seed
        Seed of first attitude, bias and noise. A shorter flight is the beginning of a longer one.
    settings
        Orbit, motion and sensors.

    Returns
    -------
    Flight
    """
    rng = np.random.default_rng(seed)
    start = rng.standard_normal(7)
    count = settings.steps
    draws = rng.standard_normal((count + 1, 4, 3))
    references, visible = _environment(settings.epoch, settings.orbit, settings.dt, count)
    times = np.arange(count + 1, dtype=np.float64) * settings.dt
    rates = np.array(settings.rates)
    first = start[:4] / np.linalg.norm(start[:4])
    attitude = propagate(first[:, None], rates[:, None], times)
    sensors = settings.sensors
    gyroscope, bias = sensors.gyroscope(
        np.broadcast_to(rates, (count, 3)), settings.dt, start[4:], draws[1:, 2:]
    )
    return Flight(
        settings=settings,
        times=times,
        attitude=np.ascontiguousarray(attitude.T),
        bias=bias,
        references=references,
        lit=visible if settings.eclipse else np.ones(count + 1, dtype=np.bool_),
        vectors=sensors.vectors(attitude_matrix(attitude), references, draws[:, :2]),
        gyroscope=gyroscope,
    )
