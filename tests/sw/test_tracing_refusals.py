"""What cannot be traced, with the message that each mistake gets: name, place, rule, remedy."""

import functools
import importlib
import math
import random
import re
import sys
from math import sin
from pathlib import Path

import numpy as np
import pytest
from numpy import array as plain_array
from numpy import zeros as plain_zeros
from scipy import special
from scipy.spatial.transform import Rotation

from support.tracing import call_of, graph_of
from ukf_sw.errors import TraceError, UkfError
from ukf_sw.tracing import places
from ukf_sw.tracing.tracer import trace

BUFFER = np.zeros(3)
TABLE = [1.0, 2.0, 3.0]

WHERE = "use np.where(condition, a, b)"
STORED = "store data in an array that was made before the call"


def branch(x, w, u):
    if x[0] > 1.0:
        return x
    return -x


def branch_later(x, w, u):
    y = np.sin(x) + w
    return y if y[0] < 0.0 else x


def loop(x, w, u):
    while x[0] > 1.0:
        x = x - 1.0
    return x


def counted(x, w, u):
    for _ in range(int(x[0])):
        x = x + w
    return x


def asserted(x, w, u):
    assert x[0] > 0.0
    return x


def truth_of_an_array(x, w, u):
    if x > 0.0:
        return x
    return w


def buffered(x, w, u):
    BUFFER[0] = x[0]
    return BUFFER


def added_in_place(x, w, u):
    total = plain_zeros(3)
    total += x
    return total


def imported_zeros(x, w, u):
    z = plain_zeros(3)
    z[0] = x[0]
    return z


def imported_array(x, w, u):
    y = plain_array([x[0], x[1], w[0]])
    return np.where(y > 0.0, y, 0.0)


def removed(x, w, u):
    return x[x > 0.0]


@functools.lru_cache
def cached(value):
    return value + 1.0


def shown(x, w, u):
    print(x[0])
    return x


def grown(x, w, u):
    y = x.copy()
    y[x > 0.0] = w
    return y


def plain_sum(x, w, u):
    return np.add(x, w, where=x > 0.0)


def deep(x, w, u):
    def helper(a):
        return math.exp(a)

    return x * helper(w[0])


