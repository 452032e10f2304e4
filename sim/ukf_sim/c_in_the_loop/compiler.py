"""Compiling the C driver and applications."""

import gc
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Sequence
from enum import Enum
from pathlib import Path

from amaranth.hdl import UnusedElaboratable

from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.generate import description
from ukf_hdl.interfaces.c_driver import c_headers
from ukf_sw.c_sources import C_SOURCES, DRIVER_SOURCES
from ukf_sw.lowering.c_problem import c_problem_files
from ukf_sw.lowering.software import software_models
from ukf_sw.problem import Problem
from ukf_sw.spec.parameters import UkfParams

__all__ = [
    "BARE_METAL_MAIN",
    "DRIVER",
    "INCLUDES",
    "LINUX_MAIN",
    "RUN",
    "RUN_FILES",
    "CompilerError",
    "Toolchain",
    "compile_application",
    "compile_c",
    "compile_objects",
    "models_in",
    "write_headers",
    "write_models",
]

#: Sources of the driver; of an application with models that were written for it.
DRIVER = tuple(C_SOURCES / name for name in DRIVER_SOURCES)
APPLICATION = C_SOURCES / "apps" / "problem_application.c"
#: Of any application: what runs it; the same with files; main programs, with the ports.
RUN = (C_SOURCES / "apps" / "scenario_run.c",)
RUN_FILES = tuple(
    C_SOURCES / "apps" / name for name in ("scenario_run.c", "run_files.c", "scenario_file.c")
)
LINUX_MAIN = tuple(
    C_SOURCES / name for name in ("apps/linux_main.c", "ports/uio.c", "ports/remote.c")
)
BARE_METAL_MAIN = tuple(
    C_SOURCES / name for name in ("apps/bare_metal_main.c", "ports/bare_metal.c")
)
#: Folders of headers.
INCLUDES = tuple(C_SOURCES / name for name in (".", "ports", "apps"))

#: No fused multiply-add: the order and rounding of operations are those of the source.
FLAGS = ("-O2", "-ffp-contract=off", "-Wall", "-Wextra")
#: Of what is ours, any warning is an error.
OWN_FLAGS = (
    "-std=c11", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wstrict-prototypes",
    "-Wmissing-prototypes", "-Werror",
)  # fmt: skip
#: Of what is the user's, warnings are told; M_PI is not of C11.
USER_FLAGS = ("-std=gnu11",)


class CompilerError(Exception):
    """A compiler is missing, or refused the source."""


class Toolchain(Enum):
    """A compiler, with the flags for its processor."""

    NATIVE = "native"
    CORTEX_A9 = "cortex-a9"

    @property
    def command(self) -> tuple[str, ...]:
        """Compiler and flags."""
        if self is Toolchain.NATIVE:
            return ("cc",)
        return (
            "arm-linux-gnueabihf-gcc", "-mcpu=cortex-a9", "-mfpu=neon-vfpv3", "-mfloat-abi=hard",
            "-marm",
        )  # fmt: skip

    @property
    def available(self) -> bool:
        """Whether it is installed."""
        return shutil.which(self.command[0]) is not None

    def require(self) -> None:
        """Raise CompilerError unless it is installed."""
        if not self.available:
            raise CompilerError(f"{self.command[0]} is not installed")


