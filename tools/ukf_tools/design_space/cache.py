"""Results on disk, found by what they depend on."""

import hashlib
import json
from pathlib import Path
from typing import Any

from ukf_sw.folders import replacing

__all__ = ["CACHE", "Cache", "key_of"]

#: Folder of results unless told otherwise.
CACHE = Path("build/design-space")


def key_of(identity: Any) -> str:
    """Key of a result: a digest of all that it depends on, which must fit in JSON."""
    text = json.dumps(identity, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class Cache:
    """Results on disk. A result is written whole or not at all, and never changes.

    With each result its digest is kept, so what a bad disk or an editor has changed is no result.
    Processes may share a folder.

    Parameters
    ----------
    folder
        Where results are; made when the first is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _file(self, kind: str, key: str) -> Path:
        return self.folder / kind / f"{key}.json"

    def get(self, kind: str, key: str) -> dict[str, Any] | None:
        """Give a result of some kind, or None if there is none that is whole."""
        try:
            record = json.loads(self._file(kind, key).read_bytes())
            result, digest = record["result"], record["digest"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None
        return result if digest == key_of([kind, key, result]) else None

    def put(self, kind: str, key: str, result: dict[str, Any], identity: Any = None) -> None:
        """Keep a result of some kind.

        Parameters
        ----------
        kind, key
            Where.
        result
            The result, which must fit in JSON.
        identity
            What it depends on, for people who look into the file.
        """
        file = self._file(kind, key)
        file.parent.mkdir(parents=True, exist_ok=True)
        digest = key_of([kind, key, result])
        record = {"identity": identity, "digest": digest, "result": result}
        with replacing(file) as part:
            part.write_text(json.dumps(record, indent=1), encoding="utf-8")

    def keys(self, kind: str) -> frozenset[str]:
        """Keys of all results of some kind that are whole."""
        return frozenset(
            file.stem
            for file in (self.folder / kind).glob("*.json")
            if self.get(kind, file.stem) is not None
        )
