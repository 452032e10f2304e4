"""The steps of the filter, as programs for the array."""

from collections.abc import Callable
from typing import NamedTuple

from ukf_sw.engine.kernels import (
    Columns,
    Row,
    gram,
    mean_residual,
    multiply_add,
    sig_gen,
    trisolve,
)
from ukf_sw.engine.layout import Layout, Vector
from ukf_sw.engine.operations import Operation, ProgramBuilder, Scalar
from ukf_sw.spec.parameters import Form
from ukf_sw.spec.sequence import Program

__all__ = ["RunResult", "build_program"]


class RunResult(NamedTuple):
    """How a program ended.

    Parameters
    ----------
    error_code, error_index
        First error, as in the register ERROR, or zeros.
    nis
        Word of the normalised innovation squared, or None if the program gives none.
    clocks
        Clocks from the start of the step to its end.
    innovation_overflow
        Whether the first error is that the innovation is too large for the format.
    """

    error_code: int
    error_index: int
    nis: int | None
    clocks: int
    innovation_overflow: bool = False


class _Columns:
    """Sets of columns of a layout."""

    def __init__(self, layout: Layout) -> None:
        self.sigma: Columns = [(layout.sigma, layout.rhs)]
        #: What an observation row has: additive r noise, sigma points, right-hand side.
        self.observation: Columns = [(0, layout.rhs + 1)]
        #: Its inner products.
        self.observation_dots: Columns = [(0, layout.rhs)]
        #: Its columns that take a factor.
        self.observation_scaled: Columns = [(0, layout.sigma + 1)]
        self.all: Columns = [(0, layout.columns)]
        #: Additive q noise.
        self.process_noise: Columns = [(layout.rhs + 1, layout.columns)]
        #: Columns of state rows that take a factor.
        self.state_scaled: Columns = [(layout.sigma, layout.sigma + 1), *self.process_noise]
        #: Inner products of state rows: all but the right-hand side.
        self.state_dots: Columns = [(0, layout.rhs), (layout.rhs + 1, layout.columns)]


def _no_factor(i: int, j: int) -> None:
    """Store no element of the factor."""


def _store_factor(layout: Layout, first: int) -> Callable[[int, int], tuple[Vector, int] | None]:
    """Where L_ij goes in the working copy, for state rows that begin at a row."""

    def store(i: int, j: int) -> tuple[Vector, int] | None:
        return (layout.F[i - first], j - first) if j >= first else None

    return store


def _predicted_gram(b: ProgramBuilder) -> None:
    """Covariance form: state rows of the joint covariance, and minus the mean beside them."""
    layout, n, m = b.layout, b.layout.params.n, b.layout.params.m
    rows = [Row(vector, vector) for vector in layout.Ex]
    for i in range(n):
        for k in range(i, n):
            gram(b, rows[i], rows[k], _Columns(layout).state_dots, (layout.Ax[i], m + k))
        b.load(layout.Ex[i], layout.rhs, store=(layout.Ax[i], layout.joint_rhs))


def _init(b: ProgramBuilder) -> None:
    layout, p = b.layout, b.layout.params
    # Loads check that their element is finite.
    for i in range(p.n):
        b.load(layout.x, i)
        for j in range(i + 1):
            b.load(layout.L[i], j)
    for symbol, size in (("LQ", p.additive_q), ("LR", p.additive_r)):
        for i in range(size):
            vector, offset = layout.buffer_vector(symbol, i)
            for j in range(i + 1):
                b.load(vector, offset + j)
    first = 0
    for factor, points in ((layout.LQ, layout.W), (layout.LR, layout.V)):
        for i, row in enumerate(points):
            terms = [
                (b.load(factor[i], j), layout.noise_sigma[first + j], _Columns(layout).sigma)
                for j in range(i + 1)
            ]
            multiply_add(b, row, None, terms, _Columns(layout).sigma)
        first += len(points)


