"""Models in software that compute what a core would, bit for bit.

::

    rounded = in_core_arithmetic(problem)
    run(rounded, "reference")  # all is float64 but f and h

shows what the arithmetic of models on the core does to the estimates, and nothing else. The same
programs as C are in :mod:`ukf_sw.lowering.c_problem`.

Angles are not wrapped in these programs: that is left to the filter, as with models in software.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.elementary.execution import execute_program
from ukf_sw.lowering.program import InputPlace, lower_model
from ukf_sw.problem import Problem, of_sensor
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import ModelProgram, SourceKind
from ukf_sw.tracing.inputs import InputVector
from ukf_sw.tracing.models import trace_problem
from ukf_sw.tracing.symbols import constants

__all__ = ["SoftwareModels", "in_core_arithmetic", "software_models"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SoftwareModels:
    """Programs of all models of a problem, for whoever calls them with a sensor's own noise.

    Parameters
    ----------
    problem
        The problem.
    fmt
        Number format.
    inputs
        Numbers that the models are given, in the order of the inputs of the programs.
    f
        Process model.
    h
        Observation models of each sensor, one for each combination of its constants.
    """

    problem: Problem
    fmt: FloatFormat
    inputs: InputVector
    f: ModelProgram
    h: Mapping[str, tuple[ModelProgram, ...]]

    def evaluate_f(self, x: Array, w: Array, u: Any = None) -> Array:
        """Evaluate f at K sigma points, as a vectorized model does; gives shape (n, K)."""
        return execute_program(self.f, self._numbers(x, w, {"u": u}, self.inputs.u, 0))

    def evaluate_h(self, sensor: str, x: Array, v: Array, **arguments: Any) -> Array:
        """Evaluate h of a sensor at K sigma points; gives shape (m, K).

        Raises
        ------
        ValueError
            If there is no program for the constants among the arguments.
        """
        kinds = self.inputs.choices.get(sensor, ({},))
        fixed = constants(arguments)
        if fixed not in kinds:
            raise ValueError(
                f"constants of {of_sensor('h', sensor)} must be those of a program, "
                f"{', '.join(map(repr, kinds))}, not {fixed!r}"
            )
        given = self._numbers(x, v, arguments, self.inputs.arguments, len(self.inputs.u))
        return execute_program(self.h[sensor][kinds.index(fixed)], given)

    @property
    def rounded(self) -> Problem:
        """The problem with these as its models, vectorized, but for those that its core has."""
        own, problem = self.problem.models, self.problem
        changes: dict[str, Any] = {} if own.f is not None else {"f": self.evaluate_f}
        if not own.h:
            changes["sensors"] = {
                name: replace(problem.sensor(name), h=partial(self.evaluate_h, name))
                for name in problem.sensor_names
            }
        return replace(problem, vectorized=True, **changes) if changes else problem

    def _numbers(
        self, x: Array, noise: Array, given: Mapping[str, Any], sources: Any, first: int
    ) -> dict[SourceKind, Array]:
        """Give what a program takes; of the inputs those that are another model's are NaN."""
        numbers = np.full((len(self.inputs), 1), np.nan)
        for place, source in enumerate(sources, first):
            if source.argument in given:
                numbers[place] = source.of(given)
        return {SourceKind.STATE: x, SourceKind.NOISE: noise, SourceKind.INPUT: numbers}


def software_models(problem: Problem, fmt: FloatFormat | None = None) -> SoftwareModels:
    """Make programs of the models of a problem, for software.

    Parameters
    ----------
    problem
        The problem. Its data say what the models are called with.
    fmt
        Number format; None is that of the problem.

    Raises
    ------
    TraceError, TypeError, ValueError
        As :func:`ukf_sw.tracing.models.trace_problem` and
        :func:`ukf_sw.lowering.program.lower_model`.
    """
    fmt = problem.format if fmt is None else fmt
    traced = trace_problem(problem)
    inputs = InputVector.of(problem)
    places: list[InputPlace] = [("f", source) for source in inputs.u]
    places += [("h", source) for source in inputs.arguments]
    return SoftwareModels(
        problem=problem,
        fmt=fmt,
        inputs=inputs,
        f=lower_model(traced.f, fmt, places),
        h={
            name: tuple(lower_model(model, fmt, places) for model in models)
            for name, models in traced.h.items()
        },
    )


def in_core_arithmetic(problem: Problem, fmt: FloatFormat | None = None) -> Problem:
    """Give the same problem with models, in software, that are rounded as on a core.

    A filter that is float64 otherwise then shows what the arithmetic of models on a core does to
    the estimates. Models of the result are vectorized.

    Parameters
    ----------
    problem
        The problem. Its data say what the models are called with.
    fmt
        Number format of the models; None is that of the problem.

    Raises
    ------
    TraceError, TypeError, ValueError
        As :func:`software_models`.
    """
    return software_models(problem, fmt).rounded
