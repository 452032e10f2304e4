"""Driver of the core: the software that would run beside it, on any bus."""

import copy
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ukf_sw.ahead import CoreSample
from ukf_sw.certainty import Certainty
from ukf_sw.drivers.bus import Addresses, Bus, Replies, WordCodec, Words
from ukf_sw.drivers.scripts import Known, ScriptBuilder, mask_with
from ukf_sw.errors import (
    REFUSALS,
    CoreTimeoutError,
    EstimateLostError,
    FormatOverflowError,
    ModelNotFiniteError,
    NotFiniteError,
    SingularObservationError,
    StepLostError,
    WrongCoreError,
    error_of,
)
from ukf_sw.factors import lower_factor
from ukf_sw.spec.fields import as_number
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
from ukf_sw.spec.sequence import STEPS, Step, of_sensor

__all__ = ["Driver", "Traffic"]

Array = NDArray[np.float64]

ENABLE = CONTROL["ENABLE"].mask
RESET = CONTROL["RESET"].mask
START = {step: ENABLE | CONTROL[step.name].mask for step in STEPS}
SENSOR = CONTROL["SENSOR"]
VARIANT = CONTROL["VARIANT"]
DONE = {step: STATUS[step.name].mask for step in START}
STATE = STATUS["STATE"].mask
INITIALISED = STATUS["INITIALISED"].mask
POINTS = STATUS["POINTS"].mask
RESIDUALS = STATUS["RESIDUALS"].mask
GATED = STATUS["GATED"].mask
CODE = ERROR["CODE"].mask
EVENTS = INTERRUPT_PENDING["DONE"].mask | INTERRUPT_PENDING["ERROR"].mask

#: No bus takes polls faster than this, not even a simulated one with 100 MHz, whose reads take some
#: clocks each; so more of them mean that the clock stands still.
POLLS_PER_SECOND = 1e8
FEWEST_POLLS = 1000


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """Numbers of bus words.

    Parameters
    ----------
    words_read, words_written
        Words of the buffer: sigma points, what the models make of them, observations, estimates,
        factors.
    starts
        Words that start a step.
    control_reads, control_writes
        All other words of the registers: looking for the end of a step, errors, NIS, cycles; masks,
        gates, acknowledged interrupts.
    """

    words_read: int = 0
    words_written: int = 0
    starts: int = 0
    control_reads: int = 0
    control_writes: int = 0

    def __sub__(self, other: "Traffic") -> "Traffic":
        return Traffic(
            **{item.name: getattr(self, item.name) - getattr(other, item.name)
               for item in fields(self)}
        )  # fmt: skip

    @property
    def words(self) -> int:
        """Words that an iteration cannot do without: numbers, and starts of steps."""
        return self.words_read + self.words_written + self.starts

    @property
    def register_words(self) -> int:
        """All others: how many there are depends on how a step is waited for."""
        return self.control_reads + self.control_writes


