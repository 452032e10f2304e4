"""Rows of a sweep in series: cores that differ in their number of processing elements only."""

from collections.abc import Sequence
from typing import Any

from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import PARAMETERS
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.parameters import Noise

__all__ = ["FACTORS", "PROBLEM", "Row", "comparable", "in_series", "said", "varying"]

Row = dict[str, Any]

#: What tells cores apart, but for the number of processing elements.
FACTORS = ("problem", *(label for label in PARAMETERS if label != "pes"))
#: What a problem says.
PROBLEM = tuple(label for label, entry in PARAMETERS.items() if entry.meaning.problem)


def varying(rows: Sequence[Row]) -> list[str]:
    """Name the factors that differ between rows. The problem stands for its sizes."""
    names = [name for name in FACTORS if len({row[name] for row in rows}) > 1]
    if "problem" in names and all(row["problem"] is not None for row in rows):
        names = [name for name in names if name not in PROBLEM]
    return names


def said(name: str, value: Any) -> str:
    """Say a factor of a core."""
    if name != "problem":
        return PARAMETERS[name].said(value)
    return "sizes" if value is None else value


def in_series(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Group rows by everything but the number of processing elements.

    Returns
    -------
    dict
        Rows by the name of their series, with rising numbers of processing elements. The name
        has what differs between series, or the form if nothing does.
    """
    names = varying(rows) or ["form"]
    groups: dict[str, list[Row]] = {}
    for row in rows:
        label = ", ".join(said(name, row[name]) for name in names)
        groups.setdefault(label, []).append(row)
    return {label: sorted(group, key=lambda row: row["pes"]) for label, group in groups.items()}


def comparable(row: Row) -> bool:
    """Whether a core does what the 2018 paper's does: its sizes, its noise, single precision."""
    p = NANOSAT
    return (
        (row["n"], row["m"], row["q"], row["r"]) == (p.n, p.m, p.q, p.r)
        and row["process_noise"] == row["observation_noise"] == Noise.AUGMENTED.value
        and row["format"] == BINARY32.name
    )
