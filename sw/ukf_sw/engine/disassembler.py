"""Disassembler: the operations of a program, found again in its control words.

It knows what a word says and how long things take, and not what was scheduled. What a word reads
begins an operation; the word of the clock on which its result is due says where that goes. Every
bit that is set belongs to an operation, so words in which a bit is left over, or in which an
operation has no result, are refused.

What the lanes write in a program of a model says so: it is the row of a result, or unchecked. That
tells its operations, of any form, from those of the filter.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from ukf_sw.engine.control_word import READ, STEERING, WRITE, BusSource, form_of
from ukf_sw.engine.layout import BANK_FACTOR, BANK_NONE, BANK_STATE, Word
from ukf_sw.engine.microcode import Microcode
from ukf_sw.engine.operations import Beat, Kind, Operation, Route
from ukf_sw.spec.forms import Form
from ukf_sw.spec.sequence import Program, Routine

__all__ = [
    "MARKS",
    "DisassemblyError",
    "Instruction",
    "disassemble",
    "fields_of",
    "kind_of",
    "word_of",
]

#: Fields of the write half that say where results come from and go to, and the end of the program.
_ROUTING = (
    "write", "write_address", "write_bank_state", "write_bank_factor", "write_lanes", "write_bus",
    "bus_source", "scalar_write", "scalar_write_address", "lanes_observation", "bus_observation",
    "last",
)  # fmt: skip
#: All others say what the result is: of the lanes, or else the number on the scalar bus. A row is
#: that of the lanes if it is of a model; what is unchecked is all that has no such row.
_LANES_MARKS = ("innovation", "of_model")
MARKS = tuple(name for name in WRITE.fields if name not in _ROUTING)


class DisassemblyError(Exception):
    """Control words that are no program."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Instruction:
    """An operation as control words say it; fields that do not apply are None or False.

    Parameters
    ----------
    kind
        What it does.
    beats, clocks
        Its reads, and the clock of each, counted from the first word of the program.
    scalar
        Register of the scalar file with operand s.
    subtract
        Whether the product is subtracted; of a SLOT the form says it.
    form
        What a SLOT computes and writes.
    done
        Clock on which the result is written, or on the scalar bus.
    destination, lanes
        Word written, and its lanes as a bit mask.
    register
        Register of the scalar file that is written.
    root, root_lanes, root_clock
        Word that takes the reciprocal square root of the result, its lanes as a bit mask, and when.
    observation
        Observation that gates the result: zero is written if it is masked.
    marks
        Those of :data:`MARKS` that the result has, with their values: 1 for a flag, else the
        number, from 0 on, of what it belongs to.
    """

    kind: Kind
    beats: tuple[Beat, ...]
    clocks: tuple[int, ...]
    scalar: int | None
    subtract: bool
    form: Form | None
    done: int
    destination: Word | None
    lanes: int
    register: int | None
    root: Word | None
    root_lanes: int
    root_clock: int | None
    observation: int | None
    marks: Mapping[str, int]


def fields_of(code: Microcode, word: int) -> dict[str, int]:
    """Give the fields of a control word that are not zero."""
    fields = code.format.fields.values()
    values = ((field.name, word >> field.lsb & (1 << field.width) - 1) for field in fields)
    return {name: value for name, value in values if value}


def kind_of(word: Mapping[str, int]) -> Kind | None:
    """Tell the kind of the operation that a word reads for, or None if it reads nothing.

    The word does not tell a SCALE from an AXPY: it is a SCALE if the result goes to the bus. Nor
    does it tell a SLOT that steers as the filter does, or not at all, from what it would be there.
    """
    for kind in (Kind.DOT, Kind.AXPY, Kind.MULTIPLY):
        if all(word.get(name) == value for name, value in kind.steering.items()):
            plain = kind is Kind.DOT or not word.keys() & set(STEERING[3:])
            return kind if plain else Kind.SLOT
    if word.keys() & {*STEERING, "address_1", "bank_factor_1"}:
        return Kind.SLOT
    return Kind.LOAD if any(name in word for name in READ.fields) else None


def word_of(word: Mapping[str, int], address: str, bank: str) -> Word:
    """Give the word of an address field and of the bank bits that complete it."""
    banks = {"state": BANK_STATE, "factor": BANK_FACTOR}
    chosen = (number for name, number in banks.items() if word.get(bank.format(name)))
    return word.get(address, 0), next(chosen, BANK_NONE)


