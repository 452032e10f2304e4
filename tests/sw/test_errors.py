"""Errors pass from a process to another with all that they say."""

import copy
import pickle

import pytest

from ukf_sw import errors
from ukf_sw.factors import IndefiniteError
from ukf_sw.spec.registers import REGISTERS
from ukf_sw.spec.sequence import Step

EXAMPLES = [
    errors.BusError(0x40, "read"),
    errors.DeviceMissingError("uio0", "there is none"),
    errors.WrongCoreError("SIZES.N", 7, 6),
    errors.CoreTimeoutError(Step.UPDATE, 0.5, "it runs"),
    errors.StepLostError(Step.PREDICT),
    errors.SingularObservationError(Step.UPDATE, 3),
    errors.NotPositiveDefiniteError(Step.UPDATE, 2),
    errors.NotFiniteError(Step.INIT),
    errors.IllegalStepError(Step.PREDICT),
    errors.NotRecoveredError(),
    errors.EstimateLostError(),
    errors.FormatOverflowError("x", 1e39, 3e38),
    IndefiniteError("must be positive definite", 3, "it is not"),
]


@pytest.mark.parametrize("error", EXAMPLES, ids=lambda error: type(error).__name__)
def test_errors_come_back_from_a_pickle(error):
    error.add_note("in a worker")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
    assert again.__notes__ == ["in a worker"]


@pytest.mark.parametrize("register", REGISTERS, ids=lambda register: register.name)
def test_registers_are_themselves_after_a_pickle(register):
    assert pickle.loads(pickle.dumps(register)) is register
    assert copy.deepcopy(register) is register
