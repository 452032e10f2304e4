"""A page about a design space: charts and tables of a sweep, in one file.

::

    series  rows of a sweep, grouped
    growth  how figures grow, fitted
    charts  what is drawn
    tables  the 2018 paper's figures beside ours, devices, all figures
    page    everything together
"""
