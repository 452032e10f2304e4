"""Building a graph: equal subexpressions become one node, and constants are computed at once."""

from collections.abc import Sequence

import numpy as np

from ukf_sw.tracing.graph import Graph, Input, Node
from ukf_sw.tracing.operations import COMMUTATIVE, LOGICAL, Operation

__all__ = ["Builder"]


class Builder:
    """Makes nodes, and a graph of those that are needed.

    The order of operations is that of the calls. Nothing is reordered, and nothing is left out that
    would change a bit. So ``x + 0.0`` stays, which is 0.0 if x is -0.0, and so does ``0.0 * x``,
    which is no number if x is none. What is left out is exact: ``x - 0.0`` and ``x + -0.0``, a
    factor or divisor of 1, a double negation, a choice between equals, a condition that is known.
    """

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._numbers: dict[Node, int] = {}

    def node(self, number: int) -> Node:
        """Give a node by its number."""
        return self._nodes[number]

    def _add(self, node: Node, key: Node | None = None) -> int:
        """Give the number of a node, which is new if there is none that equals its key."""
        known = self._numbers.setdefault(key or node, len(self._nodes))
        if known == len(self._nodes):
            self._nodes.append(node)
        return known

    def input(self, source: Input) -> int:
        """Make an input."""
        return self._add(Node(Operation.INPUT, source=source))

    def constant(self, value: float | bool) -> int:
        """Make a constant: a number, or a condition if it is a bool."""
        exact = value if isinstance(value, bool) else float(value)
        return self._add(Node(Operation.CONSTANT, value=exact))

    def apply(self, operation: Operation, *arguments: int) -> int:
        """Make an operation.

        Parameters
        ----------
        operation
            What it is.
        arguments
            Numbers of nodes. A condition where a number is wanted counts as 1 or 0, a number where
            a condition is wanted is one if it is not zero.
        """
        wanted = self._wanted(operation, arguments)
        nodes = [self._nodes[argument] for argument in wanted]
        if all(node.is_constant for node in nodes):
            return self._computed(operation, nodes)
        simpler = self._simpler(operation, wanted, nodes)
        if simpler is not None:
            return simpler
        key = tuple(sorted(wanted)) if operation in COMMUTATIVE else wanted
        return self._add(Node(operation, wanted), Node(operation, key))

    def _wanted(self, operation: Operation, arguments: Sequence[int]) -> tuple[int, ...]:
        """Make the arguments numbers or conditions, whichever the operation takes."""
        if operation in LOGICAL:
            return tuple(map(self._as_condition, arguments))
        if operation is Operation.WHERE:
            condition, *values = arguments
            return self._as_condition(condition), *map(self._as_number, values)
        return tuple(map(self._as_number, arguments))

    def _as_number(self, number: int) -> int:
        node = self._nodes[number]
        if not node.is_condition:
            return number
        return self.apply(Operation.WHERE, number, self.constant(1.0), self.constant(0.0))

    def _as_condition(self, number: int) -> int:
        if self._nodes[number].is_condition:
            return number
        return self.apply(Operation.NOT_EQUAL, number, self.constant(0.0))

    def _computed(self, operation: Operation, nodes: Sequence[Node]) -> int:
        """Compute what only constants go into."""
        with np.errstate(all="ignore"):
            result = operation.function(*(np.asarray(node.value) for node in nodes))
        return self.constant(bool(result) if operation.is_condition else float(result))

    def _simpler(
        self, operation: Operation, arguments: tuple[int, ...], nodes: Sequence[Node]
    ) -> int | None:
        """Give what equals an operation bit by bit and is there already; None if nothing does."""
        first = arguments[0]
        # The key tells -0.0 from 0.0.
        known = [node.key[2] if node.is_constant else None for node in nodes]
        match operation:
            case Operation.MULTIPLY if (1.0).hex() in known:
                return arguments[1 - known.index((1.0).hex())]
            case Operation.DIVIDE if known[1] == (1.0).hex():
                return first
            case Operation.SUBTRACT if known[1] == (0.0).hex():
                return first
            case Operation.ADD if (-0.0).hex() in known:
                return arguments[1 - known.index((-0.0).hex())]
            case Operation.NEGATIVE | Operation.LOGICAL_NOT if nodes[0].operation is operation:
                return nodes[0].arguments[0]
            case Operation.LOGICAL_AND | Operation.LOGICAL_OR:
                return self._decided(operation, arguments, known)
            case Operation.WHERE if isinstance(known[0], bool):
                return arguments[1 if known[0] else 2]
            case Operation.WHERE if arguments[1] == arguments[2]:
                return arguments[1]
            case _:
                return None

    def _decided(
        self, operation: Operation, arguments: tuple[int, ...], known: Sequence[object]
    ) -> int | None:
        """Simplify a logical operation of which one side is known, or both are one."""
        if arguments[0] == arguments[1]:
            return arguments[0]
        for side, value in enumerate(known):
            if isinstance(value, bool):
                passes = value == (operation is Operation.LOGICAL_AND)
                return arguments[1 - side] if passes else self.constant(value)
        return None

    def graph(self, outputs: Sequence[int]) -> Graph:
        """Make a graph of what these results need, in the order in which it was made."""
        results = [self._as_number(output) for output in outputs]
        needed: set[int] = set()
        waiting = list(results)
        while waiting:
            number = waiting.pop()
            if number not in needed:
                needed.add(number)
                waiting.extend(self._nodes[number].arguments)
        order = sorted(needed)
        renumbered = {number: place for place, number in enumerate(order)}
        nodes = (self._nodes[number] for number in order)
        return Graph(
            nodes=tuple(
                Node(
                    node.operation,
                    tuple(renumbered[argument] for argument in node.arguments),
                    node.value,
                    node.source,
                )
                for node in nodes
            ),
            outputs=tuple(renumbered[result] for result in results),
        )
