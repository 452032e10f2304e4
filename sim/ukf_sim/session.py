"""Running a function in the process of a simulator, with the simulated core at hand."""

import pickle
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ukf_sim.builds import Build, build
from ukf_sim.signal_lists import Signals, write_signal_lists
from ukf_sim.simulators import Simulator, SimulatorError
from ukf_sw.drivers.driver import Driver
from ukf_sw.engine.microcode import microcode
from ukf_sw.extras import require
from ukf_sw.folders import check_folder
from ukf_sw.golden import GoldenCore
from ukf_sw.spec.parameters import Pipeline, UkfParams

if TYPE_CHECKING:
    from ukf_sim.bus import CoreBench
    from ukf_sim.lockstep import LockstepBus

__all__ = [
    "CACHE",
    "JOB_VARIABLE",
    "Context",
    "Job",
    "JobResult",
    "TaskFailure",
    "run_job",
    "step_timeout",
]

#: Folder of compiled cores.
CACHE = Path("build/cosim")
#: Environment variable with the folder of a job, for the process of the simulator.
JOB_VARIABLE = "UKF_COSIM_JOB"

_POLL_SECONDS = 0.1


@dataclass(frozen=True, kw_only=True)
class Job:
    """What to run on a simulated core.

    Parameters
    ----------
    params, pipeline
        What the core computes, and how it is built.
    task
        Function to run, as "module:name". It is called in a thread of the simulator's process,
        with a :class:`Context` and the arguments; its result must be picklable.
    arguments
        Keyword arguments of the task.
    interrupt
        Whether the driver waits for the interrupt, or polls.
    word_clocks
        Clocks that a bus word takes at least, on average; 0 is as fast as the core answers.
    """

    params: UkfParams
    pipeline: Pipeline = field(default_factory=Pipeline)
    task: str
    arguments: dict[str, Any] = field(default_factory=dict)
    interrupt: bool = True
    word_clocks: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TaskFailure:
    """An exception of a task, in the process of the simulator.

    Parameters
    ----------
    kind, message, trace
        Name of its class, its message, its traceback.
    notes
        Notes on it: it is one of the user's models, and they say which.
    """

    kind: str
    message: str
    trace: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class JobResult:
    """What came of a job.

    Parameters
    ----------
    value
        What the task returned.
    build
        The compiled core.
    seconds
        How long the simulation ran, starting the process included.
    """

    value: Any
    build: Build
    seconds: float


def step_timeout(params: UkfParams, pipeline: Pipeline, word_clocks: float = 0.0) -> float:
    """Give a time, in simulated seconds, that no step needs."""
    from ukf_sim.bus import CLOCK_HZ

    code = microcode(params, pipeline)
    longest = max(code.clocks(*routine) for routine in code.programs)
    return (2 * longest + 1000 + 100 * word_clocks) / CLOCK_HZ


@dataclass(frozen=True, kw_only=True)
class Context:
    """What a task works with, in the process of the simulator.

    Parameters
    ----------
    job
        The job.
    bench
        The simulated core.
    folder
        Folder of the job.
    """

    job: Job
    bench: "CoreBench"
    folder: Path

    @cached_property
    def lockstep(self) -> "LockstepBus":
        """A bus with the simulated core and a golden model behind it, the same at every call."""
        from ukf_sim.bus import CosimBus
        from ukf_sim.lockstep import LockstepBus

        job = self.job
        golden = GoldenCore(job.params, job.pipeline)
        return LockstepBus(CosimBus(self.bench), golden, job.pipeline)

    def driver(self) -> Driver:
        """Make a driver on that bus, with a time-out that no step needs."""
        bus = self.lockstep
        return Driver(
            bus,
            self.job.params,
            interrupt=bus.wait_for_interrupt if self.job.interrupt else None,
            timeout=step_timeout(self.job.params, self.job.pipeline, self.job.word_clocks),
            clock=bus.clock,
            count_cycles=True,
        )

    def report(self, done: int) -> None:
        """Tell the waiting process how many steps are done."""
        (self.folder / "progress").write_text(str(done), encoding="ascii")


