"""Accuracy of a core on an application, on the golden model and on the float64 reference."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from ukf_sw.backends import Backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.configurations import CONFIGURATIONS, Problem
from ukf_sw.problems.judging import SETTLED, run_problem
from ukf_sw.problems.scenario import Scenario
from ukf_sw.reference import ReferenceUkf
from ukf_sw.spec.parameters import UkfParams

__all__ = ["Application", "golden_errors", "reference_errors"]

#: What makes a core fit an application.
_SIZES = ("n", "m", "q", "r", "process_noise", "observation_noise")


@dataclass(frozen=True, kw_only=True)
class Application:
    """Data that cores are judged on.

    Parameters
    ----------
    name
        An entry of the catalogue, or a configuration.
    steps
        Number of steps.
    seed
        Seed of the data.

    Raises
    ------
    ValueError
        If there is no such entry or configuration, or no step.
    """

    name: str
    steps: int = 2000
    seed: int = 0

    def __post_init__(self) -> None:
        known = dict.fromkeys((*CONFIGURATIONS, *CATALOGUE))
        if self.name not in known:
            raise ValueError(f"application must be one of {', '.join(known)}, not {self.name!r}")
        if self.steps < 1:
            raise ValueError(f"steps must be at least 1, not {self.steps!r}")

    def scenario(self) -> Scenario:
        """Make the data.

        Raises
        ------
        ValueError
            If the application does not have that many steps.
        """
        if self.name in CATALOGUE:
            return CATALOGUE[self.name].scenario(self.seed, self.steps)
        params = CONFIGURATIONS[self.name].params
        problem = Problem(configuration=self.name, params=params, seed=self.seed)
        return problem.scenario(self.steps)

    @property
    def settled(self) -> float:
        """Time from which on errors are judged, in s."""
        return CATALOGUE[self.name].settled if self.name in CATALOGUE else SETTLED

    def fits(self, params: UkfParams) -> bool:
        """Whether a core has the sizes and the kinds of noise of this application."""
        wanted = _params(self.name)
        return all(getattr(params, name) == getattr(wanted, name) for name in _SIZES)


@cache
def _params(name: str) -> UkfParams:
    """Parameters of an application; an entry of the catalogue says them with its data only."""
    if name in CONFIGURATIONS:
        return CONFIGURATIONS[name].params
    return CATALOGUE[name].scenario(0, 1).params


def golden_errors(application: Application, params: UkfParams) -> dict[str, Any]:
    """Run an application on the golden model of a core.

    Parameters
    ----------
    application
        The application.
    params
        The core.

    Returns
    -------
    dict
        ``names``, ``units`` and ``rms`` of the errors, judged once the filter has settled, or over
        all steps if it never does; ``steps`` that were done, and ``stopped``: None, or what the
        core reported, which ends the run. Then there are no ``rms``.

    Raises
    ------
    ValueError
        If the core does not have the sizes of the application.
    """
    return _errors(application, params, lambda p: Driver(GoldenBus(GoldenCore(p)), p))


def reference_errors(application: Application, params: UkfParams) -> dict[str, Any]:
    """Run an application on the float64 reference; see :func:`golden_errors`."""
    return _errors(application, params, ReferenceUkf)


def _errors(
    application: Application, params: UkfParams, backend: Callable[[UkfParams], Backend]
) -> dict[str, Any]:
    if not application.fits(params):
        raise ValueError(f"the core must have the sizes of {application.name}, {_SIZES}")
    scenario = replace(application.scenario(), params=params)
    result = run_problem(backend(params), scenario, scenario.steps)
    stopped = result["stopped"]
    rms = None
    if stopped is None:
        judged = scenario.times > application.settled
        if not judged.any():
            judged[:] = True
        if scenario.judged is not None and (judged & scenario.judged).any():
            judged &= scenario.judged
        errors = scenario.error(result["x"], scenario.truth)[judged]
        rms = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    return {
        "names": list(scenario.error_names),
        "units": list(scenario.error_units),
        "rms": rms,
        "steps": len(result["x"]),
        "stopped": stopped,
    }
