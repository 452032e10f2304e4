"""Buses of boards: Linux UIO on a memory file and a socket, PYNQ on a module that looks like it."""

import asyncio
import copy
import mmap
import os
import pickle
import sys
import types

import numpy as np
import pytest

from support.emulated_core import UioDevice, emulated_core
from support.emulated_core import main as run_on_emulated_board
from ukf_sw.backends import backend_names, make_backend
from ukf_sw.board import main
from ukf_sw.drivers.driver import Driver
from ukf_sw.drivers.pynq_bus import PynqBus
from ukf_sw.drivers.uio import UioBus
from ukf_sw.errors import (
    BusError,
    DeviceError,
    DeviceMissingError,
    DevicePermissionError,
    WrongCoreError,
)
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden import GoldenBus
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.pendulum import pendulum
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.registers import (
    ID,
    MASK,
    REGISTERS,
    STATUS,
)

PARAMS = pendulum(0, steps=1).params
SIZE = max(1 << MemoryMap(PARAMS).address_width, mmap.PAGESIZE)
STEPS = 20


@pytest.fixture
def device():
    device = UioDevice(emulated_core(PARAMS))
    yield device
    device.stop()


def test_a_filter_runs_over_uio_as_on_the_model(device):
    scenario = pendulum(0, steps=STEPS)
    with device.connect() as bus:
        driver = Driver(bus, PARAMS, interrupt=bus.wait_for_interrupt, timeout=10.0)
        results = run(scenario, driver)
    expected = run(scenario, Driver(GoldenBus(emulated_core(PARAMS)), PARAMS))
    assert np.array_equal(results.x, expected.x)
    assert np.array_equal(results.nis, expected.nis)
    assert device.waits >= 2 * STEPS
    assert np.abs(results.x - run(scenario, ReferenceUkf(PARAMS)).x).max() < 1e-4


def test_a_lost_interrupt_over_uio_is_no_error(device):
    device.silent = True
    with device.connect() as bus:
        assert not bus.wait_for_interrupt(0.01)
        assert not bus.wait_for_interrupt(0.0)
        driver = Driver(bus, PARAMS, interrupt=bus.wait_for_interrupt, timeout=0.5)
        found = run(pendulum(0, steps=1), driver)  # the steps have ended all the same
    assert found.steps == 1


def test_a_filter_on_a_board_cannot_be_copied(device):
    with device.connect() as bus:
        driver = Driver(bus, PARAMS, interrupt=bus.wait_for_interrupt, timeout=10.0)
        ukf = UnscentedKalmanFilter(pendulum(0, steps=1), driver)
        for take in (copy.deepcopy, pickle.dumps):
            with pytest.raises(TypeError, match=r"core is behind a UioBus cannot be pickled or"):
                take(ukf)


def test_wrong_core_over_uio(device):
    with device.connect() as bus, pytest.raises(WrongCoreError, match=r"^SIZES.N of the core must"):
        Driver(bus, UkfParams(n=3, m=1))


def test_what_a_core_would_refuse_is_a_bus_error(device):
    """On a board, SLVERR would end the process."""
    with device.connect() as bus:
        buffer = MemoryMap(PARAMS).address("x", 0, 0)
        cases = [2, -4, SIZE, SIZE + 4, max(register.offset for register in REGISTERS) + 4, 252]
        for address in cases:
            with pytest.raises(BusError, match="refused the read") as caught:
                bus.read(address)
            assert caught.value.address == address
            with pytest.raises(BusError, match="refused the write"):
                bus.write(address, 1)
            with pytest.raises(BusError):
                bus.read_many(np.array([ID.offset, address]))
        bus.write(buffer, 7)
        device.words[STATUS.offset >> 2] = 2  # a step runs
        for access in (
            lambda: bus.read(buffer),
            lambda: bus.write(buffer, 8),
            lambda: bus.read_many(np.array([ID.offset, buffer])),
            lambda: bus.write_many(np.array([buffer]), np.array([8], dtype=np.uint32)),
        ):
            with pytest.raises(BusError) as caught:
                access()
            assert caught.value.address == buffer
        assert bus.read(ID.offset) == device.bus.read(ID.offset)  # registers always answer
        device.words[STATUS.offset >> 2] = 0
        assert bus.read(buffer) == 7
    with device.connect(guard=False) as bus:
        device.words[STATUS.offset >> 2] = 2
        assert bus.read(buffer) == 7


