"""Golden floating-point arithmetic: what the units of the core compute, bit by bit.

Numbers are float64 whose value the format can represent (see :class:`FloatFormat`), or any NaN.
Results are rounded to nearest, ties to even. A result that is below the smallest normal number
*after* rounding, with the exponent unbounded, becomes a zero of its sign; what exceeds the largest
finite number becomes infinity. ``x + -x`` is plus zero. The reciprocal square root is the
approximation of :class:`ReciprocalSqrtParams`.

There are two forms:

- :func:`add`, :func:`multiply`, :func:`multiply_add` and :func:`reciprocal_sqrt` take a format and
  scalars or arrays.
- :func:`add_scalar`, :func:`multiply_scalar` and :func:`reciprocal_sqrt_scalar` are Numba kernels
  for use in other compiled functions, and so are :func:`decode_scalar` and :func:`encode_scalar`,
  which go from words to numbers and back. They take what :func:`scalar_parameters` gives for a
  format (and the third one also what :func:`reciprocal_sqrt_table` gives) as ordinary arguments, so
  code is compiled once and serves all formats. They do not check that operands are representable::

      @compiled
      def dot(x, y, parameters):
          total = 0.0
          for index in range(x.size):
              total = add_scalar(total, multiply_scalar(x[index], y[index], parameters), parameters)
          return total

      dot(x, y, scalar_parameters(BINARY32))
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit  # pyright: ignore[reportUnknownVariableType]
from numpy.typing import ArrayLike, NDArray

from ukf_sw.engine.kernel_cache import compiled
from ukf_sw.engine.reciprocal_sqrt import ReciprocalSqrtParams
from ukf_sw.spec.float_format import BINARY32, FloatFormat
from ukf_sw.spec.forms import exponent_step

__all__ = [
    "ScalarParameters",
    "add",
    "add_scalar",
    "decode_binary32",
    "decode_scalar",
    "encode_scalar",
    "is_binary32",
    "multiply",
    "multiply_add",
    "multiply_scalar",
    "reciprocal_sqrt",
    "reciprocal_sqrt_scalar",
    "reciprocal_sqrt_table",
    "round_binary32",
    "scalar_parameters",
]

# How a sum or product is rounded.
_BINARY32_FRACTION = 0  # to float32 by the processor
_NARROW = 1  # from float64: rounding twice is harmless up to 24 fraction bits
_WIDE = 2  # from an exact sum or product
_BINARY64_FRACTION = 3  # by the processor


_MIN_NORMAL_32 = BINARY32.min_normal
#: A magnitude from here on rounds to the smallest normal number or more.
_MIN_ROUNDED_32 = BINARY32.min_normal * (1.0 - BINARY32.epsilon / 4)


class ScalarParameters(NamedTuple):
    """What the kernels need to know of a format; made by :func:`scalar_parameters`."""

    rounding: int
    exponent_bits: int
    fraction_bits: int
    bias: int
    #: See :func:`ukf_sw.spec.forms.exponent_step`.
    exponent_step: int
    min_normal: float
    #: A magnitude from here on rounds to the smallest normal number or more.
    min_rounded: float
    #: A magnitude from here on rounds to infinity.
    overflow: float
    nan: int
    newton: bool
    degree: int
    index_bits: int
    distance_fraction_bits: int
    c0_fraction_bits: int
    c1_fraction_bits: int
    c2_fraction_bits: int
    slope_fraction_bits: int
    root_fraction_bits: int


@cache
def scalar_parameters(fmt: FloatFormat) -> ScalarParameters:
    """Give the kernels' last argument.

    Parameters
    ----------
    fmt
        Number format.

    Returns
    -------
    ScalarParameters
        The same object for equal formats.
    """
    root = ReciprocalSqrtParams(fmt=fmt)
    if fmt.fraction_bits == 23 and fmt.exponent_bits <= 8:
        rounding = _BINARY32_FRACTION
    elif fmt.fraction_bits <= 24:
        rounding = _NARROW
    elif fmt.fraction_bits < 52:
        rounding = _WIDE
    else:
        rounding = _BINARY64_FRACTION
    # In binary64 this is infinity, which is right: the processor has rounded already.
    half_step = 2.0 ** (fmt.bias - fmt.fraction_bits - 1)
    return ScalarParameters(
        rounding=rounding,
        exponent_bits=fmt.exponent_bits,
        fraction_bits=fmt.fraction_bits,
        bias=fmt.bias,
        exponent_step=exponent_step(fmt),
        min_normal=fmt.min_normal,
        min_rounded=fmt.min_normal * (1.0 - fmt.epsilon / 4),
        overflow=fmt.max_finite + half_step,
        nan=fmt.nan,
        newton=root.newton,
        degree=root.degree,
        index_bits=root.index_bits,
        distance_fraction_bits=root.distance_fraction_bits,
        c0_fraction_bits=root.c0_fraction_bits,
        c1_fraction_bits=root.c1_fraction_bits,
        c2_fraction_bits=root.c2_fraction_bits,
        slope_fraction_bits=root.slope_fraction_bits,
        root_fraction_bits=root.root_fraction_bits,
    )


@cache
def reciprocal_sqrt_table(fmt: FloatFormat) -> NDArray[np.int64]:
    """Give the last argument of :func:`reciprocal_sqrt_scalar`.

    It is not a part of :class:`ScalarParameters`, because there the reference count of an array
    would double the time of an addition.

    Parameters
    ----------
    fmt
        Number format.

    Returns
    -------
    array of int64
        Coefficients, see :attr:`ReciprocalSqrtParams.table`; the same object for equal formats.
    """
    return np.array(ReciprocalSqrtParams(fmt=fmt).table, dtype=np.int64)


# Kernels. Compiled functions are typed by Numba at the call; the hints are for the reader.


@njit
def _to_bits(value: float) -> int:
    return np.float64(value).view(np.int64)  # pyright: ignore[reportReturnType]


@njit
def _from_bits(bits: int) -> float:
    return np.int64(bits).view(np.float64)


@njit
def decode_scalar(word: int, parameters: ScalarParameters) -> float:
    """Give the number of a word, an int64; subnormal ones are zeros of their sign; compiled."""
    fraction_bits = parameters.fraction_bits
    if parameters.exponent_bits == 8 and fraction_bits == 23:
        value = np.float64(np.uint32(word).view(np.float32))
    elif parameters.exponent_bits == 11 and fraction_bits == 52:
        value = _from_bits(word)
    else:
        exponent = (word >> fraction_bits) & ((1 << parameters.exponent_bits) - 1)
        bits = (word & ((1 << (parameters.exponent_bits + fraction_bits)) - 1)) << (
            52 - fraction_bits
        )
        if exponent == (1 << parameters.exponent_bits) - 1:
            bits |= 2047 << 52
        elif exponent != 0:
            bits += (1023 - parameters.bias) << 52
        else:
            bits = 0
        sign = word >> (parameters.exponent_bits + fraction_bits)
        value = _from_bits(bits | (sign << 63))
    if abs(value) < parameters.min_normal:
        return np.copysign(0.0, value)
    return value


@njit
def encode_scalar(value: float, parameters: ScalarParameters) -> int:
    """Give the word, an int64, of a number that the format can represent, or of NaN; compiled."""
    if not abs(value) <= np.inf:
        return parameters.nan
    fraction_bits = parameters.fraction_bits
    if parameters.exponent_bits == 8 and fraction_bits == 23:
        return np.int64(np.float32(value).view(np.uint32))  # pyright: ignore[reportReturnType]
    bits = _to_bits(value)
    if parameters.exponent_bits == 11 and fraction_bits == 52:
        return bits
    magnitude = bits & ((1 << 63) - 1)
    exponent = magnitude >> 52
    if exponent == 2047:
        word = ((1 << parameters.exponent_bits) - 1) << fraction_bits
    elif exponent != 0:
        word = (magnitude - ((1023 - parameters.bias) << 52)) >> (52 - fraction_bits)
    else:
        word = 0
    sign = (bits >> 63) & 1
    return word | (sign << (parameters.exponent_bits + fraction_bits))


@njit
def _round_narrow(value: float, parameters: ScalarParameters) -> float:
    """Round a float64, ties to even, for up to 51 fraction bits."""
    magnitude = abs(value)
    if magnitude < parameters.min_rounded:
        return np.copysign(0.0, value)
    if magnitude < parameters.min_normal:
        return np.copysign(parameters.min_normal, value)
    if not magnitude < parameters.overflow:  # infinity and NaN as well
        return value + np.copysign(np.inf, value)
    shift = 52 - parameters.fraction_bits
    bits = _to_bits(value)
    bits += (1 << (shift - 1)) - 1 + ((bits >> shift) & 1)
    return _from_bits((bits >> shift) << shift)


@njit
def _add_wide(a: float, b: float, parameters: ScalarParameters) -> float:
    """Add where float64 is too narrow to round twice: 25 to 51 fraction bits."""
    total = a + b
    magnitude = abs(total)
    if not magnitude < np.inf:
        return total
    # What the addition lost, exactly (Knuth's two-sum).
    virtual = total - a
    lost = (a - (total - virtual)) + (b - virtual)
    if magnitude >= parameters.min_normal:
        shift = 52 - parameters.fraction_bits
        bits = _to_bits(total)
        half = 1 << (shift - 1)
        # The lost part decides only where the rest looks like a tie.
        if lost != 0.0 and (bits & ((1 << shift) - 1)) == half:
            if (lost > 0.0) == (total > 0.0):
                bits += 1
            else:
                bits -= 1
            total = _from_bits(bits)
    return _round_narrow(total, parameters)


@njit
def _multiply_exact(a: float, b: float, parameters: ScalarParameters) -> float:
    """Multiply finite nonzero normal numbers in integers, for 25 to 52 fraction bits."""
    bits_a = _to_bits(a)
    bits_b = _to_bits(b)
    hidden = 1 << 52
    significand_a = (bits_a & (hidden - 1)) | hidden
    significand_b = (bits_b & (hidden - 1)) | hidden
    exponent = ((bits_a >> 52) & 2047) + ((bits_b >> 52) & 2047) - 2046

    # 106-bit product as high * 2**54 + low, from pieces of 27 and 26 bits.
    mask = (1 << 27) - 1
    high_a, low_a = significand_a >> 27, significand_a & mask
    high_b, low_b = significand_b >> 27, significand_b & mask
    middle = high_a * low_b + low_a * high_b + ((low_a * low_b) >> 27)
    low = ((middle & mask) << 27) | ((low_a * low_b) & mask)
    high = high_a * high_b + (middle >> 27)

    # The product is in [2**104, 2**106): its integer part starts at bit 104 or 105.
    top = 104
    if high >= 1 << 51:
        top = 105
        exponent += 1
    drop = top - parameters.fraction_bits - 54
    if drop >= 1:
        kept = high >> drop
        rest = high & ((1 << drop) - 1)
        half = 1 << (drop - 1)
        below = low != 0
    else:
        kept = (high << -drop) | (low >> (54 + drop))
        rest = low & ((1 << (54 + drop)) - 1)
        half = 1 << (53 + drop)
        below = False
    if rest > half or (rest == half and (below or (kept & 1) == 1)):
        kept += 1
        if kept >> (parameters.fraction_bits + 1):
            kept >>= 1
            exponent += 1

    sign = np.copysign(1.0, a) * np.copysign(1.0, b)
    if exponent > parameters.bias:
        return sign * np.inf
    if exponent < 1 - parameters.bias:
        return sign * 0.0
    fraction = (kept << (52 - parameters.fraction_bits)) & (hidden - 1)
    return sign * _from_bits(((exponent + 1023) << 52) | fraction)


@njit
def add_scalar(a: float, b: float, parameters: ScalarParameters) -> float:
    """Add two numbers; compiled."""
    if parameters.rounding == _BINARY32_FRACTION:
        total = a + b
        if abs(total) < parameters.min_rounded:
            return np.copysign(0.0, total)
        if not abs(total) < parameters.overflow:
            return total + np.copysign(np.inf, total)
        return np.float64(np.float32(total))
    if parameters.rounding == _BINARY64_FRACTION:
        total = a + b
        if abs(total) < parameters.min_normal:
            return np.copysign(0.0, total)
        if not abs(total) < parameters.overflow:
            return total + np.copysign(np.inf, total)
        return total
    if parameters.rounding == _NARROW:
        return _round_narrow(a + b, parameters)
    return _add_wide(a, b, parameters)


@njit
def multiply_scalar(a: float, b: float, parameters: ScalarParameters) -> float:
    """Multiply two numbers; compiled."""
    product = a * b
    if parameters.rounding == _BINARY32_FRACTION:
        if abs(product) < parameters.min_rounded:
            return np.copysign(0.0, product)
        if not abs(product) < parameters.overflow:
            return product + np.copysign(np.inf, product)
        return np.float64(np.float32(product))
    if parameters.rounding == _NARROW:
        return _round_narrow(product, parameters)
    if a == 0.0 or b == 0.0 or not (abs(a) < np.inf and abs(b) < np.inf):
        return product
    # The processor rounds a product below the smallest normal number to fewer bits.
    exact = 2.0 * parameters.min_normal < abs(product) < parameters.overflow
    if exact and parameters.rounding == _BINARY64_FRACTION:
        return product
    return _multiply_exact(a, b, parameters)


# The same for binary32 alone, with nothing to branch on: in a loop over numbers that lie together,
# the processor computes several at a time.


@njit
def is_binary32(parameters: ScalarParameters) -> bool:
    """Whether a format is binary32; compiled."""
    return parameters.exponent_bits == 8 and parameters.fraction_bits == 23


@njit
def decode_binary32(word: int) -> float:
    """Do what :func:`decode_scalar` does for binary32; compiled."""
    value = np.float64(np.uint32(word).view(np.float32))
    return np.copysign(0.0, value) if abs(value) < _MIN_NORMAL_32 else value


@njit
def round_binary32(value: float) -> float:
    """Round a sum or a product of two numbers of binary32, made in float64; compiled."""
    rounded = np.float64(np.float32(value))
    return np.copysign(0.0, value) if abs(value) < _MIN_ROUNDED_32 else rounded


@njit
def reciprocal_sqrt_scalar(
    a: float, parameters: ScalarParameters, table: NDArray[np.int64]
) -> float:
    """Give the reciprocal square root of a number; compiled."""
    if a == 0.0 or a == np.inf:
        return 0.0
    if not a > 0.0:
        return np.nan
    p = parameters
    bits = _to_bits(a)
    exponent = (bits >> 52) - 1023
    fraction = (bits & ((1 << 52) - 1)) >> (52 - p.fraction_bits)
    odd = exponent & 1

    distance_bits = p.distance_fraction_bits - p.index_bits
    index = (odd << p.index_bits) | (fraction >> (p.fraction_bits - p.index_bits))
    c0, c1, c2 = table[index, 0], table[index, 1], table[index, 2]
    distance = fraction >> (p.fraction_bits - p.distance_fraction_bits)
    distance = (distance & ((1 << distance_bits) - 1)) - (1 << (distance_bits - 1))
    slope = c1
    if p.degree == 2:
        fine_bits = p.c2_fraction_bits + p.distance_fraction_bits
        fine = (c1 << (fine_bits - p.c1_fraction_bits)) + distance * c2
        slope = fine >> (fine_bits - p.slope_fraction_bits)
    scale_bits = p.slope_fraction_bits + p.distance_fraction_bits
    root = (c0 << (scale_bits - p.c0_fraction_bits)) + distance * slope
    root >>= scale_bits - p.root_fraction_bits

    precision = p.fraction_bits + 1
    if p.newton:
        # r * y in two pieces, because r * y is wider than a word; the residual, which is small, is
        # left when the high bits of its minuend and subtrahend overflow alike.
        drop = p.root_fraction_bits - 6
        radicand = ((1 << p.fraction_bits) | fraction) << odd
        product = (radicand >> drop) * root + (((radicand & ((1 << drop) - 1)) * root) >> drop)
        product_fraction_bits = p.fraction_bits + 6
        minuend_bits = product_fraction_bits + p.root_fraction_bits
        minuend = 1 << minuend_bits if minuend_bits < 64 else 0
        residual = (minuend - product * root) >> p.root_fraction_bits
        drop = minuend_bits + 1 - precision
        correction = (root * residual + (1 << (drop - 1))) >> drop
        root = (root << (precision - p.root_fraction_bits)) + correction

    one = root >> precision
    fraction = (root & ((1 << p.fraction_bits) - 1)) << (52 - p.fraction_bits)
    return _from_bits(((1022 - ((exponent - odd) >> 1) + one) << 52) | fraction)


# Arrays.


@compiled
def _add_all(
    a: NDArray[np.float64], b: NDArray[np.float64], parameters: ScalarParameters
) -> NDArray[np.float64]:
    result = np.empty_like(a)
    for index in range(a.size):
        result[index] = add_scalar(a[index], b[index], parameters)
    return result


@compiled
def _multiply_all(
    a: NDArray[np.float64], b: NDArray[np.float64], parameters: ScalarParameters
) -> NDArray[np.float64]:
    result = np.empty_like(a)
    for index in range(a.size):
        result[index] = multiply_scalar(a[index], b[index], parameters)
    return result


@compiled
def _multiply_add_all(
    c: NDArray[np.float64],
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    parameters: ScalarParameters,
) -> NDArray[np.float64]:
    result = np.empty(max(c.size, a.size, b.size))
    for index in range(result.size):
        product = multiply_scalar(
            a[index if a.size > 1 else 0], b[index if b.size > 1 else 0], parameters
        )
        result[index] = add_scalar(c[index if c.size > 1 else 0], product, parameters)
    return result


@compiled
def _reciprocal_sqrt_all(
    a: NDArray[np.float64], parameters: ScalarParameters, table: NDArray[np.int64]
) -> NDArray[np.float64]:
    result = np.empty_like(a)
    for index in range(a.size):
        result[index] = reciprocal_sqrt_scalar(a[index], parameters, table)
    return result


def _operands(fmt: FloatFormat, *values: ArrayLike) -> list[NDArray[np.float64]]:
    """Broadcast operands and flush what is subnormal in the format."""
    arrays = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in values))
    return [
        np.where(np.abs(array) < fmt.min_normal, np.copysign(0.0, array), array) for array in arrays
    ]


def add(fmt: FloatFormat, a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """Add numbers.

    Parameters
    ----------
    fmt
        Number format.
    a, b
        Numbers of that format, of shapes that broadcast. Subnormal ones read as zeros.

    Returns
    -------
    array of float64
        Sums.
    """
    x, y = _operands(fmt, a, b)
    return _add_all(x.ravel(), y.ravel(), scalar_parameters(fmt)).reshape(x.shape)


def multiply(fmt: FloatFormat, a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """Multiply numbers.

    Parameters
    ----------
    fmt
        Number format.
    a, b
        Numbers of that format, of shapes that broadcast. Subnormal ones read as zeros.

    Returns
    -------
    array of float64
        Products.
    """
    x, y = _operands(fmt, a, b)
    return _multiply_all(x.ravel(), y.ravel(), scalar_parameters(fmt)).reshape(x.shape)


def multiply_add(
    fmt: FloatFormat, c: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Give c + a * b, both rounded; what many small arrays take the least time with.

    Parameters
    ----------
    fmt
        Number format.
    c, a, b
        Numbers of that format, of one dimension, each of length K or 1.

    Returns
    -------
    array of float64
        Sums, shape (K,).

    Raises
    ------
    ValueError
        If the lengths do not fit.
    """
    np.broadcast_shapes(c.shape, a.shape, b.shape)
    return _multiply_add_all(c, a, b, scalar_parameters(fmt))


def reciprocal_sqrt(fmt: FloatFormat, a: ArrayLike) -> NDArray[np.float64]:
    """Give reciprocal square roots.

    Parameters
    ----------
    fmt
        Number format.
    a
        Numbers of that format, any shape. Subnormal ones read as zeros.

    Returns
    -------
    array of float64
        ``1/sqrt`` of them, off by less than one unit in the last place. A zero of either sign and
        infinity give plus zero; negative numbers and NaN give NaN.
    """
    (x,) = _operands(fmt, a)
    parameters, table = scalar_parameters(fmt), reciprocal_sqrt_table(fmt)
    return _reciprocal_sqrt_all(x.ravel(), parameters, table).reshape(x.shape)
