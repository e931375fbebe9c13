"""What benchmark/results/ and benchmark/paper/ hold, as pandas tables. Everything that reads a result reads it here.

    results/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...].csv     the seeds' evaluations, a column seed
    results/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...].json    what they were made with:

    algorithm          such as "mappo"
    flags              all flags, but the seed and those of one run only
    changed            the flags that differ from the paper's; {} is the paper's setting and budget
    paper_timesteps    the paper's budget for this algorithm and task
    seeds              for each: commit, version, script, python, versions, machine, fast_mkl, wall and CPU seconds

The names are for people; programs read the JSON. A seed counts once the JSON lists it, so the CSV is written first.
"""

import functools
import hashlib
import io
import itertools
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import envs
from envs.runs import renewed_config

HERE = Path(__file__).resolve().parents[1]
RESULTS = HERE / "results"
PAPER = HERE / "paper"

ALGORITHMS = ("iql", "ia2c", "ippo", "maddpg", "coma", "maa2c", "mappo", "vdn", "qmix")  # as in the paper's tables
PAPER_FAMILIES = {"matrix": "Matrix games", "mpe": "MPE", "smac": "SMAC", "lbf": "LBF", "rware": "RWARE"}
FAMILIES = PAPER_FAMILIES | {"other": "Other tasks"}
PAPER_SEEDS = 5
PAPER_RUNS = 2250  # 9 algorithms, 25 tasks, with and without sharing, 5 seeds
PAPER_CPU_HOURS = 138_916
PAPER_SETTING = "{}"
# In these tasks the paper's teams played against trained networks of its own. Its rows are compared with runs against
# those, which have this fingerprint; runs against our own opponents have tables of their own.
PAPER_OPPONENTS = {"mpe-adversary": "915a50e2ce129bc1", "mpe-tag": "ab8fed43e248e85a"}
KEY = ["task", "algorithm", "sharing", "setting"]
COLUMNS = ["point", "timestep", "wall_seconds", "cpu_seconds", "return_mean", "return_std", "episode_length"]
SPEED_COLUMNS = ["task", "whose", "steps_per_second", "processor", "commit"]
PARTS = {
    **{"algorithm": str, "changed": dict, "paper_timesteps": int},
    **{"env": str, "parameter_sharing": bool, "total_timesteps": int},  # these among the flags
}
LONGEST_NAME = 200  # file systems stop at 255


@functools.cache
def family(task: str) -> str:
    """The paper's family of a task, whose budgets and hyperparameters it takes; "other" where it is of none."""
    try:
        return envs.task(task).family or "other"
    except envs.InputError:  # a name of another version
        return "other"


def algorithm_order(algorithms: Iterable[str]) -> list[str]:
    """Algorithms in the order of the paper's tables; those that it does not have, such as your own, behind, by name."""
    there = set(algorithms)
    return [name for name in ALGORITHMS if name in there] + sorted(there.difference(ALGORITHMS))


def paper_task(task: str) -> str:
    """The task of the paper's tables that this one is compared with: itself, or the one that it stands in for."""
    stand_in = re.fullmatch("smaclite-(.*)-sc2", task)  # StarCraft's clock and data without StarCraft
    return f"smac-{stand_in[1]}" if stand_in else task


def setting_name(changed: dict[str, Any]) -> str:
    """The changed flags as a string that is the same whatever their order."""
    return json.dumps(changed, sort_keys=True)


def table_path(results: Path, algorithm: str, task: str, sharing: bool, changed: dict[str, Any]) -> Path:
    """Where the table of these runs stands, without its suffix: .csv holds the evaluations, .json the settings."""
    name = f"{algorithm}-{'shared' if sharing else 'independent'}"
    for flag, value in sorted(changed.items()):
        name += f"-{flag.replace('_', '-')}={value}"
    if len(name) > LONGEST_NAME:  # not `safe_name`, which cuts otherwise: older results would not be found
        name = f"{name[:LONGEST_NAME]}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    safe_task, safe_name = (re.sub(r"[^A-Za-z0-9_.=-]", "_", part) for part in (task, name))
    return results / safe_task / safe_name


def read_json(file: Path, more: dict[str, type]) -> dict[str, Any]:
    """The settings of a run or of a table, in the words of this version. ValueError where a part is missing or of
    another type than in PARTS.

    more: further parts and their types.
    """
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file} is damaged: {error}") from error
    if not isinstance(said, dict) or not isinstance(said.get("flags"), dict):
        raise ValueError(f"{file} is damaged: it has no flags")
    found = said["flags"] | said
    if wrong := [name for name, kind in (PARTS | more).items() if not isinstance(found.get(name), kind)]:
        raise ValueError(f"{file} is damaged, or of an older version: what it says of {', '.join(wrong)} is not valid")
    return renewed_config(said)


def read_settings(path: Path) -> dict[str, Any]:
    """A table's JSON, path without its suffix; where there is none, that of a table without seeds.

    ValueError where it is damaged.
    """
    file = Path(f"{path}.json")
    if not file.exists():
        return {"seeds": {}}
    settings = read_json(file, {"seeds": dict})
    if not all(seed.isdecimal() and isinstance(origin, dict) for seed, origin in settings["seeds"].items()):
        raise ValueError(f"{file} is damaged: what it says of its seeds is not valid")
    return settings


def read_evaluations(file: Path, columns: list[str]) -> pd.DataFrame:
    """The evaluations of a run or of a table, as numbers. ValueError where they are not as they were written.

    columns: must be there, with a number in every row. The statistics that a family has beyond them may be missing:
    a game that crashed has none.
    """
    try:
        text = file.read_text(encoding="utf-8")
        if not text.endswith("\n"):
            raise ValueError("it does not end with a whole line")
        table = pd.read_csv(io.StringIO(text))
        if missing := [name for name in columns if name not in table]:
            raise ValueError(f"it has no column {', '.join(missing)}")
        numbers = table.to_numpy(float)
        if np.isinf(numbers).any() or table[columns].isna().any(axis=None):
            raise ValueError("it has a number that is missing or infinite")
    except ValueError as error:
        raise ValueError(f"{file} is damaged: {str(error).strip()}") from error
    return table


