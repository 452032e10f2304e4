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


def machine(sequential, pes, **sizes):
    params = UkfParams(**{"n": 3, "m": 2, "q": 1, "r": 2, "format": BINARY64, **sizes}, pes=pes)
    layout = Layout(params)
    return params, layout, ProgramBuilder(layout), sequential(layout, BINARY64)


@pytest.mark.parametrize("pes", PES)
def test_mean_residual(sequential, pes):
    params, layout, builder, memory = machine(sequential, pes, W0=0.25)
    points = np.random.default_rng(1).normal(size=params.N)
    memory.put(layout.Z[0], [*points, 5.0])
    kernels.mean_residual(
        builder, layout.Z[0], layout.Ez[0], [(0, layout.rhs + 1)], [(0, 1)],
        mean=(layout.P[0], 1),
    )  # fmt: skip
    memory.run(builder.operations)
    W = np.full(params.N, 0.75 / (params.M + 1))
    W[0] = 0.25
    mean = W @ points
    np.testing.assert_allclose(memory.get(layout.P[0], 1, 1)[0], mean, rtol=1e-14)
    np.testing.assert_allclose(
        memory.get(layout.Ez[0], params.N + 1), [*(points - mean) * np.sqrt(W / W[1]), 5.0 - mean],
        atol=3e-15,
    )  # fmt: skip


@pytest.mark.parametrize("pes", PES)
def test_masked_mean_residual_is_zero(sequential, pes):
    params, layout, builder, memory = machine(sequential, pes)
    memory.put(layout.Z[1], [np.nan] * (params.N + 1))
    kernels.mean_residual(
        builder, layout.Z[1], layout.Ez[1], [(0, layout.rhs + 1)], [(0, 1)], observation=1
    )
    memory.run(builder.operations, mask=0b01)
    assert not memory.get(layout.Ez[1], params.N + 1).any()


@pytest.mark.parametrize("pes", PES)
@pytest.mark.parametrize("form", Form)
def test_trisolve(sequential, pes, form):
    """Both ways of elimination give the Cholesky factor and solve for right-hand sides."""
    params, layout, builder, memory = machine(sequential, pes, form=form)
    n = params.n
    rng = np.random.default_rng(2)
    E = rng.normal(size=(n, layout.rhs))
    A = E @ E.T
    b = rng.normal(size=n)
    if form is Form.SQUARE_ROOT:
        rhs, width = layout.rhs, layout.rhs
        for i in range(n):
            memory.put(layout.Ex[i], [*E[i], b[i]])
        rows = [Row(x, g) for x, g in zip(layout.Ex, layout.G, strict=True)]
        columns = ([(0, rhs)], [(0, rhs + 1)])
    else:
        rhs, width = layout.joint_rhs, n
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
    np.testing.assert_array_equal(
        [memory.get(vector, width) for vector in source], original[:, :width]
    )


@pytest.mark.parametrize("pes", PES)
def test_multiply_add(sequential, pes):
    params, layout, builder, memory = machine(sequential, pes)
    rng = np.random.default_rng(3)
    s, row, points = rng.normal(size=3), rng.normal(size=(3, params.N)), params.N
    memory.put(layout.P[0], s)
    for k in range(2):
        memory.put(layout.Ex[k], row[k])
    memory.put(layout.X[0], [9.0] * (points + 1))
    loaded = [builder.load(layout.P[0], k) for k in range(3)]
    terms = [(loaded[k], layout.Ex[k], [(0, points)]) for k in range(2)]
    kernels.multiply_add(builder, layout.X[0], (loaded[2], layout.ones, True), terms, [(0, points)])
    memory.run(builder.operations)
    result = memory.get(layout.X[0], points + 1)
    np.testing.assert_allclose(result[:-1], s[:2] @ row[:2] - s[2], atol=1e-14)
    assert result[-1] == 9.0  # columns beside are kept


@pytest.mark.parametrize("pes", PES)
def test_sig_gen(sequential, pes):
    """Sigma points have the mean x and the covariance L L^T."""
    params, layout, builder, memory = machine(sequential, pes, q=2, r=0, W0=0.125)
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
    memory.run(builder.operations)
    # The columns that are not written equal x.
    drawn = np.array([memory.get(row, n + 2) for row in layout.X])
    X = np.hstack([drawn, np.tile(x[:, None], params.N - n - 2)])
    W = np.full(params.N, 0.875 / (params.M + 1))
    W[0] = 0.125
    np.testing.assert_allclose(X[:, 0], x, rtol=1e-15)
    np.testing.assert_allclose(X @ W, x, atol=1e-14)
    residual = X - x[:, None]
    np.testing.assert_allclose((residual * W) @ residual.T, L @ L.T, atol=1e-13)


@pytest.mark.parametrize("pes", PES)
def test_gram(sequential, pes):
    _, layout, builder, memory = machine(sequential, pes)
    a, b = np.random.default_rng(5).normal(size=(2, layout.columns))
    memory.put(layout.Ex[0], a)
    memory.put(layout.Ex[1], b)
    rows = [Row(vector, vector) for vector in layout.Ex]
    columns = [(0, layout.rhs), (layout.rhs + 1, layout.columns)]
    kernels.gram(builder, rows[0], rows[1], columns, (layout.P[2], 1))
    memory.run(builder.operations)
    expected = a @ b - a[layout.rhs] * b[layout.rhs]
    np.testing.assert_allclose(memory.get(layout.P[2], 1, 1)[0], expected, rtol=1e-13)
