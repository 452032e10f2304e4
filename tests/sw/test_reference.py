import copy
from functools import partial
from itertools import cycle

import numpy as np
import pytest
from filterpy.kalman import SimplexSigmaPoints, UnscentedKalmanFilter, unscented_transform

from support.covariances import random_covariances
from ukf_sw.errors import NotFiniteError, NotPositiveDefiniteError, SingularObservationError
from ukf_sw.factors import IndefiniteError, lower_factor
from ukf_sw.filter import UnscentedKalmanFilter as Filter
from ukf_sw.problem import Problem, Sensor
from ukf_sw.reference import ReferenceUkf, sigma_coefficients, weights
from ukf_sw.spec.parameters import Form, Noise, UkfParams

EVERY_W0 = [0.0, 0.3, 0.9]


def covariance(rng, size, rank=None):
    root = rng.standard_normal((size, rank or 2 * size))
    return root @ root.T / size


def f(x, w):
    return np.array([x[0] + 0.1 * x[1] + w[0], x[1] - 0.1 * np.sin(x[0]) * (1 + w[1]), 0.9 * x[2]])


def h(x, v):
    return np.array([np.hypot(x[0], 1 + x[2]) * (1 + v[0]), x[1] * x[0] + v[1]])


def columns(function, points, noise):
    return np.column_stack([function(x, w) for x, w in zip(points.T, noise.T, strict=True)])


def reference(params, rng, *, P=None, Q=None, R=None):
    ukf = ReferenceUkf(params)
    ukf.initialise(
        rng.standard_normal(params.n),
        covariance(rng, params.n) if P is None else P,
        covariance(rng, params.q) * 0.1 if Q is None else Q,
        covariance(rng, params.r) * 0.1 if R is None else R,
    )
    return ukf


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("M", [1, 2, 3, 20])
def test_sigma_points_have_mean_zero_and_covariance_one(M, W0):
    sigma, W = sigma_coefficients(M, W0), weights(M, W0)
    assert sigma.shape == (M, M + 2)
    assert W.sum() == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(sigma @ W, 0.0, atol=1e-14)
    np.testing.assert_allclose((sigma * W) @ sigma.T, np.eye(M), atol=1e-14)
    radius = np.sqrt(M / (1.0 - W0))
    np.testing.assert_allclose(np.linalg.norm(sigma[:, 1:], axis=0), radius, rtol=1e-13)
    assert not np.tril(sigma[:, 2:].T, -1).any()  # row j is zero beyond column j + 1


@pytest.mark.parametrize("M", [1, 2, 7])
def test_sigma_points_are_those_of_filterpy_with_signs_turned(M):
    theirs = SimplexSigmaPoints(n=M).sigma_points(np.zeros(M), np.eye(M)).T
    signs = np.array([1.0] + [-1.0] * (M - 1))[:, None]
    np.testing.assert_allclose(sigma_coefficients(M, 0.0)[:, 1:], signs * theirs, atol=1e-14)


class Points:
    """Our sigma points, for filterpy."""

    def __init__(self, n, M, W0):
        self._sigma = sigma_coefficients(M, W0)[:n]
        self.Wm = self.Wc = weights(M, W0)

    def num_sigmas(self):
        return len(self.Wm)

    def sigma_points(self, x, P):
        return (x[:, None] + np.linalg.cholesky(P) @ self._sigma).T


class WithoutRedraw(UnscentedKalmanFilter):
    """filterpy's filter, but an update sees the points that went through fx."""

    def predict(self):
        self.compute_process_sigmas(self._dt)
        self.x, self.P = unscented_transform(self.sigmas_f, self.Wm, self.Wc, self.Q)


