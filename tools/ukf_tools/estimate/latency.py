"""Cycles of a core, from its schedule."""

from typing import Any

from ukf_sw.engine.microcode import microcode
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine, Step

__all__ = ["latency"]


def latency(params: UkfParams, pipeline: Pipeline, *, redraws: bool) -> dict[str, Any]:
    """Give the cycles of every step, from the schedule.

    Parameters
    ----------
    params, pipeline
        The core.
    redraws
        Whether the filter draws new sigma points after every predict.

    Returns
    -------
    dict
        ``steps`` of an iteration and their ``total``: a SIG_GEN after PREDICT if it redraws, and
        none after an UPDATE, which leaves the next sigma points; an UPDATE of each sensor, one
        after the other. ``programs``, each with its length from start to end.
    """
    code = microcode(params, pipeline)
    programs = {code.name_of(each): code.clocks(*each) for each in code.programs}
    drawn = programs["SIG_GEN_PREDICTED"] if redraws else 0
    steps = {Step.PREDICT.name: programs["PREDICT"], Step.SIG_GEN.name: drawn}
    for sensor in range(len(params.sensor_rows)):
        # Only the first sensor finds the residuals of the prediction, if nothing was redrawn.
        redrawn = redraws or sensor > 0
        program = Program.UPDATE_REDRAWN if redrawn else Program.UPDATE
        name = code.name_of(Routine(Program.UPDATE, sensor))
        steps[name] = code.clocks(program, sensor)
    return {"steps": steps, "total": sum(steps.values()), "programs": programs}
