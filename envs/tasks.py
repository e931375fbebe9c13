"""The grammar of task names, and what the paper says of each task.

    matrix-climbing  matrix-penalty-<k>                and those that are added to `MATRIX_GAMES`
    lbf-<rows>x<columns>-<n>p-<f>f[-2s][-c][-v3]
    rware-<tiny|small|medium|large>-<n>p[-<r>s][-easy|-hard]
    mpe-speaker-listener  mpe-spread  mpe-adversary[-selfplay]  mpe-tag[-selfplay]      and the same with mpe2-
    smaclite-<map>[-sc2[-v2]]  smac-<map>                   <map>: 2s_vs_1sc, 3s5z, MMM2, corridor, 3s_vs_5z, ...
    pettingzoo:<module>  gymnasium:<id>                environments that are not ours; see `envs.adapters.foreign`
    own:<module>                                       a class `Env` of your own, by the contract in `envs.vector`

A family is added with a parser: a function that takes a name and returns its Task, or None if the name does not have
the family's form. It raises InputError if the name has the form, but no such game can be played. `PARSERS` lists the
parsers.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from envs.families import OPPONENTS, PLACES_TRIED
from envs.families.smaclite.maps import RULE_SETS
from envs.vector import InputError

UNBOUNDED = (-math.inf, math.inf)

# The options of `envs.make`, as they are where nobody asks for anything else
OPTIONS: dict[str, Any] = {
    "env_kwargs": {},
    "max_episode_steps": 0,
    "flatten_images": False,
    "divide_images": True,
    "action_bins": 0,
    "env_workers": 0,
    "pictures": False,
}


@dataclass(frozen=True)
class Task:
    """A task: its name, what the paper says about it, and how its environment is built.

    family: the family of the paper whose hyperparameters apply (matrix, mpe, smac, lbf, rware), or "".
    on_policy_timesteps, off_policy_timesteps: the paper's training budgets.
    eval_points: the number of evaluations in a run, including the one before training.
    module, settings: the module whose `Env` plays the task, and keyword arguments for it.
    takes: the options of `envs.make` that it takes.
    arguments: those that `env_kwargs` may have, where it takes them and its rules are ours.
    returns: bounds of the team's return of an episode; infinite where the rules set none near to what can be reached.
    """

    name: str
    family: str
    on_policy_timesteps: int
    off_policy_timesteps: int
    eval_points: int
    module: str = field(repr=False)
    settings: Mapping[str, Any] = field(repr=False, hash=False)
    takes: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ()
    returns: tuple[float, float] = UNBOUNDED


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
    "rware-tiny-2p",
    "rware-tiny-4p",
    "rware-small-4p",
    "mpe-speaker-listener",
    "mpe-spread",
    "mpe-adversary",
    "mpe-tag",
    "smaclite-2s_vs_1sc-sc2",  # these five stand for SMAC's, which need StarCraft II
    "smaclite-3s5z-sc2-v2",
    "smaclite-MMM2-sc2",
    "smaclite-corridor-sc2-v2",
    "smaclite-3s_vs_5z-sc2-v2",
)


def task_names() -> list[str]:
    """The names of the paper's tasks that exist here. The grammar above allows many more."""
    return [name for name in PAPER_TASKS if not lacks_opponent(name)]


def lacks_opponent(name: str) -> bool:
    """Whether a task of MPE has a built-in opponent that has not been trained yet."""
    match = re.fullmatch("mpe2?-(adversary|tag)", name)
    return match is not None and not (OPPONENTS / f"mpe-{match[1]}.npz").exists()


def stand_in(battle: str) -> str:
    """The task that stands for `smac-<battle>` where there is no StarCraft II.

    It has the newest rules; on a map on which nobody fights at close quarters these have no name of their own.
    """
    return f"smaclite-{battle}-sc2-v2" if battle in RULE_SETS["sc2-v2"].maps else f"smaclite-{battle}-sc2"


def task(name: str) -> Task:
    """The task of that name.

    Raises InputError for a name that is impossible or unknown. The message says which name was probably meant.
    """
    found = parsed(name)
    if found is None:
        raise InputError(unknown(name))
    return found


def parsed(name: str) -> Task | None:
    """The task, or None if no family has names of this form. Raises InputError if there is no such game."""
    for parse in PARSERS:
        found = parse(name)
        if found is not None:
            return found
    return None


