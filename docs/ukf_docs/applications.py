"""Tables and figures of docs/applications.md, from the results of ``ukf apps all``."""

import json
import shutil
from pathlib import Path
from typing import Any

from ukf_docs.studies.iteration import load, timing_table

__all__ = ["copy_figures", "read", "sections", "update_document"]

number = "{:.4g}".format
BEGIN, END = "<!-- BEGIN {} -->", "<!-- END {} -->"


def update_document(file: Path, made: dict[str, str]) -> None:
    """Replace the tables between the markers of a document.

    Parameters
    ----------
    file
        Document.
    made
        Tables, in Markdown, by the name of their markers.

    Raises
    ------
    ValueError
        If a marker is missing.
    """
    text = file.read_text(encoding="utf-8")
    for name, table in made.items():
        begin, end = BEGIN.format(name), END.format(name)
        before, found, rest = text.partition(begin)
        _, found_end, after = rest.partition(end)
        if not (found and found_end):
            raise ValueError(f"{file.name} must have the markers {begin} and {end}")
        text = f"{before}{begin}\n\n{table}\n\n{end}{after}"
    file.write_text(text, encoding="utf-8")


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
    """Make the tables, in Markdown, by the name of their markers.

    Parameters
    ----------
    records
        What ``ukf apps all`` wrote to errors.json.
    study
        What it wrote to swampsat.json.
    """
    return {
        "errors": _errors([record for record in records if record["name"] != "swampsat study"]),
        "cosimulations": _cosimulations(records),
        "timing": timing_table(load()),
        "swampsat": _study(study, records),
        "platform": _platform(study["platform"]),
    }


def _errors(records: list[dict[str, Any]]) -> str:
    rows = [
        "| application | runs | error | core | float64 | reference | bound |",
        "|---|---:|---|---:|---:|---:|---|",
    ]
    for record in records:
        if record["backend"] == "cosim":
            continue
        verdicts = {(v["error"], v["measure"]): v for v in record["verdicts"]}
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
                kind = "largest " if measure == "maximum" else ""
                cells = (
                    f"[{name}](#{name})" if name else "", str(record["runs"]) if name else "",
                    kind + label, number(value), "–" if other is None else number(other),
                    reference, bound,
                )  # fmt: skip
                rows.append("| " + " | ".join(cells) + " |")
                name = ""
    return "\n".join(rows)


def _cosimulations(records: list[dict[str, Any]]) -> str:
    rows = [
        "| application | PEs | steps | words equal | cycles PREDICT + UPDATE | words a step |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for record in records:
        if record["backend"] != "cosim":
            continue
        cycles, traffic = record["cycles"], record["traffic"]
        words = traffic["words_read"] + traffic["words_written"]
        equal = (
            f"{record['words_compared']:,}".replace(",", " ") if record["okay"] else "**differs**"
        )
        rows.append(
            f"| {record['name']} | {record['pes']} | {record['steps']} | {equal} "
            f"| {cycles['PREDICT']} + {cycles['UPDATE']} | {words} |"
        )
    return "\n".join(rows)


def _median(found: dict[str, Any]) -> str:
    return "broke off" if found["median"] is None else f"{found['median']:.3g}"


def _study(study: dict[str, Any], records: list[dict[str, Any]]) -> str:
    """Medians beside their reference; how many filters diverged."""
    (record,) = (record for record in records if record["name"] == "swampsat study")
    verdicts = {verdict["error"]: verdict for verdict in record["verdicts"]}
    columns = {"quest_sample": "QUEST at sample", "quest_held": "QUEST held", "ekf": "EKF"}
    columns |= {"ukf_reference": "UKF float64", "ukf_golden": "UKF golden"}
    rows = [
        "| interval | flights | " + " | ".join(columns.values()) + " |",
        "|---|---:|" + "---:|" * len(columns),
    ]
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
        rows.append("| " + " | ".join(cells) + " |")
    eclipse = study["eclipse"]
    for key, name in (
        ("sunlit", "2 s, an orbit, no eclipse"),
        ("eclipse", "2 s, an orbit, eclipse"),
    ):
        found = eclipse[key]
        cells = (name, str(len(eclipse["seeds"])), "–", "–", _median(found["ekf"]),
                 _median(found["ukf_reference"]), "–")  # fmt: skip
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def _platform(platform: dict[str, Any]) -> str:
    rows = [
        "| latency each way / s | lost | mean age / s | replies used | naive | compensated |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    # The delay of the losses may be among the others.
    points = {(p["latency_s"], p["loss"]): p for key in ("delays", "losses") for p in platform[key]}
    for point in points.values():
        age = "–" if point["age_s"] is None else f"{point['age_s']:.2f}"
        rows.append(
            f"| {point['latency_s']:g} | {100 * point['loss']:g} % | {age} "
            f"| {100 * point['used']:.0f} % | {_median(point['naive'])} "
            f"| {_median(point['compensated'])} |"
        )
    return "\n".join(rows)


def read(folder: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Read the results of ``ukf apps all``: its records, and the study of SwampSat.

    Raises
    ------
    OSError
        If they are not there.
    """
    records = json.loads((folder / "errors.json").read_text(encoding="utf-8"))
    return records, json.loads((folder / "swampsat.json").read_text(encoding="utf-8"))
