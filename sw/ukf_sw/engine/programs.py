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
    """Sets of columns of a layout.

    Parameters
    ----------
    layout
        The layout.
    rows
        Number of rows of the sensor that is observed: of additive r noise it has as many columns.
        None is all of them.
    """

    def __init__(self, layout: Layout, rows: int | None = None) -> None:
        self.sigma: Columns = [(layout.sigma, layout.rhs)]
        noise = self._observation_noise(layout, layout.sigma if rows is None else rows)
        #: What an observation row has: additive r noise, sigma points, right-hand side.
        self.observation: Columns = [*noise, (layout.sigma, layout.rhs + 1)]
        #: Its inner products.
        self.observation_dots: Columns = [*noise, (layout.sigma, layout.rhs)]
        #: Its columns that take a factor.
        self.observation_scaled: Columns = [*noise, (layout.sigma, layout.sigma + 1)]
        self.all: Columns = [(0, layout.columns)]
        #: Additive q noise.
        self.process_noise: Columns = [(layout.rhs + 1, layout.columns)]
        #: Columns of state rows that take a factor.
        self.state_scaled: Columns = [(layout.sigma, layout.sigma + 1), *self.process_noise]
        #: Inner products of state rows: all but the right-hand side.
        self.state_dots: Columns = [*self.observation_dots, *self.process_noise]

    @staticmethod
    def _observation_noise(layout: Layout, rows: int) -> Columns:
        """Columns of additive r noise, and those beside them that share a beat with others.

        The latter are zero, and a beat that moves takes them along.
        """
        pes, sigma = layout.params.pes, layout.sigma
        used = min(-(-rows // pes) * pes, sigma) if sigma else 0
        return [(0, used), (max(used, sigma - sigma % pes), sigma)]


def _no_factor(i: int, j: int) -> None:
    """Store no element of the factor."""


def _store_factor(layout: Layout, first: int) -> Callable[[int, int], tuple[Vector, int] | None]:
    """Where L_ij goes in the working copy, for state rows that begin at a row."""

    def store(i: int, j: int) -> tuple[Vector, int] | None:
        return (layout.F[i - first], j - first) if j >= first else None

    return store


def _predicted_gram(b: ProgramBuilder) -> None:
    """Covariance form: state rows of the joint covariance, and minus the mean beside them."""
    layout, n, before = b.layout, b.layout.params.n, b.layout.params.largest_sensor
    rows = [Row(vector, vector) for vector in layout.Ex]
    for i in range(n):
        for k in range(i, n):
            gram(b, rows[i], rows[k], _Columns(layout).state_dots, (layout.Ax[i], before + k))
        b.load(layout.Ex[i], layout.rhs, store=(layout.Ax[i], layout.joint_rhs))


def _init(b: ProgramBuilder) -> None:
    layout, p = b.layout, b.layout.params
    # Loads check that their element is finite.
    for i in range(p.n):
        b.load(layout.x, i)
        for j in range(i + 1):
            b.load(layout.L[i], j)
    lengths_of_r = [1 + k for rows in p.sensor_rows for k in range(rows)] if p.additive_r else []
    for symbol, lengths in (("LQ", range(1, p.additive_q + 1)), ("LR", lengths_of_r)):
        for i, length in enumerate(lengths):
            vector, offset = layout.buffer_vector(symbol, i)
            for j in range(length):
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
    before = p.largest_sensor
    state = _load_state(b)
    if p.form is Form.SQUARE_ROOT:
        rows = [Row(source, target) for source, target in zip(layout.Ex, layout.G, strict=True)]
        factor = trisolve(
            b, rows, layout.roots[before:], 0, p.n,
            pivots=lambda j: (columns.state_dots, columns.state_dots),
            gram_schmidt=True, factor=_store_factor(layout, 0), pivot_offset=p.m,
        )  # fmt: skip
    else:
        joint = trisolve(
            b, _joint_rows(layout), layout.roots, before, before + p.n,
            pivots=_joint_columns(layout), gram_schmidt=False, factor=_store_factor(layout, before),
            pivot_offset=p.m - before,
        )  # fmt: skip
        factor = {(i - before, j - before): value for (i, j), value in joint.items()}
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


def _residual_columns(
    layout: Layout, columns: _Columns
) -> Callable[[int], tuple[Columns, Columns]]:
    """Columns of the residuals for pivot j: of its inner products, and that it changes."""
    before = layout.params.largest_sensor
    observation = (columns.observation_dots, columns.observation)
    state = (columns.state_dots, columns.state_dots)
    return lambda j: observation if j < before else state


def _joint_rows(layout: Layout) -> list[Row]:
    """Rows of the joint covariance: observation, then state."""
    return [Row(row, row) for row in layout.Az] + [
        Row(source, target) for source, target in zip(layout.Ax, layout.G, strict=True)
    ]


def _joint_columns(layout: Layout) -> Callable[[int], tuple[Columns, Columns]]:
    """Columns of the joint covariance that pivot j changes: above the diagonal."""
    before, rhs = layout.params.largest_sensor, layout.joint_rhs
    return lambda j: ([], [(j + 1, rhs + 1 if j < before else rhs)])


def _update(b: ProgramBuilder, sensor: int) -> None:
    layout, p = b.layout, b.layout.params
    observed, n, last = p.rows_of(sensor), p.n, p.largest_sensor
    columns = _Columns(layout, len(observed))
    # Rows of the elimination: from `first` on those of the sensor, from `last` on the states.
    first = last - len(observed)
    for i, residual in zip(observed, layout.Ez[first:], strict=True):
        mean_residual(
            b, layout.Z[i], residual, columns.observation, columns.observation_scaled,
            observation=i,
        )  # fmt: skip

    if p.form is Form.SQUARE_ROOT:
        rows = [Row(row, row) for row in layout.Ez] + [
            Row(source, target) for source, target in zip(layout.Ex, layout.G, strict=True)
        ]
        pivots = _residual_columns(layout, columns)
    else:
        z = [Row(row, row) for row in layout.Ez]
        x = [Row(row, row) for row in layout.Ex]
        for i in range(first, last):
            for k in range(i, last):
                gram(b, z[i], z[k], columns.observation_dots, (layout.Az[i], k))
            for k in range(n):
                gram(b, z[i], x[k], columns.sigma, (layout.Az[i], last + k))
            b.load(layout.Ez[i], layout.rhs, store=(layout.Az[i], layout.joint_rhs))
        rows, pivots = _joint_rows(layout), _joint_columns(layout)

    rhs = layout.elimination_rhs
    gram_schmidt = p.form is Form.SQUARE_ROOT
    trisolve(
        b, rows, layout.roots, first, last, pivots=pivots, gram_schmidt=gram_schmidt,
        factor=_no_factor, pivot_offset=observed.start - first, innovation=rhs,
    )  # fmt: skip
    # The right-hand sides are y in the observation rows and minus the new state in the others.
    beat, lane = divmod(rhs, p.pes)
    nis = b.dot(
        [(row.word(beat), row.word(beat), 1 << lane) for row in rows[first:last]], is_nis=True
    )
    b.scale(nis, layout.inverse_weight, is_nis=True)
    state: list[tuple[Scalar, bool]] = []
    for i in range(n):
        negative = b.load(rows[last + i].vector(beat), rhs)
        b.scale(negative, layout.one, subtract=True, store=(layout.x, i))
        state.append((negative, True))
    L = trisolve(
        b, rows, layout.roots, last, last + n, pivots=pivots, gram_schmidt=gram_schmidt,
        factor=_store_factor(layout, last), pivot_offset=p.m - last,
    )  # fmt: skip
    _keep_factor(b)
    sig_gen(b, {(i - last, j - last): value for (i, j), value in L.items()}, state)


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


_BUILDERS: dict[Program, Callable[[ProgramBuilder], None]] = {
    Program.INIT: _init,
    Program.SIG_GEN: _sig_gen,
    Program.SIG_GEN_PREDICTED: _sig_gen_predicted,
    Program.PREDICT: _predict,
    Program.UPDATE_REDRAWN: _update_redrawn,
    Program.COVARIANCE: _covariance,
    Program.COVARIANCE_PREDICTED: _covariance_predicted,
}


def build_program(layout: Layout, program: Program, sensor: int = 0) -> list[Operation]:
    """List the operations of a program, in program order; an UPDATE is that of a sensor."""
    builder = ProgramBuilder(layout)
    if program is Program.UPDATE:
        _update(builder, sensor)
    else:
        _BUILDERS[program](builder)
    return builder.operations
