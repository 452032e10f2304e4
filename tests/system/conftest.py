"""Fixtures of the system tests."""

import pytest

from support.command_line import runner_of
from ukf_tools.cli import app


@pytest.fixture
def ukf(tmp_path, monkeypatch):
    """Function that runs the command in an empty folder."""
    return runner_of(app, tmp_path, monkeypatch)


@pytest.fixture
def ukf_with_cores(ukf, tmp_path, core_cache):
    """Function that runs a command where the compiled cores of other sessions are."""
    core_cache.mkdir(parents=True, exist_ok=True)
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "cosim").symlink_to(core_cache)
    return ukf
