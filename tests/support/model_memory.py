"""Memories of a core whose models run, and what a model is to leave in them.

Nothing here knows schedules or places of temporaries: results are those of the steps, executed on
arrays, and the memory map says where they stand.
"""

import numpy as np

from ukf_sw.elementary.execution import execute
from ukf_sw.engine.layout import Layout
from ukf_sw.spec.model_programs import SourceKind, Temporary
from ukf_sw.spec.parameters import Form
from ukf_sw.spec.sequence import Program

__all__ = ["ModelMemory", "model_of"]


def model_of(params, routine):
    """The model that a routine evaluates."""
    if routine.program is Program.MODEL_F:
        return params.models.f
    return params.models.h[routine.sensor][routine.variant]


class ModelMemory:
    """Words of all memories, filled at random; what a model may use as it likes holds NaN.

    Parameters
    ----------
    layout : Layout
        Of a core with models.
    rng : numpy.random.Generator
        Where numbers come from.
    draw : callable
        Gives numbers of a kind (SourceKind), shape (rows, columns); by default of a normal
        distribution.

    Attributes
    ----------
    words
        The words, shape (pes, depth).
    numbers
        Arguments of the models: rows of x, w, v by column, u, z.
    """

    def __init__(self, layout: Layout, rng, draw=None):
        self.layout, self.params = layout, layout.params
        p, fmt = self.params, self.params.format
        self.points = np.array(p.points)
        draw = draw or (lambda kind, rows, columns: rng.normal(size=(rows, columns)))
        self.words = layout.initial_words()
        rows = [layout.x, *layout.L, *layout.P, *layout.LQ, *layout.LR, *layout.F, *layout.Ex,
                *layout.Ez, *layout.Az, *layout.Ax, *layout.G, *layout.roots, *layout.X, *layout.W,
                *layout.V, *layout.Z, *layout.U]  # fmt: skip
        for row in rows:
            for bank in (0, 1) if row.bank else (0,):
                own = slice(row.address + bank * layout.bank_offset, None)
                own = slice(own.start, own.start + row.beats)
                self.words[:, own] = fmt.encode(rng.normal(size=(p.pes, row.beats)))
        count = p.N
        self.numbers = {
            (SourceKind.STATE, None): fmt.round(draw(SourceKind.STATE, p.n, count)),
            (SourceKind.NOISE, "w"): fmt.round(draw(SourceKind.NOISE, p.augmented_q, count)),
            (SourceKind.NOISE, "v"): fmt.round(draw(SourceKind.NOISE, p.augmented_r, count)),
            (SourceKind.INPUT, None): fmt.round(
                draw(SourceKind.INPUT, len(p.models.inputs), 1)
            ),
            (SourceKind.MEASUREMENT, None): fmt.round(draw(SourceKind.MEASUREMENT, p.m, 1)),
        }  # fmt: skip
        for (kind, name), group in (
            ((SourceKind.STATE, None), layout.X), ((SourceKind.NOISE, "w"), layout.W),
            ((SourceKind.NOISE, "v"), layout.V),
        ):  # fmt: skip
            for row, vector in enumerate(group):
                for k in p.points:
                    self.put(vector, k, self.numbers[kind, name][row, k])
        for row, vector in enumerate(layout.Z):
            for k in p.points:
                self.put(vector, k, rng.normal())
            z = self.numbers[SourceKind.MEASUREMENT, None]
            self.put(vector, layout.rhs, z[row, 0])
        for k in range(len(p.models.inputs)):
            self.put(layout.U[0], k, self.numbers[SourceKind.INPUT, None][k, 0])

    def put(self, vector, column, value):
        """Write a number."""
        (address, _), lane = vector.element(column)
        self.words[lane, address] = self.params.format.encode(np.array([value]))[0]

    def lent(self, program):
        """Which words a model may use as it likes, shape (pes, depth)."""
        layout, pes = self.layout, self.params.pes
        lent = np.zeros(self.words.shape, dtype=bool)
        rows = [*layout.Ez, *(layout.G if self.params.form is Form.SQUARE_ROOT else [])]
        rows += layout.Ex if program is Program.MODEL_F else []
        for row in rows:
            for column in self.points.tolist():
                (address, _), lane = row.element(column)
                lent[lane, address] = True
        for row in (*layout.roots, *layout.temporaries):
            lent[:, row.address] = True
        assert pes == len(lent)
        return lent

    def poison(self, program):
        """Fill what a model may use with NaN."""
        self.words[self.lent(program)] = self.params.format.nan

    def results(self, routine):
        """Numbers that a model gives: rows by point, and observations by row."""
        p, model = self.params, model_of(self.params, routine)
        assert model is not None
        is_f = routine.program is Program.MODEL_F
        first = 0 if is_f else p.rows_of(routine.sensor).start
        values = {}
        for temporary, source in model.inputs:
            name = ("w" if is_f else "v") if source.kind is SourceKind.NOISE else None
            row = source.index + (first if source.kind is SourceKind.MEASUREMENT else 0)
            numbers = self.numbers[source.kind, name][row]
            per_point = source.kind in (SourceKind.STATE, SourceKind.NOISE)
            values[temporary] = numbers[self.points] if per_point else numbers
        execute(p.format, model.steps, values, p.centre - p.points.start)

        def value(output):
            return values[output] if isinstance(output, Temporary) else np.array([output.value])

        rows = [np.broadcast_to(value(each), self.points.shape) for each in model.outputs]
        return rows, {row: float(value(each)[0]) for row, each in model.measurements}

    def expect(self, routine, mask=-1):
        """Words that a model leaves; those that it may use are whatever they are."""
        p, layout = self.params, self.layout
        rows, measured = self.results(routine)
        is_f = routine.program is Program.MODEL_F
        first = 0 if is_f else p.rows_of(routine.sensor).start
        after = ModelMemory.__new__(ModelMemory)
        after.__dict__.update(self.__dict__, words=self.words.copy())
        for row, values in enumerate(rows):
            vector = layout.X[row] if is_f else layout.Z[first + row]
            taken = is_f or mask >> (first + row) & 1
            for column, number in zip(self.points.tolist(), values.tolist(), strict=True):
                after.put(vector, column, number if taken else 0.0)
        for row, number in measured.items():
            after.put(layout.Z[first + row], layout.rhs, number)
        return after.words
