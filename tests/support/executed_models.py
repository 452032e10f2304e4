"""Models in software that execute the programs of a core: no schedule, no memory of lanes."""

from dataclasses import replace

import numpy as np

from ukf_sw.elementary.execution import execute
from ukf_sw.lowering.placement import find_models
from ukf_sw.spec.model_programs import NO_MODELS, SourceKind, Temporary

__all__ = ["with_executed_models"]


def _execute(program, x, noise, first_term, inputs):
    """Rows of a program's results, one column a sigma point."""
    fmt, values = program.fmt, {}
    for temporary, source in program.inputs:
        if source.kind is SourceKind.STATE:
            values[temporary] = x[source.index]
        elif source.kind is SourceKind.NOISE:
            values[temporary] = noise[source.index - first_term]
        else:
            values[temporary] = fmt.round(np.array([inputs[source.index]]))
    execute(fmt, program.steps, values)
    rows = [
        values[each] if isinstance(each, Temporary) else np.array([each.value])
        for each in program.outputs
    ]
    return np.array([np.broadcast_to(row, x.shape[1:]) for row in rows])


def _of_columns(model):
    """A model of one sigma point as one of all of them, one column each."""

    def of_all(x, noise, *arguments, **keywords):
        pairs = zip(x.T, noise.T, strict=True)
        return np.array([model(one, term, *arguments, **keywords) for one, term in pairs]).T

    return of_all


def with_executed_models(problem):
    """Give a problem with models on the core as one whose models in software give the same numbers.

    Parameters
    ----------
    problem : Problem
        It has programs of f, of h, or of both; its models take one sigma point, and it has no
        angles, whose measurements a core wraps by itself.
    """
    models = problem.models
    placed = find_models(problem, models, problem.format)
    sensors = {}
    for number, name in enumerate(problem.sensor_names):
        sensor, terms = problem.sensor(name), problem.terms_of(number)
        assert not sensor.angles

        def h(x, v, *, number=number, name=name, first=terms.start, **arguments):
            variant, inputs = placed.inputs_of_h(name, arguments)
            return _execute(models.h[number][variant], x, v, first, inputs)

        sensors[name] = replace(sensor, h=h if models.h else _of_columns(sensor.h))

    def f(x, w, u):
        return _execute(models.f, x, w, 0, placed.inputs_of_f(u, {}))

    return replace(
        problem.for_core(replace(problem.params, models=NO_MODELS)),
        f=_of_columns(problem.f) if models.f is None else f, sensors=sensors, vectorized=True,
    )  # fmt: skip