def test_words_are_whole_and_in_place(device):
    with device.connect() as bus:
        places = np.array([MemoryMap(PARAMS).address("x", 0, i) for i in range(PARAMS.n)])
        words = np.array([0xDEADBEEF, 0xFFFFFFFF], dtype=np.uint32)
        bus.write_many(places, words)
        assert bus.read_many(places).tolist() == words.tolist()
        assert device.words[places >> 2].tolist() == words.tolist()


def uio_tree(folder, *, number=3, name="ukf_core", size=f"{SIZE:#x}", address="0x43c00000"):
    """Add a device to the lists of Linux, as far as the bus reads them."""
    node = folder / "sys" / f"uio{number}"
    (node / "maps" / "map0").mkdir(parents=True)
    (node / "name").write_text(f"{name}\n")
    (node / "maps" / "map0" / "size").write_text(f"{size}\n")
    (node / "maps" / "map0" / "addr").write_text(f"{address}\n")
    (folder / "dev").mkdir(exist_ok=True)
    with (folder / "dev" / f"uio{number}").open("wb") as file:
        file.truncate(SIZE)
    return {"sysfs": folder / "sys", "devices": folder / "dev"}


@pytest.mark.parametrize("device", [3, "3", "uio3", "ukf_core", "0x43C00000", "0x43c00000"])
def test_uio_devices_are_found_by_number_name_and_address(device, tmp_path):
    with UioBus(device, **uio_tree(tmp_path)) as bus:
        bus.write(MASK.offset, 5)
    assert (tmp_path / "dev" / "uio3").read_bytes()[MASK.offset] == 5


def test_a_name_of_two_uio_devices_is_refused(tmp_path):
    """Which of two cores is meant, nobody can say; in text order, uio10 comes before uio9."""
    for number, address in ((10, "0x43c10000"), (9, "0x43c00000")):
        tree = uio_tree(tmp_path, number=number, address=address)
    # A device without memory is none of ours, and must not be in the way.
    uio_tree(tmp_path, number=11, name="fan")
    (tmp_path / "sys" / "uio11" / "maps" / "map0" / "addr").unlink()
    with pytest.raises(
        DeviceError,
        match=r"^uio:ukf_core: one UIO device must have this name, not 2: uio9 at 0x43c00000 is "
        r"ukf_core, uio10 at 0x43c10000 is ukf_core; give a number or an address$",
    ):
        UioBus("ukf_core", **tree)
    for device, node in (("10", "uio10"), ("uio9", "uio9"), ("0x43C10000", "uio10")):
        with UioBus(device, **tree) as bus:
            assert bus._name == str(tmp_path / "dev" / node)
    with pytest.raises(
        DeviceMissingError,
        match=r"^uio:0x43c20000: no UIO device has this address; there are: uio9 at 0x43c00000 is "
        r"ukf_core, uio10 at 0x43c10000 is ukf_core, uio11 is fan$",
    ):
        UioBus("0x43c20000", **tree)


