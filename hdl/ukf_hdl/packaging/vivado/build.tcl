# From the generated files to a bitstream, with reports, in the folder build beside this one.
#   vivado -mode batch -source build.tcl

set scripts [file dirname [file normalize [info script]]]
source [file join $scripts settings.tcl]
source [file join $scripts package_ip.tcl]

# Without its window Vivado does not look where the board store was installed to.
set store [get_property LOCAL_ROOT_DIR [xhub::get_xstores xilinx_board_store]]
set_param board.repoPaths [concat [get_param board.repoPaths] [list $store]]

set build [file join $root build]
create_project -force $design_name $build -part $part
set board_part {}
foreach pattern $board_parts {
    set board_part [lindex [get_board_parts -quiet -nocase -latest_file_version $pattern] 0]
    if {$board_part ne {}} {
        break
    }
}
if {$board_part ne {}} {
    set_property board_part $board_part [current_project]
} elseif {$board_parts ne {}} {
    error "The files of the board ($board_parts) must be installed: source install_board.tcl"
}
set_property ip_repo_paths [list [file join $root ip]] [current_project]
update_ip_catalog

source [file join $scripts block_design.tcl]
set diagram [get_files ${design_name}.bd]
generate_target all $diagram
add_files -norecurse [make_wrapper -files $diagram -top]
set_property top ${design_name}_wrapper [current_fileset]
update_compile_order -fileset sources_1

launch_runs impl_1 -to_step write_bitstream -jobs 4
wait_on_run impl_1
if {[get_property PROGRESS [get_runs impl_1]] ne "100%"} {
    error "The implementation must end, not stop at [get_property STATUS [get_runs impl_1]]"
}
open_run impl_1
report_utilization -hierarchical -file [file join $build utilization.rpt]
report_timing_summary -file [file join $build timing.rpt]
report_power -file [file join $build power.rpt]
foreach {check delays} {setup max hold min} {
    set slack [get_property SLACK [get_timing_paths -max_paths 1 -delay_type $delays]]
    if {$slack < 0} {
        error "The slack of $check must be at least 0 ns, not $slack ns: see timing.rpt"
    }
}
# PYNQ wants the two files side by side, with one name.
file copy -force [file join $build ${design_name}.runs impl_1 ${design_name}_wrapper.bit] \
    [file join $root ${design_name}.bit]
file copy -force [file join $build ${design_name}.gen sources_1 bd $design_name hw_handoff \
    ${design_name}.hwh] [file join $root ${design_name}.hwh]
# Linux's FPGA manager takes a bitstream without its header, the bytes of each word turned round.
write_cfgmem -force -format BIN -size 32 -interface SMAPx32 -disablebitswap \
    -loadbit [list up 0x0 [file join $root ${design_name}.bit]] \
    [file join $root ${design_name}.bit.bin]
write_hw_platform -fixed -include_bit -force -file [file join $root ${design_name}.xsa]
