"""Attitude from recorded inertial and magnetic data, against optical ground truth.

A trial of BROAD, the Berlin Robust Orientation Estimation Assessment Dataset: a sensor is turned by
hand for two minutes. The filter is that of :mod:`ukf_sw.problems.systems.nanosat` with sensors as
they are on a body, and with the exact step of the quaternion: Euler's step of the papers, good
enough at their few degrees a second, does not follow the motion of a hand.

The local frame is that of the papers: x north, z up, so y is west. Of the earth's field only its
dip is needed, the angle between accelerometer and magnetometer in the first seconds, at rest.
Both sensors are scaled to unit vectors, because motion changes the length of the first and iron
nearby that of the second.
"""

from collections.abc import Callable
from functools import partial
from math import pi

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.data import load_inertial
from ukf_sw.problems.systems.nanosat import (
    BODY_RATES,
    NANOSAT_ADDITIVE,
    STATES,
    attitude_error,
    multiply,
    triad,
)
from ukf_sw.problems.systems.simulation import check_steps
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["RECORDED_IMU", "observation_model", "process_model", "recorded_imu"]

Array = NDArray[np.float64]

#: The nanosatellite's states, with additive noise.
RECORDED_IMU: UkfParams = NANOSAT_ADDITIVE
#: Standard deviations of the two unit vectors: what disturbs them is motion and iron, not noise.
SIGMA_A, SIGMA_M = 0.3, 0.6
#: Variances of the quaternion rates, 1/s^2, and of the bias rates, rad^2/s^4.
ETA_Q, ETA_D = 1e-3, 1e-8
#: First variance of every state.
P0 = 1e-3
#: Length of the rest at the beginning that the dip is taken from, s.
REST = 10.0


def _move(x: Array, w: Array, u: Array, *, dt: float) -> Array:
    q1, q2, q3, q0 = x[:4]
    r1, r2, r3 = u[0] - x[4], u[1] - x[5], u[2] - x[6]
    half = 0.5 * dt * np.sqrt(r1 * r1 + r2 * r2 + r3 * r3)
    c, s = np.cos(half), 0.5 * dt * np.sinc(half / pi)
    moved = x + dt * w
    moved[:4] += (c - 1.0) * x[:4]
    moved[0] += s * (q0 * r1 + q2 * r3 - q3 * r2)
    moved[1] += s * (q0 * r2 + q3 * r1 - q1 * r3)
    moved[2] += s * (q0 * r3 + q1 * r2 - q2 * r1)
    moved[3] -= s * (q1 * r1 + q2 * r2 + q3 * r3)
    return moved


def process_model(dt: float) -> Callable[[Array, Array, Array], Array]:
    """Process model f(x, w, u): turn with the gyroscope's rate u, exactly, for dt seconds."""
    return partial(_move, dt=dt)


def _observe(x: Array, v: Array, *, level: float, up: float) -> Array:
    q1, q2, q3, q0 = x[:4]
    s1, s2, s3, s0 = q1 * q1, q2 * q2, q3 * q3, q0 * q0
    north = (s0 + s1 - s2 - s3, 2.0 * (q1 * q2 - q0 * q3), 2.0 * (q0 * q2 + q1 * q3))
    above = (2.0 * (q1 * q3 - q0 * q2), 2.0 * (q0 * q1 + q2 * q3), s0 - s1 - s2 + s3)
    field = (level * n + up * a for n, a in zip(north, above, strict=True))
    return np.array([*above, *field]) + v


def observation_model(dip: float) -> Callable[[Array, Array], Array]:
    """Observation model h(x, v): directions of "up" and of the field as the body sees them.

    Parameters
    ----------
    dip
        Angle of the field below the horizon, rad.
    """
    return partial(_observe, level=np.cos(dip), up=-np.sin(dip))


def recorded_imu(*, steps: int | None = None) -> Problem:
    """Make the scenario from the record.

    Parameters
    ----------
    steps
        Steps to take, up to 56 939; None is all.

    Returns
    -------
    Problem
        Errors in degrees: total attitude, and about the body axes. Judged are the steps that the
        authors mark, in motion, and of these those with a truth. There are none in the first
        33 s; a scenario without any judges the steps with a truth.

    Raises
    ------
    ValueError
        If there are not that many steps.
    """
    data = load_inertial()
    rate = float(data["rate"])
    count = check_steps(steps, len(data["gyroscope"]) - 1)
    directions = [
        series / np.linalg.norm(series, axis=1, keepdims=True)
        for series in (data["accelerometer"], data["magnetometer"])
    ]
    up, field = directions
    resting = round(REST * rate)
    dip = -float(np.arcsin((up[:resting] * field[:resting]).sum(axis=1).mean()))
    level = field[0] - (field[0] @ up[0]) * up[0]
    x0 = np.zeros(7)
    x0[:4] = triad(level, up[0], physical=True)
    # From east-north-up, scalar first, to the frame of the papers, scalar last.
    quarter = np.array([0.0, 0.0, -np.sqrt(0.5), np.sqrt(0.5)])
    truth = multiply(quarter[:, None], data["truth"][:, [1, 2, 3, 0]].T).T
    known = ~np.isnan(truth[1 : count + 1, 0])
    judged = known & (data["movement"][1 : count + 1] > 0.0)
    return Problem(
        name="recorded-imu",
        states=STATES,
        inputs=BODY_RATES,
        redraw=False,  # the process noise of one step is far below the uncertainty it adds to
        f=process_model(1.0 / rate),
        vectorized=True,
        Q=np.diag([ETA_Q] * 4 + [ETA_D] * 3) / rate**2,
        process_noise=Noise.ADDITIVE,
        observation_noise=Noise.ADDITIVE,
        sensors=Sensor(
            observation_model(dip),
            R=np.diag([SIGMA_A**2] * 3 + [SIGMA_M**2] * 3),
            observations=("up x", "up y", "up z", "field x", "field y", "field z"),
        ),
        x0=x0,
        P0=P0 * np.eye(7),
        data=Data(
            times=np.arange(1, count + 1) / rate,
            inputs=data["gyroscope"][1 : count + 1],
            measurements=np.hstack(directions)[1 : count + 1],
            truth=truth[1 : count + 1],
            judged=judged if judged.any() else known,
        ),
        error=attitude_error,
        error_names=("attitude", "x", "y", "z"),
        error_units=("degrees",) * 4,
    )
