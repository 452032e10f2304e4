"""Every row of the table of docs/from-filterpy.md, with filterpy itself beside."""

import re
from dataclasses import replace

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import (
    JulierSigmaPoints,
    MerweScaledSigmaPoints,
    SimplexSigmaPoints,
    UnscentedKalmanFilter,
)

from ukf_docs import DOCS
from ukf_sw.filter import UnscentedKalmanFilter as Filter
from ukf_sw.models import wrap
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.problems.running import run
from ukf_sw.reference import sigma_coefficients, weights
from ukf_sw.spec.parameters import Noise

DT = 0.05
Q, R = np.diag([1e-3, 4e-3]), np.diag([0.01, 0.04])
X0, P0 = np.array([0.8, 0.1]), np.diag([0.2, 0.1])
N = len(X0)


def fx(x, dt, push=0.0):
    return np.array([x[0] + dt * x[1], x[1] - dt * np.sin(x[0]) + dt * push])


def hx(x, scale=1.0):
    return np.array([np.sin(x[0]) * scale, x[0] * x[1]])


class Points:
    """Our sigma points, for filterpy."""

    def __init__(self, n, W0=0.0):
        self._coefficients = sigma_coefficients(n, W0)
        self.Wm = self.Wc = weights(n, W0)

    def num_sigmas(self):
        return len(self.Wm)

    def sigma_points(self, x, P):
        return (np.reshape(x, (-1, 1)) + np.linalg.cholesky(P) @ self._coefficients).T


def their_filter(points=None, hx=hx, fx=fx, dim_z=2, **options):
    ukf = UnscentedKalmanFilter(N, dim_z, DT, hx, fx, points or Points(N), **options)
    ukf.x, ukf.P, ukf.Q, ukf.R = X0.copy(), P0.copy(), Q, R[:dim_z, :dim_z]
    return ukf


def our_problem(**changes):
    return replace(
        Problem(
            name="pendulum",
            f=lambda x, w, u, push=0.0: fx(x, u, push),
            Q=Q,
            process_noise=Noise.ADDITIVE,
            sensors=Sensor(lambda x, v, scale=1.0: hx(x, scale), R=R),
            observation_noise=Noise.ADDITIVE,
            x0=X0,
            P0=P0,
        ),
        **changes,
    )


def our_filter(**changes):
    return Filter(our_problem(**changes), "reference")


def assert_equal(theirs, ours, tolerance=1e-12):
    np.testing.assert_allclose(ours.x, theirs.x, atol=tolerance)
    np.testing.assert_allclose(ours.P, theirs.P, atol=tolerance)


def assert_differ(theirs, ours):
    assert np.abs(ours.x - theirs.x).max() > 1e-6


Z = np.array([[0.6, 0.1], [0.7, -0.1], [0.5, 0.2], [0.6, 0.3]])


def both(steps=0, **changes):
    """Both filters, after some steps."""
    theirs, ours = their_filter(), our_filter(**changes)
    for z in Z[:steps]:
        theirs.predict()
        theirs.update(z)
        ours.predict(DT)
        ours.update(z)
    return theirs, ours


def constructor():
    theirs = UnscentedKalmanFilter(N, 2, DT, hx, fx, Points(N))
    np.testing.assert_array_equal(theirs.x, np.zeros(N))
    for matrix in (theirs.P, theirs.Q, theirs.R):
        np.testing.assert_array_equal(matrix, np.eye(2))
    params = our_problem().params
    assert (params.n, params.m, params.q, params.r) == (2, 2, 2, 2)
    sensor = Sensor(lambda x, v: hx(x))
    for missing in ("x0", "P0"):
        given = {"name": "a", "f": fx, "sensors": sensor, "x0": X0, "P0": P0}
        del given[missing]
        with pytest.raises(TypeError, match=missing):
            Problem(**given)
    without = Problem(name="a", f=lambda x, w, u: x, sensors=sensor, x0=X0, P0=P0).params
    assert (without.q, without.r) == (0, 0)


def models():
    assert_equal(*both(4))
    given = Problem(name="a", f=lambda x, w, u: x, sensors=Sensor(lambda x, v: hx(x)), x0=X0, P0=P0)
    assert given.process_noise is given.observation_noise is Noise.AUGMENTED

    def changing(x, w, u):
        x[0] += 1.0
        return x

    with pytest.raises(ValueError, match="must not change its argument x"):
        our_filter(f=changing).predict(DT)


