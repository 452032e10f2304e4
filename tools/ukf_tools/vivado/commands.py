"""What the scripts may use of Vivado, which versions have it, and where that was read.

The model of Vivado refuses whatever is not in these tables, and what its version lacks; the table
of docs/board.md is made of them. Pages of UG835, the command reference, count for the version of
their edition. Scripts count for the version that they are for: those that Vivado itself has written
(write_bd_tcl, write_project_tcl), and AMD's base.tcl of the board PYNQ-ZU for 2024.1.
"""

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["COMMANDS", "PROPERTIES", "VERSIONS", "Entry"]

#: Versions whose documentation was looked through: the oldest that is promised, and a late one.
VERSIONS = ("2020.2", "2024.2")

_BITSTREAM = "AMD's build_bitstream.tcl of PYNQ-Z2, for 2020.2 or later"
_COMMUNITY = "scripts of others"
_SINCE = ("the history of that script, which has it since its version for 2020.1",)


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A command, or a property of a kind of objects.

    Parameters
    ----------
    valued, flags
        Options of the command that the scripts may use: with a value, without.
    pages
        Editions of UG835 in which its page was read.
    scripts
        Versions for which a script of Vivado's or AMD's that uses it was read.
    others
        What else was read.
    lacking
        Versions that do not have it.
    """

    valued: frozenset[str] = frozenset()
    flags: frozenset[str] = frozenset()
    pages: tuple[str, ...] = ()
    scripts: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    lacking: tuple[str, ...] = ()

    def status(self, version: str) -> str:
        """What is known of it in a version; of the late one, in any edition of its year."""
        editions = {version} if version == VERSIONS[0] else {version, f"{version[:4]}.1"}
        if version in self.lacking:
            return "not there"
        if editions & set(self.pages):
            return "documented"
        return "in a script" if editions & set(self.scripts) else "–"

    @property
    def read(self) -> str:
        """Where it was read."""
        pages = [f"UG835 {', '.join(self.pages)}"] if self.pages else []
        scripts = [f"scripts for {', '.join(self.scripts)}"] if self.scripts else []
        return "; ".join((*pages, *scripts, *self.others)) or "nowhere"


def _entry(
    options: str = "",
    flags: str = "",
    *,
    pages: str = "",
    scripts: str = "",
    others: Iterable[str] = (),
    lacking: Iterable[str] = (),
) -> Entry:
    return Entry(
        valued=frozenset(options.split()),
        flags=frozenset(flags.split()),
        pages=tuple(pages.split()),
        scripts=tuple(scripts.split()),
        others=tuple(others),
        lacking=tuple(lacking),
    )


#: Commands, with the options that the scripts may use.
COMMANDS = {
    # Projects.
    "create_project": _entry(
        "-part", "-force -in_memory", pages="2023.1", scripts="2020.2 2024.1"
    ),
    "close_project": _entry(),
    "current_project": _entry(scripts="2020.2 2024.1"),
    "current_fileset": _entry(others=[_BITSTREAM]),
    "add_files": _entry("-fileset", "-norecurse", others=[_BITSTREAM]),
    "get_files": _entry(scripts="2024.1", others=[_BITSTREAM]),
    "update_compile_order": _entry("-fileset", others=[_BITSTREAM]),
    "update_ip_catalog": _entry(scripts="2020.2 2024.1"),
    "set_property": _entry("-dict", scripts="2020.2 2024.1 2024.2"),
    "get_property": _entry(scripts="2020.2 2024.1 2024.2"),
    "set_param": _entry(scripts="2024.1"),
    "get_param": _entry(),
    # Boards.
    "get_board_parts": _entry(
        "", "-quiet -nocase -latest_file_version", pages="2021.2", scripts="2024.1"
    ),
    "xhub::get_xstores": _entry(scripts="2024.1", others=_SINCE),
    "xhub::refresh_catalog": _entry(scripts="2024.1", others=_SINCE),
    "xhub::get_xitems": _entry(scripts="2024.1", others=_SINCE),
    "xhub::install": _entry(scripts="2024.1", others=_SINCE),
    # Packaging: UG835 has none of these.
    "ipx::package_project": _entry(
        "-root_dir -vendor -library -taxonomy -set_current", "-import_files -force",
        others=[_COMMUNITY],
    ),
    "ipx::current_core": _entry(others=[_COMMUNITY]),
    "ipx::get_bus_interfaces": _entry("-of_objects", others=[_COMMUNITY]),
    "ipx::associate_bus_interfaces": _entry("-busif -clock", others=[_COMMUNITY]),
    "ipx::get_memory_maps": _entry("-of_objects", others=[_COMMUNITY]),
    "ipx::add_memory_map": _entry(others=[_COMMUNITY]),
    "ipx::get_address_blocks": _entry("-of_objects", others=[_COMMUNITY]),
    "ipx::add_address_block": _entry(others=[_COMMUNITY]),
    "ipx::create_xgui_files": _entry(),
    "ipx::update_checksums": _entry(others=[_COMMUNITY]),
    "ipx::check_integrity": _entry(),
    "ipx::save_core": _entry(others=[_COMMUNITY]),
    # Block design.
    "create_bd_design": _entry(pages="2020.2", scripts="2020.2 2024.1"),
    "create_bd_cell": _entry(
        "-type -vlnv", pages="2022.2 2026.1", scripts="2020.2 2024.1 2024.2"
    ),
    "apply_bd_automation": _entry("-rule -config", pages="2022.1 2023.2"),
    "get_bd_pins": _entry(scripts="2020.2 2024.2"),
    "get_bd_intf_pins": _entry(scripts="2020.2 2024.1 2024.2"),
    "get_bd_addr_spaces": _entry(scripts="2020.2 2024.2"),
    "get_bd_addr_segs": _entry(scripts="2020.2 2024.2"),
    "connect_bd_net": _entry(pages="2022.1", scripts="2020.2 2024.2"),
    "connect_bd_intf_net": _entry(pages="2023.1", scripts="2020.2 2024.1 2024.2"),
    "assign_bd_address": _entry(
        "-offset -range -target_address_space", "-force", pages="2020.2 2022.1 2023.1 2024.1",
        scripts="2020.2 2024.2",
    ),
    "validate_bd_design": _entry(pages="2020.2 2021.1 2026.1", scripts="2020.2 2024.2"),
    "save_bd_design": _entry(pages="2020.2", scripts="2020.2 2024.2"),
    "make_wrapper": _entry("-files", "-top", pages="2022.2", others=[_BITSTREAM]),
    "generate_target": _entry(pages="2021.2"),
    # Building.
    "launch_runs": _entry("-to_step -jobs", pages="2023.1 2023.2", others=[_BITSTREAM]),
    "wait_on_run": _entry(
        pages="2020.2", others=[_BITSTREAM, "the example of wait_on_runs in UG835 2024.2"]
    ),
    # Not used; the model knows it so that a script that uses it fails for the old version.
    "wait_on_runs": _entry(pages="2021.2 2022.1 2023.1 2024.1 2024.2", lacking=["2020.2"]),
    "get_runs": _entry(others=["the example of wait_on_run in UG835 2020.2 and 2024.2"]),
    "open_run": _entry(pages="2021.1", others=["UG904 2020.2, 2023.2, 2025.2"]),
    "report_utilization": _entry("-file", "-hierarchical", pages="2021.2 2025.2"),
    "report_timing_summary": _entry("-file", pages="2023.1 2025.2"),
    "report_power": _entry("-file", pages="2021.2"),
    "get_timing_paths": _entry("-max_paths -delay_type", pages="2026.1"),
    "write_cfgmem": _entry(
        "-format -size -interface -loadbit", "-force -disablebitswap",
        pages="2020.2 2021.2 2022.1 2023.2 2024.1",
    ),
    "write_hw_platform": _entry(
        "-file", "-fixed -include_bit -force", pages="2020.2 2021.2 2023.2", others=[_BITSTREAM]
    ),
}  # fmt: skip

#: Properties and parameters, by kind of the object and name.
PROPERTIES = {
    ("project", "board_part"): _entry(scripts="2020.2 2024.1"),
    ("project", "ip_repo_paths"): _entry(
        scripts="2024.1", others=["of a fileset in a script for 2020.2"]
    ),
    ("fileset", "top"): _entry(scripts="2020.2", others=[_BITSTREAM]),
    ("file", "USED_IN"): _entry(),
    ("store", "LOCAL_ROOT_DIR"): _entry(scripts="2024.1"),
    ("parameter", "board.repoPaths"): _entry(scripts="2024.1"),
    **{
        ("core", name): _entry(others=[_COMMUNITY])
        for name in ("name", "version", "display_name", "description", "supported_families")
    },
    ("interface", "slave_memory_map_ref"): _entry(others=[_COMMUNITY]),
    **{("block", name): _entry(others=[_COMMUNITY]) for name in ("range", "width", "usage")},
    ("run", "PROGRESS"): _entry(others=["the example of wait_on_run in UG835 2020.2 and 2024.2"]),
    ("run", "STATUS"): _entry(others=[_COMMUNITY]),
    ("path", "SLACK"): _entry(others=[_COMMUNITY]),
}