def unknown(name: str) -> str:
    """What to tell a user who asked for a task that does not exist."""
    table = "`python -m envs` lists the tasks"
    translations = names_here(name)
    here = [ours for ours in translations if refusal(ours) is None]
    if here:
        return f"unknown task {name!r}; here it is called {' or '.join(here)}. {table}."
    if translations:
        return f"unknown task {name!r}; this project does not have that game{refusal(translations[-1])}. {table}."
    small = name.lower()
    spelled = {ours.lower(): ours for ours in PAPER_TASKS}
    near = [small] if refusal(small) is None else [spelled[ours] for ours in difflib.get_close_matches(small, spelled)]
    if near:
        return f"unknown task {name!r}; did you mean {' or '.join(near)}? {table}."
    return f"unknown task {name!r}. {table}."


def refusal(name: str) -> str | None:
    """None if `task` would find the name, else why there is no such game, in brackets, or "" if the form is unknown."""
    try:
        return None if parsed(name) else ""
    except InputError as error:
        return f" ({str(error).removesuffix('.')})"


def names_here(name: str) -> list[str]:
    """Our names for what the original packages and the paper's code call `name`, the best one first.

    The list is empty if `name` has none of their forms. It may contain names of tasks that do not exist.
    """
    lbf = re.fullmatch(
        r"(?:lbforaging:)?Foraging(?:-(\d+)s)?-(\d+)x(\d+)-(\d+)p-(\d+)f(-coop)?(?:-v(\d+))?", name, re.ASCII
    )
    if lbf:
        sight, rows, columns, agents, foods, cooperative, version = lbf.groups()
        sees_all = sight is None or int(sight) >= max(int(rows), int(columns))
        sight_part = "" if sees_all else f"-{sight}s"
        ours = f"lbf-{rows}x{columns}-{agents}p-{foods}f{sight_part}{'-c' if cooperative else ''}"
        return [f"{ours}-v3", ours] if version == "3" else [ours]

    rware = re.fullmatch(r"(?:rware:)?rware-([a-z]+)-(\d+)ag(-easy|-hard)?(?:-v\d+)?", name, re.ASCII)
    if rware:
        size, agents, difficulty = rware.groups()
        return [f"rware-{size}-{agents}p{difficulty or ''}"]

    mpe = re.fullmatch(r"(?:pz-mpe-|mpe:|mpe2\.)?simple[-_]?([a-z_-]+?)(?:[-_]v(\d+))?", name, re.ASCII | re.IGNORECASE)
    scenarios = {"speakerlistener": "speaker-listener", "spread": "spread", "adversary": "adversary", "tag": "tag"}
    scenario = scenarios.get(re.sub("[-_]", "", mpe[1].lower())) if mpe else None
    if mpe and scenario:
        of_the_package = mpe[2] is not None and int(mpe[2]) >= 2  # PettingZoo's and mpe2's physics; Gym's had v0
        return [f"mpe2-{scenario}", f"mpe-{scenario}"] if of_the_package else [f"mpe-{scenario}"]

    matrix = re.fullmatch(r"(?:matrixgames:)?(climbing|penalty-\d+)(?:-nostate)?(?:-v\d+)?", name, re.ASCII)
    if matrix:
        return [f"matrix-{matrix[1]}"]

    units = r"(?:\d+[a-z]+)+"
    named_maps = "MMM2?|corridor|bane_vs_bane|so_many_baneling"
    smac = re.fullmatch(rf"(smaclite/|smac[:/-])?({units}(?:_vs_{units})?|{named_maps})(?:-v0)?", name, re.ASCII)
    if smac:
        package, battle = smac.groups()
        lite = [f"smaclite-{battle}"]
        return lite if package == "smaclite/" else [f"smac-{battle}", stand_in(battle)]
    return []


NUMBER = "(0|[1-9][0-9]{0,15})"


# The matrix games, as many rows as columns; agent 0 chooses the row. The penalty games are made by `parse_matrix`.
MATRIX_GAMES = {"climbing": ((11, -30, 0), (-30, 7, 0), (0, 6, 5))}


