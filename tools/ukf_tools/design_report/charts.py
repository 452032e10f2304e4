"""Charts of a sweep, as Vega-Lite."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import altair as alt
import vl_convert

from ukf_sw.spec.core import PARAMETERS
from ukf_tools.design_report import paper_2018
from ukf_tools.design_report.series import Row, comparable, in_series
from ukf_tools.estimate.recommendation import RULE, recommended

__all__ = ["VEGA_LITE", "Chart", "draw", "pareto", "save"]

#: Version of Vega-Lite that draws, in the page as in images.
VEGA_LITE = "6.4"
#: Name of the paper's series.
PAPER = "2018 paper"
#: Name of the chart of cores that are no series.
CORES = "single cores"
#: Width of images, and height of most charts, in pixels.
WIDTH, HEIGHT = 560, 340

#: Colours that also differ for people who do not see some; the paper's is grey.
_COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8c6d1f",
)  # fmt: skip
_PAPER_COLOUR = "#777777"
_STEPS = {"SIG_GEN": "#e69f00", "PREDICT": "#56b4e9", "UPDATE": "#0072b2"}
_RESOURCES = {
    "lut": ("LUT", "LUT", "lut"),
    "ff": ("flip-flops", "FF", "ff"),
    "dsp48e1": ("DSP slices", "DSP48E1", "dsp"),
    "bram36": ("block memories", "BRAM36", "bram36"),
}


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A chart.

    Parameters
    ----------
    name
        Name for files and for the page.
    section
        Heading under which it stands.
    title, caption
        What it shows, and what it does not say by itself.
    spec
        Vega-Lite.
    """

    name: str
    section: str
    title: str
    caption: str
    spec: dict[str, Any]


def draw(rows: Sequence[Row]) -> list[Chart]:
    """Draw what the rows of a sweep allow.

    Parameters
    ----------
    rows
        Rows of a sweep.
    """
    return [
        *_latency(rows), *_resources(rows), *_front(rows), *_accuracy(rows), *_growth(rows),
    ]  # fmt: skip


def save(charts: Sequence[Chart], folder: Path) -> list[Path]:
    """Write charts as PNG images; gives the files.

    Raises
    ------
    OSError
        If the folder cannot be written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    for chart in charts:
        spec = chart.spec | {"width": WIDTH, "title": chart.title}
        file = folder / f"{chart.name}.png"
        file.write_bytes(vl_convert.vegalite_to_png(spec, vl_version=VEGA_LITE, scale=1.5))
        files.append(file)
    return files


def pareto(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Give the points that no other beats in one coordinate without losing in the other."""
    best: list[tuple[float, float]] = []
    for x, y in sorted(set(points)):
        if not best or y < best[-1][1]:
            best.append((x, y))
    return best


def _spec(chart: alt.Chart | alt.LayerChart, height: int = HEIGHT) -> dict[str, Any]:
    """Give a chart as Vega-Lite that fills the width of the page."""
    made = chart.properties(width="container", height=height).configure_axis(
        labelFontSize=12, titleFontSize=13, gridColor="#e4e4e4"
    )
    made = made.configure_legend(orient="bottom", labelFontSize=12, labelLimit=320, title=None)
    spec = made.configure_view(stroke=None).to_dict()
    # Sizes adapt to what the page gives.
    spec["autosize"] = {"type": "fit", "contains": "padding"}
    return spec


def _data(values: list[dict[str, Any]]) -> alt.Chart:
    return alt.Chart(alt.Data(values=values))


def _colours(labels: Sequence[str], *, paper: bool) -> alt.Color:
    """Colour of each series, and of the paper's."""
    colours = [_COLOURS[k % len(_COLOURS)] for k in range(len(labels))]
    names = list(labels)
    if paper:
        names.append(PAPER)
        colours.append(_PAPER_COLOUR)
    return alt.Color(
        "series:N",
        scale=alt.Scale(domain=names, range=colours),
        legend=alt.Legend(columns=1),  # long names do not fit side by side on a phone
    )


