"""Bus words of an iteration, counted by the driver."""

from dataclasses import replace
from typing import Any

from ukf_sw.drivers.driver import Driver
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.configurations import random_scenario
from ukf_sw.problems.judging import iterate
from ukf_sw.spec.parameters import Form, UkfParams

__all__ = ["count_words"]


def count_words(params: UkfParams) -> dict[str, Any]:
    """Count the bus words of an iteration: the driver drives the golden model, and counts.

    They depend on sizes, kinds of noise, and the words of a number only. Sigma points are not
    redrawn between predict and update.

    Parameters
    ----------
    params
        The core.

    Returns
    -------
    dict
        ``words_read`` and ``words_written`` of the buffer: sigma points, what the models make of
        them, measurement, estimate; ``control_reads`` and ``control_writes`` of the registers,
        when each step is found ended on the first look.

    Raises
    ------
    StepError
        If the filter fails.
    """
    # The widest array has the shortest programs, and so is modelled soonest.
    quick = replace(params, pes=params.columns, form=Form.SQUARE_ROOT)
    # Sigma points are drawn once an iteration, as the cycles of an iteration assume.
    scenario = replace(random_scenario(quick, steps=2), redraw=False)
    driver = Driver(GoldenBus(GoldenCore(quick)), quick)
    ukf = scenario.filter(driver)
    before = driver.traffic
    # The first iteration enables the core as well; the second is like all others.
    for _ in iterate(ukf, scenario, 2):
        _ = ukf.x
        before, last = driver.traffic, driver.traffic - before
    return {
        "words_read": last.words_read,
        "words_written": last.words_written,
        "control_reads": last.control_reads,
        "control_writes": last.control_writes,
    }
