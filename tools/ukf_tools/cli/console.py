"""What every command shares: messages, results, progress."""

import functools
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
)
from rich.progress import TimeElapsedColumn as Elapsed

from ukf_sw.errors import UkfError, describe
from ukf_sw.extras import MissingExtraError, require
from ukf_tools.cli.names import in_options

__all__ = [
    "JsonOption",
    "PlainProgress",
    "checked",
    "fail",
    "make_progress",
    "messages",
    "needs",
    "number",
    "print_error",
    "print_files",
    "print_json",
    "print_warning",
    "progress_bars",
    "progress_teller",
    "results",
]

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
]

#: Progress and messages; standard output is for results.
messages = Console(stderr=True, emoji=False)
results = Console(emoji=False)


def print_error(message: str) -> None:
    """Print what is wrong."""
    messages.print(f"[bold red]Error:[/] {escape(message)}", highlight=False, soft_wrap=True)


def print_warning(message: str) -> None:
    """Print what is doubtful."""
    messages.print(f"[bold yellow]Warning:[/] {escape(message)}", highlight=False, soft_wrap=True)


def fail(message: str, code: int = 2) -> NoReturn:
    """Print a message, in which a value is called as its option, and exit."""
    print_error(in_options(message))
    raise typer.Exit(code)


def needs(*extras: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Have a command ask for extras before it begins; what is missing is told in a message.

    Further ones, which depend on options, it can ask for itself by :func:`ukf_sw.extras.require`.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def wrapped(*arguments: Any, **options: Any) -> None:
            try:
                require(*extras)
                command(*arguments, **options)
            except MissingExtraError as error:
                fail(str(error), 1)

        return wrapped

    return decorate


@contextmanager
def checked() -> Iterator[None]:
    """Turn complaints about arguments, and what the user's models raise, into messages."""
    try:
        yield
    except (ValueError, TypeError) as error:
        fail("\n".join([str(error), *getattr(error, "__notes__", [])]))
    except Exception as error:
        notes = getattr(error, "__notes__", [])
        if isinstance(error, UkfError) or not notes:
            raise
        fail("\n".join([describe(error), *notes]))


def print_json(record: Any) -> None:
    """Print a record for machines."""
    sys.stdout.write(json.dumps(record, indent=2) + "\n")


def print_files(files: Iterable[Path], *, as_json: bool = False) -> None:
    """Print files that were written, with their sizes."""
    if as_json:
        print_json({"files": [str(file) for file in files]})
        return
    for file in files:
        results.print(f"{file}  {file.stat().st_size} bytes", highlight=False, soft_wrap=True)


class PlainProgress(Progress):
    """Progress in lines of text, where bars would not show: on a pipe, in a log.

    A line says what is being done: at once when that changes, else every :attr:`interval` seconds.
    What is counted is told once a second at most.
    """

    interval = 10.0

    def __init__(self, **options: Any) -> None:
        super().__init__(disable=True, **options)
        self._told: dict[TaskID, tuple[str, float]] = {}

    def add_task(self, description: str, *arguments: Any, **options: Any) -> TaskID:
        """See :class:`rich.progress.Progress`."""
        task = super().add_task(description, *arguments, **options)
        self._tell(task)
        return task

    def update(self, task_id: TaskID, **options: Any) -> None:
        """See :class:`rich.progress.Progress`."""
        super().update(task_id, **options)
        self._tell(task_id)

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """See :class:`rich.progress.Progress`."""
        super().advance(task_id, advance)
        self._tell(task_id)

    def _tell(self, number: TaskID) -> None:
        task = next(task for task in self.tasks if task.id == number)
        before, since = self._told.get(number, ("", -math.inf))
        counted = task.total is not None
        wait = self.interval if task.description == before else 1.0 * counted
        if time.monotonic() - since < wait:
            return
        self._told[number] = (task.description, time.monotonic())
        done = f", {task.completed:.0f} of {task.total:.0f}" if counted else ""
        self.console.print(
            f"{task.description}{done}", highlight=False, soft_wrap=True, markup=False
        )


def make_progress(*columns: ProgressColumn, **options: Any) -> Progress:
    """Make bars of these columns, which go away at the end; lines if there is no terminal."""
    if not messages.is_terminal:
        return PlainProgress(console=messages)
    return Progress(*columns, console=messages, transient=True, **options)


@contextmanager
def progress_bars(*, counted: bool = True) -> Iterator[Progress]:
    """Show bars, which go away at the end."""
    columns = [SpinnerColumn(), TextColumn("{task.description}"), BarColumn()]
    if counted:
        columns.append(MofNCompleteColumn())
    with make_progress(*columns, Elapsed()) as bars:
        yield bars


@contextmanager
def progress_teller() -> Iterator[Callable[[str, float, float | None], None]]:
    """Show one bar; what it yields says what is being done, how much is done, and of how much."""
    with progress_bars() as bars:
        bar = bars.add_task("Starting", total=None)

        def tell(what: str, done: float, total: float | None) -> None:
            bars.update(bar, description=what, completed=done, total=total)

        yield tell


def number(value: float | None) -> str:
    """Four digits, or a dash."""
    return "-" if value is None else f"{value:.4g}"
