"""Tasks for the process of the simulator that treat a core at random, in lockstep with its model.

Whatever happens on the core must happen in the golden model; what that is, is for the tests of
the model to judge. Each task counts what it did, so that a test can tell whether it did enough.
"""

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sim.bus import ALL_BYTES, Request
from ukf_sim.lockstep import LockstepBus
from ukf_sim.session import Context
from ukf_sw.errors import StepError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Problem
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.registers import CONTROL, CYCLES, ERROR, GATE_LOW, MASK, REGISTERS, STATUS
from ukf_sw.spec.sequence import Step, find_way

__all__ = [
    "access_at_random",
    "all_at_random",
    "change_model",
    "models_at_random",
    "reset_during_steps",
    "run_on_odd_words",
    "use_filter",
]

_ENABLE = CONTROL["ENABLE"].mask
_STEPS = tuple(step for step in Step if step is not Step.IDLE)


def _scenario(context: Context, seed: int, steps: int) -> tuple[Problem, Sequence[Any]]:
    """Make a random scenario in which a predict does not redraw by itself, and its inputs."""
    scenario = replace(random_scenario(context.job.params, seed, steps=steps), redraw=False)
    inputs = scenario.record.inputs
    assert inputs is not None
    return scenario, list(inputs)


def all_at_random(context: Context, *, seed: int, rounds: int) -> dict[str, Counter[str]]:
    """Do the other tasks of this module on one core, one after the other.

    Parameters
    ----------
    context
        The core.
    seed
        Seed of all choices.
    rounds
        How long: about so many iterations of the filter.
    """
    return {
        "use_filter": use_filter(context, seed=seed, rounds=rounds),
        "reset_during_steps": reset_during_steps(context, seed=seed, rounds=rounds),
        "run_on_odd_words": run_on_odd_words(context, seed=seed),
        "access_at_random": access_at_random(context, seed=seed, rounds=20 * rounds),
    }


def use_filter(context: Context, *, seed: int, rounds: int) -> Counter[str]:
    """Do random things with a filter: everything that its interface offers.

    Parameters
    ----------
    context
        The core.
    seed
        Seed of the data and of the choice.
    rounds
        How many things to do.
    """
    rng = np.random.default_rng(seed)
    scenario, inputs = _scenario(context, seed, rounds)
    p = context.job.params
    bus = context.lockstep
    ukf = UnscentedKalmanFilter(scenario, context.driver())
    bus.verify()
    counts: Counter[str] = Counter()

    def update(k: int, mask: NDArray[np.bool_]) -> str:
        corrected = gated = False
        for number, name in enumerate(scenario.sensor_names):
            rows = p.rows_of(number)
            own = mask[rows.start : rows.stop]
            z = np.where(own, scenario.samples(name)[0][k], np.nan)
            corrected |= ukf.update(z, own, sensor=name)
            gated |= ukf.gated
        if gated:
            return "gated"
        if not corrected:
            return "nothing sampled"
        return "update" if mask.all() else "masked update"

    def act(k: int, action: str) -> str:
        match action:
            case "iterate":
                ukf.predict(inputs[k])
                bus.verify()
                return update(k, np.ones(p.m, dtype=np.bool_))
            case "masked":
                ukf.predict(inputs[k])
                # At least one is sampled and one is not; of a single one, none is.
                mask = rng.random(p.m) < 0.5
                mask[rng.permutation(p.m)[:2]] = (False, True)[: p.m]
                return update(k, mask)
            case "sequential":
                ukf.predict(inputs[k])
                for row in range(p.m):
                    update(k, np.arange(p.m) == row)
            case "predict":
                ukf.predict(inputs[k])
            case "redraw":
                ukf.predict(inputs[k])
                ukf.redraw()
                return "redrawn " + update(k, np.ones(p.m, dtype=np.bool_))
            case "x":
                ukf.x = rng.standard_normal(p.n)
            case "P":
                B = rng.standard_normal((p.n, p.n))
                ukf.P = B @ B.T + np.eye(p.n)
            case "noise":
                ukf.Q, ukf.R = (1.0 + rng.random()) * ukf.Q, (1.0 + rng.random()) * ukf.R
            case "covariance":
                _ = ukf.P
            case "gate":
                ukf.gate = float(rng.choice([np.inf, 1e-3, 2.0 * p.m]))
            case _:
                ukf.reset()
        return action

    actions = ("iterate", "masked", "sequential", "predict", "redraw", "x", "P", "noise",
               "covariance", "gate", "reset")  # fmt: skip
    chances = np.array([6, 6, 2, 2, 2, 1, 1, 1, 2, 1, 1]) / 25.0
    for k in range(rounds):
        # Each once, then at random.
        action = actions[k] if k < len(actions) else str(rng.choice(actions, p=chances))
        try:
            counts[act(k, action)] += 1
        except StepError as error:
            # A coarse format loses the covariance at times: core and model at the same place.
            counts[type(error).__name__] += 1
            bus.verify()
            ukf.gate = np.inf
            ukf.reset()
        bus.verify()
        context.report(k + 1)
    counts["words compared"] = bus.words_compared
    return counts


