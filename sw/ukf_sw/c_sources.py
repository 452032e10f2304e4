"""The C sources: where they are, which of them make the driver, and how written ones are called."""

from dataclasses import dataclass
from pathlib import Path

__all__ = ["CORE", "C_SOURCES", "DRIVER_HEADERS", "DRIVER_SOURCES", "PORTS", "CNames"]

_PACKAGE = Path(__file__).resolve().parent
#: Folder of the C sources: in the package as it is installed, beside it in a checkout.
C_SOURCES = _PACKAGE / "c" if (_PACKAGE / "c").is_dir() else _PACKAGE.parent / "c"

#: Driver and filter, which every program has; names below :data:`C_SOURCES`.
DRIVER_SOURCES = (
    "ukf_driver.c", "ukf_driver_models.c", "ukf_filter.c", "ukf_software.c", "ukf_factor.c",
)  # fmt: skip
DRIVER_HEADERS = (
    "ukf_driver.h", "ukf_filter.h", "ukf_internal.h", "ukf_factor.h", "ukf_port.h", "ukf_real.h",
)  # fmt: skip
#: Ways to a core, of which a program has one; stems of a source and its header.
PORTS = ("ports/bare_metal", "ports/uio", "ports/remote")
#: Name of a core that is given no other.
CORE = "ukf_core"


@dataclass(frozen=True, kw_only=True)
class CNames:
    """Names in C of what is written for a core.

    Parameters
    ----------
    core
        Name of the core, and stem of its header.
    """

    core: str = CORE

    @property
    def stem(self) -> str:
        """What names of files and functions begin with; macros with the same in capitals."""
        return "ukf" if self.core == CORE else self.core

    @property
    def model(self) -> str:
        """Stem of the models, see :mod:`ukf_sw.lowering.c_models`."""
        return f"{self.stem}_model"

    @property
    def problem(self) -> str:
        """Stem of what calls them, see :mod:`ukf_sw.lowering.c_problem`."""
        return f"{self.stem}_problem"

    @property
    def files(self) -> tuple[str, ...]:
        """All files of both."""
        return tuple(f"{name}.{kind}" for name in (self.model, self.problem) for kind in "hc")
