"""Golden arithmetic against gmpy2 and NumPy, which share no code with it."""

import gmpy2
import numpy as np
import pytest
from numba import njit

from ukf_sw.engine import arithmetic
from ukf_sw.engine.arithmetic import (
    add_scalar,
    decode_binary32,
    decode_scalar,
    encode_scalar,
    is_binary32,
    multiply_scalar,
    reciprocal_sqrt_scalar,
    reciprocal_sqrt_table,
    round_binary32,
    scalar_parameters,
)
from ukf_sw.spec.float_format import BINARY32, BINARY64, FORMATS, FloatFormat

COUNT = 6000
ALL_FORMATS = [
    *FORMATS.values(),
    *(
        FloatFormat(exponent_bits=exponent_bits, fraction_bits=fraction_bits)
        for exponent_bits, fraction_bits in [
            (4, 5), (4, 52), (5, 23), (8, 24), (8, 25), (8, 40), (8, 52), (11, 5), (11, 23),
            (11, 24), (11, 25), (11, 50), (11, 51), (10, 51), (9, 23),
        ]
    ),
]  # fmt: skip
WIDE = gmpy2.context(precision=300, emin=-(1 << 20), emax=1 << 20)


def oracle(fmt, operator, first, second):
    """Exact results, rounded once with an unbounded exponent, then flushed or made infinite."""
    context = gmpy2.context(precision=fmt.precision, emin=-(1 << 20), emax=1 << 20)
    function = {"add": context.add, "multiply": context.mul}[operator]
    results = []
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        exact = function(gmpy2.mpfr(a, 53), gmpy2.mpfr(b, 53))
        if gmpy2.is_nan(exact):
            results.append(np.nan)
            continue
        sign = -1.0 if gmpy2.is_signed(exact) else 1.0
        if abs(exact) < fmt.min_normal:
            results.append(sign * 0.0)
        elif abs(exact) > fmt.max_finite:
            results.append(sign * np.inf)
        else:
            results.append(float(exact))
    return np.array(results)


def hostile_operands(fmt, rng, count):
    """Specials, all pairs of them first; then numbers chosen for their sum or product."""
    low, high, step = fmt.min_normal, fmt.max_finite, fmt.epsilon
    positive = [
        0.0, 1.0, 1.0 + step, 2.0 - step, low, low * (1 + step), low * (2 - step), high,
        high / 2, high * (1 - step), np.inf,
    ]  # fmt: skip
    specials = fmt.round([*positive, *(-value for value in positive), np.nan])
    pairs = np.array([(a, b) for a in specials for b in specials])

    emin, emax = 1 - fmt.bias, fmt.bias
    fraction_steps = rng.integers(0, 2**fmt.fraction_bits, (2, count))
    # Short fractions make ties, runs of ones make carries.
    kind = rng.integers(0, 4, (2, count))
    mask = 2**fmt.fraction_bits - 1
    cut = rng.integers(0, fmt.fraction_bits, (2, count))
    fraction_steps = np.choose(
        kind, [fraction_steps, fraction_steps, mask ^ (mask >> cut), np.int64(1) << cut]
    )
    significand = 1.0 + fraction_steps * step
    exponent = rng.integers(emin, emax + 1, (2, count))
    partner = rng.integers(0, 6, count)
    exponent[1] = np.choose(
        partner,
        [
            exponent[1],
            exponent[0] + rng.integers(-fmt.precision - 2, fmt.precision + 3, count),
            exponent[0] + rng.integers(-1, 2, count),
            emin - exponent[0] + rng.integers(-2, 2, count),  # product near the smallest
            emax - exponent[0] + rng.integers(-1, 2, count),  # product near the largest
            np.minimum(emin + rng.integers(0, 4, count), emax),
        ],
    )
    low_sum = rng.random(count) < 0.1
    exponent[0] = np.where(low_sum, emin + rng.integers(0, 3, count), exponent[0])
    exponent = np.clip(exponent, emin, emax)
    values = np.ldexp(significand, exponent) * rng.choice([-1.0, 1.0], (2, count))
    # Neighbours, which nearly cancel.
    close = rng.random(count) < 0.1
    neighbour = -values[0] * (1 + rng.integers(-2, 3, count) * step)
    values[1] = np.where(close, neighbour, values[1])
    values = fmt.round(np.clip(values, -high, high))
    return np.concatenate([pairs.T, values], axis=1)


