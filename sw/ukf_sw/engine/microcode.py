"""All programs of a core, scheduled and encoded: the contents of its program memories."""

import heapq
from collections.abc import Iterator, Mapping
from functools import cache, cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from ukf_sw.engine.control_word import (
    READ,
    WRITE,
    BusSource,
    ControlFormat,
    Half,
    fields_of_models,
    steering,
)
from ukf_sw.engine.layout import BANK_FACTOR, BANK_STATE, Layout, Word
from ukf_sw.engine.operations import Operation, Route, Scalar
from ukf_sw.engine.packets import PacketStream, pack
from ukf_sw.engine.programs import build_program
from ukf_sw.engine.scheduler import Schedule, schedule, schedules
from ukf_sw.engine.temporaries import allocate_temporaries, lent_words
from ukf_sw.engine.timing import Timing
from ukf_sw.spec.forms import Root
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import OF_SENSORS, Program, Routine, of_sensor, of_variant

__all__ = [
    "STEP_OVERHEAD",
    "Microcode",
    "ProgramCode",
    "allocate_scalars",
    "compile_program",
    "microcode",
    "routines",
]

#: Clocks of a step beyond those of its program: fetching the first word, noticing the end.
STEP_OVERHEAD = 3

#: Packets of program memory that a clock is worth. Schedules that differ little in length may
#: differ much in how often they repeat themselves.
PACKETS_A_CLOCK = 5


def routines(params: UkfParams) -> list[Routine]:
    """Programs of a core in the order in which they lie in memory.

    UPDATE_REDRAWN runs on into UPDATE, so each sensor has its own.
    """
    before = (Program.INIT, Program.SIG_GEN, Program.SIG_GEN_PREDICTED, Program.PREDICT)
    of_sensors = (Program.UPDATE_REDRAWN, Program.UPDATE)
    behind = (Program.COVARIANCE, Program.COVARIANCE_PREDICTED)
    sensors = range(len(params.sensor_rows))
    return [
        *(Routine(program) for program in before),
        *(Routine(program, sensor) for sensor in sensors for program in of_sensors),
        *(Routine(program) for program in behind),
        *([] if params.models.f is None else [Routine(Program.MODEL_F)]),
        *(
            Routine(Program.MODEL_H, sensor, variant)
            for sensor, variants in enumerate(params.models.h)
            for variant in range(len(variants))
        ),
    ]


def allocate_scalars(plan: Schedule) -> dict[Scalar, int]:
    """Give every scalar of a schedule a register, reused once its last reader has read.

    Returns
    -------
    dict
        Register of each scalar that is read, or that nothing else keeps: writing it is what
        checks that it is finite.
    """
    last_read: dict[Scalar, int] = {}
    for operation, issue in zip(plan.operations, plan.issue, strict=True):
        if operation.scalar is not None:
            last_read[operation.scalar] = max(last_read.get(operation.scalar, 0), issue)
    born: list[tuple[int, int, Scalar]] = []
    for operation, issue in zip(plan.operations, plan.issue, strict=True):
        scalar = operation.result
        if scalar is not None and (scalar in last_read or operation.destination is None):
            written = issue + plan.timing.result(operation)
            born.append((written, scalar.number, scalar))
    registers: dict[Scalar, int] = {}
    free: list[int] = []
    busy: list[tuple[int, int]] = []
    count = 0
    for written, _, scalar in sorted(born, key=lambda entry: entry[:2]):
        while busy and busy[0][0] <= written:
            heapq.heappush(free, heapq.heappop(busy)[1])
        if free:
            register = heapq.heappop(free)
        else:
            register, count = count, count + 1
        registers[scalar] = register
        # A register that nobody reads is free again on the next clock.
        heapq.heappush(busy, (last_read.get(scalar, written + 1), register))
    return registers


class ProgramCode(NamedTuple):
    """A program, scheduled.

    Parameters
    ----------
    plan
        Its schedule.
    registers
        Place of its scalars in the scalar file.
    places
        Places of its temporaries in the memories, if it has some.
    temporaries
        How many words it needs for them beyond those that other vectors lend it.
    """

    plan: Schedule
    registers: dict[Scalar, int]
    places: dict[Word, Word]
    temporaries: int

    def lane_sets(self) -> Iterator[int]:
        """Sets of lanes that its control words name."""
        for operation in self.plan.operations:
            if operation.destination is not None:
                yield operation.lanes
            if operation.root is not None:
                yield operation.root_lanes
            if operation.kind.route is Route.TREE:
                for beat in operation.beats:
                    yield beat.lanes


