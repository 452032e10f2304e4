"""IPs that a block design may use, with their pins: AMD's, and the core from its Verilog."""

import re
from dataclasses import dataclass, field

__all__ = [
    "AXI",
    "BOARD_PARTS",
    "CATALOGUE",
    "PS7",
    "Ip",
    "Port",
    "ScriptError",
    "core_of_verilog",
    "is_part",
]


class ScriptError(Exception):
    """A script asks for something that there is not, or leaves something undone."""


@dataclass(kw_only=True)
class Port:
    """A pin of a cell: "in" or "out", and what it carries; "any" takes what its driver carries."""

    direction: str
    kind: str = "data"
    required: bool = True
    active_low: bool = False


@dataclass(kw_only=True)
class Ip:
    """An IP of the catalogue."""

    pins: dict[str, Port]
    #: Interfaces: "master" or "slave", and the pin of their clock.
    interfaces: dict[str, tuple[str, str]] = field(default_factory=dict)
    #: Properties, with the values that they have at first.
    config: dict[str, str] = field(default_factory=dict)
    spaces: dict[str, tuple[int, int]] = field(default_factory=dict)
    segments: dict[str, int] = field(default_factory=dict)
    #: Pins and interfaces that exist only while properties have one of these values.
    exists: dict[str, dict[str, tuple[str, ...]]] = field(default_factory=dict)


def _clock() -> Port:
    return Port(direction="in", kind="clock")


PS7 = Ip(
    pins={
        "FCLK_CLK0": Port(direction="out", kind="clock"),
        "FCLK_RESET0_N": Port(direction="out", kind="reset", active_low=True),
        "M_AXI_GP0_ACLK": _clock(),
        "IRQ_F2P": Port(direction="in", kind="interrupt"),
    },
    interfaces={"M_AXI_GP0": ("master", "M_AXI_GP0_ACLK")},
    config={
        "PCW_USE_M_AXI_GP0": "0", "PCW_EN_CLK0_PORT": "0", "PCW_EN_RST0_PORT": "0",
        "PCW_FPGA0_PERIPHERAL_FREQMHZ": "50", "PCW_USE_FABRIC_INTERRUPT": "0",
        "PCW_IRQ_F2P_INTR": "0",
    },
    # The window of M_AXI_GP0 (UG585, system address map).
    spaces={"Data": (0x4000_0000, 0x7FFF_FFFF)},
    exists={
        "M_AXI_GP0": {"PCW_USE_M_AXI_GP0": ("1",)},
        "M_AXI_GP0_ACLK": {"PCW_USE_M_AXI_GP0": ("1",)},
        "FCLK_CLK0": {"PCW_EN_CLK0_PORT": ("1",)},
        "FCLK_RESET0_N": {"PCW_EN_RST0_PORT": ("1",)},
        "IRQ_F2P": {"PCW_USE_FABRIC_INTERRUPT": ("1",), "PCW_IRQ_F2P_INTR": ("1",)},
    },
)  # fmt: skip
_RESET = Ip(
    pins={
        "slowest_sync_clk": _clock(),
        "ext_reset_in": Port(direction="in", kind="reset", active_low=True),
        "aux_reset_in": Port(direction="in", kind="reset", required=False),
        "mb_debug_sys_rst": Port(direction="in", kind="reset", required=False),
        "dcm_locked": Port(direction="in", required=False),
        "mb_reset": Port(direction="out", kind="reset"),
        "bus_struct_reset": Port(direction="out", kind="reset"),
        "peripheral_reset": Port(direction="out", kind="reset"),
        "interconnect_aresetn": Port(direction="out", kind="reset", active_low=True),
        "peripheral_aresetn": Port(direction="out", kind="reset", active_low=True),
    }
)
_SMARTCONNECT = Ip(
    pins={"aclk": _clock(), "aresetn": Port(direction="in", kind="reset", active_low=True)},
    interfaces={"S00_AXI": ("slave", "aclk"), "M00_AXI": ("master", "aclk")},
    config={"NUM_SI": "1", "NUM_MI": "1"},
)
_LINES = range(16)
_CONCAT = Ip(
    pins={
        **{f"In{k}": Port(direction="in", kind="any") for k in _LINES},
        "dout": Port(direction="out", kind="interrupt"),
    },
    config={"NUM_PORTS": "2"},
    exists={f"In{k}": {"NUM_PORTS": tuple(str(n + 1) for n in _LINES[k:])} for k in _LINES},
)
_CONSTANT = Ip(pins={"dout": Port(direction="out")}, config={"CONST_WIDTH": "1", "CONST_VAL": "1"})
CATALOGUE = {
    "xilinx.com:ip:processing_system7:5.5": PS7,
    "xilinx.com:ip:proc_sys_reset:5.0": _RESET,
    "xilinx.com:ip:smartconnect:1.0": _SMARTCONNECT,
    "xilinx.com:ip:xlconcat:2.1": _CONCAT,
    "xilinx.com:ip:xlconstant:1.1": _CONSTANT,
}
#: Board files of AMD's store, with their devices (on GitHub: Avnet/bdf, Xilinx/XilinxBoardStore).
#: PYNQ-Z2's came to the store in September 2022. None of them comes with Vivado.
BOARD_PARTS = {
    "avnet.com:zedboard:part0:1.3": "xc7z020clg484-1",
    "avnet.com:zedboard:part0:1.4": "xc7z020clg484-1",
    "Avnet-tria:zedboard:part0:1.5": "xc7z020clg484-1",
    "tul.com.tw:pynq-z2:part0:1.0": "xc7z020clg400-1",
}


