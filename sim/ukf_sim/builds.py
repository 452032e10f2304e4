"""Compiled Verilog, kept in a folder so that nothing is compiled twice."""

import hashlib
import json
import os
import platform
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ukf_sim.simulators import (
    Simulator,
    SimulatorError,
    Waves,
    is_plain,
    plain,
    tool_environment,
)
from ukf_sw.extras import importing
from ukf_sw.folders import locked

__all__ = ["EXECUTABLE", "Build", "build", "build_executable", "is_whole"]

#: Name of the executable of :func:`build_executable`.
EXECUTABLE = "program"

_DONE = "built.json"


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


def build(
    verilog: Path,
    top: str,
    simulator: Simulator,
    cache: Path,
    *,
    optimise: bool = True,
    waves: Sequence[str] | None = None,
    compiling: Callable[[], None] | None = None,
) -> Build:
    """Compile Verilog for cocotb, unless the same has been compiled before and is still whole.

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
    waves
        If it is to write waveforms, the words of arrays in them; of everything else they have all.
        A build that can is another, slower one.
    compiling
        Called before something is compiled.

    Returns
    -------
    Build

    Raises
    ------
    SimulatorError
        If the simulator is not installed or does not compile the source, or there is no place.
    """
    simulator.require()
    tool = simulator.tool
    with importing("sim"):
        from cocotb_tools import config
        from cocotb_tools.runner import get_runner

    make_flags = simulator.make_flags(optimise)
    flags = [*tool.cocotb_flags, *tool.flags]
    name, settings = tool.cocotb_settings or ("", "")
    settings = settings.format(top=top)
    identity = {
        "verilog": hashlib.sha256(verilog.read_bytes()).hexdigest(),
        "top": top,
        "simulator": [simulator.value, simulator.version],
        "flags": [*flags, make_flags, settings],
        # The executable is linked to these.
        "cocotb": [version("cocotb"), str(plain(config.libs_dir))],
        "python": platform.python_version(),
    }
    probe = None
    if waves is not None:
        flags += tool.waves.flags
        probe = _probe(tool.waves, top, waves)
        identity["waves"] = [tool.waves.flags, probe]

    def compile_into(folder: Path) -> None:
        arguments, sources = list(flags), [verilog.resolve()]
        if settings:
            (folder / name).write_text(settings, encoding="utf-8")
            arguments.append(str(folder / name))
        if probe is not None:
            sources.append(folder / probe[0])
            sources[-1].write_text(probe[1], encoding="utf-8")
        log = folder / "build.log"
        try:
            with tool_environment(make_flags), _plain_attributes(config):
                get_runner(simulator.value).build(
                    sources=sources,
                    hdl_toplevel=top,
                    build_dir=folder,
                    build_args=arguments,
                    timescale=("1ns", "1ps"),
                    always=True,
                    waves=waves is not None and tool.waves.by_runner,
                    log_file=log,
                )
        except (RuntimeError, SystemExit, OSError) as error:
            raise SimulatorError.with_log(
                f"{simulator.value} failed to compile {verilog} ({error})", log
            ) from error

    program = tool.program.format(top=top)
    return _cached(cache, identity, simulator, top, program, compile_into, compiling)


def _probe(waves: Waves, top: str, words: Sequence[str]) -> tuple[str, str] | None:
    """Name and text of the source that records a waveform, if one is needed."""
    if waves.probe is None:
        return None
    name, text = waves.probe
    statements = (waves.word.format(name=word) for word in words)
    return name, text.format(top=top, words="\n    ".join(statements))


