"""The last steps of a program: they write the rows of the result.

The array writes the rows of f over those that f reads, and reads no row of a result again. So each
row is written once, in all lanes, by a step of its own at the end of the program, and not before
all that read the row as it was. Where the steps of a model are not like that, copies are added.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.spec.forms import Condition
from ukf_sw.spec.model_programs import Operand, SlotStep, Step, Temporary

__all__ = ["end"]


def _reads(steps: Iterable[Step]) -> Counter[Temporary]:
    return Counter(temporary for step in steps for temporary in step.reads)


def end(
    builder: SequenceBuilder, results: Sequence[Operand], states: Mapping[Temporary, int] | None
) -> tuple[Operand, ...]:
    """Bring the steps of a builder into the order that ends with the results.

    Parameters
    ----------
    builder
        Has the steps.
    results
        Rows of the result, and what else is written like them.
    states
        Inputs that are the rows that are written over, with their numbers; None if the result goes
        elsewhere.

    Returns
    -------
    tuple of Operand
        What is in the place of the results: an input only where its row stays as it is.
    """
    steps = builder.steps
    reads = _reads(steps) + Counter(result for result in results if isinstance(result, Temporary))
    writes = Counter(step.destination for step in steps)
    own: dict[Temporary, SlotStep] = {
        step.destination: step
        for step in steps
        if isinstance(step, SlotStep) and step.form.condition is Condition.ALWAYS
    }
    last: dict[int, SlotStep] = {}
    ended: list[Operand] = list(results)
    for row, result in enumerate(results):
        if isinstance(result, Temporary):
            if states is not None and states.get(result) == row:
                continue
            if result in own and writes[result] == 1 and reads[result] == 1:
                last[row] = own[result]
                continue
        ended[row] = builder.scaled(1.0, result)
        last[row] = _taken(builder)
    final = {step.destination for step in last.values()}
    builder.steps[:] = [step for step in steps if step.destination not in final]
    if states is not None:
        _untangle(builder, last, ended, states)
    builder.steps += last.values()
    return tuple(ended)


def _taken(builder: SequenceBuilder) -> SlotStep:
    step = builder.steps[-1]
    assert isinstance(step, SlotStep)
    return step


def _untangle(
    builder: SequenceBuilder,
    last: dict[int, SlotStep],
    ended: list[Operand],
    states: Mapping[Temporary, int],
) -> None:
    """Sort the last steps so that no row is written before another last step has read it."""
    left = dict(last)
    last.clear()

    def readers(row: int) -> list[int]:
        return [
            other
            for other, step in left.items()
            if other != row and row in (states.get(temporary) for temporary in step.reads)
        ]

    while left:
        row = next((row for row in left if not readers(row)), None)
        if row is None:
            row = next(iter(left))
            for other in readers(row):
                builder.steps.append(left[other])
                ended[other] = builder.scaled(1.0, left[other].destination)
                left[other] = _taken(builder)
                builder.steps.pop()
        last[row] = left.pop(row)
