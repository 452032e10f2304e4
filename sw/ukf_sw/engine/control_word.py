"""Control words: one for each clock, with the reads of that clock and the writes of that clock.

A word has two halves that belong to different operations: the read half starts one, the write
half ends another that was started when its latency demands. The hardware delays only the few bits
that steer the adders in between. In the program memory each half is packed by itself: see
:mod:`ukf_sw.engine.packets`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["READ", "STEERING", "WRITE", "BusSource", "ControlField", "ControlFormat", "Half"]


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


#: Fields that steer the operands of the lanes, with their widths: they go to every processing
#: element as they are, beside the words of their clock.
STEERING = {"use_scalar": 1, "zero": 1, "subtract": 1}

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
        "bus_observation", "row", "coupling", "innovation", "nis", "last",
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

    Attributes
    ----------
    fields : dict of str to ControlField
        ``address_0``, ``bank_state_0``, ``bank_factor_0``, ``address_1``, ``bank_factor_1``
            Words on the read ports, and which bank bit completes their addresses.
        ``scalar_address``, ``use_scalar``
            Operand a is the scalar, else port 0.
        ``zero``, ``subtract``
            Operand c is zero, else port 0; the product is subtracted.
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
            there couples to a row before it; 0 if neither.
        ``innovation``
            The lanes write the right-hand side of an update's elimination.
        ``nis``
            The scalar bus is the normalised innovation squared, or on the way to it; the last wins.
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
    ) -> None:
        lanes_width = max((lane_sets - 1).bit_length(), 1)
        widths = {
            "address_0": address_width, "address_1": address_width, "write_address": address_width,
            "scalar_address": scalar_width, "scalar_write_address": scalar_width,
            "select": max(lanes_width, (pes - 1).bit_length()), "write_lanes": lanes_width,
            "bus_source": 2, "row": rows.bit_length(),
            "lanes_observation": observations.bit_length(),
            "bus_observation": observations.bit_length(), **STEERING,
        }  # fmt: skip
        self.fields: dict[str, ControlField] = {}
        lsb = 0
        for name in READ.fields + WRITE.fields:
            width = widths.get(name, 1)
            self.fields[name] = ControlField(name, lsb, width)
            lsb += width
        self.width = lsb

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
