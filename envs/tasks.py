"""The grammar of task names, and what the paper says of each task.

    matrix-climbing  matrix-penalty-<k>
    lbf-<rows>x<columns>-<n>p-<f>f[-2s][-c][-v3]
    smaclite-<map>[-sc2]  smac-<map>                   <map>: 2s_vs_1sc, 3s5z, MMM2, corridor, 3s_vs_5z, ...

A family is added by a parser: a function that takes a name and gives its Task, None where the name is not of its
form, or raises InputError where it has the form but no game can be played. `PARSERS` lists them.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from envs.smaclite_maps import LITE_MAPS


class InputError(ValueError):
    """What the user asked for cannot be done, as an unknown task; the message is one sentence for them."""


@dataclass(frozen=True)
class Task:
    """A task by its name, with what the paper says of it.

    family: whose hyperparameters apply (a family of the paper: matrix, mpe, smac, lbf, rware).
    on_policy_timesteps, off_policy_timesteps: the paper's training budgets.
    eval_points: evaluations in a run, the one before training included.
    module, settings: the module of this package that plays the task, and what its environment is built with.
    """

    name: str
    family: str
    on_policy_timesteps: int
    off_policy_timesteps: int
    eval_points: int
    module: str = field(repr=False)
    settings: Mapping[str, Any] = field(repr=False, hash=False)


PAPER_TASKS = (
    "matrix-climbing",
    "matrix-penalty-0",
    "matrix-penalty-25",
    "matrix-penalty-50",
    "matrix-penalty-75",
    "matrix-penalty-100",
    "lbf-8x8-2p-2f-c",
    "lbf-8x8-2p-2f-2s-c",
    "lbf-10x10-3p-3f",
    "lbf-10x10-3p-3f-2s",
    "lbf-15x15-3p-5f",
    "lbf-15x15-4p-3f",
    "lbf-15x15-4p-5f",
    "smaclite-2s_vs_1sc-sc2",  # these five stand for SMAC's, which need StarCraft II
    "smaclite-3s5z-sc2",
    "smaclite-MMM2-sc2",
    "smaclite-corridor-sc2",
    "smaclite-3s_vs_5z-sc2",
)


def task_names() -> list[str]:
    """The names of the paper's tasks, as far as their families are here; the grammar above makes many more."""
    return list(PAPER_TASKS)


def task(name: str) -> Task:
    """The task of that name. InputError: the name is unknown (the message has the nearest ones) or impossible."""
    for parse in PARSERS:
        found = parse(name)
        if found is not None:
            return found
    nearest = difflib.get_close_matches(name, PAPER_TASKS, n=3, cutoff=0.0)
    raise InputError(f"unknown task {name!r}; the nearest are {', '.join(nearest)}.")


NUMBER = "(0|[1-9][0-9]*)"


def parse_matrix(name: str) -> Task | None:
    """The climbing game, or the penalty game with a penalty of -k for any whole k."""
    match = re.fullmatch(f"matrix-(?:climbing|penalty-{NUMBER})", name)
    if match is None:
        return None
    penalty = None if match[1] is None else int(match[1])
    if penalty is not None and penalty > 2**24:
        raise InputError(f"{name}: the penalty is larger than 2^24, up to which a 32-bit reward is exact.")
    return Task(name, "matrix", 2_500_000, 250_000, 101, "matrix", {"penalty": penalty})


def parse_lbf(name: str) -> Task | None:
    """Level-Based Foraging on a board of any size that has room for the foods and the agents."""
    match = re.fullmatch(f"lbf-{NUMBER}x{NUMBER}-{NUMBER}p-{NUMBER}f(-2s)?(-c)?(-v3)?", name)
    if match is None:
        return None
    rows, columns, n_agents, n_foods = (int(match[i]) for i in range(1, 5))
    if n_agents == 0 or n_foods == 0:
        raise InputError(f"{name}: the game needs at least one agent and one food.")
    if rows < 3 or columns < 3:
        raise InputError(f"{name}: foods lie off the border, so a board has at least 3 rows and 3 columns.")
    if (rows - 2) * (columns - 2) <= n_agents:
        raise InputError(f"{name}: {n_agents} agents may leave no cell off the border free for a food.")
    if max(rows, columns) > 2**24:
        raise InputError(f"{name}: a side is longer than 2^24, up to which 32-bit observations are exact.")
    room = max(room_for_foods(rows, columns, n_foods), room_for_foods(columns, rows, n_foods))
    if room < n_foods:
        raise InputError(
            f"{name}: foods lie off the border and at least three steps apart; a {rows}x{columns} board is played with "
            f"up to {room}, not {n_foods}."
        )
    settings = {
        "rows": rows,
        "columns": columns,
        "n_agents": n_agents,
        "n_foods": n_foods,
        "sight": 2 if match[5] else max(rows, columns),
        "cooperative": match[6] is not None,
        "version": 3 if match[7] else 1,
    }
    return Task(name, "lbf", 20_000_000, 2_000_000, 41, "lbf", settings)


def room_for_foods(rows: int, columns: int, wanted: int) -> int:
    """How many foods, up to the number wanted, go on a board when each takes the first cell that is still free.

    Now and then a cleverer arrangement holds a few more (27 against 29 on 14x14), but foods placed at random never
    come near that many.
    """
    placed = 0
    taken: set[tuple[int, int]] = set()  # within two steps of a food
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            if placed == wanted:
                return placed
            if (row, column) not in taken:
                placed += 1
                for down in range(3):  # what lies above has been passed
                    taken.update((row + down, column + across) for across in range(down - 2, 3 - down))
    return placed


def parse_smac(name: str) -> Task | None:
    """Battles on the maps that our own simulator knows, and, with StarCraft II, on those of SMAC."""
    match = re.fullmatch("(smaclite|smac)-([0-9A-Za-z_]+)(-sc2)?", name)
    if match is None or (match[1] == "smac" and match[3]):
        return None
    if match[1] == "smac":
        return Task(name, "smac", 40_000_000, 4_000_000, 41, "starcraft", {"map_name": match[2]})
    if match[2] not in LITE_MAPS:
        return None
    settings = {"map_name": match[2], "rule_set": "sc2" if match[3] else "lite"}
    return Task(name, "smac", 40_000_000, 4_000_000, 41, "smaclite", settings)


PARSERS = (parse_matrix, parse_lbf, parse_smac)
