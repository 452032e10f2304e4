"""Operations of a traced model: what each takes, and what it computes in float64."""

from collections.abc import Callable
from enum import Enum
from typing import Any

import numpy as np

__all__ = ["COMMUTATIVE", "COMPARISONS", "CONDITIONS", "FUNCTIONS", "LOGICAL", "Operation"]


def _nothing(*_: Any) -> Any:
    """Stand in for what is not computed: inputs and constants."""
    raise TypeError("inputs and constants have no function")


class Operation(Enum):
    """What a node of a graph is.

    Numbers are float64 as NumPy computes with them. A condition is True or False at every sigma
    point: comparisons and logical operations give one, logical operations take conditions, and
    WHERE takes one first.

    Attributes
    ----------
    label : str
        Its name, as NumPy calls it.
    arity : int
        Number of its arguments.
    function : callable
        What computes it on arrays.
    symbol : str
        Its operator in Python; nothing if it is written as a call.
    """

    INPUT = "input", 0, _nothing, ""
    CONSTANT = "constant", 0, _nothing, ""
    ADD = "add", 2, np.add, "+"
    SUBTRACT = "subtract", 2, np.subtract, "-"
    MULTIPLY = "multiply", 2, np.multiply, "*"
    DIVIDE = "divide", 2, np.true_divide, "/"
    POWER = "power", 2, np.power, "**"
    NEGATIVE = "negative", 1, np.negative, "-"
    ABSOLUTE = "absolute", 1, np.absolute, ""
    SIGN = "sign", 1, np.sign, ""
    COPYSIGN = "copysign", 2, np.copysign, ""
    MINIMUM = "minimum", 2, np.minimum, ""
    MAXIMUM = "maximum", 2, np.maximum, ""
    FLOOR = "floor", 1, np.floor, ""
    CEIL = "ceil", 1, np.ceil, ""
    RINT = "rint", 1, np.rint, ""
    SQRT = "sqrt", 1, np.sqrt, ""
    HYPOT = "hypot", 2, np.hypot, ""
    SIN = "sin", 1, np.sin, ""
    COS = "cos", 1, np.cos, ""
    TAN = "tan", 1, np.tan, ""
    ARCSIN = "arcsin", 1, np.arcsin, ""
    ARCCOS = "arccos", 1, np.arccos, ""
    ARCTAN = "arctan", 1, np.arctan, ""
    ARCTAN2 = "arctan2", 2, np.arctan2, ""
    EXP = "exp", 1, np.exp, ""
    LOG = "log", 1, np.log, ""
    TANH = "tanh", 1, np.tanh, ""
    LESS = "less", 2, np.less, "<"
    LESS_EQUAL = "less_equal", 2, np.less_equal, "<="
    GREATER = "greater", 2, np.greater, ">"
    GREATER_EQUAL = "greater_equal", 2, np.greater_equal, ">="
    EQUAL = "equal", 2, np.equal, "=="
    NOT_EQUAL = "not_equal", 2, np.not_equal, "!="
    LOGICAL_AND = "logical_and", 2, np.logical_and, "&"
    LOGICAL_OR = "logical_or", 2, np.logical_or, "|"
    LOGICAL_NOT = "logical_not", 1, np.logical_not, "~"
    WHERE = "where", 3, np.where, ""

    label: str
    arity: int
    function: Callable[..., Any]
    symbol: str

    def __init__(self, label: str, arity: int, function: Callable[..., Any], symbol: str) -> None:
        self.label = label
        self.arity = arity
        self.function = function
        self.symbol = symbol

    @property
    def is_condition(self) -> bool:
        """Whether it gives a condition, and not a number."""
        return self in CONDITIONS


COMPARISONS = frozenset({
    Operation.LESS, Operation.LESS_EQUAL, Operation.GREATER, Operation.GREATER_EQUAL,
    Operation.EQUAL, Operation.NOT_EQUAL,
})  # fmt: skip
#: These take conditions and give one.
LOGICAL = frozenset({Operation.LOGICAL_AND, Operation.LOGICAL_OR, Operation.LOGICAL_NOT})
CONDITIONS = COMPARISONS | LOGICAL
#: Equal bits, whichever argument comes first.
COMMUTATIVE = frozenset({
    Operation.ADD, Operation.MULTIPLY, Operation.EQUAL, Operation.NOT_EQUAL,
    Operation.LOGICAL_AND, Operation.LOGICAL_OR,
})  # fmt: skip
#: More than an addition, a multiplication or a choice: what a core needs a program of its own for.
FUNCTIONS = frozenset({
    Operation.DIVIDE, Operation.POWER, Operation.SQRT, Operation.HYPOT, Operation.SIN,
    Operation.COS, Operation.TAN, Operation.ARCSIN, Operation.ARCCOS, Operation.ARCTAN,
    Operation.ARCTAN2, Operation.EXP, Operation.LOG, Operation.TANH,
})  # fmt: skip
