"""Work spread over processes."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

__all__ = ["check_workers", "mapper", "processors"]


def processors() -> int:
    """Number of processors that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux has it
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def check_workers(workers: int) -> int:
    """Give the number of processes.

    Raises
    ------
    ValueError
        If it is less than 1.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers!r}")
    return workers


@contextmanager
def mapper(workers: int) -> Iterator[Callable[[Callable[..., Any], Iterable[Any]], Iterable[Any]]]:
    """Give a function like map, over so many processes; one is this process itself."""
    if check_workers(workers) == 1:
        yield map
        return
    # Not forked: threads of libraries do not survive that.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield pool.map
