"""A traced model: a straight line of operations from its inputs to its results."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.tracing.operations import FUNCTIONS, Operation

__all__ = ["Graph", "Input", "Node"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Input:
    """A number that a model is given.

    Parameters
    ----------
    argument
        Name of the argument that it is in: x, w, v, u, or a keyword.
    path
        Where in it: (2,) of a vector, (0, 1) of a matrix, ("gain",) of a dict; () is the argument
        itself.
    per_point
        Whether every sigma point has one of its own, as of x and of the noise.
    """

    argument: str
    path: tuple[int | str, ...] = ()
    per_point: bool = False

    @property
    def label(self) -> str:
        """How it is written in Python: ``x[0]``."""
        return self.argument + "".join(f"[{part!r}]" for part in self.path)

    def of(self, given: Mapping[str, Any]) -> Any:
        """Find it among values of the arguments."""
        value = given[self.argument]
        for part in self.path:
            value = value[part]
        return value


@dataclass(frozen=True, eq=False)
class Node:
    """An operation with its arguments. Nodes are equal if they are so bit by bit.

    Parameters
    ----------
    operation
        What it is.
    arguments
        Numbers of the nodes that it takes.
    value
        Of a constant: a number, or a bool if it is a condition.
    source
        Of an input.
    """

    operation: Operation
    arguments: tuple[int, ...] = ()
    value: float | bool | None = None
    source: Input | None = None

    @cached_property
    def key(self) -> tuple[Any, ...]:
        """What tells it from others: 0.0 and -0.0 are two constants, all NaN are one."""
        value = self.value
        exact = float(value).hex() if isinstance(value, float) else value
        return self.operation, self.arguments, exact, self.source

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Node) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    @property
    def is_constant(self) -> bool:
        """Whether its value is known."""
        return self.operation is Operation.CONSTANT

    @property
    def is_condition(self) -> bool:
        """Whether it is true or false, and no number."""
        return self.operation.is_condition or isinstance(self.value, bool)

    @property
    def is_computed(self) -> bool:
        """Whether it is neither an input nor a constant."""
        return self.operation.arity > 0


@dataclass(frozen=True)
class Graph:
    """Nodes in an order in which they can be computed, and which of them are the results.

    Equal subexpressions are one node, and all nodes lead to a result. Two graphs are equal if they
    are so node for node.

    Parameters
    ----------
    nodes
        Every node comes after its arguments.
    outputs
        Numbers of the nodes that are the rows of the result.

    Raises
    ------
    ValueError
        If an argument comes after what takes it, or is of the wrong kind or number, or an output is
        no number; the message names the node.
    """

    nodes: tuple[Node, ...]
    outputs: tuple[int, ...]

    def __post_init__(self) -> None:
        for number, node in enumerate(self.nodes):
            if len(node.arguments) != node.operation.arity:
                raise ValueError(
                    f"node {number} must have {node.operation.arity} arguments, not "
                    f"{len(node.arguments)}"
                )
            if not all(0 <= argument < number for argument in node.arguments):
                raise ValueError(
                    f"node {number} must come after its arguments, not before {node.arguments!r}"
                )
        for output in self.outputs:
            if not 0 <= output < len(self.nodes):
                raise ValueError(f"outputs must be numbers of nodes, not {output!r}")

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Inputs that have an influence on the result."""
        return tuple(node.source for node in self.nodes if node.source is not None)

    @cached_property
    def per_point(self) -> tuple[bool, ...]:
        """Which nodes have a value of their own at every sigma point, by number.

        All others depend on inputs and constants alone, and are computed once.
        """
        found: list[bool] = []
        for node in self.nodes:
            own = node.source is not None and node.source.per_point
            found.append(own or any(found[argument] for argument in node.arguments))
        return tuple(found)

    @cached_property
    def constants(self) -> tuple[float, ...]:
        """Constants that are numbers, in the order of the nodes."""
        return tuple(
            node.value
            for node in self.nodes
            if node.is_constant and node.value is not None and not node.is_condition
        )

    @cached_property
    def levels(self) -> tuple[int, ...]:
        """Operations on the longest way to each node, itself included."""
        found: list[int] = []
        for node in self.nodes:
            before = max((found[argument] for argument in node.arguments), default=0)
            found.append(before + node.is_computed)
        return tuple(found)

    @property
    def depth(self) -> int:
        """Operations on the longest way to a result."""
        return max((self.levels[output] for output in self.outputs), default=0)

    def counts(self, *, per_point: bool | None = None) -> dict[Operation, int]:
        """Count the operations, by kind.

        Parameters
        ----------
        per_point
            True: those of every sigma point; False: those that are computed once; None: all.
        """
        found = Counter(
            node.operation
            for node, own in zip(self.nodes, self.per_point, strict=True)
            if node.is_computed and per_point in (None, own)
        )
        return {operation: found[operation] for operation in Operation if found[operation]}

    @property
    def functions(self) -> tuple[Operation, ...]:
        """Operations that are more than additions, multiplications and choices."""
        return tuple(operation for operation in self.counts() if operation in FUNCTIONS)

    def evaluate(
        self, given: Mapping[str, Any], disturb: Callable[[Array], Array] | None = None
    ) -> Array:
        """Compute the result with NumPy, in float64.

        Temporary values may be infinite or NaN, as those of a branch that is not chosen.

        Parameters
        ----------
        given
            Values of the arguments by name. x and the noise are of shape (n,) for one sigma point,
            (n, K) for K of them.
        disturb
            What becomes of each argument of an operation, conditions and comparisons apart: to
            find out what rounding does. None leaves them as they are.

        Returns
        -------
        array
            Shape (rows,) or (rows, K), as x has it.

        Raises
        ------
        KeyError, IndexError
            If an input is not among the values.
        """
        values: list[Any] = []
        shape = np.shape(given.get("x", ()))[1:]
        with np.errstate(all="ignore"):
            for node in self.nodes:
                if node.source is not None:
                    found = np.asarray(node.source.of(given), dtype=np.float64)
                    shape = np.broadcast_shapes(shape, found.shape)
                    values.append(found)
                elif node.is_constant:
                    values.append(np.asarray(node.value))
                else:
                    arguments = [values[argument] for argument in node.arguments]
                    if disturb is not None and not node.is_condition:
                        arguments = [a if a.dtype == np.bool_ else disturb(a) for a in arguments]
                    values.append(node.operation.function(*arguments))
        result = np.empty((len(self.outputs), *shape))
        for row, output in enumerate(self.outputs):
            result[row] = values[output]
        return result
