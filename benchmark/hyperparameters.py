"""The hyperparameters of the nine algorithms in the paper, and whether a run has them.

paper/hyperparameters.csv     what the paper's search chose for each family, with and without parameter sharing
paper/fixed.csv               what is the same in all tasks
"""

import csv
import functools
from pathlib import Path
from typing import Any

import envs
from envs import InputError

PAPER = Path(__file__).resolve().parent / "paper"
BUDGETS = {
    **dict.fromkeys(("ia2c", "ippo", "coma", "maa2c", "mappo"), "on_policy_timesteps"),
    **dict.fromkeys(("iql", "vdn", "qmix", "maddpg"), "off_policy_timesteps"),
}  # fields of a Task
FLAGS = {  # the paper's words
    "hidden_dimension": "hidden_dim",
    "learning_rate": "learning_rate",
    "reward_standardisation": "reward_standardisation",
    "network_type": "network",
    "entropy_coefficient": "entropy_coef",
    "target_update": "target_update",
    "n-step": "n_step",
    "evaluation_epsilon": "eval_epsilon",
    "epsilon_anneal": "epsilon_anneal",
    "actor_regularisation": "actor_regularisation",
}
VALUES = {"200 (hard)": "hard", "0.01 (soft)": "soft", "FC": "fc", "GRU": "gru", "True": True, "False": False}


def value_of(text: str) -> Any:
    """A value of the tables as a flag has it: a number, a word or a switch."""
    try:
        return int(text) if text.isdecimal() else float(text)
    except ValueError:
        return VALUES.get(text, text)


@functools.cache
def searched(algorithm: str, family: str, parameter_sharing: bool) -> dict[str, Any]:
    """What the search chose for a family, by flag; {} for a family that the paper lacks."""
    with open(PAPER / "hyperparameters.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    key = algorithm, family, "yes" if parameter_sharing else "no"
    chosen = [row for row in rows if (row["algorithm"], row["family"], row["parameter_sharing"]) == key]
    return {FLAGS[row["name"]]: value_of(row["value"]) for row in chosen}


@functools.cache
def fixed(algorithm: str) -> dict[str, Any]:
    """What is the same in all tasks, by flag."""
    with open(PAPER / "fixed.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {row["flag"]: value_of(row["value"]) for row in rows if algorithm in row["algorithms"].split()}


def check(algorithm: str, flags: dict[str, Any], changed: dict[str, Any]) -> None:
    """InputError where a run of one of the nine has another value than the paper, and does not say so.

    flags: all of the run; changed: those that differ from what its script takes for the paper's. A value that was
    edited in a script is in the first alone, and would pass for the paper's.
    """
    if algorithm not in BUDGETS:
        return
    try:
        task = envs.task(flags["env"])
    except InputError:  # a name of another version
        return
    wanted = fixed(algorithm) | searched(algorithm, task.family, flags["parameter_sharing"])
    wanted |= {"total_timesteps": getattr(task, BUDGETS[algorithm]), "eval_points": task.eval_points}
    for name, value in wanted.items():
        if name in flags and name not in changed and flags[name] != value:
            raise InputError(
                f"{algorithm} on {task.name} has {name} {flags[name]}, where the paper has {value}. Give the value on "
                "the command line, or keep the changed script under another name."
            )
