"""Operations of a graph as steps of the array.

The order of operations is the user's. Only what changes no bit is joined: a product and the sum
that takes it are one step, for the array rounds the product before it adds. Two operations are
defined as others that cost less, and are at least as near to the exact result: division by a
constant is multiplication by its rounded reciprocal, and integer powers are products.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ukf_sw.elementary.functions import FUNCTIONS
from ukf_sw.elementary.quotients import reciprocal
from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.elementary.trigonometric import sincos
from ukf_sw.errors import FormatOverflowError
from ukf_sw.spec.forms import Addend, Form
from ukf_sw.spec.model_programs import Constant, Operand, Temporary
from ukf_sw.tracing.graph import Graph, Node
from ukf_sw.tracing.operations import Operation

__all__ = ["GraphLowering"]

_SUMS = (Operation.ADD, Operation.SUBTRACT)
#: Functions that take no constants.
_OF_WORDS = (Operation.HYPOT, Operation.ARCTAN2)


class _Joined(NamedTuple):
    """A sum with the product that it takes.

    Parameters
    ----------
    operands
        Nodes c, a, b of c + a * b.
    addend
        What c is: a word, and then a is a scalar or c itself; or a scalar.
    subtract
        Whether it is c - a * b.
    turned
        Whether it is a * b - c, of a constant c.
    """

    operands: tuple[int, int, int]
    addend: Addend
    subtract: bool
    turned: bool = False


class GraphLowering:
    """Adds the steps of a graph to a builder.

    Parameters
    ----------
    builder
        Takes the steps.
    graph
        What to compute.
    title
        Of the model, for messages.

    Attributes
    ----------
    inputs : dict of int to Temporary
        Temporaries of the inputs of the graph, by the number of their node.
    """

    def __init__(self, builder: SequenceBuilder, graph: Graph, title: str) -> None:
        self._builder = builder
        self._graph = graph
        self._title = title
        self._values: dict[int, Operand] = {}
        self._reciprocals: dict[Operand, Temporary] = {}
        self._sincos: dict[Operand, tuple[Operand, ...]] = {}
        self.inputs: dict[int, Temporary] = {}
        for number, node in enumerate(graph.nodes):
            if node.source is not None:
                self.inputs[number] = self._values[number] = builder.input()
            elif node.is_constant:
                self._values[number] = self._constant(node)

    def outputs(self) -> list[Operand]:
        """Add all steps; give the results."""
        for number in self._needed():
            if number not in self._values:
                self._values[number] = self._lower(number)
        return [self._values[output] for output in self._graph.outputs]

    def _constant(self, node: Node) -> Constant:
        if isinstance(node.value, bool):
            return Constant(-1.0 if node.value else 1.0)  # what is negative is true
        assert node.value is not None
        value = float(node.value)
        rounded = self._builder.constant(value)
        if np.isfinite(value) and not np.isfinite(rounded.value):
            largest = self._builder.fmt.max_finite
            raise FormatOverflowError(f"each constant of {self._title}", value, largest)
        return rounded

    def _needed(self) -> list[int]:
        """Nodes that have steps of their own, in order: no products that are parts of sums only."""
        found: set[int] = set()
        waiting = list(self._graph.outputs)
        while waiting:
            number = waiting.pop()
            if number in found:
                continue
            found.add(number)
            joined = self._joined(number)
            waiting += self._graph.nodes[number].arguments if joined is None else joined.operands
        return sorted(found)

    def _node(self, number: int) -> Node:
        return self._graph.nodes[number]

    def _is(self, number: int, operation: Operation) -> bool:
        return self._graph.nodes[number].operation is operation

    def _is_common(self, number: int) -> bool:
        """Whether it is the same at all sigma points: it can be a scalar."""
        return not self._graph.per_point[number]

    def _joined(self, number: int) -> _Joined | None:
        """Give a sum as one step with the product that it takes; None if it takes none."""
        node = self._node(number)
        if node.operation not in _SUMS:
            return None
        first, second = node.arguments
        subtract = node.operation is Operation.SUBTRACT
        for c, product, is_first in ((first, second, False), (second, first, True)):
            if not self._is(product, Operation.MULTIPLY):
                continue
            turned = subtract and is_first  # product - c
            if turned and not self._node(c).is_constant:
                continue
            a, b = self._node(product).arguments
            negative = subtract and not turned
            for s, other in ((a, b), (b, a)):
                if self._is_common(s):
                    return _Joined((c, s, other), Addend.WORD, negative, turned)
            if self._is_common(c):
                return _Joined((c, a, b), Addend.SCALAR, negative, turned)
            for same, other in ((a, b), (b, a)):
                if c == same:
                    return _Joined((c, same, other), Addend.WORD, negative)
        return None

    def _join(self, joined: _Joined) -> Temporary:
        builder = self._builder
        c, a, b = (self._values[operand] for operand in joined.operands)
        if joined.turned:
            assert isinstance(c, Constant)
            c = Constant(-c.value)
        if joined.addend is Addend.SCALAR:
            return builder.product_plus(c, a, b, subtract=joined.subtract)
        if self._is_common(joined.operands[1]):
            return builder.scaled(a, b, plus=c, subtract=joined.subtract)
        return builder.slot(Form(addend=Addend.WORD, subtract=joined.subtract), a, b)

    def _lower(self, number: int) -> Operand:
        node, builder = self._node(number), self._builder
        joined = self._joined(number)
        if joined is not None:
            return self._join(joined)
        arguments = [self._values[argument] for argument in node.arguments]
        match node.operation:
            case Operation.ADD:
                return builder.sum(*arguments)
            case Operation.SUBTRACT:
                return builder.sum(*arguments, subtract=True)
            case Operation.NEGATIVE:
                return builder.scaled(-1.0, arguments[0])
            case Operation.MULTIPLY:
                return self._product(*arguments)
            case Operation.DIVIDE:
                return self._quotient(*arguments)
            case Operation.SIN | Operation.COS:
                return self._sine_or_cosine(node.operation, node.arguments[0], arguments[0])
            case _:
                return self._function(node.operation, arguments)

    def _product(self, a: Operand, b: Operand) -> Temporary:
        for s, other in ((a, b), (b, a)):
            if isinstance(s, Constant):
                return self._builder.scaled(s, other)
        return self._builder.product(a, b)

    def _quotient(self, a: Operand, b: Operand) -> Operand:
        builder = self._builder
        if isinstance(b, Constant) and b.value:
            inverse = builder.constant(1.0 / b.value).value
            if builder.fmt.min_normal <= abs(inverse) < np.inf:
                return self._product(Constant(inverse), a)
        if b not in self._reciprocals:
            self._reciprocals[b] = reciprocal(builder, self._word(b))
        inverse = self._reciprocals[b]
        return inverse if a == Constant(1.0) else builder.product(a, inverse)

    def _sine_or_cosine(self, operation: Operation, number: int, x: Operand) -> Operand:
        """Give one of them; both in one go, if both are needed."""
        others = {node.operation for node in self._graph.nodes if node.arguments == (number,)}
        if not others >= {Operation.SIN, Operation.COS}:
            return self._function(operation, [x])
        if x not in self._sincos:
            self._sincos[x] = sincos(self._builder, self._word(x))
        return self._sincos[x][operation is Operation.COS]

    def _word(self, operand: Operand) -> Temporary:
        """Give a constant as a temporary."""
        if isinstance(operand, Temporary):
            return operand
        return self._builder.scaled(1.0, operand)

    def _function(self, operation: Operation, arguments: Sequence[Operand]) -> Operand:
        function = FUNCTIONS[operation.label]
        words = len(arguments) if operation in _OF_WORDS else 1
        if not operation.is_condition and operation is not Operation.WHERE:
            arguments = [*map(self._word, arguments[:words]), *arguments[words:]]
        result = function.expand(self._builder, *arguments)
        assert not isinstance(result, tuple)
        return result
