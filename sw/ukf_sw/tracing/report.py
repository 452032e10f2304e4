"""What a traced model consists of, as the command line shows it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ukf_sw.errors import FormatOverflowError
from ukf_sw.problem import Problem
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.tracing.listing import listing
from ukf_sw.tracing.models import TracedModel
from ukf_sw.tracing.operations import Operation

__all__ = ["Constant", "constants_of", "listing_of", "record_of"]


@dataclass(frozen=True, kw_only=True)
class Constant:
    """A constant of a model in the format of a core.

    Parameters
    ----------
    value
        As the model has it.
    rounded
        As the core has it.
    """

    value: float
    rounded: float

    @property
    def exact(self) -> bool:
        """Whether the core has it exactly."""
        return self.value == self.rounded


def constants_of(model: TracedModel, format: FloatFormat) -> tuple[Constant, ...]:
    """Round the constants of a model to a format.

    Raises
    ------
    FormatOverflowError
        If one is too large for it.
    """
    found: list[Constant] = []
    for value in model.graph.constants:
        rounded = float(format.round(value))
        if np.isfinite(value) and not np.isfinite(rounded):
            raise FormatOverflowError(f"each constant of {model.name}", value, format.max_finite)
        found.append(Constant(value=value, rounded=rounded))
    return tuple(found)


def _labels(model: TracedModel, problem: Problem) -> dict[str, str]:
    """Names that the problem gives to inputs."""
    found = {f"x[{row}]": name for row, name in enumerate(problem.states)}
    names = tuple(problem.inputs)
    found |= {f"u[{k}]": name for k, name in enumerate(names)}
    if len(names) == 1:
        found["u"] = names[0]
    return found


def _rows(model: TracedModel, problem: Problem) -> list[str]:
    """Names of the results."""
    if model.sensor is not None:
        return [*cast("Mapping[str, str]", problem.sensor(model.sensor).observations)]
    return [f"x[{row}]" for row in range(model.call.rows)]


def listing_of(model: TracedModel, problem: Problem) -> str:
    """Write the operations of a model."""
    return listing(model.graph, _rows(model, problem))


def _counts(counts: Mapping[Operation, int]) -> dict[str, int]:
    return {operation.label: count for operation, count in counts.items()}


def record_of(model: TracedModel, problem: Problem, format: FloatFormat) -> dict[str, Any]:
    """Give all that is known of a model, ready for JSON.

    Raises
    ------
    FormatOverflowError
        If a constant is too large for the format.
    """
    graph = model.graph
    labels = _labels(model, problem)
    return {
        "model": "f" if model.sensor is None else "h",
        "sensor": model.sensor,
        "title": model.title,
        "constant_arguments": {name: str(value) for name, value in model.constants.items()},
        "inputs": [
            {
                "label": source.label,
                "name": labels.get(source.label),
                "per_point": source.per_point,
            }
            for source in graph.inputs
        ],
        "rows": _rows(model, problem),
        "operations": {
            "per_point": _counts(graph.counts(per_point=True)),
            "once": _counts(graph.counts(per_point=False)),
        },
        "functions": [operation.label for operation in graph.functions],
        "constants": [
            {"value": entry.value, "rounded": entry.rounded, "exact": entry.exact}
            for entry in constants_of(model, format)
        ],
        "depth": graph.depth,
    }
