"""Fixtures of the system tests."""

import pytest
from typer.testing import CliRunner

from ukf_tools.cli import app


@pytest.fixture
def ukf(tmp_path, monkeypatch):
    """Function that runs the command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    # Messages must come out in one piece, whatever the terminal.
    monkeypatch.setenv("COLUMNS", "500")

    def ukf(*arguments, code=0):
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        if result.exit_code != code:
            print(result.output)
            if result.exception is not None and not isinstance(result.exception, SystemExit):
                raise result.exception
        assert result.exit_code == code
        return result

    return ukf
