"""What becomes of the functions of NumPy that a model calls with numbers that record."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np

from ukf_sw.errors import TraceError
from ukf_sw.tracing.choosing import CHOOSING
from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.elementwise import UFUNCS, Function
from ukf_sw.tracing.making import MAKING
from ukf_sw.tracing.products import PRODUCTS, dot
from ukf_sw.tracing.reductions import REDUCTIONS, accumulate, reduce
from ukf_sw.tracing.remedies import STORED
from ukf_sw.tracing.shaping import METHODS as SHAPE_METHODS
from ukf_sw.tracing.shaping import PROPERTIES, SHAPING
from ukf_sw.tracing.values import TracedArray, TracedNumber, lift, records, wrap

__all__ = ["attribute", "call_function", "call_ufunc"]

Options = Mapping[str, Any]

#: Functions by what they are.
FUNCTIONS: Mapping[Any, Callable[..., Any]] = {
    **SHAPING, **MAKING, **CHOOSING, **REDUCTIONS, **PRODUCTS,
}  # fmt: skip

#: What to do in the place of functions that have no counterpart.
_REMEDIES = {
    "inv": "write the inverse out, or solve for it by hand",
    "solve": "write the solution out",
    "det": "write the determinant out",
    "cholesky": "write the factor out",
    "unwrap": "use a - 2 * np.pi * np.rint((a - b) / (2 * np.pi)), which brings a near b",
    "sort": "use np.minimum and np.maximum",
    "argmax": "use np.where",
    "argmin": "use np.where",
    "nonzero": "use np.where(condition, a, b)",
    "fmax": "use np.maximum",
    "fmin": "use np.minimum",
    "cbrt": "use np.sign(a) * np.abs(a) ** (1 / 3)",
    "isclose": "use np.abs(a - b) < tolerance",
    "allclose": "use np.abs(a - b) < tolerance",
    "array_equal": "use np.all(a == b)",
}
_GENERAL = "write it with other functions"
#: Ufuncs by name, as methods that NumPy looks for in arrays of objects.
_BY_NAME = {ufunc.__name__: ufunc for ufunc in UFUNCS}
#: Functions that arrays have as methods.
_METHODS = {
    name: getattr(np, name)
    for name in (
        "sum", "prod", "mean", "max", "min", "any", "all", "cumsum", "cumprod", "var", "std",
        "clip", "round", "dot", "repeat", "take", "diagonal", "trace", "ptp",
    )
}  # fmt: skip


def _refused(trace: Trace, name: str, remedy: str | None = None) -> TraceError:
    """Make the error about a function that there is none of."""
    short = name.rpartition(".")[2]
    return trace.error(
        f"call {name}, which has no counterpart on a core",
        remedy or _REMEDIES.get(short, _GENERAL),
    )


def call_ufunc(
    trace: Trace, ufunc: Any, method: str, inputs: tuple[Any, ...], options: Options
) -> Any:
    """Apply a function that works element by element, or one of its methods."""
    outputs: tuple[Any, ...] = tuple(options.get("out") or ())
    if any(not isinstance(output, (TracedArray, TracedNumber)) for output in outputs):
        raise trace.error(*STORED)
    left = {key: value for key, value in options.items() if key != "out"}
    if ufunc is np.matmul and method == "__call__":
        result = dot(trace, *inputs, matmul=True)
    elif ufunc not in UFUNCS:
        raise _refused(trace, f"np.{ufunc.__name__}")
    elif method == "__call__":
        _check_options(trace, ufunc.__name__, left, ())
        result = _elementwise(trace, UFUNCS[ufunc], inputs)
    elif method == "outer":
        a, b = (lift(trace, value) for value in inputs)
        a = a.reshape(a.shape + (1,) * b.ndim)
        result = _elementwise(trace, UFUNCS[ufunc], (TracedArray(trace, a), wrap(trace, b)))
    elif method in ("reduce", "accumulate") and UFUNCS[ufunc].arity == 2:
        _check_options(trace, ufunc.__name__, left, ("axis", "keepdims"))
        work: Any = reduce if method == "reduce" else accumulate
        kept = {key: left[key] for key in left if key in ("axis", "keepdims")}
        result = work(trace, ufunc, inputs[0], **{"axis": 0, **kept})
    else:
        raise _refused(trace, f"np.{ufunc.__name__}.{method}")
    return _stored(trace, result, outputs)


def _stored(trace: Trace, result: Any, outputs: tuple[Any, ...]) -> Any:
    """Put a result where it is wanted, as ``+=`` does."""
    if not outputs or isinstance(outputs[0], TracedNumber):
        return result
    outputs[0][...] = result
    return outputs[0]


def _check_options(trace: Trace, name: str, options: Options, known: tuple[str, ...]) -> None:
    """Refuse options that would change the result."""
    for key, value in options.items():
        usual = value is None or (key == "dtype" and np.dtype(value) == np.float64)
        if not usual and key not in (*known, "casting", "order", "subok"):
            raise trace.error(
                f"call np.{name} with {key}", "leave it out, or use np.where(condition, a, b)"
            )


def _elementwise(trace: Trace, function: Function, inputs: tuple[Any, ...]) -> Any:
    """Apply a function to each element."""
    arrays = np.broadcast_arrays(*(lift(trace, value) for value in inputs))
    results = [
        function.compute(trace, *(array[index] for array in arrays))
        for index in np.ndindex(*arrays[0].shape)
    ]
    if results and isinstance(results[0], tuple):
        return tuple(_shaped(trace, part, arrays[0].shape) for part in zip(*results, strict=True))
    return _shaped(trace, results, arrays[0].shape)


def _shaped(trace: Trace, results: Any, shape: tuple[int, ...]) -> Any:
    found = np.empty(len(results), dtype=object)
    for i, result in enumerate(results):
        found[i] = result
    return wrap(trace, found.reshape(shape))


def call_function(
    trace: Trace, function: Callable[..., Any], arguments: Any, options: Options
) -> Any:
    """Call a function of NumPy that is no ufunc."""
    known = FUNCTIONS.get(function)
    if known is not None:
        try:
            return known(trace, *arguments, **options)
        except TypeError as error:
            if "unexpected keyword" not in str(error):
                raise
            name = str(error).rpartition("argument ")[2]
            raise trace.error(f"call np.{function.__name__} with {name}", "leave it out") from error
    if not records((list(arguments), list(options.values()))):
        plain = [_plain(argument) for argument in arguments]
        return function(*plain, **{key: _plain(value) for key, value in options.items()})
    module = str(getattr(function, "__module__", "numpy")).replace("numpy", "np", 1)
    public = "np" if "linalg" not in module else "np.linalg"
    raise _refused(trace, f"{public}.{function.__name__}")


def _plain(value: Any) -> Any:
    """Make constants plain, also in lists."""
    if isinstance(value, (TracedArray, TracedNumber)):
        return np.asarray(value) if isinstance(value, TracedArray) else value.known
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in cast("list[Any]", value)]
    return value


def attribute(value: Any, name: str) -> Any:
    """Give what NumPy's numbers and arrays have under a name.

    Raises
    ------
    AttributeError
        If they have nothing, as with NumPy.
    TraceError
        If that is nothing that can be recorded.
    """
    if name.startswith("__") or not (hasattr(np.ndarray, name) or name in _BY_NAME):
        raise AttributeError(f"{type(value).__name__!r} object has no attribute {name!r}")
    trace = value.origin
    values = lift(trace, value)
    if name in PROPERTIES:
        return PROPERTIES[name](trace, values)
    if name in SHAPE_METHODS:
        return functools.partial(SHAPE_METHODS[name], trace, values)
    if name in _METHODS:
        return functools.partial(_METHODS[name], value)
    if name in _BY_NAME:
        return functools.partial(_BY_NAME[name], value)
    if not records(value):
        return getattr(np.asarray(_plain(value)), name)
    raise _refused(trace, f"the method {name}", _REMEDIES.get(name, _GENERAL))
