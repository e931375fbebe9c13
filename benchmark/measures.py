"""What results say in numbers: the paper's maxima, averages and intervals, normalised returns, and the measures of
Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the Statistical Precipice", with stratified-bootstrap
intervals.

Scores are lists of arrays, one array a task, one number a seed: tasks may have different numbers of seeds. A bootstrap
sample draws as many seeds as there are, with replacement, within each task by itself (the strata). Intervals are the
2.5 and 97.5 percentiles of 2,000 samples.
"""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import trim_mean

from benchmark.store import (
    KEY,
    KNOWN_AGAINST,
    PAPER_OPPONENTS,
    PAPER_SETTING,
    family,
    paper_cells,
    paper_task,
    setting_name,
)

SAMPLES = 2000
PERCENTILES = (2.5, 97.5)


def summarise(evaluations: pd.DataFrame, column: str = "return_mean") -> pd.DataFrame:
    """What the paper's tables say of each (task, algorithm, sharing, setting), from any column of the evaluations.

    maximum: the mean over seeds at each point, then its first best point (maximum_point). average: the mean over
    points and seeds. last: the last point. An interval is 2 s / sqrt(n), s the sample standard deviation over n seeds
    (average: over the seeds' own means); NaN for a single seed.
    """
    measured = evaluations.dropna(subset=[column])
    by_point = measured.groupby([*KEY, "point"])[column].agg(["mean", "std", "count"]).reset_index("point")
    by_point["interval"] = interval(by_point["std"], by_point["count"])
    by_point["rank"] = by_point["mean"].round(9)  # equal means may differ in their last bits
    best = by_point.sort_values(["rank", "point"], ascending=[False, True]).groupby(level=KEY).head(1)
    last = by_point.groupby(level=KEY).tail(1)  # not last(), which would take an interval of an earlier point
    own_means = measured.groupby([*KEY, "seed"])[column].mean()
    average = own_means.groupby(level=KEY).agg(["mean", "std", "count"])
    return pd.DataFrame(
        {
            "seeds": average["count"],
            "maximum": best["mean"],
            "maximum_interval": best["interval"],
            "maximum_point": best["point"],
            "average": average["mean"],
            "average_interval": interval(average["std"], average["count"]),
            "last": last["mean"],
            "last_interval": last["interval"],
        }
    )


def interval(deviation: Any, seeds: Any) -> Any:
    """The paper's 95 % interval, from the sample standard deviation."""
    return 2 * deviation / np.sqrt(seeds)


def paper_setting(task: str) -> dict[str, Any]:
    """The changed flags of the runs that the paper's rows are compared with: none, or its own opponent."""
    return {"env_kwargs": f"opponent='{PAPER_OPPONENTS[task]}'"} if task in PAPER_OPPONENTS else {}


def against(task: str) -> str:
    """The opponent, to be put behind a task's name, where another than the task's own plays."""
    return ", the paper's " + {"mpe-adversary": "adversary", "mpe-tag": "prey"}[task] if task in PAPER_OPPONENTS else ""


def beside(task: str) -> str:
    """What a row of the tables adds to a task's name: the opponent, and what is known against a stand-in."""
    return against(task) + (f" ({KNOWN_AGAINST[task]})" if task in KNOWN_AGAINST else "")


def has_paper_setting(evaluations: pd.DataFrame) -> pd.Series:
    """For each row whether it is of a run with the paper's flags and budget, against the paper's opponent."""
    settings = {task: setting_name(paper_setting(task)) for task in evaluations["task"].unique()}
    return evaluations["setting"] == evaluations["task"].map(settings)


