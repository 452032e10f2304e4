"""The program for the processor of a Zynq, in an emulator of that processor, on the golden model.

The program is the one for the board, statically linked: only the port that it is told to use
differs, a socket to the golden model instead of UIO.
"""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ukf_sim.c_in_the_loop.compiler import (
    LINUX_MAIN,
    CompilerError,
    Toolchain,
    compile_application,
    write_headers,
    write_models,
)
from ukf_sim.c_in_the_loop.loop import first_difference, golden_results, in_software
from ukf_sw.problem import Problem
from ukf_sw.problems.scenario_files import CResults, export_scenario, read_results
from ukf_tools.arm.register_server import RegisterServer

__all__ = ["EMULATOR", "ArmOutcome", "arm_available", "require_arm", "run_on_arm"]

EMULATOR = ("qemu-arm", "-cpu", "cortex-a9")
#: Name of the program.
PROGRAM = "ukf_run"
#: Longest that a step of the scenario may take in the emulator, in seconds.
PATIENCE = 5.0


def arm_available() -> bool:
    """Whether compiler and emulator are installed."""
    return Toolchain.CORTEX_A9.available and shutil.which(EMULATOR[0]) is not None


def require_arm() -> None:
    """Demand both.

    Raises
    ------
    CompilerError
        If one is not installed.
    """
    if shutil.which(EMULATOR[0]) is None:
        raise CompilerError(f"{EMULATOR[0]} is not installed")
    Toolchain.CORTEX_A9.require()


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmOutcome:
    """What came of a run.

    Parameters
    ----------
    program
        The executable.
    results
        What it wrote.
    mismatch
        First difference from the Python filter on the golden model, or None.
    words
        Words on the bus.
    seconds
        Time that the run took.
    """

    program: Path
    results: CResults
    mismatch: str | None
    words: int
    seconds: float


def run_on_arm(
    problem: Problem,
    steps: int,
    folder: Path,
    *,
    models: Sequence[Path] = (),
    interrupt: bool = True,
    warn: Callable[[str], None] | None = None,
) -> ArmOutcome:
    """Cross-compile an application for a Cortex-A9 and run it under QEMU.

    Parameters
    ----------
    problem
        The problem, with the parameters of the core.
    steps
        How many of its steps.
    folder
        Folder for the program, its headers and its samples; made if absent.
    models
        C files with its models, as :func:`ukf_sim.c_in_the_loop.compiler.compile_application` takes
        them; without any they are written from those in Python.
    interrupt
        Whether the driver waits for the interrupt, or polls.
    warn
        Called with the warnings about the C files of the user, if there are any.

    Returns
    -------
    ArmOutcome

    Raises
    ------
    ValueError
        If the scenario cannot be exported, or the models cannot be written in C.
    TraceError
        If a model cannot be a program.
    CompilerError
        If compiler or emulator are not installed, or the program does not compile or fails.
    """
    require_arm()
    binary, _ = export_scenario(problem, steps, folder)
    write_headers(problem.params, folder)
    if not models:
        problem = write_models(problem, folder)
    program = compile_application(
        folder / PROGRAM, folder, in_software(problem, models), main=LINUX_MAIN,
        toolchain=Toolchain.CORTEX_A9, link_flags=("-static",), warn=warn,
    )  # fmt: skip
    results = folder / "results.bin"
    # Names of sockets are short, folders may be deep.
    with tempfile.TemporaryDirectory(prefix="ukf-arm-") as scratch:
        path = Path(scratch) / "socket"
        with RegisterServer.of_golden(path, problem.params) as server:
            start = time.monotonic()
            done = subprocess.run(
                [*EMULATOR, str(program), f"remote:{path}", str(binary), str(results),
                 *(() if interrupt else ("polling",))],
                capture_output=True, text=True, check=False, timeout=60.0 + PATIENCE * steps,
            )  # fmt: skip
            seconds = time.monotonic() - start
    if done.returncode:
        raise CompilerError(f"{program} ended with the code {done.returncode}:\n{done.stderr}")
    found = read_results(results, problem.params, steps)
    return ArmOutcome(
        program=program,
        results=found,
        mismatch=first_difference(found, golden_results(problem, steps), done.stderr),
        words=server.words,
        seconds=seconds,
    )
