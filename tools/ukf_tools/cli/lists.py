"""Options that take lists, as ``1,2,4-6``."""

from collections.abc import Collection
from typing import Any

from ukf_sw.spec.fields import Parameter
from ukf_tools.cli.names import in_options

__all__ = ["entries", "numbers", "read_entry", "split"]


def split(option: str, text: str) -> list[str]:
    """Split a list at its commas.

    Raises
    ------
    ValueError
        If an entry is empty.
    """
    entries = [entry.strip() for entry in text.split(",")]
    if not all(entries):
        raise ValueError(f"{option} must be a list like a,b, not {text!r}")
    return entries


def numbers(option: str, text: str) -> list[int]:
    """Read a list of numbers and of ranges.

    Raises
    ------
    ValueError
        If it is not one.
    """
    found: list[int] = []
    for entry in split(option, text):
        first, dash, last = entry.partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ValueError(f"{option} must be a list like 1,2,4-6, not {text!r}")
        if dash and int(last) < int(first):
            raise ValueError(f"{option} must have ranges that rise, like 4-6, not {entry!r}")
        found += range(int(first), int(last if dash else first) + 1)
    return found


def read_entry(option: str, text: str, parameter: Parameter) -> Any:
    """Read a value of a parameter of the core.

    Raises
    ------
    ValueError
        If it is not one.
    """
    try:
        value = parameter.read(text)
        parameter.check(value)
    except ValueError as error:
        message = in_options(str(error))
        own = message.startswith(f"{option} ")
        raise ValueError(message if own else f"{option}: {message}") from None
    return value


def entries(option: str, text: str, parameter: Parameter, same_as: Collection[str]) -> list[Any]:
    """Read a list of values of a parameter of the core.

    Parameters
    ----------
    option, text
        Name of the option, and what was given.
    parameter
        Of what. If it is a number, ranges are lists, too.
    same_as
        Names that may be given instead: of what it shall equal.

    Raises
    ------
    ValueError
        If an entry is not such a value.
    """
    if text.strip() in same_as:
        return [text.strip()]
    if parameter.kind is not int:
        return [read_entry(option, entry, parameter) for entry in split(option, text)]
    found = numbers(option, text)
    for number in found:
        parameter.check(number)
    return found
