"""Errors of the filter, its driver and the core; all of them are a :class:`UkfError`.

Wrong arguments are not among them: those are the usual TypeError and ValueError.

What a method that raises has done:

- TypeError, ValueError, and what is in :data:`REFUSALS`: nothing. Filter and core are as before.
  But a driver's ``initialise()`` that INIT refuses leaves a doubt: x and P have been written.
- Anything else (:class:`BusError`, :class:`CoreTimeoutError`, :class:`StepLostError`,
  KeyboardInterrupt, ...), if it came while the core was asked: that is open. Filter and driver then
  refuse with :class:`NotRecoveredError` whatever needs the core, until their ``recover()`` has
  found out or has begun from what is known. After it, what broke off has happened as a whole or
  not at all.
"""

import traceback
from pathlib import Path
from typing import Any

from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Step

__all__ = [
    "REFUSALS", "BusError", "CoreError", "CoreTimeoutError", "DeviceError", "DeviceMissingError",
    "DevicePermissionError", "EstimateLostError", "FormatOverflowError", "IllegalStepError",
    "ModelNotFiniteError", "NotFiniteError", "NotPositiveDefiniteError", "NotRecoveredError",
    "SingularObservationError", "StepError", "StepLostError", "TraceError", "UkfError",
    "WrongCoreError",
    "add_note", "describe", "error_of",
]  # fmt: skip


