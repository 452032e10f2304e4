"""A core that needs NumPy only, behind a UIO device: what a board has, on any computer.

``python -m support.emulated_core`` is ``python -m ukf_sw.board`` with such a device as its backend.
"""

import mmap
import os
import socket
import sys
import threading
from unittest import mock

import numpy as np

from support.sequential import PLAIN, Sequential
from ukf_sw import board
from ukf_sw.drivers.driver import Driver
from ukf_sw.drivers.uio import UioBus
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.programs import RunResult, build_program
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline
from ukf_sw.spec.registers import (
    CONTROL,
    GATE_LOW,
    INTERRUPT_ENABLE,
    INTERRUPT_PENDING,
    MASK,
    REGISTERS,
)
from ukf_sw.spec.sequence import Program, Routine

__all__ = ["EmulatedEngine", "UioDevice", "emulated_core", "main"]


class EmulatedEngine:
    """Engine of a :class:`GoldenCore` that executes what programs mean, word for word the core's.

    Parameters
    ----------
    params
        What the core computes, in a format of at most 24 fraction bits.
    """

    def __init__(self, params):
        self.params = params
        self.layout = Layout(params)
        self.memory = self.layout.initial_words()
        self._code = microcode(params, Pipeline())
        self._operations = {
            routine: build_program(self.layout, *routine) for routine in self._code.programs
        }

    def _banks(self, state_bank, factor_bank):
        """Slices of the banked words, and of their copies of these numbers."""
        for vectors, bank in (([self.layout.x], state_bank), (self.layout.L, factor_bank)):
            start = vectors[0].address
            stop = start + sum(vector.beats for vector in vectors)
            turned = bank * self.layout.bank_offset
            yield slice(start, stop), slice(start + turned, stop + turned)

    def clocks(self, program, sensor=0, variant=0):
        """Clocks that a program takes."""
        return self._code.clocks(program, sensor, variant)

    def run(
        self, program, *, sensor=0, variant=0, mask=-1, state_bank=0, factor_bank=0,
        stop_after=None,
    ):  # fmt: skip
        assert variant == 0, "models run in software here"
        assert stop_after is None, "steps end at once here"
        fmt = self.params.format
        before = fmt.decode(self.memory)
        machine = Sequential(self.layout, fmt, PLAIN)
        machine.current, machine.next = before.copy(), before.copy()
        for plain, now in self._banks(state_bank, factor_bank):
            machine.current[:, plain] = before[:, now]
        for plain, later in self._banks(1 - state_bank, 1 - factor_bank):
            machine.next[:, plain] = before[:, later]
        parts = [Program.UPDATE_REDRAWN, Program.UPDATE]
        for part in parts if program is Program.UPDATE_REDRAWN else [program]:
            if machine.error == (0, 0):
                machine.run(self._operations[Routine(part, sensor)], mask)
        after = machine.current
        for plain, _ in self._banks(state_bank, factor_bank):
            after[:, plain] = before[:, plain]
        for plain, later in self._banks(1 - state_bank, 1 - factor_bank):
            after[:, later] = machine.next[:, plain]
        # Words that no operation has written stay as they are, whatever they are.
        written = before.view(np.uint64) != after.view(np.uint64)
        self.memory[written] = fmt.encode(after)[written]
        nis = None if machine.nis is None else int(fmt.encode(machine.nis))
        return RunResult(
            *machine.error, nis, self._code.clocks(program, sensor), machine.innovation_overflow
        )


class UioDevice:
    """What stands behind /dev/uioN: a shared memory, a core, and its interrupt line.

    The core looks at the memory when the interrupt is enabled, which is when a driver begins to
    wait. It then takes what was written, does the step, and leaves the results. The other end of a
    socket pair is the descriptor that a driver polls, reads and writes.

    Parameters
    ----------
    core
        A :class:`GoldenCore`, of whatever engine.
    silent
        Whether the interrupt never comes.
    """

    def __init__(self, core, *, silent=False):
        self.core = core
        self.bus = GoldenBus(self.core)
        self.silent = silent
        self.waits = 0
        self.memory = os.memfd_create("core")
        memory_map = MemoryMap(core.params)
        self.size = max(1 << memory_map.address_width, mmap.PAGESIZE)
        os.ftruncate(self.memory, self.size)
        self.words = np.frombuffer(mmap.mmap(self.memory, self.size), dtype=np.uint32)
        self.here, there = socket.socketpair()
        self.events = there.detach()
        self.buffer = [
            memory_map.address(region.symbol, row, column)
            for region in memory_map
            for row in range(region.rows)
            for column in range(region.columns)
        ]
        self.shown = {}
        self.show()
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def show(self):
        """Leave registers and buffer in the memory."""
        for address in (*(register.offset for register in REGISTERS), *self.buffer):
            if address != CONTROL.offset:
                self.words[address >> 2] = self.shown[address] = self.bus.read(address)

    def work(self):
        while self.here.recv(4):
            self.waits += 1
            control = int(self.words[CONTROL.offset >> 2])
            self.bus.write(INTERRUPT_PENDING.offset, 3)
            for register in (MASK, GATE_LOW, INTERRUPT_ENABLE):
                self.bus.write(register.offset, int(self.words[register.offset >> 2]))
            written = [a for a in self.buffer if int(self.words[a >> 2]) != self.shown[a]]
            for address in written:
                self.bus.write(address, int(self.words[address >> 2]))
            self.bus.write(CONTROL.offset, control)
            self.words[CONTROL.offset >> 2] = 0
            self.show()
            if not self.silent:
                assert self.core.irq
                self.here.send((1).to_bytes(4, "little"))

    def connect(self, **options):
        return UioBus.of_descriptors(os.dup(self.memory), os.dup(self.events), self.size, **options)

    def stop(self):
        self.here.shutdown(socket.SHUT_RDWR)
        self.thread.join(10)
        assert not self.thread.is_alive()
        self.here.close()
        os.close(self.events)
        os.close(self.memory)


def emulated_core(params):
    """Make a core whose every word is that of the golden model, without the golden model."""
    return GoldenCore(params, engine=EmulatedEngine(params))


def main(arguments=None):
    """Run ``python -m ukf_sw.board``, for which an emulated core is the backend."""
    devices = []

    def connect(_, params):
        devices.append(UioDevice(emulated_core(params)))
        bus = devices[0].connect()
        return Driver(bus, params, interrupt=bus.wait_for_interrupt, timeout=60.0)

    with mock.patch.object(board, "make_backend", connect):
        code = board.main(arguments)
    for device in devices:
        device.stop()
    return code


if __name__ == "__main__":
    sys.exit(main())
