"""Each kernel alone, against NumPy in float64."""

import numpy as np
import pytest

from ukf_sw.engine import kernels
from ukf_sw.engine.kernels import Row
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.operations import ProgramBuilder
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.parameters import Form, UkfParams

PES = [1, 2, 3, 7]
#: Without W0 there is no sigma point 0, and the right-hand side is in its column.
EVERY_W0 = [0.0, 0.25]


def machine(sequential, pes, **sizes):
    params = UkfParams(**{"n": 3, "m": 2, "q": 1, "r": 2, "format": BINARY64, **sizes}, pes=pes)
    layout = Layout(params)
    return params, layout, ProgramBuilder(layout), sequential(layout, BINARY64)


def weights(params):
    """Weights of the sigma points that have one."""
    each = (1.0 - params.W0) / (params.M + 1)
    return np.array([params.W0 if k == 0 else each for k in params.points])


def residual_columns(layout):
    """Columns of sigma points and right-hand side, and those that take a factor."""
    both = [layout.points, (layout.rhs, layout.rhs + 1)]
    return both, [(0, 1)] if layout.params.W0 else []


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", PES)
def test_mean_residual(sequential, pes, W0):
    params, layout, builder, memory = machine(sequential, pes, W0=W0)
    points = np.random.default_rng(1).normal(size=len(params.points))
    memory.put(layout.Z[0], points, first=layout.points[0])
    memory.put(layout.Z[0], [5.0], first=layout.rhs)
    kernels.mean_residual(
        builder, layout.Z[0], layout.Ez[0], *residual_columns(layout), mean=(layout.P[0], 1)
    )
    memory.run(builder.operations)
    W = weights(params)
    mean = W @ points
    np.testing.assert_allclose(memory.get(layout.P[0], 1, 1)[0], mean, rtol=1e-14)
    np.testing.assert_allclose(
        memory.get(layout.Ez[0], len(points), layout.points[0]),
        (points - mean) * np.sqrt(W / params.W1), atol=3e-15,
    )  # fmt: skip
    innovation = memory.get(layout.Ez[0], 1, layout.rhs)[0]
    np.testing.assert_allclose(innovation, 5.0 - mean, atol=3e-15)


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", PES)
def test_masked_mean_residual_is_zero(sequential, pes, W0):
    params, layout, builder, memory = machine(sequential, pes, W0=W0)
    count = len(params.points) + 1
    for vector in (layout.Z[1], layout.Ez[1]):
        memory.put(vector, [np.nan] * count)
    kernels.mean_residual(
        builder, layout.Z[1], layout.Ez[1], *residual_columns(layout), observation=1
    )
    memory.run(builder.operations, mask=0b01)
    assert not memory.get(layout.Ez[1], count).any()


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", PES)
@pytest.mark.parametrize("form", Form)
def test_trisolve(sequential, pes, form, W0):
    """Both ways of elimination give the Cholesky factor and solve for right-hand sides."""
    params, layout, builder, memory = machine(sequential, pes, form=form, W0=W0)
    n = params.n
    rng = np.random.default_rng(2)
    first, count = layout.points[0], len(params.points)
    E = rng.normal(size=(n, count))
    A = E @ E.T
    b = rng.normal(size=n)
    if form is Form.SQUARE_ROOT:
        rhs = layout.rhs
        for i in range(n):
            memory.put(layout.Ex[i], E[i], first=first)
            memory.put(layout.Ex[i], [b[i]], first=rhs)
        rows = [Row(x, g) for x, g in zip(layout.Ex, layout.G, strict=True)]
        columns = ([layout.points], [layout.points, (rhs, rhs + 1)])
    else:
        rhs, first, count = layout.joint_rhs, 0, n
        for i in range(n):
            memory.put(layout.Ax[i], A[i])
            memory.put(layout.Ax[i], [b[i]], first=rhs)
        rows = [Row(x, g) for x, g in zip(layout.Ax, layout.G, strict=True)]
    L = kernels.trisolve(
        builder, rows, layout.roots, 0, n - 1,
        pivots=(lambda j: columns) if form is Form.SQUARE_ROOT
        else (lambda j: ([], [(j + 1, n), (rhs, rhs + 1)])),
        gram_schmidt=form is Form.SQUARE_ROOT,
        factor=lambda i, j: (layout.P[i], j) if j < n - 1 else None,
    )  # fmt: skip
    scalars = memory.run(builder.operations)
    expected = np.linalg.cholesky(A)
    for (i, j), scalar in L.items():
        np.testing.assert_allclose(scalars[scalar], expected[i, j], rtol=1e-11)
        np.testing.assert_allclose(memory.get(layout.P[i], 1, j)[0], expected[i, j], rtol=1e-11)
    assert len(L) == (n - 1) * (n + 2) // 2
    # Right-hand sides: y of L y = b for the pivots, and what is left for the last row.
    y = np.linalg.solve(expected, b)
    beat = rhs // pes
    found = [memory.get(row.vector(beat), 1, rhs)[0] for row in rows]
    np.testing.assert_allclose(found, [*y[:-1], b[-1] - expected[-1, :-1] @ y[:-1]], rtol=1e-10)
    # The rows that were eliminated are untouched.
    source = layout.Ex if form is Form.SQUARE_ROOT else layout.Ax
    original = E if form is Form.SQUARE_ROOT else A
    np.testing.assert_array_equal([memory.get(vector, count, first) for vector in source], original)


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", PES)
def test_multiply_add(sequential, pes, W0):
    params, layout, builder, memory = machine(sequential, pes, W0=W0)
    rng = np.random.default_rng(3)
    points, first = len(params.points), layout.points[0]
    s, row = rng.normal(size=3), rng.normal(size=(3, points))
    memory.put(layout.P[0], s)
    for k in range(2):
        memory.put(layout.Ex[k], row[k], first=first)
    memory.put(layout.X[0], [9.0] * layout.columns)
    loaded = [builder.load(layout.P[0], k) for k in range(3)]
    columns = [layout.points]
    terms = [(loaded[k], layout.Ex[k], columns) for k in range(2)]
    kernels.multiply_add(builder, layout.X[0], (loaded[2], layout.ones, True), terms, columns)
    memory.run(builder.operations)
    result = memory.get(layout.X[0], points, first)
    np.testing.assert_allclose(result, s[:2] @ row[:2] - s[2], atol=1e-14)
    assert memory.get(layout.X[0], 1, layout.rhs)[0] == 9.0  # columns beside are kept


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", PES)
def test_sig_gen(sequential, pes, W0):
    """Sigma points have the mean x and the covariance L L^T."""
    params, layout, builder, memory = machine(sequential, pes, q=2, r=0, W0=W0)
    n = params.n
    rng = np.random.default_rng(4)
    x, L = rng.normal(size=n), np.tril(rng.normal(size=(n, n)))
    memory.put(layout.x, x)
    for i in range(n):
        memory.put(layout.L[i], L[i])
    # The kernel takes the factor in units of sqrt(W1).
    for working, stored in zip(layout.F, layout.L, strict=True):
        builder.multiply(working, stored, layout.inverse_root_weight, [(0, n)], broadcast=True)
    factor = {(i, j): builder.load(layout.F[i], j) for i in range(n) for j in range(i + 1)}
    kernels.sig_gen(builder, factor, [(builder.load(layout.x, i), False) for i in range(n)])
    memory.put(layout.X[0], [9.0], first=layout.rhs)
    memory.run(builder.operations)
    # The points that are not written equal x.
    first, stop = layout.points
    drawn = np.array([memory.get(row, n + 2 - first, first) for row in layout.X])
    X = np.hstack([drawn, np.tile(x[:, None], stop - n - 2)])
    W = weights(params)
    if W0:
        np.testing.assert_allclose(X[:, 0], x, rtol=1e-15)
    assert memory.get(layout.X[0], 1, layout.rhs)[0] == 9.0
    np.testing.assert_allclose(X @ W, x, atol=1e-14)
    residual = X - x[:, None]
    np.testing.assert_allclose((residual * W) @ residual.T, L @ L.T, atol=1e-13)


@pytest.mark.parametrize("W0", EVERY_W0)
@pytest.mark.parametrize("pes", PES)
def test_gram(sequential, pes, W0):
    _, layout, builder, memory = machine(sequential, pes, W0=W0)
    a, b = np.random.default_rng(5).normal(size=(2, layout.columns))
    memory.put(layout.Ex[0], a)
    memory.put(layout.Ex[1], b)
    rows = [Row(vector, vector) for vector in layout.Ex]
    columns = [(0, layout.rhs), (layout.rhs + 1, layout.columns)]
    kernels.gram(builder, rows[0], rows[1], columns, (layout.P[2], 1))
    memory.run(builder.operations)
    expected = a @ b - a[layout.rhs] * b[layout.rhs]
    np.testing.assert_allclose(memory.get(layout.P[2], 1, 1)[0], expected, rtol=1e-13)
