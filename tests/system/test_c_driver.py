"""The C driver and filter against the Python ones, access by access, and all their return codes."""

import ctypes
import itertools
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from support.c_binding import CFilter, CFilterError, Result, compile_library
from support.covariances import random_covariances
from support.noting_bus import NotingBus
from support.problems import core_of
from ukf_sim.c_in_the_loop.compiler import Toolchain
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import NotFiniteError
from ukf_sw.factors import IndefiniteError, check_definite, lower_factor, rounding_errors
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden import GoldenCore
from ukf_sw.problem import Problem, Sensor
from ukf_sw.spec.float_format import BINARY32, BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, UkfParams
from ukf_sw.spec.registers import (
    CONFIG,
    CONTROL,
    ERROR,
    GATE_HIGH,
    GATE_LOW,
    ID,
    MASK,
    SENSORS,
    SIZES,
    STATUS,
    ErrorCode,
)
from ukf_sw.spec.sequence import Step

pytestmark = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")

AUGMENTED = UkfParams(n=3, m=2, q=2, r=2)
MIXED = UkfParams(n=3, m=2, q=3, r=2, process_noise=Noise.ADDITIVE, format=BINARY64)
COVARIANCE = UkfParams(n=3, m=2, q=3, r=2, form=Form.COVARIANCE)
SMALLEST = UkfParams(n=1, m=1)
#: Sigma point 0 has a weight.
WEIGHTED = replace(AUGMENTED, W0=0.25)
WEIGHTED_MIXED = replace(MIXED, W0=0.25)
#: Three sensors. Noise terms that are augmented need not be as many as rows.
THREE = UkfParams(n=3, m=6, q=2, r=4, sensors=(2, 1, 3))
THREE_ADDITIVE = UkfParams(
    n=3, m=6, q=3, r=6, sensors=(2, 1, 3), process_noise=Noise.ADDITIVE,
    observation_noise=Noise.ADDITIVE,
)  # fmt: skip
THREE_WIDE = replace(THREE_ADDITIVE, format=BINARY64)
THREE_WEIGHTED = replace(THREE, W0=0.4)
#: Row 2, of the second sensor, is an angle.
ANGLE = 2
#: Without start files: those of -Ofast would change the arithmetic of this process.
FAST = ("-Ofast", "-nostartfiles")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Function that gives the library of a core, compiled once."""

    @cache
    def get(params, flags=()):
        return compile_library(params, tmp_path_factory.mktemp("c"), flags=flags)

    return get


class Clock:
    """Time that passes by looking at it, a millisecond a look."""

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        self.time += 1e-3
        return self.time


def f(x, w, u):
    """A process that uses all it gets; state 0 is an angle that turns."""
    following = [value + 0.1 * np.sin(value) + u for value in x]
    for i, noise in enumerate(w):
        following[i % len(x)] += (1.0 + 0.1 * x[0]) * noise
    following[0] += 1.0
    return following


def h(x, v):
    return [x[i % len(x)] * 0.5 + (v[i] if i < len(v) else 0.0) for i in range(2)]


def h1(x, v):
    return [x[0]]


def problem(params):
    n = params.n
    rng = np.random.default_rng(3)
    # In binary64 a factor shows the order of summation, unless it is that of a diagonal matrix.
    A = np.eye(n) if params.format == BINARY64 else rng.standard_normal((n, n))
    return {
        "x0": rng.standard_normal(n),
        "P0": A @ A.T + np.eye(n),
        "Q": 0.01 * np.eye(params.q) if params.q else None,
        "R": 0.04 * np.eye(params.r) if params.r else None,
    }


def start(library, params, *, bus=None, core=None, observe=None, **options):
    """Open and start a C filter on a golden model."""
    bus = bus or NotingBus(core or GoldenCore(params))
    ukf = CFilter(
        library(params), bus, params, f, observe or (h1 if params.m == 1 else h), **options
    )
    data = problem(params)
    ukf.start(data["x0"], data["P0"], data["Q"], data["R"])
    return ukf, bus


def python_filter(
    params, backend, *, observe=h, redraw=None, state_angles=(), observation_angles=()
):
    """The same filter in Python."""
    data = problem(params)
    sensor = Sensor(observe, R=data.pop("R"), m=params.m, angles=observation_angles)
    same = Problem(
        name="c", f=f, sensors=sensor, redraw=redraw, state_angles=state_angles, **data,
        **core_of(params),
    )  # fmt: skip
    return UnscentedKalmanFilter(same, backend)


def both(library, params, *, interrupt=False, redraw=False, **angles):
    """A C filter and a Python filter, each with a golden model of its own."""
    buses = [NotingBus(GoldenCore(params)) for _ in range(2)]
    waits = [bus.bus.wait_for_interrupt if interrupt else None for bus in buses]
    observe = h1 if params.m == 1 else h
    c = CFilter(
        library(params), buses[0], params, f, observe, interrupt=waits[0], redraw=redraw, **angles
    )
    driver = Driver(buses[1], params, interrupt=waits[1])
    data = problem(params)
    python = python_filter(params, driver, observe=observe, redraw=redraw, **angles)
    c.start(data["x0"], data["P0"], data["Q"], data["R"])
    return c, python, *buses


def same(c, python):
    """Whether the estimates are equal, bit for bit."""
    python._last_x = None  # so that both read it
    return c.x.tobytes() == python.x.tobytes()


@pytest.mark.parametrize("interrupt", [False, True], ids=["polling", "interrupt"])
@pytest.mark.parametrize(
    "params",
    [AUGMENTED, MIXED, COVARIANCE, WEIGHTED, WEIGHTED_MIXED],
    ids=["augmented", "mixed", "covariance", "W0", "W0 mixed"],
)
def test_every_access_is_that_of_the_python_driver(library, params, interrupt):
    """Sequence, addresses, words: predict, update, masks, gate, settings, recovering."""
    c, python, c_bus, python_bus = both(
        library, params, interrupt=interrupt, state_angles=(0,), observation_angles=(0,)
    )
    rng = np.random.default_rng(7)
    gated = 0
    for k in range(24):
        u = float(rng.standard_normal())
        if k % 9 == 6:
            c.recover()
            python.recover()
        c.predict(u)
        python.predict(u)
        z = 3.0 * rng.standard_normal(params.m)
        mask = rng.random(params.m) < 0.8
        z[~mask] = np.nan
        gate = 0.5 if k % 6 == 3 else np.inf
        python.gate = gate
        c.set_gate(gate)
        assert c.update(z, mask) == python.update(z, mask)
        assert c.gated == python.gated
        if python.nis is not None:
            assert c.nis == python.nis
        gated += python.gated
        if k % 4 == 1:  # an update may follow an update
            python.update(np.ones(params.m))
            c.update(np.ones(params.m))
        if k % 5 == 2:
            python.x = c_x = rng.standard_normal(params.n)
            c.x = c_x
        if k % 7 == 3:
            python.P = P = problem(params)["P0"] * (1.0 + 0.1 * k)
            c.P = P
        if k == 11 and params.q:
            python.Q = Q = 0.02 * np.eye(params.q)
            c.set_noise(Q, problem(params)["R"])
        assert same(c, python)
        if k % 6 == 5:
            python._last_P = None
            assert c.P.tobytes() == python.P.tobytes()
    assert gated > 1
    assert len(c_bus.log) > 500
    assert c_bus.log == python_bus.log
    assert not c.exceptions


# Sigma points.

#: Without and with a weight of point 0.
KINDS = pytest.mark.parametrize(
    "params", [AUGMENTED, MIXED, WEIGHTED, WEIGHTED_MIXED],
    ids=["augmented", "mixed", "W0", "W0 mixed"],
)  # fmt: skip


def held(bus, params, symbol):
    """What a region of the core holds, as numbers."""
    region = MemoryMap(params)[symbol]
    words = [
        [bus.bus.read(MemoryMap(params).address(symbol, i, j) + 4 * k) << 32 * k
         for k in range(params.format.bus_words)]
        for i in range(region.rows)
        for j in range(region.columns)
    ]  # fmt: skip
    numbers = params.format.decode(np.array([sum(each) for each in words], dtype=np.uint64))
    return numbers.reshape(region.rows, region.columns)


def both_of(library, params, processes, observations):
    """A C filter and a Python filter with models of their own, and their buses."""
    buses = [NotingBus(GoldenCore(params)) for _ in range(2)]
    data = problem(params)
    c = CFilter(library(params), buses[0], params, processes[0], observations[0])
    driver = Driver(buses[1], params)
    sensor = Sensor(observations[1], R=data["R"], m=params.m)
    same_problem = Problem(
        name="c", f=processes[1], sensors=sensor, redraw=False,
        **{key: data[key] for key in ("x0", "P0", "Q")}, **core_of(params),
    )  # fmt: skip
    python = UnscentedKalmanFilter(same_problem, driver)
    c.start(*data.values())
    return c, python, *buses


@pytest.mark.parametrize("params", [AUGMENTED, MIXED, WEIGHTED, SMALLEST])
def test_which_points_there_are(library, params):
    """Numbers of the first one, and of that to which angles are wrapped."""
    core = ctypes.c_char.in_dll(library(params), "binding_core")
    first, centre = (
        getattr(library(params), f"ukf_core_{name}")(ctypes.byref(core))
        for name in ("first_point", "centre")
    )
    assert range(first, params.N) == params.points
    assert centre == params.centre


@KINDS
def test_models_are_called_for_the_points_with_weight(library, params):
    """Those of the core, in their order; as in Python, which then checks some once more."""
    calls = {"C": [], "Python": []}

    def noting(language, model):
        def noted(x, noise, *arguments):
            calls[language].append(np.concatenate((x, noise)).tobytes())
            return model(x, noise, *arguments)

        return noted

    c, python, bus, _ = both_of(
        library, params, *([noting(language, model) for language in calls] for model in (f, h))
    )
    count = len(params.points)
    for _ in range(3):
        c.redraw()
        x, X = held(bus, params, "x")[0], held(bus, params, "X")
        w = np.zeros((params.q, params.N)) if params.additive_q else held(bus, params, "W")
        v = held(bus, params, "V")
        states = [X[:, k] if k <= params.n + 1 else x for k in params.points]
        c.predict(0.1)
        python.predict(0.1)
        assert calls["C"] == calls["Python"][:count]
        assert calls["C"] == [
            np.concatenate((state, w[:, k])).tobytes()
            for k, state in zip(params.points, states, strict=True)
        ]
        calls["C"].clear()
        calls["Python"].clear()
        c.update([0.1, 0.2])
        python.update([0.1, 0.2])
        assert calls["C"] == calls["Python"][:count]
        noises = [np.frombuffer(call)[params.n :] for call in calls["C"]]
        assert np.array_equal(np.transpose(noises), v[:, params.points.start :])
        calls["C"].clear()
        calls["Python"].clear()


@KINDS
def test_column_0_is_accessed_only_with_a_weight(library, params):
    c, bus = start(library, params)
    c.predict(0.1)
    c.update([0.1, 0.2])
    c.save()
    regions = MemoryMap(params)
    symbols = [symbol for symbol in ("X", "W", "V", "Z") if symbol in regions]
    columns = {
        symbol: {
            column
            for column in range(params.N)
            for entry in bus.log
            if entry[1] == regions.address(symbol, 0, column)
        }
        for symbol in symbols
    }
    assert columns == {symbol: set(params.points) for symbol in symbols}


@KINDS
def test_angles_are_wrapped_to_the_centre(library, params):
    """States, what is seen of them, and z, to what is expected; some points are far away.

    Point 0 and the last point are equal in all states, but not in the last noise.
    """
    seen = []

    def process(x, w, u):
        seen.append([9.0 * x[0] + 50.0, x[1] + u, x[2] + (w[0] if len(w) else 0.0)])
        return seen[-1]

    def observe(x, v):
        seen.append([x[1] + v[0], 7.0 * x[2] - 20.0 + 30.0 * v[1]])
        return seen[-1]

    bus = NotingBus(GoldenCore(params))
    angles = {"state_angles": (0,), "observation_angles": (1,)}
    c = CFilter(library(params), bus, params, process, observe, **angles)
    c.start(*problem(params).values())
    at, centre = slice(params.points.start, None), params.points.index(params.centre)
    bounds = 0
    # Words are read when a step starts: it changes what they are.
    read = {}

    def note(address, word):
        if address == CONTROL.offset and word & (CONTROL["PREDICT"].mask | CONTROL["UPDATE"].mask):
            read.update((symbol, held(bus, params, symbol)) for symbol in ("X", "Z", "z"))

    bus.on_write = note
    for call, symbol, row in (
        (lambda: c.predict(0.1), "X", 0), (lambda: c.update([0.3, 100.0]), "Z", 1),
    ):  # fmt: skip
        seen.clear()
        call()
        results = np.transpose(seen)
        turns = np.round((results[row] - results[row, centre]) / (2.0 * np.pi))
        expected = params.format.round(results[row] - 2.0 * np.pi * turns)
        assert np.array_equal(read[symbol][row, at], expected)
        bounds += np.count_nonzero(turns)
        off = np.abs(read[symbol][row, at] - read[symbol][row, params.centre])
        assert off.max() <= np.pi * (1.0 + 1e-6)
    assert bounds > 2
    others = 0
    for value in np.linspace(90.0, 110.0, 12):
        c.update([0.3, value])
        z, Z = read["z"][1, 0], read["Z"][1, at]
        expected = Z[centre] if params.W0 else Z.mean()
        assert abs(z - expected) <= np.pi * (1.0 + 1e-6)
        others += np.count_nonzero(np.abs(z - Z) > np.pi)
        turns = (value - z) / (2.0 * np.pi)
        assert abs(turns - round(turns)) < 1e-5
    assert others > 0


@KINDS
@pytest.mark.parametrize("redraw", [False, True], ids=["plain", "redrawing"])
def test_words_of_an_iteration(library, params, redraw):
    """Points with weight both ways, but of those that are read only those up to n + 1; x once."""
    c, bus = start(library, params, redraw=redraw)
    n, m, points = params.n, params.m, len(params.points)
    for k in range(3):
        before = len(bus.log)
        c.predict(0.1)
        c.update([0.1, 0.2])
        assert np.isfinite(c.x).all()
        entries = bus.log[before:]
        numbers = {
            kind: sum(
                entry[0] == kind and entry[1] >= MemoryMap(params).region_stride
                for entry in entries
            ) // params.format.bus_words
            for kind in ("read", "write")
        }  # fmt: skip
        drawn = n * (n + 2 - params.points.start)
        # Without W0, x is read beside the points: of the update that redraws, and at first.
        beside = n * (redraw + (k == 0)) if params.points.start else 0
        assert numbers["read"] == drawn * (1 + redraw) + beside + n
        assert numbers["write"] == points * (n + m) + m
        starts = [entry for entry in entries if entry[:2] == ("write", CONTROL.offset)]
        # SIG_GEN of the predict, PREDICT, UPDATE; SIG_GEN of the redraw, and of the update.
        assert len(starts) == 3 + 2 * redraw


# What is remembered of x.


def words_of_x(bus, params, call):
    """How many numbers of x a call reads."""
    places = {
        MemoryMap(params).address("x", 0, i) + 4 * word
        for i in range(params.n)
        for word in range(params.format.bus_words)
    }
    before = len(bus.log)
    call()
    reads = sum(entry[0] == "read" and entry[1] in places for entry in bus.log[before:])
    return reads // params.format.bus_words


#: What may change x, and what does not.
CHANGES = {
    "predict": lambda c: c.predict(0.2),
    "update": lambda c: c.update([0.3, 0.1]),
    "set_state": lambda c: setattr(c, "x", [0.25, 0.5, 0.75]),
    "start": lambda c: c.start(*(problem(c.params) | {"x0": [0.5, 0.25, 1.0]}).values()),
    "restore": lambda c: c.restore([0.5, 0.25, 1.0], np.eye(3)),
    "recover": lambda c: c.recover(),
    "predict and undo": lambda c: (c.predict(0.2), c.undo_predict()),
}
KEEPS = {
    "nothing": lambda c: None,
    "redraw": lambda c: c.redraw(),
    "gated update": lambda c: (c.set_gate(0.01), c.update([9.0, 9.0]), c.set_gate(np.inf)),
    "covariance": lambda c: c.P,
    "set_covariance": lambda c: setattr(c, "P", 2.0 * np.eye(3)),
    "set_noise": lambda c: c.set_noise(0.5 * np.eye(c.params.q), 0.5 * np.eye(c.params.r)),
    "save": lambda c: c.save(),
    "nothing sampled": lambda c: c.update([0.0, 0.0], np.zeros(2, dtype=bool)),
}


@KINDS
@pytest.mark.parametrize("predicted", [False, True])
@pytest.mark.parametrize("name", [*CHANGES, *KEEPS])
def test_x_is_read_once(library, params, predicted, name):
    """And again after whatever may change it; it is always that of the core."""
    c, bus = start(library, params)
    c.predict(0.1)
    c.update([0.1, 0.2])
    if predicted:
        c.predict(0.3)
    assert words_of_x(bus, params, lambda: c.x) == params.n
    assert words_of_x(bus, params, lambda: c.x) == 0
    (CHANGES | KEEPS)[name](c)
    found = []
    reads = words_of_x(bus, params, lambda: found.append(c.x))
    # A prediction that recovering leaves as it is has not been touched.
    changes = name in CHANGES and not (name == "recover" and predicted)
    assert reads == params.n * changes
    assert found[0].tobytes() == held(bus, params, "x")[0].tobytes()
    # The next predict reads it at most as column 0.
    assert words_of_x(bus, params, lambda: c.predict(0.1)) == 0
    c.undo_predict()
    assert c.x.tobytes() == found[0].tobytes() == held(bus, params, "x")[0].tobytes()


@pytest.mark.parametrize("params", [AUGMENTED, WEIGHTED], ids=["augmented", "W0"])
@pytest.mark.parametrize("which", ["f", "h"])
def test_a_step_that_was_refused_leaves_x_to_be_read_again(library, params, which):
    """With the accesses of the Python driver."""
    bad = {"f": False, "h": False}

    def process(x, w, u):
        return [1e300 if bad["f"] else x[0] + w[0], x[1] + w[1], x[2]]

    def observe(x, v):
        return [x[0] + v[0], (1e300 if bad["h"] else 1.0) * x[1] + v[1]]

    c, python, c_bus, python_bus = both_of(library, params, [process] * 2, [observe] * 2)
    for ukf in (c, python):
        ukf.predict(0.1)
        ukf.update([0.1, 0.2])
    assert same(c, python)
    before = c.x
    bad[which] = True
    for ukf, error in ((c, CFilterError), (python, NotFiniteError)):
        with pytest.raises(error):
            ukf.predict(0.1) if which == "f" else ukf.update([0.1, 0.2])
    bad[which] = False
    python._last_x = None
    assert words_of_x(c_bus, params, lambda: c.x) == params.n
    assert words_of_x(python_bus, params, lambda: python.x) == params.n
    assert c.x.tobytes() == python.x.tobytes() == before.tobytes()
    assert c_bus.log == python_bus.log


# Several sensors.


def terms_of(params):
    """Noise terms of the three sensors."""
    return params.sensor_rows if params.additive_r else (1, 2, 1)


def observations_of(params):
    """Models of the three sensors: each sees other states, with its own noise."""

    def model(sensor, rows):
        def observe(x, v):
            noise = sum((0.5 + i) * v[i] for i in range(len(v)))
            return [
                (0.5 + 0.2 * sensor) * x[(sensor + i) % len(x)] + (0.3 + i) * noise
                for i in range(rows)
            ]

        return observe

    return [model(sensor, rows) for sensor, rows in enumerate(params.sensor_rows)]


def block_of(params, size, scale):
    """A covariance; in binary64 a factor shows the order of summation, unless it is diagonal."""
    spread = 0.0 if params.format == BINARY64 else 0.3
    return 0.04 * scale * (np.diag(1.0 + np.arange(size)) + spread)


def blocks_of(params, scale=1.0):
    return [block_of(params, size, scale * (i + 1.0)) for i, size in enumerate(terms_of(params))]


def block_diagonal(blocks):
    R = np.zeros((sum(map(len, blocks)),) * 2)
    first = 0
    for block in blocks:
        R[first : first + len(block), first : first + len(block)] = block
        first += len(block)
    return R


def start_three(library, params, **options):
    """A C filter with three sensors, and its bus."""
    bus = NotingBus(GoldenCore(params))
    c = CFilter(
        library(params), bus, params, f, observations_of(params), terms=terms_of(params),
        observation_angles=(ANGLE,), **options,
    )  # fmt: skip
    data = problem(params)
    c.start(data["x0"], data["P0"], data["Q"], block_diagonal(blocks_of(params)))
    return c, bus


def both_of_three(library, params):
    """A C filter and a Python filter, with the names of the sensors, and buses."""
    c, c_bus = start_three(library, params, redraw=bool(params.additive_q))
    data = problem(params)
    del data["R"]
    sensors = {
        name: Sensor(model, R=R, m=rows, angles=(0,) if name == "b" else ())
        for name, model, R, rows in zip(
            "abc", observations_of(params), blocks_of(params), params.sensor_rows, strict=True
        )
    }
    same_problem = Problem(
        name="three", f=f, sensors=sensors, state_angles=(), **data, **core_of(params)
    )
    python_bus = NotingBus(GoldenCore(params))
    python = UnscentedKalmanFilter(same_problem, Driver(python_bus, params))
    return c, python, c_bus, python_bus


@pytest.mark.parametrize(
    "params", [THREE, THREE_ADDITIVE, THREE_WIDE, THREE_WEIGHTED],
    ids=["augmented", "additive", "binary64", "W0"],
)  # fmt: skip
def test_three_sensors_are_those_of_the_python_driver(library, params):
    """Every access: updates of some sensor in any order, with masks, gates, and other noise."""
    c, python, c_bus, python_bus = both_of_three(library, params)
    rng = np.random.default_rng(11)
    seen, gated = set(), 0
    for k in range(60):
        recovers = k % 13 == 9
        if recovers:
            python.recover()
            c.recover()
        if recovers or rng.random() < 0.6:
            u = float(rng.standard_normal())
            c.predict(u)
            python.predict(u)
        sensor = int(rng.integers(3))
        rows = params.sensor_rows[sensor]
        z = 2.0 * rng.standard_normal(rows)
        if sensor == 1:
            z += 40.0  # some turns
        mask = rng.random(rows) < 0.7
        z[~mask] = np.nan
        gate = 0.2 if rng.random() < 0.2 else np.inf
        if gate != python.gate:
            python.gate = gate
            c.set_gate(gate)
        corrected = python.update(z, mask, sensor="abc"[sensor])
        assert c.update(z, mask, sensor=sensor) == corrected
        assert c.gated == python.gated
        gated += python.gated
        if python.nis is not None:
            assert c.nis == python.nis
        seen.add((sensor, *mask))
        if k % 7 == 3:
            R = block_of(params, terms_of(params)[sensor], 1.0 + rng.random())
            python.set_R(R, "abc"[sensor])
            c.set_sensor_noise(sensor, R)
        if k == 20:
            Q, R = 0.02 * np.eye(params.q), block_diagonal(blocks_of(params, 1.5))
            python.Q = Q
            c.set_noise(Q, python.R)
            python.R = R
            c.set_noise(Q, R)
        assert same(c, python)
        if k % 6 == 5:
            python._last_P = None
            assert c.P.tobytes() == python.P.tobytes()
    assert len(seen) > 8
    assert gated > 1
    assert c_bus.log == python_bus.log
    assert not c.exceptions


@pytest.mark.parametrize("params", [THREE, THREE_ADDITIVE], ids=["augmented", "additive"])
def test_other_noise_of_a_sensor_is_written_where_it_differs(library, params):
    c, bus = start_three(library, params)
    regions = MemoryMap(params)
    terms = terms_of(params)
    for sensor, size in enumerate(terms):
        R = block_of(params, size, 7.0)
        for changes in (True, False):
            before = len(bus.log)
            c.set_sensor_noise(sensor, R)
            written = [entry[1] for entry in bus.log[before:] if entry[0] == "write"]
            assert [address for address in written if address >= regions.region_stride] == [
                regions.address("LR", sum(terms[:sensor]) + i, j)
                for i in range(changes * size)
                for j in range(regions["LR"].columns)
            ]


@pytest.mark.parametrize("params", [THREE, THREE_ADDITIVE], ids=["augmented", "additive"])
def test_sensors_are_checked(library, params):
    """Before the first write: a number, their R, their noise terms and models, and the core's."""
    c, bus = start_three(library, params)
    data = problem(params)
    R = block_diagonal(blocks_of(params))
    R[0, -1] = R[-1, 0] = 1e-30
    before = len(bus.log)
    for call in (
        lambda: c.update(np.zeros(1), sensor=3),
        lambda: c.update(np.zeros(1), np.zeros(1, dtype=bool), sensor=3),
        lambda: c.update(np.zeros(1), sensor=2**32 - 1),
        lambda: c.update([np.nan], sensor=1),
        lambda: c.set_sensor_noise(3, np.eye(1)),
        lambda: c.set_sensor_noise(0, None),
        lambda: c.set_sensor_noise(0, -np.eye(2)),
        lambda: c.set_sensor_noise(1, np.full((2, 2), np.nan)),
        lambda: c.set_noise(data["Q"], R),
        lambda: c.start(data["x0"], data["P0"], data["Q"], R),
    ):
        assert failing(call).result is Result.BAD_ARGUMENT
    assert len(bus.log) == before
    assert not c.doubtful


