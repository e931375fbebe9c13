"""The paper's tables from cells of results (`measures.our_cells`, `store.paper_cells`), as Markdown and CSV.

In a row, the highest mean is bold, and with it those that are printed alike; a maximum of untrained networks does not
count, and a single seed is not bold. An asterisk: not significantly different from a bold one in a two-sided Student
t-test with equal variances at 0.05, computed from means, intervals and numbers of seeds, as the paper's own marks can
be.
"""

import json
import re
import types
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import ttest_ind_from_stats

from benchmark.agreement import LEVEL, half_width
from benchmark.measures import beside, summarise
from benchmark.store import ALGORITHMS, FAMILIES, KEY, PAPER_SEEDS, SHARED, algorithm_order, family

TITLES = {
    "max_return": "Maximum returns",
    "average_return": "Average returns",
    "last_return": "Returns at the last evaluation",
    "max_win_rate": "Maximum win rates",
    "last_win_rate": "Win rates at the last evaluation",
}
LEGEND = """\
In each cell the mean and its interval, 2 s / sqrt(n). **Bold**: the highest mean of ours without °, or several that are
printed alike; nothing where it is of a single seed. An asterisk: not significantly different from a bold one. A small
number: how many seeds, where there are not five; a single one has no interval. ⁺ and ⁻: more or fewer seeds than
`benchmark/seeds.csv` plans for the row. °: the maximum lies at step 0, before any training, and is the luck of random
networks. †: another budget than the paper's, and so no difference. ‡: a value of the paper that cannot be, since its
average is above its maximum. Difference: ours minus the paper's, in units of half the 95 % prediction interval of this
difference, so that beyond 1 the two do not agree. For a single seed this interval has the spread of the paper's five
seeds; with several seeds, that of ours and theirs together. A maximum of one seed is too high, beside one of a mean of
five seeds: the best of 41 points picks its noise. So look at averages first."""
SUPERSCRIPTS = str.maketrans("0123456789+-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻")


def same_mean(mean: float, interval: float, seeds: int, mean2: float, interval2: float, seeds2: int) -> bool:
    """Whether two means are not significantly different. Without an interval, as for a single seed, False."""
    if np.isnan(interval) or np.isnan(interval2):
        return False
    if interval == 0 and interval2 == 0:
        return round(mean, 9) == round(mean2, 9)
    deviation, deviation2 = interval * np.sqrt(seeds) / 2, interval2 * np.sqrt(seeds2) / 2
    test = ttest_ind_from_stats(mean, deviation, seeds, mean2, deviation2, seeds2, equal_var=True)
    return bool(test.pvalue >= LEVEL)


def marks(row: pd.DataFrame) -> list[str]:
    """For each cell of a table's row "best", "not significantly different" or "", in the words of the paper's CSV."""
    learned = ~row["at_start"] if "at_start" in row else pd.Series(True, row.index)
    highest = round(row.loc[learned, "mean"].max(), 2)
    is_best = learned & (row["mean"].round(2) == highest) & (row["seeds"] > 1)
    cells = list(row[["mean", "interval", "seeds"]].itertuples(index=False, name=None))
    best = [cell for cell, mine in zip(cells, is_best) if mine]
    found = []
    for cell, mine, after_start in zip(cells, is_best, learned):
        if mine:
            found.append("best")
        elif after_start and any(same_mean(*cell, *other) for other in best):
            found.append("not significantly different")
        else:
            found.append("")
    return found


def with_marks(cells: pd.DataFrame) -> pd.DataFrame:
    """The cells with a column mark, as in the paper only for maximum returns."""
    marked = cells.assign(mark="")
    for _, row in cells[cells["metric"] == "max_return"].groupby(["metric", "sharing", "task"]):
        marked.loc[row.index, "mark"] = marks(row)
    return marked


def impossible(paper: pd.DataFrame) -> pd.Series:
    """For each of the paper's cells whether it belongs to an average return above its maximum."""
    wide = paper.pivot(index=["sharing", "task", "algorithm"], columns="metric", values="mean")
    wrong = wide.index[wide["average_return"] > wide["max_return"]]
    cells = pd.MultiIndex.from_frame(paper[["sharing", "task", "algorithm"]])
    return pd.Series(cells.isin(wrong) & paper["metric"].str.endswith("return"), index=paper.index)


