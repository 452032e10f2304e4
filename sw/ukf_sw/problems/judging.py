"""Judging runs: how large the errors are, beside another filter's, and within which bounds.

::

    from ukf_sw.problems.judging import judge
    from ukf_sw.problems.running import run

    judged = judge(run(problem, "golden"), run(problem, "reference"))
    for error in judged.errors:
        print(error.name, error.rms, error.unit)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problems.running import Run

__all__ = [
    "Bound", "JudgedError", "JudgedSensor", "Judgement", "Measure", "Verdict", "judge", "rms_after",
]  # fmt: skip

Array = NDArray[np.float64]
#: What a bound is about.
Measure = Literal["rms", "maximum", "median", "diverged"]


@dataclass(frozen=True, kw_only=True)
class Bound:
    """What an error must be, with the reason.

    Parameters
    ----------
    error
        Name of the error in the problem.
    measure
        Root mean square, or largest magnitude; of the study of SwampSat the median over the flights
        of their root mean squares, or the number of flights that diverged.
    low, high
        Limits, in the unit of the error. An error below what the noise allows is a mistake, too.
    reference
        Value that an independent float64 filter had, or None.
    origin
        Where reference and limits come from.

    Raises
    ------
    ValueError
        If the limits are not in order, or the reference is not within them.
    """

    error: str
    measure: Measure = "rms"
    low: float = 0.0
    high: float
    reference: float | None = None
    origin: str

    def __post_init__(self) -> None:
        if not (isfinite(self.high) and 0.0 <= self.low < self.high):
            raise ValueError(f"high must be more than low, {self.low!r}, not {self.high!r}")
        if self.reference is not None and not self.low <= self.reference <= self.high:
            raise ValueError(
                f"reference must be between {self.low!r} and {self.high!r}, not {self.reference!r}"
            )


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """An error beside its bound.

    Parameters
    ----------
    bound
        The bound.
    value
        What the error was, in its unit; infinite if the filter broke off.
    unit
        Unit of the error; empty if it has none.
    float64
        The same of the float64 reference on the same data, or None.
    """

    bound: Bound
    value: float
    unit: str = ""
    float64: float | None = None

    @property
    def error(self) -> str:
        """Name of the error."""
        return self.bound.error

    @property
    def difference(self) -> float | None:
        """Part by which the error is larger than that of the float64 reference, or None."""
        return self.value / self.float64 - 1.0 if self.float64 else None

    @property
    def okay(self) -> bool:
        """Whether the error is within its bound; NaN is not."""
        return self.bound.low <= self.value <= self.bound.high

    def as_dict(self) -> dict[str, Any]:
        """Give bound, value and verdict, ready for JSON."""
        bound = self.bound
        return {
            "error": bound.error, "measure": bound.measure, "unit": self.unit,
            "value": self.value if isfinite(self.value) else None, "float64": self.float64,
            "difference": self.difference,
            "low": bound.low, "high": bound.high, "reference": bound.reference,
            "origin": bound.origin, "okay": self.okay,
        }  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class JudgedError:
    """How large one error of a problem was.

    Parameters
    ----------
    name, unit
        As the problem has them.
    rms, maximum
        Root mean square, and largest magnitude.
    """

    name: str
    unit: str
    rms: float
    maximum: float


@dataclass(frozen=True, kw_only=True)
class JudgedSensor:
    """How well the observations of a sensor were what the filter expected.

    Parameters
    ----------
    name
        As the problem has it.
    updates
        Number of updates with it.
    nis
        Mean of their normalised innovations squared.
    rows
        Mean number of rows that were sampled: the mean NIS of a filter whose covariances are right.
    """

    name: str
    updates: int
    nis: float
    rows: float


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """How good runs were.

    Parameters
    ----------
    since
        Time after which steps were judged, in seconds; None is from the beginning.
    steps
        Number of steps that were judged.
    errors
        Every error over these steps; none if there was no step, or the truth is not known.
    sensors
        Every sensor with an update in these steps.
    limit
        What the first error should stay below, or None.
    below_limit
        Share of the steps in which it did, or None.
    reference
        Judgement of the other filter over the same steps, or None.
    largest_difference_of_x
        From the other filter's estimates over these steps, or None.
    """

    since: float | None
    steps: int
    errors: tuple[JudgedError, ...]
    sensors: tuple[JudgedSensor, ...] = ()
    limit: float | None = None
    below_limit: float | None = None
    reference: "Judgement | None" = None
    largest_difference_of_x: float | None = None

    @property
    def rms(self) -> Array:
        """Root mean square of each error, shape (e,).

        Raises
        ------
        ValueError
            If the truth is not known.
        """
        if self.steps and not self.errors:
            raise ValueError("problem must have truth, not None, for errors to be judged")
        return np.array([error.rms for error in self.errors])

    @property
    def maximum(self) -> Array:
        """Largest magnitude of each error, shape (e,)."""
        return np.array([error.maximum for error in self.errors])

    @property
    def rms_ratio(self) -> float | None:
        """Root mean square of the first error, of attitudes the total one, to the reference's."""
        if self.reference is None or not self.errors:
            return None
        other = self.reference.errors[0].rms
        return self.errors[0].rms / other if other > 0.0 else None

    def compare(self, bounds: Iterable[Bound]) -> tuple[Verdict, ...]:
        """Compare with bounds.

        Raises
        ------
        ValueError
            If a bound is about an error that the problem does not have, or cannot be judged here.
        """
        return tuple(self._verdict(bound) for bound in bounds)

    def compare_with_reference(
        self, part: float, exceptions: Mapping[str, float] | None = None
    ) -> tuple[Verdict, ...]:
        """Compare every error with the other filter's on the same data.

        Parameters
        ----------
        part
            By which part of the other's root mean square an error may be larger or smaller.
        exceptions
            The same of single errors, by name, where it is another.

        Raises
        ------
        ValueError
            If there is no other filter.
        """
        if self.reference is None:
            raise ValueError("reference must be a run of another filter, not None")
        parts = {error.name: part for error in self.reference.errors} | dict(exceptions or {})
        return self.compare(
            Bound(
                error=error.name,
                low=(1.0 - parts[error.name]) * error.rms,
                high=(1.0 + parts[error.name]) * error.rms,
                reference=error.rms,
                origin="float64 reference on the same data",
            )
            for error in self.reference.errors
            if error.rms > 0.0
        )

    def _verdict(self, bound: Bound) -> Verdict:
        own = self._find(bound)
        return Verdict(
            bound=bound,
            value=getattr(own, bound.measure),
            unit=own.unit,
            float64=(
                None
                if self.reference is None
                else getattr(self.reference._find(bound), bound.measure)
            ),
        )

    def _find(self, bound: Bound) -> JudgedError:
        """Find the error that a bound is about."""
        found = {error.name: error for error in self.errors}
        if bound.error not in found or bound.measure not in ("rms", "maximum"):
            names = ", ".join(found)
            raise ValueError(f"bound must be about the rms or maximum of {names}, not {bound!r}")
        return found[bound.error]

    def as_dict(self) -> dict[str, Any]:
        """Give the errors, those of the reference beside them, ready for JSON."""
        reference = self.reference
        others = (None,) * len(self.errors) if reference is None else reference.errors
        result: dict[str, Any] = {
            "since": self.since,
            "steps": self.steps,
            "errors": [
                {
                    "error": own.name, "unit": own.unit, "rms": own.rms, "maximum": own.maximum,
                    "float64_rms": None if other is None else other.rms,
                }
                for own, other in zip(self.errors, others, strict=True)
            ],
            "sensors": [vars(sensor) for sensor in self.sensors],
            "limit": self.limit,
            "below_limit": self.below_limit,
            "reference": None,
        }  # fmt: skip
        if reference is not None:
            result["reference"] = {
                "rms_ratio": self.rms_ratio,
                "below_limit": reference.below_limit,
                "largest_difference_of_x": self.largest_difference_of_x,
            }
        return result