@pytest.mark.parametrize("redraw", [False, True])
@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("kind", Noise)
def test_agrees_with_filterpy(kind, W0, redraw):
    params = UkfParams(n=3, m=2, q=3, r=2, W0=W0, process_noise=kind, observation_noise=kind)
    rng = np.random.default_rng(1)
    ours = reference(params, rng)
    W, V = ours.noise_points()
    # Theirs has a point 0, whatever its weight: there the noise is zero.
    w, v = (cycle(np.pad(noise, ((0, 0), (params.points.start, 0))).T) for noise in (W, V))
    theirs = (UnscentedKalmanFilter if redraw else WithoutRedraw)(
        params.n, params.m, 1.0,
        lambda x: h(x, next(v)), lambda x, dt: f(x, next(w)), Points(params.n, params.M, W0),
    )  # fmt: skip
    theirs.x, theirs.P = ours.state(), ours.covariance()
    additive = kind is Noise.ADDITIVE
    theirs.Q = ours._noise[0] if additive else np.zeros((3, 3))
    theirs.R = ours._noise[1] if additive else np.zeros((2, 2))
    for _ in range(20):
        points = ours.predict(columns(f, ours.sigma_points(), W))
        theirs.predict()
        np.testing.assert_allclose(ours.state(), theirs.x, atol=1e-11)
        np.testing.assert_allclose(ours.covariance(), theirs.P, atol=1e-11)
        if redraw:
            points = ours.sigma_points()
        z = rng.standard_normal(2)
        ours.update(columns(h, points, V), z, np.ones(2, dtype=bool))
        theirs.update(z)
        np.testing.assert_allclose(ours.state(), theirs.x, atol=1e-11)
        np.testing.assert_allclose(ours.covariance(), theirs.P, atol=1e-11)


