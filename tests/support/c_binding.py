"""The C filter as a Python object, on any bus: how tests look at every access that it makes."""

import ctypes
import time
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ukf_sim.c_in_the_loop.compiler import DRIVER, compile_c, write_headers
from ukf_sw.drivers.bus import Bus
from ukf_sw.errors import BusError
from ukf_sw.lowering.placement import PlacedModels
from ukf_sw.spec.parameters import UkfParams

__all__ = ["CFilter", "CFilterError", "Result", "compile_library", "describe_core"]

BINDING = Path(__file__).with_name("c_binding.c")

Array = NDArray[np.float64]
WORD = ctypes.c_uint32
REALS = ctypes.POINTER(ctypes.c_double)
READ = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, WORD, ctypes.POINTER(WORD))
WRITE = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, WORD, WORD)
WAIT = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, WORD)
NOW = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)
PROCESS = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, REALS, REALS, ctypes.c_void_p, REALS)
OBSERVE = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, REALS, REALS, REALS)


class Result(IntEnum):
    """Return codes, ``enum ukf_result``."""

    OK = 0
    ILLEGAL_STEP = 1
    NOT_FINITE = 2
    SINGULAR_OBSERVATION = 3
    NOT_POSITIVE_DEFINITE = 4
    MODEL_F = 5
    MODEL_H = 6
    UNKNOWN_ERROR = 64
    TIMEOUT = 65
    STEP_LOST = 66
    BUS_ERROR = 67
    WRONG_ID = 68
    WRONG_SIZES = 69
    WRONG_FORMAT = 70
    BAD_ARGUMENT = 71
    BAD_MODEL = 72
    NOT_OPEN = 73
    NOT_STARTED = 74
    NOT_RECOVERED = 75
    ESTIMATE_LOST = 76


class _Port(ctypes.Structure):
    _fields_ = (
        ("context", ctypes.c_void_p), ("read", READ), ("write", WRITE), ("wait", WAIT),
        ("now_us", NOW),
    )  # fmt: skip


class _Sensor(ctypes.Structure):
    _fields_ = (("observe", OBSERVE), ("terms", WORD), ("angles", WORD), ("variant", WORD))


class _Models(ctypes.Structure):
    _fields_ = (
        ("context", ctypes.c_void_p), ("process", PROCESS), ("sensors", ctypes.POINTER(_Sensor)),
        ("state_angles", WORD), ("on_predict", ctypes.c_void_p),
    )  # fmt: skip


class _Options(ctypes.Structure):
    _fields_ = (("timeout_us", WORD), ("redraw", ctypes.c_bool))


class _Fault(ctypes.Structure):
    _fields_ = tuple(
        (name, WORD)
        for name in (
            "step", "code", "index", "state", "address", "expected", "found", "point",
        )
    )  # fmt: skip


class CFilterError(Exception):
    """The C filter returned something else than UKF_OK.

    Parameters
    ----------
    result
        What it returned; a number if it is a code of the core without a name.
    fault
        Details, by name.
    """

    def __init__(self, result: Result | int, fault: dict[str, int]) -> None:
        super().__init__(f"{result!r}: {fault}")
        self.result = result
        self.fault = fault


