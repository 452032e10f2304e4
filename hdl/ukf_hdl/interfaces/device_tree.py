"""Device tree overlay: makes Linux on a Zynq-7000 offer the core through UIO."""

from typing import Any

from ukf_hdl.instance import FIRST_SHARED

__all__ = ["device_tree"]

#: Number of FCLK0 at the clock controller of a Zynq-7000.
_FCLK0 = 15


def device_tree(record: dict[str, Any]) -> str:
    """Render a device tree overlay for ``dtc -@``.

    It adds two nodes below ``/amba`` (label ``amba``) of a Zynq-7000 tree, with the interrupt
    controller ``intc`` and the clock FCLK0 of ``clkc``. The core's own is compatible with
    ``generic-uio``: the kernel's command line needs ``uio_pdrv_genirq.of_id=generic-uio``. Linux
    names the UIO device after it, and sets FCLK0 to the core's clock when it takes the node.

    UIO's driver enables no clock, so Linux may switch FCLK0 off as unused. The other node has it
    enabled, by the driver of Xilinx's kernels (``CONFIG_XILINX_FCLK``); others ignore it.

    Parameters
    ----------
    record
        Description of the core.
    """
    name, address, clock = record["name"], record["base_address"], f"<&clkc {_FCLK0}>"
    return f"""\
// Device tree overlay for the UKF core on a Zynq-7000. Generated, do not edit.
/dts-v1/;
/plugin/;

&amba {{
	#address-cells = <1>;
	#size-cells = <1>;

	{name}@{address:x} {{
		compatible = "ukf,ukf-core-{record["version"]}", "generic-uio";
		reg = <{address:#x} {record["address_range"]:#x}>;
		interrupt-parent = <&intc>;
		// Shared peripheral interrupt, high level.
		interrupts = <0 {record["interrupt"] - FIRST_SHARED} 4>;
		// FCLK0, in Hz.
		assigned-clocks = {clock};
		assigned-clock-rates = <{record["clock_hz"]}>;
	}};

	// Keeps FCLK0 running.
	{name}_clock {{
		compatible = "xlnx,fclk";
		clocks = {clock};
	}};
}};
"""
