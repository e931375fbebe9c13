"""Reads and writes results: the one module that knows the files of benchmark/results/ and benchmark/paper/.

    results/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...].csv     the seeds' evaluations, a column seed
    results/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...].json    what they were made with:

    algorithm          such as "mappo"
    flags              all flags, but the seed and those of one run only
    changed            the flags that differ from the paper's; {} is the paper's setting and budget
    paper_timesteps    the paper's budget for this algorithm and task
    seeds              for each: commit, version, script, python, versions, machine, fast_mkl, wall and CPU seconds,
                       rows (a hash of its lines in the CSV; results of older versions have none)

The names are for people; programs read the JSON. Both files are replaced at one moment, that of the JSON: before it the
new table is there as .csv.new, and after it this is the table whose lines the JSON names, until it is the CSV.

`load` gives all results as one table, `condition` says what is there of a run, and `collect` puts a complete run into
the results.
"""

import contextlib
import functools
import hashlib
import io
import itertools
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import pandas as pd

import envs
from benchmark import hyperparameters
from envs import InputError, runs
from envs.runs import valid
from envs.runs.flags import NOT_IN_DIRECTORY
from envs.tasks import stand_in

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results"
PAPER = HERE / "paper"

ALGORITHMS = ("iql", "ia2c", "ippo", "maddpg", "coma", "maa2c", "mappo", "vdn", "qmix")  # as in the paper's tables
PAPER_FAMILIES = {"matrix": "Matrix games", "mpe": "MPE", "smac": "SMAC", "lbf": "LBF", "rware": "RWARE"}
FAMILIES = PAPER_FAMILIES | {"smac": "Battles", "other": "Other tasks"}  # ours stand in for SMAC's
PAPER_SEEDS = 5
PAPER_RUNS = 2250  # 9 algorithms, 25 tasks, with and without sharing, 5 seeds
PAPER_CPU_HOURS = 138_916
PAPER_SETTING = "{}"
# In these tasks the paper's teams played against trained networks of its own. Its rows are compared with runs against
# those, which have this fingerprint; runs against our own opponents have tables of their own.
PAPER_OPPONENTS = {"mpe-adversary": "915a50e2ce129bc1", "mpe-tag": "ab8fed43e248e85a"}
# What is known against tasks that stand in for SMAC's, in a few words for their rows; docs/environments/smaclite.md has
# the measurements.
KNOWN_AGAINST = {
    "smaclite-2s_vs_1sc-sc2": "one rule was chosen by the paper's result",
    "smaclite-3s5z-sc2-v2": "SMAC's scripted policy wins 0 to 18 % here, 42 % in StarCraft II",
    "smaclite-corridor-sc2-v2": "SMAC's scripted policy wins 0 to 10 % here, none in StarCraft II",
}
SHARED, INDEPENDENT = "shared", "independent"  # with and without parameter sharing, in names and tables
SHARING = {True: SHARED, False: INDEPENDENT}
KEY = ["task", "algorithm", "sharing", "setting"]
COLUMNS = ["point", "timestep", "wall_seconds", "cpu_seconds", "return_mean", "return_std", "episode_length"]
SECONDS = ["wall_seconds", "cpu_seconds"]
SPEED_COLUMNS = ["task", "whose", "steps_per_second", "processor", "commit"]
PARTS = {
    **{"algorithm": str, "changed": dict, "paper_timesteps": int},
    **{"env": str, "parameter_sharing": bool, "total_timesteps": int},  # these among the flags
}
ORIGIN = ("commit", "version", "script", "python", "versions", "machine", "fast_mkl")  # what is kept of each seed


# --- names ---
@functools.cache
def family(task: str) -> str:
    """The paper's family of a task, whose budgets and hyperparameters it takes; "other" where it is of none."""
    try:
        return envs.task(task).family or "other"
    except InputError:  # a name of another version
        return "other"


@functools.cache
def best_return(task: str) -> float:
    """The most that an episode of a task can return; infinite where no such bound is known."""
    try:
        return envs.task(task).returns[1]
    except InputError:  # a name of another version
        return np.inf


