"""Golden model of the whole core: registers, control and buffer over the engine's interpreter.

Every word that the bus can read, and every word of the memories, equals the hardware's.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ukf_sw.drivers.bus import Addresses, Words
from ukf_sw.engine.interpreter import Interpreter, RunResult
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.programs import Program
from ukf_sw.errors import BusError
from ukf_sw.golden_buffer import GoldenBuffer, Part
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.registers import (
    CONFIG,
    CONTROL,
    CYCLES,
    ERROR,
    GATE_HIGH,
    GATE_LOW,
    ID,
    INTERRUPT_ENABLE,
    INTERRUPT_PENDING,
    MASK,
    NIS_HIGH,
    NIS_LOW,
    REGISTERS,
    SIZES,
    STATUS,
    ErrorCode,
    Register,
    Step,
)

__all__ = ["EngineModel", "GoldenBus", "GoldenCore"]

ALL_BYTES = 0b1111
WORD_MASK = 0xFFFF_FFFF

_BY_OFFSET = {register.offset: register for register in REGISTERS}
_STEPS = tuple(step for step in Step if step is not Step.IDLE)
_STATE_LSB, _INITIALISED_LSB, _POINTS_LSB, _RESIDUALS_LSB, _GATED_LSB, _DONE_LSB = (
    STATUS[name].lsb
    for name in ("STATE", "INITIALISED", "POINTS", "RESIDUALS", "GATED", Step(1).name)
)
_INDEX_LSB = ERROR["INDEX"].lsb
_EVENT = {field.name: field.mask for field in INTERRUPT_PENDING}
_ENABLE = CONTROL["ENABLE"].mask
_RESET = CONTROL["RESET"].mask
_START = {step: CONTROL[step.name].mask for step in _STEPS}


class EngineModel(Protocol):
    """What the model needs of an engine; :class:`Interpreter` is one."""

    #: Every word of the memories, shape (pes, depth).
    memory: NDArray[np.uint64]

    @property
    def layout(self) -> Layout:
        """Where the regions are in the memories."""
        ...

    def run(
        self,
        program: Program,
        *,
        mask: int = -1,
        state_bank: int = 0,
        factor_bank: int = 0,
        stop_after: int | None = None,
    ) -> RunResult:
        """Execute a program, or its beginning."""
        ...


def _strobe_bits(strobe: int) -> int:
    """Bit mask of the strobed bytes of a bus word."""
    return sum(0xFF << 8 * byte for byte in range(4) if strobe >> byte & 1)


class GoldenCore:
    """The core, seen from its bus.

    A start that is legal runs its whole step at once, so software never sees the step running.
    Tests that need to see it set :attr:`hold`: then a step that has started runs until
    :meth:`finish`, refuses what the hardware refuses meanwhile, and a RESET drops it after
    as many clocks as :meth:`advance` has let pass.

    Parameters
    ----------
    params
        What the core computes.
    pipeline
        How it is built: decides CYCLES, never results.
    engine
        Engine to use instead of an :class:`Interpreter` of these parameters.

    Attributes
    ----------
    hold
        Whether steps wait for :meth:`finish`.
    initialised, points, predicted, residuals : bool
        What the memories hold: results of INIT; sigma points of the estimate; the covariance as
        residuals of a PREDICT rather than as factor; residuals that UPDATE can use.
    state_bank, factor_bank : int
        Which copies of x and of its factor are the current ones.
    """

    def __init__(
        self,
        params: UkfParams,
        pipeline: Pipeline | None = None,
        *,
        engine: EngineModel | None = None,
    ) -> None:
        self.params = params
        self.engine: EngineModel = Interpreter(params, pipeline) if engine is None else engine
        self.hold = False
        self._buffer = GoldenBuffer(self.engine.layout, self.engine.memory)
        self._register_space = MemoryMap(params).region_stride
        self._registers = self._make_registers()

        self._enable = bool(CONTROL["ENABLE"].reset)
        self._mask = self._step_mask = MASK["VALUE"].reset
        self._gate = params.format.infinity
        self._nis = 0
        self._interrupt_enable = 0
        self._interrupt_pending = 0
        self.state_bank = self.factor_bank = 0
        self._clear()

    def _make_registers(self) -> dict[int, Callable[[], int]]:
        """Make functions that read the registers, by offset."""
        p = self.params
        sizes = {"N": p.n, "Q": p.q, "R": p.r, "M": p.m}
        config = {
            "PES": p.pes,
            "EXPONENT_BITS": p.format.exponent_bits,
            "FRACTION_BITS": p.format.fraction_bits,
            "COVARIANCE_FORM": int(p.form is Form.COVARIANCE),
            "ADDITIVE_Q": int(p.process_noise is Noise.ADDITIVE),
            "ADDITIVE_R": int(p.observation_noise is Noise.ADDITIVE),
        }
        fixed = {
            ID: sum(field.put(field.reset) for field in ID),
            SIZES: sum(SIZES[name].put(value) for name, value in sizes.items()),
            CONFIG: sum(CONFIG[name].put(value) for name, value in config.items()),
        }
        return {
            ID.offset: lambda: fixed[ID],
            SIZES.offset: lambda: fixed[SIZES],
            CONFIG.offset: lambda: fixed[CONFIG],
            CONTROL.offset: lambda: _ENABLE * self._enable,
            STATUS.offset: self._status,
            ERROR.offset: lambda: self._error_code | self._error_index << _INDEX_LSB,
            INTERRUPT_ENABLE.offset: lambda: self._interrupt_enable,
            INTERRUPT_PENDING.offset: lambda: self._interrupt_pending,
            CYCLES.offset: lambda: self._cycles & WORD_MASK,
            MASK.offset: lambda: self._mask,
            NIS_LOW.offset: lambda: self._nis & WORD_MASK,
            NIS_HIGH.offset: lambda: self._nis >> 32,
            GATE_LOW.offset: lambda: self._gate & WORD_MASK,
            GATE_HIGH.offset: lambda: self._gate >> 32,
        }

    def _clear(self) -> None:
        """Do what RESET does, a running step apart."""
        self._step = Step.IDLE
        self._program: Program | None = None
        self._done = 0
        self._error_code = 0
        self._error_index = 0
        self._gated = False
        self._cycles = 0
        self.initialised = self.points = self.predicted = self.residuals = False

    # The state that tests look at.

    @property
    def busy(self) -> bool:
        """Whether a step runs."""
        return self._step is not Step.IDLE

    @property
    def irq(self) -> bool:
        """Interrupt line: high while an enabled event is pending."""
        return bool(self._interrupt_pending & self._interrupt_enable)

    # Bus accesses.

    def read(self, address: int) -> tuple[int, bool]:
        """Read a word over the bus.

        Parameters
        ----------
        address
            Byte address; the two low bits do not matter.

        Returns
        -------
        data : int
            The word, 0 with an error.
        okay : bool
            False for SLVERR.
        """
        address &= ~0b11
        if 0 <= address < self._register_space:
            register = self._registers.get(address)
            return (0, False) if register is None else (register(), True)
        word = None if self.busy else self._buffer.read(address, self._banks)
        return (0, False) if word is None else (word, True)

    def write(self, address: int, data: int, strobe: int = ALL_BYTES) -> bool:
        """Write a word over the bus.

        Parameters
        ----------
        address
            Byte address; the two low bits do not matter.
        data
            The word.
        strobe
            Bit i lets byte i be written.

        Returns
        -------
        bool
            False for SLVERR, and nothing has happened then.
        """
        address &= ~0b11
        bits = _strobe_bits(strobe)
        if 0 <= address < self._register_space:
            register = _BY_OFFSET.get(address)
            if register is None:
                return False
            self._write_register(register, data & WORD_MASK, bits)
            return True
        if self.busy:
            return False
        part = self._buffer.write(address, data, bits, self._banks)
        if bits:
            self._note_write(part)
        return part is not Part.NOTHING

    def read_many(self, addresses: Addresses) -> Words | None:
        """Read many words of the buffer; None if :meth:`read` would answer any with SLVERR."""
        return None if self.busy else self._buffer.read_many(addresses, self._banks)

    def write_many(self, addresses: Addresses, words: Words) -> int:
        """Write many words of the buffer, in order, up to the first that is refused.

        Returns
        -------
        int
            How many words were written.
        """
        if not self.busy and (part := self._buffer.write_many(addresses, words, self._banks)):
            self._note_write(part)
            return len(addresses)
        for count, (address, word) in enumerate(
            zip(addresses.tolist(), words.tolist(), strict=True)
        ):
            if not self.write(address, word):
                return count
        return len(addresses)

    @property
    def _banks(self) -> tuple[int, int]:
        return self.state_bank, self.factor_bank

    def _note_write(self, part: Part) -> None:
        """Follow a write to the buffer: what the memories hold has changed."""
        if part >= Part.STATE:
            self.points = self.residuals = False
        if part is Part.FACTOR:
            self.predicted = False

    def _status(self) -> int:
        return (
            self._step << _STATE_LSB
            | self.initialised << _INITIALISED_LSB
            | self.points << _POINTS_LSB
            | self.residuals << _RESIDUALS_LSB
            | self._gated << _GATED_LSB
            | self._done << _DONE_LSB
        )

    def _write_register(self, register: Register, data: int, bits: int) -> None:
        def merge(old: int) -> int:
            return data & bits | old & ~bits

        if register is CONTROL:
            self._write_control(data & bits, merge(_ENABLE * self._enable))
        elif register is INTERRUPT_ENABLE:
            self._interrupt_enable = merge(self._interrupt_enable) & 0b11
        elif register is INTERRUPT_PENDING:
            self._interrupt_pending &= ~(data & bits)
        elif register is MASK:
            self._mask = merge(self._mask)
        elif register is GATE_LOW:
            self._gate = self._gate & ~WORD_MASK | merge(self._gate & WORD_MASK)
        elif register is GATE_HIGH:
            self._gate = self._gate & WORD_MASK | merge(self._gate >> 32) << 32

    # Steps.

    def _write_control(self, actions: int, enable: int) -> None:
        self._enable = bool(enable & _ENABLE)
        if actions & _RESET:
            self._reset()
            return
        starts = [step for step in _STEPS if actions & _START[step]]
        if not starts:
            return
        if len(starts) == 1 and self._enable and not self.busy and self._allows(starts[0]):
            self._start(starts[0])
        else:
            self._error_code, self._error_index = int(ErrorCode.ILLEGAL_STEP), 0
            self._signal("ERROR")

    def _allows(self, step: Step) -> bool:
        """Whether the sequence of steps allows one now."""
        match step:
            case Step.SIG_GEN | Step.COVARIANCE:
                return self.initialised
            case Step.PREDICT:
                return self.points
            case Step.UPDATE:
                return self.residuals or self.points
            case _:
                return True

    def _start(self, step: Step) -> None:
        self._error_code = self._error_index = 0
        self._done &= ~self._done_bit(step)
        self._cycles = 0
        if step is Step.UPDATE:
            self._gated = False
        if step is Step.SIG_GEN and self.points:
            self._done |= self._done_bit(step)
            self._signal("DONE")
            return
        self._step = step
        self._step_mask = self._mask & (1 << self.params.m) - 1
        self._program = {
            Step.INIT: Program.INIT,
            Step.SIG_GEN: Program.SIG_GEN_PREDICTED if self.predicted else Program.SIG_GEN,
            Step.PREDICT: Program.PREDICT,
            Step.UPDATE: Program.UPDATE if self.residuals else Program.UPDATE_REDRAWN,
            Step.COVARIANCE: (
                Program.COVARIANCE_PREDICTED if self.predicted else Program.COVARIANCE
            ),
        }[step]
        if not self.hold:
            self.finish()

    @staticmethod
    def _done_bit(step: Step) -> int:
        return 1 << (step - 1)

    def _signal(self, event: str) -> None:
        self._interrupt_pending |= _EVENT[event]

    def _execute(self, stop_after: int | None) -> RunResult:
        assert self._program is not None
        return self.engine.run(
            self._program,
            mask=self._step_mask,
            state_bank=self.state_bank,
            factor_bank=self.factor_bank,
            stop_after=stop_after,
        )

    def advance(self, clocks: int) -> None:
        """Let clocks of a held step pass.

        Raises
        ------
        RuntimeError
            If no step runs.
        """
        if not self.busy:
            raise RuntimeError("A step must run, not STATUS.STATE = IDLE")
        self._cycles += clocks

    def finish(self) -> None:
        """Let a held step run to its end.

        Raises
        ------
        RuntimeError
            If no step runs.
        """
        if not self.busy or self._program is None:
            raise RuntimeError("A step must run, not STATUS.STATE = IDLE")
        result = self._execute(None)
        step, program = self._step, self._program
        self._step, self._program = Step.IDLE, None
        self._cycles = result.clocks
        self._done |= self._done_bit(step)
        self._signal("DONE")
        if result.error_code:
            self._error_code, self._error_index = result.error_code, result.error_index
            self._signal("ERROR")
        self._apply(program, result)

    def _apply(self, program: Program, result: RunResult) -> None:
        """Commit a step, or not."""
        success = not result.error_code
        match program:
            case Program.INIT:
                self.initialised = success
                self.points = self.predicted = self.residuals = False
            case Program.SIG_GEN | Program.SIG_GEN_PREDICTED:
                if success:
                    self.points = True
                    self.predicted = self.residuals = False
                    self.factor_bank ^= program is Program.SIG_GEN_PREDICTED
            case Program.PREDICT:
                self.points = False
                self.predicted = self.residuals = success
                self.state_bank ^= success
            case Program.UPDATE | Program.UPDATE_REDRAWN:
                if success:
                    assert result.nis is not None
                    magnitude = (1 << (self.params.format.width - 1)) - 1
                    self._nis = result.nis
                    self._gated = (self._nis & magnitude) > (self._gate & magnitude)
                if success and not self._gated:
                    self.points = True
                    self.predicted = self.residuals = False
                    self.state_bank ^= 1
                    self.factor_bank ^= 1
                elif program is Program.UPDATE_REDRAWN:
                    self.points = self.predicted = self.residuals = False
            case _:
                pass

    def _reset(self) -> None:
        """RESET was written."""
        if self.busy:
            self._execute(self._cycles)
        self._clear()


class GoldenBus:
    """A :class:`GoldenCore` as a bus for the driver.

    Parameters
    ----------
    core
        The core.
    """

    def __init__(self, core: GoldenCore) -> None:
        self.core = core

    def read(self, address: int) -> int:
        """Read a word.

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        data, okay = self.core.read(address)
        if not okay:
            raise BusError(address, "read")
        return data

    def write(self, address: int, word: int) -> None:
        """Write a word.

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        if not self.core.write(address, word):
            raise BusError(address, "write")

    def read_many(self, addresses: Addresses) -> Words:
        """Read words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        words = self.core.read_many(addresses)
        if words is None:
            return np.array([self.read(address) for address in addresses.tolist()], np.uint32)
        return words

    def write_many(self, addresses: Addresses, words: Words) -> None:
        """Write words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core answers SLVERR; the words before are written.
        """
        written = self.core.write_many(addresses, words)
        if written < len(addresses):
            raise BusError(int(addresses[written]), "write")

    def wait_for_interrupt(self, timeout: float) -> bool:
        """Tell whether the interrupt line is high; time does not pass in the model."""
        return self.core.irq