def reset_during_steps(context: Context, *, seed: int, rounds: int) -> Counter[str]:
    """Reset the core in the middle of steps, and compare all that the bus can read after it.

    Parameters
    ----------
    context
        The core.
    seed
        Seed of the data and of the moments.
    rounds
        How often.
    """
    rng = np.random.default_rng(seed)
    scenario, inputs = _scenario(context, seed, rounds)
    bus = context.lockstep
    ukf = UnscentedKalmanFilter(scenario, context.driver())
    counts: Counter[str] = Counter()
    programs = (
        (Step.INIT, False), (Step.SIG_GEN, False), (Step.SIG_GEN, True), (Step.PREDICT, False),
        (Step.UPDATE, False), (Step.UPDATE, True), (Step.COVARIANCE, False),
        (Step.COVARIANCE, True),
    )  # fmt: skip
    for k in range(rounds):
        step, predicted = programs[k % len(programs)]
        try:
            ukf.reset()
            if predicted:
                ukf.predict(inputs[k])
            elif step in (Step.PREDICT, Step.UPDATE):
                ukf.redraw()
        except StepError as error:
            counts[type(error).__name__] += 1
            continue
        longest = max(bus.step_clocks(step), 1)
        # The first and the last clocks are the interesting ones.
        near = int(rng.integers(0, 12))
        clocks = (near, longest - near - 4, int(rng.integers(0, longest)))[k // len(programs) % 3]
        passed = bus.abort(step, max(clocks, 0))
        bus.verify()
        name = step.name + (" of a prediction" if predicted else "")
        counts[f"{name}, {'dropped' if passed <= longest else 'ended'}"] += 1
        context.report(k + 1)
    counts["words compared"] = bus.words_compared
    return counts


def run_on_odd_words(context: Context, *, seed: int) -> Counter[str]:
    """Write NaN, infinities and other odd words to every region, and run steps on them.

    Parameters
    ----------
    context
        The core.
    seed
        Seed of the data and of the places.

    Returns
    -------
    Counter
        Error codes, and ``"region word"`` for each word that a step refused.
    """
    rng = np.random.default_rng(seed)
    p = context.job.params
    fmt = p.format
    scenario, inputs = _scenario(context, seed, 1)
    bus = context.lockstep
    driver = context.driver()
    memory_map = MemoryMap(p)
    odd_words = {
        "NaN": fmt.nan,
        "NaN with payload": fmt.nan ^ 1,
        "infinity": fmt.infinity,
        "-infinity": fmt.infinity | 1 << (fmt.width - 1),
        "subnormal": 1,
        "-0": 1 << (fmt.width - 1),
        "largest": fmt.infinity - 1,
    }
    counts: Counter[str] = Counter()
    #: Steps that read a region.
    readers = {
        "X": (Step.PREDICT,),
        "Z": (Step.UPDATE,),
        "z": (Step.UPDATE,),
        "x": (Step.SIG_GEN, Step.INIT),
        "L": (Step.COVARIANCE, Step.SIG_GEN, Step.INIT),
        "LQ": (Step.INIT,),
        "LR": (Step.INIT,),
    }
    ukf = UnscentedKalmanFilter(scenario, driver)
    for region in memory_map:
        for name, word in odd_words.items():
            try:
                ukf.reset()
                ukf.predict(inputs[0])
                for sensor in scenario.sensor_names:
                    ukf.update(scenario.samples(sensor)[0][0], sensor=sensor)
                ukf.redraw()
            except StepError as error:
                counts[type(error).__name__] += 1
            row = int(rng.integers(region.rows))
            # The upper triangle of a factor is never read.
            sensor, first = 0, 0
            if region.symbol in ("Z", "z") or (region.symbol == "LR" and p.additive_r):
                sensor = sum(row >= p.rows_of(each).start for each in range(len(p.sensor_rows))) - 1
                first = p.rows_of(sensor).start
            triangular = region.symbol in ("L", "LQ", "LR")
            # A sigma point without weight is not read either.
            left = p.points.start if region.symbol in ("X", "Z") else 0
            column = int(rng.integers(left, row - first + 1 if triangular else region.columns))
            _put(bus, memory_map.address(region.symbol, row, column), word, fmt.bus_words)
            for step in readers.get(region.symbol, (Step.SIG_GEN,)):
                code = _start(bus, step, sensor)
                counts[f"code {code}"] += 1
                if code:
                    counts[f"{region.symbol} {name}"] += 1
                if region.symbol not in ("x", "L"):
                    assert np.isfinite(driver.state()).all(), region.symbol
            bus.verify()
    counts["words compared"] = bus.words_compared
    return counts


def _put(bus: LockstepBus, address: int, word: int, bus_words: int) -> None:
    """Write a number."""
    for index in range(bus_words):
        bus.access(Request(address + 4 * index, word >> 32 * index & 0xFFFF_FFFF))


def _start(bus: LockstepBus, step: Step, sensor: int = 0, variant: int = 0) -> int:
    """Run a step; gives its error code."""
    start = _ENABLE | CONTROL[step.name].mask | CONTROL["SENSOR"].put(sensor)
    start |= CONTROL["VARIANT"].put(variant)
    bus.access(Request(CONTROL.offset, start))
    bus.await_idle()
    return ERROR["CODE"].get(bus.golden.read(ERROR.offset)[0])


def access_at_random(context: Context, *, seed: int, rounds: int) -> Counter[str]:
    """Do what software should not: any address, any strobes, any step at any time.

    Parameters
    ----------
    context
        The core.
    seed
        Seed of the choices.
    rounds
        How many accesses, apart from the comparisons.
    """
    rng = np.random.default_rng(seed)
    p = context.job.params
    memory_map = MemoryMap(p)
    scenario, inputs = _scenario(context, seed, 1)
    bus = context.lockstep
    ukf = UnscentedKalmanFilter(scenario, context.driver())
    ukf.predict(inputs[0])
    bus.verify()
    counts: Counter[str] = Counter()
    mapped = [
        memory_map.address(region.symbol, row, column)
        for region in memory_map
        for row in range(region.rows)
        for column in range(region.columns)
    ]
    registers = [register.offset for register in REGISTERS]
    specials = (p.format.nan, p.format.infinity)
    words = [
        0,
        1,
        0xFFFF_FFFF,
        *(half for word in specials for half in (word & 0xFFFF_FFFF, word >> 32)),
    ]

    def address_of(kind: str) -> int:
        match kind:
            case "buffer":
                # Any of the four bytes of either word.
                return int(rng.choice(mapped)) + int(rng.integers(memory_map.element_bytes))
            case "register":
                return int(rng.choice(registers)) + int(rng.integers(4))
            case _:
                return int(rng.integers(1 << memory_map.address_width))

    def data() -> int:
        if rng.random() < 0.3:
            return int(rng.choice(words))
        numbers = p.format.encode(rng.standard_normal(1))
        return int(numbers[0]) >> int(rng.choice([0, 32])) & 0xFFFF_FFFF

    def strobe() -> int:
        return ALL_BYTES if rng.random() < 0.4 else int(rng.integers(16))

    kinds = itertools.cycle(itertools.product(("buffer", "register", "anywhere"), (False, True)))

    def touch(running: bool) -> None:
        kind, write = next(kinds)
        address = address_of(kind)
        aligned = address & ~3
        if running and not write and aligned == CYCLES.offset:
            return  # it counts
        if write and aligned == CONTROL.offset:
            return  # that is for `control`
        request = Request(address, data() if write else None, strobe() if write else ALL_BYTES)
        answer = bus.access(request)
        counts[f"{'running ' if running else ''}{kind} {'write' if write else 'read'}"] += 1
        counts["SLVERR" if not answer.okay else "OKAY"] += 1
        if write and request.strobe not in (0, ALL_BYTES):
            counts["partial strobe"] += 1

    def control() -> None:
        starts = rng.choice(_STEPS, size=rng.choice([0, 1, 1, 1, 1, 2]), replace=False)
        word = sum(CONTROL[Step(step).name].mask for step in starts)
        word |= _ENABLE * int(rng.random() < 0.9)
        word |= CONTROL["RESET"].mask * int(rng.random() < 0.05)
        bus.access(Request(CONTROL.offset, word, strobe()))
        counts["control"] += 1
        if not bus.golden.busy:
            return
        counts["started"] += 1
        disturb(Step(STATUS["STATE"].get(bus.golden.read(STATUS.offset)[0])))

    def disturb(step: Step) -> None:
        """Access the core while it runs a step."""
        begin, clocks = bus.device.bench.clock, bus.step_clocks(step)
        # Stay within the step: the model does not know when the core ends.
        while bus.device.bench.clock - begin < clocks - (80 if paused else 20):
            if rng.random() < 0.25:
                start = CONTROL[str(rng.choice([s.name for s in _STEPS]))].mask
                bus.access(Request(CONTROL.offset, _ENABLE | start))
                counts["start while running"] += 1
            else:
                touch(running=True)
        bus.await_idle()
        bus.verify()

    paused = False
    for _ in range(8):
        # The longest step, undisturbed so far.
        ukf.reset()
        ukf.redraw()
        bus.access(Request(CONTROL.offset, _ENABLE | CONTROL["UPDATE"].mask))
        disturb(Step.UPDATE)
    for k in range(rounds):
        if k == rounds // 2:
            patterns = rng.random((2, 64)) < 0.3
            bus.device.pause(patterns[0].tolist(), patterns[1].tolist())
            paused = True
        if rng.random() < 0.2:
            control()
        else:
            touch(running=False)
        if k % 20 == 0:
            bus.verify()
            context.report(k + 1)
        if rng.random() < 0.03:
            # Random words in the factor make most steps fail: begin again, now and then.
            bus.access(Request(CONTROL.offset, _ENABLE | CONTROL["RESET"].mask))
            ukf.reset()
    bus.verify()
    counts["words compared"] = bus.words_compared
    return counts


def models_at_random(context: Context, *, seed: int, rounds: int) -> Counter[str]:
    """Run the models of a core: whole steps, resets in the middle of them, and odd words.

    Parameters
    ----------
    context
        The core; it has models.
    seed
        Seed of all choices.
    rounds
        How many steps.
    """
    rng = np.random.default_rng(seed)
    p = context.job.params
    fmt, memory_map, bus, driver = p.format, MemoryMap(p), context.lockstep, context.driver()
    counts: Counter[str] = Counter()

    def fill(symbol: str, values: NDArray[np.float64]) -> None:
        region = memory_map[symbol]
        words = fmt.encode(np.reshape(values, (region.rows, region.columns)))
        for (row, column), word in np.ndenumerate(words):
            _put(bus, memory_map.address(symbol, row, column), int(word), fmt.bus_words)

    def begin() -> None:
        """Reset, a new estimate, and all that the models are given."""
        bus.access(Request(CONTROL.offset, _ENABLE | CONTROL["RESET"].mask))
        driver.initialise(
            0.5 * rng.standard_normal(p.n), np.eye(p.n), 0.01 * np.eye(p.q), 0.1 * np.eye(p.r)
        )
        if p.models.inputs:
            fill("U", rng.uniform(0.1, 0.5, len(p.models.inputs)))
        fill("z", 0.5 * rng.standard_normal(p.m))
        assert _start(bus, Step.SIG_GEN) == 0

    begin()
    for k in range(rounds):
        sensor = int(rng.integers(len(p.models.h)))
        variant = int(rng.integers(len(p.models.h[sensor])))
        mask = int(rng.choice([0xFFFF_FFFF, int(rng.integers(1 << p.m))]))
        bus.access(Request(MASK.offset, mask))
        step = Step((Step.ITERATE, Step.F, Step.H)[k % 3])
        what = ("run", "reset", "run", "odd", "gate", "missing", "reset")[k // 3 % 7]
        if what == "odd":
            symbols = [symbol for symbol in ("U", "z", "X", "W", "V") if symbol in memory_map]
            region = memory_map[str(rng.choice(symbols))]
            address = memory_map.address(
                region.symbol, int(rng.integers(region.rows)), int(rng.integers(region.columns))
            )
            _put(bus, address, int(rng.choice([fmt.nan, fmt.infinity, 1])), fmt.bus_words)
        if what == "gate":
            bus.access(Request(GATE_LOW.offset, int(rng.choice([1, fmt.infinity & 0xFFFF_FFFF]))))
        legal = find_way(step, bus.golden.flags) is not None
        if what == "reset" and legal:
            # Near the end of each program, and anywhere.
            ends = np.cumsum(bus.program_clocks(step, sensor, variant))
            moments = [*(int(end) - 4 + int(rng.integers(-3, 4)) for end in ends),
                       int(rng.integers(ends[-1])), int(rng.integers(6))]  # fmt: skip
            passed = bus.abort(step, max(int(rng.choice(moments)), 0), sensor, variant)
            number = int(np.searchsorted(ends, passed))
            counts[f"reset of {step.name} in program {number}"] += 1
            if number and passed in (ends[number - 1] + 1, ends[number - 1] + 2):
                counts["reset on a boundary"] += 1
        else:
            code = _start(
                bus, step, int(rng.choice([sensor, 31])) if what == "missing" else sensor,
                15 if what == "missing" else variant,
            )  # fmt: skip
            counts[f"{step.name} code {code}"] += 1
            counts["masked"] += step is not Step.F and code == 0 and mask != 0xFFFF_FFFF
            if STATUS["GATED"].get(bus.golden.read(STATUS.offset)[0]):
                counts["gated"] += 1
        bus.verify()
        if what != "run" or not bus.golden.flags or rng.random() < 0.2:
            bus.access(Request(GATE_LOW.offset, fmt.infinity & 0xFFFF_FFFF))
            begin()
        elif find_way((Step.ITERATE, Step.F, Step.H)[(k + 1) % 3], bus.golden.flags) is None:
            _start(bus, Step.SIG_GEN)
        context.report(k + 1)
    counts["words compared"] = bus.words_compared
    return counts


def change_model(context: Context) -> None:
    """Change a word in the memory of the model, which the comparison must notice."""
    bus = context.lockstep
    bus.verify()
    lane, address = bus.golden.engine.layout.buffer_location("x", 0, 0)
    bus.golden.engine.memory[lane, address] ^= np.uint64(1 << 12)
    bus.verify()
