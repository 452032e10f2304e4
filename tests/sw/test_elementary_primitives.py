"""Forms of a lane, against what gates would make of the words, and exact arithmetic."""

import itertools

import gmpy2
import numpy as np
import pytest

from ukf_sw.elementary.primitives import evaluate, evaluate_root, is_narrow
from ukf_sw.engine.reciprocal_sqrt import ReciprocalSqrtParams
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FORMATS, FloatFormat
from ukf_sw.spec.forms import (
    Addend,
    Condition,
    Form,
    Multiplier,
    Reading,
    Root,
    Sign,
    exponent_step,
)

FORMATS_TO_TRY = [
    *FORMATS.values(),
    *(
        FloatFormat(exponent_bits=exponent_bits, fraction_bits=fraction_bits)
        for exponent_bits, fraction_bits in [(6, 17), (5, 5), (6, 5), (8, 8), (11, 5), (4, 7)]
    ),
]  # fmt: skip
FORMS = [
    Form(
        multiplier=multiplier, addend=addend, reading=reading, sign=sign, subtract=subtract,
        condition=condition,
    )
    for multiplier, addend, reading, sign, subtract, condition in itertools.product(
        Multiplier, Addend, Reading, Sign, (False, True), Condition
    )
]  # fmt: skip


def bit(word, number):
    return word >> number & 1


def read(fmt, reading, word):
    """Word that a lane makes of word 1: wires, and gates for what is not of the usual kind."""
    E, F = fmt.exponent_bits, fmt.fraction_bits
    sign, exponent, fraction = bit(word, fmt.width - 1), word >> F & fmt.max_exponent_field, word
    fraction &= (1 << F) - 1
    ones = fmt.max_exponent_field
    if reading is Reading.NUMBER:
        return word
    if reading is Reading.ONE:
        return fmt.bias << F
    if reading is Reading.POWER:
        if exponent == ones and fraction:
            return fmt.nan
        if sign or exponent < fmt.bias + F:
            return 0
        if exponent > fmt.bias + F:
            return fmt.infinity
        # The top bit of the fraction tells k >= 0 from k < 0. If the others between it and the
        # E - 1 low ones are those of a short number, the low ones are an exponent, all but one bit.
        top, middle = bit(fraction, F - 1), fraction & (1 << (F - 1)) - 1
        if F >= E:
            high, low = middle >> (E - 1), middle & (1 << (E - 1)) - 1
            if high != (0 if top else (1 << (F - E)) - 1):
                return fmt.infinity if top else 0
        else:
            low = middle if top else middle | (1 << (E - 1)) - (1 << (F - 1))
        field = top << (E - 1) | low
        return field << F  # all ones are infinity, all zeros zero
    if exponent == ones or (sign and exponent):
        return fmt.nan
    if exponent == 0:
        return fmt.infinity | 1 << (fmt.width - 1)
    field = exponent >> max(0, E - F)
    bits = min(E, F)
    top, low = bit(field, bits - 1), field & (1 << (bits - 1)) - 1
    extension = 0 if top else (1 << (F - 1)) - (1 << (bits - 1))
    return (fmt.bias + F) << F | top << (F - 1) | extension | low


def rounded(fmt, exact):
    """Round, then flush or make infinite."""
    if gmpy2.is_nan(exact):
        return fmt.nan
    sign = int(gmpy2.is_signed(exact)) << (fmt.width - 1)
    value = abs(float(exact))
    if value < fmt.min_normal:
        return sign
    return int(fmt.encode(value)) | sign


def number(fmt, word):
    return gmpy2.mpfr(float(fmt.decode(word)), 53)


