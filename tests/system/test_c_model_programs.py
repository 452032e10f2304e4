"""Programs of models as C, bit for bit as the golden model executes them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from support.c_model_programs import dtype, execute_c, execute_golden, words
from ukf_sim.c_in_the_loop.compiler import CompilerError, Toolchain, compile_c
from ukf_sw.elementary.functions import FUNCTIONS
from ukf_sw.elementary.sequence import SequenceBuilder
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
        "float6.25": False, "float5.26": True, "float4.27": False,
    }.items()
]  # fmt: skip


def has_integers(fmt):
    """Whether readings of powers and exponents mean something."""
    return fmt.fraction_bits <= fmt.bias


# Programs.


def elementary(fmt):
    """Every elementary function, with its arguments as x."""
    return {name: of_sequence(name, function.sequence(fmt)) for name, function in FUNCTIONS.items()}


def of_sequence(title, sequence):
    """A program with the inputs of a sequence as x."""
    return ModelProgram(
        title=title, fmt=sequence.fmt, steps=sequence.steps, outputs=sequence.outputs,
        inputs=tuple(
            (temporary, Source(SourceKind.STATE, row))
            for row, temporary in enumerate(sequence.inputs)
        ),
    )  # fmt: skip


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
    add_pairs(fmt, rng, chosen, fractions)
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


def add_pairs(fmt, rng, words, fractions):
    """In columns side by side: products near the smallest normal number, and small differences."""
    F, ones = np.uint64(fmt.fraction_bits), fmt.max_exponent_field
    first, second = words[:, :-1], words[:, 1:]
    exponent = (first >> F & np.uint64(ones)).astype(np.int64)
    other = fmt.bias + 1 - exponent + rng.integers(-3, 3, exponent.shape)
    fits = (other > 0) & (other < ones) & (rng.random(other.shape) < 0.2)
    product = np.where(fits, other, 0).astype(np.uint64) << F | fractions[:, 1:]
    second[:] = np.where(fits, product, second)
    fits = (exponent > 0) & (exponent < ones - 1) & (rng.random(other.shape) < 0.1)
    difference = rng.integers(-2, 3, other.shape).astype(np.uint64)
    near = (first ^ np.uint64(1 << (fmt.width - 1))) + difference
    second[:] = np.where(fits, near, second)


def make_points(fmt, rng, count):
    return {
        kind: hostile(fmt, rng, (count, columns))
        for kind, columns in (("x", 4), ("noise", 2), ("u", 2))
    }


def compare(programs, fmt, folder, seed, *, count=POINTS, **options):
    """Demand equal bits."""
    points = make_points(fmt, np.random.default_rng(seed), count)
    found = execute_c(programs, dict.fromkeys(programs, points), folder, **options)
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


def nearly_ties(fmt):
    """Pairs of numbers from 1 to 2, whose products, below 2, are next to the middle of two."""
    rng = np.random.default_rng(7)
    one = 1 << fmt.fraction_bits
    for fraction in rng.integers(0, one // 2, 200).tolist():
        a = one + (fraction | 1)
        for remainder in (one // 2 - 1, one // 2 + 1):
            b = one + remainder * pow(a, -1, one) % one
            assert a * b % one == remainder
            yield a / one, b / one


@needs_cc
@pytest.mark.parametrize("fmt", [BINARY32, *(param.values[0] for param in OTHERS)],
                         ids=lambda fmt: fmt.name)  # fmt: skip
def test_limits(fmt, tmp_path):
    """Pairs of numbers next to limits, and those whose sums or products are next to ties."""
    ulp = fmt.epsilon
    middle = (1 - fmt.bias) // 2
    exponents = [1 - fmt.bias, 2 - fmt.bias, middle - 1, middle, -1, 0, 1, fmt.bias - 2]
    exponents += [fmt.bias - 1, fmt.bias]
    # In the last place of the largest of these, and below it.
    exponents += [max(fmt.bias - 1 - fmt.precision - k, 1 - fmt.bias) for k in (0, 1)]
    significands = [1.0, 1 + ulp, 1 + 2 * ulp, 1.5 - ulp, 1.5, 2 - 2 * ulp, 2 - ulp]
    numbers = [np.ldexp(s, e) for s, e in itertools.product(significands, exponents)]
    numbers += [0.0, np.inf, np.nan]
    if has_integers(fmt):
        k = np.array(
            [-fmt.bias - 1, -fmt.bias, -fmt.bias + 1, fmt.bias - 2, fmt.bias - 1, fmt.bias]
        )
        k = k[np.abs(k) < 2 ** (fmt.fraction_bits - 1)]
        numbers += [2.0**fmt.fraction_bits, 2.0 ** (fmt.fraction_bits + 1)]
        numbers += (1.5 * 2.0**fmt.fraction_bits + k).tolist()
    numbers = np.array(numbers)
    numbers = np.concatenate([numbers, -numbers])
    pairs = [*itertools.product(numbers, numbers), *nearly_ties(fmt)]
    points = np.array(pairs, dtype(fmt))

    builder = SequenceBuilder(fmt)
    x, y = builder.input(), builder.input()
    results = [builder.product(x, y), builder.sum(x, y), builder.grown(x, y)]
    results += [builder.root(y, root) for root in Root]
    # 0.0 - abs(y), in one step and in two.
    for addend in (Addend.PLUS_ZERO, Addend.MINUS_ZERO):
        results.append(builder.product(1.0, y, sign=Sign.CLEAR, addend=addend, negate=True))
    results.append(builder.sum(0.0, results[-1]))
    absolute = builder.product(1.0, y, sign=Sign.CLEAR)
    results.append(builder.sum(0.0, absolute, subtract=True))
    if has_integers(fmt):
        results += [
            builder.product(x, y, reading=reading) for reading in (Reading.POWER, Reading.EXPONENT)
        ]
    program = of_sequence("limits", builder.finish(*results))
    none = np.zeros((len(points), 0), dtype(fmt))
    points = {"x": points, "noise": none, "u": none}
    found = execute_c({"limits": program}, {"limits": points}, tmp_path, flags=FUSED)["limits"]
    expected = execute_golden(program, points)
    different = words(found) != words(expected)
    assert not different.any(), said(program, points, found, expected, different)


@needs_cc
@pytest.mark.slow
def test_every_form(tmp_path):
    programs = random_programs(BINARY32, np.random.default_rng(5), share=1.0)
    forms = {form for program in programs.values() for form in program.forms}
    assert len(forms) == len(FORMS)
    assert compare(programs, BINARY32, tmp_path, 5, flags=("-O2",)) > 400 * POINTS


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize("flags", [("-O2",), ("-O3",)], ids=["O2", "O3"])
@pytest.mark.parametrize("fmt", [BINARY32, BINARY64, BINARY16], ids=lambda fmt: fmt.name)
def test_many_points(fmt, flags, tmp_path):
    for part in range(PARTS):
        compare(
            programs_of(fmt, share=0.03), fmt, tmp_path, 100 + part, count=MANY // PARTS,
            flags=flags,
        )  # fmt: skip


@needs_cc
@pytest.mark.parametrize("fmt", OTHERS)
def test_other_formats(fmt, tmp_path):
    assert compare(programs_of(fmt), fmt, tmp_path, 2, flags=FUSED) > 20 * POINTS


@needs_arm
@pytest.mark.parametrize("fmt", [BINARY32, BINARY64], ids=lambda fmt: fmt.name)
@pytest.mark.parametrize(
    "flags", [pytest.param(("-O2",), marks=pytest.mark.slow), ARM_FUSED], ids=["O2", "fused"]
)
def test_on_the_arm(fmt, flags, tmp_path):
    """The emulated processor has no fused operations: it would stop at one."""
    compare(programs_of(fmt), fmt, tmp_path, 3, flags=flags, toolchain=Toolchain.CORTEX_A9)


# What is written.


def example(fmt=BINARY32):
    """A program with all kinds of inputs, one that nothing needs, and a step that nothing needs."""
    builder = SequenceBuilder(fmt)
    x, noise, u, _ = (builder.input() for _ in range(4))
    total = builder.scaled(0.5, noise, plus=x)
    builder.product(total, total)
    builder.copied(u, negate=True, condition=Condition.NEGATIVE, where=x, into=total)
    made = of_sequence("f of an example", builder.finish(total, x, Constant(2.0)))
    kinds = [SourceKind.STATE, SourceKind.NOISE, SourceKind.INPUT, SourceKind.INPUT]
    inputs = tuple(
        (temporary, Source(kind, number))
        for number, ((temporary, _), kind) in enumerate(zip(made.inputs, kinds, strict=True))
    )
    return replace(made, inputs=inputs)


def test_a_function_is_for_people():
    assert (
        c_source(example(), "ukf_model_f", inputs=("dt", "", "a * b*/c"))
        == """\