@pytest.mark.parametrize("terms", [(1, 2, 2), (1, 2, 0), (2**32 - 1, 2, 3)])
def test_the_noise_terms_of_the_sensors_must_be_those_of_the_core(library, terms):
    bus = NotingBus(GoldenCore(THREE))
    error = failing(
        lambda: CFilter(library(THREE), bus, THREE, f, observations_of(THREE), terms=terms)
    )
    assert error.result is Result.BAD_ARGUMENT
    assert not bus.log


@pytest.mark.parametrize("missing", [0, 2])
def test_a_sensor_without_a_model_is_refused(library, missing):
    bus = NotingBus(GoldenCore(THREE))
    models = observations_of(THREE)
    models[missing] = None
    error = failing(lambda: CFilter(library(THREE), bus, THREE, f, models, terms=terms_of(THREE)))
    assert error.result is Result.BAD_ARGUMENT
    assert not bus.log


def test_cores_with_other_sensors_are_refused(library):
    """The same sizes and places, but other rows."""
    other = replace(THREE_ADDITIVE, sensors=(3, 1, 2))
    bus = NotingBus(GoldenCore(other))
    error = failing(
        lambda: CFilter(
            library(THREE_ADDITIVE), bus, THREE_ADDITIVE, f, observations_of(THREE_ADDITIVE)
        )
    )
    assert error.result is Result.WRONG_SIZES
    assert error.fault["address"] == SENSORS.offset
    assert (error.fault["expected"], error.fault["found"]) == (0b001101, 0b011001)


