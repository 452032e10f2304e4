"""Cycles of a core, from its schedule."""

from typing import Any

from ukf_sw.engine.microcode import microcode
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine, Step, of_sensor

__all__ = ["iteration", "latency"]


def iteration(params: UkfParams, *, redraws: bool) -> dict[str, Routine]:
    """Give the program that each step of an iteration runs, by the name of the step.

    Parameters
    ----------
    params
        What the core computes.
    redraws
        Whether the filter draws new sigma points after every predict.

    Returns
    -------
    dict
        A SIG_GEN after PREDICT if it redraws, and none after an UPDATE, which leaves the next sigma
        points; an UPDATE of each sensor, one after the other.
    """
    steps = {Step.PREDICT.name: Routine(Program.PREDICT)}
    if redraws:
        steps[Step.SIG_GEN.name] = Routine(Program.SIG_GEN_PREDICTED)
    sensors = len(params.sensor_rows)
    for sensor in range(sensors):
        # Only the first sensor finds the residuals of the prediction, if nothing was redrawn.
        redrawn = redraws or sensor > 0
        program = Program.UPDATE_REDRAWN if redrawn else Program.UPDATE
        steps[of_sensor(Step.UPDATE.name, sensor, sensors)] = Routine(program, sensor)
    return steps


def latency(params: UkfParams, pipeline: Pipeline, *, redraws: bool) -> dict[str, Any]:
    """Give the cycles of every step, from the schedule.

    Parameters
    ----------
    params, pipeline
        The core.
    redraws
        As of :func:`iteration`.

    Returns
    -------
    dict
        ``steps`` of an iteration and their ``total``; a SIG_GEN that is not drawn takes none.
        ``programs``, each with its length from start to end.
    """
    code = microcode(params, pipeline)
    programs = {code.name_of(each): code.clocks(*each) for each in code.programs}
    steps = {Step.PREDICT.name: 0, Step.SIG_GEN.name: 0}  # in their order
    for name, each in iteration(params, redraws=redraws).items():
        steps[name] = code.clocks(*each)
    return {"steps": steps, "total": sum(steps.values()), "programs": programs}