#: Mistakes: the model, what it must not do, what it could do instead, and what is shown of it.
MISTAKES = {
    "if": (branch, "branch on data", WHERE, "x[0] > 1.0"),
    "if else": (branch_later, "branch on data", WHERE, "y[0] < 0.0"),
    "while": (loop, "loop while data say so", "use a for loop with a fixed number", "x[0] > 1.0"),
    "assert": (asserted, "assert something about data", "leave it out", "assert x[0] > 0.0"),
    "if of an array": (truth_of_an_array, "branch on data", WHERE, "x > 0.0"),
    "if in a list": (
        lambda x, w, u: [a for a in x if a > 0.0], "branch on data", WHERE, "a > 0.0",
    ),
    "chain": (
        lambda x, w, u: np.where(0.0 < x[0] < 1.0, x, w), "chain comparisons of data",
        "use (a < b) & (b < c)", "0.0 < x[0] < 1.0",
    ),
    "and": (
        lambda x, w, u: np.where(x[0] > 0.0 and x[1] > 0.0, x, w),
        "join conditions on data by and", "use (a) & (b)", "x[0] > 0.0 and x[1] > 0.0",
    ),
    "or": (
        lambda x, w, u: np.where(x[0] > 0.0 or x[1] > 0.0, x, w),
        "join conditions on data by or", "use (a) | (b)", "x[0] > 0.0 or x[1] > 0.0",
    ),
    "not": (
        lambda x, w, u: np.where(not x[0] > 0.0, x, w), "negate a condition on data by not",
        "use ~(a)", "not x[0] > 0.0",
    ),
    "in": (
        lambda x, w, u: x if 1.0 in x else w, "look for data by in", "use np.any(values == a)",
        "1.0 in x",
    ),
    "max()": (
        lambda x, w, u: x * max(x[0], 0.0), "decide on data by max()", "use np.maximum(a, b)",
        "max(x[0], 0.0)",
    ),
    "min()": (
        lambda x, w, u: x * min(x), "decide on data by min()", "use np.minimum(a, b)", "min(x)",
    ),
    "sorted()": (
        lambda x, w, u: sorted(x), "decide on data by sorted()", "use np.minimum and np.maximum",
        "sorted(x)",
    ),
    "any()": (
        lambda x, w, u: x if any(x > 0.0) else w, "decide on data by any()", "use np.any, or |",
        "any(x > 0.0)",
    ),
    "bool()": (
        lambda x, w, u: x * bool(x[0]), "decide on data by bool()", WHERE, "bool(x[0])",
    ),
    "float()": (
        lambda x, w, u: x * float(x[0]), "make a Python number of data by float()",
        "leave it out: the numbers of a model are float64", "float(x[0])",
    ),
    "int()": (
        lambda x, w, u: x * int(x[0]), "make a Python number of data by int()",
        "use np.floor, np.trunc or np.rint", "int(x[0])",
    ),
    "complex()": (
        lambda x, w, u: x * complex(x[0]), "make a Python number of data by complex()",
        "compute with real numbers", "complex(x[0])",
    ),
    "math.sin": (
        lambda x, w, u: x * math.sin(x[0]), "compute data by math.sin", "use np.sin",
        "math.sin(x[0])",
    ),
    "math.atan2": (
        lambda x, w, u: x * math.atan2(x[0], 1.0), "compute data by math.atan2", "use np.arctan2",
        "math.atan2(x[0], 1.0)",
    ),
    "from math import sin": (
        lambda x, w, u: x * sin(x[0]), "give data to sin, which computes outside of NumPy",
        "write it with functions of NumPy", "sin(x[0])",
    ),
    "in a helper": (deep, "compute data by math.exp", "use np.exp", "math.exp(a)"),
    "np.float64()": (
        lambda x, w, u: x * np.float64(x[0]), "make a Python float of data",
        "write it with functions of NumPy", "np.float64(x[0])",
    ),
    "range": (counted, "make a Python number of data by int()", "use np.floor", "int(x[0])"),
    "index": (
        lambda x, w, u: x * TABLE[x[0]], "index by data", "use np.where, or np.interp for a table",
        "TABLE[x[0]]",
    ),
    "index of x": (
        lambda x, w, u: x * x[w[0]], "index by data", "use np.where, or np.interp for a table",
        "x[w[0]]",
    ),
    "mask": (
        removed, "select elements by a condition on data", "use np.where(condition, a, b) for all",
        "x[x > 0.0]",
    ),
    "mask filled with an array": (
        grown, "select elements by a condition on data", "use np.where(condition, a, b) for all",
        "y[x > 0.0]",
    ),
    "array made before": (buffered, STORED, "np.zeros_like(x), np.zeros(n)", "BUFFER[0]"),
    "imported zeros": (imported_zeros, STORED, "make the array in the model", "z[0]"),
    "imported zeros, +=": (added_in_place, STORED, "make the array in the model", "total += x"),
    "imported array": (
        imported_array, "compare data in a list, or in an array that NumPy made of one",
        "make it an array in the model, by np.array or np.stack", "y > 0.0",
    ),
    "f-string": (
        lambda x, w, u: x * len(f"{x[0]:.3f}"), "make text of data", "leave it out", None,
    ),
    "str()": (
        lambda x, w, u: x * len(str(x[0])), "make text of data", "leave it out", "str(x[0])",
    ),
    "print": (shown, "make text of data", "or look at values in the float64", "print(x[0])"),
    "cache": (
        lambda x, w, u: x * cached(x[0]), "look up data in a dict, a set or a cache", "compute it",
        "cached(x[0])",
    ),
    "dict": (
        lambda x, w, u: x * {0.0: 1.0}.get(x[0], 2.0), "look up data in a dict, a set or a cache",
        "compute it", "{0.0: 1.0}.get(x[0], 2.0)",
    ),
    "inv": (
        lambda x, w, u: np.linalg.inv(np.outer(x, w)) @ x, "call np.linalg.inv",
        "write the inverse out", "np.linalg.inv(np.outer(x, w))",
    ),
    "solve": (
        lambda x, w, u: np.linalg.solve(np.outer(x, w), x), "call np.linalg.solve",
        "write the solution out", "np.linalg.solve(np.outer(x, w), x)",
    ),
    "eigh": (
        lambda x, w, u: np.linalg.eigh(np.outer(x, x))[0], "call np.linalg.eigh",
        "write it with other functions", "np.linalg.eigh(np.outer(x, x))",
    ),
    "sort": (lambda x, w, u: np.sort(x), "call np.sort", "use np.minimum", "np.sort(x)"),
    "x.sort": (lambda x, w, u: x.argsort(), "call the method argsort", "write it", "x.argsort"),
    "argmax": (lambda x, w, u: x * np.argmax(x), "call np.argmax", "use np.where", "np.argmax(x)"),
    "np.where of one": (
        lambda x, w, u: np.where(x > 0.0), "ask np.where for indices", WHERE, "np.where(x > 0.0)",
    ),
    "unwrap": (lambda x, w, u: np.unwrap(x), "call np.unwrap", "np.rint((a - b)", "np.unwrap(x)"),
    "allclose": (
        lambda x, w, u: x * np.allclose(x, w), "call np.allclose", "use np.abs(a - b) < tolerance",
        "np.allclose(x, w)",
    ),
    "cbrt": (lambda x, w, u: np.cbrt(x), "call np.cbrt", "np.abs(a) ** (1 / 3)", "np.cbrt(x)"),
    "fmax": (lambda x, w, u: np.fmax(x, w), "call np.fmax", "use np.maximum", "np.fmax(x, w)"),
    "np.add.at": (
        lambda x, w, u: np.add.at(x, [0], w) or x, "call np.add.at", "write it",
        "np.add.at(x, [0], w)",
    ),
    "where=": (plain_sum, "call np.add with where", WHERE, "np.add(x, w, where=x > 0.0)"),
    "fft": (lambda x, w, u: np.fft.fft(x), "call np.fft", "write it", "np.fft.fft(x)"),
    "np.random": (
        lambda x, w, u: x + np.random.normal(x), "draw random numbers",
        "let the noise enter by w or v", "np.random.normal(x)",
    ),
    "scipy Rotation": (
        lambda x, w, u: Rotation.from_rotvec(x).as_rotvec(),
        "give data to Rotation.from_rotvec, which computes outside of NumPy",
        "write it with functions of NumPy", "Rotation.from_rotvec(x)",
    ),
    "buffer": (
        lambda x, w, u: x * len(memoryview(x)),
        "give data to what takes none (memoryview: a bytes-like object is required, not data)",
        "write it with functions of NumPy, or with plain numbers", "memoryview(x)",
    ),
    "subscript": (
        lambda x, w, u: x * x[0][0], "give data to what takes none (data object is not",
        "write it with functions of NumPy", "x[0][0]",
    ),
    "scipy.special": (lambda x, w, u: special.erf(x), "call np.erf", "write it", "special.erf(x)"),
    "complex": (
        lambda x, w, u: x * 1j, "compute with what is no real number, of type complex",
        "use numbers", "x * 1j",
    ),
    "text": (
        lambda x, w, u: x + "1", "compute with what is no real number, of type str", "use numbers",
        'x + "1"',
    ),
    "None": (
        lambda x, w, u: np.array([x[0], None, 0.0]),
        "compute with what is no real number, of type NoneType", "use numbers",
        "np.array([x[0], None, 0.0])",
    ),
    "astype(int)": (
        lambda x, w, u: x.astype(int), "make data of the type int64",
        "use np.floor, np.trunc or np.rint", "x.astype(int)",
    ),
    "dtype": (
        lambda x, w, u: np.array([x[0], 0, 0], dtype=np.float32), "make data of the type float32",
        "leave it out: numbers are float64", "np.array([x[0], 0, 0], dtype=np.float32)",
    ),
    "size": (
        lambda x, w, u: np.zeros(x[0]), "make an array of a size that depends on data",
        "use a fixed size", "np.zeros(x[0])",
    ),
    "ragged": (
        lambda x, w, u: np.array([x[0], x[:2]]), "make an array of parts of the shapes (), (2,)",
        "make them equal", "np.array([x[0], x[:2]])",
    ),
    "minus of conditions": (
        lambda x, w, u: (x > 0.0) - (w > 0.0), "apply - to conditions alone", "use ~a, or a != b",
        "(x > 0.0) - (w > 0.0)",
    ),
    "& of numbers": (
        lambda x, w, u: np.where(x > 0.0 & w, x, w), "apply & to numbers",
        "put parentheses around comparisons", "0.0 & w",
    ),
    "interp of data": (
        lambda x, w, u: np.interp(u, x, w) * x, "interpolate between places that depend on data",
        "use np.where", "np.interp(u, x, w)",
    ),
    "cross of 2": (
        lambda x, w, u: x * np.cross(x[:2], w[:2]), "take the cross product of other vectors",
        "write it out", "np.cross(x[:2], w[:2])",
    ),
    "option": (
        lambda x, w, u: x * np.sum(x, initial=3.0), "call np.sum with 'initial'", "leave it out",
        "np.sum(x, initial=3.0)",
    ),
}  # fmt: skip


