"""The golden model of the engine: executes the control words, bit for bit and clock by clock.

It knows what a word does, not what the program meant. Its results arrive with the latencies of
the hardware, so a wrong schedule gives wrong numbers here as well.
"""

from math import copysign, frexp, ldexp
from typing import NamedTuple

import numpy as np
from numba import njit  # pyright: ignore[reportUnknownVariableType]
from numpy.typing import NDArray

from ukf_sw.engine.arithmetic import (
    ScalarParameters,
    add_scalar,
    decode_scalar,
    encode_scalar,
    multiply_scalar,
    reciprocal_sqrt_scalar,
    reciprocal_sqrt_table,
    scalar_parameters,
)
from ukf_sw.engine.control_word import READ, STEERING, WRITE, BusSource
from ukf_sw.engine.kernel_cache import compiled
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.pivots import noise_exponent
from ukf_sw.engine.programs import RunResult
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.forms import exponent_step
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
    fraction_bits: int
    exponent_step: int
    bias: int


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
#: something that is written, and the steering of the forms of models as one number.
_WORD = np.dtype([(name, np.int32) for name in (*READ.fields, *WRITE.fields, "computes", "form")])
#: Steering beyond that of the filter, in the bits of `form`.
_OF_MODELS = STEERING[3:]
_BIT = {name: 1 << k for k, name in enumerate(_OF_MODELS)}
_MINUS_ZERO, _SCALAR_ADDEND = _BIT["minus_zero"], _BIT["scalar_addend"]
_ONE, _POWER, _EXPONENT = _BIT["one"], _BIT["power"], _BIT["exponent"]
_CLEAR_SIGN, _COPY_SIGN = _BIT["clear_sign"], _BIT["copy_sign"]
_TURN_BIT_0, _TURN_BIT_1 = _BIT["turn_bit_0"], _BIT["turn_bit_1"]
_IF_NEGATIVE, _IF_NOT_NEGATIVE = _BIT["if_negative"], _BIT["if_not_negative"]
_IF_ODD, _IF_FINITE = _BIT["if_odd"], _BIT["if_finite"]
_CONDITIONS = _IF_NEGATIVE | _IF_NOT_NEGATIVE | _IF_ODD | _IF_FINITE


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
def _is_noise(pivot: float, coupling: float, noise_exponent: int) -> bool:
    """Whether a pivot is rounding noise beside the largest element that led to it."""
    if not (0.0 < pivot < np.inf and coupling > 0.0):
        return False
    return frexp(pivot)[1] - 1 < 2 * (frexp(coupling)[1] - 1) - noise_exponent


@njit
def _is_negative(number: float) -> bool:
    """Whether the sign of a number is set, which that of NaN is not."""
    return number < 0.0 or (number == 0.0 and copysign(1.0, number) < 0.0)


@njit
def _bit(number: float, bit: int, fraction_bits: int) -> bool:
    """Whether a bit of the word of a number is set."""
    if number != number:  # of NaN only the top bit of the fraction is
        return bit == fraction_bits - 1
    fraction, _ = frexp(abs(number))
    if not 0.0 < fraction < 1.0:
        return False
    return bool(int(fraction * 2.0 ** (fraction_bits + 1)) >> bit & 1)


