"""The filter that users see, whatever computes it: reference, golden model or a core on a bus."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.backends import Backend, make_backend
from ukf_sw.errors import NotFiniteError, NotPositiveDefiniteError, SingularObservationError
from ukf_sw.models import CheckedModel, ObservationModel, ProcessModel, wrap
from ukf_sw.spec.parameters import Form, UkfParams

__all__ = ["UnscentedKalmanFilter"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

#: A step that ends so has changed nothing. After any other error that is not certain.
VERDICTS = (NotFiniteError, NotPositiveDefiniteError, SingularObservationError)


def _numbers(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Check an array of numbers, and copy it."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TypeError(f"{name} must be an array of real numbers, not {value!r}") from error
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must be an array of real numbers, not {value!r}")
    if array.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, not {array.shape!r}")
    return np.array(array, dtype=np.float64)


def _vector(value: ArrayLike, name: str, length: int) -> Array:
    """Check a vector."""
    array = _numbers(value, name, (length,))
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, not {array.tolist()!r}")
    return array


def _covariance(value: ArrayLike | None, name: str, size: int, *, definite: bool = False) -> Array:
    """Check a covariance: symmetric and positive semidefinite, or definite."""
    if value is None:
        if size:
            raise TypeError(f"{name} must be a matrix of shape {(size, size)}, not None")
        return np.zeros((0, 0))
    array = _numbers(value, name, (size, size))
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, not {array.tolist()!r}")
    if not size:
        return array
    largest = np.abs(array).max()
    if np.abs(array - array.T).max() > 1e-9 * largest:
        row, column = np.unravel_index(np.abs(array - array.T).argmax(), array.shape)
        raise ValueError(
            f"{name} must be symmetric, not {float(array[row, column])!r} at ({row}, {column}) "
            f"and {float(array[column, row])!r} at ({column}, {row})"
        )
    array = (array + array.T) / 2.0
    smallest = float(np.linalg.eigvalsh(array)[0])
    tolerance = 1e-13 * size * float(largest)
    if definite and smallest <= tolerance:
        raise ValueError(
            f"{name} must be positive definite, its smallest eigenvalue not {smallest!r}"
        )
    if smallest < -tolerance:
        raise ValueError(
            f"{name} must be positive semidefinite, its smallest eigenvalue not {smallest!r}"
        )
    return array


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

    Nothing that raises changes the estimate, except as :class:`ukf_sw.errors.CoreTimeoutError`
    says. After a :class:`ukf_sw.errors.BusError` a step may have happened or not; :attr:`x` and
    :attr:`P` are those of the core, whatever it has done.

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
        for name, angles, size in (
            ("state_angles", state_angles, params.n),
            ("observation_angles", observation_angles, params.m),
        ):
            for index in angles:
                if not 0 <= index < size:
                    raise ValueError(f"{name} must be between 0 and {size - 1}, not {index!r}")
        self._f = CheckedModel(
            f, role="process model f", noise="w", rows=params.n, vectorized=vectorized,
            angles=tuple(state_angles),
        )  # fmt: skip
        self._h = CheckedModel(
            h, role="observation model h", noise="v", rows=params.m, vectorized=vectorized,
            angles=tuple(observation_angles),
        )  # fmt: skip
        self._params = params
        self._redraws = params.additive_q > 0 if redraw is None else redraw
        self._observation_angles = tuple(observation_angles)
        self._x0 = _vector(x0, "x0", params.n)
        self._P0 = _covariance(P0, "P0", params.n, definite=self._needs_definite)
        self._noise_Q = _covariance(Q, "Q", params.q)
        self._noise_R = _covariance(R, "R", params.r)
        self._mask = np.ones(params.m, dtype=np.bool_)
        self._gate = np.inf
        self._backend = self._find_backend(backend)
        self._initialise(self._x0, self._P0)

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

    def _initialise(self, x: Array, P: Array) -> None:
        """Send everything to the backend and forget what was derived from it."""
        self._transformed: Array | None = None
        self._last_x: Array | None = None
        self._last_P: Array | None = None
        self._nis: float | None = None
        self._gated = False
        self._backend.initialise(x, P, self._noise_Q, self._noise_R)
        self._backend.set_gate(self._gate)
        self._points_W, self._points_V = self._backend.noise_points()

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
        if self._last_x is None:
            self._last_x = self._backend.state()
        return self._last_x.copy()

    @x.setter
    def x(self, value: ArrayLike) -> None:
        x = _vector(value, "x", self._params.n)
        self._transformed = self._last_x = None
        self._backend.set_state(x)

    @property
    def P(self) -> Array:
        """Covariance of the estimate, shape (n, n), a copy. Assigning to it leaves x as it is.

        A core computes it when asked, from its factor.
        """
        if self._last_P is None:
            self._last_P = self._backend.covariance()
        return self._last_P.copy()

    @P.setter
    def P(self, value: ArrayLike) -> None:
        P = _covariance(value, "P", self._params.n, definite=self._needs_definite)
        self._transformed = self._last_P = None
        self._backend.set_covariance(P)

    @property
    def Q(self) -> Array:
        """Covariance of the process noise, shape (q, q), a copy. Assignable."""
        return self._noise_Q.copy()

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        self._set_noise(_covariance(value, "Q", self._params.q), self._noise_R)

    @property
    def R(self) -> Array:
        """Covariance of the observation noise, shape (r, r), a copy. Assignable."""
        return self._noise_R.copy()

    @R.setter
    def R(self, value: ArrayLike) -> None:
        self._set_noise(self._noise_Q, _covariance(value, "R", self._params.r))

    def _set_noise(self, Q: Array, R: Array) -> None:
        self._transformed = None
        self._backend.set_noise(Q, R)
        self._noise_Q, self._noise_R = Q, R
        self._points_W, self._points_V = self._backend.noise_points()

    @property
    def mask(self) -> Mask:
        """Which observations updates use unless told otherwise, shape (m,), a copy. Assignable."""
        return self._mask.copy()

    @mask.setter
    def mask(self, value: ArrayLike) -> None:
        self._mask = self._check_mask(value)

    def _check_mask(self, value: ArrayLike) -> Mask:
        mask = np.asarray(value)
        if mask.dtype != np.bool_:
            raise TypeError(f"mask must be an array of bool, not {value!r}")
        if mask.shape != (self._params.m,):
            raise ValueError(f"mask must have the shape {(self._params.m,)}, not {mask.shape!r}")
        return mask.copy()

    @property
    def gate(self) -> float:
        """NIS above which an update is rejected; infinity, the default, is off. Assignable."""
        return self._gate

    @gate.setter
    def gate(self, value: float) -> None:
        if isinstance(value, bool) or not isinstance(cast("object", value), int | float):
            raise TypeError(f"gate must be a float, not {value!r}")
        if not value >= 0.0:
            raise ValueError(f"gate must be at least 0, not {value!r}")
        self._backend.set_gate(float(value))
        self._gate = float(value)

    @property
    def nis(self) -> float | None:
        """Normalised innovation squared of the last update; None before the first."""
        return self._nis

    @property
    def gated(self) -> bool:
        """Whether the last update was rejected because its NIS exceeded the gate."""
        return self._gated

    def reset(self, x: ArrayLike | None = None, P: ArrayLike | None = None) -> None:
        """Start again from an estimate.

        Parameters
        ----------
        x, P
            Estimate and covariance; None is what the constructor was given.

        Raises
        ------
        TypeError, ValueError
            As the constructor; the filter goes on as if not called.
        """
        new_x = self._x0 if x is None else _vector(x, "x", self._params.n)
        new_P = (
            self._P0
            if P is None
            else _covariance(P, "P", self._params.n, definite=self._needs_definite)
        )
        self._initialise(new_x, new_P)

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
        results = self._f(self._draw(), self._points_W, (u,), arguments)
        self._transformed = self._ask(self._backend.predict, results)
        self._last_x = self._last_P = None
        if self._redraws:
            self.redraw()

    def redraw(self) -> None:
        """Draw new sigma points from the estimate, so that an update after a predict uses them.

        Raises
        ------
        UkfError
            If a step fails.
        """
        self._ask(self._backend.redraw)
        self._transformed = None

    def _draw(self) -> Array:
        """Sigma points of the estimate; those of the last predict are forgotten."""
        points = self._ask(self._backend.sigma_points)
        self._transformed = None
        return points

    def _ask(
        self,
        step: Callable[Arguments, Result],
        *arguments: Arguments.args,
        **keywords: Arguments.kwargs,
    ) -> Result:
        """Run a step of the backend; if it breaks off, believe only what the backend says."""
        try:
            return step(*arguments, **keywords)
        except VERDICTS:
            raise
        except BaseException:
            self._transformed = self._last_x = self._last_P = None
            raise

    def update(self, z: ArrayLike | None, mask: ArrayLike | None = None, **arguments: Any) -> bool:
        """Correct the state with an observation.

        Parameters
        ----------
        z
            Observation, shape (m,). None, nothing sampled now, leaves everything as it is.
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
        if z is None or not used.any():
            return False
        observation = _numbers(z, "z", (p.m,))
        observation[~used] = 0.0
        if not np.isfinite(observation).all():
            raise ValueError(f"z must be finite where sampled, not {np.asarray(z).tolist()!r}")
        points = self._transformed if self._transformed is not None else self._draw()
        results = self._h(points, self._points_V, keywords=arguments, used_rows=used)
        for row in self._observation_angles:
            if used[row]:
                observation[row] = wrap(observation[row], results[row, 0])
        self._nis, self._gated = self._ask(self._backend.update, results, observation, used)
        if not self._gated:
            self._transformed = self._last_x = self._last_P = None
        return not self._gated
