"""Collects complete runs into benchmark/results/, one table for all seeds of a task, algorithm and setting.

    python benchmark/collect.py [runs] [--results benchmark/results] [--replace]

Runs are found by their config.json, anywhere below the folder. A run is complete when its last evaluation stands at its
budget. What the results hold already stays: a seed with other numbers is refused, or takes the old one's place with
--replace. All seeds of a table have equally many evaluations, and for an algorithm of one's own the same script: a run
that was lengthened keeps its old distances, and may not fit. `store.py` says what the tables hold.

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

if not __package__:  # as a program, from any folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark  # isort: skip  # noqa: F401 (says which packages are missing, before one is imported)
import pandas as pd

import envs
from benchmark import store
from benchmark.measures import our_cells
from envs.runs import Parser, one_sentence, read_checkpoint, safe_name, write_whole

TEAMS = store.HERE / "teams"
OF_A_MACHINE = ("command", "machine")  # what config.json says of no use elsewhere


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


def last_returns(results: Path = store.RESULTS) -> pd.Series:
    """Mean returns at the last evaluation by (task, algorithm), with sharing and the paper's setting."""
    cells = our_cells(store.load(results))
    chosen = cells[(cells["metric"] == "last_return") & (cells["sharing"] == store.SHARED) & ~cells["other_budget"]]
    return chosen.set_index(["task", "algorithm"])["mean"]


def keep_team(directory: Path, returns: pd.Series, teams: Path = TEAMS) -> Path | None:
    """Keeps the team of a complete run as teams/<task>, if it is of seed 0 with sharing, one of the paper's tasks and
    setting, its algorithm is the best on this task, and that of the team which is there is not as good.

    returns: `last_returns`. Gives the team's place, None where it was not kept. InputError where the run has no
    checkpoint that can be read.
    """
    config = json.loads((directory / "config.json").read_text(encoding="utf-8"))
    flags, algorithm = config["flags"], config["algorithm"]
    task, place = flags["env"], teams / safe_name(flags["env"])
    usual = not config["changed"] and flags["parameter_sharing"] and flags["seed"] == 0
    if not usual or task not in envs.task_names() or not (directory / "checkpoint.pt").exists():
        return None
    best, there = returns[task].max(), place / "config.json"
    if returns[task, algorithm] < best:
        return None
    if there.exists() and returns.get((task, json.loads(there.read_text(encoding="utf-8"))["algorithm"])) == best:
        return None
    import torch  # takes a while

    saved = read_checkpoint(directory, algorithm)
    config = {name: value for name, value in config.items() if name not in OF_A_MACHINE}
    config["flags"] = flags | {"run_dir": "", "resume": False}
    kept: dict[str, Any] = {"config": config, **{name: saved[name] for name in ("rows", "seconds", "network")}}
    kept["parts"] = {"agents": saved["parts"]["agents"]}
    place.mkdir(parents=True, exist_ok=True)
    in_memory = io.BytesIO()
    torch.save(kept, in_memory)
    write_whole(place / "checkpoint.pt", in_memory.getvalue())
    write_whole(place / "evaluations.csv", (directory / "evaluations.csv").read_bytes())
    write_whole(place / "config.json", json.dumps(config, indent=2) + "\n")
    return place


@one_sentence(__file__)
def main() -> None:
    """Collects what is complete, and says what was left out. Exit code 2 if something is wrong with a run."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="?", type=Path, default=Path("runs"), help="a folder with runs; default: runs")
    parser.add_argument("--results", type=Path, default=store.RESULTS, help="the tables; default: benchmark/results")
    parser.add_argument("--replace", action="store_true", help="a seed that is there already is replaced")
    args = parser.parse_args()
    directories = sorted(run_directories(args.runs))
    if not directories:
        parser.error(f"there are no runs in {args.runs}")
    wrong, collected = False, []
    for directory in directories:
        try:
            table_file = store.collect(directory, args.results, args.replace)
        except (ValueError, OSError) as error:  # not complete, other flags, a damaged file, a full disk
            print(f"{directory}: left out, {error}", file=sys.stderr)
            wrong |= not isinstance(error, store.NotComplete)
        else:
            print(f"{directory}: in {table_file}")
            collected.append(directory)
    if collected and args.results == store.RESULTS:
        with store.lock(args.results):  # another collector's team may be better than what these returns say
            returns = last_returns()
            kept = {keep_team(directory, returns): directory for directory in collected}
        for place in filter(None, kept):
            print(f"{kept[place]}: its team is in {place}")
    if wrong:
        sys.exit(2)


if __name__ == "__main__":
    main()
