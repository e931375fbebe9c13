"""All that the site knows of results. This is the only module here that imports the programs of benchmark/."""

import json
import math
import shlex
from functools import lru_cache
from pathlib import Path

import pandas as pd

import envs
from benchmark import measures, store, tables
from benchmark.plots import COLOURS
from benchmark.report import Report

ROOT = Path(__file__).resolve().parents[2]
ALGORITHMS = store.ALGORITHMS
FAMILIES = store.PAPER_FAMILIES
RESULTS = store.RESULTS
OTHER_COLOUR = "#666666"
TITLES = tables.TITLES


@lru_cache
def report() -> Report:
    """Everything that report.py writes is made of this."""
    return Report(RESULTS)


def paper_tasks() -> list[str]:
    """The paper's tasks, as they are called here, in the order of its tables."""
    from envs.tasks import PAPER_TASKS

    return tables.in_order(pd.Series(PAPER_TASKS))


def colour(algorithm: str) -> str:
    """Of the algorithm's curves, everywhere."""
    return COLOURS.get(algorithm, OTHER_COLOUR)


def against(task: str) -> str:
    """The opponent of the paper's row of a task, to be put behind its name, where it is not the task's own."""
    return measures.against(task)


def beside(task: str) -> str:
    """What the paper's row of a task adds to its name."""
    return measures.beside(task)


@lru_cache
def curves() -> pd.DataFrame:
    """The learning curves that tables show: task, algorithm, sharing, point, timestep, mean, interval, seeds, budget,
    other_budget.

    interval: 2 s / sqrt(n) over n seeds; NaN for a single one.
    """
    shown = report().shown
    groups = shown.groupby(["task", "algorithm", "sharing", "point"])
    table = groups.agg(
        timestep=("timestep", "mean"),
        mean=("return_mean", "mean"),
        deviation=("return_mean", "std"),
        seeds=("return_mean", "count"),
        budget=("total_timesteps", "max"),
        other_budget=("other_budget", "any"),
    )
    return table.assign(interval=measures.interval(table["deviation"], table["seeds"])).reset_index()


def bounds(task: str) -> tuple[float | None, ...]:
    """The lowest and the highest return that an episode can have; None where the game has no such bound."""
    return tuple(value if math.isfinite(value) else None for value in envs.task(task).returns)


def seeds() -> pd.Series:
    """How many seeds there are, by task, algorithm and sharing."""
    return curves().groupby(["task", "algorithm", "sharing"])["seeds"].max()


def cells(metric: str) -> pd.DataFrame:
    """Our cells of one of the paper's tables, with the paper's beside them; see `tables.compare`."""
    both = report().both
    return both[both["metric"] == metric]


@lru_cache
def paper_values(metric: str) -> dict[tuple[str, str, str], tuple[float, float]]:
    """The paper's mean and interval by our task, algorithm and sharing."""
    table = report().paper
    chosen = table[table["metric"] == metric]
    known = {(row.task, row.algorithm, row.sharing): (row.mean, row.interval) for row in chosen.itertuples()}
    ours = {store.paper_task(task): task for task in paper_tasks()}
    return {(ours[task], *key): value for (task, *key), value in known.items() if task in ours}


@lru_cache
def tables_of_results() -> dict[tuple[str, str, str], tuple[Path, dict]]:
    """The table behind each cell: its path without the suffix, and the flags that differ from the paper's."""
    shown = report().shown
    found = {}
    for task, algorithm, sharing, setting in (
        shown[["task", "algorithm", "sharing", "setting"]].drop_duplicates().itertuples(index=False, name=None)
    ):
        changed = json.loads(setting)
        path = store.table_path(RESULTS, algorithm, task, sharing, changed)
        found[task, algorithm, sharing] = path, changed
    return found


# What must be run once before a command that names a file of this folder.
OPPONENTS_COMMAND = "python examples/paper_opponents.py adv_params.pt prey_params.pt --output opponents"


def campaign(algorithm: str, task: str, sharing: str, changed: dict, seeds: int) -> str:
    """The command that makes a cell. The paper's opponents, which results name by a fingerprint, are the files that
    `OPPONENTS_COMMAND` makes."""
    words = [f"python benchmark/run.py --algorithms {algorithm} --tasks {task} --seeds {seeds}"]
    if sharing != store.SHARED:
        words.append(f"--sharing {sharing}")
    if changed:
        words.append("--")
    for name, value in sorted(changed.items()):
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            text = str(value).replace(store.PAPER_OPPONENTS.get(task, "?"), f"opponents/paper-{task[4:]}.npz")
            words.append(f"--{flag} {shlex.quote(text)}")
    return " ".join(words)


@lru_cache
def verdicts() -> list[tuple[str, str, str, str, list[str]]]:
    """The paper's claims: section, sentence, verdict by the paper's tables, by our results, and what is behind this."""
    found = []
    for claim, paper, ours in report().verdicts():
        behind = [f"holds in {ours.shares} of the completed tables", ours.figures, ours.rests_on]
        behind += [f"without stand-ins: {ours.alone}"] if ours.alone else []
        found.append((claim.place, claim.sentence, paper.verdict, ours.verdict, behind))
    return found


def one_command(algorithm: str) -> str:
    """The shortest of the paper's trainings, what it returned at its end, and its time."""
    task = "matrix-climbing"
    table = report().shown
    table = table[(table["task"] == task) & (table["algorithm"] == algorithm) & (table["sharing"] == store.SHARED)]
    if table.empty:
        return f"`python algos/{algorithm}.py --env {task}`"
    last = table[table["point"] == table["point"].max()]
    minutes = last["cpu_seconds"] / 60
    return (
        f"`python algos/{algorithm}.py --env {task}`: {last['return_mean'].mean():.0f} at the end, the mean of "
        f"{len(last)} seeds (275 is the most that the game gives); {last['timestep'].mean() / 1e6:g} million steps in "
        f"{minutes.min():.1f} to {minutes.max():.1f} minutes of one CPU core"
    )
