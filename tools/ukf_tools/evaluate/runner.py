"""Running entries of the catalogue on a backend, and judging them."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ukf_sim.scenarios import cosimulate_scenario
from ukf_sim.session import CACHE
from ukf_sim.simulators import Simulator
from ukf_sw.backends import Backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import UkfError
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.catalogue import CATALOGUE, Entry, Verdict
from ukf_sw.problems.scenario import Results, Scenario
from ukf_sw.problems.scenario import run as run_scenario
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.parameters import UkfParams
from ukf_tools.evaluate.figures import draw, draw_errors
from ukf_tools.evaluate.workers import mapper

__all__ = [
    "BACKENDS",
    "EXTRA",
    "CatalogueProblem",
    "cosimulate_entry",
    "describe_verdict",
    "find",
    "run_catalogue",
    "run_entry",
]

#: What can compute an entry.
BACKENDS = ("reference", "golden", "cosim")
#: Steps of a co-simulation unless told otherwise; slow sensors have a sample by then.
COSIM_STEPS = 30

#: What installs the packages that only some entries need.
EXTRA = "pip install 'ukf-core[apps]'"

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class CatalogueProblem:
    """How to make an entry's scenario, anywhere: scenarios themselves hold functions.

    Parameters
    ----------
    name
        Name of the entry.
    seed
        Seed of the data.
    changes
        Parameters of the core to replace, such as ``{"pes": 4}``.
    """

    name: str
    seed: int = 0
    changes: tuple[tuple[str, Any], ...] = ()

    def scenario(self, steps: int | None = None) -> Scenario:
        """Make the scenario."""
        made = find(self.name).scenario(self.seed, steps)
        return replace(made, params=replace(made.params, **dict(self.changes)))

    @property
    def params(self) -> UkfParams:
        """Parameters of the core."""
        return self.scenario(1).params


def find(name: str) -> Entry:
    """Find an entry of the catalogue.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name not in CATALOGUE:
        raise ValueError(f"NAME must be one of {', '.join(CATALOGUE)}, not {name!r}")
    return CATALOGUE[name]


def _backend(name: str, params: UkfParams) -> Backend:
    """Make the software backend of a name."""
    if name == "reference":
        return ReferenceUkf(params)
    return Driver(GoldenBus(GoldenCore(params)), params)


def describe_verdict(verdict: Verdict) -> dict[str, Any]:
    """Describe a verdict, ready for JSON."""
    bound = verdict.bound
    return {
        "error": bound.error, "measure": bound.measure, "value": verdict.value,
        "low": bound.low, "high": bound.high, "reference": bound.reference,
        "origin": bound.origin, "okay": verdict.okay,
    }  # fmt: skip


def _describe_errors(
    entry: Entry, results: list[Results], others: list[Results], settled: float
) -> list[dict[str, Any]]:
    """Describe the errors of runs, and of the float64 reference on the same data."""
    scenario = results[0].scenario

    def rms(of: list[Results]) -> np.ndarray:
        return np.sqrt(np.mean([result.rms(settled) ** 2 for result in of], axis=0))

    found, reference = rms(results), rms(others)
    largest = np.max([result.maximum(settled) for result in results], axis=0)
    return [
        {
            "error": name, "unit": unit, "rms": float(found[k]), "maximum": float(largest[k]),
            "float64_rms": float(reference[k]),
        }
        for k, (name, unit) in enumerate(
            zip(scenario.error_names, scenario.error_units, strict=True)
        )
    ]  # fmt: skip


