"""The figures: one function each, which draws a matplotlib figure from tables that are not empty.

An algorithm has the same colour and line everywhere. The colours are Paul Tol's "muted" scheme, made to be told apart
by the colour-blind; the lines help where colours do not: value-based methods are dashed, MADDPG and COMA dotted.
Algorithms that the paper does not have, such as your own, are black.
"""

import io
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter
from PIL import Image

from benchmark import measures
from benchmark.measures import interval
from benchmark.store import ALGORITHMS, FAMILIES, PAPER_CPU_HOURS, PAPER_RUNS, algorithm_order
from benchmark.tables import in_order
from envs.runs import write_whole

COLOURS = {
    "iql": "#999933",
    "vdn": "#DDCC77",
    "qmix": "#117733",
    "ia2c": "#88CCEE",
    "maa2c": "#332288",
    "ippo": "#CC6677",
    "mappo": "#882255",
    "maddpg": "#44AA99",
    "coma": "#AA4499",
}
LINES: dict[str, Any] = {name: (0, (5, 2)) for name in ("iql", "vdn", "qmix")} | {
    name: (0, (1.5, 1)) for name in ("maddpg", "coma")
}
OTHER_COLOUR = "black"
SHARING = {"shared": "with parameter sharing", "independent": "without parameter sharing"}
DOTS_PER_INCH = 110
PNG_COLOURS = 64
LINEAR = 300  # untrained teams earn down to -2,500 in a matrix game: below -300 the axis is logarithmic
NARROWEST = 8.5  # inches, so that the legend has room

plt.rcParams.update(
    {
        "axes.grid": True,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "figure.constrained_layout.use": True,
        "font.size": 9,
        "grid.alpha": 0.3,
        "svg.fonttype": "none",
        "svg.hashsalt": "marl-baselines",  # the same figure is the same file
    }
)


def save(figure: Figure, path: Path) -> None:
    """Writes path.svg and path.png, the PNG with few colours, since it is kept in the repository."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the panels have their places now; saving would compute them again
    svg, large, png = io.BytesIO(), io.BytesIO(), io.BytesIO()
    figure.savefig(svg, format="svg", metadata={"Date": None})
    figure.savefig(large, format="png", dpi=DOTS_PER_INCH)
    plt.close(figure)
    with Image.open(large) as image:
        small = image.convert("RGB").quantize(PNG_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    small.save(png, "png", optimize=True)
    write_whole(path.with_suffix(".svg"), svg.getvalue())
    write_whole(path.with_suffix(".png"), png.getvalue())


def panels(number: int, columns: int, x: str, y: str, share_y: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure of equal panels, no more columns than wanted; x and y say what the axes are, at the border."""
    columns = min(columns, number)
    rows = -(-number // columns)
    size = (max(3.0 * columns, NARROWEST), 2.3 * rows + 0.7)
    figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, sharey=share_y)
    for unused in axes.flat[number:]:
        unused.remove()
    for place, panel in enumerate(axes.flat[:number]):
        if place + columns >= number:
            panel.set_xlabel(x)
        if place % columns == 0:
            panel.set_ylabel(y)
    return figure, list(axes.flat[:number])


def legend(figure: Figure, algorithms: Any) -> None:
    """One legend below all panels."""
    present = algorithm_order(algorithms)
    handles = [Line2D([], [], **style(name), lw=2) for name in present]
    figure.legend(
        handles,
        [name.upper() for name in present],
        loc="outside lower center",
        ncols=9,
        columnspacing=1.0,
        handlelength=2.6,
        frameon=False,
    )


def style(algorithm: str) -> dict[str, Any]:
    """Colour and line of an algorithm."""
    return {"color": COLOURS.get(algorithm, OTHER_COLOUR), "linestyle": LINES.get(algorithm, "-")}


def curve(axes: Axes, algorithm: str, x: Any, mean: Any, spread: Any) -> None:
    """One algorithm's line with its interval as a band."""
    axes.plot(x, mean, **style(algorithm), lw=1.3)
    axes.fill_between(x, mean - spread, mean + spread, color=style(algorithm)["color"], alpha=0.2, lw=0)


def mean_curves(rows: pd.DataFrame, column: str) -> Iterator[tuple[str, pd.DataFrame]]:
    """For each algorithm, by its points: x (the share of the paper's budget), mean and interval.

    The mean of the tasks' means over seeds; its interval comes from those of the tasks, as of independent means, and is
    missing where a task has a single seed.
    """
    rows = rows.assign(x=rows["timestep"] / rows["paper_timesteps"])
    by_task = rows.groupby(["algorithm", "point", "task"]).agg(
        x=("x", "mean"), mean=(column, "mean"), std=(column, "std"), count=(column, "count")
    )
    by_task["square"] = interval(by_task["std"], by_task["count"]) ** 2
    points = by_task.groupby(level=["algorithm", "point"])
    curves = points[["x", "mean"]].mean()
    known = points["square"].count() == points.size()
    curves["interval"] = (np.sqrt(points["square"].sum()) / points.size()).where(known)
    for algorithm in algorithm_order(rows["algorithm"]):
        yield algorithm, curves.loc[algorithm]


