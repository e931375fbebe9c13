"""The last team of each task's best algorithm, kept to be watched: its networks, without what only training needs."""

import io
import json
from pathlib import Path
from typing import Any

import envs  # isort: skip
import pandas as pd
import torch

from envs.runs import read_checkpoint, renewed_config, safe_name, write_whole
from reporting.results import HERE, RESULTS, load, our_cells

TEAMS = HERE / "teams"
OF_A_MACHINE = ("command", "machine", "preloaded")  # what config.json says of no use elsewhere


def last_returns(results: Path = RESULTS) -> pd.Series:
    """Mean returns at the last evaluation by (task, algorithm), with sharing and the paper's setting."""
    cells = our_cells(load(results))
    chosen = cells[(cells["metric"] == "last_return") & cells["sharing"] & ~cells["other_budget"]]
    return chosen.set_index(["task", "algorithm"])["mean"]


def keep_team(directory: Path, returns: pd.Series, teams: Path = TEAMS) -> Path | None:
    """Keeps the team of a complete run as teams/<task>, if it is of seed 0 with sharing, one of the paper's tasks and
    setting, its algorithm is the best on this task, and that of the team which is there is not as good.

    returns: `last_returns`. Gives the team's place, None where it was not kept. InputError where the run has no
    checkpoint that can be read.
    """
    config = renewed_config(json.loads((directory / "config.json").read_text(encoding="utf-8")))
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
    saved = read_checkpoint(directory, algorithm)
    config = {name: value for name, value in config.items() if name not in OF_A_MACHINE}
    config["flags"] = flags | {"run_dir": "", "resume": False}
    kept: dict[str, Any] = {"config": config, **{name: saved[name] for name in ("rows", "seconds", "network")}}
    kept["parts"] = {"agents": saved["parts"]["agents"]}
    place.mkdir(parents=True, exist_ok=True)
    in_memory = io.BytesIO()
    torch.save(kept, in_memory)
    (place / "checkpoint.new.pt").write_bytes(in_memory.getvalue())
    (place / "checkpoint.new.pt").replace(place / "checkpoint.pt")
    write_whole(place / "evaluations.csv", (directory / "evaluations.csv").read_text(encoding="utf-8"))
    write_whole(place / "config.json", json.dumps(config, indent=2) + "\n")
    return place