def _rms(errors: Array) -> Array:
    """Root mean square over the steps, shape (e,) of (K, e)."""
    return np.sqrt(np.mean(errors**2, axis=0))


def _check_after(times: Array, after: float) -> None:
    if not (times > after).any():
        raise ValueError(f"after must be less than {float(times[-1])} s, not {after!r}")


def rms_after(times: Array, errors: Array, after: float) -> float:
    """Root mean square of an error, shape (K,), over the steps later than a time.

    For estimators that are no filter of a problem; :func:`judge` is for those that are.

    Raises
    ------
    ValueError
        If there is no such step.
    """
    _check_after(times, after)
    return float(_rms(errors[times > after]))


def judge(
    runs: Run | Sequence[Run],
    reference: Run | Sequence[Run] | None = None,
    *,
    after: float | None = None,
) -> Judgement:
    """Judge runs of one kind of problem; several as if they were one.

    Parameters
    ----------
    runs
        What to judge.
    reference
        Runs of another filter on the same data, such as the float64 reference, or None. Without
        effect if one of them ended before its run did.
    after
        Time after which errors count, in seconds; None is the problem's ``settled``, or the
        beginning if no run is that long.

    Returns
    -------
    Judgement
        Over the steps after that time that the data want judged.

    Raises
    ------
    ValueError
        If there is no run, or one does not go on after a time that was given.
    """
    own = [runs] if isinstance(runs, Run) else list(runs)
    if not own:
        raise ValueError(f"runs must hold at least one run, not {runs!r}")
    pairs: list[tuple[Run, Run | None]] = [(one, None) for one in own]
    if reference is not None:
        others = [reference] if isinstance(reference, Run) else list(reference)
        pairs = list(zip(own, others, strict=True))
    pairs = [pair for pair in pairs if pair[0].steps]
    since = own[0].problem.settled if after is None else after
    if after is not None:
        for one, _ in pairs:
            _check_after(one.times, after)
    elif not any((one.times > since).any() for one, _ in pairs):
        since = -inf
    found = _judge([one for one, _ in pairs], own[0], since)
    if after is not None and not found.steps:
        raise ValueError(f"after must leave a step that is judged, not {after!r}")
    if not found.steps or any(other is None or other.steps < one.steps for one, other in pairs):
        return found
    compared = [(one, _beginning(other, one.steps)) for one, other in pairs if other is not None]
    differences = [
        np.abs(one.x - other.x)[_chosen(one, since)].max(initial=0.0) for one, other in compared
    ]
    return replace(
        found,
        reference=_judge([other for _, other in compared], own[0], since),
        largest_difference_of_x=float(max(differences)),
    )


