"""Elementary functions: zeros, signs, infinities and limits one by one; what is exact; counting."""

from math import inf, nan, pi

import numpy as np
import pytest

from ukf_sw.elementary import exponential, quotients, selection
from ukf_sw.elementary.coefficients import coefficients
from ukf_sw.elementary.functions import FUNCTIONS, needs_exponents, sequence
from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.elementary.trigonometric import angle_limit
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
from ukf_sw.spec.model_programs import RootStep

ALL_FORMATS = pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)


def special_cases(fmt):
    """Arguments, then what must come out, by function."""
    tiny, huge, above = fmt.min_normal, fmt.max_finite, 1.0 + fmt.epsilon
    big = 2.0 ** (fmt.bias - 1)
    far = fmt.round(pi * (2.0 ** coefficients(fmt).turn_bits + 1.0))
    half, whole = float(fmt.round(pi / 2)), float(fmt.round(pi))
    log_huge = nan if exponent_step(fmt) == 1 else float(fmt.round(np.log(huge)))
    angles = [(inf, nan), (-inf, nan), (nan, nan), (far, nan), (-far, nan), (huge, nan)]
    beyond_1 = [(above, nan), (-above, nan), (2.0, nan), (inf, nan), (-inf, nan), (nan, nan)]
    return {
        "reciprocal": [
            (0.0, inf), (-0.0, -inf), (inf, 0.0), (-inf, -0.0), (nan, nan), (1.0, 1.0),
            (-4.0, -0.25), (tiny, 1 / tiny), (-tiny, -1 / tiny), (big, nan), (-big, nan),
            (huge, nan), (big / 4, 4 / big),
        ],
        "divide": [
            (1.0, 0.0, inf), (1.0, -0.0, -inf), (-1.0, 0.0, -inf), (-1.0, -0.0, inf),
            (0.0, 0.0, nan), (-0.0, 0.0, nan), (0.0, 1.0, 0.0), (-0.0, 1.0, -0.0),
            (0.0, -1.0, -0.0), (inf, 2.0, inf), (inf, -2.0, -inf), (inf, 0.0, inf),
            (inf, inf, nan), (inf, -inf, nan), (1.0, inf, 0.0), (-1.0, inf, -0.0),
            (huge, big, nan), (0.0, big, nan), (huge, tiny, inf), (tiny, 4.0, 0.0),
            (-tiny, 4.0, -0.0), (nan, 1.0, nan), (1.0, nan, nan), (0.0, nan, nan), (nan, 0.0, nan),
            (inf, nan, nan), (3.0, 1.0, 3.0),
        ],
        "sqrt": [
            (0.0, 0.0), (-0.0, -0.0), (4.0, 2.0), (-1.0, nan), (-tiny, nan), (-huge, nan),
            (-inf, nan), (inf, nan), (nan, nan), (big, 2.0 ** ((fmt.bias - 1) // 2)),
        ],
        "hypot": [
            (0.0, 0.0, 0.0), (-0.0, -0.0, 0.0), (0.0, -4.0, 4.0), (-4.0, 0.0, 4.0),
            (inf, 1.0, inf), (1.0, -inf, inf), (0.0, inf, inf), (inf, inf, nan), (-inf, inf, nan),
            (tiny, 0.0, tiny), (0.0, -tiny, tiny), (huge, 0.0, huge), (huge, huge, inf),
            (nan, 0.0, nan), (0.0, nan, nan), (inf, nan, nan), (nan, -inf, nan), (huge, 1.0, huge),
        ],
        "sin": [(0.0, 0.0), (-0.0, 0.0), *angles],
        "cos": [(0.0, 1.0), (-0.0, 1.0), *angles],
        "tan": [(0.0, 0.0), (-0.0, 0.0), *angles],
        "arcsin": [
            (0.0, 0.0), (-0.0, -0.0), (1.0, half), (-1.0, -half), (tiny, tiny), *beyond_1,
        ],
        "arccos": [(1.0, 0.0), (-1.0, whole), (0.0, half), (-0.0, half), *beyond_1],
        "arctan": [
            (0.0, 0.0), (-0.0, -0.0), (inf, half), (-inf, -half), (big, nan), (-huge, nan),
            (nan, nan), (tiny, tiny), (-tiny, -tiny), (fmt.round(big / 2), half),
        ],
        "arctan2": [
            (0.0, 1.0, 0.0), (-0.0, 1.0, -0.0), (0.0, -1.0, whole), (-0.0, -1.0, -whole),
            (0.0, 0.0, 0.0), (-0.0, 0.0, -0.0), (0.0, -0.0, whole), (-0.0, -0.0, -whole),
            (1.0, 0.0, half), (1.0, -0.0, half), (-1.0, 0.0, -half), (-1.0, -0.0, -half),
            (1.0, inf, 0.0), (-1.0, inf, -0.0), (1.0, -inf, whole), (-1.0, -inf, -whole),
            (inf, 1.0, half), (-inf, 1.0, -half), (inf, -1.0, half), (-inf, -1.0, -half),
            (0.0, inf, 0.0), (0.0, -inf, whole), (inf, 0.0, half), (-inf, -0.0, -half),
            (inf, inf, nan), (inf, -inf, nan), (-inf, inf, nan), (-inf, -inf, nan),
            (nan, 1.0, nan), (1.0, nan, nan), (nan, 0.0, nan), (0.0, nan, nan), (inf, nan, nan),
            (nan, -inf, nan), (huge, tiny, half), (tiny, -huge, whole), (-tiny, huge, -0.0),
        ],
        "exp": [
            (0.0, 1.0), (-0.0, 1.0), (inf, inf), (-inf, 0.0), (nan, nan), (huge, inf), (-huge, 0.0),
            (tiny, 1.0), (-tiny, 1.0), (2.0**12, inf), (-(2.0**12), 0.0),
        ],
        "log": [
            (1.0, 0.0), (0.0, -inf), (-0.0, -inf), (-1.0, nan), (-tiny, nan), (-huge, nan),
            (inf, nan), (-inf, nan), (nan, nan), (huge, log_huge),
        ],
        "power": [
            (1.0, 3.5, 1.0), (0.0, 2.5, 0.0), (-0.0, 2.5, 0.0), (0.0, -2.5, inf), (0.0, 0.0, nan),
            (-1.0, 2.0, nan), (-tiny, 1.0, nan), (2.0, 0.0, 1.0), (2.0, inf, inf),
            (2.0, -inf, 0.0), (0.5, inf, 0.0), (0.5, -inf, inf), (1.0, inf, nan), (inf, 1.0, nan),
            (2.0, nan, nan), (nan, 1.0, nan), (nan, 0.0, nan), (2.0, huge, inf), (2.0, -huge, 0.0),
        ],
        "tanh": [
            (0.0, 0.0), (-0.0, -0.0), (inf, 1.0), (-inf, -1.0), (huge, 1.0), (-huge, -1.0),
            (nan, nan), (2.0**10, 1.0), (-(2.0**10), -1.0),
        ],
        "absolute": [
            (0.0, 0.0), (-0.0, 0.0), (-1.0, 1.0), (inf, inf), (-inf, inf), (nan, nan),
            (-tiny, tiny),
        ],
        "sign": [
            (0.0, 0.0), (-0.0, -0.0), (tiny, 1.0), (-tiny, -1.0), (huge, 1.0), (-huge, -1.0),
            (inf, 1.0), (-inf, -1.0), (nan, nan), (1.0, 1.0), (-1.0, -1.0),
        ],
        "copysign": [
            (0.0, -1.0, -0.0), (-0.0, 1.0, 0.0), (-0.0, -0.0, -0.0), (2.0, -0.0, -2.0),
            (-2.0, 0.0, 2.0), (inf, -1.0, -inf), (-inf, 1.0, inf), (1.0, -inf, -1.0),
            (nan, 1.0, nan), (-1.0, nan, 1.0),
        ],
        "rint": [
            (0.0, 0.0), (-0.0, -0.0), (0.5, 0.0), (-0.5, -0.0), (1.5, 2.0), (2.5, 2.0),
            (-1.5, -2.0), (inf, inf), (-inf, -inf), (nan, nan), (huge, huge), (tiny, 0.0),
        ],
        "floor": [
            (0.0, 0.0), (-0.0, -0.0), (0.5, 0.0), (-0.5, -1.0), (1.5, 1.0), (-1.5, -2.0),
            (tiny, 0.0), (-tiny, -1.0), (inf, inf), (-inf, -inf), (nan, nan), (-huge, -huge),
        ],
        "ceil": [
            (0.0, 0.0), (-0.0, -0.0), (0.5, 1.0), (-0.5, -0.0), (1.5, 2.0), (-1.5, -1.0),
            (tiny, 1.0), (-tiny, -0.0), (inf, inf), (-inf, -inf), (nan, nan), (huge, huge),
        ],
    }  # fmt: skip


def differ(found, expected):
    """Whether numbers, or the signs of zeros, differ; any NaN is as good as any other."""
    same = (found == expected) & (np.signbit(found) == np.signbit(expected))
    return ~(same | (np.isnan(found) & np.isnan(expected)))


@ALL_FORMATS
@pytest.mark.parametrize("name", special_cases(BINARY32))
def test_zeros_signs_infinities_and_limits(name, fmt):
    cases = np.array(special_cases(fmt)[name], dtype=np.float64)
    cases = fmt.round(cases)
    (found,) = sequence(name, fmt).evaluate(*cases[:, :-1].T)
    wrong = differ(found, cases[:, -1])
    assert not wrong.any(), (cases[wrong], found[wrong])


@ALL_FORMATS
def test_sine_and_cosine_together_have_the_same_limits(fmt):
    for column, name in enumerate(("sin", "cos")):
        cases = fmt.round(special_cases(fmt)[name])
        found = sequence("sincos", fmt).evaluate(cases[:, 0])[column]
        assert not differ(found, cases[:, 1]).any()


@ALL_FORMATS
def test_angles_are_reduced_up_to_the_limit_and_refused_beyond(fmt):
    limit = angle_limit(fmt)
    inside = fmt.round(limit * (1.0 - 2.0 * fmt.epsilon))
    beyond = fmt.round(limit * (1.0 + 2.0 ** -coefficients(fmt).turn_bits))
    for name in ("sin", "cos", "tan", "sincos"):
        for found in sequence(name, fmt).evaluate([inside, -inside]):
            assert np.isfinite(found).all()
        for found in sequence(name, fmt).evaluate([beyond, -beyond, fmt.max_finite]):
            assert np.isnan(found).all()


# Exact functions, against NumPy.

EXACT = {
    "absolute": np.abs, "copysign": np.copysign, "sign": np.sign, "minimum": np.minimum,
    "maximum": np.maximum, "clip": lambda x, low, high: np.minimum(np.maximum(x, low), high),
    "rint": np.rint, "floor": np.floor, "ceil": np.ceil,
}  # fmt: skip
COMPARISONS = {
    "less": np.less, "less_equal": np.less_equal, "greater": np.greater,
    "greater_equal": np.greater_equal, "equal": np.equal, "not_equal": np.not_equal,
}  # fmt: skip


def compare(name, x, y):
    """As NumPy does; but an infinity compares with itself as NaN does."""
    same = np.isinf(x) & (x == y)
    return COMPARISONS[name](np.where(same, nan, x), y)


def hostile_numbers(fmt, rng, count):
    """Special numbers first, then integers, halves, and numbers close to each other."""
    whole = 2.0**fmt.fraction_bits
    special = [
        0.0, 1.0, 0.5, 1.5, 2.5, 1.0 + fmt.epsilon, 0.5 - fmt.epsilon / 4, fmt.min_normal,
        1.5 * fmt.min_normal, fmt.max_finite, inf, whole, whole - 1, whole - 0.5, whole + 1,
        2 * whole, 2 * whole - 1, 2 * whole + 2, 3 * whole, whole / 2 + 0.5, whole / 2 - 0.5,
    ]  # fmt: skip
    some = rng.choice([0.25, 0.5, 1.0, 3.0, whole, fmt.min_normal * 3], count)
    random = some * rng.standard_normal(count)
    values = fmt.round([*special, *(-value for value in special), nan, *random])
    with np.errstate(over="ignore"):
        near = fmt.round(values * (1.0 + rng.integers(-1, 2, values.size) * fmt.epsilon))
    return np.concatenate([values, near])


def pairs(fmt, rng, arguments):
    """Special numbers with each other, and others at random."""
    values = hostile_numbers(fmt, rng, 100)
    grid = np.array(np.meshgrid(values[:43], values[:43])).reshape(2, -1)
    rows = [np.concatenate([grid[k % 2], rng.choice(values, 20_000)]) for k in range(arguments)]
    if arguments == 3:
        rows[2] = rng.permutation(rows[2])
    return rows


@ALL_FORMATS
@pytest.mark.parametrize("name", EXACT)
def test_exact_functions_are_those_of_numpy(name, fmt):
    rows = pairs(fmt, np.random.default_rng(8), FUNCTIONS[name].arguments)
    (found,) = sequence(name, fmt).evaluate(*rows)
    with np.errstate(invalid="ignore"):
        expected = EXACT[name](*rows)
    # Of zeros of both signs, NumPy takes either; its sign of minus zero is plus zero, and its
    # ceiling of what is below -1/2 minus zero.
    signs = name not in ("minimum", "maximum", "clip", "sign", "ceil")
    wrong = differ(found, expected) if signs else ~((found == expected) | np.isnan(expected))
    assert not wrong.any(), [row[wrong][:3] for row in (*rows, found, expected)]
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))


