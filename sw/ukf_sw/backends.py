"""Backends: what computes the steps of a filter, by name.

So one script runs on a model here and on a core there.

=========================  =========================================================
Name                       What computes
=========================  =========================================================
``reference``              the papers' equations in float64
``golden``                 the golden model, every bit as in hardware
``uio:0``, ``uio:NAME``    a core on this board, by Linux UIO, with its interrupt
``uio:0x43C00000``         the same, by the address of the core
``pynq:0x43C00000``        a core on this board, by PYNQ, polled
``pynq:0x43C00000,PIN``    the same with the interrupt of a pin, as ukf_core_0/irq
=========================  =========================================================

Installed packages add theirs as entry points of the group ``ukf_sw.backends``; the co-simulation
does so as ``cosim``, and ``cosim:NAME`` names the simulator. Such a function takes the parameters,
the text after the colon, and how the core is built.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ukf_sw.ahead import CoreSample
from ukf_sw.extras import require
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Pipeline, UkfParams

# What is slow to import, or needs more than NumPy, is imported by the backends that need it.
if TYPE_CHECKING:
    from ukf_sw.drivers.driver import Driver

__all__ = [
    "GROUP",
    "Backend",
    "CoreBackend",
    "backend_names",
    "golden_driver",
    "make_backend",
    "require_backend",
]

#: Group of entry points.
GROUP = "ukf_sw.backends"

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@runtime_checkable
class Backend(Protocol):
    """What computes the steps of a filter.

    :class:`ukf_sw.reference.ReferenceUkf` and :class:`ukf_sw.drivers.driver.Driver` are backends.
    Arguments have been checked when they arrive here. What is in
    :data:`ukf_sw.errors.REFUSALS` leaves everything as it was; after any other error a backend may
    refuse, until :meth:`recover` or :meth:`initialise`, what needs to know the state of a core.
    """

    @property
    def params(self) -> UkfParams:
        """Sizes and kinds of noise."""
        ...

    def initialise(self, x: Array, P: Array, Q: Array, R: Array) -> None:
        """Start from an estimate. R has the blocks of the sensors on its diagonal."""
        ...

    def set_state(self, x: Array) -> None:
        """Replace x; P stays."""
        ...

    def set_covariance(self, P: Array) -> None:
        """Replace P; x stays."""
        ...

    def set_noise(self, Q: Array, R: Array) -> None:
        """Replace Q and R; the estimate stays."""
        ...

    def set_gate(self, gate: float) -> None:
        """Reject updates with a NIS above the gate; infinity is off."""
        ...

    def recover(self) -> Array | None:
        """Find out what is held after an error that has left it open, and finish what was begun.

        Gives the points of the last predict, as that gave them, if an update may use them.
        """
        ...

    def undo_predict(self) -> bool:
        """Go back to before the last predict, unless it has been factorised; tells whether."""
        ...

    def noise_points(self) -> tuple[Array, Array]:
        """Sigma points of w (q, K) and v (r, K); zeros for additive noise."""
        ...

    def redraw(self) -> None:
        """Draw sigma points of the state anew if the estimate has changed."""
        ...

    def sigma_points(self) -> Array:
        """Sigma points of the state (n, K), drawn anew if the estimate has changed."""
        ...

    def predict(self, points: Array) -> Array:
        """Predict from the points sent through f; gives them back as the backend holds them."""
        ...

    def update(self, points: Array, z: Array, mask: Mask, sensor: int = 0) -> tuple[float, bool]:
        """Update from the points sent through the h of a sensor; gives the NIS, and if gated."""
        ...

    def state(self) -> Array:
        """Estimate x (n,)."""
        ...

    def covariance(self) -> Array:
        """Covariance P (n, n)."""
        ...


@runtime_checkable
class CoreBackend(Backend, Protocol):
    """A backend that evaluates models itself: those of ``params.models``.

    Inputs are numbers of region U by their place; those that are missing stay as they are.
    """

    def predict_on_core(self, inputs: Mapping[int, float]) -> None:
        """Send sigma points through f, and predict."""
        ...

    def propagated_points(self) -> Array:
        """Sigma points (n, K) as f has left them, after :meth:`predict_on_core`."""
        ...

    def update_on_core(
        self, z: Array, mask: Mask, sensor: int, variant: int, inputs: Mapping[int, float]
    ) -> tuple[float, bool]:
        """Send sigma points through an h, and update; gives the NIS, and if gated."""
        ...

    def iterate(
        self, z: Array, mask: Mask, sensor: int, variant: int, inputs: Mapping[int, float]
    ) -> tuple[float, bool]:
        """Do both in one step. If it raises, the prediction may have been made."""
        ...

    def iterate_ahead(
        self, samples: Sequence[CoreSample], *, redraws: bool
    ) -> tuple[Array, list[Array]]:
        """Do samples at once as in single steps, as far as they succeed; none if it cannot.

        Gives x after each of them (D, n), and the NIS of each update of theirs.
        """
        ...


def golden_driver(params: UkfParams, pipeline: Pipeline | None = None) -> "Driver":
    """Make a golden model with its driver.

    Parameters
    ----------
    params
        What the core computes.
    pipeline
        How it is built, which decides cycles only; None is the default.
    """
    from ukf_sw.drivers.driver import Driver
    from ukf_sw.golden import GoldenBus, GoldenCore

    return Driver(GoldenBus(GoldenCore(params, pipeline)), params)


def _reference(params: UkfParams, where: str, pipeline: Pipeline | None) -> Backend:
    from ukf_sw.reference import ReferenceUkf

    _nothing("reference", where)
    return ReferenceUkf(params)


def _golden(params: UkfParams, where: str, pipeline: Pipeline | None) -> Backend:
    _nothing("golden", where)
    require_backend("golden")
    return golden_driver(params, pipeline)


def _nothing(name: str, where: str) -> None:
    if where:
        raise ValueError(f"backend must be {name!r}, with nothing behind it, not {where!r}")


def _uio(params: UkfParams, where: str, pipeline: Pipeline | None) -> Backend:
    from ukf_sw.drivers.driver import Driver
    from ukf_sw.drivers.uio import UioBus

    if not where:
        raise ValueError("backend must be 'uio:' and a number, name or address, not 'uio'")
    bus = UioBus(where)
    return Driver(bus, params, interrupt=bus.wait_for_interrupt)


def _pynq(params: UkfParams, where: str, pipeline: Pipeline | None) -> Backend:
    from ukf_sw.drivers.driver import Driver
    from ukf_sw.drivers.pynq_bus import PynqBus

    text, _, pin = where.partition(",")
    try:
        base = int(text, 0)
    except ValueError:
        raise ValueError(
            f"backend must be 'pynq:' and an address, as 0x43C00000, not {'pynq:' + where!r}"
        ) from None
    bus = PynqBus(base, 1 << MemoryMap(params).address_width, interrupt=pin or None)
    return Driver(bus, params, interrupt=bus.wait_for_interrupt if pin else None)


_OWN: dict[str, Callable[[UkfParams, str, Pipeline | None], Backend]] = {
    "reference": _reference,
    "golden": _golden,
    "uio": _uio,
    "pynq": _pynq,
}

#: Extras of those that need any.
_EXTRAS = {"golden": ("golden",), "cosim": ("hdl", "sim", "golden")}


def backend_names() -> list[str]:
    """Names, without what may stand behind a colon."""
    return [*_OWN, *sorted({point.name for point in entry_points(group=GROUP)} - set(_OWN))]


def require_backend(name: str) -> None:
    """Check that the extras that a backend needs are installed, without making it.

    Raises
    ------
    MissingExtraError
        If one is not.
    """
    require(*_EXTRAS.get(name.partition(":")[0], ()))


def make_backend(name: str, params: UkfParams, pipeline: Pipeline | None = None) -> Backend:
    """Make a backend.

    Parameters
    ----------
    name
        As in the table above.
    params
        Parameters of the filter. A core may have another number of processing elements.
    pipeline
        How a core that is made here is built; None is the default. It decides cycles only.

    Raises
    ------
    ValueError
        If there is no such backend, or what stands behind the colon is wrong.
    DeviceError
        If the device is missing, may not be used, or does not work.
    WrongCoreError
        If another core is there.
    MissingExtraError
        If an extra that it needs is not installed.
    """
    kind, _, where = name.partition(":")
    if kind in _OWN:
        return _OWN[kind](params, where, pipeline)
    for point in entry_points(group=GROUP, name=kind):
        require_backend(name)
        return point.load()(params, where, pipeline)
    raise ValueError(f"backend must be one of {', '.join(backend_names())}, not {name!r}")
