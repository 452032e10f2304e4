"""Names for what control words say: operands as vectors and columns, operations as text.

A vector stands with the columns that take part, as ``Ez[0][4..7]``; one that is a single number,
the same in every lane, stands alone. ``s3`` is a register of the scalar file. What is written to x
and L is ``x'`` and ``L'``: the copy that becomes the current one when the step has succeeded.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from ukf_sw.engine.control_word import BusSource
from ukf_sw.engine.disassembler import MARKS, Instruction, fields_of, kind_of, word_of
from ukf_sw.engine.layout import Word, is_banked
from ukf_sw.engine.microcode import Microcode
from ukf_sw.engine.operations import Kind
from ukf_sw.spec.sequence import Routine

__all__ = ["Line", "Mnemonics", "say_columns"]


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


def _remarks(marks: Mapping[str, int]) -> list[str]:
    """Say what a result is; a row that is not coupled is that of a pivot."""
    row = f"{'couples row' if 'coupling' in marks else 'pivot'} {marks.get('row')}"
    said = {"row": row, "coupling": ""}
    return list(filter(None, (said.get(name, name) for name in marks)))


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
            return f"{a}, {s}, {b}"


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

    def _columns(self, word: Word, lanes: int) -> tuple[str, list[int] | None]:
        """Vector of a word, and columns in these lanes; None if it is a single number."""
        vector, beat = self._code.layout.find(word)
        if vector.broadcast:
            return vector.name, None
        pes = self._code.params.pes
        return vector.name, [beat * pes + lane for lane in range(pes) if lanes >> lane & 1]

    def place(self, word: Word, lanes: int | None = None, *, written: bool = False) -> str:
        """Name some lanes of a word, or all.

        Parameters
        ----------
        word, lanes
            Word, and lanes as a bit mask.
        written
            Whether it is written, so the copy that is not current if it has two.
        """
        name, columns = self._columns(word, self._every_lane if lanes is None else lanes)
        if written and is_banked(word):
            name = f"{name[0]}'{name[1:]}"
        return name if columns is None else f"{name}[{say_columns(columns)}]"

    def lines(self, instruction: Instruction) -> list[Line]:
        """Describe an instruction: a line for each beat, and one for its reciprocal square root."""
        targets: list[str] = []
        if instruction.register is not None:
            targets.append(f"s{instruction.register}")
        if instruction.destination is not None:
            targets.append(self.place(instruction.destination, instruction.lanes, written=True))
        begin = f"{instruction.kind.name:8} {', '.join(targets)} "
        scalar = None if instruction.scalar is None else f"s{instruction.scalar}"
        lines: list[Line] = []
        for beat, clock in zip(instruction.beats, instruction.clocks, strict=True):
            a, b = (
                None if word is None else self.place(word, beat.lanes)
                for word in (beat.word_0, beat.word_1)
            )
            value = _join(instruction.kind, a, scalar, b, subtract=instruction.subtract)
            text = f"{'' if lines else begin:{len(begin)}}{'+' if lines else '='} {value}"
            lines.append(Line(clock, None if lines else instruction.done, text))
        remarks = _remarks(instruction.marks)
        if instruction.observation is not None:
            remarks.append(_masked(instruction.observation))
        if remarks:
            clock, done, text = lines[-1]
            lines[-1] = Line(clock, done, f"{text}  ({', '.join(remarks)})")
        if instruction.root is not None:
            text = f"{'':9}{self.place(instruction.root, written=True)} = 1/sqrt of it"
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

        def place(word: Word, lanes: int) -> dict[str, Any]:
            name, columns = self._columns(word, lanes)
            return {"vector": name, "columns": columns, "banked": is_banked(word)}

        writes: list[dict[str, Any]] = []
        if instruction.register is not None:
            writes.append({"clock": instruction.done, "register": instruction.register})
        if instruction.destination is not None:
            place_written = place(instruction.destination, instruction.lanes)
            writes.append({"clock": instruction.done, **place_written})
        if instruction.root is not None:
            root = place(instruction.root, self._every_lane)
            writes.append({"clock": instruction.root_clock, **root, "is": "1/sqrt"})
        return {
            "operation": instruction.kind.name,
            "clock": instruction.clocks[0],
            "done": instruction.done,
            "scalar": instruction.scalar,
            "subtract": instruction.subtract,
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

        Operands stand with all lanes where the word does not say which count, and a SCALE is called
        AXPY.
        """
        fields = fields_of(self._code, word)
        kind = kind_of(fields)
        if kind is None:
            return "-"
        lanes, select = None, fields.get("select", 0)
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
        widths = {name: self._code.format.fields[name].width for name in MARKS}
        targets += _remarks({n: fields[n] - (widths[n] > 1) for n in MARKS if n in fields})
        for name in ("lanes_observation", "bus_observation"):
            if name in fields:
                targets.append(_masked(fields[name] - 1))
        if fields.get("last"):
            targets.append("last")
        return ", ".join(targets) or "-"
