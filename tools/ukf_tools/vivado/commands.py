"""What the scripts may use of Vivado, which versions have it, and where that was read.

The model of Vivado refuses whatever is not in these tables, and what its version lacks; the table
of docs/board.md is made of them. A page counts for a version if it was read in the edition of that
version. What was read in other editions, or only in scripts of AMD's that run on it, is named so.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

__all__ = ["COMMANDS", "PROPERTIES", "VERSIONS", "Entry"]

#: Versions whose documentation was looked through: the oldest that is promised, and a late one.
VERSIONS = ("2020.2", "2024.2")

#: Scripts of AMD's that were read, and the version of Vivado that they are for.
_BASE = "PYNQ-ZU's base.tcl for 2024.1"
_BITSTREAM = "PYNQ-Z2's build_bitstream.tcl, for 2020.2 or later"
_COMMUNITY = "public scripts"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A command, or a property of a kind of objects.

    Parameters
    ----------
    valued, flags
        Options of the command that the scripts may use: with a value, without.
    pages
        Editions of UG835 in which its page was read.
    others
        What else was read.
    lacking
        Versions that do not have it.
    """

    valued: frozenset[str] = frozenset()
    flags: frozenset[str] = frozenset()
    pages: tuple[str, ...] = ()
    others: tuple[str, ...] = field(default=())
    lacking: tuple[str, ...] = ()

    def confirmed(self, version: str) -> bool:
        """Whether its page was read in an edition of the year of a version, or of that version."""
        editions = {version} if version == VERSIONS[0] else {version, f"{version[:4]}.1"}
        return bool(editions & set(self.pages))

    @property
    def read(self) -> str:
        """Where it was read."""
        pages = [f"UG835 {', '.join(self.pages)}"] if self.pages else []
        return "; ".join((*pages, *self.others)) or "nowhere"


def _entry(
    options: str = "",
    flags: str = "",
    *,
    pages: str = "",
    others: Iterable[str] = (),
    lacking: Iterable[str] = (),
) -> Entry:
    return Entry(
        valued=frozenset(options.split()),
        flags=frozenset(flags.split()),
        pages=tuple(pages.split()),
        others=tuple(others),
        lacking=tuple(lacking),
    )


#: Commands, with the options that the scripts may use.
COMMANDS = {
    # Projects.
    "create_project": _entry("-part", "-force -in_memory", pages="2023.1", others=[_BASE]),
    "close_project": _entry(),
    "current_project": _entry(others=[_BASE]),
    "current_fileset": _entry(others=[_BITSTREAM]),
    "add_files": _entry("-fileset", "-norecurse", others=[_BITSTREAM]),
    "get_files": _entry(others=[_BITSTREAM]),
    "update_compile_order": _entry("-fileset", others=[_BITSTREAM]),
    "update_ip_catalog": _entry(others=[_BASE]),
    "set_property": _entry("-dict", others=[_BASE]),
    "get_property": _entry(others=[_BASE]),
    "set_param": _entry(others=[_BASE]),
    "get_param": _entry(),
    # Boards.
    "get_board_parts": _entry(
        "", "-quiet -nocase -latest_file_version", pages="2021.2", others=[_BASE]
    ),
    "xhub::get_xstores": _entry(others=[_BASE]),
    "xhub::refresh_catalog": _entry(others=[_BASE]),
    "xhub::get_xitems": _entry(others=[_BASE]),
    "xhub::install": _entry(others=[_BASE]),
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
    "create_bd_design": _entry(pages="2020.2", others=[_BASE]),
    "create_bd_cell": _entry("-type -vlnv", pages="2022.2 2026.1", others=[_BASE]),
    "apply_bd_automation": _entry("-rule -config", pages="2022.1 2023.2"),
    "get_bd_pins": _entry(),
    "get_bd_intf_pins": _entry(others=[_BASE]),
    "get_bd_addr_spaces": _entry(),
    "get_bd_addr_segs": _entry(),
    "connect_bd_net": _entry(pages="2022.1"),
    "connect_bd_intf_net": _entry(pages="2023.1", others=[_BASE]),
    "assign_bd_address": _entry(
        "-offset -range -target_address_space", "-force", pages="2020.2 2022.1 2023.1 2024.1"
    ),
    "validate_bd_design": _entry(pages="2020.2 2021.1 2026.1"),
    "save_bd_design": _entry(pages="2020.2"),
    "make_wrapper": _entry("-files", "-top", pages="2022.2", others=[_BITSTREAM]),
    "generate_target": _entry(pages="2021.2"),
    # Building.
    "launch_runs": _entry("-to_step -jobs", pages="2023.2", others=[_BITSTREAM]),
    "wait_on_run": _entry(
        pages="2020.2", others=[_BITSTREAM, "the example of wait_on_runs in UG835 2024.2"]
    ),
    # Not used; the model knows it so that a script that uses it fails for the old version.
    "wait_on_runs": _entry(pages="2021.2 2022.1 2023.1 2024.1 2024.2", lacking=["2020.2"]),
    "get_runs": _entry(others=["the example of wait_on_run in UG835 2020.2 and 2024.2"]),
    "open_run": _entry(pages="2021.1", others=["UG904 2020.2, 2023.2, 2025.2"]),
    "report_utilization": _entry("-file", "-hierarchical", pages="2021.2 2025.2"),
    "report_timing_summary": _entry("-file", pages="2023.1 2025.2"),
    "report_power": _entry("-file"),
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
    ("project", "board_part"): _entry(others=[_BASE]),
    ("project", "ip_repo_paths"): _entry(others=[_BASE]),
    ("fileset", "top"): _entry(others=[_BITSTREAM]),
    ("file", "USED_IN"): _entry(),
    ("store", "LOCAL_ROOT_DIR"): _entry(others=[_BASE]),
    ("parameter", "board.repoPaths"): _entry(others=[_BASE]),
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