def _latency(rows: Sequence[Row]) -> Iterator[Chart]:
    """Time of each step over processing elements, a chart for each series and for the paper."""
    stacks: dict[str, list[dict[str, Any]]] = {}
    advice: dict[str, str] = {}
    lonely: list[dict[str, Any]] = []
    for label, group in in_series(rows).items():
        values = [
            {"core": str(row["pes"]), "step": step, "time": row[column] / row["clock_mhz"]}
            for row in group
            if row["cycles"] is not None
            for step, column in (("PREDICT", "predict_cycles"), ("UPDATE", "update_cycles"))
        ]
        if len({value["core"] for value in values}) == 1 and len(in_series(rows)) > 1:
            # Series of a single core, as over sizes, stand side by side.
            lonely += [value | {"core": label} for value in values]
            continue
        # Formats do not change cycles, for instance: one chart is enough.
        same = next((other for other, known in stacks.items() if known == values), None)
        if same is not None:
            stacks[f"{same}; {label}"] = stacks.pop(same)
            advice[f"{same}; {label}"] = advice.pop(same)
        elif values:
            stacks[label] = values
            advice[label] = _advice(group)
    if lonely:
        stacks[CORES] = lonely
    if not stacks:
        return
    if any(comparable(row) for row in rows):
        stacks[PAPER] = [
            {"core": str(pes), "step": step, "time": time}
            for pes, column in paper_2018.LATENCY.items()
            for step, time in (
                ("SIG_GEN", column.sig_gen), ("PREDICT", column.predict), ("UPDATE", column.update)
            )
            if time is not None
        ]  # fmt: skip
    clocks = sorted({f"{row['clock_mhz']:g}" for row in rows})
    highest = max(map(_highest, stacks.values()))
    for number, (label, values) in enumerate(stacks.items(), start=1):
        steps = [step for step in _STEPS if any(value["step"] == step for value in values)]
        chart = _data(values).mark_bar().encode(
            x=alt.X(
                "core:N", sort=None, title=None if label == CORES else "processing elements",
                axis=alt.Axis(labelAngle=-60 if label == CORES else 0, labelLimit=150),
            ),
            # One scale for all, ours and the paper's, so that bars can be compared between charts.
            y=alt.Y(
                "time:Q", title="time of an iteration / µs", stack="zero",
                scale=alt.Scale(domain=[0.0, highest], nice=True),
            ),
            color=alt.Color(
                "step:N",
                scale=alt.Scale(domain=steps, range=[_STEPS[step] for step in steps]),
            ),
            order=alt.Order("rank:Q"),
            tooltip=[
                alt.Tooltip("step:N"), alt.Tooltip("core:N"),
                alt.Tooltip("time:Q", title="µs", format=".2f"),
            ],
        ).transform_calculate(
            rank=f"indexof({list(_STEPS)}, datum.step)"
        )  # fmt: skip
        if label == PAPER:
            caption = (
                "Table 4 of the 2018 paper at 100 MHz, models apart. With 1 PE it counts SIG_GEN "
                "to PREDICT. The scale is that of ours."
            )
        else:
            caption = (
                f"Steps of the core at {', '.join(clocks)} MHz, from the schedule; bus and models "
                "apart. UPDATE makes the next sigma points, so there is no SIG_GEN."
                + advice.get(label, "")
            )
        yield Chart(
            name="latency-paper" if label == PAPER else f"latency-{number}",
            section="Latency",
            title=f"Latency by step: {label}",
            caption=caption,
            spec=_spec(chart),
        )


def _advice(rows: Sequence[Row]) -> str:
    """Say which numbers of processing elements of a series are recommended."""
    cycles = {row["pes"]: row["cycles"] for row in rows if row["cycles"] is not None}
    if len(cycles) == 1:
        return ""
    good = ", ".join(map(str, recommended(cycles)))
    return f" Recommended numbers of PEs, of these: {good}. {RULE}"


def _highest(values: Sequence[dict[str, Any]]) -> float:
    """Height of the highest of the stacked bars."""
    bars: dict[str, float] = {}
    for value in values:
        bars[value["core"]] = bars.get(value["core"], 0.0) + value["time"]
    return max(bars.values())


