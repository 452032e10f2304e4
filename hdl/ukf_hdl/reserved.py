"""Names that a core must not have, because something that its name goes to has them already."""

from pathlib import Path

from ukf_sw.c_sources import DRIVER_HEADERS, PORTS

__all__ = ["RESERVED"]

_VERILOG = """
accept_on alias always always_comb always_ff always_latch and assert assign assume automatic before
begin bind bins binsof bit break buf bufif0 bufif1 byte case casex casez cell chandle checker class
clocking cmos config const constraint context continue cover covergroup coverpoint cross deassign
default defparam design disable dist do edge else end endcase endchecker endclass endclocking
endconfig endfunction endgenerate endgroup endinterface endmodule endpackage endprimitive endprogram
endproperty endsequence endspecify endtable endtask enum event eventually expect export extends
extern final first_match for force foreach forever fork forkjoin function generate genvar global
highz0 highz1 if iff ifnone ignore_bins illegal_bins implements implies import incdir include
initial inout input inside instance int integer interconnect interface intersect join join_any
join_none large let liblist library local localparam logic longint macromodule matches medium
modport module nand negedge nettype new nexttime nmos nor noshowcancelled not notif0 notif1 null or
output package packed parameter pmos posedge primitive priority program property protected pull0
pull1 pulldown pullup pulsestyle_ondetect pulsestyle_onevent pure rand randc randcase randsequence
rcmos real realtime ref reg reject_on release repeat restrict return rnmos rpmos rtran rtranif0
rtranif1 s_always s_eventually s_nexttime s_until s_until_with scalared sequence shortint shortreal
showcancelled signed small soft solve specify specparam static string strong strong0 strong1 struct
super supply0 supply1 sync_accept_on sync_reject_on table tagged task this throughout time
timeprecision timeunit tran tranif0 tranif1 tri tri0 tri1 triand trior trireg type typedef union
unique unique0 unsigned until until_with untyped use uwire var vectored virtual void wait wait_order
wand weak weak0 weak1 while wildcard wire with within wor xnor xor
"""
_VHDL = """
abs access after alias all and architecture array assert attribute begin block body buffer bus case
component configuration constant disconnect downto else elsif end entity exit file for function
generate generic group guarded if impure in inertial inout is label library linkage literal loop map
mod nand new next nor not null of on open or others out package port postponed procedure process
pure range record register reject rem report return rol ror select severity shared signal sla sll
sra srl subtype then to transport type unaffected units until use variable wait when while with xnor
xor
"""
_C = """
auto break case char const continue default do double else enum extern float for goto if inline int
long register restrict return short signed sizeof static struct switch typedef union unsigned void
volatile while
"""
#: Headers of C and POSIX: one of the same name beside the driver would be taken instead.
_HEADERS = """
alloca assert complex ctype endian errno fcntl features fenv float inttypes iso646 limits locale
math poll pthread sched setjmp signal stdalign stdarg stdatomic stdbool stddef stdint stdio stdlib
stdnoreturn string strings tgmath threads time uchar unistd wchar wctype
"""

#: What has the name, by the name.
RESERVED: dict[str, str] = {
    **dict.fromkeys(_C.split(), "a keyword of C"),
    **dict.fromkeys(_HEADERS.split(), "a header of the C library"),
    **dict.fromkeys(_VHDL.split(), "a keyword of VHDL"),
    **dict.fromkeys(_VERILOG.split(), "a keyword of Verilog"),
    **dict.fromkeys(
        ("ukf", "ukf_registers", *(Path(name).stem for name in (*DRIVER_HEADERS, *PORTS))),
        "which the C driver has",
    ),
}
