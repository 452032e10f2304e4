"""The distributed platform: flight computer and estimator, two processes joined by a link.

The estimator, a signal processor with the gyroscope, requests directions of Sun and field; the
flight computer, which has these sensors, samples them when the request arrives and replies (figures
2 and 3). What the estimator gets is therefore old. The paper asks for the effect of that delay.
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ukf_sw.extras import importing
from ukf_sw.problems.judging import rms_after
from ukf_sw.problems.systems.nanosat import attitude_error
from ukf_sw.problems.systems.swampsat.flight import Flight
from ukf_sw.problems.systems.swampsat.kinematics import attitude_matrix, propagate
from ukf_sw.problems.systems.swampsat.link import IMMEDIATE, Link, LinkSettings

with importing("apps"):
    import simpy

__all__ = ["Estimator", "Platform", "PlatformResults", "PlatformSettings", "run_platform"]

Array = NDArray[np.float64]
Process = Generator[simpy.Event, Any, None]

#: Times closer than this, in s, are the same.
RESOLUTION = 1e-9


class Estimator(Protocol):
    """What runs on the signal processor, such as :class:`.ekf.MurrellEkf`."""

    @property
    def q(self) -> Array:
        """Attitude, inertial to body, shape (4,)."""
        ...

    @property
    def bias(self) -> Array:
        """Bias of the gyroscope, shape (3,), rad/s."""
        ...

    def predict(self, gyroscope: Array, dt: float) -> None:
        """Propagate by a time dt, s, with a sample of the gyroscope, shape (3,), rad/s."""
        ...

    def update(self, measured: Array, references: Array, mask: NDArray[np.bool_]) -> None:
        """Correct with directions in body and inertial frame, shape (2, 3); mask has shape (2,)."""
        ...


@dataclass(frozen=True, kw_only=True)
class PlatformSettings:
    """How the two computers work together.

    Parameters
    ----------
    interval
        Time between two requests, s.
    request, reply
        The link's two directions.
    response
        Time from a request's arrival to the sample, and again from there to the reply, s.
    timeout
        A reply later than this after its request is discarded, s.
    compensate
        False: a reply is taken as sampled when it arrives, as in the paper. True: the reply carries
        its time, and the gyroscope's samples since then turn the directions to the present.

    Raises
    ------
    ValueError
        If a time is out of range.
    """

    interval: float = 2.0
    request: LinkSettings = IMMEDIATE
    reply: LinkSettings = IMMEDIATE
    response: float = 0.0
    timeout: float = float("inf")
    compensate: bool = False

    def __post_init__(self) -> None:
        if not (isfinite(self.interval) and self.interval > 0.0):
            raise ValueError(f"interval must be finite and more than 0, not {self.interval!r}")
        if not (isfinite(self.response) and self.response >= 0.0):
            raise ValueError(f"response must be finite and at least 0, not {self.response!r}")
        if not self.timeout > 0.0:
            raise ValueError(f"timeout must be more than 0, not {self.timeout!r}")


@dataclass(frozen=True)
class _Reply:
    requested: float
    time: float
    vectors: Array
    lit: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class PlatformResults:
    """What happened on the platform.

    Parameters
    ----------
    times
        Ends of the slots, shape (K,), s.
    attitude
        Total attitude error then, shape (K,), degrees.
    requests
        Requests sent.
    lost
        Requests and replies that the link lost.
    late
        Replies discarded because they came after their timeout.
    ages
        Time from sample to use of each reply that was used, shape (U,), s.
    """

    times: Array
    attitude: Array = field(repr=False)
    requests: int
    lost: int
    late: int
    ages: Array = field(repr=False)

    def rms(self, after: float = -np.inf) -> float:
        """Root mean square attitude error later than a time, degrees.

        Raises
        ------
        ValueError
            If there is no such time.
        """
        return rms_after(self.times, self.attitude, after)


class Platform:
    """Simulation of the two computers over a flight.

    At the end of every slot the estimator predicts with the slot's sample of the gyroscope. When a
    reply arrives, it propagates to that moment with the last sample, and updates.

    Parameters
    ----------
    flight
        Truth and samples.
    estimator
        Estimator with its first estimate, that of time 0.
    settings
        How they work together.
    seed
        Seed of jitter and loss.
    """

    def __init__(
        self, flight: Flight, estimator: Estimator, settings: PlatformSettings, seed: int = 0
    ) -> None:
        self._flight = flight
        self._estimator = estimator
        self._settings = settings
        self._environment = simpy.Environment()
        self._request = Link(self._environment, settings.request, 2 * seed)
        self._reply = Link(self._environment, settings.reply, 2 * seed + 1)
        self._slot = 0  # slots whose sample of the gyroscope has been used
        self._time = 0.0  # of the estimate
        self._requests = self._late = 0
        self._ages: list[float] = []
        self._attitude = np.empty((flight.steps, 4))

    def run(self) -> PlatformResults:
        """Run the simulation to the end of the flight; once only."""
        environment, flight = self._environment, self._flight
        for process in (self._sample, self._predict, self._receive, self._send):
            environment.process(process())
        # The end comes after what happens at the same time.
        environment.run(until=float(flight.times[-1]) + RESOLUTION)
        return PlatformResults(
            times=flight.times[1:],
            attitude=attitude_error(self._attitude, flight.attitude[1:])[:, 0],
            requests=self._requests,
            lost=self._request.lost + self._reply.lost,
            late=self._late,
            ages=np.array(self._ages),
        )

    # Flight computer.

    def _sample(self) -> Process:
        """Answer requests, one at a time."""
        environment = self._environment
        while True:
            requested: float = yield self._request.inbox.get()
            yield environment.timeout(self._settings.response)
            time = float(environment.now)
            flight = self._flight
            reply = _Reply(requested, time, flight.vectors_at(time), flight.lit_at(time))
            yield environment.timeout(self._settings.response)
            self._reply.send(reply)

    # Signal processor.

    def _predict(self) -> Process:
        """Predict at the end of every slot."""
        for time in self._flight.times[1:]:
            yield self._until(float(time))
            self._advance()

    def _send(self) -> Process:
        """Request directions at regular intervals."""
        while True:
            self._requests += 1
            time = self._requests * self._settings.interval
            if time > float(self._flight.times[-1]) + RESOLUTION:
                self._requests -= 1
                return
            yield self._until(time)
            self._request.send(time)

    def _receive(self) -> Process:
        """Update whenever a reply arrives."""
        while True:
            reply: _Reply = yield self._reply.inbox.get()
            now = float(self._environment.now)
            if now > reply.requested + self._settings.timeout + RESOLUTION:
                self._late += 1
                continue
            self._advance()
            self._ages.append(now - reply.time)
            time, vectors = now, reply.vectors
            if self._settings.compensate:
                time = reply.time
                vectors = vectors @ attitude_matrix(self._turn_since(time)).T
            references = self._flight.references_at(time)
            self._estimator.update(vectors, references, np.array([reply.lit, True]))
            self._record()

    def _until(self, time: float) -> simpy.Event:
        return self._environment.timeout(max(time - float(self._environment.now), 0.0))

    def _advance(self) -> None:
        """Propagate the estimate to the present; slots that have ended with their own samples."""
        now, flight = float(self._environment.now), self._flight
        while self._slot < flight.steps and flight.times[self._slot + 1] <= now + RESOLUTION:
            end = float(flight.times[self._slot + 1])
            if end - self._time > RESOLUTION:
                self._estimator.predict(flight.gyroscope[self._slot], end - self._time)
            self._time = end
            self._slot += 1
            self._record()
        if now - self._time > RESOLUTION:
            # The sample of this slot is not there yet; in the first slot there is none at all.
            latest = flight.gyroscope[self._slot - 1] if self._slot else self._estimator.bias
            self._estimator.predict(latest, now - self._time)
            self._time = now

    def _record(self) -> None:
        """Keep the estimate if it is one at the end of a slot."""
        if self._slot and self._time - float(self._flight.times[self._slot]) <= RESOLUTION:
            self._attitude[self._slot - 1] = self._estimator.q

    def _turn_since(self, time: float) -> Array:
        """Rotation of the body from a time to the present, by the gyroscope, shape (4,)."""
        flight, turn = self._flight, np.array([0.0, 0.0, 0.0, 1.0])
        dt = flight.settings.dt
        k = int((time + RESOLUTION) / dt)
        while self._time - time > RESOLUTION:
            end = min((k + 1) * dt, self._time)
            known = min(k, self._slot - 1)
            if known < 0:
                break
            rates = flight.gyroscope[known] - self._estimator.bias
            turn = propagate(turn, rates, end - time)
            time, k = end, k + 1
        return turn


def run_platform(
    flight: Flight, estimator: Estimator, settings: PlatformSettings, *, seed: int = 0
) -> PlatformResults:
    """Simulate the platform over a flight; arguments as for :class:`Platform`."""
    return Platform(flight, estimator, settings, seed).run()
