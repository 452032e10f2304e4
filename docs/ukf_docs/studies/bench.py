"""Speed of this project's own tools.

Figures are of one computer on one day. They show what is worth waiting for, and whether a change
made something slower; nothing is judged by them.
"""

import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.study import Study, Tell
from ukf_sw.problem import Problem
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.reference import ReferenceUkf, sigma_coefficients, weights
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_tools.evaluate.workers import processors

__all__ = ["STUDY", "run_filterpy"]

#: States of the generator's measurements; noise as in the nanosatellite, 6 observations.
SIZES = (7, 15, 31)
#: Processing elements of all measurements.
PES = 2
#: Iterations of the models, and of the co-simulation.
STEPS, COSIMULATED = 2000, 200

# What a user does first; the prior points serve as transformed ones.
_FIRST_STEP = """
import numpy as np
from ukf_sw.backends import make_backend
from ukf_sw.spec.parameters import UkfParams

p = UkfParams(n={p.n}, m={p.m}, q={p.q}, r={p.r}, pes={pes})
backend = make_backend("golden", p)
backend.initialise(np.zeros(p.n), np.eye(p.n), np.eye(p.q), np.eye(p.r))
points = backend.sigma_points()
backend.predict(points)
backend.update(points[: p.m], np.zeros(p.m), np.ones(p.m, dtype=bool))
"""


class _Points:
    """Sigma points of the spherical simplex that have a weight, as filterpy wants them."""

    def __init__(self, n: int, M: int, W0: float) -> None:
        W = weights(M, W0)
        self.Wm = self.Wc = W[W > 0.0]
        self._sigma = sigma_coefficients(M, W0)[:n, W > 0.0]

    def num_sigmas(self) -> int:
        """Give their number."""
        return len(self.Wm)

    def sigma_points(self, x: np.ndarray, P: np.ndarray) -> np.ndarray:
        """Draw them, shape (K, n)."""
        return (x[:, None] + np.linalg.cholesky(P) @ self._sigma).T


def run_filterpy(problem: Problem, steps: int) -> np.ndarray:
    """Run a problem with augmented noise and one sensor on filterpy.

    Parameters
    ----------
    problem
        The problem with its data; its models are vectorized.
    steps
        How many steps.

    Returns
    -------
    array of shape (steps, n)
        Estimates. They are those of the float64 reference, but for rounding.
    """
    from filterpy.kalman import UnscentedKalmanFilter, unscented_transform

    class Filter(UnscentedKalmanFilter):
        """filterpy's filter, but an update sees the points that went through fx."""

        def predict(
            self, dt: float | None = None, UT: Any = None, fx: Any = None, **arguments: Any
        ) -> None:
            self.compute_process_sigmas(self._dt if dt is None else dt, fx, **arguments)
            self.x, self.P = (UT or unscented_transform)(self.sigmas_f, self.Wm, self.Wc, self.Q)

    p, data = problem.params, problem.record
    name = problem.sensor_names[0]
    h, (observed, _) = problem.sensor(name).h, problem.samples(name)
    noise = ReferenceUkf(p)
    noise.initialise(problem.x0, problem.P0, problem.Q, problem.R)
    W, V = noise.noise_points()
    w, v = cycle(W.T), cycle(V.T)
    ukf = Filter(
        p.n, p.m, 1.0,
        lambda x: np.ravel(h(x[:, None], next(v)[:, None])),
        lambda x, dt, u: np.ravel(problem.f(x[:, None], next(w)[:, None], u)),
        _Points(p.n, p.M, p.W0),
    )  # fmt: skip
    ukf.x, ukf.P = problem.x0.copy(), problem.P0.copy()
    ukf.Q, ukf.R = np.zeros((p.n, p.n)), np.zeros((p.m, p.m))
    estimates = np.empty((steps, p.n))
    for k in range(steps):
        ukf.predict(u=None if data.inputs is None else data.inputs[k])
        ukf.update(observed[k])
        estimates[k] = ukf.x
    return estimates


def _seconds(work: Callable[[], Any], repeats: int = 3) -> float:
    """Shortest of some runs, in s."""
    best = float("inf")
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - started)
    return best


def _models(steps: int) -> dict[str, float]:
    """Golden model, reference and filterpy on the same data, in iterations a second."""
    problem = Recipe.of("nanosat", pes=PES).scenario(steps)
    rates: dict[str, float] = {}
    for name in ("golden", "reference"):
        # The first run compiles.
        run(problem, name, steps=min(steps, 5))
        rates[name] = steps / _seconds(lambda name=name: run(problem, name))
    rates["filterpy"] = steps / _seconds(lambda: run_filterpy(problem, steps))
    rates["golden_to_filterpy"] = rates["golden"] / rates["filterpy"]
    return rates


def _processor_seconds(script: str, cache: str) -> float:
    """Processor time of a script in a fresh process, in s, with a folder for compiled code."""
    before = os.times()
    subprocess.run(
        [sys.executable, "-c", script], env=os.environ | {"NUMBA_CACHE_DIR": cache}, check=True
    )
    after = os.times()
    return (
        after.children_user - before.children_user + after.children_system - before.children_system
    )