def in_tables(evaluations: pd.DataFrame, own_opponent: bool = False) -> pd.DataFrame:
    """The evaluations that the paper's tables and curves show: of each task, algorithm and sharing the paper's setting,
    or where its budget is missing, the longest other one. own_opponent: those of `PAPER_OPPONENTS`' tasks instead that
    were played against the opponents of this repository."""
    budgets = evaluations[[*KEY, "total_timesteps"]].drop_duplicates()
    if own_opponent:
        budgets = budgets[budgets["task"].isin(PAPER_OPPONENTS)]
    changed = [json.loads(setting) for setting in budgets["setting"]]
    other_budget = [bool(flags.pop("total_timesteps", 0)) for flags in changed]
    expected = [{} if own_opponent else paper_setting(task) for task in budgets["task"]]
    budgets = budgets.assign(other_budget=other_budget)
    budgets = budgets[np.array([flags == its for flags, its in zip(changed, expected)], bool)]
    budgets = budgets.sort_values(["other_budget", "total_timesteps"], ascending=[True, False])
    chosen = budgets.drop_duplicates(["task", "algorithm", "sharing"])[[*KEY, "other_budget"]]
    return evaluations.merge(chosen, on=KEY)


def our_cells(evaluations: pd.DataFrame, own_opponent: bool = False) -> pd.DataFrame:
    """The results `in_tables` as cells in the form of `paper_cells`, with the further metric last_return.

    at_start: the maximum lies before training. paper_task: the row of the paper that a cell is compared with; empty
    with `own_opponent`.
    """
    chosen = in_tables(evaluations, own_opponent)
    settings = chosen[[*KEY, "total_timesteps", "other_budget"]].drop_duplicates()
    parts = []
    for column, prefix in {"return_mean": "return", "battle_won": "win_rate"}.items():
        if column not in chosen:
            continue
        summary = settings.merge(summarise(chosen, column).reset_index(), on=KEY)
        for measure in ("maximum", "average", "last"):
            metric = f"{'max' if measure == 'maximum' else measure}_{prefix}"
            cells = summary.assign(metric=metric, mean=summary[measure], interval=summary[f"{measure}_interval"])
            parts.append(cells.assign(at_start=(summary["maximum_point"] == 0) & (measure == "maximum")))
    cells = pd.concat(parts, ignore_index=True).rename(columns={"total_timesteps": "timesteps"})
    cells["paper_task"] = "" if own_opponent else cells["task"].map(paper_task)
    columns = ["metric", "sharing", "task", "algorithm", "mean", "interval", "seeds"]
    return cells[[*columns, "timesteps", "other_budget", "at_start", "paper_task"]]


def normalise(evaluations: pd.DataFrame) -> pd.DataFrame:
    """The evaluations of the paper's tasks, setting and budget, and a column normalised in [0, 1]: the paper's formula

        norm_G = (G - min G) / (max G - min G)

    with min and max over all that was measured on the task: algorithms, seeds, points, with and without sharing. A
    task on which nothing ever changed is left out.
    """
    in_paper = evaluations["task"].map(paper_task).isin(paper_cells()["task"])
    chosen = evaluations[in_paper & has_paper_setting(evaluations)]
    returns = chosen.groupby("task")["return_mean"]
    low, high = returns.transform("min"), returns.transform("max")
    chosen = chosen.assign(normalised=(chosen["return_mean"] - low) / (high - low).where(high > low))
    return chosen.dropna(subset=["normalised"])


def final_scores(normalised: pd.DataFrame) -> dict[tuple[str, str], dict[str, np.ndarray]]:
    """For each (algorithm, sharing) and task the seeds' normalised returns at the last point."""
    last = normalised.sort_values("point").groupby([*KEY, "seed"]).last().reset_index()
    scores: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    for (task, algorithm, sharing), rows in last.groupby(["task", "algorithm", "sharing"]):
        scores.setdefault((algorithm, sharing), {})[task] = rows["normalised"].to_numpy()
    return scores


