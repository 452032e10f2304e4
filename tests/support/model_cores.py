"""Cores whose models are programs: of problems of the catalogue."""

from dataclasses import replace
from functools import cache
from typing import Any

from ukf_sw.lowering.program import lower
from ukf_sw.problems.finding import find
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.tracing.models import trace_problem

__all__ = ["PROBLEMS", "model_core"]

#: Problems whose models are small, have several sensors or variants, wrap angles, or take inputs.
PROBLEMS = ("nanosat", "ctrv", "battery", "gps-ins")
#: Steps of the data, so that every variant of an h is among them.
STEPS = 100


@cache
def _problem(name: str) -> Any:
    return find(name).scenario(0, STEPS)


@cache
def model_core(name: str, which: tuple[str, ...] = ("f", "h"), **values: Any) -> UkfParams:
    """Give the parameters of a core that evaluates the models of a problem.

    Parameters
    ----------
    name
        The problem.
    which
        Its models that the core evaluates.
    values
        Other parameters, as pes.
    """
    problem, params = _problem(name), replace(find(name).params, **values)
    return replace(params, models=lower(trace_problem(problem), problem, params.format, which))
