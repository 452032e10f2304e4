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

Models are called once for each sigma point that has a weight, :attr:`UkfParams.points`, K in all:
with W0 = 0, the default, not for point 0. *Vectorized* models are called once for all of them, with
one column for each: x (n, K), w (q, K), v (r, K), results (n, K) and (m, K). A model that indexes
rows only (``x[0] + x[1]``) works both ways.

Angles are wrapped to within half a turn of those of one sigma point, :attr:`UkfParams.centre`, so
that no mean is taken across the cut at +-pi. With a W0 it is point 0, the mean. With W0 = 0 it is
the last point, from which others can be farther away: by sqrt(M) + 1 / sqrt(M) standard deviations
instead of sqrt(M) in the last element of x, w and v together, and no farther in all others. z is
wrapped to within half a turn of the mean of what is expected.

A model must be a function in the mathematical sense: equal arguments give equal results, and the
arguments stay as they are. Kind, shape and NaN of the results and changed arguments are looked for
in every call. Whether equal arguments give equal results is looked at in the first, second, fourth,
eighth, ... call of a filter: it sends two sigma points through the model again, the last one and
the first one behind point 0, one of them twice. A vectorized model gets those alone, in another
order and with another one in front, so one that mixes columns is found as well.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.errors import add_note

__all__ = ["CheckedModel", "ObservationModel", "ProcessModel", "check_takes", "wrap"]

ProcessModel = Callable[..., ArrayLike]
ObservationModel = Callable[..., ArrayLike]

Array = NDArray[np.float64]

TURN = 2.0 * np.pi

#: Sums of vectorized models may be rounded in another way for another number of columns. Allowed
#: are these parts of the largest result of the row, and of all, which may have cancelled.
ROW_TOLERANCE, TOLERANCE = 1e-9, 1e-12

#: Errors that a model raises if it is given what it does not expect.
MISUSE = (TypeError, ValueError, IndexError, AttributeError)


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


def _signature(function: Callable[..., Any]) -> inspect.Signature | None:
    """What a function takes; None if it does not say, as some in C."""
    try:
        return inspect.signature(function)
    except (TypeError, ValueError):
        return None


def check_takes(function: Callable[..., ArrayLike], role: str, takes: tuple[str, ...]) -> str:
    """Check that a model can be called with so many arguments; gives its name in messages.

    Raises
    ------
    TypeError
        If it cannot.
    """
    # The function of a functools.partial; a callable object has the name of its class.
    inner: object = getattr(function, "func", function)
    name = f"{role} ({getattr(inner, '__name__', type(inner).__name__)})"
    signature = _signature(function)
    if signature is not None:
        try:
            signature.bind_partial(*takes)
        except TypeError as error:
            raise TypeError(f"{name} must take ({', '.join(takes)}), not {signature}") from error
    return name


