"""Names for what control words say: operands as vectors and columns, operations as text.

A vector stands with the columns that take part, as ``Ez[0][4..7]``; one that is a single number,
the same in every lane, stands alone. ``s3`` is a register of the scalar file. What is written to x
and L is ``x'`` and ``L'``: the copy that becomes the current one when the step has succeeded.

In programs of models a constant that is a word stands as its value, in 9 digits, and temporaries
have the names of the words that they are in: words of their own, or of vectors that hold nothing
meanwhile. The columns of ``temporary`` and ``root`` are lanes; where they are those of what is
written, they are left out.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ukf_sw.engine.control_word import STEERING, BusSource, form_of
from ukf_sw.engine.disassembler import MARKS, Instruction, fields_of, kind_of, word_of
from ukf_sw.engine.layout import Word, is_banked
from ukf_sw.engine.microcode import Microcode
from ukf_sw.engine.operations import Beat, Kind
from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Sign
from ukf_sw.spec.sequence import Routine

__all__ = ["Line", "Mnemonics", "say_columns", "say_constant"]


class Line(NamedTuple):
    """A line of a listing.

    Parameters
    ----------
    clock
        Clock of the reads; None if there are none.
    done
        Clock of the writes; None if there are none.
    text
        What is done.
    """

    clock: int | None
    done: int | None
    text: str


def say_columns(columns: Iterable[int]) -> str:
    """Say columns, rising, as runs: 0..3,5."""
    runs: list[list[int]] = []
    for column in columns:
        if runs and runs[-1][-1] == column - 1:
            runs[-1].append(column)
        else:
            runs.append([column])
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}..{run[-1]}" for run in runs)


def say_constant(value: float) -> str:
    """Say a constant of a model in few letters; its record has all digits."""
    return f"{value:.9g}"


def _is_of_model(instruction: Instruction) -> bool:
    """Whether an instruction belongs to the program of a model."""
    return instruction.kind is Kind.SLOT or "unchecked" in instruction.marks


def _masked(observation: int) -> str:
    """Say what a masked observation does."""
    return f"0 if z[{observation}] masked"


def _join(kind: Kind, a: str | None, s: str | None, b: str | None, *, subtract: bool) -> str:
    """Write down what a beat computes."""
    match kind:
        case Kind.LOAD:
            return f"{a}"
        case Kind.MULTIPLY:
            return f"{a} * {b}"
        case Kind.DOT:
            return f"{a} . {b}"
        case Kind.AXPY | Kind.SCALE:
            sign = "-" if subtract else "+"
            first = f"{a} {sign} " if a is not None else "-" * subtract
            return f"{first}{s} * {b}"
        case Kind.SLOT:
            raise ValueError("kind must be one whose form is fixed, not SLOT")


def _factor(form: Form, a: str | None, b: str | None) -> str:
    """Write down operand b of a form, as it is read and with its sign."""
    if form.reading is Reading.ONE:
        read = "1"
    else:
        read = f"{b}" if form.reading is Reading.NUMBER else f"{form.reading.value}({b})"
    match form.sign:
        case Sign.KEEP:
            return read
        case Sign.CLEAR:
            return read if read == "1" else f"|{read}|"
        case Sign.COPY:
            sign = f"sign({a})"
            return sign if read == "1" else f"|{read}| * {sign}"
        case Sign.BIT_0 | Sign.BIT_1:
            sign = f"(-1)^{form.sign.value.replace(' ', '')}({a})"
            return sign if read == "1" else f"{read} * {sign}"


def _join_form(form: Form, a: str | None, s: str | None, b: str | None) -> str:
    """Write down what a SLOT computes; a is word 0, b is word 1."""
    factor = _factor(form, a, b)
    multiplier = f"{s if form.multiplier is Multiplier.SCALAR else a}"
    product = multiplier if factor == "1" else f"{multiplier} * {factor}"
    addends = {
        Addend.PLUS_ZERO: "0", Addend.MINUS_ZERO: None, Addend.WORD: a, Addend.SCALAR: s,
    }  # fmt: skip
    addend = addends[form.addend]
    if addend is None:
        return "-" * form.subtract + product
    return f"{addend} {'-' if form.subtract else '+'} {product}"


def _condition(form: Form, b: str | None) -> str:
    """Say which lanes a SLOT with a condition writes."""
    if form.condition is Condition.FINITE:
        return "where that is finite"
    return f"where {b} is {form.condition.value}"


class Mnemonics:
    """What control words of a core say, in words.

    Parameters
    ----------
    code
        Programs of the core.
    """

    def __init__(self, code: Microcode) -> None:
        self._code = code
        self._every_lane = (1 << code.params.pes) - 1
        self._temporaries = frozenset((*code.layout.roots, *code.layout.temporaries))
        self._constants = {
            vector.word(0): float.fromhex(value)
            for value, vector in code.layout.model_words.items()
        }

    def _is_shared(self, word: Word) -> bool:
        """Whether the columns of a word are lanes when a temporary of a model is in it."""
        vector, _ = self._code.layout.find(word)
        return vector in self._temporaries

    def _columns(
        self, word: Word, lanes: int, *, of_model: bool = False
    ) -> tuple[str, list[int] | None]:
        """Vector of a word, and columns in these lanes; None if it is a single number."""
        vector, beat = self._code.layout.find(word)
        if vector.broadcast and not (of_model and vector in self._temporaries):
            return vector.name, None
        pes = self._code.params.pes
        return vector.name, [beat * pes + lane for lane in range(pes) if lanes >> lane & 1]

    def place(
        self,
        word: Word,
        lanes: int | None = None,
        *,
        written: bool = False,
        of_model: bool = False,
    ) -> str:
        """Name some lanes of a word, or all; a constant of a model is its value.

        Parameters
        ----------
        word, lanes
            Word, and lanes as a bit mask.
        written
            Whether it is written, so the copy that is not current if it has two.
        of_model
            Whether a temporary of a model may be in it.
        """
        if word in self._constants:
            return say_constant(self._constants[word])
        lanes = self._every_lane if lanes is None else lanes
        name, columns = self._columns(word, lanes, of_model=of_model)
        if written and is_banked(word):
            name = f"{name[0]}'{name[1:]}"
        return name if columns is None else f"{name}[{say_columns(columns)}]"

    def _input(self, beat: Beat) -> str | None:
        """Say what a load of a constant or of an input of models loads; None of all others."""
        layout = self._code.layout
        assert beat.word_0 is not None
        vector, first = layout.find(beat.word_0)
        column = first * self._code.params.pes + beat.lanes.bit_length() - 1
        if vector in layout.U and column < len(self._code.params.models.inputs):
            return self._code.params.models.inputs[column]
        if vector == layout.model_scalars and column < len(layout.scalar_columns):
            return say_constant(float.fromhex([*layout.scalar_columns][column]))
        return None

    def _value(self, instruction: Instruction, beat: Beat) -> str:
        """Write down what a beat of an instruction computes."""
        form, of_model = instruction.form, _is_of_model(instruction)

        def name(word: Word | None) -> str | None:
            if word is None:
                return None
            # Those of a temporary are the lanes that are written.
            if form is not None and self._is_shared(word):
                return self._code.layout.find(word)[0].name
            return self.place(word, beat.lanes, of_model=of_model)

        a, b = name(beat.word_0), name(beat.word_1)
        scalar = None if instruction.scalar is None else f"s{instruction.scalar}"
        if form is not None:
            return _join_form(form, a, scalar, b)
        return _join(instruction.kind, a, scalar, b, subtract=instruction.subtract)

    def _remarks(self, marks: Mapping[str, int]) -> list[str]:
        """Say what a result is; a row that is neither coupled nor of a model is that of a pivot."""
        row = marks.get("row")
        if "of_model" in marks and row is not None:
            m = self._code.params.m
            text = f"row {row} of h" if row < m else f"row {row - m} of f"
        else:
            text = f"{'couples row' if 'coupling' in marks else 'pivot'} {row}"
        said = {"row": text, "coupling": "", "of_model": ""}
        return list(filter(None, (said.get(name, name) for name in marks)))

    def lines(self, instruction: Instruction) -> list[Line]:
        """Describe an instruction.

        A line for each beat, one for its condition, and one for its reciprocal square root.
        """
        of_model = _is_of_model(instruction)
        targets: list[str] = []
        if instruction.register is not None:
            targets.append(f"s{instruction.register}")
        if instruction.destination is not None:
            targets.append(
                self.place(
                    instruction.destination, instruction.lanes, written=True, of_model=of_model
                )
            )
        begin = f"{instruction.kind.name:8} {', '.join(targets)}{' ' if targets else ''}"
        lines: list[Line] = []
        for beat, clock in zip(instruction.beats, instruction.clocks, strict=True):
            value = self._value(instruction, beat)
            text = f"{'' if lines else begin:{len(begin)}}{'+' if lines else '='} {value}"
            if not targets:  # a number for 1/sqrt alone
                text = begin + value
            lines.append(Line(clock, None if lines else instruction.done, text))
        # That it is unchecked goes without saying, that a root is signed stands with it, and the
        # row of an h is that of its observation.
        silent = {"unchecked", "signed"}
        if "of_model" in instruction.marks and instruction.observation is not None:
            silent |= {"row", "of_model"}
        remarks = self._remarks({k: v for k, v in instruction.marks.items() if k not in silent})
        if instruction.observation is not None:
            remarks.append(_masked(instruction.observation))
        if instruction.kind is Kind.LOAD:
            remarks += filter(None, [self._input(instruction.beats[0])])
        if remarks:
            clock, done, text = lines[-1]
            lines[-1] = Line(clock, done, f"{text}  ({', '.join(remarks)})")
        form = instruction.form
        if form is not None and form.condition is not Condition.ALWAYS:
            word = instruction.beats[0].word_1
            b = None if word is None else self.place(word, instruction.lanes, of_model=True)
            lines.append(Line(None, None, f"{'':9}{_condition(form, b)}"))
        if instruction.root is not None:
            root = self.place(
                instruction.root, instruction.root_lanes, written=True, of_model=of_model
            )
            signed = "signed " if "signed" in instruction.marks else ""
            text = f"{'':9}{root} = {signed}1/sqrt of it"
            lines.append(Line(None, instruction.root_clock, text))
        return lines

    def listing(self, routine: Routine, instructions: Sequence[Instruction]) -> str:
        """Give a program as text for people, of 100 columns at most.

        Parameters
        ----------
        routine
            Which one.
        instructions
            What was found in its words.
        """
        words = len(self._code.words_of(*routine))
        lines = [
            f"{self._code.name_of(routine)}: {words} words, {len(instructions)} operations",
            "clock  done  operation",
        ]
        for instruction in instructions:
            for line in self.lines(instruction):
                clock, done = ("" if at is None else at for at in (line.clock, line.done))
                lines.append(f"{clock:>5} {done:>5}  {line.text}")
        return "\n".join(lines)

    def record(self, instruction: Instruction) -> dict[str, Any]:
        """Describe an instruction, ready for JSON."""
        of_model = _is_of_model(instruction)

        def place(word: Word, lanes: int) -> dict[str, Any]:
            name, columns = self._columns(word, lanes, of_model=of_model)
            found: dict[str, Any] = {"vector": name, "columns": columns, "banked": is_banked(word)}
            if word in self._constants:
                found["value"] = self._constants[word]
            return found

        writes: list[dict[str, Any]] = []
        if instruction.register is not None:
            writes.append({"clock": instruction.done, "register": instruction.register})
        if instruction.destination is not None:
            place_written = place(instruction.destination, instruction.lanes)
            writes.append({"clock": instruction.done, **place_written})
        if instruction.root is not None:
            root = place(instruction.root, instruction.root_lanes)
            writes.append({"clock": instruction.root_clock, **root, "is": "1/sqrt"})
        form = instruction.form
        return {
            "operation": instruction.kind.name,
            "clock": instruction.clocks[0],
            "done": instruction.done,
            "scalar": instruction.scalar,
            "subtract": instruction.subtract,
            "form": None
            if form is None
            else {
                "multiplier": form.multiplier.value,
                "addend": form.addend.value,
                "reading": form.reading.value,
                "sign": form.sign.value,
                "subtract": form.subtract,
                "condition": form.condition.value,
            },
            "beats": [
                {
                    "clock": clock,
                    "reads": [
                        place(word, beat.lanes)
                        for word in (beat.word_0, beat.word_1)
                        if word is not None
                    ],
                }
                for beat, clock in zip(instruction.beats, instruction.clocks, strict=True)
            ],
            "writes": writes,
            "observation": instruction.observation,
            "marks": dict(instruction.marks),
            "text": [line.text for line in self.lines(instruction)],
        }

    # A word by itself does not say everything about what it reads: which lanes an operation is for,
    # and whether it is an AXPY or a SCALE, only the word says that ends it.

    def reads(self, word: int) -> str:
        """Describe what a control word by itself reads, or give a dash.

        Operands stand with all lanes where the word does not say which count, a SCALE is called
        AXPY, and a SLOT is called what it would be in a program of the filter, if it can be.
        """
        fields = fields_of(self._code, word)
        kind = kind_of(fields)
        if kind is None:
            return "-"
        lanes, select = None, fields.get("select", 0)
        if kind is Kind.SLOT:
            form = form_of([name for name in STEERING if name in fields])
            if form is None:
                return "SLOT of no form"
            a, b = (
                self.place(word_of(fields, f"address_{port}", f"bank_{{}}_{port}"))
                if used
                else None
                for port, used in enumerate((form.uses_word_0, form.uses_word_1))
            )
            value = _join_form(form, a, f"s{fields.get('scalar_address', 0)}", b)
            where = "" if form.condition is Condition.ALWAYS else f" {_condition(form, b)}"
            return f"{kind.name} {value}{where}"
        if kind is Kind.DOT:
            lanes = self._code.lane_sets[select]
        elif kind is Kind.LOAD:
            lanes = 1 << select
        has_a = kind in (Kind.MULTIPLY, Kind.DOT, Kind.LOAD) or not fields.get("zero")
        value = _join(
            kind,
            self.place(word_of(fields, "address_0", "bank_{}_0"), lanes) if has_a else None,
            f"s{fields.get('scalar_address', 0)}",
            None
            if kind is Kind.LOAD
            else self.place(word_of(fields, "address_1", "bank_{}_1"), lanes),
            subtract=bool(fields.get("subtract")),
        )
        more = "+ " if kind is Kind.DOT and not fields.get("first") else ""
        return f"{kind.name} {more}{value}"

    def writes(self, word: int) -> str:
        """Describe what a control word by itself writes, or give a dash."""
        fields = fields_of(self._code, word)
        source = BusSource(fields.get("bus_source", BusSource.RESULT)).name
        targets: list[str] = []
        if fields.get("scalar_write"):
            targets.append(f"s{fields.get('scalar_write_address', 0)} = {source}")
        if fields.get("write"):
            target = word_of(fields, "write_address", "write_bank_{}")
            lanes = self._code.lane_sets[fields.get("write_lanes", 0)]
            place = self.place(target, lanes, written=True)
            targets.append(f"{place} = {source if fields.get('write_bus') else 'LANES'}")
        marks = [name for name in MARKS if name in fields]
        widths = {name: self._code.format.fields[name].width for name in marks}
        targets += self._remarks({name: fields[name] - (widths[name] > 1) for name in marks})
        for name in ("lanes_observation", "bus_observation"):
            if name in fields:
                targets.append(_masked(fields[name] - 1))
        if fields.get("last"):
            targets.append("last")
        return ", ".join(targets) or "-"
