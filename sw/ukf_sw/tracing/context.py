"""A trace that is under way: its nodes, and what it refuses."""

import re
import threading
from collections.abc import Callable
from typing import Any

from ukf_sw.errors import TraceError
from ukf_sw.tracing.builder import Builder
from ukf_sw.tracing.makers import tracing_makers
from ukf_sw.tracing.places import Place, place_below

__all__ = ["Trace"]

#: Names of the classes that record, in messages of others.
_CLASSES = re.compile("'(?:[a-z_]+\\.)*Traced(?:Array|Number)'|Traced(?:Array|Number)")
PLAIN = "write it with functions of NumPy, or with plain numbers"
#: One trace at a time: it replaces functions of NumPy for as long as it runs.
_ONE = threading.RLock()


class Trace:
    """A call of a model with numbers that record what is done with them.

    Parameters
    ----------
    model
        Name of the model, in messages.
    """

    def __init__(self, model: str) -> None:
        self.model = model
        self.builder = Builder()

    def call(self, function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
        """Call the model."""
        module = str(getattr(getattr(function, "func", function), "__module__", ""))
        with _ONE, tracing_makers(self, module.partition(".")[0]):
            try:
                return function(*arguments, **keywords)
            except TypeError as error:
                # What is written in C says that it got something of a class that it does not know.
                text = _CLASSES.sub("data", str(error))
                if text == str(error):
                    raise
                place = place_below(Trace.call.__code__, error)
                raise self.error(f"give data to what takes none ({text})", PLAIN, place) from error

    @property
    def place(self) -> Place | None:
        """Where in the model's source the trace is."""
        return place_below(Trace.call.__code__)

    def error(self, rule: str, remedy: str, place: Place | None = None) -> TraceError:
        """Make an error about what the model does here.

        Parameters
        ----------
        rule
            What it must not do.
        remedy
            What it could do instead.
        place
            Where it does so; None is found.
        """
        found = place or self.place
        if found is None:
            return TraceError(self.model, rule, remedy)
        return TraceError(self.model, rule, remedy, found.file, found.line, found.expression)
