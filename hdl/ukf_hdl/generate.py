"""Generator of the packaged core: Verilog, C header and description."""

import json
import os
from contextlib import contextmanager
from pathlib import Path

import amaranth
from amaranth import ClockDomain, ClockSignal, Module, ResetSignal, Value
from amaranth.back import verilog
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from ukf_hdl.control import reset_value
from ukf_hdl.core import UkfCore
from ukf_sw import __version__
from ukf_sw.memory_map import MemoryMap
from ukf_sw.parameters import Pipeline, UkfParams
from ukf_sw.registers import DATA_WIDTH, REGISTERS, ErrorCode, Step

__all__ = ["NAME", "Toplevel", "c_header", "description", "generate"]

#: Name of the Verilog module and stem of the files.
NAME = "ukf_core"

#: Attributes that let Vivado infer what the port names do not say, by port.
VIVADO_ATTRIBUTES = {
    "aclk": {
        "X_INTERFACE_INFO": "xilinx.com:signal:clock:1.0 aclk CLK",
        "X_INTERFACE_PARAMETER": "ASSOCIATED_BUSIF s_axi, ASSOCIATED_RESET aresetn",
    },
    "aresetn": {
        "X_INTERFACE_INFO": "xilinx.com:signal:reset:1.0 aresetn RST",
        "X_INTERFACE_PARAMETER": "POLARITY ACTIVE_LOW",
    },
    "irq": {
        "X_INTERFACE_INFO": "xilinx.com:signal:interrupt:1.0 irq INTERRUPT",
        "X_INTERFACE_PARAMETER": "SENSITIVITY LEVEL_HIGH",
    },
}


def _vivado_attributes(name):
    """Attributes of a port."""
    attributes = dict(VIVADO_ATTRIBUTES.get(name, {}))
    if name.startswith("s_axi_"):
        role = name.removeprefix("s_axi_").upper()
        attributes["X_INTERFACE_INFO"] = f"xilinx.com:interface:aximm:1.0 s_axi {role}"
        if role == "AWADDR":  # the parameters of an interface stand at one of its ports
            attributes["X_INTERFACE_PARAMETER"] = f"PROTOCOL AXI4LITE, DATA_WIDTH {DATA_WIDTH}"
    return attributes


class Toplevel(wiring.Component):
    """Packaging shell with flat, stable port names.

    Amaranth joins nested names with two underscores where bus conventions have one. The shell
    renames them, and brings in the clock and the active-low reset that AXI expects.

    Parameters
    ----------
    core : :class:`wiring.Component`
        Core to wrap. It uses the ``sync`` domain only.

    Members
    -------
    aclk : :py:`In(1)`
        Clock.
    aresetn : :py:`In(1)`
        Synchronous reset, active low.
    ...
        The members of :py:`core`, flattened.
    """

    def __init__(self, core):
        self._core = core
        self._flat = {
            "_".join(map(str, path)): (member, value)
            for path, member, value in core.signature.flatten(core)
        }
        super().__init__({
            "aclk": In(1),
            "aresetn": In(1),
            **{name: member for name, (member, _) in self._flat.items()},
        })  # fmt: skip
        for name in self.signature.members:
            Value.cast(getattr(self, name)).attrs.update(_vivado_attributes(name))

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = ClockDomain()
        m.submodules.core = self._core
        m.d.comb += [ClockSignal().eq(self.aclk), ResetSignal().eq(~self.aresetn)]
        for name, (member, inner) in self._flat.items():
            outer = getattr(self, name)
            m.d.comb += inner.eq(outer) if member.flow is In else outer.eq(inner)
        return m


def description(core: UkfCore) -> dict:
    """Describe a core: versions, parameters, registers and regions.

    Offsets, positions and widths of the registers are those that the hardware has; names and
    meanings are those of :mod:`ukf_sw.registers`.

    Parameters
    ----------
    core
        The core.

    Returns
    -------
    dict
        Of lists, dicts, strings and numbers, ready for JSON.
    """
    params, pipeline = core.params, core.pipeline
    memory_map = MemoryMap(params)
    return {
        "name": NAME,
        "version": __version__,
        "amaranth": amaranth.__version__,
        "parameters": {
            "n": params.n,
            "m": params.m,
            "q": params.q,
            "r": params.r,
            "process_noise": params.process_noise.value,
            "observation_noise": params.observation_noise.value,
            "W0": params.W0,
            "form": params.form.value,
            "format": {
                "name": params.format.name,
                "exponent_bits": params.format.exponent_bits,
                "fraction_bits": params.format.fraction_bits,
            },
            "pes": params.pes,
        },
        "pipeline": {
            "multiply": pipeline.multiply,
            "add": pipeline.add,
            "reciprocal_sqrt": pipeline.reciprocal_sqrt,
        },
        "address_width": memory_map.address_width,
        "element_bytes": memory_map.element_bytes,
        "row_stride": memory_map.row_stride,
        "region_stride": memory_map.region_stride,
        "registers": _describe_registers(core),
        "regions": [
            {
                "symbol": region.symbol,
                "name": region.name,
                "base": region.index * memory_map.region_stride,
                "rows": region.rows,
                "columns": region.columns,
                "doc": region.doc,
            }
            for region in memory_map
        ],
    }


