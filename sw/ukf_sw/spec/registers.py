"""Register map of the core: the one description that hardware, driver, header and docs share."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum, IntEnum

from ukf_sw.spec.parameters import Form, Noise, UkfParams
from ukf_sw.spec.sequence import STEPS

__all__ = [
    "CONFIG", "CONTROL", "CYCLES", "DATA_WIDTH", "ERROR", "GATE_HIGH", "GATE_LOW", "ID", "IDENTITY",
    "INTERRUPT_ENABLE", "INTERRUPT_PENDING", "MAGIC", "MASK", "MODELS", "NIS_HIGH", "NIS_LOW",
    "REGISTERS", "SENSORS", "SIZES", "STATUS", "VERSION", "W0_HIGH", "W0_LOW", "Access",
    "ErrorCode", "Field", "Register",
]  # fmt: skip

DATA_WIDTH = 32
MAGIC = 0x554B  #: "UK"
VERSION = 6  #: Revision of this map.


class ErrorCode(IntEnum):
    """Values of ERROR.CODE; software has results of its own from 64 on."""

    NONE = 0
    ILLEGAL_STEP = 1
    NOT_FINITE = 2
    SINGULAR_OBSERVATION = 3
    NOT_POSITIVE_DEFINITE = 4
    MODEL_F = 5
    MODEL_H = 6

    @property
    def meaning(self) -> str:
        """What it means, in a few words."""
        return {
            ErrorCode.NONE: "none",
            ErrorCode.ILLEGAL_STEP: "illegal step",
            ErrorCode.NOT_FINITE: "NaN or infinity",
            ErrorCode.SINGULAR_OBSERVATION: "singular innovation covariance",
            ErrorCode.NOT_POSITIVE_DEFINITE: "covariance not positive definite",
            ErrorCode.MODEL_F: "f gives NaN or infinity",
            ErrorCode.MODEL_H: "h gives NaN or infinity",
        }[self]


class Access(Enum):
    """What software may do to a field."""

    RO = "ro"  #: Read only.
    RW = "rw"  #: Read and write.
    WO = "wo"  #: Belongs to the write that it is part of; reads as 0.
    W1S = "w1s"  #: Writing 1 starts an action; reads as 0.
    RW1C = "rw1c"  #: Set by hardware; writing 1 clears it.


# Equal is only what is the same, which makes them quick keys.
@dataclass(frozen=True, kw_only=True, eq=False)
class Field:
    """A named run of bits in a register.

    Parameters
    ----------
    name, lsb, width, access, reset, doc
        Name, position, width, what software may do, value after reset, meaning.
    of
        Function that gives the value after reset for a core of some parameters, where it depends
        on them. A field that is read only then is part of what identifies a core.
    bits
        Function that gives how many of its bits, from the lowest, a core of some parameters has,
        where it needs fewer than the widest core. The others are reserved.

    Raises
    ------
    ValueError
        If the field or its reset value does not fit.
    """

    name: str
    lsb: int
    width: int = 1
    access: Access
    reset: int = 0
    doc: str
    of: Callable[[UkfParams], int] | None = None
    bits: Callable[[UkfParams], int] | None = None

    def __post_init__(self) -> None:
        if self.lsb < 0 or self.width < 1 or self.lsb + self.width > DATA_WIDTH:
            raise ValueError(f"Field {self.name!r} does not fit {DATA_WIDTH} bits")
        if self.reset not in range(1 << self.width):
            raise ValueError(f"Reset value of {self.name!r} does not fit {self.width} bits")

    @property
    def mask(self) -> int:
        """Mask of the field in the word."""
        return ((1 << self.width) - 1) << self.lsb

    @property
    def is_fixed(self) -> bool:
        """Whether it always reads as its value after reset."""
        return self.access is Access.RO and (self.of is not None or self.reset != 0)

    def value_after_reset(self, params: UkfParams) -> int:
        """Value after reset, for a core of these parameters."""
        return self.reset if self.of is None else self.of(params)

    def bits_of(self, params: UkfParams) -> int:
        """How many of its bits a core of these parameters has, from the lowest."""
        return self.width if self.bits is None else self.bits(params)

    def get(self, word: int) -> int:
        """Extract the field from a register word."""
        return (word & self.mask) >> self.lsb

    def put(self, value: int) -> int:
        """Give the word that has the field at a value and all else zero."""
        return (value << self.lsb) & self.mask


@dataclass(frozen=True, kw_only=True, eq=False)
class Register:
    """A word on the bus, made of fields that do not overlap.

    Raises
    ------
    ValueError
        If the offset is not word aligned or two fields overlap.
    """

    name: str
    offset: int
    doc: str
    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        if self.offset % (DATA_WIDTH // 8):
            raise ValueError(f"Offset of {self.name!r} is not word aligned: {self.offset:#x}")
        used = 0
        for field in self.fields:
            if used & field.mask:
                raise ValueError(f"Field {self.name}.{field.name} overlaps another field")
            used |= field.mask

    def __reduce__(self) -> str:
        """Copy and pickle as the constant of this module."""
        return self.name

    def __iter__(self) -> Iterator[Field]:
        return iter(self.fields)

    def __getitem__(self, name: str) -> Field:
        return next(field for field in self.fields if field.name == name)

    @property
    def is_fixed(self) -> bool:
        """Whether all of its fields always read as after reset."""
        return all(field.is_fixed for field in self.fields)

    @property
    def is_writable(self) -> bool:
        """Whether a write to it can have an effect."""
        return any(field.access is not Access.RO for field in self.fields)

    def after_reset(self, params: UkfParams) -> int:
        """Word after reset, for a core of these parameters."""
        return sum(field.put(field.value_after_reset(params)) for field in self.fields)


def _steps(lsb: int, access: Access, doc: str) -> tuple[Field, ...]:
    """One bit per step."""
    return tuple(
        Field(name=step.name, lsb=lsb + step - 1, access=access, doc=doc.format(step.name))
        for step in STEPS
    )


def _word(
    name: str,
    offset: int,
    access: Access,
    doc: str,
    *,
    of: Callable[[UkfParams], int] | None = None,
    bits: Callable[[UkfParams], int] | None = None,
) -> Register:
    """A register that is one number."""
    field = Field(name="VALUE", lsb=0, width=32, access=access, of=of, bits=bits, doc=doc)
    return Register(name=name, offset=offset, doc=doc, fields=(field,))


ID = Register(
    name="ID", offset=0x00, doc="Identification.",
    fields=(
        Field(name="MAGIC", lsb=16, width=16, access=Access.RO, reset=MAGIC, doc="Fixed value."),
        Field(name="VERSION", lsb=0, width=16, access=Access.RO, reset=VERSION,
              doc="Revision of this map."),
    ),
)  # fmt: skip
SIZES = Register(
    name="SIZES", offset=0x04, doc="Sizes that the core was generated for.",
    fields=(
        Field(name="N", lsb=0, width=8, access=Access.RO, of=lambda p: p.n, doc="States, n."),
        Field(name="Q", lsb=8, width=8, access=Access.RO, of=lambda p: p.q,
              doc="Process noise terms, q."),
        Field(name="R", lsb=16, width=8, access=Access.RO, of=lambda p: p.r,
              doc="Observation noise terms, r."),
        Field(name="M", lsb=24, width=8, access=Access.RO, of=lambda p: p.m,
              doc="Observations, m."),
    ),
)  # fmt: skip
CONFIG = Register(
    name="CONFIG", offset=0x08, doc="How the core was generated.",
    fields=(
        Field(name="PES", lsb=0, width=8, access=Access.RO, of=lambda p: p.pes,
              doc="Processing elements."),
        Field(name="EXPONENT_BITS", lsb=8, width=4, access=Access.RO,
              of=lambda p: p.format.exponent_bits, doc="Number format."),
        Field(name="FRACTION_BITS", lsb=12, width=6, access=Access.RO,
              of=lambda p: p.format.fraction_bits, doc="Number format."),
        Field(name="COVARIANCE_FORM", lsb=18, access=Access.RO,
              of=lambda p: int(p.form is Form.COVARIANCE),
              doc="0: square-root form, 1: covariance form."),
        Field(name="ADDITIVE_Q", lsb=19, access=Access.RO,
              of=lambda p: int(p.process_noise is Noise.ADDITIVE),
              doc="Process noise is additive."),
        Field(name="ADDITIVE_R", lsb=20, access=Access.RO,
              of=lambda p: int(p.observation_noise is Noise.ADDITIVE),
              doc="Observation noise is additive."),
        Field(name="HAS_F", lsb=21, access=Access.RO, of=lambda p: int(p.models.f is not None),
              doc="The core evaluates the process model: it has the step F."),
        Field(name="HAS_H", lsb=22, access=Access.RO, of=lambda p: int(bool(p.models.h)),
              doc="The core evaluates the observation models: it has the step H, and with f the "
                  "step ITERATE."),
    ),
)  # fmt: skip
CONTROL = Register(
    name="CONTROL", offset=0x0C, doc="Control.",
    fields=(
        Field(name="ENABLE", lsb=0, access=Access.RW,
              doc="Steps may start. A write that sets it may start a step as well."),
        Field(name="RESET", lsb=1, access=Access.W1S,
              doc="Drop a running step and forget INIT; x and L keep their last good values. "
                  "Wins over a start bit of the same write."),
        *_steps(8, Access.W1S, "Start {}."),
        Field(name="SENSOR", lsb=16, width=5, access=Access.WO,
              doc="Sensor, from 0, whose UPDATE, H or ITERATE the start bit of the same write "
                  "starts. The start is illegal if there is no such sensor."),
        Field(name="VARIANT", lsb=21, width=4, access=Access.WO,
              doc="Which of the observation models of that sensor, from 0, H or ITERATE evaluates. "
                  "The start is illegal if there is no such model."),
    ),
)  # fmt: skip
STATUS = Register(
    name="STATUS", offset=0x10, doc="Status.",
    fields=(
        Field(name="STATE", lsb=0, width=4, access=Access.RO,
              doc="Step that is running, 0 when idle."),
        Field(name="INITIALISED", lsb=4, access=Access.RO, doc="INIT has succeeded."),
        Field(name="POINTS", lsb=5, access=Access.RO,
              doc="X holds sigma points of the estimate: PREDICT may start."),
        Field(name="RESIDUALS", lsb=6, access=Access.RO,
              doc="PREDICT was the last step that changed the estimate: UPDATE uses its "
                  "residuals."),
        Field(name="GATED", lsb=7, access=Access.RO,
              doc="The last UPDATE was rejected: its NIS exceeded the gate."),
        *_steps(8, Access.RO, "{} has ended, well or not, and has not been started since."),
    ),
)  # fmt: skip
ERROR = Register(
    name="ERROR", offset=0x14, doc="Last error; cleared when a step starts, and by RESET.",
    fields=(
        Field(name="CODE", lsb=0, width=8, access=Access.RO,
              doc=", ".join(f"{code.value} {code.meaning}" for code in ErrorCode) + "."),
        Field(name="INDEX", lsb=8, width=8, access=Access.RO,
              doc="Row of the bad pivot, or of the result of a model: of z for the codes 3 and "
                  "6, of x for 4 and 5."),
    ),
)  # fmt: skip
INTERRUPT_ENABLE = Register(
    name="INTERRUPT_ENABLE", offset=0x18, doc="Events that raise `irq`.",
    fields=(
        Field(name="DONE", lsb=0, access=Access.RW, doc="A step has ended, well or not."),
        Field(name="ERROR", lsb=1, access=Access.RW, doc="An error has been recorded."),
    ),
)  # fmt: skip
INTERRUPT_PENDING = Register(
    name="INTERRUPT_PENDING", offset=0x1C,
    doc="Events seen. An event on the clock of a clear is not lost.",
    fields=(
        Field(name="DONE", lsb=0, access=Access.RW1C, doc="A step has ended, well or not."),
        Field(name="ERROR", lsb=1, access=Access.RW1C, doc="An error has been recorded."),
    ),
)  # fmt: skip
CYCLES = _word("CYCLES", 0x20, Access.RO, "Clocks from start to end of the last step.")
MASK = _word(
    "MASK", 0x24, Access.RW,
    "Bit i takes observation i into UPDATE, as of its start; bits from m on are reserved.",
    of=lambda p: (1 << p.m) - 1, bits=lambda p: p.m,
)  # fmt: skip
NIS_LOW = _word(
    "NIS_LOW", 0x28, Access.RO, "Normalised innovation squared of the last UPDATE, a number."
)
NIS_HIGH = _word("NIS_HIGH", 0x2C, Access.RO, "Its upper half, for formats of 64 bits.")
GATE_LOW = _word(
    "GATE_LOW", 0x30, Access.RW,
    "UPDATE is rejected when NIS exceeds this number, or the format while z is finite; infinity, "
    "the reset value, is off. Bits that the format does not have are reserved.",
    of=lambda p: p.format.infinity & 0xFFFF_FFFF, bits=lambda p: min(p.format.width, DATA_WIDTH),
)  # fmt: skip
GATE_HIGH = _word(
    "GATE_HIGH", 0x34, Access.RW, "Its upper half, for formats of 64 bits.",
    of=lambda p: p.format.infinity >> 32, bits=lambda p: max(p.format.width - DATA_WIDTH, 0),
)  # fmt: skip


def _identifying_word(name: str, offset: int, doc: str, of: Callable[[UkfParams], int]) -> Register:
    """A register that is one number, which identifies the core; its field has its name."""
    field = Field(name=name, lsb=0, width=32, access=Access.RO, of=of, doc=doc)
    return Register(name=name, offset=offset, doc=doc, fields=(field,))


def _bits_of(number: float) -> int:
    """Bits of a binary64 number."""
    return int.from_bytes(struct.pack("<d", number), "little")


W0_LOW = _identifying_word(
    "W0_LOW", 0x38, "Weight of sigma point 0, a binary64 number whatever the format is.",
    lambda p: _bits_of(p.W0) & 0xFFFF_FFFF,
)  # fmt: skip
W0_HIGH = _identifying_word("W0_HIGH", 0x3C, "Its upper half.", lambda p: _bits_of(p.W0) >> 32)
SENSORS = _identifying_word(
    "SENSORS", 0x40, "Bit i: observation i is the first one of a sensor.",
    lambda p: sum(1 << p.rows_of(sensor).start for sensor in range(len(p.sensor_rows))),
)  # fmt: skip
MODELS = _identifying_word(
    "MODELS", 0x44, "A number that other models on the core would not have; 0 if there are none.",
    lambda p: p.models.digest,
)  # fmt: skip

REGISTERS = (
    ID, SIZES, CONFIG, CONTROL, STATUS, ERROR, INTERRUPT_ENABLE, INTERRUPT_PENDING, CYCLES, MASK,
    NIS_LOW, NIS_HIGH, GATE_LOW, GATE_HIGH, W0_LOW, W0_HIGH, SENSORS,
    MODELS,
)  # fmt: skip
#: Registers that say which core this is; they never change.
IDENTITY = tuple(register for register in REGISTERS if register.is_fixed)
