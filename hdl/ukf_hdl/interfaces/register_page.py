"""Register documentation of one core, in Markdown."""

from typing import Any

from ukf_sw.spec.core import Core
from ukf_sw.spec.sequence import ENDINGS, STEPS, WAYS, Flag, Way

__all__ = ["register_page"]


def register_page(record: dict[str, Any]) -> str:
    """Render registers and buffer of a core as a page of Markdown.

    Parameters
    ----------
    record
        Description of the core.
    """
    lines = [
        f"# Registers of {record['name']}",
        "",
        f"{Core.from_record(record).description}.",
        "",
        f"Addresses are in bytes, {record['address_width']} bits wide. A word has 32 bits.",
        "",
        "| Offset | Register | Bits | Field | Access | Reset | Meaning |",
        "|-------:|----------|-----:|-------|--------|------:|---------|",
    ]
    for register in record["registers"]:
        for field in sorted(register["fields"], key=lambda field: -field["lsb"]):
            top = field["lsb"] + field["width"] - 1
            bits = f"{top}:{field['lsb']}" if field["width"] > 1 else str(top)
            lines.append(
                f"| `{register['offset']:#04x}` | `{register['name']}` | {bits} "
                f"| `{field['name']}` | {field['access']} | `{field['reset']:#x}` "
                f"| {field['doc']} |"
            )
    strides = f"i * {record['row_stride']:#x} + j * {record['element_bytes']}"
    lines += [
        "",
        "## Buffer",
        "",
        f"Element (i, j) of a region is at base + {strides}.",
        "",
        "| Base | Region | Shape | Meaning |",
        "|-----:|--------|-------|---------|",
    ]
    lines += [
        f"| `{region['base']:#06x}` | `{region['symbol']}` | {region['rows']} x "
        f"{region['columns']} | {region['doc']} |"
        for region in record["regions"]
    ]
    lines += [
        "",
        "## Steps",
        "",
        "A step takes the first of its ways whose flag is set, and is illegal if there is none.",
        "All flags but `PREDICTED` can be read in `STATUS`.",
        "",
        "| Step | Needs | Runs | Leaves set | Leaves cleared |",
        "|------|-------|------|------------|----------------|",
    ]
    lines += [
        f"| `{step.name}` | {_names(way.needs)} | {_run(way)} |"
        for step in STEPS
        for way in WAYS[step]
    ]
    return "\n".join([*lines, ""])


def _names(flags: Flag) -> str:
    """Names of flags."""
    return ", ".join(f"`{flag.name}`" for flag in Flag if flag in flags) or "–"


def _run(way: Way) -> str:
    """What a way runs and, if that succeeds, leaves."""
    if way.program is None:
        return "nothing, it ends at once | – | –"
    change = ENDINGS[way.program].success
    return f"`{way.program.name}` | {_names(change.sets)} | {_names(change.clears)}"