def algorithm_order(algorithms: Iterable[str]) -> list[str]:
    """Algorithms in the order of the paper's tables; those that it does not have, such as your own, behind, by name."""
    there = set(algorithms)
    return [name for name in ALGORITHMS if name in there] + sorted(there.difference(ALGORITHMS))


def paper_task(task: str) -> str:
    """The task of the paper's tables that this one is compared with: itself, or the one that it stands in for."""
    battle = re.fullmatch("smaclite-(.*)-sc2(?:-v2)?", task)  # StarCraft's clock and data without StarCraft
    return f"smac-{battle[1]}" if battle and stand_in(battle[1]) == task else task


def has_older_rules(task: str) -> bool:
    """Whether a task stood in for one of the paper's until newer rules, with a name of their own, took its place."""
    battle = re.fullmatch("smaclite-(.*)-sc2", task)
    return battle is not None and stand_in(battle[1]) != task


def setting_name(changed: dict[str, Any]) -> str:
    """The changed flags as a string that is the same whatever their order."""
    return json.dumps(changed, sort_keys=True)


def table_path(results: Path, algorithm: str, task: str, sharing: str, changed: dict[str, Any]) -> Path:
    """Where the table of these runs stands, without its suffix: .csv holds the evaluations, .json the settings."""
    return results / runs.safe_name(task) / runs.file_name(algorithm, sharing == SHARED, dict(sorted(changed.items())))


# --- reading ---
def read_json(file: Path, more: dict[str, type]) -> dict[str, Any]:
    """The settings of a run or of a table. InputError where a part is missing or of another type than in PARTS.

    more: further parts and their types.
    """
    try:
        said = valid.read_json(file)
    except valid.Invalid as error:
        raise InputError(f"{file} is damaged: {error}") from error
    if not isinstance(said, dict) or not isinstance(said.get("flags"), dict):
        raise InputError(f"{file} is damaged: it has no flags")
    found = said["flags"] | said
    if wrong := [name for name, kind in (PARTS | more).items() if not isinstance(found.get(name), kind)]:
        raise InputError(f"{file} is damaged, or of an older version: what it says of {', '.join(wrong)} is not valid")
    return said


def read_settings(path: Path) -> dict[str, Any]:
    """A table's JSON, path without its suffix; where there is none, that of a table without seeds.

    InputError where it is damaged.
    """
    file = Path(f"{path}.json")
    if not file.exists():
        return {"seeds": {}}
    settings = read_json(file, {"seeds": dict})
    if not all(seed.isdecimal() and isinstance(origin, dict) for seed, origin in settings["seeds"].items()):
        raise InputError(f"{file} is damaged: what it says of its seeds is not valid")
    return settings


def content_of(file: Path) -> bytes:
    """What a CSV holds. InputError for a pipe, for example, which may never end, and for one that is too large."""
    try:
        valid.file_size(file, valid.LARGEST_TABLE)
    except valid.Invalid as error:
        raise InputError(f"{file} is damaged: {error}") from error
    return file.read_bytes()


def parse_evaluations(content: bytes, file: Path, columns: list[str]) -> pd.DataFrame:
    """The evaluations of a run or of a table, as numbers. InputError where they are not as they were written.

    file: that has this content. columns: must be there, with a number in every row. The statistics that a family has
    beyond them may be missing: a game that crashed has none.
    """
    try:
        text = content.decode()
        if not text.endswith("\n"):
            raise ValueError("it does not end with a whole line")
        table = pd.read_csv(io.StringIO(text))
        if missing := [name for name in columns if name not in table]:
            raise ValueError(f"it has no column {', '.join(missing)}")
        numbers = table.to_numpy(float)
        if np.isinf(numbers).any() or table[columns].isna().any(axis=None):
            raise ValueError("it has a number that is missing or infinite")
    except ValueError as error:
        raise InputError(f"{file} is damaged: {str(error).strip()}") from error
    return table


def parse_text(content: bytes) -> pd.DataFrame:
    """A CSV whose values stay the text that they are, so that no digit changes."""
    return pd.read_csv(io.BytesIO(content), dtype=str, keep_default_na=False)


