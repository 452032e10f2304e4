"""Programs of models as C, bit for bit as the golden model executes them."""

import itertools
import re
import subprocess

import numpy as np
import pytest

from support.c_model_programs import dtype, execute_c, execute_golden, words
from ukf_sim.c_in_the_loop.compiler import CompilerError, Toolchain, compile_c
from ukf_sw.elementary.coefficients import coefficients
from ukf_sw.elementary.functions import FUNCTIONS
from ukf_sw.lowering.c_arithmetic import literal
from ukf_sw.lowering.c_models import c_files, c_source
from ukf_sw.spec.float_format import BINARY16, BINARY32, BINARY64, FORMATS, FloatFormat
from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Root, Sign
from ukf_sw.spec.model_programs import (
    Constant,
    ModelProgram,
    PickStep,
    RootStep,
    SlotStep,
    Source,
    SourceKind,
    Temporary,
)
from ukf_tools.arm.emulator import arm_available

needs_cc = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")
needs_arm = pytest.mark.skipif(
    not arm_available(), reason="gcc-arm-linux-gnueabihf or qemu-user is not installed"
)
POINTS = 1000
#: Many points, in parts that fit in memory.
MANY, PARTS = 100_000, 10
#: A compiler that may fuse operations, for the processor that it is on.
FUSED = ("-O3", "-march=native", "-ffp-contract=fast")
#: What the user of a small processor writes, and one that has fused operations.
ARM_FUSED = ("-O3", "-mcpu=cortex-a7", "-mfpu=neon-vfpv4", "-ffp-contract=fast")
FORMS = [
    Form(
        multiplier=multiplier, addend=addend, reading=reading, sign=sign, subtract=subtract,
        condition=condition,
    )
    for multiplier, addend, reading, sign, subtract, condition in itertools.product(
        Multiplier, Addend, Reading, Sign, (False, True), Condition
    )
]  # fmt: skip
#: Formats by the way in which C computes in them; the others are in the exhaustive tests.
OTHERS = [
    pytest.param(FloatFormat.from_name(name), id=name, marks=[] if quick else [pytest.mark.slow])
    for name, quick in {
        "binary64": True, "binary16": True, "bfloat16": False,
        "float6.17": True, "float5.24": False, "float11.20": False, "float8.5": False,
        "float4.5": False, "float11.5": True,
        "float6.25": True, "float4.27": False,
    }.items()
]  # fmt: skip


def has_integers(fmt):
    """Whether readings of powers and exponents mean something."""
    return fmt.fraction_bits <= fmt.bias


# Programs.


def elementary(fmt):
    """Every elementary function, with its arguments as x."""
    programs = {}
    for name, function in FUNCTIONS.items():
        sequence = function.sequence(fmt)
        programs[name] = ModelProgram(
            title=name, fmt=fmt, steps=sequence.steps, outputs=sequence.outputs,
            inputs=tuple(
                (temporary, Source(SourceKind.STATE, row))
                for row, temporary in enumerate(sequence.inputs)
            ),
        )  # fmt: skip
    return programs


def sources():
    """Four rows of x, two of the noise and two numbers of u."""
    kinds = [SourceKind.STATE] * 4 + [SourceKind.NOISE] * 2 + [SourceKind.INPUT] * 2
    return tuple(
        (Temporary(number), Source(kind, kinds[:number].count(kind)))
        for number, kind in enumerate(kinds)
    )


def random_programs(fmt, rng, share=0.1, length=32):
    """A share of all forms, with random operands; everything that is written is a result."""
    forms = [
        form for form in FORMS
        if has_integers(fmt) or form.reading in (Reading.NUMBER, Reading.ONE)
    ]  # fmt: skip
    steps = [*forms, *(list(Root) * 40)]
    rng.shuffle(steps)
    steps = steps[: round(share * len(steps))]
    numbers = [0.0, -0.0, 1.0, -1.0, 2.0, np.nan, np.inf, -np.inf, fmt.min_normal, fmt.max_finite]
    numbers += fmt.round(rng.standard_normal(10)).tolist()

    def program(number, steps):
        inputs = sources()
        known = [temporary for temporary, _ in inputs]

        def operand(used=True):
            if not used:
                return None
            if rng.random() < 0.2:
                return Constant(float(rng.choice(numbers)))
            # Results of results are often NaN.
            return known[rng.integers(len(known) if rng.random() < 0.4 else len(inputs))]

        made = []
        for step in steps:
            writes = (
                Temporary(len(known)) if rng.random() < 0.7 else known[rng.integers(len(known))]
            )
            if isinstance(step, Root):
                source = known[rng.integers(len(known))]
                made.append(RootStep(root=step, destination=writes, source=source))
            else:
                made.append(
                    SlotStep(
                        form=step, destination=writes, word_0=operand(step.uses_word_0),
                        word_1=operand(step.uses_word_1), scalar=operand(step.uses_scalar),
                    )
                )  # fmt: skip
            if writes not in known:
                known.append(writes)
        outputs = (*known, Constant(1.5), Constant(-0.0))
        return ModelProgram(
            title=f"{number}", fmt=fmt, inputs=inputs, steps=tuple(made), outputs=outputs
        )

    return {
        f"random_{start}": program(start, steps[start : start + length])
        for start in range(0, len(steps), length)
    }


# Points.


