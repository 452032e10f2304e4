"""State of charge of a lithium-ion cell from its current and voltage.

State: state of charge (0 to 1), voltages of two RC pairs in V, series resistance in ohms, which the
filter finds as well. Everything is slow and weakly observable: the voltage changes by some
millivolts per percent. Both noises are additive; Q has a condition number of 1e4.
"""

from math import exp

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.systems.simulation import check_steps, draw
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = [
    "BATTERY", "DT", "STEPS", "battery", "current", "observation_model", "open_circuit_voltage",
    "process_model",
]  # fmt: skip

Array = NDArray[np.float64]

BATTERY = UkfParams(
    n=4, m=1, q=4, r=1, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE
)
#: Sampling interval, s.
DT = 1.0
#: Steps of the whole scenario.
STEPS = 7200

CAPACITY = 2.3 * 3600.0  # coulombs
R1, TAU1 = 0.015, 15.0
R2, TAU2 = 0.020, 300.0
R0 = 0.01  # ohms; the true series resistance
DECAY1, DECAY2 = exp(-DT / TAU1), exp(-DT / TAU2)

Q = np.diag([1e-10, 1e-8, 1e-8, 1e-12])
R = np.array([[2.5e-5]])


def open_circuit_voltage(s: Array) -> Array:
    """Voltage at rest over the state of charge."""
    return 3.0 + s * (1.9 + s * (-3.2 + s * (3.6 - 1.15 * s)))


def process_model(x: Array, w: Array, u: float) -> Array:
    """Discharge for a second with the current u in A."""
    return np.array(
        [
            x[0] - DT / CAPACITY * u,
            DECAY1 * x[1] + R1 * (1.0 - DECAY1) * u,
            DECAY2 * x[2] + R2 * (1.0 - DECAY2) * u,
            x[3],
        ]
    ) + w  # fmt: skip


def observation_model(x: Array, v: Array, *, current: float) -> Array:
    """Voltage at the terminals while a current in A flows."""
    return open_circuit_voltage(x[:1]) - x[1:2] - x[2:3] - current * x[3:4] + v


def current(times: Array) -> Array:
    """Load in A, positive when it discharges: pulses of 10 minutes with recuperation and rest."""
    phase = np.mod(times, 600.0)
    return np.select(
        [phase < 240.0, phase < 300.0, phase < 420.0, phase < 450.0],
        [1.5, 0.0, 2.5, -2.0],
        default=0.3,
    ) + 0.5 * np.sin(2.0 * np.pi * times / 47.0)


def battery(seed: int = 0, *, steps: int | None = None) -> Problem:
    """Make the scenario: two hours of a load, from a state of charge of 95 % on.

    The filter starts without knowledge, at 50 % with a standard deviation of 50 %, and believes 20
    milliohms.

    Parameters
    ----------
    seed
        Seed of both noises.
    steps
        Steps to simulate, up to 7200; None is all.

    Returns
    -------
    Problem
        Errors of the state of charge in %, and of the series resistance in milliohms.

    Raises
    ------
    ValueError
        If there are not that many steps.
    """
    count = check_steps(steps, STEPS)
    draws = draw(seed, count, 5)
    times = DT * np.arange(count + 1, dtype=np.float64)
    load = current(times)
    deviations = np.sqrt(np.diag(Q))
    truth = np.empty((count, 4))
    x = np.array([0.95, 0.0, 0.0, R0])
    for k in range(count):
        x = process_model(x, deviations * draws[k, :4], load[k])
        truth[k] = x
    voltage = open_circuit_voltage(truth[:, 0]) - truth[:, 1] - truth[:, 2] - load[1:] * truth[:, 3]
    measured = voltage + np.sqrt(R[0, 0]) * draws[:, 4]

    def error(x: Array, truth: Array) -> Array:
        difference = x - truth
        return np.column_stack((100.0 * difference[:, 0], 1e3 * difference[:, 3]))

    return Problem(
        name="battery",
        states={"state of charge": "", "voltage 1": "V", "voltage 2": "V", "resistance": "ohm"},
        inputs={"current": "A"},
        f=process_model,
        vectorized=True,
        Q=Q,
        process_noise=Noise.ADDITIVE,
        observation_noise=Noise.ADDITIVE,
        sensors=Sensor(observation_model, R=R, observations={"voltage": "V"}),
        x0=np.array([0.5, 0.0, 0.0, 0.02]),
        P0=np.diag([0.5**2, 1e-4, 1e-4, 0.01**2]),
        data=Data(
            times=times[1:],
            inputs=load[:-1],
            measurements=measured[:, None],
            observation_arguments=[{"current": float(ampere)} for ampere in load[1:]],
            truth=truth,
        ),
        error=error,
        error_names=("state of charge", "resistance"),
        error_units=("%", "milliohm"),
    )
