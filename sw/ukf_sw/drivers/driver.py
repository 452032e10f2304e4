"""Driver of the core: the software that would run beside it, on any bus."""

import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.drivers.bus import Addresses, Bus, WordCodec, Words
from ukf_sw.errors import (
    CoreTimeoutError,
    StepLostError,
    WrongCoreError,
    error_of,
)
from ukf_sw.reference import lower_factor
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.registers import (
    CONFIG,
    CONTROL,
    CYCLES,
    ERROR,
    GATE_HIGH,
    GATE_LOW,
    IDENTITY,
    INTERRUPT_ENABLE,
    INTERRUPT_PENDING,
    MASK,
    NIS_HIGH,
    NIS_LOW,
    STATUS,
    ErrorCode,
    Register,
)
from ukf_sw.spec.sequence import STEPS, Step

__all__ = ["Driver", "Traffic"]

Array = NDArray[np.float64]

ENABLE = CONTROL["ENABLE"].mask
RESET = CONTROL["RESET"].mask
START = {step: ENABLE | CONTROL[step.name].mask for step in STEPS}
DONE = {step: STATUS[step.name].mask for step in START}
STATE = STATUS["STATE"].mask
GATED = STATUS["GATED"].mask
CODE = ERROR["CODE"].mask
EVENTS = INTERRUPT_PENDING["DONE"].mask | INTERRUPT_PENDING["ERROR"].mask


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """Numbers of bus words.

    Parameters
    ----------
    words_read, words_written
        Words of the buffer.
    control_reads, control_writes
        Words of the registers.
    """

    words_read: int = 0
    words_written: int = 0
    control_reads: int = 0
    control_writes: int = 0

    def __sub__(self, other: "Traffic") -> "Traffic":
        return Traffic(
            **{item.name: getattr(self, item.name) - getattr(other, item.name)
               for item in fields(self)}
        )  # fmt: skip

    @property
    def words(self) -> int:
        """Words of the buffer, both ways."""
        return self.words_read + self.words_written


