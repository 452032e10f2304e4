"""Co-simulating a scenario, in lockstep with the golden model.

::

    from strut.data import scenario        # any module that can be imported: scenario(steps)
    from ukf_sim.cosimulation import cosimulate

    found = cosimulate(scenario, steps=20)
    print(found.okay, found.cycles, found.run.x[-1])
"""

import pickle
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from ukf_sim.builds import Build
from ukf_sim.session import CACHE, Context, Job, run_job
from ukf_sim.simulators import Simulator
from ukf_sw.drivers.driver import Driver, Traffic
from ukf_sw.errors import StepError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problem import Problem
from ukf_sw.problems.running import Estimates, Run, run
from ukf_sw.spec.parameters import Pipeline

# What needs cocotb is imported in the process of the simulator only.

__all__ = ["Cosimulation", "Iteration", "Observations", "cosimulate", "observe"]

#: Regions that are compared after every step; the others are compared at the beginning and at the
#: end, because the driver reads them rarely.
OFTEN = ("X", "x", "L")


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """What a step of the scenario took.

    Parameters
    ----------
    cycles
        Clocks of each step of the core, as it counted them.
    traffic
        Words on the bus.
    clocks
        Clocks of the whole iteration, software apart.
    bus_clocks, bus_words
        Clocks in which the bus was busy, and words that it carried.
    """

    cycles: dict[str, int]
    traffic: Traffic
    clocks: int
    bus_clocks: int
    bus_words: int


@dataclass(frozen=True, kw_only=True)
class Observations:
    """What was seen of a core while a filter ran on it.

    Parameters
    ----------
    mismatch
        What differed first from the golden model, or None.
    words_compared
        Words that were compared with the golden model's.
    first_cycles
        Clocks of each step of the core before the first iteration: of INIT.
    iterations
        What each iteration took.
    seconds, cpu_seconds
        Time that they took, and time of the processor.
    """

    mismatch: str | None
    words_compared: int
    first_cycles: dict[str, int]
    iterations: tuple[Iteration, ...] = field(repr=False)
    seconds: float
    cpu_seconds: float

    @property
    def fullest(self) -> Iteration | None:
        """The iteration with most clocks of the core, the last of several; None if there is none.

        It is not the first, which draws the sigma points that later ones have, unless there is no
        other.
        """
        return max(
            reversed(self.iterations[1:] or self.iterations),
            key=lambda each: sum(each.cycles.values()), default=None,
        )  # fmt: skip

    @property
    def cycles(self) -> dict[str, int]:
        """Clocks of each step of that iteration; empty if there is none."""
        return {} if self.fullest is None else self.fullest.cycles

    @property
    def traffic(self) -> Traffic:
        """Words on the bus of that iteration."""
        return Traffic() if self.fullest is None else self.fullest.traffic


@dataclass(frozen=True, kw_only=True, eq=False)
class Cosimulation(Observations):
    """What came of a scenario on the simulated core.

    Parameters
    ----------
    steps
        How many steps were asked for.
    run
        What the filter made of it; its ``stop`` is an error of the core.
    job
        Core and bus.
    build
        The compiled core.
    simulation_seconds
        How long the simulation ran, starting the process included.
    """

    steps: int
    run: Run
    job: Job
    build: Build
    simulation_seconds: float

    @property
    def observations(self) -> Observations:
        """The same without the problem; it passes between processes."""
        seen = {item.name: getattr(self, item.name) for item in fields(Observations)}
        return Observations(**seen)

    @property
    def okay(self) -> bool:
        """Whether all steps were run, and every word that was read is the golden model's."""
        return self.mismatch is None and self.run.stop is None and self.run.steps == self.steps


