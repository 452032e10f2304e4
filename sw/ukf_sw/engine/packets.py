"""Packets: what the program memory holds instead of plain control words.

A program has no loops, but it repeats itself: an operation on a row is one word after another with
addresses that count, and rows that are worked on side by side give a group of words again and
again. So a packet has one word as it is, and says how many words follow that repeat those a fixed
distance before them, with addresses that count or stand still (LZ77 with addresses that count).

Reads and writes have rhythms of their own, so each half of the control word is a stream of packets
of its own. Both are unpacked one word a clock, and the words are those that were packed.
"""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ukf_sw.engine.control_word import ControlField, ControlFormat, Half
from ukf_sw.spec.sequence import Routine

__all__ = ["COUNT_WIDTH", "DISTANCE_WIDTH", "Packet", "PacketFormat", "PacketStream", "pack"]

#: Width of the number of repeated words.
COUNT_WIDTH = 6
#: Width of a distance less one. The hardware remembers as many words as the largest distance.
DISTANCE_WIDTH = 5

Words = NDArray[np.int32]
Flags = NDArray[np.bool_]


class Packet(NamedTuple):
    """A word, and the words after it that repeat earlier ones.

    Parameters
    ----------
    word
        Values of the fields.
    repetitions
        How many words follow that repeat.
    distance
        How far back the word lies that each of them repeats.
    steps
        For each field that may count: 1 if it is one more than in the repeated word, else 0.
    """

    word: tuple[int, ...]
    repetitions: int
    distance: int
    steps: tuple[int, ...]


class PacketFormat:
    """Fields of the packets of one half of the control word.

    Parameters
    ----------
    control
        The control word.
    half
        Which half of it.

    Attributes
    ----------
    fields : tuple of ControlField
        Fields of the word, numbered from bit 0 of the packet.
    count, distance, steps : ControlField
        Fields behind them: number of repeated words; their distance, less one; a bit for each field
        of `half.counting`.
    word_width, width : int
        Width of the word and of the packet.
    """

    def __init__(self, control: ControlFormat, half: Half) -> None:
        self.half = half
        lsb = 0
        fields: list[ControlField] = []
        for name in control.present(half.fields):
            fields.append(ControlField(name, lsb, control.fields[name].width))
            lsb += fields[-1].width
        self.fields = tuple(fields)
        self.word_width = lsb
        self.count = ControlField("count", lsb, COUNT_WIDTH)
        self.distance = ControlField("distance", lsb + COUNT_WIDTH, DISTANCE_WIDTH)
        self.steps = ControlField(
            "steps", lsb + COUNT_WIDTH + DISTANCE_WIDTH, len(half.counting)
        )  # fmt: skip
        self.width = self.steps.lsb + self.steps.width

    def encode(self, packet: Packet) -> int:
        """Give a packet as a number."""
        steps = sum(step << k for k, step in enumerate(packet.steps))
        number = packet.repetitions << self.count.lsb | steps << self.steps.lsb
        number |= (packet.distance - 1) << self.distance.lsb
        for field, value in zip(self.fields, packet.word, strict=True):
            number |= value << field.lsb
        return number


def pack(words: Words, half: Half) -> Iterator[Packet]:
    """Pack words, in as few packets as their distances and counts allow.

    Any beginning of a repetition is a repetition, so taking the longest each time is the best.

    Parameters
    ----------
    words
        Words of one program, shape (words, fields).
    half
        Names of the fields.
    """
    length, distance, steps = _repetitions(words, half)
    at = 0
    while at < len(words):
        follows = at + 1
        count = int(length[follows]) if follows < len(words) else 0
        how = (int(distance[follows]), tuple(steps[follows].tolist())) if count else (
            1, (0,) * len(half.counting)
        )  # fmt: skip
        yield Packet(tuple(words[at].tolist()), count, *how)
        at = follows + count


def _repetitions(words: Words, half: Half) -> tuple[Words, Words, Words]:
    """For every word the longest repetition that begins there: length, distance and steps."""
    total = len(words)
    index = {name: k for k, name in enumerate(half.fields)}
    counting = [index[name] for name in half.counting]
    once = [index[name] for name in half.once]
    fixed = [k for k in range(len(half.fields)) if k not in counting and k not in once]
    length = np.zeros(total, dtype=np.int32)
    distances = np.ones(total, dtype=np.int32)
    steps = np.zeros((total, len(counting)), dtype=np.int32)
    quiet: Flags = ~np.any(words[:, once], axis=1)
    for distance in range(1, min(1 << DISTANCE_WIDTH, total - 1) + 1):
        same: Flags = quiet[distance:] & np.all(
            words[distance:, fixed] == words[:-distance, fixed], axis=1
        )
        rise = words[distance:, counting] - words[:-distance, counting]
        for step in product((0, 1), repeat=len(counting)):
            repeats: Flags = same & np.all(rise == step, axis=1)
            # The next word that does not repeat ends the run.
            ends = np.where(repeats, len(repeats), np.arange(len(repeats)))
            ends = np.minimum.accumulate(ends[::-1])[::-1]
            run = np.minimum(ends - np.arange(len(repeats)), (1 << COUNT_WIDTH) - 1)
            better = np.flatnonzero(run > length[distance:]) + distance
            length[better] = run[better - distance]
            distances[better] = distance
            steps[better] = step
    return length, distances, steps


class PacketStream:
    """All programs' packets of one half of the control word.

    Parameters
    ----------
    control
        The control word.
    half
        Which half of it.
    programs
        Words of each program, in the order in which they lie in memory.

    Attributes
    ----------
    format : PacketFormat
    packets : list of int
    entry : dict of Routine to int
        Address of the first packet of each program.
    """

    def __init__(
        self, control: ControlFormat, half: Half, programs: Mapping[Routine, list[int]]
    ) -> None:
        self.format = PacketFormat(control, half)
        self.packets: list[int] = []
        self.entry: dict[Routine, int] = {}
        present = half._replace(fields=control.present(half.fields))
        for routine, words in programs.items():
            self.entry[routine] = len(self.packets)
            columns = control.decode(words)
            matrix = np.stack([columns[field.name] for field in self.format.fields], axis=1)
            self.packets += [self.format.encode(packet) for packet in pack(matrix, present)]