def compile_library(params: UkfParams, folder: Path, *, flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """Compile the C filter for a core as a library, and load it.

    Parameters
    ----------
    params
        The core.
    folder
        Folder for headers and library; made if absent.
    flags
        Further flags of the compiler.

    Raises
    ------
    CompilerError
        If it does not compile.
    """
    write_headers(params, folder)
    library = compile_c(
        [*DRIVER, BINDING], folder / "libukf.so", [folder], flags=("-shared", "-fPIC", *flags)
    )
    return ctypes.CDLL(str(library))


def describe_core(params: UkfParams, folder: Path) -> ctypes.CDLL:
    """Compile what says what a core is, for `core` of :class:`CFilter`, faster than the filter.

    Arguments and errors as :func:`compile_library`.
    """
    write_headers(params, folder)
    flags = ("-shared", "-fPIC")
    return ctypes.CDLL(str(compile_c([BINDING], folder / "libcore.so", [folder], flags=flags)))


def _real(array: Array) -> Any:
    return array.ctypes.data_as(REALS)


class CFilter:
    """The C filter, with the methods of :class:`ukf_sw.filter.UnscentedKalmanFilter`.

    Exceptions of models become ``BAD_MODEL``; an exception of the bus other than BusError ends the
    access as refused, and is kept in :attr:`exceptions`.

    Parameters
    ----------
    library
        From :func:`compile_library`.
    bus
        Way to a core.
    params
        What the library was compiled for.
    f, h
        Models, one sigma point at a time, as :mod:`ukf_sw.models` has them; several h for several
        sensors. None is NULL, for what the core has.
    placed
        Models on the core: what turns the arguments of the methods into numbers of region U, and
        variants, as in Python; None if there are none.
    interrupt
        Function that waits for the interrupt, as for :class:`ukf_sw.drivers.driver.Driver`.
    timeout_us
        How long to wait for a step, in microseconds.
    clock
        Time in seconds.
    redraw
        Whether every predict ends with a redraw.
    state_angles, observation_angles
        Indices of angles, these of all rows.
    terms
        Noise terms of each sensor; None is as many as it has rows, or all of those of one sensor.
    short
        By how many numbers the work memory is too short, for tests.
    core
        Library for the core that is on the bus; None is `library`. Code compiled beside the header
        of one core drives any other.
    opened
        Whether to call :meth:`open`.

    Raises
    ------
    CFilterError
        If opening fails. So may every method.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        bus: Bus,
        params: UkfParams,
        f: Callable[..., ArrayLike] | None,
        h: Callable[..., ArrayLike] | Sequence[Callable[..., ArrayLike] | None],
        *,
        placed: PlacedModels | None = None,
        interrupt: Callable[[float], bool] | None = None,
        timeout_us: int = 1_000_000,
        clock: Callable[[], float] = time.monotonic,
        redraw: bool = False,
        state_angles: tuple[int, ...] = (),
        observation_angles: tuple[int, ...] = (),
        terms: Sequence[int] | None = None,
        short: int = 0,
        core: ctypes.CDLL | None = None,
        opened: bool = True,
    ) -> None:
        self._library = library
        described = library if core is None else core
        self._params = params
        self._bus = bus
        self._f = f
        self._placed = placed
        self._input: Any = None
        self.exceptions: list[Exception] = []
        size = ctypes.c_size_t.in_dll(library, "binding_size").value
        self._length = WORD.in_dll(described, "binding_work_length").value - short
        self._core = ctypes.c_char.in_dll(described, "binding_core")
        self._ukf = ctypes.create_string_buffer(size)
        # What is used before it has been written shows.
        self._work = np.full(max(self._length, 1), np.nan)
        self._port = _Port(
            None,
            READ(self._read),
            WRITE(self._write),
            WAIT() if interrupt is None else WAIT(lambda _, left: interrupt(left * 1e-6)),
            NOW(lambda _: int(clock() * 1e6)),
        )
        models = (h,) if callable(h) else tuple(h)
        rows = [params.rows_of(sensor) for sensor in range(len(params.sensor_rows))]
        if terms is None:
            terms = (params.r,) if len(rows) == 1 else [len(own) for own in rows]
        self._sensors = (_Sensor * len(rows))(*(
            _Sensor(
                OBSERVE() if model is None else OBSERVE(partial(self._observe, model, own_terms)),
                own_terms,
                sum(1 << i - own.start for i in observation_angles if i in own),
            )
            for model, own_terms, own in zip(models, terms, rows, strict=True)
        ))  # fmt: skip
        self._models = _Models(
            None, PROCESS() if f is None else PROCESS(self._process), self._sensors,
            sum(1 << i for i in state_angles),
        )  # fmt: skip
        self._options = _Options(timeout_us, redraw)
        if opened:
            self.open()

    # What C calls.

    def _refuse(self, error: Exception) -> bool:
        if not isinstance(error, BusError):
            self.exceptions.append(error)
        return False

    def _read(self, _: Any, address: int, word: Any) -> bool:
        try:
            word[0] = self._bus.read(address)
        except Exception as error:
            return self._refuse(error)
        return True

    def _write(self, _: Any, address: int, word: int) -> bool:
        try:
            self._bus.write(address, word)
        except Exception as error:
            return self._refuse(error)
        return True

    def _process(self, _: Any, x: Any, w: Any, __: Any, following: Any) -> bool:
        p, f = self._params, self._f
        assert f is not None
        return self._model(lambda: f(x[: p.n], w[: p.q], self._input), following)

    def _observe(
        self, h: Callable[..., ArrayLike], terms: int, _: Any, x: Any, v: Any, z: Any
    ) -> bool:
        return self._model(lambda: h(x[: self._params.n], v[:terms]), z)

    def _model(self, model: Callable[[], ArrayLike], result: Any) -> bool:
        try:
            values = model()
        except Exception as error:
            self.exceptions.append(error)
            return False
        for i, value in enumerate(np.asarray(values, dtype=np.float64).tolist()):
            result[i] = value
        return True

    # What calls C.

    def _call(self, name: str, *arguments: Any, work: int | None = None) -> None:
        prepared = [
            _real(argument) if isinstance(argument, np.ndarray)
            else ctypes.byref(argument) if isinstance(argument, ctypes.Structure | ctypes.c_char)
            else argument
            for argument in arguments
        ]  # fmt: skip
        if work is not None:
            prepared += [_real(self._work), WORD(work)]
        result = int(getattr(self._library, name)(self._ukf, *prepared))
        if result != Result.OK:
            known = result in set(Result)
            raise CFilterError(Result(result) if known else result, self.fault)

    @staticmethod
    def _numbers(value: ArrayLike | None) -> Array | None:
        return None if value is None else np.ascontiguousarray(value, dtype=np.float64)

    @property
    def params(self) -> UkfParams:
        """What the library was compiled for."""
        return self._params

    @property
    def fault(self) -> dict[str, int]:
        """Details of the last failure."""
        fault = _Fault()
        self._library.binding_fault(self._ukf, ctypes.byref(fault))
        return {field[0]: getattr(fault, field[0]) for field in fault._fields_}

    @property
    def doubtful(self) -> bool:
        """Whether an error has left open what the core holds."""
        return bool(self._library.binding_doubtful(self._ukf))

    @property
    def pes(self) -> int:
        """Number of processing elements that the core says it has."""
        return int(self._library.binding_pes(self._ukf))

    def result_name(self, result: int) -> str:
        """``ukf_result_name``."""
        function = self._library.ukf_result_name
        function.restype = ctypes.c_char_p
        return function(result).decode()

    def round(self, value: float) -> float:
        """``ukf_driver_round``."""
        function = self._library.ukf_driver_round
        function.restype = ctypes.c_double
        return float(function(self._ukf, ctypes.c_double(value)))

    def open(self) -> None:
        """``ukf_open``."""
        self._call(
            "ukf_open", self._core, self._port, self._models, self._options, work=self._length
        )

    def start(
        self, x: ArrayLike, P: ArrayLike, Q: ArrayLike | None = None, R: ArrayLike | None = None
    ) -> None:
        """``ukf_start``."""
        self._call("ukf_start", *(self._numbers(value) for value in (x, P, Q, R)))

    def set_inputs(self, first: int, values: ArrayLike) -> None:
        """``ukf_set_inputs``."""
        numbers = np.array(values, dtype=np.float64)
        self._call("ukf_set_inputs", WORD(first), WORD(len(numbers)), numbers)

    def set_variant(self, sensor: int, variant: int) -> None:
        """Choose one of the models that the core has for a sensor."""
        self._sensors[sensor].variant = variant

    def _give_f(self, u: Any) -> None:
        """Hand u to f, wherever that is."""
        self._input = u
        if self._placed is not None and self._placed.f:
            self._set_places(self._placed.inputs_of_f(u, {}))

    def _give_h(self, sensor: int, arguments: Mapping[str, Any]) -> None:
        """Hand arguments to the h of a sensor on the core."""
        if self._placed is not None and self._placed.h:
            name = [*self._placed.traced.h][sensor]
            variant, inputs = self._placed.inputs_of_h(name, arguments)
            self.set_variant(sensor, variant)
            self._set_places(inputs)

    def _set_places(self, inputs: Mapping[int, float]) -> None:
        for place, value in inputs.items():
            self.set_inputs(place, [value])

    def predict(self, u: Any = None) -> None:
        """``ukf_predict``; u goes to f."""
        self._give_f(u)
        self._call("ukf_predict", None)

    def redraw(self) -> None:
        """``ukf_redraw``."""
        self._call("ukf_redraw")

    def update(
        self,
        z: ArrayLike,
        mask: NDArray[np.bool_] | None = None,
        *,
        sensor: int = 0,
        **arguments: Any,
    ) -> bool:
        """``ukf_update``; whether the estimate was corrected."""
        self._give_h(sensor, arguments)
        bits = self._bits(mask)
        self._call("ukf_update", WORD(sensor), self._numbers(z), WORD(bits))
        return bits != 0 and not self.gated

    def iterate(
        self,
        u: Any,
        z: ArrayLike,
        mask: NDArray[np.bool_] | None = None,
        *,
        sensor: int = 0,
        **arguments: Any,
    ) -> bool:
        """``ukf_iterate``; whether the estimate was corrected."""
        self._give_f(u)
        self._give_h(sensor, arguments)
        bits = self._bits(mask)
        self._call("ukf_iterate", None, WORD(sensor), self._numbers(z), WORD(bits))
        return bits != 0 and not self.gated

    @staticmethod
    def _bits(mask: NDArray[np.bool_] | None) -> int:
        return 0xFFFF_FFFF if mask is None else sum(1 << int(i) for i in np.flatnonzero(mask))

    def _outcome(self) -> tuple[float, bool]:
        nis, gated = ctypes.c_double(), WORD()
        self._library.binding_outcome(self._ukf, ctypes.byref(nis), ctypes.byref(gated))
        return nis.value, bool(gated.value)

    @property
    def nis(self) -> float:
        """NIS of the last update."""
        return self._outcome()[0]

    @property
    def gated(self) -> bool:
        """Whether the last update was rejected."""
        return self._outcome()[1]

    @property
    def x(self) -> Array:
        """``ukf_state``, ``ukf_set_state``."""
        x = np.empty(self._params.n)
        self._call("ukf_state", x)
        return x

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._call("ukf_set_state", self._numbers(value))

    @property
    def P(self) -> Array:
        """``ukf_covariance``, ``ukf_set_covariance``."""
        P = np.empty((self._params.n, self._params.n))
        self._call("ukf_covariance", P)
        return P

    @P.setter
    def P(self, value: ArrayLike) -> None:
        self._call("ukf_set_covariance", self._numbers(value))

    def set_noise(self, Q: ArrayLike | None, R: ArrayLike | None) -> None:
        """``ukf_set_noise``."""
        self._call("ukf_set_noise", self._numbers(Q), self._numbers(R))

    def set_sensor_noise(self, sensor: int, R: ArrayLike | None) -> None:
        """``ukf_set_sensor_noise``."""
        self._call("ukf_set_sensor_noise", WORD(sensor), self._numbers(R))

    def set_gate(self, gate: float) -> None:
        """``ukf_set_gate``."""
        self._call("ukf_set_gate", ctypes.c_double(gate))

    def save(self) -> tuple[Array, Array]:
        """``ukf_save``: x and the factor of P."""
        n = self._params.n
        x, L = np.empty(n), np.empty((n, n))
        self._call("ukf_save", x, L)
        return x, L

    def restore(self, x: ArrayLike, L: ArrayLike) -> None:
        """``ukf_restore``."""
        self._call("ukf_restore", self._numbers(x), self._numbers(L))

    def recover(self) -> None:
        """``ukf_recover``."""
        self._call("ukf_recover")

    def undo_predict(self) -> None:
        """``ukf_undo_predict``."""
        self._call("ukf_undo_predict")
