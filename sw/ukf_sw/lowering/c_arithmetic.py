"""The arithmetic of a core as functions in C that compute the same bits on any processor.

What they compute is said in :mod:`ukf_sw.engine.arithmetic` and
:mod:`ukf_sw.elementary.primitives`. There are three ways to round:

- binary32 and binary64 are the processor's float and double. Sums are right as they are, but for
  flushing: one below the smallest normal number is exact. A product that a processor gives as the
  smallest normal number or less is computed again, far away from that limit. Magnitudes are
  compared as words, which is off the path of the results; a fused operation, which GCC makes of
  C11 as well unless it is told not to, would skip a rounding.
- Formats with up to 24 bits of fraction are held in double, which rounds first and harmlessly.
- Longer ones, up to a word of 32 bits, are held in double too. What a sum loses is known exactly,
  and decides in its last bit; products are sums of two exact parts.

The processor may flush subnormal numbers or not, before or after it rounds: none has a part in a
result, but for those of formats with 11 bits of exponent other than binary64.
"""

import re
from string import Template

import numpy as np

from ukf_sw.engine.reciprocal_sqrt import ReciprocalSqrtParams
from ukf_sw.spec.float_format import BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.forms import exponent_step

__all__ = ["check_format", "helpers", "literal", "number_type", "suffix"]

#: A word is at most that wide, but in binary64.
_MAX_WIDTH = 32
#: A double rounds twice without harm up to here.
_NARROW_FRACTION_BITS = 24


def check_format(fmt: FloatFormat) -> None:
    """Demand that C can compute in a format.

    Raises
    ------
    ValueError
        If it cannot.
    """
    if fmt.width > _MAX_WIDTH and fmt != BINARY64:
        raise ValueError(
            f"format must be binary64 or have at most {_MAX_WIDTH} bits for models in C, "
            f"not {fmt.name!r}"
        )


def number_type(fmt: FloatFormat) -> str:
    """Give the type of C that has all numbers of a format."""
    fits = (
        fmt.exponent_bits <= BINARY32.exponent_bits and fmt.fraction_bits <= BINARY32.fraction_bits
    )
    return "float" if fits else "double"


def _holder(fmt: FloatFormat) -> FloatFormat:
    """Give the format that numbers are held in: float is for binary32 alone."""
    return BINARY32 if fmt == BINARY32 else BINARY64


def suffix(fmt: FloatFormat) -> str:
    """Give what ends the names of functions and numbers of the type that they are held in."""
    return "f" if _holder(fmt) == BINARY32 else ""


def literal(fmt: FloatFormat, value: float) -> str:
    """Write a number of a format in C.

    Raises
    ------
    ValueError
        If it is not a number of that format.
    """
    if value != value:
        return "NAN"
    if float(fmt.round(value)) != value:
        raise ValueError(f"constants must be numbers of {fmt.name}, not {value!r}")
    if abs(value) == float("inf"):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    # The fewest digits that are this number.
    return f"{np.float32(value)}f" if suffix(fmt) else repr(value)


_HEAD = """\
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

/* Each operation is rounded by itself, also where a compiler would rather fuse two of them. */
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=off")
#else
#pragma STDC FP_CONTRACT OFF
#endif

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile this file without -ffast-math and -Ofast, which change results"
#endif

#if FLT_EVAL_METHOD < 0 || FLT_EVAL_METHOD == 2
#error "the processor must compute in float and double: on x86, with -mfpmath=sse"
#endif

/* $name: bits of the fraction, bias of the exponent, and the smallest normal number. */
#define FRACTION_BITS $fraction_bits
#define BIAS $bias
#define MIN_NORMAL $min_normal
/* The same of $holder, which holds the numbers. */
#define HOLDER_FRACTION_BITS $holder_fraction_bits
#define HOLDER_BIAS $holder_bias
#define MIN_NORMAL_MAGNITUDE (($word)2 << HOLDER_FRACTION_BITS)

/* Results near zero are rare, and so not in line. */
#ifdef __GNUC__
#define RARE __attribute__((noinline, cold))
#else
#define RARE
#endif

union bits {
    $holder number;
    $word word;
};
"""

