"""What the lanes of the array compute on a clock, compiled: golden arithmetic over whole words.

Words have the shape (depth, pes), results that are under way (clocks, pes). In binary32 a loop over
the lanes has nothing to branch on, so the processor computes several at a time. What every clock
needs is compiled into its caller: a call that hands over arrays takes longer than a lane.
"""

from math import copysign, frexp, ldexp

import numpy as np
from numba import njit  # pyright: ignore[reportUnknownVariableType]
from numpy.typing import NDArray

from ukf_sw.engine.arithmetic import (
    ScalarParameters,
    add_scalar,
    decode_binary32,
    decode_scalar,
    encode_scalar,
    is_binary32,
    multiply_scalar,
    reciprocal_sqrt_scalar,
    round_binary32,
)
from ukf_sw.engine.control_word import STEERING

__all__ = ["FORM_BITS", "combine", "inner_product", "signed_root", "store"]


#: Steering of models, beyond that of the filter, as bits of one number, which is called `form`.
FORM_BITS = {name: 1 << k for k, name in enumerate(STEERING[3:])}
_MINUS_ZERO, _SCALAR_ADDEND = FORM_BITS["minus_zero"], FORM_BITS["scalar_addend"]
_ONE, _POWER, _EXPONENT = FORM_BITS["one"], FORM_BITS["power"], FORM_BITS["exponent"]
_CLEAR_SIGN, _COPY_SIGN = FORM_BITS["clear_sign"], FORM_BITS["copy_sign"]
_TURN_BIT_0, _TURN_BIT_1 = FORM_BITS["turn_bit_0"], FORM_BITS["turn_bit_1"]
_IF_NEGATIVE, _IF_NOT_NEGATIVE = FORM_BITS["if_negative"], FORM_BITS["if_not_negative"]
_IF_ODD, _IF_FINITE = FORM_BITS["if_odd"], FORM_BITS["if_finite"]


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
def _read(number_0: float, number_1: float, form: int, parameters: ScalarParameters) -> float:
    """Operand b: word 1 as a form reads it, with the sign that the form gives it."""
    middle = 1.5 * 2.0**parameters.fraction_bits
    b = number_1
    if form & _ONE:
        b = 1.0
    elif form & _POWER:
        if number_1 < 2.0**parameters.fraction_bits:
            b = 0.0
        elif number_1 >= 2.0 ** (parameters.fraction_bits + 1):
            b = np.inf
        elif number_1 == number_1:
            exponent = number_1 - middle + 1.0
            if exponent < 1.0 - parameters.bias:
                b = 0.0
            elif exponent > parameters.bias:
                b = np.inf
            else:
                b = ldexp(1.0, int(exponent))
    elif form & _EXPONENT:
        if number_1 == 0.0:
            b = -np.inf
        elif 0.0 < number_1 < np.inf:
            exponent_0 = frexp(number_1)[1] - 2
            b = middle + float(exponent_0 // parameters.exponent_step)
        else:
            b = np.nan
    if form & _CLEAR_SIGN:
        b = abs(b)
    if form & _COPY_SIGN and _is_negative(number_0):
        b = -b
    if form & _TURN_BIT_0 and _bit(number_0, 0, parameters.fraction_bits):
        b = -b
    if form & _TURN_BIT_1 and _bit(number_0, 1, parameters.fraction_bits):
        b = -b
    return b


@njit
def _skips(number_1: float, form: int, parameters: ScalarParameters) -> bool:
    """Whether a lane keeps what the destination has, whatever the result is."""
    if form & _IF_NEGATIVE:
        return not _is_negative(number_1)
    if form & _IF_NOT_NEGATIVE:
        return _is_negative(number_1)
    if form & _IF_ODD:
        return not _bit(number_1, 0, parameters.fraction_bits)
    return False


@njit
def signed_root(number: float, parameters: ScalarParameters, table: NDArray[np.int64]) -> float:
    """1/sqrt of the magnitude with the sign of the number, as `Root.SIGNED` says."""
    magnitude = abs(number)
    if magnitude == 0.0:
        root = np.inf
    elif magnitude == np.inf:
        root = 0.0
    elif magnitude < 2.0 ** (parameters.bias - 1):
        root = reciprocal_sqrt_scalar(magnitude, parameters, table)
    else:
        return np.nan
    return -root if _is_negative(number) else root


@njit(inline="always")
def _add_pairs(terms: NDArray[np.float64], half: int, parameters: ScalarParameters) -> None:
    """Put the sums of twice as many neighbours into the first places."""
    if is_binary32(parameters):
        for i in range(half):
            terms[i] = round_binary32(terms[2 * i] + terms[2 * i + 1])
    else:
        for i in range(half):
            terms[i] = add_scalar(terms[2 * i], terms[2 * i + 1], parameters)


@njit(inline="always")
def _sum_lanes(terms: NDArray[np.float64], count: int, parameters: ScalarParameters) -> float:
    """Sum as the adder tree does: pairs, level by level, the last of an odd number waits."""
    while count > 1:
        half = count // 2
        _add_pairs(terms, half, parameters)
        if count % 2:
            terms[half] = terms[count - 1]
        count = half + count % 2
    return terms[0]


@njit(inline="always")
def inner_product(
    memory: NDArray[np.int64],
    address_0: int,
    address_1: int,
    lane_sets: NDArray[np.bool_],
    lanes: int,
    terms: NDArray[np.float64],
    parameters: ScalarParameters,
) -> float:
    """Sum the products of two words over lanes; `terms` has a place for each lane."""
    if is_binary32(parameters):
        for lane in range(len(terms)):
            product = round_binary32(
                decode_binary32(memory[address_0, lane]) * decode_binary32(memory[address_1, lane])
            )
            terms[lane] = product if lane_sets[lanes, lane] else 0.0
    else:
        for lane in range(len(terms)):
            terms[lane] = 0.0
            if lane_sets[lanes, lane]:
                terms[lane] = multiply_scalar(
                    decode_scalar(memory[address_0, lane], parameters),
                    decode_scalar(memory[address_1, lane], parameters),
                    parameters,
                )
    return _sum_lanes(terms, len(terms), parameters)


@njit(inline="always")
def combine(
    memory: NDArray[np.int64],
    address_0: int,
    address_1: int,
    scalar: float,
    use_scalar: bool,
    zero: bool,
    subtract: bool,
    form: int,
    results: NDArray[np.float64],
    skips: NDArray[np.bool_],
    slot: int,
    parameters: ScalarParameters,
) -> None:
    """Compute c + a * b in each lane, and whether the lane keeps what the destination has."""
    if form:
        _combine_in_form(
            memory, address_0, address_1, scalar, use_scalar, zero, subtract, form, results, skips,
            slot, parameters,
        )  # fmt: skip
    elif is_binary32(parameters):
        sign = -1.0 if subtract else 1.0
        for lane in range(results.shape[1]):
            number_0 = decode_binary32(memory[address_0, lane])
            number_1 = decode_binary32(memory[address_1, lane])
            product = round_binary32((scalar if use_scalar else number_0) * number_1)
            skips[slot, lane] = False
            results[slot, lane] = round_binary32((0.0 if zero else number_0) + sign * product)
    else:
        for lane in range(results.shape[1]):
            number_0 = decode_scalar(memory[address_0, lane], parameters)
            number_1 = decode_scalar(memory[address_1, lane], parameters)
            product = multiply_scalar(scalar if use_scalar else number_0, number_1, parameters)
            addend = 0.0 if zero else number_0
            skips[slot, lane] = False
            results[slot, lane] = add_scalar(addend, -product if subtract else product, parameters)


@njit
def _combine_in_form(
    memory: NDArray[np.int64],
    address_0: int,
    address_1: int,
    scalar: float,
    use_scalar: bool,
    zero: bool,
    subtract: bool,
    form: int,
    results: NDArray[np.float64],
    skips: NDArray[np.bool_],
    slot: int,
    parameters: ScalarParameters,
) -> None:
    """Do what :func:`combine` does for the forms that models need."""
    for lane in range(results.shape[1]):
        number_0 = decode_scalar(memory[address_0, lane], parameters)
        number_1 = decode_scalar(memory[address_1, lane], parameters)
        addend = 0.0 if zero else number_0
        if form & _MINUS_ZERO:
            addend = -0.0
        elif form & _SCALAR_ADDEND:
            addend = scalar
        product = multiply_scalar(
            scalar if use_scalar else number_0,
            _read(number_0, number_1, form, parameters),
            parameters,
        )
        total = add_scalar(addend, -product if subtract else product, parameters)
        results[slot, lane] = total
        if form & _IF_FINITE:
            skips[slot, lane] = not abs(total) < np.inf
        else:
            skips[slot, lane] = _skips(number_1, form, parameters)


@njit(inline="always")
def store(
    memory: NDArray[np.int64],
    address: int,
    lane_sets: NDArray[np.bool_],
    lanes: int,
    results: NDArray[np.float64],
    skips: NDArray[np.bool_],
    slot: int,
    masked: bool,
    parameters: ScalarParameters,
) -> None:
    """Write results of lanes as words, zeros if they are masked, where they are not skipped."""
    for lane in range(results.shape[1]):
        if lane_sets[lanes, lane] and not skips[slot, lane]:
            word = 0 if masked else encode_scalar(results[slot, lane], parameters)
            memory[address, lane] = word
