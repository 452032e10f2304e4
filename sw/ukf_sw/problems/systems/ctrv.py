"""Turning vehicle seen by a lidar and a radar that take turns.

State: x and y in m, speed in m/s, heading in rad, turn rate in rad/s, both constant but for the
process noise: accelerations along the heading (1 m/s^2) and of the turn (0.5 rad/s^2), which enter
nonlinearly, so they are augmented. The records, with the truth, come with the package.

The sensors have different noises, so v has the variance 1 and the model scales it. Both have three
rows: the radar range, range rate, bearing; the lidar x, y and nothing. With ``lidar="padded"`` the
lidar's third row says that the noise is zero, which says nothing about the state; with
``lidar="masked"`` it is masked. The bearing stands in that row, because it is an angle and the
lidar's coordinates are not.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.data import load_lidar_radar
from ukf_sw.problems.systems.simulation import check_steps
from ukf_sw.spec.parameters import UkfParams

__all__ = ["CTRV", "ctrv", "observation_model", "process_model"]

Array = NDArray[np.float64]

CTRV = UkfParams(n=5, m=3, q=2, r=3)

#: Standard deviations: longitudinal acceleration, m/s^2, and turn acceleration, rad/s^2.
ACCELERATIONS = (1.0, 0.5)
#: Standard deviation of the lidar, m.
LIDAR = 0.15
#: Standard deviations of the radar: range, m, range rate, m/s, bearing, rad.
RANGE, RANGE_RATE, BEARING = 0.3, 0.3, 0.03


def process_model(x: Array, w: Array, u: float) -> Array:
    """Drive a circle, exactly; u is the time since the last record, in s."""
    turned = u * x[4]
    # The chord has the direction of half the turn; its length goes to that of the arc as the turn
    # goes to zero, without a case of its own.
    chord = u * x[2] * np.sinc(turned / (2.0 * np.pi))
    direction = x[3] + turned / 2.0
    half = 0.5 * u * u
    return np.array(
        [
            x[0] + chord * np.cos(direction) + half * np.cos(x[3]) * w[0],
            x[1] + chord * np.sin(direction) + half * np.sin(x[3]) * w[0],
            x[2] + u * w[0],
            x[3] + turned + half * w[1],
            x[4] + u * w[1],
        ]
    )


def observation_model(x: Array, v: Array, *, device: str) -> Array:
    """Observe with the lidar (x, y, noise) or the radar (range, range rate, bearing)."""
    if device == "lidar":
        return np.array([x[0] + LIDAR * v[0], x[1] + LIDAR * v[1], BEARING * v[2]])
    distance = np.sqrt(x[0] * x[0] + x[1] * x[1])
    rate = x[2] * (x[0] * np.cos(x[3]) + x[1] * np.sin(x[3])) / np.maximum(distance, 1e-6)
    return np.array(
        [
            distance + RANGE * v[0],
            rate + RANGE_RATE * v[1],
            np.arctan2(x[1], x[0]) + BEARING * v[2],
        ]
    )


def ctrv(*, steps: int | None = None, lidar: Literal["padded", "masked"] = "padded") -> Problem:
    """Make the scenario from the records; the first, of the lidar, makes the first estimate.

    It counts as a step, which predicts over no time and updates with nothing, because the authors
    of the records judge all 500 estimates.

    Parameters
    ----------
    steps
        Steps to take, up to 500; None is all.
    lidar
        What becomes of the third row when the lidar has observed.

    Returns
    -------
    Problem
        Errors of position and velocity, along x and along y.

    Raises
    ------
    ValueError
        If there are not that many steps, or no such treatment.
    """
    if lidar not in ("padded", "masked"):
        raise ValueError(f"lidar must be 'padded' or 'masked', not {lidar!r}")
    devices, times, records, truth = load_lidar_radar()
    count = check_steps(steps, len(times))
    measurements = records[:, [0, 2, 1]]
    by_lidar = np.array([device == "lidar" for device in devices])
    measurements[by_lidar, 1] = records[by_lidar, 1]
    measurements[by_lidar, 2] = 0.0 if lidar == "padded" else np.nan
    sampled = np.ones((len(times), 3), dtype=np.bool_)
    if lidar == "masked":
        sampled[by_lidar, 2] = False

    sampled[0] = False

    def error(x: Array, truth: Array) -> Array:
        velocity = x[:, 2:3] * np.column_stack((np.cos(x[:, 3]), np.sin(x[:, 3])))
        return np.column_stack((x[:, :2], velocity)) - truth

    return Problem(
        name="ctrv",
        states={"x": "m", "y": "m", "speed": "m/s", "heading": "rad", "turn rate": "rad/s"},
        state_angles=("heading",),
        inputs={"interval": "s"},
        f=process_model,
        vectorized=True,
        Q=np.diag(np.square(ACCELERATIONS)),
        sensors=Sensor(observation_model, R=np.eye(3), m=3, angles=(2,)),
        x0=np.array([records[0, 0], records[0, 1], 0.0, 0.0, 0.0]),
        P0=np.diag([LIDAR**2, LIDAR**2, 25.0, 0.1, 0.5]),
        data=Data(
            times=times[:count],
            inputs=np.diff(times, prepend=times[0])[:count],
            measurements=measurements[:count],
            sampled=sampled[:count],
            observation_arguments=[{"device": device} for device in devices[:count]],
            truth=truth[:count],
        ),
        error=error,
        error_names=("x", "y", "velocity x", "velocity y"),
        error_units=("m", "m", "m/s", "m/s"),
    )
