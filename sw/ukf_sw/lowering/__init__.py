"""From the graph of a traced model to a program of the array, and from that to C.

::

    from ukf_sw.lowering.program import lower

    models = lower(trace_problem(problem), problem, BINARY32)

Whatever executes a program (:mod:`ukf_sw.spec.model_programs`), a core, its golden model or a
processor, computes the same bits. The modules build on each other in this order::

    arithmetic    operations of a graph as steps, products and sums joined where no bit changes
    endings       the last steps of a program, which write its result
    program       programs of the models of a problem, with the numbers that they are given
    placement     what a filter tells a core that has them
    software      the same programs as models in software
    c_arithmetic  the arithmetic of a core in C
    c_models      programs as functions in C
    c_problem     what calls these for the filter in C
"""
