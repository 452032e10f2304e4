"""Study of SwampSat: QUEST, EKF and UKF at every sampling interval, and the link's delay.

The equivalents of figures 5, 6 and 7 of Asundi, Latchman and Fitz-Coy, a table of errors, and the
study that the paper asks for, attitude error against the delay between the two computers.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ukf_sw.backends import Backend
from ukf_sw.problems.catalogue import CATALOGUE, SWAMPSAT_STUDY
from ukf_sw.problems.judging import Verdict
from ukf_sw.problems.systems.swampsat.flight import SETTINGS, Flight, SwampsatSettings, simulate
from ukf_sw.problems.systems.swampsat.link import LinkSettings
from ukf_sw.problems.systems.swampsat.platform import PlatformSettings, run_platform
from ukf_sw.problems.systems.swampsat.sampling import Sampling
from ukf_sw.problems.systems.swampsat.study import (
    CASES,
    Case,
    Errors,
    case_of,
    make_ekf,
    run_ekf,
    run_quest,
    run_ukf,
)
from ukf_tools.evaluate.evaluation import Evaluation
from ukf_tools.evaluate.figures import make_figure, save
from ukf_tools.evaluate.workers import check_workers, mapper

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "DELAYS",
    "DIVERGED",
    "LOSSES",
    "compare",
    "evaluate_study",
    "plot_study",
    "run_eclipse",
    "run_platform_study",
    "run_study",
    "table",
]

#: A filter with a larger rms error than this, in degrees, or that broke off, counts as diverged.
DIVERGED = 10.0
#: Delays of the reply, s, and probabilities of losing a message, for the platform.
DELAYS = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0)
LOSSES = (0.0, 0.1, 0.3, 0.5)
#: The platform's requests, s; and its jitter, as a part of the delay.
REQUESTS = 2.0
JITTER = 0.2
#: One orbit, s, for the eclipse.
ORBIT = 5700.0

NAMES = {
    "quest_sample": "QUEST at sample",
    "quest_held": "QUEST held",
    "ekf": "EKF",
    "ukf_reference": "UKF float64",
    "ukf_golden": "UKF golden",
}

Progress = Callable[[int, int], None]


def _label(column: str) -> str:
    return NAMES.get(column, column.replace("ukf_", "UKF "))


def _number(value: float) -> float | None:
    """A number that JSON can hold, with six digits."""
    return float(f"{value:.6g}") if isfinite(value) else None


def _summary(values: Sequence[float]) -> dict[str, Any]:
    """Median over the seeds, infinite errors included, and how many diverged."""
    with np.errstate(invalid="ignore"):
        median = float(np.median(values))
    return {
        "median": _number(median),
        "seeds": [_number(value) for value in values],
        "diverged": sum(not value <= DIVERGED for value in values),
    }


def _curve(errors: Errors, every: int) -> dict[str, Any]:
    """Some of an error's samples."""
    return {
        "times": [round(float(t), 3) for t in errors.times[::every]],
        "attitude": [_number(float(e)) for e in errors.attitude[::every]],
    }