def test_uio_devices_that_cannot_be_used(tmp_path, monkeypatch):
    tree = uio_tree(tmp_path, size="0x10000000000")
    with pytest.raises(DeviceMissingError, match=r"uio4: no such UIO device.*generic-uio"):
        UioBus(4, **tree)
    with pytest.raises(
        DeviceMissingError, match=r"^uio:other: .*; there are: uio3 at 0x43c00000 is ukf_core$"
    ):
        UioBus("other", **tree)
    with pytest.raises(DeviceError, match="cannot map 1099511627776 bytes"):
        UioBus(3, **tree)
    (tmp_path / "sys" / "uio3" / "maps" / "map0" / "size").write_text("large")
    with pytest.raises(DeviceError, match="cannot be opened"):
        UioBus(3, **tree)
    (tmp_path / "sys" / "uio3" / "maps" / "map0" / "size").write_text("16")
    with pytest.raises(ValueError, match=r"^size must be at least 256 bytes, not 16$"):
        UioBus(3, **tree)

    def denied(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", denied)
    with pytest.raises(DevicePermissionError, match=r"uio3: permission denied; run as root"):
        UioBus(3, **tree)


def test_uio_device_without_interrupt(tmp_path):
    """A device tree without interrupts: the kernel refuses the write."""
    with UioBus(3, **uio_tree(tmp_path)) as bus:
        read_only = os.open(tmp_path / "dev" / "uio3", os.O_RDONLY)
        os.dup2(read_only, bus._events)
        os.close(read_only)
        with pytest.raises(DeviceError, match="no interrupt to wait for"):
            bus.wait_for_interrupt(0.1)


# PYNQ.


class FakeMMIO:
    """``pynq.MMIO`` on the golden model: offsets in bytes, plain int to write."""

    core = None
    made = ()

    def __init__(self, base_addr, length=4):
        self.bus = GoldenBus(FakeMMIO.core)
        FakeMMIO.made = (base_addr, length)

    def read(self, offset=0):
        assert offset % 4 == 0
        return self.bus.read(offset)

    def write(self, offset, data):
        assert type(data) is int
        self.bus.write(offset, data)


class FakeInterrupt:
    """``pynq.Interrupt``: a coroutine that ends when the line is high."""

    def __init__(self, pinname):
        if pinname != "ukf_core_0/irq":
            raise ValueError(f"No Pin of name {pinname} found")

    async def wait(self):
        while not FakeMMIO.core.irq:
            await asyncio.sleep(0.001)


@pytest.fixture
def pynq(monkeypatch):
    FakeMMIO.core = emulated_core(PARAMS)
    module = types.ModuleType("pynq")
    module.MMIO, module.Interrupt = FakeMMIO, FakeInterrupt
    monkeypatch.setitem(sys.modules, "pynq", module)
    made = []
    new = asyncio.new_event_loop
    monkeypatch.setattr(asyncio, "new_event_loop", lambda: made.append(new()) or made[-1])
    yield module
    asyncio.set_event_loop(None)
    for loop in made:
        loop.close()


@pytest.mark.parametrize("name", ["pynq:0x43C00000", "pynq:0x43C00000,ukf_core_0/irq"])
def test_a_filter_runs_over_pynq_as_on_the_model(pynq, name):
    scenario = pendulum(0, steps=STEPS)
    ukf = UnscentedKalmanFilter(scenario, name)
    results = run(scenario, ukf.backend)
    expected = run(scenario, Driver(GoldenBus(emulated_core(PARAMS)), PARAMS))
    assert np.array_equal(results.x, expected.x)
    assert FakeMMIO.made == (0x43C0_0000, 1 << MemoryMap(PARAMS).address_width)


def test_pynq_interrupt_times_out(pynq):
    bus = PynqBus(0x43C0_0000, SIZE, interrupt="ukf_core_0/irq")
    assert not bus.wait_for_interrupt(0.01)


def test_what_can_go_wrong_with_pynq(pynq, monkeypatch):
    with pytest.raises(DeviceMissingError, match="No Pin of name x found"):
        PynqBus(0, SIZE, interrupt="x")
    with pytest.raises(DeviceError, match="made without an interrupt"):
        PynqBus(0, SIZE).wait_for_interrupt(1.0)
    with pytest.raises(ValueError, match=r"^base must be a multiple of 4096, not 0x10$"):
        PynqBus(16, SIZE)
    with pytest.raises(BusError):
        PynqBus(0, SIZE).read(0xFC)

    def broken(error):
        def make(*_):
            raise error

        monkeypatch.setattr(pynq, "MMIO", make)

    for error in (PermissionError("no"), OSError("Root permissions required.")):
        broken(error)
        with pytest.raises(DevicePermissionError, match="PYNQ needs root"):
            PynqBus(0, SIZE)
    broken(RuntimeError("No Devices Found"))
    with pytest.raises(DeviceError, match="PYNQ cannot map it: No Devices Found"):
        PynqBus(0, SIZE)


def test_pynq_that_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "pynq", None)
    with pytest.raises(DeviceMissingError, match="PYNQ is not installed"):
        PynqBus(0, SIZE)


# Backends by name.


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("fpga", "backend must be one of reference, golden, uio, pynq"),
        ("golden:1", "backend must be 'golden', with nothing behind it, not '1'"),
        ("uio", "backend must be 'uio:' and a number, name or address, not 'uio'"),
        ("pynq:here", "backend must be 'pynq:' and an address"),
    ],
)
def test_names_that_are_no_backend(name, message):
    with pytest.raises(ValueError, match=message):
        make_backend(name, PARAMS)


def test_other_packages_add_backends(monkeypatch):
    class Point:
        name = "mine"

        def load(self):
            return lambda params, where, pipeline: (params, where, pipeline)

    def points(group, name=None):
        assert group == "ukf_sw.backends"
        return [Point()] if name in (None, "mine") else []

    monkeypatch.setattr("ukf_sw.backends.entry_points", points)
    assert make_backend("mine:there", PARAMS) == (PARAMS, "there", None)
    deep = Pipeline(add=5)
    assert make_backend("mine:there", PARAMS, deep) == (PARAMS, "there", deep)
    assert backend_names() == ["reference", "golden", "uio", "pynq", "mine"]


