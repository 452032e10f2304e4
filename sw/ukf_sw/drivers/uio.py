"""The core through Linux's userspace I/O: a mapping of its registers, and its interrupt.

The device tree names the core ``compatible = "generic-uio"`` (``ukf package`` writes that), and the
kernel's driver ``uio_pdrv_genirq`` makes ``/dev/uioN`` of it: ``mmap`` gives the registers, a read
of 4 bytes waits for an interrupt, and a write of 4 bytes enables the next one, because the driver
disables an interrupt when it comes.
"""

import mmap
import os
import re
import select
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ukf_sw.drivers.device_bus import DeviceBus
from ukf_sw.errors import DeviceError, DeviceMissingError, DevicePermissionError

__all__ = ["UioBus"]

_SYSFS = Path("/sys/class/uio")
_DEVICES = Path("/dev")
_ENABLE = (1).to_bytes(4, "little")


@dataclass(frozen=True, kw_only=True)
class _Device:
    """A UIO device, as Linux lists it."""

    number: int
    name: str
    address: int | None

    @classmethod
    def of(cls, folder: Path) -> "_Device":
        """Read the folder of a device."""
        address = folder / "maps" / "map0" / "addr"
        return cls(
            number=int(folder.name.removeprefix("uio")),
            name=(folder / "name").read_text(encoding="ascii", errors="replace").strip(),
            address=int(address.read_text(encoding="ascii"), 0) if address.is_file() else None,
        )

    @property
    def node(self) -> str:
        """Name of its file in /dev."""
        return f"uio{self.number}"

    def __str__(self) -> str:
        place = "" if self.address is None else f" at {self.address:#x}"
        return f"{self.node}{place} is {self.name}"


def _find(wanted: str, sysfs: Path) -> str:
    """Node of the device with a number, an address, or a name of the device tree.

    Several cores may have one name. Then it says nothing, and none of them is taken.
    """
    number = re.fullmatch(r"(?:uio)?([0-9]+)", wanted)
    if number is not None:
        return f"uio{int(number[1])}"
    folders = [path.parent for path in sysfs.glob("uio*/name")]
    devices = sorted(map(_Device.of, folders), key=lambda device: device.number)
    by_address = re.fullmatch(r"0[xX][0-9a-fA-F]+", wanted) is not None
    kind = "address" if by_address else "name"
    found = [
        device
        for device in devices
        if (device.address == int(wanted, 16) if by_address else device.name == wanted)
    ]
    if len(found) > 1:
        raise DeviceError(
            f"uio:{wanted}",
            f"one UIO device must have this {kind}, not {len(found)}: "
            f"{', '.join(map(str, found))}; give a number or an address",
        )
    if not found:
        known = ", ".join(map(str, devices)) or "none"
        raise DeviceMissingError(
            f"uio:{wanted}", f"no UIO device has this {kind}; there are: {known}"
        )
    return found[0].node


class UioBus(DeviceBus):
    """Bus over a UIO device. Close it, or use it in a ``with`` statement.

    Every word is one load or store of 32 bits: the mapping is an aligned uint32 array, of which
    ``item`` and the assignment of a uint32 scalar take single elements. NumPy does both by
    dereferencing an aligned pointer to a 32-bit integer. Slices would be copied with whatever width
    ``memcpy`` likes, so there are none.

    Parameters
    ----------
    device
        Number N of ``/dev/uioN``, also as "uioN"; physical address of the registers, as
        "0x43c00000"; or name of the device, as in ``/sys/class/uio/uioN/name``, if no other has it.
    guard
        See :class:`ukf_sw.drivers.device_bus.DeviceBus`.
    sysfs, devices
        Where Linux lists and keeps UIO devices.

    Raises
    ------
    DeviceMissingError
        If there is no such device.
    DevicePermissionError
        If this user may not open it.
    DeviceError
        If several devices have this name, or it cannot be mapped.
    """

    def __init__(
        self,
        device: int | str,
        *,
        guard: bool = True,
        sysfs: Path = _SYSFS,
        devices: Path = _DEVICES,
    ) -> None:
        node = _find(str(device), sysfs)
        path = devices / node
        size = sysfs / node / "maps" / "map0" / "size"
        try:
            mapped = int(size.read_text(encoding="ascii"), 0)
            descriptor = os.open(path, os.O_RDWR | os.O_SYNC)
        except FileNotFoundError as error:
            raise DeviceMissingError(
                str(path),
                "no such UIO device; the device tree must have the core as generic-uio, and the "
                "kernel must have been booted with uio_pdrv_genirq.of_id=generic-uio",
            ) from error
        except PermissionError as error:
            raise DevicePermissionError(
                str(path), "permission denied; run as root or give the device to a group"
            ) from error
        except (OSError, ValueError) as error:
            raise DeviceError(str(path), f"cannot be opened: {error}") from error
        try:
            self._attach(descriptor, descriptor, mapped, str(path), guard=guard)
        except BaseException:
            os.close(descriptor)
            raise

    @classmethod
    def of_descriptors(cls, memory: int, events: int, size: int, *, guard: bool = True) -> "UioBus":
        """Make a bus of open file descriptors, which it then owns.

        Parameters
        ----------
        memory
            What to map.
        events
            Where to wait for interrupts; of a UIO device, the same.
        size
            Bytes to map.
        guard
            See :class:`ukf_sw.drivers.device_bus.DeviceBus`.
        """
        bus = cls.__new__(cls)
        bus._attach(memory, events, size, "the descriptors", guard=guard)
        return bus

    def _attach(self, memory: int, events: int, size: int, name: str, *, guard: bool) -> None:
        super().__init__(size, guard=guard)
        try:
            self._mapping = mmap.mmap(memory, size, mmap.MAP_SHARED)
        except (OSError, ValueError) as error:
            raise DeviceError(name, f"cannot map {size} bytes: {error}") from error
        self._name = name
        self._words = np.frombuffer(self._mapping, dtype=np.uint32)
        assert self._words.flags.aligned
        self._events = events
        self._descriptors = {memory, events}
        self._poll = select.poll()
        self._poll.register(events, select.POLLIN)

    def _load(self, address: int) -> int:
        return int(self._words.item(address >> 2))

    def _store(self, address: int, word: int) -> None:
        self._words[address >> 2] = np.uint32(word)

    def wait_for_interrupt(self, timeout: float) -> bool:
        """Wait for the interrupt, so many seconds at most; tells whether it came.

        The interrupt is a level, so it does not matter whether it rose before the call. After a
        time-out, the next call may see an interrupt that came in between.

        Raises
        ------
        DeviceError
            If the device has no interrupt, or fails.
        """
        try:
            os.write(self._events, _ENABLE)
            if not self._poll.poll(max(timeout, 0.0) * 1000.0):
                return False
            count = os.read(self._events, 4)
        except OSError as error:
            raise DeviceError(self._name, f"no interrupt to wait for: {error}") from error
        if len(count) != 4:
            raise DeviceError(self._name, f"4 bytes must come with an interrupt, not {len(count)}")
        return True

    def close(self) -> None:
        """Give the device back. Nothing else may be called afterwards."""
        del self._words
        self._mapping.close()
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors.clear()

    def __enter__(self) -> "UioBus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
