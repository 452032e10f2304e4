"""Folders and files to write to: which ones will do, and writing whole or not at all."""

import errno
import os
import tempfile
import time
import uuid
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

__all__ = ["cache_folder", "check_file", "check_folder", "locked", "replacing"]

#: How the name of a file ends that is being written, and after how many seconds nobody writes it.
_PART, _LEFT_SECONDS = ".part", 3600.0


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


def _is_there(path: Path) -> bool:
    """Whether there is something of that name; OSError if there cannot be."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _try_folder(folder: Path) -> None:
    """Write a file into a folder, or into the nearest one above it that is there; nothing stays."""
    nearest = folder.absolute()
    while not _is_there(nearest):
        nearest = nearest.parent
    with tempfile.TemporaryFile(dir=nearest):
        pass


def check_folder(name: str, path: "str | os.PathLike[str]") -> Path:
    """Check that a folder can be written to, before there is anything to write.

    Parameters
    ----------
    name
        What asks for it, for the message: an option or an argument.
    path
        The folder. If it is absent, the one in which it would be made is tried; nothing stays.

    Raises
    ------
    ValueError
        If it cannot be written to.
    """
    text = os.fspath(path)
    if not text:
        raise ValueError(f"{name} must be the name of a folder, not ''")
    try:
        if _is_there(Path(text)) and not Path(text).is_dir():
            raise ValueError(f"{name} must be a folder, not the file {text!r}")
        _try_folder(Path(text))
    except OSError as error:
        raise ValueError(
            f"{name} must be a folder that can be written, not {text!r} ({error.strerror})"
        ) from error
    return Path(text)


def check_file(name: str, path: "str | os.PathLike[str]", kinds: Sequence[str] = ()) -> Path:
    """Check that a file can be written, as :func:`check_folder` does.

    Parameters
    ----------
    name
        What asks for it, for the message.
    path
        The file, which may exist.
    kinds
        How its name may end, as ``.png``; anything if there are none.

    Raises
    ------
    ValueError
        If it cannot be written, or is of none of the kinds.
    """
    text = os.fspath(path)
    if not text:
        raise ValueError(f"{name} must be the name of a file, not ''")
    try:
        if Path(text).is_dir():
            raise ValueError(f"{name} must be a file, not the folder {text!r}")
        if kinds and Path(text).suffix.lower() not in kinds:
            raise ValueError(f"{name} must end with {' or '.join(kinds)}, not {text!r}")
        if not _is_there(Path(text)):
            _try_folder(Path(text).parent)
        elif not os.access(text, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise ValueError(
            f"{name} must be a file that can be written, not {text!r} ({error.strerror})"
        ) from error
    return Path(text)


@contextmanager
def replacing(file: Path) -> Generator[Path]:
    """Write a file whole or not at all, whatever else writes or reads it meanwhile.

    Parameters
    ----------
    file
        The file; its folder exists.

    Yields
    ------
    Path
        A file beside it to write to, which takes its place at the end. If the process is killed it
        stays, and is removed an hour later by whoever writes into that folder then.
    """
    for left in file.parent.glob(f".*{_PART}"):
        with suppress(OSError):
            if left.stat().st_mtime < time.time() - _LEFT_SECONDS:
                left.unlink()
    part = file.with_name(f".{uuid.uuid4().hex}{_PART}")
    try:
        yield part
        with part.open("rb+") as stream:
            os.fsync(stream.fileno())
        part.replace(file)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


@contextmanager
def locked(path: Path) -> Generator[None]:
    """Have a folder, or a file that is made for this, to oneself: other processes wait.

    Where the system or the file system has no such locks (Windows; a folder on NFS), nobody waits.

    Parameters
    ----------
    path
        The folder or file.
    """
    flags = os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT
    handle = -1 if fcntl is None else os.open(path, flags, 0o666)
    try:
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        if handle >= 0:
            os.close(handle)
