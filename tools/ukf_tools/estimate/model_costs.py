"""What a model costs as a program of a core."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ukf_sw.elementary.accuracy import largest_error
from ukf_sw.engine.control_word import STEERING, steering
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.microcode import STEP_OVERHEAD, compile_program
from ukf_sw.engine.timing import Timing
from ukf_sw.spec.forms import Reading, Root
from ukf_sw.spec.model_programs import ModelProgram, SlotStep, Temporary
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine

__all__ = ["clocks_of_models", "cost_of", "most_temporaries"]

#: Fields of the control word that the programs of the filter have.
_OF_FILTER = STEERING[:3]


def most_temporaries(program: ModelProgram) -> int:
    """Give how many temporaries hold something at once, one step after the other.

    Rows of sigma points, which are there anyway, are not counted, nor are results.
    """
    outputs = (*program.outputs, *(value for _, value in program.measurements))
    elsewhere = {each for each in outputs if isinstance(each, Temporary)}
    elsewhere |= {
        temporary for temporary, source in program.inputs if source.kind.value in ("x", "noise")
    }
    first: dict[Temporary, int] = {
        temporary: -1 for temporary, _ in program.inputs if temporary not in elsewhere
    }
    last: dict[Temporary, int] = dict(first)
    for number, step in enumerate(program.steps):
        for temporary in (*step.reads, step.destination):
            if temporary not in elsewhere:
                first.setdefault(temporary, number)
                last[temporary] = number
    return max(
        (
            sum(start <= number <= last[temporary] for temporary, start in first.items())
            for number in range(-1, len(program.steps))
        ),
        default=0,
    )


def cost_of(program: ModelProgram, functions: Sequence[str]) -> dict[str, Any]:
    """Describe what a program needs, ready for JSON.

    Parameters
    ----------
    program
        The program.
    functions
        Names of the elementary functions in it.

    Returns
    -------
    dict
        ``slots`` of a beat, and ``once`` for all of them; ``streams`` of words through 1/sqrt;
        constants as ``scalars`` and as ``words``; the most ``temporaries`` at once; ``functions``
        with their largest error in units in the last place, None if it is not measured in this
        format; ``forms``, the steering of operands that the filter does without; whether lanes read
        ``powers`` and ``exponents``; whether there are ``signed_roots``.
    """
    needed = {name for form in program.forms for name in steering(form)}
    readings = {form.reading for form in program.forms}
    slots = sum(isinstance(step, SlotStep) for step in program.steps)
    return {
        "slots": program.slots,
        "once": slots - program.slots,
        "streams": program.streams,
        "scalars": list(program.scalars),
        "words": list(program.words),
        "temporaries": most_temporaries(program),
        "functions": [
            {"name": name, "error_ulp": largest_error(name, program.fmt)} for name in functions
        ],
        "forms": [name for name in STEERING if name in needed and name not in _OF_FILTER],
        "powers": Reading.POWER in readings,
        "exponents": Reading.EXPONENT in readings,
        "signed_roots": Root.SIGNED in program.roots,
    }


def clocks_of_models(params: UkfParams, pes: Sequence[int]) -> dict[Routine, dict[int, int]]:
    """Give the clocks of the program of each model, by numbers of processing elements.

    They are those of :meth:`ukf_sw.engine.microcode.Microcode.clocks`. Only these programs are
    scheduled.

    Parameters
    ----------
    params
        The core; its own number of processing elements does not matter.
    pes
        Numbers of processing elements.

    Raises
    ------
    ValueError
        If a number is not one that the core can have.
    """
    models = params.models
    routines = [] if models.f is None else [Routine(Program.MODEL_F)]
    routines += [
        Routine(Program.MODEL_H, sensor, variant)
        for sensor, variants in enumerate(models.h)
        for variant in range(len(variants))
    ]
    found: dict[Routine, dict[int, int]] = {routine: {} for routine in routines}
    for number in pes:
        layout = Layout(replace(params, pes=number))
        timing = Timing(number, Pipeline())
        for routine in routines:
            length = compile_program(layout, timing, routine).plan.length
            found[routine][number] = length + STEP_OVERHEAD
    return found