class Linear:
    """Textbook Kalman filter, and the same problem for ours."""

    def __init__(self, rng, n, m, kind, q=None):
        q = n if q is None else q
        self.A, self.C = rng.standard_normal((n, n)), rng.standard_normal((m, n))
        self.params = UkfParams(n=n, m=m, q=q, r=m, process_noise=kind, observation_noise=kind)
        self.Q, self.R = covariance(rng, q), covariance(rng, m)
        self.x, self.P = rng.standard_normal(n), covariance(rng, n)
        self.ukf = ReferenceUkf(self.params)
        self.ukf.initialise(self.x, self.P, self.Q, self.R)
        self.W, self.V = self.ukf.noise_points()

    def predict(self):
        self.x = self.A @ self.x
        self.P = self.A @ self.P @ self.A.T
        if self.params.q:
            self.P = self.P + self.Q
        self.points = self.A @ self.ukf.sigma_points()
        if self.params.q:
            self.points = self.points + self.W
        self.ukf.predict(self.points)
        if self.params.additive_q:  # the points lack the noise
            self.points = self.ukf.sigma_points()

    def update(self, z, mask):
        C, R = self.C[mask], self.R[np.ix_(mask, mask)]
        S = C @ self.P @ C.T + R
        K = self.P @ C.T @ np.linalg.inv(S)
        innovation = z[mask] - C @ self.x
        self.x, self.P = self.x + K @ innovation, self.P - K @ S @ K.T
        nis, gated = self.ukf.update(self.C @ self.points + self.V, z, mask)
        assert not gated
        assert nis == pytest.approx(innovation @ np.linalg.inv(S) @ innovation, rel=1e-9)

    def check(self):
        np.testing.assert_allclose(self.ukf.state(), self.x, atol=1e-9, rtol=1e-9)
        np.testing.assert_allclose(self.ukf.covariance(), self.P, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("kind", Noise)
@pytest.mark.parametrize(("n", "m"), [(1, 1), (4, 2), (2, 5)])
def test_equals_the_kalman_filter_where_it_is_optimal(n, m, kind):
    rng = np.random.default_rng(n)
    linear = Linear(rng, n, m, kind)
    for k in range(12):
        linear.predict()
        linear.check()
        mask = np.ones(m, dtype=bool) if k % 2 else rng.random(m) < 0.5
        linear.update(rng.standard_normal(m), mask)
        linear.check()


def test_without_redraw_an_update_does_not_see_additive_process_noise():
    """The points of an update are those that went through f, and P gets Q beside them."""
    rng = np.random.default_rng(9)
    linear = Linear(rng, 2, 1, Noise.ADDITIVE)
    x, P = linear.A @ linear.x, linear.A @ linear.P @ linear.A.T
    points = linear.A @ linear.ukf.sigma_points()
    linear.ukf.predict(points)
    np.testing.assert_allclose(linear.ukf.covariance(), P + linear.Q, atol=1e-12)
    z = rng.standard_normal(1)
    nis, _ = linear.ukf.update(linear.C @ points, z, np.ones(1, dtype=bool))
    S = linear.C @ P @ linear.C.T + linear.R
    K = P @ linear.C.T / S
    assert nis == pytest.approx(((z - linear.C @ x) ** 2 / S).item())
    np.testing.assert_allclose(linear.ukf.state(), x + K @ (z - linear.C @ x), atol=1e-12)
    np.testing.assert_allclose(linear.ukf.covariance(), P + linear.Q - K @ S @ K.T, atol=1e-12)


def test_zero_process_noise():
    rng = np.random.default_rng(5)
    linear = Linear(rng, 3, 2, Noise.AUGMENTED, q=0)
    for _ in range(3):
        linear.predict()
        linear.update(rng.standard_normal(2), np.ones(2, dtype=bool))
        linear.check()


def test_sequential_updates_equal_a_joint_one_in_a_linear_problem():
    rng = np.random.default_rng(6)
    linear = Linear(rng, 3, 2, Noise.ADDITIVE)
    linear.R = np.diag([0.5, 2.0])  # independent, so that the order cannot matter
    linear.ukf.set_noise(linear.Q, linear.R)
    linear.predict()
    z = rng.standard_normal(2)
    linear.update(z, np.array([True, False]))
    linear.points = linear.ukf.sigma_points()
    linear.update(z, np.array([False, True]))
    linear.check()

    joint = ReferenceUkf(linear.params)
    rng = np.random.default_rng(6)
    start = Linear(rng, 3, 2, Noise.ADDITIVE)
    joint.initialise(start.x, start.P, start.Q, linear.R)
    points = start.A @ joint.sigma_points()
    joint.predict(points)
    joint.update(start.C @ joint.sigma_points(), z, np.ones(2, dtype=bool))
    np.testing.assert_allclose(joint.state(), linear.x, atol=1e-9)
    np.testing.assert_allclose(joint.covariance(), linear.P, atol=1e-9)


@pytest.mark.parametrize("kind", Noise)
def test_masked_rows_are_as_if_absent(kind):
    full = UkfParams(n=3, m=2, q=3, r=2, process_noise=kind, observation_noise=kind)
    less = UkfParams(n=3, m=1, q=3, r=2 if kind is Noise.AUGMENTED else 1,
                     process_noise=kind, observation_noise=kind)  # fmt: skip
    rng = np.random.default_rng(3)
    a = reference(full, rng, R=np.diag([0.2, 0.3]))
    b = ReferenceUkf(less)
    R = a._noise[1] if kind is Noise.AUGMENTED else a._noise[1][:1, :1]
    b.initialise(a.state(), a.covariance(), a._noise[0], R)
    W, V = a.noise_points()
    points = a.predict(columns(f, a.sigma_points(), W))
    b.predict(columns(f, b.sigma_points(), b.noise_points()[0]))
    observed = columns(h, points, V)
    mask = np.array([True, False])
    nis, _ = a.update(np.where(mask[:, None], observed, np.nan), np.array([1.0, np.nan]), mask)
    assert nis == b.update(observed[:1], np.array([1.0]), np.array([True]))[0]
    np.testing.assert_array_equal(a.state(), b.state())
    np.testing.assert_array_equal(a.covariance(), b.covariance())


def test_a_state_without_uncertainty_stays():
    rng = np.random.default_rng(4)
    P = covariance(rng, 3)
    P[1] = P[:, 1] = 0.0
    params = UkfParams(n=3, m=2, q=0, r=2, observation_noise=Noise.ADDITIVE)
    ukf = reference(params, rng, P=P)
    before = ukf.state()[1]
    points = ukf.predict(ukf.sigma_points())
    ukf.update(points[:2], rng.standard_normal(2), np.ones(2, dtype=bool))
    assert ukf.state()[1] == pytest.approx(before, abs=1e-14)
    np.testing.assert_allclose(ukf.covariance()[1], 0.0, atol=1e-14)
    assert np.isfinite(ukf.sigma_points()).all()


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_square_root_of_a_semidefinite_matrix(rank):
    A = covariance(np.random.default_rng(rank), 5, rank)
    B = lower_factor(A)
    assert not np.triu(B, 1).any()
    np.testing.assert_allclose(B @ B.T, A, atol=1e-12)


def test_square_root_of_nothing():
    assert lower_factor(np.zeros((0, 0))).shape == (0, 0)
    assert not lower_factor(np.zeros((2, 2))).any()


@pytest.mark.parametrize(
    ("A", "row"),
    [([[1.0, 2.0], [2.0, 1.0]], 1), ([[0.0, 1.0], [1.0, 1.0]], 0), ([[-1.0]], 0)],
)
def test_square_root_of_an_indefinite_matrix_is_refused(A, row):
    with pytest.raises(IndefiniteError, match=r"^must be positive semidef") as error:
        lower_factor(np.array(A))
    assert error.value.row == row


def test_singular_innovation_covariance_names_the_row():
    params = UkfParams(n=2, m=3)
    ukf = ReferenceUkf(params)
    ukf.initialise(np.zeros(2), np.eye(2), np.zeros((0, 0)), np.zeros((0, 0)))
    points = ukf.predict(ukf.sigma_points())
    observed = points[[0, 1, 0]]
    with pytest.raises(SingularObservationError, match=r"singular at row 2$") as error:
        ukf.update(observed, np.zeros(3), np.ones(3, dtype=bool))
    assert error.value.index == 2
    np.testing.assert_allclose(ukf.covariance(), np.eye(2), atol=1e-15)
    ukf.update(observed, np.zeros(3), np.array([False, True, True]))


def test_indefinite_covariance_is_an_error():
    ukf = ReferenceUkf(UkfParams(n=2, m=1))
    ukf.initialise(np.zeros(2), np.diag([1.0, -1.0]), np.zeros((0, 0)), np.zeros((0, 0)))
    with pytest.raises(NotPositiveDefiniteError, match=r"^SIG_GEN.* at row 1$"):
        ukf.sigma_points()


def test_overflow_is_an_error_and_keeps_the_estimate():
    ukf = ReferenceUkf(UkfParams(n=1, m=1))
    ukf.initialise(np.array([2.0]), np.eye(1), np.zeros((0, 0)), np.zeros((0, 0)))
    points = ukf.sigma_points()
    with pytest.raises(NotFiniteError, match=r"^PREDICT met NaN or infinity$"):
        ukf.predict(points * 1e300)
    assert ukf.state() == [2.0]
    with pytest.raises(NotFiniteError, match=r"^UPDATE met NaN or infinity$"):
        ukf.update(points * 1e300, np.zeros(1), np.ones(1, dtype=bool))
    assert ukf.state() == [2.0]


def test_gate_rejects_and_keeps_the_prediction():
    rng = np.random.default_rng(8)
    linear = Linear(rng, 2, 1, Noise.ADDITIVE)
    linear.ukf.set_gate(9.0)
    linear.predict()
    nis, gated = linear.ukf.update(linear.C @ linear.points, np.array([1e3]), np.array([True]))
    assert gated
    assert nis > 9.0
    linear.check()
    linear.update(linear.C @ linear.x, np.array([True]))
    linear.check()


# Covariances.


def filter_of(backend, **problem):
    """A filter of a state that stays, unless told otherwise, of which the first row is seen."""
    given = {"f": lambda x, w, u: x, "sensors": Sensor(lambda x, v: x[:1])} | problem
    return Filter(Problem(name="covariances", **given), backend)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("backend", ["reference", "golden"])
def test_every_covariance_is_accepted_and_kept(dtype, backend):
    """Within its rounding errors, each element beside the deviations of its row and column."""
    epsilon = np.finfo(dtype).eps
    count = 0
    for A in random_covariances(dtype):
        B = lower_factor(np.asarray(A, np.float64), float(epsilon))
        assert not np.triu(B, 1).any()
        deviations = np.sqrt(np.diag(np.asarray(A, np.float64)))
        limit = 32 * len(A) * epsilon * np.outer(deviations, deviations)
        assert (np.abs(B @ B.T - A) <= limit).all()
        if len(A) == 3 or (backend == "reference" and len(A) < 8):
            count += 1
            ukf = filter_of(backend, x0=np.zeros(len(A)), P0=A, Q=A, process_noise=Noise.ADDITIVE)
            assert (np.abs(ukf.Q - A) <= limit).all()
            ukf.P = ukf.Q = A
            ukf.predict()
            # Elements that are small beside the deviations are known to the format only.
            coarse = limit + 1e-5 * np.outer(deviations, deviations)
            assert (np.abs(ukf.P - 2.0 * np.asarray(A, np.float64)) <= 4.0 * coarse).all()
    assert count > 10


@pytest.mark.parametrize("dt", [0.01, 1e-4])
@pytest.mark.parametrize("backend", ["reference", "golden"])
@pytest.mark.parametrize("kind", Noise)
def test_an_outer_product_in_single_precision_is_a_covariance(backend, dt, kind):
    g = np.array([dt * dt / 2.0, dt], np.float32)
    ukf = filter_of(
        backend, f=lambda x, w, u: x + w, x0=[0.0, 0.0], P0=np.outer(g, g), Q=np.outer(g, g),
        process_noise=kind,
    )  # fmt: skip
    ukf.predict()
    np.testing.assert_allclose(ukf.P, 2.0 * np.outer(g, g), rtol=1e-5)


@pytest.mark.parametrize("backend", ["reference", "golden"])
def test_the_covariance_form_takes_variances_of_any_sizes(backend):
    P = np.diag([1e6, 1e-8])
    ukf = filter_of(backend, x0=[0.0, 0.0], P0=P, form=Form.COVARIANCE)
    ukf.predict()
    np.testing.assert_allclose(ukf.P, P, rtol=1e-6, atol=1e-9)
    dependent = np.array([[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(ValueError, match=r"^P must be positive definite, and is not in row 1: "):
        ukf.P = dependent
    with pytest.raises(ValueError, match=r"^P must be positive definite, and is not in row 1: "):
        ukf.P = (dependent + np.diag([0.0, 1e-7])).astype(np.float32)


def test_asymmetry_is_judged_beside_its_row():
    rng = np.random.default_rng(3)
    g = (rng.standard_normal((3, 3)) * [[1e4], [1.0], [1e-4]]).astype(np.float32)
    A = np.asarray(g @ g.T)
    A[1, 2] *= np.float32(1.0 + 2e-7)
    make = partial(filter_of, "reference", x0=[0] * 3)
    make(P0=A)
    with pytest.raises(ValueError, match=r"^P0 must be symmetric, not .* at \([12], [12]\)"):
        make(P0=A + 1e-6 * np.eye(3)[1][:, None] * np.eye(3)[2])


def test_shallow_copies_go_their_own_ways():
    ukf = ReferenceUkf(UkfParams(n=1, m=1, q=1, r=1))
    ukf.initialise(np.ones(1), np.eye(1), np.eye(1), np.eye(1))
    twin = copy.copy(ukf)
    twin.predict(twin.sigma_points() * 2.0)
    twin.set_noise(np.eye(1) * 4.0, np.eye(1))
    assert (ukf.state()[0], twin.state()[0]) == (1.0, 2.0)
    assert ukf.noise_points()[0].max() < twin.noise_points()[0].max()
    assert not ukf.undo_predict()
