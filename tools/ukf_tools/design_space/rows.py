"""A row of figures for each core of a sweep."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ukf_sw.spec.core import PARAMETERS
from ukf_tools.design_space.points import Point
from ukf_tools.estimate.series7 import Netlist
from ukf_tools.estimate.traffic import traffic_of

__all__ = ["COLUMNS", "Column", "Conditions", "figures"]


class Column(NamedTuple):
    """A column of the table.

    Parameters
    ----------
    kind
        Type of its entries.
    doc
        Meaning, with the unit.
    """

    kind: type
    doc: str


#: Every column, in order. An entry that is not known is empty.
COLUMNS = {
    "problem": Column(str, "Problem that the core is for, if it has a name."),
    **{label: Column(entry.cell_kind, entry.meaning.doc) for label, entry in PARAMETERS.items()},
    "sigma_points": Column(
        int, "Sigma points with a weight, so evaluations of each model an iteration."
    ),
    "redraws": Column(bool, "Whether sigma points are drawn after every predict."),
    "predict_cycles": Column(int, "Clocks of PREDICT, with the SIG_GEN after it if that redraws."),
    "update_cycles": Column(
        int, "Clocks of UPDATE, of all sensors; it makes the next sigma points as well."
    ),
    "cycles": Column(int, "Clocks of an iteration: their sum."),
    "sig_gen_cycles": Column(int, "Clocks of SIG_GEN when x or L was written; else 0."),
    "sig_gen_predicted_cycles": Column(int, "Clocks of SIG_GEN after a PREDICT."),
    "init_cycles": Column(int, "Clocks of INIT."),
    "covariance_cycles": Column(int, "Clocks of COVARIANCE."),
    "bus_words": Column(int, "Bus words an iteration: numbers, and starts of steps."),
    "register_words": Column(int, "Further bus words: looking for the end, errors, NIS, masks."),
    "clock_mhz": Column(float, "Clock in MHz: an assumption."),
    "word_clocks": Column(float, "Clocks of a bus word: an assumption."),
    "core_us": Column(float, "Time of these steps in microseconds at that clock."),
    "bus_us": Column(float, "Time of all bus words in microseconds at that clock."),
    "iteration_us": Column(float, "Their sum: an iteration, the models' own computing apart."),
    "lut": Column(int, "Look-up tables."),
    "lut_logic": Column(int, "Of these, logic."),
    "lut_memory": Column(int, "Of these, memory."),
    "lut_shift": Column(int, "Of these, shift registers."),
    "ff": Column(int, "Flip-flops."),
    "dsp48e1": Column(int, "DSP slices."),
    "bram36": Column(float, "Block memories of 36 Kbit."),
    "logic_ns": Column(float, "Longest path between registers in ns, cells only: no routing."),
    "application": Column(str, "What accuracy was judged on."),
    "steps": Column(int, "Steps that the golden model did."),
    "error_name": Column(str, "First error of the application."),
    "error_unit": Column(str, "Its unit."),
    "rms": Column(float, "Its root mean square on the golden model."),
    "reference_rms": Column(float, "Its root mean square on the float64 reference."),
    "rms_ratio": Column(float, "Golden model to float64 reference; 1 is as good."),
    "stopped": Column(str, "Error of the core that ended the run, if one did."),
    "error": Column(str, "What could not be found out, and why."),
}


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Assumptions under which cycles and words become times.

    Parameters
    ----------
    clock_mhz
        Clock in MHz.
    word_clocks
        Clocks of a bus word, on average; 15.6 is the bus of the 2018 paper.

    Raises
    ------
    ValueError
        If one of them is not possible.
    """

    clock_mhz: float = 100.0
    word_clocks: float = 15.6

    def __post_init__(self) -> None:
        if not 0.0 < self.clock_mhz < float("inf"):
            raise ValueError(f"clock_mhz must be more than 0, not {self.clock_mhz!r}")
        if not 0.0 <= self.word_clocks < float("inf"):
            raise ValueError(f"word_clocks must be at least 0, not {self.word_clocks!r}")


def figures(
    point: Point,
    found: Mapping[str, Mapping[str, Any]],
    failures: Mapping[str, str],
    conditions: Conditions,
) -> dict[str, Any]:
    """Make the row of a core.

    Parameters
    ----------
    point
        The core.
    found
        Results of its parts, by name: ``schedule``, ``resources``, ``accuracy``,
        ``reference``, as far as they are there.
    failures
        Messages of what failed, by name.
    conditions
        Clock and bus.

    Returns
    -------
    dict
        An entry for each of :data:`COLUMNS`.
    """
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row |= point.cells()
    row |= _of_core(point)
    if "schedule" in found:
        row |= _cycles(found["schedule"])
    row |= _times(row, conditions)
    if "resources" in found:
        resources = Netlist(**found["resources"]).resources.as_dict()
        row |= {name: value for name, value in resources.items() if name in COLUMNS}
    if "accuracy" in found:
        row |= _accuracy(found["accuracy"], found.get("reference", {}))
    row["error"] = "; ".join(f"{name}: {text}" for name, text in failures.items()) or None
    return row


def _of_core(point: Point) -> dict[str, Any]:
    """What follows from a core, if there is such a one."""
    try:
        core = point.core
    except ValueError:
        return {}
    traffic = traffic_of(core.params, redraws=core.redraws)
    return {
        "sigma_points": len(core.params.points), "redraws": core.redraws,
        "bus_words": traffic.words, "register_words": traffic.register_words,
    }  # fmt: skip


def _cycles(schedule: Mapping[str, Any]) -> dict[str, int]:
    programs, steps = schedule["programs"], schedule["steps"]
    predict = steps.get("PREDICT", 0) + steps.get("F", 0) + steps["SIG_GEN"]
    return {
        "predict_cycles": predict,
        "update_cycles": schedule["total"] - predict,
        "cycles": schedule["total"],
        "sig_gen_cycles": programs["SIG_GEN"],
        "sig_gen_predicted_cycles": programs["SIG_GEN_PREDICTED"],
        "init_cycles": programs["INIT"],
        "covariance_cycles": programs["COVARIANCE"],
    }


def _times(row: Mapping[str, Any], conditions: Conditions) -> dict[str, float]:
    times = {"clock_mhz": conditions.clock_mhz, "word_clocks": conditions.word_clocks}
    if row["cycles"] is not None:
        times["core_us"] = row["cycles"] / conditions.clock_mhz
    if row["bus_words"] is not None:
        words = row["bus_words"] + row["register_words"]
        times["bus_us"] = words * conditions.word_clocks / conditions.clock_mhz
    if "core_us" in times and "bus_us" in times:
        times["iteration_us"] = times["core_us"] + times["bus_us"]
    return times


def _accuracy(golden: Mapping[str, Any], reference: Mapping[str, Any]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "steps": golden["steps"],
        "error_name": golden["names"][0],
        "error_unit": golden["units"][0],
    }
    stopped = golden["stopped"]
    if stopped is not None:
        index = "" if stopped["index"] is None else f" {stopped['index']}"
        row["stopped"] = f"{stopped['step']}: {stopped['error']}{index}"
    if golden["rms"] is not None:
        row["rms"] = golden["rms"][0]
    if reference.get("rms") is not None:
        row["reference_rms"] = reference["rms"][0]
        if "rms" in row and row["reference_rms"] > 0.0:
            row["rms_ratio"] = row["rms"] / row["reference_rms"]
    return row