def build_executable(
    verilog: Path,
    top: str,
    sources: Sequence[Path],
    objects: Sequence[Path],
    cache: Path,
    *,
    includes: Sequence[Path] = (),
    libraries: Sequence[str] = (),
    optimise: bool = True,
    compiling: Callable[[], None] | None = None,
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
    libraries
        Names of libraries of the system to link, as "dl".
    optimise, compiling
        As for :func:`build`.

    Returns
    -------
    Build
        Its folder has the executable :data:`EXECUTABLE`.

    Raises
    ------
    SimulatorError
        If Verilator is not installed or does not compile the source.
    """
    simulator = Simulator.VERILATOR
    simulator.require()
    make_flags = simulator.make_flags(optimise)
    flags = [*simulator.tool.flags]
    for library in libraries:
        flags += ["-LDFLAGS", f"-l{library}"]
    # What is compiled is what was hashed, even if somebody edits the files meanwhile.
    inputs = {path.name: path.read_bytes() for path in (verilog, *sources, *objects)}
    identity = {
        "inputs": {name: hashlib.sha256(text).hexdigest() for name, text in inputs.items()},
        "top": top,
        "simulator": [simulator.value, simulator.version],
        "flags": [*flags, make_flags],
    }

    def compile_into(folder: Path) -> None:
        copies = [folder / "inputs" / name for name in inputs]
        copies[0].parent.mkdir()
        for copy, text in zip(copies, inputs.values(), strict=True):
            copy.write_bytes(text)
        command = [
            "verilator", "--cc", "--exe", "--build", *flags, "--top-module", top,
            "--Mdir", str(folder), "-o", EXECUTABLE,
            "-CFLAGS", " ".join(f"-I{plain(path.resolve())}" for path in includes),
            *map(str, copies),
        ]  # fmt: skip
        log = folder / "build.log"
        with tool_environment(make_flags), log.open("w", encoding="utf-8") as output:
            code = subprocess.run(command, stdout=output, stderr=output, check=False).returncode
        if code:
            raise SimulatorError.with_log(f"verilator failed to compile {verilog}", log)

    return _cached(cache, identity, simulator, top, EXECUTABLE, compile_into, compiling)


@contextmanager
def _plain_attributes(config: Any) -> Iterator[None]:
    """Have cocotb name its own folders so that make can work with them."""
    before = config.libs_dir, config.share_dir
    config.libs_dir, config.share_dir = map(plain, before)
    try:
        yield
    finally:
        config.libs_dir, config.share_dir = before


def _digest(file: Path) -> str | None:
    """Digest of a file, or None if it cannot be read."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return None


def is_whole(folder: Path, program: str) -> bool:
    """Whether a folder has the program that was compiled into it, unchanged.

    Parameters
    ----------
    folder
        Folder of a :class:`Build`.
    program
        Name of the file that is run.
    """
    try:
        kept = json.loads((folder / _DONE).read_bytes())[program]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return kept is not None and kept == _digest(folder / program)


def _cached(
    cache: Path,
    identity: dict[str, Any],
    simulator: Simulator,
    top: str,
    program: str,
    compile_into: Callable[[Path], None],
    compiling: Callable[[], None] | None,
) -> Build:
    """Compile into a folder of the cache, unless the same is there already."""
    key = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:24]
    folder = (cache / key).resolve()
    start = time.monotonic()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with locked(folder.parent / f"{key}.lock"):
            compiled = not is_whole(folder, program)
            if compiled:
                if compiling is not None:
                    compiling()
                _compile(folder, program, compile_into, identity, simulator)
    except OSError as error:
        raise SimulatorError(f"{cache} cannot keep what is compiled: {error}") from error
    return Build(
        simulator=simulator,
        top=top,
        folder=folder,
        compiled=compiled,
        seconds=time.monotonic() - start,
    )


def _compile(
    folder: Path,
    program: str,
    compile_into: Callable[[Path], None],
    identity: dict[str, Any],
    simulator: Simulator,
) -> None:
    """Compile where make can, which knows no blanks in names, and put what comes out into place."""
    if not is_plain(tempfile.gettempdir()):
        raise SimulatorError(
            "The folder of temporary files (TMPDIR) must have a name without blanks and signs that "
            f"mean something to make, not {tempfile.gettempdir()!r}"
        )
    shutil.rmtree(folder, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="ukf-build-") as scratch:
        made = Path(scratch, folder.name)
        made.mkdir()
        with _library(made, folder.parent, identity, simulator):
            compile_into(made)
        record = {program: _digest(made / program), "identity": identity}
        (made / _DONE).write_text(json.dumps(record, indent=2), encoding="utf-8")
        shutil.move(made, folder)


@contextmanager
def _library(
    made: Path, cache: Path, identity: dict[str, Any], simulator: Simulator
) -> Iterator[None]:
    """Have the simulator's own library compiled already, which takes longer than most designs.

    What it is compiled to depends on everything but the design, and is kept in the cache.
    """
    if not simulator.tool.library:
        yield
        return
    version_of = ["c++", "--version"]
    compiler = subprocess.run(version_of, capture_output=True, text=True, check=False).stdout
    of_design = ("verilog", "inputs", "top", "python")
    same = {name: value for name, value in identity.items() if name not in of_design}
    same["compiler"] = compiler.partition("\n")[0]
    folder = cache / f"library-{hashlib.sha256(json.dumps(same).encode()).hexdigest()[:24]}"
    lock = folder.with_suffix(".lock")
    with locked(lock):
        kept = _whole_objects(folder)
        # Make compiles what is older than the makefile, which is not written yet.
        later = time.time() + 3600.0
        for file in kept:
            shutil.copy(file, made)
            os.utime(made / file.name, (later, later))
    yield
    objects = sorted(made.glob(simulator.tool.library))
    if kept or not objects:
        return
    with locked(lock):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for file in objects:
            shutil.copy(file, folder)
        record = {"objects": {file.name: _digest(file) for file in objects}, "identity": same}
        (folder / _DONE).write_text(json.dumps(record, indent=2), encoding="utf-8")


def _whole_objects(folder: Path) -> list[Path]:
    """Objects of a library that is kept; none if one of them is missing or has changed."""
    try:
        digests: dict[str, str] = json.loads((folder / _DONE).read_bytes())["objects"]
        whole = all(_digest(folder / name) == digest for name, digest in digests.items())
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return []
    return [folder / name for name in digests] if whole else []
