"""Attitude of a nanosatellite from gyroscope, accelerometer and magnetometer.

The application of Soh and Wu, 2018 and 2014. The state is (q1, q2, q3, q0, beta): attitude
quaternion with the scalar last, and gyroscope bias in rad/s. The process noise is w = (4 quaternion
rates in 1/s, 3 bias rates in rad/s^2), the observation noise v = (3 accelerometer, 3 magnetometer),
in units of the local field.

Where the papers are ambiguous or wrong, this follows the readings that reproduce their results:

- f subtracts the bias from the gyroscope's rate (the papers leave it out of equation 38).
- Noises that the papers give with a unit are standard deviations, although called covariances;
  the quaternion noise 1e-6 is a variance.
- h gives body vectors in the local frame (equation 39 with the matrix of equation 40, which turns
  from the body to the local frame), and the simulated sensors do the same. ``physical=True`` is
  what sensors on a body measure: local vectors in the body frame, with the transposed matrix.
- Sampling at 1 kHz in both.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import pi, radians
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.models import ObservationModel, ProcessModel
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = [
    "BODY_2018",
    "BODY_RATES",
    "NANOSAT",
    "NANOSAT_2014",
    "NANOSAT_2018",
    "NANOSAT_ADDITIVE",
    "OBSERVATIONS",
    "STATES",
    "Body",
    "NanosatSettings",
    "attitude_deviations",
    "attitude_error",
    "multiply",
    "nanosat",
    "nanosat_2014",
    "nanosat_2014_rates",
    "observation_model",
    "process_model",
    "quaternion_of_matrix",
    "rotation_matrix",
    "triad",
]  # fmt: skip

Array = NDArray[np.float64]

#: Names and units of the states, of the observations in units of the local field, and of the
#: inputs, the gyroscope's rates.
STATES = {
    "q1": "", "q2": "", "q3": "", "q0": "",
    "bias x": "rad/s", "bias y": "rad/s", "bias z": "rad/s",
}  # fmt: skip
OBSERVATIONS = (
    "accelerometer x", "accelerometer y", "accelerometer z",
    "magnetometer x", "magnetometer y", "magnetometer z",
)  # fmt: skip
BODY_RATES = {"rate x": "rad/s", "rate y": "rad/s", "rate z": "rad/s"}

#: The filter has settled by then, in seconds.
SETTLED = 1.0
#: Attitude error that the filter should stay below, in degrees.
LIMIT = 0.1

#: The papers' filter: all noise augmented, M = 20, N = 22.
NANOSAT = UkfParams(n=7, m=6, q=7, r=6)
#: The same with additive noise: N = 9.
NANOSAT_ADDITIVE = UkfParams(
    n=7, m=6, q=7, r=6, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE
)


@dataclass(frozen=True, kw_only=True)
class NanosatSettings:
    """Sensors and filter of a scenario.

    Parameters
    ----------
    sigma_g
        Standard deviation of the gyroscope, rad/s.
    sigma_d
        Standard deviation of the bias drift, rad/s^2.
    sigma_a, sigma_m
        Standard deviations of accelerometer and magnetometer, in units of the local field.
    eta_q
        Variance of the quaternion noise, 1/s^2.
    dt
        Sampling interval, s.
    duration
        Length, s.
    """

    sigma_g: float = radians(0.1)
    sigma_d: float
    sigma_a: float = 1e-2
    sigma_m: float
    eta_q: float = 1e-6
    dt: float = 1e-3
    duration: float = 100.0

    @property
    def Q(self) -> Array:
        """Covariance of w, shape (7, 7)."""
        return np.diag([self.eta_q] * 4 + [self.sigma_d**2] * 3)

    @property
    def R(self) -> Array:
        """Covariance of v, shape (6, 6)."""
        return np.diag([self.sigma_a**2] * 3 + [self.sigma_m**2] * 3)


NANOSAT_2018 = NanosatSettings(sigma_d=radians(1e-2), sigma_m=1e-2)
NANOSAT_2014 = NanosatSettings(sigma_d=radians(1.0), sigma_m=1e-3)


@dataclass(frozen=True, kw_only=True)
class Body:
    """A rigid body without torque, for "slow tumbling", which the 2018 paper does not specify.

    Parameters
    ----------
    inertia
        Principal moments of inertia, kg m^2.
    rates
        Body rates at the start, rad/s.
    angles
        Roll, pitch and yaw at the start, rad.
    """

    inertia: tuple[float, float, float]
    rates: tuple[float, float, float]
    angles: tuple[float, float, float]


BODY_2018 = Body(
    inertia=(2.0e-3, 2.2e-3, 1.9e-3),
    rates=(radians(2.0), radians(-1.5), radians(1.0)),
    angles=(0.4, -0.3, 0.8),
)


# Rotations. Quaternions are (q1, q2, q3, q0), Hamilton, from the body to the local frame.


def multiply(p: Array, q: Array) -> Array:
    """Hamilton product p q of quaternions, shape (4, ...)."""
    p1, p2, p3, p0 = p
    q1, q2, q3, q0 = q
    return np.array(
        [
            p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
            p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1,
            p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0,
            p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
        ]
    )


def rotation_matrix(q: Array) -> Array:
    """Matrix A_q, body to local, of quaternions (4, ...): shape (3, 3, ...) (2018, equation 40)."""
    q1, q2, q3, q0 = q
    s1, s2, s3, s0 = q1 * q1, q2 * q2, q3 * q3, q0 * q0
    return np.array(
        [
            [s0 + s1 - s2 - s3, 2.0 * (q1 * q2 - q0 * q3), 2.0 * (q0 * q2 + q1 * q3)],
            [2.0 * (q1 * q2 + q0 * q3), s0 - s1 + s2 - s3, 2.0 * (q2 * q3 - q0 * q1)],
            [2.0 * (q1 * q3 - q0 * q2), 2.0 * (q0 * q1 + q2 * q3), s0 - s1 - s2 + s3],
        ]
    )


def quaternion_of_matrix(A: Array) -> Array:
    """Unit quaternion, shape (4,), of a rotation matrix, shape (3, 3); its largest part is > 0."""
    # K is 4 q q^T for the quaternion q of A: its column with the largest diagonal is the safest.
    trace = np.trace(A)
    K = np.empty((4, 4))
    K[:3, :3] = A + A.T + (1.0 - trace) * np.eye(3)
    K[:3, 3] = K[3, :3] = A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]
    K[3, 3] = 1.0 + trace
    column = K[:, np.argmax(np.diag(K))]
    return column / np.linalg.norm(column)


def _quaternion_of_euler(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Quaternion, shape (4, ...), of A = Rz(yaw) Ry(pitch) Rx(roll)."""

    def about(axis: int, angle: ArrayLike) -> Array:
        half = np.asarray(angle, dtype=np.float64) / 2.0
        q = np.zeros((4, *half.shape))
        q[axis], q[3] = np.sin(half), np.cos(half)
        return q

    return multiply(about(2, yaw), multiply(about(1, pitch), about(0, roll)))


