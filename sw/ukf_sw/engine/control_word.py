"""Control words: one for each clock, with the reads of that clock and the writes of that clock.

A word has two halves that belong to different operations: the read half starts one, the write
half ends another that was started when its latency demands. The hardware delays only the few bits
that steer the adders in between. In the program memory each half is packed by itself: see
:mod:`ukf_sw.engine.packets`.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Root, Sign
from ukf_sw.spec.model_programs import CoreModels

__all__ = [
    "READ", "STEERING", "WRITE", "BusSource", "ControlField", "ControlFormat", "Half",
    "fields_of_models", "form_of", "steering",
]  # fmt: skip


class BusSource(IntEnum):
    """What is on the scalar bus."""

    RESULT = 0  #: The adder of the last lane.
    LOAD = 1  #: A lane of port 0.
    ROOT = 2  #: The reciprocal square root.


@dataclass(frozen=True)
class ControlField:
    """A field of the control word.

    Parameters
    ----------
    name, lsb, width
        Name and place.
    """

    name: str
    lsb: int
    width: int


class Half(NamedTuple):
    """Half of the control word.

    Parameters
    ----------
    name
        Its name.
    fields
        Names of its fields.
    counting
        Those that may be one more in a word that repeats another.
    once
        Those that are zero in a word that repeats another.
    """

    name: str
    fields: tuple[str, ...]
    counting: tuple[str, ...]
    once: tuple[str, ...]


#: Fields of one bit that steer the operands and the writes of the lanes: they go to every
#: processing element as they are, beside the words of their clock. The first three are enough for
#: the filter; a core has those of the others that its models need.
STEERING = (
    "use_scalar", "zero", "subtract",
    "minus_zero", "scalar_addend",
    "one", "power", "exponent",
    "clear_sign", "copy_sign", "turn_bit_0", "turn_bit_1",
    "if_negative", "if_not_negative", "if_odd", "if_finite",
)  # fmt: skip

_ADDENDS = {
    Addend.PLUS_ZERO: ("zero",), Addend.MINUS_ZERO: ("zero", "minus_zero"), Addend.WORD: (),
    Addend.SCALAR: ("scalar_addend",),
}  # fmt: skip
_READINGS = {
    Reading.NUMBER: (), Reading.ONE: ("one",), Reading.POWER: ("power",),
    Reading.EXPONENT: ("exponent",),
}  # fmt: skip
_SIGNS = {
    Sign.KEEP: (), Sign.CLEAR: ("clear_sign",), Sign.COPY: ("clear_sign", "copy_sign"),
    Sign.BIT_0: ("turn_bit_0",), Sign.BIT_1: ("turn_bit_1",),
}  # fmt: skip
_CONDITIONS = {
    Condition.ALWAYS: (), Condition.NEGATIVE: ("if_negative",),
    Condition.NOT_NEGATIVE: ("if_not_negative",), Condition.ODD: ("if_odd",),
    Condition.FINITE: ("if_finite",),
}  # fmt: skip


def steering(form: Form) -> dict[str, int]:
    """Give the steering fields that a form sets."""
    names = (
        *(("use_scalar",) if form.multiplier is Multiplier.SCALAR else ()),
        *_ADDENDS[form.addend],
        *(("subtract",) if form.subtract else ()),
        *_READINGS[form.reading],
        *_SIGNS[form.sign],
        *_CONDITIONS[form.condition],
    )
    return dict.fromkeys(names, 1)


@cache
def _forms() -> dict[frozenset[str], Form]:
    """Give every form by the steering fields that it sets."""
    every = product(Multiplier, Addend, Reading, Sign, (False, True), Condition)
    forms = (
        Form(
            multiplier=multiplier, addend=addend, reading=reading, sign=sign, subtract=subtract,
            condition=condition,
        )
        for multiplier, addend, reading, sign, subtract, condition in every
    )  # fmt: skip
    return {frozenset(steering(form)): form for form in forms}


def form_of(names: Collection[str]) -> Form | None:
    """Give the form that sets these steering fields and no others; None if there is none."""
    return _forms().get(frozenset(names))


#: Fields that are in the control word only of a core whose models need them.
_OF_MODELS = frozenset({*STEERING[3:], "of_model", "unchecked", "signed"})


def fields_of_models(models: CoreModels) -> frozenset[str]:
    """Give the fields of the control word that models need beside those of the filter."""
    needed = {name for form in models.forms for name in steering(form)}
    if models:
        needed |= {"of_model", "unchecked"}
    if Root.SIGNED in models.roots:
        needed.add("signed")
    return frozenset(needed & _OF_MODELS)


READ = Half(
    name="read",
    fields=(
        "address_0", "bank_state_0", "bank_factor_0", "address_1", "bank_factor_1",
        "scalar_address", *STEERING, "dot", "first", "select",
    ),
    counting=("address_0", "address_1"),
    once=("first",),
)  # fmt: skip
WRITE = Half(
    name="write",
    fields=(
        "write", "write_address", "write_bank_state", "write_bank_factor", "write_lanes",
        "write_bus", "bus_source", "scalar_write", "scalar_write_address", "lanes_observation",
        "bus_observation", "row", "coupling", "innovation", "nis", "of_model", "unchecked",
        "signed", "last",
    ),
    counting=("write_address",),
    once=(),
)  # fmt: skip


class ControlFormat:
    """Fields of the control word of one core.

    Parameters
    ----------
    address_width
        Width of an address within a lane.
    scalar_width
        Width of an address of the scalar file.
    lane_sets
        Number of different sets of lanes.
    pes
        Number of lanes.
    observations, rows
        Number of observations, and of rows of the elimination.
    of_models
        Fields that are there for models: see :func:`fields_of_models`.

    Attributes
    ----------
    fields : dict of str to ControlField
        ``address_0``, ``bank_state_0``, ``bank_factor_0``, ``address_1``, ``bank_factor_1``
            Words on the read ports, and which bank bit completes their addresses.
        ``scalar_address``, ``use_scalar``
            Operand a is the scalar, else port 0.
        ``zero``, ``subtract``
            Operand c is zero, else port 0; the product is subtracted.
        ``minus_zero``, ``scalar_addend``
            The zero is minus zero; operand c is the scalar.
        ``one``, ``power``, ``exponent``
            What operand b is read as from port 1, as :mod:`ukf_sw.spec.forms` says.
        ``clear_sign``, ``copy_sign``, ``turn_bit_0``, ``turn_bit_1``
            What sign it gets: cleared, then that of word 0, then turned by a bit of word 0.
        ``if_negative``, ``if_not_negative``, ``if_odd``, ``if_finite``
            Which lanes write the result, when it is there.
        ``dot``, ``first``
            The adders form a tree; the accumulator starts from zero.
        ``select``
            Set of lanes whose products count in a dot product; lane of a load.
        ``write``, ``write_address``, ``write_bank_state``, ``write_bank_factor``, ``write_lanes``
            Write a word, in a set of lanes, in the bank that is not current.
        ``write_bus``
            Write the scalar bus, else the results of the lanes.
        ``bus_source``
            See :class:`BusSource`.
        ``scalar_write``, ``scalar_write_address``
            Write the scalar bus to the scalar file.
        ``lanes_observation``, ``bus_observation``
            1 + the observation whose mask clears the results of the lanes, or what is on the
            scalar bus; 0 if none.
        ``row``, ``coupling``
            1 + the row of the elimination whose pivot is on the scalar bus, or which the element
            there couples to a row before it, or that the lanes write as a result of a model; else
            0.
        ``innovation``
            The lanes write the right-hand side of an update's elimination.
        ``nis``
            The scalar bus is the normalised innovation squared, or on the way to it; the last wins.
        ``of_model``
            The row is that of a result of a model.
        ``unchecked``
            What is written may be infinite or NaN; a result of a model in the lanes may not.
        ``signed``
            What is on the scalar bus enters 1/sqrt as :attr:`ukf_sw.spec.forms.Root.SIGNED`.
        ``last``
            The program ends.
    width : int
        Width of the word.
    """

    def __init__(
        self,
        *,
        address_width: int,
        scalar_width: int,
        lane_sets: int,
        pes: int,
        observations: int,
        rows: int,
        of_models: Collection[str] = (),
    ) -> None:
        lanes_width = max((lane_sets - 1).bit_length(), 1)
        widths = {
            "address_0": address_width, "address_1": address_width, "write_address": address_width,
            "scalar_address": scalar_width, "scalar_write_address": scalar_width,
            "select": max(lanes_width, (pes - 1).bit_length()), "write_lanes": lanes_width,
            "bus_source": 2, "row": rows.bit_length(),
            "lanes_observation": observations.bit_length(),
            "bus_observation": observations.bit_length(),
        }  # fmt: skip
        self.fields: dict[str, ControlField] = {}
        lsb = 0
        for name in READ.fields + WRITE.fields:
            if name in _OF_MODELS and name not in of_models:
                continue
            width = widths.get(name, 1)
            self.fields[name] = ControlField(name, lsb, width)
            lsb += width
        self.width = lsb

    def present(self, names: Iterable[str]) -> tuple[str, ...]:
        """Give those of some fields that the word has."""
        return tuple(name for name in names if name in self.fields)

    def encode(self, values: dict[str, int]) -> int:
        """Give the word that has the given fields and all others zero.

        Raises
        ------
        ValueError
            If a value does not fit its field.
        """
        word = 0
        for name, value in values.items():
            field = self.fields[name]
            if not 0 <= value < 1 << field.width:
                raise ValueError(f"{name} must fit {field.width} bits, not {value!r}")
            word |= value << field.lsb
        return word

    def decode(self, words: Sequence[int]) -> dict[str, NDArray[np.int32]]:
        """Give the fields of words, an array for each name."""
        return {
            field.name: np.array(
                [word >> field.lsb & (1 << field.width) - 1 for word in words], dtype=np.int32
            )
            for field in self.fields.values()
        }
