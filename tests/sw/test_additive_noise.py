"""Additive noise: columns beside the sigma points, of which all sensors share some."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ukf_sw.drivers.driver import Driver
from ukf_sw.engine.layout import Layout
from ukf_sw.errors import StepError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problem import Problem, Sensor
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.float_format import BINARY16, BINARY32, BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, UkfParams

ADDITIVE = {"process_noise": Noise.ADDITIVE, "observation_noise": Noise.ADDITIVE}
EVERY_W0 = [0.0, 0.5]
#: Sensors of different sizes, the largest neither first nor last.
SENSORS = UkfParams(n=2, m=6, q=2, r=6, sensors=(1, 3, 2), format=BINARY64, **ADDITIVE)
ONE_SENSOR = UkfParams(n=3, m=2, q=3, r=2, format=BINARY64, **ADDITIVE)
SMALLEST = UkfParams(n=1, m=1, q=1, r=1, format=BINARY64, **ADDITIVE)


def positive(rng, size):
    """Covariance whose factor has no zeros below its diagonal."""
    A = rng.standard_normal((size, size)) + 2.0 * np.eye(size)
    return A @ A.T / size


def noise_of_sensors(rng, params):
    """R of sensors that have nothing to do with each other."""
    R = np.zeros((params.r, params.r))
    for rows in map(params.rows_of, range(len(params.sensor_rows))):
        R[rows.start : rows.stop, rows.start : rows.stop] = positive(rng, len(rows))
    return R


class Walk:
    """A backend that random things happen to; equal seeds, equal things.

    Parameters
    ----------
    backend
        The backend.
    seed
        Where chance comes from.
    """

    def __init__(self, backend, seed):
        self.backend, self.params = backend, backend.params
        self.rng = np.random.default_rng(seed)
        n, m = self.params.n, self.params.m
        self._A, self._C = self.rng.standard_normal((n, n)), self.rng.standard_normal((m, n))
        self._A /= np.linalg.norm(self._A, 2)
        x, P = self.rng.standard_normal(n), positive(self.rng, n)
        backend.initialise(x, P, positive(self.rng, n), noise_of_sensors(self.rng, self.params))
        self.sampled = set()
        self._steps = 0

    def step(self):
        """Predict, and update from one sensor after the other; gives what is seen."""
        rng, backend, seen = self.rng, self.backend, []
        if rng.random() < 0.2:
            backend.set_noise(positive(rng, self.params.n), noise_of_sensors(rng, self.params))
        W, V = backend.noise_points()
        moved = self._A @ backend.sigma_points() + W
        points = backend.predict(moved + 0.1 * np.sin(moved))
        seen += [backend.state(), backend.covariance()]
        sensors = len(self.params.sensor_rows)
        # Each sensor has its turn, and between these is what chance brings.
        turn, self._steps = self._steps % sensors, self._steps + 1
        for sensor in (turn, *rng.integers(sensors, size=rng.integers(3)).tolist()):
            rows = self.params.rows_of(sensor)
            mask = rng.random(len(rows)) < 0.7
            mask[rng.integers(len(rows))] = True
            z = rng.standard_normal(len(rows))
            if rng.random() < 0.5 or points is None:
                points = backend.sigma_points()
            own = slice(rows.start, rows.stop)
            observed = self._C[own] @ points + V[own]
            points = None
            self.sampled.add((sensor, int(mask.sum())))
            nis, _ = backend.update(observed + 0.1 * observed**2, z, mask, sensor)
            seen += [nis, backend.state(), backend.covariance()]
        return np.concatenate([np.ravel(item) for item in seen])


def shapes():
    """Cores with noise in beats of its own, and with noise beside points; the largest one, too."""
    result = []
    for params in (SMALLEST, ONE_SENSOR, SENSORS):
        for W0 in EVERY_W0:
            this = replace(params, W0=W0)
            lanes = {1, 2, 3, 5, 6, this.columns - 1, this.columns}
            result += [replace(this, pes=k) for k in lanes if k <= this.columns]
    return result


def noise_beside_points(params):
    """Whether noise of an observation shares a beat with sigma points or the right-hand side."""
    return Layout(params).noise_r[0] % params.pes != 0


def test_shapes_have_noise_in_beats_of_its_own_and_beside_points():
    assert {noise_beside_points(params) for params in shapes() if params.sensors} == {False, True}
    # A sensor's noise may also be in the beat of the noise that only a larger one has.
    assert any(params.sensors and params.pes == 2 for params in shapes())


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("params", shapes(), ids=lambda each: f"{each.m}-{each.W0}-{each.pes}")
def test_golden_follows_the_reference_whatever_sensor_is_next(params, form):
    """No noise of another sensor, or of another time, is left where this one's is."""
    params = replace(params, form=form)
    seed = params.pes
    walks = [
        Walk(backend, seed)
        for backend in (ReferenceUkf(params), Driver(GoldenBus(GoldenCore(params)), params))
    ]
    for _ in range(8):
        expected, found = (walk.step() for walk in walks)
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)
    (sampled,) = {frozenset(walk.sampled) for walk in walks}
    assert {sensor for sensor, _ in sampled} == set(range(len(params.sensor_rows)))
    if params.sensors:
        assert any(count < params.sensor_rows[sensor] for sensor, count in sampled)


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", [1, 2, 3, 4, -1])
def test_a_failed_update_leaves_no_noise_to_that_of_a_smaller_sensor(pes, W0, form):
    """Neither in its results, nor as an overflow in columns that are none of its own."""
    params = UkfParams(
        n=2, m=4, r=4, sensors=(1, 3), W0=W0, form=form, format=BINARY16, **ADDITIVE
    )  # fmt: skip
    params = replace(params, pes=params.columns if pes == -1 else pes)
    layout, results = Layout(params), []
    # Two rows that see the same without noise, and one whose noise is too large for a product.
    variances = np.square([5.0, 0.0, 0.0, 20_000.0])
    for fails in (False, True):
        core = GoldenCore(params)
        driver = Driver(GoldenBus(core), params)
        P = np.array([[100.0, 10.0], [10.0, 80.0]])
        driver.initialise(np.array([3.0, -5.0]), P, np.zeros((0, 0)), np.diag(variances))
        points = driver.sigma_points()
        if fails:
            with pytest.raises(StepError):
                driver.update(points[[0, 0, 1]], np.zeros(3), np.ones(3, dtype=bool), 1)
            (address, _), lane = layout.Ez[2].element(layout.noise_r[0] + 2)
            left = params.format.decode(core.engine.memory[lane, address])
            # With one processing element the error comes before; but no beat is shared.
            assert pes == 1 or left > params.format.max_finite / 100.0
            driver.recover()
            np.testing.assert_array_equal(driver.sigma_points(), points)
        nis, _ = driver.update(points[:1], np.array([4.0]), np.ones(1, dtype=bool), 0)
        results.append((nis, driver.state().tolist(), driver.covariance().tolist()))
    assert results[0] == results[1]


