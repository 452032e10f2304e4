"""The C driver and application (sw/c): compiling them, and running them against models of the core.

- :mod:`.compiler` finds the sources and compiles them, natively or for a Cortex-A9;
- :mod:`.scenario_files` hands them parameters and samples, and reads their results;
- :mod:`.binding` calls the driver from Python, on any bus of :mod:`ukf_sw.drivers.bus`;
- :mod:`.loop` runs the application on the simulated core, in one process of C and C++;
- :mod:`.register_server` offers the golden model to programs in other processes;
- :mod:`.arm` runs the application, compiled for the board, in an emulator of its processor.
"""
