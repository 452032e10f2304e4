"""A random system of any sizes: stable, slightly nonlinear."""

import numpy as np
from numpy.typing import NDArray

from ukf_sw.models import ObservationModel
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.spec.parameters import UkfParams

__all__ = ["STEPS", "random_scenario"]

Array = NDArray[np.float64]

#: Steps unless told otherwise.
STEPS = 1000
#: The first estimate is far off, so the first step does not count.
SETTLED = 1.0


def random_scenario(
    params: UkfParams, seed: int = 0, *, P0: float = 1.0, steps: int = STEPS
) -> Problem:
    """Make a problem of any sizes, with its data.

    Parameters
    ----------
    params
        Parameters.
    seed
        Seed of system and data.
    P0
        First variance of every state.
    steps
        Number of steps.

    Returns
    -------
    Problem
        Its sensors are s0, s1, ...; errors are those of each state, without units.

    Raises
    ------
    ValueError
        If P0 is not positive, or there is no step.
    """
    if not (P0 > 0.0 and np.isfinite(P0)):
        raise ValueError(f"P0 must be more than 0, not {P0!r}")
    if steps < 1:
        raise ValueError(f"steps must be at least 1, not {steps!r}")
    n, m, q, r = params.n, params.m, params.q, params.r
    rng = np.random.default_rng(seed)
    raw = rng.standard_normal((n, n))
    A = raw * (0.95 / max(np.abs(np.linalg.eigvals(raw)).max(), 1e-3))
    C = rng.standard_normal((m, n)) / np.sqrt(n)
    G = np.eye(n, q) if params.additive_q else rng.standard_normal((n, q))
    Q = 0.01 * _random_covariance(rng, q)
    R = 0.04 * _random_covariance(rng, r)
    rows = [params.rows_of(sensor) for sensor in range(len(params.sensor_rows))]
    # Each sensor has a share of the noise terms, by its rows.
    terms = [range(r * each.start // m, r * each.stop // m) for each in rows]
    names = [f"s{sensor}" for sensor in range(len(rows))]
    models = [_observation_model(C[_all(own)], len(v)) for own, v in zip(rows, terms, strict=True)]
    blocks = [R[_all(v), _all(v)] for v in terms]

    def f(x: Array, w: Array, u: Array) -> Array:
        return A @ (x + 0.1 * np.tanh(x)) / 1.1 + (G @ w if q else 0.0) + u

    factor_Q = np.linalg.cholesky(Q) if q else Q
    factors_R = [np.linalg.cholesky(block) if block.size else block for block in blocks]
    truth = np.empty((steps, n))
    measurements = {
        name: np.empty((steps, len(own))) for name, own in zip(names, rows, strict=True)
    }
    x = np.sqrt(P0) * rng.standard_normal(n)
    inputs = 0.1 * rng.standard_normal((steps, 1))
    for k in range(steps):
        x = f(x, factor_Q @ rng.standard_normal(q), inputs[k])
        truth[k] = x
        draws = rng.standard_normal(r)
        for name, h, factor, v in zip(names, models, factors_R, terms, strict=True):
            measurements[name][k] = h(x, factor @ draws[_all(v)])
    problem = Problem(
        name="random",
        states=tuple(f"x{i}" for i in range(n)),
        f=f,
        vectorized=True,
        Q=Q,
        process_noise=params.process_noise,
        observation_noise=params.observation_noise,
        sensors={
            name: Sensor(h, R=block, m=len(own))
            for name, h, block, own in zip(names, models, blocks, rows, strict=True)
        },
        x0=np.zeros(n),
        P0=P0 * np.eye(n),
        data=Data(
            times=np.arange(1, steps + 1, dtype=np.float64),
            inputs=inputs,
            measurements=measurements,
            truth=truth,
        ),
        settled=SETTLED,
    )
    return problem.for_core(params)


def _all(of: range) -> slice:
    """Slice of these indices."""
    return slice(of.start, of.stop)


def _observation_model(C: Array, r: int) -> ObservationModel:
    """Make the model of a sensor that sees these combinations of the states, with r noise terms."""
    D = np.eye(len(C), r)

    def h(x: Array, v: Array) -> Array:
        return C @ x + 0.05 * np.sin(C @ x) + (D @ v if r else 0.0)

    return h


def _random_covariance(rng: np.random.Generator, size: int) -> Array:
    """Make a well-conditioned covariance with a diagonal of about 1."""
    B = rng.standard_normal((size, size)) / np.sqrt(max(size, 1))
    return (B @ B.T + np.eye(size)) / 2.0
