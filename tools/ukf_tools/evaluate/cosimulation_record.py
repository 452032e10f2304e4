"""Records of co-simulations: what machines read, and what the command line prints."""

from typing import Any

import numpy as np

from ukf_sim.session import Job, Outcome
from ukf_sim.simulators import Simulator
from ukf_sw.problems.configurations import Problem
from ukf_sw.problems.judging import Track, accuracy
from ukf_sw.spec.core import Core
from ukf_tools.estimate.latency import latency

__all__ = ["cosimulation_record"]

#: Steps of an iteration.
ITERATION = ("SIG_GEN", "PREDICT", "UPDATE")


def cosimulation_record(
    problem: Problem,
    job: Job,
    simulator: Simulator,
    steps: int,
    outcome: Outcome,
    reference: np.ndarray,
) -> dict[str, Any]:
    """Make the record of a co-simulation, ready for JSON.

    Parameters
    ----------
    problem, job, simulator, steps
        What was run, where, and how many steps were asked for.
    outcome
        What came of it.
    reference
        Estimates of the float64 reference.
    """
    observed = outcome.result
    cycles = observed["cycles"]
    last = cycles[-1] if cycles else {}
    predicted = latency(job.params, job.pipeline)
    count = len(observed["x"])
    clocks = observed["clocks"]
    traffic = observed["traffic"][-1] if observed["traffic"] else {}
    words = sum(entry["words"] for entry in clocks)
    programs = predicted["programs"]
    first = cycles[0] if cycles else {}
    # Each reading was compared with the golden model's; this is the comparison with the schedule.
    agree = (
        observed["first_cycles"].get("INIT") == programs["INIT"]
        and all(
            entry.get("PREDICT", programs["PREDICT"]) == programs["PREDICT"]
            and entry.get("UPDATE", programs["UPDATE"])
            in (programs["UPDATE"], programs["UPDATE_REDRAWN"])
            for entry in cycles
        )
    )  # fmt: skip
    return {
        "configuration": problem.configuration,
        **Core(params=job.params, pipeline=job.pipeline).record(),
        "simulator": simulator.value,
        "mode": "interrupt" if job.interrupt else "polling",
        "bus_latency": job.word_clocks,
        "seed": problem.seed,
        "P0": problem.P0,
        "steps_requested": steps,
        "steps": count,
        "bit_exact": observed["mismatch"] is None,
        "mismatch": observed["mismatch"],
        "words_compared": observed["words_compared"],
        "stopped": observed["stopped"],
        "last_estimate": None if observed["last_x"] is None else observed["last_x"].tolist(),
        "cycles": {
            "steps": {name: last[name] for name in ITERATION if name in last},
            "total": sum(last.get(name, 0) for name in ITERATION),
            "first": observed["first_cycles"] | first,
            "predicted": predicted["steps"],
            "predicted_total": predicted["total"],
            "as_predicted": agree,
        },
        "bus": {
            "words_per_iteration": traffic.get("words_read", 0) + traffic.get("words_written", 0),
            **traffic,
            "clocks_per_word": sum(entry["bus"] for entry in clocks) / words if words else None,
        },
        "clocks_per_iteration": clocks[-1]["iteration"] if clocks else None,
        "iterations_per_second": count / observed["seconds"] if count else None,
        "compiled": outcome.build.compiled,
        "build_seconds": outcome.build.seconds,
        "simulation_seconds": outcome.seconds,
        "accuracy": accuracy(Track(problem.scenario(steps), observed["x"], reference)),
    }
