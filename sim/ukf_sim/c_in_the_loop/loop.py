"""C in the loop: the C driver and application on the simulated core, against the golden model.

The program is one process: the model that Verilator makes of the generated Verilog, a manager on
its AXI4-Lite port (harness.cpp), and the C code as it would run on the board, as a shared library,
so that other models need no other program.

The estimates are compared bit for bit with those of the Python filter on the golden model. The
models in C are written from the functions in Python, and compute what a core with these models
would; the filter in Python has them in the same arithmetic. Models of one's own in C are compared
with the functions themselves, both in double: if they use +, -, *, / and sqrt only, in the same
order, and the C code is compiled without fused multiply-add, IEEE 754 leaves no room for a
difference. Those that are on the core are the same there and in the golden model.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ukf_hdl.generate import NAME, generate
from ukf_sim.builds import EXECUTABLE, Build, build_executable
from ukf_sim.c_in_the_loop.compiler import (
    INCLUDES,
    Toolchain,
    compile_application,
    write_headers,
    write_models,
)
from ukf_sim.session import CACHE, step_timeout
from ukf_sim.simulators import Simulator, SimulatorError
from ukf_sw.errors import StepError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.folders import check_folder
from ukf_sw.problem import Problem
from ukf_sw.problems.running import run
from ukf_sw.problems.scenario_files import CResults, export_scenario, read_results
from ukf_sw.spec.core import Placement
from ukf_sw.spec.parameters import Pipeline

__all__ = [
    "CLoopOutcome",
    "first_difference",
    "golden_results",
    "in_software",
    "require_tools",
    "run_c_in_the_loop",
]

HARNESS = Path(__file__).with_name("harness.cpp")
#: Of a shared library in which nothing is missing, which is so by default but on Linux.
SHARED = ("-shared", *(("-Wl,--no-undefined",) if sys.platform == "linux" else ()))


@dataclass(frozen=True, kw_only=True, eq=False)
class CLoopOutcome:
    """What came of a run.

    Parameters
    ----------
    results
        What the C application wrote.
    mismatch
        First difference from the golden model, or None.
    clocks
        Clocks of the core.
    words, bus_clocks
        Words on the bus, and the clocks that they took.
    seconds, cpu_seconds
        Time that the run took, the compilation excluded, and time of the processor: that is what
        other programs on the machine disturb less.
    build
        The program.
    """

    results: CResults
    mismatch: str | None
    clocks: int
    words: int
    bus_clocks: int
    seconds: float
    cpu_seconds: float
    build: Build


def golden_results(problem: Problem, steps: int, *, covariances: bool = False) -> CResults:
    """Run the Python filter on the golden model; results as the C application writes them.

    If a step fails it is the last one, and there is no P at the end.

    Parameters
    ----------
    problem
        The problem, with the parameters of the core.
    steps
        How many steps.
    covariances
        Whether the results have the covariance of each step.
    """
    each: list[NDArray[np.float64]] = []

    def note(done: int, ukf: UnscentedKalmanFilter) -> None:
        if covariances and done:
            each.append(ukf.P)

    found = run(
        problem, "golden", steps=steps, ends_at=(StepError,), covariance=True, after_step=note
    )
    x, nis, gated = found.x, _sums(found.nis_of_sensors), found.gated
    results = np.zeros(found.steps, np.uint32)
    if found.stop is not None and found.steps < steps:
        last = np.full(problem.params.n, np.nan) if found.last_x is None else found.last_x
        x, nis, gated = np.vstack([x, last]), np.append(nis, np.nan), np.append(gated, False)
        results = np.append(results, np.uint32(found.stop.code or 0))
    return CResults(
        x=x, nis=nis, results=results, gated=gated, P=found.P,
        covariances=np.array(each) if covariances else None,
    )  # fmt: skip


def _sums(nis_of_sensors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Add the NIS of the sensors in their order; NaN where nothing was sampled."""
    total = np.full(len(nis_of_sensors), np.nan)
    for nis in nis_of_sensors.T:
        there = ~np.isnan(nis)
        total[there] = np.where(np.isnan(total), 0.0, total)[there] + nis[there]
    return total


def first_difference(found: CResults, expected: CResults, said: str = "") -> str | None:
    """Name the first difference of two runs, or give None if they are equal bit for bit.

    If the expected one ended with a step that failed, what comes after that is not compared.

    Parameters
    ----------
    found, expected
        The runs.
    said
        What the found one printed: a line for each step that failed.
    """
    failed = expected.P is None
    if len(found.x) != len(expected.x) and not (failed and len(found.x) > len(expected.x)):
        return f"{len(found.x)} steps, not {len(expected.x)}"
    for name in ("results", "x", "nis", "gated", "covariances"):
        one, other = getattr(found, name), getattr(expected, name)
        if one is None or other is None:
            continue
        one = one[: len(other)]
        different = _bits(one) != _bits(other)
        if different.any():
            place = tuple(int(i) for i in np.argwhere(different)[0])
            step = f"step {place[0]}: "
            lines = [line for line in said.splitlines() if line.startswith(step)]
            what = f"{name} of {step}{one[place].item()!r}, not {other[place].item()!r}"
            return f"{what} ({lines[0]})" if lines and name == "results" else what
    if expected.P is None:
        return None
    if found.P is None or (_bits(found.P) != _bits(expected.P)).any():
        return "P at the end"
    return None


