"""Scenarios for a C application, and its results: files that both sides know.

The layout is that of sw/c/apps/scenario_file.c.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ukf_sw.extras import importing
from ukf_sw.problem import Problem
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.tracing.inputs import InputVector

__all__ = ["CResults", "export_scenario", "read_results"]

MAGIC = 0x53464B55  # "UKFS"
VERSION = 2
#: Most numbers of an input: those that a program without allocation has place for.
MAX_INPUTS = 32
BINARY = "scenario.bin"
HEADER = "scenario_data.h"

Array = NDArray[np.float64]


def _samples(problem: Problem) -> tuple[Array, NDArray[np.bool_]]:
    """Observations of all sensors, one beside the other, and which were sampled, (K, m) each."""
    observations, sampled = zip(
        *(problem.samples(name) for name in problem.sensor_names), strict=True
    )
    return np.hstack(observations), np.hstack(sampled)


@dataclass(frozen=True)
class _Scenario:
    """What both files hold.

    Parameters
    ----------
    problem, steps
        As of :func:`export_scenario`.
    tables
        Numbers by name, each of two dimensions.
    words
        Whole numbers by name.
    """

    problem: Problem
    steps: int
    tables: dict[str, Array]
    words: dict[str, NDArray[np.uint32]]


def _scenario(problem: Problem, steps: int, inputs: InputVector | None) -> _Scenario:
    data = problem.record
    if not 1 <= steps <= data.steps:
        raise ValueError(f"steps must be between 1 and {data.steps}, not {steps!r}")
    observations, sampled = _samples(problem)
    measurements = np.where(sampled, observations, 0.0)[:steps]
    on_core, variants = _on_core(problem, steps)
    tables = {
        "x0": problem.x0[np.newaxis],
        "P0": problem.P0,
        "Q": problem.Q,
        "R": problem.R,
        "input": _inputs(problem, steps, inputs),
        "measurement": measurements,
        "core_input": on_core,
    }
    words = {
        "sampled": _sampled(problem, steps),
        "terms": _terms(problem),
        "variant": variants.reshape(-1),
    }
    return _Scenario(problem, steps, tables, words)


def _on_core(problem: Problem, steps: int) -> tuple[Array, NDArray[np.uint32]]:
    """What models on the core are told: numbers of region U (K, u), variants of sensors (K, S).

    A number that is not needed in a step is as before, or 0.
    """
    own, data = problem.models, problem.record
    numbers = np.zeros((steps, len(own.inputs)))
    variants = np.zeros((steps, len(problem.sensor_names)), np.uint32)
    if not own:
        return numbers, variants
    # What traces models is imported by those who need it.
    with importing("golden"):
        from ukf_sw.lowering.placement import find_models

    placed = find_models(problem, own, problem.format)
    sampled = [np.any(problem.samples(name)[1], axis=1) for name in problem.sensor_names]
    for k in range(steps):
        numbers[k] = numbers[k - 1] if k else 0.0
        given: dict[int, float] = {}
        if placed.f:
            given |= placed.inputs_of_f(None if data.inputs is None else data.inputs[k], {})
        for sensor, name in enumerate(problem.sensor_names):
            if placed.h and sampled[sensor][k]:
                extra = data.observation_arguments
                variants[k, sensor], inputs = placed.inputs_of_h(
                    name, {} if extra is None else extra[k]
                )
                given |= inputs
        numbers[k, [*given]] = [*given.values()]
    return numbers, variants


def _inputs(problem: Problem, steps: int, inputs: InputVector | None) -> Array:
    """Give what models in software take beside sigma points, shape (K, u)."""
    if problem.models.f is not None and problem.models.h:
        return np.zeros((steps, 0))
    inputs = InputVector.of(problem) if inputs is None else inputs
    if len(inputs) > MAX_INPUTS:
        raise ValueError(
            f"scenario must have at most {MAX_INPUTS} numbers that the models take in a step, not "
            f"the {len(inputs)} of {problem.name!r}"
        )
    return inputs.table(problem, steps)


def _sampled(problem: Problem, steps: int) -> NDArray[np.uint32]:
    """Masks of the samples, a word each."""
    _, sampled = _samples(problem)
    bits = 1 << np.arange(problem.params.m, dtype=np.uint64)
    return (sampled[:steps] @ bits).astype(np.uint32)


def _terms(problem: Problem) -> NDArray[np.uint32]:
    """Noise terms of each sensor."""
    sensors = range(len(problem.sensor_names))
    return np.array([len(problem.terms_of(sensor)) for sensor in sensors], dtype=np.uint32)


def _interval(times: Array) -> float:
    """Interval of steps at equal ones, NaN of others; of a single step its time.

    Times are rounded, and so are their differences. Of the numbers that all of them allow this is
    one that people write, of few digits or as a rate: 0.05, or 1/30.
    """
    if len(times) == 1:
        return float(times[0])
    rounding = 2.0 * np.spacing(np.abs(times).max())
    steps = np.diff(times)
    middle = float((times[-1] - times[0]) / len(steps))
    if (np.abs(steps - middle) > rounding).any():
        return np.nan
    written = [float(f"{middle:.{digits}g}") for digits in range(1, 10)]
    if middle < 1.0:
        written.append(1.0 / round(1.0 / middle))
    return next((each for each in written if abs(each - middle) <= rounding), middle)


def _binary(scenario: _Scenario) -> bytes:
    problem, tables, p = scenario.problem, scenario.tables, scenario.problem.params
    words = [
        MAGIC, VERSION, p.n, p.m, p.q, p.r, tables["input"].shape[1], scenario.steps,
        int(problem.redraws), len(p.sensor_rows), tables["core_input"].shape[1], 0,
    ]  # fmt: skip
    numbers = np.concatenate(
        [[_interval(problem.times)], *(table.reshape(-1) for table in tables.values())]
    )
    return b"".join((
        np.array(words, dtype="<u4").tobytes(),
        numbers.astype("<f8").tobytes(),
        *(table.astype("<u4").tobytes() for table in scenario.words.values()),
    ))  # fmt: skip


def _header(scenario: _Scenario) -> str:
    problem, tables, p = scenario.problem, scenario.tables, scenario.problem.params
    interval = _interval(problem.times)
    lines = [
        f"/* Scenario {problem.name}, {scenario.steps} steps. Generated, do not edit. */",
        "#ifndef UKF_SCENARIO_DATA_H",
        "#define UKF_SCENARIO_DATA_H",
        "",
        "#include <math.h>",
        "",
        '#include "scenario.h"',
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        "/* Hexadecimal constants have every bit of the numbers. */",
    ]
    for name, table in tables.items():
        lines.append(f"static const double ukf_scenario_{name}[] = {{")
        # An array must not be empty.
        rows = table if table.size else np.zeros((1, 1))
        lines += ["    " + " ".join(f"{value.hex()}," for value in row) for row in rows.tolist()]
        lines.append("};")
    for name, numbers in scenario.words.items():
        lines.append(f"static const uint32_t ukf_scenario_{name}[] = {{")
        lines += [
            "    " + " ".join(f"{word:#x}," for word in numbers[k : k + 8].tolist())
            for k in range(0, len(numbers), 8)
        ]
        lines.append("};")
    members = {
        **{name: f"{getattr(p, name)}u" for name in "nmqr"},
        "inputs": f"{tables['input'].shape[1]}u",
        "steps": f"{scenario.steps}u",
        "redraw": "true" if problem.redraws else "false",
        "interval": "NAN" if np.isnan(interval) else interval.hex(),
        **{name: f"ukf_scenario_{name}" for name in (*list(tables)[:-1], "sampled")},
        "sensors": f"{len(p.sensor_rows)}u",
        "core_inputs": f"{tables['core_input'].shape[1]}u",
        **{name: f"ukf_scenario_{name}" for name in ("core_input", "terms", "variant")},
    }
    lines += [
        "",
        "/* In the order of the struct: C++ before C++20 cannot name members. */",
        "static const struct ukf_scenario ukf_scenario_data = {",
        *(f"    {value}, /* {name} */" for name, value in members.items()),
        "};",
        "",
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def export_scenario(
    problem: Problem, steps: int, output: Path, inputs: InputVector | None = None
) -> list[Path]:
    """Write a scenario for C programs. Equal scenarios give equal files.

    Parameters
    ----------
    problem
        The problem with its data. Measurements and masks are of all its sensors, in the order of
        their rows. What models on its core take, arguments of h included, is there for each step.
        Which numbers are angles is known to the models in C, and to the core. The interval of the
        scenario is that of its steps, or NaN if they are not at equal ones; then the models need it
        as an input.
    steps
        How many of its steps.
    output
        Folder to write to; made if absent.
    inputs
        What the input of a step is; None is what the data have.

    Returns
    -------
    list of Path
        A file of data for programs that have files, and a C header for those that do not.

    Raises
    ------
    ValueError
        If there are not that many steps, or the models take what are no numbers, or too many.
    """
    scenario = _scenario(problem, steps, inputs)
    contents = {BINARY: _binary(scenario), HEADER: _header(scenario).encode()}
    output.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        (output / name).write_bytes(content)
    return [output / name for name in contents]


@dataclass(frozen=True, kw_only=True, eq=False)
class CResults:
    """What a C application wrote.

    Parameters
    ----------
    x
        Estimates, shape (K, n).
    nis
        Normalised innovation squared, of all sensors, shape (K,); NaN where nothing was sampled.
    results
        Return codes of the steps, shape (K,).
    gated
        Whether an update was rejected, shape (K,).
    P
        Covariance at the end, shape (n, n); None if the run did not come to its end.
    covariances
        Covariance after each step, shape (K, n, n); None if they were not asked for.
    """

    x: Array
    nis: Array
    results: NDArray[np.uint32]
    gated: NDArray[np.bool_]
    P: Array | None
    covariances: Array | None = None


def read_results(
    path: Path, params: UkfParams, steps: int, *, covariances: bool = False
) -> CResults:
    """Read the results of a C application.

    Parameters
    ----------
    path
        The file.
    params
        Sizes.
    steps
        Steps of the scenario.
    covariances
        Whether the application was told to write the covariance of each step.

    Raises
    ------
    ValueError
        If the file is neither that of a whole run nor that of one that ended early.
    """
    n = params.n
    kind = np.dtype([
        ("x", "<f8", (n,)), *([("P", "<f8", (n, n))] if covariances else []),
        ("nis", "<f8"), ("result", "<u4"), ("gated", "<u4"),
    ])  # fmt: skip
    data = path.read_bytes()
    whole = steps * kind.itemsize + 8 * n * n
    if len(data) != whole and (len(data) % kind.itemsize or len(data) > steps * kind.itemsize):
        raise ValueError(f"{path} must have {whole} bytes, or whole steps, not {len(data)}")
    done = steps if len(data) == whole else len(data) // kind.itemsize
    rows = np.frombuffer(data, dtype=kind, count=done)
    end = np.frombuffer(data, dtype="<f8", offset=done * kind.itemsize)
    return CResults(
        x=rows["x"], nis=rows["nis"], results=rows["result"], gated=rows["gated"] != 0,
        P=end.reshape(n, n) if end.size else None,
        covariances=rows["P"] if covariances else None,
    )  # fmt: skip
