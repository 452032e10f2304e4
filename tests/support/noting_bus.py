"""A golden model whose bus notes every access, for tests that compare drivers."""

from ukf_sw.errors import BusError
from ukf_sw.golden import GoldenBus

__all__ = ["NotingBus"]


class NotingBus:
    """A bus that notes every access, and can be told to lie, to refuse, and to break."""

    def __init__(self, core):
        self.core = core
        self.bus = GoldenBus(core)
        self.log = []
        self.lies = {}
        self.refuse = None
        self.on_write = None

    def read(self, address):
        if address == self.refuse:
            raise BusError(address, "read")
        word = self.lies.get(address, self.bus.read(address))
        self.log.append(("read", address, word))
        return word

    def write(self, address, word):
        if address == self.refuse:
            raise BusError(address, "write")
        self.log.append(("write", address, word))
        self.bus.write(address, word)
        if self.on_write is not None:
            self.on_write(address, word)
