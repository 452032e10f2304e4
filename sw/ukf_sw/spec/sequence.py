"""Which step is legal when, which program it runs, and what it leaves: the one description.

The control unit and the golden model execute these tables, co-simulation predicts with them how
long a step takes, and the page of registers shows them.

The memories of a core hold more than the estimate: sigma points that belong to it, or residuals of
a prediction. Flags say what is there; all but PREDICTED and PROPAGATED can be read in STATUS. A
step takes the first of its ways whose flags are set, and is illegal if there is none. When its
program has succeeded, it ends, or goes on as another step (:data:`FOLLOWING`).
"""

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

from ukf_sw.spec.model_programs import CoreModels

__all__ = [
    "ENDINGS",
    "FOLLOWING",
    "HIDDEN",
    "NO_BANK",
    "NO_FLAG",
    "OF_MODELS",
    "OF_SENSORS",
    "STEPS",
    "WAYS",
    "Bank",
    "Change",
    "Ending",
    "Flag",
    "Program",
    "Routine",
    "Step",
    "Way",
    "find_way",
    "is_there",
    "of_sensor",
    "of_variant",
    "steps_of",
]  # fmt: skip


class Step(IntEnum):
    """Steps that the processor starts, and values of STATUS.STATE."""

    IDLE = 0
    INIT = 1
    SIG_GEN = 2
    PREDICT = 3
    UPDATE = 4
    COVARIANCE = 5
    F = 6  #: The process model, then PREDICT.
    H = 7  #: The observation model of a sensor, then UPDATE.
    ITERATE = 8  #: F, then H.


#: Steps that only cores with models have.
OF_MODELS = frozenset({Step.F, Step.H, Step.ITERATE})
#: Steps that can be started, in the order of their bits in CONTROL and STATUS.
STEPS = tuple(step for step in Step if step is not Step.IDLE)


class Program(IntEnum):
    """Programs of the engine; the value is what the control unit passes to it."""

    INIT = 0  #: Check x and L, compute the noise rows W and V.
    SIG_GEN = 1  #: X from x and L.
    SIG_GEN_PREDICTED = 2  #: L from the predicted residuals, then X.
    PREDICT = 3  #: x and the weighted residuals from the transformed X.
    UPDATE_REDRAWN = 4  #: Residuals from sigma points that were just drawn; UPDATE follows on.
    UPDATE = 5  #: x, L and the next X from Z and z.
    COVARIANCE = 6  #: P from L.
    COVARIANCE_PREDICTED = 7  #: P from the predicted residuals.
    MODEL_F = 8  #: X from X, with the process model.
    MODEL_H = 9  #: Z from X, with the observation model of a sensor.


#: Programs of which each sensor has its own.
OF_SENSORS = frozenset({Program.UPDATE_REDRAWN, Program.UPDATE, Program.MODEL_H})


class Routine(NamedTuple):
    """A program as it stands in the memory of a core.

    Parameters
    ----------
    program
        Which one.
    sensor
        Whose it is; 0 of a program that is not in :data:`OF_SENSORS`.
    variant
        Which of its observation models, of MODEL_H; else 0.
    """

    program: Program
    sensor: int = 0
    variant: int = 0


def of_sensor(name: str, sensor: int, sensors: int) -> str:
    """Name of a program or step of a sensor, for people: with its number, if there are several."""
    return f"{name} of sensor {sensor}" if sensors > 1 else name


def of_variant(name: str, models: CoreModels, routine: Routine) -> str:
    """Name of a program or step with its observation model, for people, if there are several."""
    if routine.program is not Program.MODEL_H or len(models.h[routine.sensor]) == 1:
        return name
    return f"{name}, variant {routine.variant}"


class Flag(IntFlag):
    """What the memories hold."""

    INITIALISED = 1  #: The results of INIT.
    POINTS = 2  #: Sigma points of the estimate, in X.
    PREDICTED = 4  #: The covariance as residuals of a PREDICT, not as factor L.
    RESIDUALS = 8  #: Residuals of a PREDICT that an UPDATE can use.
    PROPAGATED = 16  #: Sigma points as that PREDICT has found them, in X.


#: Flags that STATUS does not show.
HIDDEN = Flag.PREDICTED | Flag.PROPAGATED


class Bank(IntFlag):
    """What has two copies: a step writes the one that is not current, and ends by turning."""

    STATE = 1  #: x.
    FACTOR = 2  #: L.


NO_FLAG = Flag(0)
NO_BANK = Bank(0)
_ALL_POINTS = Flag.POINTS | Flag.PREDICTED | Flag.RESIDUALS | Flag.PROPAGATED


@dataclass(frozen=True, kw_only=True)
class Way:
    """A way in which a step can be done.

    Parameters
    ----------
    needs
        Flags that must be set; NO_FLAG is always legal.
    program
        Program that it runs; None if there is nothing to do, so that the step ends at once.
    """

    needs: Flag = NO_FLAG
    program: Program | None


