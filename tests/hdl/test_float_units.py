"""Floating-point units against the golden arithmetic."""

import numpy as np
import pytest
from amaranth.sim import Simulator

from ukf_hdl.arithmetic.float_adder import FloatAdder
from ukf_hdl.arithmetic.float_multiplier import FloatMultiplier
from ukf_hdl.arithmetic.reciprocal_sqrt import ReciprocalSqrt
from ukf_sw.elementary.primitives import evaluate_root
from ukf_sw.engine import arithmetic
from ukf_sw.engine.reciprocal_sqrt import ReciprocalSqrtParams
from ukf_sw.spec.float_format import BINARY32, FORMATS, FloatFormat
from ukf_sw.spec.forms import Root

SMALLEST = FloatFormat(exponent_bits=4, fraction_bits=5)
ALL_FORMATS = {"smallest": SMALLEST, **FORMATS}
UNITS = {
    FloatAdder: (arithmetic.add, "sum"),
    FloatMultiplier: (arithmetic.multiply, "product"),
    ReciprocalSqrt: (arithmetic.reciprocal_sqrt, "root"),
}
VECTORS = 400


def hostile_words(fmt, rng, count):
    """Random words, among them specials and numbers next to a limit of the format."""
    fraction_mask = (1 << fmt.fraction_bits) - 1
    ones = fmt.max_exponent_field
    exponents = [0, 1, 2, 3, fmt.bias - 1, fmt.bias, fmt.bias + 1, ones - 2, ones - 1, ones]
    fractions = [0, 1, 2, fraction_mask, fraction_mask - 1, 1 << (fmt.fraction_bits - 1)]
    random_words = rng.integers(0, 1 << 63, count, dtype=np.uint64) * np.uint64(2)
    random_words = (random_words ^ rng.integers(0, 4, count, dtype=np.uint64)) >> np.uint64(
        64 - fmt.width
    )
    words = []
    for word in random_words.tolist():
        fraction = word & fraction_mask
        exponent = (word >> fmt.fraction_bits) & ones
        sign = word >> (fmt.width - 1)
        if rng.random() < 0.4:
            exponent = int(rng.choice(exponents))
        if rng.random() < 0.4:
            fraction = int(rng.choice(fractions))
        words.append((sign << (fmt.width - 1)) | (exponent << fmt.fraction_bits) | fraction)
    return words


def special_words(fmt):
    """Zero, one, infinity, NaN, the largest number, the smallest one and its neighbours."""
    smallest = 1 << fmt.fraction_bits
    positive = [
        0, 1, smallest - 1, smallest, smallest + 1, fmt.bias << fmt.fraction_bits,
        fmt.infinity - 1, fmt.infinity, fmt.infinity + 1, fmt.nan,
    ]  # fmt: skip
    return positive + [word | 1 << (fmt.width - 1) for word in positive]


def hostile_pairs(fmt, rng, count):
    """Pairs of such words, some of them neighbours or with a chosen distance of exponents."""
    first, second = hostile_words(fmt, rng, count), hostile_words(fmt, rng, count)
    mask = (1 << fmt.width) - 1
    for index in range(count):
        kind = rng.random()
        if kind < 0.2:  # nearly or exactly cancelling
            difference = int(rng.choice([0, 0, 1, -1, 2, 3]))
            sign = int(rng.integers(2)) << (fmt.width - 1)
            second[index] = ((first[index] ^ sign) + difference) & mask
        elif kind < 0.5:  # exponents at most as far apart as a significand is long
            distance = int(rng.integers(-fmt.precision - 3, fmt.precision + 4))
            exponent = (first[index] >> fmt.fraction_bits) & fmt.max_exponent_field
            exponent = min(max(exponent + distance, 0), fmt.max_exponent_field)
            second[index] &= ~(fmt.max_exponent_field << fmt.fraction_bits)
            second[index] |= exponent << fmt.fraction_bits
    specials = [(a, b) for a in special_words(fmt) for b in special_words(fmt)]
    return [a for a, _ in specials] + first, [b for _, b in specials] + second


