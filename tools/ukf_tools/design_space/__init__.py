"""The design space: many cores, each evaluated once, and their figures side by side.

The modules build on each other in this order::

    sources     what a result depends on, as a digest of source files
    cache       results on disk, found by what they depend on
    points      the cores of a sweep
    parts       what is found out about a core: schedule, resources, accuracy
    executors   where parts are computed: processes of this computer, or a cluster
    sweep       all parts of all points, those that are missing computed
    table       rows of figures, as Parquet and CSV
"""
