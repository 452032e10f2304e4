"""The stored coefficients are those that the generator makes, and the generator is right."""

import json

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from ukf_docs import coefficients as generator
from ukf_docs.minimax import fit_polynomial, fit_rational, nodes, polynomial
from ukf_sw.elementary.coefficients import coefficients
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FORMATS, FloatFormat

STORED = json.loads(generator.FILE.read_text(encoding="utf-8"))
POLYNOMIALS = (
    "sine", "quarter_sine", "quarter_cosine", "tangent", "arcsine", "arctangent", "exponential",
    "logarithm",
)  # fmt: skip


def stored(fmt, names):
    return {name: STORED[fmt.name][name] for name in names}


def dumped(record):
    return json.loads(generator.dump({"it": record}))["it"]


def test_file_has_the_usual_formats_in_the_form_of_the_generator():
    assert list(STORED) == list(FORMATS)
    text = generator.FILE.read_text(encoding="utf-8")
    numbers = {name: vars(coefficients(fmt)) for name, fmt in FORMATS.items()}
    assert generator.dump(numbers) == text


@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_coefficients_are_numbers_of_the_format(fmt):
    for name, value in vars(coefficients(fmt)).items():
        values = np.atleast_1d(np.array(value, dtype=np.float64))
        np.testing.assert_array_equal(values, fmt.round(values), err_msg=name)


@pytest.mark.parametrize("fmt", [BFLOAT16, BINARY16], ids=lambda fmt: fmt.name)
def test_stored_coefficients_are_made_again(fmt):
    assert dumped(generator.make_coefficients(fmt)) == STORED[fmt.name]


@pytest.mark.parametrize(
    ("fmt", "names"), [(BINARY32, ("sine", "arcsine")), (BINARY64, ("quarter_sine",))],
    ids=["binary32", "binary64"],
)  # fmt: skip
def test_some_wide_coefficients_are_made_again(fmt, names):
    with mpmath.workprec(generator.PRECISION):
        made = generator.make_polynomials(fmt, coefficients(fmt).turn_bits, names)
    assert dumped(made) == stored(fmt, names)


@pytest.mark.slow
@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_all_coefficients_are_made_again(fmt):
    assert dumped(generator.make_coefficients(fmt)) == STORED[fmt.name]