class CheckedModel:
    """A user's model, with checks of what it does; see :mod:`ukf_sw.models`.

    Parameters
    ----------
    function
        The model; called as ``function(x, noise, *arguments, **keywords)``.
    role
        What it is, in messages, which add the name of the function.
    takes
        Names of its positional arguments, in messages.
    asked_by
        Method of the filter that calls it, in messages.
    rows
        Length of a result.
    points
        Numbers of the sigma points that it is called for.
    centre
        Number of that to which angles are wrapped.
    vectorized
        Whether it takes all sigma points at once.
    angles
        Rows of the result that are angles in radians.

    Raises
    ------
    TypeError
        If the function cannot be called with so many arguments.
    """

    def __init__(
        self,
        function: Callable[..., ArrayLike],
        *,
        role: str,
        takes: tuple[str, ...],
        asked_by: str,
        rows: int,
        points: range,
        centre: int,
        vectorized: bool = False,
        angles: tuple[int, ...] = (),
    ) -> None:
        self.name = check_takes(function, role, takes)
        self._numbers = points
        #: Column of the sigma point to which angles are wrapped.
        self.centre = points.index(centre)
        # Columns that are sent through the model again. Every filter has them, they differ in every
        # row with uncertainty, and the mean of the three is not that of all. The one in front
        # differs so from column 0: point 0, if it is there, may equal the last one.
        first, last = points.index(1), len(points) - 1
        self._probes = [first, last, first] if first else [last, first, last]
        self.function = function
        self._noise = takes[1]
        self._asked_by = asked_by
        self._rows = rows
        self._vectorized = vectorized
        self.angles = angles
        self._calls = 0

    def __call__(
        self,
        points: Array,
        noise: Array,
        arguments: tuple[Any, ...] = (),
        keywords: Mapping[str, Any] | None = None,
        *,
        used_rows: NDArray[np.bool_] | None = None,
    ) -> Array:
        """Send sigma points through the model.

        Parameters
        ----------
        points, noise
            Sigma points, shapes (n, K) and (terms, K). The model gets copies.
        arguments, keywords
            Further arguments of the model.
        used_rows
            Rows that matter, shape (rows,); what the model returns in the others becomes zero.

        Returns
        -------
        array
            Results, shape (rows, K).

        Raises
        ------
        TypeError
            If the model does not return real numbers.
        ValueError
            If a result has a wrong shape, a row that matters is NaN or infinite or differs between
            two calls with equal arguments, or the model has changed its arguments. The message
            names the model and the sigma point.
        Exception
            Whatever the model raises, with a note that names both. If the cause is an argument
            that is missing, or one sigma point where the model wants all, or all where it wants
            one, that is a TypeError or ValueError that says so.
        """
        given = arguments, keywords or {}
        numbers, probes = self._numbers, self._probes
        results = self._send(points, noise, numbers, given)
        if used_rows is not None:
            results[~used_rows] = 0.0
        if not np.isfinite(results).all():
            row, k = (int(i) for i in np.argwhere(~np.isfinite(results))[0])
            raise ValueError(
                f"{self.name} must return finite numbers, at sigma point {numbers[k]}, "
                f"not {float(results[row, k])!r} in row {row}"
            )
        self._calls += 1
        if self._calls & (self._calls - 1) == 0:
            again = self._send(
                points[:, probes], noise[:, probes], [numbers[k] for k in probes], given
            )
            if used_rows is not None:
                again[~used_rows] = 0.0
            self._check_equal(results, again)
        for row in self.angles:
            results[row] = wrap(results[row], results[row, self.centre])
        return results

    def _send(
        self,
        points: Array,
        noise: Array,
        numbers: Sequence[int],
        given: tuple[tuple[Any, ...], Mapping[str, Any]],
    ) -> Array:
        """Send sigma points of these numbers through the model, in one call or in as many."""
        results = np.empty((self._rows, len(numbers)))
        if self._vectorized:
            x, w = points.copy(), noise.copy()
            where = "one column a sigma point"
            results[:] = self._check(self._call(x, w, given, where), results.shape, where)
        else:
            # Transposed copies, so that each sigma point is in one piece.
            x, w = points.T.copy().T, noise.T.copy().T
            for i, number in enumerate(numbers):
                where = f"at sigma point {number}"
                result = self._call(x[:, i], w[:, i], given, where)
                results[:, i] = self._check(result, (self._rows,), where)
        for argument, now, before in (("x", x, points), (self._noise, w, noise)):
            if not (now == before).all():
                i = int((now != before).any(axis=0).argmax())
                raise ValueError(
                    f"{self.name} must not change its argument {argument}, at sigma point "
                    f"{numbers[i]}, from {before[:, i].tolist()!r} to {now[:, i].tolist()!r}"
                )
        return results

    def _call(
        self, x: Array, w: Array, given: tuple[tuple[Any, ...], Mapping[str, Any]], where: str
    ) -> object:
        """Call the model; what it raises is explained, or gets a note that says in which call."""
        arguments, keywords = given
        try:
            return self.function(x, w, *arguments, **keywords)
        except Exception as error:
            self._explain(error, x, w, given, where)
            add_note(
                error,
                f"in {self.name}, {where}, called with x of shape {x.shape} and "
                f"{self._noise} of shape {w.shape}",
            )
            raise

    def _explain(
        self,
        error: Exception,
        x: Array,
        w: Array,
        given: tuple[tuple[Any, ...], Mapping[str, Any]],
        where: str,
    ) -> None:
        """Raise an error that says what the caller did wrong, if that is what it looks like."""
        if not isinstance(error, MISUSE):
            return
        arguments, keywords = given
        raised = f"{self.name} raised {type(error).__name__} ({error}), {where}"
        signature = _signature(self.function)
        if signature is not None:
            try:
                signature.bind(x, w, *arguments, **keywords)
            except TypeError as misfit:
                raise TypeError(
                    f"{self._asked_by} must be given what {self.name} takes, {signature}: {misfit}"
                ) from error
        if self._vectorized and self._gives((self._rows,), x[:, 0], w[:, 0], given):
            raise ValueError(
                f"{raised}, but works for a single one: leave out vectorized=True, or let it take "
                f"x of shape {x.shape}"
            ) from error
        if not self._vectorized:
            pairs = np.stack([x, x], axis=1), np.stack([w, w], axis=1)
            if self._gives((self._rows, 2), *pairs, given):
                raise ValueError(
                    f"{raised}, but works for several at once: say vectorized=True"
                ) from error
        if len(arguments) == 1 and arguments[0] is None and not isinstance(error, ValueError):
            raise TypeError(f"{raised}: {self._asked_by} was given no u, so u is None") from error

    def _gives(
        self,
        shape: tuple[int, ...],
        x: Array,
        w: Array,
        given: tuple[tuple[Any, ...], Mapping[str, Any]],
    ) -> bool:
        """Whether the model gives an array of a shape."""
        with suppress(Exception):
            return np.shape(self.function(x.copy(), w.copy(), *given[0], **given[1])) == shape
        return False

    def _check(self, result: object, shape: tuple[int, ...], where: str) -> Array:
        """Check the kind and the shape of what the model returned."""
        if np.ma.is_masked(result):
            raise TypeError(f"{self.name} must return no masked elements, {where}, not {result!r}")
        try:
            array = np.asarray(result)
        except ValueError as error:
            raise TypeError(
                f"{self.name} must return an array of numbers, {where}: {error}"
            ) from error
        if array.dtype.kind not in "fiub":
            raise TypeError(f"{self.name} must return real numbers, {where}, not {result!r}")
        if array.shape != shape:
            raise ValueError(
                f"{self.name} must return the shape {shape}, {where}, not {array.shape!r}"
            )
        return array.astype(np.float64, copy=False)

    def _check_equal(self, results: Array, again: Array) -> None:
        """Check that the probes gave the same again."""
        first = results[:, self._probes]
        tolerance = np.zeros((self._rows, 1))
        rule = "give equal results for equal arguments"
        if self._vectorized:
            largest = np.abs(results).max(axis=1, keepdims=True)
            tolerance = np.maximum(ROW_TOLERANCE * largest, TOLERANCE * largest.max())
            rule += ", whatever the other columns are"
        different = ~(np.abs(again - first) <= tolerance)
        if different.any():
            row, i = (int(index) for index in np.argwhere(different)[0])
            raise ValueError(
                f"{self.name} must {rule}, at sigma point {self._numbers[self._probes[i]]}, not "
                f"{float(first[row, i])!r} and then {float(again[row, i])!r} in row {row}"
            )
