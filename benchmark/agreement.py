"""When a value of ours agrees with the paper's: one test, what it lets through, and what it can see.

The test. n seeds of ours and the five of the paper agree if their means differ by no more than the half width of the
95 % prediction interval of the difference,

    t(0.975, d) * s * sqrt(1 / n + 1 / 5)

where s is the standard deviation over seeds. With one seed of ours it is the paper's, with d = 4 degrees of freedom;
with several it is pooled, s^2 = ((n - 1) s_ours^2 + 4 s_paper^2) / (n + 3), with d = n + 3: Student's t-test of two
samples with equal variances. If our runs are as the paper's, and their returns are normally distributed, one cell in
twenty is outside (`false_alarms`).

What is counted. Neither values in which nothing varies, there and here, nor maxima that are both the most that the game
can return: of these a single seed cannot say whether anything varies.

Rounding. The paper prints two decimals. An interval printed as 0.00 counts as 0.005, the most that it can be. Nothing
else is done for rounding; `false_alarms` rounds as the paper does, and shows that the test keeps its level.

What it can see. The placebo puts in the place of each of our values that of another algorithm on the same task. Where
many of these agree, too, the agreement of our own values says little.
"""

from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t

from benchmark.store import FAMILIES, PAPER_SEEDS, best_return, family

LEVEL = 0.05
PRINTED_ZERO = 0.005  # the longest interval that is printed as 0.00
METRICS = {"average_return": "average returns", "max_return": "maximum returns"}  # what is counted, averages first
EVALUATION_EPISODES = 100
DRAWS = 20_000

# Cells that were set apart after their results were known. The page "The paper, run again" says of each why.
SET_APART = {
    "MADDPG in LBF": lambda cell: cell.algorithm == "maddpg" and family(cell.task) == "lbf",
    "the stand-ins of SMAC": lambda cell: cell.task != cell.paper_task,
}


def spread(interval: Any, seeds: Any, paper_interval: Any) -> Any:
    """The standard deviation over seeds. Intervals as the tables have them, 2 s / sqrt(n); that of a single seed is not
    used, and may be NaN."""
    seeds = np.asarray(seeds)
    theirs = np.maximum(paper_interval, PRINTED_ZERO) * np.sqrt(PAPER_SEEDS) / 2
    ours = np.where(seeds > 1, interval, 0) * np.sqrt(seeds) / 2
    return np.sqrt(((seeds - 1) * ours**2 + (PAPER_SEEDS - 1) * theirs**2) / (seeds + PAPER_SEEDS - 2))


def half_width(interval: Any, seeds: Any, paper_interval: Any) -> Any:
    """Of the prediction interval of the difference between our mean of so many seeds and the paper's."""
    deviation = spread(interval, seeds, paper_interval)
    return t.ppf(1 - LEVEL / 2, seeds + PAPER_SEEDS - 2) * deviation * np.sqrt(1 / seeds + 1 / PAPER_SEEDS)


def false_alarms(seeds: int, interval: float) -> float:
    """How often the test rejects runs that are as the paper's, by simulation: normally distributed returns, mean and
    interval of the paper's five seeds printed with two decimals. interval: the true one of five seeds."""
    rng = np.random.default_rng(0)
    deviation = interval * np.sqrt(PAPER_SEEDS) / 2
    mean = rng.uniform(0, 0.01, (DRAWS, 1))  # where it lies between two numbers that can be printed
    theirs, ours = (rng.normal(mean, deviation, (DRAWS, number)) for number in (PAPER_SEEDS, seeds))
    printed = np.round([theirs.mean(axis=1), 2 * theirs.std(axis=1, ddof=1) / np.sqrt(PAPER_SEEDS)], 2)
    own = 2 * ours.std(axis=1, ddof=1) / np.sqrt(seeds) if seeds > 1 else np.zeros(DRAWS)
    return float(np.mean(np.abs(ours.mean(axis=1) - printed[0]) > half_width(own, seeds, printed[1])))


def is_trivial(cells: pd.DataFrame) -> pd.Series:
    """Whether our seeds do not vary, or both values are the best that the game can give, and the paper's interval is
    printed as zero: nothing varies there, and a test says nothing."""
    best = cells["task"].map(best_return)
    at_bound = (cells["mean"].round(2) == best) & (cells["paper_mean"].round(2) == best)
    return ((cells["interval"].round(9) == 0) | at_bound) & (cells["paper_interval"].round(2) == 0)


def set_apart(cells: pd.DataFrame) -> pd.Series:
    """For each cell what it is set apart as, by a key of `SET_APART`; empty for the others."""
    found = [next((name for name, applies in SET_APART.items() if applies(cell)), "") for cell in cells.itertuples()]
    return pd.Series(found, index=cells.index, dtype=object)


