"""Why the programs of a core take as many clocks as they do."""

from collections import Counter
from collections.abc import Mapping
from itertools import groupby
from typing import Any, NamedTuple

from ukf_sw.engine.disassembler import disassemble
from ukf_sw.engine.microcode import Microcode
from ukf_sw.engine.mnemonics import Mnemonics
from ukf_sw.engine.operations import Route
from ukf_sw.engine.scheduler import Schedule
from ukf_sw.spec.sequence import Routine
from ukf_tools.estimate.occupancy import StageKind, stages
from ukf_tools.estimate.parts import parts
from ukf_tools.estimate.waits import Link, Reason, Waits

__all__ = ["Explanation", "Lanes", "Stretch", "explain"]


def _said(counts: Mapping[Reason, int]) -> dict[str, int]:
    """Reasons as text."""
    return {reason.value: count for reason, count in counts.items()}


class Lanes(NamedTuple):
    """Work of the lanes.

    Parameters
    ----------
    useful
        Lanes that take part, summed over the beats that multiply.
    of_beats
        All lanes of these beats.
    of_clocks
        All lanes of all clocks.
    """

    useful: int
    of_beats: int
    of_clocks: int


class Step(NamedTuple):
    """An operation of the longest chain.

    Parameters
    ----------
    link
        What it waits for.
    part
        Part of the program that it belongs to.
    kind
        Name of its kind.
    text
        The operation as the disassembler writes it, a line for each beat.
    """

    link: Link
    part: str
    kind: str
    text: list[str]

    def record(self) -> dict[str, Any]:
        """Describe it, ready for JSON."""
        link = self.link
        return {
            "clock": link.issue,
            "part": self.part,
            "text": self.text,
            "waits_for": None if link.waits_for is None else link.waits_for.value,
            "result_clocks": link.result_clocks,
            "stage_clocks": _said(link.stage_clocks),
        }


class Stretch(NamedTuple):
    """Steps of the longest chain that belong to one part of the program.

    Parameters
    ----------
    name
        Of the part.
    first, clocks
        From which clock on, and how many.
    stage_clocks
        Those of them on which a step was ready and had to wait for a stage, by the reasons.
    text
        Kinds of the steps, with 1/sqrt where a step waits for it.
    """

    name: str
    first: int
    clocks: int
    stage_clocks: dict[Reason, int]
    text: str

    def record(self) -> dict[str, Any]:
        """Describe it, ready for JSON."""
        return self._asdict() | {"stage_clocks": _said(self.stage_clocks)}


class Explanation(NamedTuple):
    """Where the clocks of a program go.

    Parameters
    ----------
    name
        Of the program.
    length
        Its clocks; a step takes some more.
    idle
        Clocks without an issue, each with its reason.
    bounds
        Clocks that it takes at least, by what demands them.
    lanes
        Work of the lanes.
    chain
        The longest chain: operations of which each waits for the one before it.
    stretches
        The chain in short: a stretch for each part of the program.
    """

    name: str
    length: int
    idle: dict[int, Reason]
    bounds: dict[str, int]
    lanes: Lanes
    chain: list[Step]
    stretches: list[Stretch]

    @property
    def reasons(self) -> dict[Reason, int]:
        """Clocks without an issue by their reasons, the most frequent first."""
        return dict(Counter(self.idle.values()).most_common())

    @property
    def ratio(self) -> float:
        """Clocks to the largest bound."""
        return self.length / max(self.bounds.values())

    def record(self) -> dict[str, Any]:
        """Describe it, ready for JSON."""
        return {
            "program": self.name,
            "clocks": self.length,
            "issued": self.length - len(self.idle),
            "idle": {
                "clocks": len(self.idle),
                "reasons": _said(self.reasons),
                "by_clock": {str(clock): reason.value for clock, reason in self.idle.items()},
            },
            "bounds": self.bounds,
            "ratio_to_largest_bound": self.ratio,
            "lanes": self.lanes._asdict(),
            "chain": [step.record() for step in self.chain],
            "stretches": [stretch.record() for stretch in self.stretches],
        }


def explain(code: Microcode, routine: Routine) -> Explanation:
    """Find out where the clocks of a program go.

    Parameters
    ----------
    code
        Programs of a core.
    routine
        Which one.
    """
    plan = code.programs[routine].plan
    waits, mnemonics = Waits(plan), Mnemonics(code)
    instructions = {entry.clocks[0]: entry for entry in disassemble(code, *routine)}
    found = parts(plan.operations, code.layout)
    chain = [
        Step(
            link,
            found[link.operation].name,
            plan.operations[link.operation].kind.name,
            [line.text for line in mnemonics.lines(instructions[link.issue])],
        )
        for link in waits.chain()
    ]
    return Explanation(
        name=code.name_of(routine),
        length=plan.length,
        idle=waits.idle(),
        bounds=_bounds(plan, waits),
        lanes=_lanes(plan),
        chain=chain,
        stretches=_stretches(chain, plan.length),
    )


def _bounds(plan: Schedule, waits: Waits) -> dict[str, int]:
    """Clocks that a program takes at least."""
    used = Counter(
        stage.kind for operation in plan.operations for stage, _ in stages(operation, plan.timing)
    )
    shared = (StageKind.ISSUE, StageKind.WRITE_PORT, StageKind.SCALAR_BUS)
    return {
        "longest chain": waits.longest_chain(),
        **{kind.value: used[kind] for kind in shared},
    }


def _lanes(plan: Schedule) -> Lanes:
    """Count the lanes that take part in what multiplies."""
    multiplying = [
        beat
        for operation in plan.operations
        if operation.kind.route is not Route.PORT
        for beat in operation.beats
    ]
    pes = plan.timing.pes
    useful = sum(beat.lanes.bit_count() for beat in multiplying)
    return Lanes(useful, pes * len(multiplying), pes * plan.length)


def _stretches(chain: list[Step], length: int) -> list[Stretch]:
    """Group the steps of a chain by the parts of the program; each begins where it is ready."""
    stretches: list[Stretch] = []
    for name, group in groupby(chain, key=lambda step: step.part):
        steps = list(group)
        said: list[str] = []
        for step in steps:
            said += ["1/sqrt"] * (step.link.waits_for is Reason.ROOT)
            said.append(step.kind)
        runs = [(word, len(list(same))) for word, same in groupby(said)]
        text = ", ".join(word if times == 1 else f"{times} {word}" for word, times in runs)
        waited = sum((Counter(step.link.stage_clocks) for step in steps), Counter[Reason]())
        stretches.append(Stretch(name, steps[0].link.ready, 0, dict(waited.most_common()), text))
    ends = [*(stretch.first for stretch in stretches[1:]), length]
    return [
        stretch._replace(clocks=end - stretch.first)
        for stretch, end in zip(stretches, ends, strict=True)
    ]