# Each is there if one behind it, or a program, calls it.
_COMMON = {
    "word_of": """\
static inline $word word_of($holder number)
{
    return (union bits){.number = number}.word;
}
""",
    "number_of": """\
static inline $holder number_of($word word)
{
    return (union bits){.word = word}.number;
}
""",
    "is_negative": """\
/* NaN is not. */
static inline bool is_negative($holder a)
{
    return signbit(a) && a == a;
}
""",
    "has_bit": """\
/* A bit of the fraction; NaN has none of those that are asked for. */
static inline bool has_bit($holder a, unsigned number)
{
    return a == a && (word_of(a) >> (number + HOLDER_FRACTION_BITS - FRACTION_BITS) & 1u) != 0u;
}
""",
    "absolute": """\
/* By its word: GCC 12 takes 0.0 + -fabs(a) for -fabs(a), also where that is -0.0. */
static inline $holder absolute($holder a)
{
    return number_of(word_of(a) & ~($word)0 >> 1);
}
""",
    "with_sign_of": """\
static inline $holder with_sign_of($holder sign, $holder a)
{
    return is_negative(sign) ? -absolute(a) : absolute(a);
}
""",
    "turned_if": """\
static inline $holder turned_if(bool turn, $holder a)
{
    return turn ? -a : a;
}
""",
    "if_finite": """\
static inline $holder if_finite($holder a, $holder otherwise)
{
    return fabs$f(a) < INFINITY ? a : otherwise;
}
""",
}

_READINGS = {
    "power": """\
/* 2**(k + 1) of $middle + k. */
static inline $holder power($holder a)
{
    const $holder exponent = a - $middle + 1.0$f;

    if (a != a) {
        return NAN;
    }
    if (a < $low || exponent < 1 - BIAS) {
        return 0.0$f;
    }
    if (a >= $high || exponent > BIAS) {
        return INFINITY;
    }
    return number_of(($word)((int32_t)exponent + HOLDER_BIAS) << HOLDER_FRACTION_BITS);
}
""",
    "exponent": """\
/* $middle + $integer of a number with the exponent e. */
static inline $holder exponent($holder a)
{
    if (a == 0.0$f) {
        return -INFINITY;
    }
    if (!(a > 0.0$f && a < INFINITY)) {
        return NAN;
    }
    const int32_t e = (int32_t)(word_of(a) >> HOLDER_FRACTION_BITS) - HOLDER_BIAS;

    return $middle + ($holder)($integer);
}
""",
}

# Binary32 and binary64.
_OF_THE_PROCESSOR = {
    "magnitude": """\
/* Magnitudes are in the order of these. */
static inline $word magnitude($holder a)
{
    return word_of(a) << 1;
}
""",
    "small_sum": """\
RARE static $holder small_sum($holder a)
{
    return copysign$f(0.0$f, a);
}
""",
    "flushed": """\
static inline $holder flushed($holder a)
{
    return magnitude(a) < MIN_NORMAL_MAGNITUDE ? small_sum(a) : a;
}
""",
    "input": """\
static inline $holder input($type a)
{
    return flushed(a);
}
""",
    "add": """\
/* What is below the smallest normal number is exact. */
static inline $holder add($holder a, $holder b)
{
    return flushed(a + b);
}
""",
    "small_product": """\
/*
 * A product that is the smallest normal number or less: whether it is that, with the exponent
 * unbounded, shows in a larger one.
 */
RARE static $holder small_product($holder a, $holder b)
{
    const $holder scale = $scale;
    const $holder large = magnitude(a) < magnitude(b) ? a * scale * b : b * scale * a;

    return copysign$f(fabs$f(large) < MIN_NORMAL * scale ? 0.0$f : MIN_NORMAL, large);
}
""",
    "multiply": """\
static inline $holder multiply($holder a, $holder b)
{
    const $holder product = a * b;

    return magnitude(product) <= MIN_NORMAL_MAGNITUDE ? small_product(a, b) : product;
}
""",
}

_ROUNDED = {
    "rounded": """\
/* To nearest, ties to even, with the exponent unbounded; then flushed, or infinite. */
static $holder rounded($holder a)
{
    const $holder magnitude = fabs(a);
    const unsigned shift = HOLDER_FRACTION_BITS - FRACTION_BITS;

    if (magnitude < MIN_NORMAL) {
        return copysign(magnitude < $min_rounded ? 0.0 : MIN_NORMAL, a);
    }
    if (!(magnitude < $overflow)) {
        return a + copysign(INFINITY, a);
    }
    const $word word = word_of(a);
    const $word half = (UINT64_C(1) << (shift - 1u)) - 1u + (word >> shift & 1u);

    return number_of((word + half) >> shift << shift);
}
""",
    "input": """\
static inline $holder input($type a)
{
    return rounded(a);
}
""",
}