def line_of(model, expression):
    """Line of this file that a mistake is in, as a reader finds it."""
    lines = Path(__file__).read_text(encoding="utf-8").splitlines()
    first = model.__code__.co_firstlineno
    return next(k for k in range(first, first + 12) if expression in lines[k - 1])


@pytest.mark.parametrize("name", MISTAKES)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_mistakes_are_refused_with_their_place_and_a_remedy(name):
    model, rule, remedy, expression = MISTAKES[name]
    with pytest.raises(TraceError) as caught:
        graph_of(model, 3, name=f"process model f ({model.__name__})")
    error, message = caught.value, str(caught.value)
    assert message.startswith(f"process model f ({model.__name__}) must not {rule}")
    assert remedy in message.rpartition("; ")[2] or remedy in error.remedy
    assert error.file == __file__
    assert f"({__file__}, line {error.line})" in message
    if sys.version_info >= (3, 11) and expression is not None:
        assert error.expression == expression
        assert error.line == line_of(model, expression)


@pytest.mark.parametrize("name", MISTAKES)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_python_310_names_the_line(monkeypatch, name):
    """It does not tell the column: what is shown is the line, and the rule may be vaguer."""
    monkeypatch.setattr(places, "_span", lambda spot: None)
    model, rule, _, expression = MISTAKES[name]
    with pytest.raises(TraceError) as caught:
        graph_of(model, 3)
    if expression is not None:
        line = Path(__file__).read_text(encoding="utf-8").splitlines()[caught.value.line - 1]
        assert " ".join(line.split()).startswith(caught.value.expression.rstrip("."))
        assert caught.value.line == line_of(model, expression)
    if model.__name__ != "<lambda>":
        assert caught.value.rule.startswith(rule)


