"""Iterations with models on the core as a script, for a bus that can do many of them at once.

The accesses are those that :class:`ukf_sw.drivers.driver.Driver` makes, step by step, as long as
every step succeeds.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ukf_sw.ahead import CoreSample, CoreUpdate
from ukf_sw.drivers.bus import Addresses, Script, Start, WordCodec
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.sequence import Step

__all__ = ["Known", "ScriptBuilder", "mask_with"]


def _inputs_of(sample: CoreSample) -> list[Mapping[int, float]]:
    """Give the inputs of f, and those of each update."""
    return [sample.inputs, *(update.inputs for update in sample.updates)]


def mask_with(params: UkfParams, before: int | None, mask: NDArray[np.bool_], sensor: int) -> int:
    """Give MASK with which rows of a sensor take part; the others stay.

    Parameters
    ----------
    params
        Of the core.
    before
        What MASK was; None is what it is after a reset.
    mask
        Which rows of the sensor take part, shape (rows,).
    sensor
        Which sensor.
    """
    sampled = int.from_bytes(np.packbits(mask, bitorder="little").tobytes(), "little")
    rows = params.rows_of(sensor)
    own = (1 << rows.stop) - (1 << rows.start)
    every = (1 << params.m) - 1 if before is None else before
    return every & ~own | sampled << rows.start


class Known(NamedTuple):
    """What the driver knows of the core after a round, and the words that have crossed the bus.

    Parameters
    ----------
    drawn, propagated
        Whether X holds sigma points of the estimate, or those of a prediction.
    mask
        What MASK holds; None if that is not known.
    inputs
        Words of region U, by place.
    starts, words_written, control_reads, control_writes
        As :class:`ukf_sw.drivers.driver.Traffic` has them.
    """

    drawn: bool
    propagated: bool
    mask: int | None
    inputs: Mapping[int, bytes]
    starts: int = 0
    words_written: int = 0
    control_reads: int = 0
    control_writes: int = 0


class ScriptBuilder:
    """Makes a script of samples, a round of each.

    Parameters
    ----------
    params
        What the core computes.
    known
        What is known before the first sample.
    inputs, observations
        Word addresses: of region U, and of z of each sensor.

    Attributes
    ----------
    known : list of Known
        What is known after each round.
    """

    def __init__(
        self,
        params: UkfParams,
        known: Known,
        *,
        inputs: Addresses,
        observations: Sequence[Addresses],
    ) -> None:
        self._params = params
        self._codec = WordCodec(params.format)
        self._size = params.format.bus_words
        self._of_inputs: list[list[int]] = inputs.reshape(-1, self._size).tolist()
        self._of_z: list[list[int]] = [each.tolist() for each in observations]
        self._drawn, self._propagated = known.drawn, known.propagated
        # Before anything has been written to it, MASK has what it has after a reset.
        self._mask, self._masks = known.mask, dict[tuple[int | None, int, bytes], int]()
        self._inputs = known.inputs
        self._starts: list[Start] = []
        self._ends: list[int] = []
        self._updates: list[list[int]] = []
        self._addresses: list[int] = []
        self._data = bytearray()
        self._nis_reads = self._control_writes = 0
        self.known: list[Known] = []

    def script(self, reads: Addresses) -> Script:
        """Give the script of what has been added, with what is to be read after each round."""
        return Script(
            starts=self._starts,
            ends=self._ends,
            addresses=np.array(self._addresses, dtype=np.int64),
            words=np.frombuffer(bytes(self._data), dtype=np.uint32),
            reads=reads,
        )

    def nis_of_updates(self, nis: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Give the NIS of the updates of each round, from that after each start."""
        return [nis[updates] for updates in self._updates if max(updates, default=-1) < len(nis)]

    def add(self, samples: Sequence[CoreSample], *, redraws: bool) -> None:
        """Add rounds, up to a sample with an input that is too large for the format.

        Parameters
        ----------
        samples
            The samples.
        redraws
            Whether new sigma points are drawn after each prediction.
        """
        numbers = [
            number
            for sample in samples
            for inputs in _inputs_of(sample)
            for number in inputs.values()
        ]
        words = self._codec.to_words(np.array(numbers, dtype=np.float64))
        finite = np.isfinite(self._codec.from_words(words))
        fitting = len(numbers) if finite.all() else int(finite.argmin())
        observed = [update.z for sample in samples for update in sample.updates]
        z = self._codec.to_words(np.concatenate([np.zeros(0), *observed])).tobytes()
        data, size = words.tobytes(), 4 * self._size
        taken = taken_of_z = 0
        for sample in samples:
            inputs: list[dict[int, bytes]] = []
            for each in _inputs_of(sample):
                starts = range(size * taken, size * (taken + len(each)), size)
                inputs.append({
                    place: data[start : start + size]
                    for place, start in zip(each, starts, strict=True)
                })  # fmt: skip
                taken += len(each)
            if taken > fitting:
                return
            observations: list[bytes] = []
            for update in sample.updates:
                length = size * len(update.z)
                observations.append(z[taken_of_z : taken_of_z + length])
                taken_of_z += length
            self._add_round(sample, inputs, observations, redraws=redraws)

    def _add_round(
        self,
        sample: CoreSample,
        inputs: Sequence[Mapping[int, bytes]],
        observations: Sequence[bytes],
        *,
        redraws: bool,
    ) -> None:
        self._updates.append([])
        self._draw()
        self._write_inputs(inputs[0])
        iterates = bool(sample.updates) and not redraws
        if not iterates:
            self._start(Step.F)
            if redraws:
                self._start(Step.SIG_GEN)
        for number, update in enumerate(sample.updates):
            if not (iterates and number == 0) and not self._propagated:
                self._draw()
            self._write_inputs(inputs[1 + number])
            self._write(self._of_z[update.sensor], observations[number])
            mask = self._mask_with(update)
            self._control_writes += mask != self._mask
            self._mask = mask
            self._updates[-1].append(len(self._starts))
            self._nis_reads += 1
            step = Step.ITERATE if iterates and number == 0 else Step.H
            self._start(step, update.sensor, update.variant)
        self._ends.append(len(self._starts))
        self.known.append(Known(
            drawn=self._drawn,
            propagated=self._propagated,
            mask=self._mask,
            inputs=self._inputs,
            starts=len(self._starts),
            words_written=len(self._addresses),
            # STATUS and ERROR after each, and the NIS.
            control_reads=2 * len(self._starts) + self._size * self._nis_reads,
            control_writes=self._control_writes,
        ))  # fmt: skip

    def _mask_with(self, update: CoreUpdate) -> int:
        """Give :func:`mask_with`, which mostly is what it was before."""
        key = self._mask, update.sensor, update.mask.tobytes()
        if key not in self._masks:
            self._masks[key] = mask_with(self._params, self._mask, update.mask, update.sensor)
        return self._masks[key]

    def _draw(self) -> None:
        if not self._drawn:
            self._start(Step.SIG_GEN)

    def _start(self, step: Step, sensor: int = 0, variant: int = 0) -> None:
        mask = (1 << self._params.m) - 1 if self._mask is None else self._mask
        self._starts.append(Start(step, sensor, variant, mask, len(self._addresses)))
        self._drawn, self._propagated = step is not Step.F, step is Step.F

    def _write(self, addresses: Sequence[int], data: bytes) -> None:
        self._addresses += addresses
        self._data += data

    def _write_inputs(self, inputs: Mapping[int, bytes]) -> None:
        """Write those that the core does not have."""
        changed = {place: word for place, word in inputs.items() if self._inputs.get(place) != word}
        if changed:
            for place, word in changed.items():
                self._write(self._of_inputs[place], word)
            self._inputs = {**self._inputs, **changed}
