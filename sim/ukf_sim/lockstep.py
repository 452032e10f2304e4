"""The simulated core and its golden model on one bus, compared word for word."""

from collections.abc import Callable, Iterable
from typing import ParamSpec, TypeVar

import numpy as np

from ukf_sim.bus import Answer, CosimBus, Request
from ukf_sw.drivers.bus import Addresses, Words
from ukf_sw.engine.microcode import microcode
from ukf_sw.errors import BusError
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline
from ukf_sw.spec.registers import CONTROL, REGISTERS, STATUS
from ukf_sw.spec.sequence import ENDINGS, FOLLOWING, OF_SENSORS, Program, Step, find_way

__all__ = ["LockstepBus", "MismatchError"]

_ENABLE = CONTROL["ENABLE"].mask
_STATE = STATUS["STATE"].mask
_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_NAMES = {register.offset: register.name for register in REGISTERS}


class MismatchError(Exception):
    """The simulated core did not do what the golden model does.

    Parameters
    ----------
    place
        Where: a register, an element of a region, or a line.
    found
        What the core had.
    expected
        What the golden model has.
    """

    def __init__(self, place: str, found: str, expected: str) -> None:
        super().__init__(f"{place} of the core is {found}, of the golden model {expected}")
        self.place = place
        self.found = found
        self.expected = expected

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.place, self.found, self.expected)


