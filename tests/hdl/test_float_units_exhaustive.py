"""Generated Verilog of the floating-point units against independent oracles, by the million."""

import gmpy2
import numpy as np
import pytest

from support.unit_harness import UnitHarness
from ukf_hdl.arithmetic.float_adder import FloatAdder
from ukf_hdl.arithmetic.float_multiplier import FloatMultiplier
from ukf_hdl.arithmetic.reciprocal_sqrt import ReciprocalSqrt
from ukf_sw.engine import arithmetic
from ukf_sw.spec.float_format import BINARY32, FORMATS, FloatFormat

pytestmark = pytest.mark.slow

PAIRS = 1_100_000
ALL_FORMATS = {"smallest": FloatFormat(exponent_bits=4, fraction_bits=5), **FORMATS}
UNITS = {
    "add": (FloatAdder, "sum", arithmetic.add),
    "multiply": (FloatMultiplier, "product", arithmetic.multiply),
}


def assemble(fmt, sign, exponent, fraction):
    exponent = np.clip(exponent, 0, fmt.max_exponent_field).astype(np.uint64)
    fraction = fraction.astype(np.uint64) & np.uint64((1 << fmt.fraction_bits) - 1)
    word = sign.astype(np.uint64) << np.uint64(fmt.width - 1)
    return word | (exponent << np.uint64(fmt.fraction_bits)) | fraction


def hostile_pairs(fmt, rng, count):
    """Pairs that concentrate on what can go wrong."""
    ones, bits, bias = fmt.max_exponent_field, fmt.fraction_bits, fmt.bias
    mask = (1 << bits) - 1

    def fractions():
        # Random, a run of ones or of zeros at either end, or one of few bits.
        plain = rng.integers(0, mask, count, endpoint=True)
        cut = rng.integers(0, bits, count, endpoint=True)
        runs = np.int64(mask) >> cut
        single = np.int64(1) << np.minimum(cut, bits - 1)
        kind = rng.integers(0, 8, count)
        choices = [plain, plain, plain, runs, mask ^ runs, single, single | 1, mask * (cut & 1)]
        return np.choose(kind, choices)

    limits = np.array([0, 1, 2, ones - 2, ones - 1, ones])
    exponent_a = rng.integers(0, ones, count, endpoint=True)
    exponent_a = np.where(rng.random(count) < 0.1, rng.choice(limits, count), exponent_a)
    near = exponent_a + rng.integers(-bits - 4, bits + 5, count)
    close = exponent_a + rng.integers(-2, 3, count)
    # Products around the smallest normal number and around overflow.
    small = bias - exponent_a + rng.integers(-1, 3, count)
    large = 3 * bias - exponent_a + rng.integers(-1, 3, count)
    free = rng.integers(0, ones, count, endpoint=True)
    exponent_b = np.choose(
        rng.integers(0, 8, count),
        [near, near, close, small, large, free, rng.choice(limits, count), close],
    )
    fraction_a, fraction_b = fractions(), fractions()
    neighbour = rng.random(count) < 0.15
    fraction_b = np.where(neighbour, fraction_a + rng.integers(-3, 4, count), fraction_b)
    sign_a, sign_b = rng.integers(0, 2, (2, count))
    first = assemble(fmt, sign_a, exponent_a, fraction_a)
    second = assemble(fmt, sign_b, exponent_b, fraction_b)
    return first, second


def oracle_binary32(operator, first, second):
    """Sums or products by NumPy's float32, which rounds into subnormal numbers."""
    values = []
    for words in (first, second):
        value = words.astype(np.uint32).view(np.float32)
        tiny = np.abs(value) < np.float32(2.0**-126)
        values.append(np.where(tiny, np.copysign(np.float32(0), value), value))
    with np.errstate(all="ignore"):
        result = getattr(np, operator)(*values)
        # Exact in double precision, so this decides whether the rounded result is normal.
        exact = getattr(np, operator)(*(value.astype(np.float64) for value in values))
    tiny = np.abs(exact) < 2.0**-126 - 2.0**-151
    result = np.where(tiny, np.copysign(np.float32(0), result), result)
    return np.where(np.isnan(result), 0x7FC00000, result.view(np.uint32)).astype(np.uint64)


