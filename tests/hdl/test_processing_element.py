"""A lane of the array against the golden model of its forms, a job on every clock."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from amaranth.back import rtlil
from amaranth.sim import Simulator

from support.unit_harness import UnitHarness
from ukf_hdl.core.processing_element import ProcessingElement
from ukf_sw.elementary.primitives import evaluate
from ukf_sw.engine.control_word import STEERING, steering
from ukf_sw.engine.timing import READ_LATENCY
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Sign
from ukf_sw.spec.parameters import Pipeline

OF_FILTER = STEERING[:3]
FORMS = [
    Form(
        multiplier=multiplier, addend=addend, reading=reading, sign=sign, subtract=subtract,
        condition=condition,
    )
    for multiplier, addend, reading, sign, subtract, condition in itertools.product(
        Multiplier, Addend, Reading, Sign, (False, True), Condition
    )
]  # fmt: skip
#: Those with a meaning in a format whose fraction is longer than its bias.
WITHOUT_EXPONENTS = [form for form in FORMS if form.reading is not Reading.EXPONENT]
#: Words of the memory with sources, and as many with destinations.
HALF = 256


def narrow(exponent_bits, fraction_bits):
    return FloatFormat(exponent_bits=exponent_bits, fraction_bits=fraction_bits)


def hostile_words(fmt, rng, count):
    """Words of all kinds, also those that no result has."""
    E, F = fmt.exponent_bits, fmt.fraction_bits
    ones = fmt.max_exponent_field
    integer = min(fmt.bias + F, ones)
    near = [fmt.bias - 1, fmt.bias, fmt.bias + 1]
    exponents = [0, 1, 2, *near, integer - 1, integer, min(integer + 1, ones), ones - 1, ones]
    fractions = [0, 1, 2, 3, 1 << (F - 1), (1 << (F - 1)) - 1, (1 << F) - 2, (1 << F) - 1]
    special = [(exponent, fraction) for exponent in exponents for fraction in fractions]
    # Integers about the middle: all that are exponents, and some beyond.
    reach = min(1 << (E - 1), (1 << (F - 1)) - 4) + 3
    ks = [-reach, -reach + 1, 1 - fmt.bias, -fmt.bias, fmt.bias - 1, fmt.bias, reach - 1, -1, 0, 1]
    ks += rng.integers(-reach, reach, count).tolist()
    middle = [(integer, ((1 << (F - 1)) + k) % (1 << F)) for k in ks]
    usual = [
        (int(exponent), int(fraction))
        for exponent, fraction in zip(
            np.concatenate([
                rng.integers(0, ones + 1, count),
                rng.integers(fmt.bias - F // 2, fmt.bias + F // 2, count).clip(1, ones - 1),
            ]),
            rng.integers(0, 1 << F, 2 * count),
            strict=True,
        )
    ]  # fmt: skip
    words = [exponent << F | fraction for exponent, fraction in special + middle + usual]
    return words + [word | 1 << (fmt.width - 1) for word in words]


@dataclass
class Jobs:
    """What a lane reads on each clock, makes of it, and what is written of it; arrays."""

    form: np.ndarray  # its place in FORMS
    address_0: np.ndarray
    address_1: np.ndarray
    scalar: np.ndarray
    destination: np.ndarray
    enable: np.ndarray
    from_bus: np.ndarray
    clear: np.ndarray
    bus: np.ndarray

    def __len__(self):
        return len(self.form)


@dataclass
class Expectation:
    """What a lane gives for each job; arrays."""

    total: np.ndarray  # the sum
    kept: np.ndarray
    written: np.ndarray  # unless it is kept
    is_finite: np.ndarray


def random_jobs(rng, pool, forms, half, rounds):
    """Sources in the first half of the memory; each round writes every word of the second once."""
    count = half * rounds
    return Jobs(
        form=rng.choice(forms, count),
        address_0=rng.integers(half, size=count),
        address_1=rng.integers(half, size=count),
        scalar=rng.choice(pool, count),
        destination=np.concatenate([half + rng.permutation(half) for _ in range(rounds)]),
        enable=rng.random(count) < 0.95,
        from_bus=rng.random(count) < 0.1,
        clear=rng.random(count) < 0.1,
        bus=rng.choice(pool, count),
    )


def expectation(fmt, jobs, memory):
    """By the golden model of the forms, form by form."""
    words = (memory[jobs.address_0], memory[jobs.address_1], jobs.scalar)
    values = [fmt.decode(row) for row in words]
    total = np.zeros(len(jobs), dtype=np.uint64)
    kept = np.zeros(len(jobs), dtype=np.bool_)
    of_finite = np.zeros(len(jobs), dtype=np.bool_)
    for index in np.unique(jobs.form):
        form, chosen = FORMS[index], jobs.form == index
        operands = [row[chosen] for row in values]
        result = evaluate(replace(form, condition=Condition.ALWAYS), fmt, *operands)
        total[chosen] = fmt.encode(result)
        # What was there tells what is kept.
        one, two = (evaluate(form, fmt, *operands, before=before) for before in (1.0, 2.0))
        kept[chosen] = (one == 1.0) & (two == 2.0)
        of_finite[chosen] = form.condition is Condition.FINITE
    written = np.where(jobs.clear, 0, total)
    kept &= ~(of_finite & jobs.clear)
    written = np.where(jobs.from_bus, jobs.bus, written).astype(np.uint64)
    kept &= ~jobs.from_bus
    infinity = np.uint64(fmt.infinity)
    return Expectation(total, kept, written, kept | (written & infinity != infinity))


def stimulus(jobs, pipeline, names, half):
    """Inputs on every clock, and when jobs and the reads of destinations start.

    The jobs of a round come back to back, then the destinations are read.
    """
    latency = READ_LATENCY + pipeline.multiply + pipeline.add
    period = half + latency + half
    rounds = len(jobs) // half
    starts = (np.arange(rounds)[:, None] * period + np.arange(half)).reshape(-1)
    reads = starts + half + latency
    clocks = rounds * period + latency
    fields = {form: steering(form) for form in FORMS}
    codes = np.array([
        sum(fields[form].get(name, 0) << place for place, name in enumerate(names))
        for form in FORMS
    ], dtype=np.uint64)  # fmt: skip

    def column(*parts):
        values = np.zeros(clocks, dtype=np.uint64)
        for at, given in parts:
            values[at] = given
        return values

    destinations = np.tile(half + np.arange(half), rounds)
    inputs = {
        "operands.address_0": column((starts, jobs.address_0), (reads, destinations)),
        "operands.address_1": column((starts, jobs.address_1)),
        "operands.scalar": column((starts + 1, jobs.scalar)),
        "operands.steering": column((starts + 1, codes[jobs.form])),
        "write.address": column((starts + latency, jobs.destination)),
        "write.enable": column((starts + latency, np.where(jobs.enable, 0xFF, 0))),
        "write.bus": column((starts + latency, jobs.bus)),
        "write.from_bus": column((starts + latency, jobs.from_bus)),
        "write.clear": column((starts + latency, jobs.clear)),
    }
    return inputs, starts, reads


def contents(jobs, expected, memory, half):
    """What the reads after every round find."""
    memory = memory.copy()
    found = []
    for start in range(0, len(jobs), half):
        part = slice(start, start + half)
        writes = (jobs.enable & ~expected.kept)[part]
        memory[jobs.destination[part][writes]] = expected.written[part][writes]
        found.append(memory[half:].copy())
    return np.concatenate(found)


def scenario(fmt, seed, names, forms, half, rounds):
    rng = np.random.default_rng(seed)
    pool = np.array(hostile_words(fmt, rng, 100), dtype=np.uint64)
    if forms is None:
        forms = FORMS
    forms = [FORMS.index(form) for form in forms if set(names).issuperset(steering(form))]
    memory = rng.choice(pool, 2 * half)
    return memory, random_jobs(rng, pool, forms, half, rounds)


def check(fmt, pipeline, seed, *, names=STEERING, forms=None, half=HALF):
    """Compare a lane with its model; give how many jobs write and how many keep."""
    memory, jobs = scenario(fmt, seed, names, forms, half, 1)
    expected = expectation(fmt, jobs, memory)
    inputs, starts, reads = stimulus(jobs, pipeline, names, half)
    dut = ProcessingElement(fmt, pipeline, memory.tolist(), names)
    ports = [
        (getattr(getattr(dut, group), name), values.tolist())
        for group, _, name in (key.partition(".") for key in inputs)
        for values in (inputs[f"{group}.{name}"],)
    ]
    ports = [(port.as_value() if hasattr(port, "as_value") else port, v) for port, v in ports]
    outputs = []

    async def testbench(ctx):
        for clock in range(len(ports[0][1])):
            for port, values in ports:
                ctx.set(port, values[clock] & (1 << len(port)) - 1)
            outputs.append((ctx.get(dut.sum), ctx.get(dut.is_finite), ctx.get(dut.word_0)))
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(testbench)
    simulator.run()
    total, is_finite, word_0 = np.array(outputs, dtype=np.uint64).T
    done = starts + READ_LATENCY + pipeline.multiply + pipeline.add
    np.testing.assert_array_equal(total[done], expected.total)
    np.testing.assert_array_equal(is_finite[done], expected.is_finite)
    np.testing.assert_array_equal(
        word_0[reads + READ_LATENCY], contents(jobs, expected, memory, half)
    )
    keeps = int(np.count_nonzero(expected.kept & jobs.enable))
    return int(np.count_nonzero(jobs.enable)) - keeps, keeps


@pytest.mark.parametrize(
    ("fmt", "pipeline"),
    [
        (BINARY32, Pipeline()),
        pytest.param(BINARY32, Pipeline(multiply=1, add=1), marks=pytest.mark.slow),
        pytest.param(BINARY16, Pipeline(multiply=3, add=4), marks=pytest.mark.slow),
        (BFLOAT16, Pipeline(multiply=1, add=3)),
        pytest.param(BINARY64, Pipeline(multiply=4, add=2), marks=pytest.mark.slow),
        (narrow(6, 17), Pipeline(multiply=2, add=1)),
        pytest.param(narrow(4, 5), Pipeline(), marks=pytest.mark.slow),
        pytest.param(narrow(4, 7), Pipeline(), marks=pytest.mark.slow),
        pytest.param(narrow(11, 5), Pipeline(), marks=pytest.mark.slow),
    ],
    ids=lambda value: value.name if isinstance(value, FloatFormat) else "",
)  # fmt: skip
def test_forms_agree_with_model(fmt, pipeline):
    writes, keeps = check(fmt, pipeline, seed=fmt.width)
    assert writes > HALF // 3
    assert keeps > HALF // 6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fmt", "multiply", "add"),
    [
        (BINARY32, 2, 2), (BINARY32, 1, 8), (BINARY16, 3, 5), (BFLOAT16, 8, 3), (BINARY64, 1, 1),
        (BINARY64, 5, 4), (narrow(6, 17), 4, 1), (narrow(4, 5), 1, 1), (narrow(5, 5), 2, 2),
        (narrow(8, 8), 2, 3), (narrow(4, 7), 3, 2), (narrow(6, 5), 2, 1), (narrow(11, 5), 1, 2),
        (narrow(5, 15), 2, 2), (narrow(4, 52), 2, 2),
    ],
    ids=lambda value: value.name if isinstance(value, FloatFormat) else str(value),
)  # fmt: skip
def test_every_form_agrees_with_model(fmt, multiply, add, tmp_path):
    """In Verilator: all forms, each with many operands."""
    half, pipeline = 4096, Pipeline(multiply=multiply, add=add)
    forms = FORMS if fmt.fraction_bits <= fmt.bias else WITHOUT_EXPONENTS
    memory, jobs = scenario(fmt, fmt.width, STEERING, forms, half, 25)
    expected = expectation(fmt, jobs, memory)
    assert len(np.unique(jobs.form)) == len(forms)
    inputs, _, reads = stimulus(jobs, pipeline, STEERING, half)
    dut = ProcessingElement(fmt, pipeline, memory.tolist(), STEERING)
    dut.stages = READ_LATENCY
    ports = [name.replace(".", "___05F") for name in inputs]
    found = UnitHarness(dut, ports, "word_0", tmp_path).run(*inputs.values())
    np.testing.assert_array_equal(found[reads], contents(jobs, expected, memory, half))
    assert np.count_nonzero(expected.kept) > len(jobs) // 6


@pytest.mark.parametrize(
    "fmt", [BINARY32, BINARY16, BFLOAT16, narrow(4, 7)], ids=lambda fmt: fmt.name
)
def test_powers_and_exponents_agree_with_model(fmt):
    """Alone, so that nothing hides them: the product of a scalar and what is read."""
    forms = [
        Form(multiplier=Multiplier.SCALAR, reading=reading, sign=sign)
        for reading in (Reading.POWER, Reading.EXPONENT)
        for sign in Sign
    ]
    check(fmt, Pipeline(multiply=1, add=1), seed=3, forms=forms)


def test_no_integer_of_a_format_is_a_power():
    """With a fraction longer than the bias, only infinity and NaN give other than zero."""
    forms = [Form(reading=Reading.POWER, sign=sign) for sign in Sign]
    check(narrow(4, 8), Pipeline(), seed=4, forms=forms)


@pytest.mark.parametrize(
    "present",
    [
        (),
        ("minus_zero",),
        pytest.param(("scalar_addend",), marks=pytest.mark.slow),
        pytest.param(("one", "clear_sign"), marks=pytest.mark.slow),
        pytest.param(("power",), marks=pytest.mark.slow),
        ("exponent", "turn_bit_1"),
        ("clear_sign", "copy_sign"),
        pytest.param(("turn_bit_0",), marks=pytest.mark.slow),
        pytest.param(("if_negative",), marks=pytest.mark.slow),
        ("if_not_negative", "exponent"),
        pytest.param(("if_odd",), marks=pytest.mark.slow),
        ("if_finite",),
    ],
    ids=lambda present: "+".join(present) or "filter",
)
def test_a_lane_may_have_some_fields_only(present):
    names = tuple(name for name in STEERING if name in OF_FILTER + present)
    fmt = narrow(5, 6)
    forms = [form for form in FORMS if set(names).issuperset(steering(form))]
    used = {name for form in forms for name in steering(form)}
    assert used == set(names)
    pipeline = Pipeline(multiply=1, add=1)
    _, keeps = check(fmt, pipeline, seed=len(forms), names=names, half=128)
    assert bool(keeps) == any(name.startswith("if_") for name in present)


def test_a_lane_of_the_filter_has_no_reader():
    pipeline = Pipeline()
    assert "reader" in rtlil.convert(ProcessingElement(BINARY16, pipeline, [0] * 4, STEERING))
    assert "reader" not in rtlil.convert(ProcessingElement(BINARY16, pipeline, [0] * 4, OF_FILTER))


def test_random_words_are_of_every_kind():
    fmt = BINARY32
    words = np.array(hostile_words(fmt, np.random.default_rng(0), 50), dtype=np.uint64)
    values = fmt.decode(words)
    magnitude = words & np.uint64((1 << 31) - 1)
    low = 2.0**fmt.fraction_bits
    assert np.any((magnitude > 0) & (magnitude < 1 << 23))
    assert np.any(np.isnan(values) & (magnitude != fmt.nan))
    assert np.any(words == fmt.nan | 1 << 31)
    assert np.any(np.isinf(values))
    assert np.count_nonzero((values >= low) & (values < 2 * low)) > 50
