"""System models: how they are called, and the checks on what they return.

The conventions are those of the papers (2018, equations 1 and 2)::

    f(x, w, u) -> next state, shape (n,)        process model
    h(x, v)    -> observation, shape (m,)       observation model

with the state x, shape (n,), the process noise w, shape (q,), the observation noise v, shape (r,),
and the input u, whatever was given to ``predict``. Keyword arguments of ``predict`` and ``update``
are passed on. A noise that is *augmented* arrives as the value of the sigma point and must enter
the result. A noise that is *additive* arrives as zeros of the same shape, because the core adds it,
so one model may serve both. The filters of filterpy become ``lambda x, w, u: fx(x, dt)`` and
``lambda x, v: hx(x)``, with additive noise.

Models are called once for each sigma point; *vectorized* models once for all of them, with one
column for each sigma point: x (n, N), w (q, N), v (r, N), results (n, N) and (m, N). A model that
indexes rows only (``x[0] + x[1]``) works both ways.

Angles are wrapped relative to sigma point 0, so that no mean is taken across the cut at +-pi.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ObservationModel", "ProcessModel", "evaluate", "wrap"]

ProcessModel = Callable[..., ArrayLike]
ObservationModel = Callable[..., ArrayLike]

TURN = 2.0 * np.pi


def wrap(
    angles: NDArray[np.float64], reference: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Shift angles by whole turns to within half a turn of a reference.

    Parameters
    ----------
    angles
        Angles, in radians.
    reference
        Angles, in radians, of a shape that broadcasts.

    Returns
    -------
    array
        Angles in reference +- pi. Angles that are there already are returned unchanged.
    """
    return angles - TURN * np.round((angles - reference) / TURN)


def _check(result: object, name: str, shape: tuple[int, ...], where: str) -> NDArray[np.float64]:
    """Check the kind and the shape of what a model returned."""
    try:
        array = np.asarray(result)
    except ValueError as error:
        raise TypeError(f"{name} must return an array of numbers, {where}: {error}") from error
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must return real numbers, {where}, not {result!r}")
    if array.shape != shape:
        raise ValueError(f"{name} must return the shape {shape}, {where}, not {array.shape!r}")
    return array.astype(np.float64, copy=False)


def evaluate(
    model: Callable[..., ArrayLike],
    name: str,
    points: NDArray[np.float64],
    noise: NDArray[np.float64],
    rows: int,
    *,
    arguments: tuple[Any, ...] = (),
    keywords: dict[str, Any] | None = None,
    vectorized: bool = False,
    angles: tuple[int, ...] = (),
    used_rows: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Send sigma points through a model.

    Parameters
    ----------
    model
        The model; called as ``model(x, noise, *arguments, **keywords)``.
    name
        Its name in messages.
    points, noise
        Sigma points, shapes (n, N) and (terms, N). The model gets copies.
    rows
        Length of a result.
    arguments, keywords
        Further arguments of the model.
    vectorized
        Whether the model takes all sigma points at once.
    angles
        Rows of the result that are angles in radians.
    used_rows
        Rows that matter, shape (rows,); what the model returns in the others becomes zero.

    Returns
    -------
    array
        Results, shape (rows, N).

    Raises
    ------
    TypeError
        If the model does not return real numbers.
    ValueError
        If the result has a wrong shape, or a row that matters is NaN or infinite. The message
        names the sigma point.
    """
    count = points.shape[1]
    keywords = keywords or {}
    if vectorized:
        result = model(points.copy(), noise.copy(), *arguments, **keywords)
        results = np.array(_check(result, name, (rows, count), "one column a sigma point"))
    else:
        results = np.empty((rows, count))
        for k in range(count):
            try:
                result = model(points[:, k].copy(), noise[:, k].copy(), *arguments, **keywords)
            except Exception as error:
                error.add_note(f"in {name} at sigma point {k}")
                raise
            results[:, k] = _check(result, name, (rows,), f"at sigma point {k}")
    if used_rows is not None and not used_rows.all():
        results[~used_rows] = 0.0
    if not np.isfinite(results).all():
        row, k = (int(i) for i in np.argwhere(~np.isfinite(results))[0])
        raise ValueError(
            f"{name} must return finite numbers, at sigma point {k}, "
            f"not {float(results[row, k])!r} in row {row}"
        )
    for row in angles:
        results[row] = wrap(results[row], results[row, 0])
    return results
