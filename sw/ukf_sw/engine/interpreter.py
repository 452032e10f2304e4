"""The golden model of the engine: executes the control words, bit for bit and clock by clock.

It knows what a word does, not what the program meant. Its results arrive with the latencies of
the hardware, so a wrong schedule gives wrong numbers here as well.
"""

from math import frexp
from typing import NamedTuple

import numpy as np
from numba import njit  # pyright: ignore[reportUnknownVariableType]
from numpy.typing import NDArray

from ukf_sw.engine.arithmetic import (
    ScalarParameters,
    add_scalar,
    decode_scalar,
    encode_scalar,
    reciprocal_sqrt_scalar,
    reciprocal_sqrt_table,
    scalar_parameters,
)
from ukf_sw.engine.control_word import READ, WRITE, BusSource
from ukf_sw.engine.kernel_cache import compiled
from ukf_sw.engine.lanes import FORM_BITS, combine, inner_product, signed_root, store
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.pivots import noise_exponent
from ukf_sw.engine.programs import RunResult
from ukf_sw.engine.rounds import Rounds, RoundsDone
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Program, Routine

__all__ = ["AdderConflictError", "Interpreter"]


class AdderConflictError(Exception):
    """Two results left the accumulator's adder on the same clock: the schedule is wrong."""


class _Array(NamedTuple):
    """What is fixed for a core, in the form that compiled code takes."""

    pes: int
    lanes: int
    dot: int
    load: int
    root: int
    accumulate: int
    bank_offset: int
    observations: int
    zero_pivot_is_legal: bool
    noise_exponent: int
    rhs_lane: int


class _State(NamedTuple):
    """What a program leaves besides the memories."""

    error_code: int
    error_index: int
    nis: int
    has_nis: bool
    clocks: int
    conflict: bool
    innovation_overflow: bool


_BUS_LOAD = int(BusSource.LOAD)
_BUS_ROOT = int(BusSource.ROOT)
_NOT_FINITE = int(ErrorCode.NOT_FINITE)
_SINGULAR = int(ErrorCode.SINGULAR_OBSERVATION)
_NOT_POSITIVE = int(ErrorCode.NOT_POSITIVE_DEFINITE)
_MODEL_F = int(ErrorCode.MODEL_F)
_MODEL_H = int(ErrorCode.MODEL_H)
_RING = 256  # more than any latency

#: A control word; the names are those of `ControlFormat`. Beside them: whether the lanes compute
#: something that is written, and the steering of the forms of models as one number. The fields are
#: small, so that the words of a program, which are read again and again, fit into the caches.
_WORD = np.dtype([(name, np.uint16) for name in (*READ.fields, *WRITE.fields, "computes", "form")])


@njit
def _is_masked(observation: int, mask: int) -> bool:
    """Whether 1 + an observation, or 0 for none, is masked."""
    return observation > 0 and not (mask >> (observation - 1)) & 1


@njit
def _is_noise(pivot: float, coupling: float, noise_exponent: int) -> bool:
    """Whether a pivot is rounding noise beside the largest element that led to it."""
    if not (0.0 < pivot < np.inf and coupling > 0.0):
        return False
    return frexp(pivot)[1] - 1 < 2 * (frexp(coupling)[1] - 1) - noise_exponent