def with_interval(measure: Callable[..., np.ndarray], *teams: list[np.ndarray]) -> np.ndarray:
    """A measure of one or two teams' scores with its interval: [3, ...], the measure, its lower and its upper bound.

    measure: takes for each team a list of arrays [sample, seed], one a task, and gives an array [sample, ...].
    """
    rng = np.random.default_rng(0)
    point = measure(*([values[None] for values in team] for team in teams))[0]
    drawn = ([seeds[rng.integers(len(seeds), size=(SAMPLES, len(seeds)))] for seeds in team] for team in teams)
    sampled = measure(*drawn)
    return np.stack([point, *np.percentile(sampled, PERCENTILES, axis=0)])


def interquartile_mean(scores: list[np.ndarray]) -> np.ndarray:
    """[sample]: the mean of the middle half of all runs' scores, whatever their tasks; less noisy than a median."""
    return trim_mean(np.concatenate(scores, axis=1), 0.25, axis=1)


def probability_of_improvement(scores: list[np.ndarray], others: list[np.ndarray]) -> np.ndarray:
    """[sample]: how probably a run of the first team beats one of the second on the same task, a tie counting half; the
    mean over tasks. Both lists have the same tasks in the same order."""
    by_task = []
    for ours, theirs in zip(scores, others):
        pairs = np.sign(ours[:, :, None] - theirs[:, None, :])  # [sample, our seed, their seed]
        by_task.append((pairs.mean(axis=(1, 2)) + 1) / 2)
    return np.mean(by_task, axis=0)


def performance_profile(thresholds: np.ndarray) -> Callable[[list[np.ndarray]], np.ndarray]:
    """A measure [sample, threshold]: which share of all runs scores above each threshold."""

    def measure(scores: list[np.ndarray]) -> np.ndarray:
        runs = np.sort(np.concatenate(scores, axis=1), axis=1)
        not_above = np.stack([np.searchsorted(sample, thresholds, side="right") for sample in runs])
        return 1 - not_above / runs.shape[1]

    return measure


def sharing_means(cells: pd.DataFrame) -> pd.DataFrame:
    """Normalised maximum returns by (family, sharing): mean, error (standard error) and count over the pairs of task
    and algorithm that have both; cells as `measures.our_cells`. Range: the maximum returns of all algorithms on the
    task, with and without sharing."""
    chosen = cells[cells["metric"] == "max_return"]
    if "other_budget" in chosen:
        chosen = chosen[~chosen["other_budget"]]
    means = chosen.groupby("task")["mean"]
    low, high = means.transform("min"), means.transform("max")
    chosen = chosen.assign(normalised=(chosen["mean"] - low) / (high - low).where(high > low))
    chosen = chosen.assign(family=chosen["task"].map(family)).dropna(subset=["normalised"])
    both = chosen.groupby(["task", "algorithm"])["sharing"].transform("nunique") == 2
    by_family = chosen[both].groupby(["family", "sharing"])["normalised"]
    return by_family.agg(["mean", "count"]).assign(error=by_family.sem())


def cpu_hours(evaluations: pd.DataFrame) -> pd.DataFrame:
    """CPU hours of the runs with default flags, against either opponent, by (family, algorithm, sharing): runs, total,
    mean."""
    chosen = evaluations[(evaluations["setting"] == PAPER_SETTING) | has_paper_setting(evaluations)]
    runs = chosen.groupby(["family", *KEY, "seed"])["cpu_seconds"].max() / 3600
    return runs.groupby(["family", "algorithm", "sharing"]).agg(runs="count", total="sum", mean="mean")


def hours_of_cells(evaluations: pd.DataFrame) -> dict[tuple[str, str, str], float]:
    """Mean CPU hours of a run by sharing, the paper's task and algorithm; evaluations of the tables."""
    runs = evaluations.groupby(["sharing", "task", "algorithm", "seed"])["cpu_seconds"].max() / 3600
    means = runs.groupby(["sharing", "task", "algorithm"]).mean()
    return {(sharing, paper_task(task), algorithm): mean for (sharing, task, algorithm), mean in means.items()}
