"""Options of Vivado's commands (UG835), as far as the scripts may use them."""

__all__ = ["OPTIONS"]


def _options(valued: str = "", flags: str = "") -> tuple[frozenset[str], frozenset[str]]:
    return frozenset(valued.split()), frozenset(flags.split())


#: Options of the commands: those with a value, those without.
OPTIONS = {
    "create_project": _options("-part", "-force -in_memory"),
    "close_project": _options(),
    "current_project": _options(),
    "current_fileset": _options(),
    "add_files": _options("-fileset", "-norecurse"),
    "get_files": _options(),
    "update_compile_order": _options("-fileset"),
    "get_board_parts": _options("", "-quiet"),
    "update_ip_catalog": _options(),
    "ipx::package_project": _options(
        "-root_dir -vendor -library -taxonomy -set_current", "-import_files -force"
    ),
    "ipx::current_core": _options(),
    "ipx::get_bus_interfaces": _options("-of_objects"),
    "ipx::associate_bus_interfaces": _options("-busif -clock"),
    "ipx::get_memory_maps": _options("-of_objects"),
    "ipx::add_memory_map": _options(),
    "ipx::get_address_blocks": _options("-of_objects"),
    "ipx::add_address_block": _options(),
    "ipx::create_xgui_files": _options(),
    "ipx::update_checksums": _options(),
    "ipx::check_integrity": _options(),
    "ipx::save_core": _options(),
    "set_property": _options("-dict"),
    "get_property": _options(),
    "create_bd_design": _options(),
    "create_bd_cell": _options("-type -vlnv"),
    "apply_bd_automation": _options("-rule -config"),
    "get_bd_pins": _options(),
    "get_bd_intf_pins": _options(),
    "get_bd_addr_spaces": _options(),
    "get_bd_addr_segs": _options(),
    "connect_bd_net": _options(),
    "connect_bd_intf_net": _options(),
    "assign_bd_address": _options("-offset -range -target_address_space", "-force"),
    "validate_bd_design": _options(),
    "save_bd_design": _options(),
    "make_wrapper": _options("-files", "-top"),
    "generate_target": _options(),
    "launch_runs": _options("-to_step -jobs"),
    "wait_on_runs": _options(),
    "get_runs": _options(),
    "open_run": _options(),
    "report_utilization": _options("-file", "-hierarchical"),
    "report_timing_summary": _options("-file"),
    "report_power": _options("-file"),
    "get_timing_paths": _options("-max_paths -delay_type"),
    "write_hw_platform": _options("-file", "-fixed -include_bit -force"),
}
