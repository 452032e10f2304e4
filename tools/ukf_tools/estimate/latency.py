"""Cycles of a core, from its schedule."""

from typing import Any

from ukf_sw.engine.microcode import microcode
from ukf_sw.spec.parameters import Pipeline, UkfParams

__all__ = ["latency"]


def latency(params: UkfParams, pipeline: Pipeline) -> dict[str, Any]:
    """Give the cycles of every step, from the schedule.

    Returns
    -------
    dict
        ``steps`` of an iteration and their ``total``: SIG_GEN is free there, because an update
        leaves the next sigma points; ``programs``, each with its length from start to end.
    """
    code = microcode(params, pipeline)
    programs = {code.name_of(each): code.clocks(*each) for each in code.programs}
    steps = {"SIG_GEN": 0, "PREDICT": programs["PREDICT"], "UPDATE": programs["UPDATE"]}
    return {"steps": steps, "total": sum(steps.values()), "programs": programs}
