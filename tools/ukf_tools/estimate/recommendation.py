"""Which numbers of processing elements are worth their place, for a problem."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

from ukf_sw.engine.layout import Layout
from ukf_sw.engine.microcode import STEP_OVERHEAD, compile_program
from ukf_sw.engine.timing import Timing
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.estimate.latency import iteration

__all__ = ["RULE", "Choice", "candidates", "choices", "recommended"]

#: Which numbers are recommended, for people.
RULE = (
    "A number of PEs is recommended if no larger one gives more speedup per PE, and if it gives at "
    "least a third of the speedup that its added PEs promise over the recommended one before it."
)
#: Up to this number of columns every number of processing elements is tried: seconds.
_ALL = 32


class Choice(NamedTuple):
    """A number of processing elements.

    Parameters
    ----------
    pes
        The number.
    beats
        Beats of a row.
    cycles
        Cycles of an iteration.
    speedup_per_pe
        Speedup against one processing element, divided by their number.
    recommended
        Whether it is recommended.
    """

    pes: int
    beats: int
    cycles: int
    speedup_per_pe: float
    recommended: bool


def recommended(cycles: Mapping[int, int]) -> list[int]:
    """Give the numbers of processing elements that are worth their place; see :data:`RULE`.

    Parameters
    ----------
    cycles
        Cycles of an iteration, by number of processing elements.

    Returns
    -------
    list of int
        Those that are recommended, rising; the first one has none before it.
    """
    chosen: list[int] = []
    for pes in sorted(cycles):
        work = pes * cycles[pes]
        if any(larger * cycles[larger] < work for larger in cycles if larger > pes):
            continue
        if chosen:
            before = chosen[-1]
            # A third of (pes / before - 1), the speedup that they promise, without rounding.
            if 3 * before * (cycles[before] - cycles[pes]) < cycles[pes] * (pes - before):
                continue
        chosen.append(pes)
    return chosen


def candidates(params: UkfParams) -> list[int]:
    """Give the numbers of processing elements to compare.

    Up to 32 columns all that are legal. Else the fewest for each number of beats of a row, since
    more with as many beats change next to nothing.
    """
    legal = range(1, params.columns + 1)
    if params.columns <= _ALL:
        return list(legal)
    lengths = {params.columns}
    if params.form is Form.COVARIANCE:
        layout = Layout(params)
        lengths |= {layout.joint_rhs, layout.joint_rhs + 1}
    fewest: set[int] = set()
    for length in lengths:
        first: dict[int, int] = {}
        for pes in legal:
            first.setdefault(-(-length // pes), pes)
        fewest.update(first.values())
    return sorted(fewest)


def choices(
    params: UkfParams,
    pipeline: Pipeline,
    *,
    redraws: bool,
    tell: Callable[[int, int], None] | None = None,
) -> list[Choice]:
    """Compare numbers of processing elements, from the schedules of an iteration.

    Parameters
    ----------
    params, pipeline
        The core; its own number of processing elements does not matter.
    redraws
        As of :func:`ukf_tools.estimate.latency.latency`.
    tell
        Called with how many numbers are done, and of how many.
    """
    tried = candidates(params)
    cycles: dict[int, int] = {}
    for done, pes in enumerate(tried):
        if tell is not None:
            tell(done, len(tried))
        cycles[pes] = _cycles(replace(params, pes=pes), pipeline, redraws=redraws)
    chosen = recommended(cycles)
    return [
        Choice(
            pes, -(-params.columns // pes), cycles[pes],
            cycles[1] / cycles[pes] / pes, pes in chosen,
        )
        for pes in tried
    ]  # fmt: skip


def _cycles(params: UkfParams, pipeline: Pipeline, *, redraws: bool) -> int:
    """Cycles of an iteration. Only its programs are scheduled."""
    layout, timing = Layout(params), Timing(params.pes, pipeline)
    total = 0
    for routine in chain.from_iterable(iteration(params, redraws=redraws).values()):
        total += STEP_OVERHEAD
        parts = [routine]
        if routine.program is Program.UPDATE_REDRAWN:
            parts.append(Routine(Program.UPDATE, routine.sensor))
        total += sum(compile_program(layout, timing, part).plan.length for part in parts)
    return total