@compiled
def _execute(
    words: NDArray[np.void],
    entry: int,
    stop_after: int,
    array: _Array,
    lane_sets: NDArray[np.bool_],
    memory: NDArray[np.int64],
    scalars: NDArray[np.float64],
    mask: int,
    state_bank: int,
    factor_bank: int,
    parameters: ScalarParameters,
    table: NDArray[np.int64],
) -> tuple[int, int, int, bool, int, bool, bool]:
    """Execute words from `entry` on until the last one, or for `stop_after` clocks."""
    pes = array.pes
    lanes_ring = np.zeros((_RING, pes))
    skip_ring = np.zeros((_RING, pes), dtype=np.bool_)
    adder_ring = np.zeros(_RING)
    adder_due = np.full(_RING, -1, dtype=np.int64)
    load_ring = np.zeros(_RING, dtype=np.int64)
    bus_ring = np.zeros(_RING)
    signed_ring = np.zeros(_RING, dtype=np.bool_)
    terms = np.zeros(pes)
    error_code = 0
    error_index = 0
    nis = 0
    has_nis = False
    conflict = False
    innovation_overflow = False
    couplings = np.zeros(array.observations)  # largest of every observation row
    clock = 0
    while stop_after < 0 or clock < stop_after:
        word = words[entry + clock]

        # Read half: operands, products, and sums that will be due later.
        address_0 = word["address_0"]
        address_1 = word["address_1"]
        if word["bank_factor_1"] and factor_bank:
            address_1 |= array.bank_offset
        if (word["bank_state_0"] and state_bank) or (word["bank_factor_0"] and factor_bank):
            address_0 |= array.bank_offset
        select = word["select"]
        use_scalar = word["use_scalar"]
        zero = word["zero"]
        load_ring[(clock + array.load) % _RING] = memory[address_0, select % pes]
        if word["dot"]:
            total = inner_product(
                memory, address_0, address_1, lane_sets, select, terms, parameters
            )
            before = 0.0 if word["first"] else adder_ring[(clock + array.accumulate) % _RING]
            due = clock + array.dot
            adder_ring[due % _RING] = add_scalar(total, before, parameters)
            conflict |= adder_due[due % _RING] == due
            adder_due[due % _RING] = due
        elif word["computes"]:
            due = clock + array.lanes
            scalar = scalars[int(word["scalar_address"])]
            form = word["form"]
            combine(
                memory, address_0, address_1, scalar, use_scalar != 0, zero != 0,
                word["subtract"] != 0, form, lanes_ring, skip_ring, due % _RING, parameters,
            )  # fmt: skip
            adder_ring[due % _RING] = lanes_ring[due % _RING, pes - 1]
            conflict |= adder_due[due % _RING] == due
            adder_due[due % _RING] = due

        # Write half: results that are due now.
        bus_source = word["bus_source"]
        if bus_source == _BUS_LOAD:
            bus = decode_scalar(load_ring[clock % _RING], parameters)
        elif bus_source == _BUS_ROOT:
            number = bus_ring[(clock - array.root) % _RING]
            if signed_ring[(clock - array.root) % _RING]:
                bus = signed_root(number, parameters, table)
            else:
                bus = reciprocal_sqrt_scalar(number, parameters, table)
        else:
            bus = adder_ring[clock % _RING]
        bus_ring[clock % _RING] = bus
        signed_ring[clock % _RING] = word["signed"] != 0
        bus_masked = _is_masked(word["bus_observation"], mask)
        lanes_masked = _is_masked(word["lanes_observation"], mask)
        lanes = word["write_lanes"]
        if error_code == 0:
            finite = True
            of_innovation = True
            row_of_model = -1
            if word["of_model"]:
                row_of_model = int(word["row"]) - 1
            elif word["row"] > 0 and word["coupling"]:
                row = int(word["row"]) - 1
                couplings[row] = max(couplings[row], abs(bus))
            elif word["row"] > 0:
                row = int(word["row"]) - 1
                finite = bool(bus < np.inf)
                if row < array.observations:
                    is_noise = _is_noise(bus, couplings[row], array.noise_exponent)
                    if (not bus > 0.0 and (bus != 0.0 or (mask >> row) & 1)) or is_noise:
                        error_code = _SINGULAR
                        error_index = row
                elif not (bus > 0.0 or (bus == 0.0 and array.zero_pivot_is_legal)):
                    error_code = _NOT_POSITIVE
                    error_index = row - array.observations
                of_innovation &= finite
            # A number on the bus that may be anything can meet a result of a model in the lanes.
            checked = not word["unchecked"]
            checks_lanes = checked or word["of_model"]
            if checked and (word["scalar_write"] or (word["write"] and word["write_bus"])):
                good = bus_masked or abs(bus) < np.inf
                of_innovation &= good or word["nis"] != 0
                finite &= good
            if checks_lanes and word["write"] and not word["write_bus"] and not lanes_masked:
                for lane in range(pes):
                    if lane_sets[lanes, lane]:
                        good = abs(lanes_ring[clock % _RING, lane]) < np.inf
                        of_innovation &= good or (word["innovation"] and lane == array.rhs_lane)
                        finite &= good
            if error_code == 0 and not finite:
                if row_of_model < 0:
                    error_code = _NOT_FINITE
                    innovation_overflow = of_innovation
                elif row_of_model < array.observations:
                    error_code = _MODEL_H
                    error_index = row_of_model
                else:
                    error_code = _MODEL_F
                    error_index = row_of_model - array.observations
        if error_code == 0:
            bus_word = 0
            if not bus_masked:
                # A load passes a word on as it is.
                if bus_source == _BUS_LOAD:
                    bus_word = load_ring[clock % _RING]
                else:
                    bus_word = encode_scalar(bus, parameters)
            if word["write"]:
                address = word["write_address"]
                if (word["write_bank_state"] and not state_bank) or (
                    word["write_bank_factor"] and not factor_bank
                ):
                    address |= array.bank_offset
                if word["write_bus"]:
                    for lane in range(pes):
                        if lane_sets[lanes, lane]:
                            memory[address, lane] = bus_word
                else:
                    store(
                        memory, address, lane_sets, lanes, lanes_ring, skip_ring, clock % _RING,
                        lanes_masked, parameters,
                    )  # fmt: skip
            if word["scalar_write"]:
                scalars[word["scalar_write_address"]] = 0.0 if bus_masked else bus
            if word["nis"]:
                nis = bus_word
                has_nis = True
        clock += 1
        if word["last"]:
            break
    # Plain values: to make an object of a class here would call Python, which an interrupt breaks.
    return error_code, error_index, nis, has_nis, clock, conflict, innovation_overflow


