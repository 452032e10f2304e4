"""Whether it is known what a core holds; shared by filter and driver."""

from collections.abc import Callable
from types import TracebackType
from typing import Any

from ukf_sw.errors import REFUSALS, FormatOverflowError, NotRecoveredError

__all__ = ["Certainty"]


class Certainty:
    """Whether it is known what a core holds: in doubt from before it is asked until all is noted.

    ::

        with self._certainty:
            self._x = None
            self._x = ask_the_core()

    An error or an interrupt anywhere within leaves a doubt, in which the next ``with`` raises
    :class:`ukf_sw.errors.NotRecoveredError`; :data:`ukf_sw.errors.REFUSALS` leave none.

    Attributes
    ----------
    doubtful : bool
        Whether there is a doubt.
    """

    __slots__ = ("_unfinished", "doubtful")

    def __init__(self) -> None:
        self.doubtful = False
        self._unfinished: tuple[Callable[..., None], tuple[Any, ...]] | None = None

    def check(self) -> None:
        """Raise NotRecoveredError if there is a doubt."""
        if self.doubtful:
            raise NotRecoveredError

    def __enter__(self) -> None:
        if self.doubtful:
            raise NotRecoveredError
        self._unfinished = None
        self.doubtful = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if kind is None or issubclass(kind, REFUSALS):
            self.doubtful = False

    def assign(self, send: Callable[..., None], *values: Any) -> None:
        """Send values that :meth:`settle` sends again if this breaks off.

        Raises
        ------
        NotRecoveredError
            If there is a doubt.
        """
        with self:
            self._unfinished = send, values
            send(*values)

    def assign_anew(self, send: Callable[..., None], *values: Any) -> None:
        """Send all that a core must be told, so that a doubt from before does not matter."""
        before = self.doubtful, self._unfinished
        self.doubtful = True
        self._unfinished = send, values
        try:
            send(*values)
        except FormatOverflowError:  # the only one that is certain to come before all accesses
            self.doubtful, self._unfinished = before
            raise
        self.doubtful = False

    def settle(self, find_out: Callable[[], None]) -> None:
        """End a doubt: find out what the core holds, then send again what broke off.

        Raises
        ------
        UkfError
            As the functions do. What is in REFUSALS is about what broke off, which is given up.
        """
        self.doubtful = True
        try:
            find_out()
            if self._unfinished is not None:
                send, values = self._unfinished
                send(*values)
        except REFUSALS:
            self._unfinished = None
            self.doubtful = False
            raise
        self.doubtful = False
