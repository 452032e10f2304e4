"""The filter that users see, whatever computes it: reference, golden model or a core on a bus."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.ahead import Observations, samples_for_core
from ukf_sw.arrays import as_covariance, as_numbers, as_vector, is_masked
from ukf_sw.backends import Backend, CoreBackend, make_backend
from ukf_sw.certainty import Certainty
from ukf_sw.errors import REFUSALS, NotFiniteError
from ukf_sw.extras import importing
from ukf_sw.models import CheckedModel, wrap
from ukf_sw.problem import Problem, of_sensor
from ukf_sw.results import ReadOnlyArray
from ukf_sw.spec.fields import as_number
from ukf_sw.spec.model_programs import NO_MODELS, choose_models
from ukf_sw.spec.parameters import Form, UkfParams
from ukf_sw.spec.sequence import Step

if TYPE_CHECKING:
    from ukf_sw.lowering.placement import PlacedModels

__all__ = ["UnscentedKalmanFilter"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: What :attr:`UnscentedKalmanFilter.nis` and ``gated`` are before an update.
NO_UPDATE = (None, False)


class UnscentedKalmanFilter:
    """An unscented Kalman filter.

    ::

        ukf = UnscentedKalmanFilter(problem, "golden")
        for u, z in data:
            ukf.predict(u)
            ukf.update(z)
            print(ukf.x)

    With several sensors, each update is of one: ``ukf.update(z, sensor="gps")``.

    Predict and update may come at different rates and in any order; several updates may follow each
    other. An update directly after a predict sends the predicted sigma points through h, as in the
    papers; any other update draws new ones first. :meth:`redraw` in between asks for that. The
    predicted points do not have the spread of an *additive* process noise, and without redrawing
    the gain would leave that of the last step out of account, so with such a noise predict redraws
    unless the problem says otherwise. (filterpy always redraws.)

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
    problem
        What to estimate: see :class:`ukf_sw.problem.Problem`. Its data, if any, do not matter.
    backend
        What computes: "reference" (float64, the papers' equations), "golden" (the software model
        of the core, every bit as in hardware), or an object such as a
        :class:`ukf_sw.drivers.driver.Driver` of a core. Such a core decides form, format and number
        of processing elements; its sizes, kinds of noise and W0 must be those of the problem.
    models
        Which models the core evaluates: "core", "software", or of each as ``{"f": "core"}``. None
        is what the backend does, all in software if it is a name. On the core they are programs
        that :mod:`ukf_sw.lowering` makes of the functions, in the number format of the core; with
        what u and the arguments of h are like in the data of the problem.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If an argument has a wrong shape or value; the message names the rule and the value.
    UkfError
        If the core cannot be reached or refuses to start.
    TraceError
        If a model that is to be on the core cannot be.
    """

    __slots__ = (
        "__weakref__", "_backend", "_certainty", "_f", "_first", "_gate", "_h", "_last_P",
        "_last_update", "_last_x", "_mask", "_noise", "_noise_points", "_params", "_placed",
        "_problem", "_transformed",
    )  # fmt: skip

    def __init__(
        self,
        problem: Problem,
        backend: Backend | str = "reference",
        models: str | Mapping[str, str] | None = None,
    ) -> None:
        if not isinstance(cast("object", problem), Problem):
            raise TypeError(f"problem must be a Problem, not {problem!r}")
        if not isinstance(cast("object", backend), (str, Backend)):
            raise TypeError(f"backend must be a name or a Backend, not {backend!r}")
        if not isinstance(backend, str):
            if backend.params.W0 != problem.W0:
                raise ValueError(
                    f"W0 of a core for {problem.name} must be {problem.W0!r}, not "
                    f"{backend.params.W0!r}"
                )
            problem = problem.for_core(backend.params)
        self._placed = _placed(problem, backend, models)
        # Copies of a filter need neither the data nor what compares with them.
        self._problem = problem = replace(problem, data=None, error=None)
        own = NO_MODELS if self._placed is None else self._placed.models
        self._params = params = replace(problem.params, models=own)
        self._f = CheckedModel(
            problem.f, role="process model f", takes=("x", "w", "u"), asked_by="predict",
            rows=params.n, points=params.points, centre=params.centre,
            vectorized=problem.vectorized,
            angles=cast("tuple[int, ...]", problem.state_angles),
        )  # fmt: skip
        self._h = tuple(
            CheckedModel(
                problem.sensor(name).h, role="observation model " + of_sensor("h", name),
                takes=("x", "v"), asked_by="update", rows=len(params.rows_of(number)),
                points=params.points, centre=params.centre, vectorized=problem.vectorized,
                angles=cast("tuple[int, ...]", problem.sensor(name).angles),
            )
            for number, name in enumerate(problem.sensor_names)
        )  # fmt: skip
        self._first = problem.x0, problem.P0
        self._noise = problem.Q, problem.R
        self._noise_points: tuple[Array, Array]
        self._mask = np.ones(params.m, dtype=np.bool_)
        self._gate = np.inf
        self._certainty = Certainty()
        self._backend = make_backend(backend, params) if isinstance(backend, str) else backend
        if self._placed is not None and not isinstance(self._backend, CoreBackend):
            raise ValueError(f"models must be in software for a backend {backend!r}")
        self._forget()
        self._certainty.assign_anew(self._start, *self._first)

    def __copy__(self) -> "UnscentedKalmanFilter":
        """Copy as copy.deepcopy does: two filters on one core would not know of each other."""
        return copy.deepcopy(self)

    @property
    def _needs_definite(self) -> bool:
        return self._params.form is Form.COVARIANCE

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
        self._read_noise_points()
        self._forget()

    def _read_noise_points(self) -> None:
        """Read the sigma points of the noise, which models in software need."""
        if self._placed is None or not (self._placed.f and self._placed.h):
            self._noise_points = self._backend.noise_points()

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
        self._read_noise_points()

    def _send_gate(self, gate: float) -> None:
        self._backend.set_gate(gate)
        self._gate = gate

    @property
    def problem(self) -> Problem:
        """What is estimated, by a core of this form, format and number of PEs; without data."""
        return self._problem

    @property
    def params(self) -> UkfParams:
        """What a core for it computes."""
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
        self._certainty.assign(self._send_state, as_vector(value, "x", self._params.n))

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
        P = as_covariance(value, "P", self._params.n, definite=self._needs_definite)
        self._certainty.assign(self._send_covariance, P)

    @property
    def Q(self) -> Array:
        """Covariance of the process noise, shape (q, q), a copy. Assignable."""
        return ReadOnlyArray.of(self._noise[0])

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        Q = as_covariance(value, "Q", self._params.q)
        self._certainty.assign(self._send_noise, Q, self._noise[1])

    @property
    def R(self) -> Array:
        """Covariance of the observation noise, shape (r, r), a copy. Assignable.

        It has the covariances of the sensors on its diagonal, and nothing beside them.
        """
        return ReadOnlyArray.of(self._noise[1])

    @R.setter
    def R(self, value: ArrayLike) -> None:
        R = as_covariance(value, "R", self._params.r)
        beside = R != 0.0
        for number in range(len(self._h)):
            terms = self._problem.terms_of(number)
            beside[terms.start : terms.stop, terms.start : terms.stop] = False
        if beside.any():
            row, column = (int(index) for index in np.argwhere(beside)[0])
            raise ValueError(
                "R must be zero between sensors, which have an update each, not "
                f"{float(R[row, column])!r} at ({row}, {column})"
            )
        self._certainty.assign(self._send_noise, self._noise[0], R)

    def set_R(self, R: ArrayLike, sensor: str | None = None) -> None:
        """Replace the covariance of the noise of one sensor; those of the others stay.

        Parameters
        ----------
        R
            Covariance, shape (r, r) with the noise terms of the sensor.
        sensor
            Its name; None is the only one.

        Raises
        ------
        TypeError, ValueError
            If R or the name is wrong.
        UkfError
            If a step fails; then nothing has changed.
        """
        number = self._problem.number_of(sensor)
        terms = self._problem.terms_of(number)
        whole = self._noise[1].copy()
        whole[terms.start : terms.stop, terms.start : terms.stop] = as_covariance(
            R, of_sensor("R", self._problem.sensor_names[number]), len(terms)
        )
        self._certainty.assign(self._send_noise, self._noise[0], whole)

    @property
    def mask(self) -> Mask:
        """Which observations updates use unless told otherwise, shape (m,), a copy. Assignable."""
        return ReadOnlyArray.of(self._mask)

    @mask.setter
    def mask(self, value: ArrayLike) -> None:
        self._mask = self._check_mask(value, self._params.m)

    @staticmethod
    def _check_mask(value: ArrayLike, rows: int) -> Mask:
        if is_masked(value):
            raise TypeError(f"mask must have no masked elements, not {value!r}")
        mask = np.asarray(value)
        numbers = mask.dtype.kind in "iuf" and bool(((mask == 0) | (mask == 1)).all())
        if not (mask.dtype == np.bool_ or numbers):
            raise TypeError(f"mask must be an array of bool, or of 0 and 1, not {value!r}")
        if mask.shape != (rows,):
            raise ValueError(f"mask must have the shape {(rows,)}, not {mask.shape!r}")
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
        new_x = self._first[0] if x is None else as_vector(x, "x", self._params.n)
        new_P = (
            self._first[1]
            if P is None
            else as_covariance(P, "P", self._params.n, definite=self._needs_definite)
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
        if self._problem.redraws and self._backend.undo_predict():
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
        if self._placed is not None and self._placed.f:
            inputs = self._placed.inputs_of_f(u, arguments)
            with self._certainty:
                backend = cast("CoreBackend", self._backend)
                self._transformed = None
                backend.predict_on_core(inputs)
                self._finish_predict(None)
                if not (self._problem.redraws or self._placed.h):
                    self._transformed = backend.propagated_points()
            return
        results = self._f(self._draw(), self._noise_points[0], (u,), arguments)
        with self._certainty:
            self._finish_predict(self._backend.predict(results))

    def _finish_predict(self, transformed: Array | None) -> None:
        """Draw new sigma points, if the problem wants that."""
        if self._problem.redraws:
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

    def update(
        self,
        z: ArrayLike | None,
        mask: ArrayLike | None = None,
        *,
        sensor: str | None = None,
        **arguments: Any,
    ) -> bool:
        """Correct the state with an observation.

        Parameters
        ----------
        z
            Observation, shape (m,) with the rows of the sensor. None, nothing sampled now, leaves
            everything as it is. Masked elements of a NumPy masked array were not sampled, whatever
            `mask` says.
        mask
            Which observations were sampled, an array of bool, shape (m,); z may be NaN in the
            others. None is :attr:`mask`. If it is all False, nothing was sampled.
        sensor
            Name of the sensor; None is the only one, or that nothing was sampled.
        arguments
            Keyword arguments of h.

        Returns
        -------
        bool
            Whether the estimate was corrected: False if nothing was sampled or the gate rejected z.

        Raises
        ------
        TypeError, ValueError
            If z, mask or sensor is wrong, or if h does what it must not; see
            :mod:`ukf_sw.models`.
        UkfError
            If a step fails.
        """
        if z is None and sensor is None:
            return False
        number = self._problem.number_of(sensor)
        given = self._given(z, mask, number)
        if given is None:
            return False
        observation, used = given
        if self._placed is not None and self._placed.h:
            variant, inputs = self._placed.inputs_of_h(
                self._problem.sensor_names[number], arguments
            )
            with self._certainty:
                backend = cast("CoreBackend", self._backend)
                nis, gated = backend.update_on_core(observation, used, number, variant, inputs)
                self._finish_update(nis, gated=gated)
            return not gated
        terms = self._problem.terms_of(number)
        points = self._transformed if self._transformed is not None else self._draw()
        noise, h = self._noise_points[1][terms.start : terms.stop], self._h[number]
        results = h(points, noise, keywords=arguments, used_rows=used)
        for row in h.angles:
            if used[row]:
                # Without W0 the centre may be far from the mean, and all weights are equal.
                expected = results[row, h.centre] if self._params.W0 else results[row].mean()
                observation[row] = wrap(observation[row], expected)
        with self._certainty:
            nis, gated = self._backend.update(results, observation, used, number)
            self._finish_update(nis, gated=gated)
        return not gated

    def _finish_update(self, nis: float, *, gated: bool) -> None:
        if not gated:
            self._transformed = self._last_x = self._last_P = None
        self._last_update = nis, gated

    def iterate(
        self,
        u: Any = None,
        z: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        *,
        sensor: str | None = None,
        **arguments: Any,
    ) -> bool:
        """Predict, then update: :meth:`predict` with u, and :meth:`update` with all else.

        With both models on the core, and without redrawing, it is one step of the core. If it
        raises, the prediction stands unless it was f that failed; :meth:`undo_predict` goes back.

        Parameters
        ----------
        u
            Input, third argument of f.
        z, mask, sensor, arguments
            As of :meth:`update`.

        Returns
        -------
        bool
            Whether the estimate was corrected.

        Raises
        ------
        TypeError, ValueError, UkfError
            As of both.
        """
        number = None if z is None else self._problem.number_of(sensor)
        given = None if number is None else self._given(z, mask, number)
        placed = self._placed
        if (
            number is None
            or given is None
            or placed is None
            or self._problem.redraws
            or not (placed.f and placed.h)
        ):
            self.predict(u)
            return self.update(z, mask, sensor=sensor, **arguments)
        observation, used = given
        name = self._problem.sensor_names[number]
        variant, inputs = placed.inputs_of_h(name, arguments)
        inputs = placed.inputs_of_f(u, {}) | inputs
        with self._certainty:
            self._last_x = self._last_P = self._transformed = None
            nis, gated = cast("CoreBackend", self._backend).iterate(
                observation, used, number, variant, inputs
            )
            self._last_update = nis, gated
        return not gated

    def iterate_ahead(
        self,
        inputs: Sequence[Any],
        observations: Sequence[Observations],
        arguments: Sequence[Mapping[str, Any]],
    ) -> tuple[Array, Array]:
        """Do many samples at once, as far as the backend can: the golden model, of its models.

        All is as if each had been done by :meth:`iterate`, and :meth:`update` for further sensors.
        It ends before a sample in which something would raise or exceed the gate. With another
        backend, or a model in software, that is the first one.

        Parameters
        ----------
        inputs
            Third argument of f, K of them.
        observations
            Of each sensor in their order, z and what of it was sampled, both of shape (K, rows).
        arguments
            Keyword arguments of h, K of them.

        Returns
        -------
        x : array of shape (D, n)
            The estimate after each sample that has been done.
        nis : array of shape (D, sensors)
            The NIS of each update; NaN of a sensor of which nothing was sampled.
        """
        placed = self._placed
        none = np.empty((0, self._params.n)), np.empty((0, len(self._h)))
        if placed is None or not (placed.f and placed.h):
            return none
        self._certainty.check()
        names = self._problem.sensor_names
        samples = samples_for_core(placed, names, inputs, observations, arguments)
        with self._certainty:
            backend = cast("CoreBackend", self._backend)
            x, found = backend.iterate_ahead(samples, redraws=self._problem.redraws)
            if not len(x):
                return none
            self._last_x, self._last_P, self._transformed = x[-1].copy(), None, None
            nis = np.full((len(x), len(names)), np.nan)
            for k, (sample, values) in enumerate(zip(samples, found, strict=False)):
                nis[k, [update.sensor for update in sample.updates]] = values
                if sample.updates:
                    self._last_update = float(values[-1]), False
        return x, nis

    def _given(
        self, z: ArrayLike | None, mask: ArrayLike | None, number: int
    ) -> tuple[Array, Mask] | None:
        """Check an observation; gives it and what of it was sampled, None if nothing was."""
        rows = self._params.rows_of(number)
        used = self._mask[rows.start : rows.stop]
        if mask is not None:
            used = self._check_mask(mask, len(rows))
        if z is not None and is_masked(z):
            masked = cast("Any", np.ma.array(cast("Any", z)))
            z = masked.filled(0)
            used = used & ~np.ma.getmaskarray(masked) if masked.shape == used.shape else used
        if z is None or not used.any():
            return None
        observation = as_numbers(z, "z", (len(rows),))
        observation[~used] = 0.0
        if not np.isfinite(observation).all():
            raise ValueError(f"z must be finite where sampled, not {np.asarray(z).tolist()!r}")
        return observation, used


def _placed(
    problem: Problem, backend: Backend | str, models: str | Mapping[str, str] | None
) -> "PlacedModels | None":
    """Make the programs of the models that a core is to evaluate; None if there are none."""
    own = NO_MODELS
    if isinstance(backend, str):
        # Only a core can evaluate those that the problem has programs of.
        own = NO_MODELS if backend == "reference" else problem.models
    elif isinstance(backend, CoreBackend):
        own = backend.params.models
    wanted = models is not None
    if models is None:
        models = {"f": "core"} if own.f is not None else {}
        models |= {"h": "core"} if own.h else {}
    if not own and not choose_models(models):
        return None
    # What traces models is imported by those who need it.
    with importing("golden"):
        from ukf_sw.lowering.placement import find_models, place_models

    if wanted and isinstance(backend, str):
        return place_models(problem, models)
    there: list[str] = [kind for kind, programs in (("f", own.f), ("h", own.h)) if programs]
    if frozenset(there) != choose_models(models):
        raise ValueError(f"models must be those that the core has, {there!r}, not {models!r}")
    return find_models(problem, own, problem.format)
