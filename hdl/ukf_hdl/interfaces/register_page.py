"""Register documentation of one core, in Markdown."""

from typing import Any

from ukf_sw.spec.sequence import ENDINGS, STEPS, WAYS, Flag, Way

__all__ = ["register_map", "register_page"]

#: What no field says; :class:`ukf_hdl.core.control.Control` promises it.
BEHAVIOUR = """\
- **Reserved bits** read as 0; writes to them, and to fields that are `ro`, do nothing.
- **Refused accesses** are answered `SLVERR`, have no effect and read as 0: addresses without a
  register or an element, and the buffer while a step runs. Registers can be accessed at any time.
- **Bytes**: write strobes are honoured, in registers and buffer.
- **Starts**: exactly one start bit, with `ENABLE` set by then, while no step runs, and in sequence.
  Any other start has no effect but `ERROR.CODE` = 1. SIG_GEN with sigma points already there ends
  at once.
- **When a value counts**: `MASK` as it is at the start of UPDATE, the gate as it is at its end.
- **Races**, on one clock: a write is judged before the end of a step. So a start on the clock on
  which a step ends is illegal, an error of the ending step replaces its code 1, and `RESET` drops
  the ending step; only a gate written on that clock comes too late. An event wins over the write
  that clears its pending bit.
- **Access**: `ro` read only; `rw` read and write; `w1s` writing 1 starts something, reads as 0;
  `rw1c` set by the core, writing 1 clears it.
"""


def register_map(record: dict[str, Any]) -> str:
    """Render registers, their behaviour and the buffer of a core as Markdown without a title.

    Parameters
    ----------
    record
        Description of the core.
    """
    lines = [
        f"{record['description']}.",
        "",
        f"Addresses are in bytes, {record['address_width']} bits wide. A word has 32 bits.",
        "",
        "## Registers",
        "",
    ]
    for register in record["registers"]:
        lines += [
            f"### `{register['name']}`, offset `{register['offset']:#04x}`",
            "",
            register["doc"],
            "",
            "| Bits | Field | Access | Reset | Meaning |",
            "|-----:|-------|--------|------:|---------|",
        ]
        for field in sorted(register["fields"], key=lambda field: -field["lsb"]):
            top = field["lsb"] + field["width"] - 1
            bits = f"{top}:{field['lsb']}" if field["width"] > 1 else str(top)
            lines.append(
                f"| {bits} | `{field['name']}` | {field['access']} | `{field['reset']:#x}` "
                f"| {field['doc']} |"
            )
        lines.append("")
    strides = f"i * {record['row_stride']:#x} + j * {record['element_bytes']}"
    lines += [
        "## Behaviour",
        "",
        *BEHAVIOUR.splitlines(),
        "",
        "## Steps",
        "",
        "A step takes the first of its ways whose flags are set, and is illegal if there is none.",
        "All flags but `PREDICTED` and `PROPAGATED` can be read in `STATUS`. `F`, `H` and",
        "`ITERATE` are for models on the core: `F` goes on as `PREDICT`, `H` as `UPDATE`, and",
        "`ITERATE` is both.",
        "",
        "| Step | Needs | Runs | Leaves set | Leaves cleared |",
        "|------|-------|------|------------|----------------|",
    ]
    lines += [
        f"| `{step.name}` | {_names(way.needs)} | {_run(way)} |"
        for step in STEPS
        for way in WAYS[step]
    ]
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


def register_page(record: dict[str, Any]) -> str:
    """Render :func:`register_map` as a page of Markdown.

    Parameters
    ----------
    record
        Description of the core.
    """
    place = (
        f"At {record['base_address']:#x} in the system, interrupt {record['interrupt']}, "
        f"clock {record['clock_hz'] / 1e6:g} MHz; macros in C begin with `{record['c_prefix']}_`."
    )
    return f"# Registers of {record['name']}\n\n{place}\n\n{register_map(record)}"


def _names(flags: Flag) -> str:
    """Names of flags."""
    return ", ".join(f"`{flag.name}`" for flag in Flag if flag in flags) or "–"


def _run(way: Way) -> str:
    """What a way runs and, if that succeeds, leaves."""
    if way.program is None:
        return "nothing, it ends at once | – | –"
    change = ENDINGS[way.program].success
    return f"`{way.program.name}` | {_names(change.sets)} | {_names(change.clears)}"
