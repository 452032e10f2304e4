"""Accuracy of a core on a system of the catalogue, ready for the cache of results."""

from dataclasses import replace
from typing import Any

from ukf_sw.errors import StepError
from ukf_sw.problems.judging import judge
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run

__all__ = ["measure_accuracy"]


def measure_accuracy(recipe: Recipe, steps: int, backend: str) -> dict[str, Any]:
    """Run a filter on the beginning of a scenario, and judge it.

    Parameters
    ----------
    recipe
        How to make the scenario; it says the core.
    steps
        How many steps.
    backend
        "golden" or "reference".

    Returns
    -------
    dict
        ``names``, ``units`` and ``rms`` of the errors, judged once the filter has settled, or over
        all steps if it never does; ``steps`` that were done, and ``stopped``: None, or what the
        core reported, which ends the run. Then there are no ``rms``. Without truth the errors are
        the differences from the float64 reference, which has no ``rms`` itself then.

    Raises
    ------
    ValueError
        If the scenario does not have that many steps.
    """
    problem = recipe.scenario(steps)
    known = problem.record.truth is not None
    if not known:
        # What float64 makes of the data is the best that is known.
        data = replace(problem.record, truth=run(problem).x)
        problem = replace(problem, data=data, error=None, error_names=(), error_units=())
    found = run(problem, backend, ends_at=(StepError,))
    judged = found.stop is None and (known or backend != "reference")
    return {
        "names": [
            name if known else f"difference of {name} from float64" for name in problem.error_names
        ],
        "units": list(problem.error_units),
        "rms": judge(found).rms.tolist() or None if judged else None,
        "steps": found.steps,
        "stopped": None if found.stop is None else found.stop.as_dict(),
    }