def is_true(mask):
    return np.signbit(mask) & ~np.isnan(mask)


@ALL_FORMATS
@pytest.mark.parametrize("name", COMPARISONS)
def test_comparisons_are_those_of_numpy(name, fmt):
    rows = pairs(fmt, np.random.default_rng(9), 2)
    (found,) = sequence(name, fmt).evaluate(*rows)
    expected = compare(name, *rows)
    wrong = is_true(found) != expected
    assert not wrong.any(), [row[wrong][:3] for row in (*rows, found)]
    assert 100 < expected.sum() < expected.size - 100


@ALL_FORMATS
@pytest.mark.parametrize("constant", [0.0, -0.0, 1.5, -3.0, inf, "min_normal", "max_finite"])
@pytest.mark.parametrize("name", [*COMPARISONS, "minimum", "maximum"])
def test_constants_are_compared_in_fewer_slots(name, constant, fmt):
    constant = getattr(fmt, constant) if isinstance(constant, str) else constant
    values = hostile_numbers(fmt, np.random.default_rng(10), 500)
    for swap in (False, True):
        builder = SequenceBuilder(fmt)
        operands = [builder.input(), builder.constant(constant)]
        result = FUNCTIONS[name].expand(builder, *operands[:: -1 if swap else 1])
        made = builder.finish(result)
        assert made.slots < sequence(name, fmt).slots
        (found,) = made.evaluate(values)
        arguments = [values, constant][:: -1 if swap else 1]
        if name in COMPARISONS:
            np.testing.assert_array_equal(is_true(found), compare(name, *arguments))
        else:
            np.testing.assert_array_equal(found, EXACT[name](*arguments))