class Scribbling(GoldenBus):
    """Writes something else to what is above the diagonals of the factors of noise."""

    def __init__(self, core, params, garbage):
        super().__init__(core)
        memory_map = MemoryMap(params)
        before = {i: min(rows) for rows in map(params.rows_of, range(len(params.sensor_rows)))
                  for i in rows} if params.additive_r else {}  # fmt: skip
        above = [
            (symbol, row, column)
            for symbol in ("LQ", "LR")
            for row in range(memory_map[symbol].rows)
            for column in range(memory_map[symbol].columns)
            if column > row - (before.get(row, 0) if symbol == "LR" else 0)
        ]
        self.symbols = {symbol for symbol, _, _ in above}
        self.above = [
            memory_map.address(*element) + 4 * word
            for element in above for word in range(params.format.bus_words)
        ]  # fmt: skip
        self.garbage = dict(zip(self.above, garbage(len(self.above)), strict=True))
        self.written = set()

    def write_many(self, addresses, words):
        words = [
            self.garbage.get(address, word)
            for address, word in zip(addresses.tolist(), words.tolist(), strict=True)
        ]
        self.written |= self.garbage.keys() & set(addresses.tolist())
        super().write_many(addresses, np.array(words, dtype=np.uint32))


GARBAGE = {
    "numbers": lambda rng, count: rng.integers(0x3F80_0000, 0x4180_0000, count).tolist(),
    "NaN": lambda rng, count: [0x7FFF_FFFF] * count,
    "infinity": lambda rng, count: [0x7F80_0000, 0xFF80_0000] * (count // 2) + [0] * (count % 2),
    "anything": lambda rng, count: rng.integers(0, 1 << 32, count).tolist(),
}


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", [1, 3, 5, -1])
@pytest.mark.parametrize("name", ["one sensor", "sensors", "augmented"])
def test_what_is_above_the_diagonal_of_factors_does_not_matter(name, pes, W0, form):
    """INIT clears it where the noise is additive; else nothing reads it."""
    params = {
        "one sensor": ONE_SENSOR, "sensors": SENSORS, "augmented": UkfParams(n=2, m=2, q=2, r=2),
    }[name]  # fmt: skip
    params = replace(params, W0=W0, form=form, format=BINARY32)
    params = replace(params, pes=params.columns if pes == -1 else pes)
    rng = np.random.default_rng(1)
    buses = [GoldenBus(GoldenCore(params))]
    for garbage in GARBAGE.values():
        buses.append(Scribbling(GoldenCore(params), params, partial(garbage, rng)))
    walks = [Walk(Driver(bus, params), 7) for bus in buses]
    clean, *dirty = buses
    memory = clean.core.engine.memory

    def check_memories():
        for bus in dirty:
            assert not any(bus.read(address) for address in bus.above)
            np.testing.assert_array_equal(bus.core.engine.memory, memory)

    for bus in dirty:
        assert bus.symbols == {"LQ", "LR"}
        assert bus.written == set(bus.above)
    if name != "augmented":
        check_memories()
    for _ in range(6):
        expected, *found = (walk.step() for walk in walks)
        assert np.isfinite(expected).all()
        for seen in found:
            np.testing.assert_array_equal(seen, expected)
    if name != "augmented":
        check_memories()
    assert {sensor for sensor, _ in walks[0].sampled} == set(range(len(params.sensor_rows)))


@pytest.mark.parametrize("pes", range(1, 8))
def test_what_is_below_the_diagonal_of_a_covariance_does_not_overflow(pes):
    """Nobody reads it, so it must not be computed: in binary16 it would be infinite."""
    problem = Problem(
        name="large",
        f=lambda x, w, u: x,
        sensors={
            "one": Sensor(lambda x, v: x[:1], R=[[900.0]]),
            "three": Sensor(
                lambda x, v: np.array([x[0], x[1], x[0] + x[1]]), R=np.diag([900.0] * 3)
            ),
        },
        Q=np.zeros((0, 0)),
        x0=[10.0, 20.0],
        P0=[[3600.0, 300.0], [300.0, 2500.0]],
        observation_noise="additive",
        form=Form.COVARIANCE,
        format=BINARY16,
        pes=pes,
    )
    ukf = UnscentedKalmanFilter(problem, "golden")
    ukf.update([30.0], sensor="one")
    gain = np.array([3600.0, 300.0]) / 4500.0
    np.testing.assert_allclose(ukf.x, [10.0, 20.0] + gain * 20.0, rtol=2e-3)
