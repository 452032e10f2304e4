"""Dataclasses whose fields say what they are, beside their type and default.

Whatever lists the parameters of a core has them from here: options of commands, axes and columns
of sweeps, records, titles. So a new field is in all of them.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, fields
from enum import Enum
from functools import cache
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

import numpy as np

from ukf_sw.spec.float_format import FORMATS, FloatFormat

__all__ = [
    "NO_PARAMETER", "Meaning", "Parameter", "as_bool", "as_int", "as_number", "check_parameters",
    "parameters_of",
]  # fmt: skip

#: What the kinds of parameters are called in messages, and the types that do for them.
_KINDS: dict[type, tuple[str, tuple[type, ...]]] = {
    int: ("an int", (int, np.integer)),
    float: ("a number", (int, float, np.integer, np.floating)),
    bool: ("a bool", (bool, np.bool_)),
}


#: Metadata of a field that is no parameter: none that a user gives as an option, or sweeps.
NO_PARAMETER = {"parameter": False}

#: How a tuple without entries is written.
NONE = "one"


def _as(kind: type[Any], name: str, value: Any) -> Any:
    called, kinds = _KINDS[kind]
    value = value[()] if getattr(value, "shape", None) == () else value
    if not isinstance(value, kinds) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(f"{name} must be {called}, not {value!r}")
    try:
        return kind(value)
    except OverflowError as error:
        bits = int(value).bit_length()
        raise ValueError(
            f"{name} must be at most {np.finfo(np.float64).max:.6g}, the largest float, "
            f"not an int of {bits} bits"
        ) from error


def as_int(name: str, value: Any) -> int:
    """Give an integer of Python or NumPy as int; TypeError for all else, bool included."""
    return _as(int, name, value)


def as_number(name: str, value: Any) -> float:
    """Give a real number of Python or NumPy as float; TypeError for all else, bool included."""
    return _as(float, name, value)


def as_bool(name: str, value: Any) -> bool:
    """Give a bool of Python or NumPy as bool; TypeError for all else."""
    return _as(bool, name, value)


@dataclass(frozen=True)
class Meaning:
    """What a field is: ``n: Annotated[int, Meaning("States.", low=1, high=32)]``.

    Parameters
    ----------
    doc
        In a sentence, with the unit: help of the option, meaning of the column.
    low, high
        Smallest and largest value, or None where there is none or another rule.
    label
        Name among all parameters of a core, if that of the field says too little there.
    words
        How it is said in titles, with ``{label}``, ``{value}``, and ``{s}`` for the s of a plural.
    always
        Whether titles say it also when it has its default.
    problem
        Whether the problem decides it. What is left is a choice among cores for a problem.
    """

    doc: str
    _: KW_ONLY
    low: int | None = None
    high: int | None = None
    label: str | None = None
    words: str = "{label} {value}"
    always: bool = False
    problem: bool = False


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of a core; see :func:`parameters_of`.

    Parameters
    ----------
    name
        Name of the field.
    kind
        Type of its values: int, float, bool, tuple (of ints), an Enum or FloatFormat.
    meaning
        What it is.
    default
        Its default, or None if it must be given.
    """

    name: str
    kind: type[Any]
    meaning: Meaning
    default: Any = None

    @property
    def label(self) -> str:
        """Name among all parameters of a core."""
        return self.meaning.label or self.name

    @property
    def choices(self) -> tuple[str, ...]:
        """Names of all values, or of usual ones; none for numbers."""
        if issubclass(self.kind, Enum):
            return tuple(str(member.value) for member in self.kind)
        return tuple(FORMATS) if self.kind is FloatFormat else ()

    @property
    def cell_kind(self) -> type[Any]:
        """Type of what :meth:`cell` gives."""
        return self.kind if self.kind in _KINDS else str

    def check(self, value: Any) -> Any:
        """Check a value by itself, and give it as :attr:`kind`.

        Numbers may be of NumPy, and values with names may be given by name.

        Raises
        ------
        TypeError
            If it is of the wrong kind.
        ValueError
            If it is out of range, or no such name.
        """
        if self.kind in _KINDS:
            value = _as(self.kind, self.name, value)
        elif self.kind is tuple and isinstance(value, (tuple, list)):
            each_of = cast("Sequence[object]", value)
            return tuple(self._in_range(as_int(f"each of {self.name}", each)) for each in each_of)
        elif isinstance(value, str):
            value = self.read(value)
        elif not isinstance(value, self.kind):
            raise TypeError(f"{self.name} must be a {self.kind.__name__}, not {value!r}")
        return self._in_range(value)

    def _in_range(self, value: Any) -> Any:
        low, high = self.meaning.low, self.meaning.high
        if (low is not None and value < low) or (high is not None and value > high):
            limits = f"at least {low}" if high is None else f"between {low} and {high}"
            raise ValueError(f"{self.name} must be {limits}, not {value!r}")
        return value

    def cell(self, value: Any) -> int | float | str:
        """Give a value as an entry of a table."""
        if isinstance(value, Enum):
            return value.value
        if isinstance(value, FloatFormat):
            return value.name
        if isinstance(value, tuple):
            return "+".join(map(str, cast("tuple[int, ...]", value))) or NONE
        return float(value) if self.kind is float else value

    def text(self, value: Any) -> str:
        """Give a value as a user writes it; :meth:`read` reads it."""
        text = str(self.cell(value))
        return text.lower() if self.kind is bool else text

    def read(self, text: str) -> Any:
        """Give the value that a user has written.

        Raises
        ------
        ValueError
            If it is not one.
        """
        if self.kind is FloatFormat:
            return FloatFormat.from_name(text)
        if self.kind is tuple:
            parts = [] if text == NONE else text.split("+")
            if not all(part.isdecimal() for part in parts):
                raise ValueError(f"{self.label} must be like 3+3, or {NONE}, not {text!r}")
            return tuple(map(int, parts))
        if self.kind in (int, float):
            try:
                return self.kind(text)
            except ValueError:
                called, _ = _KINDS[self.kind]
                raise ValueError(f"{self.label} must be {called}, not {text!r}") from None
        members: dict[str, Any] = getattr(self.kind, "__members__", {})
        values = (False, True) if self.kind is bool else members.values()
        known = {self.text(value): value for value in values}
        if text not in known:
            raise ValueError(f"{self.label} must be one of {', '.join(known)}, not {text!r}")
        return known[text]

    def record(self, value: Any) -> Any:
        """Give a value exactly, ready for JSON; :meth:`from_record` takes it."""
        if isinstance(value, FloatFormat):
            return {
                "name": value.name,
                "exponent_bits": value.exponent_bits,
                "fraction_bits": value.fraction_bits,
            }
        if isinstance(value, tuple):
            return list(cast("tuple[int, ...]", value))
        return self.cell(value)

    def from_record(self, entry: Any) -> Any:
        """Give the value of what :meth:`record` gave."""
        if self.kind is FloatFormat:
            return FloatFormat(
                exponent_bits=entry["exponent_bits"], fraction_bits=entry["fraction_bits"]
            )
        return self.kind(entry)

    def said(self, value: Any) -> str:
        """Say it in a title, of a value or of its :meth:`cell`."""
        label = self.label.replace("_", " ")
        return self.meaning.words.format(label=label, value=self.text(value), s="s" * (value != 1))


