"""A game in which a forgotten action mask shows: the two agents of docs/exercises/index.md, task 3, and their sledge.

    python -m envs check own:examples.sledge
    python algos/iql.py --env own:examples.sledge --total-timesteps 20000 --epsilon-anneal 10000 \
        --no-reward-standardisation

Each agent waits, pulls or unloads. Eight pulls bring the sledge to its place, and only there it can be unloaded, which
ends the game. Every step before costs the team 1, and every pull 0.5. The best return is -8, of four steps in which
both pull and one that unloads; who always waits has -25. All agents see how far the sledge has come.
"""

import numpy as np

from envs.vector import VectorEnv

PULLS, STEPS = 8, 25
WAIT, PULL, UNLOAD = range(3)


class Env(VectorEnv):
    """See the module's docstring."""

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(
            name, num_envs, seed, copy, n_agents=2, n_actions=3, obs_size=1, episode_limit=STEPS, low=0, high=1
        )
        self.pulls = np.zeros(num_envs, np.int64)
        self.steps = np.zeros(num_envs, np.int64)

    def reset_env(self, e: int, rng: np.random.Generator) -> None:
        self.pulls[e] = self.steps[e] = 0
        self.show(e)

    def step_env(self, e: int, actions: np.ndarray, rng: np.random.Generator) -> None:
        self.steps[e] += 1
        pulling = (actions == PULL).sum()
        self.pulls[e] = min(self.pulls[e] + pulling, PULLS)
        self.terminated[e] = (actions == UNLOAD).any()
        self.truncated[e] = not self.terminated[e] and self.steps[e] == STEPS
        self.rewards[e] = 0 if self.terminated[e] else -1 - pulling / 2
        self.agent_rewards[e] = self.rewards[e] / 2
        self.show(e)

    def show(self, e: int) -> None:
        """Writes what the agents see and may do."""
        self.observations[e] = self.pulls[e] / PULLS
        self.action_mask[e, :, UNLOAD] = self.pulls[e] == PULLS