def triad(first: Array, second: Array, *, physical: bool = False) -> Array:
    """Attitude from one sample of two directions (TRIAD).

    Parameters
    ----------
    first, second
        Measured directions, shape (3,), of the magnetometer (x) and the accelerometer (z). The
        first is trusted where they disagree.
    physical
        Whether they were measured in the body frame, as :func:`observation_model` has it.

    Returns
    -------
    array of shape (4,)
        Unit quaternion.

    Raises
    ------
    ValueError
        If the directions are zero or parallel.
    """
    x = first / np.linalg.norm(first) if first.any() else first
    y = np.cross(second, x)
    if not np.linalg.norm(y) > 0.0:
        raise ValueError(f"Directions must not be parallel, not {first!r} and {second!r}")
    y /= np.linalg.norm(y)
    A = np.column_stack((x, y, np.cross(x, y)))
    return quaternion_of_matrix(A.T if physical else A)


# Models.


def _move(x: Array, w: Array, u: Array, *, dt: float) -> Array:
    half = dt / 2.0
    q1, q2, q3, q0 = x[:4]
    r1, r2, r3 = u[0] - x[4], u[1] - x[5], u[2] - x[6]
    moved = x + dt * w
    moved[0] += half * (q0 * r1 + q2 * r3 - q3 * r2)
    moved[1] += half * (q0 * r2 + q3 * r1 - q1 * r3)
    moved[2] += half * (q0 * r3 + q1 * r2 - q2 * r1)
    moved[3] -= half * (q1 * r1 + q2 * r2 + q3 * r3)
    return moved


