"""Attitude error of QUEST, EKF and UKF on the same data."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ukf_sw.backends import Backend
from ukf_sw.errors import UkfError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problems.judging import rms_after
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.nanosat import attitude_error
from ukf_sw.problems.systems.swampsat.ekf import MurrellEkf
from ukf_sw.problems.systems.swampsat.flight import CALIBRATED, SETTINGS, Flight, SwampsatSettings
from ukf_sw.problems.systems.swampsat.quest import quest
from ukf_sw.problems.systems.swampsat.sampling import ALTERNATE, INTERVALS, Sampling
from ukf_sw.problems.systems.swampsat.scenario import first_attitude, scenario_of
from ukf_sw.problems.systems.swampsat.ukf import SWAMPSAT, UkfEstimator
from ukf_sw.spec.parameters import UkfParams

__all__ = [
    "CASES",
    "Case",
    "Errors",
    "case_of",
    "make_ekf",
    "make_ukf",
    "run_ekf",
    "run_quest",
    "run_ukf",
]

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A row of the study's table.

    Parameters
    ----------
    name
        Name in tables.
    sampling
        When the sensors are sampled.
    settings
        Orbit, motion, sensors and first uncertainty.
    repeats
        Flights for each seed that is asked for, where errors scatter much from flight to flight.
    """

    name: str
    sampling: Sampling
    settings: SwampsatSettings = SETTINGS
    repeats: int = 1


#: The paper's intervals, 0.2 s beside its alternate sampling, and a minute with a calibrated bias.
CASES = (
    *(Case(name=sampling.name, sampling=sampling) for sampling in INTERVALS),
    Case(name=ALTERNATE.name, sampling=ALTERNATE),
    Case(name="60 s calibrated", sampling=INTERVALS[-1], settings=CALIBRATED, repeats=5),
)


def case_of(interval: float | str) -> Case:
    """Find a case by its name, or make one of a sampling interval.

    Parameters
    ----------
    interval
        Interval, s, or the name of one of :data:`CASES`, such as "alternate".

    Raises
    ------
    ValueError
        If there is no such case, or the interval is not positive and finite.
    """
    if isinstance(interval, str):
        for case in CASES:
            if case.name == interval:
                return case
        names = ", ".join(repr(case.name) for case in CASES)
        raise ValueError(f"interval must be a number or one of {names}, not {interval!r}")
    sampling = Sampling(interval=float(interval))
    return Case(name=sampling.name, sampling=sampling)


@dataclass(frozen=True, kw_only=True, eq=False)
class Errors:
    """Errors of an estimator over a flight.

    Parameters
    ----------
    times
        Times, shape (K,), s.
    attitude
        Total attitude error, shape (K,), degrees.
    bias
        Estimate less truth, shape (K, 3), degrees/s; NaN if the estimator has none.
    failed
        Message of the error that ended the run; the errors after it are NaN. Else None.
    """

    times: Array
    attitude: Array
    bias: Array
    failed: str | None = None

    def rms(self, after: float = -np.inf) -> float:
        """Root mean square attitude error later than a time, degrees; infinite if it failed.

        Raises
        ------
        ValueError
            If there is no such time.
        """
        rms = rms_after(self.times, self.attitude, after)
        return rms if self.failed is None else float("inf")


def run_quest(flight: Flight, sampling: Sampling) -> tuple[Errors, Errors]:
    """Determine the attitude from each sample by itself.

    Where the Sun is not seen there is none.

    Parameters
    ----------
    flight
        Truth and samples.
    sampling
        When the sensors are sampled.

    Returns
    -------
    at_sample : Errors
        At the times of the samples.
    held : Errors
        At the end of every slot, with the last attitude held until the next sample.
    """
    sampled = np.append(True, sampling.sampled(flight.steps, flight.settings.dt)) & flight.lit
    first_attitude(flight)  # checks that there is one
    slots = np.flatnonzero(sampled)
    weights = 1.0 / np.square(np.maximum(flight.settings.sensors.sigma_vectors, 1e-12))
    attitudes = quest(flight.vectors[slots], flight.references[slots], weights)
    latest = np.cumsum(sampled)[1:] - 1
    results: list[Errors] = []
    for times, estimates, truth in (
        (flight.times[slots], attitudes, flight.attitude[slots]),
        (flight.times[1:], attitudes[latest], flight.attitude[1:]),
    ):
        error = attitude_error(estimates, truth)[:, 0]
        results.append(Errors(times=times, attitude=error, bias=np.full((len(times), 3), np.nan)))
    return results[0], results[1]


