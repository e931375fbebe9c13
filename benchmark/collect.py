"""Collects complete runs into benchmark/results/, one table for all seeds of a task, algorithm and setting.

    python benchmark/collect.py [runs] [--results benchmark/results] [--replace]

Runs are found by their config.json, anywhere below the folder. A run is complete when its last evaluation stands at its
budget. What the results hold already stays: a seed with other numbers is refused, or takes the old one's place with
--replace. All seeds of a table have equally many evaluations, and for an algorithm of one's own the same script: a run
that was lengthened keeps its old distances, and may not fit. `reporting/results.py` says what the tables hold.

Of the runs that go into benchmark/results/, the last team of each task's best algorithm (seed 0, with sharing, by the
return at the last evaluation) is kept in benchmark/teams/<task>/, where --watch and `load` find it.
"""

import argparse
import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import filelock
import pandas as pd

from envs import runs
from envs.runs import one_sentence
from reporting.results import (
    COLUMNS,
    RESULTS,
    check_script,
    read_evaluations,
    read_json,
    read_settings,
    read_table,
    table_path,
)

SECONDS = ["wall_seconds", "cpu_seconds"]
ORIGIN = ("commit", "version", "script", "python", "versions", "machine", "fast_mkl")


class NotComplete(ValueError):
    """A run has not reached its end."""

    def __init__(self) -> None:
        super().__init__("it is not complete")


def read_text(path: Path) -> pd.DataFrame:
    """A CSV whose values stay the text that they are, so that no digit changes."""
    return pd.read_csv(path, dtype=str, keep_default_na=False)


