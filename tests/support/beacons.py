"""A rover that sees beacons: h takes text, which chooses a model, and arrays; and a compass."""

from dataclasses import replace

import numpy as np

from ukf_sw.problem import Data, Problem, Sensor

STEPS = 6


def drive(x, w, u):
    speed, turn = u
    return np.array([x[0] + speed * np.cos(x[1]) + w[0], x[1] + turn])


def see_beacon(x, v, *, beacon, place, height=0.0):
    offset = place[0] - x[0]
    if beacon == "near":
        return np.array([np.hypot(offset, height) + v[0]])
    return np.array([offset * offset + v[0]])


def see_heading(x, v, **_):
    return x[1:] + v


def simulate(seed, steps):
    """Give data that begin with another beacon if the seed is odd."""
    steps = STEPS if steps is None else steps
    arguments = [
        {"beacon": ("near", "far")[(k + seed) % 2], "place": np.array([5.0 + k, 1.0])}
        for k in range(steps)
    ]
    return Data(
        times=np.arange(float(steps)),
        measurements={name: np.zeros((steps, 1)) for name in ("beacon", "compass")},
        inputs=np.ones((steps, 2)),
        observation_arguments=arguments,
    )


def rover(**changes):
    """Give the problem, with some of it changed."""
    usual = {
        "name": "rover",
        "f": drive,
        "sensors": {
            "beacon": Sensor(see_beacon, R=[[0.01]], m=1),
            "compass": Sensor(see_heading, R=[[0.04]], m=1),
        },
        "x0": [1.0, 0.5],
        "P0": np.eye(2),
        "Q": [[0.01]],
        "inputs": {"speed": "m/s", "turn": "rad/s"},
        "data": simulate(0, None),
    }
    return Problem(**{**usual, **changes})


def with_data(**changes):
    """Give the problem with some of its data changed."""
    problem = rover()
    return replace(problem, data=replace(problem.record, **changes))


simulated = rover(data=simulate)
