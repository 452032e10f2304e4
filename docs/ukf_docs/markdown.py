"""Pieces of Markdown."""

from collections.abc import Iterable, Sequence

__all__ = ["table", "thousands"]


def table(headings: Sequence[str], rows: Iterable[Sequence[object]], *, left: int = 1) -> str:
    """Make a table.

    Parameters
    ----------
    headings
        One for each column.
    rows
        Cells of each row.
    left
        How many columns are text and stand left; the others are numbers and stand right.

    Raises
    ------
    ValueError
        If a row has more or fewer cells than there are headings.
    """
    rules = ["---" if column < left else "---:" for column in range(len(headings))]
    lines = [f"| {' | '.join(headings)} |", f"|{'|'.join(rules)}|"]
    for row in rows:
        if len(row) != len(headings):
            raise ValueError(f"row must have {len(headings)} cells, not {row!r}")
        lines.append(f"| {' | '.join(str(cell) for cell in row)} |")
    return "\n".join(lines) + "\n"


def thousands(value: int) -> str:
    """Number with a space between thousands."""
    return f"{value:,}".replace(",", " ")
