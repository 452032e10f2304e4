"""The core through PYNQ: the registers by its MMIO, the interrupt by its asyncio Interrupt.

PYNQ is imported when a bus is made, because it exists on its boards only.
"""

import asyncio
from importlib import import_module
from typing import Any

from ukf_sw.drivers.device_bus import DeviceBus
from ukf_sw.errors import DeviceError, DeviceMissingError, DevicePermissionError

__all__ = ["PynqBus"]


def _import(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise DeviceMissingError(
            name, "PYNQ is not installed; it comes with the images of PYNQ boards"
        ) from error


class PynqBus(DeviceBus):
    """Bus over ``pynq.MMIO``, whose ``read`` and ``write`` access one element of a uint32 array.

    Parameters
    ----------
    base
        Physical address of the core.
    size
        Bytes to map: 2 to the number of address bits of the core.
    interrupt
        Name of the interrupt pin in the block design, "ukf_core_0/irq" for instance; None is no
        interrupt, for drivers that poll.
    guard
        See :class:`ukf_sw.drivers.device_bus.DeviceBus`.

    Raises
    ------
    ValueError
        If the address is not one.
    DeviceMissingError
        If PYNQ is not installed, or the overlay has no such interrupt.
    DevicePermissionError
        If this user may not map physical memory.
    DeviceError
        If PYNQ fails in another way.
    """

    def __init__(
        self, base: int, size: int, *, interrupt: str | None = None, guard: bool = True
    ) -> None:
        super().__init__(size, guard=guard)
        if base < 0 or base % 4096:
            raise ValueError(f"base must be a multiple of 4096, not {base:#x}")
        self._name = f"pynq:{base:#x}"
        self._base = base
        pynq = _import("pynq")
        try:
            self._mmio = pynq.MMIO(base, size)
        except PermissionError as error:
            raise self._denied() from error
        except Exception as error:  # whatever PYNQ raises; older ones EnvironmentError for this
            if "root" in str(error).lower():
                raise self._denied() from error
            raise DeviceError(self._name, f"PYNQ cannot map it: {error}") from error
        self._interrupt: Any = None
        if interrupt is not None:
            # PYNQ has its interrupts wait in the loop that is the current one when it makes them.
            self._loop = asyncio.new_event_loop()
            asyncio.set_event_loop(self._loop)
            try:
                self._interrupt = pynq.Interrupt(interrupt)
            except ValueError as error:
                raise DeviceMissingError(self._name, f"no interrupt: {error}") from error

    def _denied(self) -> DevicePermissionError:
        return DevicePermissionError(self._name, "permission denied; PYNQ needs root")

    def _load(self, address: int) -> int:
        return int(self._mmio.read(address))

    def _store(self, address: int, word: int) -> None:
        self._mmio.write(address, int(word))

    def wait_for_interrupt(self, timeout: float) -> bool:
        """Wait for the interrupt, so many seconds at most; tells whether it came.

        Must not be called from a running event loop, because it runs one.

        Raises
        ------
        DeviceError
            If the bus was made without an interrupt.
        """
        if self._interrupt is None:
            raise DeviceError(self._name, "the bus was made without an interrupt")
        try:
            self._loop.run_until_complete(asyncio.wait_for(self._interrupt.wait(), timeout))
        except (TimeoutError, asyncio.TimeoutError):  # one and the same since Python 3.11
            return False
        return True