class Driver:
    """Driver of a core; a backend of :class:`ukf_sw.filter.UnscentedKalmanFilter`.

    The constructor reads ID, SIZES and CONFIG and compares them with the parameters; then it resets
    and enables the core. Steps are polled for, or waited for by interrupt.

    The driver moves as few words as it can: of the state's sigma points it reads the first n + 2
    columns, the others being equal to x; it writes x, factors and the mask when they change.

    Parameters
    ----------
    bus
        Bus; its ``read_many`` and ``write_many`` are used if it has them.
    params
        What the core should be. The number of processing elements may differ: nothing that the
        driver does depends on it, and :attr:`pes` tells.
    interrupt
        Function that waits for the interrupt line, at most so many seconds, and tells whether it
        is high. None is polling.
    timeout
        How long to wait for a step, in seconds of the clock.
    clock
        Function that gives the time in seconds. A co-simulation passes simulated time.
    count_cycles
        Whether to read CYCLES after every step, into :attr:`last_cycles`.

    Attributes
    ----------
    words_read, words_written
        Words of the buffer since the constructor.
    control_reads, control_writes
        Words of the registers since the constructor.
    last_cycles : dict
        Clocks of the last step of each name, if they are counted.

    Raises
    ------
    TypeError
        If the parameters are of the wrong kind.
    ValueError
        If the time-out is not positive.
    WrongCoreError
        If the core is not the one that the parameters describe.
    BusError
        If the core refuses an access. So may every method.
    """

    def __init__(
        self,
        bus: Bus,
        params: UkfParams,
        *,
        interrupt: Callable[[float], bool] | None = None,
        timeout: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
        count_cycles: bool = False,
    ) -> None:
        if not isinstance(cast("object", params), UkfParams):
            raise TypeError(f"params must be a UkfParams, not {params!r}")
        if not timeout > 0.0:
            raise ValueError(f"timeout must be more than 0 s, not {timeout!r}")
        self._bus = bus
        self._params = params
        self._interrupt = interrupt
        self._timeout = timeout
        self._clock = clock
        self._read_many: Callable[[Addresses], Words] = getattr(bus, "read_many", self._read_each)
        self._write_many: Callable[[Addresses, Words], None] = getattr(
            bus, "write_many", self._write_each
        )
        self._codec = WordCodec(params.format)
        self._map = MemoryMap(params)
        self.count_cycles = count_cycles
        self.last_cycles: dict[str, int] = {}
        self.words_read = self.words_written = 0
        self.control_reads = self.control_writes = 0

        n, m, N = params.n, params.m, params.N
        self._x_addresses = self._addresses("x", 1, n)
        self._X_read = self._addresses("X", n, n + 2)
        self._X_write = self._addresses("X", n, N)
        self._Z_write = np.concatenate((self._addresses("Z", m, N), self._addresses("z", m, 1)))

        self._pes = self._check_core()
        self.reset()

    # What the core is.

    def _check_core(self) -> int:
        """Compare the core with the parameters; gives its number of processing elements."""
        pes = CONFIG["PES"]
        number = 0
        for register in IDENTITY:
            word = self._read_register(register)
            for field in register:
                found, value = field.get(word), field.value_after_reset(self._params)
                if field is pes:
                    number = found
                elif found != value:
                    raise WrongCoreError(f"{register.name}.{field.name}", value, found)
        return number

    @property
    def params(self) -> UkfParams:
        """Parameters given to the constructor."""
        return self._params

    @property
    def pes(self) -> int:
        """Number of processing elements that the core says it has."""
        return self._pes

    # Bus accesses, counted.

    def _read_register(self, register: Register) -> int:
        word = self._bus.read(register.offset)
        self.control_reads += 1
        return word

    def _write_register(self, register: Register, word: int) -> None:
        self._bus.write(register.offset, word)
        self.control_writes += 1

    def _read_each(self, addresses: Addresses) -> Words:
        return np.array([self._bus.read(a) for a in addresses.tolist()], dtype=np.uint32)

    def _write_each(self, addresses: Addresses, words: Words) -> None:
        for address, word in zip(addresses.tolist(), words.tolist(), strict=True):
            self._bus.write(address, word)

    def _addresses(self, symbol: str, rows: int, columns: int) -> Addresses:
        """Word addresses of the upper left part of a region, row by row."""
        size = self._params.format.bus_words
        return np.array(
            [
                self._map.address(symbol, row, column) + 4 * word
                for row in range(rows)
                for column in range(columns)
                for word in range(size)
            ],
            dtype=np.int64,
        )

    def _read(self, addresses: Addresses) -> Array:
        words = self._read_many(addresses)
        self.words_read += len(addresses)
        return self._codec.from_words(words)

    def _write(self, addresses: Addresses, values: Array) -> Words:
        words = self._codec.to_words(values.reshape(-1))
        self._write_many(addresses, words)
        self.words_written += len(addresses)
        return words

    def _write_matrix(self, symbol: str, values: Array) -> None:
        if values.size:
            self._write(self._addresses(symbol, *values.shape), values)

    @property
    def traffic(self) -> Traffic:
        """Bus words since the constructor; the difference of two is the traffic in between."""
        return Traffic(
            words_read=self.words_read,
            words_written=self.words_written,
            control_reads=self.control_reads,
            control_writes=self.control_writes,
        )

    # Steps.

    def reset(self) -> None:
        """Reset and enable the core: a running step is dropped, x and its factor stay."""
        self._initialised = False
        self._overwritten = False
        self._mask: int | None = None
        self._write_register(CONTROL, ENABLE | RESET)
        self._write_register(INTERRUPT_PENDING, EVENTS)
        self._write_register(INTERRUPT_ENABLE, EVENTS if self._interrupt is not None else 0)

    def _run(self, step: Step) -> int:
        """Run a step; gives STATUS after it, raises what ERROR says."""
        self._write_register(CONTROL, START[step])
        status = self._wait(step)
        error = self._read_register(ERROR)
        code = error & CODE
        if code == ErrorCode.NONE and not status & DONE[step]:
            self._initialised = False
            raise StepLostError(step)
        if self.count_cycles and code != ErrorCode.ILLEGAL_STEP:
            self.last_cycles[step.name] = self._read_register(CYCLES)
        if code == ErrorCode.NONE:
            return status
        raise error_of(step, code, ERROR["INDEX"].get(error))

    def _wait(self, step: Step) -> int:
        """Wait until no step runs; gives STATUS."""
        deadline = self._clock() + self._timeout
        while True:
            if self._interrupt is not None:
                left = max(deadline - self._clock(), 0.0)
                if not self._interrupt(left):
                    self._give_up(step, "no interrupt")
                self._write_register(INTERRUPT_PENDING, EVENTS)
            # The clock is read first: a step that ends while we look is not late.
            late = self._clock() > deadline
            status = self._read_register(STATUS)
            if not status & STATE:
                return status
            if late:
                self._give_up(step, "it still runs")

    def _give_up(self, step: Step, detail: str) -> None:
        """Reset the core and raise."""
        state = STATUS["STATE"].get(self._read_register(STATUS))
        self.reset()
        name = Step(state).name if state in set(Step) else str(state)
        raise CoreTimeoutError(step, self._timeout, f"{detail}, STATUS.STATE was {name}")

    def _ensure_initialised(self) -> None:
        """After a reset, INIT must come before any other step; x and its factor are in place."""
        if not self._initialised:
            self._run(Step.INIT)
            self._initialised = True

    # Backend.

    def initialise(self, x: Array, P: Array, Q: Array, R: Array) -> None:
        """Reset the core and start from an estimate: x (n,), P (n, n), Q (q, q), R (r, r).

        Raises
        ------
        NotFiniteError
            If a number overflows the format.
        CoreTimeoutError
            If INIT does not end.
        """
        self.reset()
        self._write(self._x_addresses, x)
        self._write_matrix("L", lower_factor(P))
        self._write_matrix("LQ", lower_factor(Q))
        self._write_matrix("LR", lower_factor(R))
        self._ensure_initialised()

    def set_state(self, x: Array) -> None:
        """Write x, shape (n,); P stays."""
        self._write(self._x_addresses, x)
        self._overwritten = False  # the core now knows that its sigma points are outdated

    def set_covariance(self, P: Array) -> None:
        """Write the factor of P, shape (n, n); x stays."""
        self._write_matrix("L", lower_factor(P))
        self._overwritten = False

    def set_noise(self, Q: Array, R: Array) -> None:
        """Write the factors of Q (q, q) and R (r, r); the estimate stays.

        Raises
        ------
        StepError
            If a step fails.
        """
        self.redraw()  # INIT would forget a prediction that has not been factorised
        self._write_matrix("LQ", lower_factor(Q))
        self._write_matrix("LR", lower_factor(R))
        self._initialised = False
        self._ensure_initialised()

    def set_gate(self, gate: float) -> None:
        """Write the gate; infinity is off."""
        words = self._codec.to_words(np.array([gate]))
        self._write_register(GATE_LOW, int(words[0]))
        if len(words) == 2:
            self._write_register(GATE_HIGH, int(words[1]))

    def noise_points(self) -> tuple[Array, Array]:
        """Read the sigma points of w (q, N) and of v (r, N); zeros for additive noise."""
        p = self._params
        rows: list[Array] = []
        for symbol, terms in (("W", p.q), ("V", p.r)):
            if symbol in self._map:
                values = self._read(self._addresses(symbol, terms, p.N)).reshape(terms, p.N)
            else:
                values = np.zeros((terms, p.N))
            rows.append(values)
        return rows[0], rows[1]

    def redraw(self) -> None:
        """Run SIG_GEN, which costs nothing if sigma points of the estimate are there.

        Raises
        ------
        StepError
            If the step fails.
        """
        self._ensure_initialised()
        if self._overwritten:
            # A predict broke off after writing points, which the core takes for its own. A write
            # to x, of what it holds, tells it.
            word = self._bus.read(int(self._x_addresses[0]))
            self._bus.write(int(self._x_addresses[0]), word)
            self.words_read += 1
            self.words_written += 1
            self._overwritten = False
        self._run(Step.SIG_GEN)

    def sigma_points(self) -> Array:
        """Run SIG_GEN, which costs nothing if the points are there, and read them.

        Returns
        -------
        array of shape (n, N)
            Columns n + 2 and up are copies of x, which is column 0.

        Raises
        ------
        StepError
            If the step fails.
        """
        self.redraw()
        n = self._params.n
        read = self._read(self._X_read).reshape(n, n + 2)
        points = np.empty((n, self._params.N))
        points[:, : n + 2] = read
        points[:, n + 2 :] = read[:, :1]
        return points

    def predict(self, points: Array) -> Array:
        """Write transformed sigma points, shape (n, N), and run PREDICT.

        Returns
        -------
        array
            The points as the core holds them, rounded to its format.

        Raises
        ------
        StepError
            If the step fails.
        """
        self._overwritten = True
        words = self._write(self._X_write, points)
        self._run(Step.PREDICT)
        self._overwritten = False
        return self._codec.from_words(words).reshape(points.shape)

    def update(self, points: Array, z: Array, mask: NDArray[np.bool_]) -> tuple[float, bool]:
        """Write observations of the sigma points and z, and run UPDATE.

        Parameters
        ----------
        points
            Shape (m, N).
        z
            Shape (m,).
        mask
            Which rows were sampled, shape (m,).

        Returns
        -------
        nis : float
            Normalised innovation squared.
        gated : bool
            Whether it exceeded the gate, so that the estimate stays.

        Raises
        ------
        StepError
            If the step fails.
        """
        self._ensure_initialised()
        self._write(self._Z_write, np.concatenate((points.reshape(-1), z)))
        bits = int.from_bytes(np.packbits(mask, bitorder="little").tobytes(), "little")
        if bits != self._mask:
            self._write_register(MASK, bits)
            self._mask = bits
        status = self._run(Step.UPDATE)
        words = [self._read_register(NIS_LOW)]
        if self._params.format.bus_words == 2:
            words.append(self._read_register(NIS_HIGH))
        nis = float(self._codec.from_words(np.array(words, dtype=np.uint32))[0])
        return nis, bool(status & GATED)

    def state(self) -> Array:
        """Read x, shape (n,)."""
        return self._read(self._x_addresses)

    def covariance(self) -> Array:
        """Run COVARIANCE and read P, shape (n, n): its lower triangle, mirrored.

        Raises
        ------
        StepError
            If the step fails.
        """
        self._ensure_initialised()
        self._run(Step.COVARIANCE)
        n = self._params.n
        size = self._params.format.bus_words
        rows, columns = np.tril_indices(n)
        addresses = self._addresses("P", n, n).reshape(n, n, size)[rows, columns].reshape(-1)
        P = np.empty((n, n))
        P[rows, columns] = P[columns, rows] = self._read(addresses)
        return P

    def status(self) -> dict[str, Any]:
        """Fields of STATUS and of ERROR by name, read now."""
        words = ((STATUS, self._read_register(STATUS)), (ERROR, self._read_register(ERROR)))
        return {
            f"{register.name}.{item.name}": item.get(word)
            for register, word in words
            for item in register
        }