def compile_program(layout: Layout, timing: Timing, routine: Routine) -> ProgramCode:
    """Schedule a program: of the schedules that differ little in length the one that costs least.

    Parameters
    ----------
    layout
        Where its vectors are.
    timing
        Latencies of the array.
    routine
        Which program.
    """
    if routine.program in (Program.MODEL_F, Program.MODEL_H):
        return _compile_model(layout, timing, routine)
    plans = schedules(build_program(layout, *routine), timing)
    codes = [ProgramCode(plan, allocate_scalars(plan), {}, 0) for plan in plans]
    return codes[0] if len(codes) == 1 else min(codes, key=_cost)


def _compile_model(layout: Layout, timing: Timing, routine: Routine) -> ProgramCode:
    """Schedule the program of a model. What the schedule is does not depend on the layout."""
    plan = schedule(build_program(layout, *routine), timing)
    own = [vector.word(0) for vector in layout.temporaries]
    places, needed = allocate_temporaries(plan, lent_words(layout, routine.program), own)
    return ProgramCode(plan, allocate_scalars(plan), places, needed)


def _cost(code: ProgramCode) -> float:
    """Length of a program in clocks, and what its packets are worth."""
    sets: dict[int, int] = {(1 << code.plan.timing.pes) - 1: 0}
    for lanes in code.lane_sets():
        sets.setdefault(lanes, len(sets))
    words = _words(code, sets)
    packets = 0
    for half in (READ, WRITE):
        rows = [[word.get(name, 0) for name in half.fields] for word in words]
        packets += sum(1 for _ in pack(np.array(rows, dtype=np.int32), half))
    return code.plan.length + packets / PACKETS_A_CLOCK


def _words(code: ProgramCode, sets: Mapping[int, int]) -> list[dict[str, int]]:
    """Give the fields of the control words of a program; `sets` has numbers of sets of lanes."""
    plan = code.plan
    words: list[dict[str, int]] = [{} for _ in range(plan.length)]
    for operation, issue in zip(plan.operations, plan.issue, strict=True):
        for k, beat in enumerate(operation.beats):
            if operation.form is not None:
                values = steering(operation.form)
            else:
                values = {"subtract": int(operation.subtract), **operation.kind.steering}
                if beat.word_0 is None:
                    values["zero"] = 1
            if beat.word_0 is not None:
                word_0 = code.places.get(beat.word_0, beat.word_0)
                values |= _banked("address_0", "bank_{}_0", word_0)
            if beat.word_1 is not None:
                word_1 = code.places.get(beat.word_1, beat.word_1)
                values["address_1"] = word_1[0]
                values["bank_factor_1"] = int(word_1[1] == BANK_FACTOR)
            if operation.scalar is not None:
                values["scalar_address"] = code.registers[operation.scalar]
            if operation.kind.route is Route.TREE:
                values |= {"first": int(k == 0), "select": sets[beat.lanes]}
            elif operation.kind.route is Route.PORT:
                values["select"] = beat.lanes.bit_length() - 1
            words[issue + k * plan.timing.beat_interval] |= values
        done = issue + plan.timing.result(operation)
        words[done] |= _writes(code, operation, sets)
        if operation.root is not None:
            root = code.places.get(operation.root, operation.root)
            words[done + plan.timing.pipeline.reciprocal_sqrt] |= {
                "write": 1, "write_bus": 1, "bus_source": BusSource.ROOT,
                "write_address": root[0], "write_lanes": sets[operation.root_lanes],
                **({"unchecked": 1} if operation.unchecked else {}),
            }  # fmt: skip
    return words


def _writes(code: ProgramCode, operation: Operation, sets: Mapping[int, int]) -> dict[str, int]:
    """Give the fields of the clock on which the result of an operation is there."""
    values: dict[str, int] = {}
    if operation.destination is not None:
        destination = code.places.get(operation.destination, operation.destination)
        values |= _banked("write_address", "write_bank_{}", destination)
        values |= {"write": 1, "write_lanes": sets[operation.lanes]}
        values["write_bus"] = int(operation.kind.is_scalar)
    if operation.observation is not None:
        gate = "bus_observation" if operation.kind.is_scalar else "lanes_observation"
        values[gate] = 1 + operation.observation
    if operation.result in code.registers:
        values["scalar_write"] = 1
        values["scalar_write_address"] = code.registers[operation.result]
    if operation.kind.route is Route.PORT:
        values["bus_source"] = BusSource.LOAD
    if operation.pivot is not None:
        values["row"] = 1 + operation.pivot
    if operation.coupling is not None:
        values |= {"row": 1 + operation.coupling, "coupling": 1}
    if operation.innovation:
        values["innovation"] = 1
    if operation.is_nis:
        values["nis"] = 1
    if operation.model_row is not None:
        values |= {"row": 1 + operation.model_row, "of_model": 1}
    if operation.unchecked:
        values["unchecked"] = 1
    if operation.root_kind is Root.SIGNED:
        values["signed"] = 1
    return values


