"""Time of an iteration of the nanosatellite beside tables 1 and 4 of the 2018 paper."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.study import Study, Tell
from ukf_sim.cosimulation import cosimulate
from ukf_sim.session import CACHE
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.recipe import Recipe
from ukf_sw.spec.parameters import Pipeline
from ukf_tools.estimate.latency import latency

__all__ = ["BUS_CLOCKS", "STUDY", "IterationTraffic", "load", "measure_traffic"]

#: Clocks a word on the paper's bus at 100 MHz: its transfers took 116 us, for 726 words of sigma
#: points (20, 7 and 6 rows of 22), 13 of z and x, and a few of registers.
BUS_CLOCKS = 15.6
CLOCKS_PER_US = 100.0
#: The paper's arithmetic of both models on its processor, us.
MODELS_US = 21.0
#: Its table 4, us: numbers of PEs, then its rows. For 1 PE sig_gen is within predict.
PES = (1, 2, 5, 10)
PAPER: dict[str, tuple[float | None, ...]] = {
    "sigma points": (None, None, 92.0, 61.0, 51.0),
    "system models": (52.0, 137.0, 137.0, 137.0, 137.0),
    "predict": (522.0, 170.0, 13.0, 8.5, 6.5),
    "update": (87.0, 56.0, 30.0, 21.0, 17.0),
    "total": (660.0, 363.0, 272.0, 228.0, 212.0),
}
#: Configurations of the nanosatellite that are co-simulated.
NAMES = ("nanosat", "nanosat-additive")
#: Iterations to co-simulate; all but the first are alike.
STEPS = 3


@dataclass(frozen=True, kw_only=True)
class IterationTraffic:
    """What an iteration takes on the bus, co-simulated.

    Parameters
    ----------
    words
        Words of the buffer, both ways, and starts of steps.
    control
        Other words of the registers, both ways.
    clocks
        Clocks of the whole iteration, the models' arithmetic apart.
    cycles
        Clocks of it in which the core computed.
    pes
        Processing elements of the core.
    """

    words: int
    control: int
    clocks: int
    cycles: int
    pes: int

    def microseconds(self, cycles: int) -> float:
        """Time of an iteration in which the core computes for other cycles."""
        return ((self.words + self.control) * BUS_CLOCKS + cycles) / CLOCKS_PER_US + MODELS_US


def measure_traffic(
    name: str, *, pes: int = 1, cache: Path = CACHE, progress: Callable[[str], None] | None = None
) -> IterationTraffic:
    """Co-simulate a configuration with the paper's bus.

    Parameters
    ----------
    name
        Name of a configuration of the nanosatellite.
    pes
        Processing elements.
    cache
        Folder of compiled cores.
    progress
        Called with what is being done.

    Raises
    ------
    RuntimeError
        If the core differs from the golden model.
    SimulatorError
        If the simulator is not installed or fails.
    """
    tell = progress or (lambda what: None)
    found = cosimulate(
        Recipe.of(name, pes=pes).scenario, STEPS, word_clocks=BUS_CLOCKS, cache=cache,
        progress=lambda phase, done: tell(f"{name}: {phase}"),
    )  # fmt: skip
    stop = found.run.stop
    if found.mismatch is not None or stop is not None:
        raise RuntimeError(f"{name}: {found.mismatch or (stop and stop.message)}")
    last = found.iterations[-1]
    # The driver reads the cycles of both steps only to check them here.
    checks = sum(step in last.cycles for step in ("PREDICT", "UPDATE", "SIG_GEN"))
    return IterationTraffic(
        words=last.traffic.words,
        control=last.traffic.register_words - checks,
        clocks=last.clocks,
        cycles=sum(last.cycles.values()),
        pes=pes,
    )


def load(record: dict[str, dict[str, Any]]) -> dict[str, IterationTraffic]:
    """Read what was measured, by configuration."""
    return {name: IterationTraffic(**traffic) for name, traffic in record.items()}


def _measure(tell: Tell) -> dict[str, dict[str, Any]]:
    """Co-simulate iterations of the nanosatellite with the paper's bus."""
    record: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(NAMES):

        def progress(what: str, k: int = k) -> None:
            tell(what, k, len(NAMES))

        record[name] = asdict(measure_traffic(name, progress=progress))
    return record


def _table(record: dict[str, dict[str, Any]]) -> str:
    """Write the time of an iteration beside the paper's."""
    measured = load(record)
    us = "{:.1f}".format
    schedule = {
        name: [
            latency(replace(entry.params, pes=pes), Pipeline(), redraws=entry.redraws)
            for pes in PES
        ]
        for name, entry in ((name, CATALOGUE[name]) for name in measured)
    }
    ours = {
        "sigma points": ["in update"] * len(PES),
        "predict": [us(p["steps"]["PREDICT"] / CLOCKS_PER_US) for p in schedule["nanosat"]],
        "update": [us(p["steps"]["UPDATE"] / CLOCKS_PER_US) for p in schedule["nanosat"]],
    }
    for key, row in (("nanosat", "total"), ("nanosat-additive", "total, additive noise")):
        traffic = measured[key]
        if key == "nanosat":
            ours["system models"] = [us(traffic.microseconds(0))] * len(PES)
        ours[row] = [f"**{us(traffic.microseconds(p['total']))}**" for p in schedule[key]]
    headings = (
        "µs", "software", *(f"2018, {pes} PE{'s' * (pes > 1)}" for pes in PES),
        *(f"here, {pes}" for pes in PES),
    )  # fmt: skip
    rows: list[tuple[str, ...]] = []
    for name in (*PAPER, "total, additive noise"):
        paper = ["–" if value is None else f"{value:g}" for value in PAPER.get(name, (None,) * 5)]
        rows.append((name, *paper, *ours[name]))
    notes = [
        f"{name}: {t.words} words of data and {t.control} of registers an iteration; with "
        f"{BUS_CLOCKS} clocks a word the co-simulation of {t.pes} PE took {t.clocks} clocks, of "
        f"which the core computed {t.cycles}"
        for name, t in measured.items()
    ]
    return table(headings, rows) + f"\n{'; '.join(notes)}.\n"


STUDY = Study(
    name="iteration",
    document=DOCS / "applications.md",
    measure=_measure,
    tables={"iteration": _table},
)