def hash_rows(content: bytes) -> dict[str, str]:
    """Names what a table has of each seed: its lines and the names of its columns."""
    names, *lines = content.splitlines() or [b""]
    rows: dict[bytes, list[bytes]] = {}
    for line in lines:
        rows.setdefault(line.partition(b",")[0], [names]).append(line)
    return {
        seed.decode(errors="replace"): hashlib.sha256(b"\n".join(of_seed)).hexdigest()[:16]
        for seed, of_seed in rows.items()
    }


def read_files(path: Path) -> tuple[dict[str, Any], Path, bytes]:
    """A table's settings, and its evaluations that belong to them: their file and what it holds, nothing where there is
    none. path without its suffix. InputError where there are no such evaluations.

    The file is .csv.new where a collector was killed, or is at work, between its two renames. Another one's next
    renames may come between the readings here, so these are tried again.
    """
    for _ in range(3):
        settings = read_settings(path)
        named = {seed: origin["rows"] for seed, origin in settings["seeds"].items() if "rows" in origin}
        for file in (Path(f"{path}.csv"), Path(f"{path}.csv.new")):
            try:
                content = content_of(file)
            except FileNotFoundError:
                content = b""
            if named.items() <= hash_rows(content).items():
                return settings, file, content
    raise InputError(f"{path}.csv is damaged: it does not hold the evaluations that {path.name}.json names")


