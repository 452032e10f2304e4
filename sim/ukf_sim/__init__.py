"""Co-simulation of the generated Verilog with the software that drives it."""
