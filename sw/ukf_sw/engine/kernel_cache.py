"""Compiled functions that are kept on disk, so that a process need not compile them again.

Numba's own ``cache=True`` looks at the file of a function only: it takes what was compiled before
a function that is called, or a constant of another module, has changed. Here whatever was compiled
says from which sources, for which types and for which processor, and nothing else is taken.
"""

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.resources import files
from typing import Any

from numba import njit  # pyright: ignore[reportUnknownVariableType]
from numba.core import caching, serialize

__all__ = ["compiled", "sources_digest"]

#: Numba's own pickler, which takes what it compiles.
_serialize: Any = serialize

#: Packages that compiled functions, and the constants in them, may come from.
_PACKAGES = ("ukf_sw.engine", "ukf_sw.spec")


@cache
def sources_digest() -> str:
    """Digest of the sources of all compiled functions, and of all that they may refer to."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for file in sorted(files(package).iterdir(), key=lambda file: file.name):
            if file.name.endswith(".py"):
                source = file.read_bytes()
                digest.update(f"{package} {file.name} {len(source)}\n".encode())
                digest.update(source)
    return digest.hexdigest()


class _CheckedFile:
    """What Numba writes for a function, with its origin and a digest beside it.

    Processes that compile at the same time may overwrite each other's files, of other sources or
    for another processor; the origin tells. Machine code with a wrong bit still runs; the digest
    tells.
    """

    def __init__(self, file: Any) -> None:
        self._file = file

    def save(self, key: Any, data: Any) -> None:
        kept: bytes = _serialize.dumps(((sources_digest(), key), data))
        self._file.save(key, (hashlib.sha256(kept).digest(), kept))

    def load(self, key: Any) -> Any:
        try:
            digest, kept = self._file.load(key) or (b"", b"")
            if digest != hashlib.sha256(kept).digest():
                return None
            origin, data = pickle.loads(kept)
        except Exception:  # a damaged file can raise anything
            with suppress(OSError):
                self._file.flush()
            return None
        return data if origin == (sources_digest(), key) else None


class _KernelCache:
    """Numba's cache of a function, but with checked files; it never fails a call."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._cache: Any = caching.FunctionCache(function)
        file = caching.IndexDataCacheFile(
            cache_path=self._cache.cache_path,
            filename_base=self._cache._impl.filename_base,
            source_stamp=sources_digest(),
        )
        self._cache._cache_file = _CheckedFile(file)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):
            self._cache.save_overload(sig, data)


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call, or take what an earlier process has compiled.

    Files lie where Numba puts them: in ``NUMBA_CACHE_DIR``, in ``__pycache__`` beside the source,
    or in the user's cache folder. Where none of them can be written, each process compiles.

    Parameters
    ----------
    function
        Function of :mod:`ukf_sw.engine`, which refers to that package and to :mod:`ukf_sw.spec`
        only. Call it with few different types: each is compiled, for seconds.

    Returns
    -------
    callable
        What Numba's ``njit`` gives.
    """
    dispatcher: Any = njit(function)
    with suppress(RuntimeError):  # there is no folder to write to
        dispatcher._cache = _KernelCache(function)
    return dispatcher
