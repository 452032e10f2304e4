"""Steps and programs executed on arrays of numbers, bit for bit as a core does."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ukf_sw.elementary.primitives import evaluate, evaluate_root
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import (
    ModelProgram,
    Operand,
    PickStep,
    RootStep,
    SourceKind,
    Step,
    Temporary,
)

__all__ = ["execute", "execute_program"]

_Numbers = NDArray[np.float64]


def execute(
    fmt: FloatFormat, steps: Sequence[Step], values: dict[Temporary, _Numbers], centre: int = 0
) -> None:
    """Execute steps in order.

    Parameters
    ----------
    fmt
        Number format.
    steps
        What to execute.
    values
        Numbers of that format by temporary, in one dimension, of lengths that broadcast; what the
        steps write is added.
    centre
        Which of them a :class:`PickStep` takes.
    """

    def read(operand: Operand | None) -> _Numbers:
        if isinstance(operand, Temporary):
            return values[operand]
        return np.array([operand.value if operand else 0.0])

    # Products of what is infinite or overflows are meant.
    with np.errstate(over="ignore", invalid="ignore"):
        for step in steps:
            if isinstance(step, RootStep):
                result = evaluate_root(fmt, step.root, values[step.source])
            elif isinstance(step, PickStep):
                result = values[step.source][centre : centre + 1]
            else:
                result = evaluate(
                    step.form, fmt, read(step.word_0), read(step.word_1), read(step.scalar),
                    values.get(step.destination, np.nan),
                )  # fmt: skip
            values[step.destination] = result


def execute_program(program: ModelProgram, numbers: Mapping[SourceKind, _Numbers]) -> _Numbers:
    """Give the results of a program at K sigma points, shape (rows, K).

    Parameters
    ----------
    program
        The program.
    numbers
        What it is given, by kind, shapes (rows, K), or (rows, 1) if that is the same at all points.
        It is rounded to the format.
    """
    fmt = program.fmt
    # NaN may be signalling.
    with np.errstate(invalid="ignore"):
        rounded = {kind: fmt.round(given.astype(np.float64)) for kind, given in numbers.items()}
    values = {temporary: rounded[source.kind][source.index] for temporary, source in program.inputs}
    execute(fmt, program.steps, values)
    results = np.empty((len(program.outputs), numbers[SourceKind.STATE].shape[1]))
    for row, output in enumerate(program.outputs):
        results[row] = values[output] if isinstance(output, Temporary) else output.value
    return results
