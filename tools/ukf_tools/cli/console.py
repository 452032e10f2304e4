"""What every command shares: messages, results, progress."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn
from rich.progress import TimeElapsedColumn as Elapsed

__all__ = [
    "JsonOption",
    "checked",
    "fail",
    "messages",
    "number",
    "print_files",
    "print_json",
    "progress_bars",
    "progress_teller",
    "results",
]

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
]

#: Progress and messages; standard output is for results.
messages = Console(stderr=True)
results = Console()


def fail(message: str, code: int = 2) -> NoReturn:
    """Print a message and exit."""
    messages.print(f"[bold red]Error:[/] {message}", highlight=False, soft_wrap=True)
    raise typer.Exit(code)


@contextmanager
def checked() -> Iterator[None]:
    """Turn complaints about arguments into messages."""
    try:
        yield
    except (ValueError, TypeError) as error:
        fail(str(error))


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


@contextmanager
def progress_bars(*, counted: bool = True) -> Iterator[Progress]:
    """Show bars, which go away at the end."""
    columns = [SpinnerColumn(), TextColumn("{task.description}"), BarColumn()]
    if counted:
        columns.append(MofNCompleteColumn())
    with Progress(*columns, Elapsed(), console=messages, transient=True) as bars:
        yield bars


@contextmanager
def progress_teller() -> Iterator[Callable[[str, int, int | None], None]]:
    """Show one bar; what it yields says what is being done, how much is done, and of how much."""
    with progress_bars() as bars:
        bar = bars.add_task("Starting", total=None)

        def tell(what: str, done: int, total: int | None) -> None:
            bars.update(bar, description=what, completed=done, total=total)

        yield tell


def number(value: float | None) -> str:
    """Four digits, or a dash."""
    return "-" if value is None else f"{value:.4g}"
