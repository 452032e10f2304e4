"""Whole iterations: the core with the models on it, beside software alone."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ukf_sw.problems.placing import core_models
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE
from ukf_sw.spec.parameters import Noise, Pipeline
from ukf_tools.baseline.figures import CORE_MHZ, WORD_CLOCKS, as_range
from ukf_tools.estimate.latency import latency
from ukf_tools.estimate.traffic import traffic_of

__all__ = ["PES", "markdown", "measure"]

PES = (1, 2, 5, 10, 11, 22)
#: Of each noise the problem, its core, and the software that is fastest.
_CORES = {
    Noise.AUGMENTED: ("nanosat", NANOSAT, "fast"),
    Noise.ADDITIVE: ("nanosat-additive", NANOSAT_ADDITIVE, "fast-additive"),
}


def measure(software: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Put the core with models on it beside the software.

    Parameters
    ----------
    software
        Records of the variants, by name, as :func:`ukf_tools.baseline.report.measure` has them.

    Returns
    -------
    dict
        Rows by noise; times in us, those of software as a bracket [at least, at most].
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for noise, (name, plain, variant) in _CORES.items():
        models = core_models(name, "core", plain.format)
        alone = software[variant]["us"]
        rows: list[dict[str, Any]] = []
        for pes in PES:
            params = replace(plain, pes=pes, models=models)
            cycles = latency(params, Pipeline(), redraws=False)["total"]
            traffic = traffic_of(params, redraws=False)
            hardware = cycles / CORE_MHZ
            bus = (traffic.words + traffic.register_words) * WORD_CLOCKS / CORE_MHZ
            rows.append({
                "pes": pes, "cycles": cycles, "hardware_us": hardware, "words": traffic.words,
                "register_words": traffic.register_words, "bus_us": bus,
                "iteration_us": hardware + bus, "software_us": alone["total"],
                "processor_us": bus,
                "speedup": [bound / (hardware + bus) for bound in alone["total"]],
            })  # fmt: skip
        found[noise.value] = rows
    return found


def markdown(record: Mapping[str, list[dict[str, Any]]]) -> str:
    """Table of :func:`measure`."""
    headings = (
        "noise", "PEs", "cycles", "hardware", "bus", "**iteration**", "fast software alone",
        "speed-up", "processor busy",
    )  # fmt: skip
    lines = [f"| {' | '.join(headings)} |", f"|---|{'---:|' * (len(headings) - 1)}"]
    for noise, rows in record.items():
        for row in rows:
            cells = (
                noise, row["pes"], row["cycles"], f"{row['hardware_us']:.1f}",
                f"{row['bus_us']:.1f}", f"**{row['iteration_us']:.1f}**",
                as_range(row["software_us"], 1), as_range(row["speedup"], 2),
                f"{row['processor_us']:.1f}",
            )  # fmt: skip
            lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"
