"""Fixtures of the software tests."""

import numpy as np
import pytest

from ukf_sw.engine.arithmetic import add, multiply, reciprocal_sqrt
from ukf_sw.engine.operations import Kind


class Sequential:
    """Executes operations one after the other, as if each took no time.

    That is what a program means; schedules, control words and hardware must agree with it.
    """

    def __init__(self, layout, fmt):
        self.layout, self.format = layout, fmt
        self.pes = layout.params.pes
        self.current = fmt.decode(layout.initial_words())
        self.next = self.current.copy()
        self.nis = None

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
            if operation.observation is not None and not mask >> operation.observation & 1:
                result = np.zeros_like(result)
            if operation.kind.is_scalar:
                scalars[operation.result] = result
                result = np.full(self.pes, result)
            if operation.is_nis:
                self.nis = float(result[0])
            lanes = np.array([operation.lanes >> lane & 1 for lane in range(self.pes)], dtype=bool)
            if operation.destination is not None:
                address, bank = operation.destination
                (self.next if bank else self.current)[lanes, address] = result[lanes]
            if operation.root is not None:
                self.current[:, operation.root[0]] = reciprocal_sqrt(self.format, result)
        return scalars

    def _word(self, word):
        return np.zeros(self.pes) if word is None else self.current[:, word[0]]

    def _result(self, operation, scalars):
        fmt = self.format
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
                terms = list(np.where(counted, products, 0.0))
                while len(terms) > 1:
                    odd = terms[len(terms) // 2 * 2 :]
                    pairs = zip(terms[::2], terms[1::2], strict=False)
                    terms = [float(add(fmt, x, y)) for x, y in pairs] + odd
                total = float(add(fmt, terms[0], total))
            return total
        product = multiply(fmt, scalars[operation.scalar], b)
        result = add(fmt, c, -product if operation.subtract else product)
        return float(result[-1]) if operation.kind is Kind.SCALE else result


@pytest.fixture
def sequential():
    return Sequential
