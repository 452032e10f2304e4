"""Sequences of issue slots: what an elementary function is made of, and the builder of one.

Every step is one issue slot a beat, or the stream of one word's numbers through the unit 1/sqrt.
Steps run in order. A temporary is a word of every lane; it may be written again, and a step with a
condition writes some of its lanes only.

    builder = SequenceBuilder(BINARY32)
    x = builder.input()
    square = builder.product(x, x)
    sequence = builder.finish(square)
    (squares,) = sequence.evaluate([1.0, 2.0, 3.0])
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sw.elementary.execution import execute
from ukf_sw.elementary.primitives import round_constant
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Root, Sign
from ukf_sw.spec.model_programs import (
    Constant,
    Operand,
    PickStep,
    RootStep,
    SlotStep,
    Step,
    Temporary,
)

__all__ = ["Sequence", "SequenceBuilder"]


@dataclass(frozen=True, kw_only=True)
class Sequence:
    """Steps that compute some outputs from some inputs.

    Parameters
    ----------
    fmt
        Number format.
    inputs, outputs
        Temporaries; an output may also be a constant.
    steps
        In order.
    """

    fmt: FloatFormat
    inputs: tuple[Temporary, ...]
    outputs: tuple[Operand, ...]
    steps: tuple[Step, ...]

    @property
    def slots(self) -> int:
        """Issue slots of every beat, without the loads."""
        return sum(isinstance(step, SlotStep) for step in self.steps)

    @property
    def loads(self) -> int:
        """How many words stream through the unit 1/sqrt, a load for every column."""
        return sum(isinstance(step, RootStep) for step in self.steps)

    @property
    def scalars(self) -> frozenset[float]:
        """Constants that are scalars."""
        return frozenset(
            step.scalar.value
            for step in self.steps
            if isinstance(step, SlotStep) and isinstance(step.scalar, Constant)
        )

    @property
    def words(self) -> frozenset[float]:
        """Constants that are words, the same in every lane."""
        return frozenset(
            word.value
            for step in self.steps
            if isinstance(step, SlotStep)
            for word in (step.word_0, step.word_1)
            if isinstance(word, Constant)
        )

    @property
    def forms(self) -> frozenset[Form]:
        """What its slots compute."""
        return frozenset(step.form for step in self.steps if isinstance(step, SlotStep))

    def evaluate(self, *inputs: ArrayLike) -> tuple[NDArray[np.float64], ...]:
        """Give the outputs, bit for bit as the array computes them.

        Parameters
        ----------
        inputs
            Numbers of the format, an array for each input, of shapes that broadcast. Subnormal
            ones read as zeros, as do those of words.

        Returns
        -------
        tuple of arrays
            An array for each output, of the common shape.

        Raises
        ------
        ValueError
            If there are more or fewer arrays than inputs, or a number is not one of the format.
        """
        if len(inputs) != len(self.inputs):
            raise ValueError(f"inputs must be {len(self.inputs)} arrays, not {len(inputs)!r}")
        arrays = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in inputs))
        shape = arrays[0].shape if arrays else ()
        values: dict[Temporary, NDArray[np.float64]] = {}
        for temporary, array in zip(self.inputs, arrays, strict=True):
            number = self.fmt.round(array.ravel())
            tiny = np.abs(array.ravel()) < self.fmt.min_normal
            wrong = (number != array.ravel()) & ~np.isnan(number) & ~tiny
            if wrong.any():
                worst = float(array.ravel()[wrong][0])
                raise ValueError(f"inputs must be numbers of {self.fmt.name}, not {worst!r}")
            values[temporary] = number

        execute(self.fmt, self.steps, values)
        count = int(np.prod(shape, dtype=np.int64))
        return tuple(
            np.broadcast_to(
                values[output] if isinstance(output, Temporary) else output.value, (count,)
            ).reshape(shape)
            for output in self.outputs
        )


class SequenceBuilder:
    """Collects the steps of a sequence, in order.

    A method that computes something adds one step and gives the temporary that it writes: a new
    one, or `into`. Constants may be given as numbers; they are rounded to the format.

    Parameters
    ----------
    fmt
        Number format.
    """

    def __init__(self, fmt: FloatFormat) -> None:
        self.fmt = fmt
        self.steps: list[Step] = []
        self._inputs: list[Temporary] = []
        self._count = 0

    def _temporary(self) -> Temporary:
        self._count += 1
        return Temporary(self._count - 1)

    def input(self) -> Temporary:
        """Give a new input."""
        self._inputs.append(self._temporary())
        return self._inputs[-1]

    def finish(self, *outputs: Operand) -> Sequence:
        """Give the sequence that has been built."""
        return Sequence(
            fmt=self.fmt, inputs=tuple(self._inputs), outputs=outputs, steps=tuple(self.steps)
        )

    def constant(self, value: float) -> Constant:
        """Give a constant, rounded to the format."""
        return Constant(round_constant(self.fmt, value))

    def _operand(self, value: Operand | float | None) -> Operand | None:
        return self.constant(value) if isinstance(value, int | float) else value

    def slot(
        self,
        form: Form,
        word_0: Operand | float | None = None,
        word_1: Operand | float | None = None,
        scalar: Operand | float | None = None,
        *,
        into: Temporary | None = None,
    ) -> Temporary:
        """Add one issue slot.

        Raises
        ------
        ValueError
            If an operand that the form uses is missing, or one is given that it does not use, or
            if it has a condition and nothing to keep.
        """
        for name, given, used in (
            ("word 0", word_0, form.uses_word_0),
            ("word 1", word_1, form.uses_word_1),
            ("scalar", scalar, form.uses_scalar),
        ):
            if (given is not None) is not used:
                raise ValueError(f"{name} must be {'given' if used else 'left out'}, not {given!r}")
        if form.condition is not Condition.ALWAYS and into is None:
            raise ValueError(f"into must be given with a condition, not {into!r}")
        destination = into or self._temporary()
        self.steps.append(
            SlotStep(
                form=form, destination=destination, word_0=self._operand(word_0),
                word_1=self._operand(word_1),
                scalar=self._operand(scalar),
            )
        )  # fmt: skip
        return destination

    def root(self, source: Temporary, root: Root) -> Temporary:
        """Send the numbers of a word through the unit 1/sqrt."""
        destination = self._temporary()
        self.steps.append(RootStep(root=root, destination=destination, source=source))
        return destination

    def pick(self, source: Temporary) -> Temporary:
        """Give the number of the sigma point that angles are wrapped to."""
        destination = self._temporary()
        self.steps.append(PickStep(destination=destination, source=source))
        return destination

    def product(
        self,
        a: Operand | float,
        b: Operand | float,
        *,
        sign: Sign = Sign.KEEP,
        reading: Reading = Reading.NUMBER,
        addend: Addend = Addend.MINUS_ZERO,
        negate: bool = False,
        condition: Condition = Condition.ALWAYS,
        into: Temporary | None = None,
    ) -> Temporary:
        """Give a * b, or -a * b; a is word 0."""
        form = Form(addend=addend, sign=sign, reading=reading, subtract=negate, condition=condition)
        return self.slot(form, a, b, into=into)

    def scaled(
        self,
        s: Operand | float,
        b: Operand | float,
        *,
        plus: Operand | float | None = None,
        subtract: bool = False,
        sign: Sign = Sign.KEEP,
        sign_of: Operand | None = None,
        reading: Reading = Reading.NUMBER,
        condition: Condition = Condition.ALWAYS,
        into: Temporary | None = None,
    ) -> Temporary:
        """Give plus + s * b; minus zero + s * b, if there is nothing to add."""
        form = Form(
            multiplier=Multiplier.SCALAR, addend=Addend.MINUS_ZERO if plus is None else Addend.WORD,
            sign=sign, reading=reading, subtract=subtract, condition=condition,
        )  # fmt: skip
        return self.slot(form, sign_of if plus is None else plus, b, s, into=into)

    def sum(self, a: Operand | float, b: Operand | float, *, subtract: bool = False) -> Temporary:
        """Give a + b or a - b."""
        return self.scaled(1.0, b, plus=a, subtract=subtract)

    def product_plus(
        self,
        s: Operand | float,
        a: Operand | float,
        b: Operand | float,
        *,
        subtract: bool = False,
        sign: Sign = Sign.KEEP,
    ) -> Temporary:
        """Give s + a * b or s - a * b."""
        form = Form(addend=Addend.SCALAR, subtract=subtract, sign=sign)
        return self.slot(form, a, b, s)

    def grown(
        self,
        a: Operand,
        b: Operand,
        *,
        condition: Condition = Condition.ALWAYS,
        into: Temporary | None = None,
    ) -> Temporary:
        """Give a + a * b."""
        return self.slot(Form(addend=Addend.WORD, condition=condition), a, b, into=into)

    def shifted(
        self,
        a: Operand,
        s: Operand | float,
        *,
        subtract: bool = False,
        sign: Sign = Sign.KEEP,
        condition: Condition = Condition.ALWAYS,
        where: Operand | None = None,
        into: Temporary | None = None,
    ) -> Temporary:
        """Give a + s or a - s; with :attr:`Sign.COPY`, s has the sign of a."""
        form = Form(
            multiplier=Multiplier.SCALAR, addend=Addend.WORD, reading=Reading.ONE, sign=sign,
            subtract=subtract, condition=condition,
        )  # fmt: skip
        return self.slot(form, a, where, s, into=into)

    def reflected(
        self,
        s: Operand | float,
        a: Operand,
        *,
        condition: Condition = Condition.ALWAYS,
        where: Operand | None = None,
        into: Temporary | None = None,
    ) -> Temporary:
        """Give s - a."""
        form = Form(addend=Addend.SCALAR, reading=Reading.ONE, subtract=True, condition=condition)
        return self.slot(form, a, where, s, into=into)

    def complement(self, s: Operand | float, b: Operand) -> Temporary:
        """Give s - s * abs(b)."""
        form = Form(
            multiplier=Multiplier.SCALAR, addend=Addend.SCALAR, sign=Sign.CLEAR, subtract=True
        )
        return self.slot(form, None, b, s)

    def copied(
        self,
        a: Operand | float,
        *,
        negate: bool = False,
        sign: Sign = Sign.KEEP,
        condition: Condition = Condition.ALWAYS,
        where: Operand | None = None,
        into: Temporary | None = None,
    ) -> Temporary:
        """Give a, or -a; with :attr:`Sign.COPY`, its magnitude."""
        form = Form(reading=Reading.ONE, sign=sign, subtract=negate, condition=condition)
        return self.slot(form, a, where, into=into)

    def signed_one(
        self,
        s: Operand | float,
        sign_of: Operand,
        *,
        negate: bool = False,
        condition: Condition = Condition.ALWAYS,
        where: Operand | None = None,
        into: Temporary | None = None,
    ) -> Temporary:
        """Give s with the sign of a word, or the other one; s is positive."""
        form = Form(
            multiplier=Multiplier.SCALAR, reading=Reading.ONE, sign=Sign.COPY, subtract=negate,
            condition=condition,
        )  # fmt: skip
        return self.slot(form, sign_of, where, s, into=into)

    def polynomial(self, coefficients: tuple[float, ...], z: Operand) -> Operand:
        """Give the polynomial with coefficients of rising powers, by Horner's rule."""
        if len(coefficients) == 1:
            return self.constant(coefficients[0])
        *rest, before, last = coefficients
        result = self.scaled(last, z, plus=before)
        for coefficient in reversed(rest):
            result = self.product_plus(coefficient, result, z)
        return result