def compare(
    ours: pd.DataFrame, paper: pd.DataFrame, planned: Mapping[tuple[str, str], int] = types.MappingProxyType({})
) -> pd.DataFrame:
    """Our cells with mark, and beside them the paper's: paper_mean, paper_interval, impossible, difference, planned.

    planned: how many seeds were planned, by task and sharing; as a column 0 where nothing was.
    difference: in units of `agreement.half_width`; NaN with another budget, and without a value of the paper that can
    be.
    """
    theirs = paper.assign(impossible=impossible(paper)).rename(
        columns={"task": "paper_task", "mean": "paper_mean", "interval": "paper_interval"}
    )
    key = ["metric", "sharing", "paper_task", "algorithm"]
    both = with_marks(ours).merge(theirs[[*key, "paper_mean", "paper_interval", "impossible"]], how="left", on=key)
    both["impossible"] = both["impossible"].eq(True)
    width = half_width(both["interval"], both["seeds"], both["paper_interval"])
    difference = ((both["mean"] - both["paper_mean"]) / width).round(9)
    rows = zip(both["task"], both["sharing"])
    return both.assign(
        difference=difference.mask(both["other_budget"] | both["impossible"]),
        planned=[planned.get(row, 0) for row in rows],
    )


def number(mean: float, interval: float) -> str:
    """Mean and interval with two decimals; a dash where there is none."""
    if np.isnan(mean):
        return "-"
    text = f"{round(mean, 2) + 0.0:.2f}"  # adding zero turns -0.0 into 0.0
    return text if np.isnan(interval) else f"{text} ± {interval:.2f}"


def signs(cell: Any) -> str:
    """The legend's signs for a cell of ours, a space before them."""
    off = "" if cell.planned in (0, cell.seeds) else "+" if cell.seeds > cell.planned else "-"
    seeds = f"{cell.seeds}{off}" if off or cell.seeds != PAPER_SEEDS else ""
    found = seeds.translate(SUPERSCRIPTS) + "°" * cell.at_start + "†" * cell.other_budget
    return f" {found}" if found else ""


def our_text(cell: Any) -> str:
    """Our value with its marks and signs, in Markdown."""
    text = number(cell.value, cell.interval)
    if cell.mark == "best":
        text = f"**{text}**"
    elif cell.mark:
        text += r"\*"
    return text + signs(cell)


def paper_text(cell: Any) -> str:
    """The paper's value."""
    return number(cell.paper_mean, cell.paper_interval) + "‡" * cell.impossible


def difference_text(cell: Any) -> str:
    """The difference; a dash where there is none."""
    return "-" if np.isnan(cell.difference) else f"{round(cell.difference, 1) + 0.0:+.1f}"


def short_text(cell: Any) -> str:
    """Our mean with its signs, the paper's in brackets."""
    paper = "" if np.isnan(cell.paper_mean) else f" ({number(cell.paper_mean, np.nan)})"
    return number(cell.value, np.nan) + signs(cell) + paper


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts numbers within names as numbers."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split("([0-9]+)", name)]


def in_order(tasks: Any) -> list[str]:
    """Tasks by family in the paper's order, and by name within."""
    order = list(FAMILIES)
    return sorted(set(tasks), key=lambda task: (order.index(family(task)), natural(task)))


def columns(both: pd.DataFrame) -> list[str]:
    """The algorithms that the tables have columns for: the paper's nine, and those that only we have results of."""
    return algorithm_order([*ALGORITHMS, *both["algorithm"]])


def rows(cells: pd.DataFrame, algorithms: list[str], *texts: Callable[[Any], str]) -> dict[str, list[list[str]]]:
    """For each task in order, for each of the texts, the algorithms' cells; an empty text where one is missing."""
    known = {(cell.task, cell.algorithm): cell for cell in cells.rename(columns={"mean": "value"}).itertuples()}
    found = {}
    for task in in_order(cells["task"]):
        row = [known.get((task, algorithm)) for algorithm in algorithms]
        found[task] = [["" if cell is None else text(cell) for cell in row] for text in texts]
    return found


