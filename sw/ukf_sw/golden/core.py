"""Golden model of the whole core: registers, control and buffer over the engine's interpreter.

Every word that the bus can read, and every word of the memories, equals the hardware's.
"""

import copy
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from ukf_sw.drivers.bus import Addresses, Replies, Script, Start, Words
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.programs import RunResult
from ukf_sw.engine.rounds import Rounds, RoundsDone
from ukf_sw.extras import importing
from ukf_sw.golden.buffer import GoldenBuffer
from ukf_sw.golden.scripts import Plan, plan_script
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.registers import (
    CONTROL,
    CYCLES,
    ERROR,
    GATE_HIGH,
    GATE_LOW,
    INTERRUPT_ENABLE,
    INTERRUPT_PENDING,
    MASK,
    NIS_HIGH,
    NIS_LOW,
    REGISTERS,
    STATUS,
    Access,
    ErrorCode,
    Register,
)
from ukf_sw.spec.sequence import (
    ENDINGS,
    FOLLOWING,
    HIDDEN,
    NO_BANK,
    NO_FLAG,
    OF_SENSORS,
    STEPS,
    Bank,
    Flag,
    Program,
    Routine,
    Step,
    find_way,
    is_there,
)

__all__ = ["EngineModel", "GoldenCore"]

ALL_BYTES = 0b1111
WORD_MASK = 0xFFFF_FFFF

_BY_OFFSET = {register.offset: register for register in REGISTERS}
_STATE_LSB, _GATED_LSB, _DONE_LSB = (STATUS[name].lsb for name in ("STATE", "GATED", STEPS[0].name))
_FLAGS = tuple((flag, STATUS[flag.name].mask) for flag in Flag if flag.name and flag not in HIDDEN)
_INDEX_LSB = ERROR["INDEX"].lsb
_EVENT = {field.name: field.mask for field in INTERRUPT_PENDING}
_ENABLE = CONTROL["ENABLE"].mask
_RESET = CONTROL["RESET"].mask
#: Steps that are of a sensor, and of a variant of its model.
_OF_SENSORS = (Step.UPDATE, Step.H, Step.ITERATE)
_OF_VARIANTS = (Step.H, Step.ITERATE)
_START = {step: CONTROL[step.name].mask for step in STEPS}


def _mask_of(register: Register, *kinds: Access) -> int:
    """Bits of the fields of some kinds."""
    return sum(field.mask for field in register if field.access in kinds)


def _stored_by(register: Register, params: UkfParams) -> int:
    """Bits that a write stores."""
    return sum(
        field.put((1 << field.bits_of(params)) - 1)
        for field in register
        if field.access is Access.RW
    )


#: What a write to CONTROL may change.
_CHANGING = (
    "_step", "_program", "_sensor", "_variant", "_step_mask", "_done", "_error_code",
    "_error_index", "_gated", "_cycles", "_nis", "_interrupt_pending", "flags", "banks",
)  # fmt: skip
_what_changes = attrgetter(*_CHANGING)


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
        sensor: int = 0,
        variant: int = 0,
        mask: int = -1,
        state_bank: int = 0,
        factor_bank: int = 0,
        stop_after: int | None = None,
    ) -> RunResult:
        """Execute a program, or its beginning."""
        ...

    def clocks(self, program: Program, sensor: int = 0, variant: int = 0) -> int:
        """Clocks that a program takes from the start of a step."""
        ...


def _strobe_bits(strobe: int) -> int:
    """Bit mask of the strobed bytes of a bus word."""
    return sum(0xFF << 8 * byte for byte in range(4) if strobe >> byte & 1)