def test_a_singular_row_is_one_of_all_of_z(library):
    bus = NotingBus(GoldenCore(THREE))
    models = observations_of(THREE)
    models[2] = lambda x, v: [x[0] + v[0], x[1] + v[0], 0.0]
    c = CFilter(library(THREE), bus, THREE, f, models, terms=terms_of(THREE))
    data = problem(THREE)
    c.start(data["x0"], data["P0"], data["Q"], block_diagonal(blocks_of(THREE)))
    error = failing(lambda: c.update(np.zeros(3), sensor=2))
    assert (error.result, error.fault["index"]) == (Result.SINGULAR_OBSERVATION, 5)


def test_masks_of_other_sensors_stay(library):
    """All ones at first, and after a reset of the core."""
    c, bus = start_three(library, THREE)
    masks = []
    bus.on_write = lambda address, word: address == MASK.offset and masks.append(word)
    for sensor, mask in ((1, [1]), (0, [0, 1]), (2, [1, 0, 1]), (0, [0, 1]), (0, [1, 1])):
        c.update(np.zeros(len(mask)), np.array(mask, dtype=bool), sensor=sensor)
    assert masks == [0b111111, 0b111110, 0b101110, 0b101111]
    c.recover()
    c.update(np.zeros(1), sensor=1)
    assert masks[4:] == [0b111111]