class Microcode:
    """Programs of a core; use :func:`microcode`, which makes it once.

    Parameters
    ----------
    params
        What the core computes.
    pipeline
        How it is built.

    Attributes
    ----------
    layout : Layout
    timing : Timing
    programs : dict of Routine to ProgramCode
    lane_sets : tuple of int
        Sets of lanes, as bit masks, that control words refer to by number.
    scalars : int
        Depth of the scalar file.
    format : ControlFormat
    words : list of int
        Control words, one for each clock.
    entry : dict of Routine to int
        Index of the first word of each program.
    """

    def __init__(self, params: UkfParams, pipeline: Pipeline) -> None:
        self.params = params
        self.pipeline = pipeline
        self.timing = Timing(params.pes, pipeline)
        self.layout = self._lay_out()
        self.programs: dict[Routine, ProgramCode] = {}
        for routine in routines(params):
            self.programs[routine] = compile_program(self.layout, self.timing, routine)
        self.scalars = 1 + max(
            max(code.registers.values(), default=0) for code in self.programs.values()
        )
        every_lane = (1 << params.pes) - 1
        sets = {every_lane, *(each for code in self.programs.values() for each in code.lane_sets())}
        self.lane_sets = tuple(sorted(sets))
        self.format = ControlFormat(
            address_width=self.layout.address_width,
            scalar_width=max((self.scalars - 1).bit_length(), 1),
            lane_sets=len(self.lane_sets),
            pes=params.pes,
            observations=params.m,
            rows=params.m + params.n,
            of_models=fields_of_models(params.models),
        )
        self._encoded = {routine: self._encode(code) for routine, code in self.programs.items()}
        for routine, words in self._encoded.items():
            if routine.program is not Program.UPDATE_REDRAWN:
                words[-1] |= self.format.encode({"last": 1})
        self.words = [word for words in self._encoded.values() for word in words]
        lengths = [len(words) for words in self._encoded.values()]
        self.entry = dict(zip(self._encoded, accumulate(lengths, initial=0), strict=False))

    def _lay_out(self) -> Layout:
        """Give the layout, with as many words for temporaries as the models need."""
        layout = Layout(self.params)
        needed = [
            compile_program(layout, self.timing, routine).temporaries
            for routine in routines(self.params)
            if routine.program in (Program.MODEL_F, Program.MODEL_H)
        ]
        return Layout(self.params, max(needed)) if any(needed) else layout

    @cached_property
    def streams(self) -> dict[Half, PacketStream]:
        """Contents of the program memories: packets of the words, for each half of them."""
        return {half: PacketStream(self.format, half, self._encoded) for half in (READ, WRITE)}

    def words_of(self, program: Program, sensor: int = 0, variant: int = 0) -> list[int]:
        """Give the control words of a program, one for each clock."""
        return self._encoded[Routine(program, sensor, variant)]

    def name_of(self, routine: Routine) -> str:
        """Name of a program for people, with its sensor and variant if there are several."""
        sensors = len(self.params.sensor_rows) if routine.program in OF_SENSORS else 1
        name = of_sensor(routine.program.name, routine.sensor, sensors)
        return of_variant(name, self.params.models, routine)

    def clocks(self, program: Program, sensor: int = 0, variant: int = 0) -> int:
        """Clocks from the start of a step to its end, when it runs a program."""
        clocks = self.programs[Routine(program, sensor, variant)].plan.length + STEP_OVERHEAD
        if program is Program.UPDATE_REDRAWN:
            clocks += self.programs[Routine(Program.UPDATE, sensor)].plan.length
        return clocks

    def _encode(self, code: ProgramCode) -> list[int]:
        numbers = {lanes: number for number, lanes in enumerate(self.lane_sets)}
        return [self.format.encode(word) for word in _words(code, numbers)]


def _banked(address: str, bank: str, word: Word) -> dict[str, int]:
    """Fields of an address that a bank bit may complete."""
    return {
        address: word[0],
        bank.format("state"): int(word[1] == BANK_STATE),
        bank.format("factor"): int(word[1] == BANK_FACTOR),
    }


@cache
def microcode(params: UkfParams, pipeline: Pipeline) -> Microcode:
    """Give the microcode of a core; equal arguments give the same object."""
    return Microcode(params, pipeline)