def oracle_gmpy2(fmt, operator, first, second):
    """Sums or products by gmpy2, rounded with an unbounded exponent and then flushed."""
    context = gmpy2.context(precision=fmt.precision, emin=-(1 << 20), emax=1 << 20)
    function = getattr(context, {"add": "add", "multiply": "mul"}[operator])
    ones, bits, bias = fmt.max_exponent_field, fmt.fraction_bits, fmt.bias
    fraction_mask, top = (1 << bits) - 1, fmt.width - 1
    smallest = gmpy2.mpfr(2) ** (1 - bias)
    scale, hidden = gmpy2.mpfr(2) ** (-bits), 1 << bits
    powers = [gmpy2.mpfr(2) ** (exponent - bias) for exponent in range(ones + 1)]
    wide = gmpy2.context(precision=60, emin=-(1 << 20), emax=1 << 20)

    def value(word):
        exponent, fraction = (word >> bits) & ones, word & fraction_mask
        if exponent == 0:
            magnitude = gmpy2.mpfr(0)
        elif exponent == ones:
            magnitude = gmpy2.nan() if fraction else gmpy2.inf()
        else:
            magnitude = wide.mul(
                wide.mul(gmpy2.mpfr(hidden | fraction, 60), scale), powers[exponent]
            )
        return wide.minus(magnitude) if word >> top else magnitude

    def word(number):
        if gmpy2.is_nan(number):
            return (ones << bits) | 1 << (bits - 1)
        sign = int(gmpy2.is_signed(number)) << top
        if gmpy2.is_zero(number) or abs(number) < smallest:
            return sign
        if gmpy2.is_infinite(number):
            return sign | ones << bits
        mantissa, exponent = (int(part) for part in number.as_mantissa_exp())
        mantissa = abs(mantissa)
        exponent += mantissa.bit_length() - 1
        if exponent > bias:
            return sign | ones << bits
        mantissa <<= bits + 1 - mantissa.bit_length()
        return sign | (exponent + bias) << bits | (mantissa & fraction_mask)

    return np.array(
        [
            word(function(value(a), value(b)))
            for a, b in zip(first.tolist(), second.tolist(), strict=True)
        ],
        dtype=np.uint64,
    )


@pytest.mark.parametrize("name", ALL_FORMATS)
@pytest.mark.parametrize(("operator", "stages"), [("add", 2), ("add", 3), ("multiply", 2)])
def test_hostile_pairs(operator, stages, name, tmp_path):
    fmt = ALL_FORMATS[name]
    unit_class, output, model = UNITS[operator]
    first, second = hostile_pairs(fmt, np.random.default_rng(7), PAIRS)
    harness = UnitHarness(unit_class(fmt, stages=stages), ["a", "b"], output, tmp_path)
    received = harness.run(first, second)

    if fmt == BINARY32:
        expected = oracle_binary32(operator, first, second)
    else:
        expected = oracle_gmpy2(fmt, operator, first, second)
    wrong = np.flatnonzero(received != expected)
    assert wrong.size == 0, [f"{w[i]:#x}" for i in wrong[:4] for w in (first, second, received)]
    golden = fmt.encode(model(fmt, fmt.decode(first), fmt.decode(second)))
    assert np.array_equal(received, golden)
    assert received.size == PAIRS
    # Zeros, infinities, NaN and the smallest normal number are all among the results.
    for word in (0, 1 << (fmt.width - 1), fmt.infinity, fmt.nan, 1 << fmt.fraction_bits):
        assert np.count_nonzero(received == np.uint64(word)) > 50


