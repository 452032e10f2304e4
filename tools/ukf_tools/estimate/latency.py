"""Cycles of a core, from its schedule."""

from collections.abc import Mapping
from typing import Any

from ukf_sw.engine.microcode import microcode
from ukf_sw.spec.model_programs import CoreModels
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine, Step, of_sensor
from ukf_tools.estimate.traffic import bus_words

__all__ = ["Chain", "iteration", "latency", "steps_of"]

#: Programs that a step runs, one after the other.
Chain = tuple[Routine, ...]


def _variant(models: CoreModels, sensor: int) -> int:
    """Give the observation model of a sensor that has the most steps."""
    variants = models.h[sensor]
    return max(range(len(variants)), key=lambda variant: len(variants[variant].steps))


def steps_of(params: UkfParams, *, redraws: bool) -> dict[str, Chain]:
    """Give the programs that each step runs, by the name of the step.

    Parameters
    ----------
    params
        What the core computes.
    redraws
        Whether the filter draws new sigma points after every predict.

    Returns
    -------
    dict
        F or PREDICT, SIG_GEN, H or UPDATE of each sensor, one after the other, and ITERATE if the
        core evaluates both models. A SIG_GEN that is not drawn runs nothing. Of several observation
        models of a sensor it is the one that has the most steps.
    """
    models, sensors = params.models, len(params.sensor_rows)
    predict = Routine(Program.PREDICT)
    steps: dict[str, Chain] = {}
    if models.f is None:
        steps[Step.PREDICT.name] = (predict,)
    else:
        steps[Step.F.name] = (Routine(Program.MODEL_F), predict)
    steps[Step.SIG_GEN.name] = (Routine(Program.SIG_GEN_PREDICTED),) if redraws else ()
    for sensor in range(sensors):
        # Only the first sensor finds the residuals of the prediction, if nothing was redrawn.
        redrawn = redraws or sensor > 0
        update = Routine(Program.UPDATE_REDRAWN if redrawn else Program.UPDATE, sensor)
        if models.h:
            name = of_sensor(Step.H.name, sensor, sensors)
            model = Routine(Program.MODEL_H, sensor, _variant(models, sensor))
            steps[name] = (model, update)
        else:
            steps[of_sensor(Step.UPDATE.name, sensor, sensors)] = (update,)
    if models.f is not None and models.h:
        steps[of_sensor(Step.ITERATE.name, 0, sensors)] = (
            *steps[Step.F.name],
            Routine(Program.MODEL_H, 0, _variant(models, 0)),
            Routine(Program.UPDATE),
        )
    return steps


def iteration(params: UkfParams, *, redraws: bool) -> dict[str, Chain]:
    """Give the steps of an iteration, of those that :func:`steps_of` gives.

    Parameters
    ----------
    params, redraws
        As there.

    Returns
    -------
    dict
        A SIG_GEN after PREDICT or F if it redraws, and none after an UPDATE, which leaves the next
        sigma points. ITERATE is F and the H of the first sensor, if the core evaluates both models
        and the filter does not redraw.
    """
    steps = {name: chain for name, chain in steps_of(params, redraws=redraws).items() if chain}
    sensors = len(params.sensor_rows)
    iterate = of_sensor(Step.ITERATE.name, 0, sensors)
    chain = steps.pop(iterate, None)
    if chain is None or redraws:
        return steps
    for name in (Step.F.name, of_sensor(Step.H.name, 0, sensors)):
        del steps[name]
    return {iterate: chain, **steps}


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
        ``steps``, as of :func:`steps_of`, and ``total``, of those that are an :func:`iteration`; a
        SIG_GEN that is not drawn takes none. ``programs``, each with its length from start to end.
        ``bus_words`` of an iteration: see :func:`ukf_tools.estimate.traffic.bus_words`.
    """
    code = microcode(params, pipeline)

    def cycles(chains: Mapping[str, Chain]) -> dict[str, int]:
        return {
            name: sum(code.clocks(*routine) for routine in chain) for name, chain in chains.items()
        }

    return {
        "steps": cycles(steps_of(params, redraws=redraws)),
        "total": sum(cycles(iteration(params, redraws=redraws)).values()),
        "programs": {code.name_of(each): code.clocks(*each) for each in code.programs},
        "bus_words": bus_words(params, redraws=redraws),
    }
