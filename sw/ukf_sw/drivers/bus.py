"""The bus as software sees it, and numbers as words on it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from ukf_sw.spec.float_format import BINARY32, FloatFormat
from ukf_sw.spec.sequence import Step

__all__ = [
    "Addresses",
    "BlockBus",
    "Bus",
    "OneCore",
    "Replies",
    "Script",
    "ScriptBus",
    "Start",
    "WordCodec",
    "Words",
]

Addresses = NDArray[np.int64]
Words = NDArray[np.uint32]


class Bus(Protocol):
    """A bus of 32-bit words, with byte addresses relative to the core.

    Both methods raise :class:`ukf_sw.errors.BusError` if the core answers with an error.
    """

    def read(self, address: int) -> int:
        """Read a word."""
        ...

    def write(self, address: int, word: int) -> None:
        """Write a word."""
        ...


class BlockBus(Bus, Protocol):
    """A bus that takes many accesses at once, where single calls cost too much.

    They mean the same as single accesses in that order.
    """

    def read_many(self, addresses: Addresses) -> Words:
        """Read words, shape (k,), at addresses, shape (k,)."""
        ...

    def write_many(self, addresses: Addresses, words: Words) -> None:
        """Write words, shape (k,), at addresses, shape (k,)."""
        ...


class Start(NamedTuple):
    """A write to CONTROL that starts a step.

    Parameters
    ----------
    step, sensor, variant
        What CONTROL is told.
    mask
        What MASK holds then.
    writes
        Words that have been written before it, since the script began.
    """

    step: Step
    sensor: int
    variant: int
    mask: int
    writes: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Script:
    """K rounds of accesses, every start of a step being waited for.

    Parameters
    ----------
    starts
        Starts of steps, in order.
    ends
        How many of them there have been at the end of each round, K numbers.
    addresses, words
        What is written to the buffer, and where, in order.
    reads
        Addresses that are read at the end of each round, X of them.
    """

    starts: Sequence[Start]
    ends: Sequence[int]
    addresses: Addresses
    words: Words
    reads: Addresses


class Replies(NamedTuple):
    """What came of a script.

    Parameters
    ----------
    rounds
        How many have succeeded: no step was refused, failed, or exceeded the gate.
    nis
        Word of the NIS after each start of theirs, of updates.
    reads
        What was read, shape (rounds, X).
    """

    rounds: int
    nis: NDArray[np.uint64]
    reads: Words


class ScriptBus(Bus, Protocol):
    """A bus to a core that can do many rounds of accesses at once: a model, no hardware."""

    def run_script(self, script: Script) -> Replies:
        """Do what a script says, up to the first round that does not succeed.

        Nothing of that round is done. One that could succeed may be left out, too.
        """
        ...


class OneCore:
    """Base of a bus to a core of which there is only one, so that it cannot be copied."""

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied.

        Raises
        ------
        TypeError
            Always.
        """
        raise TypeError(
            f"A filter or driver whose core is behind a {type(self).__name__} cannot be pickled "
            "or copied, for there is one such core: keep x, P, Q and R, and start another filter "
            "from them"
        )


class WordCodec:
    """Numbers to bus words and back.

    A number takes ``format.bus_words`` words, the low one first; narrow formats use the low bits.
    The results are those of :meth:`FloatFormat.encode` and :meth:`FloatFormat.decode`, sooner for
    binary32.

    Parameters
    ----------
    number_format
        Format of the numbers.
    """

    def __init__(self, number_format: FloatFormat) -> None:
        self._format = number_format
        self._quick = number_format == BINARY32

    def to_words(self, values: NDArray[np.float64]) -> Words:
        """Round numbers, shape (k,), to words, shape (k * bus_words,)."""
        if self._quick:
            with np.errstate(over="ignore", under="ignore", invalid="ignore"):
                words = values.astype(np.float32).view(np.uint32)
            magnitude = words & np.uint32(0x7FFF_FFFF)
            # NaN, and what may be below the smallest normal number, is for the format to decide.
            plain = (magnitude > 0x0080_0000) & (magnitude <= 0x7F80_0000)
            if (plain | (values == 0.0)).all():
                return words
        encoded = self._format.encode(values)
        if self._format.bus_words == 1:
            return encoded.astype(np.uint32)
        halves = (encoded & np.uint64(0xFFFF_FFFF), encoded >> np.uint64(32))
        return np.stack(halves, axis=-1).astype(np.uint32).reshape(-1)

    def from_words(self, words: Words) -> NDArray[np.float64]:
        """Give the numbers, shape (k,), of words, shape (k * bus_words,)."""
        if self._quick:
            magnitude = words & np.uint32(0x7FFF_FFFF)
            plain = (magnitude >= 0x0080_0000) & (magnitude <= 0x7F80_0000)
            if (plain | (magnitude == 0)).all():
                return words.view(np.float32).astype(np.float64)
        if self._format.bus_words == 1:
            return self._format.decode(words)
        pairs = words.astype(np.uint64).reshape(-1, 2)
        return self._format.decode(pairs[:, 0] | pairs[:, 1] << np.uint64(32))