def test_redrawing_gives_the_same_estimates(library):
    c, python, c_bus, python_bus = both(library, MIXED, redraw=True)
    plain = python_filter(MIXED, "golden", redraw=False)
    for k in range(8):
        z = np.array([np.sin(k), np.cos(k)])
        for ukf in (c, python, plain):
            ukf.predict(0.1)
            ukf.update(z)
        assert same(c, python)
    assert c_bus.log == python_bus.log
    assert (plain.x != python.x).any()


def test_nothing_sampled_is_no_access(library):
    c, bus = start(library, AUGMENTED)
    c.predict(0.0)
    before = len(bus.log)
    assert not c.update([np.nan, np.nan], np.zeros(2, dtype=bool))
    assert len(bus.log) == before


def test_code_for_one_core_drives_another(library):
    """Sizes are those of the description at run time, so two cores share the code."""
    bus = NotingBus(GoldenCore(AUGMENTED))
    c = CFilter(library(SMALLEST), bus, AUGMENTED, f, h, core=library(AUGMENTED))
    own, _ = start(library, AUGMENTED)
    small, _ = start(library, SMALLEST)
    data = problem(AUGMENTED)
    c.start(data["x0"], data["P0"], data["Q"], data["R"])
    for ukf in (c, own):
        ukf.predict(0.5)
        small.predict(0.5)
        ukf.update([0.1, 0.2])
    small.update([0.1])
    assert c.x.tobytes() == own.x.tobytes()


