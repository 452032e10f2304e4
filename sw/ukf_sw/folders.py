"""Folders to write to."""

import os
import tempfile
from pathlib import Path

__all__ = ["cache_folder", "output_folder"]


def cache_folder(wanted: Path | None) -> Path:
    """Give a folder for what may be made again: the one that is wanted, if it can be written.

    Parameters
    ----------
    wanted
        The folder, made if it is absent; None if there is no place for it, as without a home.

    Returns
    -------
    Path
        That folder, or one of this user below that of temporary files, which may not exist yet.
    """
    if wanted is not None:
        try:
            wanted.mkdir(parents=True, exist_ok=True)
        except OSError:
            pass
        else:
            if os.access(wanted, os.W_OK | os.X_OK):
                return wanted
    user = getattr(os, "getuid", lambda: "user")()  # Windows has one of its own for each user
    return Path(tempfile.gettempdir(), f"ukf-core-{user}", wanted.name if wanted else "cache")


def output_folder(folder: Path) -> Path:
    """Make a folder for results and try to write there, so that long work does not end in vain.

    Raises
    ------
    OSError
        If it cannot be made or written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        return folder