def lane(fmt, form, word_0, word_1, scalar, before):
    """Word that the destination has afterwards."""
    context = gmpy2.context(precision=fmt.precision, emin=-(1 << 20), emax=1 << 20)
    high = fmt.width - 1
    a = word_0 if form.multiplier is Multiplier.WORD else scalar
    c = {
        Addend.PLUS_ZERO: 0, Addend.MINUS_ZERO: 1 << high, Addend.WORD: word_0,
        Addend.SCALAR: scalar,
    }[form.addend]  # fmt: skip
    b = read(fmt, form.reading, word_1)
    sign = {
        Sign.KEEP: bit(b, high), Sign.CLEAR: 0, Sign.COPY: bit(word_0, high),
        Sign.BIT_0: bit(b, high) ^ bit(word_0, 0), Sign.BIT_1: bit(b, high) ^ bit(word_0, 1),
    }[form.sign]  # fmt: skip
    b = b & (1 << high) - 1 | (sign ^ form.subtract) << high
    product = rounded(fmt, context.mul(number(fmt, a), number(fmt, b)))
    result = rounded(fmt, context.add(number(fmt, c), number(fmt, product)))
    writes = {
        Condition.ALWAYS: True,
        Condition.NEGATIVE: bit(word_1, high),
        Condition.NOT_NEGATIVE: not bit(word_1, high),
        Condition.ODD: bit(word_1, 0),
        Condition.FINITE: result & fmt.infinity != fmt.infinity,
    }[form.condition]
    return result if writes else before


def hostile_words(fmt, rng, count):
    """Words of all kinds: special ones, numbers of all sizes, integers as they are formed."""
    E, F = fmt.exponent_bits, fmt.fraction_bits
    specials = [
        0, fmt.bias << F, fmt.infinity, 1 << F, fmt.infinity - 1, (fmt.bias + F) << F,
        (fmt.bias + F) << F | (1 << F) - 1, (fmt.bias + F + 1) << F, ((fmt.bias + F) << F) - 1,
    ]  # fmt: skip
    specials += [word | 1 << (fmt.width - 1) for word in specials] + [fmt.nan]
    exponents = rng.integers(1, fmt.max_exponent_field, count)
    fractions = rng.integers(0, 1 << F, count)
    wide = exponents << F | fractions | rng.integers(0, 2, count) << (fmt.width - 1)
    k = rng.integers(-(1 << (min(E, F) - 1)) - 3, (1 << (min(E, F) - 1)) + 3, count)
    formed = ((fmt.bias + F) << F) + np.clip((1 << (F - 1)) + k, 0, (1 << F) - 1)
    kinds = [np.array(specials, dtype=np.uint64), wide.astype(np.uint64), formed.astype(np.uint64)]
    return np.concatenate(kinds)


@pytest.mark.parametrize("fmt", FORMATS_TO_TRY, ids=lambda fmt: fmt.name)
def test_forms_are_what_gates_make(fmt):
    rng = np.random.default_rng(fmt.width)
    words = hostile_words(fmt, rng, 40)
    count = 10
    kept = 0
    for form in rng.permutation(np.array(FORMS, dtype=object))[:160]:
        operands = rng.choice(words, (4, count))
        values = [fmt.decode(row) for row in operands]
        found = fmt.encode(evaluate(form, fmt, *values))
        expected = [lane(fmt, form, *map(int, column)) for column in operands.T]
        assert found.tolist() == expected, (form, operands)
        kept += sum(
            int(word) == int(before) for word, before in zip(found, operands[3], strict=True)
        )
    assert kept > 30


@pytest.mark.parametrize("reading", [Reading.POWER, Reading.EXPONENT])
@pytest.mark.parametrize("fmt", FORMATS_TO_TRY, ids=lambda fmt: fmt.name)
def test_readings_of_every_kind_of_word(fmt, reading):
    words = hostile_words(fmt, np.random.default_rng(4), 500)
    if fmt.width <= 16:
        words = np.arange(1 << fmt.width)
    values = fmt.decode(words)
    found = evaluate(Form(multiplier=Multiplier.SCALAR, reading=reading), fmt, 0.0, values, 1.0)
    canonical = fmt.encode(values).tolist()
    assert fmt.encode(found).tolist() == [read(fmt, reading, word) for word in canonical]
    assert np.isfinite(found).any()
    assert not np.isfinite(found).all()