def test_masks_are_combined_and_choose():
    truths = np.array([-1.0, -0.0, -inf, 1.0, 0.0, inf, nan])
    first, second = (rows.ravel() for rows in np.meshgrid(truths, truths))
    a, b = is_true(first), is_true(second)
    results = {
        "logical_and": a & b, "logical_or": a | b,
    }  # fmt: skip
    for name, expected in results.items():
        (found,) = sequence(name, BINARY32).evaluate(first, second)
        np.testing.assert_array_equal(is_true(found), expected)
    (found,) = sequence("logical_not", BINARY32).evaluate(truths)
    np.testing.assert_array_equal(is_true(found), ~is_true(truths))
    assert np.abs(found).tolist() == [1.0] * len(truths)

    values = np.array([0.0, -0.0, 2.5, inf, -inf, nan, BINARY32.max_finite])
    for mask in truths:
        for other in values:
            (found,) = sequence("where", BINARY32).evaluate(mask, values, other)
            chosen = values if is_true(mask) else np.full(values.shape, other)
            assert not differ(found, chosen).any()


def test_limits_of_a_clip_may_be_constants():
    builder = SequenceBuilder(BINARY32)
    x = builder.input()
    low, high = builder.constant(-1.5), builder.constant(2.0)
    made = builder.finish(selection.clip(builder, x, low, high))
    values = hostile_numbers(BINARY32, np.random.default_rng(11), 300)
    np.testing.assert_array_equal(made.evaluate(values)[0], np.clip(values, -1.5, 2.0))
    assert made.slots == 5
    np.testing.assert_array_equal(builder.finish(x).evaluate(values)[0], values)  # is kept


