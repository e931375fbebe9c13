"""Charts: specifications of Vega-Lite, made with Altair, which static/charts.js draws when they come into view.

Altair makes and checks each kind of chart once. A page has only the data and colours of its charts; static/charts.js
puts the two together.
"""

import html
import json
from collections.abc import Iterable
from typing import Any, Literal

import altair as alt
import numpy as np
import pandas as pd
import results_data
from docutils import nodes

POINTER: dict[str, Any] = {"opacity": 0, "size": 60}  # invisible points, so that the mouse finds a line
SHORT_STEPS = (
    "datum.value >= 1e6 ? format(datum.value / 1e6, '~g') + 'M' : "
    "datum.value >= 1e3 ? format(datum.value / 1e3, '~g') + 'k' : datum.value"
)


def figure(chart: dict, caption: str, described: str) -> str:
    """A chart in HTML: its kind and data. caption: HTML; described: what those hear who cannot see it."""
    text = json.dumps(chart, separators=(",", ":")).replace("</", "<\\/")
    return (
        f'<figure class="chart"><figcaption>{caption}</figcaption>'
        f'<div class="drawing" role="img" aria-label="{html.escape(described)}"></div>'
        f'<script type="application/json">{text}</script></figure>'
    )


def grid(figures: Iterable[str]) -> nodes.raw:
    """Charts side by side, as many as there is room for."""
    return nodes.raw("", f'<div class="charts">{"".join(figures)}</div>', format="html")


def rounded(value: float) -> float | None:
    """Four digits are enough for a picture."""
    return None if pd.isna(value) else float(f"{value:.4g}")


def specification(chart: alt.TopLevelMixin) -> dict:
    """What Altair makes of a chart, without what charts.js gives to every chart."""
    return {key: value for key, value in chart.to_dict().items() if key not in ("$schema", "config")}


def steps_axis() -> alt.X:
    """Timesteps, as 5M."""
    return alt.X("t:Q", title="timesteps", axis=alt.Axis(labelExpr=SHORT_STEPS, tickCount=5, grid=False))


def curves_chart(height: int, legend: Literal["right", "bottom"] | None) -> dict:
    """Learning curves with intervals, the paper's maximum returns as rules; data and colours are still missing.

    Data: "curves" with a label, t timestep, m mean, l and h the ends of the interval, n seeds; "paper" with a and
    p, the paper's maximum return. With a legend, a click on it leaves one algorithm visible; with shift it adds one.
    The first layer has the intervals; charts.js leaves it out where there are none.
    """
    chosen = alt.selection_point(fields=["a"], bind="legend", name="chosen", toggle="event.shiftKey")
    symbols: dict[str, Any] = {"symbolStrokeWidth": 3, "symbolType": "stroke", "symbolSize": 200, "symbolOpacity": 1}
    shown = alt.Legend(title=None, orient=legend, columns=5 if legend == "bottom" else 1, **symbols) if legend else None
    colours = alt.Color("a:N", legend=shown)

    def opacity(value: float) -> dict:
        return {"opacity": alt.when(chosen).then(alt.value(value)).otherwise(alt.value(value / 12))} if legend else {}

    base = alt.Chart(alt.NamedData(name="curves")).encode(x=steps_axis(), color=colours)
    scale = alt.Scale(zero=False)
    band = base.mark_area(opacity=0.16).encode(y=alt.Y("l:Q", title="return", scale=scale), y2="h:Q", **opacity(0.16))
    mean = alt.Y("m:Q", title="return", scale=scale)
    line = base.mark_line(strokeWidth=1.8).encode(y=mean, **opacity(1))
    points = base.mark_point(**POINTER).encode(
        y=mean,
        tooltip=[
            alt.Tooltip("a:N", title="algorithm"),
            alt.Tooltip("t:Q", title="timesteps", format=","),
            alt.Tooltip("m:Q", title="return", format=".3~f"),
            alt.Tooltip("l:Q", title="from", format=".3~f"),
            alt.Tooltip("h:Q", title="to", format=".3~f"),
            alt.Tooltip("n:Q", title="seeds"),
        ],
    )
    paper = (
        alt.Chart(alt.NamedData(name="paper"))
        .mark_rule(strokeDash=[4, 3], strokeWidth=1.2)
        .encode(
            y=alt.Y("p:Q", title="return"),
            color=colours,
            tooltip=[alt.Tooltip("a:N", title="the paper's"), alt.Tooltip("p:Q", title="maximum", format=".3~f")],
            **opacity(0.8),
        )
    )
    if legend:
        line = line.add_params(chosen)
    layers = alt.layer(band, line, paper, points)
    return specification(layers.properties(width="container", height=height))


