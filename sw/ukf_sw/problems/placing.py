"""Models of a problem, by its name, as programs of a core."""

from functools import cache
from pathlib import Path

from ukf_sw.extras import importing
from ukf_sw.problem import Problem
from ukf_sw.problems.finding import find, is_own
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import NO_MODELS, CoreModels, choose_models

__all__ = ["core_models", "example_of"]

#: Steps of data that are made for it, to say what the models are called with.
STEPS = 100


def example_of(name: str, steps: int | None = None, folder: Path | None = None) -> Problem:
    """Give a problem with the beginning of its data; all of them if there are not as many.

    Parameters
    ----------
    name
        Name of the problem.
    steps
        How many; None: all that the user has recorded, 100 of others.
    folder
        Where the module of a problem is looked for first; None is the current one.

    Raises
    ------
    ValueError
        If there is no such problem.
    """
    entry = find(name, folder=folder)
    problem = entry.problem
    if problem.data is None:
        return problem
    if entry.own is not None and not callable(problem.data):
        return problem.with_data(0, min(steps or problem.steps, problem.steps))
    try:
        return entry.scenario(0, steps or STEPS)
    except ValueError:
        return entry.scenario(0)


@cache
def _models(name: str, which: str, fmt: FloatFormat, folder: Path | None) -> CoreModels:
    with importing("golden"):
        from ukf_sw.lowering.placement import place_models

    placed = place_models(example_of(name, folder=folder), which, fmt)
    return NO_MODELS if placed is None else placed.models


def core_models(name: str, which: str, fmt: FloatFormat) -> CoreModels:
    """Make programs of models of a problem.

    Parameters
    ----------
    name
        Name of the problem.
    which
        "core", "software", "f" or "h".
    fmt
        Number format of the core.

    Raises
    ------
    TraceError
        If a model cannot be on a core.
    TypeError, ValueError
        If there is no such problem, or it does not fit; see
        :func:`ukf_sw.lowering.placement.place_models`.
    """
    if not choose_models(which):
        return NO_MODELS
    return _models(name, which, fmt, Path.cwd() if is_own(name) else None)
