"""The models of a problem, traced and checked: f, and h of each sensor.

The data of the problem say what the models are called with. u of its first step is the example of
u: a number, an array, or a tuple, list or dict of them. Keyword arguments of h are those of
``observation_arguments``: floats and arrays are inputs; text, bool, None and whole numbers are
constants, and each of their values that occurs gives a program of its own. Without data, u is a
vector of the problem's named inputs, or None.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.errors import add_note
from ukf_sw.factors import lower_factor
from ukf_sw.models import check_takes
from ukf_sw.problem import Problem, of_sensor
from ukf_sw.spec.parameters import Noise
from ukf_sw.tracing.check import check
from ukf_sw.tracing.graph import Graph
from ukf_sw.tracing.inputs import by_constants, given_arguments, given_inputs
from ukf_sw.tracing.symbols import constants, shape_of
from ukf_sw.tracing.tracer import Call, trace

__all__ = ["TracedModel", "TracedProblem", "trace_problem"]

Array = NDArray[np.float64]
Given = Mapping[str, Any]

#: Programs that a sensor may have at most.
LARGEST_VARIETY = 16
#: Steps of the data that are compared, and points for each: near the first estimate, and far.
STEPS, POINTS = 20, 16
#: How far, in standard deviations.
NEAR, FAR = 1.0, 30.0


@dataclass(frozen=True, kw_only=True)
class TracedModel:
    """A model with what was traced of it.

    Parameters
    ----------
    call
        How it is called.
    sensor
        Name of the sensor whose h it is; None for f.
    constants
        Keyword arguments that are part of the program.
    graph
        What it computes.
    """

    call: Call
    sensor: str | None = None
    constants: Given
    graph: Graph

    @property
    def name(self) -> str:
        """Its name in messages."""
        return self.call.name

    @property
    def title(self) -> str:
        """Which of the problem's models it is: f, h, or h of gps (device='radar')."""
        title = "f" if self.sensor is None else of_sensor("h", self.sensor)
        shown = ", ".join(f"{name}={value!r}" for name, value in self.constants.items())
        return f"{title} ({shown})" if shown else title


@dataclass(frozen=True, kw_only=True)
class TracedProblem:
    """Models of a problem.

    Parameters
    ----------
    process
        Process model; None if it has not been traced.
    h
        Observation models of each sensor: one for each combination of constants. None of a sensor
        if they have not been traced.
    """

    process: TracedModel | None
    h: Mapping[str, tuple[TracedModel, ...]]

    @property
    def f(self) -> TracedModel:
        """Process model.

        Raises
        ------
        ValueError
            If it has not been traced.
        """
        if self.process is None:
            raise ValueError("f must be among the models that are traced")
        return self.process

    @property
    def models(self) -> tuple[TracedModel, ...]:
        """All of them, f first."""
        own = () if self.process is None else (self.process,)
        return *own, *(model for models in self.h.values() for model in models)


def _check_shapes(what: str, given: Sequence[Any]) -> None:
    """Check that a value has the same shape in each step."""
    first = shape_of(given[0])
    for value in given:
        if shape_of(value) != first:
            raise ValueError(
                f"{what} must have the same shape in every step to be traced, not {first!r} and "
                f"then {shape_of(value)!r}"
            )


def _spread(items: Sequence[Any]) -> list[Any]:
    """Choose some of many, the first and the last among them."""
    chosen = np.unique(np.linspace(0, len(items) - 1, STEPS).round().astype(int))
    return [items[k] for k in chosen]


def _compare(problem: Problem, call: Call, graph: Graph, covariance: Array, data: Any) -> None:
    """Compare a graph with its model for the arguments of some steps, near and far."""
    draws = np.random.default_rng(0)
    spread = lower_factor(problem.P0)
    noise = np.zeros_like(covariance) if call.additive else lower_factor(covariance)
    for given in _spread(data):
        for scale in (NEAR, FAR):
            x = problem.x0[:, np.newaxis] + scale * (
                spread @ draws.standard_normal((len(problem.x0), POINTS))
            )
            x[:, 0] = problem.x0
            w = scale * (noise @ draws.standard_normal((len(noise), POINTS)))
            w[:, 0] = 0.0
            check(call, graph, x, w, given)


def _trace_f(problem: Problem) -> TracedModel:
    inputs = given_inputs(problem)
    _check_shapes("u", inputs)
    call = Call(
        function=problem.f,
        name=check_takes(problem.f, "process model f", ("x", "w", "u")),
        rows=len(problem.x0),
        states=len(problem.x0),
        noise="w",
        terms=len(problem.Q),
        additive=problem.process_noise is Noise.ADDITIVE,
        vectorized=problem.vectorized,
        positional={"u": inputs[0]},
        keywords={},
    )
    try:
        graph = trace(call)
    except Exception as error:
        if inputs[0] is None:
            add_note(
                error, "u is None: there are no inputs in the data of the problem, or no names"
            )
        raise
    _compare(problem, call, graph, problem.Q, [{"u": u} for u in _spread(inputs)])
    return TracedModel(call=call, constants={}, graph=graph)


def _trace_h(problem: Problem, name: str) -> tuple[TracedModel, ...]:
    """Trace h of a sensor, once for each combination of constants."""
    sensor = problem.sensor(name)
    arguments = given_arguments(problem, name)
    of_kind = by_constants(arguments)
    model = check_takes(sensor.h, f"observation model {of_sensor('h', name)}", ("x", "v"))
    if len(of_kind) > LARGEST_VARIETY:
        many = ", ".join(constants(arguments[0]))
        raise ValueError(
            f"{model} must be called with at most {LARGEST_VARIETY} combinations of constants, not "
            f"{len(of_kind)} of {many}: each is a program of its own, so let numbers that change "
            "be floats"
        )
    found: list[TracedModel] = []
    R = cast("Array", sensor.R)
    for kind, steps in of_kind.items():
        for key in steps[0]:
            _check_shapes(key, [step.get(key) for step in steps])
        call = Call(
            function=sensor.h,
            name=model,
            rows=cast("int", sensor.m),
            states=len(problem.x0),
            noise="v",
            terms=len(R),
            additive=problem.observation_noise is Noise.ADDITIVE,
            vectorized=problem.vectorized,
            positional={},
            keywords=steps[0],
        )
        graph = trace(call)
        _compare(problem, call, graph, R, _spread(steps))
        found.append(TracedModel(call=call, sensor=name, constants=dict(kind), graph=graph))
    return tuple(found)


def trace_problem(problem: Problem, which: Collection[str] = ("f", "h")) -> TracedProblem:
    """Trace models of a problem, and compare them with what was traced.

    They are compared for the first estimate and for random points around it, with its covariance
    and far beyond it, with u and the arguments of some steps of the data.

    Parameters
    ----------
    problem
        The problem; data that are yet to be made are not looked at.
    which
        Which of its models; others need not be such as can be traced.

    Raises
    ------
    TraceError
        If a model does what cannot be part of a program.
    TypeError, ValueError
        If a model does not return what it must, u or an argument is of a kind or shape that cannot
        be traced, or what was traced does not give what the model does.
    Exception
        Whatever a model raises, with a note.
    """
    return TracedProblem(
        process=_trace_f(problem) if "f" in which else None,
        h={name: _trace_h(problem, name) if "h" in which else () for name in problem.sensor_names},
    )
