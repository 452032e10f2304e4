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
from ukf_sw.engine.model_programs import model_program
from ukf_sw.engine.operations import Operation, ProgramBuilder, Scalar
from ukf_sw.spec.parameters import Form
from ukf_sw.spec.sequence import Program, Routine

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
        self._layout = layout
        self._rows = layout.params.columns_of_r if rows is None else rows
        self.points: Columns = [layout.points]
        self._point_0: Columns = [(0, 1)] if layout.params.W0 else []
        #: Sigma points and right-hand side.
        self.no_noise: Columns = [*self.points, (layout.rhs, layout.rhs + 1)]
        #: What an observation row has: these, and additive r noise.
        self.observation: Columns = [*self.no_noise, *self._noise_beats()]

    def _noise_beats(self) -> Columns:
        """Columns of additive r noise, and those beside them that share a beat with others.

        The latter are zero, and a beat that moves takes them along.
        """
        layout, pes = self._layout, self._layout.params.pes
        start, stop = layout.noise_r
        used = {column // pes for column in (*range(start), *range(start, start + self._rows))}
        return [(k, k + 1) for k in range(start, stop) if k // pes in used]

    # Factors of noise are lower triangular, and elimination leaves them so: row i has noise in
    # columns 0 to i, as have its multiples.

    def _observation_noise(self, row: int) -> Columns:
        """Additive r noise of a row of the sensor."""
        start = self._layout.noise_r[0]
        return [(start, start + min(row + 1, self._layout.params.columns_of_r))]

    def process_noise(self, row: int) -> Columns:
        """Additive q noise of a state."""
        start = self._layout.noise_q[0]
        return [(start, start + min(row + 1, self._layout.params.additive_q))]

    def observation_scaled(self, row: int) -> Columns:
        """Columns of a row of the sensor that take a factor."""
        return [*self._point_0, *self._observation_noise(row)]

    def observation_dots(self, row: int) -> Columns:
        """Columns of its inner products with rows below it, of observations or of states."""
        return [*self.points, *self._observation_noise(row)]

    def observation_changes(self, row: int) -> Columns:
        """Columns of the rows below it that it changes in the elimination."""
        return [*self.no_noise, *self._observation_noise(row)]

    def state(self, row: int) -> Columns:
        """What a state has before an update."""
        return [*self.no_noise, *self.process_noise(row)]

    def state_scaled(self, row: int) -> Columns:
        """Columns of a state that take a factor."""
        return [*self._point_0, *self.process_noise(row)]

    def state_dots(self, row: int) -> Columns:
        """Columns of its inner products with states below it, before an update."""
        return [*self.points, *self.process_noise(row)]

    def updated_dots(self, row: int) -> Columns:
        """The same when observations have been eliminated, which leaves their noise in it."""
        return [*self.observation_dots(self._rows - 1), *self.process_noise(row)]


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
            gram(b, rows[i], rows[k], _Columns(layout).state_dots(i), (layout.Ax[i], before + k))
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
    # Above the diagonal the factors are zero, whatever the bus has written.
    noises = [(layout.X, layout.noise_q)]
    for sensor in range(len(p.sensor_rows)):
        own = p.rows_of(sensor)
        noises.append((layout.Z[own.start : own.stop], layout.noise_r))
    for points, (start, stop) in noises:
        for i, row in enumerate(points):
            b.multiply(row, layout.ones, layout.ones, [(start + i + 1, stop)])
    first = 0
    for factor, points in ((layout.LQ, layout.W), (layout.LR, layout.V)):
        for i, row in enumerate(points):
            terms = [
                (b.load(factor[i], j), layout.noise_sigma[first + j], _Columns(layout).points)
                for j in range(i + 1)
            ]
            multiply_add(b, row, None, terms, _Columns(layout).points)
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
            pivots=lambda j: (columns.state_dots(j), columns.state_dots(j)),
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
        mean_residual(
            b, points, residual, columns.state(i), columns.state_scaled(i), mean=(layout.x, i)
        )
    if layout.params.form is Form.COVARIANCE:
        _predicted_gram(b)


def _update_redrawn(b: ProgramBuilder) -> None:
    layout, p, columns = b.layout, b.layout.params, _Columns(b.layout)
    # Sigma points that SIG_GEN did not write, for they equal x.
    rest = [] if p.models else [(p.n + 2, p.N)]
    for i, (points, residual) in enumerate(zip(layout.X, layout.Ex, strict=True)):
        state = b.load(layout.x, i)
        b.axpy(points, None, state, layout.ones, rest)
        # Point 0 equals x, so its residual is zero without a factor.
        b.axpy(residual, points, state, layout.ones, columns.no_noise, subtract=True)
        b.axpy(residual, None, state, layout.ones, columns.process_noise(i))  # ones is zero there
    if p.form is Form.COVARIANCE:
        _predicted_gram(b)


def _residual_columns(layout: Layout, rows: int) -> Callable[[int], tuple[Columns, Columns]]:
    """Columns of the residuals for pivot j: of its inner products, and that it changes.

    Pivots are the rows of a sensor, so many, and then the states.
    """
    columns, last = _Columns(layout, rows), layout.params.largest_sensor
    first = last - rows

    def find(j: int) -> tuple[Columns, Columns]:
        if j < last:
            return columns.observation_dots(j - first), columns.observation_changes(j - first)
        return columns.updated_dots(j - last), columns.updated_dots(j - last)

    return find


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
            b, layout.Z[i], residual, columns.observation,
            columns.observation_scaled(i - observed.start), observation=i,
        )  # fmt: skip

    if p.form is Form.SQUARE_ROOT:
        rows = [Row(row, row) for row in layout.Ez] + [
            Row(source, target) for source, target in zip(layout.Ex, layout.G, strict=True)
        ]
        pivots = _residual_columns(layout, len(observed))
    else:
        z = [Row(row, row) for row in layout.Ez]
        x = [Row(row, row) for row in layout.Ex]
        for i in range(first, last):
            for k in range(i, last):
                gram(b, z[i], z[k], columns.observation_dots(i - first), (layout.Az[i], k))
            for k in range(n):
                gram(b, z[i], x[k], columns.points, (layout.Az[i], last + k))
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
            product = gram(b, rows[i], rows[k], _Columns(layout).state_dots(min(i, k)))
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


def build_program(
    layout: Layout, program: Program, sensor: int = 0, variant: int = 0
) -> list[Operation]:
    """List the operations of a program, in program order.

    An UPDATE is that of a sensor, a MODEL_H that of a variant of its model.
    """
    builder = ProgramBuilder(layout)
    if program in (Program.MODEL_F, Program.MODEL_H):
        model_program(builder, Routine(program, sensor, variant))
    elif program is Program.UPDATE:
        _update(builder, sensor)
    else:
        _BUILDERS[program](builder)
    return builder.operations
