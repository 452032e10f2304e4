"""The simulated core as a backend of any script: ``backend="cosim"``.

A co-simulation runs its task inside the simulator's process. This task takes bus accesses from a
socket and does them, so the software can stay where it is: in a script that would run on a board
as it is. Everything goes through the lockstep bus, compared with the golden model.

What passes through the socket is JSON: ``[access, arguments]`` that way, ``[kind, value]`` back.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from ukf_sim.lockstep import MismatchError
from ukf_sim.session import CACHE, Context, Job, run_job, step_timeout
from ukf_sim.simulators import Simulator, SimulatorError
from ukf_sw.drivers.bus import Addresses, OneCore, Words
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import BusError
from ukf_sw.spec.core import Core
from ukf_sw.spec.parameters import Pipeline, UkfParams

__all__ = ["RemoteBus", "cosim_backend", "serve", "simulator_of"]


def serve(context: Context, *, address: str) -> None:
    """Do bus accesses for another process until it closes the connection: a task.

    Parameters
    ----------
    context
        The core.
    address
        Socket of a :class:`RemoteBus`.
    """
    bus = context.lockstep
    accesses: dict[str, Callable[..., Any]] = {
        "read": bus.read,
        "write": bus.write,
        "read_many": lambda addresses: bus.read_many(np.array(addresses)),
        "write_many": lambda addresses, words: bus.write_many(
            np.array(addresses), np.array(words, dtype=np.uint32)
        ),
        "wait_for_interrupt": bus.wait_for_interrupt,
        "clock": bus.clock,
    }
    with Client(address) as connection:
        _send(connection, "ready", None)
        while True:
            try:
                name, arguments = _receive(connection)
            except EOFError:
                return
            try:
                answer = ("result", accesses[name](*arguments))
            except BusError as error:
                answer = ("refused", (error.address, error.access))
            except MismatchError as error:
                answer = ("mismatch", str(error))
            _send(connection, *answer)


def _send(connection: Connection, what: str, value: Any) -> None:
    text = json.dumps([what, value], default=lambda array: array.tolist())
    connection.send_bytes(text.encode())


def _receive(connection: Connection) -> tuple[str, Any]:
    what, value = json.loads(connection.recv_bytes())
    return what, value


class Line:
    """A connection on which each question has its answer, whatever interrupts who asks.

    A thread of its own sends and receives, since signals interrupt only the main one: the answer to
    a question that KeyboardInterrupt has cut off is taken and dropped before the next is sent.

    Parameters
    ----------
    connection
        The connection.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._questions: _Questions = SimpleQueue()
        arguments = connection, self._questions
        threading.Thread(target=_converse, args=arguments, daemon=True).start()

    def ask(self, name: str, *arguments: Any) -> tuple[str, Any]:
        """Send a question and wait for its answer: its kind and value.

        Raises
        ------
        EOFError, OSError, ValueError, TypeError
            If the connection has been closed, or what arrives is no answer.
        """
        if self._connection.closed:
            raise EOFError
        answer: Future[tuple[str, Any]] = Future()
        self._questions.put((answer, name, arguments))
        return answer.result()

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()
        self._questions.put(None)


_Questions = SimpleQueue[tuple[Future[tuple[str, Any]], str, tuple[Any, ...]] | None]


def _converse(connection: Connection, questions: _Questions) -> None:
    """Send questions one after the other, each when the one before has been answered."""
    while (question := questions.get()) is not None:
        answer, name, arguments = question
        try:
            _send(connection, name, arguments)
            answer.set_result(_receive(connection))
        except Exception as error:
            answer.set_exception(error)