def _beginning(run: Run, steps: int) -> Run:
    """Give the first steps of a run."""
    return replace(
        run,
        x=run.x[:steps],
        nis_of_sensors=run.nis_of_sensors[:steps],
        gated=run.gated[:steps],
    )


def _chosen(run: Run, since: float) -> NDArray[np.bool_]:
    """Choose the steps of a run that count, shape (K,)."""
    chosen = run.times > since
    judged = run.problem.record.judged
    return chosen if judged is None else chosen & judged[: run.steps]


def _judge(runs: Sequence[Run], first: Run, since: float) -> Judgement:
    """Judge the steps after a time; name and limit of the errors are those of the first run."""
    problem = first.problem
    chosen = [_chosen(run, since) for run in runs]
    found = Judgement(
        since=since if isfinite(since) else None,
        steps=sum(int(steps.sum()) for steps in chosen),
        errors=(),
        sensors=tuple(_judge_sensors(runs, chosen)),
        limit=problem.limit,
    )
    if not found.steps or problem.record.truth is None:
        return found
    errors = np.concatenate([run.errors[steps] for run, steps in zip(runs, chosen, strict=True)])
    rms = _rms(errors).tolist()
    largest = np.abs(errors).max(axis=0).tolist()
    limit = problem.limit
    return replace(
        found,
        errors=tuple(
            JudgedError(name=name, unit=unit, rms=rms[k], maximum=largest[k])
            for k, (name, unit) in enumerate(
                zip(problem.error_names, problem.error_units, strict=True)
            )
        ),
        below_limit=None if limit is None else float(np.mean(np.abs(errors[:, 0]) < limit)),
    )


def _judge_sensors(
    runs: Sequence[Run], chosen: Sequence[NDArray[np.bool_]]
) -> Iterable[JudgedSensor]:
    """Judge the updates of each sensor in the steps that were chosen."""
    if not runs:
        return
    for number, name in enumerate(runs[0].problem.sensor_names):
        nis = np.concatenate(
            [run.nis_of_sensors[steps, number] for run, steps in zip(runs, chosen, strict=True)]
        )
        rows = np.concatenate(
            [
                run.problem.samples(name)[1][: run.steps][steps].sum(axis=1)
                for run, steps in zip(runs, chosen, strict=True)
            ]
        )
        updated = rows > 0
        if updated.any():
            yield JudgedSensor(
                name=name, updates=int(updated.sum()), nis=float(nis[updated].mean()),
                rows=float(rows[updated].mean()),
            )  # fmt: skip
