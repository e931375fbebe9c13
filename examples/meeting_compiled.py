"""The game of meeting_numpy.py as compiled rules, as the families of this project have them.

    python -m envs check own:examples.meeting_compiled
    python algos/ippo.py --env own:examples.meeting_compiled --total-timesteps 200000

The rules are functions of one sub-environment e. Numba compiles them with the loops over all sub-environments, which
take arrays and numbers only. What is compiled is kept until a file changes in this folder or in `envs/`, so rules and
the loops that call them should lie in one folder.
"""

import numpy as np
from numpy.typing import NDArray

from envs.families.kernels import compiled, episode_state, forbidden_action, random_below
from envs.vector import VectorEnv

CELLS, STEPS = 9, 20
LEFT, RIGHT = 1, 2


@compiled
def reset_env(random, cell, steps, e):
    cell[e, 0] = random_below(random, e, CELLS)
    cell[e, 1] = random_below(random, e, CELLS - 1)
    if cell[e, 1] >= cell[e, 0]:  # any of the other cells
        cell[e, 1] += 1
    steps[e] = 0


@compiled
def step_env(cell, steps, rewards, agent_rewards, terminated, truncated, e, actions):
    for i in range(2):
        move = (actions[e, i] == RIGHT) - (actions[e, i] == LEFT)
        cell[e, i] = min(max(cell[e, i] + move, 0), CELLS - 1)
    steps[e] += 1
    met = cell[e, 0] == cell[e, 1]
    rewards[e] = met - 0.05
    agent_rewards[e, :] = rewards[e] / 2
    terminated[e] = met
    truncated[e] = not met and steps[e] == STEPS


@compiled
def observe_env(cell, observations, e):
    for i in range(2):
        observations[e, i, 0] = cell[e, i]
        observations[e, i, 1] = cell[e, 1 - i]


@compiled
def reset_all(random, cell, steps, observations, mask, seed, episodes):
    for e in range(len(mask)):
        if mask[e]:
            random[e] = episode_state(seed, e, episodes[e])
            reset_env(random, cell, steps, e)
            observe_env(cell, observations, e)


@compiled
def step_all(cell, steps, observations, rewards, agent_rewards, terminated, truncated, action_mask, actions, playing):
    refused = forbidden_action(actions, action_mask)
    if refused >= 0:
        return refused
    for e in range(len(playing)):
        if playing[e]:
            step_env(cell, steps, rewards, agent_rewards, terminated, truncated, e, actions)
            observe_env(cell, observations, e)
    return -1


class Env(VectorEnv):
    """The arrays that the rules work on, and the calls of the loops."""

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool) -> None:
        super().__init__(
            name, num_envs, seed, copy, n_agents=2, n_actions=3, obs_size=2, episode_limit=STEPS, low=0, high=CELLS - 1
        )
        self.random = np.zeros(num_envs, np.uint64)  # the generator's state
        self.cell = np.zeros((num_envs, 2), np.int64)
        self.steps = np.zeros(num_envs, np.int64)

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        reset_all(self.random, self.cell, self.steps, self.observations, mask, seed, episodes)

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        arrays = (self.cell, self.steps, self.observations, self.rewards, self.agent_rewards)
        return step_all(*arrays, self.terminated, self.truncated, self.action_mask, actions, playing)
