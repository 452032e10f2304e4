"""Speed of software alone beside the core with its bus and models."""

import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ukf_sw.engine.microcode import microcode
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE, nanosat
from ukf_sw.spec.parameters import Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program
from ukf_tools.baseline import whole
from ukf_tools.baseline.costs import TOOL, Cycles, cost
from ukf_tools.baseline.counting import COMPILER, DISASSEMBLER, SECTIONS, count
from ukf_tools.baseline.executable import ARM, VARIANTS, build, need
from ukf_tools.baseline.figures import CORE_MHZ, PROCESSOR_MHZ, WORD_CLOCKS, as_range
from ukf_tools.estimate.traffic import traffic_of

__all__ = ["PAPER", "markdown", "measure"]

PES = (1, 2, 5, 10)
#: Table 4 of the 2018 paper in us; its software has the sigma points in `predict`. Totals: table 1.
PAPER: dict[str, Any] = {
    "models": 52.0, "predict": 522.0, "update": 87.0, "total": 660.0,
    "core_total": {"1": 363.0, "2": 272.0, "5": 228.0, "10": 212.0},
}  # fmt: skip


def _software(steps: int, sysroot: Path | None) -> dict[str, dict[str, Cycles]]:
    with tempfile.TemporaryDirectory(prefix="ukf-baseline-") as name:
        folder = Path(name)
        program = build(ARM, folder, sysroot)
        return {
            variant: cost(
                count(program, variant, nanosat(0, steps=steps, noise=noise), folder), steps
            )
            for variant, noise in VARIANTS.items()
        }


def _bracket(cycles: Cycles) -> list[float]:
    """Microseconds of the processor."""
    return [cycles.throughput / PROCESSOR_MHZ, cycles.latency / PROCESSOR_MHZ]


def _sum(parts: dict[str, Cycles], sections: tuple[str, ...]) -> Cycles:
    first, *rest = (parts[section] for section in sections)
    for part in rest:
        first += part
    return first


def _core(params: UkfParams, models: list[float], software: dict[str, Any]) -> dict[str, Any]:
    """One row: the core, its bus and the models, and how much faster that is."""
    code = microcode(params, Pipeline())
    cycles = code.clocks(Program.PREDICT) + code.clocks(Program.UPDATE)
    traffic = traffic_of(params, redraws=False)
    words = traffic.words + traffic.register_words
    hardware, bus = cycles / CORE_MHZ, words * WORD_CLOCKS / CORE_MHZ
    total = [hardware + bus + bound for bound in models]
    speedup: dict[str, Any] = {}
    for name, record in software.items():
        low, high = record["us"]["total"]
        speedup[name] = {
            # The models are the same on both sides of a bracket, so bounds go with bounds.
            "iteration": sorted([low / total[0], high / total[1]]),
            "hardware_part": [bound / hardware for bound in record["us"]["without_models"]],
        }
    speedup["paper"] = {
        "iteration": [PAPER["total"] / total[1], PAPER["total"] / total[0]],
        "hardware_part": [(PAPER["predict"] + PAPER["update"]) / hardware] * 2,
    }
    return {
        "pes": params.pes, "cycles": cycles, "hardware_us": hardware,
        "words": traffic.words, "register_words": traffic.register_words, "bus_us": bus,
        "models_us": models, "total_us": total, "speedup_over": speedup,
    }  # fmt: skip


