"""A golden model whose bus breaks off the access that a test names."""

from functools import cache

from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.errors import BusError
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.spec.parameters import UkfParams

__all__ = ["BreakingBus", "golden_core"]


@cache
def _engine(params: UkfParams) -> Interpreter:
    return Interpreter(params)


def golden_core(params: UkfParams) -> GoldenCore:
    """Make a core. One at a time: they have one engine, whose memory is cleared, to save time."""
    engine = _engine(params)
    engine.memory[:] = engine.layout.initial_words()
    return GoldenCore(params, engine=engine)


class BreakingBus(GoldenBus):
    """Breaks off one access, before or after it has been done.

    Parameters
    ----------
    params
        What the core computes.

    Attributes
    ----------
    count : int
        Accesses since :meth:`break_at`.
    """

    def __init__(self, params: UkfParams) -> None:
        super().__init__(golden_core(params))
        self.break_at(None, False)

    def break_at(self, access: int | None, done: bool) -> None:
        """Break off the access of this number, from 1 on; None is none."""
        self.count, self._breaks, self._done = 0, access, done

    def _is_broken(self, address: int) -> bool:
        """Count an access; whether it breaks off after it has been done."""
        self.count += 1
        broken = self.count == self._breaks
        if broken and not self._done:
            raise BusError(address)
        return broken

    def read(self, address: int) -> int:
        """Read a word."""
        broken = self._is_broken(address)
        word = super().read(address)
        if broken:
            raise BusError(address)
        return word

    def write(self, address: int, word: int) -> None:
        """Write a word."""
        broken = self._is_broken(address)
        super().write(address, word)
        if broken:
            raise BusError(address)
