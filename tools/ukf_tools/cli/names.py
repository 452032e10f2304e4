"""Names of options, and messages about values in terms of them."""

from ukf_sw.problems.finding import find
from ukf_sw.spec.core import PARAMETERS

__all__ = ["in_options", "option_of", "with_sensor"]


def option_of(label: str) -> str:
    """Option of a parameter of the core, or of a command."""
    return f"--{label.replace('_', '-').lower()}"


#: Options by what messages call their values.
_OPTIONS = {
    **{
        name: option_of(label)
        for label, parameter in PARAMETERS.items()
        for name in (label, parameter.name)
    },
    **{
        name: option_of(name)
        for name in (
            "P0", "backend", "data", "base_address", "clock_mhz", "duration", "interrupt", "runs",
            "ignore", "seed", "start", "steps", "workers",
        )
    },
    "word_clocks": "--bus-latency",
    "application": "--accuracy",
}  # fmt: skip


def in_options(message: str) -> str:
    """Give a message about a value, such as "multiply must be ...", with the name of its option.

    Parameters
    ----------
    message
        What names the value first, then the rule.
    """
    name, must, rule = message.partition(" must ")
    return f"{_OPTIONS.get(name, name)}{must}{rule}"


def with_sensor(step: str, problem: str | None) -> str:
    """Name of a step or program; with the name of its sensor, not the number, if that is known."""
    name, _, number = step.partition(" of sensor ")
    if not number or problem is None:
        return step
    number, *variant = number.split(", ")
    return ", ".join([f"{name} {find(problem).problem.sensor_names[int(number)]}", *variant])
