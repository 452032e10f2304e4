"""Compiling the C driver and application."""

import shutil
import subprocess
from collections.abc import Sequence
from enum import Enum
from pathlib import Path

from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.generate import description
from ukf_hdl.interfaces.c_driver import c_headers
from ukf_sw.c_sources import C_SOURCES, DRIVER_SOURCES
from ukf_sw.spec.parameters import UkfParams

__all__ = [
    "APPLICATION",
    "DRIVER",
    "INCLUDES",
    "LINUX_MAIN",
    "CompilerError",
    "Toolchain",
    "compile_c",
    "compile_objects",
    "write_headers",
]

#: Sources of the driver; of the nanosatellite; of its main program for Linux, with the ports.
DRIVER = tuple(C_SOURCES / name for name in DRIVER_SOURCES)
APPLICATION = tuple(
    C_SOURCES / "apps" / name
    for name in ("nanosat/nanosat.c", "nanosat/nanosat_files.c", "scenario_file.c")
)
LINUX_MAIN = tuple(
    C_SOURCES / name for name in ("apps/nanosat/nanosat_linux.c", "ports/uio.c", "ports/remote.c")
)
#: Folders of headers.
INCLUDES = tuple(C_SOURCES / name for name in (".", "ports", "apps", "apps/nanosat"))

#: No fused multiply-add: the order and rounding of operations are those of the source.
FLAGS = (
    "-std=c11", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion",
    "-Wshadow", "-Wstrict-prototypes", "-Wmissing-prototypes", "-Werror",
)  # fmt: skip


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
    for name, text in c_headers(description(UkfCore(params))).items():
        (folder / name).write_text(text, encoding="utf-8")


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
    toolchain.require()
    folders = [f"-I{path}" for path in (*INCLUDES, *includes)]
    link = [] if "-c" in flags else ["-lm"]
    command = [
        *toolchain.command, *FLAGS, *flags, *folders, *map(str, sources), "-o", str(output), *link,
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise CompilerError(f"{' '.join(command)}:\n{result.stderr}")
    return output


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
