"""Golden model of the buffer: the words of the memories, at their bus addresses."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ukf_sw.drivers.bus import Addresses, Words
from ukf_sw.engine.layout import Layout
from ukf_sw.spec.memory_map import FirstColumn, MemoryMap
from ukf_sw.spec.sequence import Bank, Flag

__all__ = ["GoldenBuffer"]

_WORD_MASK = 0xFFFF_FFFF
_BANKS = 1 + (Bank.STATE | Bank.FACTOR)


class GoldenBuffer:
    """The buffer, one bus word or many at a time.

    Words are kept as they are written, whatever number they are; bits above the width of the
    format are dropped. An access that meets an unmapped address does nothing. Where there is no
    sigma point 0, column 0 is what :class:`ukf_sw.spec.memory_map.FirstColumn` says.

    Parameters
    ----------
    layout
        Where the regions are in the memories.
    memory
        The memories, array of uint64, shape (pes, depth), which this reads and writes. It may lie
        row by row or column by column.
    """

    def __init__(self, layout: Layout, memory: NDArray[np.uint64]) -> None:
        # Bus words are half words of the memory; in every format the low one is the first.
        self._halves = memory.ravel(order="K").view(np.uint32)
        lanes_apart, words_apart = (stride // memory.itemsize for stride in memory.strides)
        params = layout.params
        memory_map = MemoryMap(params)
        width = params.format.width
        self._count = count = 1 << (memory_map.address_width - 2)
        self._forgets = np.zeros(count, dtype=np.uint8)
        #: Bits of a bus word that are stored, and that are read.
        self._bits = np.zeros(count, dtype=np.uint32)
        self._read_bits = np.zeros(count, dtype=np.uint32)
        # Half word of a bus word, -1 if it is unmapped, by banks and bus word.
        self._place = np.full((_BANKS, count), -1, dtype=np.int64)
        for region in memory_map:
            for row, column in product(range(region.rows), range(region.columns)):
                first = memory_map.address(region.symbol, row, column) >> 2
                kind = region.first_column if column == 0 else FirstColumn.STORED
                shown = (region, row, column)
                if kind is FirstColumn.STATE:
                    shown = (memory_map["x"], 0, row)
                lane, address = layout.buffer_location(shown[0].symbol, *shown[1:])
                turn = 2 * layout.bank_offset * words_apart
                turned = [turn * bool(shown[0].bank & banks) for banks in range(_BANKS)]
                for half in range(params.format.bus_words):
                    place = 2 * (lane * lanes_apart + address * words_apart) + half
                    bits = (1 << width) - 1 >> 32 * half & _WORD_MASK
                    self._place[:, first + half] = np.add(place, turned)
                    self._forgets[first + half] = region.forgets
                    self._bits[first + half] = bits if kind is FirstColumn.STORED else 0
                    self._read_bits[first + half] = 0 if kind is FirstColumn.EMPTY else _WORD_MASK

    def _find(self, address: int, banks: Bank) -> int:
        """Half word at an address, or -1."""
        index = address >> 2
        return int(self._place[banks, index]) if 0 <= index < self._count else -1

    def _find_many(self, addresses: Addresses, banks: Bank) -> NDArray[np.int64] | None:
        """Half words at addresses, or None if any is unmapped."""
        index = addresses >> 2
        if (index < 0).any() or (index >= self._count).any():
            return None
        places = self._place[banks][index]
        return None if (places < 0).any() else places

    def read(self, address: int, banks: Bank) -> int | None:
        """Read a word; None if its address is unmapped."""
        place = self._find(address, banks)
        if place < 0:
            return None
        return int(self._halves[place]) & int(self._read_bits[address >> 2])

    def write(self, address: int, word: int, bits: int, banks: Bank) -> Flag | None:
        """Write those of a word's bits that are set in `bits`.

        Returns
        -------
        Flag or None
            Flags that are outdated by it; None if its address is unmapped.
        """
        place = self._find(address, banks)
        if place < 0:
            return None
        index = address >> 2
        bits &= int(self._bits[index])
        self._halves[place] = word & bits | int(self._halves[place]) & ~bits
        return Flag(int(self._forgets[index]))

    def read_many(self, addresses: Addresses, banks: Bank) -> Words | None:
        """Read words, shape (k,), at addresses, shape (k,); None if any is unmapped."""
        places = self._find_many(addresses, banks)
        return None if places is None else self._halves[places] & self._read_bits[addresses >> 2]

    def write_many(self, addresses: Addresses, words: Words, banks: Bank) -> Flag | None:
        """Write words, shape (k,), at addresses, shape (k,); returns as :meth:`write`."""
        places = self._find_many(addresses, banks)
        if places is None:
            return None
        index = addresses >> 2
        stored = self._bits[index] != 0
        self._halves[places[stored]] = (words & self._bits[index])[stored]
        return Flag(int(np.bitwise_or.reduce(self._forgets[index])))

    def find_many(
        self, addresses: Addresses
    ) -> tuple[NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint8]] | None:
        """Half words at addresses, shape (banks, k), bits that are stored, and flags outdated.

        None if an address is unmapped.
        """
        index = addresses >> 2
        if (index < 0).any() or (index >= self._count).any():
            return None
        places = self._place[:, index]
        if (places < 0).any():
            return None
        return places, self._bits[index], self._forgets[index]
