"""From a model in NumPy to a graph of its operations.

::

    from ukf_sw.tracing.models import trace_problem

    traced = trace_problem(problem)
    print(traced.f.graph.counts(), traced.f.graph.depth)

Models are ordinary NumPy functions (:mod:`ukf_sw.models`) that do the same operations at every
sigma point. What does not is refused with its place in the source and what to write instead.
"""
