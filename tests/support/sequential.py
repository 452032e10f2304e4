"""Programs executed one operation after the other, as if each took no time.

That is what a program means; schedules, control words and hardware must agree with it. It needs
NumPy only, so with :data:`PLAIN` it computes what the core does where there is no golden model.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ukf_sw.engine.operations import Kind
from ukf_sw.engine.pivots import noise_exponent
from ukf_sw.engine.reciprocal_sqrt import ReciprocalSqrtParams
from ukf_sw.spec.parameters import Form
from ukf_sw.spec.registers import ErrorCode

__all__ = ["PLAIN", "Arithmetic", "Sequential"]


class Arithmetic(NamedTuple):
    """Operations on numbers of a format, which each takes first; scalars or arrays."""

    add: Callable[..., Any]
    multiply: Callable[..., Any]
    reciprocal_sqrt: Callable[..., Any]


def _rounded(operate):
    def operation(fmt, a, b):
        # Rounding twice is harmless: float64 has twice the bits of the format, and two more.
        assert fmt.fraction_bits <= 24
        with np.errstate(over="ignore", invalid="ignore"):
            return fmt.round(operate(a, b))

    return operation


@cache
def _recipe(fmt):
    return ReciprocalSqrtParams(fmt=fmt)


def _reciprocal_sqrt(fmt, a):
    words = np.asarray(fmt.encode(a)).reshape(-1).tolist()
    return fmt.decode([_recipe(fmt).compute(word) for word in words]).reshape(np.shape(a))


#: NumPy and Python integers only, for formats of at most 24 fraction bits.
PLAIN = Arithmetic(_rounded(np.add), _rounded(np.multiply), _reciprocal_sqrt)


class Sequential:
    """Memories of an array, and operations on them.

    Parameters
    ----------
    layout
        Where the vectors are.
    fmt
        Format of the numbers.
    arithmetic
        How they are computed with.

    Attributes
    ----------
    current, next
        Memories, shape (pes, depth), of which the second takes what is written to banked words.
    nis
        Normalised innovation squared, once it is known.
    error
        Code and index of the first error, which ends execution, or zeros.
    innovation_overflow
        Whether it is that the innovation is too large for the format.
    """

    def __init__(self, layout, fmt, arithmetic):
        self.layout, self.format = layout, fmt
        self.arithmetic = arithmetic
        self.pes = layout.params.pes
        self.current = fmt.decode(layout.initial_words())
        self.next = self.current.copy()
        self.nis = None
        self.error = (0, 0)
        self.innovation_overflow = False
        self._couplings = [0.0] * layout.params.m

    def put(self, vector, values, first=0):
        for k, value in enumerate(values, start=first):
            (address, _), lane = vector.element(k)
            self.current[lane, address] = self.format.round(value)

    def get(self, vector, count, first=0):
        places = [vector.element(k) for k in range(first, first + count)]
        return np.array(
            [(self.next if bank else self.current)[lane, address]
             for (address, bank), lane in places]
        )  # fmt: skip

    def run(self, operations, mask=-1):
        scalars = {}
        for operation in operations:
            result = self._result(operation, scalars)
            lanes = np.array([operation.lanes >> lane & 1 for lane in range(self.pes)], dtype=bool)
            seen = result
            if operation.observation is not None and not mask >> operation.observation & 1:
                result = np.zeros_like(result)
            if operation.kind.is_scalar:
                scalars[operation.result] = result
                result = np.full(self.pes, result)
            error = self._check(operation, seen, result, lanes, mask)
            if error is not None:
                self.error = error
                break
            if operation.is_nis:
                self.nis = float(result[0])
            if operation.destination is not None:
                address, bank = operation.destination
                (self.next if bank else self.current)[lanes, address] = result[lanes]
            if operation.root is not None:
                root = self.arithmetic.reciprocal_sqrt(self.format, result)
                self.current[:, operation.root[0]] = root
        return scalars

    def _check(self, operation, seen, result, lanes, mask):
        """Look for an error as the engine does; gives its code and index, or None."""
        observations = self.layout.params.m
        if operation.coupling is not None:
            largest = max(self._couplings[operation.coupling], abs(float(seen)))
            self._couplings[operation.coupling] = largest
        if operation.pivot is not None:
            row, value = operation.pivot, float(seen)
            if row < observations:
                if self._is_noise(value, self._couplings[row]):
                    return int(ErrorCode.SINGULAR_OBSERVATION), row
                if not value > 0.0 and (mask >> row & 1 or value != 0.0):
                    return int(ErrorCode.SINGULAR_OBSERVATION), row
            elif not (value > 0.0 or (value == 0.0 and self._zero_pivot_is_legal)):
                return int(ErrorCode.NOT_POSITIVE_DEFINITE), row - observations
            if value == np.inf:
                return int(ErrorCode.NOT_FINITE), 0
        kept = lanes | operation.kind.is_scalar
        bad = kept & ~np.isfinite(result)
        rhs_lane = self.layout.elimination_rhs % self.pes
        others = bad & ~(operation.innovation & (np.arange(self.pes) == rhs_lane))
        self.innovation_overflow = bool(bad.any()) and (operation.is_nis or not others.any())
        return (int(ErrorCode.NOT_FINITE), 0) if bad.any() else None

    def _is_noise(self, pivot, coupling):
        if not (0.0 < pivot < np.inf and coupling > 0.0):
            return False
        smallest = 2 * math.floor(math.log2(coupling)) - noise_exponent(self.layout.params)
        return math.floor(math.log2(pivot)) < smallest

    @property
    def _zero_pivot_is_legal(self):
        return self.layout.params.form is Form.SQUARE_ROOT

    def _word(self, word):
        return np.zeros(self.pes) if word is None else self.current[:, word[0]]

    def _result(self, operation, scalars) -> Any:
        fmt, (add, multiply, _) = self.format, self.arithmetic
        beat = operation.beats[0]
        c, b = self._word(beat.word_0), self._word(beat.word_1)
        if operation.kind is Kind.LOAD:
            return c[beat.lanes.bit_length() - 1]
        if operation.kind is Kind.MULTIPLY:
            return add(fmt, 0.0, multiply(fmt, c, b))
        if operation.kind is Kind.DOT:
            total = 0.0
            for beat in operation.beats:
                products = multiply(fmt, self._word(beat.word_0), self._word(beat.word_1))
                counted = [beat.lanes >> lane & 1 for lane in range(self.pes)]
                terms = np.where(counted, products, 0.0)
                while len(terms) > 1:
                    paired = len(terms) // 2 * 2
                    sums = add(fmt, terms[:paired:2], terms[1:paired:2])
                    terms = np.append(sums, terms[paired:])
                total = float(add(fmt, terms[0], total))
            return total
        product = multiply(fmt, scalars[operation.scalar], b)
        result = add(fmt, c, -product if operation.subtract else product)
        return float(result[-1]) if operation.kind is Kind.SCALE else result
