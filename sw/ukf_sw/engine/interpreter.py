"""The golden model of the engine: executes the control words, bit for bit and clock by clock.

It knows what a word does, not what the program meant. Its results arrive with the latencies of
the hardware, so a wrong schedule gives wrong numbers here as well.
"""

from typing import NamedTuple

import numpy as np
from numba import njit  # pyright: ignore[reportUnknownVariableType]
from numpy.typing import NDArray

from ukf_sw.engine.arithmetic import (
    ScalarParameters,
    add_scalar,
    multiply_scalar,
    reciprocal_sqrt_scalar,
    reciprocal_sqrt_table,
    scalar_parameters,
)
from ukf_sw.engine.control_word import BusSource
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Program

__all__ = ["AdderConflictError", "Interpreter", "RunResult"]


class AdderConflictError(Exception):
    """Two results left the accumulator's adder on the same clock: the schedule is wrong."""


class RunResult(NamedTuple):
    """How a program ended.

    Parameters
    ----------
    error_code, error_index
        First error, as in the register ERROR, or zeros.
    nis
        Word of the normalised innovation squared, or None if the program gives none.
    clocks
        Clocks from the start of the step to its end.
    """

    error_code: int
    error_index: int
    nis: int | None
    clocks: int


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


class _Words(NamedTuple):
    """Fields of the control words, an array each; the names are those of `ControlFormat`."""

    address_0: NDArray[np.int64]
    bank_state_0: NDArray[np.int64]
    bank_factor_0: NDArray[np.int64]
    address_1: NDArray[np.int64]
    bank_factor_1: NDArray[np.int64]
    scalar_address: NDArray[np.int64]
    use_scalar: NDArray[np.int64]
    zero: NDArray[np.int64]
    subtract: NDArray[np.int64]
    dot: NDArray[np.int64]
    first: NDArray[np.int64]
    select: NDArray[np.int64]
    write: NDArray[np.int64]
    write_address: NDArray[np.int64]
    write_bank_state: NDArray[np.int64]
    write_bank_factor: NDArray[np.int64]
    write_lanes: NDArray[np.int64]
    write_bus: NDArray[np.int64]
    bus_source: NDArray[np.int64]
    scalar_write: NDArray[np.int64]
    scalar_write_address: NDArray[np.int64]
    lanes_observation: NDArray[np.int64]
    bus_observation: NDArray[np.int64]
    pivot: NDArray[np.int64]
    nis: NDArray[np.int64]
    last: NDArray[np.int64]


class _State(NamedTuple):
    """What a program leaves besides the memories."""

    error_code: int
    error_index: int
    nis: float
    has_nis: bool
    clocks: int
    conflict: bool


_BUS_LOAD = int(BusSource.LOAD)
_BUS_ROOT = int(BusSource.ROOT)
_NOT_FINITE = int(ErrorCode.NOT_FINITE)
_SINGULAR = int(ErrorCode.SINGULAR_OBSERVATION)
_NOT_POSITIVE = int(ErrorCode.NOT_POSITIVE_DEFINITE)
_RING = 256  # more than any latency


@njit
def _flushed(value: float, parameters: ScalarParameters) -> float:
    """Read a subnormal number, which only the bus can have written, as zero."""
    if abs(value) < parameters.min_normal:
        return np.copysign(0.0, value)
    return value


@njit
def _is_masked(observation: int, mask: int) -> bool:
    """Whether 1 + an observation, or 0 for none, is masked."""
    return observation > 0 and not (mask >> (observation - 1)) & 1


@njit
def _sum_lanes(terms: NDArray[np.float64], count: int, parameters: ScalarParameters) -> float:
    """Sum as the adder tree does: pairs, level by level, the last of an odd number waits."""
    while count > 1:
        half = count // 2
        for i in range(half):
            terms[i] = add_scalar(terms[2 * i], terms[2 * i + 1], parameters)
        if count % 2:
            terms[half] = terms[count - 1]
        count = half + count % 2
    return terms[0]