# Powers with exponents that are known.


def power(fmt, exponent):
    builder = SequenceBuilder(fmt)
    return builder.finish(exponential.power(builder, builder.input(), exponent))


@ALL_FORMATS
def test_integer_powers_are_products(fmt):
    x = fmt.round([-2.0, -1.5, -0.0, 0.0, 0.5, 1.5, 2.0, 3.0])
    assert power(fmt, 0).evaluate(x)[0].tolist() == [1.0] * 8
    assert power(fmt, 1).evaluate(x)[0].tolist() == x.tolist()
    for exponent, slots in ((2, 1), (3, 2), (4, 2), (5, 3), (7, 4)):
        made = power(fmt, exponent)
        assert (made.slots, made.loads) == (slots, 0)
        error = np.abs(made.evaluate(x)[0] - x**exponent)
        assert (error <= (slots + 1) * fmt.epsilon * np.abs(x**exponent)).all()
        inverse = power(fmt, -exponent)
        assert (inverse.slots, inverse.loads) == (slots + 3, 1)
        found = inverse.evaluate([0.0, -0.0, 2.0])[0].tolist()
        assert found == [inf, inf if exponent % 2 == 0 else -inf, 2.0**-exponent]
    assert power(fmt, 2.0).slots == power(fmt, 2).slots