def process_model(dt: float) -> ProcessModel:
    """Process model f(x, w, u), dead reckoning with the gyroscope (2018, equations 37 and 38).

    The input u is the gyroscope's sample, shape (3,), in rad/s. The noise is multiplied by dt, so
    an additive noise must have the covariance Q dt^2 instead.

    Parameters
    ----------
    dt
        Sampling interval, s.
    """
    return partial(_move, dt=dt)


def _observe(x: Array, v: Array, *, physical: bool) -> Array:
    q1, q2, q3, q0 = x[:4]
    s1, s2, s3, s0 = q1 * q1, q2 * q2, q3 * q3, q0 * q0
    # The elements of A_q in the rows and columns of x and z, and those beside them.
    xx, zz = s0 + s1 - s2 - s3, s0 - s1 - s2 + s3
    xz, zx = 2.0 * (q0 * q2 + q1 * q3), 2.0 * (q1 * q3 - q0 * q2)
    z = np.array(v)
    if physical:
        z[0] += zx
        z[1] += 2.0 * (q0 * q1 + q2 * q3)
        z[2] += zz
        z[3] += xx
        z[4] += 2.0 * (q1 * q2 - q0 * q3)
        z[5] += xz
    else:
        z[0] += xz
        z[1] += 2.0 * (q2 * q3 - q0 * q1)
        z[2] += zz
        z[3] += xx
        z[4] += 2.0 * (q1 * q2 + q0 * q3)
        z[5] += zx
    return z


def observation_model(*, physical: bool = False) -> ObservationModel:
    """Observation model h(x, v), directions of gravity and of the magnetic field.

    Parameters
    ----------
    physical
        False: the papers' A_q b, with b_a = (0, 0, 1) and b_m = (1, 0, 0) (2018, equation 39);
        True: A_q^T b, what sensors on the body measure. g and the field strength are scaled out.
    """
    return partial(_observe, physical=physical)


# Truth.


def _oscillation(times: Array) -> tuple[Array, Array]:
    """Attitude (4, K) and body rates (3, K) of the 2014 paper: 5 degrees at 0.1 Hz, all axes."""
    omega = 2.0 * pi * 0.1
    angle = radians(5.0) * np.sin(omega * times)
    rate = radians(5.0) * omega * np.cos(omega * times)
    s, c = np.sin(angle), np.cos(angle)
    rates = np.array([rate - rate * s, rate * c + rate * s * c, -rate * s + rate * c * c])
    return _quaternion_of_euler(angle, angle, angle), rates


def _runge_kutta(y: Array, step: Array, inertia: tuple[float, float, float]) -> Array:
    """One step of the classic Runge-Kutta method for Euler's equations; y is (q, rates)."""
    J1, J2, J3 = inertia

    def slope(y: Array) -> Array:
        q1, q2, q3, q0, r1, r2, r3 = y
        return np.array(
            [
                0.5 * (q0 * r1 + q2 * r3 - q3 * r2),
                0.5 * (q0 * r2 + q3 * r1 - q1 * r3),
                0.5 * (q0 * r3 + q1 * r2 - q2 * r1),
                -0.5 * (q1 * r1 + q2 * r2 + q3 * r3),
                (J2 - J3) / J1 * r2 * r3,
                (J3 - J1) / J2 * r3 * r1,
                (J1 - J2) / J3 * r1 * r2,
            ]
        )

    k1 = slope(y)
    k2 = slope(y + step * k1 / 2.0)
    k3 = slope(y + step * k2 / 2.0)
    k4 = slope(y + step * k3)
    return y + step * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0


def _tumbling(times: Array, body: Body) -> tuple[Array, Array]:
    """Attitude (4, K) and body rates (3, K) of a body without torque."""
    # Rates are a few degrees per second: steps of 0.05 s have errors far below 1e-10, so every
    # sample is one step of its own length away from a node.
    spacing = np.array(0.05)
    nodes = np.floor(times / spacing + 1e-9).astype(np.int64)
    y = np.empty((7, int(nodes.max()) + 1))
    y[:4, 0] = _quaternion_of_euler(*body.angles)
    y[4:, 0] = body.rates
    for k in range(1, y.shape[1]):
        y[:, k] = _runge_kutta(y[:, k - 1], spacing, body.inertia)
        y[:4, k] /= np.linalg.norm(y[:4, k])
    samples = _runge_kutta(y[:, nodes], times - nodes * spacing, body.inertia)
    return samples[:4] / np.linalg.norm(samples[:4], axis=0), samples[4:]