# Double rounds sums and products of these harmlessly.
_NARROW = {
    "add": """\
static inline $holder add($holder a, $holder b)
{
    return rounded(a + b);
}
""",
    "multiply": """\
static inline $holder multiply($holder a, $holder b)
{
    return rounded(a * b);
}
""",
}

_WIDE = {
    "add": """\
/* What the sum loses makes its last bit one; so it is rounded once. */
static $holder add($holder a, $holder b)
{
    const $holder sum = a + b;
    const $holder part = sum - a;
    const $holder lost = (a - (sum - part)) + (b - part);

    if (!(fabs(sum) < INFINITY) || lost == 0.0) {
        return rounded(sum);
    }
    const $word word = word_of(sum);

    return rounded(number_of(((lost > 0.0) == (sum > 0.0) ? word : word - 1u) | 1u));
}
""",
    "multiply": """\
/* The sum of two exact products. */
static $holder multiply($holder a, $holder b)
{
    const $holder product = a * b;
    const $holder high = (float)a;

    if (product == 0.0 || !(fabs(product) < INFINITY)) {
        return product;
    }
    return add(high * b, (a - high) * b);
}
""",
}

_OUTPUT = {
    "output": """\
/* There is one NaN. */
static inline $type output($holder a)
{
    return a == a ? $cast : NAN;
}
""",
}

_SIGNED_ROOT = {
    "signed_reciprocal_sqrt": """\
/* 1/sqrt(abs(a)) with the sign of a; NaN if its square could not be the reciprocal. */
static $holder signed_reciprocal_sqrt($holder a)
{
    const $holder size = fabs$f(a);

    if (size == 0.0$f) {
        return copysign$f(INFINITY, a);
    }
    if (a != a || (size >= $large && size < INFINITY)) {
        return NAN;
    }
    return copysign$f(reciprocal_sqrt(size), a);
}
""",
}


def _root(fmt: FloatFormat) -> str:
    """Write the unit 1/sqrt, whose widths are those of :class:`ReciprocalSqrtParams`."""
    p = ReciprocalSqrtParams(fmt=fmt)
    columns = 3 if p.degree == 2 else 2
    rows = [f"{{{', '.join(map(str, row[:columns]))}}}" for row in p.table]
    table = "\n".join(
        f"    {', '.join(rows[start : start + 4])}," for start in range(0, len(rows), 4)
    )
    distance_bits = p.distance_bits
    scale_bits = p.slope_fraction_bits + p.distance_fraction_bits
    slope = "row[1]"
    if p.degree == 2:
        fine_bits = p.c2_fraction_bits + p.distance_fraction_bits
        slope = (
            f"(row[1] * {_power_of_2(fine_bits - p.c1_fraction_bits)} + distance * row[2]) "
            f">> {fine_bits - p.slope_fraction_bits}"
        )
    newton = "\n"
    if p.newton:
        drop = p.root_fraction_bits - 6
        minuend_bits = p.product_fraction_bits + p.root_fraction_bits
        last = minuend_bits + 1 - p.fmt.precision
        # The high bits of minuend and subtrahend overflow alike, and are left out.
        minuend = f"(UINT64_C(1) << {minuend_bits})" if minuend_bits < 64 else "0u"
        newton = f"""
    /* r * y in two pieces; then y + y * (1 - r * y * y) / 2. */
    const int64_t radicand = (INT64_C(1) << FRACTION_BITS | fraction) << odd;
    const int64_t product =
        (radicand >> {drop}) * root + ((radicand & {(1 << drop) - 1}) * root >> {drop});
    const int64_t residual =
        (int64_t)({minuend} - (uint64_t)product * (uint64_t)root) >> {p.root_fraction_bits};

    root = root * {_power_of_2(p.fmt.precision - p.root_fraction_bits)} +
           ((root * residual + {_power_of_2(last - 1)}) >> {last});

"""
    return f"""\
/* Polynomials of 1/sqrt(r) with 1 <= r < 4, by parity of the exponent and leading bits. */
static const int32_t polynomials[][{columns}] = {{
{table}
}};

_Static_assert(-1 >> 1 == -1, "shifts of negative numbers must be floors");

static $holder reciprocal_sqrt($holder a)
{{
    if (a == 0.0$f || a == INFINITY) {{
        return 0.0$f;
    }}
    if (!(a > 0.0$f)) {{
        return NAN;
    }}
    const $word word = word_of(a);
    const int32_t e = (int32_t)(word >> HOLDER_FRACTION_BITS) - HOLDER_BIAS;
    const int64_t fraction = (int64_t)((word & ((($word)1 << HOLDER_FRACTION_BITS) - 1u)) >>
                                       (HOLDER_FRACTION_BITS - FRACTION_BITS));
    const int32_t odd = e & 1;
    const int32_t *row = polynomials[odd << {p.index_bits} | (int32_t)(fraction >> \
{fmt.fraction_bits - p.index_bits})];
    const int64_t distance = (fraction >> {fmt.fraction_bits - p.distance_fraction_bits} & \
{(1 << distance_bits) - 1}) - {1 << (distance_bits - 1)};
    const int64_t slope = {slope};
    int64_t root = (row[0] * {_power_of_2(scale_bits - p.c0_fraction_bits)} + distance * slope) \
>> {scale_bits - p.root_fraction_bits};
{newton}    /* It is one for r = 1, and less for any other. */
    const int32_t one = (int32_t)(root >> (FRACTION_BITS + 1));
    const $word field = ($word)(HOLDER_BIAS - 1 - ((e - odd) >> 1) + one);

    return number_of(field << HOLDER_FRACTION_BITS |
                     ($word)(root & ((INT64_C(1) << FRACTION_BITS) - 1))
                         << (HOLDER_FRACTION_BITS - FRACTION_BITS));
}}
"""


