"""Rounds of programs, which the engine runs without going back to its caller in between."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ukf_sw.spec.sequence import Routine

__all__ = ["Rounds", "RoundsDone"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Rounds:
    """K rounds, of R programs in all, with what is written before each and read after each round.

    A place is the number of a half word of the memories.

    Parameters
    ----------
    routines, masks, state_banks, factor_banks
        What :meth:`ukf_sw.engine.interpreter.Interpreter.run` is to be called with, R each.
    compares
        Whether the NIS of a program is compared with the gate, R.
    gate
        The gate, as a word without its sign.
    ends
        Number of programs up to the end of each round, K.
    writes
        Number of words that have been written before each program runs, R, in
    places, words
        what is written where, in order.
    shown
        Places that are read after each round, shape (K, X).
    """

    routines: Sequence[Routine]
    masks: Sequence[int]
    state_banks: Sequence[int]
    factor_banks: Sequence[int]
    compares: Sequence[bool]
    gate: int
    ends: Sequence[int]
    writes: Sequence[int]
    places: NDArray[np.int64]
    words: NDArray[np.uint32]
    shown: NDArray[np.int64]


class RoundsDone(NamedTuple):
    """What came of rounds.

    Parameters
    ----------
    rounds
        Number of rounds that have succeeded.
    nis
        NIS of each of their programs, as a word; 0 of those that give none.
    seen
        What was read after each of them, shape (rounds, X).
    """

    rounds: int
    nis: NDArray[np.uint64]
    seen: NDArray[np.uint32]