def _run_case(
    task: tuple[Case, int], *, backends: tuple[Backend | str, ...], after: float, curves_of: int
) -> dict[str, Any]:
    """Run all estimators on one flight."""
    case, seed = task
    flight = simulate(seed, case.settings)
    at_sample, held = run_quest(flight, case.sampling)
    filters = {"ekf": run_ekf(flight, case.sampling)}
    for backend in backends:
        name = backend if isinstance(backend, str) else "core"
        filters[f"ukf_{name}"] = run_ukf(flight, case.sampling, backend)
    # QUEST has no memory, so nothing settles.
    rms = {"quest_sample": at_sample.rms(), "quest_held": held.rms()}
    rms |= {name: errors.rms(after) for name, errors in filters.items()}
    result: dict[str, Any] = {"rms": rms}
    if seed == curves_of:
        # Odd, so as not to fall on the vector sensors' samples only.
        every = flight.steps // 1600 | 1
        result["curves"] = {
            "quest_sample": _curve(at_sample, max(1, len(at_sample.times) // 1500)),
            "quest_held": _curve(held, every),
        }
        for name, errors in filters.items():
            result["curves"][name] = _curve(errors, every) | {
                "bias": [[_number(float(b)) for b in row] for row in errors.bias[::every]]
            }
    return result


def _check(seeds: Sequence[int], workers: int) -> tuple[int, ...]:
    if not seeds:
        raise ValueError(f"seeds must not be empty, not {seeds!r}")
    check_workers(workers)
    return tuple(seeds)


def _seeds_of(case: Case, seeds: tuple[int, ...]) -> tuple[int, ...]:
    """Seeds of a case: those that are asked for, and those after them that it takes beside."""
    first = max(seeds) + 1
    return (*seeds, *range(first, first + (case.repeats - 1) * len(seeds)))


def run_study(
    intervals: Sequence[float | str] | None = None,
    seeds: Sequence[int] = range(5),
    duration: float = SETTINGS.duration,
    backend: Backend | str = "golden",
    progress: Progress | None = None,
    *,
    workers: int = 1,
    delays: Sequence[float] = DELAYS,
    losses: Sequence[float] = LOSSES,
    eclipse: bool = True,
) -> dict[str, Any]:
    """Run the study.

    With the defaults it takes about 15 minutes of one processor.

    Parameters
    ----------
    intervals
        Sampling intervals, s, or names of
        :data:`ukf_sw.problems.systems.swampsat.study.CASES`; None is all of these.
    seeds
        Seeds of the flights; a case may take more: see its ``repeats``.
    duration
        Length of the flights, s; errors are taken over its second half.
    backend
        What computes the UKF beside the float64 reference: see
        :class:`ukf_sw.filter.UnscentedKalmanFilter`. "reference" is the reference only.
    progress
        Called with the flights done and their total.
    workers
        Processes; more than one needs a backend that is a name.
    delays, losses
        As for :func:`run_platform_study`; none leaves it out. It uses the first three seeds.
    eclipse
        Whether to add :func:`run_eclipse`, with the first three seeds.

    Returns
    -------
    dict
        Plain data, ready for JSON: "rows" (one for each case, with the rms errors in degrees of
        each estimator: median, each seed, how many diverged; None where a filter broke off),
        "curves" (errors over time of the first seed), "platform", "eclipse", and the settings.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    chosen = _check(seeds, workers)
    if workers > 1 and not isinstance(backend, str):
        raise ValueError(f"backend must be a name with more than one worker, not {backend!r}")
    cases = CASES if intervals is None else tuple(case_of(interval) for interval in intervals)
    cases = tuple(
        replace(case, settings=replace(case.settings, duration=duration)) for case in cases
    )
    for case in cases:
        case.sampling.slots(case.settings.dt)
    after = duration / 2.0
    backends = ("reference",) if backend == "reference" else ("reference", backend)
    seeds_of = [_seeds_of(case, chosen) for case in cases]
    tasks = [(case, seed) for case, own in zip(cases, seeds_of, strict=True) for seed in own]
    extra = chosen[:3]
    platform_runs = 2 * (len(delays) + len(losses)) * len(extra)
    total = len(tasks) + platform_runs + (2 * len(extra) if eclipse else 0)
    done = 0

    def step(*_: int) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    found: list[dict[str, Any]] = []
    with mapper(workers) as spread:
        run = partial(_run_case, backends=backends, after=after, curves_of=chosen[0])
        for result in spread(run, tasks):
            found.append(result)
            step()
    results: dict[str, Any] = {
        "application": "swampsat",
        "unit": "degrees",
        "duration_s": duration,
        "settled_after_s": after,
        "seeds": list(chosen),
        "columns": list(found[0]["rms"]) if found else [],
        "rows": [],
        "curves": {},
    }
    done_cases = iter(found)
    for case, own in zip(cases, seeds_of, strict=True):
        group = list(islice(done_cases, len(own)))
        row: dict[str, Any] = {"name": case.name, "interval_s": case.sampling.interval}
        row |= {column: _summary([g["rms"][column] for g in group]) for column in group[0]["rms"]}
        results["rows"].append(row)
        results["curves"][case.name] = group[0]["curves"]
    if platform_runs:
        results["platform"] = run_platform_study(
            extra, duration, delays=delays, losses=losses, progress=step, workers=workers
        )
    if eclipse:
        results["eclipse"] = run_eclipse(extra, progress=step, workers=workers)
    return results


def _run_link(
    task: tuple[float, float, bool, int], *, settings: SwampsatSettings, after: float
) -> dict[str, Any]:
    """Run the platform once."""
    delay, loss, compensate, seed = task
    flight: Flight = simulate(seed, settings)
    link = PlatformSettings(
        interval=REQUESTS,
        request=LinkSettings(latency=delay, jitter=JITTER * delay, loss=loss),
        reply=LinkSettings(latency=delay, jitter=JITTER * delay, loss=loss),
        compensate=compensate,
    )
    found = run_platform(flight, make_ekf(flight), link, seed=seed)
    return {
        "rms": found.rms(after),
        "age": float(found.ages.mean()) if len(found.ages) else None,
        "used": len(found.ages) / max(found.requests, 1),
    }


def run_platform_study(
    seeds: Sequence[int] = range(3),
    duration: float = SETTINGS.duration,
    *,
    delays: Sequence[float] = DELAYS,
    losses: Sequence[float] = LOSSES,
    progress: Progress | None = None,
    workers: int = 1,
) -> dict[str, Any]:
    """Find the attitude error of the EKF against the link's delay and loss.

    The estimator requests every two seconds. Each direction of the link has the delay, and a jitter
    of a fifth of it. "naive" takes a reply as sampled when it arrives, "compensated" turns it to
    the present by the gyroscope.

    Parameters
    ----------
    seeds
        Seeds of the flights.
    duration
        Length of the flights, s; errors are taken over its second half.
    delays
        Latencies of each direction, s, without loss.
    losses
        Probabilities that a message is lost, with a latency of 0.1 s.
    progress
        Called with the flights done and their total.
    workers
        Processes.

    Returns
    -------
    dict
        Plain data: "delays" and "losses", each a list of points with the rms errors in degrees, the
        mean age of the replies in seconds, and the part of the requests whose reply was used.
    """
    chosen = _check(seeds, workers)
    settings = replace(SETTINGS, duration=duration)
    points = [(delay, 0.0) for delay in delays] + [(0.1, loss) for loss in losses]
    tasks = [(*point, flag, seed) for point in points for flag in (False, True) for seed in chosen]
    found: list[dict[str, Any]] = []
    with mapper(workers) as spread:
        run = partial(_run_link, settings=settings, after=duration / 2.0)
        for result in spread(run, tasks):
            found.append(result)
            if progress is not None:
                progress(len(found), len(tasks))
    count, listed = len(chosen), []
    for k, (delay, loss) in enumerate(points):
        naive = found[2 * k * count : (2 * k + 1) * count]
        compensated = found[(2 * k + 1) * count : (2 * k + 2) * count]
        ages = [n["age"] for n in naive if n["age"] is not None]
        listed.append(
            {
                "latency_s": delay,
                "loss": loss,
                "age_s": float(np.mean(ages)) if ages else None,
                "used": float(np.mean([n["used"] for n in naive])),
                "naive": _summary([n["rms"] for n in naive]),
                "compensated": _summary([c["rms"] for c in compensated]),
            }
        )
    return {
        "interval_s": REQUESTS,
        "seeds": list(chosen),
        "delays": listed[: len(delays)],
        "losses": listed[len(delays) :],
    }


def _run_eclipse(task: tuple[bool, int]) -> dict[str, float]:
    """Run EKF and float64 UKF over an orbit."""
    dark, seed = task
    flight = simulate(seed, replace(SETTINGS, duration=ORBIT, eclipse=dark))
    sampling = Sampling(interval=REQUESTS)
    after = SETTINGS.duration / 2.0
    return {
        "ekf": run_ekf(flight, sampling).rms(after),
        "ukf_reference": run_ukf(flight, sampling).rms(after),
    }


def run_eclipse(
    seeds: Sequence[int] = range(3), *, progress: Progress | None = None, workers: int = 1
) -> dict[str, Any]:
    """Find what the Earth's shadow costs over one orbit, sampled every two seconds.

    Parameters
    ----------
    seeds
        Seeds of the flights.
    progress
        Called with the flights done and their total.
    workers
        Processes.

    Returns
    -------
    dict
        Plain data: rms errors in degrees after 25 minutes, "sunlit" throughout and with "eclipse".
    """
    chosen = _check(seeds, workers)
    tasks = [(dark, seed) for dark in (False, True) for seed in chosen]
    found: list[dict[str, float]] = []
    with mapper(workers) as spread:
        for result in spread(_run_eclipse, tasks):
            found.append(result)
            if progress is not None:
                progress(len(found), len(tasks))
    halves = {"sunlit": found[: len(chosen)], "eclipse": found[len(chosen) :]}
    return {
        name: {column: _summary([f[column] for f in half]) for column in half[0]}
        for name, half in halves.items()
    } | {"duration_s": ORBIT, "interval_s": REQUESTS, "seeds": list(chosen)}


def compare(results: dict[str, Any]) -> tuple[Verdict, ...]:
    """Compare a study with what is known.

    Parameters
    ----------
    results
        What :func:`run_study` returned, or the same from a JSON file.

    Returns
    -------
    tuple of Verdict
        For each bound of :data:`ukf_sw.problems.catalogue.SWAMPSAT_STUDY` about a case of the
        study; the error names case and estimator.
    """
    found = {row["name"]: row for row in results["rows"]}
    for point in results.get("platform", {}).get("delays", ()):
        found[f"latency {point['latency_s']:g} s"] = point
    verdicts: list[Verdict] = []
    for (case, column), bound in SWAMPSAT_STUDY.items():
        if column in found.get(case, {}):
            value = found[case][column][bound.measure]
            verdicts.append(
                Verdict(
                    bound=replace(bound, error=f"{case}, {_label(column)}"),
                    value=float("inf") if value is None else float(value),
                    unit="" if bound.measure == "diverged" else results["unit"],
                )
            )
    return tuple(verdicts)


def evaluate_study(results: dict[str, Any]) -> Evaluation:
    """Evaluate a study as an entry of the catalogue is.

    Parameters
    ----------
    results
        What :func:`run_study` returned, or the same from a JSON file. Only a study of whole flights
        with at least five seeds is compared with its bounds.
    """
    whole = results["duration_s"] == SETTINGS.duration and len(results["seeds"]) >= 5
    entry = CATALOGUE["swampsat"]
    return Evaluation(
        name="swampsat study", doc=entry.doc, source=entry.source, backend="golden",
        seed=results["seeds"][0], runs=len(results["seeds"]),
        steps=round(results["duration_s"] / SETTINGS.dt), settled=results["settled_after_s"],
        verdicts=compare(results) if whole else None,
    )  # fmt: skip


def table(results: dict[str, Any]) -> list[list[str]]:
    """Lay out the study's table.

    Parameters
    ----------
    results
        What :func:`run_study` returned.

    Returns
    -------
    list of rows of cells
        Headings first; medians of the rms errors in degrees, and how many flights diverged.
    """
    columns = results["columns"]
    rows = [["interval", *(_label(column) for column in columns)]]
    for row in results["rows"]:
        cells = [row["name"]]
        for column in columns:
            found = row[column]
            cell = "broke off" if found["median"] is None else f"{found['median']:.3g}"
            if not column.startswith("quest") and found["diverged"]:
                cell += f" ({found['diverged']} of {len(found['seeds'])} diverged)"
            cells.append(cell)
        rows.append(cells)
    return rows


# Figures.

#: Colour, marker, line and its width; where curves coincide, the thin ones lie on the thick ones.
STYLES = {
    "quest_held": ("0.75", "", "-", 0.7),
    "quest_sample": ("C0", ".", "", 0.0),
    "ekf": ("C0", "", "-", 2.0),
    "ukf_reference": ("C1", "", "-", 1.2),
}


def _style(column: str) -> dict[str, Any]:
    color, marker, line, width = STYLES.get(column, ("k", "", "--", 0.6))
    return {
        "color": color, "marker": marker, "linestyle": line, "linewidth": width,
        "label": _label(column), "zorder": 2.0 + (column == "quest_sample"),
    }  # fmt: skip


def _panels(
    results: dict[str, Any],
    draw: Callable[["Axes", dict[str, Any]], None],
    unit: str,
    logarithmic: bool,
) -> "Figure":
    """Draw one panel for each case."""
    curves = results["curves"]
    count = len(curves)
    columns = min(3, count)
    rows = -(-count // columns)
    figure, axes = make_figure((4.0 * columns, 2.4 * rows + 0.8), rows, columns, share_x=True)
    for k, (name, found) in enumerate(curves.items()):
        draw(axes[k], found)
        axes[k].set_title(name, fontsize=9)
        if logarithmic:
            axes[k].set_yscale("log")
        if k % columns == 0:
            axes[k].set_ylabel(unit)
        if k >= count - columns:
            axes[k].set_xlabel("time / minutes")
            axes[k].xaxis.set_tick_params(labelbottom=True)
    for spare in axes[count:]:
        spare.set_visible(False)
    axes[0].legend(fontsize=7)
    return figure


def _floats(values: Sequence[float | None]) -> "np.ndarray[Any, np.dtype[np.float64]]":
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _draw_attitude(axes: "Axes", found: dict[str, Any], *, filters: bool) -> None:
    for column, curve in found.items():
        if column.startswith("quest") == filters:
            continue
        minutes = np.array(curve["times"]) / 60.0
        style: dict[str, Any] = _style(column) | {"markersize": 2.5}
        axes.plot(minutes, np.maximum(_floats(curve["attitude"]), 1e-3), **style)


def _draw_bias(axes: "Axes", found: dict[str, Any]) -> None:
    for column, curve in found.items():
        if column.startswith("quest"):
            continue
        minutes, style = np.array(curve["times"]) / 60.0, _style(column)
        bias = np.array([_floats(row) for row in curve["bias"]])
        for axis in range(3):
            if axis == 1:
                del style["label"]  # once is enough
            axes.plot(minutes, bias[:, axis], **style)
    axes.set_ylim(-0.3, 0.3)


def _plot_rms(results: dict[str, Any], file: Path) -> Path:
    """Errors against the interval."""
    figure, (axes,) = make_figure((7.0, 5.0), 1)
    # Not the special cases, whose names are other than their intervals.
    rows = [row for row in results["rows"] if row["name"] == f"{row['interval_s']:g} s"]
    intervals = [row["interval_s"] for row in rows]
    for column in results["columns"]:
        medians = _floats([row[column]["median"] for row in rows])
        style = _style(column) | {"marker": "o", "markersize": 4.0}
        style |= {"linestyle": style["linestyle"] or "-.", "linewidth": style["linewidth"] or 1.0}
        axes.plot(intervals, medians, **style)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(intervals, [f"{interval:g}" for interval in intervals], minor=False)
    axes.minorticks_off()
    axes.set_xlabel("interval between samples of Sun and field / s")
    axes.set_ylabel("rms attitude error / degrees")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    caption = (
        f"Attitude error against the sampling interval: median over {len(results['seeds'])} flights"
        f" of the rms after {results['settled_after_s'] / 60:g} minutes (QUEST: over the whole "
        "flight). The gyroscope is sampled at 10 Hz."
    )
    return save(figure, file, caption)


def _plot_platform(platform: dict[str, Any], file: Path) -> Path:
    """Errors against delay and loss."""
    figure, axes = make_figure((9.0, 4.4), 1, 2)
    for panel, points, key, label in (
        (axes[0], platform["delays"], "age_s", "mean age of a reply / s"),
        (axes[1], platform["losses"], "loss", "probability of losing a message"),
    ):
        for name, style in (("naive", "o-"), ("compensated", "s--")):
            medians = _floats([point[name]["median"] for point in points])
            panel.plot(_floats([point[key] for point in points]), medians, style, label=name)
        panel.set_xlabel(label)
        panel.set_ylabel("rms attitude error / degrees")
        panel.set_ylim(bottom=0.0)
        panel.legend(fontsize=8)
    caption = (
        "Distributed platform: error of the EKF against the delay (left) and the loss of messages "
        f"(right, latency 0.1 s each way), requests every {platform['interval_s']:g} s. "
        f"Median over {len(platform['seeds'])} flights. A naive estimator takes a reply as sampled "
        "when it arrives; a compensated one turns it to the present by the gyroscope."
    )
    return save(figure, file, caption)


def plot_study(results: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the figures of a study.

    Parameters
    ----------
    results
        What :func:`run_study` returned, or the same from a JSON file.
    folder
        Where to; it is made if absent.

    Returns
    -------
    list of Path
        Images: QUEST over time (the paper's figure 5), filters over time (figure 6), errors of the
        estimated bias (figure 7), errors against the interval, and the platform if it was run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    seed = results["seeds"][0]
    files: list[Path] = []
    interval = "by the interval between samples of Sun and field"
    for name, draw, unit, logarithmic, caption in (
        ("quest", partial(_draw_attitude, filters=False), "error / degrees", False,
         f"Attitude error of QUEST {interval}: at each sample, and held until the next (figure 5)"),
        ("filters", partial(_draw_attitude, filters=True), "error / degrees", True,
         f"Attitude error of the filters {interval} (figure 6)"),
        ("bias", _draw_bias, "bias error / (degrees/s)", False,
         f"Error of the estimated gyroscope bias about three axes {interval} (figure 7)"),
    ):  # fmt: skip
        figure = _panels(results, draw, unit, logarithmic)
        files.append(save(figure, folder / f"swampsat-{name}.png", f"{caption}. Seed {seed}."))
    files.append(_plot_rms(results, folder / "swampsat-rms.png"))
    if "platform" in results:
        files.append(_plot_platform(results["platform"], folder / "swampsat-platform.png"))
    return files
