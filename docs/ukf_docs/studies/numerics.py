"""What number format, form and W0 do to the applications: measured on the golden model."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.study import Study, Tell
from ukf_sw.errors import StepError, UkfError
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.judging import iterate
from ukf_sw.problems.scenario import Scenario, run
from ukf_sw.spec.float_format import FORMATS
from ukf_sw.spec.parameters import Form
from ukf_tools.evaluate.runner import find

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


def _brief(error: Exception) -> str:
    """Name an error in a few words."""
    if isinstance(error, StepError):
        kind = type(error).__name__.removesuffix("Error")
        index = getattr(error, "index", None)
        return f"{error.step.name} {kind}" + ("" if index is None else f" {index}")
    return "model not finite" if isinstance(error, ValueError) else type(error).__name__


def _measure(scenario: Scenario, backend: str, expected: np.ndarray, settled: float) -> Measurement:
    """Run a filter up to its first error."""
    stopped = None
    estimates: list[np.ndarray] = []
    try:
        ukf = scenario.filter(backend)
        estimates.extend(ukf.x for _ in iterate(ukf, scenario, scenario.steps))
    except (UkfError, ValueError) as error:
        stopped = _brief(error)
    done = len(estimates)
    if not done:
        return Measurement(rms=np.nan, ratio=np.nan, steps=0, stopped=stopped)
    errors = scenario.error(np.array(estimates), scenario.truth[:done])[:, 0]
    chosen = scenario.times[:done] > settled
    if scenario.judged is not None:
        chosen &= scenario.judged[:done]
    if not chosen.any():
        chosen[:] = True
    rms = float(np.sqrt(np.nanmean(errors[chosen] ** 2)))
    other = float(np.sqrt(np.nanmean(expected[:done][chosen] ** 2)))
    return Measurement(rms=rms, ratio=rms / other, steps=done, stopped=stopped)


def _prepare(name: str, steps: int) -> tuple[Scenario, np.ndarray, float]:
    """Make a scenario, the reference's errors, and the time from which on they count."""
    entry = find(name)
    try:
        scenario = entry.scenario(0, steps)
    except ValueError:  # it has fewer
        scenario = entry.scenario(0)
    settled = entry.settled if scenario.times[-1] > entry.settled else -np.inf
    return scenario, run(scenario).errors[:, 0], settled


def measure_formats(
    name: str, steps: int = STEPS, *, W0: float = 0.0
) -> dict[tuple[Form, str], Measurement]:
    """Measure every form in every format on the beginning of an application."""
    scenario, expected, settled = _prepare(name, steps)
    measured = {}
    for form in Form:
        for format_name in FORMAT_NAMES:
            params = replace(scenario.params, form=form, format=FORMATS[format_name], W0=W0)
            made = replace(scenario, params=params)
            measured[form, format_name] = _measure(made, "golden", expected, settled)
    return measured


def measure_weights(name: str, steps: int = STEPS) -> dict[float, tuple[Measurement, Measurement]]:
    """Measure some W0: the float64 reference, and the core in binary32, square-root form."""
    scenario, expected, settled = _prepare(name, steps)
    measured = {}
    for W0 in WEIGHTS:
        made = replace(scenario, params=replace(scenario.params, W0=W0))
        measured[W0] = (
            _measure(made, "reference", expected, settled),
            _measure(made, "golden", expected, settled),
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