def _resources(rows: Sequence[Row]) -> Iterator[Chart]:
    """Each resource over processing elements, with the paper's."""
    groups = {
        label: [row for row in group if row["lut"] is not None]
        for label, group in in_series(rows).items()
    }
    groups = {label: group for label, group in groups.items() if group}
    if not groups:
        return
    paper = any(comparable(row) for row in rows)
    for name, (title, unit, column) in _RESOURCES.items():
        values = [
            {"series": label, "pes": row["pes"], "value": row[name]}
            for label, group in groups.items()
            for row in group
        ]
        if paper:
            values += [
                {"series": PAPER, "pes": pes, "value": getattr(used, column)}
                for pes, used in paper_2018.RESOURCES.items()
            ]
        chart = _data(values).mark_line(point=alt.OverlayMarkDef(size=50), strokeWidth=2).encode(
            x=alt.X("pes:Q", title="processing elements", axis=alt.Axis(tickMinStep=1)),
            y=alt.Y("value:Q", title=unit, scale=alt.Scale(type="log", nice=True)),
            color=_colours(list(groups), paper=paper),
            tooltip=[
                alt.Tooltip("series:N"), alt.Tooltip("pes:Q", title="PEs"),
                alt.Tooltip("value:Q", title=unit),
            ],
        )  # fmt: skip
        yield Chart(
            name=f"resources-{name}",
            section="Resources",
            title=f"{title[0].upper()}{title[1:]} over processing elements",
            caption=(
                "Ours: Yosys for 7-series, before packing. "
                + ("Paper: Vivado, after implementation. " if paper else "")
                + "Logarithmic."
            ),
            spec=_spec(chart),
        )


def _front(rows: Sequence[Row]) -> Iterator[Chart]:
    """Cycles over look-up tables: what an area buys."""
    series = {
        label: [row for row in group if row["lut"] is not None and row["cycles"] is not None]
        for label, group in in_series(rows).items()
    }
    series = {label: group for label, group in series.items() if group}
    if not series:
        return
    values = [
        {"series": label, "lut": row["lut"], "cycles": row["cycles"], "pes": row["pes"]}
        for label, group in series.items()
        for row in group
    ]
    ours = pareto([(value["lut"], value["cycles"]) for value in values])
    paper = any(comparable(row) for row in rows)
    if paper:
        values += [
            {"series": PAPER, "lut": paper_2018.RESOURCES[pes].lut, "cycles": column.cycles,
             "pes": pes}
            for pes, column in paper_2018.LATENCY.items()
        ]  # fmt: skip
    scale = alt.Scale(type="log", nice=False, padding=24)
    x = alt.X("lut:Q", title="LUT", scale=scale)
    y = alt.Y("cycles:Q", title="cycles of an iteration", scale=scale)
    points = _data(values).mark_point(filled=True, size=80, opacity=1).encode(
        x=x, y=y, color=_colours(list(series), paper=paper),
        tooltip=[
            alt.Tooltip("series:N"), alt.Tooltip("pes:Q", title="PEs"),
            alt.Tooltip("lut:Q", title="LUT"), alt.Tooltip("cycles:Q"),
        ],
    )  # fmt: skip
    # All points would have more numbers than there is room for.
    named = [
        value
        for value in values
        if value["series"] == PAPER or (value["lut"], value["cycles"]) in ours
    ]
    names = _data(named).mark_text(dx=9, dy=-8, fontSize=11).encode(x=x, y=y, text="pes:Q")
    front = (
        _data([{"lut": a, "cycles": b} for a, b in ours])
        .mark_line(strokeDash=[4, 4], color="#444444", strokeWidth=1)
        .encode(x=x, y=y)
    )
    yield Chart(
        name="front",
        section="Latency against area",
        title="Cycles of an iteration over look-up tables",
        caption=(
            "Each point is a core. Dashed: the front, what no other core of the sweep beats in "
            "both; numbers there are processing elements. Down and left is better. Both "
            "logarithmic."
        ),
        spec=_spec(alt.LayerChart(layer=[front, points, names]), height=440),
    )


