"""What people write with NumPy, traced: equal to NumPy, bit by bit unless listed."""

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest

from support.tracing import call_of, graph_of, of_pair
from ukf_sw.tracing.tracer import trace

POINTS = 40
A = np.array([[1.0, -2.0, 0.5], [0.25, 3.0, -1.0]])
SQUARE = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1], [0.2, 0.0, 1.0]])


def assigned(x, y):
    z = x.copy()
    z[0] += y[0]
    z[1:] = y[:2] * 2.0
    z[2] -= 1
    return z


def into_zeros(x, y):
    z = np.zeros(3)
    z[0], z[2] = np.hypot(x[0], y[0]), x[1]
    return z


def into_like(x, y):
    z = np.zeros_like(x)
    z[0] = y[1]
    return z


def into_views(x, y):
    z = np.zeros((2, 3))
    row = z[0]
    row[1:] = x[:2]
    z[1] = y
    z[:, 0] += 1.0
    z.T[2] *= 3.0
    return z


def into_masked(x, y):
    z = x.copy()
    z[z < 0.0] = 0.25
    z[np.array([True, False, True])] += 1.0
    return z


def into_masked_row(x, y):
    z = np.stack((x, y))
    z[1, y > 0.5] = 0.0
    return z


def into_empty(x, y):
    z = np.empty((3, 3))
    for i in range(3):
        z[i] = x[i] * y
    return z


def in_place(x, y):
    z = x * 1.5
    z += y
    z *= 2.0
    z /= 3.0
    z -= 0.5
    np.add(z, y, out=z)
    return z


def of_matrix(x, y):
    F = np.eye(3)
    F[0, 1] = x[2]
    F[1] = F[1] * y[0]
    return F @ x


def unpacked(x, y):
    a, b, c = x
    (d, e), f = y[:2], y[2]
    first, *rest = x
    return a + d, b * e, c - f, first, *rest


def looped(x, y):
    total = 0.0
    for i, (a, b) in enumerate(zip(x, y, strict=True)):
        total = total + i * a * b
    return total


def recursive(x, y):
    def power(value, k):
        return value if k == 0 else value * power(value, k - 1)

    return power(x, 3)


def of_constants(x, y):
    table = np.linspace(0.0, 1.0, 5)
    inverse = np.linalg.inv(SQUARE)
    chosen = np.flatnonzero(table > 0.4)
    scale = math.sqrt(2.0) if len(chosen) == 3 else 0.0
    return inverse @ x * scale + table[chosen]


def own_inverse(x, y):
    F = np.eye(3)
    F[0, 1] = 0.5
    return np.linalg.inv(F) @ x


def with_keywords(x, y):
    return np.sum(x, axis=0, keepdims=False) + np.linalg.norm(x=y, ord=2)


@dataclass
class Gain:
    k: float

    def __call__(self, x):
        return self.k * x


def wrapped(x, y):
    return x - 2.0 * np.pi * np.round((x - y) / (2.0 * np.pi))