@compiled
def _execute_rounds(
    words: NDArray[np.void],
    array: _Array,
    lane_sets: NDArray[np.bool_],
    memory: NDArray[np.int64],
    halves: NDArray[np.uint32],
    scalars: NDArray[np.float64],
    parameters: ScalarParameters,
    table: NDArray[np.int64],
    runs: NDArray[np.int64],
    gate: int,
    magnitude: int,
    ends: NDArray[np.int64],
    places: NDArray[np.int64],
    written: NDArray[np.uint32],
    shown: NDArray[np.int64],
    nis: NDArray[np.int64],
    seen: NDArray[np.uint32],
) -> int:
    """Run rounds up to the first one that fails; of that one nothing is left. Gives how many.

    But scalars: no program reads one that it has not written.

    A row of `runs` has entry, mask, banks, whether the NIS is compared, and the writes before it.
    """
    memory_before = np.empty_like(memory)
    run = 0
    write = 0
    for k in range(len(ends)):
        memory_before[:] = memory
        while run < ends[k]:
            while write < runs[run, 5]:
                halves[places[write]] = written[write]
                write += 1
            error_code, _, run_nis, _, _, conflict, _ = _execute(
                words, runs[run, 0], np.int64(-1), array, lane_sets, memory, scalars, runs[run, 1],
                runs[run, 2], runs[run, 3], parameters, table,
            )  # fmt: skip
            nis[run] = run_nis
            if error_code != 0 or conflict or (runs[run, 4] and (run_nis & magnitude) > gate):
                memory[:] = memory_before
                return k
            run += 1
        for i in range(shown.shape[1]):
            seen[k, i] = halves[shown[k, i]]
    return len(ends)


