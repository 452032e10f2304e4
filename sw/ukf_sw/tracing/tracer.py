"""From a model to a graph: the model is called with numbers that record what it does with them.

A model is called as the filter calls it: x of shape (n,), or (n, 1) if it is vectorized; w or v
likewise; then u and keyword arguments. It is called twice, and must do the same both times.

x, the noise, u, and keyword arguments that are floats or arrays are data. Everything else is as it
is when the model is called: numbers in its source, of its closure and of a ``functools.partial``,
and keyword arguments that are text, bool, None, or whole numbers. What is computed with these
alone, with all of Python's branches and loops, becomes constants.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ukf_sw.errors import TraceError, add_note
from ukf_sw.tracing import dispatch
from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.graph import Graph, Input
from ukf_sw.tracing.symbols import constants, noise_zeros, points, symbols
from ukf_sw.tracing.values import NO_NUMBER, TracedArray, Values, lift

__all__ = ["Call", "trace"]

# Its tables are of NumPy's own functions, so it is loaded before they are replaced.
_ = dispatch


@dataclass(frozen=True, kw_only=True)
class Call:
    """How a model is called.

    Parameters
    ----------
    function
        The model.
    name
        Its name in messages, as :func:`ukf_sw.models.check_takes` gives it.
    rows
        Length of its result.
    states
        Length of x.
    noise
        Name of its noise, w or v.
    terms
        Length of that.
    additive
        Whether the noise arrives as zeros.
    vectorized
        Whether it takes one column a sigma point.
    positional
        Examples of its further arguments by name, as that of u.
    keywords
        Examples of its keyword arguments.
    """

    function: Callable[..., Any]
    name: str
    rows: int
    states: int
    noise: str
    terms: int
    additive: bool = False
    vectorized: bool = False
    positional: Mapping[str, Any]
    keywords: Mapping[str, Any]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the result for one sigma point."""
        return (self.rows, 1) if self.vectorized else (self.rows,)


def trace(call: Call) -> Graph:
    """Make a graph of a model.

    Raises
    ------
    TraceError
        If the model does what cannot be part of a program, or does not do the same twice.
    TypeError, ValueError
        If the result is not what :mod:`ukf_sw.models` demands of one.
    Exception
        Whatever the model raises, with a note.
    """
    first, again = _record(call), _record(call)
    if first != again:
        rows = [_row(first, i) != _row(again, i) for i in range(call.rows)]
        raise TraceError(
            call.name,
            f"keep a state or draw random numbers, as two calls differ in row {rows.index(True)}",
            "let what changes be part of x, of the noise, or of u",
        )
    return first


def _row(graph: Graph, row: int) -> Graph:
    """Give what one row of the result needs."""
    from ukf_sw.tracing.builder import Builder

    builder = Builder()
    numbers: list[int] = []
    for node in graph.nodes:
        if node.source is not None:
            numbers.append(builder.input(node.source))
        elif node.value is not None:
            numbers.append(builder.constant(node.value))
        else:
            numbers.append(builder.apply(node.operation, *(numbers[a] for a in node.arguments)))
    return builder.graph([numbers[graph.outputs[row]]])


def _arguments(call: Call, x: TracedArray, noise: TracedArray) -> str:
    """Say what a model is called with, for messages."""
    said = [f"x of shape {x.shape}", f"{call.noise} of shape {noise.shape}"]
    for name, given in (*call.positional.items(), *call.keywords.items()):
        if isinstance(given, np.ndarray):
            said.append(f"{name} of shape {np.shape(cast('Any', given))}")
        else:
            said.append(f"{name} like {given!r}")
    return f"{', '.join(said[:-1])} and {said[-1]}"


def _record(call: Call) -> Graph:
    """Call the model once."""
    traced = Trace(call.name)
    x = points(traced, "x", call.states, column=call.vectorized)
    noise = (
        noise_zeros(traced, call.terms, column=call.vectorized)
        if call.additive
        else points(traced, call.noise, call.terms, column=call.vectorized)
    )
    before = {"x": (x, x.values.copy()), call.noise: (noise, noise.values.copy())}
    positional = [symbols(traced, Input(name), given) for name, given in call.positional.items()]
    fixed = constants(call.keywords)
    keywords = {
        name: given if name in fixed else symbols(traced, Input(name), given)
        for name, given in call.keywords.items()
    }
    try:
        result = traced.call(call.function, x, noise, *positional, **keywords)
    except Exception as error:
        if not isinstance(error, TraceError):
            add_note(
                error,
                f"in {call.name}, traced with {_arguments(call, x, noise)}",
            )
        raise
    values = _checked(call, traced, result)
    for name, (argument, numbers) in before.items():
        _check_unchanged(call, name, argument, numbers)
    return traced.builder.graph([number.number for number in values.reshape(-1)])


def _checked(call: Call, traced: Trace, result: Any) -> Values:
    """Check kind and shape of a result, as the filter does."""
    where = "one column a sigma point" if call.vectorized else "at a sigma point"
    try:
        values = lift(traced, result)
    except ValueError as error:
        if not isinstance(error, TraceError):
            raise TypeError(
                f"{call.name} must return an array of numbers, {where}: {error}"
            ) from error
        if not error.rule.startswith(NO_NUMBER):
            raise
        raise TypeError(f"{call.name} must return real numbers, {where}, not {result!r}") from error
    if values.shape != call.shape:
        raise ValueError(
            f"{call.name} must return the shape {call.shape}, {where}, not {values.shape!r}"
        )
    for row, number in enumerate(values.reshape(-1)):
        if number.known is not None and not np.isfinite(number.known):
            raise ValueError(
                f"{call.name} must return finite numbers, {where}, not {number.known!r} in row "
                f"{row}"
            )
    return values


def _check_unchanged(call: Call, name: str, argument: TracedArray, before: Values) -> None:
    """Check that the model has written nothing into an argument."""
    for row, (now, then) in enumerate(
        zip(argument.values.reshape(-1), before.reshape(-1), strict=True)
    ):
        if now.number != then.number:
            raise ValueError(
                f"{call.name} must not change its argument {name}, as it does in row {row}: let it "
                f"change a copy, {name}.copy()"
            )
