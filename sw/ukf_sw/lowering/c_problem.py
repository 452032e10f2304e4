"""A problem for the filter in C: its models as ``ukf_model.c``, and what calls them there.

::

    files = c_problem_files(software_models(problem))

gives, beside the two files of :mod:`ukf_sw.lowering.c_models`, ``ukf_problem.h`` and
``ukf_problem.c``: a ``struct ukf_models`` with the sensors, their noise terms and angles, and
functions that round what the filter gives to the format of the core, call the models, and give back
what these give. What models take beside sigma points is one vector
(:class:`ukf_sw.tracing.inputs.InputVector`), the input of ``ukf_predict()``.
"""

from collections.abc import Mapping, Sequence
from string import Template
from typing import cast

from ukf_sw.c_sources import CORE, CNames
from ukf_sw.lowering.c_arithmetic import number_type
from ukf_sw.lowering.c_models import c_files
from ukf_sw.lowering.software import SoftwareModels
from ukf_sw.problem import ONLY
from ukf_sw.spec.float_format import BINARY32, BINARY64
from ukf_sw.spec.model_programs import ModelProgram, SourceKind

__all__ = ["c_problem_files"]


def c_problem_files(models: SoftwareModels, core: str = CORE) -> dict[str, str]:
    """Write a problem in C for a core; models that the core has are left out.

    Parameters
    ----------
    models
        Programs of the models. Their problem says which of them the core has.
    core
        Name of the core.

    Returns
    -------
    dict
        Texts by name of the file.

    Raises
    ------
    ValueError
        If the format is not one that the filter in C has, or C cannot execute a program.
    """
    if models.fmt not in (BINARY32, BINARY64):
        raise ValueError(
            f"format must be one that C has, binary32 or binary64, not {models.fmt.name!r}"
        )
    names = CNames(core=core)
    writer = _Writer(models, names)
    files = {f"{names.problem}.h": writer.header(), f"{names.problem}.c": writer.source()}
    programs = writer.programs
    if programs:
        files |= c_files(programs, prefix=names.model, inputs=models.inputs.labels)
    return files


def _room(count: int) -> int:
    """Length of an array, which C does not allow to be 0."""
    return max(count, 1)


def _mask(rows: Sequence[int]) -> str:
    return f"{sum(1 << row for row in rows):#x}u"


def _reads(program: ModelProgram, kind: SourceKind) -> int:
    """How many numbers of a kind a program reads, up to the last one of them."""
    return max((source.index + 1 for _, source in program.inputs if source.kind is kind), default=0)


_HEADER = Template("""\
/**
 * @file
 * @brief The problem $problem for the filter in C: what ukf_open() takes as models.
 *
 * Written for the core of $core.h. The models compute in its format, $format; those that the core
 * has are not here.
 */
#ifndef $guard
#define $guard

#include "ukf_filter.h"

#ifdef __cplusplus
extern "C" {
#endif

/**
 * Numbers of an input.$labels
 */
#define $inputs ${count}u

/** The models, with their sensors and angles. */
extern const struct ukf_models $name;

/**
 * @brief Give the numbers that the models take beside sigma points, $inputs of them.
 *
 * ukf_predict() does it with its input, unless that is NULL. So what belongs to an observation may
 * be given when it is known, between the predict and the update. There is one place for them: for
 * one filter at a time.
 */
void ${name}_set(const ukf_real *input);

#ifdef __cplusplus
}
#endif

#endif
""")

_GIVEN = Template("""\
/** What the models are given beside sigma points. */
static struct {
    bool is_set;
    $number numbers[$room];
$choices} given;

""")

# As the driver rounds what it writes.
_ROUND_BINARY32 = """\
/** Round to the format of the core. */
static void round_numbers(const ukf_real *from, uint32_t count, float *to)
{
    for (uint32_t i = 0; i < count; i++) {
        const double number = (double)from[i];

        /* What is below the smallest normal number after rounding, with the exponent unbounded. */
        to[i] = fabs(number) < 0x1p-126 - 0x1p-151 ? copysignf(0.0f, (float)number)
                                                   : (float)number;
    }
}

"""

_ROUND_BINARY64 = """\
/** The models round to the format of the core. */
static void round_numbers(const ukf_real *from, uint32_t count, double *to)
{
    for (uint32_t i = 0; i < count; i++) {
        to[i] = (double)from[i];
    }
}

"""

