"""The amaranth-soc library, wherever it is installed.

The package of that name on PyPI is an empty placeholder; luna-soc carries the library and puts it
on the path when it is imported. No other module imports either of them.
"""

import warnings
from importlib import import_module

__all__ = ["csr", "event", "memory"]

with warnings.catch_warnings():
    # Warnings of third parties at import time are not ours to fix.
    warnings.simplefilter("ignore")
    try:
        csr = import_module("amaranth_soc.csr")
    except ImportError:
        import_module("luna_soc")
        csr = import_module("amaranth_soc.csr")
    event = import_module("amaranth_soc.event")
    memory = import_module("amaranth_soc.memory")
