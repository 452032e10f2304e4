"""A graph as Python would write it: a line for each row, and for each shared subexpression."""

from collections import Counter
from collections.abc import Mapping, Sequence

from ukf_sw.tracing.graph import Graph
from ukf_sw.tracing.operations import COMPARISONS, Operation

__all__ = ["listing"]

#: How tightly operators bind, as in Python; calls and names do so the most.
_BINDING = {
    **dict.fromkeys(COMPARISONS, 0),
    Operation.LOGICAL_OR: 1,
    Operation.LOGICAL_AND: 2,
    Operation.ADD: 3,
    Operation.SUBTRACT: 3,
    Operation.MULTIPLY: 4,
    Operation.DIVIDE: 4,
    Operation.NEGATIVE: 5,
    Operation.LOGICAL_NOT: 5,
    Operation.POWER: 6,
}
_TIGHTEST = 7


def listing(graph: Graph, rows: Sequence[str], labels: Mapping[str, str] | None = None) -> str:
    """Write a graph as assignments.

    Parameters
    ----------
    graph
        The graph.
    rows
        Names of its results.
    labels
        What to call inputs in the place of their labels.

    Returns
    -------
    str
        t1, t2, ... are used more than once. Those that are computed once, and not at every sigma
        point, say so.
    """
    called = labels or {}
    used = Counter(argument for node in graph.nodes for argument in node.arguments)
    used.update(graph.outputs)
    texts: list[tuple[str, int]] = []
    lines: list[str] = []
    shared = 0
    for number, node in enumerate(graph.nodes):
        if node.source is not None:
            label = node.source.label
            texts.append((called.get(label, label), _TIGHTEST))
            continue
        if not node.is_computed:
            value = node.value
            negative = isinstance(value, float) and repr(value).startswith("-")
            tight = _BINDING[Operation.NEGATIVE] if negative else _TIGHTEST
            texts.append((repr(value), tight))
            continue
        written = _written(node.operation, [texts[argument] for argument in node.arguments])
        if used[number] > 1:
            shared += 1
            once = "" if graph.per_point[number] else "  # once"
            lines.append(f"t{shared} = {written[0]}{once}")
            written = f"t{shared}", _TIGHTEST
        texts.append(written)
    lines += [f"{row} = {texts[n][0]}" for row, n in zip(rows, graph.outputs, strict=True)]
    return "\n".join(lines)


def _written(operation: Operation, arguments: list[tuple[str, int]]) -> tuple[str, int]:
    """Write an operation, and say how tightly it binds."""
    binding = _BINDING.get(operation)
    if binding is None:
        return f"{operation.label}({', '.join(text for text, _ in arguments)})", _TIGHTEST

    def bound(argument: tuple[str, int], least: int) -> str:
        text, tight = argument
        return text if tight >= least else f"({text})"

    if operation.arity == 1:
        return operation.symbol + bound(arguments[0], binding), binding
    # What binds as tightly on the right is grouped; of comparisons and powers also on the left.
    left = bound(arguments[0], binding + (operation in COMPARISONS | {Operation.POWER}))
    return f"{left} {operation.symbol} {bound(arguments[1], binding + 1)}", binding
