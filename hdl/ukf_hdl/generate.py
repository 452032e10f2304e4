"""Generator of the packaged core: Verilog, description, and what software needs."""

import json
import os
from collections.abc import Iterable, Mapping
from contextlib import contextmanager
from functools import lru_cache
from itertools import dropwhile
from pathlib import Path

import amaranth
from amaranth import ClockDomain, ClockSignal, Module, ResetSignal, Value
from amaranth.back import verilog
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.instance import NAME, Instance, address_range
from ukf_hdl.interfaces.c_driver import c_driver
from ukf_hdl.interfaces.device_tree import device_tree
from ukf_hdl.interfaces.register_page import register_page
from ukf_hdl.interfaces.svd import svd
from ukf_hdl.lint_waivers import lint_waivers
from ukf_sw import __version__
from ukf_sw.c_sources import CNames
from ukf_sw.folders import cache_folder, check_folder, locked, replacing
from ukf_sw.spec.core import PARAMETERS, Core
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.registers import DATA_WIDTH, REGISTERS

__all__ = [
    "NAME",
    "Toplevel",
    "description",
    "files_of",
    "generate",
    "header",
    "interface_files",
    "without_header",
    "write_together",
]

#: A core with the name and in the place that cores have if nothing else is said.
_INSTANCE = Instance()

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