def assert_same(actual, expected, *operands):
    """Equal bit by bit, except that any NaN is as good as any other."""
    same = (np.isnan(actual) & np.isnan(expected)) | (
        (actual == expected) & (np.signbit(actual) == np.signbit(expected))
    )
    wrong = np.flatnonzero(~same)
    assert wrong.size == 0, [
        tuple(float(values[i]).hex() for values in (*operands, actual, expected)) for i in wrong[:3]
    ]


@pytest.mark.parametrize("fmt", ALL_FORMATS, ids=lambda fmt: fmt.name)
@pytest.mark.parametrize("operator", ["add", "multiply"])
def test_agrees_with_gmpy2(operator, fmt):
    a, b = hostile_operands(fmt, np.random.default_rng(11), COUNT)
    actual = getattr(arithmetic, operator)(fmt, a, b)
    assert_same(actual, oracle(fmt, operator, a, b), a, b)
    assert_same(actual, fmt.decode(fmt.encode(actual)))  # representable
    for special in (0.0, np.inf, fmt.min_normal):
        assert np.count_nonzero(actual == special) > 3
    assert np.count_nonzero(np.isnan(actual)) > 3


@pytest.mark.parametrize("operator", ["add", "multiply"])
def test_binary32_agrees_with_numpy(operator):
    rng = np.random.default_rng(5)
    a, b = hostile_operands(BINARY32, rng, 200_000)
    with np.errstate(all="ignore"):
        expected = getattr(np, operator)(a.astype(np.float32), b.astype(np.float32))
        exact = getattr(np, operator)(a, b)
    expected = expected.astype(np.float64)
    expected[np.abs(exact) < 2.0**-126 - 2.0**-151] *= 0
    assert_same(getattr(arithmetic, operator)(BINARY32, a, b), expected, a, b)


@pytest.mark.parametrize("fmt", ALL_FORMATS, ids=lambda fmt: fmt.name)
def test_flush_is_after_rounding(fmt):
    """The largest product below the smallest normal number rounds up to it, or does not."""
    below_two = 2.0 - fmt.epsilon
    # (1 - step/2) * (1 + step) is 1 + step/2 - step**2/2, which rounds to 1.
    above = arithmetic.multiply(fmt, below_two / 2, fmt.min_normal * (1 + fmt.epsilon))
    assert above == fmt.min_normal
    assert arithmetic.multiply(fmt, below_two / 2, fmt.min_normal) == 0.0
    assert np.signbit(arithmetic.multiply(fmt, -below_two / 2, fmt.min_normal))
    # (1 - t) * (1 + t) = 1 - t**2, which rounds up to 1 or not.
    for bits in range(1, fmt.fraction_bits):
        a, b = 1.0 - 2.0**-bits, fmt.min_normal * (1.0 + 2.0**-bits)
        expected = fmt.min_normal if 2 * bits > fmt.precision else 0.0
        assert arithmetic.multiply(fmt, a, b) == expected


def test_signed_zeros():
    for fmt in FORMATS.values():
        assert not np.signbit(arithmetic.add(fmt, 1.5, -1.5))
        assert np.signbit(arithmetic.add(fmt, -0.0, -0.0))
        assert not np.signbit(arithmetic.add(fmt, -0.0, 0.0))
        assert np.signbit(arithmetic.multiply(fmt, -0.0, 3.0))
        assert not np.signbit(arithmetic.reciprocal_sqrt(fmt, -0.0))


@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_subnormal_operands_read_as_zeros(fmt):
    tiny = fmt.min_normal / 2
    assert arithmetic.add(fmt, tiny, tiny) == 0
    assert arithmetic.multiply(fmt, tiny, fmt.max_finite) == 0
    assert np.isnan(arithmetic.multiply(fmt, -tiny, np.inf))
    assert arithmetic.reciprocal_sqrt(fmt, -tiny) == 0


def test_operands_broadcast():
    total = arithmetic.add(BINARY32, [[1.0], [2.0]], [10.0, 20.0, 30.0])
    assert total.tolist() == [[11.0, 21.0, 31.0], [12.0, 22.0, 32.0]]
    assert arithmetic.add(BINARY64, 1.0, 2.0).shape == ()


