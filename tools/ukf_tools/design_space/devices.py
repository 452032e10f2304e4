"""Zynq-7000 devices, and how much of one a core takes."""

from dataclasses import dataclass

from ukf_tools.estimate.series7 import Resources

__all__ = ["DEVICES", "Device", "share"]


@dataclass(frozen=True, kw_only=True)
class Device:
    """A device.

    Parameters
    ----------
    name
        Name.
    lut, ff, dsp48e1, bram36
        What its programmable logic has.
    """

    name: str
    lut: int
    ff: int
    dsp48e1: int
    bram36: int


#: Source: Xilinx DS190, Zynq-7000 SoC data sheet: overview, table 1.
DEVICES = (
    Device(name="XC7Z010", lut=17_600, ff=35_200, dsp48e1=80, bram36=60),
    Device(name="XC7Z020", lut=53_200, ff=106_400, dsp48e1=220, bram36=140),
    Device(name="XC7Z045", lut=218_600, ff=437_200, dsp48e1=900, bram36=545),
)


def share(resources: Resources, device: Device) -> dict[str, float]:
    """Give the share of a device that is used, by resource; more than 1 does not fit."""
    return {
        "LUT": resources.lut / device.lut,
        "FF": resources.ff / device.ff,
        "DSP48E1": resources.dsp48e1 / device.dsp48e1,
        "BRAM36": resources.bram36 / device.bram36,
    }
