"""Inertial navigation with satellite fixes: the largest of the systems, and of two rates.

State: position (3, m, north-east-down), velocity (3, m/s), Euler angles (3, rad: roll, pitch, yaw,
A = Rz Ry Rx), accelerometer bias (3, m/s^2), gyroscope bias (3, rad/s). The inertial sensors are
the input, at 100 Hz; their noises and those of the biases are w (12), which enters nonlinearly and
is augmented. Fixes of position and velocity come at 5 Hz; in between there are predicts only.
"""

from math import pi, radians

import numpy as np
from numpy.typing import NDArray

from ukf_sw.models import wrap
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.systems.simulation import check_steps, draw
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["DT", "GPS_INS", "STEPS", "gps_ins", "observation_model", "process_model"]

Array = NDArray[np.float64]

GPS_INS = UkfParams(n=15, m=6, q=12, r=6, observation_noise=Noise.ADDITIVE)
#: Sampling interval of the inertial sensors, s.
DT = 0.01
#: Inertial samples between fixes.
FIX_EVERY = 20
#: Steps of the whole scenario.
STEPS = 12_000
#: The filter has settled by then, in seconds.
SETTLED = 30.0

#: Names and units of the states.
STATES = {
    "north": "m", "east": "m", "down": "m",
    "velocity north": "m/s", "velocity east": "m/s", "velocity down": "m/s",
    "roll": "rad", "pitch": "rad", "yaw": "rad",
    "accelerometer bias x": "m/s^2", "accelerometer bias y": "m/s^2",
    "accelerometer bias z": "m/s^2",
    "gyroscope bias x": "rad/s", "gyroscope bias y": "rad/s", "gyroscope bias z": "rad/s",
}  # fmt: skip

GRAVITY = 9.80665
#: Standard deviations of a sample: m/s^2, rad/s; of the drift of the biases in a step.
ACCELEROMETER, GYROSCOPE = 0.05, radians(0.2)
ACCELEROMETER_DRIFT, GYROSCOPE_DRIFT = 1e-4, 1e-6
#: Standard deviations of a fix: m, m/s.
POSITION, VELOCITY = 1.0, 0.1
#: True biases have this standard deviation; so has the filter's first estimate, which is zero.
ACCELEROMETER_BIAS, GYROSCOPE_BIAS = 0.1, radians(0.5)
#: First standard deviations of the angles: roll and pitch, yaw.
TILT, YAW = radians(2.0), radians(5.0)

#: Unit variance: the model scales w, so that small and large noises have the same range.
Q = np.eye(12)
R = np.diag([POSITION**2] * 3 + [VELOCITY**2] * 3)
_SCALE = np.repeat([ACCELEROMETER, GYROSCOPE, ACCELEROMETER_DRIFT, GYROSCOPE_DRIFT], 3)


