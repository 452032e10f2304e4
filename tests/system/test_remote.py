"""The simulated core as a backend by name, in the process of a script."""

import numpy as np
import pytest

from ukf_sim.remote import RemoteBus
from ukf_sim.simulators import SimulatorError
from ukf_sw.backends import backend_names, make_backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import BusError, NotFiniteError, WrongCoreError
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.registers import ID, INTERRUPT_PENDING

pytestmark = pytest.mark.system

TINY = UkfParams(n=1, m=1, q=1, r=1)


def test_script_runs_on_the_simulated_core(icarus, tmp_path, monkeypatch):
    """All in one test, because a simulation takes long to start."""
    assert "cosim" in backend_names()
    monkeypatch.chdir(tmp_path)
    scenario = random_scenario(TINY, steps=3)
    ukf = scenario.filter("cosim:icarus")
    driver = ukf.backend
    assert isinstance(driver, Driver)
    results = run(scenario, driver)
    assert np.array_equal(results.x, run(scenario, "golden").x)
    assert driver.last_cycles["UPDATE"] > 0
    # Errors of the core arrive as they do from any other backend.
    with pytest.raises(NotFiniteError):
        driver.predict(np.full((1, TINY.N), np.inf))

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


def test_simulators_that_there_are_not():
    with pytest.raises(ValueError, match=r"^backend must be cosim:verilator or cosim:icarus, not"):
        make_backend("cosim:vcs", TINY)


def test_simulator_that_fails(icarus, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(SimulatorError, match="File exists"):
        RemoteBus(TINY, simulator=icarus, cache=tmp_path / "file")