def _describe_registers(core):
    """Registers as the CSR library placed them, with the words of the description."""
    described = {register.name: register for register in REGISTERS}
    registers = []
    for info in core.register_map.all_resources():
        register = described[str(info.path[-1][-1])]
        fields = []
        position = 0
        for path, action in info.resource:
            width = action.port.shape.width
            if not path[-1].startswith("reserved_"):
                field = register[path[-1]]
                fields.append({
                    "name": field.name,
                    "lsb": position,
                    "width": width,
                    "access": field.access.value,
                    "reset": reset_value(core.params, register, field),
                    "doc": field.doc,
                })  # fmt: skip
            position += width
        registers.append({
            "name": register.name,
            "offset": info.start * (DATA_WIDTH // 8),
            "doc": register.doc,
            "fields": fields,
        })  # fmt: skip
    return registers


def c_header(core: UkfCore) -> str:
    """Render the map of a core as a C header, C99 and later.

    Parameters
    ----------
    core
        The core.
    """
    record = description(core)
    lines = [
        "/* Register and memory map of the UKF core. Generated, do not edit. */",
        "#ifndef UKF_CORE_H",
        "#define UKF_CORE_H",
        "",
        "/* Sizes. */",
        *(f"#define UKF_{name.upper()} {record['parameters'][name]}u" for name in "nmqr"),
        f"#define UKF_POINTS {core.params.N}u",
        f"#define UKF_PES {core.params.pes}u",
        f"#define UKF_EXPONENT_BITS {core.params.format.exponent_bits}u",
        f"#define UKF_FRACTION_BITS {core.params.format.fraction_bits}u",
        "",
        "/* Addresses are in bytes. Element (i, j) of a region is at",
        " * base + i * UKF_ROW_STRIDE + j * UKF_ELEMENT_BYTES. */",
        f"#define UKF_ADDRESS_BITS {record['address_width']}u",
        f"#define UKF_ELEMENT_BYTES {record['element_bytes']}u",
        f"#define UKF_ROW_STRIDE {record['row_stride']:#x}u",
        f"#define UKF_REGION_STRIDE {record['region_stride']:#x}u",
    ]
    for region in record["regions"]:
        stem = f"UKF_{region['name'].upper()}"
        lines += [
            "",
            f"/* {region['symbol']}: {region['doc']} */",
            f"#define {stem}_BASE {region['base']:#x}u",
            f"#define {stem}_ROWS {region['rows']}u",
            f"#define {stem}_COLUMNS {region['columns']}u",
        ]
    for register in record["registers"]:
        stem = f"UKF_{register['name']}"
        lines += ["", f"/* {register['doc']} */", f"#define {stem}_OFFSET {register['offset']:#x}u"]
        for field in register["fields"]:
            mask = ((1 << field["width"]) - 1) << field["lsb"]
            lines += [
                f"#define {stem}_{field['name']}_SHIFT {field['lsb']}u",
                f"#define {stem}_{field['name']}_MASK {mask:#x}u",
            ]
    lines += ["", "/* Values of STATUS.STATE. */"]
    lines += [f"#define UKF_STEP_{step.name} {step.value}u" for step in Step]
    lines += ["", "/* Values of ERROR.CODE. */"]
    lines += [f"#define UKF_ERROR_CODE_{code.name} {code.value}u" for code in ErrorCode]
    return "\n".join([*lines, "", "#endif", ""])


@contextmanager
def _builtin_yosys():
    """Have Amaranth use the Yosys that came with it: others write other bytes."""
    name = "AMARANTH_USE_YOSYS"
    before = os.environ.get(name)
    os.environ[name] = "builtin"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def generate(
    params: UkfParams, pipeline: Pipeline | None, output: Path, *, engine=None
) -> list[Path]:
    """Write a core to a folder. Equal inputs give equal files, byte for byte.

    Parameters
    ----------
    params, pipeline
        What the core computes, and how it is built.
    output
        Folder to write to; made if absent.
    engine
        In the place of the core's own, for tests.

    Returns
    -------
    list of Path
        The files written: Verilog, description, C header.
    """
    core = UkfCore(params, pipeline, engine=engine)
    with _builtin_yosys():
        text = verilog.convert(Toplevel(core), name=NAME, emit_src=False, strip_internal_attrs=True)
    files = {
        f"{NAME}.v": text,
        f"{NAME}.json": json.dumps(description(core), indent=2) + "\n",
        f"{NAME}.h": c_header(core),
    }
    output.mkdir(parents=True, exist_ok=True)
    for file, content in files.items():
        (output / file).write_text(content, encoding="utf-8")
    return [output / file for file in files]
