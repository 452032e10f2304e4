"""Register server: the golden model for programs in other processes, over a socket.

It answers the requests of sw/c/ports/remote.c. So the program for the processor of the board, run
by an emulator of that processor, has a core.
"""

import socket
import struct
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from ukf_sw.drivers.bus import Bus
from ukf_sw.errors import BusError
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.spec.parameters import UkfParams

__all__ = ["RegisterServer"]

READ, WRITE, WAIT = range(3)
#: Operation, address, data; one word is left over.
REQUEST = struct.Struct("=4I")
#: Success, data.
ANSWER = struct.Struct("=2I")
#: How long a program that has just ended may take to be gone, in seconds.
_LEAVE_SECONDS = 0.5


class RegisterServer:
    """A bus for one program at a time, in a thread, for the time of a ``with`` block.

    The connection of a second program is closed at once, so that it does not wait. At the end of
    the block that of the first one is, whether the program is done or not.

    Parameters
    ----------
    path
        Socket to make; its name must have less than 100 characters.
    bus
        What is served.

    Attributes
    ----------
    words : int
        Accesses answered.
    """

    def __init__(self, path: Path, bus: Bus) -> None:
        self._path = path
        self._bus = bus
        self.words = 0
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._thread = threading.Thread(target=self._listen, name="registers", daemon=True)
        self._connection: socket.socket | None = None
        self._server: threading.Thread | None = None

    @classmethod
    def of_golden(cls, path: Path, params: UkfParams) -> "RegisterServer":
        """Serve a new golden model."""
        return cls(path, GoldenBus(GoldenCore(params)))

    def __enter__(self) -> "RegisterServer":
        self._listener.bind(str(self._path))
        self._listener.listen(1)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # Closing alone does not wake the thread that accepts.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()
        if self._connection is not None and self._server is not None:
            with suppress(OSError):  # the program has closed it
                self._connection.shutdown(socket.SHUT_RDWR)
            self._server.join()
        self._path.unlink()

    def _listen(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            if self._server is not None:
                self._server.join(_LEAVE_SECONDS)
                if self._server.is_alive():
                    connection.close()
                    continue
            self._connection = connection
            self._server = threading.Thread(target=self._serve, args=(connection,), daemon=True)
            self._server.start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, connection.makefile("rb") as requests, suppress(OSError):
            while len(request := requests.read(REQUEST.size)) == REQUEST.size:
                operation, address, data, _ = REQUEST.unpack(request)
                connection.sendall(ANSWER.pack(*self._answer(operation, address, data)))

    def _answer(self, operation: int, address: int, data: int) -> tuple[int, int]:
        """Success, and data."""
        try:
            if operation == READ:
                self.words += 1
                return 1, self._bus.read(address)
            if operation == WRITE:
                self.words += 1
                self._bus.write(address, data)
                return 1, 0
            if operation == WAIT:
                wait = getattr(self._bus, "wait_for_interrupt", None)
                return (0, 0) if wait is None else (1, int(wait(data * 1e-6)))
        except BusError:
            pass
        return 0, 0
