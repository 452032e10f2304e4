"""The C driver and an application (sw/c) on the simulated core.

- :mod:`.compiler` compiles the sources, natively or for a Cortex-A9;
- :mod:`.loop` runs an application in one process with the model of the Verilog, by harness.cpp.
"""
