"""A link that delays, scatters and loses messages."""

from collections.abc import Generator
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from ukf_sw.extras import importing

with importing("apps"):
    import simpy

__all__ = ["IMMEDIATE", "Link", "LinkSettings"]


@dataclass(frozen=True, kw_only=True)
class LinkSettings:
    """Timing of one direction of a link.

    Parameters
    ----------
    latency
        Shortest time from sending to arrival, s.
    jitter
        Width of the uniform distribution of what comes on top, s.
    loss
        Probability that a message is lost, in [0, 1].

    Raises
    ------
    ValueError
        If a parameter is out of range.
    """

    latency: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0

    def __post_init__(self) -> None:
        for name in ("latency", "jitter"):
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and at least 0, not {value!r}")
        if not 0.0 <= self.loss <= 1.0:
            raise ValueError(f"loss must be between 0 and 1, not {self.loss!r}")


class Link:
    """One direction of a link in a simulation.

    Messages arrive in the order in which they were sent, as on a serial bus: one that is delayed
    less than the one before it arrives together with it.

    Parameters
    ----------
    environment
        Simulation.
    settings
        Timing.
    seed
        Seed of jitter and loss.

    Attributes
    ----------
    inbox : simpy.Store
        Messages that have arrived.
    sent, lost : int
        Messages so far.
    """

    def __init__(self, environment: simpy.Environment, settings: LinkSettings, seed: int) -> None:
        self.inbox = simpy.Store(environment)
        self.sent = self.lost = 0
        self._environment = environment
        self._settings = settings
        self._rng = np.random.default_rng(seed)
        self._last = 0.0

    def send(self, message: Any) -> None:
        """Send a message; returns at once."""
        self.sent += 1
        # Both are drawn for every message: the same seed with more loss has the same delays.
        jitter, luck = self._rng.random(2)
        if luck < self._settings.loss:
            self.lost += 1
            return
        now = float(self._environment.now)
        arrival = max(now + self._settings.latency + self._settings.jitter * jitter, self._last)
        self._last = arrival
        self._environment.process(self._deliver(message, arrival - now))

    def _deliver(self, message: Any, delay: float) -> Generator[simpy.Event, Any, None]:
        # Events of the same time happen in the order in which they were scheduled.
        yield self._environment.timeout(delay)
        yield self.inbox.put(message)


#: No delay, no loss.
IMMEDIATE = LinkSettings()