def test_the_driver_knows_the_processing_elements(library):
    c, _ = start(library, AUGMENTED, core=GoldenCore(UkfParams(n=3, m=2, q=2, r=2, pes=3)))
    assert c.pes == 3


# Numbers.


@pytest.mark.parametrize("params", [AUGMENTED, MIXED], ids=["binary32", "binary64"])
def test_rounding_is_that_of_the_format(library, params):
    c, _ = start(library, params)
    number_format = params.format
    rng = np.random.default_rng(1)
    tiny = number_format.min_normal
    edges = [tiny, tiny * (1 - 2.0**-24), tiny * (1 - 2.0**-25), tiny * (1 - 2.0**-26), tiny / 2]
    edges += [number_format.max_finite, 5e-324, 0.0, np.inf, 1.0 + 2.0**-24, 1.0 + 3 * 2.0**-24]
    if number_format == BINARY32:
        edges += [number_format.max_finite * (1 + 2.0**-25), number_format.max_finite * 1.5]
    values = np.concatenate((
        edges, np.ldexp(rng.standard_normal(2000), rng.integers(-160, 130, 2000)),
        tiny * (1 + rng.uniform(-(2.0**-22), 2.0**-22, 500)), [np.nan],
    ))  # fmt: skip
    values = np.concatenate((values, -values))
    found = np.array([c.round(value) for value in values])
    expected = number_format.round(values)
    assert (number_format.encode(found) == number_format.encode(expected)).all()
    assert (np.signbit(found) == np.signbit(expected))[~np.isnan(values)].all()
    assert (expected == 0.0).sum() > 100
    if number_format == BINARY32:
        assert (expected != values).sum() > 1000


def factor_in_c(library, A):
    B = np.full_like(A, np.nan)
    return B if call_with_matrices(library.ukf_lower_factor, A, B) else None


def is_definite_in_c(library, A):
    return call_with_matrices(library.ukf_is_definite, A, np.empty_like(A))


def call_with_matrices(function, A, B):
    function.restype = ctypes.c_bool
    return function(len(A), *(ctypes.c_void_p(matrix.ctypes.data) for matrix in (A, B)))


#: Both types of ukf_real, with the flags of the compiler.
REALS = [
    pytest.param(np.float64, (), id="double"),
    pytest.param(np.float32, ("-DUKF_REAL=float",), id="float"),
]