def description(core: UkfCore, instance: Instance = _INSTANCE) -> dict:
    """Describe a core: name, versions, parameters, place in the system, registers and regions.

    Offsets, positions and widths of the registers are those that the hardware has; names and
    meanings are those of :mod:`ukf_sw.spec.registers`.

    Parameters
    ----------
    core
        The core.
    instance
        Its name and place in the system.

    Returns
    -------
    dict
        Of lists, dicts, strings and numbers, ready for JSON.

    Raises
    ------
    ValueError
        If the core cannot be at this address.
    """
    instance.check(core.params)
    memory_map = MemoryMap(core.params)
    return {
        "name": instance.name,
        "c_prefix": instance.prefix,
        "version": __version__,
        "amaranth": amaranth.__version__,
        **(described := Core(params=core.params, pipeline=core.pipeline)).record(),
        "description": described.description,
        "base_address": instance.base_address,
        "address_range": address_range(core.params),
        "interrupt": instance.interrupt,
        "clock_hz": instance.clock_hz,
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
                    "reset": field.value_after_reset(core.params),
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


def interface_files(core: UkfCore, instance: Instance = _INSTANCE) -> dict[str, str]:
    """Render everything that software needs about a core.

    Parameters
    ----------
    core, instance
        As for :func:`description`.

    Returns
    -------
    dict
        Contents by name of the file; the C driver is in the folder ``c``.

    Raises
    ------
    ValueError
        If the core cannot be at this address.
    """
    record = description(core, instance)
    stem = instance.name
    return {
        f"{stem}.json": json.dumps(record, indent=2) + "\n",
        f"{stem}.svd": svd(record),
        f"{stem}.dtso": device_tree(record),
        f"{stem}.md": register_page(record),
        **{f"c/{name}": text for name, text in c_driver(record).items()},
    }


#: What each line of the header of the Verilog begins with.
_COMMENT = "//"


def header(core: UkfCore) -> str:
    """Render the comment that the Verilog begins with: which core it is, and who wrote it.

    Parameters
    ----------
    core
        The core.
    """
    values = Core(params=core.params, pipeline=core.pipeline).values()
    texts = {label: PARAMETERS[label].text(value) for label, value in values.items()}
    wide, high = (max(map(len, column)) for column in (texts.keys(), texts.values()))
    lines = [
        f" Unscented Kalman filter core. Written by ukf-core {__version__}, do not edit.",
        "",
        *(
            f"   {label:{wide}}  {text:{high}}  {PARAMETERS[label].meaning.doc}"
            for label, text in texts.items()
        ),
    ]
    return "".join(f"{_COMMENT}{line}\n" for line in lines) + "\n"


def without_header(text: str) -> str:
    """Give Verilog without its :func:`header`: what there is to synthesise.

    Parameters
    ----------
    text
        The Verilog.
    """
    lines = text.splitlines(keepends=True)
    return "".join(dropwhile(lambda line: line.startswith((_COMMENT, "\n")), lines))


def _user_cache():
    """Folder of this user's caches, or None without a home."""
    named = os.environ.get("XDG_CACHE_HOME")
    if named:
        return Path(named)
    try:
        return Path.home() / ".cache"
    except RuntimeError:
        return None


@contextmanager
def _builtin_yosys():
    """Have Amaranth use the Yosys that came with it: others write other bytes.

    It keeps itself compiled in a cache of the user, and does not run where there can be none.
    """
    before = dict(os.environ)
    os.environ["AMARANTH_USE_YOSYS"] = "builtin"
    os.environ["XDG_CACHE_HOME"] = str(cache_folder(_user_cache()))
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def write_together(
    files: Mapping[str, str], output: Path, *, gone: Iterable[str] = ()
) -> list[Path]:
    """Write files that belong together, each whole or not at all, and all of them at once.

    Whoever writes others to the same folder at the same time waits, so those of the last one stay.

    Parameters
    ----------
    files
        Contents by name.
    output
        Folder to write to; made if absent.
    gone
        Names of files that are not to be there afterwards, if they are not among the others.

    Returns
    -------
    list of Path
        The files.
    """
    output.mkdir(parents=True, exist_ok=True)
    with locked(output):
        for name, content in files.items():
            (output / name).parent.mkdir(parents=True, exist_ok=True)
            with replacing(output / name) as part:
                part.write_text(content, encoding="utf-8")
        for name in set(gone).difference(files):
            (output / name).unlink(missing_ok=True)
    return [output / name for name in files]


@lru_cache(maxsize=8)
def files_of(
    params: UkfParams, pipeline: Pipeline, instance: Instance, engine=None
) -> dict[str, str]:
    """Render a core; what this process rendered last is kept, for the Verilog takes seconds.

    Parameters
    ----------
    params, pipeline, instance, engine
        As for :func:`generate`.

    Returns
    -------
    dict of str
        Contents of the files by name. Not to be changed.

    Raises
    ------
    ValueError
        If the core cannot be at this address.
    """
    core = UkfCore(params, pipeline, engine=engine)
    interfaces = interface_files(core, instance)
    stem = instance.name
    with _builtin_yosys():
        text = verilog.convert(Toplevel(core), name=stem, emit_src=False, strip_internal_attrs=True)
    return {f"{stem}.v": header(core) + text, f"{stem}.vlt": lint_waivers(stem), **interfaces}


def generate(
    params: UkfParams,
    pipeline: Pipeline | None,
    output: Path,
    *,
    engine=None,
    instance: Instance = _INSTANCE,
    models: Mapping[str, str] | None = None,
) -> list[Path]:
    """Write a core to a folder. Equal inputs give equal files, byte for byte, with equal Amaranth.

    If two cores are written to a folder at the same time, it has all files of the last one; see
    :func:`write_together`.

    Cores of different names can be in one design and their headers in one C program.

    Parameters
    ----------
    params, pipeline
        What the core computes, and how it is built.
    output
        Folder to write to; made if absent.
    engine
        In the place of the core's own, for tests.
    instance
        Its name and place in the system.
    models
        Models in C that belong to the core, contents by name of the file; those of a core that was
        there before go.

    Returns
    -------
    list of Path
        The files written: Verilog, waivers for Verilator's lint, description, CMSIS-SVD, device
        tree overlay, documentation of the registers, C driver, models in C.

    Raises
    ------
    ValueError
        At once, if the folder cannot be written to, or the core cannot be at this address.
    """
    check_folder("output", output)
    written = files_of(params, pipeline or Pipeline(), instance, engine)
    written = written | {f"c/{name}": text for name, text in (models or {}).items()}
    gone = (f"c/{name}" for name in CNames(core=instance.name).files)
    return write_together(written, output, gone=gone)