def write_headers(params: UkfParams, folder: Path) -> None:
    """Write the generated headers of a core, without its Verilog.

    Parameters
    ----------
    params
        What the core computes.
    folder
        Folder to write to; made if absent.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        # Amaranth says of parts of a core that they were never elaborated, when they are destroyed.
        warnings.simplefilter("ignore", UnusedElaboratable)
        headers = c_headers(description(UkfCore(params)))
        gc.collect()
    for name, text in headers.items():
        (folder / name).write_text(text, encoding="utf-8")


def write_models(problem: Problem, folder: Path) -> Problem:
    """Write the models of a problem in C, for :func:`models_in`.

    Parameters
    ----------
    problem
        The problem, with its data and the parameters of the core.
    folder
        Folder of the headers of the core.

    Returns
    -------
    Problem
        The same with models that compute the same bits in Python.

    Raises
    ------
    TraceError
        If a model cannot be a program.
    ValueError
        If they cannot be written in C.
    """
    models = software_models(problem)
    for name, text in c_problem_files(models).items():
        (folder / name).write_text(text, encoding="utf-8")
    return models.rounded


def models_in(folder: Path) -> tuple[Path, ...]:
    """Give the sources of an application with the models that were written to a folder."""
    return (*(folder / f"{name}.c" for name in ("ukf_model", "ukf_problem")), APPLICATION)


def compile_c(
    sources: Sequence[Path],
    output: Path,
    includes: Sequence[Path],
    *,
    toolchain: Toolchain = Toolchain.NATIVE,
    flags: Sequence[str] = (),
) -> Path:
    """Compile and link C sources.

    Parameters
    ----------
    sources
        The sources.
    output
        File to write.
    includes
        Folders of generated headers; those of the sources are known.
    toolchain
        For which processor.
    flags
        Further flags: ``-shared``, ``-static``, ``-c``.

    Returns
    -------
    Path
        The output.

    Raises
    ------
    CompilerError
        If the compiler is not installed or does not compile the source; any warning is an error.
    """
    folders = [f"-I{path}" for path in (*INCLUDES, *includes)]
    link = [] if "-c" in flags else ["-lm"]
    arguments = [*FLAGS, *OWN_FLAGS, *flags, *folders, *map(str, sources), "-o", str(output), *link]
    _run(toolchain, arguments)
    return output


def _run(toolchain: Toolchain, arguments: Sequence[str]) -> str:
    """Run a compiler; gives its warnings."""
    toolchain.require()
    command = [*toolchain.command, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise CompilerError(f"{' '.join(command)}:\n{result.stderr}")
    return result.stderr


def compile_objects(
    sources: Sequence[Path],
    folder: Path,
    includes: Sequence[Path],
    *,
    toolchain: Toolchain = Toolchain.NATIVE,
    flags: Sequence[str] = (),
) -> list[Path]:
    """Compile each source to an object file; arguments and errors as :func:`compile_c`."""
    folder.mkdir(parents=True, exist_ok=True)
    return [
        compile_c(
            [source], folder / f"{source.stem}.o", includes, toolchain=toolchain,
            flags=("-c", *flags),
        )
        for source in sources
    ]  # fmt: skip


def compile_application(
    output: Path,
    headers: Path,
    models: Sequence[Path] | None = (),
    *,
    main: Sequence[Path] = (),
    toolchain: Toolchain = Toolchain.NATIVE,
    flags: Sequence[str] = (),
    link_flags: Sequence[str] = (),
    warn: Callable[[str], None] | None = None,
) -> Path:
    """Compile and link an application: the driver, what runs a scenario, and models.

    Parameters
    ----------
    output
        File to write.
    headers
        Folder of the generated headers of the core.
    models
        C files of the user, with ``ukf_application()``: see sw/c/apps/application.h. Their folders
        are searched for headers. Without any they are those that :func:`write_models` has written
        to the folder of the headers; None: the core has all models.
    main
        Sources of the main program.
    toolchain
        For which processor.
    flags, link_flags
        Further flags, for compiling and linking; for linking alone.
    warn
        Called with the warnings of the compiler about the C files of the user, if there are any.

    Returns
    -------
    Path
        The output.

    Raises
    ------
    CompilerError
        If the compiler is not installed or does not compile a source.
    """
    written = () if models or models is None else models_in(headers)
    own, models = [*DRIVER, *RUN_FILES, *main, *written], models or ()
    searched = [*INCLUDES, headers, *dict.fromkeys(source.resolve().parent for source in models)]
    folders = [f"-I{path}" for path in searched]
    with tempfile.TemporaryDirectory(prefix="ukf-objects-") as scratch:
        folder = Path(scratch)
        objects: list[Path] = []
        for number, source in enumerate(models):
            # Files in different folders may have the same name.
            objects.append(folder / f"models-{number}.o")
            told = _run(
                toolchain,
                [*FLAGS, *USER_FLAGS, "-c", *flags, *folders, str(source), "-o", str(objects[-1])],
            )
            if told and warn is not None:
                warn(told)
        objects += compile_objects(own, folder, [headers], toolchain=toolchain, flags=flags)
        _run(toolchain, [*flags, *link_flags, *map(str, objects), "-o", str(output), "-lm"])
    return output
