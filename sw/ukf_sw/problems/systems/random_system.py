"""A random system of any sizes: stable, slightly nonlinear."""

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problems.scenario import Scenario
from ukf_sw.spec.parameters import UkfParams

__all__ = ["STEPS", "random_scenario"]

Array = NDArray[np.float64]

#: Steps unless told otherwise.
STEPS = 1000
#: The first estimate is far off, so the first step does not count.
SETTLED = 1.0


def random_scenario(
    params: UkfParams, seed: int = 0, *, P0: float = 1.0, steps: int = STEPS
) -> Scenario:
    """Make a scenario of any sizes.

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
    Scenario
        Errors are those of each state, without units.

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
    D = np.eye(m, r)
    Q = 0.01 * _random_covariance(rng, q)
    R = 0.04 * _random_covariance(rng, r)

    def f(x: Array, w: Array, u: Array) -> Array:
        return A @ (x + 0.1 * np.tanh(x)) / 1.1 + (G @ w if q else 0.0) + u

    def h(x: Array, v: Array) -> Array:
        return C @ x + 0.05 * np.sin(C @ x) + (D @ v if r else 0.0)

    factor_Q = np.linalg.cholesky(Q) if q else Q
    factor_R = np.linalg.cholesky(R) if r else R
    truth = np.empty((steps, n))
    measurements = np.empty((steps, m))
    x = np.sqrt(P0) * rng.standard_normal(n)
    inputs = 0.1 * rng.standard_normal((steps, 1))
    for k in range(steps):
        x = f(x, factor_Q @ rng.standard_normal(q), inputs[k])
        truth[k] = x
        measurements[k] = h(x, factor_R @ rng.standard_normal(r))
    return Scenario(
        name="random",
        params=params,
        f=f,
        h=h,
        vectorized=True,
        Q=Q,
        R=R,
        x0=np.zeros(n),
        P0=P0 * np.eye(n),
        times=np.arange(1, steps + 1, dtype=np.float64),
        inputs=inputs,
        measurements=measurements,
        truth=truth,
        error=lambda estimates, states: estimates - states,
        error_names=tuple(f"x{i}" for i in range(n)),
        error_units=("",) * n,
        settled=SETTLED,
    )


def _random_covariance(rng: np.random.Generator, size: int) -> Array:
    """Make a well-conditioned covariance with a diagonal of about 1."""
    B = rng.standard_normal((size, size)) / np.sqrt(max(size, 1))
    return (B @ B.T + np.eye(size)) / 2.0
