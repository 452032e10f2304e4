"""Estimation problems with their data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.backends import Backend
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.models import ObservationModel, ProcessModel
from ukf_sw.spec.parameters import UkfParams

__all__ = ["Scenario"]

Array = NDArray[np.float64]


def _check_steps(name: str, data: Any, times: Array) -> None:
    """Check that data have as many entries as there are times."""
    if not hasattr(data, "__len__") or getattr(data, "shape", None) == ():
        raise TypeError(f"{name} must have an entry for each step, not {data!r}")
    if len(data) != len(times):
        raise ValueError(f"{name} must have {len(times)} steps, not {len(data)!r}")


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
        Observations, shape (K, m). Elements that are masked, as NumPy masks arrays, were not
        sampled.
    truth
        True states, or whatever `error` compares with, shape (K, ...). None if it is not known;
        then there are no errors.
    error
        Function of estimates (K, n) and truth (K, ...) that gives errors (K, e); with the truth.
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
    settled
        Time from which on errors count, in seconds: the filter has settled by then.
    limit
        What the first error should stay below, in its unit; None is nothing.

    Raises
    ------
    TypeError
        If the data are no arrays or sequences.
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
    truth: Array | None = None
    error: Callable[[Array, Array], Array] | None = None
    error_names: tuple[str, ...] = ()
    error_units: tuple[str, ...] = ()
    inputs: Sequence[Any] | Array | None = None
    sampled: NDArray[np.bool_] | None = None
    observation_arguments: Sequence[Mapping[str, Any]] | None = None
    vectorized: bool = False
    redraw: bool | None = None
    state_angles: tuple[int, ...] = ()
    observation_angles: tuple[int, ...] = ()
    judged: NDArray[np.bool_] | None = None
    settled: float = float("-inf")
    limit: float | None = None

    def __post_init__(self) -> None:
        for name in (
            "times", "measurements", "truth", "inputs", "sampled", "observation_arguments",
            "judged",
        ):  # fmt: skip
            data = getattr(self, name)
            if data is not None or name in ("times", "measurements"):
                _check_steps(name, data, self.times)
        if len(self.error_names) != len(self.error_units):
            raise ValueError(
                f"error_units must have {len(self.error_names)} entries, "
                f"not {len(self.error_units)!r}"
            )

    @property
    def steps(self) -> int:
        """Number of steps, K."""
        return len(self.times)

    def errors_of(self, x: Array) -> Array:
        """Compare estimates of the first steps, shape (k, n), with the truth; gives (k, e).

        Raises
        ------
        ValueError
            If there is no truth, or no function that compares with it.
        """
        if self.truth is None or self.error is None:
            missing = "truth" if self.truth is None else "error"
            raise ValueError(
                f"the scenario {self.name!r} must have {missing}, not None, to have errors: it can "
                "be run, but what comes out cannot be judged"
            )
        return self.error(x, self.truth[: len(x)])

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
