"""Tables and figures of docs/applications.md, from the results of ``ukf apps all``."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ukf_docs import DOCS
from ukf_docs.markdown import table, thousands
from ukf_sw.drivers.driver import Traffic

__all__ = ["DOCUMENT", "SECTIONS", "copy_figures", "read", "sections"]

DOCUMENT = DOCS / "applications.md"
#: Sections of the document that are made of these results.
SECTIONS = ("errors", "cosimulations", "swampsat", "platform")
number = "{:.4g}".format


def copy_figures(records: list[dict[str, Any]], folder: Path) -> list[Path]:
    """Copy the figures of records, without the backend in their names; gives the copies.

    Raises
    ------
    ValueError
        If a record has no figure, or it is not there any more.
    """
    folder.mkdir(parents=True, exist_ok=True)
    copies: list[Path] = []
    for record in records:
        if record["backend"] == "cosim":
            continue
        if not record["plots"]:
            raise ValueError(f"{record['name']} must have figures, not {record['plots']!r}")
        for plot in record["plots"]:
            source = Path(plot)
            if not source.is_file():
                raise ValueError(f"{record['name']} must have its figure, not without {plot!r}")
            copy = folder / source.name.replace(f"-{record['backend']}.png", ".png")
            copies.append(Path(shutil.copyfile(source, copy)))
    return copies


def sections(records: list[dict[str, Any]], study: dict[str, Any]) -> dict[str, str]:
    """Make the tables, in Markdown, by the name of their section.

    Parameters
    ----------
    records
        What ``ukf apps all`` wrote to errors.json.
    study
        What it wrote to swampsat.json.
    """
    made = (
        _errors([record for record in records if record["name"] != "swampsat study"]),
        _cosimulations(records),
        _study(study, records),
        _platform(study["platform"]),
    )
    return dict(zip(SECTIONS, made, strict=True))


def _errors(records: list[dict[str, Any]]) -> str:
    rows: list[tuple[str, ...]] = []
    for record in records:
        if record["backend"] == "cosim":
            continue
        verdicts = {(v["error"], v["measure"]): v for v in record["verdicts"]}
        rounding = {v["error"]: v for v in record["rounding"]}
        name = record["name"]
        for error in record["errors"]:
            label = f"{error['error']} / {error['unit']}" if error["unit"] else error["error"]
            for measure, value, other in (
                ("rms", error["rms"], error["float64_rms"]),
                ("maximum", error["maximum"], None),
            ):
                verdict = verdicts.get((error["error"], measure))
                if verdict is None and measure == "maximum":
                    continue
                bound = reference = "–"
                if verdict is not None:
                    bound = f"{number(verdict['low'])} to {number(verdict['high'])}"
                    bound += "" if verdict["okay"] else " **missed**"
                    reference = (
                        "–" if verdict["reference"] is None else number(verdict["reference"])
                    )
                    value = verdict["value"]
                difference = "–"
                if measure == "rms" and (beside := rounding.get(error["error"])) is not None:
                    difference = f"{beside['difference']:+.2%}"
                    difference += "" if beside["okay"] else " **missed**"
                kind = "largest " if measure == "maximum" else ""
                rows.append((
                    f"[{name}](#{name})" if name else "", str(record["runs"]) if name else "",
                    kind + label, number(value), "–" if other is None else number(other),
                    difference, reference, bound,
                ))  # fmt: skip
                name = ""
    headings = (
        "application", "runs", "error", "core", "float64", "difference", "reference", "bound",
    )  # fmt: skip
    return table(headings, rows, left=3)


def _cosimulations(records: list[dict[str, Any]]) -> str:
    headings = (
        "application", "PEs", "steps", "words equal", "cycles PREDICT + UPDATE", "words a step",
    )  # fmt: skip
    rows: list[tuple[object, ...]] = []
    for record in records:
        if record["backend"] != "cosim":
            continue
        cycles, words = record["cycles"], Traffic(**record["traffic"]).words
        equal = thousands(record["words_compared"]) if record["okay"] else "**differs**"
        rows.append((
            record["name"], record["pes"], record["steps"], equal,
            f"{cycles['PREDICT']} + {cycles['UPDATE']}", words,
        ))  # fmt: skip
    return table(headings, rows)


def _median(found: dict[str, Any]) -> str:
    return "broke off" if found["median"] is None else f"{found['median']:.3g}"


def _study(study: dict[str, Any], records: list[dict[str, Any]]) -> str:
    """Medians beside their reference; how many filters diverged."""
    (record,) = (record for record in records if record["name"] == "swampsat study")
    verdicts = {verdict["error"]: verdict for verdict in record["verdicts"]}
    columns = {"quest_sample": "QUEST at sample", "quest_held": "QUEST held", "ekf": "EKF"}
    columns |= {"ukf_reference": "UKF float64", "ukf_golden": "UKF golden"}
    rows: list[Sequence[str]] = []
    for row in study["rows"]:
        cells = [row["name"], str(len(row["ekf"]["seeds"]))]
        for column, label in columns.items():
            found = row[column]
            cell = _median(found)
            if not column.startswith("quest") and found["diverged"]:
                cell += f", {found['diverged']} diverged"
            verdict = verdicts.get(f"{row['name']}, {label}")
            if verdict is not None and verdict["reference"] is not None:
                other = number(verdict["reference"])
                cell += (
                    f" ({other} diverged)" if verdict["measure"] == "diverged" else f" ({other})"
                )
            if verdict is not None and not verdict["okay"]:
                cell += " **missed**"
            cells.append(cell)
        rows.append(cells)
    eclipse = study["eclipse"]
    for key, name in (
        ("sunlit", "2 s, an orbit, no eclipse"),
        ("eclipse", "2 s, an orbit, eclipse"),
    ):
        found = eclipse[key]
        rows.append((
            name, str(len(eclipse["seeds"])), "–", "–", _median(found["ekf"]),
            _median(found["ukf_reference"]), "–",
        ))  # fmt: skip
    return table(("interval", "flights", *columns.values()), rows)


def _platform(platform: dict[str, Any]) -> str:
    headings = (
        "latency each way / s", "lost", "mean age / s", "replies used", "naive", "compensated",
    )  # fmt: skip
    rows: list[tuple[str, ...]] = []
    # The delay of the losses may be among the others.
    points = {(p["latency_s"], p["loss"]): p for key in ("delays", "losses") for p in platform[key]}
    for point in points.values():
        age = "–" if point["age_s"] is None else f"{point['age_s']:.2f}"
        rows.append((
            f"{point['latency_s']:g}", f"{100 * point['loss']:g} %", age,
            f"{100 * point['used']:.0f} %", _median(point["naive"]),
            _median(point["compensated"]),
        ))  # fmt: skip
    return table(headings, rows, left=0)


def read(folder: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Read the results of ``ukf apps all``: its records, and the study of SwampSat.

    Raises
    ------
    OSError
        If they are not there.
    """
    records = json.loads((folder / "errors.json").read_text(encoding="utf-8"))
    return records, json.loads((folder / "swampsat.json").read_text(encoding="utf-8"))
