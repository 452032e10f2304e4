"""Generated sections of documents: the text between two markers, which nobody writes by hand.

The markers of a section are the comments ``<!-- BEGIN GENERATED name -->`` and
``<!-- END GENERATED name -->``, each on a line of its own. :mod:`ukf_docs.documents` says what
stands between them.
"""

import re
from collections.abc import Mapping
from pathlib import Path

__all__ = ["find", "refresh", "update"]

BEGIN, END = "<!-- BEGIN GENERATED {} -->\n", "<!-- END GENERATED {} -->"


def find(text: str) -> list[str]:
    """Names of the generated sections of a Markdown text, in its order."""
    return re.findall(BEGIN.format("(.+)"), text)


def refresh(text: str, sections: Mapping[str, str]) -> str:
    """Replace generated sections of a Markdown text.

    Parameters
    ----------
    text
        Markdown of the document.
    sections
        What is to stand between the markers, by the name of the section.

    Raises
    ------
    ValueError
        If the markers of a section are missing.
    """
    for name, section in sections.items():
        begin, end = BEGIN.format(name), END.format(name)
        head, found, rest = text.partition(begin)
        _, closed, tail = rest.partition(end)
        if not (found and closed):
            raise ValueError(f"text must have the markers of the section {name!r}")
        text = f"{head}{begin}{section.strip()}\n{end}{tail}"
    return text


def update(document: Path, sections: Mapping[str, str]) -> bool:
    """Replace generated sections of a document; gives whether that changed it.

    Raises
    ------
    ValueError
        If the markers of a section are missing.
    """
    old = document.read_text(encoding="utf-8")
    try:
        new = refresh(old, sections)
    except ValueError as error:
        raise ValueError(f"{document.name}: {error}") from None
    document.write_text(new, encoding="utf-8")
    return new != old
