"""Scripts of accesses as rounds of programs: what the control unit does if every step succeeds."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ukf_sw.drivers.bus import Script
from ukf_sw.engine.rounds import Rounds
from ukf_sw.golden.buffer import GoldenBuffer
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.sequence import (
    ENDINGS,
    FOLLOWING,
    OF_SENSORS,
    Bank,
    Flag,
    Program,
    Routine,
    Step,
    find_way,
    is_there,
)

__all__ = ["Plan", "plan_script"]


class Path(NamedTuple):
    """What a step does if all its programs succeed.

    Parameters
    ----------
    routines
        Its programs.
    turns
        Banks that have turned before each of them, and after the last.
    compares
        Of each of them, whether its NIS is compared with the gate.
    flags
        What the memories hold after the step.
    """

    routines: tuple[Routine, ...]
    turns: tuple[int, ...]
    compares: tuple[bool, ...]
    flags: Flag


def find_path(params: UkfParams, step: Step, sensor: int, variant: int, flags: Flag) -> Path | None:
    """Give the path of a step; None if it is illegal."""
    if not is_there(step, params.models, len(params.sensor_rows), sensor, variant):
        return None
    routines: list[Routine] = []
    turns = [0]
    following: Step | None = step
    while following is not None:
        way = find_way(following, flags)
        if way is None:
            return None
        if way.program is None:
            break
        program = way.program
        routines.append(
            Routine(
                program,
                sensor if program in OF_SENSORS else 0,
                variant if program is Program.MODEL_H else 0,
            )
        )
        change = ENDINGS[program].success
        flags = flags & ~change.clears | change.sets
        turns.append(turns[-1] ^ int(change.turns))
        following = FOLLOWING.get((step, program))
    compares = tuple(ENDINGS[routine.program].gives_nis for routine in routines)
    return Path(tuple(routines), tuple(turns), compares, flags)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """A script as rounds of programs, as far as it is legal.

    Parameters
    ----------
    rounds
        The rounds.
    paths
        Path of each start.
    banks
        Banks before each start, and after the last.
    updates
        Of each start, the program that has given the NIS that there is after it; -1 if that is
    nis
        the word from before the script.
    """

    rounds: Rounds
    paths: list[Path]
    banks: list[int]
    updates: list[int]
    nis: int

    def nis_of_starts(self, nis: NDArray[np.uint64]) -> NDArray[np.uint64]:
        """Give the word of the NIS after each start, from those of the programs that have run."""
        updates = np.array([each for each in self.updates if each < len(nis)], dtype=np.int64)
        return np.append(nis, np.uint64(self.nis))[updates]


def plan_script(
    script: Script,
    params: UkfParams,
    buffer: GoldenBuffer,
    flags: Flag,
    banks: Bank,
    nis: int,
    gate: int,
) -> Plan | None:
    """Plan the rounds of a script up to one that is illegal.

    Parameters
    ----------
    script
        The script.
    params
        What the core computes.
    buffer
        Its buffer.
    flags, banks
        As they are before the script.
    nis
        Word of the last NIS.
    gate
        The gate, as a word without its sign.

    Returns
    -------
    Plan or None
        None if an address is illegal, or if what is written would change flags, or lie in a bank.
    """
    written = buffer.find_many(script.addresses)
    shown = buffer.find_many(script.reads)
    if written is None or shown is None:
        return None
    places, bits, outdated = written
    if outdated.any() or (places != places[0]).any() or not bits.all():
        return None
    found: dict[tuple[Step, int, int, Flag], Path | None] = {}
    paths: list[Path] = []
    now = int(banks)
    before = [now]
    routines: list[Routine] = []
    masks: list[int] = []
    banks_of_runs: list[int] = []
    compares: list[bool] = []
    writes: list[int] = []
    updates: list[int] = []
    ends: list[int] = []
    update = -1
    for step, sensor, variant, mask, count in script.starts:
        key = step, sensor, variant, flags
        if key not in found:
            found[key] = find_path(params, *key)
        path = found[key]
        if path is None:
            break
        for routine, turns, gives_nis in zip(
            path.routines, path.turns, path.compares, strict=False
        ):
            if gives_nis:
                update = len(routines)
            routines.append(routine)
            masks.append(mask)
            banks_of_runs.append(now ^ turns)
            compares.append(gives_nis)
            writes.append(count)
        paths.append(path)
        updates.append(update)
        flags, now = path.flags, now ^ path.turns[-1]
        before.append(now)
        ends.append(len(routines))
    whole = [end for end in script.ends if end <= len(paths)]
    return Plan(
        rounds=Rounds(
            routines=routines,
            masks=masks,
            state_banks=[each & int(Bank.STATE) != 0 for each in banks_of_runs],
            factor_banks=[each & int(Bank.FACTOR) != 0 for each in banks_of_runs],
            compares=compares,
            gate=gate,
            ends=[ends[end - 1] for end in whole],
            writes=writes,
            places=places[0],
            words=script.words & bits,
            shown=shown[0][np.array([before[end] for end in whole], dtype=np.int64)],
        ),
        paths=paths,
        banks=before,
        updates=updates,
        nis=nis,
    )