def _bits(values: np.ndarray) -> np.ndarray:
    """Words of numbers: -0 is not 0, and NaN is NaN."""
    if values.dtype.kind != "f":
        return values
    return np.where(np.isnan(values), np.nan, values).view(np.uint64)


def in_software(problem: Problem, models: Sequence[Path]) -> tuple[Path, ...] | None:
    """Give the C files of models for compile_application(); None if the core has all models."""
    return None if Placement.of(problem.models) is Placement.CORE else tuple(models)


def require_tools() -> None:
    """Demand what compiles the C code and the Verilog.

    Raises
    ------
    CompilerError, SimulatorError
        If something is not installed.
    """
    Toolchain.NATIVE.require()
    Simulator.VERILATOR.require()


def run_c_in_the_loop(
    problem: Problem,
    steps: int,
    *,
    pipeline: Pipeline | None = None,
    models: Sequence[Path] = (),
    interrupt: bool = True,
    word_clocks: float = 0.0,
    covariances: bool = False,
    cache: Path = CACHE,
    optimise: bool = True,
    warn: Callable[[str], None] | None = None,
    progress: Callable[[str], None] | None = None,
) -> CLoopOutcome:
    """Compile a C application and the simulated core, unless that was done before, and run them.

    Parameters
    ----------
    problem
        The problem, with the parameters of the core.
    steps
        How many of its steps.
    models
        C files with its models, as :func:`ukf_sim.c_in_the_loop.compiler.compile_application` takes
        them; without any they are written from those in Python.
    pipeline
        How the core is built.
    interrupt
        Whether the driver waits for the interrupt, or polls.
    word_clocks
        Clocks that a bus word takes at least, on average; 0 is as fast as the core answers.
    covariances
        Whether the application reads the covariance after each step. That is one more step of the
        core, and words on the bus.
    cache
        Folder of compiled programs.
    optimise
        Whether to compile for speed; see :func:`ukf_sim.builds.build`.
    warn
        Called with the warnings about the C files of the user, if there are any.
    progress
        Called with what is being done: "generate", "compile", "run", "compare".

    Returns
    -------
    CLoopOutcome

    Raises
    ------
    ValueError
        If the scenario cannot be exported, the models cannot be written in C, or nothing can be
        written to the cache.
    TraceError
        If a model cannot be a program.
    CompilerError, SimulatorError
        If a compiler is missing, at once; if something does not compile, or the program fails.
    """
    tell = progress or (lambda what: None)
    require_tools()
    check_folder("cache", cache)
    with tempfile.TemporaryDirectory(prefix="ukf-c-") as scratch:
        folder = Path(scratch)
        tell("generate")
        scenario_file, _ = export_scenario(problem, steps, folder)
        # First, because models are what is wrong most often.
        write_headers(problem.params, folder / "headers")
        if not models:
            problem = write_models(problem, folder / "headers")
        application = compile_application(
            folder / "application.so", folder / "headers", in_software(problem, models),
            flags=("-fPIC",), link_flags=SHARED, warn=warn,
        )  # fmt: skip
        generate(problem.params, pipeline, folder / "rtl")
        built = build_executable(
            folder / "rtl" / f"{NAME}.v", NAME, [HARNESS], [], cache, includes=INCLUDES,
            libraries=("dl",), optimise=optimise, compiling=lambda: tell("compile"),
        )  # fmt: skip
        tell("run")
        command = [
            str(built.folder / EXECUTABLE), str(application), str(scenario_file),
            str(folder / "results.bin"), str(folder / "counts"),
            "interrupt" if interrupt else "polling", "covariances" if covariances else "estimates",
            str(word_clocks),
            str(round(1e6 * step_timeout(problem.params, pipeline or Pipeline(), word_clocks))),
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SimulatorError(
                f"The C application ended with the code {done.returncode}:\n{done.stderr}"
            )
        results = read_results(
            folder / "results.bin", problem.params, steps, covariances=covariances
        )
        clocks, words, bus_clocks, seconds, cpu_seconds = (folder / "counts").read_text().split()
        tell("compare")
        return CLoopOutcome(
            results=results,
            mismatch=first_difference(
                results, golden_results(problem, steps, covariances=covariances), done.stderr
            ),
            clocks=int(clocks),
            words=int(words),
            bus_clocks=int(bus_clocks),
            seconds=float(seconds),
            cpu_seconds=float(cpu_seconds),
            build=built,
        )