def run_entry(
    name: str,
    backend: str = "golden",
    *,
    steps: int | None = None,
    seed: int = 0,
    output: Path | None = None,
    cache: Path = CACHE,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run an entry, compare it with the float64 reference on the same data, and judge it.

    Parameters
    ----------
    name
        Name of the entry.
    backend
        "reference", "golden", or "cosim": the Verilog, in lockstep with the golden model.
    steps
        How many; None is all, or a few for "cosim". Errors are judged of whole runs only.
    seed
        Seed of the first run.
    output
        Folder of the figure; None is none.
    cache
        Folder of compiled cores.
    progress
        Called with what runs, steps done and their total.

    Returns
    -------
    dict
        Ready for JSON. ``okay`` is whether nothing is wrong: no error of the core, no mismatch, and
        whatever was judged is within its bounds. ``judged`` says whether it was.

    Raises
    ------
    ValueError
        If there is no such entry or backend, or it has fewer steps.
    SimulatorError
        If the simulator is not installed or fails.
    """
    if backend not in BACKENDS:
        raise ValueError(f"--backend must be one of {', '.join(BACKENDS)}, not {backend!r}")
    if backend == "cosim":
        return cosimulate_entry(
            name, steps=COSIM_STEPS if steps is None else steps, seed=seed, output=output,
            cache=cache, progress=progress,
        )  # fmt: skip
    entry = find(name)
    tell = progress or (lambda what, done, total: None)
    started = time.perf_counter()
    results: list[Results] = []
    others: list[Results] = []
    stopped = None
    for number in range(1 if steps is not None else entry.runs):
        try:
            scenario = entry.scenario(seed + number, steps)
        except ModuleNotFoundError as error:
            stopped = f"{error.name} is not installed: {EXTRA}"
            break
        for kind, kept in (("reference", others), (backend, results)):
            if kind == "reference" and kept is results:
                results.append(others[-1])
                continue
            label = f"{name}: {kind}, run {number + 1}"
            try:
                kept.append(
                    run_scenario(
                        scenario,
                        _backend(kind, scenario.params),
                        progress=lambda done, total, label=label: tell(label, done, total),
                        every=500,
                    )
                )
            except UkfError as error:
                stopped = f"{kind}, seed {seed + number}: {type(error).__name__}: {error}"
                break
        if stopped is not None:
            break
    record: dict[str, Any] = {
        "name": name, "doc": entry.doc, "source": entry.source, "backend": backend, "seed": seed,
        "runs": len(results), "steps": None, "settled": None, "stopped": stopped, "errors": [],
        "judged": False, "verdicts": [], "plots": [],
    }  # fmt: skip
    if results and stopped is None:
        scenario = results[0].scenario
        settled = entry.settled if scenario.times[-1] > entry.settled else -np.inf
        record["steps"] = len(results[0].times)
        record["settled"] = settled if np.isfinite(settled) else None
        record["errors"] = _describe_errors(entry, results, others, settled)
        if steps is None or steps == entry.scenario(seed).steps:
            record["judged"] = True
            record["verdicts"] = [describe_verdict(verdict) for verdict in entry.judge(results)]
        if output is not None:
            estimates = {"golden model": results[0]} if backend == "golden" else {}
            estimates["float64 reference"] = others[0]
            record["plots"] = [str(file) for file in draw(output, entry, backend, estimates)]
    record["okay"] = stopped is None and all(verdict["okay"] for verdict in record["verdicts"])
    record["seconds"] = time.perf_counter() - started
    return record


def cosimulate_entry(
    name: str,
    *,
    steps: int = COSIM_STEPS,
    seed: int = 0,
    pes: int = 1,
    output: Path | None = None,
    cache: Path = CACHE,
    simulator: Simulator = Simulator.VERILATOR,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the first steps of an entry on the Verilog, in lockstep with the golden model.

    Parameters
    ----------
    name
        Name of the entry.
    steps
        How many steps.
    seed
        Seed of the data.
    pes
        Number of processing elements.
    output
        Folder of the figure; None is none.
    cache
        Folder of compiled cores.
    simulator
        What simulates.
    progress
        Called with the phase, steps done and their total.

    Returns
    -------
    dict
        Ready for JSON; ``okay`` is whether every word that was read is the golden model's.

    Raises
    ------
    ValueError
        If there is no such entry, or it has fewer steps.
    SimulatorError
        If the simulator is not installed or fails.
    """
    entry = find(name)
    started = time.perf_counter()
    problem = CatalogueProblem(name=name, seed=seed, changes=(("pes", pes),))
    tell = progress or (lambda what, done, total: None)
    found = cosimulate_scenario(
        problem.scenario, steps, simulator=simulator, cache=cache,
        progress=lambda phase, done: tell(f"{name}: {phase}", done, steps),
    )  # fmt: skip
    simulated = found.results
    count = 0 if simulated is None else len(simulated.times)
    record: dict[str, Any] = {
        "name": name, "doc": entry.doc, "source": entry.source, "backend": "cosim", "seed": seed,
        "runs": 1, "steps": count, "settled": None, "stopped": found.stopped, "errors": [],
        "judged": False, "verdicts": [], "plots": [], "mismatch": found.mismatch,
        "words_compared": found.words_compared, "pes": pes, "cycles": found.cycles,
        "traffic": found.traffic, "okay": found.okay,
    }  # fmt: skip
    if simulated is not None:
        reference = run_scenario(simulated.scenario, steps=count)
        record["errors"] = _describe_errors(entry, [simulated], [reference], -np.inf)
        if output is not None:
            estimates = {"core, simulated": simulated, "float64 reference": reference}
            record["plots"] = [str(draw_errors(output / f"{name}-cosim.png", entry, estimates))]
    record["seconds"] = time.perf_counter() - started
    return record


def _run_both(
    name: str, *, backend: str, cosim_steps: int, seed: int, output: Path, cache: Path
) -> list[dict[str, Any]]:
    """Run an entry, and co-simulate some of its steps."""
    records = [run_entry(name, backend, seed=seed, output=output, cache=cache)]
    if cosim_steps and records[0]["stopped"] is None:
        records.append(cosimulate_entry(name, steps=cosim_steps, seed=seed, cache=cache))
    return records


def run_catalogue(
    backend: str = "golden",
    *,
    cosim_steps: int = 0,
    seed: int = 0,
    output: Path,
    cache: Path = CACHE,
    workers: int = 1,
    names: Iterable[str] | None = None,
) -> Iterator[list[dict[str, Any]]]:
    """Run entries one after the other, or on several processors.

    Parameters
    ----------
    backend
        As for :func:`run_entry`.
    cosim_steps
        How many steps of each to co-simulate as well; 0 is none.
    seed
        Seed of the first runs.
    output
        Folder of the figures.
    cache
        Folder of compiled cores.
    workers
        Processes.
    names
        Names of the entries; None is all.

    Yields
    ------
    list of dict
        Records of each entry, in the order of the names: as :func:`run_entry` gives it, and that of
        the co-simulation.

    Raises
    ------
    ValueError
        If there is no worker, or as :func:`run_entry`.
    SimulatorError
        If the simulator is not installed or fails.
    """
    run = partial(
        _run_both, backend=backend, cosim_steps=cosim_steps, seed=seed, output=output, cache=cache
    )
    with mapper(workers) as spread:
        yield from spread(run, tuple(CATALOGUE) if names is None else tuple(names))