@ALL_FORMATS
def test_halves_are_roots(fmt):
    root, inverse, other = power(fmt, 0.5), power(fmt, -0.5), power(fmt, 2.5)
    assert (root.slots, root.loads, inverse.slots, inverse.loads) == (1, 1, 4, 2)
    assert (other.slots, other.loads, power(fmt, -1.5).slots) == (3, 1, 5)
    assert root.evaluate([0.0, 4.0])[0].tolist() == [0.0, 2.0]
    assert inverse.evaluate([0.0, 4.0, 16.0])[0].tolist() == [inf, 0.5, 0.25]
    assert other.evaluate([0.0, 4.0])[0].tolist() == [0.0, 32.0]
    assert power(fmt, -1.5).evaluate([0.0, 4.0])[0].tolist() == [inf, 0.125]
    for made in (root, inverse, other):
        assert np.isnan(made.evaluate([-1.0, -inf, nan])[0]).all()


@ALL_FORMATS
@pytest.mark.parametrize("exponent", [0.25, 1.0 / 3.0, -2.75, 1100.0, inf])
def test_other_powers_are_of_logarithms(fmt, exponent):
    exponent = float(fmt.round(exponent))
    made = power(fmt, exponent)
    (given,) = sequence("power", fmt).evaluate([1.0, 1.5, 0.0, -1.0], exponent)
    assert made.slots == sequence("power", fmt).slots
    np.testing.assert_array_equal(made.evaluate([1.0, 1.5, 0.0, -1.0])[0], given)


def test_integer_powers_are_positive():
    builder = SequenceBuilder(BINARY32)
    with pytest.raises(ValueError, match="exponent must be positive, not 0"):
        quotients.integer_power(builder, builder.input(), 0)


# Sequences and their builder.


def test_what_is_counted():
    builder = SequenceBuilder(BINARY32)
    x, y = builder.input(), builder.input()
    made = builder.finish(quotients.divide(builder, y, x), x)
    assert (made.slots, made.loads) == (4, 1)
    assert made.scalars == {1.0}
    assert made.words == set()
    assert len(made.forms) == 4
    assert {name for name in FUNCTIONS if needs_exponents(name, BINARY32)} == {
        "exp", "log", "power",
    }  # fmt: skip
    assert sequence("rint", BINARY32).words == {2.0**23, -(2.0**23)}
    assert sequence("exp", BINARY32) is sequence("exp", BINARY32)


def test_all_that_lanes_can_do_is_used():
    """Hardware that no function needs is none."""
    forms = {form for name in FUNCTIONS for form in sequence(name, BINARY32).forms}
    used = {value for form in forms for value in vars(form).values()}
    for kind in (Multiplier, Addend, Reading, Sign, Condition):
        assert set(kind) <= used
    steps = [step for name in FUNCTIONS for step in sequence(name, BINARY32).steps]
    assert {step.root for step in steps if isinstance(step, RootStep)} == set(Root)


