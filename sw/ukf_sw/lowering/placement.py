"""Models of a problem on a core: their programs, and the numbers that it must be told for them."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import Any, cast

import numpy as np

from ukf_sw.lowering.program import InputPlace, lower, name_of, places_of_inputs
from ukf_sw.problem import Problem, of_sensor
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import CoreModels, ModelProgram, choose_models
from ukf_sw.tracing.graph import Input
from ukf_sw.tracing.models import TracedModel, TracedProblem, trace_problem
from ukf_sw.tracing.symbols import constants, shape_of

__all__ = ["PlacedModels", "find_models", "place_models"]

#: Inputs with their places in region U.
Needed = tuple[tuple[int, Input], ...]


@dataclass(frozen=True, kw_only=True)
class PlacedModels:
    """Models on a core.

    Parameters
    ----------
    models
        Their programs.
    traced
        What was traced of all models of the problem.
    places
        Inputs in the order of region U; None are those of observation models that are not traced.
    variants
        Number on the core of each observation model that was traced, by its sensor.
    """

    models: CoreModels
    traced: TracedProblem
    places: tuple[InputPlace | None, ...]
    variants: Mapping[str, tuple[int, ...]]

    @property
    def f(self) -> bool:
        """Whether the core evaluates f."""
        return self.models.f is not None

    @property
    def h(self) -> bool:
        """Whether the core evaluates the h of every sensor."""
        return bool(self.models.h)

    def inputs_of_f(self, u: Any, arguments: Mapping[str, Any]) -> dict[int, float]:
        """Give the numbers of region U that f needs, by their place.

        Raises
        ------
        TypeError, ValueError
            If u is not of the shape with which f was traced, or not of finite numbers, or there are
            other arguments.
        """
        if arguments:
            raise TypeError(
                f"predict must have no arguments beside u with f on the core, not {[*arguments]!r}"
            )
        model = self.traced.f
        return self._numbers(model, self._needed[None], {"u": u}, model.call.positional)

    def inputs_of_h(
        self, sensor: str, arguments: Mapping[str, Any]
    ) -> tuple[int, dict[int, float]]:
        """Give the variant of a sensor's h, and the numbers of region U that it needs.

        Raises
        ------
        TypeError, ValueError
            If an argument is not as those with which h was traced.
        """
        variants = self.traced.h[sensor]
        expected = variants[0].call.keywords
        if set(arguments) != set(expected):
            raise TypeError(
                f"update must have the arguments of {of_sensor('h', sensor)} as traced, "
                f"{[*expected]!r}, not {[*arguments]!r}"
            )
        chosen = constants(arguments)
        for variant, model in zip(self.variants[sensor], variants, strict=True):
            if dict(model.constants) == chosen:
                needed = self._needed[sensor, variant]
                return variant, self._numbers(model, needed, arguments, model.call.keywords)
        known = ", ".join(repr(dict(model.constants)) for model in variants)
        raise ValueError(
            f"constants of {of_sensor('h', sensor)} must be those of a program on the core, "
            f"{known}, not {chosen!r}"
        )

    def _numbers(
        self,
        model: TracedModel,
        needed: Needed,
        given: Mapping[str, Any],
        example: Mapping[str, Any],
    ) -> dict[int, float]:
        known = {name: _as_example(value, example[name]) for name, value in given.items()}
        for name, value in known.items():
            if shape_of(value) != shape_of(example[name]):
                raise ValueError(
                    f"{name} must have the shape with which {model.name} was traced, "
                    f"{shape_of(example[name])!r}, not {shape_of(value)!r}"
                )
        found: dict[int, float] = {}
        for place, source in needed:
            value = source.of(known)
            try:
                number = float(value)
            except (TypeError, ValueError):
                raise TypeError(f"{source.label} must be a real number, not {value!r}") from None
            if not isfinite(number):
                raise ValueError(f"{source.label} must be finite, not {number!r}")
            found[place] = number
        return found

    @cached_property
    def _needed(self) -> dict[tuple[str, int] | None, Needed]:
        """What a model takes from region U: None is f, sensor and variant are of an h."""

        def needed(kind: str, model: TracedModel) -> Needed:
            used = set(model.graph.inputs)
            return tuple(
                (place, entry[1])
                for place, entry in enumerate(self.places)
                if entry is not None and entry[0] == kind and entry[1] in used
            )

        found: dict[tuple[str, int] | None, Needed] = {}
        if self.f:
            found[None] = needed("f", self.traced.f)
        for sensor, variants in self.variants.items():
            for variant, model in zip(variants, self.traced.h[sensor], strict=True):
                found[sensor, variant] = needed("h", model)
        return found


def _as_example(value: Any, example: Any) -> Any:
    """Make an array of a list of numbers, as in software, if the example is one."""
    if isinstance(example, np.ndarray) and isinstance(value, (list, tuple)):
        with suppress(ValueError):  # of lists of different lengths there is none
            return np.asarray(cast("Any", value))
    return cast("Any", value)


def place_models(
    problem: Problem, models: str | Mapping[str, str], fmt: FloatFormat | None = None
) -> PlacedModels | None:
    """Make programs of models of a problem; None if all are to be in software.

    Parameters
    ----------
    problem
        The problem. Its data say what the models are called with.
    models
        As :func:`ukf_sw.spec.model_programs.choose_models` takes it.
    fmt
        Number format of the core; None is that of the problem.

    Raises
    ------
    TypeError, ValueError
        As :func:`ukf_sw.spec.model_programs.choose_models`,
        :func:`ukf_sw.tracing.models.trace_problem` and :func:`ukf_sw.lowering.program.lower`.
    """
    which = choose_models(models)
    if not which:
        return None
    traced = trace_problem(problem, which)
    places = places_of_inputs(traced.models)
    return PlacedModels(
        models=lower(traced, problem, problem.format if fmt is None else fmt, which, places),
        traced=traced,
        places=places,
        variants={name: tuple(range(len(own))) for name, own in traced.h.items()},
    )


def find_models(problem: Problem, models: CoreModels, fmt: FloatFormat) -> PlacedModels:
    """Find the models of a problem among the programs of a core.

    The core may have observation models that the data of the problem do not call for, and all of
    them in another order.

    Parameters
    ----------
    problem
        The problem. Its data say what the models are called with.
    models
        Programs of the core.
    fmt
        Its number format.

    Raises
    ------
    TypeError, ValueError
        As :func:`place_models`, or if the core lacks the program of a model.
    """
    which = [kind for kind, there in (("f", models.f), ("h", models.h)) if there]
    traced = trace_problem(problem, which)
    found = {name_of(place): place for place in places_of_inputs(traced.models)}
    places = tuple(found.pop(name, None) for name in models.inputs)
    if found:
        raise _not_of(problem, models, next(iter(found)))
    made = lower(traced, problem, fmt, which, places)

    def number(program: ModelProgram, programs: Sequence[ModelProgram]) -> int:
        for position, other in enumerate(programs):
            if replace(program, title=other.title) == other:
                return position
        raise _not_of(problem, models, program.title)

    if made.f is not None:
        number(made.f, [program for program in (models.f,) if program is not None])
    return PlacedModels(
        models=models,
        traced=traced,
        places=places,
        variants={
            name: tuple(number(program, on_core) for program in own)
            for name, own, on_core in zip(traced.h, made.h, models.h, strict=False)
        },
    )


def _not_of(problem: Problem, models: CoreModels, missing: str) -> ValueError:
    return ValueError(
        f"models of a core for {problem.name} must be those of the problem, {missing} among them, "
        f"not {models.digest:#010x}"
    )