/*
 * f of an example
 * From x[0..0], noise[0..1], u[0..3]: result[0..2].
 * u[2]: a * b* /c
 */
void ukf_model_f(const float x[], const float noise[], const float u[], float result[])
{
    const float t0 = input(x[0]);
    const float t1 = input(noise[1]);
    const float t2 = input(u[2]);
    float t4 = add(t0, multiply(0.5f, t1));
    if (is_negative(t0)) {
        t4 = -t2;
    }
    result[0] = output(t4);
    result[1] = output(t0);
    result[2] = output(2.0f);
}
"""
    )


@pytest.mark.parametrize(
    ("fmt", "type_"), [("binary32", "float"), ("float6.17", "float"), ("float6.25", "double")]
)
def test_numbers_are_float_if_it_has_all_of_them(fmt, type_):
    files = c_files({"f": example(FloatFormat.from_name(fmt))}, prefix="mine")
    assert list(files) == ["mine.h", "mine.c"]
    assert f"void mine_f(const {type_} x[]" in files["mine.h"]
    assert "MINE_H" in files["mine.h"]


@needs_cc
@pytest.mark.parametrize("toolchain", list(Toolchain), ids=lambda toolchain: toolchain.value)
@pytest.mark.parametrize("fmt", FORMATS.values(), ids=lambda fmt: fmt.name)
def test_it_compiles_without_a_warning(fmt, toolchain, tmp_path):
    """With the flags of our own sources, each function with just the helpers that it needs."""
    if not toolchain.available:
        pytest.skip(f"{toolchain.command[0]} is not installed")
    names = ("sqrt", "sin", "exp", "log", "less") if fmt == BINARY32 else ("log",)
    functions = elementary(fmt)
    programs = [{name: functions[name]} for name in names]
    programs.append({"nothing": of_sequence("", SequenceBuilder(fmt).finish(Constant(1.5)))})
    for number, one in enumerate(programs):
        for name, text in c_files(one).items():
            (tmp_path / name).write_text(text)
        # Small processors have no double.
        flags = ("-c", *(("-Wdouble-promotion",) if fmt == BINARY32 else ()))
        compile_c(
            [tmp_path / "ukf_model.c"], tmp_path / f"{number}.o", [tmp_path], toolchain=toolchain,
            flags=flags,
        )  # fmt: skip


@needs_cc
@pytest.mark.parametrize("flag", ["-Ofast", "-ffast-math", "-ffinite-math-only"])
def test_flags_that_change_results_are_refused(flag, tmp_path):
    for name, text in c_files({"f": example()}).items():
        (tmp_path / name).write_text(text)
    with pytest.raises(CompilerError, match="compile this file without -ffast-math"):
        compile_c(
            [tmp_path / "ukf_model.c"], tmp_path / "f.o", [tmp_path], flags=("-c", flag)
        )  # fmt: skip


# What is refused.


@pytest.mark.parametrize("name", ["float11.21", "float8.24", "float11.51"])
def test_formats_that_c_has_not(name):
    message = f"^format must be binary64 or have at most 32 bits for models in C, not '{name}'$"
    with pytest.raises(ValueError, match=message):
        c_source(example(FloatFormat.from_name(name)), "f")


@pytest.mark.parametrize("name", ["", "2f", "f-2", "é", "f("])
def test_names_that_c_has_not(name):
    with pytest.raises(ValueError, match=r"^names must be identifiers of C, not "):
        c_source(example(), name)


def test_what_only_a_core_has():
    made = example()
    pick = PickStep(destination=Temporary(9), source=Temporary(0))
    with pytest.raises(ValueError, match=r"^steps of f of an example must be of one sigma point, "):
        c_source(replace(made, steps=(*made.steps, pick)), "f")
    observed = (Temporary(9), Source(SourceKind.MEASUREMENT, 0))
    with pytest.raises(ValueError, match=r"^inputs of f of an example must be x, noise or u, not "):
        c_source(replace(made, inputs=(*made.inputs, observed)), "f")


def test_temporaries_without_a_number():
    message = r"^temporaries of f of an example must be written before they are read, not "
    with pytest.raises(ValueError, match=message):
        c_source(replace(example(), outputs=(Temporary(9),)), "f")


def test_constants_that_are_no_numbers_of_the_format():
    with pytest.raises(ValueError, match=r"^constants must be numbers of binary32, not 0\.1$"):
        c_source(replace(example(), outputs=(Constant(0.1),)), "f")


def test_programs_of_one_format():
    with pytest.raises(ValueError, match=r"must have one format, not 'binary16, binary32'$"):
        c_files({"f": example(), "h": example(BINARY16)})
    with pytest.raises(ValueError, match=r"^programs must have one format, not ''$"):
        c_files({})


@pytest.mark.parametrize("reading", [Reading.POWER, Reading.EXPONENT])
def test_readings_need_integers(reading):
    """In a format with more bits of fraction than its bias."""
    builder = SequenceBuilder(FloatFormat.from_name("float4.10"))
    power = builder.product(1.0, builder.input(), reading=reading)
    with pytest.raises(
        ValueError, match=r"^format must have integers up to 1536, not 'float4\.10'$"
    ):
        c_files({"f": of_sequence("f", builder.finish(power))})
