"""A study: measurements that take long are made once and noted, and tables are made of the note."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ukf_docs import DOCS

__all__ = ["Study", "Tell"]

#: Called with what is being done, how much of it is done, and of how much.
Tell = Callable[[str, float, float | None], None]


@dataclass(frozen=True, kw_only=True)
class Study:
    """Measurements for one of the documents.

    Parameters
    ----------
    name
        Of its note, ``NAME.json``, and of the target of make that measures.
    document
        The document.
    measure
        Measures everything; gives a record for JSON.
    tables
        Functions that make a section of the document from the record, by name of the section.
    folder
        Where the note is; None is ``docs/measured``.
    """

    name: str
    document: Path
    measure: Callable[[Tell], Any]
    tables: Mapping[str, Callable[[Any], str]]
    folder: Path | None = None

    @property
    def file(self) -> Path:
        """Where the record is noted."""
        return (self.folder or DOCS / "measured") / f"{self.name}.json"

    def read(self) -> Any:
        """Read what was measured.

        Raises
        ------
        OSError
            If it has not been measured yet.
        """
        return json.loads(self.file.read_text(encoding="utf-8"))

    def write(self, record: Any) -> None:
        """Note what was measured."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(record, indent=2, allow_nan=False) + "\n"
        self.file.write_text(text, encoding="utf-8")

    def section(self, name: str) -> str:
        """Make a section from the record, or say who measures it."""
        if not self.file.exists():
            return f"Not measured yet; `make {self.name}` does.\n"
        return self.tables[name](self.read())
