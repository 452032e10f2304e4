"""Tasks for the process of the simulator: what runs on the core."""

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from ukf_sim.lockstep import MismatchError
from ukf_sim.session import Context
from ukf_sw.errors import StepError
from ukf_sw.problems.configurations import Problem
from ukf_sw.problems.judging import describe, iterate
from ukf_sw.problems.scenario import Scenario

__all__ = ["run_problem", "run_scenario"]

#: Regions that are compared after every step; the others are compared at the beginning and at the
#: end, because the driver reads them rarely.
OFTEN = ("X", "x", "L")


def run_problem(context: Context, *, problem: Problem, steps: int) -> dict[str, Any]:
    """Run a problem of the command line; see :func:`run_scenario`."""
    return run_scenario(context, make=problem.scenario, steps=steps)


def run_scenario(
    context: Context, *, make: Callable[[int], Scenario], steps: int
) -> dict[str, Any]:
    """Run a filter on a scenario, compared with the golden model in lockstep.

    Parameters
    ----------
    context
        The core.
    make
        Makes the scenario of so many steps.
    steps
        How many steps.

    Returns
    -------
    dict
        ``mismatch``, what differed first, or None; ``stopped``, the error of the core that ended
        the run, or None; ``words_compared``; ``x``, the estimates, and ``last_x``, the one that
        could be read at the end; ``nis``, NaN where nothing was sampled, and ``gated`` of each
        step; ``P``; ``first_cycles``, of INIT, and ``cycles`` of the steps of each iteration;
        ``traffic`` in words and ``clocks`` of each iteration; ``seconds`` of time
        and ``cpu_seconds`` of the processor.
    """
    scenario = make(steps)
    bus = context.lockstep
    bench = context.bench
    x: list[np.ndarray] = []
    nis: list[float] = []
    gated: list[bool] = []
    cycles: list[dict[str, int]] = []
    traffic: list[dict[str, int]] = []
    clocks: list[dict[str, int]] = []
    result: dict[str, Any] = {
        "mismatch": None, "stopped": None, "last_x": None, "P": None, "first_cycles": {},
    }  # fmt: skip
    started = _now()
    try:
        driver = context.driver()
        try:
            ukf = scenario.filter(driver)
            result["first_cycles"] = dict(driver.last_cycles)
            bus.verify()
            started = _now()
            before = (driver.traffic, bench.clock, bench.bus_clocks, bench.words)
            driver.last_cycles.clear()
            for k in iterate(ukf, scenario, steps):
                x.append(ukf.x)
                sampled = scenario.sampled is None or bool(scenario.sampled[k].any())
                nis.append(ukf.nis if sampled and ukf.nis is not None else np.nan)
                gated.append(sampled and ukf.gated)
                cycles.append(dict(driver.last_cycles))
                traffic.append(asdict(driver.traffic - before[0]))
                clocks.append({
                    "iteration": bench.clock - before[1],
                    "bus": bench.bus_clocks - before[2],
                    "words": bench.words - before[3],
                })  # fmt: skip
                bus.verify(OFTEN)
                context.report(k + 1)
                before = (driver.traffic, bench.clock, bench.bus_clocks, bench.words)
                driver.last_cycles.clear()
            result |= _passed(started)
            result["P"] = ukf.P
        except StepError as error:
            result["stopped"] = describe(error, len(x))
            result |= _passed(started)
        result["last_x"] = driver.state()
        bus.verify()
    except MismatchError as error:
        result["mismatch"] = str(error)
        result |= _passed(started)
    return result | {
        "words_compared": bus.words_compared,
        "x": np.array(x).reshape(-1, scenario.params.n),
        "nis": np.array(nis[: len(x)]),
        "gated": np.array(gated[: len(x)], dtype=np.bool_),
        "cycles": cycles,
        "traffic": traffic,
        "clocks": clocks,
    }


def _now() -> tuple[float, float]:
    """Time, and time of the processor, in seconds."""
    return time.perf_counter(), time.process_time()


def _passed(since: tuple[float, float]) -> dict[str, float]:
    """What has passed since then."""
    now = _now()
    return {"seconds": now[0] - since[0], "cpu_seconds": now[1] - since[1]}
