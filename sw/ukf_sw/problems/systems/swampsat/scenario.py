"""Scenarios of SwampSat for the unscented Kalman filter."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.systems.nanosat import BODY_RATES, attitude_error
from ukf_sw.problems.systems.simulation import check_steps
from ukf_sw.problems.systems.swampsat.flight import SETTINGS, Flight, SwampsatSettings, simulate
from ukf_sw.problems.systems.swampsat.quest import quest
from ukf_sw.problems.systems.swampsat.sampling import Sampling
from ukf_sw.problems.systems.swampsat.ukf import (
    OBSERVATIONS,
    STATES,
    SWAMPSAT,
    observation_model,
    process_covariance,
    process_model,
)
from ukf_sw.spec.parameters import UkfParams

__all__ = ["first_attitude", "scenario_of", "swampsat"]

Array = NDArray[np.float64]


def first_attitude(flight: Flight) -> Array:
    """Attitude at time 0 by QUEST, shape (4,).

    Raises
    ------
    ValueError
        If the flight starts in eclipse.
    """
    if not flight.lit[0]:
        raise ValueError(
            f"The flight must start in sunlight, not in eclipse at {flight.settings.epoch!r}"
        )
    weights = 1.0 / np.square(np.maximum(flight.settings.sensors.sigma_vectors, 1e-12))
    return quest(flight.vectors[0], flight.references[0], weights)


def scenario_of(flight: Flight, sampling: Sampling, params: UkfParams = SWAMPSAT) -> Problem:
    """Make the scenario of a flight.

    Every slot predicts with the gyroscope; slots at whose end the vector sensors are sampled update
    as well. The first estimate is that of QUEST, with a bias of zero.

    Parameters
    ----------
    flight
        Truth and samples.
    sampling
        When the sensors are sampled.
    params
        Sizes as :data:`ukf_sw.problems.systems.swampsat.ukf.SWAMPSAT`, number format and form.

    Returns
    -------
    Problem
        Errors in degrees: total attitude, and about the body axes.

    Raises
    ------
    ValueError
        If the interval is not a whole number of slots or the flight starts in eclipse.
    """
    settings, count = flight.settings, flight.steps
    sensors = settings.sensors
    sampled = np.repeat(sampling.sampled(count, settings.dt)[:, None], 6, axis=1)
    sampled[:, :3] &= flight.lit[1:, None]
    arguments: list[dict[str, Any]] = [{"references": r} for r in flight.references[1:]]
    variances = [settings.sigma_attitude**2 / 4.0] * 4 + [settings.sigma_bias**2] * 3
    sigma_v = sensors.angle_random_walk * sampling.noise_factor**0.5
    problem = Problem(
        name="swampsat",
        states=STATES,
        inputs=BODY_RATES,
        f=process_model(settings.dt),
        vectorized=True,
        Q=process_covariance(sigma_v, sensors.rate_random_walk, settings.dt),
        sensors=Sensor(
            observation_model(),
            R=np.diag(np.repeat(sensors.sigma_vectors**2, 3)),
            observations=OBSERVATIONS,
        ),
        x0=np.append(first_attitude(flight), np.zeros(3)),
        P0=np.diag(variances),
        data=Data(
            times=flight.times[1:],
            inputs=flight.gyroscope[sampling.gyroscope_slots(count)],
            measurements=flight.vectors[1:].reshape(count, 6),
            sampled=sampled,
            observation_arguments=arguments,
            truth=np.hstack((flight.attitude, flight.bias))[1:],
        ),
        error=attitude_error,
        error_names=("attitude", "x", "y", "z"),
        error_units=("degrees",) * 4,
    )
    return problem.for_core(params)


def swampsat(
    seed: int = 0,
    *,
    sampling: Sampling | None = None,
    settings: SwampsatSettings = SETTINGS,
    params: UkfParams = SWAMPSAT,
    steps: int | None = None,
) -> Problem:
    """Simulate a flight and make its scenario.

    Parameters
    ----------
    seed
        Seed of first attitude, bias and noise.
    sampling
        When the sensors are sampled; None is every 2 s.
    settings
        Orbit, motion, sensors and first uncertainty.
    params
        As for :func:`scenario_of`.
    steps
        Slots to simulate; None is the whole duration.

    Returns
    -------
    Problem
        As :func:`scenario_of`; errors count in the second half of the whole duration.

    Raises
    ------
    ValueError
        If there are not that many steps, or as :func:`scenario_of`.
    """
    chosen = Sampling(interval=2.0) if sampling is None else sampling
    count = check_steps(steps, settings.steps)
    flight = simulate(seed, replace(settings, duration=count * settings.dt))
    return replace(scenario_of(flight, chosen, params), settled=settings.duration / 2.0)