class RemoteBus(OneCore):
    """A core in a simulator of its own, as a bus. Close it, or let it be forgotten.

    Parameters
    ----------
    params, pipeline
        The core, which is generated and compiled unless that was done before.
    simulator
        Where it is simulated.
    cache
        Folder of compiled cores.

    Raises
    ------
    SimulatorError
        If the simulator is missing or fails; also from every access, and when the core does not do
        what the golden model does.
    """

    def __init__(
        self,
        params: UkfParams,
        pipeline: Pipeline | None = None,
        simulator: Simulator = Simulator.VERILATOR,
        *,
        cache: Path = CACHE,
    ) -> None:
        with tempfile.TemporaryDirectory(prefix="ukf-bus-") as folder:
            address = str(Path(folder) / "socket")
            record = Core(params=params, pipeline=pipeline or Pipeline()).record(programs=True)
            record |= {"simulator": simulator.value, "cache": str(cache)}
            (Path(folder) / "core.json").write_text(json.dumps(record), encoding="utf-8")
            # A process of its own: compiling and simulating change the environment of a process.
            command = [sys.executable, "-m", "ukf_sim.remote", folder]
            with Listener(address) as listener:
                # In a session of its own, Ctrl-C in a terminal interrupts the script only.
                process = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, start_new_session=True
                )  # fmt: skip
                try:
                    threading.Thread(target=_unblock, args=(process, address), daemon=True).start()
                    connection = listener.accept()
                    try:
                        kind, text = _receive(connection)
                    except EOFError:
                        kind = "failed"
                        text = f"The simulation ended with the code {process.wait()}"
                except BaseException:
                    os.killpg(process.pid, signal.SIGINT)
                    raise
        self._line = Line(connection)
        self._finalizer = weakref.finalize(self, _stop, self._line, process)
        if kind == "failed":
            self.close()
            raise SimulatorError(text)

    def close(self) -> None:
        """End the simulation."""
        self._finalizer()

    def _call(self, name: str, *arguments: Any) -> Any:
        try:
            kind, value = self._line.ask(name, *arguments)
        except (EOFError, OSError, ValueError, TypeError) as error:
            raise SimulatorError("The simulation has ended") from error
        if kind == "refused":
            raise BusError(*value)
        if kind == "mismatch":
            raise SimulatorError(value)
        return value

    def read(self, address: int) -> int:
        """Read a word; BusError if the core refuses."""
        return self._call("read", address)

    def write(self, address: int, word: int) -> None:
        """Write a word; BusError if the core refuses."""
        self._call("write", address, word)

    def read_many(self, addresses: Addresses) -> Words:
        """Read words, shape (k,), at addresses, shape (k,); BusError if the core refuses."""
        return np.array(self._call("read_many", addresses), dtype=np.uint32)

    def write_many(self, addresses: Addresses, words: Words) -> None:
        """Write words, shape (k,), at addresses, shape (k,); BusError if the core refuses."""
        self._call("write_many", addresses, words)

    def wait_for_interrupt(self, timeout: float) -> bool:
        """Wait for the interrupt, so many seconds of simulated time at most."""
        return self._call("wait_for_interrupt", timeout)

    def clock(self) -> float:
        """Simulated time, in seconds."""
        return self._call("clock")


def _unblock(process: subprocess.Popen[bytes], address: str) -> None:
    """Connect in the place of a process that ended before it could."""
    process.wait()
    with suppress(OSError):
        Client(address).close()


def _stop(line: Line, process: subprocess.Popen[bytes]) -> None:
    line.close()
    process.wait()


def main(folder: Path) -> None:
    """Simulate what a :class:`RemoteBus` left in a folder: the process that it starts."""
    record = json.loads((folder / "core.json").read_text(encoding="utf-8"))
    core = Core.from_record(record)
    address = str(folder / "socket")
    job = Job(
        params=core.params,
        pipeline=core.pipeline,
        task="ukf_sim.remote:serve",
        arguments={"address": address},
    )
    try:
        run_job(job, Simulator(record["simulator"]), cache=Path(record["cache"]))
    except Exception as error:
        with suppress(OSError), Client(address) as connection:
            _send(connection, "failed", str(error))
        raise SystemExit(1) from error


def simulator_of(where: str) -> Simulator:
    """Give the simulator of the backend ``cosim:where``.

    Parameters
    ----------
    where
        Name of a simulator; Verilator if empty.

    Raises
    ------
    ValueError
        If there is no such simulator.
    """
    names = [simulator.value for simulator in Simulator]
    if where and where not in names:
        raise ValueError(f"backend must be cosim:{' or cosim:'.join(names)}, not 'cosim:{where}'")
    return Simulator(where) if where else Simulator.VERILATOR


def cosim_backend(params: UkfParams, where: str = "", pipeline: Pipeline | None = None) -> Driver:
    """Make the backend ``cosim``, or ``cosim:icarus``: a driver of a simulated core.

    Parameters
    ----------
    params
        The core.
    where
        Simulator; Verilator if empty.
    pipeline
        How the core is built; None is the default.

    Raises
    ------
    ValueError
        If there is no such simulator.
    SimulatorError
        If the simulator is not installed or fails.
    """
    bus = RemoteBus(params, pipeline, simulator_of(where))
    return Driver(
        bus, params, interrupt=bus.wait_for_interrupt, clock=bus.clock, count_cycles=True,
        timeout=step_timeout(params, pipeline or Pipeline()),
    )  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