def _load_state(b: ProgramBuilder) -> list[tuple[Scalar, bool]]:
    return [(b.load(b.layout.x, i), False) for i in range(b.layout.params.n)]


def _sig_gen(b: ProgramBuilder) -> None:
    layout = b.layout
    state = _load_state(b)
    factor: dict[tuple[int, int], Scalar] = {}
    for i, (stored, working) in enumerate(zip(layout.L, layout.F, strict=True)):
        b.multiply(working, stored, layout.inverse_root_weight, [(0, i + 1)], broadcast=True)
        for j in range(i + 1):
            factor[i, j] = b.load(working, j)
    sig_gen(b, factor, state)


def _keep_factor(b: ProgramBuilder) -> None:
    """From the working copy of the factor to the next one."""
    for i, (stored, working) in enumerate(zip(b.layout.L, b.layout.F, strict=True)):
        b.multiply(stored, working, b.layout.root_weight, [(0, i + 1)], broadcast=True)


def _sig_gen_predicted(b: ProgramBuilder) -> None:
    layout, p, columns = b.layout, b.layout.params, _Columns(b.layout)
    state = _load_state(b)
    if p.form is Form.SQUARE_ROOT:
        rows = [Row(source, target) for source, target in zip(layout.Ex, layout.G, strict=True)]
        factor = trisolve(
            b, rows, layout.roots[p.m :], 0, p.n,
            pivots=lambda j: (columns.state_dots, columns.state_dots),
            gram_schmidt=True, factor=_store_factor(layout, 0), pivot_offset=p.m,
        )  # fmt: skip
    else:
        joint = trisolve(
            b, _joint_rows(layout), layout.roots, p.m, p.m + p.n, pivots=_joint_columns(layout),
            gram_schmidt=False, factor=_store_factor(layout, p.m),
        )  # fmt: skip
        factor = {(i - p.m, j - p.m): value for (i, j), value in joint.items()}
    _keep_factor(b)
    sig_gen(b, factor, state)


def _predict(b: ProgramBuilder) -> None:
    layout, columns = b.layout, _Columns(b.layout)
    for i, (points, residual) in enumerate(zip(layout.X, layout.Ex, strict=True)):
        mean_residual(b, points, residual, columns.all, columns.state_scaled, mean=(layout.x, i))
    if layout.params.form is Form.COVARIANCE:
        _predicted_gram(b)


def _update_redrawn(b: ProgramBuilder) -> None:
    layout, p, columns = b.layout, b.layout.params, _Columns(b.layout)
    # Sigma points that SIG_GEN did not write, for they equal x.
    rest = [(layout.sigma + p.n + 2, layout.rhs)]
    for i, (points, residual) in enumerate(zip(layout.X, layout.Ex, strict=True)):
        state = b.load(layout.x, i)
        b.axpy(points, None, state, layout.ones, rest)
        # Point 0 equals x, so its residual is zero without a factor.
        b.axpy(residual, points, state, layout.ones, columns.observation, subtract=True)
        b.axpy(residual, None, state, layout.ones, columns.process_noise)  # ones is zero there
    if p.form is Form.COVARIANCE:
        _predicted_gram(b)


def _residual_columns(layout: Layout) -> Callable[[int], tuple[Columns, Columns]]:
    """Columns of the residuals for pivot j: of its inner products, and that it changes."""
    columns, m = _Columns(layout), layout.params.m
    observation = (columns.observation_dots, columns.observation)
    state = (columns.state_dots, columns.state_dots)
    return lambda j: observation if j < m else state


def _joint_rows(layout: Layout) -> list[Row]:
    """Rows of the joint covariance: observation, then state."""
    return [Row(row, row) for row in layout.Az] + [
        Row(source, target) for source, target in zip(layout.Ax, layout.G, strict=True)
    ]


def _joint_columns(layout: Layout) -> Callable[[int], tuple[Columns, Columns]]:
    """Columns of the joint covariance that pivot j changes: above the diagonal."""
    m, rhs = layout.params.m, layout.joint_rhs
    return lambda j: ([], [(j + 1, rhs + 1 if j < m else rhs)])


