"""Many samples at once: all is as if they had been done one by one."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from support.model_cores import model_core
from ukf_sw.backends import golden_driver
from ukf_sw.drivers.bus import Script, Start
from ukf_sw.errors import EstimateLostError, NotRecoveredError, UkfError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problems.finding import find
from ukf_sw.problems.running import run
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form
from ukf_sw.spec.registers import CONTROL, INTERRUPT_PENDING, REGISTERS
from ukf_sw.spec.sequence import Flag, Step

STEPS = 40


@cache
def scenario(name):
    return find(name).scenario(0, STEPS)


def core_of(driver):
    return driver._bus.core


def everything(driver):
    """What can be seen of a core and its driver."""
    core = core_of(driver)
    return (
        [core.read(register.offset) for register in REGISTERS], core.flags, core.banks,
        core.engine.memory.tolist(), driver.traffic,
    )  # fmt: skip


class Samples:
    """The data of a problem as a filter is given them, and a filter for them."""

    def __init__(self, name, *, models=("f", "h"), gate=None, **values):
        self.problem = scenario(name)
        self.params = model_core(name, models, **values)
        self.driver = golden_driver(self.params)
        problem = replace(self.problem, form=self.params.form, format=self.params.format)
        self.ukf = UnscentedKalmanFilter(problem, self.driver)
        if gate is not None:
            self.ukf.gate = gate
        data = self.problem.record
        self.inputs = data.inputs if data.inputs is not None else [None] * STEPS
        self.observations = [
            tuple(part.copy() for part in self.problem.samples(sensor))
            for sensor in self.problem.sensor_names
        ]
        extra = data.observation_arguments
        self.arguments = [{}] * STEPS if extra is None else list(extra)

    def ahead(self, start, stop):
        """Do some at once."""
        there = slice(start, stop)
        observations = [(z[there], sampled[there]) for z, sampled in self.observations]
        return self.ukf.iterate_ahead(self.inputs[there], observations, self.arguments[there])

    def one(self, k):
        """Do one; gives x and the NIS of each sensor."""
        given = [
            (number, z[k], sampled[k])
            for number, (z, sampled) in enumerate(self.observations)
            if sampled[k].any()
        ]
        nis = np.full(len(self.observations), np.nan)
        if not given:
            self.ukf.predict(self.inputs[k])
        for place, (number, z, sampled) in enumerate(given):
            name = self.problem.sensor_names[number]
            if place:
                self.ukf.update(z, sampled, sensor=name, **self.arguments[k])
            else:
                self.ukf.iterate(self.inputs[k], z, sampled, sensor=name, **self.arguments[k])
            nis[number] = self.ukf.nis
        return self.ukf.x, nis


def assert_same(a, b):
    assert everything(a.driver) == everything(b.driver)
    np.testing.assert_array_equal(a.ukf.x, b.ukf.x)
    np.testing.assert_array_equal(a.ukf.P, b.ukf.P)
    assert (a.ukf.nis, a.ukf.gated) == (b.ukf.nis, b.ukf.gated)
    assert everything(a.driver) == everything(b.driver)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("nanosat", {"pes": 10}),
        ("nanosat", {"pes": 3, "form": Form.COVARIANCE, "format": BINARY64}),
        ("ctrv", {"pes": 1, "format": BINARY64}),
        ("ctrv", {"pes": 4}),
        ("nanosat", {"pes": 5, "format": FloatFormat(exponent_bits=8, fraction_bits=26)}),
        ("battery", {"pes": 2, "format": BFLOAT16}),
    ],
)
def test_all_at_once_is_as_one_by_one(name, values):
    """Several sensors and variants, redrawing, angles, inputs that change or do not, formats."""
    a, b = Samples(name, **values), Samples(name, **values)
    x, nis = a.ahead(0, STEPS)
    assert x.shape == (STEPS, a.params.n)
    for k in range(STEPS):
        one, one_nis = b.one(k)
        np.testing.assert_array_equal(x[k], one)
        np.testing.assert_array_equal(nis[k], one_nis)
    assert_same(a, b)


def test_runs_are_done_at_once_unless_each_step_is_to_be_seen(monkeypatch):
    done = []
    ahead = UnscentedKalmanFilter.iterate_ahead

    def spy(self, *given):
        found = ahead(self, *given)
        done.append(len(found[0]))
        return found

    monkeypatch.setattr(UnscentedKalmanFilter, "iterate_ahead", spy)
    a, b = (golden_driver(model_core("ctrv")) for _ in range(2))
    told = []
    found = run(
        scenario("ctrv"), a, covariance=True, every=15, progress=lambda *now: told.append(now)
    )
    assert done == [15, 15, 10]
    assert told == [(15, STEPS), (30, STEPS), (STEPS, STEPS)]
    seen = []
    single = run(scenario("ctrv"), b, covariance=True, after_step=lambda k, ukf: seen.append(ukf.x))
    assert len(done) == 3
    np.testing.assert_array_equal(found.x, single.x)
    np.testing.assert_array_equal(found.x, seen[1:])
    np.testing.assert_array_equal(found.nis_of_sensors, single.nis_of_sensors)
    np.testing.assert_array_equal(found.P, single.P)
    np.testing.assert_array_equal(found.last_x, single.last_x)
    assert everything(a) == everything(b)


@pytest.mark.parametrize("name", ["nanosat", "ctrv", "battery"])
def test_a_sample_that_the_gate_rejects_is_not_begun(name):
    nis = run(scenario(name), golden_driver(model_core(name))).nis_of_sensors
    gate = float(np.nanquantile(nis, 0.7))
    a, b = Samples(name, gate=gate), Samples(name, gate=gate)
    k = rejected = 0
    while k < STEPS:
        x, found = a.ahead(k, STEPS)
        for one, one_nis in zip(x, found, strict=True):
            single, single_nis = b.one(k)
            np.testing.assert_array_equal(one, single)
            np.testing.assert_array_equal(one_nis, single_nis)
            assert not b.ukf.gated
            k += 1
        assert everything(a.driver) == everything(b.driver)
        if k < STEPS:
            np.testing.assert_array_equal(a.one(k)[1], b.one(k)[1])
            assert a.ukf.gated
            rejected += 1
            k += 1
    assert_same(a, b)
    assert 3 < rejected < STEPS


def test_predictions_alone_are_done_and_can_be_undone():
    a, b = Samples("ctrv"), Samples("ctrv")
    for each in (a, b):
        for _, sampled in each.observations:
            sampled[[0, 5, 6, 7, 19]] = False
    x, nis = a.ahead(0, 20)
    assert len(x) == 20
    assert np.isnan(nis[[0, 5, 6, 7, 19]]).all()
    for k in range(20):
        np.testing.assert_array_equal(x[k], b.one(k)[0])
    assert everything(a.driver) == everything(b.driver)
    for each in (a, b):
        each.ukf.undo_predict()
        np.testing.assert_array_equal(each.ukf.x, x[18])
    assert_same(a, b)
    assert len(a.ahead(19, 20)[0]) == 1
    b.one(19)
    assert_same(a, b)


def spoil(samples, at):
    """Put what cannot be done into a sample, in one of several ways."""
    z, sampled = samples.observations[0]

    def put(value):
        z[at] = value
        sampled[at] = True

    return {
        "not a number": lambda: put(np.nan),
        "infinite": lambda: put(-np.inf),
        "too large for the format": lambda: put(1e39),
        "input too large": lambda: samples.inputs.__setitem__(at, 1e39),
        "input not finite": lambda: samples.inputs.__setitem__(at, np.nan),
        "f not finite": lambda: samples.inputs.__setitem__(at, 3e38),
        "other argument": lambda: samples.arguments.__setitem__(at, {"another": 1.0}),
        "other constant": lambda: samples.arguments.__setitem__(at, {"device": "camera"}),
        "other shape": lambda: samples.inputs.__setitem__(at, [0.1, 0.1]),
    }


WAYS = (
    "not a number", "infinite", "too large for the format", "input too large", "input not finite",
    "f not finite", "other argument", "other constant", "other shape",
)  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
def test_a_sample_that_fails_is_not_begun(way):
    """It raises when it is done by itself, and all before and after it is as it would be."""
    pair = Samples("ctrv"), Samples("ctrv")
    for each in pair:
        each.inputs = list(each.inputs)
        spoil(each, 7)[way]()
    a, b = pair
    assert len(a.ahead(0, STEPS)[0]) == 7
    assert len(a.ahead(7, STEPS)[0]) == 0
    for k in range(7):
        b.one(k)
    assert everything(a.driver) == everything(b.driver)
    messages = []
    for each in pair:
        with pytest.raises((UkfError, ValueError, TypeError)) as caught:
            each.one(7)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert len(a.ahead(8, STEPS)[0]) == STEPS - 8
    for k in range(8, STEPS):
        b.one(k)
    assert_same(a, b)


def test_an_interrupt_within_leaves_nothing_done(monkeypatch):
    a, b = Samples("nanosat"), Samples("nanosat")
    for each in (a, b):
        each.ahead(0, 10)
    before = everything(a.driver)
    core = core_of(a.driver)

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(core, "_end_script", interrupted)
        with pytest.raises(KeyboardInterrupt):
            a.ahead(10, STEPS)
    assert everything(a.driver)[:4] == before[:4]
    with pytest.raises(NotRecoveredError):
        a.ahead(10, STEPS)
    a.ukf.recover()
    np.testing.assert_array_equal(a.ukf.x, b.ukf.x)
    np.testing.assert_array_equal(a.ukf.P, b.ukf.P)
    assert a.ukf.nis is None
    assert len(a.ahead(10, STEPS)[0]) == STEPS - 10


@pytest.mark.parametrize("updates", [True, False])
def test_an_interrupt_after_it_has_been_done(monkeypatch, updates):
    """Then it has happened; but of a prediction alone nobody knows what was before it."""
    a, b = Samples("ctrv"), Samples("ctrv")
    for each in (a, b):
        for _, sampled in each.observations:
            sampled[10] = updates
    b.ahead(0, 11)

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        run_script = type(a.driver._bus).run_script

        def late(self, script):
            run_script(self, script)
            raise KeyboardInterrupt

        patch.setattr(type(a.driver._bus), "run_script", late)
        with pytest.raises(KeyboardInterrupt):
            a.ahead(0, 11)
    if updates:
        a.ukf.recover()
        np.testing.assert_array_equal(a.ukf.x, b.ukf.x)
        np.testing.assert_array_equal(a.ukf.P, b.ukf.P)
    else:
        with pytest.raises(EstimateLostError):
            a.ukf.recover()
        a.ukf.reset()
    assert len(a.ahead(11, STEPS)[0]) == STEPS - 11


def test_others_do_none():
    """Models in software, waiting for an interrupt, counting cycles, a step that is held."""
    software = Samples("nanosat", models=())
    hybrid = Samples("nanosat", models=("f",))
    for each in (software, hybrid):
        assert len(each.ahead(0, STEPS)[0]) == 0
    waiting = Samples("nanosat")
    waiting.driver._interrupt = waiting.driver._bus.wait_for_interrupt
    counting = Samples("nanosat")
    counting.driver.count_cycles = True
    held = Samples("nanosat")
    core_of(held.driver).hold = True
    for each in (waiting, counting, held):
        before = everything(each.driver)[:4]
        x, nis = each.ahead(0, STEPS)
        assert (x.shape, nis.shape) == ((0, each.params.n), (0, 1))
        assert everything(each.driver)[:4] == before
    assert len(counting.ahead(0, 0)[0]) == 0


def script(core, *, step=Step.ITERATE, sensor=0, addresses=(), reads=None):
    memory_map = MemoryMap(core.params)
    words = np.zeros(len(addresses), dtype=np.uint32)
    if reads is None:
        reads = [memory_map.address("x", 0, 0)]
    start = Start(step, sensor, 0, (1 << core.params.m) - 1, len(addresses))
    return Script(
        starts=[Start(Step.SIG_GEN, 0, 0, 0, 0), start], ends=[2],
        addresses=np.array(addresses, dtype=np.int64), words=words,
        reads=np.array(reads, dtype=np.int64),
    )  # fmt: skip


def test_scripts_that_are_not_for_it():
    """What is written must not outdate anything; illegal addresses and steps are not begun."""
    samples = Samples("ctrv")
    samples.ahead(0, 1)
    core = core_of(samples.driver)
    memory_map = MemoryMap(core.params)
    before = everything(samples.driver)
    beyond = 1 << memory_map.address_width
    for given in (
        script(core, addresses=[memory_map.address("x", 0, 0)]),
        script(core, addresses=[beyond]),
        script(core, addresses=[-4]),
        script(core, reads=[beyond]),
        script(core, reads=[0]),
        script(core, step=Step.INIT),
        script(core, sensor=2),
    ):
        if given.starts[1].step is Step.INIT:
            core.flags = Flag(0)  # SIG_GEN is illegal then
        replies = core.run_script(given)
        assert (replies.rounds, len(replies.nis), len(replies.reads)) == (0, 0, 0)
        core.flags = before[1]
        assert everything(samples.driver) == before
    core.write(CONTROL.offset, 0)
    assert core.run_script(script(core)).rounds == 0
    core.write(CONTROL.offset, CONTROL["ENABLE"].mask)
    core.write(INTERRUPT_PENDING.offset, INTERRUPT_PENDING["DONE"].mask)
    done = core.run_script(script(core, addresses=[memory_map.address("z", 0, 0)]))
    assert (done.rounds, done.nis.shape, done.reads.shape) == (1, (2,), (1, 1))
    assert core.read(INTERRUPT_PENDING.offset)[0] & INTERRUPT_PENDING["DONE"].mask


@pytest.mark.parametrize("fmt", [BINARY16, BINARY32, BINARY64])
def test_gates_are_compared_without_sign_in_every_format(fmt):
    """A gate of zero rejects all; of infinity none, nor does that of the largest number."""
    for gate, done in ((0.0, 0), (np.inf, 5), (fmt.max_finite, 5)):
        samples = Samples("battery", format=fmt, gate=gate)
        assert len(samples.ahead(0, 5)[0]) == done, gate
