"""All programs of a core, scheduled and encoded: the contents of its program memories."""

import heapq
from functools import cache, cached_property
from itertools import accumulate
from typing import NamedTuple

from ukf_sw.engine.control_word import READ, WRITE, BusSource, ControlFormat, Half
from ukf_sw.engine.layout import BANK_FACTOR, BANK_STATE, Layout, Word
from ukf_sw.engine.operations import Operation, Route, Scalar
from ukf_sw.engine.packets import PacketStream
from ukf_sw.engine.programs import build_program
from ukf_sw.engine.scheduler import Schedule, schedule
from ukf_sw.engine.timing import Timing
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import OF_SENSORS, Program, Routine, of_sensor

__all__ = ["STEP_OVERHEAD", "Microcode", "allocate_scalars", "microcode", "routines"]

#: Clocks of a step beyond those of its program: fetching the first word, noticing the end.
STEP_OVERHEAD = 3


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
    """

    plan: Schedule
    registers: dict[Scalar, int]


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
        self.layout = Layout(params)
        self.timing = Timing(params.pes, pipeline)
        self.programs: dict[Routine, ProgramCode] = {}
        for routine in routines(params):
            plan = schedule(build_program(self.layout, *routine), self.timing)
            self.programs[routine] = ProgramCode(plan, allocate_scalars(plan))
        self.scalars = 1 + max(
            max(code.registers.values(), default=0) for code in self.programs.values()
        )
        every_lane = (1 << params.pes) - 1
        sets = {every_lane}
        for code in self.programs.values():
            for operation in code.plan.operations:
                if operation.destination is not None:
                    sets.add(operation.lanes)
                if operation.kind.route is Route.TREE:
                    sets.update(beat.lanes for beat in operation.beats)
        self.lane_sets = tuple(sorted(sets))
        self.format = ControlFormat(
            address_width=self.layout.address_width,
            scalar_width=max((self.scalars - 1).bit_length(), 1),
            lane_sets=len(self.lane_sets),
            pes=params.pes,
            observations=params.m,
            rows=params.m + params.n,
        )
        self._encoded = {routine: self._encode(code) for routine, code in self.programs.items()}
        for routine, words in self._encoded.items():
            if routine.program is not Program.UPDATE_REDRAWN:
                words[-1] |= self.format.encode({"last": 1})
        self.words = [word for words in self._encoded.values() for word in words]
        lengths = [len(words) for words in self._encoded.values()]
        self.entry = dict(zip(self._encoded, accumulate(lengths, initial=0), strict=False))

    @cached_property
    def streams(self) -> dict[Half, PacketStream]:
        """Contents of the program memories: packets of the words, for each half of them."""
        return {half: PacketStream(self.format, half, self._encoded) for half in (READ, WRITE)}

    def words_of(self, program: Program, sensor: int = 0) -> list[int]:
        """Give the control words of a program, one for each clock."""
        return self._encoded[Routine(program, sensor)]

    def name_of(self, routine: Routine) -> str:
        """Name of a program for people, with its sensor if there are several."""
        sensors = len(self.params.sensor_rows) if routine.program in OF_SENSORS else 1
        return of_sensor(routine.program.name, routine.sensor, sensors)

    def clocks(self, program: Program, sensor: int = 0) -> int:
        """Clocks from the start of a step to its end, when it runs a program."""
        clocks = self.programs[Routine(program, sensor)].plan.length + STEP_OVERHEAD
        if program is Program.UPDATE_REDRAWN:
            clocks += self.programs[Routine(Program.UPDATE, sensor)].plan.length
        return clocks

    def _encode(self, code: ProgramCode) -> list[int]:
        words = [0] * code.plan.length
        numbers = {lanes: number for number, lanes in enumerate(self.lane_sets)}
        for operation, issue in zip(code.plan.operations, code.plan.issue, strict=True):
            clock = issue
            for k, beat in enumerate(operation.beats):
                clock = issue + k * self.timing.beat_interval
                values = {"subtract": operation.subtract, **operation.kind.steering}
                if beat.word_0 is None:
                    values["zero"] = 1
                else:
                    values |= _banked("address_0", "bank_{}_0", beat.word_0)
                if beat.word_1 is not None:
                    values["address_1"] = beat.word_1[0]
                    values["bank_factor_1"] = beat.word_1[1] == BANK_FACTOR
                if operation.scalar is not None:
                    values["scalar_address"] = code.registers[operation.scalar]
                if operation.kind.route is Route.TREE:
                    values |= {"first": k == 0, "select": numbers[beat.lanes]}
                elif operation.kind.route is Route.PORT:
                    values["select"] = beat.lanes.bit_length() - 1
                words[clock] |= self.format.encode(values)
            self._encode_writes(code, operation, issue, words, numbers)
        return words

    def _encode_writes(
        self,
        code: ProgramCode,
        operation: Operation,
        issue: int,
        words: list[int],
        numbers: dict[int, int],
    ) -> None:
        clock = issue + self.timing.result(operation)
        values: dict[str, int] = {}
        if operation.destination is not None:
            values |= _banked("write_address", "write_bank_{}", operation.destination)
            values |= {"write": 1, "write_lanes": numbers[operation.lanes]}
            values["write_bus"] = operation.kind.is_scalar
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
        values |= {"innovation": operation.innovation, "nis": operation.is_nis}
        words[clock] |= self.format.encode(values)
        if operation.root is not None:
            root = {
                "write": 1, "write_bus": 1, "bus_source": BusSource.ROOT,
                "write_address": operation.root[0], "write_lanes": len(self.lane_sets) - 1,
            }  # fmt: skip
            words[clock + self.pipeline.reciprocal_sqrt] |= self.format.encode(root)


def _banked(address: str, bank: str, word: Word) -> dict[str, int]:
    """Fields of an address that a bank bit may complete."""
    return {
        address: word[0],
        bank.format("state"): word[1] == BANK_STATE,
        bank.format("factor"): word[1] == BANK_FACTOR,
    }


@cache
def microcode(params: UkfParams, pipeline: Pipeline) -> Microcode:
    """Give the microcode of a core; equal arguments give the same object."""
    return Microcode(params, pipeline)