def hostile(fmt, rng, shape):
    """Numbers of all sizes, near 1, specials, integers as they are read, subnormal ones and NaN."""
    E, F, sign = fmt.exponent_bits, fmt.fraction_bits, 1 << (fmt.width - 1)
    specials = np.array(
        [
            0, fmt.bias << F, fmt.infinity, 1 << F, fmt.infinity - 1, fmt.nan, (fmt.bias + 1) << F,
            *((((fmt.bias + F) << F) + k for k in (-1, 0, (1 << F) - 1, 1 << F))
              if has_integers(fmt) else ()),
        ],
        dtype=np.uint64,
    )  # fmt: skip
    fractions = np.where(
        rng.random(shape) < 0.3,
        rng.choice([0, 1, 2, (1 << F) - 1, (1 << F) - 2, 1 << (F - 1)], shape),
        rng.integers(0, 1 << F, shape),
    ).astype(np.uint64)
    wide = rng.integers(1, fmt.max_exponent_field, shape).astype(np.uint64) << np.uint64(F)
    near = rng.integers(fmt.bias - 3, fmt.bias + 4, shape).astype(np.uint64) << np.uint64(F)
    k = rng.integers(-(1 << (min(E, F) - 1)) - 3, (1 << (min(E, F) - 1)) + 3, shape)
    formed = ((fmt.bias + F) << F) + np.clip((1 << (F - 1)) + k, 0, (1 << F) - 1)
    kinds = [wide | fractions, near | fractions, rng.choice(specials, shape)]
    kinds.append(formed.astype(np.uint64) if has_integers(fmt) else kinds[0])
    chosen = np.choose(rng.choice(4, shape, p=[0.25, 0.4, 0.15, 0.2]), kinds)
    chosen |= np.where(rng.random(shape) < 0.5, 0, sign).astype(np.uint64)
    with_neighbours(fmt, rng, chosen, fractions)
    values = fmt.decode(chosen).astype(dtype(fmt))

    # What is no number of the format: subnormal ones, and NaN with signs and other bits.
    tiny = fmt.min_normal * rng.integers(1, 1 << F, shape) * fmt.epsilon
    values = np.where(rng.random(shape) < 0.02, tiny * rng.choice([-1, 1], shape), values)
    values = values.astype(dtype(fmt))
    bits = words(values)
    payload = rng.integers(1, 1 << 20, shape).astype(bits.dtype)
    payload |= rng.integers(0, 2, shape).astype(bits.dtype) << bits.dtype.type(
        8 * bits.itemsize - 1
    )
    bits[:] = np.where(np.isnan(values), bits | payload, bits)
    return values


def with_neighbours(fmt, rng, words, fractions):
    """Pairs, in columns side by side, of products near the smallest number and small differences."""
    F = np.uint64(fmt.fraction_bits)
    first, second = words[:, :-1], words[:, 1:]
    exponent = (first >> F & np.uint64(fmt.max_exponent_field)).astype(np.int64)
    others = fmt.bias + 1 - exponent + rng.integers(-3, 3, exponent.shape)
    fits = (others > 0) & (others < fmt.max_exponent_field) & (rng.random(others.shape) < 0.2)
    product = np.where(fits, others, 0).astype(np.uint64) << F | fractions[:, 1:]
    second[:] = np.where(fits, product, second)
    close = rng.random(others.shape) < 0.1
    difference = rng.integers(-2, 3, others.shape).astype(np.uint64)
    turn = np.uint64(1 << (fmt.width - 1))
    near = (first ^ turn) + difference
    second[:] = np.where(
        close & (exponent > 0) & (exponent < fmt.max_exponent_field - 1), near, second
    )


def make_points(fmt, rng, count):
    return {
        kind: hostile(fmt, rng, (count, columns))
        for kind, columns in (("x", 4), ("noise", 2), ("u", 2))
    }


def compare(programs, fmt, folder, seed, *, count=POINTS, **options):
    """Demand equal bits."""
    points = make_points(fmt, np.random.default_rng(seed), count)
    found = execute_c(programs, points, folder, **options)
    numbers = 0
    for name, program in programs.items():
        expected = execute_golden(program, points)
        different = words(found[name]) != words(expected)
        assert not different.any(), said(program, points, found[name], expected, different)
        usual = np.isfinite(expected) & (expected != 0.0)
        numbers += np.count_nonzero(usual)
        # A function of nothing but NaN and zeros would prove little.
        assert usual.any() or not usual.size, name
    return numbers


def said(program, points, found, expected, different):
    """Name the first difference."""
    row, column = np.argwhere(different)[0]
    point = {kind: table[row].tolist() for kind, table in points.items()}
    return (
        f"{program.title} result[{column}] of {point}: {found[row, column].item()!r}, "
        f"not {expected[row, column].item()!r}; {np.count_nonzero(different)} differ"
    )


# Equal bits.


def programs_of(fmt, **options):
    """Elementary functions, if there are any of the format, and random programs."""
    programs = random_programs(fmt, np.random.default_rng(fmt.width), **options)
    return (elementary(fmt) if fmt in FORMATS.values() else {}) | programs


@needs_cc
@pytest.mark.parametrize("flags", [("-O2",), FUSED], ids=["O2", "fused"])
def test_binary32(flags, tmp_path):
    """Whether the compiler may fuse operations or not."""
    assert compare(programs_of(BINARY32), BINARY32, tmp_path, 1, flags=flags) > 50 * POINTS


@needs_cc
@pytest.mark.parametrize("fmt", OTHERS)
def test_other_formats(fmt, tmp_path):
    assert compare(programs_of(fmt), fmt, tmp_path, 2, flags=FUSED) > 40 * POINTS


@needs_arm
@pytest.mark.parametrize("fmt", [BINARY32, BINARY64], ids=lambda fmt: fmt.name)
@pytest.mark.parametrize(
    "flags", [pytest.param(("-O2",), marks=pytest.mark.slow), ARM_FUSED], ids=["O2", "fused"]
)
def test_on_the_arm(fmt, flags, tmp_path):
    """The emulated processor has no fused operations: it would stop at one."""
    compare(programs_of(fmt), fmt, tmp_path, 3, flags=flags, toolchain=Toolchain.CORTEX_A9)
