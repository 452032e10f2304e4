"""Backends as options: what they need is asked for before there is anything to compute."""

from ukf_sw.backends import make_backend, require_backend
from ukf_sw.errors import UkfError
from ukf_sw.spec.core import Core
from ukf_tools.cli.console import checked, fail

__all__ = ["need_backend", "need_simulation"]


def need_simulation(simulator: str = "") -> None:
    """Ask for a simulator and its compilers, Verilator by default; exit with a message without."""
    require_backend("cosim")
    from ukf_sim.remote import simulator_of

    try:
        simulator_of(simulator).require()
    except UkfError as error:
        fail(str(error), 1)


def need_backend(name: str, core: Core) -> None:
    """Ask for extras, tools or device of a backend; exit with a message if one is missing.

    Parameters
    ----------
    name
        As :func:`ukf_sw.backends.make_backend` takes it.
    core
        What it is to compute.
    """
    require_backend(name)
    kind, _, where = name.partition(":")
    with checked():
        try:
            if kind == "cosim":
                need_simulation(where)
            else:  # it is made in no time
                make_backend(name, core.params, core.pipeline)
        except UkfError as error:
            fail(str(error), 1)
