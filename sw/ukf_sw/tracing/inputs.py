"""What the data of a problem call its models with, beside the sigma points.

A filter in C takes all of it as one vector of numbers a step, :class:`InputVector`: u, as its parts
stand in Python; then keyword arguments of h that are floats or arrays, by name; then, for each
sensor whose h takes constants, which of its models it is: 0, 1, and so on, in the order in which
their constants come in the data.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.problem import Problem, of_sensor
from ukf_sw.tracing.graph import Input
from ukf_sw.tracing.symbols import constants, shape_of

__all__ = ["InputVector", "by_constants", "given_arguments", "given_inputs"]

Array = NDArray[np.float64]
Given = Mapping[str, Any]
#: Constants by name, in an order; equal ones are of one model.
Kind = tuple[tuple[str, Any], ...]


def given_inputs(problem: Problem) -> Sequence[Any]:
    """Give u of each step of the data; one example if there are none."""
    if not callable(problem.data) and problem.data is not None:
        given = problem.record.inputs
        return [None] if given is None else list(given)
    return [np.zeros(len(problem.inputs)) if problem.inputs else None]


def given_arguments(problem: Problem, sensor: str) -> Sequence[Given]:
    """Give the keyword arguments of the h of a sensor in the steps in which it was sampled."""
    if callable(problem.data) or problem.data is None:
        return [{}]
    given = problem.record.observation_arguments
    if given is None:
        return [{}]
    _, sampled = problem.samples(sensor)
    own = [arguments for arguments, any_row in zip(given, sampled, strict=True) if any_row.any()]
    return own or given


def by_constants(arguments: Iterable[Given]) -> dict[Kind, list[Given]]:
    """Sort keyword arguments by the constants among them, in the order in which these come."""
    found: dict[Kind, list[Given]] = {}
    for given in arguments:
        found.setdefault(tuple(constants(given).items()), []).append(given)
    return found


def _parts(source: Input, given: Any) -> list[Input]:
    """Name the numbers of a value as :func:`ukf_sw.tracing.symbols.symbols` does."""
    if given is None:
        return []
    inner: list[tuple[Any, Any]]
    if isinstance(given, dict):
        inner = list(cast("dict[str, Any]", given).items())
    elif isinstance(given, (list, tuple)):
        inner = list(enumerate(cast("Sequence[Any]", given)))
    elif isinstance(given, np.ndarray):
        shape = np.shape(cast("Any", given))
        return [replace(source, path=(*source.path, *index)) for index in np.ndindex(*shape)]
    else:
        return [source]
    return [
        part
        for key, value in inner
        for part in _parts(replace(source, path=(*source.path, key)), value)
    ]


@dataclass(frozen=True, kw_only=True)
class InputVector:
    """The numbers that the models of a problem are given in a step, as one vector.

    Parameters
    ----------
    u
        Parts of u.
    arguments
        Parts of the keyword arguments of h that are no constants.
    choices
        Constants of each model of a sensor, by sensor; of those whose h takes some.
    takes
        Names of the arguments that the h of each sensor takes.
    """

    u: tuple[Input, ...]
    arguments: tuple[Input, ...]
    choices: Mapping[str, tuple[Given, ...]]
    takes: Mapping[str, Collection[str]]

    @classmethod
    def of(cls, problem: Problem) -> "InputVector":
        """Find out from the data of a problem what there is.

        Raises
        ------
        ValueError
            If a sensor has no data.
        """
        arguments: dict[Input, None] = {}
        choices: dict[str, tuple[Given, ...]] = {}
        takes: dict[str, Collection[str]] = {}
        for sensor in problem.sensor_names:
            of_kind = by_constants(given_arguments(problem, sensor))
            takes[sensor] = {name for steps in of_kind.values() for name in steps[0]}
            for kind, steps in of_kind.items():
                fixed = dict(kind)
                for name in sorted(set(steps[0]) - set(fixed)):
                    arguments.update(dict.fromkeys(_parts(Input(name), steps[0][name])))
            if any(of_kind):
                choices[sensor] = tuple(dict(kind) for kind in of_kind)
        return cls(
            u=tuple(_parts(Input("u"), given_inputs(problem)[0])),
            arguments=tuple(arguments),
            choices=choices,
            takes=takes,
        )

    def __len__(self) -> int:
        return len(self.u) + len(self.arguments) + len(self.choices)

    @property
    def labels(self) -> tuple[str, ...]:
        """What each number is, for people."""
        chosen = (
            f"which {of_sensor('h', sensor)}: "
            + ", ".join(
                f"{number} {' '.join(f'{key}={value!r}' for key, value in kind.items())}"
                for number, kind in enumerate(kinds)
            )
            for sensor, kinds in self.choices.items()
        )
        return (
            *(source.label for source in self.u),
            *(f"{source.label} of h" for source in self.arguments),
            *chosen,
        )

    def table(self, problem: Problem, steps: int) -> Array:
        """Give the vectors of the first steps of a problem's data, shape (steps, length).

        What belongs to h alone is 0 in a step in which no sensor was sampled whose h takes it.

        Raises
        ------
        ValueError
            If something is no finite number, is missing, has another shape than in the first step,
            or has constants that no model has; the message names it and the step.
        """
        data = problem.record
        extra = data.observation_arguments
        sampled = {
            name: [bool(row.any()) for row in problem.samples(name)[1]]
            for name in problem.sensor_names
        }
        found = np.zeros((steps, len(self)))
        for k in range(steps):
            if data.inputs is not None:
                u = data.inputs[k]
                if shape_of(u) != shape_of(data.inputs[0]):
                    raise ValueError(
                        f"u must have the shape {shape_of(data.inputs[0])} in every step, as in "
                        f"the first one, not {shape_of(u)} at step {k}"
                    )
                found[k, : len(self.u)] = [_number(source, {"u": u}, k) for source in self.u]
            used = {name for name, steps in sampled.items() if steps[k]}
            if extra is not None and used:
                found[k, len(self.u) :] = self._of_h(extra[k], used, k)
        return found

    def _of_h(self, given: Given, used: Collection[str], k: int) -> list[float]:
        needed = {name for sensor in used for name in self.takes[sensor]}
        numbers = [
            _number(source, given, k) if source.argument in needed else 0.0
            for source in self.arguments
        ]
        fixed = constants(given)
        for sensor, kinds in self.choices.items():
            if sensor not in used:
                numbers.append(0.0)
                continue
            if fixed not in kinds:
                raise ValueError(
                    f"constants of {of_sensor('h', sensor)} must be among {[*map(dict, kinds)]!r}, "
                    f"not {fixed!r} at step {k}"
                )
            numbers.append(float(kinds.index(fixed)))
        return numbers


def _number(source: Input, given: Given, k: int) -> float:
    """Find a number."""
    try:
        number = float(np.asarray(source.of(given), dtype=np.float64))
    except (KeyError, IndexError, TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise ValueError(
            f"{source.label} must be a finite number in every step, and is none at step {k}"
        )
    return number
