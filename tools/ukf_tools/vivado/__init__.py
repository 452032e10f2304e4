"""Running the scripts for Vivado without Vivado: a Tcl interpreter with a model of its commands.

The scripts are executed by the real Tcl; commands of Vivado act on a small model of projects, IPs
and block designs. The model knows the commands, properties, pins and interfaces that a script may
use, from AMD's guides (UG835, UG994, PG021, PG164, PG247), and nothing else: a command, option,
property, pin, interface or file that it does not know is an error. The core's own ports come from
the generated Verilog, as Vivado would infer them from its attributes. At ``validate_bd_design``
the whole design is checked: what is not connected, driven twice, in another clock domain, of the
wrong polarity, or not addressable.

That finds misspelt and forgotten things. It is no proof that Vivado accepts the scripts: **Vivado
has not run them.**
"""
