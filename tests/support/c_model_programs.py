"""Programs of models, as C and as the golden model executes them, on the same points."""

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sim.c_in_the_loop.compiler import Toolchain, compile_c
from ukf_sw.elementary.execution import execute_program
from ukf_sw.lowering.c_arithmetic import number_type
from ukf_sw.lowering.c_models import c_files
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import ModelProgram, SourceKind
from ukf_tools.arm.emulator import EMULATOR

__all__ = ["dtype", "execute_c", "execute_golden", "words"]

HARNESS = Path(__file__).with_name("c_model_programs.c")
KINDS = {"x": SourceKind.STATE, "noise": SourceKind.NOISE, "u": SourceKind.INPUT}

Numbers = NDArray[np.floating]


def dtype(fmt: FloatFormat) -> type[np.floating]:
    """Give the type of numbers in C."""
    return np.float32 if number_type(fmt) == "float" else np.float64


def words(values: Numbers) -> NDArray[np.unsignedinteger]:
    """Give the bits of numbers in C."""
    return values.view(np.uint32 if values.dtype == np.float32 else np.uint64)


def _sizes(program: ModelProgram) -> dict[str, int]:
    """Give how many numbers of each kind a program has."""
    return {
        name: max(
            (source.index + 1 for _, source in program.inputs if source.kind is kind), default=0
        )
        for name, kind in KINDS.items()
    }


def execute_golden(program: ModelProgram, points: Mapping[str, Numbers]) -> Numbers:
    """Give the results of a program at points, a row for each; as numbers in C.

    Parameters
    ----------
    program
        The program.
    points
        Rows of numbers by kind: x, noise, u.
    """
    numbers: dict[SourceKind, Any] = {kind: points[name].T for name, kind in KINDS.items()}
    return execute_program(program, numbers).T.astype(dtype(program.fmt))


def execute_c(
    programs: Mapping[str, ModelProgram],
    points: Mapping[str, Mapping[str, Numbers]],
    folder: Path,
    *,
    toolchain: Toolchain = Toolchain.NATIVE,
    flags: Sequence[str] = (),
) -> dict[str, Numbers]:
    """Compile programs and run them, with the arguments and results of :func:`execute_golden`.

    Parameters
    ----------
    programs
        Programs by name.
    points
        Points of each, as many of all.
    folder
        Folder for sources, programs, and points.
    toolchain, flags
        How it is compiled, and for which processor.
    """
    fmt = next(iter(programs.values())).fmt
    files = c_files(programs)
    for name, text in files.items():
        (folder / name).write_text(text)
    sizes = {name: _sizes(program) for name, program in programs.items()}
    room = max(*(max(size.values()) for size in sizes.values()),
               *(len(program.outputs) for program in programs.values()))  # fmt: skip
    rows = "".join(
        f"    {{ukf_model_{name}, {size['x']}, {size['noise']}, {size['u']}, "
        f"{len(programs[name].outputs)}}},\n"
        for name, size in sizes.items()
    )
    (folder / "functions.h").write_text(f"""\
#include "ukf_model.h"
typedef {number_type(fmt)} number;
#define ROOM {room}
static const struct {{
    void (*model)(const number x[], const number noise[], const number u[], number result[]);
    size_t x, noise, u, result;
}} functions[] = {{
{rows}}};
""")
    is_arm = toolchain is Toolchain.CORTEX_A9
    program = compile_c(
        [HARNESS, folder / "ukf_model.c"], folder / "program", [folder], toolchain=toolchain,
        flags=(*flags, *(("-static",) if is_arm else ())),
    )  # fmt: skip
    count = len(next(iter(points.values()))["x"])
    with (folder / "points").open("wb") as file:
        for name, size in sizes.items():
            table = np.hstack([points[name][kind][:, :number] for kind, number in size.items()])
            file.write(np.ascontiguousarray(table, dtype(fmt)).tobytes())
    subprocess.run(
        [*(EMULATOR if is_arm else ()), str(program), str(folder / "points"),
         str(folder / "results"), str(count)],
        check=True, timeout=300,
    )  # fmt: skip
    flat = np.fromfile(folder / "results", dtype(fmt))
    ends = np.cumsum([count * len(program.outputs) for program in programs.values()])
    assert len(flat) == ends[-1]
    return {
        name: part.reshape(count, -1)
        for name, part in zip(programs, np.split(flat, ends[:-1]), strict=True)
    }
