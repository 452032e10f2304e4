"""A lane of the array against the golden model of its forms, a job on every clock."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from amaranth.back import rtlil
from amaranth.sim import Simulator

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
#: Sources are in the first half of the memory, destinations in the second.
HALF = 512
JOBS = 400


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
class Job:
    """What the lane reads, makes of it, and what is written of it."""

    form: Form
    address_0: int
    address_1: int
    scalar: int
    destination: int
    enable: bool
    from_bus: bool
    clear: bool
    bus: int


def random_jobs(fmt, rng, pool, forms):
    destinations = HALF + rng.permutation(HALF)[:JOBS]
    return [
        Job(
            form=forms[rng.integers(len(forms))],
            address_0=int(rng.integers(HALF)), address_1=int(rng.integers(HALF)),
            scalar=int(rng.choice(pool)), destination=int(destination),
            enable=bool(rng.random() < 0.95), from_bus=bool(rng.random() < 0.1),
            clear=bool(rng.random() < 0.1), bus=int(rng.choice(pool)),
        )
        for destination in destinations
    ]  # fmt: skip


def expectation(fmt, job, memory):
    """Sum, whether it or what is in its place is written, that, and whether it counts as finite."""
    words = [memory[job.address_0], memory[job.address_1], job.scalar]
    values = fmt.decode(np.array(words, dtype=np.uint64))
    # What is kept is told from the sum by what was there.
    first, second = (
        int(fmt.encode(evaluate(job.form, fmt, *values, before=before))[0]) for before in (1, 2)
    )
    always = Form(
        multiplier=job.form.multiplier, addend=job.form.addend, reading=job.form.reading,
        sign=job.form.sign, subtract=job.form.subtract,
    )  # fmt: skip
    total = int(fmt.encode(evaluate(always, fmt, *values))[0])
    keeps = first != second
    written = 0 if job.clear else total
    if job.form.condition is Condition.FINITE and job.clear:
        keeps = False
    if job.from_bus:
        keeps, written = False, job.bus
    is_finite = keeps or written & fmt.infinity != fmt.infinity
    return total, job.enable and not keeps, written, is_finite


async def drive(ctx, dut, pipeline, jobs, steering_names, expected):
    """A job on every clock; every sum is checked on its clock."""
    latency = READ_LATENCY + pipeline.multiply + pipeline.add
    for clock in range(len(jobs) + latency):
        if clock < len(jobs):
            ctx.set(dut.operands.address_0, jobs[clock].address_0)
            ctx.set(dut.operands.address_1, jobs[clock].address_1)
        if 1 <= clock <= len(jobs):
            job = jobs[clock - 1]
            high = steering(job.form)
            ctx.set(dut.operands.scalar, job.scalar)
            ctx.set(dut.operands.steering, {name: high.get(name, 0) for name in steering_names})
        ctx.set(dut.write.enable, 0)
        if clock >= latency:
            job = jobs[clock - latency]
            total, _, _, is_finite = expected[clock - latency]
            ctx.set(dut.write.address, job.destination)
            ctx.set(dut.write.enable, -1 if job.enable else 0)
            ctx.set(dut.write.from_bus, job.from_bus)
            ctx.set(dut.write.clear, job.clear)
            ctx.set(dut.write.bus, job.bus)
            assert ctx.get(dut.sum) == total, job
            assert ctx.get(dut.is_finite) == is_finite, job
        await ctx.tick()
    ctx.set(dut.write.enable, 0)


async def read_all(ctx, dut, steering_names):
    found = []
    ctx.set(dut.operands.steering, dict.fromkeys(steering_names, 0))
    for clock in range(2 * HALF + READ_LATENCY):
        ctx.set(dut.operands.address_0, clock % (2 * HALF))
        if clock >= READ_LATENCY:
            found.append(ctx.get(dut.word_0))
        await ctx.tick()
    return found


def check(fmt, pipeline, seed, *, steering_names=STEERING, rounds=1, forms=None):
    """Compare a lane with its model; give how many jobs wrote and how many kept."""
    rng = np.random.default_rng(seed)
    pool = hostile_words(fmt, rng, 100)
    if forms is None:
        forms = [form for form in FORMS if set(steering_names).issuperset(steering(form))]
    memory = [int(word) for word in rng.choice(np.array(pool, dtype=np.uint64), 2 * HALF)]
    dut = ProcessingElement(fmt, pipeline, memory, steering_names)
    memory = list(memory)
    wrote, kept = 0, 0

    async def testbench(ctx):
        nonlocal wrote, kept
        for _ in range(rounds):
            jobs = random_jobs(fmt, rng, pool, forms)
            expected = [expectation(fmt, job, memory) for job in jobs]
            await drive(ctx, dut, pipeline, jobs, steering_names, expected)
            for job, (_, writes, written, _) in zip(jobs, expected, strict=True):
                if writes:
                    memory[job.destination] = written
                wrote += writes
                kept += job.enable and not writes
            assert await read_all(ctx, dut, steering_names) == memory

    simulator = Simulator(dut)
    simulator.add_clock(1e-8)
    simulator.add_testbench(testbench)
    simulator.run()
    return wrote, kept


@pytest.mark.parametrize(
    ("fmt", "pipeline"),
    [
        (BINARY32, Pipeline()),
        (BINARY32, Pipeline(multiply=1, add=1)),
        (BINARY16, Pipeline(multiply=3, add=4)),
        (BFLOAT16, Pipeline(multiply=1, add=3)),
        (BINARY64, Pipeline(multiply=4, add=2)),
        (narrow(6, 17), Pipeline(multiply=2, add=1)),
        (narrow(4, 5), Pipeline()),
        (narrow(4, 7), Pipeline()),
        (narrow(11, 5), Pipeline()),
    ],
    ids=lambda value: value.name if isinstance(value, FloatFormat) else "",
)  # fmt: skip
def test_forms_agree_with_model(fmt, pipeline):
    wrote, kept = check(fmt, pipeline, seed=fmt.width)
    assert wrote > JOBS // 3
    assert kept > JOBS // 6


@pytest.mark.slow
@pytest.mark.parametrize(
    "fmt",
    [
        BINARY16, BFLOAT16, BINARY32, BINARY64, narrow(6, 17), narrow(4, 5), narrow(5, 5),
        narrow(8, 8), narrow(4, 7), narrow(6, 5), narrow(11, 5), narrow(5, 15), narrow(11, 52),
    ],
    ids=lambda fmt: fmt.name,
)  # fmt: skip
@pytest.mark.parametrize(("multiply", "add"), [(1, 1), (1, 8), (2, 2), (3, 5), (8, 3)])
def test_every_form_agrees_with_model(fmt, multiply, add):
    pipeline = Pipeline(multiply=multiply, add=add)
    assert min(check(fmt, pipeline, seed=multiply * add, rounds=20)) > 5 * JOBS


@pytest.mark.parametrize("reading", [Reading.POWER, Reading.EXPONENT])
@pytest.mark.parametrize(
    "fmt", [BINARY32, BINARY16, BFLOAT16, narrow(4, 7), narrow(8, 8), narrow(11, 5)],
    ids=lambda fmt: fmt.name,
)  # fmt: skip
def test_powers_and_exponents_agree_with_model(fmt, reading):
    """Alone, so that nothing hides them: the product of one and what is read."""
    forms = [
        Form(multiplier=Multiplier.SCALAR, reading=reading, sign=sign, condition=condition)
        for sign in Sign
        for condition in (Condition.ALWAYS, Condition.NEGATIVE)
    ]
    check(fmt, Pipeline(multiply=1, add=1), seed=3, forms=forms)


def test_no_integer_of_a_format_is_a_power():
    """With a fraction longer than the bias, only infinity and NaN are not zero."""
    forms = [Form(reading=Reading.POWER, sign=sign) for sign in Sign]
    check(narrow(4, 8), Pipeline(), seed=4, forms=forms)
    check(narrow(4, 9), Pipeline(), seed=5, forms=forms)


@pytest.mark.parametrize(
    "present",
    [
        (),
        ("minus_zero",),
        ("scalar_addend",),
        ("one", "clear_sign"),
        ("power",),
        ("exponent", "turn_bit_1"),
        ("clear_sign", "copy_sign"),
        ("turn_bit_0",),
        ("if_negative",),
        ("if_not_negative", "exponent"),
        ("if_odd",),
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
    _, kept = check(fmt, Pipeline(multiply=1, add=1), seed=len(forms), steering_names=names)
    assert bool(kept) == any(name.startswith("if_") for name in present)


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
