"""Programs of the user's models: the steps of :mod:`ukf_sw.spec.model_programs` as operations.

A temporary that differs between sigma points has a word for each beat of them, one that does not a
single word. The rows of the result are written over X, or into Z, and only there NaN and infinity
are errors: ``np.where(x > 0, np.log(x), 0)`` is legal.
"""

from itertools import count

from ukf_sw.engine.layout import TEMPORARY, Layout, Vector, Word
from ukf_sw.engine.operations import Beat, Kind, Operation, ProgramBuilder, Scalar
from ukf_sw.spec.model_programs import (
    Constant,
    ModelProgram,
    Operand,
    PickStep,
    RootStep,
    SlotStep,
    SourceKind,
    Step,
    Temporary,
)
from ukf_sw.spec.sequence import Program, Routine

__all__ = ["model_of", "model_program"]


def model_of(layout: Layout, routine: Routine) -> ModelProgram:
    """Give the model that a routine evaluates."""
    models = layout.params.models
    if routine.program is Program.MODEL_H:
        return models.h[routine.sensor][routine.variant]
    assert models.f is not None
    return models.f


def model_program(builder: ProgramBuilder, routine: Routine) -> None:
    """Add the operations of MODEL_F or MODEL_H to a builder."""
    emitter = _Emitter(builder, routine)
    emitter.load_inputs()
    for step in emitter.program.steps:
        emitter.emit(step)


class _Emitter:
    """Turns the steps of a model into operations.

    Parameters
    ----------
    builder
        Takes the operations.
    routine
        MODEL_F, or a MODEL_H.
    """

    def __init__(self, builder: ProgramBuilder, routine: Routine) -> None:
        self._builder = builder
        self._layout = layout = builder.layout
        self.program = program = model_of(layout, routine)
        self._is_f = routine.program is Program.MODEL_F
        p = layout.params
        first = p.m if self._is_f else p.rows_of(routine.sensor).start
        results = layout.X if self._is_f else layout.Z[first:]
        #: Rows of the result, and of the elimination, by the temporary that is written there.
        self._results = {
            output: (results[row], first + row)
            for row, output in enumerate(program.outputs)
            if isinstance(output, Temporary)
        }
        self._measured = {
            value: layout.Z[first + row].element(layout.rhs)
            for row, value in program.measurements
            if isinstance(value, Temporary)
        }
        self._observations = layout.Z[first:]
        self._every_lane = (1 << p.pes) - 1
        self._beats = builder.lanes_by_beat([layout.points])
        self._numbers = count()
        self._words: dict[Temporary, dict[int, Word]] = {}
        self._scalars: dict[Operand, Scalar] = {}

    def load_inputs(self) -> None:
        """Find the rows that the model reads, and load the numbers."""
        layout = self._layout
        for temporary, source in self.program.inputs:
            match source.kind:
                case SourceKind.STATE:
                    self._words[temporary] = self._row(layout.X[source.index])
                case SourceKind.NOISE:
                    noise = layout.W if self._is_f else layout.V
                    self._words[temporary] = self._row(noise[source.index])
                case SourceKind.INPUT:
                    self._load(*layout.U[0].element(source.index), temporary)
                case SourceKind.MEASUREMENT:
                    self._load(*self._observations[source.index].element(layout.rhs), temporary)

    def emit(self, step: Step) -> None:
        """Add the operations of a step."""
        match step:
            case SlotStep():
                self._emit_slot(step)
            case RootStep():
                self._emit_root(step)
            case PickStep():
                beat, lane = divmod(self._layout.params.centre, self._layout.params.pes)
                self._load(self._word(step.source, beat), lane, step.destination)
        self._scalars.pop(step.destination, None)

    def _row(self, vector: Vector) -> dict[int, Word]:
        return {beat: vector.word(beat) for beat in self._beats}

    def _new_word(self) -> Word:
        return next(self._numbers), TEMPORARY

    def _word(self, operand: Operand, beat: int) -> Word:
        """Give the word of an operand at a beat."""
        if isinstance(operand, Constant):
            return self._layout.model_words[operand.value.hex()].word(0)
        words = self._words[operand]
        return words[0] if operand in self.program.common else words[beat]

    def _places(self, temporary: Temporary) -> dict[int, tuple[Word, int]]:
        """Give the words that a temporary is written in and the lanes of each, by beat."""
        if temporary in self._results:
            row, _ = self._results[temporary]
            return {beat: (row.word(beat), lanes) for beat, lanes in self._beats.items()}
        if temporary in self._measured:
            word, lane = self._measured[temporary]
            return {0: (word, 1 << lane)}
        is_common = temporary in self.program.common
        lanes = {0: self._every_lane} if is_common else self._beats
        if temporary not in self._words:
            self._words[temporary] = {beat: self._new_word() for beat in lanes}
        words = self._words[temporary]
        return {beat: (words[beat], lanes[beat]) for beat in lanes}

    def _emit_slot(self, step: SlotStep) -> None:
        scalar = None if step.scalar is None else self._scalar(step.scalar)
        is_result = step.destination in self._results
        row = self._results[step.destination][1] if is_result else None
        for beat, (word, lanes) in self._places(step.destination).items():
            word_0, word_1 = (
                None if operand is None else self._word(operand, beat)
                for operand in (step.word_0, step.word_1)
            )
            self._builder.operations.append(
                Operation(
                    kind=Kind.SLOT, form=step.form, beats=(Beat(word_0, word_1, lanes),),
                    scalar=scalar,
                    destination=word, lanes=lanes, unchecked=not is_result, model_row=row,
                    observation=None if self._is_f else row,
                )
            )  # fmt: skip

    def _emit_root(self, step: RootStep) -> None:
        is_common = step.destination in self.program.common
        pes = self._layout.params.pes
        for beat, (word, lanes) in self._places(step.destination).items():
            source = self._word(step.source, beat)
            # What is the same in all lanes goes through once, and into all of them.
            each = [0] if is_common else [lane for lane in range(pes) if lanes >> lane & 1]
            for lane in each:
                self._builder.operations.append(
                    Operation(
                        kind=Kind.LOAD, beats=(Beat(source, None, 1 << lane),), root=word,
                        root_lanes=lanes if is_common else 1 << lane, root_kind=step.root,
                        unchecked=True,
                    )
                )  # fmt: skip

    def _load(self, word: Word, lane: int, temporary: Temporary) -> None:
        """Load a number into all lanes of a word."""
        destination, lanes = self._places(temporary)[0]
        self._builder.operations.append(
            Operation(
                kind=Kind.LOAD, beats=(Beat(word, None, 1 << lane),), destination=destination,
                lanes=lanes, unchecked=True,
            )
        )  # fmt: skip

    def _scalar(self, operand: Operand) -> Scalar:
        """Give an operand as a scalar, loaded when it is first needed."""
        if operand not in self._scalars:
            if isinstance(operand, Constant):
                constants = self._layout.model_scalars
                assert constants is not None
                column = self._layout.scalar_columns[operand.value.hex()]
                word, lane = constants.element(column)
            else:
                word, lane = self._word(operand, 0), 0
            result = self._builder.new_scalar()
            self._builder.operations.append(
                Operation(
                    kind=Kind.LOAD, beats=(Beat(word, None, 1 << lane),), result=result,
                    unchecked=True,
                )
            )  # fmt: skip
            self._scalars[operand] = result
        return self._scalars[operand]
