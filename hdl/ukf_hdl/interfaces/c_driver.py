"""The C driver of a core, as a folder that is ready to compile."""

from typing import Any

from ukf_hdl.interfaces.c_header import core_header, registers_header
from ukf_sw.c_sources import C_SOURCES, DRIVER_HEADERS, DRIVER_SOURCES, PORTS

__all__ = ["c_driver", "c_headers"]

#: Bits of exponent and fraction of the formats that the driver has: those of float and double.
_FORMATS = ((8, 23), (11, 52))


def c_headers(record: dict[str, Any]) -> dict[str, str]:
    """Render the headers that belong to one core.

    Parameters
    ----------
    record
        Description of the core.

    Returns
    -------
    dict
        Texts by name of the file.
    """
    return {f"{record['name']}.h": core_header(record), "ukf_registers.h": registers_header(record)}


def c_driver(record: dict[str, Any]) -> dict[str, str]:
    """Give the C driver with the headers of a core.

    Parameters
    ----------
    record
        Description of the core.

    Returns
    -------
    dict
        Texts by name of the file in the folder. Only headers if the number format of the core is
        not one of C.
    """
    number_format = record["parameters"]["format"]
    headers = c_headers(record)
    if (number_format["exponent_bits"], number_format["fraction_bits"]) not in _FORMATS:
        return headers
    ports = (f"{port}.{kind}" for port in PORTS for kind in ("h", "c"))
    names = ("README.md", *DRIVER_HEADERS, *DRIVER_SOURCES, *ports)
    return headers | {name: (C_SOURCES / name).read_text(encoding="utf-8") for name in names}