@cache
def parameters_of(block: type[Any]) -> dict[str, Parameter]:
    """Give the parameters of a dataclass by label, in their order.

    Raises
    ------
    TypeError
        If a field has no :class:`Meaning`, and is not marked as :data:`NO_PARAMETER`.
    """
    hints = get_type_hints(block, include_extras=True)
    found: dict[str, Parameter] = {}
    for each in fields(block):
        if not each.metadata.get("parameter", True):
            continue
        arguments = get_args(hints[each.name])
        if get_origin(hints[each.name]) is not Annotated or not isinstance(arguments[1], Meaning):
            raise TypeError(f"{block.__name__}.{each.name} must have a Meaning")
        parameter = Parameter(
            name=each.name,
            kind=get_origin(arguments[0]) or arguments[0],
            meaning=arguments[1],
            default=None if each.default is MISSING else each.default,
        )
        found[parameter.label] = parameter
    return found


def check_parameters(block: object) -> None:
    """Check each field of a dataclass by itself, and keep it as the kind that it is to be.

    Raises
    ------
    TypeError
        If one is of the wrong kind.
    ValueError
        If one is out of range.
    """
    for parameter in parameters_of(type(block)).values():
        value = parameter.check(getattr(block, parameter.name))
        object.__setattr__(block, parameter.name, value)  # the dataclass may be frozen