def learning_curves(evaluations: pd.DataFrame, family: str, sharing: str) -> Figure:
    """Evaluation returns of a family's tasks over training, with 95 % intervals over seeds; evaluations from
    `measures.in_tables`."""
    chosen = evaluations[(evaluations["family"] == family) & (evaluations["sharing"] == sharing)]
    tasks = in_order(chosen["task"])
    figure, axes = panels(len(tasks), 4 if len(tasks) > 6 else 3, "", "return")
    for task, panel in zip(tasks, axes):
        rows = chosen[chosen["task"] == task]
        if family == "other" or rows["other_budget"].any():  # shares of the paper's budgets would end at several places
            panel.set_xlabel("timesteps")
            panel.xaxis.set_major_formatter(EngFormatter())
            rows = rows.assign(paper_timesteps=1)
        else:
            panel.set_xlabel("share of the paper's timesteps")
        for algorithm, line in mean_curves(rows, "return_mean"):
            curve(panel, algorithm, line["x"], line["mean"], line["interval"])
        title = f"{task}{measures.against(task)}"
        panel.set_title(title, fontsize=min(10.8, 330 / len(title)))  # a long name has the width of its panel, too
        panel.margins(x=0.02)
        if family == "matrix" and panel.get_ylim()[0] < -LINEAR:
            panel.set_yscale("symlog", linthresh=LINEAR)
            panel.set_yticks([-2000, -LINEAR, 0, LINEAR], minor=False)
            panel.yaxis.set_major_formatter("{x:g}")
    figure.suptitle(f"{FAMILIES[family]}, {SHARING[sharing]}")
    legend(figure, chosen["algorithm"])
    return figure


def set_family_title(panel: Axes, family: str, rows: pd.DataFrame) -> None:
    """A family's name and the number of its tasks; where algorithms were run on some of them only, on how many each."""
    tasks, each = rows["task"].nunique(), rows.groupby("algorithm")["task"].nunique()
    title, small = f"{FAMILIES[family]}, {tasks} task{'s' * (tasks != 1)}", ""
    if each.min() < tasks:
        numbers = ", ".join(f"{name.upper()} {each[name]}" for name in algorithm_order(each.index))
        small = textwrap.fill(f"run on so many of them: {numbers}", 60)
    panel.set_title(title, pad=22 if small else 6)
    panel.text(0.5, 1.02, small, fontsize=6.5, ha="center", transform=panel.transAxes)


def normalised_curves(normalised: pd.DataFrame, sharing: str) -> Figure:
    """Normalised returns over training, a panel for each family: means over tasks with 95 % intervals."""
    chosen = normalised[normalised["sharing"] == sharing]
    families = [family for family in FAMILIES if (chosen["family"] == family).any()]
    figure, axes = panels(len(families), 3, "share of the paper's timesteps", "normalised return")
    for family, panel in zip(families, axes):
        rows = chosen[chosen["family"] == family]
        for algorithm, line in mean_curves(rows, "normalised"):
            curve(panel, algorithm, line["x"], line["mean"], line["interval"])
        set_family_title(panel, family, rows)
        panel.set_ylim(-0.02, 1.02)
    figure.suptitle(f"Normalised returns, {SHARING[sharing]}")
    legend(figure, chosen["algorithm"])
    return figure


def sharing_effect(ours: pd.DataFrame, paper: pd.DataFrame) -> Figure:
    """Normalised maximum returns with and without sharing by family, ours and the paper's, with standard errors."""
    sides = {"ours": measures.sharing_means(ours), "paper": measures.sharing_means(paper)}
    families = [family for family in FAMILIES if family in sides["ours"].index]
    figure, (panel,) = panels(1, 1, "", "normalised maximum return")
    place = np.arange(len(families))
    for number, (whose, sharing) in enumerate((whose, sharing) for whose in sides for sharing in SHARING):
        rows = sides[whose].xs(sharing, level="sharing").reindex(families)
        panel.bar(
            place + 0.2 * (number - 1.5),
            rows["mean"],
            0.18,
            yerr=rows["error"],
            color="#332288" if sharing == "shared" else "#DDCC77",
            alpha=1.0 if whose == "ours" else 0.45,
            label=f"{whose}, {SHARING[sharing]}",
        )
    figure.suptitle("Maximum returns with and without parameter sharing")
    pairs = sides["ours"].xs("shared", level="sharing").reindex(families)["count"]
    panel.set_xticks(place, [f"{FAMILIES[family]}\n({count:.0f} pairs)" for family, count in zip(families, pairs)])
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


