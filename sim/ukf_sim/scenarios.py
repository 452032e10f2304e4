"""Co-simulating a scenario of one's own, in lockstep with the golden model.

::

    from strut.data import scenario        # any module that can be imported: scenario(steps)
    from ukf_sim.scenarios import cosimulate_scenario

    simulated = cosimulate_scenario(scenario, steps=20)
    print(simulated.okay, simulated.cycles, simulated.results.rms())
"""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ukf_sim.session import CACHE, Job, cosimulate
from ukf_sim.simulators import Simulator
from ukf_sw.problems.scenario import Results, Scenario
from ukf_sw.spec.parameters import Pipeline

__all__ = ["Cosimulation", "cosimulate_scenario"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Cosimulation:
    """What came of a scenario on the simulated core.

    Parameters
    ----------
    steps
        How many steps were asked for.
    results
        Estimates of the core; None if it did not get through a single step.
    mismatch
        What differed first from the golden model, or None.
    stopped
        Error of the core that ended the run, as
        :func:`ukf_sw.problems.judging.describe` gives it, or None.
    words_compared
        Words that were compared with the golden model's.
    cycles
        Clocks of each step of the last iteration with an update, as the core counted them.
    traffic
        Words on the bus of that iteration, as :class:`ukf_sw.drivers.driver.Traffic` names them.
    """

    steps: int
    results: Results | None
    mismatch: str | None
    stopped: dict[str, Any] | None
    words_compared: int
    cycles: dict[str, int]
    traffic: dict[str, int]

    @property
    def okay(self) -> bool:
        """Whether all steps were run, and every word that was read is the golden model's."""
        done = 0 if self.results is None else len(self.results.times)
        return self.mismatch is None and self.stopped is None and done == self.steps


def _check_importable(make: Callable[[int], Scenario]) -> None:
    """Check that another process finds the function as well."""
    try:
        text = pickle.dumps(make)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"make must be a function at the top level of a module, not {make!r}: {error}"
        ) from error
    if b"__main__" in text:
        raise ValueError(
            "make must be in a module that can be imported, not in the script that is run: "
            f"{make!r}"
        )


def cosimulate_scenario(
    make: Callable[[int], Scenario],
    steps: int,
    *,
    pipeline: Pipeline | None = None,
    simulator: Simulator = Simulator.VERILATOR,
    interrupt: bool = True,
    word_clocks: float = 0.0,
    cache: Path = CACHE,
    optimise: bool = True,
    progress: Callable[[str, int], None] | None = None,
) -> Cosimulation:
    """Run the first steps of a scenario on the Verilog, in lockstep with the golden model.

    Parameters
    ----------
    make
        Makes the scenario, with at least so many steps: ``make(steps)``. It is called here and,
        because the models run there, in the process of the simulator. So it must be found there: a
        function at the top level of a module that can be imported, a ``functools.partial`` of one,
        or a method of an object that can be pickled.
    steps
        How many steps.
    pipeline, interrupt, word_clocks
        As :class:`ukf_sim.session.Job` takes them.
    simulator, cache, optimise, progress
        As :func:`ukf_sim.session.cosimulate` takes them.

    Raises
    ------
    ValueError
        If `make` would not be found in another process, or the scenario has fewer steps.
    SimulatorError
        If the simulator is not installed or fails, or a model raises something in it.
    """
    _check_importable(make)
    scenario = make(steps)
    if not 1 <= steps <= scenario.steps:
        raise ValueError(f"steps must be between 1 and {scenario.steps}, not {steps!r}")
    job = Job(
        params=scenario.params,
        pipeline=pipeline or Pipeline(),
        task="ukf_sim.tasks:run_scenario",
        arguments={"make": make, "steps": steps},
        interrupt=interrupt,
        word_clocks=word_clocks,
    )
    outcome = cosimulate(job, simulator, cache=cache, optimise=optimise, progress=progress)
    found = outcome.result
    x = found["x"]
    count = len(x)
    updates = [k for k, clocks in enumerate(found["cycles"]) if "UPDATE" in clocks]
    last = updates[-1] if updates else count - 1
    return Cosimulation(
        steps=steps,
        results=None if not count else Results(
            scenario=scenario,
            times=scenario.times[:count],
            x=x,
            errors=scenario.error(x, scenario.truth[:count]),
            nis=found["nis"],
            gated=found["gated"],
        ),
        mismatch=found["mismatch"],
        stopped=found["stopped"],
        words_compared=found["words_compared"],
        cycles=found["cycles"][last] if count else {},
        traffic=found["traffic"][last] if count else {},
    )  # fmt: skip
