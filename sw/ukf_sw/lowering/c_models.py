"""Programs of models as functions in C, bit for bit what a core computes.

::

    files = c_files({"f": models.f, "h": models.h[0][0]}, prefix="ukf_model")

gives ``ukf_model.h`` and ``ukf_model.c`` with ``ukf_model_f()`` and ``ukf_model_h()``. A function
takes what one sigma point has and gives its rows of the result, which may be those of `x`::

    void ukf_model_f(const float x[], const float noise[], const float u[], float result[]);

The files need nothing else, and no flags: a compiler that would fuse operations is told not to, and
``-ffast-math`` is refused. Numbers are float if that has all numbers of the format, else double.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from ukf_sw.lowering.c_arithmetic import check_format, helpers, literal, number_type, suffix
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.forms import Addend, Condition, Multiplier, Reading, Root, Sign
from ukf_sw.spec.model_programs import (
    Constant,
    ModelProgram,
    Operand,
    PickStep,
    RootStep,
    SlotStep,
    SourceKind,
    Temporary,
)

__all__ = ["c_files", "c_source"]

#: Parameters of a function with what they are; an observation is none of them.
_ARRAYS = {SourceKind.STATE: "x", SourceKind.NOISE: "noise", SourceKind.INPUT: "u"}

_ROOTS = {Root.PLAIN: "reciprocal_sqrt", Root.SIGNED: "signed_reciprocal_sqrt"}
#: What turns b, from word 0.
_TURNS = {
    Sign.COPY: "is_negative({})",
    Sign.BIT_0: "has_bit({}, 0)",
    Sign.BIT_1: "has_bit({}, 1)",
}
#: What a write depends on, from word 1.
_CONDITIONS = {
    Condition.NEGATIVE: "is_negative({})",
    Condition.NOT_NEGATIVE: "!is_negative({})",
    Condition.ODD: "has_bit({}, 0)",
}


def c_source(program: ModelProgram, name: str, *, inputs: Sequence[str] = ()) -> str:
    """Write one function, without the helpers that it calls.

    Parameters
    ----------
    program
        What it computes.
    name
        Its name.
    inputs
        Names of the numbers in region U, for its comment.

    Raises
    ------
    ValueError
        If the name is none in C; or if C cannot execute the program, because of its format, of a
        step or an input that only a core has, or of a temporary that nothing has written.
    """
    _check(program, name)
    lines = _Body(program).lines()
    return "\n".join(
        [
            f"/*\n{_comment(program, inputs)}\n */",
            _signature(program.fmt, name),
            "{",
            *(f"    (void){array};" for array in _ARRAYS.values() if array not in _used(lines)),
            *(f"    {line}" for line in lines),
            "}\n",
        ]
    )


def c_files(
    programs: Mapping[str, ModelProgram],
    *,
    prefix: str = "ukf_model",
    inputs: Sequence[str] = (),
) -> dict[str, str]:
    """Write functions with all that they need.

    Parameters
    ----------
    programs
        What they compute, by the end of their names.
    prefix
        How the names of files and functions begin.
    inputs
        Names of the numbers in region U, for the comments.

    Returns
    -------
    dict
        Texts of a header and a source by the names of the files.

    Raises
    ------
    ValueError
        As :func:`c_source`; or if there is no program, or they have several formats.
    """
    formats = {program.fmt.name for program in programs.values()}
    if len(formats) != 1:
        raise ValueError(f"programs must have one format, not {', '.join(sorted(formats))!r}")
    fmt = next(iter(programs.values())).fmt
    named = {f"{prefix}_{name}": program for name, program in programs.items()}
    source = "\n".join(c_source(program, name, inputs=inputs) for name, program in named.items())
    prototypes = "\n".join(
        f"/**\n{_comment(program, inputs)}\n */\n{_signature(fmt, name)};\n"
        for name, program in named.items()
    )
    guard = f"{prefix.upper()}_H"
    header = f"""\