@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_a_product_and_a_sum_at_once(fmt):
    """Rounded twice; what has one number is the same for all."""
    a, b = hostile_operands(fmt, np.random.default_rng(4), 1000)
    c = np.roll(b, 7)
    for operands in ((c, a, b), (c[5:6], a, b), (c, a[9:10], b), (c, a, b[3:4])):
        found = arithmetic.multiply_add(fmt, *operands)
        expected = arithmetic.add(fmt, operands[0], arithmetic.multiply(fmt, *operands[1:]))
        assert found.shape == expected.shape
        assert np.where(np.isnan(found), np.nan, found).tobytes() == (
            np.where(np.isnan(expected), np.nan, expected).tobytes()
        )


def test_lengths_fit():
    with pytest.raises(ValueError, match="shape mismatch"):
        arithmetic.multiply_add(BINARY32, np.ones(2), np.ones(3), np.ones(1))


@pytest.mark.parametrize("fmt", ALL_FORMATS, ids=lambda fmt: fmt.name)
def test_kernels_work_in_compiled_code(fmt):
    @njit
    def kernel(a, b, parameters, table):
        product = multiply_scalar(a, b, parameters)
        return add_scalar(product, reciprocal_sqrt_scalar(b, parameters, table), parameters)

    actual = kernel(1.5, 4.0, scalar_parameters(fmt), reciprocal_sqrt_table(fmt))
    assert actual == 6.5


@njit
def _alone(words, first, second):
    """Numbers of words, and sums and products of numbers, by the kernels for binary32 alone."""
    decoded = np.array([decode_binary32(word) for word in words])
    sums = np.array([round_binary32(first[k] + second[k]) for k in range(len(first))])
    products = np.array([round_binary32(first[k] * second[k]) for k in range(len(first))])
    return decoded, sums, products


def test_kernels_for_binary32_alone_do_what_the_others_do():
    rng = np.random.default_rng(11)
    edges = [
        0, 1, 0x007F_FFFF, 0x0080_0000, 0x0080_0001, 0x3F80_0000, 0x7F7F_FFFF, 0x7F80_0000,
        0x7F80_0001, 0x7FC0_0000, 0x7FFF_FFFF,
    ]  # fmt: skip
    words = np.array([*edges, *(edge | 1 << 31 for edge in edges)], dtype=np.int64)
    words = np.concatenate([words, rng.integers(0, 1 << 32, COUNT)])
    first, second = hostile_operands(BINARY32, rng, COUNT)
    found = _alone(words, first, second)
    expected = (
        BINARY32.decode(words.astype(np.uint64)),
        arithmetic.add(BINARY32, first, second),
        arithmetic.multiply(BINARY32, first, second),
    )
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(np.signbit(one[one == 0]), np.signbit(other[other == 0]))
    # Just below the smallest normal number, and rounded up to it.
    low, step = BINARY32.min_normal, BINARY32.epsilon
    assert _alone(words[:1], np.array([low * (1 + step)]), np.array([1 - step]))[2] == [low]
    assert is_binary32(scalar_parameters(BINARY32))
    assert not any(is_binary32(scalar_parameters(fmt)) for fmt in ALL_FORMATS if fmt != BINARY32)


@njit
def _decode_all(words, parameters):
    return np.array([decode_scalar(word, parameters) for word in words])


@njit
def _encode_all(values, parameters):
    return np.array([encode_scalar(value, parameters) for value in values])


@pytest.mark.parametrize("fmt", ALL_FORMATS, ids=lambda fmt: fmt.name)
def test_words_in_compiled_code(fmt):
    """Every word of the short formats; else extreme ones and random ones."""
    if fmt.width <= 16:
        words = np.arange(1 << fmt.width, dtype=np.uint64)
    else:
        rng = np.random.default_rng(fmt.width)
        words = rng.integers(0, 1 << 64, 20_000, dtype=np.uint64) >> np.uint64(64 - fmt.width)
        least_normal = 1 << fmt.fraction_bits
        ends = np.array(
            [0, 1, least_normal - 1, least_normal, fmt.infinity - 1, fmt.infinity,
             fmt.infinity | 1, fmt.nan, fmt.nan | 5], dtype=np.uint64,
        )  # fmt: skip
        words = np.concatenate((words, ends, ends | np.uint64(1 << (fmt.width - 1))))
    parameters = scalar_parameters(fmt)
    numbers = _decode_all(words.view(np.int64), parameters)
    expected = fmt.decode(words)
    np.testing.assert_array_equal(numbers, expected)
    regular = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(numbers)[regular], np.signbit(expected)[regular])
    # Back again: the one NaN, zeros for subnormal numbers.
    again = _encode_all(numbers, parameters).view(np.uint64)
    np.testing.assert_array_equal(again, fmt.encode(expected))
