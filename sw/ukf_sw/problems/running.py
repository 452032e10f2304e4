"""Running a filter on the data of a problem: the one loop, on any backend.

::

    from ukf_sw.problems.running import run

    found = run(problem, "golden")
    print(found.x[-1], found.errors[-1])
"""

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.backends import Backend, make_backend
from ukf_sw.errors import REFUSALS, StepError, UkfError, add_note
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Problem
from ukf_sw.spec.fields import as_int

__all__ = ["Estimates", "Run", "Stop", "run"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Stop:
    """The error that ended a run.

    Parameters
    ----------
    iteration
        Number of steps that had succeeded.
    kind
        Class of the error.
    message
        What it said.
    step
        Name of the core's step that failed, or None if it was not one.
    code, index
        Fields of the register ERROR, or None where the error has none.
    """

    iteration: int
    kind: type[Exception]
    message: str
    step: str | None = None
    code: int | None = None
    index: int | None = None

    @classmethod
    def of(cls, error: Exception, iteration: int) -> "Stop":
        """Describe an error that came after so many steps."""
        code = getattr(error, "error_code", None)
        return cls(
            iteration=iteration,
            kind=type(error),
            message=str(error),
            step=error.step.name if isinstance(error, StepError) else None,
            code=getattr(error, "code", None) if code is None else int(code),
            index=getattr(error, "index", None),
        )

    @property
    def error(self) -> str:
        """Name of the core's error code, or else of the class."""
        code = getattr(self.kind, "error_code", None)
        return self.kind.__name__ if code is None else code.name

    def as_dict(self) -> dict[str, Any]:
        """What is known about it, ready for JSON."""
        return {
            "iteration": self.iteration, "step": self.step, "error": self.error,
            "code": self.code, "index": self.index, "message": self.message,
        }  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimates:
    """What a filter gave for K steps; unlike a :class:`Run` it passes between processes.

    Parameters
    ----------
    x
        Estimate after each step, shape (K, n).
    nis_of_sensors
        Normalised innovation squared of each update, shape (K, S) with S sensors; NaN where nothing
        was sampled.
    gated
        Whether any update of the step was rejected, shape (K,).
    stop
        The error that ended the run, or None.
    last_x
        Estimate at the end, shape (n,): after a failed step the one that the core still has or, if
        that is not known, the one after the last step that was done. None if there is none.
    P
        Covariance at the end, shape (n, n), if it was asked for and the run came to its end.
    """

    x: Array
    nis_of_sensors: Array = field(repr=False)
    gated: NDArray[np.bool_] = field(repr=False)
    stop: Stop | None = None
    last_x: Array | None = field(default=None, repr=False)
    P: Array | None = field(default=None, repr=False)

    @property
    def steps(self) -> int:
        """Number of steps that were done, K."""
        return len(self.x)

    @cached_property
    def nis(self) -> Array:
        """Sum over the updates of each step, shape (K,); NaN where nothing was sampled."""
        none = np.isnan(self.nis_of_sensors).all(axis=1)
        return np.where(none, np.nan, np.nansum(self.nis_of_sensors, axis=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Run(Estimates):
    """What a filter made of a problem with data; :func:`ukf_sw.problems.judging.judge` judges it.

    Parameters
    ----------
    problem
        The problem, with its data.
    """

    problem: Problem

    @property
    def times(self) -> Array:
        """Time of each step that was done, shape (K,), in seconds."""
        return self.problem.times[: self.steps]

    @cached_property
    def errors(self) -> Array:
        """Errors of the estimates, shape (K, e); names and units are those of the problem.

        Raises
        ------
        ValueError
            If the problem has no truth.
        """
        return self.problem.errors_of(self.x)

    @property
    def estimates(self) -> Estimates:
        """The same without the problem."""
        return Estimates(**{item.name: getattr(self, item.name) for item in fields(Estimates)})

    @classmethod
    def of(cls, problem: Problem, estimates: Estimates) -> "Run":
        """Put estimates and their problem together again."""
        found = {item.name: getattr(estimates, item.name) for item in fields(Estimates)}
        return cls(problem=problem, **found)


@contextmanager
def _placed(k: int, time: float) -> Generator[None]:
    """Note at which step of the data a model failed."""
    try:
        yield
    except UkfError:  # knows its place
        raise
    except Exception as error:
        add_note(error, f"after {k} iterations, at {time:.9g} s")
        raise


def _iterate(
    ukf: UnscentedKalmanFilter,
    u: Any,
    observations: list[tuple[str, Array, NDArray[np.bool_]]],
    arguments: Mapping[str, Any],
) -> tuple[Array, bool]:
    """Do one step; gives the NIS of each sensor, and whether an update was rejected."""
    nis, gated = np.full(len(observations), np.nan), False
    given = [number for number, (_, _, sampled) in enumerate(observations) if sampled.any()]
    if not given:
        ukf.predict(u)
    for number in given:
        name, z, sampled = observations[number]
        if number == given[0]:
            ukf.iterate(u, z, sampled, sensor=name, **arguments)
        else:
            ukf.update(z, sampled, sensor=name, **arguments)
        nis[number] = ukf.nis
        gated |= ukf.gated
    return nis, gated


def run(
    problem: Problem,
    backend: Backend | str = "reference",
    *,
    steps: int | None = None,
    ends_at: tuple[type[Exception], ...] = (),
    covariance: bool = False,
    after_step: Callable[[int, UnscentedKalmanFilter], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    every: int = 100,
) -> Run:
    """Run a filter on the data of a problem.

    A step predicts, then updates with every sensor of which something was sampled, in their order.

    Parameters
    ----------
    problem
        The problem, with its data.
    backend
        What computes: see :class:`ukf_sw.filter.UnscentedKalmanFilter`.
    steps
        How many steps; None is all.
    ends_at
        Errors that end the run and stand in its ``stop``; all others are raised.
    covariance
        Whether to take P at the end. A core computes it in a step of its own.
    after_step
        Called with the number of steps done and the filter: with 0 when the filter has started, and
        after each step.
    progress
        Called with the steps done and their total, every so many steps and at the end.
    every
        How many steps.

    Returns
    -------
    Run
        Of the steps before the error, if one ended it.

    Raises
    ------
    TypeError
        If a number of steps is not an int.
    ValueError
        If there are not that many steps, or no data.
    UkfError
        If a step of the filter fails and `ends_at` does not have it.
    Exception
        Whatever a model raises, with a note that says at which step.
    """
    data = problem.record
    total = data.steps if steps is None else as_int("steps", steps)
    if as_int("every", every) < 1:
        raise ValueError(f"every must be at least 1, not {every!r}")
    if not 1 <= total <= data.steps:
        raise ValueError(f"steps must be between 1 and {data.steps}, not {steps!r}")
    computer = make_backend(backend, problem.params) if isinstance(backend, str) else backend
    sensors = [(name, *problem.samples(name)) for name in problem.sensor_names]
    inputs: Any = [None] * total if data.inputs is None else data.inputs
    arguments: Any = data.observation_arguments
    if arguments is None:
        arguments = [dict[str, Any]()] * total
    x = np.empty((total, problem.params.n))
    nis = np.full((total, len(sensors)), np.nan)
    gated = np.zeros(total, dtype=np.bool_)
    done, stop = 0, None
    last_x = last_P = None
    try:
        ukf = UnscentedKalmanFilter(problem, computer)
        if after_step is not None:
            after_step(0, ukf)
        # How many steps to do at once; they are done one by one if each is to be seen.
        count = 0 if after_step is not None else total
        while done < total:
            # Not across a step at which progress is told.
            end = min(done + count, done + every - done % every, total)
            if count:
                those = slice(done, end)
                found = ukf.iterate_ahead(
                    inputs[those],
                    [(z[those], sampled[those]) for _, z, sampled in sensors],
                    arguments[those],
                )
                those = slice(done, done + len(found[0]))
                x[those], nis[those] = found
                done = those.stop
                # What has ended it may come again soon.
                count = 2 * len(found[0]) + 1
            if done < end or not count:
                given = [(name, z[done], sampled[done]) for name, z, sampled in sensors]
                with _placed(done, float(data.times[done])):
                    nis[done], gated[done] = _iterate(ukf, inputs[done], given, arguments[done])
                x[done] = ukf.x
                done += 1
            last_x = x[done - 1]
            if after_step is not None:
                after_step(done, ukf)
            if progress is not None and (done % every == 0 or done == total):
                progress(done, total)
        if covariance:
            last_P = ukf.P
    except ends_at as error:
        stop = Stop.of(error, done)
        # After other errors it is not known what the core holds.
        if isinstance(error, REFUSALS):
            last_x = computer.state()
    return Run(
        problem=problem,
        x=x[:done],
        nis_of_sensors=nis[:done],
        gated=gated[:done],
        stop=stop,
        last_x=last_x,
        P=last_P,
    )
