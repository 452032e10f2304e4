"""Observations that a filter must refuse: rows that depend on others, and values far from sense."""

import numpy as np
import pytest

from ukf_sw.errors import NotFiniteError, SingularObservationError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Problem, Sensor
from ukf_sw.spec.float_format import BINARY32, BINARY64
from ukf_sw.spec.parameters import Form, Noise

CORES = [
    pytest.param("reference", {}, id="reference"),
    *(
        pytest.param("golden", {"form": form, "pes": pes, "format": number_format},
                     id=f"golden-{form.value}-{pes}-{number_format.name}")
        for form in Form for pes in (1, 2, 4) for number_format in (BINARY32, BINARY64)
    ),
]  # fmt: skip


def observing(H, backend, core, *, P0, R=None):
    """A filter of a state that stays, observed through a matrix with additive noise."""
    problem = Problem(
        name="hostile", f=lambda x, w, u: x, sensors=Sensor(lambda x, v: H @ x, R=R),
        x0=np.zeros(H.shape[1]), P0=P0, observation_noise=Noise.ADDITIVE, **core,
    )  # fmt: skip
    return UnscentedKalmanFilter(problem, backend)


def state(ukf):
    return ukf.x.tolist(), ukf.P.tolist()


@pytest.mark.parametrize(("backend", "core"), CORES)
def test_a_row_that_depends_on_others_is_named(backend, core):
    H = np.array([[1, 0], [0, 1], [1.1, 1.3]])
    ukf = observing(H, backend, core, P0=np.diag([1.0, 2.0]))
    before = state(ukf)
    with pytest.raises(SingularObservationError) as error:
        ukf.update(H @ [0.1, 0.2] + [0.0, 0.0, 1e-3])
    assert error.value.index == 2
    assert state(ukf) == before
    # Without it there is nothing wrong, and the core goes on.
    if core.get("form") is not Form.COVARIANCE:  # which has no P = 0
        ukf.update(H @ [0.1, 0.2], mask=[True, True, False])
        np.testing.assert_allclose(ukf.x, [0.1, 0.2], rtol=1e-6)


@pytest.mark.parametrize(("backend", "core"), CORES[::3])
@pytest.mark.parametrize("noise", Noise)
@pytest.mark.parametrize("constant", [0.0, 0.1, -3e7])
def test_a_row_that_is_constant_and_has_no_noise_is_named(backend, core, noise, constant):
    """The rounding error of its mean looks like a variance."""
    augmented = noise is Noise.AUGMENTED

    def h(x, v):
        return [x[0], constant, x[1], v[1] if augmented else constant]

    problem = Problem(
        name="constant", f=lambda x, w, u: x, x0=[1.0, 2.0], P0=np.diag([1.0, 2.0]),
        sensors=Sensor(h, R=np.diag([0.0, 4.0]) if augmented else np.diag([0.0, 0.0, 0.0, 4.0])),
        observation_noise=noise, **core,
    )  # fmt: skip
    ukf = UnscentedKalmanFilter(problem, backend)
    before = state(ukf)
    with pytest.raises(SingularObservationError, match=r"singular at row 1$"):
        ukf.update([1.0, constant, 2.0, 0.0])
    assert state(ukf) == before
    # One with noise is as good as any, and so is one that was not sampled.
    mask = np.array([True, False, True, True])
    if core.get("form") is Form.COVARIANCE:  # which has no P = 0
        mask[:3] = False
    ukf.update([1.0, constant, 2.0, 0.0 if augmented else constant], mask)
    np.testing.assert_allclose(ukf.x, [1.0, 2.0], rtol=1e-6)


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize(
    "seed", [*range(4), *(pytest.param(k, marks=pytest.mark.slow) for k in range(4, 40))]
)
def test_dependent_rows_of_any_scale_are_found_and_precise_sensors_are_not(form, seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 7)), int(rng.integers(2, 7))
    dependent = int(rng.integers(1, min(m, n)))
    H = rng.standard_normal((m, n))
    H[dependent] = rng.standard_normal(dependent) @ H[:dependent]
    H *= 10.0 ** rng.uniform(-3, 3, (m, 1))
    root = rng.standard_normal((n, n))
    P0 = root @ root.T + 0.1 * np.eye(n)
    core = {"form": form, "pes": int(rng.integers(1, n + 3))}
    with pytest.raises(SingularObservationError) as error:
        observing(H, "golden", core, P0=P0).update(np.zeros(m))
    assert error.value.index == dependent
    # The smallest noise that is legal, in parts of H P H^T.
    part = {Form.SQUARE_ROOT: 1e-10, Form.COVARIANCE: 1e-5}[form]
    R = part * np.diag(np.diag(H @ P0 @ H.T))
    ukf = observing(H, "golden", core, P0=P0, R=R)
    ukf.update(np.zeros(m))
    assert np.isfinite(ukf.P).all()


def test_a_row_is_found_where_one_before_it_was_nearly_dependent_too():
    """Its rounding errors are magnified then; a margin of 2^-40 let it pass."""
    H = np.array([
        [1.337560930857414, 0.1757359503214666],
        [-0.7196249616847328, -0.26622137111407684],
        [0.056934041566392736, -0.4300137156429038],
    ])  # fmt: skip
    ukf = observing(H, "golden", {"pes": 2}, P0=np.eye(2))
    ukf.predict()
    with pytest.raises(SingularObservationError) as error:
        ukf.update(H @ [1.0, 1.0] + [0.0, 0.0, 1e-3])
    assert error.value.index == 2


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_more_sensors_than_states_are_found_as_often_as_in_float64(seed):
    """What passes has two rows before it that are nearly the same."""
    passed = {}
    for backend in ("reference", "golden"):
        rng = np.random.default_rng(seed)
        passed[backend] = 0
        for _ in range(100):
            H = rng.standard_normal((3, 2)) * 10.0 ** rng.uniform(-2, 2, (3, 1))
            root = rng.standard_normal((2, 2))
            ukf = observing(H, backend, {"pes": 2}, P0=root @ root.T)
            try:
                ukf.update(np.zeros(3))
                passed[backend] += 1
            except SingularObservationError:
                pass
    assert passed["golden"] <= passed["reference"] <= 5


@pytest.mark.parametrize(("backend", "core"), CORES)
@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("redrawn", [False, True])
def test_a_gate_rejects_what_the_format_cannot_square(backend, core, row, redrawn):
    largest = core.get("format", BINARY64).max_finite
    ukf = observing(np.eye(2), backend, core, P0=np.diag([1e-4, 2.0]), R=np.diag([1e-4, 1.0]))
    twin = observing(np.eye(2), backend, core, P0=np.diag([1e-4, 2.0]), R=np.diag([1e-4, 1.0]))
    for each in (ukf, twin):
        each.gate = 10.0
        if not redrawn:
            each.predict()
    before = state(ukf)
    for value in (1e15, 1e30, -0.9 * largest, largest):
        z = [0.1, 0.1]
        z[row] = value
        assert ukf.update(z) is False
        assert ukf.gated
        assert ukf.nis > 1e29
        assert state(ukf) == before
    # A predicted point still serves, and what is sensible is still taken.
    for each in (ukf, twin):
        assert each.update([0.01, 0.5]) is True
    np.testing.assert_allclose(ukf.x, twin.x, rtol=1e-6)
    ukf.gate = np.inf
    before = state(ukf)
    with pytest.raises(NotFiniteError):
        ukf.update([largest, -largest])
    assert state(ukf) == before
