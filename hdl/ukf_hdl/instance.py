"""A core in a system: what it is called there, where software finds it, and its clock."""

import re
from dataclasses import dataclass

from ukf_hdl.reserved import RESERVED
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams

__all__ = ["FIRST_SHARED", "NAME", "Instance", "address_range"]

#: Name of a core that is given no other.
NAME = "ukf_core"
#: Shared peripheral interrupts of an interrupt controller of Arm start at this number.
FIRST_SHARED = 32
_LAST_SHARED = 1019
#: Smallest segment of Vivado's address editor, and page of Linux.
_PAGE = 4096
#: A node's name in a device tree has 31 characters; that of the clock has 6 more than the core's.
_LONGEST = 25
#: Megahertz that FCLK_CLK0 of a Zynq-7000 may have.
_SLOWEST, _FASTEST = 1.0, 250.0


def address_range(params: UkfParams) -> int:
    """Bytes of the address space that a core takes, a power of two."""
    return max(1 << MemoryMap(params).address_width, _PAGE)


@dataclass(frozen=True, kw_only=True)
class Instance:
    """A core in a system. Results do not depend on it.

    Parameters
    ----------
    name
        Top module, beginning of the names of all modules below it, IP in Vivado, node of the device
        tree, and stem of the files. Lower-case letters, digits and single underscores, as Verilog,
        VHDL, C and device trees all have them.
    base_address
        Byte address of the registers: a multiple of the core's :func:`address_range`.
    interrupt
        Its number at the interrupt controller.
    clock_mhz
        Frequency of the core in MHz.

    Raises
    ------
    TypeError
        If address or interrupt are no int, or the name is no str.
    ValueError
        If the name is reserved or not of this form, or a number is out of range.
    """

    name: str = NAME
    #: Where Vivado puts the first core on the general port of a Zynq-7000, unless told otherwise.
    base_address: int = 0x43C0_0000
    #: Interrupt of IRQ_F2P[0] of a Zynq-7000.
    interrupt: int = 61
    clock_mhz: float = 100.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise TypeError(f"name must be a str, not {self.name!r}")
        if not re.fullmatch(r"[a-z](_?[a-z0-9])*", self.name) or len(self.name) > _LONGEST:
            raise ValueError(
                f"name must be at most {_LONGEST} lower-case letters, digits and single "
                f"underscores, beginning with a letter, not {self.name!r}"
            )
        if self.name in RESERVED:
            raise ValueError(f"name must not be {self.name!r}, {RESERVED[self.name]}")
        for label in ("base_address", "interrupt"):
            value = getattr(self, label)
            if not isinstance(value, int) or isinstance(value, bool):
                raise TypeError(f"{label} must be an int, not {value!r}")
        if not FIRST_SHARED <= self.interrupt <= _LAST_SHARED:
            raise ValueError(
                f"interrupt must be between {FIRST_SHARED} and {_LAST_SHARED}, "
                f"not {self.interrupt!r}"
            )
        if not _SLOWEST <= self.clock_mhz <= _FASTEST:
            raise ValueError(
                f"clock_mhz must be between {_SLOWEST:g} and {_FASTEST:g}, not {self.clock_mhz!r}"
            )

    def check(self, params: UkfParams) -> None:
        """Check that a core of these parameters can be there.

        Raises
        ------
        ValueError
            If the address is none for its size.
        """
        size = address_range(params)
        if self.base_address % size or not 0 <= self.base_address < 1 << 32:
            raise ValueError(
                f"base_address must be a multiple of {size:#x}, the size of the core, of 32 bits, "
                f"not {self.base_address:#x}"
            )

    @property
    def prefix(self) -> str:
        """What its macros in C begin with: UKF, or another name in capitals."""
        return "UKF" if self.name == NAME else self.name.upper()

    @property
    def clock_hz(self) -> int:
        """Frequency in Hz."""
        return round(self.clock_mhz * 1e6)
