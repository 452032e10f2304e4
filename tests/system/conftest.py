"""Fixtures of the system tests."""

import pytest

from support.command_line import runner_of
from ukf_tools.cli import app


@pytest.fixture
def ukf(tmp_path, monkeypatch):
    """Function that runs the command in an empty folder."""
    return runner_of(app, tmp_path, monkeypatch)
