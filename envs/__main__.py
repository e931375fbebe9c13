"""`python -m envs`: the paper's tasks that are here, in a table. `python -m envs <name> ...`: those tasks."""

from __future__ import annotations

import argparse
import sys

import envs

HEADER = ("task", "agents", "observation", "state", "actions", "episode limit", "on-policy steps", "off-policy steps")


def row(name: str) -> tuple[str, ...]:
    """One line of the table. Raises InputError for a name that is not a task."""
    task = envs.task(name)
    env = envs.make(name)
    sizes = (env.n_agents, env.obs_size, env.state_size, env.n_actions, env.episode_limit)
    return (name, *(f"{size:,}" for size in (*sizes, task.on_policy_timesteps, task.off_policy_timesteps)))


def main(argv: list[str]) -> int:
    """Print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m envs", description="Tasks, their sizes and the paper's budgets.")
    parser.add_argument("names", nargs="*", metavar="name", help="of a task; default: the paper's that are here")
    names = parser.parse_args(argv).names
    try:
        table = [HEADER, *(row(name) for name in names or envs.task_names())]
    except envs.InputError as error:
        print(error, file=sys.stderr)
        return 2
    widths = [max(len(line[column]) for line in table) for column in range(len(HEADER))]
    for line in table:
        cells = (cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))
        print("  ".join((line[0].ljust(widths[0]), *cells)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