def _interpreter(params: UkfParams, pipeline: Pipeline | None) -> EngineModel:
    with importing("golden"):
        from ukf_sw.engine.interpreter import Interpreter
    return Interpreter(params, pipeline)


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
        Engine to use instead of an :class:`Interpreter` of these parameters, which needs the extra
        ``golden``.

    Attributes
    ----------
    hold
        Whether steps wait for :meth:`finish`.
    flags : Flag
        What the memories hold.
    banks : Bank
        Banks whose second copy is the current one.
    """

    def __init__(
        self,
        params: UkfParams,
        pipeline: Pipeline | None = None,
        *,
        engine: EngineModel | None = None,
    ) -> None:
        self.params = params
        self.engine: EngineModel = _interpreter(params, pipeline) if engine is None else engine
        self.hold = False
        self._buffer = GoldenBuffer(self.engine.layout, self.engine.memory)
        self._register_space = MemoryMap(params).region_stride
        self._words = {register: register.after_reset(params) for register in REGISTERS}
        #: Bits of each register that a write stores.
        self._stored = {register: _stored_by(register, params) for register in REGISTERS}

        self._step_mask = 0
        self._nis = 0
        self._interrupt_pending = 0
        self.banks = NO_BANK
        self._clear()

    def _clear(self) -> None:
        """Do what RESET does, a running step apart."""
        self._step = Step.IDLE
        self._program: Program | None = None
        self._sensor = 0
        self._variant = 0
        self._done = 0
        self._error_code = 0
        self._error_index = 0
        self._gated = False
        self._cycles = 0
        self.flags = NO_FLAG

    def __copy__(self) -> "GoldenCore":
        """Copy as copy.deepcopy does, so that the copy has memories of its own."""
        return copy.deepcopy(self)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_buffer"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        # The buffer is a view of the engine's memory.
        self._buffer = GoldenBuffer(self.engine.layout, self.engine.memory)

    # What can be seen from outside.

    @property
    def state_bank(self) -> int:
        """Which copy of x is the current one."""
        return int(Bank.STATE in self.banks)

    @property
    def factor_bank(self) -> int:
        """Which copy of the factor of its covariance is the current one."""
        return int(Bank.FACTOR in self.banks)

    @property
    def _magnitude(self) -> int:
        """Bits of a word of a number but for its sign."""
        return (1 << (self.params.format.width - 1)) - 1

    @property
    def _gate(self) -> int:
        """The gate, as a word without its sign."""
        return (self._words[GATE_LOW] | self._words[GATE_HIGH] << 32) & self._magnitude

    @property
    def busy(self) -> bool:
        """Whether a step runs."""
        return self._step is not Step.IDLE

    @property
    def irq(self) -> bool:
        """Interrupt line: high while an enabled event is pending."""
        return bool(self._interrupt_pending & self._words[INTERRUPT_ENABLE])

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
            register = _BY_OFFSET.get(address)
            return (0, False) if register is None else (self._read_register(register), True)
        word = None if self.busy else self._buffer.read(address, self.banks)
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
        outdated = self._buffer.write(address, data, bits, self.banks)
        if outdated is None:
            return False
        if bits:
            self.flags &= ~outdated
        return True

    def read_many(self, addresses: Addresses) -> Words | None:
        """Read many words of the buffer; None if :meth:`read` would answer any with SLVERR."""
        return None if self.busy else self._buffer.read_many(addresses, self.banks)

    def write_many(self, addresses: Addresses, words: Words) -> int:
        """Write many words of the buffer, in order, up to the first that is refused.

        Returns
        -------
        int
            How many words were written.
        """
        outdated = None if self.busy else self._buffer.write_many(addresses, words, self.banks)
        if outdated is not None:
            self.flags &= ~outdated
            return len(addresses)
        for count, (address, word) in enumerate(
            zip(addresses.tolist(), words.tolist(), strict=True)
        ):
            if not self.write(address, word):
                return count
        return len(addresses)

    def run_script(self, script: Script) -> Replies:
        """Do what a script says, up to the first round that does not succeed.

        Nothing of that round is done: what it comes to is for single accesses to find out.
        """
        run_rounds: Callable[[Rounds], RoundsDone] | None
        run_rounds = getattr(self.engine, "run_rounds", None)
        plan = None
        if (
            run_rounds is not None
            and not (self.busy or self.hold)
            and self._words[CONTROL] & _ENABLE
        ):
            plan = plan_script(
                script, self.params, self._buffer, self.flags, self.banks, self._nis, self._gate
            )
        if run_rounds is None or plan is None:
            return Replies(0, np.zeros(0, np.uint64), np.zeros((0, len(script.reads)), np.uint32))
        memory, mask = self.engine.memory.copy(order="K"), self._words[MASK]
        before = _what_changes(self)
        try:
            rounds, nis, seen = run_rounds(plan.rounds)
            count = script.ends[rounds - 1] if rounds else 0
            found = plan.nis_of_starts(nis)[:count]
            if count:
                self._end_script(script.starts[:count], plan, int(found[-1]))
        except BaseException:
            self.engine.memory[:] = memory
            self._words[MASK] = mask
            for name, value in zip(_CHANGING, before, strict=True):
                setattr(self, name, value)
            raise
        return Replies(rounds, found, seen)

    def _end_script(self, starts: Sequence[Start], plan: Plan, nis: int) -> None:
        """Leave what steps leave that have all succeeded."""
        last, path = starts[-1], plan.paths[len(starts) - 1]
        self._program = None
        self._error_code = self._error_index = 0
        self._cycles = sum(self.engine.clocks(*routine) for routine in path.routines)
        self._words[MASK] = last.mask
        self._nis = nis
        for start in starts:
            self._done |= self._done_bit(start.step)
            if start.step in _OF_SENSORS:
                self._gated = False
        self.flags, self.banks = path.flags, Bank(plan.banks[len(starts)])
        self._signal("DONE")

    # Registers.

    def _read_register(self, register: Register) -> int:
        show = self._shows.get(register)
        return self._words[register] if show is None else show(self)

    def _write_register(self, register: Register, data: int, bits: int) -> None:
        """Write the bits that are strobed: what is stored, then what acts."""
        stored = self._stored[register] & bits
        self._words[register] = self._words[register] & ~stored | data & stored
        act = self._acts.get(register)
        if act is not None:
            act(self, data & bits)

    def _show_status(self) -> int:
        word = self._step << _STATE_LSB | self._gated << _GATED_LSB | self._done << _DONE_LSB
        for flag, mask in _FLAGS:
            word |= mask if flag in self.flags else 0
        return word

    def _show_error(self) -> int:
        return self._error_code | self._error_index << _INDEX_LSB

    def _show_pending(self) -> int:
        return self._interrupt_pending

    def _show_cycles(self) -> int:
        return self._cycles & WORD_MASK

    def _show_nis_low(self) -> int:
        return self._nis & WORD_MASK

    def _show_nis_high(self) -> int:
        return self._nis >> 32

    def _clear_pending(self, events: int) -> None:
        self._interrupt_pending &= ~events

    # Steps.

    def _act(self, actions: int) -> None:
        """CONTROL was written. A program that Python interrupts has failed."""
        if not self.busy:
            self._program = None
        before = _what_changes(self)
        try:
            self._control(actions)
        except BaseException:
            failed = self._program
            for name, value in zip(_CHANGING, before, strict=True):
                setattr(self, name, value)
            if failed is not None and not self.busy:
                self.flags &= ~ENDINGS[failed].failure.clears
            raise

    def _control(self, actions: int) -> None:
        if actions & _RESET:
            self._reset()
            return
        starts = [step for step in STEPS if actions & _START[step]]
        if not starts:
            return
        step = starts[0]
        way = find_way(step, self.flags)
        enabled = self._words[CONTROL] & _ENABLE
        sensor = CONTROL["SENSOR"].get(actions) if step in _OF_SENSORS else 0
        variant = CONTROL["VARIANT"].get(actions) if step in _OF_VARIANTS else 0
        sensors = len(self.params.sensor_rows)
        exists = is_there(step, self.params.models, sensors, sensor, variant)
        legal = len(starts) == 1 and enabled and not self.busy and exists
        if legal and way is not None:
            self._start(step, way.program, sensor, variant)
        else:
            self._error_code, self._error_index = int(ErrorCode.ILLEGAL_STEP), 0
            self._signal("ERROR")

    def _start(self, step: Step, program: Program | None, sensor: int, variant: int) -> None:
        """Start a step; without a program it ends at once."""
        self._error_code = self._error_index = 0
        self._done &= ~self._done_bit(step)
        self._cycles = 0
        if step in _OF_SENSORS:
            self._gated = False
        if program is None:
            self._done |= self._done_bit(step)
            self._signal("DONE")
            return
        self._step, self._program = step, program
        self._sensor, self._variant = sensor, variant
        self._step_mask = self._words[MASK] & (1 << self.params.m) - 1
        if not self.hold:
            self.finish()

    #: What registers show that are neither constant nor stored, and what writes to them do.
    _shows: ClassVar[dict[Register, Callable[["GoldenCore"], int]]] = {
        STATUS: _show_status, ERROR: _show_error, INTERRUPT_PENDING: _show_pending,
        CYCLES: _show_cycles, NIS_LOW: _show_nis_low, NIS_HIGH: _show_nis_high,
    }  # fmt: skip
    _acts: ClassVar[dict[Register, Callable[["GoldenCore", int], None]]] = {
        CONTROL: _act, INTERRUPT_PENDING: _clear_pending,
    }  # fmt: skip

    @classmethod
    def check_description(cls) -> None:
        """Check that the model knows every register of the description, and what writes do.

        Raises
        ------
        RuntimeError
            If it does not.
        """
        for register in REGISTERS:
            stores = bool(_mask_of(register, Access.RW))
            if (register in cls._shows) == (register.is_fixed or stores):
                raise RuntimeError(f"GoldenCore must show {register.name} in one way")
            acts = bool(_mask_of(register, Access.W1S, Access.RW1C))
            if acts != (register in cls._acts):
                raise RuntimeError(f"GoldenCore must act on a write to {register.name}, or not")

    @staticmethod
    def _done_bit(step: Step) -> int:
        return 1 << (step - 1)

    def _signal(self, event: str) -> None:
        self._interrupt_pending |= _EVENT[event]

    @property
    def _routine(self) -> Routine:
        """Program of the step that runs."""
        assert self._program is not None
        return Routine(
            self._program,
            self._sensor if self._program in OF_SENSORS else 0,
            self._variant if self._program is Program.MODEL_H else 0,
        )

    def _execute(self, stop_after: int | None) -> RunResult:
        program, sensor, variant = self._routine
        return self.engine.run(
            program,
            sensor=sensor,
            variant=variant,
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
        self._cycles = 0
        while self._run_program():
            pass
        self._end()

    def _end(self) -> None:
        """End the step that runs."""
        self._done |= self._done_bit(self._step)
        self._step = Step.IDLE
        self._signal("DONE")

    def _run_program(self) -> bool:
        """Run a program of a step; tell whether the step goes on with another."""
        assert self._program is not None
        result = self._execute(None)
        self._cycles += result.clocks
        magnitude, gate = self._magnitude, self._gate
        infinity = self.params.format.infinity
        # An innovation too large for the format is above every gate.
        rejected = failed = bool(result.error_code) and not (
            result.innovation_overflow and gate < infinity
        )
        if failed:
            self._error_code, self._error_index = result.error_code, result.error_index
            self._signal("ERROR")
        ending = ENDINGS[self._program]
        if ending.gives_nis and not failed:
            nis = infinity if result.innovation_overflow else result.nis
            assert nis is not None
            self._nis = nis
            self._gated = rejected = (self._nis & magnitude) > gate
        change = ending.failure if rejected else ending.success
        self.flags = self.flags & ~change.clears | change.sets
        self.banks ^= change.turns
        following = FOLLOWING.get((self._step, self._program))
        if failed or following is None:
            return False
        way = find_way(following, self.flags)
        assert way is not None
        self._program = way.program
        return True

    def _reset(self) -> None:
        """RESET was written."""
        if self.busy:
            left = self._cycles
            while (self._step, self._program) in FOLLOWING:
                clocks = self.engine.clocks(*self._routine)
                if left < clocks:
                    break
                if not self._run_program():  # an error has ended the step before
                    self._end()
                    break
                left -= clocks
            if self.busy:
                self._execute(left)
        self._clear()


GoldenCore.check_description()