def read_table(path: Path, settings: dict[str, Any]) -> pd.DataFrame:
    """A table's evaluations of the seeds that its settings list; path without its suffix.

    ValueError where it is damaged: each seed has the points 0, 1, ..., all equally many, up to the budget.
    """
    if not settings["seeds"]:
        return pd.DataFrame()
    file = Path(f"{path}.csv")
    table = read_evaluations(file, ["seed", *COLUMNS])
    seeds = sorted(int(seed) for seed in settings["seeds"])
    table = table[table["seed"].isin(seeds)].sort_values(["seed", "point"])
    points = len(table) // len(seeds)
    if not points or [*zip(table["seed"], table["point"])] != [*itertools.product(seeds, range(points))]:
        raise ValueError(f"{file} is damaged: evaluations are missing or there twice")
    if table["timestep"].iloc[points - 1 :: points].min() < settings["flags"]["total_timesteps"]:
        raise ValueError(f"{file} is damaged: the last evaluations are missing")
    return table


def has_seed(
    results: Path, algorithm: str, task: str, sharing: bool, changed: dict[str, Any], seed: int, script: str
) -> bool:
    """Whether the results hold this run; `changed` and `script` as its config.json would have them. ValueError for a
    damaged table, and where `check_script` raises it."""
    path = table_path(results, algorithm, task, sharing, changed)
    settings = read_settings(path)
    read_table(path, settings)
    there = str(seed) in settings["seeds"] and settings["changed"] == changed
    if there:
        check_script(path, algorithm, script, settings["seeds"].values())
    return there


def check_script(path: Path, algorithm: str, script: str | None, origins: Iterable[dict[str, Any]]) -> None:
    """ValueError where the seeds of a table were made with another text of an algorithm of one's own.

    The nine scripts compute the same from version to version, and only their comments change.
    """
    if algorithm not in ALGORITHMS and any(origin.get("script") != script for origin in origins):
        raise ValueError(
            f"{path}.csv holds runs of another text of {algorithm}.py: give the new one another name, or keep its "
            "results elsewhere with --results"
        )


def load(results: Path = RESULTS) -> pd.DataFrame:
    """All evaluations, a row for each task, algorithm, sharing, setting, seed and point.

    setting is `changed` as text (`json.loads` gives it back); total_timesteps and paper_timesteps are budgets.
    Statistics that a family has beyond the return are columns of their own, NaN elsewhere.
    """
    tables = []
    for file in sorted(results.glob("*/*.json")):
        path = file.with_suffix("")
        settings = read_settings(path)
        flags = settings["flags"]
        table = read_table(path, settings)
        columns = {
            "task": flags["env"],
            "family": family(flags["env"]),
            "algorithm": settings["algorithm"],
            "sharing": flags["parameter_sharing"],
            "setting": setting_name(settings["changed"]),
            "total_timesteps": flags["total_timesteps"],
            "paper_timesteps": settings["paper_timesteps"],
        }
        tables.append(table.assign(**columns))
    if not tables:
        raise ValueError(f"there are no results in {results}")
    return pd.concat(tables, ignore_index=True)


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


def paper_cells() -> pd.DataFrame:
    """The paper's tables, a row for each cell: metric (max_return, average_return, max_win_rate), sharing (bool), task,
    algorithm, mean, interval, seeds, mark ("best", "not significantly different" or nothing)."""
    table = pd.read_csv(PAPER / "returns.csv", keep_default_na=False)
    table = table.assign(sharing=table["parameter_sharing"] == "yes", seeds=PAPER_SEEDS)
    return table.rename(columns={"ci95": "interval"}).drop(columns="parameter_sharing")


def read_speeds(file: Path) -> pd.DataFrame:
    """What `time_stepping.py --output` has written into a CSV. ValueError where the file holds something else."""
    if not file.exists():
        return pd.DataFrame(columns=SPEED_COLUMNS)
    try:
        table = pd.read_csv(file)
        if list(table) != SPEED_COLUMNS:
            raise ValueError(f"its columns are not {', '.join(SPEED_COLUMNS)}")
        pd.to_numeric(table["steps_per_second"])
    except ValueError as error:
        raise ValueError(f"{file} is not a table of time_stepping.py: {str(error).strip()}") from error
    return table


def speeds(results: Path = RESULTS) -> pd.DataFrame:
    """Simulation speeds: task, family, whose ("the paper", "original package", "ours, num_envs=10"),
    steps_per_second. Ours and the original packages' are from `time_stepping.py --output`, the paper's of the same
    tasks."""
    measured = read_speeds(results / "stepping.csv")
    paper = pd.read_csv(PAPER / "env_speed.csv")
    paper = paper.assign(whose="the paper", steps_per_second=10_000 / paper["seconds_per_10000_steps"])
    paper = paper[paper["task"].isin(measured["task"].map(paper_task))]
    is_ours = measured["whose"].str.startswith("ours")
    both = pd.concat([paper, measured[~is_ours], measured[is_ours]])[["task", "whose", "steps_per_second"]]
    return both.assign(family=both["task"].map(family))


def paper_setting(task: str) -> dict[str, Any]:
    """The changed flags of the runs that the paper's rows are compared with: none, or its own opponent."""
    return {"env_kwargs": f"opponent='{PAPER_OPPONENTS[task]}'"} if task in PAPER_OPPONENTS else {}


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