class Interpreter:
    """An engine: its memories, and its programs executed word by word.

    Parameters
    ----------
    params
        What the core computes.
    pipeline
        How it is built; it decides latencies, never results.

    Attributes
    ----------
    memory : array of uint64
        Every word of the memories, shape (pes, depth). The bus may put any word there: those of
        subnormal numbers and of NaN stay as they are until a program writes.
    """

    def __init__(self, params: UkfParams, pipeline: Pipeline | None = None) -> None:
        self.params = params
        self.microcode = code = microcode(params, pipeline or Pipeline())
        self.layout = code.layout
        timing = code.timing
        fields = code.format.decode(code.words)
        self._words = np.empty(len(code.words), dtype=_WORD)
        self._words[:] = 0
        for name, column in fields.items():
            if column.max(initial=0) > np.iinfo(np.uint16).max:
                raise ValueError(f"{name} must fit into 16 bits, not {column.max()}")
            self._words[name] = column
        # The lanes compute on every clock; what counts is what is written when it is there.
        ends = np.zeros(len(code.words), dtype=np.bool_)
        ends[: -timing.lanes] = (self._words["write"] & (1 - self._words["write_bus"]))[
            timing.lanes :
        ]
        self._words["computes"] = self._words["use_scalar"] | self._words["zero"] | ends
        for name in code.format.present(FORM_BITS):
            self._words["form"] |= self._words[name] * FORM_BITS[name]
        self._lane_sets = np.array(
            [[lanes >> lane & 1 for lane in range(params.pes)] for lanes in code.lane_sets],
            dtype=np.bool_,
        )
        self._array = _Array(
            pes=params.pes,
            lanes=timing.lanes,
            dot=timing.dot,
            load=LOAD_LATENCY,
            root=timing.pipeline.reciprocal_sqrt,
            accumulate=timing.accumulate,
            bank_offset=self.layout.bank_offset,
            observations=params.m,
            zero_pivot_is_legal=params.form is Form.SQUARE_ROOT,
            noise_exponent=noise_exponent(params),
            rhs_lane=self.layout.elimination_rhs % params.pes,
        )
        self._parameters = scalar_parameters(params.format)
        self._table = reciprocal_sqrt_table(params.format)
        # A word of all lanes lies together, because all are read at once.
        self.memory = np.asfortranarray(self.layout.initial_words())
        self._scalars = np.zeros(code.scalars)

    def clocks(self, program: Program, sensor: int = 0, variant: int = 0) -> int:
        """Clocks that a program takes from the start of a step."""
        return self.microcode.clocks(program, sensor, variant)

    def run(
        self,
        program: Program,
        *,
        sensor: int = 0,
        variant: int = 0,
        mask: int = -1,
        state_bank: int = 0,
        factor_bank: int = 0,
        stop_after: int | None = None,
    ) -> RunResult:
        """Execute a program.

        Parameters
        ----------
        program
            What to execute.
        sensor
            Whose, of a program in :data:`ukf_sw.spec.sequence.OF_SENSORS`.
        variant
            Which of its observation models, of MODEL_H.
        mask
            Bit i takes observation i into an update.
        state_bank, factor_bank
            Current copies of x and L.
        stop_after
            Number of words after which the program is dropped; None: it runs to its end.

        Raises
        ------
        AdderConflictError
            If the words use an adder twice on a clock.
        """
        entry = self.microcode.entry[Routine(program, sensor, variant)]
        state = _State(*_execute(
            self._words, entry, -1 if stop_after is None else stop_after, self._array,
            self._lane_sets, self.memory.T.view(np.int64), self._scalars,
            mask & (1 << self.params.m) - 1, state_bank, factor_bank, self._parameters,
            self._table,
        ))  # fmt: skip
        if state.conflict:
            raise AdderConflictError(f"The schedule of {program!r} uses an adder twice on a clock")
        return RunResult(
            error_code=state.error_code,
            error_index=state.error_index,
            nis=state.nis & (1 << self.params.format.width) - 1 if state.has_nis else None,
            clocks=self.microcode.clocks(program, sensor, variant),
            innovation_overflow=state.innovation_overflow,
        )

    def run_rounds(self, rounds: Rounds) -> RoundsDone:
        """Run rounds of programs up to the first one that does not succeed; that leaves nothing.

        A round succeeds if no program of it ends with an error or, where that is compared, a NIS
        above the gate.

        Parameters
        ----------
        rounds
            The rounds.
        """
        fmt = self.params.format
        memory = self.memory.T.view(np.int64)
        entries = [self.microcode.entry[routine] for routine in rounds.routines]
        used = (1 << self.params.m) - 1
        runs = np.array(
            [
                entries, [mask & used for mask in rounds.masks], rounds.state_banks,
                rounds.factor_banks, rounds.compares, rounds.writes,
            ],
            dtype=np.int64,
        ).T.copy()  # fmt: skip
        # Of a word of 64 bits the one of the sign must not make it negative.
        magnitude = (1 << (fmt.width - 1)) - 1
        nis = np.zeros(len(runs), dtype=np.int64)
        seen = np.zeros(rounds.shown.shape, dtype=np.uint32)
        done = int(_execute_rounds(
            self._words, self._array, self._lane_sets, memory, memory.reshape(-1).view(np.uint32),
            self._scalars, self._parameters, self._table, runs, rounds.gate, magnitude,
            np.array(rounds.ends, dtype=np.int64), rounds.places, rounds.words, rounds.shown, nis,
            seen,
        ))  # fmt: skip
        count = rounds.ends[done - 1] if done else 0
        return RoundsDone(done, nis.view(np.uint64)[:count], seen[:done])