_GIVE = Template("""\
static void give(const $number *from, uint32_t count, ukf_real *to)
{
    for (uint32_t i = 0; i < count; i++) {
        to[i] = (ukf_real)from[i];
    }
}

""")


class _Writer:
    """The texts of a problem."""

    def __init__(self, models: SoftwareModels, names: CNames) -> None:
        self._models = models
        self._problem = models.problem
        self._names = names
        self._number = number_type(models.fmt)
        on_core = models.problem.models
        self._f: ModelProgram | None = None if on_core.f is not None else models.f
        self._h: Mapping[str, tuple[ModelProgram, ...]] = {} if on_core.h else models.h
        #: Numbers of the input that are not the choice of a model.
        self._numbers = len(models.inputs.u) + len(models.inputs.arguments)
        #: Sensors whose model is chosen by a number.
        self._chosen = tuple(models.inputs.choices) if self._h else ()

    @property
    def programs(self) -> dict[str, ModelProgram]:
        """What is written as models, by the ends of the names."""
        found = {} if self._f is None else {"f": self._f}
        for sensor, variants in self._h.items():
            for number, program in enumerate(variants):
                found[self._function(sensor, number)] = program
        return found

    def _function(self, sensor: str, variant: int) -> str:
        stem = "h" if sensor == ONLY else f"h_{sensor}"
        return stem if len(self._models.h[sensor]) == 1 else f"{stem}_{variant}"

    # Header.

    def header(self) -> str:
        """Write the header."""
        labels = list(self._models.inputs.labels)
        named = cast("dict[str, str]", self._problem.inputs)
        if len(named) == len(self._models.inputs.u):
            for number, (name, unit) in enumerate(named.items()):
                labels[number] += f", {name}" + (f" in {unit}" if unit else "")
        lines = (
            f"\n * - input[{number}]: {' '.join(label.split()).replace('*/', '* /')}"
            for number, label in enumerate(labels)
        )
        name = self._names.problem
        return _HEADER.substitute(
            problem=self._problem.name.replace("*/", "* /"),
            core=self._names.core,
            format=self._models.fmt.name,
            guard=f"{name.upper()}_H",
            inputs=f"{name.upper()}_INPUTS",
            labels="".join(lines),
            count=len(labels),
            name=name,
        )

    # Source.

    def source(self) -> str:
        """Write the source."""
        name, core = self._names.problem, self._names.core
        text = f'#include "{name}.h"\n\n#include <math.h>\n#include <stddef.h>\n\n'
        text += f'#include "{core}.h"\n'
        if self.programs:
            text += f'#include "{self._names.model}.h"\n'
        text += f"\n{self._checks()}\n"
        if self.programs:
            text += self._given()
            text += _ROUND_BINARY32 if self._models.fmt == BINARY32 else _ROUND_BINARY64
            text += _GIVE.substitute(number=self._number)
        text += self._set()
        if self._is_told:
            text += self._on_predict()
        if self._f is not None:
            text += self._process(self._f)
        for sensor, variants in self._h.items():
            text += self._observe(sensor, variants)
        return text + self._struct()

    def _checks(self) -> str:
        p, prefix = self._problem.params, self._names.stem.upper()
        sizes = {
            "N": p.n, "M": p.m, "Q": p.q, "R": p.r,
            "SENSORS": sum(1 << p.rows_of(sensor).start for sensor in range(len(p.sensor_rows))),
            "FRACTION_BITS": self._models.fmt.fraction_bits,
        }  # fmt: skip
        return "".join(
            f'_Static_assert({prefix}_{size} == {value}u, "this is another core");\n'
            for size, value in sizes.items()
        )

    def _given(self) -> str:
        choices = "".join(f"    uint32_t model_of_{sensor};\n" for sensor in self._chosen)
        if not (self._numbers or choices):
            return ""
        return _GIVEN.substitute(number=self._number, room=_room(self._numbers), choices=choices)

    def _set(self) -> str:
        """Write the function that takes the input."""
        lines: list[str] = []
        if self.programs and self._numbers:
            lines.append(f"round_numbers(input, {self._numbers}u, given.numbers);")
        for place, sensor in enumerate(self._chosen, self._numbers):
            number, count = f"input[{place}]", len(self._models.inputs.choices[sensor])
            lines.append(f"given.model_of_{sensor} =")
            lines.append(
                f"    {number} >= 0 && {number} < {count} ? (uint32_t){number} : {count}u;"
            )
        lines.append("given.is_set = true;" if lines else "(void)input;")
        return _function(f"void {self._names.problem}_set(const ukf_real *input)", lines)

    @property
    def _is_told(self) -> bool:
        """Whether the models here take something beside sigma points."""
        return bool(self.programs and (self._numbers or self._chosen))

    def _on_predict(self) -> str:
        """Write what a predict calls before all else."""
        lines = ["(void)context;", "if (input != NULL) {"]
        lines += [f"    {self._names.problem}_set(input);", "}"]
        return _function("static void on_predict(void *context, const void *input)", lines)

    def _process(self, program: ModelProgram) -> str:
        lines = self._arguments(program, "w")
        lines += ["(void)context;", "(void)input;", *self._call(program, "f", "w", "next")]
        return _function(
            "static bool process(void *context, const ukf_real *x, const ukf_real *w, "
            "const void *input,\n                    ukf_real *next)",
            [*lines, "return true;"],
        )

    def _observe(self, sensor: str, variants: tuple[ModelProgram, ...]) -> str:
        largest = max(variants, key=lambda program: _reads(program, SourceKind.NOISE))
        lines = [*self._arguments(largest, "v"), "(void)context;"]
        if sensor not in self._chosen:
            lines += [*self._call(variants[0], self._function(sensor, 0), "v", "z"), "return true;"]
        else:
            lines += ["if (!given.is_set) {", "    return false;", "}"]
            for number, program in enumerate(variants):
                call = self._call(program, self._function(sensor, number), "v", "z")
                lines += [
                    f"if (given.model_of_{sensor} == {number}u) {{",
                    *(f"    {line}" for line in call),
                    "    return true;",
                    "}",
                ]
            lines.append("return false;")
        return _function(
            f"static bool observe_{sensor}(void *context, const ukf_real *x, const ukf_real *v, "
            "ukf_real *z)",
            lines,
        )

    def _arguments(self, program: ModelProgram, noise: str) -> list[str]:
        """Declare what a model takes, in its numbers."""
        terms = _reads(program, SourceKind.NOISE)
        arrays = [f"state[{self._problem.params.n}]", f"result[{len(program.outputs)}]"]
        arrays += [f"noise[{terms}]"] if terms else []
        return [f"{self._number} {', '.join(arrays)};", "", *([] if terms else [f"(void){noise};"])]

    def _call(self, program: ModelProgram, function: str, noise: str, result: str) -> list[str]:
        """Call a model with what the filter has given."""
        terms, own = _reads(program, SourceKind.NOISE), _reads(program, SourceKind.INPUT)
        lines: list[str] = []
        if own:
            lines += ["if (!given.is_set) {", "    return false;", "}"]
        lines.append(f"round_numbers(x, {self._problem.params.n}u, state);")
        if terms:
            lines.append(f"round_numbers({noise}, {terms}u, noise);")
        numbers = ("noise" if terms else "NULL", "given.numbers" if own else "NULL")
        lines.append(f"{self._names.model}_{function}(state, {', '.join(numbers)}, result);")
        lines.append(f"give(result, {len(program.outputs)}u, {result});")
        return lines

    def _struct(self) -> str:
        """Write what the filter takes."""
        lines: list[str] = []
        for number, name in enumerate(self._problem.sensor_names):
            angles = cast("tuple[int, ...]", self._problem.sensor(name).angles)
            observe = f"observe_{name}" if name in self._h else "NULL"
            lines.append(
                f"    {{.observe = {observe}, .terms = {len(self._problem.terms_of(number))}u, "
                f".angles = {_mask(angles)}}},"
            )
        process = "NULL" if self._f is None else "process"
        told = "on_predict" if self._is_told else "NULL"
        angles = _mask(cast("tuple[int, ...]", self._problem.state_angles))
        return (
            "static const struct ukf_sensor sensors[] = {\n" + "\n".join(lines) + "\n};\n\n"
            f"const struct ukf_models {self._names.problem} = {{\n    .process = {process},\n"
            f"    .sensors = sensors,\n    .state_angles = {angles},\n"
            f"    .on_predict = {told},\n}};\n"
        )


def _function(signature: str, lines: Sequence[str]) -> str:
    body = "\n".join(f"    {line}" if line else "" for line in lines)
    return f"{signature}\n{{\n{body}\n}}\n\n"
