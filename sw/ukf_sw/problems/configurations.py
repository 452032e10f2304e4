"""Configurations that the command line knows by name, and problems to run on them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ukf_sw.problems.scenario import Scenario
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE, nanosat, nanosat_2014
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["CONFIGURATIONS", "Configuration", "Problem", "random_scenario"]


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """A core with a scenario to run on it.

    Parameters
    ----------
    params
        Parameters; form, format and number of processing elements may be replaced.
    doc
        What it is.
    """

    params: UkfParams
    doc: str


CONFIGURATIONS = {
    "nanosat": Configuration(
        params=NANOSAT, doc="Nanosatellite of 2018: slow tumbling, all noise augmented."
    ),
    "nanosat-2014": Configuration(
        params=NANOSAT, doc="Nanosatellite of 2014: 5 degrees at 0.1 Hz, all noise augmented."
    ),
    "nanosat-additive": Configuration(
        params=NANOSAT_ADDITIVE, doc="Nanosatellite of 2018 with additive noise."
    ),
}

_SCENARIOS: dict[str, Callable[..., Scenario]] = {
    "nanosat": nanosat,
    "nanosat-2014": nanosat_2014,
    "nanosat-additive": lambda *args, **keywords: nanosat(*args, noise=Noise.ADDITIVE, **keywords),
}


@dataclass(frozen=True, kw_only=True)
class Problem:
    """How to make a scenario, anywhere: scenarios themselves hold functions.

    Parameters
    ----------
    configuration
        Name of a configuration, or None for a random system of these sizes.
    params
        Sizes, form, format, number of processing elements.
    seed
        Seed of the data.
    P0
        First variance of every state.
    """

    configuration: str | None = None
    params: UkfParams
    seed: int = 0
    P0: float = 1.0

    def scenario(self, steps: int | None = None) -> Scenario:
        """Make the scenario.

        Raises
        ------
        ValueError
            If the scenario does not have as many steps, or P0 is not positive.
        """
        if self.configuration is None:
            count = 1000 if steps is None else steps
            return random_scenario(self.params, self.seed, P0=self.P0, steps=count)
        made = _SCENARIOS[self.configuration](self.seed, P0=self.P0, steps=steps)
        return replace(made, params=self.params)


def random_scenario(
    params: UkfParams, seed: int = 0, *, P0: float = 1.0, steps: int = 1000
) -> Scenario:
    """Make a scenario of any sizes: a random system, stable and slightly nonlinear.

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
    A = rng.standard_normal((n, n))
    A *= 0.95 / max(np.abs(np.linalg.eigvals(A)).max(), 1e-3)
    C = rng.standard_normal((m, n)) / np.sqrt(n)
    G = np.eye(n, q) if params.additive_q else rng.standard_normal((n, q))
    D = np.eye(m, r)
    Q = 0.01 * _random_covariance(rng, q)
    R = 0.04 * _random_covariance(rng, r)

    def f(x, w, u):
        return A @ (x + 0.1 * np.tanh(x)) / 1.1 + (G @ w if q else 0.0) + u

    def h(x, v):
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
    )


def _random_covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    """Make a well-conditioned covariance with a diagonal of about 1."""
    B = rng.standard_normal((size, size)) / np.sqrt(max(size, 1))
    return (B @ B.T + np.eye(size)) / 2.0