def counted(compared: pd.DataFrame) -> pd.DataFrame:
    """The compared cells (`tables.compare`) that tell something, with columns family, agrees and apart."""
    cells = compared[compared["metric"].isin(METRICS) & compared["difference"].notna()]
    cells = cells[~is_trivial(cells)]
    families = cells["task"].map(family)
    return cells.assign(family=families, agrees=cells["difference"].abs() <= 1, apart=set_apart(cells))


def placebo(cells: pd.DataFrame) -> pd.DataFrame:
    """Each counted cell once with each of our other algorithms' values on the same task: agrees."""
    key = ["metric", "sharing", "task"]
    theirs = cells[[*key, "family", "algorithm", "paper_mean", "paper_interval"]]
    pairs = theirs.merge(cells[[*key, "algorithm", "mean", "interval", "seeds"]], on=key, suffixes=("", "_other"))
    pairs = pairs[pairs["algorithm"] != pairs["algorithm_other"]]
    width = half_width(pairs["interval"], pairs["seeds"], pairs["paper_interval"])
    return pairs.assign(agrees=(pairs["mean"] - pairs["paper_mean"]).abs() <= width)


def maximum_bias(evaluations: pd.DataFrame) -> float:
    """By how much the maximum of one seed is above what the maximum of a mean of five would be, because it picks the
    noise of evaluations: `evaluations` are one seed's.

    A point's noise has the standard deviation return_std / sqrt(100). What is left of the curve without it: the points'
    distances from a running mean of five are shrunk until their variance is what it was without the noise's. On this
    curve noise is drawn anew, whole for one seed and a fifth of its variance for a mean of five; the difference of the
    mean maxima is the bias. Only evaluations are counted; that a seed's policy goes up and down adds to it.
    """
    curve = evaluations.sort_values("point")
    returns, noise = curve["return_mean"], (curve["return_std"] / np.sqrt(EVALUATION_EPISODES)).to_numpy()
    trend = returns.rolling(5, center=True, min_periods=1).mean()
    distances = (returns - trend).to_numpy()
    total = np.mean(distances**2)
    kept = max(0.0, 1 - np.mean(noise**2) / total) if total > 0 else 0.0
    truth = trend.to_numpy() + np.sqrt(kept) * distances
    drawn = np.random.default_rng(0).normal(0, 1, (2000, len(curve))) * noise
    return float(np.mean((truth + drawn).max(axis=1) - (truth + drawn / np.sqrt(PAPER_SEEDS)).max(axis=1)))


def without_bias(cells: pd.DataFrame, evaluations: pd.DataFrame) -> pd.DataFrame:
    """The counted maxima with a column bias (`maximum_bias`; 0 with several seeds), and agrees without it.

    evaluations: of the tables (`measures.in_tables`).
    """
    maxima = cells[cells["metric"] == "max_return"]
    key = ["task", "algorithm", "sharing"]
    curves = dict(iter(evaluations.groupby(key)))
    bias = [maximum_bias(curves[tuple(cell[key])]) if cell["seeds"] == 1 else 0.0 for _, cell in maxima.iterrows()]
    width = half_width(maxima["interval"], maxima["seeds"], maxima["paper_interval"])
    return maxima.assign(bias=bias, agrees=(maxima["mean"] - bias - maxima["paper_mean"]).abs() <= width)


def numbers(agrees: pd.Series) -> str:
    """How many of how many agree."""
    return f"{int(agrees.sum())} of {len(agrees)}" if len(agrees) else ""


def percent(agrees: pd.Series) -> str:
    """The share that agrees."""
    return f"{100 * agrees.mean():.0f} %" if len(agrees) else ""


def by_family(
    first: pd.DataFrame, cells: pd.DataFrame, corrected: pd.DataFrame, sharing: dict[str, str]
) -> list[list[str]]:
    """Lines of a table, by family and sharing: of averages and of maxima those that agree with seed 0 alone (`first`),
    those of `cells`, and by the placebo; and the maxima that agree without the bias of single seeds."""
    pretended, body = placebo(cells), []
    for name, title in FAMILIES.items():
        for shared, words in sharing.items():
            alone, chosen, others, without = (
                frame[(frame["family"] == name) & (frame["sharing"] == shared)]
                for frame in (first, cells, pretended, corrected)
            )
            if chosen.empty:
                continue
            line = [f"{title}, {words}"]
            for metric in METRICS:
                line += [numbers(frame.loc[frame["metric"] == metric, "agrees"]) for frame in (alone, chosen)]
                line += [percent(others.loc[others["metric"] == metric, "agrees"])]
            body.append([*line, numbers(without["agrees"])])
    return body
