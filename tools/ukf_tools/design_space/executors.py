"""Where parts are computed: processes of this computer, or a Dask cluster."""

import asyncio
import logging
import signal
import socket
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, as_completed
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Protocol

from ukf_sw.engine.microcode import microcode
from ukf_sw.extras import importing
from ukf_tools.design_space.parts import Part
from ukf_tools.evaluate.workers import processors

__all__ = ["ClusterExecutor", "Executor", "ExecutorError", "FailedPart", "LocalExecutor", "perform"]

#: How long to wait for a scheduler, in s.
_CONNECT_SECONDS = 10.0
#: How long a cluster may have no worker before what is left is given up, and between looks, in s.
_WORKER_SECONDS, _POLL_SECONDS = 30.0, 0.2


class ExecutorError(RuntimeError):
    """There is nothing to compute with."""


@dataclass(frozen=True, kw_only=True)
class FailedPart:
    """A part that could not be computed.

    Parameters
    ----------
    message
        Why.
    """

    message: str


class Executor(Protocol):
    """Something that computes parts."""

    def run(self, parts: Sequence[Part]) -> Iterator[tuple[Part, dict[str, Any] | FailedPart]]:
        """Compute parts; gives each with its result as soon as it has ended, in any order.

        Whoever stops iterating stops what still runs.
        """
        ...


def perform(part: Part, key: str) -> dict[str, Any]:
    """Compute a part, in the process that computes.

    Parameters
    ----------
    part
        The part.
    key
        Its key, where the result will be kept.

    Raises
    ------
    RuntimeError
        If the key is another one here, so that the result would be kept in a wrong place.
    """
    if part.key != key:
        raise RuntimeError(
            f"workers must have the same sources and tools as the sweep, not those of {part.key!r}"
        )
    try:
        return part.compute()
    finally:
        # A process of a long sweep must not remember the programs of every core.
        microcode.cache_clear()


def attempt(part: Part, key: str) -> dict[str, Any] | FailedPart:
    """Compute a part as :func:`perform` does, but give what went wrong instead of raising it.

    Exceptions stay in their process: some cannot be made again from what pickle keeps of them,
    and one of these would break the whole pool.
    """
    try:
        return perform(part, key)
    except Exception as error:
        return _failure(error)


def _leave_when_told(*_: object) -> None:
    """End this process so that the tools it has started end, too, and scratch files go."""
    raise SystemExit(1)


def _attempt_in_pool(part: Part, key: str) -> dict[str, Any] | FailedPart:
    """As :func:`attempt`, in a process that may be told to leave on the way."""
    before = signal.signal(signal.SIGTERM, _leave_when_told)
    try:
        return attempt(part, key)
    finally:
        signal.signal(signal.SIGTERM, before)


def _failure(error: BaseException) -> FailedPart:
    text = str(error).strip() or "no message"
    kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
    return FailedPart(message=kind + text)


class LocalExecutor:
    """Processes of this computer. One that dies costs its part only.

    Parameters
    ----------
    workers
        Number of processes; one for each processor core by default.

    Raises
    ------
    ValueError
        If there is no worker.
    MissingExtraError
        If Pebble is not installed.
    """

    def __init__(self, workers: int | None = None) -> None:
        if workers is not None and workers < 1:
            raise ValueError(f"workers must be at least 1, not {workers!r}")
        with importing("sweep"):
            import pebble
        self._pool = pebble.ProcessPool
        self._expired = pebble.ProcessExpired
        self.workers = workers or processors()

    def run(self, parts: Sequence[Part]) -> Iterator[tuple[Part, dict[str, Any] | FailedPart]]:
        """Compute parts; see :class:`Executor`."""
        count = min(self.workers, len(parts))
        if not count:
            return
        # A fork would take over the threads and locks of whoever shows the progress.
        pool = self._pool(max_workers=count, context=get_context("spawn"))
        try:
            ordered = sorted(parts, key=lambda part: -part.cost)
            futures: dict[Future[Any], Part] = {
                pool.schedule(_attempt_in_pool, args=[part, part.key]): part for part in ordered
            }
            for future in as_completed(futures):
                try:
                    outcome = future.result()
                except self._expired as error:
                    outcome = FailedPart(message=f"its process died, exit code {error.exitcode}")
                except Exception as error:
                    outcome = _failure(error)
                yield futures[future], outcome
        finally:
            pool.stop()
            pool.join()


class ClusterExecutor:
    """A Dask cluster, whose workers have this project and its tools installed.

    A part whose worker is lost is computed by another one. Parts that cannot be computed because
    they kill every worker that tries, or because no worker or no scheduler is left, are failed
    parts, as they are here.

    Parameters
    ----------
    address
        Address of the scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    MissingExtraError
        If dask.distributed is not installed.
    ExecutorError
        If there is no scheduler.
    """

    def __init__(self, address: str) -> None:
        with importing("cluster"):
            import distributed
        self._distributed = distributed
        self._address = address
        # What it would log is in the messages of the parts.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            self._look(address)
            self._client = distributed.Client(
                address, timeout=_CONNECT_SECONDS, set_as_default=False
            )
        except (OSError, ValueError) as error:
            raise ExecutorError(f"There is no scheduler at {address!r}: {error}") from error

    def _look(self, address: str) -> None:
        """Connect once, since a client tries for long and leaves a trace on the terminal."""
        from distributed.comm.addressing import get_address_host_port

        host, port = get_address_host_port(address)
        if address.partition("://")[0] != "inproc":
            socket.create_connection((host, port), timeout=_CONNECT_SECONDS).close()

    def run(self, parts: Sequence[Part]) -> Iterator[tuple[Part, dict[str, Any] | FailedPart]]:
        """Compute parts; see :class:`Executor`."""
        futures: dict[Any, Part] = {}
        for part in parts:
            key = part.key
            # Whole numbers, the longest first.
            future = self._client.submit(
                attempt, part, key, key=f"{part.kind}-{key}",
                priority=round(1000 * part.cost), pure=False,
            )  # fmt: skip
            futures[future] = part
        worked = time.monotonic()
        try:
            while futures:
                for future in [future for future in futures if future.done()]:
                    outcome = self._outcome(future)
                    if outcome is not None:
                        # What is not released is kept in the memory of the workers.
                        future.release()
                        yield futures.pop(future), outcome
                if self._has_workers():
                    worked = time.monotonic()
                elif time.monotonic() > worked + _WORKER_SECONDS:
                    lost = FailedPart(message="no worker is left: this part or another killed them")
                    for future in list(futures):
                        yield futures.pop(future), lost
                time.sleep(_POLL_SECONDS)
        finally:
            with suppress(Exception):  # there may be nobody left to tell
                self._client.cancel(list(futures))

    def _outcome(self, future: Any) -> dict[str, Any] | FailedPart | None:
        """Give what came of a future that has ended, or None if that was lost again."""
        try:
            return future.result(timeout=_CONNECT_SECONDS)
        except self._distributed.KilledWorker:
            return FailedPart(message="each worker that computed it died")
        except TimeoutError:
            return None  # with its worker; another one computes it
        except (Exception, asyncio.CancelledError) as error:
            if future.status == "cancelled":
                return FailedPart(message=f"the scheduler at {self._address!r} has gone")
            return _failure(error)

    def _has_workers(self) -> bool:
        """Whether anybody computes; without a scheduler, futures say so themselves."""
        try:
            return bool(self._client.scheduler_info()["workers"])
        except Exception:
            return False

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        with suppress(Exception):
            self._client.close(timeout=_CONNECT_SECONDS)
