"""Arrays that a filter gives: they refuse to be written, since that would not reach the filter."""

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["ReadOnlyArray"]


def _in_place(name: str) -> Callable[["ReadOnlyArray", Any], Any]:
    """Make an in-place operator that gives a new array, if it may not write its own."""
    plain = getattr(operator, name)
    in_place = getattr(np.ndarray, f"__i{name.strip('_')}__")

    def operate(self: "ReadOnlyArray", other: Any) -> Any:
        if self.flags.writeable:
            return in_place(self, other)
        return plain(np.asarray(self), other)

    return operate


class ReadOnlyArray(np.ndarray):
    """An array that a filter gives: a copy, which cannot be written.

    To assign an element raises ValueError, with a message that says what to do instead. In-place
    operators give a new array, so ``ukf.x += d`` assigns ``ukf.x + d``. What is computed or copied
    from it, or pickled, is a usual array.
    """

    @staticmethod
    def of(array: NDArray[Any]) -> "ReadOnlyArray":
        """Give an array of which nobody else has a view."""
        array.flags.writeable = False
        return array.view(ReadOnlyArray)

    def __setitem__(self, key: Any, value: Any) -> None:
        if not self.flags.writeable:
            raise ValueError(
                "An array that a filter gives must not be written, for the filter would not see "
                "it: assign the whole, as in x = ukf.x.copy(); x[0] = 1.0; ukf.x = x"
            )
        super().__setitem__(key, value)

    def __array_wrap__(
        self, array: NDArray[Any], context: Any = None, return_scalar: bool = False
    ) -> Any:
        plain = np.asarray(array)
        return plain[()] if plain.ndim == 0 else plain

    def copy(self, order: Any = "C") -> NDArray[Any]:
        """Copy to a usual array."""
        return np.array(self, order=order)

    def __copy__(self) -> NDArray[Any]:
        return self.copy()

    def __deepcopy__(self, memo: Any) -> NDArray[Any]:
        return self.copy()

    def __reduce__(self) -> Any:
        return self.copy().__reduce__()

    def __reduce_ex__(self, protocol: Any) -> Any:
        return self.copy().__reduce_ex__(protocol)

    def __repr__(self) -> str:
        return repr(np.asarray(self))

    __iadd__, __isub__, __imul__, __itruediv__ = map(_in_place, ("add", "sub", "mul", "truediv"))
    __ifloordiv__, __imod__, __ipow__ = map(_in_place, ("floordiv", "mod", "pow"))
    __iand__, __ior__, __ixor__ = map(_in_place, ("and_", "or_", "xor"))
