"""A small problem whose models a core can have: inputs, angles, two sensors, variants, and errors.

The state is heading in rad, rate in rad/s and a position. An input makes f give a number that is
none, and an argument h.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from support.c_binding import CFilter
from ukf_sw.lowering.placement import PlacedModels, place_models
from ukf_sw.problem import Data, Problem, Sensor
from ukf_sw.spec.parameters import Noise, UkfParams

__all__ = ["AIMED", "BAD_U", "SENSORS", "TURNED", "placed_rover", "rover", "rover_on_c"]

#: What the sensors are called, and the arguments of their h: the first one has two models.
SENSORS = ("aim", "odometer")
AIMED: dict[str, Any] = {"mode": "near", "scale": 1.25}
TURNED: dict[str, Any] = {"mode": "far", "scale": 0.75}
#: An input with which row 1 of f is NaN.
BAD_U = np.array([0.1, -5.0])


def f(x, w, u):
    """Turn and drive."""
    heading, rate, position = x
    noise = [*w, *w[:1], *w[1:2]][:3]
    return np.array([
        heading + 0.5 * rate + noise[0],
        0.9 * rate + 0.2 * np.sqrt(1.0 + u[1]) + noise[1],
        position + u[0] * np.sin(heading) + noise[2],
    ])  # fmt: skip


def aim(x, v, *, mode, scale):
    """Heading, and something of the position that has no value if the scale is negative."""
    far = 2.0 if mode == "far" else 0.5
    return np.array([x[0] * 1.5 + v[0], far * x[2] + np.sqrt(scale) * x[1] + v[1]])


def odometer(x, v):
    """Position."""
    return np.array([x[2] + 0.25 * x[1] + v[0]])


def _data(count: int) -> Data:
    """Samples of both sensors in turn, with both variants."""
    draws = np.random.default_rng(0)
    taken = np.arange(count) % 2 == 0
    return Data(
        times=np.linspace(0.1, 0.1 * count, count),
        measurements={"aim": draws.standard_normal((count, 2)), "odometer": np.zeros((count, 1))},
        sampled={"aim": np.stack([taken, taken], axis=1), "odometer": ~taken[:, None]},
        inputs=draws.uniform(0.1, 0.5, (count, 2)),
        observation_arguments=[(AIMED if k % 4 else TURNED) if taken[k] else {}
                               for k in range(count)],
    )  # fmt: skip


def rover(
    *, noise: Noise = Noise.AUGMENTED, redraw: bool = False, steps: int = 8, **core: Any
) -> Problem:
    """Make the problem, with data.

    Parameters
    ----------
    noise
        Kind of both noises.
    redraw
        Whether every predict ends with a redraw.
    steps
        Steps of the data.
    core
        Other parameters of the core, as W0, form and format.
    """
    terms = 3 if noise is Noise.ADDITIVE else 2
    return Problem(
        name="rover",
        f=f,
        sensors={
            "aim": Sensor(aim, R=np.diag([0.04, 0.05]), m=2, angles=(0,)),
            "odometer": Sensor(odometer, R=[[0.06]], m=1),
        },
        Q=np.diag([0.01, 0.02, 0.03][:terms]),
        x0=np.array([3.0, 0.5, -0.25]),
        P0=np.diag([0.5, 0.25, 1.0]),
        state_angles=(0,),
        process_noise=noise,
        observation_noise=noise,
        redraw=redraw,
        data=_data(steps),
        pes=2,
        **core,
    )


def placed_rover(problem: Problem, which: str) -> tuple[PlacedModels | None, UkfParams]:
    """Place some of its models on a core: "core", "f", "h" or "software"; gives also the core."""
    placed = place_models(problem, which)
    params = problem.params
    return placed, params if placed is None else replace(params, models=placed.models)


def rover_on_c(
    libraries: Any, bus: Any, problem: Problem, placed: PlacedModels | None, params: UkfParams,
    **options: Any,
) -> CFilter:  # fmt: skip
    """Make the C filter for it; models that the core has are NULL.

    Parameters
    ----------
    libraries
        The library, and that of the core, from :mod:`support.c_binding`.
    bus, problem, placed, params
        Way to the core, the problem, and what :func:`placed_rover` gave.
    options
        Those of CFilter.
    """
    on_core = placed is not None and placed.f, placed is not None and placed.h
    return CFilter(
        libraries[0], bus, params, None if on_core[0] else f,
        [None, None] if on_core[1] else [partial(aim, **AIMED), odometer], placed=placed,
        core=libraries[1],
        redraw=problem.redraws, state_angles=(0,), observation_angles=(0,),
        terms=[len(problem.terms_of(sensor)) for sensor in range(2)], **options,
    )  # fmt: skip
