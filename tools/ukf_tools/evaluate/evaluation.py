"""Evaluating entries of the catalogue: run on a backend, judged, compared with their bounds."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from ukf_sim.cosimulation import Observations, cosimulate
from ukf_sim.session import CACHE
from ukf_sim.simulators import Simulator
from ukf_sw.errors import UkfError
from ukf_sw.extras import MissingExtraError
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.entry import Entry
from ukf_sw.problems.finding import find
from ukf_sw.problems.judging import Judgement, Verdict, judge
from ukf_sw.problems.placing import core_models
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import Run, run
from ukf_sw.spec.core import Placement
from ukf_tools.evaluate.figures import draw, draw_errors
from ukf_tools.evaluate.workers import mapper

__all__ = ["BACKENDS", "Evaluation", "evaluate", "evaluate_all", "evaluate_in_simulator"]

#: What can compute an entry.
BACKENDS = ("reference", "golden", "cosim")
#: Processing elements of the golden model, or as many as there are columns: those of the 2018
#: paper's fastest core. They decide in which order sums are rounded.
PES = 10
#: Steps of a co-simulation unless told otherwise; slow sensors have a sample by then.
COSIM_STEPS = 30

#: Where the models are when all entries are run, if nothing else is said.
PLACEMENTS = (Placement.SOFTWARE, Placement.CORE)

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What came of an entry. It passes between processes.

    Parameters
    ----------
    name, doc, source
        The entry.
    backend, models
        What computed, and which models the core evaluated.
    seed, runs
        Seed of the first run, and number of runs.
    steps
        Steps of each run; None if there is no whole one.
    settled
        Time after which errors were judged, in seconds, or None.
    judgement
        Errors, those of the float64 reference beside them; None if a run stopped, or of a study.
    verdicts
        Comparison with the bounds, which are those of whole runs; None if it was not made.
    rounding
        Comparison with the float64 reference on the same data; None if it was not made.
    stopped
        Why a run ended early, or None.
    pes
        Processing elements of the simulated core, or None.
    observed
        What was seen of it, or None.
    plots
        Figures.
    seconds
        How long it took.
    """

    name: str
    doc: str
    source: str
    backend: str
    models: Placement = Placement.SOFTWARE
    seed: int
    runs: int
    steps: int | None
    settled: float | None = None
    judgement: Judgement | None = None
    verdicts: tuple[Verdict, ...] | None = None
    rounding: tuple[Verdict, ...] | None = None
    stopped: str | None = None
    pes: int | None = None
    observed: Observations | None = None
    plots: tuple[Path, ...] = ()
    seconds: float = 0.0

    @property
    def okay(self) -> bool:
        """Whether nothing is wrong.

        No error of the core, no mismatch, and whatever was compared is within its bounds.
        """
        if self.stopped is not None:
            return False
        if self.observed is not None and self.observed.mismatch is not None:
            return False
        return all(verdict.okay for verdict in (*(self.verdicts or ()), *(self.rounding or ())))

    def as_dict(self) -> dict[str, Any]:
        """Give all of it, ready for JSON."""
        record: dict[str, Any] = {
            "name": self.name, "doc": self.doc, "source": self.source, "backend": self.backend,
            "models": self.models.value,
            "seed": self.seed, "runs": self.runs, "steps": self.steps, "settled": self.settled,
            "stopped": self.stopped,
            "errors": [] if self.judgement is None else self.judgement.as_dict()["errors"],
            "judged": self.verdicts is not None,
            "verdicts": [verdict.as_dict() for verdict in self.verdicts or ()],
            "rounding": [verdict.as_dict() for verdict in self.rounding or ()],
            "plots": [str(plot) for plot in self.plots],
            "okay": self.okay, "seconds": self.seconds,
        }  # fmt: skip
        observed = self.observed
        if observed is not None:
            record |= {
                "mismatch": observed.mismatch, "words_compared": observed.words_compared,
                "pes": self.pes, "cycles": observed.cycles, "traffic": asdict(observed.traffic),
            }  # fmt: skip
        return record


def _unjudged(
    entry: Entry,
    backend: str,
    models: Placement,
    *,
    seed: int,
    runs: int,
    steps: int | None,
    stopped: str | None,
) -> Evaluation:
    """What there is to say before anything is compared."""
    return Evaluation(
        name=entry.name, doc=entry.doc, source=entry.source, backend=backend, models=models,
        seed=seed, runs=runs, steps=steps, stopped=stopped,
    )  # fmt: skip


