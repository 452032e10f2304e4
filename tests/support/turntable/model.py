"""A turntable: an encoder sees its angle in each step, an inertial sensor at times its rate.

The models compute with +, -, *, / and sqrt only, as table.c and sensors/sensors.c do, in the same
order.
"""

from dataclasses import replace

import numpy as np

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.spec.parameters import Noise

DRAG, RADIUS, GRAVITY = 0.2, 0.7, 9.81
TURN = 6.283185307179586


def f(x, w, u):
    """Angle and rate after dt under an acceleration; w disturbs that, or is zeros."""
    dt, acceleration = u
    rate = x[1] + dt * (acceleration - DRAG * x[1] + w[0])
    angle = x[0] + dt * (x[1] + rate) / 2.0
    # Within half a turn, so that sigma points come to be on both sides of the cut.
    return np.array([angle - TURN if angle > TURN / 2.0 else angle, rate])


def encoder(x, v):
    """Angle."""
    return x[:1] + v


def inertial(x, v):
    """Rate, and how much acceleration there is at the rim."""
    outward = RADIUS * (x[1] * x[1])
    return np.array([x[1] + v[0], np.sqrt(GRAVITY * GRAVITY + outward * outward) + v[1]])


def simulate(seed, steps):
    """Give data of 60 steps, or as many; the encoder counts from 0 to a whole turn."""
    steps = 60 if steps is None else steps
    rng = np.random.default_rng(seed)
    dt = np.where(np.arange(steps) % 4 == 1, 0.1, 0.05)
    inputs = np.stack([dt, np.where(np.arange(steps) % 20 < 10, 3.0, -1.0)], axis=1)
    w, v = rng.standard_normal((steps, 1)), rng.standard_normal((steps, 3))
    truth = np.empty((steps, 2))
    angle, inert = np.empty((steps, 1)), np.full((steps, 2), np.nan)
    x = np.array([2.5, 1.5])
    for k in range(steps):
        truth[k] = x = f(x, 0.3 * w[k], inputs[k])
        angle[k] = (x[0] + 0.02 * v[k, 0]) % TURN
        if k % 3 == 2:
            inert[k] = inertial(x, 0.05 * v[k, 1:])
        if k % 6 == 5:
            inert[k, 1] = np.nan
    return Data(
        times=np.cumsum(dt), inputs=inputs, truth=truth,
        measurements={"encoder": angle, "inertial": inert},
    )  # fmt: skip


augmented = Problem(
    name="turntable",
    states={"angle": "rad", "rate": "rad/s"},
    state_angles=("angle",),
    inputs={"dt": "s", "acceleration": "rad/s^2"},
    f=f,
    Q=np.array([[0.3**2]]),
    sensors={
        "encoder": Sensor(encoder, R=[[0.02**2]], angles=(0,)),
        "inertial": Sensor(inertial, R=0.05**2 * np.eye(2)),
    },
    x0=np.array([3.0, 1.0]),
    P0=np.eye(2),
    data=simulate,
)
additive = replace(
    augmented,
    Q=np.diag([0.001**2, 0.03**2]),
    process_noise=Noise.ADDITIVE,
    observation_noise=Noise.ADDITIVE,
)
