"""`python -m envs`: the paper's tasks in a table. `python -m envs <name> ...`: those tasks."""

from __future__ import annotations

import sys

import envs

HEADER = ("task", "agents", "observation", "state", "actions", "episode limit", "on-policy steps", "off-policy steps")


def row(name: str) -> tuple[str, ...]:
    """One line of the table. Raises InputError for a name that is not a task."""
    task = envs.task(name)
    env = envs.make(name)
    sizes = (env.n_agents, env.obs_size, env.state_size, env.n_actions, env.episode_limit)
    return (name, *(f"{size:,}" for size in (*sizes, task.on_policy_timesteps, task.off_policy_timesteps)))


def main(names: list[str]) -> int:
    """Print the table; returns the exit code."""
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
