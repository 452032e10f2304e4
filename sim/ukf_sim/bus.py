"""The simulated core as the driver and the tests see it."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from cocotb.clock import Clock
from cocotb.simtime import get_sim_time
from cocotb.task import resume
from cocotb.triggers import ClockCycles, First, RisingEdge, Timer
from cocotbext.axi import AxiLiteBus, AxiLiteMasterRead, AxiLiteMasterWrite, AxiResp

from ukf_sw.drivers.bus import Addresses, OneCore, Words
from ukf_sw.errors import BusError

__all__ = ["ALL_BYTES", "CLOCK_HZ", "Answer", "CoreBench", "CosimBus", "Request"]

CLOCK_HZ = 100e6
PERIOD_NS = 10
ALL_BYTES = 0b1111


@dataclass(frozen=True, slots=True)
class Request:
    """An access on the bus.

    Parameters
    ----------
    address
        Byte address.
    data
        Word to write, or None to read.
    strobe
        Bit i lets byte i be written.
    """

    address: int
    data: int | None = None
    strobe: int = ALL_BYTES


@dataclass(frozen=True, slots=True)
class Answer:
    """What the core answered.

    Parameters
    ----------
    okay
        OKAY; False is SLVERR.
    data
        Word read; 0 for a write.
    clock
        Clock on which the answer was taken, counted from the start of the simulation.
    """

    okay: bool
    data: int
    clock: int


class CoreBench:
    """The core, its clock, and managers of writes and of reads on its bus.

    Requests of one block are queued on the channels of a manager back to back. This goes below
    ``AxiLiteMaster.write``, which zeroes the lanes that it does not strobe, and costs a good part
    of the time of its ``read``.

    Parameters
    ----------
    dut
        Top level, with the ports of the packaged core.
    word_clocks
        Clocks that a bus word takes at least, on average; 0 is as fast as the core answers.

    Attributes
    ----------
    words
        Words on the bus so far.
    bus_clocks
        Clocks that they took.
    """

    def __init__(self, dut: Any, word_clocks: float = 0.0) -> None:
        self.dut = dut
        self.word_clocks = word_clocks
        self.words = 0
        self.bus_clocks = 0
        self._owed = 0.0
        bus = AxiLiteBus.from_prefix(dut, "s_axi")
        self._writes = writes = AxiLiteMasterWrite(
            bus.write, dut.aclk, dut.aresetn, reset_active_level=False
        )
        self._reads = reads = AxiLiteMasterRead(
            bus.read, dut.aclk, dut.aresetn, reset_active_level=False
        )
        for channel in (writes.aw_channel, writes.w_channel, reads.ar_channel):
            channel.queue_occupancy_limit = -1
        self._address_request = writes.aw_channel._transaction_obj
        self._data_request = writes.w_channel._transaction_obj
        self._read_request = reads.ar_channel._transaction_obj

    @classmethod
    async def started(cls, dut: Any, word_clocks: float = 0.0) -> "CoreBench":
        """Start the clock and bring the core out of reset."""
        dut.aresetn.value = 0
        Clock(dut.aclk, PERIOD_NS, unit="ns", impl="gpi").start()
        await ClockCycles(dut.aclk, 2)
        # The manager looks at the reset at once, so it must have a value by now.
        bench = cls(dut, word_clocks)
        await ClockCycles(dut.aclk, 4)
        dut.aresetn.value = 1
        await ClockCycles(dut.aclk, 2)
        return bench

    @property
    def clock(self) -> int:
        """Clocks since the start of the simulation."""
        return int(get_sim_time("ns")) // PERIOD_NS

    @property
    def seconds(self) -> float:
        """Simulated time."""
        return get_sim_time("ns") * 1e-9

    async def transfer(self, requests: Sequence[Request]) -> list[Answer]:
        """Do accesses in order: writes one after the other, reads likewise."""
        if self.word_clocks:
            answers: list[Answer] = []
            for request in requests:
                start = self.clock
                answers += await self._transfer([request])
                await self._wait_word(start)
            return answers
        start = self.clock
        answers = []
        begin = 0
        for end in range(1, len(requests) + 1):
            # A read must not overtake the writes before it, nor a write the reads.
            kind = requests[begin].data is None
            if end == len(requests) or (requests[end].data is None) != kind:
                answers += await self._transfer(requests[begin:end])
                begin = end
        self.bus_clocks += self.clock - start
        self.words += len(requests)
        return answers

    async def _wait_word(self, start: int) -> None:
        """Let a word that began on a clock take its time."""
        self._owed += self.word_clocks
        due = int(self._owed)
        taken = self.clock - start
        if taken < due:
            await ClockCycles(self.dut.aclk, due - taken)
        self._owed = max(self._owed - (self.clock - start), 0.0)
        self.bus_clocks += self.clock - start
        self.words += 1

    async def _transfer(self, requests: Sequence[Request]) -> list[Answer]:
        """Do accesses that are all writes or all reads."""
        answers: list[Answer] = []
        if requests[0].data is None:
            source, sink = self._reads.ar_channel, self._reads.r_channel
            for request in requests:
                source.send_nowait(self._read_request(araddr=request.address))
            for _ in requests:
                answer = await sink.recv()
                okay = int(answer.rresp) == AxiResp.OKAY
                answers.append(Answer(okay, int(answer.rdata), self.clock))
            return answers
        addresses, data = self._writes.aw_channel, self._writes.w_channel
        sink = self._writes.b_channel
        for request in requests:
            addresses.send_nowait(self._address_request(awaddr=request.address))
            data.send_nowait(self._data_request(wdata=request.data, wstrb=request.strobe))
        for _ in requests:
            answer = await sink.recv()
            answers.append(Answer(int(answer.bresp) == AxiResp.OKAY, 0, self.clock))
        return answers

    async def sleep(self, clocks: int) -> None:
        """Let clocks pass."""
        if clocks > 0:
            await ClockCycles(self.dut.aclk, clocks)

    def pause(self, requests: Sequence[bool], responses: Sequence[bool]) -> None:
        """Pause the managers in a pattern that repeats: True is a clock without valid or ready."""
        write, read = self._writes, self._reads
        for channels, pattern in (
            ((write.aw_channel, write.w_channel, read.ar_channel), requests),
            ((write.b_channel, read.r_channel), responses),
        ):
            for channel in channels:
                channel.set_pause_generator(itertools.cycle(pattern))

    async def wait_for_interrupt(self, timeout: float) -> bool:
        """Wait until the interrupt is high, so many seconds at most; tells whether it is."""
        if self.dut.irq.value == 1:
            return True
        if timeout <= 0.0:
            return False
        await First(RisingEdge(self.dut.irq), Timer(max(round(timeout * 1e9), 1), "ns"))
        return self.dut.irq.value == 1


class CosimBus(OneCore):
    """The bus for a driver, in a thread that :func:`cocotb.task.bridge` has made.

    Parameters
    ----------
    bench
        The core.
    """

    def __init__(self, bench: CoreBench) -> None:
        self.bench = bench
        self.transfer = resume(bench.transfer)
        self.sleep = resume(bench.sleep)
        self.pause = resume(self._pause)
        self._wait = resume(bench.wait_for_interrupt)

    async def _pause(self, requests: Sequence[bool], responses: Sequence[bool]) -> None:
        self.bench.pause(requests, responses)

    def clock(self) -> float:
        """Simulated time, in seconds."""
        return self.bench.seconds

    def read(self, address: int) -> int:
        """Read a word.

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        (answer,) = self.transfer([Request(address)])
        if not answer.okay:
            raise BusError(address, "read")
        return answer.data

    def write(self, address: int, word: int) -> None:
        """Write a word.

        Raises
        ------
        BusError
            If the core answers SLVERR.
        """
        (answer,) = self.transfer([Request(address, word)])
        if not answer.okay:
            raise BusError(address, "write")

    def read_many(self, addresses: Addresses) -> Words:
        """Read words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core answers any with SLVERR.
        """
        answers = self.transfer([Request(address) for address in addresses.tolist()])
        self._check(addresses, answers, "read")
        return np.array([answer.data for answer in answers], dtype=np.uint32)

    def write_many(self, addresses: Addresses, words: Words) -> None:
        """Write words, shape (k,), at addresses, shape (k,).

        Raises
        ------
        BusError
            If the core answers any with SLVERR; the others are written all the same.
        """
        pairs = zip(addresses.tolist(), words.tolist(), strict=True)
        answers = self.transfer([Request(address, word) for address, word in pairs])
        self._check(addresses, answers, "write")

    @staticmethod
    def _check(addresses: Addresses, answers: list[Answer], access: str) -> None:
        for address, answer in zip(addresses.tolist(), answers, strict=True):
            if not answer.okay:
                raise BusError(address, access)

    def wait_for_interrupt(self, timeout: float) -> bool:
        """Wait until the interrupt is high, so many seconds at most; tells whether it is."""
        return self._wait(timeout)
