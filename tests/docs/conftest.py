"""Fixtures of the tests of the documents."""

import pytest

from support.command_line import runner_of
from ukf_docs.__main__ import app


@pytest.fixture
def documents(tmp_path, monkeypatch):
    """Function that runs `python -m ukf_docs` in an empty folder."""
    return runner_of(app, tmp_path, monkeypatch)