def to_markdown(header: list[str], body: list[list[str]]) -> str:
    """A table in Markdown; nothing without a line in it."""
    lines = [header, ["---"] * len(header), *body] if body else []
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def grid(rows: Mapping[Any, str], columns: Mapping[Any, str], cell: Callable[[Any, Any], str]) -> str:
    """A table of cell(row, column) in Markdown, without the rows that are empty. rows, columns: titles by key."""
    lines = [[title, *(cell(row, column) for column in columns)] for row, title in rows.items()]
    return to_markdown(["", *columns.values()], [line for line in lines if any(line[1:])])


def markdown(both: pd.DataFrame, metric: str, sharing: str) -> str:
    """One of the paper's tables in Markdown, with up to three lines for a task: ours, the paper's, the difference.
    Nothing where we have no result for it."""
    chosen = both[(both["metric"] == metric) & (both["sharing"] == sharing)]
    body = []
    for task, (ours, paper, differences) in rows(chosen, columns(both), our_text, paper_text, difference_text).items():
        own_opponent = set(chosen.loc[chosen["task"] == task, "paper_task"]) == {""}
        body.append([task if own_opponent else f"{task}{beside(task)}", "ours", *ours])
        for whose, row in (("paper", paper), ("difference", differences)):
            if set(row) - {"", "-"}:
                body.append(["", whose, *row])
    return to_markdown(["task", "", *map(str.upper, columns(both))], body)


# One task of each family, for the README.
SHOWN = ("matrix-climbing", "mpe-speaker-listener", "smaclite-2s_vs_1sc-sc2", "lbf-15x15-3p-5f", "rware-tiny-4p")


def short(both: pd.DataFrame) -> str:
    """Average returns with sharing and the paper's budget, one line for each of a few tasks."""
    chosen = both[(both["metric"] == "average_return") & (both["sharing"] == SHARED) & ~both["other_budget"]]
    chosen = chosen[chosen["task"].isin(SHOWN)]
    body = [[f"`{task}`{beside(task)}", *texts] for task, (texts,) in rows(chosen, columns(both), short_text).items()]
    return to_markdown(["task", *map(str.upper, columns(both))], body)


def variants(evaluations: pd.DataFrame, shown: pd.DataFrame | None = None) -> str:
    """The results that are in no other table, as those with other flags, or a search; nothing where there are none.

    shown: the evaluations that the other tables are of. Of each task, algorithm, sharing and budget the best maximum
    comes first, and of equal ones the best average.
    """
    summary = summarise(evaluations).reset_index()
    summary = summary.merge(evaluations[[*KEY, "total_timesteps"]].drop_duplicates(), on=KEY)
    summary["place"] = summary["task"].map(in_order(summary["task"]).index)
    summary["score"] = summary["maximum"].round(9)  # equal ones may differ in their last bits
    group = ["place", "algorithm", "sharing", "total_timesteps"]
    ascending = [True, True, False, False, False, False]
    elsewhere = set() if shown is None else set(shown[KEY].itertuples(index=False, name=None))
    body = []
    for row in summary.sort_values([*group, "score", "average"], ascending=ascending).itertuples():
        if (row.task, row.algorithm, row.sharing, row.setting) in elsewhere:
            continue
        flags = ", ".join(f"{name} {value}" for name, value in json.loads(row.setting).items()).replace("|", r"\|")
        pairs = [(getattr(row, name), getattr(row, f"{name}_interval")) for name in ("maximum", "average", "last")]
        values = [number(*pair) for pair in pairs]
        body.append([row.task, row.algorithm.upper(), row.sharing, flags, str(row.seeds), *values])
    header = ["task", "algorithm", "sharing", "changed flags", "seeds", "maximum", "average", "last"]
    return to_markdown(header, body)


def to_csv(both: pd.DataFrame) -> str:
    """All cells beside the paper's, as a CSV; columns as `compare` has them."""
    order = both["task"].map(in_order(both["task"]).index)
    columns = both["algorithm"].map(algorithm_order(both["algorithm"]).index)
    places = both.assign(order=order, column=columns).sort_values(["metric", "sharing", "order", "column"])
    return places[both.columns].round(4).to_csv(index=False, lineterminator="\n")