def _update(b: ProgramBuilder) -> None:
    layout, p, columns = b.layout, b.layout.params, _Columns(b.layout)
    m, n = p.m, p.n
    for i, (points, residual) in enumerate(zip(layout.Z, layout.Ez, strict=True)):
        mean_residual(
            b, points, residual, columns.observation, columns.observation_scaled, observation=i
        )

    if p.form is Form.SQUARE_ROOT:
        rows = [Row(row, row) for row in layout.Ez] + [
            Row(source, target) for source, target in zip(layout.Ex, layout.G, strict=True)
        ]
        pivots = _residual_columns(layout)
    else:
        z = [Row(row, row) for row in layout.Ez]
        x = [Row(row, row) for row in layout.Ex]
        for i in range(m):
            for k in range(i, m):
                gram(b, z[i], z[k], columns.observation_dots, (layout.Az[i], k))
            for k in range(n):
                gram(b, z[i], x[k], columns.sigma, (layout.Az[i], m + k))
            b.load(layout.Ez[i], layout.rhs, store=(layout.Az[i], layout.joint_rhs))
        rows, pivots = _joint_rows(layout), _joint_columns(layout)

    rhs = layout.elimination_rhs
    gram_schmidt = p.form is Form.SQUARE_ROOT
    store = _store_factor(layout, m)
    trisolve(
        b, rows, layout.roots, 0, m, pivots=pivots, gram_schmidt=gram_schmidt, factor=_no_factor,
        innovation=rhs,
    )  # fmt: skip
    # The right-hand sides are y in the observation rows and minus the new state in the others.
    beat, lane = divmod(rhs, p.pes)
    nis = b.dot([(row.word(beat), row.word(beat), 1 << lane) for row in rows[:m]], is_nis=True)
    b.scale(nis, layout.inverse_weight, is_nis=True)
    state: list[tuple[Scalar, bool]] = []
    for i in range(n):
        negative = b.load(rows[m + i].vector(beat), rhs)
        b.scale(negative, layout.one, subtract=True, store=(layout.x, i))
        state.append((negative, True))
    L = trisolve(
        b, rows, layout.roots, m, m + n, pivots=pivots, gram_schmidt=gram_schmidt, factor=store
    )
    _keep_factor(b)
    sig_gen(b, {(i - m, j - m): value for (i, j), value in L.items()}, state)


def _covariance(b: ProgramBuilder) -> None:
    layout, n = b.layout, b.layout.params.n
    for i in range(n):
        for k in range(n):
            pairs = [
                (layout.L[i].word(beat), layout.L[k].word(beat), lanes)
                for beat, lanes in b.lanes_by_beat([(0, min(i, k) + 1)]).items()
            ]
            b.dot(pairs, store=(layout.P[i], k))


def _covariance_predicted(b: ProgramBuilder) -> None:
    layout, n = b.layout, b.layout.params.n
    rows = [Row(vector, vector) for vector in layout.Ex]
    for i in range(n):
        for k in range(n):
            product = gram(b, rows[i], rows[k], _Columns(layout).state_dots)
            b.scale(product, layout.weight, store=(layout.P[i], k))


_BUILDERS = {
    Program.INIT: _init,
    Program.SIG_GEN: _sig_gen,
    Program.SIG_GEN_PREDICTED: _sig_gen_predicted,
    Program.PREDICT: _predict,
    Program.UPDATE_REDRAWN: _update_redrawn,
    Program.UPDATE: _update,
    Program.COVARIANCE: _covariance,
    Program.COVARIANCE_PREDICTED: _covariance_predicted,
}


def build_program(layout: Layout, program: Program) -> list[Operation]:
    """List the operations of a program, in program order."""
    builder = ProgramBuilder(layout)
    _BUILDERS[program](builder)
    return builder.operations
