"""Environment steps per second with random actions, ours and the original package's beside it, on one thread.

    python benchmark/stepping.py [--tasks lbf-15x15-3p-5f ...] [--num-envs 1 10 100] [--seconds 2]

One step is one action of every agent in one sub-environment, observations included; the actions are drawn beforehand,
and episodes are reset when the time limit comes. Pin it to a core: `taskset -c 0 python benchmark/stepping.py`.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
import time
from collections.abc import Callable

import numpy as np

import envs

ACTIONS = 1000  # joint actions drawn beforehand


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
    env.reset()
    numbers = env.action_mask.sum(axis=2)  # the first ones of each agent
    actions = np.random.default_rng(0).integers(0, numbers, (ACTIONS, num_envs, env.n_agents))
    prepared = itertools.cycle(list(actions))

    def play() -> int:
        env.reset()
        for _ in range(env.episode_limit):
            env.step(next(prepared))
        return num_envs * env.episode_limit

    return play


def original(name: str) -> Callable[[], int] | None:
    """Plays one episode of the package that the task comes from, or None where there is none or it is missing."""
    if name.startswith("mpe"):
        return original_mpe(name)
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


def original_mpe(name: str) -> Callable[[], int] | None:
    """The same for the particle environments; where a task has an opponent, all agents act at random."""
    versions = {"speaker-listener": "v4", "spread": "v3", "adversary": "v3", "tag": "v3"}
    scenario = name.split("-", 1)[1].removesuffix("-selfplay")
    try:
        package = envs.optional(f"mpe2.simple_{scenario.replace('-', '_')}_{versions[scenario]}", "test")
    except envs.InputError as error:
        print(error, file=sys.stderr)
        return None
    env = package.parallel_env(max_cycles=25)
    numbers = [env.action_space(agent).n for agent in env.possible_agents]
    drawn = np.random.default_rng(0).integers(0, numbers, (ACTIONS, len(numbers))).tolist()
    prepared = itertools.cycle([dict(zip(env.possible_agents, actions)) for actions in drawn])

    def play() -> int:
        env.reset(seed=0)
        for _ in range(25):
            env.step(next(prepared))
        return 25

    return play


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["matrix-climbing", "lbf-8x8-2p-2f-c", "lbf-15x15-3p-5f"])
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
