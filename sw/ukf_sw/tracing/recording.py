"""What records: it hands what NumPy does with it to the trace, and refuses to be a plain number."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np

from ukf_sw.tracing.context import Trace
from ukf_sw.tracing.remedies import TEXT, of_number, of_truth

__all__ = ["Recorder"]


class Recorder(np.lib.mixins.NDArrayOperatorsMixin):
    """What numbers and arrays have in common.

    Attributes
    ----------
    origin : Trace
        The trace that they belong to.
    """

    origin: Trace

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        from ukf_sw.tracing import dispatch  # which makes values

        return dispatch.call_ufunc(self.origin, ufunc, method, inputs, options)

    def __array_function__(
        self, function: Callable[..., Any], types: Any, arguments: Any, options: Any
    ) -> Any:
        from ukf_sw.tracing import dispatch

        return dispatch.call_function(self.origin, function, arguments, options)

    def __getattr__(self, name: str) -> Any:
        from ukf_sw.tracing import dispatch

        return dispatch.attribute(self, name)

    def _known(self) -> Any:
        """Give the value, or an array of values, if that is known."""
        raise NotImplementedError

    def __bool__(self) -> bool:
        known = self._known()
        if known is None:
            place = self.origin.place
            raise self.origin.error(*of_truth(place), place)
        return bool(known)

    def _plain(self, kind: str) -> float:
        known = self._known()
        if known is None:
            place = self.origin.place
            raise self.origin.error(*of_number(place, kind), place)
        return float(known)

    def __float__(self) -> float:
        return self._plain("float")

    def __int__(self) -> int:
        return int(self._plain("int"))

    def __complex__(self) -> complex:
        return complex(self._plain("complex"))

    def __index__(self) -> int:
        raise TypeError(f"an index must be an int, not {self._plain('int')!r}")

    def __str__(self) -> str:
        raise self.origin.error(*TEXT)

    def __format__(self, specification: str) -> str:
        raise self.origin.error(*TEXT)

    def __hash__(self) -> int:
        raise self.origin.error(
            "look up data in a dict, a set or a cache", "compute it, or use np.where"
        )

    def __round__(self, digits: int | None = None) -> Any:
        from ukf_sw.tracing import dispatch

        return dispatch.call_function(self.origin, np.round, (self, digits or 0), {})

    def __floor__(self) -> Any:
        return np.floor(cast("Any", self))

    def __ceil__(self) -> Any:
        return np.ceil(cast("Any", self))

    def __trunc__(self) -> Any:
        return np.trunc(cast("Any", self))
