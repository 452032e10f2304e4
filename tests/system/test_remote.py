"""The simulated core as a backend by name, in the process of a script."""

import importlib
import inspect
import os
import signal
import threading
import time
from multiprocessing import Pipe
from multiprocessing.connection import Listener
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ukf_sim.lockstep import MismatchError
from ukf_sim.remote import Line, RemoteBus, _receive, serve
from ukf_sim.simulators import SimulatorError
from ukf_sw.backends import backend_names, make_backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import BusError, NotFiniteError, WrongCoreError
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.registers import ID, INTERRUPT_PENDING

pytestmark = pytest.mark.system

TINY = UkfParams(n=1, m=1, q=1, r=1)
#: A time-out above which a user interrupts the script.
INTERRUPTED = 1e3


def test_script_runs_on_the_simulated_core(icarus, tmp_path, monkeypatch):
    """All in one test, because a simulation takes long to start."""
    assert "cosim" in backend_names()
    monkeypatch.chdir(tmp_path)
    scenario = random_scenario(TINY, steps=3)
    ukf = UnscentedKalmanFilter(scenario, "cosim:icarus")
    driver = ukf.backend
    assert isinstance(driver, Driver)
    results = run(scenario, driver)
    assert np.array_equal(results.x, run(scenario, "golden").x)
    assert driver.last_cycles["UPDATE"] > 0
    # Errors of the core arrive as they do from any other backend.
    with pytest.raises(NotFiniteError):
        driver.predict(np.full((1, len(TINY.points)), np.inf))

    bus = driver._bus
    assert isinstance(bus, RemoteBus)
    assert ID["MAGIC"].get(bus.read(ID.offset)) == ID["MAGIC"].reset
    with pytest.raises(BusError) as caught:
        bus.read(0xFC)
    assert (caught.value.address, caught.value.access) == (0xFC, "read")
    address = MemoryMap(TINY).address("x", 0, 0)
    bus.write(address, 0x3F80_0000)
    assert bus.read_many(np.array([address])).tolist() == [0x3F80_0000]
    with pytest.raises(WrongCoreError):
        Driver(bus, UkfParams(n=2, m=1))
    bus.write(INTERRUPT_PENDING.offset, 3)
    before = bus.clock()
    assert not bus.wait_for_interrupt(1e-6)
    assert bus.clock() >= before + 1e-6
    bus.close()
    bus.close()
    with pytest.raises(SimulatorError, match=r"^The simulation has ended$"):
        bus.read(ID.offset)


class Recorded:
    """A bus behind the socket, without a simulator."""

    def read(self, address):
        if address == 0xFC:
            raise BusError(address, "read")
        return np.uint32(address + 1)

    def write(self, address, word):
        if address:
            raise MismatchError("x[0, 0]", "1", "2")

    def read_many(self, addresses):
        return np.asarray(addresses, dtype=np.uint32) + 1

    def write_many(self, addresses, words):
        assert (words.dtype, words.tolist()) == (np.uint32, [2**32 - 1])

    def wait_for_interrupt(self, timeout):
        if timeout > INTERRUPTED:
            os.kill(os.getpid(), signal.SIGINT)  # the main thread waits for the answer
            time.sleep(0.1)
        return np.bool_(timeout > 1.0)

    def clock(self):
        return 0.1


@pytest.fixture
def remote(tmp_path):
    """A remote bus whose other side is that of a simulation, in a thread."""
    address = str(tmp_path / "socket")
    with Listener(address) as listener:
        context = SimpleNamespace(lockstep=Recorded())
        thread = threading.Thread(target=serve, args=(context,), kwargs={"address": address})
        thread.start()
        bus = object.__new__(RemoteBus)
        connection = listener.accept()
    assert _receive(connection) == ("ready", None)
    bus._line = Line(connection)
    yield bus
    bus._line.close()
    thread.join(10)
    assert not thread.is_alive()


def test_accesses_pass_as_text(remote):
    assert remote.read(8) == 9
    remote.write(0, 7)
    words = remote.read_many(np.array([4, 8]))
    assert (words.dtype, words.tolist()) == (np.uint32, [5, 9])
    remote.write_many(np.array([4]), np.array([2**32 - 1], dtype=np.uint32))
    assert remote.wait_for_interrupt(2.0) is True
    assert remote.wait_for_interrupt(0.5) is False
    assert remote.clock() == 0.1
    with pytest.raises(BusError) as caught:
        remote.read(0xFC)
    assert (caught.value.address, caught.value.access) == (0xFC, "read")
    with pytest.raises(SimulatorError, match=r"x\[0, 0\]"):
        remote.write(4, 7)


@pytest.mark.parametrize("times", [1, 3])
def test_an_answer_that_comes_after_an_interrupt_is_dropped(remote, times):
    for _ in range(times):
        with pytest.raises(KeyboardInterrupt):
            remote.wait_for_interrupt(2.0 * INTERRUPTED)
    assert remote.read(8) == 9
    assert remote.clock() == 0.1
    with pytest.raises(BusError):
        remote.read(0xFC)
    remote.write(0, 7)


def test_what_is_received_is_not_run(remote, tmp_path):
    """Nothing on the way is unpickled, so whoever gets at the socket runs no code."""

    class Attack:
        def __reduce__(self):
            return Path.touch, (tmp_path / "owned",)

    source = inspect.getsource(importlib.import_module("ukf_sim.remote"))
    assert "pickle" not in source
    assert ".recv()" not in source
    ours, theirs = Pipe()
    theirs.send(Attack())
    with pytest.raises(ValueError, match=r"."):
        _receive(ours)
    assert not (tmp_path / "owned").exists()


def test_simulators_that_there_are_not():
    with pytest.raises(ValueError, match=r"^backend must be cosim:verilator or cosim:icarus, not"):
        make_backend("cosim:vcs", TINY)


def test_simulator_that_fails(icarus, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(SimulatorError, match=r"^cache must be a folder, not the file "):
        RemoteBus(TINY, simulator=icarus, cache=tmp_path / "file")
