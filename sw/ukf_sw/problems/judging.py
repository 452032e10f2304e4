"""Running filters on problems, up to the first error, and judging the estimates."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ukf_sw.backends import Backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import (
    IllegalStepError,
    NotFiniteError,
    NotPositiveDefiniteError,
    SingularObservationError,
    StepError,
)
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.configurations import Problem
from ukf_sw.problems.scenario import Scenario
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.parameters import Pipeline
from ukf_sw.spec.registers import ErrorCode

__all__ = ["Track", "accuracy", "describe", "iterate", "make_backend", "run_problem"]

#: The filter has settled by then, in seconds of a nanosatellite.
SETTLED = 1.0
#: Attitude error that the filter should stay below, in degrees.
LIMIT = 0.1

_CODES: dict[type[StepError], ErrorCode] = {
    IllegalStepError: ErrorCode.ILLEGAL_STEP,
    NotFiniteError: ErrorCode.NOT_FINITE,
    SingularObservationError: ErrorCode.SINGULAR_OBSERVATION,
    NotPositiveDefiniteError: ErrorCode.NOT_POSITIVE_DEFINITE,
}

Array = NDArray[np.float64]


def make_backend(name: str, problem: Problem, pipeline: Pipeline | None = None) -> Backend:
    """Make a backend for a problem.

    Parameters
    ----------
    name
        "golden" or "reference".
    problem
        The problem.
    pipeline
        How the core is built; decides cycles only.

    Raises
    ------
    ValueError
        If there is no such backend.
    """
    if name == "reference":
        return ReferenceUkf(problem.params)
    if name == "golden":
        return Driver(GoldenBus(GoldenCore(problem.params, pipeline)), problem.params)
    raise ValueError(f"backend must be 'golden' or 'reference', not {name!r}")


def iterate(ukf: UnscentedKalmanFilter, scenario: Scenario, steps: int) -> Iterator[int]:
    """Run a filter on a scenario: gives the number of each step after it.

    Parameters
    ----------
    ukf
        The filter.
    scenario
        The scenario.
    steps
        How many steps.

    Raises
    ------
    UkfError
        If a step of the filter fails.
    """
    for k in range(steps):
        ukf.predict(None if scenario.inputs is None else scenario.inputs[k])
        mask = None if scenario.sampled is None else scenario.sampled[k]
        if mask is None or mask.any():
            arguments = scenario.observation_arguments
            ukf.update(
                scenario.measurements[k], mask, **({} if arguments is None else arguments[k])
            )
        yield k


def describe(error: StepError, iteration: int) -> dict[str, Any]:
    """Describe where an error of the core stopped a run.

    Parameters
    ----------
    error
        The error.
    iteration
        Number of steps of the scenario that had succeeded.
    """
    code = _CODES.get(type(error))
    return {
        "iteration": iteration,
        "step": error.step.name,
        "error": type(error).__name__ if code is None else code.name,
        "code": getattr(error, "code", None) if code is None else int(code),
        "index": getattr(error, "index", None),
        "message": str(error),
    }


def run_problem(
    backend: Backend,
    scenario: Scenario,
    steps: int,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Run a filter on a problem, up to its first error.

    Parameters
    ----------
    backend
        What computes.
    scenario
        The scenario.
    steps
        How many steps.
    progress
        Called with the number of steps done, now and then.

    Returns
    -------
    dict
        ``x``, the estimates, shape (steps done, n); ``stopped``, from :func:`describe`, or None;
        ``last_x``, the estimate that can be read at the end, also after an error.
    """
    estimates: list[Array] = []
    stopped = None
    try:
        ukf = scenario.filter(backend)
        for k in iterate(ukf, scenario, steps):
            estimates.append(ukf.x)
            if progress is not None and k % 200 == 0:
                progress(k + 1)
    except StepError as error:
        stopped = describe(error, len(estimates))
    if progress is not None:
        progress(len(estimates))
    x = np.array(estimates).reshape(-1, scenario.params.n)
    return {"x": x, "stopped": stopped, "last_x": backend.state()}


class Track(NamedTuple):
    """What a filter made of a scenario.

    Parameters
    ----------
    scenario
        The scenario.
    x
        Estimates of its first steps, shape (K, n).
    reference
        Estimates of the float64 reference, shape (K or more, n), or None.
    """

    scenario: Scenario
    x: Array
    reference: Array | None = None


def accuracy(*tracks: Track) -> dict[str, Any]:
    """Judge estimates; those of several runs as if they were one.

    Parameters
    ----------
    tracks
        Runs of one kind of scenario.

    Returns
    -------
    dict
        Root mean square and largest magnitude of every error; for attitudes, the share of the
        steps below 0.1 degrees; ratios and differences to the reference. All of it over the steps
        after 1 s, or over all if there are none. Empty if there is no estimate.
    """
    tracks = tuple(track for track in tracks if len(track.x))
    if not tracks:
        return {}
    settled = [track.scenario.times[: len(track.x)] > SETTLED for track in tracks]
    since = SETTLED
    if not any(part.any() for part in settled):
        settled, since = [np.ones_like(part) for part in settled], 0.0

    def errors_of(estimates: Callable[[Track], Array]) -> Array:
        return np.concatenate([
            track.scenario.error(estimates(track), track.scenario.truth[: len(track.x)])[part]
            for track, part in zip(tracks, settled, strict=True)
        ])  # fmt: skip

    scenario = tracks[0].scenario
    names, units = scenario.error_names, scenario.error_units
    errors = errors_of(lambda track: track.x)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    result: dict[str, Any] = {
        "since": since,
        "steps": len(errors),
        "units": dict(zip(names, units, strict=True)),
        "rms": dict(zip(names, rms.tolist(), strict=True)),
        "maximum": dict(zip(names, np.abs(errors).max(axis=0).tolist(), strict=True)),
    }
    if units[0] == "degrees":
        result["below_0.1_degrees"] = float(np.mean(errors[:, 0] < LIMIT))
    if all(track.reference is not None for track in tracks):
        other = errors_of(lambda track: track.reference[: len(track.x)])
        other_rms = np.sqrt(np.mean(other**2, axis=0))
        differences = [
            np.abs(track.x - track.reference[: len(track.x)])[part].max(initial=0.0)
            for track, part in zip(tracks, settled, strict=True)
        ]
        result["reference"] = {
            "rms": dict(zip(names, other_rms.tolist(), strict=True)),
            # Of the first error, for attitudes the total one.
            "rms_ratio": float(rms[0] / other_rms[0]) if other_rms[0] > 0.0 else None,
            "largest_difference_of_x": float(max(differences)),
        }
        if units[0] == "degrees":
            result["reference"]["below_0.1_degrees"] = float(np.mean(other[:, 0] < LIMIT))
    return result
