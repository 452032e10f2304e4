"""The golden model as a bus for the driver."""

import numpy as np

from ukf_sw.drivers.bus import Addresses, Replies, Script, Words
from ukf_sw.errors import BusError
from ukf_sw.golden.core import GoldenCore

__all__ = ["GoldenBus"]


class GoldenBus:
    """A :class:`GoldenCore` as a bus for the driver.

    Parameters
    ----------
    core
        The core.
    """

    def __init__(self, core: GoldenCore) -> None:
        self.core = core

    def read(self, address: int) -> int:
        """Read a word.

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        data, okay = self.core.read(address)
        if not okay:
            raise BusError(address, "read")
        return data

    def write(self, address: int, word: int) -> None:
        """Write a word.

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        if not self.core.write(address, word):
            raise BusError(address, "write")

    def read_many(self, addresses: Addresses) -> Words:
        """Read words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        words = self.core.read_many(addresses)
        if words is None:
            return np.array([self.read(address) for address in addresses.tolist()], np.uint32)
        return words

    def write_many(self, addresses: Addresses, words: Words) -> None:
        """Write words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core answers SLVERR; the words before are written.
        """
        written = self.core.write_many(addresses, words)
        if written < len(addresses):
            raise BusError(int(addresses[written]), "write")

    def run_script(self, script: Script) -> Replies:
        """Do what a script says, up to the first round that does not succeed."""
        return self.core.run_script(script)

    def wait_for_interrupt(self, timeout: float) -> bool:
        """Tell whether the interrupt line is high; time does not pass in the model."""
        return self.core.irq