def _first_step(repeats: int = 5) -> dict[str, float]:
    """First predict and update of a process on the golden model, shortest processor time, in s."""
    script = _FIRST_STEP.format(p=NANOSAT, pes=PES)
    cold: list[float] = []
    warm: list[float] = []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(_processor_seconds(script, cache))
            warm.append(_processor_seconds(script, cache))
    return {"cold_seconds": min(cold), "warm_seconds": min(warm)}


def _cosimulation(steps: int) -> dict[str, float]:
    """Co-simulation in lockstep with the golden model."""
    from ukf_sim.cosimulation import cosimulate

    found = cosimulate(Recipe.of("nanosat", pes=PES).scenario, steps)
    if found.mismatch is not None:
        raise RuntimeError(f"the core must be as the golden model, not: {found.mismatch}")
    clocks = sum(each.clocks for each in found.iterations)
    return {
        "iterations_per_second": steps / found.seconds,
        "clocks_per_second": clocks / found.seconds,
    }


def _generator() -> list[dict[str, float]]:
    """Time of the scheduler and of the generator by the number of states, in s."""
    from ukf_hdl.generate import files_of, generate
    from ukf_sw.engine.microcode import Microcode

    files_of.cache_clear()
    rows: list[dict[str, float]] = []
    for n in SIZES:
        params = UkfParams(n=n, m=6, q=n, r=6, pes=PES)
        schedule = _seconds(lambda params=params: Microcode(params, Pipeline()), repeats=1)
        with tempfile.TemporaryDirectory() as folder:
            started = time.perf_counter()
            files = generate(params, Pipeline(), Path(folder))
            rows.append({
                "n": n, "schedule_seconds": schedule,
                "generate_seconds": time.perf_counter() - started,
                "verilog_bytes": sum(f.stat().st_size for f in files if f.suffix == ".v"),
            })  # fmt: skip
    return rows


def _sweep() -> dict[str, float]:
    """Points a second of a sweep without synthesis, in this process, and from the cache."""
    from ukf_tools.design_space.cache import Cache
    from ukf_tools.design_space.executors import LocalExecutor
    from ukf_tools.design_space.points import Point, grid
    from ukf_tools.design_space.sweep import Questions, sweep

    nanosat = Point.of(Core(params=NANOSAT, problem="nanosat"))
    points = grid([nanosat], pes=range(1, 23), add_stages=(2, 3))
    with tempfile.TemporaryDirectory() as folder:
        cache, executor = Cache(Path(folder)), LocalExecutor()
        first = sweep(points, Questions(resources=False), cache, executor)
        again = sweep(points, Questions(resources=False), cache, executor)
    return {
        "points": len(points),
        "workers": executor.workers,
        "points_per_second": len(points) / first.seconds,
        "cached_points_per_second": len(points) / again.seconds,
    }


def _measure(tell: Tell) -> dict[str, Any]:
    record: dict[str, Any] = {
        "computer": {
            "processors": processors(),
            "machine": platform.machine(),
            "python": platform.python_version(),
            "load": round(os.getloadavg()[0], 2),
        },
        "configuration": Core(params=replace(NANOSAT, pes=PES), problem="nanosat").title,
    }
    jobs: dict[str, Callable[[], Any]] = {
        "models": lambda: _models(STEPS), "first_step": _first_step,
        "cosimulation": lambda: _cosimulation(COSIMULATED), "generator": _generator,
        "sweep": _sweep,
    }  # fmt: skip
    for k, (name, work) in enumerate(jobs.items()):
        tell(f"Measuring: {name}", k, len(jobs))
        record[name] = work()
    return record


def _table(record: dict[str, Any]) -> str:
    models, cosim, sweep = record["models"], record["cosimulation"], record["sweep"]
    first = record["first_step"]
    computer = record["computer"]
    rows = [
        ("golden model, nanosatellite", f"{models['golden']:.0f} iterations a second"),
        ("filterpy, float64, same data", f"{models['filterpy']:.0f} iterations a second"),
        ("golden model to filterpy", f"{models['golden_to_filterpy']:.2f}"),
        (
            "first step of a process on the golden model, processor time, then of the next one",
            f"{first['cold_seconds']:.1f} s, {first['warm_seconds']:.1f} s",
        ),
        ("float64 reference", f"{models['reference']:.0f} iterations a second"),
        (
            "co-simulation in lockstep",
            (
                f"{cosim['iterations_per_second']:.1f} iterations, "
                f"{cosim['clocks_per_second']:.0f} clocks a second"
            ),
        ),
        (
            f"sweep of {sweep['points']} cores, no synthesis, {sweep['workers']} processes",
            f"{sweep['points_per_second']:.1f} cores a second",
        ),
        ("the same from the cache", f"{sweep['cached_points_per_second']:.0f} cores a second"),
        *(
            (
                f"n = {row['n']}: schedule, then generate",
                f"{row['schedule_seconds']:.1f} s, {row['generate_seconds']:.1f} s",
            )
            for row in record["generator"]
        ),
    ]
    return table(("what", "speed"), rows) + (
        f"\n{record['configuration']}; {computer['processors']} processors of "
        f"{computer['machine']}, Python {computer['python']}, load {computer['load']:g} at the "
        "start. filterpy calls the models once a point.\n"
    )


STUDY = Study(
    name="bench", document=DOCS / "design-space.md", measure=_measure, tables={"bench": _table}
)
