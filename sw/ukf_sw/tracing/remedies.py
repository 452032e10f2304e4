"""What a model does that cannot be traced, and what it could do instead: by the syntax there."""

import ast

from ukf_sw.tracing.places import Place

__all__ = ["of_number", "of_truth"]

WHERE = "use np.where(condition, a, b)"

#: Built-in functions that ask for the truth of a comparison.
_CHOOSING = {
    "max": "use np.maximum(a, b)",
    "min": "use np.minimum(a, b)",
    "sorted": "use np.minimum and np.maximum",
    "any": "use np.any, or |",
    "all": "use np.all, or &",
    "bool": WHERE,
}
#: Functions of math that have another name in NumPy.
_MATH = {
    "asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2", "fabs": "abs",
    "pow": "power", "dist": "linalg.norm", "fsum": "sum", "isclose": "isclose",
}  # fmt: skip
#: What turns a number into another kind.
_KINDS = {
    "float": "leave it out: the numbers of a model are float64",
    "int": "use np.floor, np.trunc or np.rint",
    "round": "use np.rint",
    "complex": "compute with real numbers",
}


def _called(node: ast.AST) -> str:
    """Name of what a call calls, as math.sin."""
    return ast.unparse(node.func) if isinstance(node, ast.Call) else ""


def of_truth(place: Place | None) -> tuple[str, str]:
    """Say what asks whether something is true that is true at some sigma points only."""
    syntax = () if place is None else place.syntax
    for node in syntax:
        name = _called(node)
        if name in _CHOOSING:
            return f"decide on data by {name}()", _CHOOSING[name]
        if isinstance(node, ast.Compare) and len(node.ops) > 1:
            return "chain comparisons of data", "use (a < b) & (b < c)"
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn):
            return "look for data by in", "use np.any(values == a)"
        if isinstance(node, ast.BoolOp):
            word, sign = ("and", "&") if isinstance(node.op, ast.And) else ("or", "|")
            return f"join conditions on data by {word}", f"use (a) {sign} (b)"
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return "negate a condition on data by not", "use ~(a)"
        if isinstance(node, ast.While):
            return (
                "loop while data say so",
                "use a for loop with a fixed number of rounds, and np.where in it",
            )
        if isinstance(node, ast.Assert):
            return "assert something about data", "leave it out: results are checked"
        if isinstance(node, ast.If | ast.IfExp | ast.comprehension):
            return "branch on data", WHERE
    asking = syntax[:1] if place is not None and place.exact else syntax
    if any(isinstance(node, ast.Call | ast.Compare) for node in asking):
        return (
            "compare data in a list, or in an array that NumPy made of one",
            "make it an array in the model, by np.array or np.stack",
        )
    return "branch on data", WHERE


def _of_call(node: ast.AST) -> tuple[str, str] | None:
    """Say what a call makes of data that Python or a module computes with, if it is one."""
    name = _called(node)
    module, _, function = name.rpartition(".")
    if module in ("math", "cmath"):
        return f"compute data by {name}", f"use np.{_MATH.get(function, function)}"
    if name in _KINDS:
        return f"make a Python number of data by {name}()", _KINDS[name]
    if "random" in name.split("."):
        return "draw random numbers", "let the noise enter by w or v"
    return None


def _is_text(node: ast.AST) -> bool:
    """Whether something is text with numbers in it."""
    if isinstance(node, ast.BinOp) and isinstance(node.left, ast.Constant):
        return isinstance(node.left.value, str)
    return isinstance(node, ast.JoinedStr | ast.FormattedValue)


def of_number(place: Place | None, kind: str) -> tuple[str, str]:
    """Say what asks for one number, of Python's type `kind`, that is another at every sigma point.

    Parameters
    ----------
    place
        Where.
    kind
        float, int or complex.
    """
    syntax = () if place is None else place.syntax
    if place is not None and not place.exact:
        calls = (_of_call(node) for node in syntax)
        found = next((call for call in calls if call is not None), None)
        if found is not None:
            return found
    for node in syntax:
        call = _of_call(node)
        if call is not None:
            return call
        if _is_text(node):
            return TEXT
        if isinstance(node, ast.AugAssign):
            return STORED
        if isinstance(node, ast.Subscript):
            if kind == "int":
                return "index by data", "use np.where, or np.interp for a table"
            if isinstance(node.ctx, ast.Store):
                return STORED
        name = _called(node)
        if name and not name.startswith("np."):
            return (
                f"give data to {name}, which computes outside of NumPy",
                "write it with functions of NumPy",
            )
    return f"make a Python {kind} of data", "write it with functions of NumPy"


STORED = (
    "store data in an array that was made before the call, or by a function imported by its name",
    "make the array in the model: np.zeros_like(x), np.zeros(n) or np.array(values)",
)
TEXT = "make text of data", "leave it out, or look at values in the float64 reference"
MASK = "select elements by a condition on data", "use np.where(condition, a, b) for all of them"