@pytest.mark.parametrize("size", [1, 2, 7, 32])
def test_factors_are_those_of_python(library, size):
    rng = np.random.default_rng(size)
    for rank in {size, max(size - 1, 1), (size + 1) // 2}:
        G = rng.standard_normal((size, rank))
        if rank < size:
            G[rng.integers(size)] = 0.0  # a state without uncertainty
        A = G @ G.T
        B = factor_in_c(library(SMALLEST), A)
        assert B is not None
        assert np.abs(B @ B.T - A).max() <= 1e-12 * max(np.abs(A).max(), 1.0)
        assert (np.triu(B, 1) == 0.0).all()
        if rank == size:
            assert np.allclose(B, lower_factor(A), rtol=1e-8, atol=1e-12)
    diagonal = np.diag(rng.uniform(0.0, 2.0, size))
    diagonal[0, 0] = 0.0
    assert np.allclose(
        factor_in_c(library(SMALLEST), diagonal), lower_factor(diagonal), rtol=1e-15, atol=0.0
    )
    assert factor_in_c(library(SMALLEST), -np.eye(size)) is None
    if size > 1:
        indefinite = np.eye(size)
        indefinite[0, 1] = indefinite[1, 0] = 2.0
        assert factor_in_c(library(SMALLEST), indefinite) is None
        indefinite[0, 0] = 0.0
        assert factor_in_c(library(SMALLEST), indefinite) is None


@pytest.mark.parametrize(("dtype", "flags"), REALS)
def test_every_covariance_has_a_factor(library, dtype, flags):
    """As in Python, of all ranks and scales; each element beside the deviations of its place."""
    compiled = library(SMALLEST, flags)
    epsilon = float(np.finfo(dtype).eps)
    singular = 0
    for A in random_covariances(dtype):
        B = factor_in_c(compiled, A)
        assert B is not None, A
        assert not np.triu(B, 1).any()
        wide, factor = A.astype(np.float64), B.astype(np.float64)
        deviations = np.sqrt(np.diag(wide))
        limit = (len(A) + 1) * epsilon * np.outer(deviations, deviations)
        assert (np.abs(factor @ factor.T - wide) <= limit).all()
        try:
            check_definite(wide, epsilon)
        except IndefiniteError:
            singular += 1
            assert not is_definite_in_c(compiled, A)
        else:
            assert is_definite_in_c(compiled, A)
    assert 100 < singular < 300


@pytest.mark.parametrize(("dtype", "flags"), REALS)
@pytest.mark.parametrize("size", [2, 5, 13])
def test_what_is_refused_is_refused_by_python(library, dtype, flags, size):
    """Matrices whose smallest eigenvalue is a little below zero, or above."""
    compiled = library(SMALLEST, flags)
    epsilon = float(np.finfo(dtype).eps)
    rng = np.random.default_rng(size)
    ones = np.ones((size, 1)) / np.sqrt(size)
    scales = np.ldexp(1.0, rng.integers(-9, 9, size))
    for part in (-4.0, -1.5, -0.6, 0.0, 0.6, 1.5):
        # All eigenvalues but one are equal, and so are the diagonal elements, just below 1.
        A = 0.9 * (np.eye(size) - ones @ ones.T) * size / (size - 1)
        A += part * rounding_errors(size, epsilon) * np.eye(size)
        A = (A * np.outer(scales, scales)).astype(dtype)
        accepted = definite = True
        try:
            lower_factor(A.astype(np.float64), epsilon)
        except IndefiniteError:
            accepted = False
        try:
            check_definite(A.astype(np.float64), epsilon)
        except IndefiniteError:
            definite = False
        assert (factor_in_c(compiled, A) is not None) == accepted == (part > -1.0)
        assert is_definite_in_c(compiled, A) == definite == (part > 1.0)


def test_ordinary_singular_covariances_are_accepted(library):
    """A small pivot magnifies the rounding errors of those after it."""
    G = np.array([[-0.8, -0.49], [-0.98, -0.62], [-1.0, 0.37]])
    Q = G @ G.T
    c, _ = start(library, MIXED)
    data = problem(MIXED)
    c.start(data["x0"], Q, Q, data["R"])
    assert np.allclose(c.P, Q, rtol=1e-14)
    c.set_noise(Q, data["R"])


# What can go wrong.


def failing(call, *arguments):
    """Call something that must fail; gives the error."""
    with pytest.raises(CFilterError) as caught:
        call(*arguments)
    return caught.value


CHECKED = [
    (ID, "MAGIC", Result.WRONG_ID),
    (ID, "VERSION", Result.WRONG_ID),
    *((SIZES, name, Result.WRONG_SIZES) for name in "NQRM"),
    (SENSORS, "SENSORS", Result.WRONG_SIZES),
    *(
        (CONFIG, name, Result.WRONG_FORMAT)
        for name in (
            "EXPONENT_BITS", "FRACTION_BITS", "COVARIANCE_FORM", "ADDITIVE_Q", "ADDITIVE_R",
        )
    ),
]  # fmt: skip


@pytest.mark.parametrize(("register", "name", "result"), CHECKED)
def test_a_wrong_core_is_refused(library, register, name, result):
    bus = NotingBus(GoldenCore(AUGMENTED))
    right = bus.bus.read(register.offset)
    field = register[name]
    bus.lies[register.offset] = right ^ (1 << field.lsb)
    error = failing(lambda: CFilter(library(AUGMENTED), bus, AUGMENTED, f, h))
    assert error.result is result
    assert error.fault["address"] == register.offset
    assert error.fault["expected"] == field.get(right)
    assert error.fault["found"] == field.get(right) ^ 1
    assert all(kind == "read" for kind, *_ in bus.log), "nothing was written to it"


@pytest.mark.parametrize("options", [{"timeout_us": 0}, {"short": 1}])
def test_opening_checks_its_arguments(library, options):
    bus = NotingBus(GoldenCore(AUGMENTED))
    error = failing(lambda: start(library, AUGMENTED, bus=bus, **options))
    assert error.result is Result.BAD_ARGUMENT
    assert not bus.log


@pytest.mark.parametrize("offset", [ID.offset, SIZES.offset, CONFIG.offset, CONTROL.offset])
def test_a_refused_access_is_told_when_opening(library, offset):
    bus = NotingBus(GoldenCore(AUGMENTED))
    bus.refuse = offset
    error = failing(lambda: CFilter(library(AUGMENTED), bus, AUGMENTED, f, h))
    assert (error.result, error.fault["address"]) == (Result.BUS_ERROR, offset)


@pytest.mark.parametrize("symbol", ["X", "Z", "z", "x"])
def test_a_refused_access_is_told_while_running(library, symbol):
    c, bus = start(library, AUGMENTED)
    region = MemoryMap(AUGMENTED)[symbol]
    place = MemoryMap(AUGMENTED).address(symbol, region.rows - 1, region.columns - 1)

    def iterate():
        c.predict(0.1)
        c.update([0.1, 0.2])
        return c.x

    bus.refuse = place
    error = failing(iterate)
    assert (error.result, error.fault["address"]) == (Result.BUS_ERROR, place)
    bus.refuse = None
    assert c.doubtful == (symbol != "x")
    c.recover()
    iterate()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("x0", [np.nan, 0.0, 0.0]),
        ("P0", -np.eye(3)),
        ("P0", np.array([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]])),
        ("P0", np.array([[1e12, 0.0, 0.0], [0.0, 1.0, 0.9], [0.0, -0.9, 1.0]])),
        ("P0", np.array([[1e12, 0.0, 0.0], [0.0, 1.0, 2e-9], [0.0, 0.0, 1.0]])),
        ("P0", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1e-300], [0.0, 0.0, 1.0]])),
        ("P0", np.diag([1.0, np.inf, 1.0])),
        ("Q", None),
        ("Q", -np.eye(2)),
        ("R", np.full((2, 2), np.nan)),
    ],
)
def test_starting_checks_its_arguments_before_it_writes(library, name, value):
    c, bus = start(library, AUGMENTED)
    data = problem(AUGMENTED) | {name: value}
    before = len(bus.log)
    error = failing(c.start, data["x0"], data["P0"], data["Q"], data["R"])
    assert error.result is Result.BAD_ARGUMENT
    assert len(bus.log) == before


def test_what_is_nearly_symmetric_is_taken_as_its_mean(library):
    """As in Python: bit for bit."""
    c, python, c_bus, python_bus = both(library, AUGMENTED)
    P = np.diag([1e12, 1.0, 1e-12])
    P[0, 1], P[1, 0], P[2, 1] = 1e5, 1e5 + 9e-4, 9e-16
    for ukf in (c, python):
        ukf.P = P
        ukf.redraw()
    assert c_bus.log == python_bus.log
    assert c.P[1, 0] == c.P[0, 1]


@pytest.mark.parametrize("flags", [(), FAST], ids=["O2", "Ofast"])
def test_settings_check_their_arguments(library, flags):
    """Before the first write; also if the compiler may take all numbers for finite."""
    c, bus = start(lambda params: library(params, flags), AUGMENTED)
    before = len(bus.log)
    for call in (
        lambda: setattr(c, "x", [0.0, np.inf, 0.0]),
        lambda: setattr(c, "x", [0.0, np.nan, 0.0]),
        lambda: setattr(c, "x", [0.0, 1e39, 0.0]),
        lambda: setattr(c, "P", 1e80 * np.eye(3)),
        lambda: setattr(c, "P", np.full((3, 3), np.nan)),
        lambda: c.set_noise(np.eye(2), 1e80 * np.eye(2)),
        lambda: c.start([0.0, 1e39, 0.0], np.eye(3), np.eye(2), np.eye(2)),
        lambda: c.restore([0.0, np.nan, 0.0], np.eye(3)),
        lambda: c.restore([0.0, 0.0, 0.0], 1e39 * np.eye(3)),
        lambda: setattr(c, "P", -np.eye(3)),
        lambda: c.set_noise(-np.eye(2), np.eye(2)),
        lambda: c.set_gate(-1.0),
        lambda: c.set_gate(np.nan),
        lambda: c.update([np.nan, 0.0]),
    ):
        assert failing(call).result is Result.BAD_ARGUMENT
    assert len(bus.log) == before
    assert not c.doubtful


