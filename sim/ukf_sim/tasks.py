"""Tasks for the process of the simulator: what runs on the core."""

import time
from dataclasses import asdict
from typing import Any

import numpy as np

from ukf_sim.configurations import Problem
from ukf_sim.cosimulation import Context
from ukf_sim.lockstep import MismatchError
from ukf_sw.errors import StepError

__all__ = ["run_problem"]

#: Regions that are compared after every step; the others change rarely and are compared at the end.
OFTEN = ("X", "x", "L")


def run_problem(context: Context, *, problem: Problem, steps: int) -> dict[str, Any]:
    """Run a filter on an estimation problem, compared with the golden model in lockstep.

    Parameters
    ----------
    context
        The core.
    problem
        The problem.
    steps
        How many steps.

    Returns
    -------
    dict
        What was observed; see :mod:`ukf_sim.report`.
    """
    scenario = problem.scenario(steps)
    bus = context.lockstep()
    bench = context.bench
    observed: dict[str, Any] = {
        "x": [], "P": None, "cycles": [], "traffic": [], "clocks": [], "mismatch": None,
        "stopped": None,
    }  # fmt: skip
    ukf = None
    started = time.perf_counter()
    try:
        driver = context.driver(bus)
        ukf = scenario.filter(driver)
        observed["first_cycles"] = dict(driver.last_cycles)
        bus.verify()
        started = time.perf_counter()
        for k in range(steps):
            traffic, clock = driver.traffic, bench.clock
            words, bus_clocks = bench.words, bench.bus_clocks
            driver.last_cycles.clear()
            ukf.predict(None if scenario.inputs is None else scenario.inputs[k])
            mask = None if scenario.sampled is None else scenario.sampled[k]
            if mask is None or mask.any():
                arguments = scenario.observation_arguments
                ukf.update(
                    scenario.measurements[k], mask, **({} if arguments is None else arguments[k])
                )
            observed["x"].append(ukf.x)
            observed["cycles"].append(dict(driver.last_cycles))
            observed["traffic"].append(asdict(driver.traffic - traffic))
            observed["clocks"].append(
                {
                    "iteration": bench.clock - clock,
                    "bus": bench.bus_clocks - bus_clocks,
                    "words": bench.words - words,
                }
            )
            bus.verify(OFTEN)
            context.report(k + 1)
    except MismatchError as error:
        observed["mismatch"] = str(error)
    except StepError as error:
        observed["stopped"] = _describe(error)
    observed["seconds"] = time.perf_counter() - started
    if ukf is not None and observed["mismatch"] is None:
        try:
            observed["last_x"] = driver.state()
            bus.verify()
            if observed["stopped"] is None:
                observed["P"] = ukf.P
                bus.verify()
        except MismatchError as error:
            observed["mismatch"] = str(error)
        except StepError as error:
            observed["stopped"] = _describe(error)
    observed["words_compared"] = bus.words_compared
    observed["x"] = np.array(observed["x"]).reshape(-1, scenario.params.n)
    return observed


def _describe(error: StepError) -> dict[str, Any]:
    return {
        "step": error.step.name,
        "error": type(error).__name__.removesuffix("Error"),
        "index": getattr(error, "index", None),
        "message": str(error),
    }