def evaluate(
    name: str,
    backend: str = "golden",
    *,
    models: Placement = Placement.SOFTWARE,
    steps: int | None = None,
    seed: int = 0,
    output: Path | None = None,
    cache: Path = CACHE,
    progress: Progress | None = None,
) -> Evaluation:
    """Run an entry, judge it beside the float64 reference on the same data, compare with bounds.

    Parameters
    ----------
    name
        Name of the entry.
    backend
        "reference", "golden", or "cosim": the Verilog, in lockstep with the golden model.
    models
        Which models the core evaluates; of the reference they are in software.
    steps
        How many; None is all, or a few for "cosim". Bounds are those of whole runs only.
    seed
        Seed of the first run.
    output
        Folder of the figure; None is none.
    cache
        Folder of compiled cores.
    progress
        Called with what runs, steps done and their total.

    Raises
    ------
    ValueError
        If there is no such entry or backend, or it has fewer steps, or cannot have such models.
    SimulatorError
        If the simulator is not installed or fails.
    """
    if backend not in BACKENDS:
        raise ValueError(f"--backend must be one of {', '.join(BACKENDS)}, not {backend!r}")
    if backend == "cosim":
        return evaluate_in_simulator(
            name, models=models, steps=COSIM_STEPS if steps is None else steps, seed=seed,
            output=output, cache=cache, progress=progress,
        )  # fmt: skip
    (made,) = _evaluate_each(name, backend, (models,), steps, seed, output, progress)
    return made


@dataclass
class _Runs:
    """Runs of one kind, until one stops."""

    backend: str
    models: Placement
    runs: list[Run] = field(default_factory=list[Run])
    stopped: str | None = None
    seconds: float = 0.0

    @property
    def label(self) -> str:
        """What computes, with where the models are if they are not in software."""
        there = self.models is Placement.SOFTWARE
        return self.backend if there else f"{self.backend}, models {self.models.value}"

    def add(self, entry: Entry, seed: int, steps: int | None, progress: Progress | None) -> None:
        """Run once more."""
        started = time.perf_counter()
        problem = entry.scenario(seed, steps)
        params = replace(problem.params, pes=min(PES, problem.params.columns))
        models = core_models(entry.name, self.models.value, params.format)
        label = f"{entry.name}: {self.label}, run {len(self.runs) + 1}"
        made = run(
            problem.for_core(replace(params, models=models)), self.backend, ends_at=(UkfError,),
            progress=None if progress is None else partial(progress, label), every=500,
        )  # fmt: skip
        if made.stop is None:
            self.runs.append(made)
        else:
            kind = made.stop.kind.__name__
            self.stopped = f"{self.label}, seed {seed}: {kind}: {made.stop.message}"
        self.seconds += time.perf_counter() - started


def _evaluate_each(
    name: str,
    backend: str,
    placements: Sequence[Placement],
    steps: int | None,
    seed: int,
    output: Path | None,
    progress: Progress | None,
) -> list[Evaluation]:
    """Evaluate an entry with its models in different places, beside one reference.

    The figure is that of the first; others have none.
    """
    if backend == "reference" and any(each is not Placement.SOFTWARE for each in placements):
        wrong = next(each for each in placements if each is not Placement.SOFTWARE)
        raise ValueError(f"--models must be software of the reference, not {wrong.value!r}")
    entry = find(name, "NAME")
    entry.check_seed(seed)
    reference = _Runs("reference", Placement.SOFTWARE)
    kinds = [_Runs(backend, each) for each in placements]
    for number in range(1 if steps is not None else entry.runs):
        try:
            reference.add(entry, seed + number, steps, progress)
            for kind in kinds:
                if kind.stopped is None and reference.stopped is None and backend != "reference":
                    kind.add(entry, seed + number, steps, progress)
        except MissingExtraError as error:
            reference.stopped = str(error)
        if reference.stopped is not None:
            break
    found: list[Evaluation] = []
    for kind in kinds:
        own = reference if backend == "reference" else kind
        stopped = reference.stopped or own.stopped
        made = _unjudged(
            entry, backend, kind.models, seed=seed, runs=len(own.runs), steps=None, stopped=stopped
        )
        if stopped is None:
            drawn = None if found else output
            made = _judged(made, entry, own, reference, steps, drawn)
        # The reference is run once.
        shared = reference.seconds if not found and own is not reference else 0.0
        found.append(replace(made, seconds=own.seconds + shared))
    return found


def _judged(
    made: Evaluation,
    entry: Entry,
    own: _Runs,
    reference: _Runs,
    steps: int | None,
    output: Path | None,
) -> Evaluation:
    """Judge runs that none of which stopped."""
    judgement = judge(own.runs, reference.runs)
    first = own.runs[0]
    whole = steps is None or steps == entry.scenario(made.seed).steps
    return replace(
        made,
        steps=first.steps,
        settled=judgement.since,
        judgement=judgement,
        verdicts=judgement.compare(entry.bounds) if whole else None,
        rounding=judgement.compare_with_reference(entry.rounding, entry.exceptions)
        if whole
        else None,
        plots=_plots(entry, own, reference, output),
    )