def curve(label: str, table: pd.DataFrame) -> dict:
    """One learning curve: a label, b budget in timesteps, n seeds, and by point t timestep, m mean, i interval."""
    found = {"a": label, "b": int(table["budget"].max()), "n": int(table["seeds"].max())}
    found["t"] = [round(value) for value in table["timestep"]]
    found["m"] = [rounded(value) for value in table["mean"]]
    if table["interval"].notna().any():
        found["i"] = [rounded(value) for value in table["interval"]]
    return found


def learning_curves(task: str, sharing: str, algorithms: Iterable[str], legend: bool = False) -> dict | None:
    """A task's learning curves with their intervals and the paper's maximum returns; None where none is measured.

    A label is an algorithm's name, with a dagger where the budget is not the paper's; of these no maximum is shown.
    """
    table = results_data.curves()
    table = table[(table["task"] == task) & (table["sharing"] == sharing)]
    tables = {name: table[table["algorithm"] == name] for name in algorithms if name in set(table["algorithm"])}
    if not tables:
        return None
    labels = {name: name.upper() + " †" * bool(own["other_budget"].any()) for name, own in tables.items()}
    maxima = results_data.paper_values("max_return")
    return {
        "kind": "curves-with-legend" if legend else "curves",
        "bounds": results_data.bounds(task),
        "colours": {label: results_data.colour(name) for name, label in labels.items()},
        "curves": [curve(labels[name], own) for name, own in tables.items()],
        "paper": [
            {"a": label, "p": rounded(maxima[task, name, sharing][0])}
            for name, label in labels.items()
            if (task, name, sharing) in maxima and "†" not in label
        ],
    }


HEALTH = {"healthy": "#0077bb", "sick": "#cc3311"}  # the colours of recorded runs; site.css has them, too
FAR = 8  # so many times wider than the healthy run's range, an axis is logarithmic


def scalar_chart() -> dict:
    """One of TensorBoard's curves of a healthy and a sick run, still without data."""
    chart = (
        alt.Chart(alt.NamedData(name="scalar"))
        .mark_line(strokeWidth=1.6, point=POINTER)
        .encode(
            x=steps_axis(),
            color=alt.Color("r:N", legend=None, scale=alt.Scale(domain=[*HEALTH], range=[*HEALTH.values()])),
            y=alt.Y("v:Q", title=None, scale=alt.Scale(zero=False), axis=alt.Axis(tickCount=4, format=".3~g")),
            tooltip=[
                alt.Tooltip("r:N", title="run"),
                alt.Tooltip("t:Q", title="timesteps", format=","),
                alt.Tooltip("v:Q", title="value", format=".4~g"),
            ],
        )
    )
    return specification(chart.properties(width="container", height=90))


def scalar(tables: dict[str, pd.DataFrame]) -> dict:
    """One of TensorBoard's curves, by run: columns timestep and value. constant: of a symmetric logarithmic axis, where
    one run's values would press the other's into a line."""
    runs = {
        health: {"t": table["timestep"].tolist(), "v": [rounded(value) for value in table["value"]]}
        for health, table in tables.items()
    }
    healthy, every = tables["healthy"]["value"], pd.concat([table["value"] for table in tables.values()])
    found: dict[str, Any] = {"kind": "scalar", "runs": runs}
    if np.ptp(every) > FAR * np.ptp(healthy) > 0:
        found["constant"] = rounded(healthy.abs().median() / 10 or 1.0)
    return found


def kinds() -> dict[str, dict]:
    """The specifications of all kinds of charts, without data."""
    return {
        "curves": curves_chart(150, None),
        "curves-with-legend": curves_chart(150, "bottom"),
        "explorer": curves_chart(380, "right"),
        "scalar": scalar_chart(),
    }
