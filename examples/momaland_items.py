"""MOMAland's item gathering. Its rewards are vectors, a number for each kind of item; they are weighed here.

pip install momaland
python algos/mappo.py --env pettingzoo:examples.momaland_items --env-kwargs "weights=[1, 1, 1]"
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from momaland.envs.item_gathering import moitem_gathering_v0
from momaland.utils.parallel_wrappers import LinearizeReward


def parallel_env(weights: Sequence[float] = (1, 1, 1), steps: int = 50) -> Any:
    """Agents gather items. weights: what an item of each kind is worth. steps: of an episode."""
    env = moitem_gathering_v0.parallel_env(num_timesteps=steps)
    env.unwrapped.max_cycles = steps  # where adapters look for it
    return LinearizeReward(env, {agent: np.array(weights, float) for agent in env.possible_agents})
