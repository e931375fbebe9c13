"""Environment steps per CPU second with random actions, ours and the original package's beside it, on one thread.

    python benchmark/stepping.py [--tasks lbf-15x15-3p-5f ...] [--num-envs 1 10 100] [--seconds 2] [--output <csv>]

One step is one action of every agent in one sub-environment, observations included; the actions are drawn beforehand,
and episodes are reset when the time limit comes. The column "paper" is the paper's own figure, from another machine.
With --output the figures also go to a CSV, where they take the place of those of the same tasks. Pin it to a core:
`taskset -c 0 python benchmark/stepping.py`.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import envs
from results import PAPER, paper_task, write_whole

ACTIONS = 1000  # joint actions drawn beforehand


def rate(play: Callable[[], int], seconds: float) -> float:
    """The most steps per CPU second in five measurements that together take so many; play returns its steps."""
    play()
    best = 0.0
    for _ in range(5):
        steps, start = 0, time.process_time()
        while (passed := time.process_time() - start) < seconds / 5:
            steps += play()
        best = max(best, steps / passed)
    return best


def ours(name: str, num_envs: int, copy: bool) -> Callable[[], int]:
    """Plays one episode of every sub-environment."""
    env = envs.make(name, num_envs, copy=copy)
    actions = np.random.default_rng(0).integers(0, env.n_actions, (ACTIONS, num_envs, env.n_agents))
    prepared = itertools.cycle(list(actions))

    def play() -> int:
        env.reset()
        for _ in range(env.episode_limit):
            env.step(next(prepared))
        return num_envs * env.episode_limit

    return play


def original(name: str) -> Callable[[], int] | None:
    """Plays one episode of the package that the task comes from, or None where there is none or it is missing."""
    match = re.fullmatch(r"lbf-(\d+)x(\d+)-(\d+)p-(\d+)f(-2s)?(-c)?(?:-v3)?", name)
    if match is None:
        return None
    try:
        package = envs.optional("lbforaging.foraging", "test")
    except envs.InputError as error:
        print(error, file=sys.stderr)
        return None
    rows, columns, players, foods = (int(match[i]) for i in range(1, 5))
    env = package.ForagingEnv(
        players=players,
        min_player_level=1,
        max_player_level=2,
        min_food_level=1,
        max_food_level=None,
        field_size=(rows, columns),
        max_num_food=foods,
        sight=2 if match[5] else max(rows, columns),
        max_episode_steps=50,
        force_coop=match[6] is not None,
    )
    env.reset(seed=0)
    prepared = itertools.cycle(np.random.default_rng(0).integers(0, 6, (ACTIONS, players)).tolist())

    def play() -> int:
        env.reset()
        while not env.step(next(prepared))[2]:
            pass
        return int(env.current_step)

    return play


def label(num_envs: int) -> str:
    """How the CSV and the figure call our environments."""
    return f"ours, num_envs={num_envs}"


def keep(path: Path, task: str, speeds: dict[str, float]) -> None:
    """Puts the speeds of a task into the CSV, in place of those that it has; notes the processor and the commit."""
    origin = envs.provenance()
    machine: Any = origin["machine"]
    rows = pd.DataFrame({"task": task, "whose": list(speeds), "steps_per_second": list(speeds.values())})
    rows["steps_per_second"] = rows["steps_per_second"].round().astype(int)
    rows = rows.assign(processor=machine["processor"], commit=origin["commit"])
    if path.exists():
        there = pd.read_csv(path)
        rows = pd.concat([there[there["task"] != task], rows])
    write_whole(path, rows.to_csv(index=False, lineterminator="\n"))


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["matrix-climbing", "lbf-8x8-2p-2f-c", "lbf-15x15-3p-5f"])
    parser.add_argument("--num-envs", nargs="+", type=int, default=[1, 10, 100])
    parser.add_argument("--seconds", type=float, default=2.0, help="for each figure")
    parser.add_argument("--copy", action="store_true", help="measure with copy=True")
    parser.add_argument("--output", type=Path, help="a CSV, as benchmark/results/stepping.csv")
    args = parser.parse_args()
    try:
        for name in args.tasks:
            envs.task(name)
    except envs.InputError as error:
        parser.error(str(error))
    if min(args.num_envs) < 1 or args.seconds <= 0:
        parser.error("--num-envs and --seconds must be positive")

    table = pd.read_csv(PAPER / "env_speed.csv", index_col="task")
    paper = 10_000 / table["seconds_per_10000_steps"]
    print(f"{'task':<24}{'paper':>12}{'original':>12}" + "".join(f"{number:>12} envs" for number in args.num_envs))
    for name in args.tasks:
        speeds = {}
        if play := original(name):
            speeds["original package"] = rate(play, args.seconds)
        for number in args.num_envs:
            speeds[label(number)] = rate(ours(name, number, args.copy), args.seconds)
        theirs = paper.get(paper_task(name))
        cells = [f"{value:>12,.0f}" if value else f"{'-':>12}" for value in (theirs, speeds.get("original package"))]
        cells += [f"{speeds[label(number)]:>17,.0f}" for number in args.num_envs]
        print(f"{name:<24}" + "".join(cells), flush=True)
        if args.output:
            keep(args.output, name, speeds)


if __name__ == "__main__":
    main()