def _power_of_2(exponent: int) -> str:
    return f"INT64_C({1 << exponent})"


def helpers(fmt: FloatFormat, text: str) -> str:
    """Write what comes before functions: declarations, and the helpers that they call.

    Parameters
    ----------
    fmt
        Number format.
    text
        The functions.

    Raises
    ------
    ValueError
        If C cannot compute in the format, or a function reads powers or exponents in a format
        without integers that stand for them.
    """
    check_format(fmt)
    holder = _holder(fmt)
    if holder == fmt:
        arithmetic = _OF_THE_PROCESSOR
    else:
        arithmetic = _ROUNDED | (_NARROW if fmt.fraction_bits <= _NARROW_FRACTION_BITS else _WIDE)
    known = _COMMON | arithmetic | _OUTPUT | _READINGS
    known |= {"reciprocal_sqrt": _root(fmt)} | _SIGNED_ROOT
    needed = _needed(known, text)
    middle = 1.5 * 2.0**fmt.fraction_bits
    if fmt.fraction_bits > fmt.bias and not needed.isdisjoint(_READINGS):
        raise ValueError(f"format must have integers up to {middle:g}, not {fmt.name!r}")
    f, step = suffix(fmt), exponent_step(fmt)

    def exact(value: float) -> str:
        return re.sub(r"\.?0*p", "p", value.hex()) + f

    values = {
        "name": fmt.name,
        "holder": "float" if f else "double",
        "type": number_type(fmt),
        "cast": "a" if f or number_type(fmt) == "double" else "(float)a",
        "word": "uint32_t" if f else "uint64_t",
        "f": f,
        "fraction_bits": fmt.fraction_bits,
        "bias": fmt.bias,
        "min_normal": exact(fmt.min_normal),
        "holder_fraction_bits": holder.fraction_bits,
        "holder_bias": holder.bias,
        "middle": f"{middle}{f}",
        "low": f"{2.0**fmt.fraction_bits}{f}",
        "high": f"{2.0 ** (fmt.fraction_bits + 1)}{f}",
        # Division of what is positive rounds down.
        "integer": "e - 1" if step == 1 else f"(e + 2047) / {step} - {2048 // step}",
        "scale": exact(2.0 ** (fmt.precision + 1)),
        "min_rounded": exact(fmt.min_normal * (1.0 - fmt.epsilon / 4)),
        "overflow": exact(fmt.max_finite + 2.0 ** (fmt.bias - fmt.fraction_bits - 1)),
        "large": exact(2.0 ** (fmt.bias - 1)),
    }
    parts = [_HEAD, *(known[name] for name in known if name in needed)]
    return Template("\n".join(parts)).substitute(values)


def _needed(known: dict[str, str], text: str) -> set[str]:
    """Give the helpers that a text calls, and those that they call, which stand before them."""
    needed: set[str] = set()
    for name in reversed(known):
        if re.search(rf"\b{name}\(", text):
            needed.add(name)
            text += known[name]
    return needed