def parse_matrix(name: str) -> Task | None:
    """A game of MATRIX_GAMES, or the penalty game with the penalty -k for any whole number k."""
    match = re.fullmatch(f"matrix-(?:({'|'.join(MATRIX_GAMES)})|penalty-{NUMBER})", name)
    if match is None:
        return None
    if match[1]:
        payoffs = MATRIX_GAMES[match[1]]
    else:
        k = int(match[2])
        if k > 2**24:
            raise InputError(f"{name}: the penalty is larger than 2^24, and 32-bit rewards are exact only up to there.")
        payoffs = ((-k, 0, 10), (0, 2, 0), (10, 0, -k))
    returns = 25.0 * min(map(min, payoffs)), 25.0 * max(map(max, payoffs))
    settings = {"payoffs": payoffs}
    return Task(name, "matrix", 2_500_000, 250_000, 101, "envs.families.matrix", settings, returns=returns)


def parse_lbf(name: str) -> Task | None:
    """Level-Based Foraging on a board of any size that has room for the agents and the foods."""
    match = re.fullmatch(f"lbf-{NUMBER}x{NUMBER}-{NUMBER}p-{NUMBER}f(-2s)?(-c)?(-v3)?", name)
    if match is None:
        return None
    rows, columns, n_agents, n_foods = (int(match[i]) for i in range(1, 5))
    if n_agents == 0 or n_foods == 0:
        raise InputError(f"{name}: the game needs at least one agent and one food.")
    if n_foods > PLACES_TRIED:
        raise InputError(
            f"{name}: the game tries {PLACES_TRIED:,} places for its foods, so there are never more of them."
        )
    if rows < 3 or columns < 3:
        raise InputError(f"{name}: foods never lie on the border, so a board needs at least 3 rows and 3 columns.")
    if (rows - 2) * (columns - 2) <= n_agents:
        raise InputError(f"{name}: {n_agents} agents may leave no cell inside the border free for a food.")
    if max(rows, columns) > 2**24:
        raise InputError(f"{name}: a side is longer than 2^24, and 32-bit observations are exact only up to there.")
    room = max(room_for_foods(rows, columns, n_foods), room_for_foods(columns, rows, n_foods))
    if room < n_foods:
        raise InputError(
            f"{name}: foods lie inside the border and at least three steps apart, so a {rows}x{columns} board is "
            f"played with at most {room} of them, not {n_foods}."
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
    return Task(name, "lbf", 20_000_000, 2_000_000, 41, "envs.families.lbf", settings, returns=(0.0, 1.0))


def room_for_foods(rows: int, columns: int, wanted: int) -> int:
    """The number of foods, at most `wanted`, that fit on a board when each takes the first cell that is still free.

    Sometimes a cleverer arrangement holds a few more (29 instead of 27 on 14x14), but foods that are placed at random
    never come near that number.
    """
    placed = 0
    taken: set[tuple[int, int]] = set()  # cells within two steps of a food
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            if placed == wanted:
                return placed
            if (row, column) not in taken:
                placed += 1
                for down in range(3):  # the cells above are not visited again
                    taken.update((row + down, column + across) for across in range(down - 2, 3 - down))
    return placed


# Rows, columns, shelves
WAREHOUSES = {"tiny": (11, 10, 32), "small": (20, 10, 80), "medium": (20, 16, 144), "large": (29, 16, 224)}


def parse_rware(name: str) -> Task | None:
    """The multi-robot warehouse in one of its four sizes; the range of the sensors is named where it is not 1."""
    match = re.fullmatch(f"rware-(tiny|small|medium|large)-{NUMBER}p(?:-{NUMBER}s)?(?:-(easy|hard))?", name)
    if match is None:
        return None
    rows, columns, n_shelves = WAREHOUSES[match[1]]
    n_agents, sight = int(match[2]), int(match[3] or 1)
    if not 1 <= n_agents <= 20:
        raise InputError(f"{name}: a warehouse has 1 to 20 agents.")
    if match[3] == "1":
        raise InputError(f"{name}: agents sense one cell far unless the name says more; leave the -1s out.")
    if not 1 <= sight <= 5:
        raise InputError(f"{name}: agents sense 1 to 5 cells far.")
    n_requests = {None: n_agents, "easy": 2 * n_agents, "hard": n_agents // 2}[match[4]]
    if n_requests == 0:
        raise InputError(f"{name}: half as many requests as agents are none here; -hard needs at least 2 agents.")
    if n_requests >= n_shelves:
        raise InputError(
            f"{name}: {n_requests} requests leave none of the {n_shelves} shelves to be requested after a delivery."
        )
    settings = {
        "rows": rows,
        "columns": columns,
        "n_shelves": n_shelves,
        "n_agents": n_agents,
        "n_requests": n_requests,
        "sight": sight,
    }
    return Task(name, "rware", 40_000_000, 4_000_000, 41, "envs.families.rware", settings, returns=(0.0, math.inf))


def parse_mpe(name: str) -> Task | None:
    """The particle environments by the paper's rules (mpe) or those of the package mpe2."""
    match = re.fullmatch("(mpe2?)-(?:(speaker-listener|spread)|(adversary|tag)(-selfplay)?)", name)
    if match is None:
        return None
    selfplay = match[4] is not None
    settings = {"scenario": match[2] or match[3], "paper": match[1] == "mpe", "selfplay": selfplay}
    if lacks_opponent(name):
        raise InputError(
            f"{name} has no opponent yet: `python tools/train_opponents.py` trains it, for hours. "
            f"In {name}-selfplay all agents learn."
        )
    if selfplay:  # 25,000 episodes, in which the opponents were trained
        return Task(name, "mpe", 625_000, 625_000, 41, "envs.families.mpe", settings)
    takes, arguments = (("env_kwargs",), ("opponent",)) if match[3] else ((), ())
    bounds = {"adversary": UNBOUNDED, "tag": (0.0, math.inf)}  # the others' rewards are minus distances
    returns = bounds.get(match[2] or match[3], (-math.inf, 0.0))
    return Task(name, "mpe", 20_000_000, 2_000_000, 41, "envs.families.mpe", settings, takes, arguments, returns)


def parse_smac(name: str) -> Task | None:
    """Battles on the maps that our own simulator knows, and, with StarCraft II, on those of SMAC."""
    match = re.fullmatch("(smaclite|smac)-([0-9A-Za-z_]+)(?:-(sc2(?:-v2)?))?", name)
    if match is None or (match[1] == "smac" and match[3]):
        return None
    returns = (0.0, math.inf)
    if match[1] == "smac":
        settings = {"map_name": match[2]}
        return Task(name, "smac", 40_000_000, 4_000_000, 41, "envs.families.starcraft", settings, returns=returns)
    rule_set = match[3] or "lite"
    if match[2] not in RULE_SETS[rule_set].maps:
        return None
    settings = {"map_name": match[2], "rule_set": rule_set}
    module = "envs.families.smaclite.environment"
    return Task(name, "smac", 40_000_000, 4_000_000, 41, module, settings, returns=returns)


# Packages that the paper's tasks come from, and one of these tasks
KNOWN_PACKAGES = {
    "matrixgames": "matrix-climbing",
    "lbforaging": "lbf-8x8-2p-2f-c",
    "rware": "rware-tiny-2p",
    "mpe2?": "mpe-spread",
    "smac": "smaclite-3s5z-sc2-v2",
}
OF_OTHERS = ("own:", "pettingzoo:", "gymnasium:")  # how names begin that lead to code of others, which is then run
STEPS = (20_000_000, 2_000_000, 41)  # budgets on and off policy, and evaluations, where the paper says nothing


def parse_foreign(name: str) -> Task | None:
    """Environments of PettingZoo and Gymnasium; those of the paper's families take their hyperparameters."""
    match = re.fullmatch("(pettingzoo|gymnasium):(.+)", name)
    if match is None:
        return None
    settings = {"interface": match[1], "target": match[2]}
    for package, known in KNOWN_PACKAGES.items():
        if re.search(rf"(?:^|[.:/])(?:{package})", match[2]):
            found = task(known)
            budgets = found.on_policy_timesteps, found.off_policy_timesteps, found.eval_points
            return Task(name, found.family, *budgets, "envs.adapters.foreign", settings, tuple(OPTIONS))
    return Task(name, "", *STEPS, "envs.adapters.foreign", settings, tuple(OPTIONS))


def parse_own(name: str) -> Task | None:
    """A user's module with a class `Env`."""
    match = re.fullmatch(r"own:([\w.]+)", name)
    return Task(name, "", *STEPS, "envs.adapters.own", {"target": match[1]}, ("env_kwargs",)) if match else None


PARSERS = (parse_matrix, parse_lbf, parse_rware, parse_mpe, parse_smac, parse_foreign, parse_own)