/**
 * @file
 * @brief Models, bit for bit as a core with numbers of {fmt.name} computes them.
 *
 * A function takes the numbers of one sigma point, and what all have, and gives its numbers of the
 * result. Subnormal numbers are read as zeros and never given. `result` may be one of the others.
 */
#ifndef {guard}
#define {guard}

#ifdef __cplusplus
extern "C" {{
#endif

{prototypes}
#ifdef __cplusplus
}}
#endif

#endif
"""
    text = f'#include "{prefix}.h"\n\n{helpers(fmt, source)}\n{source}'
    return {f"{prefix}.h": header, f"{prefix}.c": text}


def _check(program: ModelProgram, name: str) -> None:
    """Refuse what has no C."""
    if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
        raise ValueError(f"names must be identifiers of C, not {name!r}")
    check_format(program.fmt)
    for step in program.steps:
        if isinstance(step, PickStep):
            raise ValueError(f"steps of {program.title} must be of one sigma point, not {step!r}")
    for _, source in program.inputs:
        if source.kind not in _ARRAYS:
            raise ValueError(f"inputs of {program.title} must be x, noise or u, not {source!r}")


def _signature(fmt: FloatFormat, name: str) -> str:
    number = number_type(fmt)
    arrays = [f"const {number} {array}[]" for array in _ARRAYS.values()]
    start = f"void {name}("
    line = f"{start}{', '.join(arrays)}, {number} result[])"
    if len(line) < 100:
        return line
    return f",\n{' ' * len(start)}".join([start + arrays[0], *arrays[1:], f"{number} result[])"])


def _comment(program: ModelProgram, inputs: Sequence[str]) -> str:
    """Give the lines of a comment: the title, and what is read and written."""
    read: dict[str, list[int]] = {}
    for _, source in program.inputs:
        read.setdefault(_ARRAYS[source.kind], []).append(source.index)
    extents = [f"{array}[0..{max(read[array])}]" for array in _ARRAYS.values() if array in read]
    lines = [
        program.title,
        f"From {', '.join(extents) or 'nothing'}: result[0..{len(program.outputs) - 1}].",
    ]
    lines += [
        f"u[{index}]: {inputs[index]}" for index in sorted(read.get("u", ())) if index < len(inputs)
    ]
    return "\n".join(f" * {' '.join(line.split()).replace('*/', '* /')}" for line in lines)


def _used(lines: Sequence[str]) -> set[str]:
    """Give the arrays that are read."""
    return set(re.findall(r"\b(\w+)\[", "\n".join(lines)))


def _reads(step: SlotStep | RootStep) -> set[Temporary]:
    """Give the temporaries that matter for what a step writes."""
    if isinstance(step, RootStep):
        return {step.source}
    form = step.form
    operands = {
        step.word_0 if form.uses_word_0 else None,
        step.word_1 if form.uses_word_1 else None,
        step.scalar if form.uses_scalar else None,
        step.destination if form.condition is not Condition.ALWAYS else None,
    }
    return {operand for operand in operands if isinstance(operand, Temporary)}


class _Body:
    """The statements of a function.

    Temporaries are variables of the same number; what has no part in a result is left out.
    """

    def __init__(self, program: ModelProgram) -> None:
        self._fmt = program.fmt
        self._program = program
        self._suffix = suffix(program.fmt)
        self._holder = "float" if self._suffix else "double"
        self._declared: set[Temporary] = set()
        self._needed: set[Temporary] = set()
        self._steps = self._needed_steps()
        writes = Counter(temporary for temporary, _ in program.inputs)
        writes.update(step.destination for step in self._steps)
        self._once = {temporary for temporary, count in writes.items() if count == 1}

    def _needed_steps(self) -> list[SlotStep | RootStep]:
        """Give the steps that have a part in a result; leaves the inputs that have in _needed."""
        needed = {output for output in self._program.outputs if isinstance(output, Temporary)}
        steps: list[SlotStep | RootStep] = []
        for step in reversed(self._program.steps):
            if isinstance(step, PickStep) or step.destination not in needed:
                continue
            steps.append(step)
            needed.discard(step.destination)
            needed |= _reads(step)
        self._needed = needed
        return steps[::-1]

    def lines(self) -> list[str]:
        """Give them."""
        lines: list[str] = []
        for temporary, source in self._program.inputs:
            if temporary in self._needed:
                value = f"input({_ARRAYS[source.kind]}[{source.index}])"
                lines += self._assigned(temporary, value)
        for step in self._steps:
            lines += self._slot(step) if isinstance(step, SlotStep) else self._root(step)
        for row, output in enumerate(self._program.outputs):
            lines.append(f"result[{row}] = output({self._text(output)});")
        return lines

    def _text(self, operand: Operand | None) -> str:
        """Write an operand; one that is not given is a zero."""
        if isinstance(operand, Temporary):
            if operand not in self._declared:
                raise ValueError(
                    f"temporaries of {self._program.title} must be written before they are read, "
                    f"not {operand!r}"
                )
            return f"t{operand.number}"
        return literal(self._fmt, operand.value if isinstance(operand, Constant) else 0.0)

    def _assigned(self, destination: Temporary, value: str) -> list[str]:
        variable = f"t{destination.number}"
        if destination in self._declared:
            return [f"{variable} = {value};"]
        self._declared.add(destination)
        const = "const " if destination in self._once else ""
        return [f"{const}{self._holder} {variable} = {value};"]

    def _root(self, step: RootStep) -> list[str]:
        return self._assigned(step.destination, f"{_ROOTS[step.root]}({self._text(step.source)})")

    def _slot(self, step: SlotStep) -> list[str]:
        value = self._value(step)
        condition = step.form.condition
        if condition is Condition.ALWAYS:
            return self._assigned(step.destination, value)
        lines: list[str] = []
        if step.destination not in self._declared:
            self._once.discard(step.destination)
            lines += self._assigned(step.destination, "NAN")
        variable = f"t{step.destination.number}"
        if condition is Condition.FINITE:
            return [*lines, f"{variable} = if_finite({value}, {variable});"]
        return [
            *lines,
            f"if ({_CONDITIONS[condition].format(self._text(step.word_1))}) {{",
            f"    {variable} = {value};",
            "}",
        ]

    def _value(self, step: SlotStep) -> str:
        """Write c + a * b; products with one and sums with zero are what they leave as it is."""
        product = self._product(step)
        addend = step.form.addend
        if addend is Addend.MINUS_ZERO:
            return product
        if addend is Addend.PLUS_ZERO:
            return f"0.0{self._suffix} + {product}"
        return (
            f"add({self._text(step.word_0 if addend is Addend.WORD else step.scalar)}, {product})"
        )

    def _product(self, step: SlotStep) -> str:
        form = step.form
        a = self._text(step.word_0 if form.multiplier is Multiplier.WORD else step.scalar)
        if form.reading is Reading.ONE:
            if form.sign in _TURNS:
                a = f"turned_if({self._turn(step)}, {a})"
            return _negated(a) if form.subtract else a
        b = self._text(step.word_1)
        if form.reading is Reading.POWER:
            b = f"power({b})"
        elif form.reading is Reading.EXPONENT:
            b = f"exponent({b})"
        if form.sign is Sign.CLEAR:
            b = f"absolute({b})"
        elif form.sign is Sign.COPY:
            b = f"with_sign_of({self._text(step.word_0)}, {b})"
        elif form.sign is not Sign.KEEP:
            b = f"turned_if({self._turn(step)}, {b})"
        if form.subtract:
            b = _negated(b)
        return b if a == literal(self._fmt, 1.0) else f"multiply({a}, {b})"

    def _turn(self, step: SlotStep) -> str:
        return _TURNS[step.form.sign].format(self._text(step.word_0))


def _negated(text: str) -> str:
    return text[1:] if text.startswith("-") else f"-{text}"