# The command.


def test_board_command_saves_and_compares(tmp_path, capsys):
    file = tmp_path / "absent" / "saved.npz"
    common = ["--problem", "nanosat-additive", "--steps", "2", "--pes", "10"]
    assert run_on_emulated_board([*common, "--save", str(file)]) == 0
    assert run_on_emulated_board([*common, "--compare", str(file)]) == 0
    out = capsys.readouterr().out
    assert "Equal to" in out
    assert "PREDICT:" in out
    assert run_on_emulated_board([*common, "--seed", "1", "--compare", str(file)]) == 1
    assert "seed is 1, of the saved run 0" in capsys.readouterr().err
    with np.load(file) as saved:
        contents = dict(saved)
    contents["x"][1, 2] = np.nextafter(contents["x"][1, 2], 9.0)
    np.savez(file, **contents)
    assert run_on_emulated_board([*common, "--compare", str(file)]) == 1
    assert "x[2] after step 1 is" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--save", "/dev/null/x.npz"),
            "--save must be a file that can be written, not '",
        ),
        (("--save", "."), "--save must be a file, not the folder '.'"),
        (("--save", "x.foo"), "--save must end with .npz, not 'x.foo'"),
        (
            ("--compare", "absent.npz"),
            "--compare must be a file that --save wrote, not 'absent",
        ),
        (("--compare", "text.npz"), "--compare must be a file that --save wrote, not 'text.npz'"),
        (("--compare", "other.npz"), "--compare must be a file that --save wrote, not 'other"),
        (("--compare", "array.npz"), "--compare must be a file that --save wrote, not 'arr"),
        (("--compare", "objects.npz"), "--compare must be a file that --save wrote, not 'obj"),
        (("--compare", "floats.npz"), "(x must be of float64 and 2 dimensions)"),
        (("--compare", "."), "--compare must be a file that --save wrote, not '.'"),
        (("--problem", "ctrv", "--seed", "3"), "seed must be 0 for ctrv, which is a record, not 3"),
        (("--start", "1"), "--ignore and --start must come with --data"),
        (("--ignore", "temperature"), "--ignore and --start must come with --data"),
        (
            ("--data", "text.npz", "--start", "nan"),
            "start must be a finite time in seconds, not nan",
        ),
        (
            ("--data", "text.npz", "--ignore", "text"),
            "text.npz must have a column time, not only what is",
        ),
    ],
)
def test_board_command_judges_files_before_it_runs(
    tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.npz").write_text("text")
    np.savez(tmp_path / "other.npz", y=np.zeros(3))
    with (tmp_path / "array.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    about = {"problem": "nanosat", "seed": 0, "pes": 1}
    np.savez(tmp_path / "objects.npz", x=np.array([{}]), **about)
    np.savez(tmp_path / "floats.npz", x=np.zeros((2, 7), np.float32), **about)
    monkeypatch.setattr("ukf_sw.board.run", None)
    assert main(["--backend", "reference", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_no_flipped_bit_of_a_saved_run_is_compared(tmp_path, monkeypatch, capsys):
    """It is refused, or at least not equal."""
    monkeypatch.setattr("ukf_sw.board._print", lambda *arguments: None)
    file = tmp_path / "saved.npz"
    common = ["--backend", "reference", "--problem", "pendulum", "--steps", "3"]
    assert main([*common, "--save", str(file)]) == 0
    original = file.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["saved.npz"]
    rng = np.random.default_rng(0)
    codes = []
    for position in rng.integers(8 * len(original), size=100):
        changed = bytearray(original)
        changed[position // 8] ^= 1 << position % 8
        file.write_bytes(changed)
        codes.append(main([*common, "--compare", str(file)]))
        # Some bits mean nothing: dates, for instance.
        equal = "Equal to" in capsys.readouterr().out
        assert equal == (codes[-1] == 0)
    assert set(codes) <= {0, 1, 2}
    assert codes.count(2) > 30


def test_board_command_fails_with_a_message(tmp_path, capsys):
    assert main(["--backend", "uio:99"]) == 1
    assert "DeviceMissingError: /dev/uio99: no such UIO device" in capsys.readouterr().err
    assert main(["--backend", "fpga"]) == 2
    assert "backend must be one of" in capsys.readouterr().err