IDIOMS = {
    # The idioms of the first survey.
    "np.sin(x)": lambda x, y: np.sin(x),
    "np.sin(x[0])": lambda x, y: np.sin(x[0]),
    "np.arctan2(x, y)": lambda x, y: np.arctan2(x, y),
    "np.arctan2(x[0], y[0])": lambda x, y: np.arctan2(x[0], y[0]),
    "np.hypot(x, y)": lambda x, y: np.hypot(x, y),
    "np.sqrt(np.abs(x))": lambda x, y: np.sqrt(np.abs(x)),
    "np.exp(x)": lambda x, y: np.exp(x),
    "np.abs(x)": lambda x, y: np.abs(x),
    "x > y": lambda x, y: x > y,
    "x[0] > 0": lambda x, y: x[0] > 0,
    "np.where(x > 0, x, y)": lambda x, y: np.where(x > 0, x, y),
    "np.where(x[0] > 0, x[0], 1.)": lambda x, y: np.where(x[0] > 0, x[0], 1.0),
    "np.clip(x, -1, 1)": lambda x, y: np.clip(x, -1, 1),
    "np.maximum(x, y)": lambda x, y: np.maximum(x, y),
    "np.maximum(x[0], 1e-6)": lambda x, y: np.maximum(x[0], 1e-6),
    "A @ x": lambda x, y: A @ x,
    "x @ y": lambda x, y: x @ y,
    "np.dot(x, y)": lambda x, y: np.dot(x, y),
    "np.einsum": lambda x, y: np.einsum("i,i->", x, y),
    "np.linalg.norm(x)": lambda x, y: np.linalg.norm(x),
    "np.cross(x, y)": lambda x, y: np.cross(x, y),
    "np.outer(x, y)": lambda x, y: np.outer(x, y),
    "np.sum(x)": lambda x, y: np.sum(x),
    "x.sum()": lambda x, y: x.sum(),
    "np.mean(x)": lambda x, y: np.mean(x),
    "np.concatenate": lambda x, y: np.concatenate((x[:2], y)),
    "np.stack": lambda x, y: np.stack((x, y)),
    "np.array([x[0], y[0]])": lambda x, y: np.array([x[0], y[0]]),
    "np.array([..]) * x": lambda x, y: np.array([x[0], y[0], 1.0]) * x,
    "np.where(np.array([..]) > 0)": lambda x, y: np.where(np.array([x[0], y[0]]) > 0, 1.0, 0.0),
    "norm(np.array([..]))": lambda x, y: np.linalg.norm(np.array([x[0], y[0]])),
    "np.clip(np.array([..]), 0, 1)": lambda x, y: np.clip(np.array([x[0], y[0]]), 0, 1),
    "np.sinc(x[0])": lambda x, y: np.sinc(x[0]),
    "np.tan(x)": lambda x, y: np.tan(x),
    "np.arcsin": lambda x, y: np.arcsin(np.clip(x, -1, 1)),
    "np.tanh(x)": lambda x, y: np.tanh(x),
    "np.log": lambda x, y: np.log(np.abs(x)),
    "x**2": lambda x, y: x**2,
    "np.abs(x)**1.5": lambda x, y: np.abs(x) ** 1.5,
    "np.mod(x, 6.28)": lambda x, y: np.mod(x, 6.28),
    "wrap()": wrapped,
    "np.sign(x)": lambda x, y: np.sign(x),
    "np.interp": lambda x, y: np.interp(x[0], [-1.0, 0.5, 1.0], [0.0, 1.0, 4.0]),
    "np.diff(x)": lambda x, y: np.diff(x),
    "x[0] += y[0]": assigned,
    "zeros(3)[0] = x[0]": into_zeros,
    "np.zeros_like(x)[0] = x[0]": into_like,
    "abs(x[0])": lambda x, y: abs(x[0]),
    # Indexing and assignment.
    "slices": lambda x, y: np.concatenate((x[::-1], y[1:], x[-1:], y[::2])),
    "fancy index": lambda x, y: x[[2, 0]] * y[np.array([1, 1])],
    "constant mask": lambda x, y: x[np.array([True, False, True])],
    "new axis": lambda x, y: x[:, None] * y[np.newaxis, :],
    "ellipsis": lambda x, y: np.stack((x, y))[..., 1],
    "views": into_views,
    "y[y < 0] = c": into_masked,
    "y[1, mask] = c": into_masked_row,
    "np.empty": into_empty,
    "in place": in_place,
    "F = np.eye(3)": of_matrix,
    "unpacking": unpacked,
    "iteration": looped,
    "tolist, item": lambda x, y: [*x.tolist(), y[:1].item()],
    "fill, full": lambda x, y: np.full(2, x[0]) + np.full_like(y[:2], y[1]),
    "reversed, sum()": lambda x, y: sum(reversed([*x])),
    # Functions of numbers.
    "powers": lambda x, y: (x**1, x**0, x**2, np.square(x), x**4.0, np.power(y, 2)),
    "odd powers": lambda x, y: (x**3, x**5, x**-1, x**-2, np.abs(x) ** 0.5, np.abs(y) ** -0.5),
    "2.0**x": lambda x, y: 2.0**x,
    "other powers": lambda x, y: np.abs(x) ** y,
    "x % y, x // y": lambda x, y: (x % 1.5, x // 1.5, *divmod(y[0], 0.5), np.fmod(x, 0.75)),
    "rounding": lambda x, y: (np.floor(x), np.ceil(x), np.rint(x), np.trunc(x), np.fix(y)),
    "np.round(x, 2)": lambda x, y: np.round(x, 2),
    "round(x[0]), math.floor(x[0])": lambda x, y: [round(x[0]), math.floor(y[0]), math.ceil(y[0])],
    "degrees": lambda x, y: (np.degrees(x), np.radians(y), np.rad2deg(x), np.deg2rad(x)),
    "inverse functions": lambda x, y: (np.arctan(x), np.arccos(np.tanh(y)), 1.0 / x),
    "hyperbolic": lambda x, y: (np.sinh(x), np.cosh(y)),
    "logarithms": lambda x, y: (np.log2(np.exp(x)), np.log10(np.exp(y)), np.log1p(np.abs(x))),
    "exponentials": lambda x, y: (np.exp2(x), np.expm1(y)),
    "signs": lambda x, y: (np.copysign(x, y), np.signbit(x), -x, +y, np.fabs(x), np.negative(y)),
    "np.heaviside": lambda x, y: np.heaviside(x, 0.5),
    "x.clip, x.round": lambda x, y: (x.clip(-0.5, 0.5), y.round(), x.round(1)),
    "np.clip(x, None, 1)": lambda x, y: (np.clip(x, None, 1), np.clip(y, 0, None)),
    "np.reciprocal": lambda x, y: np.reciprocal(x),
    "np.polyval": lambda x, y: np.polyval([0.5, -1.0, 2.0], x),
    "Polynomial": lambda x, y: np.polynomial.polynomial.polyval(x, [2.0, -1.0, 0.5]),
    "np.interp with ends": lambda x, y: np.interp(y, [0.0, 1.0], [2.0, 3.0], left=-1.0, right=9.0),
    "np.isnan, np.isfinite": lambda x, y: (np.isnan(np.log(x)), np.isfinite(1.0 / x), np.isinf(y)),
    "wrap by sin and cos": lambda x, y: np.arctan2(np.sin(x - y), np.cos(x - y)),
    # Conditions.
    "comparisons": lambda x, y: (x < y, x <= y, x >= y, x == x, x != y, -x > 0.5),
    "& | ~ ^": lambda x, y: ((x > 0) & (y > 0), (x > 0) | (y > 0), ~(x > 0), (x > 0) ^ (y > 0)),
    "np.logical_": lambda x, y: (
        np.logical_and(x > 0, y > 0), np.logical_or(x, y), np.logical_not(x > y),
        np.logical_xor(x > 0, y > 0),
    ),
    "(x > 0) * y": lambda x, y: ((x > 0) * y, (x > 0) * 1.0 + (y > 0), (x > 0) + (y > 0)),
    "np.sum(x > 0)": lambda x, y: (np.sum(x > 0), np.mean(y > 0)),
    "np.any, np.all": lambda x, y: (np.any(x > 1.5), np.all(y > -1.5), (x > 0).any()),
    "np.where of conditions": lambda x, y: np.where(x > 0, y > 0, y < -1),
    "np.where(x, a, b)": lambda x, y: np.where(x, 1.0, y),
    "np.select": lambda x, y: np.select([x > 1, x > 0], [y, 2 * y], default=-1.0),
    "np.piecewise": lambda x, y: np.piecewise(x, [x < 0, x > 1], [lambda t: -t, 2.0, lambda t: t]),
    "chained where": lambda x, y: np.where(x > 1, 1, np.where(x < -1, -1, x)),
    "np.min, np.max": lambda x, y: (np.min(x), y.max(), np.ptp(x), np.max([x[0], y[0]])),
    # Sums and products.
    "sums along axes": lambda x, y: (
        np.stack((x, y)).sum(axis=0), np.stack((x, y)).sum(axis=-1, keepdims=True),
        np.outer(x, y).mean(axis=(0, 1)), np.outer(x, y).prod(axis=1),
    ),
    "sums of lists": lambda x, y: np.sum([x[0], y[1], 2.0]) + np.mean([x[1], 3.0]),
    "sum of 12": lambda x, y: np.sum(np.concatenate((x, y, x * y, x - y))),
    "cumsum, cumprod": lambda x, y: (np.cumsum(x), y.cumprod(), np.cumsum([x[0], y[0]])),
    "var, std": lambda x, y: (np.var(x), y.std()),
    "matrices": lambda x, y: (SQUARE @ A.T @ A @ x, x @ SQUARE, A.dot(y), np.outer(x, y) @ SQUARE),
    "stacks": lambda x, y: np.stack((SQUARE, SQUARE * x)) @ np.stack((SQUARE, SQUARE.T)),
    "einsum of matrices": lambda x, y: (
        np.einsum("ij,j->i", SQUARE, x), np.einsum("i,ij,j", x, SQUARE, y),
        np.einsum("ij->ji", np.outer(x, y)), np.einsum("ii", np.outer(x, y)),
    ),
    "inner, vdot, tensordot, kron": lambda x, y: (
        np.inner(x, y), np.vdot(x, y), np.tensordot(SQUARE, x, 1), np.kron(x, y),
    ),
    "quadratic form": lambda x, y: x.T @ SQUARE @ y,
    "norms": lambda x, y: (
        np.linalg.norm(x, 1), np.linalg.norm(y, np.inf), np.linalg.norm(np.outer(x, y)),
        np.linalg.norm(np.stack((x, y)), axis=1), np.sqrt(x @ x),
    ),
    "normalised": lambda x, y: x / np.linalg.norm(x),
    "trace": lambda x, y: (np.trace(np.outer(x, y)), np.outer(x, y).trace()),
    "cross of stacks": lambda x, y: np.cross(np.stack((x, y)), np.stack((y, x))),
    "np.add.reduce": lambda x, y: (np.add.reduce(x), np.multiply.outer(x, y), np.add.accumulate(y)),
    # Shapes.
    "joined": lambda x, y: (
        np.hstack((x, y)), np.vstack((x, y)), np.column_stack((x, y)), np.append(x, y[0]),
        np.dstack((x, y)), np.block([[x, y]]), np.concatenate(([x[0]], y)), np.stack([x[0], y[0]]),
        np.concatenate((np.eye(3), np.outer(x, y)), 1), np.stack((x, y), axis=1),
    ),
    "vector of columns": lambda x, y: np.vstack(([x[0], 1.0], [y[0], 2.0])),
    "shapes": lambda x, y: (
        np.outer(x, y).T, x.reshape(3, 1), y.reshape((1, -1)), np.outer(x, y).ravel(),
        np.outer(x, y).flatten(), np.atleast_2d(x), np.expand_dims(y, 0), np.squeeze(x[None]),
        np.swapaxes(np.outer(x, y), 0, 1), np.transpose(np.outer(x, y)), x.squeeze(),
    ),
    "moved": lambda x, y: (
        np.roll(x, 1), np.flip(y), np.tile(x, 2), np.repeat(y, 2), x.repeat(2), np.take(x, [2, 0]),
    ),
    "split": lambda x, y: (*np.split(np.concatenate((x, y)), 3), *np.array_split(x, 2)),
    "diag": lambda x, y: (
        np.diag(x), np.diag(np.outer(x, y)), np.tril(np.outer(x, y)), np.diagonal(SQUARE * x),
    ),
    "broadcast": lambda x, y: (
        np.broadcast_to(x, (2, 3)), x[:, None] + A.T, *np.broadcast_arrays(x, 1.0),
    ),
    "shape, ndim, size": lambda x, y: x * len(x) + y.shape[0] * x.ndim + np.size(y) + x[0].ndim,
    "dtype": lambda x, y: np.zeros(3, dtype=x.dtype) + x.astype(float) + np.asarray(y, dtype=float),
    "isinstance float": lambda x, y: x.real + np.real(y),
    # Python.
    "functools.partial": lambda x, y: functools.partial(wrapped, y=y)(x),
    "callable object": lambda x, y: Gain(0.5)(x),
    "recursion": recursive,
    "constants": of_constants,
    "inverse of a constant": own_inverse,
    "keywords": with_keywords,
    "comprehension": lambda x, y: np.array([a * b for a, b in zip(x, y, strict=True)]),
    "nested lists": lambda x, y: np.array([[x[0], 0.0], [0, y[1]]]) @ x[:2],
    "int arrays": lambda x, y: np.array([1, 2, 3]) * x // 1,
    "np.float64 constants": lambda x, y: np.float64(2.0) * x + np.pi * y[0] - np.sqrt(2.0),
    "np.vectorize": lambda x, y: np.vectorize(lambda a, b: a * b + 1.0)(x, y),
    "copy": lambda x, y: np.copy(x) + y.copy() + np.array(x, copy=True),
    "errstate": lambda x, y: np.errstate(all="ignore").__enter__() or x / y,
}  # fmt: skip

#: These add in another order than NumPy, or are written with other functions: last bits differ.
NEAR = {
    "A @ x", "F = np.eye(3)", "constants", "einsum of matrices", "exponentials", "hyperbolic",
    "inner, vdot, tensordot, kron", "inverse of a constant", "keywords", "logarithms", "matrices",
    "nested lists", "norm(np.array([..]))", "normalised", "norms", "np.dot(x, y)", "np.einsum",
    "np.linalg.norm(x)", "np.mod(x, 6.28)", "odd powers", "powers", "quadratic form", "stacks",
    "sum of 12", "sums along axes", "x % y, x // y", "x @ y",
}  # fmt: skip


def random_points():
    draws = np.random.default_rng(0).uniform(-2.0, 2.0, (POINTS, 6))
    draws[0] = [0.0, -0.0, 1.0, 0.5, -0.0, 0.0]
    draws[1] = draws[2].round()
    return [(point[:3], point[3:]) for point in draws]


@pytest.mark.parametrize("name", IDIOMS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_idioms_give_what_numpy_gives(name):
    model = of_pair(IDIOMS[name])
    expected = [np.asarray(model(x.copy(), y.copy(), 0.5), dtype=float) for x, y in random_points()]
    graph = graph_of(model, len(expected[0]))
    found = [graph.evaluate({"x": x, "w": y, "u": 0.5}) for x, y in random_points()]
    if name in NEAR:
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
    else:
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", sorted(NEAR))
def test_only_those_that_differ_are_listed(name):
    assert name in IDIOMS


def test_idioms_are_equal_for_several_points_at_once():
    points = random_points()
    x, y = (np.array([point[i] for point in points]).T for i in (0, 1))
    graph = graph_of(of_pair(IDIOMS["np.hypot(x, y)"]), 3)
    np.testing.assert_array_equal(graph.evaluate({"x": x, "w": y, "u": 0.5}), np.hypot(x, y))


# Arguments.


class Command(NamedTuple):
    force: float
    turn: float


GIVEN = {
    "number": (2.0, lambda u: u),
    "array": (np.array([1.0, 2.0]), lambda u: u[0] - u[1]),
    "matrix": (SQUARE, lambda u: u[0, 1] + u[2][0]),
    "tuple": ((1.0, np.array([2.0, 3.0])), lambda u: u[0] * u[1][1]),
    "list": ([1.0, 2.0], lambda u: u[0] - u[1]),
    "named tuple": (Command(1.0, 2.0), lambda u: u.force - u.turn),
    "dict": ({"force": 3.0, "turn": np.ones(2)}, lambda u: u["force"] + u["turn"][1]),
    "ints": (np.array([1, 2]), lambda u: u[0] / u[1]),
    "int": (3, lambda u: u / 2),
    "None": (None, lambda u: 1.0 if u is None else 0.0),
    "unused": (np.ones(2), lambda u: 0.0),
}


@pytest.mark.parametrize("name", GIVEN)
def test_inputs_of_all_kinds(name):
    given, pick = GIVEN[name]
    graph = graph_of(lambda x, w, u: x[:1] + pick(u), positional={"u": given})
    x = np.array([0.25, 0.5, 1.0])
    assert graph.evaluate({"x": x, "u": given}) == x[0] + pick(given)


@pytest.mark.parametrize("given", ["text", True, object(), np.array([1j]), [1.0, "a"]])
def test_other_inputs_are_refused(given):
    with pytest.raises(TypeError, match=r"^u(\[1\])? must be None, a number, an array, or a tuple"):
        graph_of(lambda x, w, u: x[:1], positional={"u": given})


def test_keywords_are_inputs_or_constants():
    def h(x, v, *, gain, places, device, bias=2.0, count=1):
        assert isinstance(count, int)
        return x[:1] * gain + places[1] * (3.0 if device == "radar" else 5.0) + bias * count

    keywords = {"gain": 0.5, "places": np.array([1.0, 2.0]), "device": "radar", "count": 4}
    graph = graph_of(h, noise="v", positional={}, keywords=keywords)
    assert [source.label for source in graph.inputs] == ["x[0]", "gain", "places[1]"]
    assert graph.evaluate({"x": np.ones(3), **keywords}) == 0.5 + 2.0 * 3.0 + 8.0


def test_vectorized_models_are_called_with_a_column():
    shapes = []

    def f(x, w, u):
        shapes.append((x.shape, w.shape))
        return np.array([x[0] + w[0], np.where(x[1] > 0, x[1], 0.0), u * x[2]])

    graph = graph_of(f, 3, vectorized=True)
    assert shapes == [((3, 1), (3, 1))] * 2
    x = np.random.default_rng(1).standard_normal((3, 5))
    np.testing.assert_array_equal(graph.evaluate({"x": x, "w": x, "u": 0.5}), f(x, x, 0.5))


def test_additive_noise_arrives_as_zeros():
    graph = graph_of(lambda x, w, u: x + w, 3, additive=True)
    assert [source.label for source in graph.inputs] == ["x[0]", "x[1]", "x[2]"]
    # x + 0.0 is not left out: it is 0.0 where x is -0.0.
    assert not np.signbit(graph.evaluate({"x": np.array([-0.0, 1.0, 2.0]), "u": 0.0})[0])


def test_numpy_is_as_before_after_a_trace():
    names = ("array", "zeros", "where", "sum")
    before = [getattr(np, name) for name in names]
    inside = []
    graph_of(lambda x, w, u: inside.append(np.zeros) or np.zeros(1))
    assert inside[0] is not before[1]
    assert [getattr(np, name) for name in names] == before
    with pytest.raises(ZeroDivisionError):
        graph_of(lambda x, w, u: 1 // 0)
    assert [getattr(np, name) for name in names] == before


def test_numpy_is_as_before_for_other_packages_and_threads():
    import threading

    import scipy.linalg

    made = []

    def f(x, w, u):
        thread = threading.Thread(target=lambda: made.append(np.zeros(2)))
        thread.start()
        thread.join()
        F = np.zeros((3, 3))
        F[0, 1] = 0.5
        made.append(scipy.linalg.expm(F))
        return scipy.linalg.expm(F) @ x

    expected = scipy.linalg.expm(np.array([[0, 0.5, 0], [0, 0, 0], [0, 0, 0]])) @ np.ones(3)
    graph = trace(call_of(f, 3))
    assert [type(each) for each in made] == [np.ndarray] * 4
    np.testing.assert_allclose(graph.evaluate({"x": np.ones(3)}), expected, rtol=1e-15)
