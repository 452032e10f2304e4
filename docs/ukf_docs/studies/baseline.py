"""The filter wholly in software on a Cortex-A9, beside the core."""

from functools import partial
from pathlib import Path
from typing import Any

from ukf_docs import DOCS
from ukf_docs.studies.study import Study, Tell
from ukf_tools.baseline.report import markdown, measure

__all__ = ["STUDY"]

#: GSL for ARM, where ``make baseline`` puts it.
SYSROOT = Path("build/armhf")


def _measure(tell: Tell) -> dict[str, Any]:
    tell("Compiling and counting", 0, None)
    return measure(sysroot=SYSROOT)


def _table(name: str, record: dict[str, Any]) -> str:
    return markdown(record)[name]


STUDY = Study(
    name="baseline",
    document=DOCS / "baseline.md",
    measure=_measure,
    tables={name: partial(_table, name) for name in ("software", "core", "whole")},
)
