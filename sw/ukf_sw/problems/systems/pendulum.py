"""Pendulum that swings far, seen by the sine of its angle: the smallest of the systems.

The example of Särkkä and Svensson, *Bayesian Filtering and Smoothing*: state (angle a in rad, rate
b in rad/s), a+ = a + h b, b+ = b - 9.8 h sin(a), observation sin(a). Both noises are additive. Q is
that of white acceleration noise, so it is correlated.
"""

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.systems.simulation import check_steps, draw
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["DT", "PENDULUM", "STEPS", "observation_model", "pendulum", "process_model"]

Array = NDArray[np.float64]

PENDULUM = UkfParams(
    n=2, m=1, q=2, r=1, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE
)
#: Sampling interval, s.
DT = 0.01
#: Steps of the whole scenario.
STEPS = 500

GRAVITY = 9.8
ACCELERATION_DENSITY = 0.01
R = np.array([[0.1]])
Q = ACCELERATION_DENSITY * np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]])


def process_model(x: Array, w: Array, u: None) -> Array:
    """Move the pendulum by one step; without length, as the equations are per metre."""
    return np.array([x[0] + DT * x[1], x[1] - GRAVITY * DT * np.sin(x[0])]) + w


def observation_model(x: Array, v: Array) -> Array:
    """Horizontal position of the bob."""
    return np.sin(x[:1]) + v


def pendulum(seed: int = 0, *, steps: int | None = None) -> Problem:
    """Make the scenario: 5 s from (1.5, 0); the filter believes (1.8, 0).

    Parameters
    ----------
    seed
        Seed of both noises.
    steps
        Steps to simulate, up to 500; None is all.

    Returns
    -------
    Problem
        Errors of angle and rate.

    Raises
    ------
    ValueError
        If there are not that many steps.
    """
    count = check_steps(steps, STEPS)
    draws = draw(seed, count, 3)
    w = draws[:, :2] @ np.linalg.cholesky(Q).T
    truth = np.empty((count, 2))
    x = np.array([1.5, 0.0])
    for k in range(count):
        x = process_model(x, w[k], None)
        truth[k] = x
    return Problem(
        name="pendulum",
        states={"angle": "rad", "rate": "rad/s"},
        f=process_model,
        vectorized=True,
        Q=Q,
        process_noise=Noise.ADDITIVE,
        observation_noise=Noise.ADDITIVE,
        sensors=Sensor(observation_model, R=R, observations=("sine of the angle",)),
        x0=np.array([1.8, 0.0]),
        P0=0.1 * np.eye(2),
        data=Data(
            times=DT * np.arange(1, count + 1, dtype=np.float64),
            measurements=np.sin(truth[:, :1]) + np.sqrt(R[0, 0]) * draws[:, 2:],
            truth=truth,
        ),
    )