def run_job(
    job: Job,
    simulator: Simulator = Simulator.VERILATOR,
    *,
    cache: Path = CACHE,
    optimise: bool = True,
    waves: Path | None = None,
    progress: Callable[[str, int], None] | None = None,
) -> JobResult:
    """Generate and compile a core, unless that was done before, and run a job on it.

    Parameters
    ----------
    job
        What to run.
    simulator
        Where to run it.
    cache
        Folder of compiled cores.
    optimise
        Whether to compile for speed; see :func:`ukf_sim.builds.build`.
    waves
        Where to write a waveform, with lists of its signals beside it; see
        :mod:`ukf_sim.signal_lists`. Its suffix is that of the simulator's format.
    progress
        Called with the phase, "generate", "compile" unless that was done before, or "simulate", and
        the number of steps done, a few times a second.

    Returns
    -------
    JobResult

    Raises
    ------
    ValueError
        If `waves` is no file for a waveform of that simulator, or nothing can be written to the
        cache.
    SimulatorError
        If the simulator is not installed or fails.
    MissingExtraError
        If an extra that this needs is not installed.
    """
    # Extras are asked for here, so that what names a co-simulation can be imported without them.
    require("hdl", "sim", "golden")
    simulator.require()
    if waves is not None:
        simulator.require_waves(waves)
    check_folder("cache", cache)
    from ukf_hdl.generate import NAME, generate

    tell = progress or (lambda phase, done: None)
    with tempfile.TemporaryDirectory(prefix="ukf-cosim-") as scratch:
        folder = Path(scratch)
        tell("generate", 0)
        generate(job.params, job.pipeline, folder / "rtl")
        signals = None if waves is None else Signals(microcode(job.params, job.pipeline))
        compiled = build(
            folder / "rtl" / f"{NAME}.v", NAME, simulator, cache, optimise=optimise,
            waves=None if signals is None else signals.words,
            compiling=lambda: tell("compile", 0),
        )  # fmt: skip
        tell("simulate", 0)
        start = time.monotonic()
        if waves is not None and signals is not None:
            write_signal_lists(waves, signals, simulator)
        value = _run(job, compiled, folder, waves, tell)
        return JobResult(value=value, build=compiled, seconds=time.monotonic() - start)


def _run(
    job: Job, compiled: Build, folder: Path, waves: Path | None, tell: Callable[[str, int], None]
) -> Any:
    from ukf_sim.cocotb_run import run_cocotb

    (folder / "job.pickle").write_bytes(pickle.dumps(job))
    errors: list[SimulatorError] = []

    def work() -> None:
        try:
            environment = {JOB_VARIABLE: str(folder)}
            run_cocotb(
                compiled, "ukf_sim.simulator_side", folder, environment=environment, waves=waves
            )
        except SimulatorError as error:
            errors.append(error)

    thread = threading.Thread(target=work, name="simulator")
    thread.start()
    while thread.is_alive():
        thread.join(_POLL_SECONDS)
        tell("simulate", _progress(folder))
    file = folder / "result.pickle"
    result = pickle.loads(file.read_bytes()) if file.exists() else None
    if isinstance(result, TaskFailure):
        if result.notes:
            raise SimulatorError("\n".join([result.message, *result.notes]))
        raise SimulatorError(
            f"{job.task} failed in {compiled.simulator.value}: {result.kind}: {result.message}\n"
            f"{result.trace}"
        )
    if errors:
        raise errors[0]
    return result


def _progress(folder: Path) -> int:
    """Read what :meth:`Context.report` wrote last."""
    file = folder / "progress"
    text = file.read_text(encoding="ascii") if file.exists() else ""
    return int(text) if text.isdecimal() else 0
