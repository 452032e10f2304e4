"""What the simulated systems share."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["check_steps", "draw"]


def check_steps(steps: int | None, whole: int) -> int:
    """Give the number of steps to simulate or to take from a record.

    Parameters
    ----------
    steps
        How many are asked for; None is all.
    whole
        How many there are.

    Raises
    ------
    TypeError
        If `steps` is not an int.
    ValueError
        If there are not that many.
    """
    if steps is None:
        return whole
    if not isinstance(steps, int) or isinstance(steps, bool):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise TypeError(f"steps must be an int, not {steps!r}")
    if not 1 <= steps <= whole:
        raise ValueError(f"steps must be between 1 and {whole}, not {steps!r}")
    return steps


def draw(seed: int, count: int, terms: int) -> NDArray[np.float64]:
    """Draw standard normal numbers, shape (count, terms), sample by sample.

    Fewer samples are the beginning of more, so a short scenario is the beginning of a long one.
    """
    return np.random.default_rng(seed).standard_normal((count, terms))