class UkfError(Exception):
    """Something went wrong in the filter or on the way to its core.

    It can be pickled, so it passes from a process to another with all that it says.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self.args, self.__dict__)


def _restore(kind: type[UkfError], args: tuple[Any, ...], state: dict[str, Any]) -> UkfError:
    """Make an error as it was, whatever its constructor takes."""
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(state)
    return error


class BusError(UkfError):
    """The core answered an access with an error (SLVERR on AXI).

    Parameters
    ----------
    address
        Byte address of the access.
    access
        "read" or "write".
    """

    def __init__(self, address: int, access: str = "access") -> None:
        super().__init__(f"The core refused the {access} at address {address:#x}")
        self.address = address
        self.access = access


class DeviceError(UkfError):
    """The device through which the core is reached does not work.

    Parameters
    ----------
    device
        Name of the device.
    message
        What is wrong with it, and what may help.
    """

    def __init__(self, device: str, message: str) -> None:
        super().__init__(f"{device}: {message}")
        self.device = device


class DeviceMissingError(DeviceError):
    """There is no such device, or what it needs is not installed."""


class DevicePermissionError(DeviceError):
    """The device is there, but not for this user."""


class WrongCoreError(UkfError):
    """The core on the bus is not the one that the parameters describe.

    Parameters
    ----------
    field
        Register field that differs.
    expected, found
        Its values.
    """

    def __init__(self, field: str, expected: int, found: int) -> None:
        super().__init__(f"{field} of the core must be {expected:#x}, not {found:#x}")
        self.field = field
        self.expected = expected
        self.found = found


class NotRecoveredError(UkfError):
    """An error has left open what the core holds, and ``recover()`` has not been called since."""

    def __init__(self) -> None:
        super().__init__(
            "An error has left open what the core has done: call recover() before going on, "
            "or begin anew with reset()"
        )


class EstimateLostError(UkfError):
    """The core has been reset while its estimate was a prediction that it had yet to factorise.

    Whether the factor is that from before is not known, so there is no estimate any more.
    """

    def __init__(self) -> None:
        super().__init__(
            "The core has lost its estimate by a reset during a step: begin anew with reset()"
        )


class FormatOverflowError(UkfError, ValueError):
    """A number is too large for the number format of the core. Nothing has been sent.

    Parameters
    ----------
    name
        What it belongs to.
    value
        The number.
    limit
        Largest number of the format.
    """

    def __init__(self, name: str, value: float, limit: float) -> None:
        super().__init__(
            f"{name} must be at most {limit:.6g}, the largest number of the format, not {value!r}"
        )


class TraceError(UkfError, ValueError):
    """A model does what cannot become a program of the core. Nothing has been made of it.

    Parameters
    ----------
    model
        Name of the model.
    rule
        What it must not do.
    remedy
        What it could do instead.
    file, line
        Where it does so; None if that is not known.
    expression
        What stands there.
    """

    def __init__(
        self,
        model: str,
        rule: str,
        remedy: str,
        file: str | None = None,
        line: int | None = None,
        expression: str = "",
    ) -> None:
        shown = f", as in `{expression}`" if expression else ""
        where = "" if file is None else f" ({file}, line {line})"
        super().__init__(f"{model} must not {rule}{shown}{where}; {remedy}")
        self.model = model
        self.rule = rule
        self.remedy = remedy
        self.file = file
        self.line = line
        self.expression = expression


class StepError(UkfError):
    """A step did not succeed.

    Parameters
    ----------
    message
        What happened.
    step
        The step.

    Attributes
    ----------
    error_code : ErrorCode or None
        What the core reports so; None if the driver found it.
    """

    error_code: ErrorCode | None = None

    def __init__(self, message: str, step: Step) -> None:
        super().__init__(message)
        self.step = step


class CoreTimeoutError(StepError, TimeoutError):
    """A step did not end in time. It may end later.

    ``recover()`` waits for it once more, and drops it if it still runs. What is left then is the
    estimate from before the step or, if that was a prediction not yet factorised, from before the
    prediction.

    Parameters
    ----------
    step
        The step.
    timeout
        How long the driver waited, in seconds.
    detail
        What is known beyond that.
    """

    def __init__(self, step: Step, timeout: float, detail: str) -> None:
        super().__init__(f"{step.name} did not end within {timeout} s: {detail}", step)
        self.timeout = timeout


class StepLostError(StepError):
    """A step that had started neither runs nor has ended: something else reset the core."""

    def __init__(self, step: Step) -> None:
        super().__init__(
            f"{step.name} was dropped by a reset that the driver did not ask for", step
        )


class CoreError(StepError):
    """A step ended with an error code that this software does not know.

    Parameters
    ----------
    step
        The step.
    code, index
        Fields of the register ERROR.
    """

    def __init__(self, step: Step, code: int, index: int) -> None:
        super().__init__(f"{step.name} ended with the unknown error {code}, index {index}", step)
        self.code = code
        self.index = index


class IllegalStepError(StepError):
    """A step was started while one ran, out of sequence, or with the core disabled.

    It has not begun, but the core is not in the state that the driver took it to be in.
    """

    error_code = ErrorCode.ILLEGAL_STEP

    def __init__(self, step: Step) -> None:
        super().__init__(f"{step.name} must not start in this state of the core", step)


class NotFiniteError(StepError):
    """A step met NaN or infinity. The estimate from before the step stays.

    Parameters
    ----------
    step
        The step.
    detail
        What was so, if that is known.
    """

    error_code = ErrorCode.NOT_FINITE

    def __init__(self, step: Step, detail: str = "") -> None:
        super().__init__(f"{step.name} met NaN or infinity{detail and ': ' + detail}", step)


class ModelNotFiniteError(NotFiniteError):
    """A model on the core gave NaN or infinity. The estimate from before stays.

    Parameters
    ----------
    step
        The step.
    code
        MODEL_F or MODEL_H.
    index
        Row of the result, from 0: of x, or of all observations.
    """

    def __init__(self, step: Step, code: ErrorCode, index: int) -> None:
        model, row = ("f", "x") if code == ErrorCode.MODEL_F else ("h", "z")
        super().__init__(step, f"{model} gave it in row {index} of {row}")
        self.error_code = code
        self.index = index


class SingularObservationError(StepError):
    """The innovation covariance S is singular. The estimate from before the step stays.

    Parameters
    ----------
    index
        Row of S, from 0, that depends on the rows before it.
    """

    error_code = ErrorCode.SINGULAR_OBSERVATION

    def __init__(self, step: Step, index: int) -> None:
        super().__init__(f"{step.name}: innovation covariance is singular at row {index}", step)
        self.index = index


class NotPositiveDefiniteError(StepError):
    """The covariance of the state is not positive definite. The estimate before the step stays.

    Parameters
    ----------
    index
        Row of the bad pivot, from 0.
    """

    error_code = ErrorCode.NOT_POSITIVE_DEFINITE

    def __init__(self, step: Step, index: int) -> None:
        super().__init__(f"{step.name}: covariance is not positive definite at row {index}", step)
        self.index = index


def add_note(error: Exception, note: str) -> None:
    """Add a note to an error; before Python 3.11 it is kept, though no traceback prints it."""
    error.__dict__.setdefault("__notes__", []).append(note)


def describe(error: Exception) -> str:
    """Say what code of the user raised, and in which line of it."""
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg} ({error.filename}, line {error.lineno})"
    own = [
        frame for frame in traceback.extract_tb(error.__traceback__)
        if "importlib" not in frame.filename and "ukf_sw" not in Path(frame.filename).parts
    ]  # fmt: skip
    where = f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""
    return f"{type(error).__name__}: {error}{where}"


def error_of(step: Step, code: int, index: int) -> StepError:
    """Make the error that the core reports.

    Parameters
    ----------
    step
        The step.
    code, index
        Fields of the register ERROR; the code is not 0.
    """
    match code:
        case ErrorCode.ILLEGAL_STEP:
            return IllegalStepError(step)
        case ErrorCode.NOT_FINITE:
            return NotFiniteError(step)
        case ErrorCode.MODEL_F | ErrorCode.MODEL_H:
            return ModelNotFiniteError(step, ErrorCode(code), index)
        case ErrorCode.SINGULAR_OBSERVATION:
            return SingularObservationError(step, index)
        case ErrorCode.NOT_POSITIVE_DEFINITE:
            return NotPositiveDefiniteError(step, index)
        case _:
            return CoreError(step, code, index)


#: After these, what was asked for has not been done at all, and that is certain.
REFUSALS = (
    FormatOverflowError, NotFiniteError, NotPositiveDefiniteError, SingularObservationError,
)  # fmt: skip