def make_ekf(
    flight: Flight, *, noise_factor: float = 1.0, first: Array | None = None
) -> MurrellEkf:
    """Make the extended Kalman filter of a flight, at time 0.

    Parameters
    ----------
    flight
        Truth and samples.
    noise_factor
        Factor of the angle random walk's variance.
    first
        First attitude, shape (4,); None is that of QUEST.
    """
    settings = flight.settings
    return MurrellEkf(
        first_attitude(flight) if first is None else first,
        P0=np.diag([settings.sigma_attitude**2] * 3 + [settings.sigma_bias**2] * 3),
        sigma=settings.sensors.sigma_vectors,
        sigma_v=settings.sensors.angle_random_walk * noise_factor**0.5,
        sigma_u=settings.sensors.rate_random_walk,
    )


def make_ukf(
    flight: Flight, backend: Backend | str = "reference", params: UkfParams = SWAMPSAT
) -> UkfEstimator:
    """Make the unscented Kalman filter of a flight, at time 0, for the platform.

    Parameters
    ----------
    flight
        Truth and samples.
    backend, params
        As for :func:`run_ukf`.
    """
    sensors = flight.settings.sensors
    problem = scenario_of(flight, Sampling(interval=flight.settings.dt), params)
    return UkfEstimator(
        UnscentedKalmanFilter(problem, backend), sensors.angle_random_walk, sensors.rate_random_walk
    )


def run_ekf(flight: Flight, sampling: Sampling, *, first: Array | None = None) -> Errors:
    """Run Murrell's extended Kalman filter.

    Parameters
    ----------
    flight
        Truth and samples.
    sampling
        When the sensors are sampled.
    first
        First attitude, shape (4,); None is that of QUEST.

    Returns
    -------
    Errors
        At the end of every slot.
    """
    dt, count = flight.settings.dt, flight.steps
    ekf = make_ekf(flight, noise_factor=sampling.noise_factor, first=first)
    q, bias = np.empty((count, 4)), np.empty((count, 3))
    sampled = sampling.sampled(count, dt)
    inputs = flight.gyroscope[sampling.gyroscope_slots(count)]
    for k in range(count):
        ekf.predict(inputs[k], dt)
        if sampled[k]:
            mask = np.array([flight.lit[k + 1], True])
            ekf.update(flight.vectors[k + 1], flight.references[k + 1], mask)
        q[k], bias[k] = ekf.q, ekf.bias
    return Errors(
        times=flight.times[1:],
        attitude=attitude_error(q, flight.attitude[1:])[:, 0],
        bias=np.degrees(bias - flight.bias[1:]),
    )


def run_ukf(
    flight: Flight,
    sampling: Sampling,
    backend: Backend | str = "reference",
    *,
    params: UkfParams = SWAMPSAT,
    progress: Progress | None = None,
) -> Errors:
    """Run the unscented Kalman filter.

    Parameters
    ----------
    flight
        Truth and samples.
    sampling
        When the sensors are sampled.
    backend
        What computes: see :class:`ukf_sw.filter.UnscentedKalmanFilter`.
    params
        As for :func:`ukf_sw.problems.systems.swampsat.scenario.scenario_of`.
    progress
        As for :func:`ukf_sw.problems.running.run`.

    Returns
    -------
    Errors
        At the end of every slot. A filter that breaks off is an outcome: see its ``failed``.
    """
    problem = scenario_of(flight, sampling, params)
    found = run(problem, backend, ends_at=(UkfError,), progress=progress, every=1000)
    if found.stop is not None:
        empty = np.full((flight.steps, 3), np.nan)
        failed = found.stop.message
        return Errors(times=problem.times, attitude=empty[:, 0], bias=empty, failed=failed)
    bias = np.degrees(found.x[:, 4:] - flight.bias[1:])
    return Errors(times=found.times, attitude=found.errors[:, 0], bias=bias)