def _turned(angles: Array, vector: Array) -> Array:
    """Vector (3, ...) of the body in the local frame."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    x, y, z = vector
    y, z = cr * y - sr * z, sr * y + cr * z
    x, z = cp * x + sp * z, cp * z - sp * x
    return np.array([cy * x - sy * y, sy * x + cy * y, z])


def process_model(x: Array, w: Array, u: Array) -> Array:
    """Navigate by one inertial sample u: accelerometer (m/s^2), gyroscope (rad/s)."""
    scale = _SCALE.reshape(-1, *([1] * (w.ndim - 1)))
    sample = u.reshape(-1, *([1] * (x.ndim - 1)))
    noise = scale * w
    acceleration = _turned(x[6:9], sample[:3] - x[9:12] - noise[:3])
    acceleration[2] += GRAVITY
    rate = sample[3:] - x[12:15] - noise[3:6]
    roll, pitch = x[6], x[7]
    across = np.sin(roll) * rate[1] + np.cos(roll) * rate[2]
    moved = x.copy()
    moved[0:3] += DT * (x[3:6] + 0.5 * DT * acceleration)
    moved[3:6] += DT * acceleration
    moved[6] += DT * (rate[0] + np.tan(pitch) * across)
    moved[7] += DT * (np.cos(roll) * rate[1] - np.sin(roll) * rate[2])
    moved[8] += DT * across / np.cos(pitch)
    moved[9:] += noise[6:]
    return moved


def observation_model(x: Array, v: Array) -> Array:
    """Fix of position and velocity."""
    return x[:6] + v


def _flight(times: Array) -> tuple[Array, Array]:
    """Angles (3, K) and forward speeds (K,) of an aircraft that weaves, climbs and turns."""
    roll = radians(20.0) * np.sin(2.0 * pi * times / 20.0)
    pitch = radians(8.0) * np.sin(2.0 * pi * times / 13.0 + 0.5)
    yaw = radians(60.0) * np.sin(2.0 * pi * times / 40.0)
    speed = 20.0 + 4.0 * np.sin(2.0 * pi * times / 17.0)
    return np.array([roll, pitch, yaw]), speed


def gps_ins(seed: int = 0, *, steps: int | None = None) -> Problem:
    """Make the scenario: two minutes of flight at about 20 m/s.

    The truth obeys the process model exactly: its samples are derived from the flight path.

    Parameters
    ----------
    seed
        Seed of the sensors and of the first errors.
    steps
        Steps to simulate, up to 12 000; None is all.

    Returns
    -------
    Problem
        Errors: distance in m, speed in m/s, and the norm of the angles in degrees.

    Raises
    ------
    ValueError
        If there are not that many steps.
    """
    count = check_steps(steps, STEPS)
    draws = draw(seed, count + 1, 18)
    times = DT * np.arange(count + 1, dtype=np.float64)
    angles, speed = _flight(times)
    velocity = _turned(angles, np.array([speed, np.zeros_like(speed), np.zeros_like(speed)]))
    acceleration = np.diff(velocity, axis=1) / DT
    position = np.zeros((3, count + 1))
    position[:, 1:] = np.cumsum(DT * velocity[:, :-1] + 0.5 * DT**2 * acceleration, axis=1)
    # Inertial samples that lead from each of these states to the next.
    force = acceleration - np.array([[0.0], [0.0], [GRAVITY]])
    roll, pitch, yaw = angles[:, :-1]
    level = np.array(
        [
            np.cos(yaw) * force[0] + np.sin(yaw) * force[1],
            np.cos(yaw) * force[1] - np.sin(yaw) * force[0],
            force[2],
        ]
    )
    nose = np.cos(pitch) * level[0] - np.sin(pitch) * level[2]
    below = np.sin(pitch) * level[0] + np.cos(pitch) * level[2]
    specific = np.array(
        [
            nose,
            np.cos(roll) * level[1] + np.sin(roll) * below,
            np.cos(roll) * below - np.sin(roll) * level[1],
        ]
    )
    d_roll, d_pitch, d_yaw = np.diff(angles, axis=1) / DT
    rates = np.array(
        [
            d_roll - np.sin(pitch) * d_yaw,
            np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_yaw,
            np.cos(roll) * np.cos(pitch) * d_yaw - np.sin(roll) * d_pitch,
        ]
    )

    first = draws[0]
    bias = np.empty((count + 1, 6))
    bias[0, :3], bias[0, 3:] = ACCELEROMETER_BIAS * first[:3], GYROSCOPE_BIAS * first[3:6]
    bias[1:] = bias[0] + np.cumsum(_SCALE[6:] * draws[1:, 6:12], axis=0)
    inputs = np.vstack((specific, rates)).T + bias[:-1] + _SCALE[:6] * draws[1:, :6]
    truth = np.hstack((position.T, velocity.T, angles.T, bias))
    deviations = np.sqrt(np.diag(R))
    measurements = truth[1:, :6] + deviations * draws[1:, 12:18]
    sampled = np.zeros((count, 6), dtype=np.bool_)
    sampled[FIX_EVERY - 1 :: FIX_EVERY] = True

    first_deviations = np.concatenate((deviations, [TILT, TILT, YAW]))
    x0 = np.zeros(15)
    x0[:9] = truth[0, :9] + first_deviations * first[6:15]
    P0 = np.diag(
        np.concatenate(
            (first_deviations, [ACCELEROMETER_BIAS] * 3, [GYROSCOPE_BIAS] * 3)
        ) ** 2
    )  # fmt: skip

    def error(x: Array, truth: Array) -> Array:
        difference = x - truth
        turned = np.degrees(wrap(difference[:, 6:9], 0.0))
        return np.column_stack(
            (
                np.linalg.norm(difference[:, :3], axis=1),
                np.linalg.norm(difference[:, 3:6], axis=1),
                np.linalg.norm(turned, axis=1),
            )
        )

    return Problem(
        name="gps-ins",
        states=STATES,
        state_angles=("roll", "pitch", "yaw"),
        f=process_model,
        vectorized=True,
        Q=Q,
        observation_noise=Noise.ADDITIVE,
        sensors=Sensor(observation_model, R=R, observations=dict(list(STATES.items())[:6])),
        x0=x0,
        P0=P0,
        data=Data(
            times=times[1:],
            inputs=inputs,
            measurements=measurements,
            sampled=sampled,
            truth=truth[1:],
        ),
        error=error,
        error_names=("position", "velocity", "angles"),
        error_units=("m", "m/s", "degrees"),
        settled=SETTLED,
    )
