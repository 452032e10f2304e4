"""Angles: states and observations for which a whole turn makes no difference."""

import numpy as np
import pytest

from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Problem, Sensor
from ukf_sw.reference import sigma_coefficients
from ukf_sw.spec.float_format import BINARY32, BINARY64
from ukf_sw.spec.parameters import Noise, UkfParams

TURN = 2.0 * np.pi
#: What the reference and the golden model may differ by from the same filter elsewhere.
BACKENDS = {
    "reference": ("reference", BINARY64, 1e-11),
    "golden": ("golden", BINARY64, 1e-11),
    "golden in binary32": ("golden", BINARY32, 2e-5),
}
ORDERS = ["angle first", "angle last"]


def folded(angle):
    """Within half a turn of zero, as atan2 gives it."""
    return np.arctan2(np.sin(angle), np.cos(angle))


def make(backend, number_format, *, heading, folds, kind, W0, order):
    """Make a filter of a heading and its rate, of which the heading is seen.

    Parameters
    ----------
    heading
        Where it begins.
    folds
        Whether the models give angles as atan2 does, and they are declared to be angles. Else they
        are numbers as all others.
    order
        Which of the states comes last, so which one the last sigma point differs in.
    """
    angle, rate = (0, 1) if order == "angle first" else (1, 0)
    fold = folded if folds else np.asarray

    def f(x, w, u):
        moved = np.empty(x.shape)
        moved[angle] = fold(x[angle] + 0.3 * x[rate] + w[angle])
        moved[rate] = 0.9 * x[rate] + w[rate]
        return moved

    def h(x, v):
        return np.array([fold(x[angle] + v[0])])

    x0, P0 = np.empty(2), np.diag([0.3, 0.3])
    x0[angle], x0[rate] = heading, 0.4
    problem = Problem(
        name="heading", f=f, sensors=Sensor(h, R=[[0.09]], m=1, angles=(0,) if folds else ()),
        x0=x0, P0=P0, Q=np.diag([0.02, 0.01]), state_angles=(angle,) if folds else (),
        process_noise=kind, observation_noise=kind, W0=W0, format=number_format,
    )  # fmt: skip
    return UnscentedKalmanFilter(problem, backend), angle


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("W0", [0.0, 0.3])
@pytest.mark.parametrize("kind", Noise)
@pytest.mark.parametrize("name", BACKENDS)
def test_an_angle_near_the_cut_behaves_as_one_far_from_it(name, kind, W0, order):
    backend, number_format, tolerance = BACKENDS[name]
    options = {"kind": kind, "W0": W0, "order": order}
    # Innovations of both signs, some of them near half a turn.
    seen = [0.1, -0.2, 0.3, 2.7, -2.7, 0.05, -2.9, 2.9]
    crossed = 0
    for start in (np.pi - 0.05, -np.pi + 0.05, np.pi, 1.0):
        far, angle = make(backend, number_format, heading=0.0, folds=False, **options)
        near, _ = make(backend, number_format, heading=start, folds=True, **options)
        for offset in seen:
            far.predict()
            near.predict()
            z = far.x[angle] + offset
            assert far.update([z])
            assert near.update([folded(z + start)])
            difference = near.x - far.x
            difference[angle] -= start
            crossed += abs(difference[angle]) > 1.0
            difference[angle] -= TURN * np.round(difference[angle] / TURN)
            np.testing.assert_allclose(difference, 0.0, atol=tolerance)
            np.testing.assert_allclose(near.P, far.P, atol=tolerance)
            assert near.nis == pytest.approx(far.nis, rel=10 * tolerance, abs=10 * tolerance)
    assert crossed > 0


@pytest.mark.parametrize("W0", [0.0, 0.3])
@pytest.mark.parametrize("M", [1, 2, 3, 7, 20, 32, 33, 96])
def test_points_are_near_enough_to_that_which_angles_are_wrapped_to(M, W0):
    """In standard deviations; two points within half a turn of a third must be."""
    n, q = min(M, 32), min(max(M - 32, 0), 32)
    params = UkfParams(n=n, m=1, q=q, r=M - n - q, W0=W0)
    assert params.M == M
    sigma = sigma_coefficients(M, W0)[:, params.points.start :]
    centre = sigma[:, params.points.index(params.centre)]
    from_centre = np.abs(sigma - centre[:, None]).max(axis=1)
    from_mean = np.abs(sigma).max(axis=1)
    if W0:
        np.testing.assert_array_equal(from_centre, from_mean)
        assert from_mean[-1] == pytest.approx(np.sqrt(M / (1.0 - W0)))
        return
    np.testing.assert_array_equal(from_centre[:-1], from_mean[:-1])
    assert from_mean[-1] == pytest.approx(np.sqrt(M))
    assert from_centre[-1] == pytest.approx(np.sqrt(M) + 1.0 / np.sqrt(M))
    # Any other point is farther away from some in more than the last element.
    for k in range(sigma.shape[1] - 1):
        farther = np.abs(sigma - sigma[:, [k]]).max(axis=1) > from_mean * (1.0 + 1e-12)
        assert farther.sum() > 1 or k >= M - 2