@njit
def _execute(
    words: _Words,
    entry: int,
    stop_after: int,
    array: _Array,
    lane_sets: NDArray[np.bool_],
    memory: NDArray[np.float64],
    scalars: NDArray[np.float64],
    mask: int,
    state_bank: int,
    factor_bank: int,
    parameters: ScalarParameters,
    table: NDArray[np.int64],
) -> _State:
    """Execute words from `entry` on until the last one, or for `stop_after` clocks."""
    pes = array.pes
    lanes_ring = np.zeros((_RING, pes))
    adder_ring = np.zeros(_RING)
    adder_due = np.full(_RING, -1, dtype=np.int64)
    load_ring = np.zeros(_RING)
    bus_ring = np.zeros(_RING)
    terms = np.zeros(pes)
    written = np.zeros(pes)
    error_code = 0
    error_index = 0
    nis = 0.0
    has_nis = False
    conflict = False
    clock = 0
    while stop_after < 0 or clock < stop_after:
        at = entry + clock

        # Read half: operands, products, and sums that will be due later.
        address_0 = words.address_0[at]
        address_1 = words.address_1[at]
        if words.bank_factor_1[at] and factor_bank:
            address_1 |= array.bank_offset
        if (words.bank_state_0[at] and state_bank) or (words.bank_factor_0[at] and factor_bank):
            address_0 |= array.bank_offset
        select = words.select[at]
        use_scalar = words.use_scalar[at]
        zero = words.zero[at]
        load_ring[(clock + array.load) % _RING] = memory[select % pes, address_0]
        if words.dot[at]:
            for lane in range(pes):
                if lane_sets[select, lane]:
                    terms[lane] = multiply_scalar(
                        _flushed(memory[lane, address_0], parameters),
                        _flushed(memory[lane, address_1], parameters),
                        parameters,
                    )
                else:
                    terms[lane] = 0.0
            total = _sum_lanes(terms, pes, parameters)
            before = 0.0 if words.first[at] else adder_ring[(clock + array.accumulate) % _RING]
            due = clock + array.dot
            adder_ring[due % _RING] = add_scalar(total, before, parameters)
            conflict |= adder_due[due % _RING] == due
            adder_due[due % _RING] = due
        elif use_scalar or zero:
            due = clock + array.lanes
            scalar = _flushed(scalars[int(words.scalar_address[at])], parameters)
            for lane in range(pes):
                word_0 = _flushed(memory[lane, address_0], parameters)
                product = multiply_scalar(
                    scalar if use_scalar else word_0,
                    _flushed(memory[lane, address_1], parameters),
                    parameters,
                )
                lanes_ring[due % _RING, lane] = add_scalar(
                    0.0 if zero else word_0, -product if words.subtract[at] else product, parameters
                )
            adder_ring[due % _RING] = lanes_ring[due % _RING, pes - 1]
            conflict |= adder_due[due % _RING] == due
            adder_due[due % _RING] = due

        # Write half: results that are due now.
        bus_source = words.bus_source[at]
        if bus_source == _BUS_LOAD:
            bus = load_ring[clock % _RING]
        elif bus_source == _BUS_ROOT:
            bus = reciprocal_sqrt_scalar(
                _flushed(bus_ring[(clock - array.root) % _RING], parameters), parameters, table
            )
        else:
            bus = adder_ring[clock % _RING]
        bus_ring[clock % _RING] = bus
        bus_written = 0.0 if _is_masked(words.bus_observation[at], mask) else bus
        lanes_masked = _is_masked(words.lanes_observation[at], mask)
        lanes_finite = True
        lanes = lane_sets[words.write_lanes[at]]
        if words.write[at]:
            for lane in range(pes):
                if words.write_bus[at]:
                    written[lane] = bus_written
                else:
                    written[lane] = 0.0 if lanes_masked else lanes_ring[clock % _RING, lane]
                if lanes[lane]:
                    lanes_finite &= abs(written[lane]) < np.inf
        if error_code == 0:
            if words.pivot[at] > 0:
                row = words.pivot[at] - 1
                value = _flushed(bus, parameters)
                observed = row < array.observations
                if observed and not value > 0.0:
                    if (mask >> row) & 1 or value != 0.0:
                        error_code = _SINGULAR
                        error_index = row
                elif not observed and not (
                    value > 0.0 or (value == 0.0 and array.zero_pivot_is_legal)
                ):
                    error_code = _NOT_POSITIVE
                    error_index = row - array.observations
            if error_code == 0 and not (
                lanes_finite and (not words.scalar_write[at] or abs(bus_written) < np.inf)
            ):
                error_code = _NOT_FINITE
        if error_code == 0:
            if words.write[at]:
                address = words.write_address[at]
                if (words.write_bank_state[at] and not state_bank) or (
                    words.write_bank_factor[at] and not factor_bank
                ):
                    address |= array.bank_offset
                for lane in range(pes):
                    if lanes[lane]:
                        memory[lane, address] = written[lane]
            if words.scalar_write[at]:
                scalars[words.scalar_write_address[at]] = bus_written
            if words.nis[at]:
                nis = bus_written
                has_nis = True
        clock += 1
        if words.last[at]:
            break
    return _State(error_code, error_index, nis, has_nis, clock, conflict)


