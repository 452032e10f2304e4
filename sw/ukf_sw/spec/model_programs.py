"""Models as programs of a core: steps of the array on temporaries, and where they begin and end.

Every :class:`SlotStep` is one issue slot a beat, every :class:`RootStep` the stream of one word's
numbers through the unit 1/sqrt, a :class:`PickStep` one load. Steps run in order. A temporary is a
word of every lane; it may be written again, and a step with a condition writes some of its lanes
only.

:mod:`ukf_sw.lowering` makes programs of traced models; the core, its golden model and the models
in C execute the same steps, so they give equal bits.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, cast

from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Root, Sign

__all__ = [
    "NO_MODELS",
    "Constant",
    "CoreModels",
    "ModelProgram",
    "Operand",
    "PickStep",
    "RootStep",
    "SlotStep",
    "Source",
    "SourceKind",
    "Step",
    "Temporary",
    "choose_models",
]


@dataclass(frozen=True, slots=True)
class Temporary:
    """A word of every lane, by its number in its program."""

    number: int


@dataclass(frozen=True, slots=True)
class Constant:
    """A number of the format; as word 0 or 1 it is the same in all lanes."""

    value: float

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Constant) and self.value.hex() == other.value.hex()

    def __hash__(self) -> int:
        return hash(self.value.hex())


Operand = Temporary | Constant


def _operand_record(operand: Operand | None) -> int | str | None:
    """Give a temporary as its number, a constant exactly as text."""
    if isinstance(operand, Temporary):
        return operand.number
    return None if operand is None else operand.value.hex()


def _operand_of(record: int | str | None) -> Operand | None:
    if isinstance(record, int):
        return Temporary(record)
    return None if record is None else Constant(float.fromhex(record))


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotStep:
    """One issue slot.

    Parameters
    ----------
    form
        What it computes and writes.
    destination
        Temporary that it writes.
    word_0, word_1
        Words; None if the form does not use one.
    scalar
        A constant, or a temporary that is the same in all lanes; None if the form uses none.
    """

    form: Form
    destination: Temporary
    word_0: Operand | None = None
    word_1: Operand | None = None
    scalar: Operand | None = None

    @property
    def reads(self) -> tuple[Temporary, ...]:
        """Temporaries that it reads; one that it writes some lanes of is not among them."""
        return tuple(
            operand
            for operand in (self.word_0, self.word_1, self.scalar)
            if isinstance(operand, Temporary)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RootStep:
    """The numbers of a word, one after the other through the unit 1/sqrt.

    Parameters
    ----------
    root
        What the unit gives.
    destination, source
        Temporary that takes the results, and where the numbers are.
    """

    root: Root
    destination: Temporary
    source: Temporary

    @property
    def reads(self) -> tuple[Temporary, ...]:
        """Temporaries that it reads."""
        return (self.source,)


@dataclass(frozen=True, slots=True, kw_only=True)
class PickStep:
    """The number of the sigma point that angles are wrapped to, in all lanes of a word.

    Parameters
    ----------
    destination, source
        Temporary that takes the number, and the one that it is of.
    """

    destination: Temporary
    source: Temporary

    @property
    def reads(self) -> tuple[Temporary, ...]:
        """Temporaries that it reads."""
        return (self.source,)


Step = SlotStep | RootStep | PickStep


def _step_record(step: Step) -> list[Any]:
    match step:
        case SlotStep():
            form = step.form
            return [
                "slot", step.destination.number, form.multiplier.value, form.addend.value,
                form.reading.value, form.sign.value, form.subtract, form.condition.value,
                *map(_operand_record, (step.word_0, step.word_1, step.scalar)),
            ]  # fmt: skip
        case RootStep():
            return ["root", step.destination.number, step.root.value, step.source.number]
        case PickStep():
            return ["pick", step.destination.number, step.source.number]


def _step_of(record: list[Any]) -> Step:
    kind, destination, *rest = record
    if kind == "slot":
        multiplier, addend, reading, sign, subtract, condition, *operands = rest
        word_0, word_1, scalar = map(_operand_of, operands)
        form = Form(
            multiplier=Multiplier(multiplier), addend=Addend(addend), reading=Reading(reading),
            sign=Sign(sign), subtract=subtract, condition=Condition(condition),
        )  # fmt: skip
        return SlotStep(
            form=form, destination=Temporary(destination), word_0=word_0, word_1=word_1,
            scalar=scalar,
        )  # fmt: skip
    if kind == "root":
        return RootStep(
            root=Root(rest[0]), destination=Temporary(destination), source=Temporary(rest[1])
        )
    return PickStep(destination=Temporary(destination), source=Temporary(rest[0]))


class SourceKind(Enum):
    """What an input of a program is."""

    STATE = "x"  #: A row of X.
    NOISE = "noise"  #: A row of W, of f, or of V, of h.
    MEASUREMENT = "z"  #: What was observed in a row.
    INPUT = "u"  #: A number of region U, the same at all sigma points.


@dataclass(frozen=True, slots=True)
class Source:
    """An input of a program.

    Parameters
    ----------
    kind, index
        What it is, and which: row, or place in region U.
    """

    kind: SourceKind
    index: int


@dataclass(frozen=True, kw_only=True)
class ModelProgram:
    """A model as a program of the array.

    Parameters
    ----------
    title
        What it is, for people: f, or h of a sensor.
    fmt
        Number format.
    inputs
        What is in temporaries before the first step.
    steps
        In order.
    outputs
        Rows of the result: of X, or of Z.
    measurements
        Observations that it changes, by row: it wraps angles.
    """

    title: str
    fmt: FloatFormat
    inputs: tuple[tuple[Temporary, Source], ...]
    steps: tuple[Step, ...]
    outputs: tuple[Operand, ...]
    measurements: tuple[tuple[int, Operand], ...] = ()

    @cached_property
    def common(self) -> frozenset[Temporary]:
        """Temporaries that are the same at all sigma points: one word, and not one for each beat.

        They depend on inputs of region U, observations, and constants alone.
        """
        own = {
            temporary
            for temporary, source in self.inputs
            if source.kind in (SourceKind.STATE, SourceKind.NOISE)
        }
        count = -1
        while count != len(own):
            count = len(own)
            for step in self.steps:
                if not isinstance(step, PickStep) and not own.isdisjoint(step.reads):
                    own.add(step.destination)
        every = {temporary for temporary, _ in self.inputs}
        every.update(step.destination for step in self.steps)
        return frozenset(every - own)

    @cached_property
    def forms(self) -> frozenset[Form]:
        """Forms that its slots have."""
        return frozenset(step.form for step in self.steps if isinstance(step, SlotStep))

    @cached_property
    def roots(self) -> frozenset[Root]:
        """What it asks of the unit 1/sqrt."""
        return frozenset(step.root for step in self.steps if isinstance(step, RootStep))

    @cached_property
    def scalars(self) -> tuple[float, ...]:
        """Constants that are scalars, each once, in the order of their use."""
        found = dict.fromkeys(
            step.scalar
            for step in self.steps
            if isinstance(step, SlotStep) and isinstance(step.scalar, Constant)
        )
        return tuple(constant.value for constant in found)

    @cached_property
    def words(self) -> tuple[float, ...]:
        """Constants that are words, each once, in the order of their use."""
        found: dict[Constant, None] = {}
        for step in self.steps:
            if isinstance(step, SlotStep):
                for word in (step.word_0, step.word_1):
                    if isinstance(word, Constant):
                        found[word] = None
        for output in (*self.outputs, *(value for _, value in self.measurements)):
            if isinstance(output, Constant):
                found[output] = None
        return tuple(constant.value for constant in found)

    def record(self) -> dict[str, Any]:
        """Describe it exactly, ready for JSON; :meth:`from_record` takes it."""
        return {
            "title": self.title,
            "inputs": [
                [temporary.number, source.kind.value, source.index]
                for temporary, source in self.inputs
            ],
            "steps": [_step_record(step) for step in self.steps],
            "outputs": [_operand_record(output) for output in self.outputs],
            "measurements": [[row, _operand_record(value)] for row, value in self.measurements],
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any], fmt: FloatFormat) -> "ModelProgram":
        """Make the program that a :meth:`record` describes, in its format."""

        def operand(entry: int | str) -> Operand:
            found = _operand_of(entry)
            assert found is not None
            return found

        return cls(
            title=record["title"],
            fmt=fmt,
            inputs=tuple(
                (Temporary(number), Source(SourceKind(kind), index))
                for number, kind, index in record["inputs"]
            ),
            steps=tuple(map(_step_of, record["steps"])),
            outputs=tuple(map(operand, record["outputs"])),
            measurements=tuple((row, operand(value)) for row, value in record["measurements"]),
        )

    @property
    def slots(self) -> int:
        """Issue slots of every beat."""
        return sum(
            isinstance(step, SlotStep) and step.destination not in self.common
            for step in self.steps
        )

    @property
    def streams(self) -> int:
        """How many words stream through the unit 1/sqrt, a load for every sigma point."""
        return sum(
            isinstance(step, RootStep) and step.destination not in self.common
            for step in self.steps
        )


@dataclass(frozen=True, kw_only=True)
class CoreModels:
    """The models that a core evaluates; what is missing, software does.

    Parameters
    ----------
    f
        Process model, or None.
    h
        Observation models of each sensor, one for each combination of its constants; or empty.
    inputs
        Names of the numbers in region U.
    """

    f: ModelProgram | None = None
    h: tuple[tuple[ModelProgram, ...], ...] = ()
    inputs: tuple[str, ...] = ()

    def record(self) -> dict[str, Any]:
        """Describe them exactly, ready for JSON; :meth:`from_record` takes it."""
        return {
            "f": None if self.f is None else self.f.record(),
            "h": [[program.record() for program in variants] for variants in self.h],
            "inputs": [*self.inputs],
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any], fmt: FloatFormat) -> "CoreModels":
        """Make the models that a :meth:`record` describes, in their format."""
        f = record["f"]
        return cls(
            f=None if f is None else ModelProgram.from_record(f, fmt),
            h=tuple(
                tuple(ModelProgram.from_record(each, fmt) for each in variants)
                for variants in record["h"]
            ),
            inputs=tuple(record["inputs"]),
        )

    @cached_property
    def inputs_of_f(self) -> int:
        """How many of the first numbers in region U f takes."""
        return 1 + max(_places(() if self.f is None else (self.f,)), default=-1)

    @cached_property
    def inputs_of_h(self) -> int:
        """How many of the last numbers in region U the h of all sensors take."""
        count = len(self.inputs)
        return count - min(_places(each for variants in self.h for each in variants), default=count)

    @cached_property
    def digest(self) -> int:
        """A number of 32 bits that other models have not, 0 of none; names do not matter."""
        if not self:
            return 0
        content = self.record()
        for program in (content["f"], *(each for variants in content["h"] for each in variants)):
            if program is not None:
                del program["title"]
        content["inputs"] = len(self.inputs)
        text = json.dumps(content, sort_keys=True).encode()
        return int.from_bytes(hashlib.sha256(text).digest()[:4], "big") or 1

    @cached_property
    def _hash(self) -> int:
        return hash((self.f, self.h, self.inputs))

    def __hash__(self) -> int:
        return self._hash

    def __bool__(self) -> bool:
        return self.f is not None or bool(self.h)

    def __iter__(self) -> Iterator[ModelProgram]:
        if self.f is not None:
            yield self.f
        for programs in self.h:
            yield from programs

    @cached_property
    def forms(self) -> frozenset[Form]:
        """Forms that their slots have."""
        return frozenset(form for program in self for form in program.forms)

    @cached_property
    def roots(self) -> frozenset[Root]:
        """What they ask of the unit 1/sqrt."""
        return frozenset(root for program in self for root in program.roots)


def _places(programs: Iterable[ModelProgram]) -> set[int]:
    """Places in region U that programs take."""
    return {
        source.index
        for program in programs
        for _, source in program.inputs
        if source.kind is SourceKind.INPUT
    }


#: Of a core whose models run in software.
NO_MODELS = CoreModels()

#: The models of a problem.
MODELS = ("f", "h")
_PLACES = ("core", "software")


def choose_models(models: str | Mapping[str, str]) -> frozenset[str]:
    """Give the models that a core is to evaluate.

    Parameters
    ----------
    models
        "core" or "software", for all of them, or which of the two for f and for h:
        ``{"f": "core"}``; what is missing is in software. "f" and "h" are short for one on the
        core.

    Raises
    ------
    TypeError, ValueError
        If it is something else.
    """
    if isinstance(models, str):
        wanted = {models: "core"} if models in MODELS else dict.fromkeys(MODELS, models)
    elif isinstance(cast("object", models), Mapping):
        wanted = dict(models)
    else:
        raise TypeError(f"models must be a str or a dict, not {models!r}")
    for model, place in wanted.items():
        if model not in MODELS or place not in _PLACES:
            raise ValueError(
                f"models must be 'core', 'software', 'f', 'h', or a dict as {{'f': 'core'}}, not "
                f"{models!r}"
            )
    return frozenset(model for model, place in wanted.items() if place == "core")
