"""The repeated matrix games of Claus and Boutilier (1998): climbing and penalty.

Two agents choose a row and a column at the same time and both receive the entry of the payoff matrix, 25 times.

    climbing   11  -30   0         penalty   -k   0  10
              -30    7   0                    0   2   0
                0    6   5                   10   0  -k

The benchmark paper prints climbing's rows from the bottom to the top, but its results belong to the order above. In
this order, two agents that choose the same action earn 11, 7 or 5. Untrained agents that share a network do choose the
same action, so their episodes return 275, 175 or 125, and the mean and the interval of the paper's VDN can only come
from such returns. In the paper IA2C, IPPO, MAA2C and MAPPO end at 175 with all seeds. With the rows as they are
printed, MAPPO found 275 with five of nine seeds.

Observation: always two zeros for each agent. Actions: 0, 1, 2, the row (agent 0) or the column (agent 1).
Reward: each agent receives the payoff. The team's reward is the mean over the agents, which is the payoff again.
End: step 25, a truncation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.families.kernels import compiled, forbidden_action

EPISODE_LIMIT = 25


class State(NamedTuple):
    """One game for each index of the leading axis."""

    steps: NDArray[np.int64]  # [env]
    agent_rewards: NDArray[np.float32]  # [env, agent]
    truncated: NDArray[np.bool_]  # [env]


@compiled
def reset_env(state, e):
    state.steps[e] = 0


@compiled
def step_env(state, payoff, e, actions):
    state.steps[e] += 1
    for i in range(2):
        state.agent_rewards[e, i] = payoff[actions[e, 0], actions[e, 1]]
    state.truncated[e] = state.steps[e] == EPISODE_LIMIT


@compiled
def reset_all(steps, agent_rewards, truncated, mask):
    state = State(steps, agent_rewards, truncated)
    for e in range(len(mask)):
        if mask[e]:
            reset_env(state, e)


@compiled
def step_all(steps, agent_rewards, truncated, rewards, action_mask, payoff, actions, playing):
    refused = forbidden_action(actions, action_mask)
    if refused >= 0:
        return refused
    state = State(steps, agent_rewards, truncated)
    for e in range(len(playing)):
        if playing[e]:
            step_env(state, payoff, e, actions)
            rewards[e] = (agent_rewards[e, 0] + agent_rewards[e, 1]) / 2
    return -1


class Env(vector.VectorEnv):
    """Matrix games; see the module's docstring."""

    can_draw, picture = True, "envs.pictures.matrix"

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool, payoffs: tuple[tuple[float, ...], ...]) -> None:
        """payoffs: the table, as many rows as columns."""
        size, steps = len(payoffs), EPISODE_LIMIT
        super().__init__(
            name, num_envs, seed, copy, n_agents=2, n_actions=size, obs_size=2, episode_limit=steps, low=0, high=0
        )
        self.payoffs = payoffs
        self.steps = np.zeros(num_envs, np.int64)
        self.chosen = np.full((num_envs, 2), -1)  # the last joint action, for pictures; -1: none yet
        self.scores = np.zeros(num_envs)  # the returns so far
        self._arrays = (self.steps, self.agent_rewards, self.truncated)
        self._step_arrays = (*self._arrays, self.rewards, self.action_mask, np.array(payoffs, np.float32))

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """See `VectorEnv`; there is nothing random in these games."""
        reset_all(*self._arrays, mask)
        self.chosen[mask], self.scores[mask] = -1, 0

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        refused = step_all(*self._step_arrays, actions, playing)
        if refused < 0:
            self.chosen[playing] = actions[playing]
            self.scores[playing] += self.rewards[playing]
        return refused
