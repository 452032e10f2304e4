"""With W0 = 0 nothing is computed with sigma point 0, which has no weight."""

import numpy as np
import pytest

from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Problem, Sensor
from ukf_sw.spec.float_format import BINARY32, BINARY64
from ukf_sw.spec.parameters import Form, Noise

BACKENDS = ["reference", "golden"]
ADDITIVE = {"process_noise": Noise.ADDITIVE, "observation_noise": Noise.ADDITIVE}
#: Kinds of noise, and the steps whose model sees point 0 alone with all of its arguments at their
#: mean: points that differ from it only in the noise of the other model are the same to a model.
KINDS = {
    "additive": (ADDITIVE, ("predict", "update")),
    "augmented": ({}, ("update",)),
    "augmented process noise": ({"observation_noise": Noise.ADDITIVE}, ("predict",)),
}
STEPS = [(kind, step) for kind, (_, steps) in KINDS.items() for step in steps]


class Trap:
    """Models that fail where x and the noise are at their mean, and count their calls.

    Parameters
    ----------
    how
        "nan" for a result of NaN, "raise" for an error.
    vectorized
        Whether they take all sigma points at once.
    """

    def __init__(self, how, vectorized):
        self.how, self.vectorized = how, vectorized
        self.mean = None
        self.shapes = []

    @property
    def points(self):
        """Sigma points since the last look."""
        count = sum(shape[1] if self.vectorized else 1 for shape in self.shapes)
        self.shapes.clear()
        return count

    def model(self, x, noise, *_):
        self.shapes.append(x.shape)
        result = np.array([x[0] + 0.1 * x[1] + noise[0], 0.9 * x[1] + 0.1 * x[0] ** 2 + noise[-1]])
        if self.mean is not None:
            column = self.mean if x.ndim == 1 else self.mean[:, None]
            caught = (x == column).all(axis=0) & (noise == 0.0).all(axis=0)
            if caught.any() and self.how == "raise":
                raise ZeroDivisionError("at the mean")
            result = np.where(caught, np.nan, result)
        return result


def make(trap, backend, kind, **options):
    problem = Problem(
        name="trap", f=trap.model, sensors=Sensor(trap.model, R=np.eye(2) * 0.1, m=2),
        x0=[0.5, -1.0], P0=[[0.3, 0.1], [0.1, 0.2]], Q=np.eye(2) * 0.05, pes=2,
        vectorized=trap.vectorized, **KINDS[kind][0], **options,
    )  # fmt: skip
    return UnscentedKalmanFilter(problem, backend)


def run_step(ukf, step):
    if step == "predict":
        ukf.predict()
        ukf.redraw()
    else:
        assert ukf.update([1.0, 0.0])


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("how", ["nan", "raise"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number_format", [BINARY32, BINARY64])
@pytest.mark.parametrize("backend", BACKENDS)
def test_models_need_not_work_at_the_mean(backend, number_format, kind, how, vectorized):
    trap, free = Trap(how, vectorized), Trap(how, vectorized)
    ukf, twin = (make(each, backend, kind, format=number_format) for each in (trap, free))
    count = len(ukf.params.points)
    assert count == ukf.params.M + 1
    for call in range(1, 4):
        for step in ("predict", "update"):
            trap.mean = ukf.x if step in KINDS[kind][1] else None
            run_step(ukf, step)
            run_step(twin, step)
            # In the first call, and in the second, a model is asked again at three points.
            assert trap.points == count + (3 if call < 3 else 0)
            np.testing.assert_array_equal(ukf.x, twin.x)
            np.testing.assert_array_equal(ukf.P, twin.P)


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize(("kind", "step"), STEPS)
@pytest.mark.parametrize("backend", BACKENDS)
def test_with_W0_models_must_work_at_the_mean(backend, kind, step, vectorized):
    for how, error, message in (
        ("nan", ValueError, "must return finite numbers, at sigma point 0, not nan in row 0$"),
        ("raise", ZeroDivisionError, "^at the mean"),
    ):
        trap = Trap(how, vectorized)
        ukf = make(trap, backend, kind, W0=0.5)
        trap.mean = ukf.x
        with pytest.raises(error, match=message):
            run_step(ukf, step)
        trap.mean = None
        trap.shapes.clear()
        run_step(ukf, step)
        assert trap.points >= len(ukf.params.points) == ukf.params.M + 2


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("kind", KINDS)
def test_a_small_W0_is_nearly_none(kind, form):
    """Without sigma point 0 the estimate is the limit of those with it."""
    estimates = []
    for W0 in (0.0, 1e-9):
        trap = Trap("nan", vectorized=True)
        ukf = make(trap, "golden", kind, W0=W0, form=form, format=BINARY64)
        for k in range(4):
            ukf.predict()
            ukf.update([0.5 + k, 0.1])
        estimates.append(np.append(ukf.x, ukf.P))
    np.testing.assert_allclose(*estimates, atol=1e-7)
    assert (estimates[0] != estimates[1]).any()
