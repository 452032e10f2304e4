"""Recorded odometry of a wheeled robot, with position fixes twice a second.

State: heading in rad, x and y in m. The inputs are the recorded speeds and turn rate; their errors
(0.15 m/s forward, 0.05 m/s sideways, 0.15 rad/s) are the process noise, which is augmented. The
fixes are those of the cameras with 0.1 m of noise added; in between there are predicts only. The
filter starts with a heading that is wrong by 30 degrees. The settings are those of the authors of
the recording (Brossard, Barrau, Bonnabel, *A Code for Unscented Kalman Filtering on Manifolds*).
"""

from math import radians

import numpy as np
from numpy.typing import NDArray

from ukf_sw.models import wrap
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.data import load_odometry
from ukf_sw.problems.systems.simulation import check_steps, draw
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["ODOMETRY", "observation_model", "process_model", "recorded_odometry"]

Array = NDArray[np.float64]

ODOMETRY = UkfParams(n=3, m=2, q=3, r=2, observation_noise=Noise.ADDITIVE)
#: Standard deviations of forward and sideways speed, m/s, and of the turn rate, rad/s.
DEVIATIONS = (0.15, 0.05, 0.15)
#: Standard deviation of a position fix, m.
FIX = 0.1
#: Time between fixes, s.
INTERVAL = 0.5
#: First error of the heading, rad; also its standard deviation in the filter.
HEADING_ERROR = radians(30.0)


def process_model(x: Array, w: Array, u: Array) -> Array:
    """Drive; u is (time since the last sample in s, forward and sideways speed, turn rate)."""
    interval, forward, sideways, rate = u
    forward, sideways = forward + w[0], sideways + w[1]
    c, s = np.cos(x[0]), np.sin(x[0])
    return np.array(
        [
            x[0] + interval * (rate + w[2]),
            x[1] + interval * (c * forward - s * sideways),
            x[2] + interval * (s * forward + c * sideways),
        ]
    )


def observation_model(x: Array, v: Array) -> Array:
    """Position fix."""
    return x[1:3] + v


def recorded_odometry(seed: int = 0, *, steps: int | None = None) -> Problem:
    """Make the scenario.

    Parameters
    ----------
    seed
        Seed of the noise of the fixes.
    steps
        Steps to take, up to 6283; None is all.

    Returns
    -------
    Problem
        Errors: distance in m, heading in degrees.

    Raises
    ------
    ValueError
        If there are not that many steps.
    """
    data = load_odometry()
    times = data["times"] - data["times"][0]
    truth = data["truth"]
    count = check_steps(steps, len(times) - 1)
    measurements = truth[1:, 1:] + FIX * draw(seed, len(times) - 1, 2)
    # The first sample at or after every multiple of the interval.
    periods = np.floor(times / INTERVAL + 1e-9)
    fixed = np.diff(periods) > 0.0
    inputs = np.column_stack((np.diff(times), data["speeds"][:-1], data["gyroscope"][:-1]))

    def error(x: Array, truth: Array) -> Array:
        distance = np.linalg.norm(x[:, 1:] - truth[:, 1:], axis=1)
        return np.column_stack((distance, np.degrees(wrap(x[:, 0] - truth[:, 0], 0.0))))

    return Problem(
        name="recorded-odometry",
        states={"heading": "rad", "x": "m", "y": "m"},
        state_angles=("heading",),
        inputs={"interval": "s", "forward": "m/s", "sideways": "m/s", "turn rate": "rad/s"},
        f=process_model,
        vectorized=True,
        Q=np.diag(np.square(DEVIATIONS)),
        observation_noise=Noise.ADDITIVE,
        sensors=Sensor(observation_model, R=FIX**2 * np.eye(2), observations={"x": "m", "y": "m"}),
        x0=truth[0] + [HEADING_ERROR, 0.0, 0.0],
        P0=np.diag([HEADING_ERROR**2, FIX**2, FIX**2]),
        data=Data(
            times=times[1 : count + 1],
            inputs=inputs[:count],
            measurements=measurements[:count],
            sampled=np.repeat(fixed[:count, None], 2, axis=1),
            truth=truth[1 : count + 1],
        ),
        error=error,
        error_names=("position", "heading"),
        error_units=("m", "degrees"),
    )
