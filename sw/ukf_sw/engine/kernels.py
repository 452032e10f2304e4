"""The filter's matrix operations, as lists of operations on the array.

They carry the names of the 2018 paper's modules: the triangular linear equation solver
(`trisolve`), the matrix multiply-add, the mean and covariance, and `sig_gen`, which uses two of
them. All vectors lie along the sigma points, so no kernel transposes anything.
"""

from collections.abc import Callable, Sequence

from ukf_sw.engine.layout import Vector, Word
from ukf_sw.engine.operations import ProgramBuilder, Scalar

__all__ = ["Row", "gram", "mean_residual", "multiply_add", "sig_gen", "trisolve"]

#: Pairs of first column and column after the last.
Columns = Sequence[tuple[int, int]]


class Row:
    """A row under elimination: read where it lies, written to its working place.

    The first change of a beat reads `source` and writes `target`; from then on the beat lives in
    `target`. So the source survives, and copying it costs nothing.
    """

    def __init__(self, source: Vector, target: Vector) -> None:
        self._source = source
        self._target = target
        self._moved: set[int] = set()

    def word(self, beat: int) -> Word:
        """Where a beat is now."""
        return self.vector(beat).word(beat)

    def vector(self, beat: int) -> Vector:
        """Vector that holds a beat now."""
        return self._target if beat in self._moved else self._source

    def change(self, beat: int, lanes: int, moved: int) -> tuple[Word, Word, int]:
        """Word to write, word to read and lanes to write for a beat that is about to change.

        A beat that moves takes the lanes `moved` along.
        """
        source = self.word(beat)
        self._moved.add(beat)
        target = self.word(beat)
        return target, source, lanes if target == source else moved


def inner(
    builder: ProgramBuilder, a: Row, b: Row, columns: Columns
) -> list[tuple[Word, Word, int]]:
    """Beats of the inner product of two rows."""
    return [
        (a.word(beat), b.word(beat), lanes)
        for beat, lanes in builder.lanes_by_beat(columns).items()
    ]


def mean_residual(
    builder: ProgramBuilder,
    points: Vector,
    residual: Vector,
    columns: Columns,
    scaled: Columns,
    *,
    mean: tuple[Vector, int] | None = None,
    observation: int | None = None,
) -> None:
    """Mean of a row of sigma points, and the row less its mean (2018, equations 25 and 27).

    The residuals are in units of sqrt(W1). The measurement, or zero, in the right-hand side column
    becomes the innovation, or minus the mean. Additive noise columns are copied, in that unit.

    Parameters
    ----------
    points, residual
        Row to read, row to write.
    columns
        Columns of the residual.
    scaled
        Columns that take a factor: sigma point 0, and additive noise that the row has.
    mean
        Where to store the mean.
    observation
        Observation whose mask clears mean and residual.
    """
    layout = builder.layout
    value = builder.dot(
        [
            (points.word(beat), layout.weights.word(beat), lanes)
            for beat, lanes in builder.lanes_by_beat([layout.points]).items()
        ],
        store=mean,
        observation=observation,
    )
    builder.axpy(
        residual, points, value, layout.ones, columns, subtract=True, observation=observation
    )
    builder.multiply(residual, residual, layout.scale, scaled, observation=observation)


def gram(
    builder: ProgramBuilder,
    a: Row,
    b: Row,
    columns: Columns,
    store: tuple[Vector, int] | None = None,
) -> Scalar:
    """One element of a covariance, in units of W1: the inner product of two rows of residuals."""
    return builder.dot(inner(builder, a, b, columns), store=store)