class _Words:
    """Words of a program, of which fields are taken until none is left."""

    def __init__(self, code: Microcode, routine: Routine) -> None:
        self._code = code
        self._fields = [fields_of(code, word) for word in code.words_of(*routine)]
        self._shared: set[tuple[int, str]] = set()

    def __len__(self) -> int:
        return len(self._fields)

    def at(self, clock: int) -> Mapping[str, int]:
        """What is left of a word; nothing behind the end."""
        return self._fields[clock] if clock < len(self) else {}

    def take(self, clock: int, name: str) -> int:
        """Take a field: its value, 0 if it is zero or taken."""
        return self._fields[clock].pop(name, 0) if clock < len(self) else 0

    def share(self, clock: int, name: str) -> int:
        """Take a field that may belong to several operations: its value, 0 if it is zero."""
        self._shared.add((clock, name))
        return self.at(clock).get(name, 0)

    def left(self, clock: int) -> dict[str, int]:
        """Fields of a word that no operation has taken."""
        return {
            name: value
            for name, value in self._fields[clock].items()
            if (clock, name) not in self._shared
        }

    def take_word(self, clock: int, address: str, bank: str) -> Word:
        """Take the address of a word, with the bank bits that complete it."""
        word = word_of(self.at(clock), address, bank)
        for name in (address, bank.format("state" if word[1] == BANK_STATE else "factor")):
            self.take(clock, name)
        try:
            self._code.layout.find(word)
        except KeyError:
            raise DisassemblyError(
                f"{address} of clock {clock} must be that of a vector, not {word!r}"
            ) from None
        return word

    def take_lanes(self, clock: int, name: str) -> int:
        """Take the number of a set of lanes; gives the lanes."""
        number, sets = self.take(clock, name), self._code.lane_sets
        if number >= len(sets):
            raise DisassemblyError(
                f"{name} of clock {clock} must be below {len(sets)}, not {number!r}"
            )
        return sets[number]


def disassemble(
    code: Microcode, program: Program, sensor: int = 0, variant: int = 0
) -> list[Instruction]:
    """Find the operations of a program in its control words.

    Parameters
    ----------
    code
        Programs of a core.
    program, sensor, variant
        Which one, and whose.

    Returns
    -------
    list of Instruction
        In the order in which they begin.

    Raises
    ------
    DisassemblyError
        If the words are no program.
    """
    words = _Words(code, Routine(program, sensor, variant))
    found: list[Instruction] = []
    for clock in range(len(words)):
        # What an earlier operation has read on this clock is taken already.
        kind = kind_of(words.at(clock))
        if kind is not None:
            found.append(_instruction(code, words, clock, kind))
    # UPDATE_REDRAWN runs on into the program behind it.
    if program is not Program.UPDATE_REDRAWN and not words.take(len(words) - 1, "last"):
        raise DisassemblyError("The last word must be marked as last")
    for clock in range(len(words)):
        for name, value in words.left(clock).items():
            raise DisassemblyError(
                f"{name} of clock {clock} must belong to an operation, not be {value!r} for none"
            )
    return found


def _is_of_model(code: Microcode, words: _Words, clock: int) -> bool:
    """Whether the lanes write what began on a clock, and that is of a model."""
    due = words.at(clock + code.timing.lanes)
    return (
        bool(due.get("write"))
        and not due.get("write_bus")
        and bool(due.get("of_model") or due.get("unchecked"))
    )


def _form(words: _Words, clock: int) -> Form:
    """Take the form of a SLOT."""
    names = [name for name in STEERING if words.take(clock, name)]
    form = form_of(names)
    if form is None:
        raise DisassemblyError(f"steering of clock {clock} must be a form, not {names!r}")
    return form