def measure(steps: int = 20, sysroot: Path | None = None) -> dict[str, Any]:
    """Count and cost all variants, and put the core beside them.

    Parameters
    ----------
    steps
        Iterations of the 2018 nanosatellite to count; counts hardly depend on the data.
    sysroot
        Where the GNU Scientific Library for ARM is; see
        :func:`ukf_tools.baseline.executable.build`.

    Returns
    -------
    dict
        Ready for JSON. Times in us, each a bracket [at least, at most].

    Raises
    ------
    BaselineError
        If a tool is missing or fails.
    """
    for tool in (ARM.compiler, ARM.emulator[0], COMPILER, DISASSEMBLER, TOOL):
        need(tool)
    software: dict[str, Any] = {}
    for variant, parts in _software(steps, sysroot).items():
        own = tuple(section for section in SECTIONS if section != "models")
        software[variant] = {
            "noise": VARIANTS[variant].value,
            "sections": {name: asdict(part) for name, part in parts.items()},
            "us": {
                **{name: _bracket(part) for name, part in parts.items()},
                "without_models": _bracket(_sum(parts, own)),
                "total": _bracket(_sum(parts, SECTIONS)),
            },
        }
    dense = software["gsl"]["us"]
    return {
        "scenario": "nanosat, 2018",
        "steps": steps,
        "processor_mhz": PROCESSOR_MHZ,
        "core_mhz": CORE_MHZ,
        "word_clocks": WORD_CLOCKS,
        "method": "instructions counted under qemu-arm -cpu cortex-a9; llvm-mca-14 -mcpu=cortex-a9;"
        " no cache misses, no mispredicted branches; not run on a Cortex-A9",
        "software": software,
        "paper": PAPER,
        "check_against_paper": {
            "models": dense["models"],
            "predict": [sum(pair) for pair in zip(dense["sig_gen"], dense["predict"], strict=True)],
            "update": dense["update"],
            "total": dense["total"],
        },
        "whole": whole.measure(software),
        "core": {
            noise.value: [
                _core(
                    replace(params, pes=pes),
                    software[variant]["us"]["models"],
                    {name: record for name, record in software.items()
                     if record["noise"] == noise.value or name == "gsl"},
                )
                for pes in PES
            ]
            for noise, params, variant in (
                (Noise.AUGMENTED, NANOSAT, "fast"),
                (Noise.ADDITIVE, NANOSAT_ADDITIVE, "fast-additive"),
            )
        },
    }  # fmt: skip


def markdown(record: dict[str, Any]) -> dict[str, str]:
    """Tables of the comparison by name: software, the core beside it, the core with models."""
    software = [
        "| us | instructions | sigma points | predict | update | models | **total** |",
        "|----|-------------:|-------------:|--------:|-------:|-------:|----------:|",
    ]
    for name, variant in record["software"].items():
        us = variant["us"]
        instructions = sum(part["instructions"] for part in variant["sections"].values())
        cells = [as_range(us[section], 1) for section in SECTIONS]
        software.append(
            f"| `{name}` | {instructions:.0f} | {' | '.join(cells)} | **{as_range(us['total'])}** |"
        )
    paper = record["paper"]
    software.append(
        f"| 2018 paper, measured | – | in predict | {paper['predict']:g} | {paper['update']:g} "
        f"| {paper['models']:g} | **{paper['total']:g}** |"
    )
    headings = (
        "noise", "PEs", "hardware", "bus", "models", "**iteration**", "over `gsl`", "over fast",
        "over the paper's", "hardware part: over `gsl`", "over fast",
    )  # fmt: skip
    core = [
        f"| {' | '.join(headings)} |",
        f"|---|{'---:|' * (len(headings) - 1)}",
    ]
    for noise, rows in record["core"].items():
        fast = "fast" if noise == Noise.AUGMENTED.value else "fast-additive"
        for row in rows:
            over = row["speedup_over"]
            core.append(
                f"| {noise} | {row['pes']} | {row['hardware_us']:.1f} | {row['bus_us']:.1f} "
                f"| {as_range(row['models_us'], 1)} | **{as_range(row['total_us'], 1)}** "
                f"| {as_range(over['gsl']['iteration'], 1)} "
                f"| {as_range(over[fast]['iteration'], 2)} "
                f"| {as_range(over['paper']['iteration'], 1)} "
                f"| {as_range(over['gsl']['hardware_part'], 1)} "
                f"| {as_range(over[fast]['hardware_part'], 2)} |"
            )
    return {
        "software": "\n".join(software) + "\n",
        "core": "\n".join(core) + "\n",
        "whole": whole.markdown(record["whole"]),
    }
