"""Graphs of models as steps: what is joined, how programs end, and what is refused."""

import numpy as np
import pytest

from support.tracing import call_of
from ukf_sw.elementary.execution import execute
from ukf_sw.errors import FormatOverflowError
from ukf_sw.lowering.program import lower_model, places_of_inputs
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64
from ukf_sw.spec.forms import Addend
from ukf_sw.spec.model_programs import Constant, RootStep, SlotStep, SourceKind, Temporary
from ukf_sw.tracing.models import TracedModel
from ukf_sw.tracing.tracer import trace

POINTS = 200


def traced(function, rows=3, *, sensor=None, noise="w"):
    call = call_of(function, rows, noise=noise)
    if sensor is not None:
        call = call_of(function, rows, noise="v", positional={}, keywords={"u": 0.5})
    return TracedModel(call=call, sensor=sensor, constants={}, graph=trace(call))


def lowered(function, rows=3, fmt=BINARY32, sensor=None, angles=()):
    model = traced(function, rows, sensor=sensor)
    return lower_model(model, fmt, places_of_inputs([model]), angles)


def points(fmt=BINARY32, seed=1):
    rng = np.random.default_rng(seed)
    x, w = (fmt.round(rng.normal(scale=3.0, size=(3, POINTS))) for _ in range(2))
    return x, w, float(fmt.round(rng.normal()))


def in_place(program, x, w, u):
    """Execute f as a core does: each row of the result is written over that of x."""
    rows = {t: s.index for t, s in program.inputs if s.kind is SourceKind.STATE}
    own = {row: Temporary(1000 + row) for row in range(3)}
    place = {t: own[row] for t, row in rows.items()}
    results = {o: row for row, o in enumerate(program.outputs) if o not in rows}
    place |= {t: own[row] for t, row in results.items()}

    def moved(operand):
        return place.get(operand, operand)

    values = {own[row]: x[row] for row in range(3)}
    for temporary, source in program.inputs:
        if source.kind is SourceKind.NOISE:
            values[temporary] = w[source.index]
        elif source.kind is SourceKind.INPUT:
            values[temporary] = np.array([u])
    for step in program.steps:
        kind = type(step)
        fields = {name: getattr(step, name) for name in step.__slots__}
        execute(
            program.fmt, [kind(**{name: moved(value) for name, value in fields.items()})], values
        )
    for row, output in enumerate(program.outputs):
        assert output not in rows or rows[output] == row
        assert isinstance(output, Temporary)
    return [np.broadcast_to(values[own[row]], (POINTS,)) for row in range(3)]


def bits(values):
    return np.asarray(values, dtype=np.float64).view(np.uint64)