class Driver:
    """Driver of a core; a backend of :class:`ukf_sw.filter.UnscentedKalmanFilter`.

    The constructor reads ID, SIZES and CONFIG and compares them with the parameters; then it resets
    and enables the core. Steps are polled for, or waited for by interrupt.

    The driver moves as few words as it can: of the state's sigma points it reads those up to n + 1,
    the others being equal to x; it reads x once; it writes x, factors and the mask when they
    change. Sigma points are those that have a weight, :attr:`UkfParams.points`, K in all.

    What a method that raises has done is said in :mod:`ukf_sw.errors`. After an error that leaves
    it open, whatever needs the core raises :class:`ukf_sw.errors.NotRecoveredError` until
    :meth:`recover` or :meth:`initialise` has succeeded.

    Every copy is a deep one, with a core of its own; if there is but one core, as on a device, it
    is refused.

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
        How long to wait for a step, in seconds of the clock. A step that has ended when the driver
        looks is in time, however late that is, and whether or not there was an interrupt.
    clock
        Function that gives the time in seconds. A co-simulation passes simulated time.
    count_cycles
        Whether to read CYCLES after every step, into :attr:`last_cycles`.

    Attributes
    ----------
    words_read, words_written
        Words of the buffer since the constructor.
    starts, control_reads, control_writes
        Words of the registers since the constructor, as :class:`Traffic` has them.
    last_cycles : dict
        Clocks of the last step of each name that had something to do, if they are counted; with
        several sensors, "UPDATE of sensor 1".

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
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
        timeout = as_number("timeout", timeout)
        if not timeout > 0.0:
            raise ValueError(f"timeout must be more than 0 s, not {timeout!r}")
        for name, function in (("interrupt", interrupt), ("clock", clock)):
            if not callable(function) and (name, function) != ("interrupt", None):
                raise TypeError(f"{name} must be callable, not {function!r}")
        self._bus = bus
        self._params = params
        self._interrupt = interrupt
        self._timeout = timeout
        self._polls = max(timeout * POLLS_PER_SECOND, FEWEST_POLLS)
        self._clock = clock
        self._certainty = Certainty()
        self._read_many: Callable[[Addresses], Words] = getattr(bus, "read_many", self._read_each)
        self._write_many: Callable[[Addresses, Words], None] = getattr(
            bus, "write_many", self._write_each
        )
        self._codec = WordCodec(params.format)
        self._map = MemoryMap(params)
        self.count_cycles = count_cycles
        self.last_cycles: dict[str, int] = {}
        self.words_read = self.words_written = 0
        self.control_reads = self.control_writes = self.starts = 0

        n, points = range(params.n), params.points
        self._x_addresses = self._addresses("x", range(1), n)
        self._X_read = self._addresses("X", n, range(points.start, params.n + 2))
        self._X_write = self._addresses("X", n, points)
        inputs = params.models.inputs
        self._U_write = self._addresses("U", range(int(bool(inputs))), range(len(inputs)))
        #: Of each sensor, its rows of Z and of z.
        self._Z_write = [
            np.concatenate(
                (
                    self._addresses("Z", rows, points),
                    self._addresses("z", rows, range(1)),
                )
            )
            for rows in map(params.rows_of, range(len(params.sensor_rows)))
        ]

        #: Of each sensor, its rows of z.
        self._z_write = [
            self._addresses("z", params.rows_of(sensor), range(1))
            for sensor in range(len(params.sensor_rows))
        ]

        #: The step that may have been started and may have ended.
        self._step: Step | None = None
        #: Whether a running step may have been dropped, no event having been pending before.
        self._dropping = False
        #: x, if it has been read and not changed since.
        self._x: Array | None = None
        #: What a prediction was made from, until its covariance has been factorised: x from before
        #: it, whose factor the core still has, and the points if an update may use them.
        self._before: Array | None = None
        self._predicted: Array | None = None
        #: Words that the core has been told, and must be told again when it has been reset.
        self._noise: tuple[Words, Words] | None = None
        #: Whether it has that noise: not if a change of it has broken off.
        self._noise_written = False
        self._gate: Words | None = None
        #: Inputs of models on the core that it has been told, by their place.
        self._inputs: dict[int, bytes] = {}
        #: Whether X surely holds sigma points of the estimate, or those of a prediction that an
        #: update may use: then a model on the core can be evaluated there.
        self._drawn = self._propagated = False

        self._pes = self._check_core()
        self._reset_core()

    def __copy__(self) -> "Driver":
        """Copy as copy.deepcopy does: two drivers of one core would not know of each other."""
        return copy.deepcopy(self)

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

    def _addresses(self, symbol: str, rows: range, columns: range) -> Addresses:
        """Word addresses of rows and columns of a region, row by row."""
        size = self._params.format.bus_words
        return np.array(
            [
                self._map.address(symbol, row, column) + 4 * word
                for row in rows
                for column in columns
                for word in range(size)
            ],
            dtype=np.int64,
        )

    def _read(self, addresses: Addresses) -> Array:
        words = self._read_many(addresses)
        self.words_read += len(addresses)
        return self._codec.from_words(words)

    def _write(self, addresses: Addresses, words: Words) -> None:
        self._write_many(addresses, words)
        self.words_written += len(addresses)

    def _write_matrix(self, symbol: str, words: Words, before: Words | None = None) -> None:
        """Write a region; if it is known what is there, only the rows that differ."""
        if words.size:
            region = self._map[symbol]
            new = words.reshape(region.rows, -1)
            changed = np.ones(region.rows, dtype=np.bool_)
            if before is not None:
                changed = (new != before.reshape(region.rows, -1)).any(axis=1)
            addresses = self._addresses(symbol, range(region.rows), range(region.columns))
            if changed.any():
                chosen = addresses.reshape(new.shape)[changed]
                self._write(chosen.reshape(-1), new[changed].reshape(-1))

    def _words(self, name: str, values: Array) -> Words:
        """Round numbers to words.

        Raises
        ------
        FormatOverflowError
            If one is too large for that.
        """
        flat = values.reshape(-1)
        words = self._codec.to_words(flat)
        finite = np.isfinite(self._codec.from_words(words))
        if not finite.all():
            raise FormatOverflowError(
                name, float(flat[finite.argmin()]), self._params.format.max_finite
            )
        return words

    def _factor_words(self, name: str, covariance: Array) -> Words:
        return self._words(f"factor of {name}", lower_factor(covariance))

    def _noise_words(self, Q: Array, R: Array) -> tuple[Words, Words]:
        """Words of the factors of Q and of R, as their regions hold them."""
        p, factor = self._params, lower_factor(R)
        if p.additive_r:
            # One sensor's below the other's, each from column 0 on.
            blocks, factor = factor, np.zeros((p.r, p.columns_of_r))
            for sensor in range(len(p.sensor_rows)):
                rows = p.rows_of(sensor)
                own = slice(rows.start, rows.stop)
                factor[own, : len(rows)] = blocks[own, own]
        return self._factor_words("Q", Q), self._words("factor of R", factor)

    @property
    def traffic(self) -> Traffic:
        """Bus words since the constructor; the difference of two is the traffic in between."""
        return Traffic(
            words_read=self.words_read,
            words_written=self.words_written,
            starts=self.starts,
            control_reads=self.control_reads,
            control_writes=self.control_writes,
        )

    # Steps.

    def reset(self) -> None:
        """Reset and enable the core: a running step is dropped.

        The estimate stays; if it is a prediction whose covariance has not been factorised, it is
        that from before the prediction again.
        """
        with self._certainty:
            self._restart()

    def _restart(self) -> None:
        """Reset the core. What is left then is an estimate whose factor it has."""
        self._reset_core()
        if self._before is not None:
            self._x = None
            self._write(self._x_addresses, self._codec.to_words(self._before))
        self._before = self._predicted = None

    def _reset_core(self) -> None:
        self._initialised = self._drawn = self._propagated = False
        #: Whether a script may have run of which nothing has been noted.
        self._scripted = False
        self._mask: int | None = None
        self._write_register(CONTROL, ENABLE | RESET)
        self._write_register(INTERRUPT_PENDING, EVENTS)
        self._write_register(INTERRUPT_ENABLE, EVENTS if self._interrupt is not None else 0)

    def _run(self, step: Step, sensor: int = 0, variant: int = 0) -> int:
        """Run a step; gives STATUS after it, raises what ERROR says."""
        self._step = step
        propagated, self._drawn, self._propagated = self._propagated, False, False
        self._bus.write(CONTROL.offset, START[step] | SENSOR.put(sensor) | VARIANT.put(variant))
        self.starts += 1
        status = self._wait(self._interrupt)
        if status & STATE:
            running = STATUS["STATE"].get(status)
            name = Step(running).name if running in set(Step) else str(running)
            raise CoreTimeoutError(step, self._timeout, f"it still runs, STATUS.STATE was {name}")
        word = self._read_register(ERROR)
        code = word & CODE
        if code == ErrorCode.NONE and not status & DONE[step]:
            raise StepLostError(step)
        if self.count_cycles and code != ErrorCode.ILLEGAL_STEP:
            of_one = step in (Step.UPDATE, Step.H, Step.ITERATE)
            sensors = len(self._params.sensor_rows) if of_one else 1
            name, cycles = of_sensor(step.name, sensor, sensors), self._read_register(CYCLES)
            self.last_cycles[name] = cycles or self.last_cycles.get(name, 0)
        if code != ErrorCode.NONE:
            # A step that is illegal has not begun; but PREDICT has its points overwritten before.
            error = error_of(step, code, ERROR["INDEX"].get(word))
            illegal = code == ErrorCode.ILLEGAL_STEP and step not in (Step.PREDICT, Step.ITERATE)
            if illegal or isinstance(error, REFUSALS):
                self._step = None
            raise error
        self._step = None
        self._drawn = bool(status & POINTS)
        self._propagated = step in (Step.PREDICT, Step.F) or (
            propagated and step is Step.COVARIANCE
        )
        return status

    def _wait(self, interrupt: Callable[[float], bool] | None) -> int:
        """Wait until no step runs, or for the time-out; gives the last STATUS."""
        deadline = self._clock() + self._timeout
        polls = self._polls
        while True:
            late = False
            if interrupt is not None:
                late = not interrupt(max(deadline - self._clock(), 0.0))
                self._write_register(INTERRUPT_PENDING, EVENTS)
            # The clock is read first: a step that ends while we look is not late.
            polls -= 1
            late = late or self._clock() > deadline or polls <= 0.0
            status = self._read_register(STATUS)
            if late or not status & STATE:
                return status

    def _ensure_initialised(self) -> None:
        """After a reset, INIT must come before any other step; x and its factor are in place."""
        if not self._initialised:
            self._run(Step.INIT)
            self._initialised = True

    # After an error.

    def recover(self) -> Array | None:
        """Find out what the core has done, after an error that has left it open.

        A step that may still run is waited for, and dropped if it does not end. Then an assignment
        that had broken off is made. A PREDICT that had broken off is undone; any other step has
        happened or not, as :meth:`state` and :meth:`covariance` tell. If this raises, it can be
        called again.

        Returns
        -------
        array or None
            What the last :meth:`predict` gave, shape (n, K), if an update may use it.

        Raises
        ------
        EstimateLostError
            If that cannot be found out: begin anew with :meth:`initialise`.
        UkfError
            If the core cannot be reached. What is in :data:`ukf_sw.errors.REFUSALS` is about the
            assignment that had broken off, which is not made then; there is no doubt any more.
        """
        self._certainty.settle(self._find_out)
        return self._predicted

    def _find_out(self) -> None:
        """Get the core into a state that is known."""
        step, status = self._step, self._come_to_rest()
        if self._scripted:
            # It ran to some round's end. Of a prediction it is not known what was before it.
            if not status & POINTS:
                raise EstimateLostError
            self._before = self._predicted = None
        self._drawn = self._propagated = False
        predicted = self._before is not None and step not in (Step.PREDICT, Step.F)
        if predicted and status & INITIALISED:
            # The core has not been reset, so its flags are true.
            self._initialised = True
            if status & POINTS:
                self._before = self._predicted = None
                predicted = False
            elif step is Step.ITERATE:
                predicted = bool(status & RESIDUALS)  # else f has failed
        elif predicted:
            # Only these change the factor, and it is that from before if they have been dropped.
            changes = (Step.SIG_GEN, Step.UPDATE, Step.H, Step.ITERATE)
            if step in changes and not self._dropped():
                raise EstimateLostError
            predicted = False
        if not predicted:
            self._x = None
            self._restart()
            if self._gate is not None:
                self._write_gate(self._gate)
            self._write_old_noise()
        self._step, self._dropping = None, False

    def _come_to_rest(self) -> int:
        """Let a running step end, or drop it; gives STATUS."""
        status = self._wait(None)
        if status & STATE:
            self._write_register(INTERRUPT_PENDING, EVENTS)
            if self._read_register(STATUS) & STATE:
                self._dropping = True
                self._write_register(CONTROL, ENABLE | RESET)
            status = self._read_register(STATUS)
        return status

    def _dropped(self) -> bool:
        """Whether the reset of this driver has dropped the step: else its end is pending."""
        return self._dropping and not self._read_register(INTERRUPT_PENDING) & EVENTS

    def undo_predict(self) -> bool:
        """Go back to the estimate from before the last predict.

        That is possible until its covariance has been factorised: by SIG_GEN, by an update that
        was not gated, by :meth:`set_noise`, or replaced by :meth:`set_covariance`.

        Returns
        -------
        bool
            Whether it was possible; if not, nothing has been done.
        """
        with self._certainty:
            if self._before is None:
                return False
            self._restart()
            return True

    # Backend.

    def initialise(self, x: Array, P: Array, Q: Array, R: Array) -> None:
        """Reset the core and start from an estimate: x (n,), P (n, n), Q (q, q), R (r, r).

        Raises
        ------
        FormatOverflowError
            If a number overflows the format. Nothing has been done then.
        IndefiniteError
            If a matrix is not positive semidefinite. Nothing has been done then.
        StepError
            If INIT does not succeed. x and P have been written then, so that leaves a doubt; a
            refusal in :meth:`recover` leaves them with Q and R from before.
        """
        self._certainty.assign_anew(
            self._initialise,
            self._words("x", x),
            self._factor_words("P", P),
            *self._noise_words(Q, R),
        )

    def _initialise(self, x: Words, L: Words, LQ: Words, LR: Words) -> None:
        self._x = self._before = self._predicted = self._step = None
        self._noise_written = False  # to begin anew is to rely on nothing
        self._inputs.clear()
        self._reset_core()
        self._write(self._x_addresses, x)
        self._write_matrix("L", L)
        self._use_noise(LQ, LR)

    def set_state(self, x: Array) -> None:
        """Write x, shape (n,); P stays.

        Raises
        ------
        FormatOverflowError
            If a number overflows the format.
        """
        self._certainty.assign(self._set_state, self._words("x", x))

    def _set_state(self, x: Words) -> None:
        self._x = self._predicted = None
        self._drawn = self._propagated = False
        self._write(self._x_addresses, x)

    def set_covariance(self, P: Array) -> None:
        """Write the factor of P, shape (n, n); x stays.

        Raises
        ------
        FormatOverflowError
            If a number overflows the format.
        IndefiniteError
            If P is not positive semidefinite.
        """
        self._certainty.assign(self._set_covariance, self._factor_words("P", P))

    def _set_covariance(self, L: Words) -> None:
        self._before = self._predicted = None
        self._drawn = self._propagated = False
        self._write_matrix("L", L)

    def set_noise(self, Q: Array, R: Array) -> None:
        """Write the factors of Q (q, q) and R (r, r); the estimate stays.

        Raises
        ------
        FormatOverflowError
            If a number overflows the format.
        IndefiniteError
            If a matrix is not positive semidefinite.
        StepError
            If a step fails. The noise is as before then.
        """
        factors = self._noise_words(Q, R)
        self.redraw()  # INIT would forget a prediction that has not been factorised
        self._certainty.assign(self._use_noise, *factors)

    def _use_noise(self, LQ: Words, LR: Words) -> None:
        """Write factors of Q and R, and run INIT; if it is refused, with those from before."""
        before = self._noise if self._noise_written else None
        try:
            self._write_noise(LQ, LR, before)
            self._ensure_initialised()
        except REFUSALS:
            if self._noise is not None:
                self._write_old_noise()
                self._ensure_initialised()
            raise
        self._noise, self._noise_written = (LQ, LR), True

    def _write_noise(self, LQ: Words, LR: Words, before: tuple[Words, Words] | None = None) -> None:
        """Write the factors; of those that are there, `before`, only the rows that differ."""
        self._initialised = self._noise_written = False
        self._drawn = self._propagated = False
        there = (None, None) if before is None else before
        self._write_matrix("LQ", LQ, there[0])
        self._write_matrix("LR", LR, there[1])

    def _write_old_noise(self) -> None:
        if self._noise is not None:
            self._write_noise(*self._noise)
            self._noise_written = True

    def set_gate(self, gate: float) -> None:
        """Write the gate; infinity is off. What is finite stays so, at the format's largest."""
        if np.isfinite(gate):
            gate = min(gate, self._params.format.max_finite)
        self._certainty.assign(self._set_gate, self._codec.to_words(np.array([gate])))

    def _set_gate(self, words: Words) -> None:
        self._gate = words
        self._write_gate(words)

    def _write_gate(self, words: Words) -> None:
        self._write_register(GATE_LOW, int(words[0]))
        if len(words) == 2:
            self._write_register(GATE_HIGH, int(words[1]))

    def noise_points(self) -> tuple[Array, Array]:
        """Read the sigma points of w (q, K) and of v (r, K); zeros for additive noise."""
        self._certainty.check()
        p = self._params
        count = len(p.points)
        rows: list[Array] = []
        for symbol, terms in (("W", p.q), ("V", p.r)):
            if symbol in self._map:
                values = self._read(self._addresses(symbol, range(terms), p.points))
            else:
                values = np.zeros(terms * count)
            rows.append(values.reshape(terms, count))
        return rows[0], rows[1]

    def redraw(self) -> None:
        """Run SIG_GEN, which costs nothing if sigma points of the estimate are there.

        Raises
        ------
        StepError
            If the step fails.
        """
        with self._certainty:
            self._redraw()

    def _redraw(self) -> None:
        self._ensure_initialised()
        self._run(Step.SIG_GEN)
        self._before = self._predicted = None

    def sigma_points(self) -> Array:
        """Run SIG_GEN, which costs nothing if the points are there, and read them.

        Returns
        -------
        array of shape (n, K)
            Those from number n + 2 on are copies of x.

        Raises
        ------
        StepError
            If the step fails.
        """
        p = self._params
        drawn = p.n + 2 - p.points.start
        with self._certainty:
            self._redraw()
            read = self._read(self._X_read).reshape(p.n, drawn)
            # Sigma point 0 is x, if it is there.
            x = read[:, 0] if p.points.start == 0 else self._known_x()
            self._x = x
        points = np.empty((p.n, len(p.points)))
        points[:, :drawn] = read
        points[:, drawn:] = x[:, None]
        return points

    def _known_x(self) -> Array:
        """Give x, read if it is not known."""
        if self._x is None:
            self._x = self._read(self._x_addresses)
        return self._x

    def predict(self, points: Array) -> Array:
        """Write transformed sigma points, shape (n, K), and run PREDICT.

        Returns
        -------
        array
            The points as the core holds them, rounded to its format.

        Raises
        ------
        ValueError
            If the points have another shape.
        StepError
            If the step fails.
        """
        self._check_shape(points, self._params.n)
        words = self._codec.to_words(points.reshape(-1))
        given = self._codec.from_words(words).reshape(points.shape)
        with self._certainty:
            x = self._known_x()
            self._step = Step.PREDICT  # its points are about to be overwritten
            self._predicted = given
            if self._before is None:
                self._before = x
            self._x = None
            try:
                self._write(self._X_write, words)
                self._run(Step.PREDICT)
            except REFUSALS:
                self._before = self._predicted = None
                raise
        return given

    def update(
        self, points: Array, z: Array, mask: NDArray[np.bool_], sensor: int = 0
    ) -> tuple[float, bool]:
        """Write what a sensor sees of the sigma points, and z, and run its UPDATE.

        Parameters
        ----------
        points
            Shape (rows, K).
        z
            Shape (rows,). With a finite gate, what is finite is clamped to the format's range, for
            the gate to reject.
        mask
            Which rows were sampled, shape (rows,).
        sensor
            Which sensor.

        Returns
        -------
        nis : float
            Normalised innovation squared.
        gated : bool
            Whether it exceeded the gate, so that the estimate stays.

        Raises
        ------
        ValueError
            If the points have another shape.
        SingularObservationError
            If a row is one number for all sigma points and has no noise.
        StepError
            If the step fails.
        """
        self._check_shape(points, len(self._params.rows_of(sensor)))
        z = self._within_gate(z, mask)
        words = self._codec.to_words(np.concatenate((points.reshape(-1), z)))
        self._check_varies(words[: -len(z) * self._params.format.bus_words], mask, sensor)
        with self._certainty:
            self._ensure_initialised()
            self._write(self._Z_write[sensor], words)
            self._write_mask(mask, sensor)
            x, self._x = self._x, None
            gated = self._correct(Step.UPDATE, z, mask, sensor)
            if gated:
                self._x = x
            nis = self._read_nis()
        return nis, gated

    def _within_gate(self, z: Array, mask: NDArray[np.bool_]) -> Array:
        """With a finite gate, clamp what is finite to the format's range."""
        largest = self._params.format.max_finite
        beyond = mask & (np.abs(z) > largest) & np.isfinite(z)
        if self._gate is not None and np.isfinite(self._codec.from_words(self._gate)[0]):
            return np.where(beyond, np.copysign(largest, z), z)
        return z

    def _write_mask(self, mask: NDArray[np.bool_], sensor: int) -> None:
        """Write which rows of a sensor take part, if that has changed."""
        bits = mask_with(self._params, self._mask, mask, sensor)
        if bits != self._mask:
            self._mask = None
            self._write_register(MASK, bits)
            self._mask = bits

    def _correct(
        self, step: Step, z: Array, mask: NDArray[np.bool_], sensor: int, variant: int = 0
    ) -> bool:
        """Run a step that ends with an UPDATE; tells whether that exceeded the gate."""
        try:
            gated = bool(self._run(step, sensor, variant) & GATED)
        except NotFiniteError as error:
            rounded = self._codec.from_words(self._codec.to_words(z))
            lost = np.flatnonzero(mask & ~np.isfinite(rounded))
            if not len(lost) or isinstance(error, ModelNotFiniteError):
                raise
            row = int(lost[0])
            largest = self._params.format.max_finite
            detail = f"z is {float(z[row])!r} in row {row}, and the format ends at {largest:.6g}"
            raise NotFiniteError(error.step, detail) from error
        if not gated:
            self._before = self._predicted = None
        return gated

    def _read_nis(self) -> float:
        found = [self._read_register(NIS_LOW)]
        if self._params.format.bus_words == 2:
            found.append(self._read_register(NIS_HIGH))
        return float(self._codec.from_words(np.array(found, dtype=np.uint32))[0])

    # Models on the core.

    def _input_words(self, inputs: Mapping[int, float]) -> dict[int, Words]:
        """Round inputs to words, of those that the core has not been told."""
        size = self._params.format.bus_words
        names = self._params.models.inputs
        words = {
            place: self._words(names[place], np.array([value])) for place, value in inputs.items()
        }
        return {
            place: word.reshape(size)
            for place, word in words.items()
            if self._inputs.get(place) != word.tobytes()
        }

    def _write_inputs(self, words: Mapping[int, Words]) -> None:
        if words:
            size = self._params.format.bus_words
            places = self._U_write.reshape(-1, size)[[*words]]
            for place in words:
                self._inputs.pop(place, None)
            self._write(places.reshape(-1), np.concatenate([*words.values()]))
            self._inputs |= {place: word.tobytes() for place, word in words.items()}

    def predict_on_core(self, inputs: Mapping[int, float]) -> None:
        """Send sigma points of the estimate through f on the core, and predict: run F.

        Parameters
        ----------
        inputs
            Numbers of region U by place; those that are missing stay as they are.

        Raises
        ------
        FormatOverflowError
            If a number overflows the format.
        ModelNotFiniteError
            If f gives NaN or infinity at a sigma point. The estimate stays.
        StepError
            If the step fails.
        """
        words = self._input_words(inputs)
        with self._certainty:
            self._prepare(words)
            if self._before is None:
                self._before = self._known_x()
            self._x = self._predicted = None
            try:
                self._run(Step.F)
            except REFUSALS:
                self._before = None
                raise

    def _prepare(self, inputs: Mapping[int, Words]) -> None:
        """Draw sigma points of the estimate unless they are there, and write inputs."""
        if not self._drawn:
            self._redraw()
        self._write_inputs(inputs)

    def propagated_points(self) -> Array:
        """Read the sigma points that f on the core has given, shape (n, K).

        An update by :meth:`update` may use them, until the estimate changes otherwise.
        """
        with self._certainty:
            points = self._read(self._X_write).reshape(self._params.n, -1)
            self._predicted = points
        return points.copy()

    def update_on_core(
        self,
        z: Array,
        mask: NDArray[np.bool_],
        sensor: int,
        variant: int,
        inputs: Mapping[int, float],
    ) -> tuple[float, bool]:
        """Send sigma points through an h on the core, and update: run H.

        The points are those of a prediction that has just been made. Otherwise, and after an update
        that was rejected, they are drawn from the estimate.

        Parameters
        ----------
        z, mask, sensor
            As of :meth:`update`.
        variant
            Which of the models of that sensor.
        inputs
            Numbers of region U by place; those that are missing stay as they are.

        Returns
        -------
        nis, gated
            As of :meth:`update`.

        Raises
        ------
        FormatOverflowError
            If a number overflows the format.
        ModelNotFiniteError
            If h gives NaN or infinity at a sigma point, in a row that takes part. The estimate
            stays.
        StepError
            If the step fails.
        """
        z = self._within_gate(z, mask)
        words = self._input_words(inputs)
        with self._certainty:
            if not self._propagated:
                self._prepare({})
            self._write_inputs(words)
            self._write(self._z_write[sensor], self._codec.to_words(z))
            propagated = self._propagated
            self._write_mask(mask, sensor)
            x, self._x = self._x, None
            try:
                gated = self._correct(Step.H, z, mask, sensor, variant)
            except ModelNotFiniteError:
                self._propagated = propagated  # h leaves X as it is
                self._x = x
                raise
            if gated:
                self._x = x
            nis = self._read_nis()
        return nis, gated

    def iterate(
        self,
        z: Array,
        mask: NDArray[np.bool_],
        sensor: int,
        variant: int,
        inputs: Mapping[int, float],
    ) -> tuple[float, bool]:
        """Predict and update with models on the core: run ITERATE.

        Parameters and results are those of :meth:`update_on_core`, with the inputs of both.

        Raises
        ------
        FormatOverflowError
            If a number overflows the format.
        ModelNotFiniteError
            If a model gives NaN or infinity.
        StepError
            If the step fails. If it was not f that failed, nor PREDICT, the prediction stands.
        """
        z = self._within_gate(z, mask)
        words = self._input_words(inputs)
        with self._certainty:
            self._prepare(words)
            self._write(self._z_write[sensor], self._codec.to_words(z))
            self._write_mask(mask, sensor)
            if self._before is None:
                self._before = self._known_x()
            self._x = self._predicted = None
            try:
                gated = self._correct(Step.ITERATE, z, mask, sensor, variant)
            except REFUSALS as error:
                self._step = Step.ITERATE  # if this breaks off, recovering has to find it out
                status = self._read_register(STATUS)
                self._step = None
                if not status & RESIDUALS:
                    self._before = None
                self._propagated = bool(status & RESIDUALS) and isinstance(
                    error, ModelNotFiniteError
                )
                raise
            nis = self._read_nis()
        return nis, gated

    def iterate_ahead(
        self, samples: Sequence[CoreSample], *, redraws: bool
    ) -> tuple[Array, list[Array]]:
        """Iterate with models on the core, many times at once where the bus can: a model's can.

        All has happened then as it would have in single steps, words that are counted included. It
        ends before a sample in which a step would fail or exceed the gate, or that is not one for
        it; with such a bus or driver this is the first one.

        Parameters
        ----------
        samples
            The samples.
        redraws
            Whether new sigma points are drawn after each prediction.

        Returns
        -------
        x : array of shape (D, n)
            The estimate after each sample that has been done.
        nis : list of array
            The NIS of each update of theirs.
        """
        run_script = getattr(self._bus, "run_script", None)
        able = self._initialised and self._interrupt is None and not self.count_cycles
        if run_script is None or not able or not samples:
            return np.empty((0, self._params.n)), []
        with self._certainty:
            x = self._known_x()
            known = Known(self._drawn, self._propagated, self._mask, self._inputs)
            builder = ScriptBuilder(
                self._params, known, inputs=self._U_write, observations=self._z_write
            )
            builder.add(samples, redraws=redraws)
            self._scripted = True
            replies: Replies = run_script(builder.script(self._x_addresses))
            done = replies.rounds
            xs = self._codec.from_words(replies.reads.reshape(-1)).reshape(done, self._params.n)
            nis = self._params.format.decode(replies.nis)
            if done:
                known = builder.known[done - 1]
                self._drawn, self._propagated, self._mask = known[:3]
                self._inputs = dict(known.inputs)
                self.starts += known.starts
                self.words_written += known.words_written
                self.control_reads += known.control_reads
                self.control_writes += known.control_writes
                self.words_read += done * len(self._x_addresses)
                self._x, self._before, self._predicted = xs[-1].copy(), None, None
                if not (samples[done - 1].updates or redraws):
                    self._before = xs[-2].copy() if done > 1 else x
            self._scripted = False
        return xs, builder.nis_of_updates(nis)[:done]

    def _check_shape(self, points: Array, rows: int) -> None:
        """Check that there is a column for each sigma point with a weight."""
        shape = rows, len(self._params.points)
        if points.shape != shape:
            raise ValueError(f"points must have the shape {shape}, not {points.shape!r}")

    def _check_varies(self, words: Words, mask: NDArray[np.bool_], sensor: int) -> None:
        """Refuse a row that is one number for all sigma points and has no noise.

        Its variance is zero, but the core would find the rounding error of its mean, and nothing
        to compare that with. Of a row of zeros it finds zero, of one that overflows that it is not
        finite, and says so itself.
        """
        p = self._params
        rows = p.rows_of(sensor)
        points = words.reshape(len(rows), len(p.points), -1)
        first = self._codec.from_words(points[:, 0].reshape(-1))
        constant = mask & (points == points[:, :1]).all(axis=(1, 2))
        constant &= np.isfinite(first) & (first != 0.0)
        if p.additive_r and self._noise is not None:
            factors = self._noise[1].reshape(p.r, -1)[rows.start : rows.stop]
            constant &= ~factors.any(axis=1)
        if constant.any():
            raise SingularObservationError(Step.UPDATE, rows.start + int(constant.argmax()))

    def state(self) -> Array:
        """Give x, shape (n,): read, unless it has been read and not changed since."""
        self._certainty.check()
        return self._known_x().copy()

    def covariance(self) -> Array:
        """Run COVARIANCE and read P, shape (n, n): its lower triangle, mirrored.

        Raises
        ------
        StepError
            If the step fails.
        """
        n = self._params.n
        size = self._params.format.bus_words
        rows, columns = np.tril_indices(n)
        addresses = (
            self._addresses("P", range(n), range(n)).reshape(n, n, size)[rows, columns].reshape(-1)
        )
        P = np.empty((n, n))
        with self._certainty:
            self._ensure_initialised()
            self._run(Step.COVARIANCE)
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
