"""An environment of your own in plain NumPy: two agents on a line of cells try to meet.

    python -m envs check own:examples.meeting_numpy
    python algos/ippo.py --env own:examples.meeting_numpy --total-timesteps 200000

Actions: 0 stay, 1 left, 2 right. Each agent sees its own cell and the other's. Every step costs the team 0.05, and
meeting on a cell earns 1 and ends the episode. Agents next to each other that both move only change places.
"""

import numpy as np

from envs.vector import VectorEnv

CELLS, STEPS = 9, 20
MOVES = np.array([0, -1, 1])


class Env(VectorEnv):
    """The base class keeps the arrays, checks actions and lets what has finished stand still."""

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(
            name, num_envs, seed, copy, n_agents=2, n_actions=3, obs_size=2, episode_limit=STEPS, low=0, high=CELLS - 1
        )
        self.cell = np.zeros((num_envs, 2), np.int64)
        self.steps = np.zeros(num_envs, np.int64)

    def reset_env(self, e: int, rng: np.random.Generator) -> None:
        self.cell[e] = rng.choice(CELLS, 2, replace=False)
        self.steps[e] = 0
        self.observations[e] = [self.cell[e], self.cell[e, ::-1]]

    def step_env(self, e: int, actions: np.ndarray, rng: np.random.Generator) -> None:
        self.cell[e] = np.clip(self.cell[e] + MOVES[actions], 0, CELLS - 1)
        self.steps[e] += 1
        met = self.cell[e, 0] == self.cell[e, 1]
        self.rewards[e] = met - 0.05
        self.agent_rewards[e] = self.rewards[e] / 2
        self.terminated[e] = met
        self.truncated[e] = not met and self.steps[e] == STEPS
        self.observations[e] = [self.cell[e], self.cell[e, ::-1]]
