"""The page: one file that needs no network."""

import json
import re
from collections.abc import Sequence
from typing import Any

import jinja2
import vl_convert
from markupsafe import Markup

from ukf_tools.design_report.charts import VEGA_LITE, Chart
from ukf_tools.design_report.series import Row
from ukf_tools.design_report.tables import everything, tables

__all__ = ["render"]

#: Sections in their order; one without charts and tables is left out, but for accuracy.
_SECTIONS = (
    "Latency", "Resources", "Latency against area", "Accuracy", "The 2018 paper", "Devices",
    "Growth", "All figures",
)  # fmt: skip
_ALWAYS = ("Accuracy", "All figures")
#: What the page uses of the bundle of libraries.
_SCRIPT = "window.vegaEmbed = vegaEmbed;"


def _script(text: str) -> Markup:
    """Script that may stand in a page: no string of it ends its element."""
    return Markup(re.sub(r"</(?=script)", r"<\\/", text, flags=re.IGNORECASE))


def _json(value: Any) -> Markup:
    """Data that may stand in a page."""
    return Markup(json.dumps(value).replace("<", "\\u003c"))


def render(rows: Sequence[Row], charts: Sequence[Chart]) -> str:
    """Make the page of a sweep.

    Parameters
    ----------
    rows
        Rows of a sweep.
    charts
        Their charts, from :func:`ukf_tools.design_report.charts.draw`.

    Returns
    -------
    str
        HTML with charts, scripts and styles.

    Raises
    ------
    ValueError
        If there is no row.
    """
    if not rows:
        raise ValueError(f"rows must have at least one core, not {rows!r}")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ukf_tools.design_report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["anchor"] = lambda name: name.lower().replace(" ", "-")
    found = tables(rows)
    present = {chart.section for chart in charts} | {table.section for table in found}
    return environment.get_template("page.html.j2").render(
        title="Design space of the UKF core",
        summary=_summary(rows),
        sections=[name for name in _SECTIONS if name in present or name in _ALWAYS],
        rows=rows,
        charts=charts,
        tables=found,
        everything=everything(rows),
        bundle=_script(vl_convert.javascript_bundle(_SCRIPT, vl_version=VEGA_LITE)),
        specs=_json({chart.name: chart.spec for chart in charts}),
    )


def _summary(rows: Sequence[Row]) -> str:
    """Say what is in the sweep, and what is measured and what estimated."""
    failed = sum(row["error"] is not None for row in rows)
    names = sorted({row["problem"] for row in rows if row["problem"]})
    text = f"Configurations: {', '.join(names)}. " if names else ""
    if failed:
        text += f"{failed} of them failed; their rows below say why. "
    return text + (
        "Cycles are exact: they come from the schedule. Resources are estimates of Yosys before "
        "packing. Times assume the clock and the bus that the table names. Nothing was placed or "
        "routed for this family, and nothing ran on a board."
    )
