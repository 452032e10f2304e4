"""From models to programs of a core: steps of the array, and the same steps as C.

:mod:`.c_models` writes programs (:mod:`ukf_sw.spec.model_programs`) as functions in C, on the
arithmetic of :mod:`.c_arithmetic`: whatever executes a program, a core, its golden model or a
processor, computes the same bits.
"""