def trisolve(
    builder: ProgramBuilder,
    rows: Sequence[Row],
    roots: Sequence[Vector],
    first: int,
    last: int,
    *,
    pivots: Callable[[int], tuple[Columns, Columns]],
    gram_schmidt: bool,
    factor: Callable[[int, int], tuple[Vector, int] | None],
    pivot_offset: int = 0,
    innovation: int | None = None,
) -> dict[tuple[int, int], Scalar]:
    """Triangular factorisation by elimination, pivot by pivot; right-hand sides go along.

    For pivot j, with d the pivot and t_i what couples row i to it::

        g = 1/sqrt(d) ;  q = g e_j ;  for i > j:  L_ij = t_i g ;  e_i = e_i - L_ij q

    Of rows of residuals (Gram-Schmidt, the square-root form), d and t_i are the inner
    products e_j . e_j and e_i . e_j. Of rows of a symmetric matrix (L D L^T, the covariance form,
    2018, equations 20 to 24), they are the elements of row j, of which only the upper triangle is
    kept.

    Parameters
    ----------
    rows
        All rows, those of the state last.
    roots
        A broadcast word for 1/sqrt of each pivot.
    first, last
        Rows that are pivots, the last exclusive.
    pivots
        For pivot j, the columns of the inner products (none of a symmetric matrix) and the
        columns that change.
    gram_schmidt
        Whether the rows are residuals; else they are those of a symmetric matrix.
    factor
        Where to store L_ij, or None.
    pivot_offset
        What the number of row 0 is, for the report of a bad pivot.
    innovation
        Column of the right-hand side, where the pivots are observations; else None.

    Returns
    -------
    dict
        L_ij by (i, j), the diagonal included where it is stored.
    """
    L: dict[tuple[int, int], Scalar] = {}
    pes = builder.layout.params.pes
    every_lane = (1 << pes) - 1
    innovation_beat = None if innovation is None else innovation // pes
    for j in range(first, last):
        dots, changed = pivots(j)
        others = range(j + 1, len(rows))
        if gram_schmidt:
            d = builder.dot(
                inner(builder, rows[j], rows[j], dots), pivot=j + pivot_offset, root=roots[j]
            )
            t = {i: builder.dot(inner(builder, rows[i], rows[j], dots)) for i in others}
        else:
            d = builder.load_pivot(
                rows[j].vector(j // pes), j, pivot=j + pivot_offset, root=roots[j]
            )
            t = {i: builder.load(rows[j].vector(i // pes), i) for i in others}
        if others:
            for beat, changing in builder.lanes_by_beat(changed).items():
                moved = every_lane if gram_schmidt else changing
                target, source, lanes = rows[j].change(beat, changing, moved)
                builder.multiply_beat(
                    target, source, roots[j].word(0), lanes, innovation=beat == innovation_beat
                )
        for i in others:
            coupling = i + pivot_offset if innovation is not None and i < last else None
            L[i, j] = builder.scale(t[i], roots[j], store=factor(i, j), coupling=coupling)
            kept = changed if gram_schmidt else [(max(a, i), b) for a, b in changed]
            for beat, changing in builder.lanes_by_beat(kept).items():
                q = rows[j].word(beat)
                moved = every_lane if gram_schmidt else changing
                target, source, lanes = rows[i].change(beat, changing, moved)
                builder.axpy_beat(
                    target, source, L[i, j], q, lanes, subtract=True,
                    innovation=beat == innovation_beat,
                )  # fmt: skip
        if (store := factor(j, j)) is not None:
            L[j, j] = builder.scale(d, roots[j], store=store)
    return L


def multiply_add(
    builder: ProgramBuilder,
    destination: Vector,
    start: tuple[Scalar, Vector, bool] | None,
    terms: Sequence[tuple[Scalar, Vector, Columns]],
    columns: Columns,
) -> None:
    """One row of the matrix multiply-add: a row plus scalars times rows (2018, section 3.2.2).

    Parameters
    ----------
    destination
        Row to write.
    start
        Scalar, row and whether to subtract their product: what the sum starts from. None: zero.
    terms
        Scalar, row and the columns in which the row is not zero.
    columns
        Columns of the result.
    """
    if start is not None:
        scalar, row, subtract = start
        builder.axpy(destination, None, scalar, row, columns, subtract=subtract)
    for k, (scalar, row, nonzero) in enumerate(terms):
        if start is None and k == 0:
            builder.axpy(destination, None, scalar, row, columns)
        else:
            builder.axpy(destination, destination, scalar, row, nonzero)


def sig_gen(
    builder: ProgramBuilder,
    L: dict[tuple[int, int], Scalar],
    state: Sequence[tuple[Scalar, bool]],
) -> None:
    """Sigma points of the state, X = x + L sigma (2018, equation 8).

    Those after point n + 1 equal x. They are not written, unless models on the core read them.

    Parameters
    ----------
    L
        Factor in units of sqrt(W1), by (row, column), the diagonal included.
    state
        For each state a scalar and whether the state is its negative.
    """
    layout = builder.layout
    n = layout.params.n
    columns = [(layout.points[0], layout.points[1] if layout.params.models else n + 2)]
    for i in range(n):
        terms = [(L[i, j], layout.state_sigma[j], [(1, j + 3)]) for j in range(i + 1)]
        scalar, negative = state[i]
        multiply_add(builder, layout.X[i], (scalar, layout.ones, negative), terms, columns)
