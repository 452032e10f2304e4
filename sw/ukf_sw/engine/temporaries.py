"""Places in the memories for the temporaries of a model's program, when it has been scheduled.

A word is free again when its last reader has read it. Vectors that hold nothing while a model runs
lend their words: an update writes them before it reads them. Of a row of residuals only the lanes
of sigma points are lent, for the lanes beside them must stay zero; of a root all lanes.
"""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from itertools import count

from ukf_sw.engine.layout import TEMPORARY, Layout, Word
from ukf_sw.engine.operations import ProgramBuilder
from ukf_sw.engine.scheduler import Schedule
from ukf_sw.spec.parameters import Form
from ukf_sw.spec.sequence import Program

__all__ = ["allocate_temporaries", "lent_words"]


def lent_words(layout: Layout, program: Program) -> dict[Word, int]:
    """Give the words that hold nothing while MODEL_F or MODEL_H runs, and their free lanes.

    The residuals of a prediction are there while an h runs, but not while f does.
    """
    lanes = ProgramBuilder(layout).lanes_by_beat([layout.points])
    rows = list(layout.Ez)
    if layout.params.form is Form.SQUARE_ROOT:
        rows += layout.G
    if program is Program.MODEL_F:
        rows += layout.Ex
    lent = {row.word(beat): free for row in rows for beat, free in lanes.items()}
    every_lane = (1 << layout.params.pes) - 1
    return lent | dict.fromkeys((root.word(0) for root in layout.roots), every_lane)


def _lives(plan: Schedule) -> dict[Word, tuple[int, int, int]]:
    """Give the clocks of the first write and of the last use of temporaries, and their lanes."""
    lives: dict[Word, tuple[int, int, int]] = {}

    def use(word: Word | None, clock: int, lanes: int = 0) -> None:
        if word is not None and word[1] == TEMPORARY:
            first, last, all_lanes = lives.get(word, (clock, clock, 0))
            lives[word] = min(first, clock), max(last, clock), all_lanes | lanes

    for operation, issue in zip(plan.operations, plan.issue, strict=True):
        done = issue + plan.timing.result(operation)
        use(operation.destination, done, operation.lanes)
        use(operation.root, done + plan.timing.pipeline.reciprocal_sqrt, operation.root_lanes)
        for beat in operation.beats:
            use(beat.word_0, issue)
            use(beat.word_1, issue)
    return lives


def allocate_temporaries(
    plan: Schedule, lent: Mapping[Word, int], own: Sequence[Word]
) -> tuple[dict[Word, Word], int]:
    """Give every temporary of a schedule a place.

    Parameters
    ----------
    plan
        The schedule.
    lent
        Words that other vectors lend, and their lanes.
    own
        Words for temporaries alone. If there are too few, others are invented.

    Returns
    -------
    places : dict
        Place of each temporary.
    needed : int
        How many of its own words the program needs.
    """
    # Those with few free lanes first, so that the others stay for what needs them.
    free = sorted(lent, key=lambda word: (lent[word].bit_count(), word))
    mine: Iterator[Word] = (own[k] if k < len(own) else (k, -1) for k in count())
    released: list[Word] = []
    busy: list[tuple[int, Word]] = []
    places: dict[Word, Word] = {}
    needed = 0
    lives = _lives(plan)
    for word in sorted(lives, key=lambda word: (*lives[word], word)):
        first, last, lanes = lives[word]
        # A word that is read on a clock must not be written on it.
        while busy and busy[0][0] < first:
            place = heapq.heappop(busy)[1]
            (free if place in lent else released).append(place)
        fitting = next((place for place in free if not lanes & ~lent[place]), None)
        if fitting is not None:
            free.remove(fitting)
        elif released:
            fitting = released.pop()
        else:
            fitting, needed = next(mine), needed + 1
        places[word] = fitting
        heapq.heappush(busy, (last, fitting))
    return places, needed