def is_faithful(fmt, words, roots):
    """Whether roots are within one unit in the last place, in exact integers.

    For words with an exponent field such that the root is below one, that is, for operands from one
    (excluded) to four. Products of 24 and 2 * 24 bits need more than 64: they are split.
    """
    bits = fmt.fraction_bits
    hidden = np.uint64(1 << bits)
    mask = hidden - np.uint64(1)
    odd = (words >> np.uint64(bits)) - np.uint64(fmt.bias)
    radicand = ((words & mask) | hidden) << odd  # r * 2**bits
    root = (roots & mask) | hidden  # y * 2**(bits + 1)

    def compare(y):
        """Sign of y * y * r - 1."""
        square = y * y
        low = (square & np.uint64((1 << 32) - 1)) * radicand
        high = (square >> np.uint64(32)) * radicand + (low >> np.uint64(32))
        low &= np.uint64((1 << 32) - 1)
        one = np.uint64(1 << (3 * bits + 2 - 32))
        return np.where(high >= one, np.where((high > one) | (low > 0), 1, 0), -1)

    one = np.uint64(1)
    return (compare(root - one) < 0) & (compare(root + one) > 0)


@pytest.mark.parametrize("stages", [1, 2, ReciprocalSqrt.DEFAULT_STAGES])
def test_reciprocal_sqrt_of_all_significands(stages, tmp_path):
    fmt = BINARY32
    start = fmt.bias << fmt.fraction_bits
    words = np.arange(start, start + (2 << fmt.fraction_bits), dtype=np.uint64)
    harness = UnitHarness(ReciprocalSqrt(fmt, stages=stages), ["a"], "root", tmp_path)
    received = harness.run(words)

    assert received.size == 1 << 24
    assert received[0] == start  # 1/sqrt(1) is exact
    below_one = received[1:] >> np.uint64(fmt.fraction_bits) == np.uint64(fmt.bias - 1)
    assert below_one.all()
    assert is_faithful(fmt, words[1:], received[1:]).all()
    golden = fmt.encode(arithmetic.reciprocal_sqrt(fmt, fmt.decode(words)))
    assert np.array_equal(received, golden)


@pytest.mark.parametrize("name", ["binary16", "bfloat16", "binary64"])
def test_reciprocal_sqrt_of_other_formats(name, tmp_path):
    """All words of a short format; the golden model itself is checked in `tests/sw`."""
    fmt = FORMATS[name]
    if fmt.width <= 16:
        words = np.arange(1 << fmt.width, dtype=np.uint64)
    else:
        words, _ = hostile_pairs(fmt, np.random.default_rng(3), PAIRS)
    harness = UnitHarness(ReciprocalSqrt(fmt), ["a"], "root", tmp_path)
    received = harness.run(words)
    golden = fmt.encode(arithmetic.reciprocal_sqrt(fmt, fmt.decode(words)))
    assert np.array_equal(received, golden)


def test_every_exponent_of_binary32(tmp_path):
    """The exponent path: every exponent and sign with a few fractions."""
    fmt = BINARY32
    fractions = np.array([0, 1, 0x2AAAAA, 0x400000, 0x7FFFFF], dtype=np.uint64)
    heads = np.arange(1 << 9, dtype=np.uint64) << np.uint64(23)
    words = (heads[:, None] | fractions).ravel()
    harness = UnitHarness(ReciprocalSqrt(fmt), ["a"], "root", tmp_path)
    received = harness.run(words)
    value = fmt.decode(words)
    with np.errstate(all="ignore"):
        expected = 1 / np.sqrt(value)
    expected[value == 0] = 0
    got = fmt.decode(received)
    assert np.array_equal(np.isnan(got), np.isnan(expected))
    ok = np.isnan(got) | (np.abs(got - expected) <= np.abs(expected) * 2.0**-23)
    assert ok.all()


def test_wrong_words_are_rejected(tmp_path):
    harness = UnitHarness(FloatAdder(BINARY32), ["a", "b"], "sum", tmp_path)
    with pytest.raises(ValueError, match=r"^Words must be 2 arrays of one length, not of shapes"):
        harness.run([1, 2], [3])
    with pytest.raises(ValueError, match=r"^Words must not be empty, not "):
        harness.run([], [])