# Errors.


def attitude_error(x: Array, truth: Array) -> Array:
    """Attitude errors of estimates.

    Parameters
    ----------
    x
        Estimates, shape (K, 4 or more); the quaternion need not have unit length.
    truth
        True states, shape (K, 4 or more).

    Returns
    -------
    array of shape (K, 4)
        Total error, then its components about the body axes x, y and z (the rotation vector from
        the true to the estimated body frame), in degrees.
    """
    inverse = truth[:, :4].T * np.array([[-1.0], [-1.0], [-1.0], [1.0]])
    difference = multiply(inverse, x[:, :4].T)
    difference *= np.where(difference[3] < 0.0, -1.0, 1.0)
    length = np.linalg.norm(difference[:3], axis=0)
    angle = 2.0 * np.arctan2(length, difference[3])
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(length > 0.0, angle / length, 0.0)
    return np.degrees(np.vstack((angle, difference[:3] * scale))).T


def attitude_deviations(x: Array, P: Array) -> Array:
    """Standard deviations of the attitude errors that covariances stand for, if they are small.

    Parameters
    ----------
    x
        Estimates, shape (K, 4 or more).
    P
        Their covariances, shape (K, 4 or more, 4 or more).

    Returns
    -------
    array of shape (K, 4)
        As :func:`attitude_error`; for the total error the root of its mean square. In degrees.
    """
    length = np.linalg.norm(x[:, :4], axis=1)
    inverse = (x[:, :4] / length[:, None]).T * np.array([[-1.0], [-1.0], [-1.0], [1.0]])
    # Columns of the error's derivative, which is linear in the quaternion: 2 (q* d) of its vector.
    columns = [multiply(inverse, np.eye(4)[i][:, None])[:3] for i in range(4)]
    derivative = 2.0 * np.array(columns).transpose(2, 1, 0) / length[:, None, None]
    variances = np.einsum("kai,kij,kaj->ka", derivative, P[:, :4, :4], derivative)
    total = variances.sum(axis=1, keepdims=True)
    return np.degrees(np.sqrt(np.hstack((total, variances))))


# Scenarios.


def _simulate(
    name: str,
    settings: NanosatSettings,
    motion: Callable[[Array], tuple[Array, Array]],
    *,
    seed: int,
    P0: float,
    noise: Noise,
    physical: bool,
    steps: int | None,
) -> Problem:
    """Simulate sensors over a motion."""
    dt = settings.dt
    whole = round(settings.duration / dt)
    count = whole if steps is None else steps
    if not 1 <= count <= whole:
        raise ValueError(f"steps must be between 1 and {whole}, not {steps!r}")
    if not (P0 > 0.0 and np.isfinite(P0)):
        raise ValueError(f"P0 must be more than 0, not {P0!r}")
    # Drawn sample by sample, so that fewer steps are a beginning of more.
    draws = np.random.default_rng(seed).standard_normal((count + 1, 12))
    times = np.arange(count + 1, dtype=np.float64) * dt
    q, rates = motion(times)

    beta = np.zeros((3, count + 1))
    beta[:, 1:] = np.cumsum(settings.sigma_d * dt * draws[:-1, 0:3], axis=0).T
    gyroscope = rates + beta + settings.sigma_g * draws[:, 3:6].T
    h = observation_model(physical=physical)
    deviations = np.sqrt(np.diag(settings.R))
    observations = np.asarray(h(q, deviations[:, None] * draws[:, 6:12].T))

    x0 = np.zeros(7)
    x0[:4] = triad(observations[3:, 0], observations[:3, 0], physical=physical)
    return Problem(
        name=name,
        states=STATES,
        inputs=BODY_RATES,
        redraw=False,  # the process noise of one step is far below the uncertainty it adds to
        f=process_model(dt),
        vectorized=True,
        Q=settings.Q if noise is Noise.AUGMENTED else settings.Q * dt**2,
        process_noise=noise,
        observation_noise=noise,
        sensors=Sensor(h, R=settings.R, observations=OBSERVATIONS),
        x0=x0,
        P0=P0 * np.eye(7),
        data=Data(
            times=times[1:],
            inputs=np.ascontiguousarray(gyroscope[:, :-1].T),
            measurements=np.ascontiguousarray(observations[:, 1:].T),
            truth=np.vstack((q, beta))[:, 1:].T,
        ),
        error=attitude_error,
        error_names=("attitude", "x", "y", "z"),
        error_units=("degrees",) * 4,
        settled=SETTLED,
        limit=LIMIT,
    )


