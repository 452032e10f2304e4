"""The C sources: where they are, and which of them make the driver."""

from pathlib import Path

__all__ = ["C_SOURCES", "DRIVER_HEADERS", "DRIVER_SOURCES", "PORTS"]

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