def test_there_are_enough_mistakes():
    assert len(MISTAKES) > 60


def test_errors_are_of_the_family():
    with pytest.raises(TraceError) as caught:
        graph_of(branch, 3)
    assert isinstance(caught.value, UkfError)
    assert isinstance(caught.value, ValueError)
    assert caught.value.model == "process model f (f)"
    assert caught.value.rule == "branch on data"


def test_source_that_is_not_there_is_left_out():
    made = {}
    exec("def f(x, w, u):\n    return x if x[0] > 0 else w\n", made)
    with pytest.raises(TraceError, match=r"branch on data \(<string>, line 2\); use np.where"):
        graph_of(made["f"], 3)


def test_places_are_in_the_file_of_the_model(tmp_path, monkeypatch):
    (tmp_path / "helpers_of_mine.py").write_text("def text(a):\n    return '%.3f' % a\n")
    (tmp_path / "model_of_mine.py").write_text(
        "from helpers_of_mine import text\n\ndef f(x, w, u):\n    return x * len(text(x[0]))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    model = importlib.import_module("model_of_mine").f
    with pytest.raises(TraceError, match="must not make text of data") as caught:
        graph_of(model, 3)
    assert (caught.value.file, caught.value.line) == (str(tmp_path / "helpers_of_mine.py"), 2)


def test_models_in_c_have_no_place():
    with pytest.raises(TraceError, match=r"must not make a Python float of data; write it"):
        trace(call_of(functools.partial(math.fmod), 3, positional={}))


def test_long_expressions_are_cut():
    with pytest.raises(TraceError) as caught:
        graph_of(
            lambda x, w, u: np.cbrt(x + w + x + w + x + w + x + w + x + w + x + w + x + w + x), 3
        )
    assert len(caught.value.expression) <= 80
    assert caught.value.expression.startswith("np.cbrt(x + w") or sys.version_info < (3, 11)


# What is wrong about results and arguments: worded as in the filter.


@pytest.mark.parametrize(
    ("model", "error", "message"),
    [
        (lambda x, w, u: x[:2], ValueError, "the shape (3,), at a sigma point, not (2,)"),
        (lambda x, w, u: x[0], ValueError, "the shape (3,), at a sigma point, not ()"),
        (lambda x, w, u: None, TypeError, "real numbers, at a sigma point, not None"),
        (lambda x, w, u: "abc", TypeError, "real numbers, at a sigma point, not 'abc'"),
        (lambda x, w, u: [x[0], 1j, 0], TypeError, "real numbers, at a sigma point, not [<traced"),
        (lambda x, w, u: [[1.0], [1.0, 2.0]], TypeError, "an array of numbers, at a sigma point"),
        (
            lambda x, w, u: [x[0], np.inf, 0],
            ValueError,
            "finite numbers, at a sigma point, not inf",
        ),
    ],
)
def test_wrong_results(model, error, message):
    with pytest.raises(error, match=re.escape(f"process model f (f) must return {message}")):
        graph_of(model, 3)


def test_rows_that_nobody_has_written():
    def f(x, w, u):
        z = np.empty(3)
        z[:2] = x[:2]
        return z

    with pytest.raises(ValueError, match=r"must return finite numbers, .* not nan in row 2"):
        graph_of(f, 3)


def test_wrong_shape_of_a_vectorized_model():
    message = r"must return the shape \(3, 1\), one column a sigma point, not \(3,\)"
    with pytest.raises(ValueError, match=message):
        graph_of(lambda x, w, u: x[:, 0], 3, vectorized=True)


def change_x(x, w, u):
    x[1] += w[1]
    return x


def change_w(x, w, u):
    w[:] = 0.0
    return x + w


@pytest.mark.parametrize(("model", "name", "row"), [(change_x, "x", 1), (change_w, "w", 0)])
def test_arguments_must_not_change(model, name, row):
    message = rf"must not change its argument {name}, as it does in row {row}: .* {name}\.copy\(\)"
    with pytest.raises(ValueError, match=message):
        graph_of(model, 3)


# State and randomness.


class Counter:
    """Gives another result in each call."""

    def __init__(self):
        self.calls = 0

    def __call__(self, x, w, u):
        self.calls += 1
        return [x[0], x[1] + self.calls, x[2]]


class Memory:
    """Uses data of the call before."""

    def __init__(self):
        self.last = None

    def __call__(self, x, w, u):
        before, self.last = self.last, x[0]
        return x if before is None else x - before


@pytest.mark.parametrize(
    ("model", "row"),
    [
        (Counter(), 1),
        (lambda x, w, u: [x[0], x[1], x[2] + np.random.standard_normal()], 2),
        (lambda x, w, u: x * random.random(), 0),
    ],
)
def test_state_and_randomness_are_found_by_a_second_trace(model, row):
    message = f"must not keep a state or draw random numbers, as two calls differ in row {row}; let"
    with pytest.raises(TraceError, match=message):
        graph_of(model, 3)


def test_data_of_another_call_are_refused():
    with pytest.raises(TraceError, match="must not keep data from one call to the next, as in"):
        graph_of(Memory(), 3)


def test_what_models_raise_has_a_note():
    with pytest.raises(IndexError) as caught:
        graph_of(lambda x, w, u: x[7], 3)
    assert caught.value.__notes__ == [
        "in process model f (f), traced with x of shape (3,), w of shape (3,) and u like 0.5"
    ]