class LockstepBus:
    """A bus for a driver, with the simulated core and its golden model behind it.

    Both get every write. Every word that is read, the registers included, must be equal, and so
    must every refusal. A step of the model lasts until the core's ends.

    Parameters
    ----------
    device
        The simulated core.
    golden
        The model.
    pipeline
        How the core is built, which says how long its steps take.

    Attributes
    ----------
    words_compared : int
        Number of words read from both.
    """

    def __init__(self, device: CosimBus, golden: GoldenCore, pipeline: Pipeline) -> None:
        self.device = device
        self.golden = golden
        self.words_compared = 0
        golden.hold = True
        self._model = GoldenBus(golden)
        self._code = microcode(golden.params, pipeline)
        self._map = MemoryMap(golden.params)
        self._everything = {
            region.symbol: self._addresses(region.symbol) for region in self._map.regions
        }

    def _addresses(self, symbol: str) -> Addresses:
        region = self._map[symbol]
        size = self.golden.params.format.bus_words
        return np.array(
            [
                self._map.address(symbol, row, column) + 4 * word
                for row in range(region.rows)
                for column in range(region.columns)
                for word in range(size)
            ],
            dtype=np.int64,
        )

    def name(self, address: int) -> str:
        """Name what is at an address."""
        address &= ~0b11
        if address < self._map.region_stride:
            return _NAMES.get(address, f"address {address:#x}")
        index, within = divmod(address, self._map.region_stride)
        row, within = divmod(within, self._map.row_stride)
        column, byte = divmod(within, self._map.element_bytes)
        for region in self._map:
            if region.index == index and row < region.rows and column < region.columns:
                half = "" if self._map.element_bytes == 4 else (" low", " high")[byte // 4]
                return f"{region.symbol}[{row}, {column}]{half}"
        return f"address {address:#x}"

    def read(self, address: int) -> int:
        """Read a word.

        Raises
        ------
        BusError
            If both answer SLVERR.
        MismatchError
            If they differ.
        """
        try:
            found = self.device.read(address)
        except BusError:
            found = None
        if address == STATUS.offset and found is not None and not found & _STATE:
            self._catch_up()
        expected, okay = self.golden.read(address)
        self._compare(address, found, expected if okay else None)
        if found is None:
            raise BusError(address, "read")
        return found

    def _compare(self, address: int, found: int | None, expected: int | None) -> None:
        self.words_compared += 1
        if found != expected:
            texts = ["SLVERR" if word is None else f"{word:#010x}" for word in (found, expected)]
            raise MismatchError(self.name(address), *texts)

    def _catch_up(self) -> None:
        """Let the model's step end."""
        if self.golden.busy:
            self.golden.finish()

    def write(self, address: int, word: int) -> None:
        """Write a word.

        Raises
        ------
        BusError
            If both answer SLVERR.
        MismatchError
            If only one does.
        """
        self.write_many(np.array([address]), np.array([word], dtype=np.uint32))

    def read_many(self, addresses: Addresses) -> Words:
        """Read words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If both answer SLVERR.
        MismatchError
            If they differ.
        """
        found, device_error = _attempt(self.device.read_many, addresses)
        expected, model_error = _attempt(self._model.read_many, addresses)
        self._compare_errors(device_error, model_error)
        assert found is not None
        assert expected is not None  # else there was an error
        self.words_compared += len(addresses)
        wrong = np.flatnonzero(found != expected)
        if wrong.size:
            self._compare(int(addresses[wrong[0]]), int(found[wrong[0]]), int(expected[wrong[0]]))
        return found

    def write_many(self, addresses: Addresses, words: Words) -> None:
        """Write words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If both answer SLVERR.
        MismatchError
            If only one does.
        """
        _, device_error = _attempt(self.device.write_many, addresses, words)
        _, model_error = _attempt(self._model.write_many, addresses, words)
        self._compare_errors(device_error, model_error)

    def _compare_errors(self, device: BusError | None, model: BusError | None) -> None:
        """Check that both refuse the same access, and raise if they do."""
        error = device if device is not None else model
        if error is None:
            return
        if device is None or model is None or device.address != model.address:
            found, expected = ("OKAY" if e is None else "SLVERR" for e in (device, model))
            raise MismatchError(f"answer at {self.name(error.address)}", found, expected)
        raise error

    def clock(self) -> float:
        """Simulated time, in seconds."""
        return self.device.clock()

    def wait_for_interrupt(self, timeout: float) -> bool:
        """Wait until the interrupt of the core is high; that of the model must be then.

        Raises
        ------
        MismatchError
            If it is not.
        """
        found = self.device.wait_for_interrupt(timeout)
        if found:
            self._catch_up()
        if found != self.golden.irq:
            raise MismatchError("irq", str(found), str(self.golden.irq))
        return found

    def access(self, request: Request) -> Answer:
        """Make any access, with any strobes; gives the core's answer.

        Raises
        ------
        MismatchError
            If the model answers something else.
        """
        (answer,) = self.device.transfer([request])
        if request.data is None:
            data, okay = self.golden.read(request.address)
        else:
            data, okay = 0, self.golden.write(request.address, request.data, request.strobe)
        self.words_compared += 1
        if (answer.okay, answer.data) != (okay, data):
            raise MismatchError(
                f"answer at {self.name(request.address)}",
                f"{answer.data:#010x}, {'OKAY' if answer.okay else 'SLVERR'}",
                f"{data:#010x}, {'OKAY' if okay else 'SLVERR'}",
            )
        return answer

    def await_idle(self) -> None:
        """Wait until the core runs no step, by polling, and let the model's step end."""
        while self.device.read(STATUS.offset) & _STATE:
            self.device.sleep(8)
        self._catch_up()

    def step_clocks(self, step: Step, sensor: int = 0, variant: int = 0) -> int:
        """Clocks that a step would take, as the model stands; 0 if it ends at once.

        See :meth:`program_clocks`.
        """
        return sum(self.program_clocks(step, sensor, variant))

    def program_clocks(self, step: Step, sensor: int = 0, variant: int = 0) -> list[int]:
        """Clocks of each program of a step, as the model stands, if none ends with an error.

        Parameters
        ----------
        step
            The step.
        sensor, variant
            Whose and which, of a step that has them.

        Raises
        ------
        ValueError
            If the step is illegal.
        """
        flags, clocks = self.golden.flags, list[int]()
        way = find_way(step, flags)
        if way is None:
            raise ValueError(f"step must be legal in this state of the core, not {step.name}")
        while way is not None and (program := way.program) is not None:
            clocks.append(
                self._code.clocks(
                    program,
                    sensor if program in OF_SENSORS else 0,
                    variant if program is Program.MODEL_H else 0,
                )
            )
            change = ENDINGS[program].success
            flags = flags & ~change.clears | change.sets
            following = FOLLOWING.get((step, program))
            way = None if following is None else find_way(following, flags)
        return clocks

    def abort(self, step: Step, clocks: int, sensor: int = 0, variant: int = 0) -> int:
        """Start a step, and write RESET some clocks later.

        Parameters
        ----------
        step
            Step to start.
        clocks
            How long to wait between the writes.
        sensor, variant
            Whose and which, of a step that has them.

        Returns
        -------
        int
            Clocks from the start to the reset.
        """
        control = CONTROL.offset
        chosen = CONTROL["SENSOR"].put(sensor) | CONTROL["VARIANT"].put(variant)
        start = self.access(Request(control, _ENABLE | CONTROL[step.name].mask | chosen))
        self.device.sleep(clocks)
        request = Request(control, _ENABLE | CONTROL["RESET"].mask)
        (stop,) = self.device.transfer([request])
        passed = stop.clock - start.clock
        if self.golden.busy:
            if passed > self.step_clocks(step, sensor, variant):
                self.golden.finish()
            else:
                # The word of the clock after the reset is the last one that is executed; the
                # first one is two clocks after the start.
                self.golden.advance(max(passed - 1, 0))
        self.golden.write(control, request.data or 0)
        return passed

    def verify(self, symbols: Iterable[str] | None = None) -> None:
        """Compare registers, and regions of the buffer, while no step runs.

        Parameters
        ----------
        symbols
            Regions; None is all. Those that a core does not have are left out.

        Raises
        ------
        MismatchError
            If they differ.
        """
        for register in REGISTERS:
            self.read(register.offset)
        for symbol, addresses in self._everything.items():
            if symbols is None or symbol in symbols:
                self.read_many(addresses)


def _attempt(
    function: Callable[_Arguments, _Result], *args: _Arguments.args, **kwargs: _Arguments.kwargs
) -> tuple[_Result | None, BusError | None]:
    """Result of a bus access, or its refusal."""
    try:
        return function(*args, **kwargs), None
    except BusError as error:
        return None, error
