"""What number format, form and W0 do to the applications: measured on the golden model."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ukf_sw.errors import StepError, UkfError
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.judging import iterate
from ukf_sw.problems.scenario import Scenario, run
from ukf_sw.spec.float_format import FORMATS
from ukf_sw.spec.parameters import Form
from ukf_tools.evaluate.runner import find

__all__ = ["Measurement", "measure_formats", "measure_weights", "tables"]

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


def tables(
    names: Iterable[str] = tuple(CATALOGUE),
    steps: int = STEPS,
    progress: Callable[[str], None] | None = None,
) -> dict[str, str]:
    """Measure, and make the tables of the document, in Markdown, by the name of their markers."""
    tell = progress or (lambda what: None)
    formats = [
        "| application | form | " + " | ".join(FORMAT_NAMES) + " |",
        "| --- " * (2 + len(FORMAT_NAMES)) + "|",
    ]
    heads = [f"{W0:g}" for W0 in WEIGHTS]
    points = ["| application | filter | " + " | ".join(heads) + " |", "| --- " * 6 + "|"]
    for name in names:
        tell(f"{name}: formats")
        measured = measure_formats(name, steps)
        for form in Form:
            cells = " | ".join(str(measured[form, number]) for number in FORMAT_NAMES)
            formats.append(f"| {name} | {form.value} | {cells} |")
        tell(f"{name}: W0")
        pairs = measure_weights(name, steps).values()
        for row, label in enumerate(("float64", "binary32")):
            cells = " | ".join(str(pair[row]) for pair in pairs)
            points.append(f"| {name} | {label} | {cells} |")
    return {"formats": "\n".join(formats), "weights": "\n".join(points)}
