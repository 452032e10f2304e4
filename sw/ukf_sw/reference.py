"""Reference filter: the papers' equations in float64, step by step, as written.

Equation numbers are those of Soh and Wu 2018. Nothing here is shared with the golden model or the
engine, so agreement between them means something. It keeps covariances, where the core keeps
factors, and it has the core's steps: sigma points, predict, update.

Whatever interrupts a step, the estimate is that from before it or that from after it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ukf_sw.errors import NotFiniteError, NotPositiveDefiniteError, SingularObservationError
from ukf_sw.factors import IndefiniteError, lower_factor
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.sequence import Step

__all__ = ["ReferenceUkf", "sigma_coefficients", "weights"]

Array = NDArray[np.float64]

#: Pivots of S below this part of the diagonal are rounding errors of zero.
ZERO_PIVOT = 1e-14


def weights(M: int, W0: float) -> Array:
    """Weights of mean and covariance, shape (M + 2,) (equation 5)."""
    W = np.empty(M + 2)
    W[0] = W0
    W[1:] = (1.0 - W0) / (M + 1)
    return W


def sigma_coefficients(M: int, W0: float) -> Array:
    """Sigma coefficients of the spherical simplex, shape (M, M + 2) (equations 6 and 7).

    The expansion of equation 7 is carried out as printed: every j appends a row to the vectors
    0 to j and starts the vector j + 1.
    """
    W1 = (1.0 - W0) / (M + 1)
    vectors = [[0.0], [-1.0 / np.sqrt(2.0 * W1)], [1.0 / np.sqrt(2.0 * W1)]]
    for j in range(2, M + 1):
        a = 1.0 / np.sqrt(j * (j + 1) * W1)
        vectors = [
            [*vectors[0], 0.0],
            *([*vectors[i], -a] for i in range(1, j + 1)),
            [*([0.0] * (j - 1)), j * a],
        ]
    return np.array(vectors).T


class _Estimate(NamedTuple):
    """All that a step changes, so that it is replaced at once."""

    x: Array
    P: Array
    points: Array | None = None  #: Sigma points of x and P.
    predicted: Array | None = None  #: What a prediction was made from, if an update may use it.
    residuals: Array | None = None  #: The same without its mean.
    before: tuple[Array, Array] | None = None  #: x and P from before a prediction.


class ReferenceUkf:
    """Unscented Kalman filter of equations 4 to 19, with the steps of the core.

    Serves :class:`ukf_sw.filter.UnscentedKalmanFilter` as a backend. Copies, shallow ones as well,
    go their own ways. Sigma points are those that have a weight, K in all: without W0 there is no
    point 0.

    Parameters
    ----------
    params
        Sizes, kinds of noise and W0; form, format and pes are ignored.
    """

    def __init__(self, params: UkfParams) -> None:
        self._params = params
        W = weights(params.M, params.W0)
        self._weights = W[W > 0.0]
        self._sigma = sigma_coefficients(params.M, params.W0)[:, W > 0.0]
        self._gate = np.inf
        self._noise: tuple[Array, Array] = (
            np.zeros((params.q, params.q)),
            np.zeros((params.r, params.r)),
        )
        self._estimate = _Estimate(np.zeros(params.n), np.zeros((params.n, params.n)))

    @property
    def params(self) -> UkfParams:
        """Parameters given to the constructor."""
        return self._params

    def initialise(self, x: Array, P: Array, Q: Array, R: Array) -> None:
        """Start from an estimate (equation 4): x (n,), P (n, n), Q (q, q), R (r, r)."""
        self._noise = Q.copy(), R.copy()
        self._estimate = _Estimate(x.copy(), P.copy())

    def set_state(self, x: Array) -> None:
        """Replace x, shape (n,); P stays."""
        self._estimate = _Estimate(x.copy(), self._estimate.P, before=self._estimate.before)

    def set_covariance(self, P: Array) -> None:
        """Replace P, shape (n, n); x stays."""
        self._estimate = _Estimate(self._estimate.x, P.copy())

    def set_noise(self, Q: Array, R: Array) -> None:
        """Replace Q (q, q) and R (r, r); the estimate stays, and sigma points are drawn anew.

        Raises
        ------
        NotPositiveDefiniteError
            If P has become indefinite; then Q and R stay as well.
        """
        self.redraw()
        self._noise = Q.copy(), R.copy()

    def set_gate(self, gate: float) -> None:
        """Reject updates with a NIS above the gate; infinity is off."""
        self._gate = gate

    def recover(self) -> Array | None:
        """Find out after an interrupt what an update may use.

        Returns
        -------
        array or None
            The points of the last predict, shape (n, K), if an update may still use them.
        """
        return self._estimate.predicted

    def undo_predict(self) -> bool:
        """Go back to before the last predict, if nothing has changed the covariance since.

        Returns
        -------
        bool
            Whether there was such a predict.
        """
        before = self._estimate.before
        if before is not None:
            self._estimate = _Estimate(*before)
        return before is not None

    def noise_points(self) -> tuple[Array, Array]:
        """Sigma points of w (q, K) and of v (r, K) (equation 8); zeros for additive noise."""
        p = self._params
        rows: list[Array] = []
        first = p.n
        for A, terms in zip(self._noise, (p.augmented_q, p.augmented_r), strict=True):
            if terms:
                rows.append(lower_factor(A) @ self._sigma[first : first + terms])
            else:
                rows.append(np.zeros((len(A), len(self._weights))))
            first += terms
        return rows[0], rows[1]

    def sigma_points(self) -> Array:
        """Sigma points of the state, shape (n, K) (equation 8).

        Raises
        ------
        NotPositiveDefiniteError
            If P has become indefinite.
        """
        self.redraw()
        assert self._estimate.points is not None
        return self._estimate.points.copy()

    def redraw(self) -> None:
        """Draw sigma points if the estimate has changed; raises as :meth:`sigma_points`."""
        x, P, points, *_ = self._estimate
        if points is None:
            try:
                factor = lower_factor(P)
            except IndefiniteError as error:
                raise NotPositiveDefiniteError(Step.SIG_GEN, error.row) from error
            points = x[:, None] + factor @ self._sigma[: self._params.n]
            self._estimate = _Estimate(x, P, points)

    def predict(self, points: Array) -> Array:
        """Predict from transformed sigma points, shape (n, K) (equations 10 and 11).

        Returns
        -------
        array
            The points, as an update will see them.

        Raises
        ------
        NotFiniteError
            If mean or covariance overflow.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            x = points @ self._weights
            residuals = points - x[:, None]
            P = (residuals * self._weights) @ residuals.T + self._additive_Q()
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise NotFiniteError(Step.PREDICT)
        before = self._estimate
        self._estimate = _Estimate(x, P, None, points, residuals, (before.x, before.P))
        return points

    def update(
        self, points: Array, z: Array, mask: NDArray[np.bool_], sensor: int = 0
    ) -> tuple[float, bool]:
        """Update from the observations of the sigma points (equations 13 to 18).

        Directly after a predict the residuals of that predict are used; otherwise those of the
        sigma points of the estimate.

        Parameters
        ----------
        points
            What a sensor sees of the sigma points, shape (rows, K).
        z
            Its observation, shape (rows,).
        mask
            Which rows were sampled, shape (rows,); the others are left out.
        sensor
            Which sensor.

        Returns
        -------
        nis : float
            Normalised innovation squared.
        gated : bool
            Whether it exceeded the gate, so that the estimate stays.

        Raises
        ------
        SingularObservationError
            If S is singular.
        NotFiniteError
            If a result overflows.
        """
        residuals = self._estimate.residuals
        if residuals is None:
            residuals = self.sigma_points() - self._estimate.x[:, None]
        before = self._estimate
        points, innovation = points[mask], z[mask]
        with np.errstate(over="ignore", invalid="ignore"):
            z_mean = points @ self._weights
            innovation = innovation - z_mean
            observed = points - z_mean[:, None]
            R = self._additive_R(sensor)[np.ix_(mask, mask)]
            S = (observed * self._weights) @ observed.T + R
            Pxz = (residuals * self._weights) @ observed.T
        # The residuals of a row of equal numbers are the rounding error of their mean.
        equal = (points == points[:, :1]).all(axis=1) & (np.diag(R) == 0.0)
        S[equal], S[:, equal], Pxz[:, equal] = 0.0, 0.0, 0.0
        # An innovation may be infinite, since z and its mean are finite; so is the NIS then.
        if not (np.isfinite(S).all() and np.isfinite(Pxz).all()) or np.isnan(innovation).any():
            raise NotFiniteError(Step.UPDATE)
        self._check_regular(S, self._params.rows_of(sensor).start + np.flatnonzero(mask))
        solved = np.linalg.solve(S, np.column_stack((Pxz.T, innovation)))
        K = solved[:, :-1].T
        with np.errstate(over="ignore", invalid="ignore"):
            nis = float(innovation @ solved[:, -1])
        if not np.isfinite(nis):  # it is too large for a float64, and so above every gate
            nis = np.inf
            if self._gate == np.inf:
                raise NotFiniteError(Step.UPDATE)
        if nis > self._gate:
            return nis, True
        P = before.P - K @ S @ K.T
        self._estimate = _Estimate(before.x + K @ innovation, P / 2.0 + P.T / 2.0)
        return nis, False

    def _additive_Q(self) -> Array:
        """Process noise to add to P, shape (n, n); zero for augmented noise."""
        p = self._params
        return self._noise[0] if p.additive_q else np.zeros((p.n, p.n))

    def _additive_R(self, sensor: int) -> Array:
        """Noise of a sensor to add to S, shape (rows, rows); zero for augmented noise."""
        rows = self._params.rows_of(sensor)
        if not self._params.additive_r:
            return np.zeros((len(rows), len(rows)))
        return self._noise[1][rows.start : rows.stop, rows.start : rows.stop]

    def _check_regular(self, S: Array, numbers: NDArray[np.int_]) -> None:
        """Raise if S has a pivot that is not positive; with the number of its row."""
        limits = ZERO_PIVOT * len(S) * np.diag(S)
        try:
            pivots = np.diag(np.linalg.cholesky(S)) ** 2
            if (pivots > limits).all():
                return
            row = int((pivots > limits).argmin())
        except np.linalg.LinAlgError:
            row, remainder = 0, S.copy()
            while row < len(S) - 1 and remainder[row, row] > limits[row]:
                remainder -= np.outer(remainder[row], remainder[row]) / remainder[row, row]
                row += 1
        raise SingularObservationError(Step.UPDATE, int(numbers[row]))

    def state(self) -> Array:
        """Estimate x, shape (n,)."""
        return self._estimate.x.copy()

    def covariance(self) -> Array:
        """Covariance P of the estimate, shape (n, n)."""
        return self._estimate.P.copy()
