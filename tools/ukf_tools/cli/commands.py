"""What becomes of a command line that is wrong: a message like all others, with rule and value."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from ukf_sw.problems.logs import LogWarning
from ukf_tools.cli.console import print_error, print_warning

__all__ = ["Commands"]

#: What Typer raises about a command line: it has had several homes.
_CommandLineError: Any = typer.BadParameter.__mro__[2]

#: Rules of Typer's options, by what Pydantic calls a value that breaks them.
_RULES = {
    "int_parsing": "a whole number",
    "float_parsing": "a number",
    "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le:g}",
}


def _complaint(error: Any) -> str:
    """Say which option is wrong, the rule and the value."""
    found = getattr(error.__cause__, "errors", None)
    if found is None:  # nothing was given, or an older Typer has said it all
        return error.format_message().strip()
    first = found()[0]
    option = error.param.opts[0]
    rule = _RULES.get(first["type"])
    if rule is None:
        return f"{option}: {first['msg'].removeprefix('Value error, ')}"
    value = first["input"] if "{" in rule else repr(first["input"])
    return f"{option} must be {rule.format(**first.get('ctx', {}))}, not {value}"


@contextmanager
def _told() -> Iterator[None]:
    """Print warnings about the user's data as messages; others are as they were."""
    with warnings.catch_warnings():
        warnings.simplefilter("default", LogWarning)
        show = warnings.showwarning

        def tell(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, LogWarning):
                print_warning(str(message))
            else:
                show(message, category, *where, **more)

        warnings.showwarning = tell
        yield


class Commands(TyperGroup):
    """Commands whose complaints are those of this project."""

    def main(self, *arguments: Any, standalone_mode: bool = True, **options: Any) -> Any:
        """Run a command; see :class:`typer.core.TyperGroup`."""
        if not standalone_mode:
            return super().main(*arguments, standalone_mode=False, **options)
        try:
            with _told():
                code = super().main(*arguments, standalone_mode=False, **options)
        except typer.BadParameter as error:
            print_error(_complaint(error))
            sys.exit(2)
        except _CommandLineError as error:
            error.show()
            sys.exit(error.exit_code)
        except (typer.Abort, KeyboardInterrupt):
            sys.exit(130)
        sys.exit(code or 0)
