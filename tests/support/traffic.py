"""Bus words of an iteration of models in software, counted by the driver."""

from dataclasses import replace

from ukf_sw.backends import golden_driver
from ukf_sw.drivers.driver import Traffic
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.random_system import random_scenario
from ukf_sw.spec.parameters import Form, UkfParams

__all__ = ["count_words"]


def count_words(params: UkfParams, *, redraws: bool) -> Traffic:
    """Count the bus words of an iteration: the driver drives the golden model, and counts.

    They depend on sizes, kinds of noise, the words of a number, and whether W0 is zero only.

    Parameters
    ----------
    params
        The core.
    redraws
        Whether the filter draws new sigma points after every predict.

    Returns
    -------
    Traffic
        The counts, when each step is found ended on the first look.

    Raises
    ------
    StepError
        If the filter fails.
    """
    # The widest array has the shortest programs, and so is modelled soonest.
    quick = replace(params, pes=params.columns, form=Form.SQUARE_ROOT)
    problem = replace(random_scenario(quick, steps=2), redraw=redraws)
    driver = golden_driver(quick)
    counts: list[Traffic] = []
    run(problem, driver, after_step=lambda done, ukf: counts.append(driver.traffic))
    # The first iteration enables the core as well; the second is like all others.
    return counts[2] - counts[1]
