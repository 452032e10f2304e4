"""Samples for a backend that evaluates models itself and can do many of them at once."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ukf_sw.lowering.placement import PlacedModels

__all__ = ["CoreSample", "CoreUpdate", "Observations", "samples_for_core"]

#: Of one sensor: z, and what of it was sampled, both of shape (K, rows).
Observations = tuple[NDArray[np.float64], NDArray[np.bool_]]


class CoreUpdate(NamedTuple):
    """An update with a model on the core.

    Parameters
    ----------
    sensor, variant
        Which sensor, and which of its models.
    inputs
        Numbers of region U by place.
    z, mask
        What was observed, and which rows of it were sampled, shape (rows,).
    """

    sensor: int
    variant: int
    inputs: Mapping[int, float]
    z: NDArray[np.float64]
    mask: NDArray[np.bool_]


class CoreSample(NamedTuple):
    """An iteration with models on the core.

    Parameters
    ----------
    inputs
        Numbers of region U for f, by place.
    updates
        Updates after the prediction, in order.
    """

    inputs: Mapping[int, float]
    updates: Sequence[CoreUpdate]


def samples_for_core(
    placed: "PlacedModels",
    names: Sequence[str],
    inputs: Sequence[Any],
    observations: Sequence[Observations],
    arguments: Sequence[Mapping[str, Any]],
) -> list[CoreSample]:
    """Make samples, up to one that a core would not be asked to do.

    Parameters
    ----------
    placed
        What is on the core: f and every h.
    names
        Names of the sensors, in their order.
    inputs
        Third argument of f, K of them.
    observations
        What each sensor has observed.
    arguments
        Keyword arguments of h, K of them.
    """
    fine = np.ones(len(inputs), dtype=np.bool_)
    sampled: list[Any] = []
    for z, mask in observations:
        fine &= (np.isfinite(z) | ~mask).all(axis=1)
        sampled.append(mask.any(axis=1))
    observed = [np.where(mask, z, 0.0) for z, mask in observations]
    found: list[CoreSample] = []
    for k in range(len(inputs) if fine.all() else int(fine.argmin())):
        try:
            of_f = placed.inputs_of_f(inputs[k], {})
            updates = [
                CoreUpdate(
                    sensor, *placed.inputs_of_h(name, arguments[k]), observed[sensor][k],
                    observations[sensor][1][k],
                )
                for sensor, name in enumerate(names)
                if sampled[sensor][k]
            ]  # fmt: skip
        except (TypeError, ValueError):
            break
        found.append(CoreSample(of_f, updates))
    return found
