"""When which sensor is sampled."""

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

__all__ = ["ALTERNATE", "INTERVALS", "Sampling"]


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Sampling of vector sensors and gyroscope in slots of equal length.

    Parameters
    ----------
    interval
        Time between two samples of the vector sensors, s; a whole number of slots.
    alternate
        Whether one slot samples the gyroscope and the next one the vector sensors, and so on. A
        sample of the gyroscope then serves for two slots. The interval must be two slots.

    Raises
    ------
    ValueError
        If the interval is not positive and finite.
    """

    interval: float
    alternate: bool = False

    def __post_init__(self) -> None:
        if not (isfinite(self.interval) and self.interval > 0.0):
            raise ValueError(f"interval must be finite and more than 0, not {self.interval!r}")

    @property
    def name(self) -> str:
        """Name in tables: "alternate", or the interval such as "2 s"."""
        return "alternate" if self.alternate else f"{self.interval:g} s"

    @property
    def noise_factor(self) -> float:
        """Factor of the angle random walk's variance; a sample used twice has its noise twice."""
        return 2.0 if self.alternate else 1.0

    def slots(self, dt: float) -> int:
        """Slots of length dt between two samples of the vector sensors.

        Raises
        ------
        ValueError
            If the interval is not a whole number of slots, or alternate and not two.
        """
        count = round(self.interval / dt)
        if count < 1 or abs(count * dt - self.interval) > 1e-9 * self.interval:
            raise ValueError(f"interval must be a multiple of {dt} s, not {self.interval!r}")
        if self.alternate and count != 2:
            raise ValueError(f"interval must be {2 * dt} s to alternate, not {self.interval!r}")
        return count

    def sampled(self, count: int, dt: float) -> NDArray[np.bool_]:
        """Whether the vector sensors are sampled at the end of each of so many slots."""
        return np.arange(1, count + 1) % self.slots(dt) == 0

    def gyroscope_slots(self, count: int) -> NDArray[np.int64]:
        """Which slot's gyroscope sample serves in each of so many slots."""
        slots = np.arange(count)
        return slots - slots % 2 if self.alternate else slots


#: The paper's intervals, and every other slot without alternation.
INTERVALS = tuple(Sampling(interval=interval) for interval in (0.2, 2, 5, 10, 15, 20, 60))
#: "Attitude sensors and gyros sampled alternately" (figures 6a and 7a), in slots of 0.1 s.
ALTERNATE = Sampling(interval=0.2, alternate=True)
