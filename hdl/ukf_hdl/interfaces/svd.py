"""CMSIS-SVD: the registers for debuggers and for generators of code."""

import xml.etree.ElementTree as ElementTree
from typing import Any

from ukf_sw.spec.registers import ErrorCode
from ukf_sw.spec.sequence import Step

__all__ = ["svd"]

#: Access of a field: what CMSIS-SVD calls it, what a write does, and whether a read shows it.
ACCESS = {
    "ro": {"access": "read-only"},
    "rw": {"access": "read-write", "modifiedWriteValues": "modify"},
    "wo": {"access": "write-only"},
    "w1s": {"access": "write-only", "modifiedWriteValues": "oneToSet"},
    "rw1c": {"access": "read-write", "modifiedWriteValues": "oneToClear"},
}
#: Fields whose values have names.
VALUES = {("STATUS", "STATE"): Step, ("ERROR", "CODE"): ErrorCode}

Element = ElementTree.Element


def _add(parent: Element, values: dict[str, object]) -> Element:
    """Append elements that hold text, in this order."""
    for name, value in values.items():
        ElementTree.SubElement(parent, name).text = str(value)
    return parent


def _field(parent: Element, register: str, field: dict[str, Any]) -> None:
    element = _add(
        ElementTree.SubElement(parent, "field"),
        {
            "name": field["name"],
            "description": field["doc"],
            "bitOffset": field["lsb"],
            "bitWidth": field["width"],
            **ACCESS[field["access"]],
        },
    )
    names = VALUES.get((register, field["name"]))
    if names is not None:
        values = ElementTree.SubElement(element, "enumeratedValues")
        for member in names:
            _add(
                ElementTree.SubElement(values, "enumeratedValue"),
                {"name": member.name, "value": member.value},
            )


def _register(parent: Element, register: dict[str, Any]) -> None:
    reset = sum(field["reset"] << field["lsb"] for field in register["fields"])
    kinds = {field["access"] for field in register["fields"]}
    element = _add(
        ElementTree.SubElement(parent, "register"),
        {
            "name": register["name"],
            "description": register["doc"],
            "addressOffset": f"{register['offset']:#x}",
            "size": 32,
            "access": "read-only" if kinds == {"ro"} else "read-write",
            "resetValue": f"{reset:#x}",
            "resetMask": "0xffffffff",
        },
    )
    fields = ElementTree.SubElement(element, "fields")
    for field in register["fields"]:
        _field(fields, register["name"], field)


def _peripheral(record: dict[str, Any]) -> str:
    """Describe what is there: the buffer's matrices as well, which no register is."""
    regions = " ".join(
        f"{region['symbol']}, {region['rows']} x {region['columns']} from {region['base']:#x} on: "
        f"{region['doc']}"
        for region in record["regions"]
    )
    return (
        f"Control and status; the buffer follows. Its element (i, j) is at base + "
        f"i * {record['row_stride']:#x} + j * {record['element_bytes']}. {regions}"
    )


def svd(record: dict[str, Any]) -> str:
    """Render the registers as a CMSIS-SVD device of one peripheral, schema version 1.3.

    Parameters
    ----------
    record
        Description of the core.
    """
    device = ElementTree.Element(
        "device",
        {
            "schemaVersion": "1.3",
            "xmlns:xs": "http://www.w3.org/2001/XMLSchema-instance",
            "xs:noNamespaceSchemaLocation": "CMSIS-SVD.xsd",
        },
    )
    _add(
        device,
        {
            "name": record["name"].upper(),
            "version": record["version"],
            "description": "Unscented Kalman filter core.",
            "addressUnitBits": 8,
            "width": 32,
            "size": 32,
            "resetValue": "0x0",
            "resetMask": "0xffffffff",
        },
    )
    peripheral = _add(
        ElementTree.SubElement(ElementTree.SubElement(device, "peripherals"), "peripheral"),
        {
            "name": record["c_prefix"],
            "description": _peripheral(record),
            "baseAddress": f"{record['base_address']:#x}",
        },
    )
    for offset, size, usage in (
        (0, record["region_stride"], "registers"),
        (
            record["region_stride"],
            (1 << record["address_width"]) - record["region_stride"],
            "buffer",
        ),
    ):
        _add(
            ElementTree.SubElement(peripheral, "addressBlock"),
            {"offset": f"{offset:#x}", "size": f"{size:#x}", "usage": usage},
        )
    _add(
        ElementTree.SubElement(peripheral, "interrupt"),
        {
            "name": record["c_prefix"],
            "description": "Enabled events are pending.",
            "value": record["interrupt"],
        },
    )
    registers = ElementTree.SubElement(peripheral, "registers")
    for register in record["registers"]:
        _register(registers, register)
    ElementTree.indent(device)
    text = ElementTree.tostring(device, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'
