"""Reference filter: the papers' equations in float64, step by step, as written.

Equation numbers are those of Soh and Wu 2018. Nothing here is shared with the golden model or the
engine, so agreement between them means something. It keeps covariances, where the core keeps
factors, and it has the core's steps: sigma points, predict, update.
"""

import numpy as np
from numpy.typing import NDArray

from ukf_sw.errors import NotFiniteError, NotPositiveDefiniteError, SingularObservationError
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.sequence import Step

__all__ = ["ReferenceUkf", "lower_factor", "sigma_coefficients", "weights"]

Array = NDArray[np.float64]

#: Pivots below this part of the diagonal are rounding errors of zero.
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


def lower_factor(A: Array) -> Array:
    """Lower triangular B with A = B B^T, for positive *semi*definite A.

    The square root of equation 8. A pivot that is zero, but for rounding, gives a zero column; for
    positive definite A this is the Cholesky factor.

    Parameters
    ----------
    A
        Symmetric matrix, shape (k, k).

    Returns
    -------
    array of shape (k, k)

    Raises
    ------
    numpy.linalg.LinAlgError
        If A is not positive semidefinite; its argument is the row of the bad pivot.
    """
    try:
        return np.asarray(np.linalg.cholesky(A), dtype=np.float64)
    except np.linalg.LinAlgError:
        pass
    size = len(A)
    B = np.zeros_like(A)
    remainder = A.copy()
    for j in range(size):
        column = remainder[j:, j]
        tolerance = ZERO_PIVOT * size * A[j, j]
        if column[0] > tolerance:
            B[j:, j] = column / np.sqrt(column[0])
            remainder[j:, j:] -= np.outer(B[j:, j], B[j:, j])
            continue
        # |a_ij| <= sqrt(a_ii a_jj): beside a zero pivot the column must be zero as well.
        limit = np.sqrt(ZERO_PIVOT * size * np.abs(A[j, j] * np.diag(A)[j:]))
        if column[0] < -tolerance or (np.abs(column) > np.maximum(limit, tolerance)).any():
            raise np.linalg.LinAlgError(j)
    return B