@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_reductions_are_exact_but_for_their_last_part(fmt):
    """The product of every other part and every number of turns is a number of the format."""
    table = coefficients(fmt)
    quarters = np.arange(1, 2 << table.turn_bits)
    step = 2 if fmt is BFLOAT16 else 1
    powers = np.arange(1, (1 << (fmt.exponent_bits - 1)) // step + 1)
    for parts, factors in ((table.half_pi, quarters), (table.ln_2, powers)):
        for part in parts[:-1]:
            exact = [int(k) * int(part * 2**80) for k in factors]
            assert [int(fmt.round(float(k) * part) * 2**80) for k in factors] == exact
    with mpmath.workprec(200):
        scaled = mpmath.pi / 2 * mpf(table.angle_scale)
        rest = abs(mpmath.fsum(map(mpf, table.half_pi)) - scaled)
        assert rest < abs(table.half_pi[-1]) * fmt.epsilon
        rest = abs(mpmath.fsum(map(mpf, table.ln_2)) - step * mpmath.log(2))
        assert rest < abs(table.ln_2[-1]) * fmt.epsilon
    # What is refused is NaN because infinities of both signs meet.
    assert table.half_pi[0] > 0.0 > min(table.half_pi)


def test_reduced_angles_of_more_turns_would_be_wrong():
    """The number of turns is what the parts allow, or nobody has more."""
    with mpmath.workprec(generator.PRECISION):
        bits = coefficients(BINARY32).turn_bits + 1
        parts = generator._split(BINARY32, mpmath.pi / 2, 3, 24 - bits - 1, up=True)
        assert generator._angle_error(BINARY32, parts, 1.0, 2 << bits) > 0.75
    assert coefficients(BINARY64).turn_bits == 13


def test_polynomials_are_minimax():
    """A straight line of exp: its error is the same at both ends and where it is steepest."""
    with mpmath.workprec(200):
        found = fit_polynomial(mpmath.exp, lambda x: mpf(1), (mpf(0), mpf(1)), range(2), float)
        slope = mpmath.e - 1
        offset = (mpmath.e - slope * mpmath.log(slope)) / 2
        assert abs(found.coefficients[0] - offset) < 1e-3
        assert abs(found.coefficients[1] - slope) < 1e-3
        assert abs(found.error - (1 - offset)) < 1e-3
        # Level errors, alternating in sign, are the sign of the best one.
        best = fit_polynomial(
            mpmath.cos, lambda x: mpf(1), (mpf(-1), mpf(2)), range(6), lambda value: value
        )
        errors = [
            mpmath.cos(x) - polynomial(best.coefficients, x) for x in nodes(mpf(-1), mpf(2), 2000)
        ]
        turns = [
            abs(errors[k]) for k in range(1, 1999)
            if abs(errors[k]) >= max(abs(errors[k - 1]), abs(errors[k + 1]))
        ]  # fmt: skip
        ends = [abs(errors[0]), abs(errors[-1])]
        assert len(turns) == 5
        assert min(turns + ends) > 0.98 * best.error


def test_rounding_is_made_up_for():
    """Coefficients that follow are fitted to those that are rounded."""
    with mpmath.workprec(200):
        arguments = mpmath.exp, lambda x: mpf(1), (mpf(0), mpf(1)), range(6)
        together = fit_polynomial(*arguments, lambda value: float(BINARY16.round(float(value))))
        exact = fit_polynomial(*arguments, lambda value: value)
        rounded = [float(BINARY16.round(float(value))) for value in exact.coefficients]
        alone = max(abs(mpmath.exp(x) - polynomial(rounded, x)) for x in nodes(mpf(0), mpf(1), 99))
        assert together.error < alone
        assert all(value == BINARY16.round(value) for value in together.coefficients)


def test_a_goal_that_is_missed_ends_the_fit():
    with mpmath.workprec(200):
        found = fit_polynomial(
            mpmath.exp, lambda x: mpf(1), (mpf(0), mpf(1)), range(2), float, goal=mpf("0.01")
        )
    assert found.coefficients == ()
    assert found.error > 0.1


def test_quotients_are_level():
    with mpmath.workprec(200):
        above, below = fit_rational(
            mpmath.exp, lambda x: 1 / mpmath.exp(x), (mpf(0), mpf(1)), (2, 2)
        )
        assert below.coefficients[0] == 1
        assert len(above.coefficients) == 3
        assert above.error < 3e-6
        worst = max(
            abs(
                polynomial(above.coefficients, x)
                / polynomial(below.coefficients, x) / mpmath.exp(x) - 1
            )
            for x in nodes(mpf(0), mpf(1), 200)
        )  # fmt: skip
        assert worst < 1.1 * above.error


def test_the_command_keeps_other_formats(tmp_path):
    file = tmp_path / "coefficients.json"
    told = []

    def tell(*what):
        told.append(what)

    generator.refresh(file, [BFLOAT16], tell)
    generator.refresh(file, [FloatFormat(exponent_bits=7, fraction_bits=6)], tell)
    found = json.loads(file.read_text())
    assert list(found) == ["bfloat16", "float7.6"]
    assert found["bfloat16"] == STORED["bfloat16"]
    assert told == [("bfloat16", 0, 1), ("float7.6", 0, 1)]
    before = file.read_text()
    generator.refresh(file, [BFLOAT16], tell)
    assert file.read_text() == before


def test_formats_that_cannot_be_are_refused():
    for fmt in (
        FloatFormat(exponent_bits=4, fraction_bits=20),
        FloatFormat(exponent_bits=11, fraction_bits=5),
    ):
        with pytest.raises(ValueError, match=f"format must be one .*, not {fmt.name!r}"):
            generator.make_coefficients(fmt)
