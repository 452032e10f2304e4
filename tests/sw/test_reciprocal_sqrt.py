"""Golden reciprocal square root against gmpy2."""

import gmpy2
import numpy as np
import pytest

from ukf_sw.engine import arithmetic
from ukf_sw.engine.reciprocal_sqrt import ReciprocalSqrtParams
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FORMATS, FloatFormat

EVERY_FRACTION = [
    FloatFormat(exponent_bits=exponent_bits, fraction_bits=fraction_bits)
    for exponent_bits, fraction_bits in zip([4, 8, 11] * 16, range(5, 53), strict=True)
]
CONTEXT = gmpy2.context(precision=200)


def is_faithful(fmt, word, root_word):
    """Whether a root is one of the two neighbours of the exact one, or equal to it."""
    value = gmpy2.mpfr(float(fmt.decode(word)), 53)
    exact = CONTEXT.rec_sqrt(value)
    low = float(fmt.decode(root_word - 1))
    high = float(fmt.decode(root_word + 1))
    root = float(fmt.decode(root_word))
    if root == exact:
        return True
    return (low < exact < root) or (root < exact < high)


def sample(fmt, rng, count):
    """Positive normal words: the ends of the table's intervals, both parities, random ones."""
    index_bits = ReciprocalSqrtParams(fmt=fmt).index_bits
    interval = rng.integers(0, 1 << index_bits, count)
    low_bits = fmt.fraction_bits - index_bits
    last = (1 << low_bits) - 1
    low = rng.integers(0, last, count, endpoint=True)
    low = np.choose(rng.integers(0, 6, count), [low, low, low, low * 0, low * 0 + last, last // 2])
    exponent = rng.integers(1, fmt.max_exponent_field, count)
    fraction = (interval << low_bits) | low
    words = (exponent.astype(np.uint64) << np.uint64(fmt.fraction_bits)) | fraction.astype(
        np.uint64
    )
    return words.tolist()


@pytest.mark.parametrize("fmt", [BINARY16, BFLOAT16], ids=lambda fmt: fmt.name)
def test_all_words(fmt):
    params = ReciprocalSqrtParams(fmt=fmt)
    words = list(range(1 << fmt.width))
    roots = [params.compute(word) for word in words]
    for word in range(1 << fmt.fraction_bits, fmt.infinity):
        assert is_faithful(fmt, word, roots[word]), hex(word)
    compiled = fmt.encode(arithmetic.reciprocal_sqrt(fmt, fmt.decode(words)))
    assert compiled.tolist() == roots


@pytest.mark.parametrize("fmt", EVERY_FRACTION, ids=lambda fmt: fmt.name)
def test_faithful(fmt):
    params = ReciprocalSqrtParams(fmt=fmt)
    words = sample(fmt, np.random.default_rng(1), 1000)
    roots = [params.compute(word) for word in words]
    assert all(is_faithful(fmt, word, root) for word, root in zip(words, roots, strict=True))
    compiled = fmt.encode(arithmetic.reciprocal_sqrt(fmt, fmt.decode(words)))
    assert compiled.tolist() == roots


@pytest.mark.parametrize(
    "fmt",
    [BINARY32, pytest.param(BINARY64, marks=pytest.mark.slow)],
    ids=lambda fmt: fmt.name,
)
def test_faithful_long(fmt):
    words = sample(fmt, np.random.default_rng(2), 50_000)
    roots = fmt.encode(arithmetic.reciprocal_sqrt(fmt, fmt.decode(words))).tolist()
    assert all(is_faithful(fmt, word, root) for word, root in zip(words, roots, strict=True))


@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_powers_of_four_are_exact(fmt):
    for exponent in range(-((fmt.bias - 1) // 2), fmt.bias // 2 + 1):
        assert arithmetic.reciprocal_sqrt(fmt, 4.0**exponent) == 2.0**-exponent


@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_special_operands(fmt):
    params = ReciprocalSqrtParams(fmt=fmt)
    minus = 1 << (fmt.width - 1)
    smallest = 1 << fmt.fraction_bits
    for word in (0, minus, 1, smallest - 1, minus | 1, minus | (smallest - 1), fmt.infinity):
        assert params.compute(word) == 0
    for word in (
        minus | smallest,
        minus | fmt.infinity,
        fmt.nan,
        fmt.infinity + 1,
        minus | fmt.nan,
    ):
        assert params.compute(word) == fmt.nan
    values = np.array([0.0, -0.0, np.inf, -1.0, -np.inf, np.nan])
    roots = arithmetic.reciprocal_sqrt(fmt, values)
    assert fmt.encode(roots).tolist() == [0, 0, 0, fmt.nan, fmt.nan, fmt.nan]


def test_table_of_binary32_is_small():
    """The unit counts on a depth of one block RAM, and on factors of one DSP48E1."""
    params = ReciprocalSqrtParams(fmt=BINARY32)
    assert len(params.table) == 256
    assert params.slope_fraction_bits + 1 <= 25
    assert params.distance_bits <= 18


def test_wrong_format_is_rejected():
    with pytest.raises(TypeError, match=r"^Format must be a FloatFormat, not 32$"):
        ReciprocalSqrtParams(fmt=32)
