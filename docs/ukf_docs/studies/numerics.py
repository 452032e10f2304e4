"""What number format, form and W0 do to the applications: measured on the golden model."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import nan
from typing import Any

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.study import Study, Tell
from ukf_sw.errors import UkfError
from ukf_sw.problem import Problem
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.finding import find
from ukf_sw.problems.judging import judge
from ukf_sw.problems.running import Run, Stop, run
from ukf_sw.spec.float_format import FORMATS
from ukf_sw.spec.parameters import Form

__all__ = ["STUDY", "Measurement", "measure", "measure_formats", "measure_weights"]

FORMAT_NAMES = ("binary16", "bfloat16", "binary32", "binary64")
WEIGHTS = (0.0, 0.5, 0.9, 0.99)
#: Steps of each run.
STEPS = 1200


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """How a core did on an application.

    Parameters
    ----------
    rms
        Root mean square of the first error of the scenario; of the steps before it stopped.
    ratio
        The same, divided by that of the float64 reference with W0 = 0 over the same steps; NaN if
        there was no step.
    steps
        Steps that succeeded.
    stopped
        What stopped it, in short, or None.
    """

    rms: float
    ratio: float
    steps: int
    stopped: str | None

    def __str__(self) -> str:
        if self.stopped is not None:
            return f"stops at {self.steps}: {self.stopped}"
        return f"{self.ratio:.3g}" if self.ratio < 1e3 else f"{self.ratio:.0e}"


def _brief(stop: Stop) -> str:
    """Name an error in a few words."""
    if stop.step is not None:
        kind = stop.kind.__name__.removesuffix("Error")
        return f"{stop.step} {kind}" + ("" if stop.index is None else f" {stop.index}")
    return "model not finite" if stop.kind is ValueError else stop.kind.__name__


def _measure(problem: Problem, backend: str, expected: Run) -> Measurement:
    """Run a filter up to its first error."""
    found = run(problem, backend, ends_at=(UkfError, ValueError))
    stopped = None if found.stop is None else _brief(found.stop)
    judged = judge(found, expected)
    return Measurement(
        rms=judged.errors[0].rms if judged.errors else nan,
        ratio=nan if judged.rms_ratio is None else judged.rms_ratio,
        steps=found.steps,
        stopped=stopped,
    )


def _prepare(name: str, steps: int) -> Run:
    """Run the reference on the beginning of a scenario."""
    entry = find(name)
    try:
        problem = entry.scenario(0, steps)
    except ValueError:  # it has fewer
        problem = entry.scenario(0)
    return run(problem)


def measure_formats(
    name: str, steps: int = STEPS, *, W0: float = 0.0
) -> dict[tuple[Form, str], Measurement]:
    """Measure every form in every format on the beginning of an application."""
    expected = _prepare(name, steps)
    problem = expected.problem
    measured = {}
    for form in Form:
        for format_name in FORMAT_NAMES:
            made = replace(problem, form=form, format=FORMATS[format_name], W0=W0)
            measured[form, format_name] = _measure(made, "golden", expected)
    return measured


def measure_weights(name: str, steps: int = STEPS) -> dict[float, tuple[Measurement, Measurement]]:
    """Measure some W0: the float64 reference, and the core in binary32, square-root form."""
    expected = _prepare(name, steps)
    problem = expected.problem
    measured = {}
    for W0 in WEIGHTS:
        made = replace(problem, W0=W0)
        measured[W0] = (
            _measure(made, "reference", expected),
            _measure(made, "golden", expected),
        )
    return measured


def measure(
    tell: Tell, names: Iterable[str] = tuple(CATALOGUE), steps: int = STEPS
) -> dict[str, dict[str, dict[str, list[str]]]]:
    """Measure formats, forms and W0.

    Parameters
    ----------
    tell
        Called with what is being done.
    names
        Entries of the catalogue.
    steps
        Steps of each run.

    Returns
    -------
    dict
        "formats": by application and form, what each format does; "weights": by application and
        filter, what each W0 does.
    """
    names = list(names)
    formats: dict[str, dict[str, list[str]]] = {}
    weights: dict[str, dict[str, list[str]]] = {}
    for k, name in enumerate(names):
        tell(f"{name}: formats", 2 * k, 2 * len(names))
        found = measure_formats(name, steps)
        formats[name] = {
            form.value: [str(found[form, number]) for number in FORMAT_NAMES] for form in Form
        }
        tell(f"{name}: W0", 2 * k + 1, 2 * len(names))
        pairs = measure_weights(name, steps).values()
        weights[name] = {
            label: [str(pair[row]) for pair in pairs]
            for row, label in enumerate(("float64", "binary32"))
        }
    return {"formats": formats, "weights": weights}


def _rows(measured: dict[str, dict[str, list[str]]]) -> list[tuple[str, ...]]:
    return [
        (name, kind, *cells) for name, kinds in measured.items() for kind, cells in kinds.items()
    ]


def _formats(record: dict[str, Any]) -> str:
    return table(("application", "form", *FORMAT_NAMES), _rows(record["formats"]), left=6)


def _weights(record: dict[str, Any]) -> str:
    heads = [f"{W0:g}" for W0 in WEIGHTS]
    return table(("application", "filter", *heads), _rows(record["weights"]), left=6)


STUDY = Study(
    name="numerics",
    document=DOCS / "numerics.md",
    measure=measure,
    tables={"formats": _formats, "weights": _weights},
)