def nanosat(
    seed: int = 0,
    *,
    P0: float = 1.0,
    noise: Noise = Noise.AUGMENTED,
    physical: bool = False,
    steps: int | None = None,
    settings: NanosatSettings = NANOSAT_2018,
) -> Problem:
    """Problem of the 2018 paper: slow tumbling.

    Parameters
    ----------
    seed
        Seed of the sensor noise.
    P0
        First variance of every state; the paper has 1.
    noise
        How both noises enter the filter; the papers have them augmented.
    physical
        Whether sensors and model are those of :func:`observation_model` with ``physical=True``.
    steps
        Steps to simulate; None is the whole duration.
    settings
        Sensors.

    Returns
    -------
    Problem
        Errors in degrees: total attitude, and about the body axes.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    return _simulate(
        "nanosat", settings, lambda times: _tumbling(times, BODY_2018),
        seed=seed, P0=P0, noise=noise, physical=physical, steps=steps,
    )  # fmt: skip


def nanosat_2014(
    seed: int = 0,
    *,
    P0: float = 1.0,
    noise: Noise = Noise.AUGMENTED,
    physical: bool = False,
    steps: int | None = None,
    settings: NanosatSettings = NANOSAT_2014,
) -> Problem:
    """Problem of the 2014 paper: oscillation about all axes. Arguments as :func:`nanosat`."""
    return _simulate(
        "nanosat-2014", settings, _oscillation,
        seed=seed, P0=P0, noise=noise, physical=physical, steps=steps,
    )  # fmt: skip


#: Mean interval of the vector sensors when they are slower than the gyroscope, in samples of it.
EVERY = 10


def nanosat_2014_rates(
    seed: int = 0,
    *,
    gaps: Literal["regular", "random"] = "regular",
    P0: float = 1.0,
    noise: Noise = Noise.AUGMENTED,
    steps: int | None = None,
    settings: NanosatSettings = NANOSAT_2014,
) -> Problem:
    """Problem of the 2014 paper with predict and update at rates of their own.

    The gyroscope is sampled at 1 kHz, so there are 1000 predicts a second; the vector sensors at
    100 Hz.

    Parameters
    ----------
    seed, P0, noise, steps, settings
        As for :func:`nanosat`.
    gaps
        "regular": every tenth sample of the gyroscope has both vector sensors. "random": each
        vector sensor by itself has gaps of 1 to 19 samples, all equally likely, so most updates
        are of one sensor and mask the other.

    Returns
    -------
    Problem

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    if gaps not in ("regular", "random"):
        raise ValueError(f"gaps must be 'regular' or 'random', not {gaps!r}")
    made = nanosat_2014(seed, P0=P0, noise=noise, steps=steps, settings=settings)
    measured, _ = made.samples()
    sampled = np.zeros((made.steps, 6), dtype=np.bool_)
    if gaps == "regular":
        sampled[EVERY - 1 :: EVERY] = True
    else:
        whole = round(settings.duration / settings.dt)
        # Drawn for the whole duration, so that fewer steps are a beginning of more.
        drawn = np.random.default_rng((seed, 1)).integers(1, 2 * EVERY, size=(whole, 2))
        at = np.cumsum(drawn, axis=0) - 1
        for sensor, rows in enumerate((slice(0, 3), slice(3, 6))):
            sampled[at[at[:, sensor] < made.steps, sensor], rows] = True
    data = replace(made.record, measurements=np.where(sampled, measured, np.nan), sampled=sampled)
    return replace(made, name=f"nanosat-2014-{gaps}", data=data)
