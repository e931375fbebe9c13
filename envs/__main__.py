"""`python -m envs` prints a table of the paper's tasks, `python -m envs <name> ...` one of the named tasks."""

from __future__ import annotations

import argparse
import os
import sys

import envs

HEADER = ("task", "agents", "observation", "state", "actions", "episode limit", "on-policy steps", "off-policy steps")


def row(name: str) -> tuple[str, ...]:
    """One line of the table. Raises InputError for a name that is not a task."""
    task = envs.task(name)
    env = envs.make(name)
    sizes = (env.n_agents, env.obs_size, env.state_size, env.n_actions, env.episode_limit)
    return (name, *(f"{size:,}" for size in (*sizes, task.on_policy_timesteps, task.off_policy_timesteps)))


def main(argv: list[str]) -> None:
    """Print the table. A wrong name ends with one sentence and exit code 2."""
    parser = argparse.ArgumentParser(prog="python -m envs", description="Tasks, their sizes and the paper's budgets.")
    parser.add_argument("names", nargs="*", metavar="name", help="a task; without any, all tasks of the paper")
    names = parser.parse_args(argv).names
    try:
        table = [HEADER, *(row(name) for name in names or envs.task_names())]
    except envs.InputError as error:
        parser.exit(2, f"{error}\n")
    widths = [max(len(line[column]) for line in table) for column in range(len(HEADER))]
    lines = []
    for line in table:
        cells = (cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True))
        lines.append("  ".join((line[0].ljust(widths[0]), *cells)))
    try:
        print("\n".join(lines), flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more when it exits
        if not isinstance(error, BrokenPipeError):  # that is a reader such as `head`, which has seen enough
            parser.exit(2, f"The table cannot be written: {error}.\n")


if __name__ == "__main__":
    main(sys.argv[1:])
