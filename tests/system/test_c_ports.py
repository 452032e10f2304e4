"""The ports of the C driver for real systems, as far as they go without one."""

import ctypes
import itertools
import os

import numpy as np
import pytest

from ukf_sim.c_in_the_loop.compiler import Toolchain, compile_c, write_headers
from ukf_sw.c_sources import C_SOURCES
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.registers import INTERRUPT_PENDING

pytestmark = pytest.mark.skipif(not Toolchain.NATIVE.available, reason="no C compiler")

NOW = ctypes.CFUNCTYPE(ctypes.c_uint64)
WORD = ctypes.c_uint32


class Port(ctypes.Structure):
    _fields_ = (
        ("context", ctypes.c_void_p),
        ("read", ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, WORD, ctypes.POINTER(WORD))),
        ("write", ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, WORD, WORD)),
        ("wait", ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, WORD)),
        ("now_us", ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_void_p)),
    )

    def get(self, address):
        word = WORD()
        assert self.read(self.context, address, ctypes.byref(word))
        return word.value


class BareMetal(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("now_us", NOW), ("interrupted", ctypes.c_bool))


class Uio(ctypes.Structure):
    _fields_ = (("device", ctypes.c_int), ("words", ctypes.c_void_p), ("length", ctypes.c_size_t))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ports")
    write_headers(UkfParams(n=1, m=1), folder)
    compiled = compile_c(
        [C_SOURCES / "ports/bare_metal.c", C_SOURCES / "ports/uio.c"], folder / "libports.so",
        [folder], flags=("-shared", "-fPIC"),
    )  # fmt: skip
    library = ctypes.CDLL(str(compiled))
    library.ukf_bare_metal_port.restype = Port
    library.ukf_bare_metal_port.argtypes = (ctypes.POINTER(BareMetal), ctypes.c_bool)
    library.ukf_global_timer_us.restype = ctypes.c_uint64
    return library


def test_bare_metal_reads_and_writes_at_its_base(library):
    words = np.zeros(64, dtype=np.uint32)
    state = BareMetal(words.ctypes.data, NOW(lambda: 5))
    port = library.ukf_bare_metal_port(state, False)
    assert not port.wait, "polling"
    assert port.write(port.context, 0x24, 0xDEAD_BEEF)
    assert words[9] == 0xDEAD_BEEF
    assert np.count_nonzero(words) == 1
    assert port.get(0x24) == 0xDEAD_BEEF
    assert port.now_us(port.context) == 5


def test_bare_metal_waits_for_its_handler(library):
    """The handler silences the line; an interrupt is seen once, also when it came before."""
    words = np.zeros(64, dtype=np.uint32)
    clock = itertools.count()
    state = BareMetal(words.ctypes.data, NOW(lambda: next(clock)))
    port = library.ukf_bare_metal_port(state, True)
    assert not port.wait(port.context, 0)
    assert not port.wait(port.context, 20)
    waited = next(clock)
    assert 20 < waited < 30
    library.ukf_bare_metal_interrupt(ctypes.byref(state))
    assert words[INTERRUPT_PENDING.offset // 4] == 0b11
    assert port.wait(port.context, 0)
    assert not port.wait(port.context, 0)


def test_bare_metal_does_not_wait_for_ever(library):
    """Not even if the clock stands still."""
    state = BareMetal(np.zeros(64, dtype=np.uint32).ctypes.data, NOW(lambda: 7))
    port = library.ukf_bare_metal_port(state, True)
    assert not port.wait(port.context, 20)


@pytest.mark.parametrize("ticks", [0, 332, 333, 1 << 32, (7 << 32) + 12345])
def test_the_global_timer_counts_microseconds(library, ticks):
    registers = np.array([ticks & 0xFFFF_FFFF, ticks >> 32], dtype=np.uint32)
    assert library.ukf_global_timer_us(registers.ctypes.data_as(ctypes.c_void_p), 333) == (
        ticks // 333
    )


def test_uio_maps_its_device(library, tmp_path):
    """A file has memory to map as a device has; it is always ready, as a high line is."""
    path = tmp_path / "uio"
    path.write_bytes(bytes(8192))
    state, port = Uio(), Port()
    name = str(path).encode()
    assert library.ukf_uio_open(
        ctypes.byref(state), ctypes.byref(port), name, ctypes.c_size_t(4100), True
    ) == 0  # fmt: skip
    assert state.length == 8192, "whole pages"
    assert port.write(port.context, 0x1008, 77)
    assert port.get(0x1008) == 77
    assert path.read_bytes()[0x1008:0x100C] == b"M\0\0\0"
    assert port.now_us(port.context) <= port.now_us(port.context)
    assert port.wait(port.context, 1000)
    assert path.read_bytes()[:4] == b"\1\0\0\0", "the interrupt was switched on first"
    library.ukf_uio_close(ctypes.byref(state))
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(state.device)


def test_uio_says_what_is_wrong(library, tmp_path):
    state, port = Uio(), Port()
    name = str(tmp_path / "none").encode()
    code = library.ukf_uio_open(
        ctypes.byref(state), ctypes.byref(port), name, ctypes.c_size_t(4096), False
    )
    assert os.strerror(code) == "No such file or directory"
    folder = str(tmp_path).encode()
    code = library.ukf_uio_open(
        ctypes.byref(state), ctypes.byref(port), folder, ctypes.c_size_t(4096), False
    )
    assert os.strerror(code) == "Is a directory"