def _instruction(code: Microcode, words: _Words, clock: int, kind: Kind) -> Instruction:
    """Take the operation that begins on a clock."""
    form = None
    if _is_of_model(code, words, clock):
        kind, form = Kind.SLOT, _form(words, clock)
        beats = [_beat_of_slot(words, clock, form)]
    elif kind is Kind.SLOT:
        kind = Kind.LOAD  # what it reads beside that is left over
        beats = [_beat(words, clock, kind)]
    else:
        beats = [_beat(words, clock, kind)]
    clocks = [clock]
    subtract, scalar = bool(words.take(clock, "subtract")), None
    if kind is Kind.AXPY or (form is not None and form.uses_scalar):
        scalar = words.take(clock, "scalar_address")
    if kind is Kind.DOT:
        if not words.take(clock, "first"):
            raise DisassemblyError(f"dot of clock {clock} must continue a dot product")
        following = clock + code.timing.beat_interval
        while words.at(following).get("dot") and not words.at(following).get("first"):
            beats.append(_beat(words, following, kind))
            clocks.append(following)
            following += code.timing.beat_interval
    done = clock + code.timing.result(Operation(kind=kind, beats=tuple(beats)))

    due = words.at(done)
    if kind is Kind.AXPY and not (due.get("write") and not due.get("write_bus")):
        kind = Kind.SCALE
    destination, register, root, root_clock, lanes, root_lanes = None, None, None, None, 0, 0
    marks = _marks(code, words, done, kind)
    if kind.is_scalar:
        source = BusSource.LOAD if kind.route is Route.PORT else BusSource.RESULT
        if words.take(done, "bus_source") != source:
            raise DisassemblyError(f"bus_source of clock {done} must be {source!r}")
        observation = words.take(done, "bus_observation")
        if words.take(done, "scalar_write"):
            register = words.take(done, "scalar_write_address")
        at = done + code.pipeline.reciprocal_sqrt
        if words.at(at).get("bus_source") == BusSource.ROOT:
            words.take(at, "bus_source")
            (root, root_lanes), root_clock = _write(words, at, from_bus=True), at
            if words.share(at, "unchecked") != marks.get("unchecked", 0):
                raise DisassemblyError(f"The root of clock {at} must be checked as its number is")
    else:
        observation = words.take(done, "lanes_observation")
    if due.get("write") and bool(due.get("write_bus")) is kind.is_scalar:
        destination, lanes = _write(words, done, from_bus=kind.is_scalar)
    if destination is None and register is None and (root is None or "unchecked" not in marks):
        raise DisassemblyError(f"The {kind.value} of clock {clock} must have a result")

    used = lanes
    if kind is Kind.SCALE:
        used = 1 << (code.params.pes - 1)
    if kind.route in (Route.LANES, Route.LAST_LANE):
        beats = [Beat(beat.word_0, beat.word_1, used) for beat in beats]
    return Instruction(
        kind=kind, beats=tuple(beats), clocks=tuple(clocks), scalar=scalar, subtract=subtract,
        form=form, done=done, destination=destination, lanes=lanes, register=register, root=root,
        root_lanes=root_lanes, root_clock=root_clock,
        observation=observation - 1 if observation else None, marks=marks,
    )  # fmt: skip


def _marks(code: Microcode, words: _Words, clock: int, kind: Kind) -> dict[str, int]:
    """Take the marks of the result of a clock: that of the lanes, or that on the scalar bus."""
    of_model = bool(words.at(clock).get("of_model"))
    marks: dict[str, int] = {}
    for name in MARKS:
        if name == "unchecked":
            has_row = of_model and not kind.is_scalar
            value = 0 if has_row else words.share(clock, name)
        else:
            of_lanes = of_model if name == "row" else name in _LANES_MARKS
            value = words.take(clock, name) if of_lanes is not kind.is_scalar else 0
        if value:
            marks[name] = value - (code.format.fields[name].width > 1)
    return marks


def _beat_of_slot(words: _Words, clock: int, form: Form) -> Beat:
    """Take the words that a form reads."""
    return Beat(
        words.take_word(clock, "address_0", "bank_{}_0") if form.uses_word_0 else None,
        words.take_word(clock, "address_1", "bank_{}_1") if form.uses_word_1 else None,
        0,
    )


def _beat(words: _Words, clock: int, kind: Kind) -> Beat:
    """Take the reads of a clock; those of lanes that write have their lanes later."""
    for name in kind.steering:
        words.take(clock, name)
    # Without c, port 0 is not read; of a MULTIPLY it is operand a.
    no_word_0 = words.take(clock, "zero")
    word_0 = None if no_word_0 else words.take_word(clock, "address_0", "bank_{}_0")
    if kind is Kind.LOAD:
        return Beat(word_0, None, 1 << words.take(clock, "select"))
    word_1 = words.take_word(clock, "address_1", "bank_{}_1")
    return Beat(word_0, word_1, words.take_lanes(clock, "select") if kind is Kind.DOT else 0)


def _write(words: _Words, clock: int, *, from_bus: bool) -> tuple[Word, int]:
    """Take a write to the memories: word and lanes."""
    if not words.take(clock, "write") or bool(words.take(clock, "write_bus")) is not from_bus:
        raise DisassemblyError(f"The result of clock {clock} must be written")
    return (
        words.take_word(clock, "write_address", "write_bank_{}"),
        words.take_lanes(clock, "write_lanes"),
    )
