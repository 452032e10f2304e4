"""Tables of the page: the 2018 paper's beside ours, devices, growth, and all figures."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from ukf_tools.design_report import paper_2018
from ukf_tools.design_report.growth import growths
from ukf_tools.design_report.series import FACTORS, Row, comparable, in_series
from ukf_tools.design_space.devices import DEVICES
from ukf_tools.design_space.rows import COLUMNS

__all__ = ["Cell", "Table", "everything", "tables", "text"]

_NAMES = {
    "cycles": "cycles", "lut": "LUT", "ff": "FF", "dsp48e1": "DSP48E1", "bram36": "BRAM36",
    "bus_words": "bus words", "n": "states", "pes": "processing elements",
}  # fmt: skip


class Cell(NamedTuple):
    """An entry of a table.

    Parameters
    ----------
    text
        What it shows.
    number
        Whether it is a number.
    bad
        Whether it is a limit exceeded.
    """

    text: str
    number: bool = True
    bad: bool = False


class Table(NamedTuple):
    """A table.

    Parameters
    ----------
    section, title, caption
        Heading under which it stands, what it shows, and what to know about it.
    heads
        Heading of each column.
    rows
        Entries.
    """

    section: str
    title: str
    caption: str
    heads: tuple[str, ...]
    rows: list[list[Cell]]


def tables(rows: Sequence[Row]) -> list[Table]:
    """Make the tables that the rows of a sweep allow."""
    return [
        table
        for table in (_table_2(rows), _table_4(rows), _devices(rows), _growth(rows))
        if table is not None
    ]


def _text(text: str) -> Cell:
    return Cell(text, number=False)


def _grouped(value: float | None, digits: int = 0) -> Cell:
    """Number with thin spaces between thousands."""
    if value is None:
        return Cell("–")
    if isinstance(value, float) and not value.is_integer():
        digits = digits or 1
    return Cell(f"{value:,.{digits}f}".replace(",", "\u202f"))


def _table_2(rows: Sequence[Row]) -> Table | None:
    """Table 2: resources."""
    entries: list[list[Cell]] = []
    for label, group in in_series(rows).items():
        for row in group:
            if row["lut"] is None or not comparable(row):
                continue
            used = paper_2018.RESOURCES.get(row["pes"])
            entries.append([
                _text(label), _grouped(row["pes"]),
                _grouped(row["lut"]), _grouped(used.lut if used else None),
                _grouped(row["ff"]), _grouped(used.ff if used else None),
                _grouped(row["dsp48e1"]), _grouped(used.dsp if used else None),
                _grouped(row["bram36"]), _grouped(used.bram36 if used else None),
            ])  # fmt: skip
    if not entries:
        return None
    return Table(
        "The 2018 paper", "Table 2: resources",
        "Ours: Yosys, xc7, before packing. Paper: Vivado on an XC7Z045, after implementation.",
        ("core", "PEs", "LUT", "paper", "FF", "paper", "DSP48E1", "paper", "BRAM36", "paper"),
        entries,
    )  # fmt: skip


def _table_4(rows: Sequence[Row]) -> Table | None:
    """Table 4: latency."""
    entries: list[list[Cell]] = []
    for label, group in in_series(rows).items():
        for row in group:
            if row["iteration_us"] is None or not comparable(row):
                continue
            paper = paper_2018.LATENCY.get(row["pes"])
            entries.append([
                _text(label), _grouped(row["pes"]),
                _grouped(row["predict_cycles"] / row["clock_mhz"], 2),
                _grouped(row["update_cycles"] / row["clock_mhz"], 2),
                _grouped(row["core_us"], 2), _grouped(paper.core if paper else None, 1),
                _grouped(row["bus_us"], 1), _grouped(paper_2018.BUS_US if paper else None),
                _grouped(row["iteration_us"], 1),
                _grouped(paper.core + paper_2018.BUS_US if paper else None, 1),
            ])  # fmt: skip
    if not entries:
        return None
    first = next(row for row in rows if comparable(row) and row["iteration_us"] is not None)
    return Table(
        "The 2018 paper", "Table 4: time of an iteration in µs",
        f"Ours: schedule at {first['clock_mhz']:g} MHz, and {first['bus_words']} bus words and "
        f"{first['register_words']} of registers at {first['word_clocks']:g} clocks each. Paper: "
        f"its core without the models; its bus took {paper_2018.BUS_US:g} µs of the "
        f"{paper_2018.LATENCY[1].system_model:g} µs of its system models. Computing the models is "
        "left out of both.",
        ("core", "PEs", "PREDICT", "UPDATE", "core", "paper", "bus", "paper", "sum", "paper"),
        entries,
    )  # fmt: skip


def _devices(rows: Sequence[Row]) -> Table | None:
    """Largest share of each device, and of what."""
    entries: list[list[Cell]] = []
    for label, group in in_series(rows).items():
        for row in group:
            if row["lut"] is None:
                continue
            cells = [_text(label), _grouped(row["pes"])]
            for device in DEVICES:
                shares = {
                    _NAMES[name]: row[name] / getattr(device, name)
                    for name in ("lut", "ff", "dsp48e1", "bram36")
                }
                cells += [
                    Cell(f"{share:.1%}", bad=share > 1.0) for share in shares.values()
                ]  # fmt: skip
            entries.append(cells)
    if not entries:
        return None
    heads = [f"{d.name} {what}" for d in DEVICES for what in ("LUT", "FF", "DSP", "BRAM")]
    return Table(
        "Devices", "Share of a device",
        "Of its programmable logic. More than 100 % does not fit, and routing gets hard well "
        "before: estimates are made before packing.",
        ("core", "PEs", *heads), entries,
    )  # fmt: skip


def _growth(rows: Sequence[Row]) -> Table | None:
    """Fitted exponents."""
    entries = [
        [
            _text(f"{_NAMES[g.figure]} over {_NAMES[g.over]}"), _text(g.group),
            Cell(f"{g.low} to {g.high}"), Cell(str(g.points)), Cell(f"{g.exponent:+.2f}"),
            Cell(f"{g.worst - 1.0:.0%}"),
        ]
        for g in growths(rows)
    ]  # fmt: skip
    if not entries:
        return None
    return Table(
        "Growth", "Fitted exponents",
        "A figure grows with this power of the number; the last column is how far the worst core "
        "is from the fitted line.",
        ("figure", "cores", "range", "points", "exponent", "worst"), entries,
    )  # fmt: skip


def text(value: Any) -> str:
    """Write a figure."""
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def everything(rows: Sequence[Row]) -> dict[str, Any]:
    """Give all figures for the table to sort and filter.

    Returns
    -------
    dict
        ``heads``: name, meaning, and whether it is a number, of each column with different
        entries; ``common``: what all rows have in common; ``docs``: meaning of every column;
        ``rows``: text and value to sort by of each entry; ``choices``: entries of each column
        with few different ones, to filter by.
    """
    names = [
        name
        for name in COLUMNS
        if any(row[name] is not None for row in rows)
        and (name == "pes" or len({row[name] for row in rows}) > 1)
    ]
    common = {
        name: text(rows[0][name])
        for name in COLUMNS
        if name not in names and rows[0][name] is not None
    }
    numeric = {name: COLUMNS[name].kind is not str for name in names}

    choices: dict[int, list[str]] = {}
    for number, name in enumerate(names):
        found = list(dict.fromkeys(text(row[name]) for row in rows))
        if name in (*FACTORS, "pes") and len(found) > 1:
            choices[number] = found
    return {
        "heads": [(name, COLUMNS[name].doc, numeric[name]) for name in names],
        "common": common,
        "docs": {name: column.doc for name, column in COLUMNS.items()},
        "rows": [
            [(text(row[name]), "" if row[name] is None else row[name]) for name in names]
            for row in rows
        ],
        "choices": choices,
    }
