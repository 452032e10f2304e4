"""Steps executed on arrays of numbers, bit for bit as a core does."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ukf_sw.elementary.primitives import evaluate, evaluate_root
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import Operand, PickStep, RootStep, Step, Temporary

__all__ = ["execute"]

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
