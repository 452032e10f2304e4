"""The filter that users see, whatever computes it: reference, golden model or a core on a bus."""

import copy
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.backends import Backend, make_backend
from ukf_sw.certainty import Certainty
from ukf_sw.errors import REFUSALS, NotFiniteError
from ukf_sw.factors import IndefiniteError, check_definite, lower_factor, rounding_errors
from ukf_sw.models import CheckedModel, ObservationModel, ProcessModel, wrap
from ukf_sw.results import ReadOnlyArray
from ukf_sw.spec.fields import as_bool, as_int, as_number
from ukf_sw.spec.parameters import Form, UkfParams
from ukf_sw.spec.sequence import Step

__all__ = ["UnscentedKalmanFilter"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: What :attr:`UnscentedKalmanFilter.nis` and ``gated`` are before an update.
NO_UPDATE = (None, False)
DOUBLE = float(np.finfo(np.float64).eps)


def _is_masked(value: Any) -> bool:
    """Whether elements of an array, or of a list or of its rows, are masked as those of np.ma."""
    if isinstance(value, (list, tuple)):
        return any(map(np.ma.is_masked, cast("list[Any]", value)))
    return np.ma.is_masked(value)


def _raw(value: ArrayLike, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Check kind and shape of an array of numbers, none of them masked."""
    if _is_masked(value):
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


def _numbers(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Check an array of numbers, and copy it."""
    return np.array(_raw(value, name, shape), dtype=np.float64)


def _vector(value: ArrayLike, name: str, length: int) -> Array:
    """Check a vector."""
    array = _numbers(value, name, (length,))
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, not {array.tolist()!r}")
    return array


def _covariance(value: ArrayLike | None, name: str, size: int, *, definite: bool = False) -> Array:
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
            _covariance(array.astype(np.float32), name, len(array), definite=definite)
            return "; if it comes from float32, its rounding is allowed for when given as float32"
    return ""


def _angles(value: Iterable[int], name: str, size: int) -> tuple[int, ...]:
    """Check indices of angles."""
    if isinstance(value, str) or not isinstance(cast("object", value), Iterable):
        raise TypeError(f"{name} must be a tuple of indices, as (0,), not {value!r}")
    indices = tuple(as_int(f"each of {name}", index) for index in value)
    for index in indices:
        if not 0 <= index < size:
            raise ValueError(f"{name} must be between 0 and {size - 1}, not {index!r}")
    if len(set(indices)) < len(indices):
        raise ValueError(f"{name} must be different indices, not {indices!r}")
    return indices


class UnscentedKalmanFilter:
    """An unscented Kalman filter.

    ::

        ukf = UnscentedKalmanFilter(f, h, params, Q=Q, R=R, x0=x0, P0=P0, backend="golden")
        for u, z in data:
            ukf.predict(u)
            ukf.update(z)
            print(ukf.x)

    Predict and update may come at different rates and in any order; several updates may follow each
    other. An update directly after a predict sends the predicted sigma points through h, as in the
    papers; any other update draws new ones first. :meth:`redraw` in between asks for that. The
    predicted points do not have the spread of an *additive* process noise, and without redrawing
    the gain would leave that of the last step out of account, so with such a noise predict redraws
    unless ``redraw=False``. (filterpy always redraws.)

    Nothing that raises changes the estimate; but a predict that follows a predict begins with a
    :meth:`redraw`, which stays. With redrawing, predict is one step: it is done if the new sigma
    points are there. Without, :meth:`undo_predict` goes back if they cannot be drawn later.

    An error that leaves open what a core has done (:mod:`ukf_sw.errors` says which, and
    KeyboardInterrupt is one) makes all that needs the core raise
    :class:`ukf_sw.errors.NotRecoveredError` until :meth:`recover` or :meth:`reset` has succeeded.

    The arrays that it gives are copies, which cannot be written: assign the whole, as in
    ``ukf.x = x`` or ``ukf.x += d``. A filter can be pickled and copied if its models can, and if it
    has no core on a device. Every copy is a deep one, with a backend of its own.

    Parameters
    ----------
    f, h
        Process and observation model; see :mod:`ukf_sw.models`.
    params
        Sizes, kinds of noise, and what else the core computes.
    Q, R
        Covariances of w and v, shapes (q, q) and (r, r), positive semidefinite. None if q or r
        is 0.
    x0
        First estimate, shape (n,).
    P0
        Its covariance, shape (n, n), positive semidefinite; positive definite for a core of the
        covariance form.
    backend
        What computes: "reference" (float64, the papers' equations), "golden" (the software model
        of the core, every bit as in hardware), or an object such as a
        :class:`ukf_sw.drivers.driver.Driver` of a core.
    vectorized
        Whether the models take all sigma points at once.
    redraw
        Whether every predict ends with :meth:`redraw`; None: if there is additive process noise.
        It costs a factorisation and, on a core, reading the points once more.
    state_angles, observation_angles
        Indices of the states and of the observations that are angles, in radians. Results of the
        models and z are wrapped to within half a turn of sigma point 0.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If an argument has a wrong shape or value; the message names the rule and the value.
    UkfError
        If the core cannot be reached or refuses to start.
    """

    __slots__ = (
        "__weakref__", "_backend", "_certainty", "_f", "_first", "_gate", "_h", "_last_P",
        "_last_update", "_last_x", "_mask", "_noise", "_noise_points", "_observation_angles",
        "_params", "_redraws", "_transformed",
    )  # fmt: skip

    def __init__(
        self,
        f: ProcessModel,
        h: ObservationModel,
        params: UkfParams,
        *,
        x0: ArrayLike,
        P0: ArrayLike,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        backend: Backend | str = "reference",
        vectorized: bool = False,
        redraw: bool | None = None,
        state_angles: tuple[int, ...] = (),
        observation_angles: tuple[int, ...] = (),
    ) -> None:
        for name, model in (("f", f), ("h", h)):
            if not callable(model):
                raise TypeError(f"{name} must be callable, not {model!r}")
        if not isinstance(cast("object", params), UkfParams):
            raise TypeError(f"params must be a UkfParams, not {params!r}")
        vectorized = as_bool("vectorized", vectorized)
        self._observation_angles = _angles(observation_angles, "observation_angles", params.m)
        self._f = CheckedModel(
            f, role="process model f", takes=("x", "w", "u"), asked_by="predict", rows=params.n,
            vectorized=vectorized, angles=_angles(state_angles, "state_angles", params.n),
        )  # fmt: skip
        self._h = CheckedModel(
            h, role="observation model h", takes=("x", "v"), asked_by="update", rows=params.m,
            vectorized=vectorized, angles=self._observation_angles,
        )  # fmt: skip
        self._params = params
        self._redraws = params.additive_q > 0 if redraw is None else as_bool("redraw", redraw)
        self._first = (
            _vector(x0, "x0", params.n),
            _covariance(P0, "P0", params.n, definite=self._needs_definite),
        )
        self._noise = _covariance(Q, "Q", params.q), _covariance(R, "R", params.r)
        self._noise_points: tuple[Array, Array]
        self._mask = np.ones(params.m, dtype=np.bool_)
        self._gate = np.inf
        self._certainty = Certainty()
        self._backend = self._find_backend(backend)
        self._forget()
        self._certainty.assign_anew(self._start, *self._first)

    def __copy__(self) -> "UnscentedKalmanFilter":
        """Copy as copy.deepcopy does: two filters on one core would not know of each other."""
        return copy.deepcopy(self)

    @property
    def _needs_definite(self) -> bool:
        return self._params.form is Form.COVARIANCE

    def _find_backend(self, backend: Backend | str) -> Backend:
        """Find the backend of a name."""
        if isinstance(backend, str):
            return make_backend(backend, self._params)
        if not isinstance(cast("object", backend), Backend):
            raise TypeError(f"backend must be a name or a Backend, not {backend!r}")
        if backend.params != self._params:
            raise ValueError(
                f"params of the backend must be {self._params!r}, not {backend.params!r}"
            )
        return backend

    def _forget(self) -> None:
        """Forget what is derived from the state of the backend."""
        self._transformed: Array | None = None
        self._last_x: Array | None = None
        self._last_P: Array | None = None
        self._last_update: tuple[float | None, bool] = NO_UPDATE

    # What is sent to the backend, and once more by `recover` if that breaks off.

    def _start(self, x: Array, P: Array) -> None:
        self._backend.initialise(x, P, *self._noise)
        self._backend.set_gate(self._gate)
        self._noise_points = self._backend.noise_points()
        self._forget()

    def _send_state(self, x: Array) -> None:
        self._backend.set_state(x)
        self._transformed = self._last_x = None

    def _send_covariance(self, P: Array) -> None:
        self._backend.set_covariance(P)
        self._transformed = self._last_P = None

    def _send_noise(self, Q: Array, R: Array) -> None:
        try:
            self._backend.set_noise(Q, R)
        except NotFiniteError as error:
            if error.step is Step.INIT:  # there has been a redraw before it
                self._transformed = None
            raise
        self._transformed = None
        self._noise = Q, R
        self._noise_points = self._backend.noise_points()

    def _send_gate(self, gate: float) -> None:
        self._backend.set_gate(gate)
        self._gate = gate

    @property
    def params(self) -> UkfParams:
        """Parameters given to the constructor."""
        return self._params

    @property
    def backend(self) -> Backend:
        """What computes the steps."""
        return self._backend

    @property
    def x(self) -> Array:
        """Estimate, shape (n,), a copy. Assigning to it leaves P as it is."""
        self._certainty.check()
        if self._last_x is None:
            self._last_x = self._backend.state()
        return ReadOnlyArray.of(self._last_x)

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._certainty.assign(self._send_state, _vector(value, "x", self._params.n))

    @property
    def P(self) -> Array:
        """Covariance of the estimate, shape (n, n), a copy. Assigning to it leaves x as it is.

        A core computes it when asked, from its factor.
        """
        self._certainty.check()
        if self._last_P is None:
            with self._certainty:
                self._last_P = self._backend.covariance()
        return ReadOnlyArray.of(self._last_P)

    @P.setter
    def P(self, value: ArrayLike) -> None:
        P = _covariance(value, "P", self._params.n, definite=self._needs_definite)
        self._certainty.assign(self._send_covariance, P)

    @property
    def Q(self) -> Array:
        """Covariance of the process noise, shape (q, q), a copy. Assignable."""
        return ReadOnlyArray.of(self._noise[0])

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        Q = _covariance(value, "Q", self._params.q)
        self._certainty.assign(self._send_noise, Q, self._noise[1])

    @property
    def R(self) -> Array:
        """Covariance of the observation noise, shape (r, r), a copy. Assignable."""
        return ReadOnlyArray.of(self._noise[1])

    @R.setter
    def R(self, value: ArrayLike) -> None:
        R = _covariance(value, "R", self._params.r)
        self._certainty.assign(self._send_noise, self._noise[0], R)

    @property
    def mask(self) -> Mask:
        """Which observations updates use unless told otherwise, shape (m,), a copy. Assignable."""
        return ReadOnlyArray.of(self._mask)

    @mask.setter
    def mask(self, value: ArrayLike) -> None:
        self._mask = self._check_mask(value)

    def _check_mask(self, value: ArrayLike) -> Mask:
        if _is_masked(value):
            raise TypeError(f"mask must have no masked elements, not {value!r}")
        mask = np.asarray(value)
        numbers = mask.dtype.kind in "iuf" and bool(((mask == 0) | (mask == 1)).all())
        if not (mask.dtype == np.bool_ or numbers):
            raise TypeError(f"mask must be an array of bool, or of 0 and 1, not {value!r}")
        if mask.shape != (self._params.m,):
            raise ValueError(f"mask must have the shape {(self._params.m,)}, not {mask.shape!r}")
        return mask.astype(np.bool_)

    @property
    def gate(self) -> float:
        """NIS above which an update is rejected; infinity, the default, is off. Assignable."""
        return self._gate

    @gate.setter
    def gate(self, value: float) -> None:
        gate = as_number("gate", value)
        if not gate >= 0.0:
            raise ValueError(f"gate must be at least 0, not {value!r}")
        self._certainty.assign(self._send_gate, gate)

    @property
    def nis(self) -> float | None:
        """Normalised innovation squared of the last update.

        None before the first, and if a :meth:`recover` has come since.
        """
        self._certainty.check()
        return self._last_update[0]

    @property
    def gated(self) -> bool:
        """Whether the last update was rejected because its NIS exceeded the gate."""
        self._certainty.check()
        return self._last_update[1]

    def reset(self, x: ArrayLike | None = None, P: ArrayLike | None = None) -> None:
        """Start again from an estimate. No :meth:`recover` is needed before it.

        Parameters
        ----------
        x, P
            Estimate and covariance; None is what the constructor was given.

        Raises
        ------
        TypeError, ValueError
            As the constructor; the filter goes on as if not called.
        UkfError
            If the core cannot be reached or refuses.
        """
        new_x = self._first[0] if x is None else _vector(x, "x", self._params.n)
        new_P = (
            self._first[1]
            if P is None
            else _covariance(P, "P", self._params.n, definite=self._needs_definite)
        )
        self._certainty.assign_anew(self._start, new_x, new_P)

    def recover(self) -> None:
        """Go on after an error or interrupt that has left open what the core has done.

        Afterwards :attr:`x` and :attr:`P` are those of the core again, and all settings agree:

        - An assignment to x, P, Q, R or gate, or a :meth:`reset`, that broke off has been made.
        - A predict that broke off has not happened, or has happened as a whole.
        - So has an update. :attr:`nis` is None.
        - If the core had to be reset in a step, and the estimate was a prediction that had not been
          factorised, it is that from before the prediction.

        If it raises, it can be called again. Without an error before, it is legal and keeps the
        estimate; but sigma points may be drawn anew, so the last bits of later estimates may be
        others. :attr:`nis` is None.

        Raises
        ------
        EstimateLostError
            If what is left of the estimate cannot be found out; :meth:`reset` begins anew.
        UkfError
            If the core cannot be reached. What is in :data:`ukf_sw.errors.REFUSALS` is about the
            assignment that had broken off, which is not made then, and leaves no doubt.
        """
        self._certainty.settle(self._find_out)

    def _find_out(self) -> None:
        self._forget()
        self._transformed = self._backend.recover()
        if self._redraws and self._backend.undo_predict():
            self._transformed = None

    def undo_predict(self) -> None:
        """Go back to the estimate from before the last predict.

        For a predict without redrawing whose covariance turns out not to be one, so that P or the
        next step raises. It is possible until the prediction has been factorised: by
        :meth:`redraw`, a predict, an update that was not gated, or a change of P, Q or R.

        Raises
        ------
        ValueError
            If there is no such predict.
        UkfError
            If the core cannot be reached.
        """
        with self._certainty:
            undone = self._backend.undo_predict()
            if undone:
                self._transformed = self._last_x = self._last_P = None
        if not undone:
            raise ValueError("undo_predict must follow a predict that nothing has factorised since")

    def predict(self, u: Any = None, **arguments: Any) -> None:
        """Predict the state at the next step.

        Parameters
        ----------
        u
            Input, third argument of f.
        arguments
            Keyword arguments of f.

        Raises
        ------
        TypeError, ValueError
            If f does what it must not; see :mod:`ukf_sw.models`.
        UkfError
            If a step fails.
        """
        results = self._f(self._draw(), self._noise_points[0], (u,), arguments)
        with self._certainty:
            transformed = self._backend.predict(results)
            if self._redraws:
                transformed = None
                try:
                    self._backend.redraw()
                except REFUSALS:
                    self._backend.undo_predict()
                    raise
            self._last_x = self._last_P = None
            self._transformed = transformed

    def redraw(self) -> None:
        """Draw new sigma points from the estimate, so that an update after a predict uses them.

        Raises
        ------
        UkfError
            If a step fails.
        """
        with self._certainty:
            self._backend.redraw()
            self._transformed = None

    def _draw(self) -> Array:
        """Sigma points of the estimate; those of the last predict are forgotten."""
        with self._certainty:
            points = self._backend.sigma_points()
            self._transformed = None
        return points

    def update(self, z: ArrayLike | None, mask: ArrayLike | None = None, **arguments: Any) -> bool:
        """Correct the state with an observation.

        Parameters
        ----------
        z
            Observation, shape (m,). None, nothing sampled now, leaves everything as it is. Masked
            elements of a NumPy masked array were not sampled, whatever `mask` says.
        mask
            Which observations were sampled, an array of bool, shape (m,); z may be NaN in the
            others. None is :attr:`mask`. If it is all False, nothing was sampled.
        arguments
            Keyword arguments of h.

        Returns
        -------
        bool
            Whether the estimate was corrected: False if nothing was sampled or the gate rejected z.

        Raises
        ------
        TypeError, ValueError
            If z or mask is wrong, or if h does what it must not; see :mod:`ukf_sw.models`.
        UkfError
            If a step fails.
        """
        p = self._params
        used = self._mask if mask is None else self._check_mask(mask)
        if z is not None and _is_masked(z):
            masked = cast("Any", np.ma.array(cast("Any", z)))
            z = masked.filled(0)
            used = used & ~np.ma.getmaskarray(masked) if masked.shape == used.shape else used
        if z is None or not used.any():
            return False
        observation = _numbers(z, "z", (p.m,))
        observation[~used] = 0.0
        if not np.isfinite(observation).all():
            raise ValueError(f"z must be finite where sampled, not {np.asarray(z).tolist()!r}")
        points = self._transformed if self._transformed is not None else self._draw()
        results = self._h(points, self._noise_points[1], keywords=arguments, used_rows=used)
        for row in self._observation_angles:
            if used[row]:
                observation[row] = wrap(observation[row], results[row, 0])
        with self._certainty:
            nis, gated = self._backend.update(results, observation, used)
            if not gated:
                self._transformed = self._last_x = self._last_P = None
            self._last_update = nis, gated
        return not gated
