"""Accuracy of a core on a system of the catalogue, ready for the cache of results."""

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
        core reported, which ends the run. Then there are no ``rms``.

    Raises
    ------
    ValueError
        If the scenario does not have that many steps.
    """
    found = run(recipe.scenario(steps), backend, ends_at=(StepError,))
    problem = found.problem
    return {
        "names": list(problem.error_names),
        "units": list(problem.error_units),
        "rms": judge(found).rms.tolist() or None if found.stop is None else None,
        "steps": found.steps,
        "stopped": None if found.stop is None else found.stop.as_dict(),
    }
