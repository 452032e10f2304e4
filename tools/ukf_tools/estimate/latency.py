"""Cycles of a core, from its schedule."""

from typing import Any

from ukf_sw.engine.microcode import microcode
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Program

__all__ = ["latency"]


def latency(params: UkfParams, pipeline: Pipeline) -> dict[str, Any]:
    """Give the cycles of every step, from the schedule.

    Returns
    -------
    dict
        ``steps`` of an iteration and their ``total``: SIG_GEN is free there, because an update
        leaves the next sigma points, and UPDATE is of all sensors, one after the other;
        ``programs``, each with its length from start to end.
    """
    code = microcode(params, pipeline)
    programs = {code.name_of(each): code.clocks(*each) for each in code.programs}
    # Only the first sensor finds the residuals of the prediction.
    updates = [
        code.clocks(Program.UPDATE_REDRAWN if sensor else Program.UPDATE, sensor)
        for sensor in range(len(params.sensor_rows))
    ]
    steps = {"SIG_GEN": 0, "PREDICT": programs["PREDICT"], "UPDATE": sum(updates)}
    return {"steps": steps, "total": sum(steps.values()), "programs": programs}