#: Ways of each step, the first whose flag is set being taken.
WAYS: dict[Step, tuple[Way, ...]] = {
    Step.INIT: (Way(program=Program.INIT),),
    Step.SIG_GEN: (
        Way(needs=Flag.POINTS, program=None),
        Way(needs=Flag.PREDICTED, program=Program.SIG_GEN_PREDICTED),
        Way(needs=Flag.INITIALISED, program=Program.SIG_GEN),
    ),
    Step.PREDICT: (Way(needs=Flag.POINTS, program=Program.PREDICT),),
    Step.UPDATE: (
        Way(needs=Flag.RESIDUALS, program=Program.UPDATE),
        Way(needs=Flag.POINTS, program=Program.UPDATE_REDRAWN),
    ),
    Step.COVARIANCE: (
        Way(needs=Flag.PREDICTED, program=Program.COVARIANCE_PREDICTED),
        Way(needs=Flag.INITIALISED, program=Program.COVARIANCE),
    ),
    Step.F: (Way(needs=Flag.POINTS, program=Program.MODEL_F),),
    # An UPDATE that was rejected has overwritten the sigma points of the prediction.
    Step.H: (
        Way(needs=Flag.RESIDUALS | Flag.PROPAGATED, program=Program.MODEL_H),
        Way(needs=Flag.POINTS, program=Program.MODEL_H),
    ),
    Step.ITERATE: (Way(needs=Flag.POINTS, program=Program.MODEL_F),),
}

#: As what a step goes on when a program has succeeded.
FOLLOWING: dict[tuple[Step, Program], Step] = {
    (Step.F, Program.MODEL_F): Step.PREDICT,
    (Step.H, Program.MODEL_H): Step.UPDATE,
    (Step.ITERATE, Program.MODEL_F): Step.PREDICT,
    (Step.ITERATE, Program.PREDICT): Step.H,
    (Step.ITERATE, Program.MODEL_H): Step.UPDATE,
}


def is_there(step: Step, models: CoreModels, sensors: int, sensor: int, variant: int) -> bool:
    """Whether a core has a step for a sensor and a variant of its model.

    Parameters
    ----------
    step
        The step. What it does not need does not matter.
    models, sensors
        Of the core: what it evaluates, and how many sensors it has.
    sensor, variant
        As the processor gives them.
    """
    if step in (Step.F, Step.ITERATE) and models.f is None:
        return False
    if step in (Step.H, Step.ITERATE):
        return sensor < len(models.h) and variant < len(models.h[sensor])
    return step is not Step.UPDATE or sensor < sensors


def steps_of(models: CoreModels) -> tuple[Step, ...]:
    """Steps of a core, for any sensor."""
    return tuple(step for step in STEPS if is_there(step, models, 1, 0, 0))


def find_way(step: Step, flags: Flag) -> Way | None:
    """Give the way that a step takes; None if it is illegal.

    Parameters
    ----------
    step
        The step.
    flags
        What the memories hold.
    """
    for way in WAYS[step]:
        if way.needs & flags == way.needs:
            return way
    return None


@dataclass(frozen=True, kw_only=True)
class Change:
    """What an end does to flags and banks.

    Parameters
    ----------
    sets, clears
        Flags; one that is in neither stays.
    turns
        Banks whose other copy becomes the current one.
    """

    sets: Flag = NO_FLAG
    clears: Flag = NO_FLAG
    turns: Bank = NO_BANK


@dataclass(frozen=True, kw_only=True)
class Ending:
    """What a program leaves.

    Parameters
    ----------
    success
        If it succeeds.
    failure
        If it ends with an error, or its update is rejected by the gate.
    gives_nis
        Whether its success gives a NIS, which is compared with the gate.
    """

    success: Change = Change()
    failure: Change = Change()
    gives_nis: bool = False


_DRAWN = Change(sets=Flag.POINTS, clears=Flag.PREDICTED | Flag.RESIDUALS | Flag.PROPAGATED)
_UPDATED = Change(sets=_DRAWN.sets, clears=_DRAWN.clears, turns=Bank.STATE | Bank.FACTOR)

#: What every program leaves.
ENDINGS: dict[Program, Ending] = {
    Program.INIT: Ending(
        success=Change(sets=Flag.INITIALISED, clears=_ALL_POINTS),
        failure=Change(clears=Flag.INITIALISED | _ALL_POINTS),
    ),
    Program.SIG_GEN: Ending(success=_DRAWN),
    Program.SIG_GEN_PREDICTED: Ending(
        success=Change(sets=_DRAWN.sets, clears=_DRAWN.clears, turns=Bank.FACTOR)
    ),
    Program.PREDICT: Ending(
        success=Change(
            sets=Flag.PREDICTED | Flag.RESIDUALS | Flag.PROPAGATED, clears=Flag.POINTS,
            turns=Bank.STATE,
        ),
        failure=Change(clears=_ALL_POINTS),
    ),
    # The residuals of the prediction stay as they are, so a rejected update can be tried again.
    Program.UPDATE: Ending(
        success=_UPDATED, failure=Change(clears=Flag.PROPAGATED), gives_nis=True
    ),
    # It has overwritten the sigma points and what stood in the place of residuals.
    Program.UPDATE_REDRAWN: Ending(
        success=_UPDATED, failure=Change(clears=_ALL_POINTS), gives_nis=True
    ),
    Program.COVARIANCE: Ending(),
    Program.COVARIANCE_PREDICTED: Ending(),
    # X then is neither what it was nor what f gives.
    Program.MODEL_F: Ending(failure=Change(clears=_ALL_POINTS)),
    Program.MODEL_H: Ending(),
}  # fmt: skip

if set(WAYS) != set(STEPS) or set(ENDINGS) != set(Program):
    raise RuntimeError("Every step must have its ways, and every program its ending")
