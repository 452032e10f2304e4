"""Arrays as users give them: checked for kind, shape and value, and copied."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.factors import IndefiniteError, check_definite, lower_factor, rounding_errors
from ukf_sw.spec.fields import as_int

__all__ = ["as_covariance", "as_indices", "as_numbers", "as_vector", "is_masked"]

Array = NDArray[np.float64]

DOUBLE = float(np.finfo(np.float64).eps)


def is_masked(value: Any) -> bool:
    """Whether elements of an array, or of a list or of its rows, are masked as those of np.ma."""
    if isinstance(value, (list, tuple)):
        return any(map(np.ma.is_masked, cast("list[Any]", value)))
    return np.ma.is_masked(value)


def _raw(value: ArrayLike, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Check kind and shape of an array of numbers, none of them masked."""
    if is_masked(value):
        raise TypeError(f"{name} must have no masked elements, not {value!r}")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TypeError(f"{name} must be an array of real numbers, not {value!r}") from error
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must be an array of real numbers, not {value!r}")
    if array.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, not {array.shape!r}")
    return array


def as_numbers(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Check an array of numbers, and copy it."""
    return np.array(_raw(value, name, shape), dtype=np.float64)


def as_vector(value: ArrayLike, name: str, length: int) -> Array:
    """Check a vector."""
    array = as_numbers(value, name, (length,))
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, not {array.tolist()!r}")
    return array


def as_covariance(
    value: ArrayLike | None, name: str, size: int, *, definite: bool = False
) -> Array:
    """Check a covariance: symmetric and positive semidefinite, or definite.

    Within the rounding errors of its type, relative to the diagonal elements of row and column. If
    its type is coarser than float64, what is given is the nearby matrix without their effect.
    """
    if value is None:
        if size:
            raise TypeError(f"{name} must be a matrix of shape {(size, size)}, not None")
        return np.zeros((0, 0))
    given = _raw(value, name, (size, size))
    array = np.array(given, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, not {array.tolist()!r}")
    if not size:
        return array
    epsilon = DOUBLE
    if given.dtype.kind == "f":
        epsilon = max(epsilon, float(np.finfo(given.dtype).eps))
    deviations = np.sqrt(np.abs(np.diag(array)))
    tolerance = max(1e-9, rounding_errors(size, epsilon)) * np.outer(deviations, deviations)
    halves = np.abs(array / 2.0 - array.T / 2.0)  # a sum or difference might overflow
    if (halves > tolerance / 2.0).any():
        row, column = np.unravel_index((halves - tolerance / 2.0).argmax(), array.shape)
        raise ValueError(
            f"{name} must be symmetric, not {float(array[row, column])!r} at ({row}, {column}) "
            f"and {float(array[column, row])!r} at ({column}, {row}), which may differ by "
            f"{tolerance[row, column]:.3g}{_hint(array, epsilon, name, definite=definite)}"
        )
    array = array / 2.0 + array.T / 2.0
    try:
        factor = lower_factor(array, epsilon)
        if epsilon > DOUBLE:
            array = factor @ factor.T
        if definite:
            check_definite(array, epsilon)
    except IndefiniteError as error:
        hint = _hint(array, epsilon, name, definite=definite)
        raise ValueError(f"{name} {error}{hint}") from error
    return array


def _hint(array: Array, epsilon: float, name: str, *, definite: bool) -> str:
    """What may help with a matrix that is refused, if it is good enough for one of float32."""
    if epsilon == DOUBLE and np.abs(array).max() <= np.finfo(np.float32).max:
        with suppress(ValueError):
            as_covariance(array.astype(np.float32), name, len(array), definite=definite)
            return "; if it comes from float32, its rounding is allowed for when given as float32"
    return ""


def as_indices(
    value: Iterable[int | str], name: str, size: int, names: Sequence[str] = ()
) -> tuple[int, ...]:
    """Check indices, or names, of rows; gives indices."""
    if isinstance(value, str) or not isinstance(cast("object", value), Iterable):
        raise TypeError(f"{name} must be a tuple of indices or names, as (0,), not {value!r}")
    indices: list[int] = []
    for index in value:
        if isinstance(index, str):
            if not names:
                raise ValueError(
                    f"{name} must be indices, as the rows have no names, not {index!r}"
                )
            if index not in names:
                raise ValueError(f"{name} must be among {', '.join(names)}, not {index!r}")
            indices.append(names.index(index))
        else:
            indices.append(as_int(f"each of {name}", index))
    for index in indices:
        if not 0 <= index < size:
            raise ValueError(f"{name} must be between 0 and {size - 1}, not {index!r}")
    if len(set(indices)) < len(indices):
        raise ValueError(f"{name} must be different indices, not {tuple(indices)!r}")
    return tuple(indices)
