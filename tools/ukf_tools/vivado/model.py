"""Vivado's commands, acting on a small model of projects, IPs and block designs."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from ukf_tools.vivado.commands import COMMANDS, PROPERTIES, VERSIONS
from ukf_tools.vivado.ips import (
    BOARD_PARTS,
    CATALOGUE,
    PS7,
    Ip,
    Port,
    ScriptError,
    core_of_verilog,
    is_part,
)

__all__ = ["Vivado"]


@dataclass
class _Arguments:
    """Arguments of a command, parted."""

    plain: list[str]
    options: dict[str, str]
    flags: set[str]


def _numbers(version: str) -> tuple[int, ...]:
    """Version as numbers: 1.10 comes after 1.9."""
    return tuple(map(int, version.split(".")))


_RUNS = ("synth_1", "impl_1")
#: Where the board store is installed to.
_STORE = "/home/user/.Xilinx/xhub/board_store/boards"


class Vivado:
    """The model.

    Parameters
    ----------
    folder
        A package.
    version
        Version of Vivado, one of :data:`ukf_tools.vivado.commands.VERSIONS`.
    """

    def __init__(self, folder: Path, version: str = VERSIONS[-1]) -> None:
        import tkinter

        self.folder = folder
        self.version = version
        self.tcl = tkinter.Tcl()
        self.commands = 0
        self.error: ScriptError | None = None
        self.project: str | None = None
        self.part = ""
        self.repositories: list[str] = []
        self.board_part = ""
        self.parameters = {"board.repoPaths": ""}
        self.refreshed = False
        self.installed: list[str] = []
        self.added: dict[str, Path] = {}
        self.top = ""
        self.catalogue = dict(CATALOGUE)
        self.packaged: dict[str, Any] = {}
        self.design = ""
        self.cells: dict[str, tuple[Ip, dict[str, str]]] = {}
        self.nets: list[list[str]] = []
        self.links: list[tuple[str, str]] = []
        self.addresses: dict[str, tuple[int, int]] = {}
        self.preset = False
        self.validated = self.saved = False
        self.done: list[str] = []
        self.outputs: set[str] = set()
        self._define()

    # Plumbing.

    def _define(self) -> None:
        self.tcl.eval("namespace eval ipx {}; namespace eval xhub {}; rename file _file")
        self.tcl.eval(
            "proc file {action args} { if {$action in {copy delete mkdir rename}} "
            "{ model_file $action {*}$args } else { uplevel 1 [list _file $action {*}$args] } }"
        )
        handlers = {
            name.removeprefix("do_").replace("__", "::"): getattr(self, name)
            for name in dir(self)
            if name.startswith("do_")
        }
        for name, handler in handlers.items():
            self.tcl.createcommand(name, self._counted(name, handler))
        self.tcl.createcommand("model_file", self._file)

    def _counted(self, name: str, handler: Callable[[_Arguments], Any]) -> Callable[..., str]:
        entry = COMMANDS[name]

        def call(*words: Any) -> str:
            self.commands += 1
            if self.version in entry.lacking:
                self.error = ScriptError(f"Vivado {self.version} has no {name}")
                raise self.error
            texts = [str(word) for word in words]
            arguments = _Arguments([], {}, set())
            rest = iter(texts)
            for text in rest:
                if text in entry.valued:
                    arguments.options[text] = next(rest, "")
                elif text in entry.flags:
                    arguments.flags.add(text)
                elif re.match(r"-[a-z]", text):
                    self.error = ScriptError(f"{name} has no option {text}")
                    raise self.error
                else:
                    arguments.plain.append(text)
            try:
                result = handler(arguments)
            except (ScriptError, KeyError, IndexError, ValueError) as error:
                # Tcl passes on that there was an error, but not which.
                known = isinstance(error, ScriptError)
                self.error = error if known else ScriptError(f"{name} {' '.join(texts)}: {error!r}")
                raise
            return "" if result is None else str(result)

        return call

    def run(self, script: Path) -> None:
        """Execute a script."""
        import tkinter

        try:
            self.tcl.call("source", str(script))
        except (tkinter.TclError, ScriptError, KeyError, IndexError, ValueError) as error:
            raise ScriptError(f"{script.name}: {self.error or error}") from error

    def _list(self, text: str) -> list[str]:
        return [str(item) for item in self.tcl.splitlist(text)]

    def _file(self, action: str, *words: Any) -> str:
        paths = [str(word) for word in words if str(word) != "-force"]
        source = Path(paths[0])
        if action != "copy" or len(paths) != 2:
            self.error = ScriptError(f"file {action} must not be needed")
        elif "write_bitstream" not in self.done:
            self.error = ScriptError(f"{source.name} must be copied after it is made")
        elif source.stem not in (f"{self.design}_wrapper", self.design):
            self.error = ScriptError(f"there will be no file {source.name}")
        if self.error is not None:
            raise self.error
        self.outputs.add(Path(paths[1]).name)
        return ""

    def _open_project(self) -> None:
        if self.project is None:
            raise ScriptError("a project must be open")

    # Projects.

    def do_create_project(self, a: _Arguments) -> None:
        self.part = a.options.get("-part", "")
        if not is_part(self.part):
            raise ScriptError(f"there is no part {self.part!r}")
        if self.project is not None:
            raise ScriptError(f"the project {self.project} is still open")
        self.project = a.plain[0] if a.plain else "in memory"
        self.added, self.top = {}, ""

    def do_close_project(self, a: _Arguments) -> None:
        self._open_project()
        self.project = None

    def do_current_project(self, a: _Arguments) -> str:
        self._open_project()
        return "project"

    def do_current_fileset(self, a: _Arguments) -> str:
        self._open_project()
        return "fileset"

    def do_add_files(self, a: _Arguments) -> None:
        self._open_project()
        for name in a.plain:
            path = Path(name)
            if not path.is_file() and name not in self.outputs:
                raise ScriptError(f"there is no file {name}")
            self.added[path.name] = path
            if path.suffix == ".xdc":
                self._constrain(path)

    def _constrain(self, path: Path) -> None:
        """Read constraints: their ports must be ports of the core."""
        name = str(self.tcl.eval("set core_name"))
        core = core_of_verilog((self.folder / "rtl" / f"{name}.v").read_text("utf-8"), name)
        for line in path.read_text(encoding="utf-8").splitlines():
            if not line or line.startswith("#"):
                continue
            match = re.fullmatch(r"create_clock -period (\d+\.\d+) \[get_ports (\w+)\]", line)
            if match is None:
                raise ScriptError(f"{path.name}: {line!r} is not understood")
            if match[2] not in core.pins or core.pins[match[2]].kind != "clock":
                raise ScriptError(f"{path.name}: there is no clock {match[2]}")

    def do_get_files(self, a: _Arguments) -> str:
        if a.plain[0] not in self.added:
            raise ScriptError(f"the project has no file {a.plain[0]}")
        return a.plain[0]

    def do_update_compile_order(self, a: _Arguments) -> None:
        if a.options.get("-fileset") != "sources_1":
            raise ScriptError(f"there is no fileset {a.options.get('-fileset')}")

    # Boards.

    def do_set_param(self, a: _Arguments) -> None:
        name, value = a.plain
        self._known("parameter", name)
        self.parameters[name] = value

    def do_get_param(self, a: _Arguments) -> str:
        self._known("parameter", a.plain[0])
        return self.parameters[a.plain[0]]

    def do_get_board_parts(self, a: _Arguments) -> str:
        if _STORE not in self._list(self.parameters["board.repoPaths"]):
            return ""  # only in its window does Vivado look there by itself
        pattern, latest = a.plain[0], dict[str, str]()
        fold = str.lower if "-nocase" in a.flags else str
        found = [part for part in BOARD_PARTS if fnmatchcase(fold(part), fold(pattern))]
        if "-latest_file_version" not in a.flags:
            return " ".join(found)
        for part in found:
            board, _, version = part.rpartition(":")
            if board not in latest or _numbers(version) > _numbers(latest[board]):
                latest[board] = version
        return " ".join(f"{board}:{version}" for board, version in latest.items())

    def do_xhub__get_xstores(self, a: _Arguments) -> str:
        if a.plain != ["xilinx_board_store"]:
            raise ScriptError(f"there is no store {a.plain}")
        return "store"

    def do_xhub__refresh_catalog(self, a: _Arguments) -> None:
        self.refreshed = a.plain == ["store"]

    def do_xhub__get_xitems(self, a: _Arguments) -> str:
        if not self.refreshed:
            raise ScriptError("the catalogue of the store must be refreshed first")
        items = {":".join((*part.split(":")[:2], part.split(":")[3])) for part in BOARD_PARTS}
        names = [item.replace(":", ":xilinx_board_store:", 1) for item in sorted(items)]
        return " ".join(name for name in names if fnmatchcase(name, a.plain[0]))

    def do_xhub__install(self, a: _Arguments) -> None:
        self.installed += self._list(a.plain[0])

    def do_update_ip_catalog(self, a: _Arguments) -> None:
        self._open_project()
        if self.packaged and self.packaged.get("saved"):
            if self.packaged["root"] not in self.repositories:
                raise ScriptError(f"ip_repo_paths must have {self.packaged['root']}")
            p = self.packaged
            self.catalogue[f"{p['vendor']}:{p['library']}:{p['name']}:{p['version']}"] = p["ip"]

    # Packaging.

    def do_ipx__package_project(self, a: _Arguments) -> None:
        self._open_project()
        missing = {"-root_dir", "-vendor", "-library", "-taxonomy"} - set(a.options)
        if missing:
            raise ScriptError(f"ipx::package_project must have {sorted(missing)}")
        sources = [path for path in self.added.values() if path.suffix == ".v"]
        if len(sources) != 1:
            raise ScriptError(f"the core must have one file, not {len(sources)}")
        self.packaged = {
            "root": a.options["-root_dir"], "vendor": a.options["-vendor"],
            "library": a.options["-library"], "maps": {}, "blocks": {}, "range": 0,
            "ip": core_of_verilog(sources[0].read_text(encoding="utf-8"), self.top),
        }  # fmt: skip

    def do_ipx__current_core(self, a: _Arguments) -> str:
        if not self.packaged:
            raise ScriptError("no core is being packaged")
        return "core"

    def do_ipx__get_bus_interfaces(self, a: _Arguments) -> str:
        ip: Ip = self.packaged["ip"]
        name = a.plain[0]
        return f"interface:{name}" if name in ip.interfaces or name in ip.pins else ""

    def do_ipx__associate_bus_interfaces(self, a: _Arguments) -> None:
        ip: Ip = self.packaged["ip"]
        bus, clock = a.options["-busif"], a.options["-clock"]
        if ip.interfaces.get(bus, ("", ""))[1] != clock:
            raise ScriptError(f"the clock of {bus} must not be {clock}")

    def do_ipx__get_memory_maps(self, a: _Arguments) -> str:
        return f"map:{a.plain[0]}" if a.plain[0] in self.packaged["maps"] else ""

    def do_ipx__add_memory_map(self, a: _Arguments) -> str:
        if a.plain[0] not in self.packaged["ip"].interfaces:
            raise ScriptError(f"there is no interface {a.plain[0]}")
        self.packaged["maps"][a.plain[0]] = None
        return f"map:{a.plain[0]}"

    def do_ipx__get_address_blocks(self, a: _Arguments) -> str:
        return f"block:{a.plain[0]}" if a.plain[0] in self.packaged["blocks"] else ""

    def do_ipx__add_address_block(self, a: _Arguments) -> str:
        if not a.plain[1].startswith("map:"):
            raise ScriptError(f"{a.plain[1]!r} is no memory map")
        self.packaged["blocks"][a.plain[0]] = 0
        self.packaged["maps"][a.plain[1].removeprefix("map:")] = a.plain[0]
        return f"block:{a.plain[0]}"

    def do_ipx__create_xgui_files(self, a: _Arguments) -> None: ...

    def do_ipx__update_checksums(self, a: _Arguments) -> None: ...

    def do_ipx__check_integrity(self, a: _Arguments) -> None:
        p = self.packaged
        for bus in p["ip"].interfaces:
            if p["maps"].get(bus) is None:
                raise ScriptError(f"{bus} must have a memory map with a block")
            size = p["blocks"][p["maps"][bus]]
            if not size:
                raise ScriptError(f"the block {p['maps'][bus]} must have a range")
            p["ip"].segments = {f"{bus}/{p['maps'][bus]}": size}
        if "name" not in p or "version" not in p:
            raise ScriptError("the core must have a name and a version")

    def do_ipx__save_core(self, a: _Arguments) -> None:
        self.do_ipx__check_integrity(a)
        self.packaged["saved"] = True

    # Properties.

    def do_set_property(self, a: _Arguments) -> None:
        if "-dict" in a.options:
            words = self._list(a.options["-dict"])
            if len(words) % 2:
                raise ScriptError("-dict must have pairs")
            pairs = list(zip(words[::2], words[1::2], strict=True))
            objects = a.plain
        else:
            pairs = [(a.plain[0], a.plain[1])]
            objects = a.plain[2:]
        if len(objects) != 1 or not objects[0]:
            raise ScriptError(f"set_property {pairs[0][0]} must have one object")
        for name, value in pairs:
            self._set(objects[0], name, value)

    def _known(self, kind: str, name: str) -> None:
        """Check that objects of a kind have a property."""
        if (kind, name) not in PROPERTIES:
            raise ScriptError(f"a {kind} has no property {name}")

    def _set(self, what: str, name: str, value: str) -> None:
        if what in self.cells:
            config = self.cells[what][1]
            key = name.removeprefix("CONFIG.")
            if not name.startswith("CONFIG.") or key not in config:
                raise ScriptError(f"{what} has no property {name}")
            config[key] = value
            return
        kind, _, of = what.partition(":")
        kind = "file" if what in self.added else kind
        self._known(kind, name)
        match kind, name:
            case "project", "board_part":
                if BOARD_PARTS.get(value) != self.part:
                    raise ScriptError(f"the board {value} does not have the part {self.part}")
                self.board_part = value
            case "project", _:
                self.repositories = self._list(value)
            case "fileset", _:
                self.top = value
            case "core", _:
                self.packaged[name] = value
                if name == "supported_families" and "zynq" not in value:
                    raise ScriptError("supported_families must have zynq")
            case "interface", _:
                if value not in self.packaged["maps"]:
                    raise ScriptError(f"there is no memory map {value}")
            case "block", "range":
                self.packaged["blocks"][of] = int(value, 0)
            case "file", _:
                if set(value.split()) - {"synthesis", "implementation", "out_of_context"}:
                    raise ScriptError(f"USED_IN must not be {value!r}")
            case _:
                pass

    def do_get_property(self, a: _Arguments) -> str:
        name, what = a.plain
        kind = "run" if what in _RUNS else what
        self._known(kind, name)
        return {
            "PROGRESS": "100%",
            "STATUS": "write_bitstream Complete!",
            "SLACK": "0.5",
            "LOCAL_ROOT_DIR": _STORE,
        }[name]

    # Block design.

    def do_create_bd_design(self, a: _Arguments) -> None:
        self._open_project()
        self.design = a.plain[0]
        self.added[f"{self.design}.bd"] = self.folder
        self.cells = {}

    def do_create_bd_cell(self, a: _Arguments) -> str:
        vlnv = a.options.get("-vlnv", "")
        if a.options.get("-type") != "ip" or vlnv not in self.catalogue:
            raise ScriptError(f"the catalogue has no {vlnv}")
        name = f"/{a.plain[0]}"
        if not self.design or name in self.cells:
            raise ScriptError(f"{name} must be new in an open design")
        ip = self.catalogue[vlnv]
        self.cells[name] = (ip, dict(ip.config))
        return name

    def do_apply_bd_automation(self, a: _Arguments) -> None:
        rule = a.options.get("-rule")
        if rule != "xilinx.com:bd_rule:processing_system7" or len(a.plain) != 1:
            raise ScriptError(f"there is no rule {rule} for {a.plain}")
        words = self._list(a.options["-config"])
        config = dict(zip(words[::2], words[1::2], strict=True))
        preset = config.pop("apply_board_preset", "")
        known = {"make_external": "FIXED_IO, DDR", "Master": "Disable", "Slave": "Disable"}
        if config != known or preset not in ("0", "1"):
            raise ScriptError(f"the rule does not know {config}")
        if bool(self.board_part) != (preset == "1"):
            raise ScriptError("a preset needs a board, and a board has one")
        if self.cells.get(a.plain[0], (None,))[0] is not PS7:
            raise ScriptError(f"{a.plain[0]} is no processing system")
        self.preset = True

    def _find(self, path: str, kind: str) -> str:
        cell, _, name = path.rpartition("/")
        if cell not in self.cells:
            raise ScriptError(f"there is no cell {cell!r}")
        ip, config = self.cells[cell]
        known = ip.pins if kind == "pin" else ip.interfaces
        needs = ip.exists.get(name, {})
        if name not in known:
            raise ScriptError(f"{cell} has no {kind} {name}")
        for key, values in needs.items():
            if config[key] not in values:
                raise ScriptError(f"{cell} has the {kind} {name} only with {key} = {values[0]}")
        return path

    def do_get_bd_pins(self, a: _Arguments) -> str:
        return self._find(a.plain[0], "pin")

    def do_get_bd_intf_pins(self, a: _Arguments) -> str:
        return self._find(a.plain[0], "interface")

    def do_get_bd_addr_spaces(self, a: _Arguments) -> str:
        cell, _, name = a.plain[0].rpartition("/")
        if cell not in self.cells or name not in self.cells[cell][0].spaces:
            raise ScriptError(f"there is no address space {a.plain[0]}")
        return a.plain[0]

    def do_get_bd_addr_segs(self, a: _Arguments) -> str:
        cell, _, name = a.plain[0][1:].partition("/")
        if f"/{cell}" not in self.cells or name not in self.cells[f"/{cell}"][0].segments:
            raise ScriptError(f"there is no address segment {a.plain[0]}")
        return a.plain[0]

    def _port(self, path: str) -> Port:
        cell, _, name = path.rpartition("/")
        return self.cells[cell][0].pins[name]

    def do_connect_bd_net(self, a: _Arguments) -> None:
        joined = [net for net in self.nets if set(net) & set(a.plain)]
        net = list(dict.fromkeys([pin for net in joined for pin in net] + a.plain))
        self.nets = [net for net in self.nets if net not in joined]
        self.nets.append(net)
        drivers = [pin for pin in net if self._port(pin).direction == "out"]
        if len(drivers) != 1:
            raise ScriptError(f"a net must have one driver, not {drivers} for {net}")
        driver = self._port(drivers[0])
        for pin in net:
            port = self._port(pin)
            if port.kind not in ("any", driver.kind):
                raise ScriptError(f"{pin} is a {port.kind}, {drivers[0]} a {driver.kind}")
            if port.kind == "reset" and port.active_low != driver.active_low:
                raise ScriptError(f"{pin} must not have the polarity of {drivers[0]}")

    def do_connect_bd_intf_net(self, a: _Arguments) -> None:
        ends = {self._role(path): path for path in a.plain}
        if set(ends) != {"master", "slave"}:
            raise ScriptError(f"a master and a slave must be connected, not {a.plain}")
        for path in a.plain:
            if any(path in link for link in self.links):
                raise ScriptError(f"{path} is connected already")
        self.links.append((ends["master"], ends["slave"]))

    def _role(self, path: str) -> str:
        cell, _, name = path.rpartition("/")
        return self.cells[cell][0].interfaces[name][0]

    def do_assign_bd_address(self, a: _Arguments) -> None:
        offset, size = int(a.options["-offset"], 0), int(a.options["-range"], 0)
        cell, _, space = a.options["-target_address_space"].rpartition("/")
        low, high = self.cells[cell][0].spaces[space]
        (segment,) = a.plain
        owner, _, name = segment[1:].partition("/")
        needed = self.cells[f"/{owner}"][0].segments[name]
        if size & (size - 1) or size < 4096 or offset % size:
            raise ScriptError(f"{offset:#x} must be a multiple of {size:#x}, a power of 2")
        if size < needed:
            raise ScriptError(f"the range must be at least {needed:#x}, not {size:#x}")
        if not low <= offset <= high - size + 1:
            raise ScriptError(f"{offset:#x} is not in the window {low:#x} to {high:#x}")
        self.addresses[segment] = (offset, size)

    def _net(self, pin: str) -> list[str]:
        for net in self.nets:
            if pin in net:
                return net
        return []

    def interrupt(self) -> int:
        """Number, at the processor's controller, of what drives its interrupts."""
        (processor,) = (cell for cell, (ip, _) in self.cells.items() if ip is PS7)
        (line,) = self._sources(f"{processor}/IRQ_F2P")
        return 61 + line if line < 8 else 84 + line - 8  # UG585, table of the shared interrupts

    def _sources(self, pin: str) -> list[int]:
        """Bits of a pin that are interrupts of a cell, not constant."""
        driver = next(other for other in self._net(pin) if self._port(other).direction == "out")
        cell = driver.rpartition("/")[0]
        width = int(self.cells[cell][1].get("NUM_PORTS", "0"))
        if not width:
            return [0] if self._port(driver).kind == "interrupt" else []
        return [bit for bit in range(width) if self._sources(f"{cell}/In{bit}")]

    def do_validate_bd_design(self, a: _Arguments) -> None:
        if not self.preset:
            raise ScriptError("the processing system must have its preset")
        for cell, (ip, config) in self.cells.items():
            there = {
                name for name in (*ip.pins, *ip.interfaces)
                if all(config[k] in values for k, values in ip.exists.get(name, {}).items())
            }  # fmt: skip
            for name, port in ip.pins.items():
                if name not in there:
                    continue
                wanted = port.required and (port.direction == "in" or port.kind == "interrupt")
                if wanted and not self._net(f"{cell}/{name}"):
                    raise ScriptError(f"{cell}/{name} is not connected")
            for name in ip.interfaces:
                if name in there and not any(f"{cell}/{name}" in link for link in self.links):
                    raise ScriptError(f"{cell}/{name} is not connected")
            for name in ip.segments:
                if f"{cell}/{name}" not in self.addresses:
                    raise ScriptError(f"{cell}/{name} has no address")
        for master, slave in self.links:
            clocks: list[list[str]] = []
            for path in (master, slave):
                cell, _, name = path.rpartition("/")
                clocks.append(self._net(f"{cell}/{self.cells[cell][0].interfaces[name][1]}"))
            if clocks[0] != clocks[1]:
                raise ScriptError(f"{master} and {slave} must have one clock")
        self.validated = True

    def do_save_bd_design(self, a: _Arguments) -> None:
        if not self.validated:
            raise ScriptError("the design must be validated before it is saved")
        self.saved = True

    def do_make_wrapper(self, a: _Arguments) -> str:
        if a.options.get("-files") != f"{self.design}.bd" or not self.saved:
            raise ScriptError("a wrapper needs a design that is saved")
        name = f"{self.design}_wrapper.v"
        self.outputs.add(name)
        return name

    # Building.

    def do_generate_target(self, a: _Arguments) -> None:
        if a.plain[0] != "all" or a.plain[1] not in self.added:
            raise ScriptError(f"there is no target {a.plain}")

    def _run(self, name: str) -> None:
        if name not in _RUNS:
            raise ScriptError(f"there is no run {name}")

    def do_launch_runs(self, a: _Arguments) -> None:
        self._run(a.plain[0])
        if self.top != f"{self.design}_wrapper" or f"{self.top}.v" not in self.added:
            raise ScriptError(f"the top must be the wrapper, not {self.top!r}")
        self.done.append(a.options.get("-to_step", a.plain[0]))

    def do_wait_on_run(self, a: _Arguments) -> None:
        self._run(a.plain[0])
        if not self.done:
            raise ScriptError("no run was launched")

    do_wait_on_runs = do_wait_on_run

    def do_get_runs(self, a: _Arguments) -> str:
        self._run(a.plain[0])
        return a.plain[0]

    def do_open_run(self, a: _Arguments) -> None:
        self._run(a.plain[0])

    def _report(self, a: _Arguments) -> None:
        if "-file" not in a.options:
            raise ScriptError("a report must have a file")

    do_report_utilization = do_report_timing_summary = do_report_power = _report

    def do_get_timing_paths(self, a: _Arguments) -> str:
        if a.options.get("-delay_type", "max") not in ("max", "min", "min_max"):
            raise ScriptError(f"there are no delays {a.options['-delay_type']}")
        return "path"

    def do_write_cfgmem(self, a: _Arguments) -> None:
        how, first, source = self._list(a.options["-loadbit"])
        if (how, int(first, 0)) != ("up", 0) or Path(source).name not in self.outputs:
            raise ScriptError(f"there is no bitstream {source}")
        size = int(a.options["-size"])
        if size < 1 or size & (size - 1):
            raise ScriptError(f"-size must be a power of 2, not {size}")
        kind = a.options["-format"].upper(), a.options.get("-interface", "SMAPx8").upper()
        # What drivers/fpga/zynq-fpga.c of Linux takes.
        if kind != ("BIN", "SMAPX32") or "-disablebitswap" not in a.flags:
            raise ScriptError(f"{Path(a.plain[0]).name} must have the byte order of Linux")
        self.outputs.add(Path(a.plain[0]).name)

    def do_write_hw_platform(self, a: _Arguments) -> None:
        self.outputs.add(Path(a.options["-file"]).name)