@pytest.mark.parametrize("flags", [(), FAST], ids=["O2", "Ofast"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_results_of_models_are_checked(library, flags, value):
    bad = {"f": False, "h": False}

    def process(x, w, u):
        return [value if bad["f"] else x[0], *f(x, w, u)[1:]]

    def observe(x, v):
        return [x[0], value if bad["h"] else x[1] + v[0]]

    bus = NotingBus(GoldenCore(AUGMENTED))
    c = CFilter(library(AUGMENTED, flags), bus, AUGMENTED, process, observe)
    c.start(*problem(AUGMENTED).values())
    for name, call in (("f", c.predict), ("h", lambda: c.update([0.0, 0.0]))):
        bad[name] = True
        assert failing(call).result is Result.BAD_MODEL
        bad[name] = False


@pytest.mark.parametrize(
    ("params", "gate", "held"),
    [(AUGMENTED, 1e39, BINARY32.max_finite), (AUGMENTED, np.inf, np.inf), (MIXED, 1e39, 1e39)],
)
def test_a_finite_gate_stays_finite(library, params, gate, held):
    """One that binary32 cannot hold is its largest number: what is above it is gated still."""
    c, bus = start(library, params)
    c.set_gate(gate)
    words = [bus.bus.read(register.offset) for register in (GATE_LOW, GATE_HIGH)]
    word = words[0] if params.format == BINARY32 else words[0] | words[1] << 32
    assert params.format.decode(np.array([word], dtype=np.uint64))[0] == held


@pytest.mark.parametrize("params", [AUGMENTED, MIXED], ids=["binary32", "binary64"])
def test_a_gate_rejects_a_z_beyond_the_format(library, params):
    """With the accesses of the Python driver; without a gate binary32 has no such number."""
    c, python, c_bus, python_bus = both(library, params)
    mask = np.ones(params.m, dtype=bool)
    for gate, large in ((10.0, 1e39), (1e39, -1e200)):
        z = np.zeros(params.m)
        z[0] = large
        python.gate = gate
        c.set_gate(gate)
        assert c.update(z, mask) == python.update(z, mask)
        assert c.gated
        assert python.gated
        assert c.nis == python.nis
    assert c_bus.log == python_bus.log
    if params.format == BINARY32:
        c.set_gate(np.inf)
        assert failing(c.update, z, mask).result is Result.NOT_FINITE


def test_the_covariance_form_needs_a_definite_covariance(library):
    c, _ = start(library, COVARIANCE)
    data = problem(COVARIANCE)
    P = np.diag([1.0, 0.0, 1.0])
    assert failing(c.start, data["x0"], P, data["Q"], data["R"]).result is Result.BAD_ARGUMENT
    square_root, _ = start(library, AUGMENTED)
    data = problem(AUGMENTED)
    square_root.start(data["x0"], P, data["Q"], data["R"])


@pytest.mark.parametrize("interrupt", [False, True], ids=["polling", "interrupt"])
def test_a_core_that_never_finishes(library, interrupt):
    """A time-out; then, after recovering, all is as if the lost sample had not been."""
    core = GoldenCore(AUGMENTED)
    bus = NotingBus(core)
    wait = bus.bus.wait_for_interrupt if interrupt else None
    c, _ = start(library, AUGMENTED, bus=bus, interrupt=wait, timeout_us=20_000, clock=Clock())
    other, _ = start(library, AUGMENTED)
    for ukf in (c, other):
        ukf.predict(0.1)
        ukf.update([0.1, 0.2])
    core.hold = True
    error = failing(c.predict, 0.2)
    assert error.result is Result.TIMEOUT
    assert error.fault["step"] == error.fault["state"] == Step.PREDICT
    assert bus.log[-1][:2] == ("read", STATUS.offset), "after the time it looks once more"
    assert failing(c.predict, 0.2).result is Result.NOT_RECOVERED
    core.hold = False
    c.recover()
    other.recover()
    for ukf in (c, other):
        ukf.predict(0.3)
        ukf.update([0.2, 0.1])
    assert c.x.tobytes() == other.x.tobytes()
    assert c.P.tobytes() == other.P.tobytes()


def test_a_step_that_has_ended_is_in_time(library):
    """An interrupt that is lost, and a processor that was busy for longer than the time-out."""
    late = {"clock": 0.0}

    def clock():
        late["clock"] += 1.0
        return late["clock"]

    for interrupt in (None, lambda seconds: False):
        c, _ = start(library, AUGMENTED, interrupt=interrupt, timeout_us=1000, clock=clock)
        c.predict(0.1)
        c.update([0.1, 0.2])


@pytest.mark.parametrize("interrupt", [None, lambda seconds: True], ids=["polling", "interrupt"])
@pytest.mark.parametrize(("timeout_us", "polls"), [(1, 1000), (50, 5000)])
def test_polls_are_bounded_if_the_clock_stands_still(library, interrupt, timeout_us, polls):
    core = GoldenCore(AUGMENTED)
    c, bus = start(
        library, AUGMENTED, core=core, interrupt=interrupt, timeout_us=timeout_us,
        clock=lambda: 0.0,
    )  # fmt: skip
    c.redraw()
    core.hold = True
    before = len(bus.log)
    assert failing(c.predict, 0.1).result is Result.TIMEOUT
    assert sum(entry[:2] == ("read", STATUS.offset) for entry in bus.log[before:]) == polls + 1


def test_a_fast_bus_is_polled_for_the_whole_time_out(library):
    """As a simulated one with 46 ns a word, by both drivers: 69 of 100 microseconds."""
    for language in ("C", "Python"):
        core = GoldenCore(AUGMENTED)
        bus = NotingBus(core)
        clock = partial(lambda log: 46e-9 * len(log), bus.log)
        if language == "C":
            ukf, _ = start(library, AUGMENTED, bus=bus, timeout_us=100, clock=clock)
        else:
            driver = Driver(bus, AUGMENTED, timeout=100e-6, clock=clock)
            ukf = python_filter(AUGMENTED, driver)
        ukf.redraw()
        core.hold = True
        polls = itertools.count()
        read = bus.read

        def finish_late(address, read=read, polls=polls, core=core):
            if address == STATUS.offset and next(polls) == 1500:
                core.finish()
            return read(address)

        bus.read = finish_late
        ukf.predict(0.1)
        assert next(polls) > 1500


@pytest.mark.parametrize("what", ["x", "P"])
def test_an_assignment_forgets_the_predicted_points(library, what):
    """An update that follows draws new ones, as in Python."""
    c, python, c_bus, python_bus = both(library, AUGMENTED)
    n, m = AUGMENTED.n, AUGMENTED.m
    value = {"x": np.linspace(0.5, 1.0, n), "P": 2.0 * np.eye(n)}[what]
    for ukf in (c, python):
        ukf.predict(0.3)
        setattr(ukf, what, value)
        ukf.update(np.ones(m))
    assert same(c, python)
    assert c_bus.log == python_bus.log


def test_restoring_forgets_a_prediction(library):
    c, _ = start(library, AUGMENTED)
    saved = c.save()
    c.predict(0.9)
    c.restore(*saved)
    c.update([0.1, 0.2])
    other, _ = start(library, AUGMENTED)
    other.update([0.1, 0.2])
    assert c.x.tobytes() == other.x.tobytes()


def test_a_step_that_somebody_dropped(library):
    c, bus = start(library, AUGMENTED)

    def reset(address, word):
        if address == CONTROL.offset and word & CONTROL["PREDICT"].mask:
            bus.bus.write(CONTROL.offset, 0b11)

    bus.on_write = reset
    error = failing(c.predict, 0.1)
    assert (error.result, error.fault["step"]) == (Result.STEP_LOST, Step.PREDICT)
    bus.on_write = None
    c.recover()
    c.predict(0.1)


def test_an_illegal_step(library):
    """Somebody else used the core's points; the driver's PREDICT then comes out of sequence."""
    c, bus = start(library, AUGMENTED)
    place = MemoryMap(AUGMENTED).address("X", 0, AUGMENTED.points.start)
    x = MemoryMap(AUGMENTED).address("x", 0, 0)

    def meddle(address, word):
        if address == place:
            bus.bus.write(x, 0)

    bus.on_write = meddle
    error = failing(c.predict, 0.1)
    assert (error.result, error.fault["step"]) == (Result.ILLEGAL_STEP, Step.PREDICT)
    bus.on_write = None
    c.recover()
    c.predict(0.1)


@pytest.mark.parametrize(
    ("code", "result"),
    [(max(ErrorCode) + 1,) * 2, (63, 63), (64, Result.UNKNOWN_ERROR), (255, Result.UNKNOWN_ERROR)],
)
def test_an_error_that_nobody_knows(library, code, result):
    """A code of the core is the result, also if nobody has named it; results of the driver are not
    mistaken for it.
    """
    c, bus = start(library, AUGMENTED)
    bus.lies[ERROR.offset] = code | 5 << 8
    error = failing(c.predict, 0.1)
    assert error.result == result
    assert (error.fault["code"], error.fault["index"]) == (code, 5)
    assert (error.fault["step"], c.result_name(error.result)) == (Step.SIG_GEN, "unknown error")


def test_codes_of_the_core_and_results_of_the_driver_are_apart():
    assert all(code < Result.UNKNOWN_ERROR for code in ErrorCode)
    names = {code.name for code in ErrorCode} - {"NONE"}
    assert {result.name for result in Result if result < Result.UNKNOWN_ERROR} == names | {"OK"}
    assert all(Result[name] == ErrorCode[name] for name in names)


def test_an_overflow(library):
    """A finite number that binary32 cannot hold; the estimate stays."""
    c, _ = start(library, AUGMENTED, observe=lambda x, v: [1e300 + x[0], x[1] + v[0]])
    c.predict(0.1)
    before = c.x
    error = failing(c.update, [0.0, 0.0])
    assert (error.result, error.fault["step"]) == (Result.NOT_FINITE, Step.UPDATE)
    assert error.fault["code"] == ErrorCode.NOT_FINITE
    assert (c.x == before).all()
    c.update([0.0, 0.0], np.array([False, True]))
    assert (c.x != before).any()


def test_a_singular_observation(library):
    c, _ = start(library, AUGMENTED, observe=lambda x, v: [x[0] + v[0], 1.0])
    c.predict(0.1)
    before = c.x
    error = failing(c.update, [0.0, 0.0])
    assert error.result is Result.SINGULAR_OBSERVATION
    assert (error.fault["step"], error.fault["index"]) == (Step.UPDATE, 1)
    assert (c.x == before).all()
    c.update([0.0, 0.0], np.array([True, False]))


@pytest.mark.parametrize("noise", Noise)
def test_a_row_that_is_constant_and_has_no_noise(library, noise):
    """The core is not asked: the rounding error of the mean would look like a variance."""
    params = replace(AUGMENTED, observation_noise=noise)
    c, bus = start(library, params, observe=lambda x, v: [x[0] + v[0], 0.1])
    if noise is Noise.ADDITIVE:
        c.update([0.0, 0.0])  # its noise is not zero
        c.set_noise(problem(params)["Q"], np.diag([0.1, 0.0]))
    c.predict(0.1)
    before, accesses = c.x, len(bus.log)
    error = failing(c.update, [0.0, 0.0])
    assert len(bus.log) == accesses
    assert error.result is Result.SINGULAR_OBSERVATION
    assert (error.fault["step"], error.fault["index"]) == (Step.UPDATE, 1)
    assert (c.x == before).all()
    c.update([0.0, 0.0], np.array([True, False]))


def test_a_covariance_that_is_not_positive_definite(library):
    """In the covariance form, a state that is known exactly has no factor."""
    bus = NotingBus(GoldenCore(COVARIANCE))
    c = CFilter(
        library(COVARIANCE), bus, COVARIANCE,
        lambda x, w, u: [x[0], 1.0, x[2]], lambda x, v: [x[0] + v[0], x[2]],
    )  # fmt: skip
    data = problem(COVARIANCE)
    c.start(data["x0"], data["P0"], np.zeros((3, 3)), data["R"])
    error = failing(lambda: (c.predict(0.0), c.redraw()))
    assert error.result is Result.NOT_POSITIVE_DEFINITE
    assert (error.fault["step"], error.fault["index"]) == (Step.SIG_GEN, 1)


@pytest.mark.parametrize("params", [AUGMENTED, WEIGHTED], ids=["augmented", "W0"])
@pytest.mark.parametrize("which", ["f", "h"])
@pytest.mark.parametrize("kind", ["exception", "not finite"])
def test_a_model_without_a_result(library, params, which, kind):
    """The fault has the number of the sigma point: that of the third one with a weight."""
    calls = []

    def breaking(model):
        def broken(*arguments):
            calls.append(arguments)
            values = np.asarray(model(*arguments))
            if len(calls) == 3:
                if kind == "exception":
                    raise ArithmeticError("on purpose")
                values[1] = np.inf
            return values

        return broken

    bus = NotingBus(GoldenCore(params))
    c = CFilter(
        library(params), bus, params,
        breaking(f) if which == "f" else f, breaking(h) if which == "h" else h,
    )  # fmt: skip
    data = problem(params)
    c.start(data["x0"], data["P0"], data["Q"], data["R"])
    before = c.x

    def iterate():
        c.predict(0.1)
        c.update([0.1, 0.2])

    error = failing(iterate)
    assert (error.result, error.fault["point"]) == (Result.BAD_MODEL, params.points[2])
    if kind == "not finite":
        assert error.fault["index"] == 1
    if which == "f":
        assert (c.x == before).all()
    assert bool(c.exceptions) == (kind == "exception")
    iterate()


def test_results_have_names(library):
    c, _ = start(library, SMALLEST)
    names = {c.result_name(result) for result in Result}
    assert len(names) == len(Result)
    assert c.result_name(max(Result) + 1) == c.result_name(1000) == "not a result"


def test_status_is_polled_with_the_bits_of_the_map(library):
    """A core that says it is busy for a while is waited for."""
    c, bus = start(library, AUGMENTED)
    looks = []
    read = bus.read

    def busy(address):
        word = read(address)
        if address == STATUS.offset and len(looks) < 5:
            looks.append(word)
            return word | Step.SIG_GEN << STATUS["STATE"].lsb
        return word

    bus.read = busy
    c.predict(0.1)
    assert len(looks) == 5