def _accuracy(rows: Sequence[Row]) -> Iterator[Chart]:
    """Ratio of errors to the float64 reference by format."""
    applications = list(dict.fromkeys(row["application"] for row in rows if row["application"]))
    for application in applications:
        judged = [
            row for row in rows if row["application"] == application and row["steps"] is not None
        ]
        values: list[dict[str, Any]] = []
        stops: list[dict[str, Any]] = []
        for row in judged:
            entry = {"format": row["format"], "series": row["form"], "pes": row["pes"]}
            if row["rms_ratio"] is not None:
                values.append(entry | {"ratio": row["rms_ratio"]})
            elif row["stopped"] is not None:
                stops.append(entry | {"stopped": row["stopped"], "steps": row["steps"]})
        if not values and not stops:
            continue
        forms = list(dict.fromkeys(row["form"] for row in judged))
        formats = list(dict.fromkeys(row["format"] for row in judged))
        x = alt.X("format:N", title="number format", sort=formats, axis=alt.Axis(labelAngle=0))
        offset = alt.XOffset("series:N", sort=forms)
        colour = _colours(forms, paper=False)
        ratios = [value["ratio"] for value in values]
        scale = alt.Scale(
            type="log", domain=[min([0.9, *ratios]) / 1.05, max([1.1, *ratios]) * 1.5], nice=False
        )
        marks = _data(values).mark_point(filled=True, size=90, opacity=0.8).encode(
            x=x, xOffset=offset, color=colour,
            y=alt.Y("ratio:Q", title="rms error / that of float64", scale=scale),
            tooltip=[
                alt.Tooltip("series:N", title="form"), alt.Tooltip("pes:Q", title="PEs"),
                alt.Tooltip("ratio:Q", format=".4f"),
            ],
        )  # fmt: skip
        crosses = _data(stops).mark_point(shape="cross", angle=45, filled=True, size=110).encode(
            x=x, xOffset=offset, color=colour, y=alt.value(10),
            tooltip=[
                alt.Tooltip("series:N", title="form"), alt.Tooltip("pes:Q", title="PEs"),
                alt.Tooltip("stopped:N"), alt.Tooltip("steps:Q", title="after steps"),
            ],
        )  # fmt: skip
        layers = [layer for layer, shown in ((marks, values), (crosses, stops)) if shown]
        yield Chart(
            name=f"accuracy-{_slug(application)}",
            section="Accuracy",
            title=f"Accuracy by format: {application}",
            caption=(
                f"Golden model, {max(row['steps'] for row in judged)} steps; a point for each "
                "number of processing elements. 1 is as good as float64. A cross at the top is a "
                "run that the core stopped with an error, because of the covariance for instance."
            ),
            spec=_spec(alt.LayerChart(layer=layers)),
        )


def _growth(rows: Sequence[Row]) -> Iterator[Chart]:
    """Cycles over the number of states."""
    values = [
        {"series": ", ".join(PARAMETERS[name].said(row[name]) for name in ("pes", "form")),
         "n": row["n"], "cycles": row["cycles"]}
        for row in rows
        if row["cycles"] is not None
    ]  # fmt: skip
    if len({value["n"] for value in values}) < 3:
        return
    labels = list(dict.fromkeys(value["series"] for value in values))
    chart = _data(values).mark_line(point=alt.OverlayMarkDef(size=40)).encode(
        x=alt.X("n:Q", title="states, n", scale=alt.Scale(type="log", nice=False)),
        y=alt.Y("cycles:Q", title="cycles of an iteration", scale=alt.Scale(type="log")),
        color=_colours(labels, paper=False),
        tooltip=[alt.Tooltip("series:N"), alt.Tooltip("n:Q"), alt.Tooltip("cycles:Q")],
    )  # fmt: skip
    yield Chart(
        name="growth-states",
        section="Growth",
        title="Cycles of an iteration over states",
        caption="Both logarithmic: a power law is a straight line.",
        spec=_spec(chart),
    )


def _slug(label: str) -> str:
    """Name for a file."""
    return "".join(c if c.isalnum() else "-" for c in label.lower()).strip("-")