def test_shapes_broadcast_and_inputs_are_numbers_of_the_format():
    made = sequence("divide", BINARY32)
    (found,) = made.evaluate([[1.0], [3.0]], [1.0, 2.0, 4.0])
    assert found.tolist() == [[1.0, 0.5, 0.25], [3.0, 1.5, 0.75]]
    assert made.evaluate(1.0, 2.0)[0].shape == ()
    assert made.evaluate(np.empty((0, 3)), 1.0)[0].shape == (0, 3)
    # Subnormal numbers read as zeros of their sign.
    assert made.evaluate(1.0, [-(2.0**-130), 2.0**-149])[0].tolist() == [-inf, inf]
    with pytest.raises(ValueError, match=r"inputs must be numbers of binary32, not 0\.1"):
        made.evaluate(1.0, [0.5, 0.1])
    with pytest.raises(ValueError, match="inputs must be 2 arrays, not 1"):
        made.evaluate(1.0)


def test_inputs_are_kept():
    """A function writes into temporaries of its own."""
    rng = np.random.default_rng(12)
    for name, function in FUNCTIONS.items():
        builder = SequenceBuilder(BINARY32)
        inputs = [builder.input() for _ in range(function.arguments)]
        function.expand(builder, *inputs)
        values = BINARY32.round(rng.standard_normal((function.arguments, 5)))
        found = builder.finish(*inputs).evaluate(*values)
        np.testing.assert_array_equal(found, values, err_msg=name)


def test_operands_are_those_that_a_form_uses():
    builder = SequenceBuilder(BINARY32)
    x = builder.input()
    axpy = Form(multiplier=Multiplier.SCALAR)
    with pytest.raises(ValueError, match="word 0 must be left out, not Temporary"):
        builder.slot(axpy, x, x, 1.0)
    with pytest.raises(ValueError, match="word 1 must be given, not None"):
        builder.slot(axpy, None, None, 1.0)
    with pytest.raises(ValueError, match="scalar must be given, not None"):
        builder.slot(axpy, None, x)
    with pytest.raises(ValueError, match="into must be given with a condition, not None"):
        builder.slot(Form(condition=Condition.ODD), x, x)


def test_a_condition_keeps_what_was_there():
    builder = SequenceBuilder(BINARY32)
    x, y = builder.input(), builder.input()
    result = builder.copied(x)
    builder.copied(y, condition=Condition.NEGATIVE, where=y, into=result)
    assert builder.finish(result).evaluate(5.0, [1.0, -2.0])[0].tolist() == [5.0, -2.0]


def test_names_that_are_none():
    with pytest.raises(ValueError, match=r"function must be one of reciprocal, .*, not 'sinus'"):
        sequence("sinus", BINARY32)


def test_formats_without_coefficients_are_refused_with_the_remedy():
    fmt = FloatFormat(exponent_bits=6, fraction_bits=17)
    message = (
        r"format of elementary functions must be one of .*binary64, or `make coefficients "
        r"FORMATS=float6\.17` makes theirs; not 'float6\.17'"
    )
    with pytest.raises(ValueError, match=message):
        sequence("sin", fmt)
    # What needs none has no limit.
    assert sequence("divide", fmt).evaluate(1.0, 4.0)[0] == 0.25


def test_fractions_too_short_for_exponents_are_refused(monkeypatch):
    fmt = FloatFormat(exponent_bits=11, fraction_bits=9)
    monkeypatch.setattr(exponential, "coefficients", lambda fmt: coefficients(BINARY64))
    for name in ("exp", "log", "power"):
        message = f"fraction bits of a format with .* exponent bits - 1, not {fmt.name!r}"
        with pytest.raises(ValueError, match=message):
            FUNCTIONS[name].sequence(fmt)


def test_slots_are_not_more_than_they_were_planned_to_be():
    """In binary32, as the design of the array counts on."""
    planned = {
        "reciprocal": 4, "divide": 5, "sqrt": 1, "sin": 13, "cos": 15, "sincos": 22, "tan": 25,
        "arctan2": 24, "arctan": 18, "arcsin": 20, "exp": 12, "log": 20, "power": 32, "tanh": 18,
    }  # fmt: skip
    for name, slots in planned.items():
        assert sequence(name, BINARY32).slots <= slots, name
    for fmt in (BINARY16, BFLOAT16):
        assert sequence("arctan2", fmt).slots < 24