def _plots(entry: Entry, own: _Runs, reference: _Runs, output: Path | None) -> tuple[Path, ...]:
    """Draw the first run."""
    if output is None:
        return ()
    drawn = {"golden model": own.runs[0]} if own.backend == "golden" else {}
    drawn["float64 reference"] = reference.runs[0]
    return tuple(draw(output, entry, own.label.replace(", ", "-").replace(" ", "-"), drawn))


def evaluate_in_simulator(
    name: str,
    *,
    models: Placement = Placement.SOFTWARE,
    steps: int = COSIM_STEPS,
    seed: int = 0,
    pes: int = 1,
    output: Path | None = None,
    cache: Path = CACHE,
    simulator: Simulator = Simulator.VERILATOR,
    progress: Progress | None = None,
) -> Evaluation:
    """Run the first steps of an entry on the Verilog, in lockstep with the golden model.

    Parameters
    ----------
    name
        Name of the entry.
    models
        Which models the core evaluates.
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

    Raises
    ------
    ValueError
        If there is no such entry, or it has fewer steps.
    SimulatorError
        If the simulator is not installed or fails.
    """
    entry = find(name, "NAME")
    started = time.perf_counter()
    tell = progress or (lambda what, done, total: None)
    found = cosimulate(
        Recipe.of(name, seed=seed, pes=pes, models=models.value).scenario, steps,
        simulator=simulator, cache=cache,
        progress=lambda phase, done: tell(f"{name}: {phase}", done, steps),
    )  # fmt: skip
    own = found.run
    stopped = None if own.stop is None else own.stop.message
    made = _unjudged(entry, "cosim", models, seed=seed, runs=1, steps=own.steps, stopped=stopped)
    made = replace(made, pes=pes, observed=found.observations)
    if own.steps:
        reference = run(own.problem, steps=own.steps)
        made = replace(made, judgement=judge(own, reference))
        if output is not None:
            drawn = {"core, simulated": own, "float64 reference": reference}
            made = replace(
                made, plots=(draw_errors(output / f"{name}-cosim.png", entry, drawn),)
            )  # fmt: skip
    return replace(made, seconds=time.perf_counter() - started)


def _evaluate_all_of(
    name: str,
    *,
    backend: str,
    models: Sequence[Placement],
    cosim_steps: int,
    seed: int,
    output: Path,
    cache: Path,
) -> list[Evaluation]:
    """Run an entry with its models in each place, and co-simulate some of its steps."""
    seed = 0 if find(name).recorded else seed
    if backend == "cosim":
        return [
            evaluate(name, backend, models=each, seed=seed, output=output, cache=cache)
            for each in models
        ]
    made = _evaluate_each(name, backend, models, None, seed, output, None)
    if cosim_steps:
        made += [
            evaluate_in_simulator(name, models=each, steps=cosim_steps, seed=seed, cache=cache)
            for each, found in zip(models, made, strict=True)
            if found.stopped is None
        ]
    return made


def evaluate_all(
    backend: str = "golden",
    *,
    models: Sequence[Placement] | None = None,
    cosim_steps: int = 0,
    seed: int = 0,
    output: Path,
    cache: Path = CACHE,
    workers: int = 1,
    names: Iterable[str] | None = None,
) -> Iterator[list[Evaluation]]:
    """Run entries one after the other, or on several processors.

    Parameters
    ----------
    backend
        As for :func:`evaluate`.
    models
        Where the models are; each entry is run with them in each of these places. None: in software
        and on the core, of the reference in software.
    cosim_steps
        How many steps of each to co-simulate as well; 0 is none.
    seed
        Seed of the first runs; records have none.
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
    list of Evaluation
        Of each entry, in the order of the names: with the models in each place, then the
        co-simulations.

    Raises
    ------
    ValueError
        If there is no worker, or as :func:`evaluate`.
    SimulatorError
        If the simulator is not installed or fails.
    """
    if models is None:
        models = PLACEMENTS[:1] if backend == "reference" else PLACEMENTS
    work = partial(
        _evaluate_all_of, backend=backend, models=tuple(models), cosim_steps=cosim_steps,
        seed=seed, output=output, cache=cache,
    )  # fmt: skip
    with mapper(workers) as spread:
        yield from spread(work, tuple(CATALOGUE) if names is None else tuple(names))