@pytest.mark.parametrize("fmt", FORMATS_TO_TRY, ids=lambda fmt: fmt.name)
def test_a_power_undoes_an_exponent(fmt):
    """And so does the other way round, as far as there are as many numbers as exponents."""
    step = exponent_step(fmt)
    exponents = np.arange(1 - fmt.bias, fmt.bias + 1)
    one = Form(multiplier=Multiplier.SCALAR, reading=Reading.EXPONENT)
    counted = evaluate(one, fmt, 0.0, np.ldexp(1.0, exponents), 1.0)
    power = Form(multiplier=Multiplier.SCALAR, reading=Reading.POWER)
    powers = evaluate(power, fmt, 0.0, counted, 1.0)
    expected = np.ldexp(1.0, (exponents - 1) // step + 1)
    assert powers.tolist() == expected.tolist()


@pytest.mark.parametrize("fmt", FORMATS_TO_TRY, ids=lambda fmt: fmt.name)
def test_plain_roots_are_those_of_the_unit(fmt):
    words = hostile_words(fmt, np.random.default_rng(5), 60)
    unit = ReciprocalSqrtParams(fmt=fmt)
    found = fmt.encode(evaluate_root(fmt, Root.PLAIN, fmt.decode(words)))
    assert found.tolist() == [unit.compute(int(word)) for word in words]


@pytest.mark.parametrize("fmt", FORMATS_TO_TRY, ids=lambda fmt: fmt.name)
def test_signed_roots_are_those_of_the_unit_with_a_sign(fmt):
    words = hostile_words(fmt, np.random.default_rng(6), 60)
    unit, high = ReciprocalSqrtParams(fmt=fmt), fmt.width - 1
    found = fmt.encode(evaluate_root(fmt, Root.SIGNED, fmt.decode(words)))
    for word, result in zip(map(int, words), found.tolist(), strict=True):
        sign, magnitude = word >> high << high, word & (1 << high) - 1
        exponent = magnitude >> fmt.fraction_bits
        if magnitude == 0:
            expected = fmt.infinity | sign
        elif exponent >= fmt.max_exponent_field - 2 and magnitude != fmt.infinity:
            expected = fmt.nan
        else:
            expected = unit.compute(magnitude) | sign
        assert result == expected
    # One below the limit, the square is the smallest normal number or more.
    limit = 2.0 ** (fmt.bias - 1)
    below = fmt.round(limit * (1.0 - fmt.epsilon / 2))
    root = evaluate_root(fmt, Root.SIGNED, np.array([below, -below]))
    square = evaluate(Form(), fmt, root, root)
    assert (square >= fmt.min_normal).all()
    assert np.isnan(evaluate_root(fmt, Root.SIGNED, np.array([limit, -limit]))).all()


def test_operands_that_a_form_does_not_use_do_not_matter():
    rng = np.random.default_rng(7)
    words = BINARY32.decode(hostile_words(BINARY32, rng, 30))
    for form in rng.permutation(np.array(FORMS, dtype=object))[:400]:
        operands = rng.choice(words, (4, 8))
        others = rng.choice(words, (4, 8))
        uses = form.uses_word_0, form.uses_word_1, form.uses_scalar, True
        mixed = np.where(np.array(uses)[:, None], operands, others)
        np.testing.assert_array_equal(
            evaluate(form, BINARY32, *operands), evaluate(form, BINARY32, *mixed)
        )


def test_steps_and_narrow_ranges():
    wide = FloatFormat(exponent_bits=11, fraction_bits=9)
    expected = {BINARY16: (1, True), BFLOAT16: (2, False), BINARY32: (1, False)}
    expected |= {BINARY64: (1, False), wide: (4, False)}
    for fmt, (step, narrow) in expected.items():
        assert (exponent_step(fmt), is_narrow(fmt)) == (step, narrow)
