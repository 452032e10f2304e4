"""The engine's programs: layout, operations, kernels, scheduler, checker and interpreter.

The modules build on each other in this order::

    layout        where every vector lives in the memories of the processing elements
    operations    what the array can do, and the builder that collects operations
    kernels       the filter's matrix operations, as lists of operations
    programs      the steps of the filter, as sequences of kernels
    scheduler     when every operation issues
    checker       proof that a schedule means what its operations mean
    control_word  schedules as bits, one word a clock
    microcode     all programs of a core, scheduled and encoded
    interpreter   the golden model: executes the words, bit for bit
"""
