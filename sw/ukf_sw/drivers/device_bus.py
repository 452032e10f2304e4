"""What buses on a board have in common: which accesses they must refuse by themselves.

A processor that accesses a core directly gets no exception when the core answers SLVERR: on a Zynq
that is an external abort, which Linux turns into SIGBUS, and Python cannot recover from one. So a
bus on a board looks first.
"""

from abc import ABC, abstractmethod

import numpy as np

from ukf_sw.drivers.bus import Addresses, OneCore, Words
from ukf_sw.errors import BusError
from ukf_sw.spec.registers import REGISTERS, STATUS

__all__ = ["DeviceBus"]

_WORD = 4
_REGISTERS = frozenset(register.offset for register in REGISTERS)
#: The buffer begins there or higher: the register block has room for 64 words.
_REGISTER_SPACE = 64 * _WORD
_STATE = STATUS["STATE"].mask


class DeviceBus(OneCore, ABC):
    """A bus whose core answers forbidden accesses by killing the process.

    Refused with :class:`ukf_sw.errors.BusError`, before the core sees them, are accesses that are
    not aligned, outside of the mapping, to a register that does not exist, and to the buffer while
    a step runs. To know the last, STATUS is read once before each access to the buffer, or once
    before each block of them.

    Parameters
    ----------
    size
        Bytes that are mapped.
    guard
        Whether to read STATUS before accesses to the buffer. Without it, an access while a step
        runs ends the process.

    Raises
    ------
    ValueError
        If the mapping does not even hold the registers.
    """

    def __init__(self, size: int, *, guard: bool = True) -> None:
        if size < _REGISTER_SPACE:
            raise ValueError(f"size must be at least {_REGISTER_SPACE} bytes, not {size!r}")
        self._size = size
        self._guard = guard

    @abstractmethod
    def _load(self, address: int) -> int:
        """Load the word at an address that has been checked, with one access of 32 bits."""

    @abstractmethod
    def _store(self, address: int, word: int) -> None:
        """Store a word at an address that has been checked, with one access of 32 bits."""

    def _check(self, address: int, access: str) -> bool:
        """Check an address; tells whether it is in the buffer."""
        if address % _WORD or not 0 <= address <= self._size - _WORD:
            raise BusError(address, access)
        if address >= _REGISTER_SPACE:
            return True
        if address not in _REGISTERS:
            raise BusError(address, access)
        return False

    def _check_idle(self, address: int, access: str) -> None:
        """Check that no step runs, so that the core answers for its buffer."""
        if self._guard and self._load(STATUS.offset) & _STATE:
            raise BusError(address, access)

    def read(self, address: int) -> int:
        """Read a word.

        Raises
        ------
        BusError
            If the core would refuse.
        """
        if self._check(address, "read"):
            self._check_idle(address, "read")
        return self._load(address)

    def write(self, address: int, word: int) -> None:
        """Write a word.

        Raises
        ------
        BusError
            If the core would refuse.
        """
        if self._check(address, "write"):
            self._check_idle(address, "write")
        self._store(address, word)

    def read_many(self, addresses: Addresses) -> Words:
        """Read words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core would refuse any; then none is read.
        """
        numbers = addresses.tolist()
        self._check_block(numbers, "read")
        return np.array([self._load(address) for address in numbers], dtype=np.uint32)

    def write_many(self, addresses: Addresses, words: Words) -> None:
        """Write words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core would refuse any; then none is written.
        """
        numbers = addresses.tolist()
        self._check_block(numbers, "write")
        for address, word in zip(numbers, words.tolist(), strict=True):
            self._store(address, word)

    def _check_block(self, addresses: list[int], access: str) -> None:
        buffered = [address for address in addresses if self._check(address, access)]
        if buffered:
            self._check_idle(buffered[0], access)
