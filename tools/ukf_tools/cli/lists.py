"""Options that take lists, as ``1,2,4-6``."""

from collections.abc import Callable
from typing import Any

__all__ = ["numbers", "pick", "split"]


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
        found += range(int(first), int(last if dash else first) + 1)
    if not found:
        raise ValueError(f"{option} must have at least one number, not {text!r}")
    return found


def pick(option: str, text: str, known: Callable[[str], Any]) -> list[Any]:
    """Read a list of names.

    Parameters
    ----------
    option, text
        Name of the option, and what was given.
    known
        Gives what a name stands for, or raises a ValueError.

    Raises
    ------
    ValueError
        If a name is not known.
    """
    found: list[Any] = []
    for entry in split(option, text):
        try:
            found.append(known(entry))
        except ValueError as error:
            raise ValueError(f"{option}: {error}") from None
    return found