def cpu_hours(hours: pd.DataFrame) -> Figure:
    """Mean CPU hours of a run by family, algorithm and sharing; hours from `measures.cpu_hours`."""
    families = [family for family in FAMILIES if family in hours.index.get_level_values("family")]
    algorithms = algorithm_order([*ALGORITHMS, *hours.index.get_level_values("algorithm")])
    figure, axes = panels(len(families), 3, "", "CPU hours a run", share_y=True)
    for family, panel in zip(families, axes):
        rows = hours.loc[family]
        for place, algorithm in enumerate(algorithms):
            for sharing, shift, alpha in (("shared", -0.2, 1.0), ("independent", 0.2, 0.45)):
                if (algorithm, sharing) in rows.index:
                    mean = rows.loc[(algorithm, sharing), "mean"]
                    panel.bar(place + shift, mean, 0.38, color=style(algorithm)["color"], alpha=alpha)
        panel.axhline(PAPER_CPU_HOURS / PAPER_RUNS, color="black", lw=1, linestyle="--")
        panel.set_yscale("log")
        panel.yaxis.set_major_formatter("{x:g}")
        panel.set_xticks(range(len(algorithms)), [name.upper() for name in algorithms], rotation=60)
        panel.set_title(FAMILIES[family])
    figure.suptitle("CPU hours of one training run")
    handles: list[Artist] = [Patch(color="black", label=SHARING["shared"])]
    handles.append(Patch(color="black", alpha=0.45, label=SHARING["independent"]))
    handles.append(Line2D([], [], color="black", lw=1, linestyle="--", label="the paper's mean over all its runs"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def rounded(number: float) -> str:
    """A number with two digits that count; nothing for none."""
    return "" if np.isnan(number) else f"{float(f'{number:.2g}'):,.0f}"


def simulation_speed(speeds: pd.DataFrame) -> Figure:
    """Steps per second by family; speeds from `store.speeds`. Geometric means over the tasks that were measured."""
    families = [family for family in FAMILIES if (speeds["family"] == family).any()]
    figure, (panel,) = panels(1, 1, "", "environment steps per second")
    whose = list(dict.fromkeys(speeds["whose"]))
    width = 0.8 / len(whose)
    for number, name in enumerate(whose):
        logs = np.log(speeds[speeds["whose"] == name].set_index("family")["steps_per_second"])
        means = np.exp(logs.groupby("family").mean()).reindex(families)
        shift = width * (number - (len(whose) - 1) / 2)
        colour = plt.get_cmap("cividis")(number / max(1, len(whose) - 1))
        bars = panel.bar(np.arange(len(families)) + shift, means, 0.9 * width, color=colour, label=name)
        panel.bar_label(bars, fmt=rounded, fontsize=7)
    figure.suptitle("Simulation speed on one core, random actions")
    panel.set_yscale("log")
    panel.set_ylim(bottom=speeds["steps_per_second"].min() / 5)
    panel.set_xticks(range(len(families)), [FAMILIES[family] for family in families])
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    return figure


def profiles(normalised: pd.DataFrame, sharing: str) -> Figure:
    """Performance profiles of each family: the share of runs whose last evaluation is above a normalised return. With
    bootstrap intervals where all tasks have several seeds."""
    chosen = normalised[normalised["sharing"] == sharing]
    families = [family for family in FAMILIES if (chosen["family"] == family).any()]
    figure, axes = panels(len(families), 3, "normalised return", "share of runs")
    thresholds = np.linspace(0, 1, 101)
    measure = measures.performance_profile(thresholds)
    for family, panel in zip(families, axes):
        rows = chosen[chosen["family"] == family]
        scores = measures.final_scores(rows)
        for algorithm in algorithm_order(name for name, _ in scores):
            look = style(algorithm)
            by_task = list(scores[algorithm, sharing].values())
            share, low, high = measures.with_interval(measure, by_task)
            panel.step(thresholds, share, **look, lw=1.3)
            if min(map(len, by_task)) > 1:  # of a single seed no interval is known
                panel.fill_between(thresholds, low, high, color=look["color"], alpha=0.15, lw=0, step="pre")
        set_family_title(panel, family, rows)
    figure.suptitle(f"Runs above a normalised return at the last evaluation, {SHARING[sharing]}")
    legend(figure, chosen["algorithm"])
    return figure