@njit
def _read(number_0: float, number_1: float, form: int, array: _Array) -> float:
    """Operand b: word 1 as a form reads it, with the sign that the form gives it."""
    middle = 1.5 * 2.0**array.fraction_bits
    b = number_1
    if form & _ONE:
        b = 1.0
    elif form & _POWER:
        if number_1 < 2.0**array.fraction_bits:
            b = 0.0
        elif number_1 >= 2.0 ** (array.fraction_bits + 1):
            b = np.inf
        elif number_1 == number_1:
            exponent = number_1 - middle + 1.0
            if exponent < 1.0 - array.bias:
                b = 0.0
            elif exponent > array.bias:
                b = np.inf
            else:
                b = ldexp(1.0, int(exponent))
    elif form & _EXPONENT:
        if number_1 == 0.0:
            b = -np.inf
        elif 0.0 < number_1 < np.inf:
            exponent_0 = frexp(number_1)[1] - 2
            b = middle + float(exponent_0 // array.exponent_step)
        else:
            b = np.nan
    if form & _CLEAR_SIGN:
        b = abs(b)
    if form & _COPY_SIGN and _is_negative(number_0):
        b = -b
    if form & _TURN_BIT_0 and _bit(number_0, 0, array.fraction_bits):
        b = -b
    if form & _TURN_BIT_1 and _bit(number_0, 1, array.fraction_bits):
        b = -b
    return b


@njit
def _signed_root(
    number: float, array: _Array, parameters: ScalarParameters, table: NDArray[np.int64]
) -> float:
    """1/sqrt of the magnitude with the sign of the number, as `Root.SIGNED` says."""
    magnitude = abs(number)
    if magnitude == 0.0:
        root = np.inf
    elif magnitude == np.inf:
        root = 0.0
    elif magnitude < 2.0 ** (array.bias - 1):
        root = reciprocal_sqrt_scalar(magnitude, parameters, table)
    else:
        return np.nan
    return -root if _is_negative(number) else root


@njit
def _skips(number_1: float, form: int, array: _Array) -> bool:
    """Whether a lane keeps what the destination has, whatever the result is."""
    if form & _IF_NEGATIVE:
        return not _is_negative(number_1)
    if form & _IF_NOT_NEGATIVE:
        return _is_negative(number_1)
    if form & _IF_ODD:
        return not _bit(number_1, 0, array.fraction_bits)
    return False


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
    has_condition = np.zeros(_RING, dtype=np.bool_)
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
        load_ring[(clock + array.load) % _RING] = memory[select % pes, address_0]
        if word["dot"]:
            for lane in range(pes):
                if lane_sets[select, lane]:
                    terms[lane] = multiply_scalar(
                        decode_scalar(memory[lane, address_0], parameters),
                        decode_scalar(memory[lane, address_1], parameters),
                        parameters,
                    )
                else:
                    terms[lane] = 0.0
            total = _sum_lanes(terms, pes, parameters)
            before = 0.0 if word["first"] else adder_ring[(clock + array.accumulate) % _RING]
            due = clock + array.dot
            adder_ring[due % _RING] = add_scalar(total, before, parameters)
            conflict |= adder_due[due % _RING] == due
            adder_due[due % _RING] = due
        elif word["computes"]:
            due = clock + array.lanes
            scalar = scalars[int(word["scalar_address"])]
            form = word["form"]
            has_condition[due % _RING] = form & _CONDITIONS != 0
            for lane in range(pes):
                number_0 = decode_scalar(memory[lane, address_0], parameters)
                number_1 = decode_scalar(memory[lane, address_1], parameters)
                c = 0.0 if zero else number_0
                if form:
                    if form & _CONDITIONS:
                        skip_ring[due % _RING, lane] = _skips(number_1, form, array)
                    number_1 = _read(number_0, number_1, form, array)
                    if form & _MINUS_ZERO:
                        c = -0.0
                    elif form & _SCALAR_ADDEND:
                        c = scalar
                product = multiply_scalar(scalar if use_scalar else number_0, number_1, parameters)
                total = add_scalar(c, -product if word["subtract"] else product, parameters)
                lanes_ring[due % _RING, lane] = total
                if form & _IF_FINITE:
                    skip_ring[due % _RING, lane] = not abs(total) < np.inf
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
                bus = _signed_root(number, array, parameters, table)
            else:
                bus = reciprocal_sqrt_scalar(number, parameters, table)
        else:
            bus = adder_ring[clock % _RING]
        bus_ring[clock % _RING] = bus
        signed_ring[clock % _RING] = word["signed"] != 0
        bus_masked = _is_masked(word["bus_observation"], mask)
        lanes_masked = _is_masked(word["lanes_observation"], mask)
        lanes = lane_sets[word["write_lanes"]]
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
                    if lanes[lane]:
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
                conditional = has_condition[clock % _RING] and not word["write_bus"]
                for lane in range(pes):
                    if lanes[lane] and not (conditional and skip_ring[clock % _RING, lane]):
                        if word["write_bus"]:
                            memory[lane, address] = bus_word
                        elif lanes_masked:
                            memory[lane, address] = 0
                        else:
                            memory[lane, address] = encode_scalar(
                                lanes_ring[clock % _RING, lane], parameters
                            )
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
            self._words[name] = column
        # The lanes compute on every clock; what counts is what is written when it is there.
        ends = np.zeros(len(code.words), dtype=np.bool_)
        ends[: -timing.lanes] = (self._words["write"] & (1 - self._words["write_bus"]))[
            timing.lanes :
        ]
        self._words["computes"] = self._words["use_scalar"] | self._words["zero"] | ends
        for name in code.format.present(_OF_MODELS):
            self._words["form"] |= self._words[name] * _BIT[name]
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
            fraction_bits=params.format.fraction_bits,
            exponent_step=exponent_step(params.format),
            bias=params.format.bias,
        )
        self._parameters = scalar_parameters(params.format)
        self._table = reciprocal_sqrt_table(params.format)
        self.memory = self.layout.initial_words()
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
            self._lane_sets, self.memory.view(np.int64), self._scalars,
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
