"""Falling body tracked by a radar (Julier and Uhlmann, *Unscented Filtering*, 2004, section VI).

State: position (2, km), velocity (2, km/s), and x5, which scales the unknown ballistic coefficient
b0 exp(x5). Drag and gravity are strong and nonlinear, range and bearing precise. The process noise
w (two accelerations, one rate of x5) is augmented with q = 3 < n = 5, the observation noise is
additive.

Positions are of the order of 6400 km with errors of some metres, near the limit of binary32:
``origin="radar"`` measures them from the radar instead, which changes nothing but the rounding.
"""

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.systems.simulation import check_steps, draw
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["DT", "REENTRY", "STEPS", "observation_model", "process_model", "reentry"]

Array = NDArray[np.float64]

REENTRY = UkfParams(n=5, m=2, q=3, r=2, observation_noise=Noise.ADDITIVE)
#: Sampling interval, s.
DT = 0.1
#: Steps of the whole scenario.
STEPS = 2000

BALLISTIC = -0.59783  # 1/km
SCALE_HEIGHT = 13.406  # km
GRAVITATION = 3.986e5  # km^3/s^2
EARTH_RADIUS = 6374.0  # km

#: Variances of one step: velocities in (km/s)^2, x5.
Q = np.diag([2.4064e-5, 2.4064e-5, 1e-6])
#: 1 m, 0.17 mrad.
R = np.diag([1e-3**2, 0.17e-3**2])
TRUE_START = (6500.4, 349.14, -1.8093, -6.7967, 0.6932)
START = (6500.4, 349.14, -1.8093, -6.7967, 0.0)


def _move(x: Array, w: Array, u: None, *, centre: float) -> Array:
    first = x[0] + centre
    radius = np.sqrt(first * first + x[1] * x[1])
    speed = np.sqrt(x[2] * x[2] + x[3] * x[3])
    coefficient = BALLISTIC * np.exp(x[4])
    drag = coefficient * np.exp((EARTH_RADIUS - radius) / SCALE_HEIGHT) * speed
    gravity = -GRAVITATION / radius**3
    return np.array(
        [
            x[0] + DT * x[2],
            x[1] + DT * x[3],
            x[2] + DT * (drag * x[2] + gravity * first) + w[0],
            x[3] + DT * (drag * x[3] + gravity * x[1]) + w[1],
            x[4] + w[2],
        ]
    )


def process_model(centre: float = 0.0) -> Callable[[Array, Array, None], Array]:
    """Process model f(x, w, u): one Euler step of drag and gravity.

    Parameters
    ----------
    centre
        First coordinate of the origin as seen from the centre of the Earth, km.
    """
    return partial(_move, centre=centre)


def _observe(x: Array, v: Array, *, centre: float) -> Array:
    first = x[0] + (centre - EARTH_RADIUS)
    return np.array([np.sqrt(first * first + x[1] * x[1]), np.arctan2(x[1], first)]) + v


def observation_model(centre: float = 0.0) -> Callable[[Array, Array], Array]:
    """Observation model h(x, v): range in km and bearing in rad, from the radar on the ground.

    Parameters
    ----------
    centre
        As for :func:`process_model`.
    """
    return partial(_observe, centre=centre)


def reentry(
    seed: int = 0,
    *,
    steps: int | None = None,
    origin: Literal["earth", "radar"] = "earth",
) -> Problem:
    """Make the scenario: 200 s, radar at 10 Hz.

    Parameters
    ----------
    seed
        Seed of first state and of both noises.
    steps
        Steps to simulate, up to 2000; None is all.
    origin
        Where the filter's coordinates have their origin: centre of the Earth, or radar.

    Returns
    -------
    Problem
        Errors: distance, speed, and x5.

    Raises
    ------
    ValueError
        If there are not that many steps, or no such origin.
    """
    count = check_steps(steps, STEPS)
    if origin not in ("earth", "radar"):
        raise ValueError(f"origin must be 'earth' or 'radar', not {origin!r}")
    centre = 0.0 if origin == "earth" else EARTH_RADIUS
    draws = draw(seed, count + 1, 5)
    f, h = process_model(), observation_model()
    P_start = np.diag([1e-6] * 4 + [0.0])
    x = np.array(TRUE_START) + np.sqrt(np.diag(P_start)) * draws[0]
    # The true body keeps its ballistic coefficient.
    deviations = np.sqrt(np.diag(Q)) * [1.0, 1.0, 0.0]
    truth = np.empty((count, 5))
    for k in range(count):
        x = f(x, deviations * draws[k + 1, :3], None)
        truth[k] = x
    noise = np.sqrt(np.diag(R))[:, None] * draws[1:, 3:].T
    measurements = h(truth.T, noise).T
    shift = np.array([centre, 0.0, 0.0, 0.0, 0.0])

    def error(x: Array, truth: Array) -> Array:
        difference = x + shift - truth
        return np.column_stack(
            (
                np.linalg.norm(difference[:, :2], axis=1),
                np.linalg.norm(difference[:, 2:4], axis=1),
                difference[:, 4],
            )
        )

    return Problem(
        name="reentry",
        states={"x1": "km", "x2": "km", "x3": "km/s", "x4": "km/s", "x5": ""},
        f=process_model(centre),
        vectorized=True,
        Q=Q,
        observation_noise=Noise.ADDITIVE,
        sensors=Sensor(
            observation_model(centre),
            R=R,
            observations={"range": "km", "bearing": "rad"},
            angles=("bearing",),
        ),
        x0=np.array(START) - shift,
        P0=np.diag([1e-6] * 4 + [1.0]),
        data=Data(
            times=DT * np.arange(1, count + 1, dtype=np.float64),
            measurements=np.ascontiguousarray(measurements),
            truth=truth,
        ),
        error=error,
        error_names=("position", "velocity", "ballistic parameter"),
        error_units=("km", "km/s", ""),
    )
