"""Environment steps per CPU second with random actions, ours and the original package's beside it, on one thread.

    python benchmark/time_stepping.py [--tasks lbf-15x15-3p-5f ...] [--num-envs 1 10 100] [--seconds 2] [--output <csv>]

One step is one action of every agent in one sub-environment, observations included; the actions are drawn beforehand,
and episodes are reset when the time limit comes; steps of a sub-environment that has finished before do not count.
In battles (smaclite, smac) masks change and episodes end early, so legal actions are drawn, and the finished are reset,
as the game goes on; that is a part of the time. The column "paper" is the paper's own figure, from another machine.
With --output the figures also go to a CSV, where they take the place of those of the same tasks. Pin it to a core:
`taskset -c 0 python benchmark/time_stepping.py`.
"""

import argparse
import itertools
import math
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

if not __package__:  # as a program, from any folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark  # isort: skip  # noqa: F401 (says which packages are missing, before one is imported)
import gymnasium
import numpy as np

import envs
from benchmark import store
from envs import runs
from envs.runs import Parser, one_sentence

ACTIONS = 1000  # joint actions drawn beforehand
TRIALS = 20  # episodes of each sub-environment that say how many steps they have
DEFAULT_TASKS = ["matrix-climbing", "lbf-8x8-2p-2f-c", "lbf-15x15-3p-5f", "rware-tiny-4p"]


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


def ours(name: str, num_envs: int) -> Callable[[], int]:
    """Plays one episode of every sub-environment."""
    env = envs.make(name, num_envs, copy=False)
    env.reset()
    if envs.task(name).family == "smac":
        return battles(env)
    numbers = env.action_mask.sum(axis=2)  # the first ones of each agent
    actions = np.random.default_rng(0).integers(0, numbers, (ACTIONS, num_envs, env.n_agents))
    prepared = itertools.cycle(list(actions))

    lengths = []
    for _ in range(TRIALS):
        env.reset()
        totals = envs.EpisodeTotals(env)
        for _ in range(env.episode_limit):
            totals.add(*env.step(next(prepared))[1:])
        lengths.append(totals.lengths.sum())
    steps = round(float(np.mean(lengths)))  # counted beforehand, since counting takes time

    def play() -> int:
        env.reset()
        for _ in range(env.episode_limit):
            env.step(next(prepared))
        return steps

    return play


def battles(env: envs.VectorEnv) -> Callable[[], int]:
    """Plays a hundred steps of every sub-environment with legal actions."""
    scores = itertools.cycle(list(np.random.default_rng(0).random((ACTIONS, *env.action_mask.shape))))

    def play() -> int:
        for _ in range(100):
            actions = (next(scores) * env.action_mask).argmax(axis=2)
            _, _, terminated, truncated, _ = env.step(actions)
            ended = terminated | truncated
            if ended.any():
                env.reset(options={"reset_mask": ended})
        return 100 * env.num_envs

    return play


def original(name: str) -> Callable[[], int] | None:
    """Plays one episode of the package that the task comes from, or None where there is none or it is missing."""
    play = {"lbf": lbforaging, "rware": rware, "mpe": mpe2, "mpe2": mpe2}.get(name.partition("-")[0])
    try:
        return play(name) if play else None
    except (envs.InputError, gymnasium.error.Error) as error:  # a package is missing, or has no such game
        print(error, file=sys.stderr)
        return None


def episodes(name: str) -> Callable[[], int]:
    """Plays an episode of a game that a package has registered, without Gymnasium's wrappers."""
    env: Any = gymnasium.make(name).unwrapped
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


def lbforaging(name: str) -> Callable[[], int]:
    """Plays the package's game of a name as in `envs.tasks`."""
    envs.optional("lbforaging", "test")
    config = envs.task(name).settings
    sight = f"{config['sight']}s-" if config["sight"] < config["rows"] else ""
    game = f"{config['rows']}x{config['columns']}-{config['n_agents']}p-{config['n_foods']}f"
    return episodes(f"Foraging-{sight}{game}{'-coop' * config['cooperative']}-v3")


def rware(name: str) -> Callable[[], int]:
    """Plays the package's game of a name as in `envs.tasks`."""
    envs.optional("rware", "test")
    return episodes(re.sub("([0-9]+)p", r"\1ag", name) + "-v2")


def mpe2(name: str) -> Callable[[], int]:
    """The same for the particle environments; where a task has an opponent, all agents act at random."""
    versions = {"speaker-listener": "v4", "spread": "v3", "adversary": "v3", "tag": "v3"}
    scenario = name.split("-", 1)[1].removesuffix("-selfplay")
    package = envs.optional(f"mpe2.simple_{scenario.replace('-', '_')}_{versions[scenario]}", "test")
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


@one_sentence(__file__)
def main() -> None:
    """Measure and print a table. What can be wrong is looked for before, since measuring takes long."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=DEFAULT_TASKS, help=f"default: {' '.join(DEFAULT_TASKS)}")
    parser.add_argument("--num-envs", nargs="+", type=int, default=[1, 10, 100], help="so many side by side")
    parser.add_argument("--seconds", type=float, default=2.0, help="for each figure")
    parser.add_argument("--output", type=Path, help="a CSV, as benchmark/results/stepping.csv")
    args = parser.parse_args()
    if min(args.num_envs) < 1 or not 0 < args.seconds < math.inf:
        parser.error("--num-envs and --seconds must be positive numbers")
    if args.output:
        store.read_speeds(args.output)
        if not args.output.parent.is_dir():
            parser.error(f"--output: there is no folder {args.output.parent}")
    for name in args.tasks:
        envs.make(name, max(args.num_envs)).close()
    origin = runs.provenance()  # now: what is written into a checkout makes it dirty

    paper = store.paper_speeds()
    print(f"{'task':<24}{'paper':>12}{'original':>12}" + "".join(f"{number:>12} envs" for number in args.num_envs))
    for name in args.tasks:
        play = original(name)
        theirs = {"original package": rate(play, args.seconds)} if play else {}
        own = {f"ours, num_envs={number}": rate(ours(name, number), args.seconds) for number in args.num_envs}
        others = paper.get(store.paper_task(name)), theirs.get("original package")
        cells = [f"{value:>12,.0f}" if value else f"{'-':>12}" for value in others]
        print(f"{name:<24}" + "".join([*cells, *(f"{value:>17,.0f}" for value in own.values())]), flush=True)
        if args.output:
            store.keep_speeds(args.output, name, theirs | own, origin)


if __name__ == "__main__":
    main()