def is_part(name: str) -> bool:
    """Whether a device is a Zynq-7000, of which the block design is."""
    return re.fullmatch(r"x[acq]7z\d{3}s?[a-z]+\d+-[123][a-z]*", name) is not None


#: Signals of AXI4-Lite that a slave must have.
AXI = frozenset(
    [
        "AWADDR",
        "AWVALID",
        "AWREADY",
        "WDATA",
        "WSTRB",
        "WVALID",
        "WREADY",
        "BRESP",
        "BVALID",
        "BREADY",
        "ARADDR",
        "ARVALID",
        "ARREADY",
        "RDATA",
        "RRESP",
        "RVALID",
        "RREADY",
    ]
)


def core_of_verilog(text: str, name: str) -> Ip:
    """Pins and interfaces of the core, as its Verilog has them."""
    module = re.search(rf"^module {name}\((.*?)\);(.*?)^endmodule", text, re.S | re.M)
    if module is None:
        raise ScriptError(f"the Verilog must have the module {name}")
    ports = re.findall(
        r"((?:^  \(\* .*? \*\)\n)*)^  (input|output) (?:reg )?(?:\[\d+:0\] )?(\w+);",
        module[2], re.M,
    )  # fmt: skip
    pins: dict[str, Port] = {}
    roles: dict[str, set[str]] = {}
    clock_of: dict[str, str] = {}
    for attributes, direction, port in ports:
        values = dict(re.findall(r'\(\* (\w+) = "(.*?)" \*\)', attributes))
        info = re.fullmatch(r"xilinx\.com:(\w+):(\w+):1\.0 (\w+) (\w+)", values["X_INTERFACE_INFO"])
        if info is None:
            raise ScriptError(f"{port}: X_INTERFACE_INFO must name an interface")
        _, kind, interface, role = info.groups()
        more = values.get("X_INTERFACE_PARAMETER", "")
        if kind == "aximm":
            roles.setdefault(interface, set()).add(role)
            continue
        pins[port] = Port(
            direction="in" if direction == "input" else "out",
            kind=kind,
            active_low="ACTIVE_LOW" in more,
        )
        for bus in re.findall(r"ASSOCIATED_BUSIF (\w+)", more):
            clock_of[bus] = port
    for bus, found in roles.items():
        if AXI - found:
            raise ScriptError(f"{bus} must have {sorted(AXI - found)}")
        if bus not in clock_of:
            raise ScriptError(f"{bus} must have a clock")
    return Ip(pins=pins, interfaces={bus: ("slave", clock_of[bus]) for bus in roles})
