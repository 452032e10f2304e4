"""The register server: programs that are silent, too many, or gone."""

import socket
import time
from contextlib import ExitStack

import pytest

from ukf_sw.errors import BusError
from ukf_tools.arm.register_server import ANSWER, READ, REQUEST, WRITE, RegisterServer


class Memory:
    """A bus with one word."""

    word = 5

    def read(self, address):
        if address:
            raise BusError(address, "read")
        return self.word

    def write(self, address, word):
        self.word = word


class Program:
    """What a program does on its side of the socket."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(5.0)
        self.socket.connect(str(path))

    def ask(self, operation, address, data=0):
        self.socket.sendall(REQUEST.pack(operation, address, data, 0))
        return ANSWER.unpack(self.socket.recv(ANSWER.size))


@pytest.fixture
def connect(path):
    """Function that starts a program."""
    with ExitStack() as open_sockets:

        def connect():
            program = Program(path)
            open_sockets.enter_context(program.socket)
            return program

        yield connect


@pytest.fixture
def path(tmp_path):
    return tmp_path / "socket"


def test_programs_one_after_the_other(path, connect):
    with RegisterServer(path, Memory()) as server:
        for word in (5, 6, 7):
            program = connect()
            assert program.ask(READ, 0) == (1, word)
            assert program.ask(WRITE, 0, word + 1) == (1, 0)
            assert program.ask(READ, 4) == (0, 0)
            program.socket.close()
    assert server.words == 9
    assert not path.exists()


def test_second_program_does_not_wait(path, connect):
    with RegisterServer(path, Memory()):
        first, second = connect(), connect()
        assert second.socket.recv(1) == b""
        assert first.ask(READ, 0) == (1, 5)


def test_silent_program_does_not_hold_the_server(path, connect):
    began = time.monotonic()
    with RegisterServer(path, Memory()):
        program = connect()
        assert program.ask(READ, 0) == (1, 5)
    assert time.monotonic() - began < 5.0
    assert program.socket.recv(1) == b""
