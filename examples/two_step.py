"""A game that QMIX solves, and VDN and IQL do not: the two-step game of the paper on QMIX (Rashid et al., 2018).

    python -m envs check own:examples.two_step
    python algos/qmix.py --env own:examples.two_step --total-timesteps 12000

In the first step agent 0's action decides which game is played in the second. In game A the team always earns 7. In
game B it earns 8 if both agents take action 1, 0 if neither does, and 1 otherwise. Each agent sees which of the three
states it is.
"""

import numpy as np

from envs.vector import VectorEnv

GAMES = np.array([[[7, 7], [7, 7]], [[0, 1], [1, 8]]])  # [game A or B, action of agent 0, of agent 1]


class Env(VectorEnv):
    """State 0 is the first step; states 1 and 2 are the games A and B."""

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(
            name, num_envs, seed, copy, n_agents=2, n_actions=2, obs_size=3, episode_limit=2, low=0, high=1
        )
        self.now = np.zeros(num_envs, np.int64)

    def reset_env(self, e: int, rng: np.random.Generator) -> None:
        self.now[e] = 0
        self.observations[e] = np.eye(3)[0]

    def step_env(self, e: int, actions: np.ndarray, rng: np.random.Generator) -> None:
        over = self.now[e] > 0
        self.rewards[e] = GAMES[self.now[e] - 1, actions[0], actions[1]] if over else 0
        self.agent_rewards[e] = self.rewards[e] / 2
        self.terminated[e] = over
        if not over:
            self.now[e] = 1 + actions[0]
        self.observations[e] = np.eye(3)[self.now[e]]
