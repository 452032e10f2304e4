"""Arguments of a model that is traced: numbers that record, in the place of those of an example."""

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from typing import Any, cast

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.graph import Input
from ukf_sw.tracing.values import TracedArray, TracedNumber, lift

__all__ = ["constants", "noise_zeros", "points", "shape_of", "symbols"]


def points(trace: Trace, argument: str, count: int, *, column: bool) -> TracedArray:
    """Make x or a noise, as a vector or a column."""
    found = np.empty(count, dtype=object)
    for row in range(count):
        source = Input(argument, (row,), per_point=True)
        found[row] = TracedNumber(trace, trace.builder.input(source))
    return TracedArray(trace, found.reshape(-1, 1) if column else found)


def noise_zeros(trace: Trace, count: int, *, column: bool) -> TracedArray:
    """Make a noise that is added elsewhere."""
    return TracedArray(trace, lift(trace, np.zeros((count, 1) if column else count)))


def symbols(trace: Trace, source: Input, given: Any) -> Any:
    """Make numbers that record in the shape of an example.

    Parameters
    ----------
    trace
        The trace that they belong to.
    source
        What the example stands for.
    given
        None, a number, an array, or a tuple, list or dict of such.

    Raises
    ------
    TypeError
        If it is something else.
    """

    def inside(part: int | str, value: Any) -> Any:
        return symbols(trace, replace(source, path=(*source.path, part)), value)

    if given is None:
        return None
    if isinstance(given, dict):
        named = cast("dict[str, Any]", given)
        return {key: inside(key, value) for key, value in named.items()}
    if isinstance(given, (list, tuple)):
        parts: Any = cast("Any", given)
        made = [inside(i, value) for i, value in enumerate(parts)]
        if isinstance(given, list):
            return made
        # A tuple with names takes its parts one by one.
        return type(parts)(*made) if hasattr(parts, "_fields") else tuple(made)
    kind = np.asarray(given).dtype.kind
    if kind not in "fiu":
        raise TypeError(
            f"{source.label} must be None, a number, an array, or a tuple, list or dict of them, "
            f"to be traced, not {given!r}"
        )
    if not isinstance(given, np.ndarray):
        return TracedNumber(trace, trace.builder.input(source))
    shape = np.shape(cast("Any", given))
    found = np.empty(shape, dtype=object)
    for index in np.ndindex(*shape):
        place = replace(source, path=(*source.path, *index))
        found[index] = TracedNumber(trace, trace.builder.input(place))
    return TracedArray(trace, found)


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_constant, cast("tuple[Any, ...]", value)))
    return value is None or isinstance(
        value, (str, bytes, bool, int, Enum, np.bool_, np.integer, np.str_)
    )


def constants(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Choose the keyword arguments that are no data: text, bool, None, whole numbers.

    Each of their values gives a program of its own.
    """
    return {name: value for name, value in keywords.items() if _is_constant(value)}


def shape_of(given: Any) -> Any:
    """Describe an example so that two that are equal in shape are described equally."""
    if isinstance(given, dict):
        parts = cast("dict[str, Any]", given)
        return {key: shape_of(value) for key, value in parts.items()}
    if isinstance(given, (list, tuple)):
        return [shape_of(value) for value in cast("list[Any]", given)]
    return None if given is None else np.shape(given)
