"""Runs commands in the process of the test."""

from typer.testing import CliRunner

__all__ = ["runner_of"]


def runner_of(app, folder, monkeypatch):
    """Make a function that runs a command in a folder and checks its exit code.

    Parameters
    ----------
    app : typer.Typer
        The commands.
    folder : Path
        Working folder.
    monkeypatch : pytest.MonkeyPatch
        Of the test.
    """
    monkeypatch.chdir(folder)
    # Messages must come out in one piece, whatever the terminal.
    monkeypatch.setenv("COLUMNS", "500")

    def run(*arguments, code=0):
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        if result.exit_code != code:
            print(result.output)
            if result.exception is not None and not isinstance(result.exception, SystemExit):
                raise result.exception
        assert result.exit_code == code
        return result

    return run
