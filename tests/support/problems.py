"""What tests of problems share."""

from dataclasses import replace
from typing import Any

from ukf_sw.problem import Problem, Sensor
from ukf_sw.spec.fields import parameters_of
from ukf_sw.spec.parameters import UkfParams


def core_of(params: UkfParams) -> dict[str, Any]:
    """Arguments that a Problem has for such a core: all but the sizes, which follow from others."""
    names = [name for name in parameters_of(UkfParams) if name not in ("n", "m", "q", "r")]
    return {name: getattr(params, name) for name in names if name != "sensors"}


def only_sensor(problem: Problem) -> Sensor:
    """Sensor of a problem that has one."""
    (name,) = problem.sensor_names
    return problem.sensor(name)


def change_data(problem: Problem, **changes: Any) -> Problem:
    """The same problem with some of its data replaced."""
    return replace(problem, data=replace(problem.record, **changes))