def read_run(directory: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """The config and the evaluations of a complete run. Raises NotComplete, or ValueError where they are damaged."""
    config = read_json(directory / "config.json", {"seed": int})
    path = directory / "evaluations.csv"
    if not path.exists() or not path.stat().st_size:
        raise NotComplete
    numbers = read_evaluations(path, COLUMNS)
    if list(numbers["point"]) != list(range(len(numbers))):
        raise ValueError(f"{path} is damaged: evaluations are missing, there twice, or in another order")
    if numbers.empty or numbers["timestep"].iloc[-1] < config["flags"]["total_timesteps"]:
        raise NotComplete
    planned = config["flags"].get("eval_points", len(numbers))
    if len(numbers) != planned and "total_timesteps" not in config["changed"]:
        raise ValueError(
            f"it was lengthened to the paper's budget and has {len(numbers)} evaluations instead of {planned}, so its "
            "best one does not compare with that of other runs"
        )
    return config, read_text(path)


def merge(
    path: Path, settings: dict[str, Any], table: pd.DataFrame, config: dict[str, Any], rows: pd.DataFrame
) -> pd.DataFrame:
    """The table with one seed more; its origin is noted in the settings.

    Raises ValueError where it differs from the other seeds in its flags, its columns, the number of its evaluations or,
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
        raise ValueError(f"the seeds that are there were made with another {', '.join(different)}")
    others = table[table["seed"] != seed] if len(table) else table
    if len(others) and len(others) != len(rows) * others["seed"].nunique():
        raise ValueError(f"it has {len(rows)} evaluations, unlike the seeds that are there")
    if len(others) and list(others.columns) != ["seed", *rows.columns]:
        raise ValueError(f"it has the columns {', '.join(rows.columns)}, unlike the seeds that are there")
    last = rows.iloc[-1]
    older = [origin for number, origin in settings["seeds"].items() if number != seed]
    check_script(path, config["algorithm"], config.get("script"), older)
    origin = {name: config.get(name) for name in ORIGIN}
    if "preloaded" in config:  # older runs named the library
        origin["fast_mkl"] = "fast-mkl.so" in config["preloaded"]
    origin |= {name: round(float(last[name]), 1) for name in SECONDS}
    seeds = settings["seeds"] | {seed: origin}
    settings["algorithm"] = config["algorithm"]
    settings["flags"] = known | flags
    settings["changed"] = config["changed"]
    settings["paper_timesteps"] = config["paper_timesteps"]
    settings["seeds"] = {name: seeds[name] for name in sorted(seeds, key=int)}
    rows = rows.assign(**{name: [f"{float(value):.1f}" for value in rows[name]] for name in SECONDS})
    rows.insert(0, "seed", seed)
    both = pd.concat([others, rows]) if len(others) else rows
    return both.sort_values(["seed", "point"], key=pd.to_numeric)


def collect_run(directory: Path, results: Path = RESULTS, replace: bool = False) -> Path:
    """Puts a complete run into the results; gives the path of its table.

    Raises ValueError, one sentence, where the run does not fit, and OSError where it cannot be written; the results
    then are as they were. Several processes may collect into the same folder.
    """
    config, rows = read_run(directory)
    flags = config["flags"]
    path = table_path(results, config["algorithm"], flags["env"], flags["parameter_sharing"], config["changed"])
    table_file, settings_file = Path(f"{path}.csv"), Path(f"{path}.json")
    results.mkdir(parents=True, exist_ok=True)
    with filelock.FileLock(results / ".lock"):
        settings = read_settings(path)
        read_table(path, settings)  # ValueError where it is damaged
        table = pd.DataFrame({"seed": []})
        if table_file.exists():
            read_evaluations(table_file, ["seed", *COLUMNS])  # the same where the settings are missing
            table = read_text(table_file)
        seed = str(flags["seed"])
        if not settings["seeds"] and set(table["seed"]) - {seed}:
            raise ValueError(
                f"{table_file} holds other seeds, but {settings_file.name}, which lists them, is missing: bring it "
                "back, or move the table away and collect all seeds again"
            )
        if seed in settings["seeds"] and not replace:
            there = table.loc[table["seed"] == seed, "return_mean"]
            if list(there) != list(rows["return_mean"]):
                origin = settings["seeds"][seed].get("commit")
                raise ValueError(f"{table_file} has a seed {seed} with other returns, made with commit {origin}")
        table = merge(path, settings, table, config, rows)
        text = io.StringIO()
        table.to_csv(text, index=False, lineterminator="\n")
        table_file.parent.mkdir(exist_ok=True)
        runs.write_whole(table_file, text.getvalue())
        runs.write_whole(settings_file, json.dumps(settings, indent=2) + "\n")
    return table_file


def run_directories(folder: Path) -> Iterator[Path]:
    """The directories of runs below a folder, also behind symbolic links; each once."""
    known: set[Path] = set()
    for place, folders, files in os.walk(folder, followlinks=True):
        if (real := Path(place).resolve()) in known:
            folders.clear()
            continue
        known.add(real)
        if "config.json" in files:
            yield Path(place)


@one_sentence(__file__)
def main() -> None:
    """Collects what is complete, and says what was left out. Exit code 2 if something is wrong with a run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="?", type=Path, default=Path("runs"), help="a folder with runs; default: runs")
    parser.add_argument("--results", type=Path, default=RESULTS, help="the tables; default: benchmark/results")
    parser.add_argument("--replace", action="store_true", help="a seed that is there already is replaced")
    args = parser.parse_args()
    directories = sorted(run_directories(args.runs))
    if not directories:
        parser.error(f"there are no runs in {args.runs}")
    wrong, collected = False, []
    for directory in directories:
        try:
            table_file = collect_run(directory, args.results, args.replace)
        except (ValueError, OSError) as error:  # not complete, other flags, a damaged file, a full disk
            print(f"{directory}: left out, {error}", file=sys.stderr)
            wrong |= not isinstance(error, NotComplete)
        else:
            print(f"{directory}: in {table_file}")
            collected.append(directory)
    if collected and args.results == RESULTS:
        from campaign import teams  # imports PyTorch

        returns = teams.last_returns()
        kept = {teams.keep_team(directory, returns): directory for directory in collected}
        for place in filter(None, kept):
            print(f"{kept[place]}: its team is in {place}")
    if wrong:
        sys.exit(2)


if __name__ == "__main__":
    main()
