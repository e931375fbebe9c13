"""Environment steps per second with random actions, ours and the original package's beside it, on one thread.

    python benchmark/stepping.py [--tasks lbf-15x15-3p-5f ...] [--num-envs 1 10 100] [--seconds 2]

One step is one action of every agent in one sub-environment, observations included; the actions are drawn beforehand,
and episodes are reset when the time limit comes. Pin it to a core: `taskset -c 0 python benchmark/stepping.py`.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import envs

ACTIONS = 1000  # joint actions drawn beforehand
DEFAULT_TASKS = ["matrix-climbing", "lbf-8x8-2p-2f-c", "lbf-15x15-3p-5f", "rware-tiny-4p"]


def rate(play: Callable[[], int], seconds: float) -> float:
    """The most steps per second in five measurements that together take so many seconds; play returns its steps."""
    play()
    best = 0.0
    for _ in range(5):
        steps, start = 0, time.perf_counter()
        while (passed := time.perf_counter() - start) < seconds / 5:
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
    build = {"lbf": lbforaging, "rware": rware}.get(envs.task(name).module)
    if build is None:
        return None
    try:
        env = build(name)
    except envs.InputError as error:
        print(error, file=sys.stderr)
        return None
    env.reset(seed=0)
    n_agents, n_actions = len(env.action_space), env.action_space[0].n
    prepared = itertools.cycle(np.random.default_rng(0).integers(0, n_actions, (ACTIONS, n_agents)).tolist())

    def play() -> int:
        env.reset()
        steps = 1
        while not env.step(next(prepared))[2]:
            steps += 1
        return steps

    return play


def lbforaging(name: str) -> Any:
    """The package's game of a name as in `envs.tasks`."""
    package = envs.optional("lbforaging.foraging", "test")
    config = envs.task(name).settings
    return package.ForagingEnv(
        players=config["n_agents"],
        min_player_level=1,
        max_player_level=2,
        min_food_level=1,
        max_food_level=None,
        field_size=(config["rows"], config["columns"]),
        max_num_food=config["n_foods"],
        sight=config["sight"],
        max_episode_steps=50,
        force_coop=config["cooperative"],
    )


def rware(name: str) -> Any:
    """The package's game of a name as in `envs.tasks`."""
    package = envs.optional("rware.warehouse", "test")
    config = envs.task(name).settings
    return package.Warehouse(
        shelf_columns=(config["columns"] - 1) // 3,
        column_height=8,
        shelf_rows=(config["rows"] - 2) // 9,
        n_agents=config["n_agents"],
        msg_bits=0,
        sensor_range=config["sight"],
        request_queue_size=config["n_requests"],
        max_inactivity_steps=None,
        max_steps=500,
        reward_type=package.RewardType.INDIVIDUAL,
    )


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=DEFAULT_TASKS)
    parser.add_argument("--num-envs", nargs="+", type=int, default=[1, 10, 100])
    parser.add_argument("--seconds", type=float, default=2.0, help="for each figure")
    parser.add_argument("--copy", action="store_true", help="measure with copy=True")
    args = parser.parse_args()
    try:
        for name in args.tasks:
            envs.task(name)
    except envs.InputError as error:
        parser.error(str(error))
    if min(args.num_envs) < 1 or args.seconds <= 0:
        parser.error("--num-envs and --seconds must be positive")

    print(f"{'task':<24}{'original':>12}" + "".join(f"{number:>12} envs" for number in args.num_envs))
    for name in args.tasks:
        play = original(name)
        cells = [f"{rate(play, args.seconds):>12,.0f}" if play else f"{'-':>12}"]
        cells += [f"{rate(ours(name, number, args.copy), args.seconds):>17,.0f}" for number in args.num_envs]
        print(f"{name:<24}" + "".join(cells), flush=True)


if __name__ == "__main__":
    main()
