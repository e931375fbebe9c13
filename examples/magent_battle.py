"""Two armies of MAgent. The package does not say that they are opponents, so this module does.

    pip install magent2
    python algos/ippo.py --env pettingzoo:examples.magent_battle --flatten-images --individual-rewards \\
        --no-parameter-sharing --env-kwargs "map_size=12, max_cycles=100"

Rewards are then each agent's own, and the return in tables is that of team 0, the red army.
"""

from typing import Any

from magent2.environments import battle_v4


def parallel_env(**options: Any) -> Any:
    """The battle, with the number of each agent's team. options: those of MAgent's own function."""
    env = battle_v4.parallel_env(**options)
    env.unwrapped.teams = {agent: 0 if agent.startswith("red") else 1 for agent in env.possible_agents}
    return env
