"""Functions that make arrays, while a model is traced.

NumPy asks no argument of ``np.zeros(3)`` or ``np.array([x[0], 1.0])`` what to make. It makes plain
arrays: of float64, which take no number that records, or of objects, which cannot be compared.
While a model is traced, these names in the module ``numpy`` therefore stand for functions that make
arrays that record: for the model and what it calls, but not for NumPy itself, nor for other
packages, what is written in C, and other threads. A name that was imported from NumPy before, as by
``from numpy import zeros``, stays what it was. Arrays made by it, or made before the call, can be
computed with, but not filled with data.
"""

import functools
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ukf_sw.tracing.places import HERE, calling_module, calls, is_foreign

if TYPE_CHECKING:
    from ukf_sw.tracing.context import Trace

__all__ = ["MAKERS", "tracing_makers"]

#: Functions that make an array of a shape.
SHAPED = ("zeros", "ones", "empty", "full", "eye", "identity")
#: Functions that make an array of what they are given.
COPYING = ("array", "asarray", "asanyarray", "ascontiguousarray", "asfortranarray")
#: Functions that are given lists of numbers, besides arrays.
JOINING = (
    "concatenate", "stack", "hstack", "vstack", "dstack", "column_stack", "block", "append",
    "where", "clip", "sum", "prod", "mean", "max", "min", "amax", "amin", "any", "all", "dot",
    "cross", "outer", "diag", "roll", "cumsum", "interp", "select", "atleast_1d", "atleast_2d",
)  # fmt: skip
MAKERS = (*SHAPED, *COPYING, *JOINING)


@contextmanager
def tracing_makers(trace: "Trace", package: str) -> Generator[None]:
    """Have the functions of NumPy make arrays that record, as long as this is open.

    Parameters
    ----------
    trace
        The trace that they belong to.
    package
        Package of the model, for which it holds also if it is installed.
    """
    from ukf_sw.tracing.values import records

    before = {name: getattr(np, name) for name in MAKERS if hasattr(np, name)}
    thread = threading.get_ident()

    def asked() -> bool:
        """Whether the model, or what it calls, wants an array."""
        file, caller = calling_module(2)
        if threading.get_ident() != thread or file.startswith(HERE):
            return False
        return caller == package or not is_foreign(file)

    def replace(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        make = _copied if name in COPYING else _shaped if name in SHAPED else _joined

        @functools.wraps(original)
        def made(*arguments: Any, **options: Any) -> Any:
            if not asked():
                return original(*arguments, **options)
            # Without data it may be what a function in C wants, as those that draw random numbers.
            if not (records((arguments, list(options.values()))) or calls(name, 1)):
                return original(*arguments, **options)
            return make(trace, original, arguments, options)

        return made

    try:
        for name, original in before.items():
            setattr(np, name, replace(name, original))
        yield
    finally:
        for name, original in before.items():
            setattr(np, name, original)


def _is_usual(dtype: Any) -> bool:
    """Whether a type is that of the numbers of a model."""
    return dtype is None or np.dtype(dtype) == np.float64


def _shaped(
    trace: "Trace", make: Callable[..., Any], arguments: tuple[Any, ...], options: dict[str, Any]
) -> Any:
    """Make an array of a shape; other types than float64 stay plain."""
    from ukf_sw.tracing.values import TracedArray, lift, records

    if records((arguments, list(options.values()))):
        number: Any = arguments[1] if len(arguments) > 1 else options.get("fill_value")
        shape: Any = arguments[0] if arguments else options.get("shape")
        if make.__name__ != "full" or records(shape):
            raise trace.error("make an array of a size that depends on data", "use a fixed size")
        return TracedArray(trace, np.broadcast_to(lift(trace, number), shape).copy())
    made = make(*arguments, **options)
    if made.dtype != np.float64:
        return made
    # What nobody has written is no number, so that it is seen in the result.
    return TracedArray(trace, lift(trace, made * np.nan if make.__name__ == "empty" else made))


def _copied(
    trace: "Trace", make: Callable[..., Any], arguments: tuple[Any, ...], options: dict[str, Any]
) -> Any:
    """Make an array of numbers; if nothing is in it that records, only float64 becomes traced."""
    from ukf_sw.tracing.values import TracedArray, lift, trace_of

    value = arguments[0] if arguments else options.get("object")
    if trace_of(value) is None:
        made = make(*arguments, **options)
        return TracedArray(trace, lift(trace, made)) if made.dtype == np.float64 else made
    dtype = arguments[1] if len(arguments) > 1 else options.get("dtype")
    if not _is_usual(dtype):
        raise trace.error(
            f"make data of the type {np.dtype(dtype).name}", "leave it out: numbers are float64"
        )
    values = lift(trace, value)
    missing = options.get("ndmin", 0) - values.ndim
    if isinstance(value, TracedArray) and (
        make.__name__ != "array" or options.get("copy") is False
    ):
        return value
    return TracedArray(trace, values.reshape((1,) * max(missing, 0) + values.shape).copy())


def _joined(
    trace: "Trace", make: Callable[..., Any], arguments: tuple[Any, ...], options: dict[str, Any]
) -> Any:
    """Call a function with arrays in the place of lists of numbers that record."""
    from ukf_sw.tracing.values import TracedArray, TracedNumber, lift, trace_of

    def made(value: Any) -> Any:
        """Make an array of a list of numbers, and of the lists in a list."""
        if not isinstance(value, (list, tuple)) or trace_of(value) is None:
            return cast("Any", value)
        parts = cast("list[Any]", value)
        if all(isinstance(part, (TracedNumber, float, int)) for part in parts):
            return TracedArray(trace, lift(trace, parts))
        return [made(part) for part in parts]

    return make(*map(made, arguments), **options)
