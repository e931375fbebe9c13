"""Tasks in the terminal.

python -m envs                   a table of the paper's tasks
python -m envs <name> ...        the named tasks
python -m envs check <name>      whether an environment keeps the contract; exit code 1 if it does not
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any

from tqdm import tqdm

import envs
from envs import tasks
from envs.check import hints, problems
from envs.runs import Parser, check_flags, one_sentence, with_flags
from envs.workers import closed_games

HEADER = ("task", "agents", "observation", "state", "actions", "episode limit", "on-policy steps", "off-policy steps")


def row(name: str, options: Mapping[str, Any]) -> tuple[str, ...]:
    """One line of the table. options: of `envs.make`. Raises InputError for a name that is not a task."""
    task = envs.task(name)
    env = envs.make(name, **options)
    sizes = (env.n_agents, env.obs_size, env.state_size, env.n_actions, env.episode_limit)
    return (name, *(f"{size:,}" for size in (*sizes, task.on_policy_timesteps, task.off_policy_timesteps)))


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of environments that are not ours."""
    parser.add_argument("--env-kwargs", default="", help="keyword arguments, as they stand in a call")
    parser.add_argument("--max-episode-steps", type=int, default=0, help="cut episodes after so many steps")
    parser.add_argument("--flatten-images", action="store_true", help="make vectors of images")
    parser.add_argument("--no-divide-images", dest="divide_images", action="store_false", help="they have codes")
    parser.add_argument("--action-bins", type=int, default=0, help="values in each dimension of continuous actions")


def check_task(argv: list[str]) -> int:
    """Check a task, and say what is wrong. Returns the exit code."""
    parser = Parser(
        prog="python -m envs check",
        description="Plays some episodes, and says what in an environment is not as envs/vector.py has it: shapes, "
        "seeds, masks, resets, flags. Exit code 0: nothing; 1: something.",
    )
    parser.add_argument("name", help="a task")
    add_flags(parser)
    parser.add_argument("--env-workers", type=int, default=0, help="processes that play the episodes")
    flags = parser.parse_args(argv)
    args = vars(flags)
    name = args.pop("name")
    progress = partial(tqdm, desc=f"checking {name}", unit=" topics", leave=False, disable=None)

    def make(num_envs: int, seed: int, copy: bool) -> envs.VectorEnv:
        return envs.make(name, num_envs, seed, copy, **args)

    check_flags(flags)
    found = problems(make, progress)
    lines = found or [f"{name} keeps the contract.", *(f"Hint: {hint}" for hint in hints(make))]
    print("\n".join(map(with_flags, lines)))
    return 1 if found else 0


def main(argv: list[str]) -> int:
    """Print the table. Returns the exit code. Raises InputError for a wrong name."""
    if argv[:1] == ["check"]:
        return check_task(argv[1:])
    grammar = (tasks.__doc__ or "").split("\n\n")[1]
    parser = Parser(
        prog="python -m envs",
        description=(__doc__ or "").partition("\n\n")[2],
        epilog=f"names:\n{grammar}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="name", help="a task; without any, all tasks of the paper")
    add_flags(parser)
    flags = parser.parse_args(argv)
    options = vars(flags)
    names = options.pop("names")
    check_flags(flags)
    table = [HEADER, *(row(name, options) for name in names or envs.task_names())]
    widths = [max(len(line[column]) for line in table) for column in range(len(HEADER))]
    for line in table:
        cells = (cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))
        print("  ".join((line[0].ljust(widths[0]), *cells)))
    return 0


if __name__ == "__main__":
    with closed_games(), one_sentence("envs"):
        code = main(sys.argv[1:])
    sys.exit(code)