def merwe():
    points = MerweScaledSigmaPoints(N, 0.5, 2.0, 1.0)
    assert points.num_sigmas() == 2 * N + 1
    assert points.Wm[0] != points.Wc[0]
    assert our_problem().params.N == N + 2


def julier():
    for kappa in (0.0, 1.0, 4.0):
        points, ours = JulierSigmaPoints(N, kappa), Points(N, kappa / (N + kappa))
        assert points.num_sigmas() == 2 * N + 1
        assert points.Wm[0] == ours.Wm[0]
        radii = [
            np.linalg.norm(each.sigma_points(np.zeros(N), np.eye(N))[1:], axis=1)
            for each in (points, ours)
        ]
        np.testing.assert_allclose(radii[0], radii[1][0])
        np.testing.assert_allclose(radii[1], radii[1][0])


def simplex():
    points, ours = SimplexSigmaPoints(N), Points(N)
    assert points.num_sigmas() == N + 1
    theirs = points.sigma_points(np.zeros(N), np.eye(N))
    assert (np.linalg.norm(theirs, axis=1) > 1.0).all()  # none is the mean
    np.testing.assert_allclose(
        ours.sigma_points(np.zeros(N), np.eye(N)), np.vstack((np.zeros(N), theirs * [1.0, -1.0])),
        atol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(ours.Wm, [0.0, *points.Wm])


def predict_dt():
    theirs, ours = both()
    for dt in (0.02, 0.3):
        theirs.predict(dt=dt)
        ours.predict(dt)
    assert_equal(theirs, ours)
    theirs.predict()
    with pytest.raises(TypeError):  # f gets no u
        ours.predict()


def arguments():
    theirs, ours = both()
    theirs.predict(push=2.0)
    ours.predict(DT, push=2.0)
    assert_equal(theirs, ours)
    theirs.update(Z[0], scale=0.5)
    ours.update(Z[0], scale=0.5)
    assert_equal(theirs, ours)
    assert_differ(both(1)[0], ours)


def predict_fx():
    def other(x, dt):
        return x

    theirs = their_filter()
    theirs.predict(fx=other)
    ours = our_filter(f=lambda x, w, u, still=False: x.copy() if still else fx(x, u))
    with pytest.raises(TypeError):
        ours.predict(DT, fx=other)
    ours.predict(DT, still=True)
    assert_equal(theirs, ours)


def redraw():
    assert our_problem().redraws
    assert_equal(*both(4, redraw=True))
    assert_differ(*both(4, redraw=False))
    augmented = our_problem(process_noise=Noise.AUGMENTED)
    assert not augmented.redraws


def update_R():
    theirs, ours = both()
    for filters in range(2):
        theirs.predict()
        ours.predict(DT)
        if not filters:
            ours.set_R(2.0 * R)
            theirs.update(Z[0], R=2.0 * R)
        else:
            ours.set_R(R)  # it would stay
            theirs.update(Z[0])
        ours.update(Z[0])
        assert_equal(theirs, ours)
    np.testing.assert_array_equal(theirs.R, R)


def update_hx():
    theirs = their_filter()
    ours = our_filter(sensors={
        "gps": Sensor(lambda x, v: hx(x), R=R), "baro": Sensor(lambda x, v: x[:1], R=[[0.3]]),
    })  # fmt: skip
    for sensor, z, given in (
        ("gps", Z[0], {}), ("baro", [0.5], {"hx": lambda x: x[:1], "R": np.array([[0.3]])}),
    ):  # fmt: skip
        theirs.predict()
        theirs.update(z, **given)
        ours.predict(DT)
        ours.update(z, sensor=sensor)
        assert_equal(theirs, ours)


def update_none():
    theirs, ours = both(2)
    theirs.predict()
    ours.predict(DT)
    before = ours.x, ours.P
    theirs.update(None)
    assert not ours.update(None)
    np.testing.assert_array_equal(ours.x, before[0])
    np.testing.assert_array_equal(ours.P, before[1])
    assert_equal(theirs, ours)
    theirs.update(Z[0, :1], R=R[:1, :1], hx=lambda x: hx(x)[:1])
    ours.update([Z[0, 0], np.nan], mask=[True, False])
    assert_equal(theirs, ours)


def update_again():
    for drawn_again in (False, True):
        theirs, ours = both(1)
        theirs.predict()
        ours.predict(DT)
        for z in Z[:2]:
            if drawn_again:
                theirs.sigmas_f = theirs.points_fn.sigma_points(theirs.x, theirs.P)
            theirs.update(z)
            ours.update(z)
        (assert_equal if drawn_again else assert_differ)(theirs, ours)


def estimate():
    theirs, ours = both(1)
    theirs.x[0] = 1.0
    with pytest.raises(ValueError, match="must not be written"):
        ours.x[0] = 1.0
    with pytest.raises(ValueError, match="must not be written"):
        ours.P[0, 0] = 1.0
    ours.x = [1.0, ours.x[1]]
    theirs.P, ours.P = P0.copy(), P0
    assert_equal(theirs, ours)
    copy = ours.x
    ours.predict(DT)
    assert (copy != ours.x).any()


def noises():
    theirs, ours = both()
    theirs.Q, theirs.R = 3.0 * Q, 2.0 * R
    ours.Q, ours.R = 3.0 * Q, 2.0 * R
    theirs.predict()
    theirs.update(Z[0])
    ours.predict(DT)
    ours.update(Z[0])
    assert_equal(theirs, ours)
    with pytest.raises(ValueError, match="must not be written"):
        ours.Q[0, 0] = 1.0
    sensors = {name: Sensor(lambda x, v: x[:1], R=[[1.0]]) for name in ("a", "b")}
    several = our_filter(sensors=sensors)
    np.testing.assert_array_equal(several.R, np.eye(2))
    with pytest.raises(ValueError, match="R must be zero between sensors"):
        several.R = np.full((2, 2), 0.5) + np.eye(2)


def wrapped_mean(row):
    """Mean with a row that is an angle: within half a turn of point 0, as ours."""

    def mean(points, Wm):
        near = points.copy()
        near[:, row] = wrap(points[:, row], points[0, row])
        return Wm @ near

    return mean


def wrapped_residual(row):
    def residual(a, b):
        difference = np.subtract(a, b)
        difference[row] = wrap(difference[row], 0.0)
        return difference

    return residual


def angles_of_z():
    def bearing(x):
        return np.array([np.arctan2(np.sin(x[0]), np.cos(x[0])), x[1]])

    theirs = their_filter(
        hx=bearing, z_mean_fn=wrapped_mean(0), residual_z=wrapped_residual(0)
    )  # fmt: skip
    sensors = Sensor(
        lambda x, v: bearing(x), R=R, observations={"bearing": "rad", "rate": ""},
        angles=["bearing"],
    )  # fmt: skip
    ours, careless = our_filter(sensors=sensors), our_filter(sensors=replace(sensors, angles=()))
    for ukf in (theirs, ours, careless):
        ukf.x = np.array([3.1, 0.1])
        ukf.predict(DT)
        ukf.update([-3.1, 0.1])
    assert_equal(theirs, ours)
    assert_differ(theirs, careless)
    assert 3.1 < ours.x[0] < 3.3


def angles_of_x():
    def turning(x, dt):
        return np.array([wrap(x[0] + dt * x[1], 0.0), x[1]])

    theirs = their_filter(
        fx=turning, x_mean_fn=wrapped_mean(0), residual_x=wrapped_residual(0)
    )  # fmt: skip
    ours, careless = (
        our_filter(f=lambda x, w, u: turning(x, u), state_angles=angles) for angles in ([0], [])
    )
    for ukf in (theirs, ours, careless):
        ukf.x = np.array([3.1, 1.0])
        ukf.predict(DT)
    assert_equal(theirs, ours)
    assert_differ(theirs, careless)
    ours = our_filter(state_angles=[0], sensors=Sensor(lambda x, v: x, R=R))
    ours.x = [3.1, 0.0]
    ours.update([3.5, 0.0])
    assert ours.x[0] > np.pi  # it is not wrapped


def state_add():
    added = []

    def add(x, d):
        added.append(d)
        return x + d

    theirs = their_filter(state_add=add)
    theirs.predict()
    theirs.update(Z[0])
    assert len(added) == 1
    with pytest.raises(TypeError):
        our_problem(state_add=add)


def mahalanobis():
    theirs, ours = both(2)
    assert ours.nis == pytest.approx(theirs.mahalanobis**2, rel=1e-9)
    ours.gate = 1.0
    ours.predict(DT)
    assert not ours.update([50.0, 0.0])
    assert ours.gated


def likelihood():
    theirs, ours = both(2)
    determinant = np.linalg.det(theirs.S)
    expected = -0.5 * (ours.nis + np.log(determinant) + 2 * np.log(2.0 * np.pi))
    assert theirs.log_likelihood == pytest.approx(expected, rel=1e-9)
    assert theirs.likelihood == pytest.approx(np.exp(expected), rel=1e-9)
    assert_missing(theirs, ours, "log_likelihood", "likelihood")


def assert_missing(theirs, ours, *names):
    for name in names:
        assert hasattr(theirs, name)
        assert not hasattr(ours, name)


def innovation():
    assert_missing(*both(1), "y", "S", "SI", "K", "z")


def priors():
    theirs, ours = both(1)
    assert_missing(theirs, ours, "x_prior", "P_prior", "x_post", "P_post")
    theirs.predict()
    ours.predict(DT)
    np.testing.assert_allclose(ours.x, theirs.x_prior, atol=1e-12)
    np.testing.assert_allclose(ours.P, theirs.P_prior, atol=1e-12)
    theirs.update(Z[0])
    ours.update(Z[0])
    np.testing.assert_allclose(ours.x, theirs.x_post, atol=1e-12)
    np.testing.assert_allclose(ours.P, theirs.P_post, atol=1e-12)


def data_of(measurements):
    steps = len(measurements)
    times = DT * np.arange(steps)
    return Data(times=times, inputs=np.full(steps, DT), measurements=measurements)


def batch():
    theirs = their_filter()
    zs = [Z[0], None, *Z[2:]]
    means, covariances = theirs.batch_filter(zs)
    found = run(
        our_problem(data=data_of(np.array([np.full(2, np.nan) if z is None else z for z in zs]))),
        "reference",
        covariance=True,
    )
    np.testing.assert_allclose(found.x, means, atol=1e-12)
    np.testing.assert_allclose(found.P, covariances[-1], atol=1e-12)
    assert np.isnan(found.nis_of_sensors[:, 0]).tolist() == [False, True, False, False]


def saver():
    theirs = their_filter()
    kept = Saver(theirs)
    theirs.batch_filter(list(Z), saver=kept)
    P = []
    run(
        our_problem(data=data_of(Z)), "reference",
        after_step=lambda done, ukf: P.append(ukf.P) if done else None,
    )  # fmt: skip
    np.testing.assert_allclose(P, kept.P, atol=1e-12)


def smoother():
    assert_missing(*both(), "rts_smoother")


def internals():
    assert_missing(*both(), "sigmas_f", "compute_process_sigmas", "msqrt")
    with pytest.raises(TypeError):
        our_problem(sqrt_fn=np.linalg.cholesky)
    with pytest.raises(TypeError):
        our_filter().predict(DT, UT=None)


#: What tests each row of the table, by its first column.
ROWS = {
    "`UnscentedKalmanFilter(dim_x, dim_z, dt, hx, fx, points)`": constructor,
    "`fx(x, dt)`, `hx(x)`": models,
    "`MerweScaledSigmaPoints(n, alpha, beta, kappa)`": merwe,
    "`JulierSigmaPoints(n, kappa)`": julier,
    "`SimplexSigmaPoints(n)`": simplex,
    "`predict()`, `predict(dt=dt)`": predict_dt,
    "`predict(**fx_args)`, `update(z, **hx_args)`": arguments,
    "`predict(fx=...)`": predict_fx,
    "`predict()` redraws": redraw,
    "`update(z, R=...)`": update_R,
    "`update(z, hx=..., R=...)`": update_hx,
    "`update(None)`": update_none,
    "`update()` after `update()`": update_again,
    "`x`, `P`": estimate,
    "`Q`, `R`": noises,
    "`residual_z`, `z_mean_fn`": angles_of_z,
    "`residual_x`, `x_mean_fn`": angles_of_x,
    "`state_add`": state_add,
    "`mahalanobis`": mahalanobis,
    "`log_likelihood`, `likelihood`": likelihood,
    "`y`, `S`, `SI`, `K`, `z`": innovation,
    "`x_prior`, `P_prior`, `x_post`, `P_post`": priors,
    "`batch_filter(zs)`": batch,
    "`Saver(filter)`": saver,
    "`rts_smoother(xs, Ps)`": smoother,
    "`sigmas_f`, `compute_process_sigmas()`, `sqrt_fn`, `UT`": internals,
}


def test_every_row_of_the_table_has_a_test():
    text = (DOCS / "from-filterpy.md").read_text(encoding="utf-8")
    table = text.partition("| filterpy | here |")[2].partition("\n\n")[0]
    assert re.findall(r"(?m)^\| (`.*?) \| ", table) == list(ROWS)


@pytest.mark.parametrize("check", ROWS.values(), ids=lambda check: check.__name__)
def test_row(check):
    check()