def stream(unit, inputs, output):
    """Put one vector in on every clock, and give what comes out for each."""
    received = []

    async def testbench(ctx):
        for index in range(len(inputs[0][1]) + unit.stages):
            for port, words in inputs:
                ctx.set(port, words[index] if index < len(words) else 0)
            if index >= unit.stages:
                received.append(ctx.get(output))
            await ctx.tick()

    simulator = Simulator(unit)
    simulator.add_clock(10e-9)
    simulator.add_testbench(testbench)
    simulator.run()
    return received


@pytest.mark.parametrize("name", ALL_FORMATS)
@pytest.mark.parametrize("stages", [1, 2, 3, "default", 4, 5, 8])
@pytest.mark.parametrize("unit_class", [FloatAdder, FloatMultiplier])
def test_binary_units_agree_with_model(unit_class, stages, name):
    fmt = ALL_FORMATS[name]
    if stages == "default":
        stages = unit_class.DEFAULT_STAGES
    model, output = UNITS[unit_class]
    first, second = hostile_pairs(fmt, np.random.default_rng(stages), VECTORS)

    unit = unit_class(fmt, stages=stages)
    received = stream(unit, [(unit.a, first), (unit.b, second)], getattr(unit, output))

    a, b = (fmt.decode(np.array(words, dtype=np.uint64)) for words in (first, second))
    expected = fmt.encode(model(fmt, a, b)).tolist()
    assert received == expected
    assert len(received) > VECTORS
    # The vectors reach ordinary and special results.
    assert {0, fmt.infinity, fmt.nan} < set(expected)
    assert len(set(expected)) > VECTORS // 4


@pytest.mark.parametrize("name", ALL_FORMATS)
@pytest.mark.parametrize("stages", [1, 2, 3, "default", 4, 5, 6, 7, 8, 12])
def test_reciprocal_sqrt_agrees_with_model(stages, name):
    fmt = ALL_FORMATS[name]
    if stages == "default":
        stages = ReciprocalSqrt.DEFAULT_STAGES
    words = special_words(fmt) + hostile_words(fmt, np.random.default_rng(stages), VECTORS)

    unit = ReciprocalSqrt(fmt, stages=stages)
    received = stream(unit, [(unit.a, words)], unit.root)

    params = ReciprocalSqrtParams(fmt=fmt)
    expected = [params.compute(word) for word in words]
    assert received == expected
    assert {0, fmt.nan} < set(expected)


@pytest.mark.parametrize("name", ALL_FORMATS)
@pytest.mark.parametrize("stages", [1, "default", 6, 9, 12])
def test_signed_reciprocal_sqrt_agrees_with_model(stages, name):
    """Both kinds of roots, a random one on every clock."""
    fmt = ALL_FORMATS[name]
    if stages == "default":
        stages = ReciprocalSqrt.DEFAULT_STAGES
    rng = np.random.default_rng(stages)
    large = (2 * fmt.bias - 1) << fmt.fraction_bits
    limits = [word | sign << (fmt.width - 1) for word in (large - 1, large) for sign in (0, 1)]
    words = 3 * (special_words(fmt) + limits) + hostile_words(fmt, rng, VECTORS)
    signed = rng.integers(2, size=len(words))

    unit = ReciprocalSqrt(fmt, stages=stages, has_signed=True)
    received = stream(unit, [(unit.a, words), (unit.signed, signed.tolist())], unit.root)

    values = fmt.decode(np.array(words, dtype=np.uint64))
    roots = (fmt.encode(evaluate_root(fmt, root, values)) for root in (Root.PLAIN, Root.SIGNED))
    expected = np.choose(signed, list(roots)).tolist()
    assert received == expected
    minus = 1 << (fmt.width - 1)
    assert {0, minus, fmt.infinity, fmt.infinity | minus, fmt.nan} < set(expected)


@pytest.mark.parametrize("unit_class", UNITS)
def test_wrong_arguments_are_rejected(unit_class):
    with pytest.raises(TypeError, match=r"^Format must be a FloatFormat, not 32$"):
        unit_class(32, stages=2)
    for stages in (0, 17, "2"):
        with pytest.raises(ValueError, match=rf"^Stages must be between 1 and 16, not {stages!r}$"):
            unit_class(BINARY32, stages=stages)
