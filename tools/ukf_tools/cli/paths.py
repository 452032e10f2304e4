"""Options that are folders and files. Each is judged before its command begins."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import typer

from ukf_sw.folders import check_file, check_folder
from ukf_tools.cli.console import checked

__all__ = ["IMAGES", "file_option", "folder_option", "source_option"]

#: How images may end.
IMAGES = (".png", ".svg", ".pdf", ".jpg")


def _parser(judge: Callable[..., Path], option: str, *more: Any) -> Callable[[Any], Path]:
    """Make what Typer calls with a path, given or default."""

    def parse(path: Any) -> Path:
        with checked():
            return judge(option, path, *more)

    return parse


def folder_option(option: str, help: str, **rest: Any) -> Any:
    """Make the option of a folder to write to.

    Parameters
    ----------
    option, help
        Its name and its help.
    **rest
        As ``typer.Option`` takes them.
    """
    return typer.Option(
        option, help=help, metavar="FOLDER", parser=_parser(check_folder, option), **rest
    )


def file_option(option: str, help: str, kinds: Sequence[str] = (), **rest: Any) -> Any:
    """Make the option of a file to write; its name ends with one of the kinds, if there are any.

    Parameters
    ----------
    option, help, rest
        As for :func:`folder_option`.
    kinds
        As for :func:`ukf_sw.folders.check_file`.
    """
    return typer.Option(
        option, help=help, metavar="FILE", parser=_parser(check_file, option, kinds), **rest
    )


def _check_source(option: str, path: Any, what: str, metavar: str) -> Path:
    there = Path(path).is_file() if metavar == "FILE" else Path(path).is_dir()
    if not (os.fspath(path) and there):
        raise ValueError(f"{option} must be {what}, not {os.fspath(path)!r}")
    return Path(path)


def source_option(option: str, help: str, what: str, metavar: str) -> Any:
    """Make the option of a file or folder to read.

    Parameters
    ----------
    option, help
        As ``typer.Option`` takes them.
    what
        What it must be, for the message if it is not there.
    metavar
        FILE or FOLDER.
    """
    return typer.Option(
        option, help=help, metavar=metavar, parser=_parser(_check_source, option, what, metavar)
    )