class ReferenceUkf:
    """Unscented Kalman filter of equations 4 to 19, with the steps of the core.

    Serves :class:`ukf_sw.filter.UnscentedKalmanFilter` as a backend.

    Parameters
    ----------
    params
        Sizes, kinds of noise and W0; form, format and pes are ignored.
    """

    def __init__(self, params: UkfParams) -> None:
        self._params = params
        self._weights = weights(params.M, params.W0)
        self._sigma = sigma_coefficients(params.M, params.W0)
        self._gate = np.inf
        self._estimate_x: Array = np.zeros(params.n)
        self._estimate_P: Array = np.zeros((params.n, params.n))
        self._noise_Q: Array = np.zeros((params.q, params.q))
        self._noise_R: Array = np.zeros((params.r, params.r))
        self._points: Array | None = None
        self._residuals: Array | None = None

    @property
    def params(self) -> UkfParams:
        """Parameters given to the constructor."""
        return self._params

    def initialise(self, x: Array, P: Array, Q: Array, R: Array) -> None:
        """Start from an estimate (equation 4): x (n,), P (n, n), Q (q, q), R (r, r)."""
        self._estimate_x, self._estimate_P = x.copy(), P.copy()
        self._noise_Q, self._noise_R = Q.copy(), R.copy()
        self._points = self._residuals = None

    def set_state(self, x: Array) -> None:
        """Replace x, shape (n,); P stays."""
        self._estimate_x = x.copy()
        self._points = self._residuals = None

    def set_covariance(self, P: Array) -> None:
        """Replace P, shape (n, n); x stays."""
        self._estimate_P = P.copy()
        self._points = self._residuals = None

    def set_noise(self, Q: Array, R: Array) -> None:
        """Replace Q (q, q) and R (r, r); the estimate stays."""
        self._noise_Q, self._noise_R = Q.copy(), R.copy()
        self._points = self._residuals = None

    def set_gate(self, gate: float) -> None:
        """Reject updates with a NIS above the gate; infinity is off."""
        self._gate = gate

    def noise_points(self) -> tuple[Array, Array]:
        """Sigma points of w (q, N) and of v (r, N) (equation 8); zeros for additive noise."""
        p = self._params
        rows: list[Array] = []
        first = p.n
        for A, terms in ((self._noise_Q, p.augmented_q), (self._noise_R, p.augmented_r)):
            if terms:
                rows.append(lower_factor(A) @ self._sigma[first : first + terms])
            else:
                rows.append(np.zeros((len(A), p.N)))
            first += terms
        return rows[0], rows[1]

    def sigma_points(self) -> Array:
        """Sigma points of the state, shape (n, N) (equation 8).

        Raises
        ------
        NotPositiveDefiniteError
            If P has become indefinite.
        """
        self.redraw()
        assert self._points is not None
        return self._points.copy()

    def redraw(self) -> None:
        """Draw sigma points if the estimate has changed; raises as :meth:`sigma_points`."""
        if self._points is None:
            try:
                factor = lower_factor(self._estimate_P)
            except np.linalg.LinAlgError as error:
                raise NotPositiveDefiniteError(Step.SIG_GEN, int(error.args[0])) from error
            self._points = self._estimate_x[:, None] + factor @ self._sigma[: self._params.n]
            self._residuals = None

    def predict(self, points: Array) -> Array:
        """Predict from transformed sigma points, shape (n, N) (equations 10 and 11).

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
        self._estimate_x, self._estimate_P, self._residuals, self._points = x, P, residuals, None
        return points

    def update(self, points: Array, z: Array, mask: NDArray[np.bool_]) -> tuple[float, bool]:
        """Update from the observations of the sigma points (equations 13 to 18).

        Directly after a predict the residuals of that predict are used; otherwise those of the
        sigma points of the estimate.

        Parameters
        ----------
        points
            Observations of the sigma points, shape (m, N).
        z
            Observation, shape (m,).
        mask
            Which rows were sampled, shape (m,); the others are left out.

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
        residuals = self._residuals
        if residuals is None:
            residuals = self.sigma_points() - self._estimate_x[:, None]
        points, innovation = points[mask], z[mask]
        with np.errstate(over="ignore", invalid="ignore"):
            z_mean = points @ self._weights
            innovation = innovation - z_mean
            observed = points - z_mean[:, None]
            S = (observed * self._weights) @ observed.T + self._additive_R()[np.ix_(mask, mask)]
            Pxz = (residuals * self._weights) @ observed.T
        if not (np.isfinite(S).all() and np.isfinite(Pxz).all() and np.isfinite(innovation).all()):
            raise NotFiniteError(Step.UPDATE)
        self._check_regular(S, mask)
        solved = np.linalg.solve(S, np.column_stack((Pxz.T, innovation)))
        K = solved[:, :-1].T
        with np.errstate(over="ignore", invalid="ignore"):
            nis = float(innovation @ solved[:, -1])
        if not np.isfinite(nis):  # it is too large for a float64, and so above every gate
            nis = np.inf
            if self._gate == np.inf:
                raise NotFiniteError(Step.UPDATE)
        if nis > self._gate:
            if self._residuals is None:
                self._points = None
            return nis, True
        P = self._estimate_P - K @ S @ K.T
        self._estimate_x = self._estimate_x + K @ innovation
        self._estimate_P = (P + P.T) / 2.0
        self._points = self._residuals = None
        return nis, False

    def _additive_Q(self) -> Array:
        """Process noise to add to P, shape (n, n); zero for augmented noise."""
        p = self._params
        return self._noise_Q if p.additive_q else np.zeros((p.n, p.n))

    def _additive_R(self) -> Array:
        """Observation noise to add to S, shape (m, m); zero for augmented noise."""
        p = self._params
        return self._noise_R if p.additive_r else np.zeros((p.m, p.m))

    def _check_regular(self, S: Array, mask: NDArray[np.bool_]) -> None:
        """Raise if S has a pivot that is not positive; name its row before masking."""
        try:
            pivots = np.diag(lower_factor(S)) ** 2
        except np.linalg.LinAlgError as error:
            pivots = np.ones(len(S))
            pivots[error.args[0]] = 0.0
        for row, pivot, size in zip(np.flatnonzero(mask), pivots, np.diag(S), strict=True):
            if not pivot > ZERO_PIVOT * len(S) * size:
                raise SingularObservationError(Step.UPDATE, int(row))

    def state(self) -> Array:
        """Estimate x, shape (n,)."""
        return self._estimate_x.copy()

    def covariance(self) -> Array:
        """Covariance P of the estimate, shape (n, n)."""
        return self._estimate_P.copy()