ENDINGS = {
    "unchanged": lambda x, w, u: x,
    "swapped": lambda x, w, u: np.array([x[1], x[0], x[2]]),
    "cycle": lambda x, w, u: np.array([x[1], x[2], x[0]]),
    "other cycle": lambda x, w, u: np.array([x[2] + w[0], x[0] * u, x[1] - x[2]]),
    "of all": lambda x, w, u: np.array([x[0] + x[1], x[1] + x[2], x[2] + x[0]]),
    "twice": lambda x, w, u: (lambda s: np.array([s, s, x[0]]))(x[1] * x[2]),
    "a result that is read": lambda x, w, u: (lambda s: np.array([s, s + x[0], s * x[1]]))(
        x[0] * x[1]
    ),
    "constants": lambda x, w, u: np.array([2.0, x[0], -0.0]),
    "numbers": lambda x, w, u: np.array([u, x[0] + u, u]),
    "noise": lambda x, w, u: np.array([w[2], w[0], w[0]]),
    "rows of others": lambda x, w, u: np.array([x[2], x[2], x[0]]),
    "choices": lambda x, w, u: np.array(
        [np.where(x[1] > 0.0, x[0], x[2]), np.where(x[0] > x[1], x[1], u), x[0]]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ENDINGS)
def test_results_are_written_in_place(name):
    """No row is read again once it has been written, whatever goes in circles."""
    program = lowered(ENDINGS[name])
    x, w, u = points()
    singles, noise, number = x.astype(np.float32), w.astype(np.float32), np.float32(u)
    expected = np.column_stack(
        [ENDINGS[name](singles[:, k], noise[:, k], number) for k in range(POINTS)]
    )
    for row, found in enumerate(in_place(program, x, w, u)):
        np.testing.assert_array_equal(bits(found), bits(expected[row]), f"row {row}")


@pytest.mark.parametrize("name", ENDINGS)
def test_results_are_written_once_and_last(name):
    program = lowered(ENDINGS[name])
    states = {t for t, s in program.inputs if s.kind is SourceKind.STATE}
    results = [o for o in program.outputs if o not in states]
    assert len(set(results)) == len(results)
    written = [step.destination for step in program.steps]
    assert sorted(written[len(written) - len(results) :], key=str) == sorted(results, key=str)
    assert all(written.count(each) == 1 for each in results)
    assert not any(each in step.reads for step in program.steps for each in results)


def test_a_row_that_stays_needs_no_step():
    assert lowered(ENDINGS["unchanged"]).steps == ()
    assert len(lowered(lambda x, w, u: np.array([x[0], x[1] + x[0], x[2]])).steps) == 1


def test_a_swap_needs_one_copy_more():
    assert len(lowered(ENDINGS["swapped"]).steps) == 3


# Products and sums.

JOINED = {
    "scalar times word": lambda x, w, u: x[0] + u * x[1],
    "minus": lambda x, w, u: x[0] - u * x[1],
    "constant factor": lambda x, w, u: x[0] + 0.3 * x[1],
    "common addend": lambda x, w, u: u + x[0] * x[1],
    "common addend minus": lambda x, w, u: u - x[0] * x[1],
    "itself": lambda x, w, u: x[0] + x[0] * x[1],
    "itself minus": lambda x, w, u: x[0] - x[1] * x[0],
    "product minus constant": lambda x, w, u: u * x[1] - 0.7,
    "both are products": lambda x, w, u: x[0] * x[1] + u * x[2],
}
SEPARATE = {
    "three words": lambda x, w, u: x[0] + x[1] * x[2],
    "product minus word": lambda x, w, u: u * x[1] - x[0],
    "two squares": lambda x, w, u: x[0] * x[0] + x[1] * x[1],
}


def only(function):
    return lambda x, w, u: np.array([function(x, w, u)])


@pytest.mark.parametrize("name", [*JOINED, *SEPARATE])
def test_joins_change_no_bit(name):
    """In binary32, where NumPy rounds as a core does."""
    function = (JOINED | SEPARATE)[name]
    program = lowered(only(function), 1, sensor="s")
    x, _, u = points()
    x[:, :3] = [[0.0, -0.0, 1.0], [-0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
    values = {}
    for temporary, source in program.inputs:
        values[temporary] = np.array([u]) if source.kind is SourceKind.INPUT else x[source.index]
    execute(BINARY32, program.steps, values)
    singles = x.astype(np.float32)
    expected = function(singles, None, np.float32(u))
    assert expected.dtype == np.float32
    found = np.broadcast_to(values[program.outputs[0]], (POINTS,)).astype(np.float32)
    np.testing.assert_array_equal(found.view(np.uint32), expected.view(np.uint32))


@pytest.mark.parametrize("name", JOINED)
def test_a_product_and_its_sum_are_one_step(name):
    program = lowered(only(JOINED[name]), 1, sensor="s")
    assert len(program.steps) == (2 if name == "both are products" else 1)
    assert program.steps[-1].form.addend in (Addend.WORD, Addend.SCALAR)


@pytest.mark.parametrize("name", SEPARATE)
def test_what_cannot_be_joined_is_not(name):
    program = lowered(only(SEPARATE[name]), 1, sensor="s")
    assert len(program.steps) == (3 if name == "two squares" else 2)


# Quotients.


def test_division_by_a_constant_is_a_product():
    program = lowered(lambda x, w, u: x / 3.0, sensor=None)
    assert all(isinstance(step, SlotStep) for step in program.steps)
    assert program.scalars == (float(np.float32(1.0 / 3.0)),)
    x, w, u = points()
    third = np.float32(1.0 / 3.0)
    for row, found in enumerate(in_place(program, x, w, u)):
        expected = x[row].astype(np.float32) * third
        np.testing.assert_array_equal(found.astype(np.float32), expected)


@pytest.mark.parametrize("divisor", [0.0, 1e-39, 1e38])
def test_division_by_a_constant_without_reciprocal_is_none(divisor):
    """Its reciprocal is not a normal number, or it is zero: then a reciprocal is computed."""
    program = lowered(lambda x, w, u: x / divisor)
    roots = [step for step in program.steps if isinstance(step, RootStep)]
    assert bool(roots) is not (divisor == 1e38 and 1.0 / divisor >= BINARY32.min_normal)


def test_a_reciprocal_is_computed_once():
    program = lowered(lambda x, w, u: np.array([x[0] / x[2], x[1] / x[2], 1.0 / x[2]]))
    assert program.streams == 1


def test_numbers_of_the_input_are_common():
    program = lowered(lambda x, w, u: np.array([x[0] / (1.0 + u), x[1], x[2]]))
    assert program.streams == 0, "the root of what all points share is not of each point"
    assert any(isinstance(step, RootStep) for step in program.steps)


# Constants.


@pytest.mark.parametrize(
    ("fmt", "value", "fits"),
    [
        (BINARY16, 65000.0, True), (BINARY16, 1e5, False), (BFLOAT16, 1e38, True),
        (BINARY32, 1e39, False), (BINARY64, 1e39, True), (BINARY16, -1e5, False),
        (BINARY16, np.inf, True),
    ],
)  # fmt: skip
def test_a_constant_beyond_the_format_is_refused(fmt, value, fits):
    def model(x, w, u):
        return np.array([np.minimum(x[0], value), x[1], x[2]])

    if fits:
        program = lowered(model, fmt=fmt)
        rounded = float(fmt.round(value))
        assert rounded in {*program.words, *program.scalars}
    else:
        with pytest.raises(FormatOverflowError, match=r"each constant of f"):
            lowered(model, fmt=fmt)


def test_signs_of_zero_are_kept_apart():
    program = lowered(lambda x, w, u: np.array([x[0] * 0.0, x[1] * -0.0, x[2]]))
    assert {np.signbit(value) for value in program.scalars} == {False, True}
    assert Constant(0.0) != Constant(-0.0)


# Angles.


def test_angles_are_wrapped_to_the_centre():
    """Whole turns away from the centre point, rows and what was measured; other rows stay."""
    program = lowered(lambda x, v, u: np.array([2.0 * x[0], x[1]]), 2, sensor="s", angles=(0,))
    ((row, measured),) = program.measurements
    assert row == 0
    x, _, _ = points()
    (z,) = (t for t, s in program.inputs if s.kind is SourceKind.MEASUREMENT)
    for centre in (0, 7, POINTS - 1):
        for observed in (-20.0, 0.3, 9.0):
            values = {t: x[s.index] for t, s in program.inputs if s.kind is SourceKind.STATE}
            values[z] = np.array([observed])
            execute(BINARY32, program.steps, values, centre)
            reference = 2.0 * x[0][centre]
            near = values[program.outputs[0]]
            assert near[centre] == pytest.approx(reference)
            for found, angle in ((near, 2.0 * x[0]), (values[measured], observed)):
                assert (np.abs(found - reference) <= np.pi + 1e-4).all()
                turns = (found - angle) / (2.0 * np.pi)
                np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)
                assert len(np.unique(np.round(turns))) > 1 or np.ndim(angle) == 0
            np.testing.assert_array_equal(values[program.outputs[1]], x[1])