class _Observer:
    """Notes what each iteration takes, and compares what the driver does not read itself."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._driver = context.driver()
        self.first_cycles: dict[str, int] = {}
        self.iterations: list[Iteration] = []
        self._begin = self._end = _now()
        self._before = self._counts()

    @property
    def driver(self) -> Driver:
        """Driver of the core."""
        return self._driver

    @property
    def seconds(self) -> tuple[float, float]:
        """Time of the iterations, and time of the processor."""
        return self._end[0] - self._begin[0], self._end[1] - self._begin[1]

    def after_step(self, done: int, ukf: UnscentedKalmanFilter) -> None:
        """Note an iteration, or the beginning; the reading for it counts in none of them."""
        if done:
            (traffic, *numbers), (traffic_before, *before) = self._counts(), self._before
            clocks, bus_clocks, bus_words = (
                now - then for now, then in zip(numbers, before, strict=True)
            )
            self.iterations.append(
                Iteration(
                    cycles=dict(self._driver.last_cycles), traffic=traffic - traffic_before,
                    clocks=clocks, bus_clocks=bus_clocks, bus_words=bus_words,
                )
            )  # fmt: skip
            self._context.lockstep.verify(OFTEN)
            self._context.report(done)
        else:
            self.first_cycles |= self._driver.last_cycles
            self._context.lockstep.verify()
            self._begin = _now()
        self._end = _now()
        self._driver.last_cycles.clear()
        self._before = self._counts()

    def _counts(self) -> tuple[Traffic, int, int, int]:
        bench = self._context.bench
        return self._driver.traffic, bench.clock, bench.bus_clocks, bench.words


def _now() -> tuple[float, float]:
    """Time, and time of the processor, in seconds."""
    return time.perf_counter(), time.process_time()


def observe(
    context: Context, *, make: Callable[[int], Problem], steps: int
) -> tuple[Estimates, Observations]:
    """Run a filter on a scenario in lockstep: the task of :func:`cosimulate`.

    Parameters
    ----------
    context
        The core.
    make
        Makes the scenario, a problem with its data, of so many steps.
    steps
        How many steps.
    """
    from ukf_sim.lockstep import MismatchError

    problem = make(steps)
    bus = context.lockstep
    estimates = Estimates(
        x=np.empty((0, problem.params.n)),
        nis_of_sensors=np.empty((0, len(problem.sensor_names))),
        gated=np.empty(0, dtype=np.bool_),
    )
    observer = mismatch = None
    try:
        observer = _Observer(context)
        found = run(
            problem, observer.driver, steps=steps, ends_at=(StepError, MismatchError),
            covariance=True, after_step=observer.after_step,
        )  # fmt: skip
        estimates = found.estimates
        if estimates.stop is not None and estimates.stop.kind is MismatchError:
            mismatch, estimates = estimates.stop.message, replace(estimates, stop=None)
        else:
            bus.verify()
    except MismatchError as error:
        mismatch = str(error)
    seconds, cpu_seconds = (0.0, 0.0) if observer is None else observer.seconds
    return estimates, Observations(
        mismatch=mismatch,
        words_compared=bus.words_compared,
        first_cycles={} if observer is None else observer.first_cycles,
        iterations=() if observer is None else tuple(observer.iterations),
        seconds=seconds,
        cpu_seconds=cpu_seconds,
    )


def _check_importable(make: Callable[[int], Problem]) -> None:
    """Check that another process finds the function as well."""
    try:
        text = pickle.dumps(make)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"make must be a function at the top level of a module, not {make!r}: {error}"
        ) from error
    if b"__main__" in text:
        raise ValueError(
            "make must be in a module that can be imported, not in the script that is run: "
            f"{make!r}"
        )


def cosimulate(
    make: Callable[[int], Problem],
    steps: int,
    *,
    pipeline: Pipeline | None = None,
    simulator: Simulator = Simulator.VERILATOR,
    interrupt: bool = True,
    word_clocks: float = 0.0,
    cache: Path = CACHE,
    optimise: bool = True,
    waves: Path | None = None,
    progress: Callable[[str, int], None] | None = None,
) -> Cosimulation:
    """Run the first steps of a scenario on the Verilog, in lockstep with the golden model.

    Parameters
    ----------
    make
        Makes the scenario, a problem with its data, of at least so many steps: ``make(steps)``. It
        is called here and, because the models run there, in the process of the simulator. So it
        must be found there: a function at the top level of a module that can be imported, a
        ``functools.partial`` of one, or a method of an object that can be pickled, as
        :meth:`ukf_sw.problems.recipe.Recipe.scenario`.
    steps
        How many steps.
    pipeline, interrupt, word_clocks
        As :class:`ukf_sim.session.Job` takes them.
    simulator, cache, optimise, waves, progress
        As :func:`ukf_sim.session.run_job` takes them.

    Raises
    ------
    ValueError
        If `make` would not be found in another process, the scenario has fewer steps, or `waves`
        is no file for a waveform of the simulator.
    SimulatorError
        If the simulator is not installed or fails, or a model raises something in it.
    """
    _check_importable(make)
    problem = make(steps)
    if not 1 <= steps <= problem.steps:
        raise ValueError(f"steps must be between 1 and {problem.steps}, not {steps!r}")
    job = Job(
        params=problem.params,
        pipeline=pipeline or Pipeline(),
        task="ukf_sim.cosimulation:observe",
        arguments={"make": make, "steps": steps},
        interrupt=interrupt,
        word_clocks=word_clocks,
    )
    result = run_job(job, simulator, cache=cache, optimise=optimise, waves=waves, progress=progress)
    estimates, observed = result.value
    return Cosimulation(
        steps=steps,
        run=Run.of(problem, estimates),
        job=job,
        build=result.build,
        simulation_seconds=result.seconds,
        **vars(observed),
    )
