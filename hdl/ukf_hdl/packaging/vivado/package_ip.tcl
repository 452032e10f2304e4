# Packages the core as an IP for Vivado's catalogue, in the folder ip beside this one.
#   vivado -mode batch -source package_ip.tcl

source [file join [file dirname [file normalize [info script]]] settings.tcl]

create_project -force -in_memory -part $part
add_files -norecurse [file join $root rtl ${core_name}.v]
add_files -fileset constrs_1 -norecurse [file join $root vivado ${core_name}_ooc.xdc]
set_property USED_IN {synthesis out_of_context} [get_files ${core_name}_ooc.xdc]
set_property top $core_name [current_fileset]
update_compile_order -fileset sources_1

ipx::package_project -root_dir [file join $root ip] -vendor $core_vendor -library user \
    -taxonomy /UserIP -import_files -set_current true -force
set core [ipx::current_core]
set_property -dict [list \
    name $core_name \
    version $core_version \
    display_name "UKF core $core_name" \
    description $core_description \
    supported_families {zynq Production} \
] $core

# Clock, reset, bus and interrupt are inferred from the attributes in the Verilog.
foreach interface $core_interfaces {
    if {[llength [ipx::get_bus_interfaces $interface -of_objects $core]] != 1} {
        error "The core must have the interface $interface"
    }
}
ipx::associate_bus_interfaces -busif $core_bus -clock $core_clock $core

if {[llength [ipx::get_memory_maps $core_bus -of_objects $core]] == 0} {
    ipx::add_memory_map $core_bus $core
    set_property slave_memory_map_ref $core_bus \
        [ipx::get_bus_interfaces $core_bus -of_objects $core]
}
set map [ipx::get_memory_maps $core_bus -of_objects $core]
if {[llength [ipx::get_address_blocks $core_block -of_objects $map]] == 0} {
    ipx::add_address_block $core_block $map
}
set_property -dict [list range $core_range width 32 usage register] \
    [ipx::get_address_blocks $core_block -of_objects $map]

ipx::create_xgui_files $core
ipx::update_checksums $core
ipx::check_integrity $core
ipx::save_core $core
close_project
