"""Building and running the C of ``tools/ukf_tools/baseline/c``, natively or for the Cortex-A9."""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ukf_sw.lowering.c_models import c_files
from ukf_sw.lowering.software import software_models
from ukf_sw.problem import Problem
from ukf_sw.problems.systems.nanosat import nanosat
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.parameters import Noise

__all__ = ["ARM", "NATIVE", "SOURCES", "VARIANTS", "BaselineError", "Executable", "Target", "build"]

SOURCES = Path(__file__).with_name("c")
#: Variants of the program, with the noise of the scenario that each takes.
VARIANTS = {
    "gsl": Noise.AUGMENTED,
    "fast": Noise.AUGMENTED,
    "fast-additive": Noise.ADDITIVE,
    "traced": Noise.AUGMENTED,
    "traced-additive": Noise.ADDITIVE,
}
#: Names of the models in C that are written for it, as fast.c includes them.
_TRACED = {"traced": Noise.AUGMENTED, "traced_additive": Noise.ADDITIVE}

_WARNINGS = ("-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
#: -O2 is the papers'. NEON has no IEEE arithmetic, so vectors need leave to use it.
_FAST = ("-O3", "-funsafe-math-optimizations")
_OBJECTS = (
    ("dense", "dense.c", ("-O2",)),
    ("fast", "fast.c", _FAST),
    ("fast_additive", "fast.c", (*_FAST, "-DADDITIVE")),
    ("fast_traced", "fast.c", (*_FAST, "-DTRACED")),
    ("fast_traced_additive", "fast.c", (*_FAST, "-DTRACED", "-DADDITIVE")),
    ("main", "main.c", ("-O2",)),
)


class BaselineError(Exception):
    """A tool is missing, or failed."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """A machine to compile for.

    Parameters
    ----------
    compiler
        C compiler.
    flags
        Its flags for the machine.
    link
        Its flags for linking.
    emulator
        What runs the program, or nothing.
    """

    compiler: str
    flags: tuple[str, ...] = ()
    link: tuple[str, ...] = ()
    emulator: tuple[str, ...] = ()


NATIVE = Target(compiler="gcc")
ARM = Target(
    compiler="arm-linux-gnueabihf-gcc",
    flags=("-mcpu=cortex-a9", "-mfpu=neon-vfpv3", "-mfloat-abi=hard", "-marm"),
    link=("-static",),
    emulator=("qemu-arm", "-cpu", "cortex-a9"),
)


def need(tool: str) -> str:
    """Path of a tool.

    Raises
    ------
    BaselineError
        If it is not installed.
    """
    found = shutil.which(tool)
    if found is None:
        raise BaselineError(f"{tool} is not installed; docs/baseline.md says what is needed")
    return found


def execute(command: list[str], given: bytes | None = None) -> bytes:
    """Run a command, with what it is given on its standard input, and give its output.

    Raises
    ------
    BaselineError
        If it fails.
    """
    need(command[0])
    result = subprocess.run(command, capture_output=True, check=False, input=given)
    if result.returncode:
        text = result.stderr.decode(errors="replace").strip()
        raise BaselineError(f"{Path(command[0]).name} failed: {text[-2000:]}")
    return result.stdout


@dataclass(frozen=True, kw_only=True)
class Executable:
    """The program, compiled.

    Parameters
    ----------
    path
        The file.
    target
        For which machine.
    """

    path: Path
    target: Target

    def run(
        self, variant: str, problem: Problem, emulator_flags: tuple[str, ...] = ()
    ) -> np.ndarray:
        """Run a variant on a scenario of the nanosatellite.

        Parameters
        ----------
        variant
            One of :data:`VARIANTS`.
        problem
            With W0 = 0, inputs, and all observations in every step.
        emulator_flags
            Further flags of the emulator.

        Returns
        -------
        array of shape (steps, 7)
            Estimates.

        Raises
        ------
        BaselineError
            If a pivot was not positive, or the program failed otherwise.
        """
        data, (measurements, _) = problem.record, problem.samples()
        assert data.inputs is not None
        first = (problem.steps, problem.times[0], *problem.x0)
        matrices = (problem.P0, problem.Q, problem.R)
        steps = np.hstack((np.asarray(data.inputs), measurements))
        numbers = np.concatenate((first, *(a.reshape(-1) for a in matrices), steps.reshape(-1)))
        emulator = [*self.target.emulator, *emulator_flags] if self.target.emulator else []
        output = execute([*emulator, str(self.path), variant], numbers.tobytes())
        return np.frombuffer(output).reshape(-1, len(problem.x0))


def _write_models(name: str, noise: Noise, folder: Path) -> None:
    """Write the models of the nanosatellite in C, as they are traced."""
    models = software_models(nanosat(0, steps=1, noise=noise), BINARY32)
    ((h,),) = models.h.values()
    for file, text in c_files({"f": models.f, "h": h}, prefix=name).items():
        (folder / file).write_text(text, encoding="utf-8")


def build(target: Target, folder: Path, sysroot: Path | None = None) -> Executable:
    """Compile the program.

    Parameters
    ----------
    target
        For which machine.
    folder
        Where to put it; made if absent.
    sysroot
        Folder with ``usr/include/gsl`` and the static libraries of the GNU Scientific Library for
        that machine; None is the compiler's own.

    Raises
    ------
    BaselineError
        If the compiler or the library is missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    compiler = [target.compiler, *target.flags]
    include, libraries = [], []
    if sysroot is not None:
        archives = sorted(sysroot.glob("usr/lib/*/libgsl.a"))
        if not archives:
            raise BaselineError(
                f"{sysroot} has no GNU Scientific Library; run {SOURCES / 'fetch-gsl.sh'} {sysroot}"
            )
        include = [f"-I{sysroot / 'usr' / 'include'}"]
        libraries = [f"-L{archives[0].parent}"]
    sources = [(name, SOURCES / source, flags) for name, source, flags in _OBJECTS]
    for name, noise in _TRACED.items():
        _write_models(name, noise, folder)
        sources.append((name, folder / f"{name}.c", ("-O3",)))
    objects: list[str] = []
    for name, source, flags in sources:
        objects.append(str(folder / f"{name}.o"))
        execute([*compiler, *_WARNINGS, *flags, *include, f"-I{folder}", "-c", str(source), "-o",
                 objects[-1]])  # fmt: skip
    path = folder / "baseline"
    execute(
        [*compiler, *target.link, *objects, *libraries, "-lgsl", "-lgslcblas", "-lm", "-o",
         str(path)]
    )  # fmt: skip
    return Executable(path=path, target=target)
