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
        if record["backend"] == "cosim" or record["models"] != "software":
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


def _by_name(
    records: list[dict[str, Any]], *, simulated: bool
) -> dict[str, dict[str, dict[str, Any]]]:
    """Records of each application by where its models were: software first."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for record in records:
        if (record["backend"] == "cosim") is simulated:
            found.setdefault(record["name"], {})[record["models"]] = record
    return found


def _errors(records: list[dict[str, Any]]) -> str:
    """Errors of each application, with its models in software and on the core."""
    rows: list[tuple[str, ...]] = []
    for name, placed in _by_name(records, simulated=False).items():
        first = next(iter(placed.values()))
        bounds = {(v["error"], v["measure"]): v for v in first["verdicts"]}
        begin = [f"[{name}](#{name})", str(first["runs"])]
        for error in first["errors"]:
            for measure in ("rms", "maximum"):
                bound = bounds.get((error["error"], measure))
                if measure == "rms" or bound is not None:
                    rows.append((*begin, *_error(error, measure, placed, bound)))
                    begin = ["", ""]
    headings = (
        "application", "runs", "error", "float64", "in software", "difference", "on the core",
        "difference", "reference", "bound",
    )  # fmt: skip
    return table(headings, rows, left=3)


def _error(
    error: dict[str, Any],
    measure: str,
    placed: dict[str, dict[str, Any]],
    bound: dict[str, Any] | None,
) -> list[str]:
    """Cells of an error: its name, with the models in each place, and what it must be."""
    label = f"{error['error']} / {error['unit']}" if error["unit"] else error["error"]
    other = error["float64_rms"] if measure == "rms" else None
    cells = [
        ("largest " if measure == "maximum" else "") + label,
        "–" if other is None else number(other),
    ]
    missed = ""
    for models in ("software", "core"):
        record = placed.get(models, {"errors": []})
        own = next((each for each in record["errors"] if each["error"] == error["error"]), None)
        if own is None:  # not run, or stopped
            cells += ["–", "–"]
            continue
        cells.append(number(own[measure]))
        beside = {v["error"]: v for v in record["rounding"]}.get(error["error"])
        if measure == "rms" and beside is not None:
            cells.append(f"{beside['difference']:+.2%}{'' if beside['okay'] else ' **missed**'}")
        else:
            cells.append("–")
        for verdict in record["verdicts"]:
            if (verdict["error"], verdict["measure"]) == (error["error"], measure):
                missed = missed if verdict["okay"] else " **missed**"
    if bound is None:
        return [*cells, "–", "–"]
    reference = "–" if bound["reference"] is None else number(bound["reference"])
    return [*cells, reference, f"{number(bound['low'])} to {number(bound['high'])}{missed}"]


def _cosimulations(records: list[dict[str, Any]]) -> str:
    """What was compared of each application, and what an iteration took."""
    rows: list[tuple[object, ...]] = []
    for name, placed in _by_name(records, simulated=True).items():
        first = next(iter(placed.values()))
        row: list[object] = [name, first["pes"], first["steps"]]
        for models in ("software", "core"):
            record = placed.get(models)
            if record is None:
                row += ["–", "–", "–"]
                continue
            row += [
                thousands(record["words_compared"]) if record["okay"] else "**differs**",
                sum(record["cycles"].values()),
                Traffic(**record["traffic"]).words,
            ]
        rows.append(tuple(row))
    headings = (
        "application", "PEs", "steps", "in software: words equal", "cycles", "words",
        "on the core: words equal", "cycles", "words",
    )  # fmt: skip
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
