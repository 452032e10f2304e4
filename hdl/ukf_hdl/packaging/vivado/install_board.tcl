# Installs the files of the board from AMD's board store, once; this needs the network.
#   vivado -mode batch -source install_board.tcl

source [file join [file dirname [file normalize [info script]]] settings.tcl]

xhub::refresh_catalog [xhub::get_xstores xilinx_board_store]
set items [xhub::get_xitems $board_items]
if {[llength $items] == 0} {
    error "The board store must have $board_items"
}
xhub::install $items
