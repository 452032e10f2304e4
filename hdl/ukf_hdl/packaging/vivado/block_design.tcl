# Draws the system into the open project: processor, interconnect, core, interrupt. build.tcl
# sources it.

source [file join [file dirname [file normalize [info script]]] settings.tcl]

create_bd_design $design_name

set ps [create_bd_cell -type ip -vlnv xilinx.com:ip:processing_system7:5.5 processing_system7_0]
# Memory, clocks and pins of the board come from its preset.
apply_bd_automation -rule xilinx.com:bd_rule:processing_system7 -config [list \
    make_external "FIXED_IO, DDR" \
    apply_board_preset [expr {$board_parts ne {}}] \
    Master "Disable" \
    Slave "Disable" \
] $ps
set_property -dict [list \
    CONFIG.PCW_USE_M_AXI_GP0 1 \
    CONFIG.PCW_EN_CLK0_PORT 1 \
    CONFIG.PCW_EN_RST0_PORT 1 \
    CONFIG.PCW_FPGA0_PERIPHERAL_FREQMHZ $clock_mhz \
    CONFIG.PCW_USE_FABRIC_INTERRUPT 1 \
    CONFIG.PCW_IRQ_F2P_INTR 1 \
] $ps

set reset [create_bd_cell -type ip -vlnv xilinx.com:ip:proc_sys_reset:5.0 proc_sys_reset_0]
set bus [create_bd_cell -type ip -vlnv xilinx.com:ip:smartconnect:1.0 smartconnect_0]
set_property -dict [list CONFIG.NUM_SI 1 CONFIG.NUM_MI 1] $bus
set core [create_bd_cell -type ip -vlnv $core_vendor:user:$core_name:$core_version ${core_name}_0]

connect_bd_intf_net [get_bd_intf_pins $ps/M_AXI_GP0] [get_bd_intf_pins $bus/S00_AXI]
connect_bd_intf_net [get_bd_intf_pins $bus/M00_AXI] [get_bd_intf_pins $core/$core_bus]

connect_bd_net [get_bd_pins $ps/FCLK_CLK0] \
    [get_bd_pins $ps/M_AXI_GP0_ACLK] \
    [get_bd_pins $reset/slowest_sync_clk] \
    [get_bd_pins $bus/aclk] \
    [get_bd_pins $core/$core_clock]
connect_bd_net [get_bd_pins $ps/FCLK_RESET0_N] [get_bd_pins $reset/ext_reset_in]
connect_bd_net [get_bd_pins $reset/peripheral_aresetn] \
    [get_bd_pins $bus/aresetn] \
    [get_bd_pins $core/$core_reset]

if {$core_interrupt_bit == 0} {
    connect_bd_net [get_bd_pins $core/$core_interrupt] [get_bd_pins $ps/IRQ_F2P]
} else {
    # The lower interrupts stay low.
    set lines [create_bd_cell -type ip -vlnv xilinx.com:ip:xlconcat:2.1 interrupts]
    set_property -dict [list CONFIG.NUM_PORTS [expr {$core_interrupt_bit + 1}]] $lines
    set low [create_bd_cell -type ip -vlnv xilinx.com:ip:xlconstant:1.1 low]
    set_property -dict [list CONFIG.CONST_WIDTH 1 CONFIG.CONST_VAL 0] $low
    for {set bit 0} {$bit < $core_interrupt_bit} {incr bit} {
        connect_bd_net [get_bd_pins $low/dout] [get_bd_pins $lines/In$bit]
    }
    connect_bd_net [get_bd_pins $core/$core_interrupt] [get_bd_pins $lines/In$bit]
    connect_bd_net [get_bd_pins $lines/dout] [get_bd_pins $ps/IRQ_F2P]
}

assign_bd_address -offset $core_base -range [format 0x%08x $core_range] \
    -target_address_space [get_bd_addr_spaces $ps/Data] \
    [get_bd_addr_segs $core/$core_bus/$core_block] -force

validate_bd_design
save_bd_design