def read_table(path: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """A table's settings, and the evaluations of the seeds that they list; path without its suffix.

    InputError where it is damaged: each seed has the points 0, 1, ..., all equally many, up to the budget.
    """
    settings, file, content = read_files(path)
    return settings, check_table(settings, file, content)


def check_table(settings: dict[str, Any], file: Path, content: bytes) -> pd.DataFrame:
    """What `read_table` gives, of files that were read."""
    seeds = sorted(int(seed) for seed in settings["seeds"])
    if not seeds and not content:
        return pd.DataFrame()
    table = parse_evaluations(content, file, ["seed", *COLUMNS])
    table = table[table["seed"].isin(seeds)].sort_values(["seed", "point"])
    if not seeds:
        return table
    points = len(table) // len(seeds)
    if not points or [*zip(table["seed"], table["point"])] != [*itertools.product(seeds, range(points))]:
        raise InputError(f"{file} is damaged: evaluations are missing or there twice")
    if table["timestep"].iloc[points - 1 :: points].min() < settings["flags"]["total_timesteps"]:
        raise InputError(f"{file} is damaged: the last evaluations are missing")
    return table


def load(results: Path = RESULTS) -> pd.DataFrame:
    """All evaluations, a row for each task, algorithm, sharing, setting, seed and point.

    setting is `changed` as text (`json.loads` gives it back); total_timesteps and paper_timesteps are budgets; commit
    is that with which the seed was run. Statistics that a family has beyond the return are columns of their own, NaN
    elsewhere.
    """
    tables = []
    for file in sorted(results.glob("*/*.json")):
        path = file.with_suffix("")
        settings, table = read_table(path)
        flags = settings["flags"]
        columns = {
            "task": flags["env"],
            "family": family(flags["env"]),
            "algorithm": settings["algorithm"],
            "sharing": SHARING[flags["parameter_sharing"]],
            "setting": setting_name(settings["changed"]),
            "total_timesteps": flags["total_timesteps"],
            "paper_timesteps": settings["paper_timesteps"],
            "commit": table["seed"].map({int(k): origin.get("commit") for k, origin in settings["seeds"].items()}),
        }
        tables.append(table.assign(**columns))
    if not tables:
        raise InputError(f"there are no results in {results}")
    return pd.concat(tables, ignore_index=True)


def step_costs(*folders: Path) -> dict[tuple[str, str, str, str], float]:
    """CPU seconds that a timestep took, evaluations included: the mean over the seeds of each setting in these results,
    by task, algorithm, sharing and setting, whose length does not count. InputError where one is damaged."""
    costs: dict[tuple[str, str, str, str], list[float]] = {}
    for file in sorted(file for results in folders for file in results.glob("*/*.json")):
        settings = read_settings(file.with_suffix(""))
        flags = settings["flags"]
        key = flags["env"], settings["algorithm"], SHARING[flags["parameter_sharing"]], trained(settings["changed"])
        spent = [origin["cpu_seconds"] for origin in settings["seeds"].values() if "cpu_seconds" in origin]
        costs.setdefault(key, []).extend(seconds / flags["total_timesteps"] for seconds in spent)
    return {key: sum(each) / len(each) for key, each in costs.items() if each}


def trained(changed: dict[str, Any]) -> str:
    """The setting's name without the flags that say how long a run is."""
    return setting_name({name: value for name, value in changed.items() if name not in NOT_IN_DIRECTORY})


# --- one run ---
@dataclass(frozen=True)
class BenchmarkRun:
    """A run of a script, as the results know it.

    changed: the flags that differ from the paper's, by name, as its config.json has them. directory: where it is kept.
    script: the file that runs.
    """

    algorithm: str
    task: str
    sharing: str
    seed: int
    changed: dict[str, Any]
    directory: Path
    script: Path


class NotComplete(InputError):
    """A run has not reached its end."""


def read_config(directory: Path) -> dict[str, Any]:
    """The config of a run. InputError where it is damaged."""
    return read_json(directory / "config.json", {"seed": int})


def read_run(directory: Path, config: dict[str, Any]) -> pd.DataFrame:
    """The evaluations of a complete run. Raises NotComplete, or InputError where they are damaged."""
    path = directory / "evaluations.csv"
    if not path.exists() or not path.stat().st_size:
        raise NotComplete("it is not complete")
    content = content_of(path)
    numbers = parse_evaluations(content, path, COLUMNS)
    if list(numbers["point"]) != list(range(len(numbers))):
        raise InputError(f"{path} is damaged: evaluations are missing, there twice, or in another order")
    if numbers.empty or numbers["timestep"].iloc[-1] < config["flags"]["total_timesteps"]:
        raise NotComplete("it is not complete")
    planned = config["flags"].get("eval_points", len(numbers))
    if len(numbers) != planned and "total_timesteps" not in config["changed"]:
        raise InputError(
            f"it was lengthened to the paper's budget and has {len(numbers)} evaluations instead of {planned}, so its "
            "best one does not compare with that of other runs"
        )
    return parse_text(content)


def has(run: BenchmarkRun, results: Path) -> bool:
    """Whether the results hold this run. InputError for a damaged table, and where `check_script` raises it."""
    path = table_path(results, run.algorithm, run.task, run.sharing, run.changed)
    settings, _ = read_table(path)
    there = str(run.seed) in settings["seeds"] and settings["changed"] == run.changed
    if there:
        check_script(path, run.algorithm, runs.script_hash(run.script), settings["seeds"].values())
    return there


def check_script(path: Path, algorithm: str, script: str | None, origins: Iterable[dict[str, Any]]) -> None:
    """InputError where the seeds of a table were made with another text of an algorithm of one's own.

    The nine scripts compute the same from version to version, and only their comments change.
    """
    if algorithm not in ALGORITHMS and any(origin.get("script") != script for origin in origins):
        raise InputError(
            f"{path}.csv holds runs of another text of {algorithm}.py: give the new one another name, or keep its "
            "results elsewhere with --results"
        )


def condition(run: BenchmarkRun, results: Path) -> tuple[str, tuple[dict[str, Any], pd.DataFrame] | None]:
    """What is there of a run: "in the results", "complete" (but not collected), "begun" or "new"; of a complete one
    also its config and its evaluations.

    InputError where its table of the results is damaged, or its directory holds a damaged or another run.
    """
    if has(run, results):
        return "in the results", None
    if not (run.directory / "config.json").exists():
        return "new", None
    config = read_config(run.directory)
    there, wanted = config["changed"] | {"seed": config["flags"]["seed"]}, run.changed | {"seed": run.seed}
    different = sorted(name for name in there.keys() | wanted.keys() if there.get(name) != wanted.get(name))
    if different:
        raise InputError(
            f"{run.directory} holds a run with another {', '.join(different)}: move it away, or keep the campaign's "
            "runs elsewhere with --runs"
        )
    try:
        return "complete", (config, read_run(run.directory, config))
    except NotComplete:
        return "begun", None


def bring_in(run: BenchmarkRun, results: Path) -> str:
    """The `condition` of a run after a complete one has been collected: "in the results", "begun" or "new".

    InputError as there, and where a complete run cannot be collected.
    """
    there, complete = condition(run, results)
    if complete is None:
        return there
    try:
        put_in(*complete, results)
    except (InputError, OSError) as error:  # InputError: it does not fit to the other seeds
        raise InputError(f"complete, but not collected: {error} ({run.directory})") from error
    return "in the results"


def collect(directory: Path, results: Path = RESULTS, replace: bool = False) -> Path:
    """Puts the complete run of a directory into the results, as `put_in`. Raises InputError where there is none."""
    config = read_config(directory)
    return put_in(config, read_run(directory, config), results, replace)


def put_in(config: dict[str, Any], rows: pd.DataFrame, results: Path, replace: bool = False) -> Path:
    """Puts a complete run into the results; gives the path of its table.

    Raises InputError, one sentence, where the run does not fit, and OSError where it cannot be written; the results
    then are as they were. Several processes may collect into the same folder. One that is killed leaves the results as
    they were, or with the whole run.
    """
    flags = config["flags"]
    hyperparameters.check(config["algorithm"], flags, config["changed"])
    path = table_path(
        results, config["algorithm"], flags["env"], SHARING[flags["parameter_sharing"]], config["changed"]
    )
    table_file, settings_file = Path(f"{path}.csv"), Path(f"{path}.json")
    with lock(results):
        settings, file, content = read_files(path)
        check_table(settings, file, content)
        if file != table_file:  # a collector was killed
            runs.put(file, table_file)
        table = parse_text(content) if content else pd.DataFrame({"seed": []})
        seed = str(flags["seed"])
        if not settings["seeds"] and set(table["seed"]) - {seed}:
            raise InputError(
                f"{table_file} holds other seeds, but {settings_file.name}, which lists them, is missing: bring it "
                "back, or move the table away and collect all seeds again"
            )
        if seed in settings["seeds"] and not replace:
            there = table.loc[table["seed"] == seed, "return_mean"]
            if list(there) != list(rows["return_mean"]):
                origin = settings["seeds"][seed].get("commit")
                raise InputError(f"{table_file} has a seed {seed} with other returns, made with commit {origin}")
        settings, table = merge(path, settings, table, config, rows)
        content = table.to_csv(index=False, lineterminator="\n").encode()
        hashes = hash_rows(content)
        for number, origin in settings["seeds"].items():
            origin["rows"] = hashes[number]
        table_file.parent.mkdir(exist_ok=True)
        new = Path(f"{path}.csv.new")
        runs.write_new(new, content)
        try:
            runs.write_whole(settings_file, json.dumps(settings, indent=2) + "\n")
        except OSError:
            new.unlink()
            raise
        with contextlib.suppress(OSError):  # on Windows, where a spreadsheet has it open; the next collector does it
            runs.put(new, table_file)
    return table_file


def lock(results: Path) -> filelock.BaseFileLock:
    """Held by who changes these results. OSError where the folder cannot be written."""
    results.mkdir(parents=True, exist_ok=True)
    (results / ".lock").touch()
    return filelock.FileLock(results / ".lock")


def merge(
    path: Path, settings: dict[str, Any], table: pd.DataFrame, config: dict[str, Any], rows: pd.DataFrame
) -> tuple[dict[str, Any], pd.DataFrame]:
    """The settings and the table with one seed more.

    Raises InputError where it differs from the other seeds in its flags, its columns, the number of its evaluations or,
    for an algorithm of one's own, its script.
    """
    seed = str(config["flags"]["seed"])
    alone = set(settings["seeds"]) <= {seed}  # there is nothing else that it has to fit to
    known, flags = (
        {name: value for name, value in some.items() if name not in runs.OF_ONE_RUN}
        for some in ({} if alone else settings["flags"], config["flags"])
    )
    different = sorted(name for name in known.keys() & flags.keys() if known[name] != flags[name])
    if settings.get("changed", config["changed"]) != config["changed"]:
        different.append("choice of changed flags")
    if different:
        raise InputError(f"the seeds that are there were made with another {', '.join(different)}")
    others = table[table["seed"] != seed]
    if len(others) and len(others) != len(rows) * others["seed"].nunique():
        raise InputError(f"it has {len(rows)} evaluations, unlike the seeds that are there")
    if len(others) and list(others.columns) != ["seed", *rows.columns]:
        raise InputError(f"it has the columns {', '.join(rows.columns)}, unlike the seeds that are there")
    older = [origin for number, origin in settings["seeds"].items() if number != seed]
    check_script(path, config["algorithm"], config.get("script"), older)
    last = rows.iloc[-1]
    origin = {name: config.get(name) for name in ORIGIN} | {name: round(float(last[name]), 1) for name in SECONDS}
    seeds = settings["seeds"] | {seed: origin}
    merged = settings | {
        "algorithm": config["algorithm"],
        "flags": known | flags,
        "changed": config["changed"],
        "paper_timesteps": config["paper_timesteps"],
        "seeds": {name: seeds[name] for name in sorted(seeds, key=int)},
    }
    rows = rows.assign(**{name: [f"{float(value):.1f}" for value in rows[name]] for name in SECONDS})
    rows.insert(0, "seed", seed)
    both = pd.concat([others, rows]) if len(others) else rows
    return merged, both.sort_values(["seed", "point"], key=pd.to_numeric)


# --- the paper's tables, and speeds ---
def paper_cells() -> pd.DataFrame:
    """The paper's tables, a row for each cell: metric (max_return, average_return, max_win_rate), sharing ("shared" or
    "independent"), task, algorithm, mean, interval, seeds, mark ("best", "not significantly different" or nothing)."""
    table = pd.read_csv(PAPER / "returns.csv", keep_default_na=False)
    table = table.assign(sharing=(table["parameter_sharing"] == "yes").map(SHARING), seeds=PAPER_SEEDS)
    return table.rename(columns={"ci95": "interval"}).drop(columns="parameter_sharing")


def read_speeds(file: Path) -> pd.DataFrame:
    """What `time_stepping.py --output` has written into a CSV. InputError where the file holds something else."""
    if not file.exists():
        return pd.DataFrame(columns=SPEED_COLUMNS)
    try:
        table = pd.read_csv(file)
        if list(table) != SPEED_COLUMNS:
            raise ValueError(f"its columns are not {', '.join(SPEED_COLUMNS)}")
        pd.to_numeric(table["steps_per_second"])
    except ValueError as error:
        raise InputError(f"{file} is not a table of time_stepping.py: {str(error).strip()}") from error
    return table


def keep_speeds(file: Path, task: str, speeds: dict[str, float], origin: dict[str, Any]) -> None:
    """Puts the speeds of a task into the CSV, in place of those that it has, with the processor and the commit."""
    rows = pd.DataFrame({"task": task, "whose": list(speeds), "steps_per_second": map(round, speeds.values())})
    rows = rows.assign(processor=origin["machine"]["processor"], commit=origin["commit"])[SPEED_COLUMNS]
    with lock(file.parent):
        there = read_speeds(file)
        others = there[there["task"] != task]
        rows = pd.concat([others, rows]) if len(others) else rows
        runs.write_whole(file, rows.to_csv(index=False, lineterminator="\n"))


def paper_speeds() -> pd.Series:
    """The paper's environment steps per second, by its task."""
    table = pd.read_csv(PAPER / "env_speed.csv", index_col="task")
    return 10_000 / table["seconds_per_10000_steps"]


def speeds(results: Path = RESULTS) -> pd.DataFrame:
    """Simulation speeds: task, family, whose ("the paper", "original package", "ours, num_envs=10"),
    steps_per_second. Ours and the original packages' are from `time_stepping.py --output`, the paper's of the same
    tasks."""
    measured = read_speeds(results / "stepping.csv")
    paper = paper_speeds().rename("steps_per_second").reset_index().assign(whose="the paper")
    paper = paper[paper["task"].isin(measured["task"].map(paper_task))]
    is_ours = measured["whose"].str.startswith("ours")
    both = pd.concat([paper, measured[~is_ours], measured[is_ours]])[["task", "whose", "steps_per_second"]]
    return both.assign(family=both["task"].map(family))
