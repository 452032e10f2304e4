"""The cores of a sweep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from ukf_sw.problems.placing import core_models
from ukf_sw.spec.core import PARAMETERS, Core

__all__ = ["Point", "grid"]

#: What varies fastest in a grid, so that cores that differ in it only stand side by side.
_FASTEST = "pes"


@dataclass(frozen=True, kw_only=True)
class Point:
    """A core of a sweep, which need not be legal: :attr:`core` says so.

    Parameters
    ----------
    problem
        Name of the problem that it is for, or None.
    redraw
        Whether the filter draws sigma points after every predict, as :class:`Core` has it.
    values
        Parameters by label; those that are missing have their defaults.
    """

    problem: str | None = None
    redraw: bool | None = None
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @classmethod
    def of(cls, core: Core, **changes: Any) -> "Point":
        """Make the point of a core, with some parameters, by label, changed."""
        return cls(problem=core.problem, redraw=core.redraw, values=core.values() | changes)

    @property
    def core(self) -> Core:
        """The core.

        Raises
        ------
        ValueError
            If there is no such core, with more processing elements than columns for instance.
        """
        return Core.from_values(self.values, self.problem, redraw=self.redraw, place=core_models)

    def cells(self) -> dict[str, Any]:
        """What tells this core from others, by name of the column."""
        return {
            "problem": self.problem,
            **{
                label: entry.cell(self.values.get(label, entry.default))
                for label, entry in PARAMETERS.items()
            },
        }


def grid(bases: Sequence[Point], **axes: Sequence[Any]) -> list[Point]:
    """Make the points of a full grid, without duplicates.

    Parameters
    ----------
    bases
        What is varied.
    axes
        Values of parameters by label; all are combined with each base. One may be the label of a
        parameter before it, to which it is equal then, as in ``n=(2, 3), q=("n",)``.

    Raises
    ------
    ValueError
        If there is nothing of one of them.
    """
    for label, entries in {"bases": bases, **axes}.items():
        if not entries:
            raise ValueError(f"{label} must have at least one entry, not {entries!r}")
    labels = sorted(axes, key=lambda label: label == _FASTEST)
    points: dict[tuple[Any, ...], Point] = {}
    for base, *entries in product(bases, *(axes[label] for label in labels)):
        chosen = dict(zip(labels, entries, strict=True))
        values = dict(base.values)
        for label in (label for label in PARAMETERS if label in chosen):
            value = chosen[label]
            values[label] = values[value] if isinstance(value, str) else value
        points.setdefault((base.problem, *values.items()), replace(base, values=values))
    return list(points.values())
