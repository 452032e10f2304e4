"""What tests of tracing share."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ukf_sw.tracing.graph import Graph
from ukf_sw.tracing.tracer import Call, trace


def call_of(function: Callable[..., Any], rows: int, **changes: Any) -> Call:
    """How a process model of three states, three noise terms and a number u is called."""
    usual = {
        "name": "process model f (f)", "states": 3, "noise": "w", "terms": 3,
        "positional": {"u": 0.5}, "keywords": {},
    }  # fmt: skip
    return Call(function=function, rows=rows, **{**usual, **changes})


def graph_of(function: Callable[..., Any], rows: int = 1, **changes: Any) -> Graph:
    """Trace a model."""
    return trace(call_of(function, rows, **changes))


def of_pair(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a model of x of a function of two vectors of 3 that gives anything."""

    def model(x: Any, w: Any, u: Any) -> Any:
        found = function(x, w)
        if isinstance(found, (tuple, list)):
            found = np.concatenate([np.atleast_1d(part).reshape(-1) for part in found])
        return np.asarray(found).reshape(-1)

    return model
