"""Which roundings cost the nanosatellite of 2018 accuracy, and which applications are as fine."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.rounded_filter import RoundedFilter, Roundings
from ukf_docs.studies.study import Study, Tell
from ukf_sw.problem import Problem
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.nanosat import nanosat
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.parameters import Noise

__all__ = ["CASES", "STUDY", "measure_resolution", "measure_roundings"]

Array = NDArray[np.float64]

CORE = Roundings(points=True, mean=True, state=True, rest=True)
#: Runs, by the name of their row; all are compared with the one without roundings.
CASES = {
    "all, as the core": CORE,
    "all but the sigma points": replace(CORE, points=False),
    "all but the mean": replace(CORE, mean=False),
    "all but sigma points and mean": replace(CORE, points=False, mean=False),
    "only sigma points and state": Roundings(points=True, state=True),
    "all, dot products fused": replace(CORE, fused=True),
    "all, beside an origin": replace(CORE, origin=True),
}
SEEDS = 8
PES = 10
#: Steps of a run of the reference that shows the resolution.
STEPS = 20000


def measure_roundings(problems: Sequence[Problem], tell: Tell) -> list[dict[str, Any]]:
    """Run a filter with each set of roundings.

    Parameters
    ----------
    problems
        One filter, with data of several seeds.
    tell
        Called with what is being done.

    Returns
    -------
    list of dict
        For each of :data:`CASES` its name, and what it does: "loss", by which part its error is
        larger than without roundings, for each seed; and means over seeds and steps, once settled:
        "deviation", what it believes in beside that, of the quaternion; "variance", what rounding
        the sigma points adds a step, largest of the quaternion; "bias", error of the predicted
        mean in half units in the last place of 1, largest of the quaternion.
    """
    seeds = len(problems)
    cases = [Roundings(), *CASES.values()]
    # Run k is of seed k mod seeds.
    filters = RoundedFilter(
        problems[0],
        np.tile([p.x0 for p in problems], (len(cases), 1)),
        np.repeat(np.array(cases, dtype=object), seeds).tolist(),
    )
    noise = problems[0].process_noise.value
    inputs = np.array([p.record.inputs for p in problems])
    z = np.array([p.samples()[0] for p in problems])
    total, first = inputs.shape[1], int(np.argmax(problems[0].times >= problems[0].settled))
    x = np.empty((total, len(filters.x), 7))
    sums = np.zeros((3, len(filters.x), 7))
    for k in range(total):
        filters.step(np.tile(inputs[:, k], (len(cases), 1)), np.tile(z[:, k], (len(cases), 1)))
        x[k] = filters.x
        if k >= first:
            sums += filters.deviations, filters.points_variance, filters.mean_error
        if k % 100 == 0:
            tell(f"{problems[0].name}, {noise} noise", k, total)

    errors = np.array(
        [_rms(problems[run % seeds], x[:, run]) for run in range(x.shape[1])]
    ).reshape(len(cases), seeds)
    means = (sums / (total - first)).reshape(3, len(cases), seeds, 7)[..., :4]
    deviations, variances, biases = means
    return [
        {
            "noise": noise,
            "case": name,
            "loss": (errors[row] / errors[0] - 1.0).tolist(),
            "deviation": float((deviations[row] / deviations[0]).mean()),
            "variance": float(variances[row].mean(axis=0).max()),
            "bias": float(np.abs(biases[row].mean(axis=0)).max() / (BINARY32.epsilon / 2.0)),
        }
        for row, name in enumerate(CASES, start=1)
    ]


def _rms(problem: Problem, x: Array) -> float:
    """Attitude error of a run after it has settled."""
    late = problem.times >= problem.settled
    return float(np.sqrt((problem.errors_of(x)[late, 0] ** 2).mean()))


class _Watched(ReferenceUkf):
    """Notes by how much each update lowers the standard deviations of the state, beside it."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.params)
        self.noted: list[Array] = []

    def update(self, *arguments: Any, **keywords: Any) -> tuple[float, bool]:
        before = np.sqrt(np.diag(self.covariance()))
        found = super().update(*arguments, **keywords)
        # Spacing of the numbers near x; the smallest points lie sqrt(1 / 2 W1) deviations away.
        _, exponent = np.frexp(np.abs(self.state()))
        half_unit = np.ldexp(BINARY32.epsilon / 2.0, exponent - 1)
        radius = np.sqrt(0.5 / self.params.W1)
        after = np.sqrt(np.diag(self.covariance()))
        self.noted.append((before - after) * radius / half_unit)
        return found


def measure_resolution(name: str, steps: int = STEPS) -> float:
    """By how many half units in the last place an update moves a sigma point.

    Parameters
    ----------
    name
        Of an entry of the catalogue.
    steps
        Steps to run; fewer if it has not as many.

    Returns
    -------
    float
        Of the state where it is least, median of the last fifth of the updates.
    """
    problem = CATALOGUE[name].scenario(0, None)
    watched = _Watched(problem)
    run(problem, watched, steps=min(steps, problem.steps))
    last = watched.noted[len(watched.noted) * 4 // 5 :]
    return float(np.median(last, axis=0).min())


def _measure(tell: Tell) -> dict[str, Any]:
    resolutions: dict[str, float] = {}
    for k, name in enumerate(CATALOGUE):
        tell(name, k, len(CATALOGUE))
        resolutions[name] = measure_resolution(name)
    rows: list[dict[str, Any]] = []
    for noise in Noise:
        problems = [replace(nanosat(seed, noise=noise), pes=PES) for seed in range(SEEDS)]
        rows += measure_roundings(problems, tell)
    return {"resolution": resolutions, "roundings": rows}


def _roundings(record: dict[str, Any]) -> str:
    rows: list[tuple[str, ...]] = []
    for row in record["roundings"]:
        loss = 100.0 * np.array(row["loss"])
        error = loss.std(ddof=1) / np.sqrt(len(loss))
        rows.append(
            (
                row["noise"], row["case"], f"{loss.mean():+.2f} ± {error:.2f} %",
                f"{loss.std(ddof=1):.2f} %", f"{100.0 * (row['deviation'] - 1.0):+.2f} %",
                f"{row['variance']:.1e}", f"{row['bias']:.3f}",
            )
        )  # fmt: skip
    headings = (
        "noise", "rounded", "error", "scatter of a seed", "deviations believed in",
        "variance added a step", "bias of the mean",
    )  # fmt: skip
    return table(headings, rows, left=2)


def _resolution(record: dict[str, Any]) -> str:
    rows = [(name, f"{value:.2g}") for name, value in record["resolution"].items()]
    return table(("application", "half units an update"), rows)


STUDY = Study(
    name="rounding",
    document=DOCS / "numerics.md",
    measure=_measure,
    tables={"roundings": _roundings, "resolution": _resolution},
)
