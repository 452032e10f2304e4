"""Estimation problems with their data, and running a filter on them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.backends import Backend
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.models import ObservationModel, ProcessModel
from ukf_sw.spec.parameters import UkfParams

__all__ = ["Results", "Scenario", "run"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scenario:
    """An estimation problem: models, noise, first estimate, and K steps of data.

    Step k predicts with ``inputs[k]``, then updates with ``measurements[k]``; the estimate after it
    belongs to the time ``times[k]`` and to ``truth[k]``.

    Parameters
    ----------
    name
        Name on the command line and in reports.
    params
        Sizes and kinds of noise.
    f, h, vectorized, redraw, state_angles, observation_angles
        Models, as :class:`ukf_sw.filter.UnscentedKalmanFilter` takes them.
    Q, R, x0, P0
        Noise covariances and first estimate.
    times
        Time of each step, shape (K,), in seconds.
    measurements
        Observations, shape (K, m).
    truth
        True states, or whatever `error` compares with, shape (K, ...).
    error
        Function of estimates (K, n) and truth (K, ...) that gives errors (K, e).
    error_names, error_units
        Name and unit of each error, e each.
    inputs
        Input u of each predict, K of them; None gives ``u=None``.
    sampled
        Which observations were sampled, shape (K, m); None is all. A step without any is a
        predict only.
    observation_arguments
        Keyword arguments of h, K of them; None is none.
    judged
        Steps whose errors count, shape (K,); None is all. Records have steps without truth.

    Raises
    ------
    ValueError
        If the data are not K steps long.
    """

    name: str
    params: UkfParams
    f: ProcessModel
    h: ObservationModel
    Q: Array
    R: Array
    x0: Array
    P0: Array
    times: Array
    measurements: Array
    truth: Array
    error: Callable[[Array, Array], Array]
    error_names: tuple[str, ...]
    error_units: tuple[str, ...]
    inputs: Sequence[Any] | Array | None = None
    sampled: NDArray[np.bool_] | None = None
    observation_arguments: Sequence[Mapping[str, Any]] | None = None
    vectorized: bool = False
    redraw: bool | None = None
    state_angles: tuple[int, ...] = ()
    observation_angles: tuple[int, ...] = ()
    judged: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        for name in (
            "measurements", "truth", "inputs", "sampled", "observation_arguments", "judged",
        ):  # fmt: skip
            data = getattr(self, name)
            if data is not None and len(data) != self.steps:
                raise ValueError(f"{name} must have {self.steps} steps, not {len(data)!r}")
        if len(self.error_names) != len(self.error_units):
            raise ValueError(
                f"error_units must have {len(self.error_names)} entries, "
                f"not {len(self.error_units)!r}"
            )

    @property
    def steps(self) -> int:
        """Number of steps, K."""
        return len(self.times)

    def filter(self, backend: Backend | str = "reference") -> UnscentedKalmanFilter:
        """Make a filter for this scenario; see :class:`UnscentedKalmanFilter` for backends."""
        params = self.params if isinstance(backend, str) else backend.params
        return UnscentedKalmanFilter(
            self.f,
            self.h,
            params,
            Q=self.Q,
            R=self.R,
            x0=self.x0,
            P0=self.P0,
            backend=backend,
            vectorized=self.vectorized,
            redraw=self.redraw,
            state_angles=self.state_angles,
            observation_angles=self.observation_angles,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """What a filter made of a scenario.

    Parameters
    ----------
    scenario
        The scenario.
    times
        Time of each step that was run, shape (K,), in seconds.
    x
        Estimate after each step, shape (K, n).
    errors
        Errors of the estimates, shape (K, e); names and units are those of the scenario.
    nis
        Normalised innovation squared of each step, shape (K,); NaN where nothing was sampled.
    gated
        Whether the update was rejected, shape (K,).
    """

    scenario: Scenario
    times: Array
    x: Array
    errors: Array = field(repr=False)
    nis: Array = field(repr=False)
    gated: NDArray[np.bool_] = field(repr=False)

    def rms(self, after: float = -np.inf) -> Array:
        """Root mean square of each error over the judged steps later than a time, shape (e,).

        Raises
        ------
        ValueError
            If there is no such step.
        """
        return np.sqrt(np.mean(self.errors[self._settled(after)] ** 2, axis=0))

    def maximum(self, after: float = -np.inf) -> Array:
        """Largest magnitude of each error over the judged steps later than a time, shape (e,).

        Raises
        ------
        ValueError
            If there is no such step.
        """
        return np.abs(self.errors[self._settled(after)]).max(axis=0)

    def _settled(self, after: float) -> NDArray[np.bool_]:
        chosen = self.times > after
        if chosen.any() and self.scenario.judged is not None:
            chosen &= self.scenario.judged[: len(chosen)]
            if not chosen.any():
                raise ValueError(f"after must leave a step that is judged, not {after!r}")
        if not chosen.any():
            raise ValueError(f"after must be less than {float(self.times[-1])} s, not {after!r}")
        return chosen


def run(
    scenario: Scenario,
    backend: Backend | str = "reference",
    *,
    steps: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    every: int = 100,
) -> Results:
    """Run a filter on a scenario.

    Parameters
    ----------
    scenario
        The scenario.
    backend
        What computes: see :class:`ukf_sw.filter.UnscentedKalmanFilter`.
    steps
        How many steps; None is all.
    progress
        Called with the steps done and their total, every so many steps and at the end.
    every
        How many steps.

    Returns
    -------
    Results

    Raises
    ------
    ValueError
        If there are not that many steps.
    UkfError
        If a step of the filter fails.
    """
    total = scenario.steps if steps is None else steps
    if not 1 <= total <= scenario.steps:
        raise ValueError(f"steps must be between 1 and {scenario.steps}, not {steps!r}")
    ukf = scenario.filter(backend)
    x = np.empty((total, scenario.params.n))
    nis = np.full(total, np.nan)
    gated = np.zeros(total, dtype=np.bool_)
    for k in range(total):
        ukf.predict(None if scenario.inputs is None else scenario.inputs[k])
        mask = None if scenario.sampled is None else scenario.sampled[k]
        if mask is None or mask.any():
            extra = scenario.observation_arguments
            arguments: Mapping[str, Any] = {} if extra is None else extra[k]
            ukf.update(scenario.measurements[k], mask=mask, **arguments)
            nis[k], gated[k] = ukf.nis, ukf.gated
        x[k] = ukf.x
        if progress is not None and ((k + 1) % every == 0 or k + 1 == total):
            progress(k + 1, total)
    return Results(
        scenario=scenario,
        times=scenario.times[:total],
        x=x,
        errors=scenario.error(x, scenario.truth[:total]),
        nis=nis,
        gated=gated,
    )