class Interpreter:
    """An engine: its memories, and its programs executed word by word.

    Parameters
    ----------
    params
        What the core computes.
    pipeline
        How it is built; it decides latencies, never results.
    """

    def __init__(self, params: UkfParams, pipeline: Pipeline | None = None) -> None:
        self.params = params
        self.microcode = code = microcode(params, pipeline or Pipeline())
        self.layout = code.layout
        timing = code.timing
        fields = code.format.decode(code.words)
        self._words = _Words(**{name: column.astype(np.int64) for name, column in fields.items()})
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
        )
        self._parameters = scalar_parameters(params.format)
        self._table = reciprocal_sqrt_table(params.format)
        # Contents as float64. Words that the format does not read as written, subnormal numbers
        # and NaN with a payload, are kept apart, because a read over the bus returns them.
        self.memory = params.format.decode(self.layout.initial_words())
        self._scalars = np.zeros(code.scalars)
        self._raw: dict[tuple[int, int], tuple[int, int]] = {}

    @property
    def words(self) -> NDArray[np.uint64]:
        """Contents of the memories, shape (pes, depth)."""
        words = self.params.format.encode(self.memory)
        for place in list(self._raw):
            words[place] = self._raw_word(place, int(words[place]))
        return words

    def _raw_word(self, place: tuple[int, int], word: int) -> int:
        """Give the word as it was written over the bus, unless a program has written since."""
        raw, marker = self._raw.get(place, (0, 0))
        if marker and int(self.memory[place].view(np.uint64)) == marker:
            return raw
        self._raw.pop(place, None)
        return word

    def read(self, lane: int, address: int) -> int:
        """Read a word as the bus does."""
        word = int(self.params.format.encode(self.memory[lane, address]))
        if (lane, address) in self._raw:
            return self._raw_word((lane, address), word)
        return word

    def write(self, lane: int, address: int, word: int, strobe: int = -1) -> None:
        """Write the bytes of a word that the strobe selects, as the bus does."""
        fmt = self.params.format
        kept = self.read(lane, address) if strobe != -1 else 0
        bits = sum(0xFF << 8 * k for k in range((fmt.width + 7) // 8) if strobe >> k & 1)
        word = (word & bits | kept & ~bits) & (1 << fmt.width) - 1
        value = fmt.decode(word)
        place = (lane, address)
        self._raw.pop(place, None)
        self.memory[place] = value
        if int(fmt.encode(value)) != word:
            # A quiet NaN or a tiny number that no program writes marks the place.
            marker = np.float64(np.nan) if np.isnan(value) else np.copysign(5e-324, value)
            self.memory[place] = marker
            self._raw[place] = (word, int(self.memory[place].view(np.uint64)))

    def run(
        self,
        program: Program,
        *,
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
        state = _execute(
            self._words, self.microcode.entry[program], -1 if stop_after is None else stop_after,
            self._array, self._lane_sets, self.memory, self._scalars,
            mask & (1 << self.params.m) - 1, state_bank, factor_bank, self._parameters,
            self._table,
        )  # fmt: skip
        if state.conflict:
            raise AdderConflictError(f"The schedule of {program!r} uses an adder twice on a clock")
        return RunResult(
            error_code=state.error_code,
            error_index=state.error_index,
            nis=int(self.params.format.encode(state.nis)) if state.has_nis else None,
            clocks=self.microcode.clocks(program),
        )
