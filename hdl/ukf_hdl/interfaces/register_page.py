"""Register documentation of one core, in Markdown."""

from typing import Any

from ukf_sw.spec.core import Core

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
    return "\n".join([*lines, ""])
