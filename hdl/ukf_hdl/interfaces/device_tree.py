"""Device tree overlay: makes Linux on a Zynq-7000 offer the core through UIO."""

from typing import Any

__all__ = ["device_tree"]

#: Shared peripheral interrupts of the device tree start at this number of the controller.
FIRST_SHARED = 32
#: Linux maps whole pages.
PAGE = 4096


def device_tree(record: dict[str, Any], *, base_address: int, interrupt: int) -> str:
    """Render a device tree overlay for ``dtc -@``.

    It adds a node below ``/amba`` (label ``amba``) of a Zynq-7000 tree, with the interrupt
    controller ``intc`` and the clock FCLK0 of ``clkc``. The node is compatible with
    ``generic-uio``: the kernel's command line needs ``uio_pdrv_genirq.of_id=generic-uio``.

    Parameters
    ----------
    record
        Description of the core.
    base_address
        Where the core is on the bus of the processor; a multiple of its size, which is at least a
        page.
    interrupt
        Number of its interrupt at the interrupt controller, 32 or more.

    Raises
    ------
    ValueError
        If the address does not fit the size of the core, or the interrupt is not a shared one.
    """
    size = max(PAGE, 1 << record["address_width"])
    if base_address % size or not 0 <= base_address < 1 << 32:
        raise ValueError(
            f"base_address must be a multiple of {size:#x}, the size of the core, of 32 bits, "
            f"not {base_address:#x}"
        )
    if not FIRST_SHARED <= interrupt < 1020:
        raise ValueError(f"interrupt must be between {FIRST_SHARED} and 1019, not {interrupt!r}")
    return f"""\
// Device tree overlay for the UKF core on a Zynq-7000. Generated, do not edit.
/dts-v1/;
/plugin/;

&amba {{
	#address-cells = <1>;
	#size-cells = <1>;

	{record["name"]}@{base_address:x} {{
		compatible = "ukf,ukf-core-{record["version"]}", "generic-uio";
		reg = <{base_address:#x} {size:#x}>;
		interrupt-parent = <&intc>;
		// Shared peripheral interrupt, high level.
		interrupts = <0 {interrupt - FIRST_SHARED} 4>;
		// FCLK0.
		clocks = <&clkc 15>;
	}};
}};
"""
