"""Level-Based Foraging (Albrecht and Ramamoorthy, 2013; Papoudakis et al., 2021): collect foods on a board, together.

    lbf-<rows>x<columns>-<n>p-<f>f[-2s][-c][-v3]      n agents, f foods; -2s: sight 2; -c: cooperative; -v3: see below

Agents and foods have levels. Agents that stand next to a food (not diagonally) and load in the same step collect it if
the sum of their levels is at least the food's level.

Actions: 0 nothing, 1 north (row - 1), 2 south (row + 1), 3 west (column - 1), 4 east (column + 1), 5 load. The mask
always allows all of them. An action that cannot be carried out (off the board, onto a food, no food to load) does
nothing. Agents that would stand on the same cell after the step all stay where they are, also if one of them is there
already. An agent that is held back in this way does not keep another from moving onto its cell, so two agents can stand
on one cell. The original does the same.

Observation (3 f + 3 n values):
    row, column, level of each visible food, in row-major order; -1, -1, 0 for each food out of sight, collected or
    never placed;
    row, column, level of the agent itself, then of the other visible agents in order; -1, -1, 0 for each out of sight.
With -2s the sight is 2, otherwise the longer side of the board. An agent sees the foods that are at most `sight` rows
and columns away. Rows and columns are counted from the top left corner of this window, which ends at the border of the
board. Another agent is visible if both its coordinates, counted in this way, lie in 0 .. 2 sight. Near the top and the
left border this is further than foods are seen, as in the original. State: the observations of all agents in a row.

Reward: an agent that takes part in collecting a food receives its own level * the food's level / (the sum of the
loaders' levels * the sum of all foods' levels at the start). The team's reward is the sum over the agents, so that an
episode in which all foods are collected returns 1.
End: no food left is a termination; step 50 is a truncation.

Start: agents have level 1 or 2. S is the sum of the three smallest levels (of all, if there are fewer agents). Foods
lie inside the border, at least three steps apart. At most 1,000 places are drawn for them. On a small board the first
foods can leave no room for the next, so an episode may begin with fewer than f. With -c all foods have level S.
    The paper's rules (version 1 of lbforaging): agents start anywhere but in the last row and the last column; without
    -c the foods have levels 1 .. S-1 (or 1, if S is 1).
    -v3 (today's lbforaging): agents start anywhere; without -c the foods have levels 1 .. S.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.families import PLACES_TRIED
from envs.families.kernels import compiled, episode_state, forbidden_action, random_below

EPISODE_LIMIT = 50
NORTH, SOUTH, WEST, EAST, LOAD = 1, 2, 3, 4, 5


class State(NamedTuple):
    """One game for each index of the leading axis."""

    random: NDArray[np.uint64]  # [env] the generator's state
    steps: NDArray[np.int64]  # [env]
    score: NDArray[np.float64]  # [env] the team's return so far
    agent: NDArray[np.int64]  # [env, agent, (row, column, level)]
    target: NDArray[np.int64]  # [env, agent, (row, column)] where the agent wants to be after this step
    loading: NDArray[np.int64]  # [env, agent] the food that it loads in this step, or -1
    food: NDArray[np.int64]  # [env, food, (row, column, level)] in row-major order; level 0: collected
    food_left: NDArray[np.int64]  # [env] how many are left
    food_total: NDArray[np.int64]  # [env] sum of the foods' levels at the start
    observations: NDArray[np.float32]  # [env, agent, value]
    agent_rewards: NDArray[np.float32]  # [env, agent]
    rewards: NDArray[np.float32]  # [env]
    terminated: NDArray[np.bool_]  # [env]
    truncated: NDArray[np.bool_]  # [env]


class Config(NamedTuple):
    """What the name says."""

    rows: int
    columns: int
    sight: int
    cooperative: bool
    version: int


@compiled
def reset_env(state, config, e):
    """Place agents, then foods."""
    agent, food, random = state.agent, state.food, state.random
    n_agents, n_foods = agent.shape[1], food.shape[1]
    state.steps[e] = 0
    state.score[e] = 0

    margin = 1 if config.version == 1 else 0
    level_one = 0
    for i in range(n_agents):
        free = False
        while not free:  # the board has more cells than agents
            row = random_below(random, e, config.rows - margin)
            column = random_below(random, e, config.columns - margin)
            free = True
            for j in range(i):
                free = free and (agent[e, j, 0] != row or agent[e, j, 1] != column)
        agent[e, i, 0] = row
        agent[e, i, 1] = column
        agent[e, i, 2] = 1 + random_below(random, e, 2)
        level_one += agent[e, i, 2] == 1
        state.loading[e, i] = -1

    three = min(n_agents, 3)
    three_smallest = three + max(0, three - level_one)  # where a 1 is missing among the three, there is a 2
    highest = three_smallest
    if config.version == 1 and not config.cooperative:
        highest = max(1, three_smallest - 1)

    placed = 0
    attempts = 0
    food[e, :, :] = 0
    state.food_total[e] = 0
    while placed < n_foods and attempts < PLACES_TRIED:
        attempts += 1
        row = 1 + random_below(random, e, config.rows - 2)
        column = 1 + random_below(random, e, config.columns - 2)
        free = True
        for f in range(placed):
            free = free and abs(food[e, f, 0] - row) + abs(food[e, f, 1] - column) > 2
        for i in range(n_agents):
            free = free and (agent[e, i, 0] != row or agent[e, i, 1] != column)
        if not free:
            continue
        level = highest if config.cooperative else 1 + random_below(random, e, highest)
        f = placed
        while f > 0 and (food[e, f - 1, 0], food[e, f - 1, 1]) > (row, column):  # keep row-major order
            food[e, f] = food[e, f - 1]
            f -= 1
        food[e, f, 0] = row
        food[e, f, 1] = column
        food[e, f, 2] = level
        state.food_total[e] += level
        placed += 1
    state.food_left[e] = placed


@compiled
def step_env(state, config, e, actions):
    """Decide who wants to go where and who loads; move; load."""
    agent, food, target, loading = state.agent, state.food, state.target, state.loading
    n_agents, n_foods = agent.shape[1], food.shape[1]
    state.steps[e] += 1

    for i in range(n_agents):
        row, column, action = agent[e, i, 0], agent[e, i, 1], actions[e, i]
        to_row = min(max(row + (action == SOUTH) - (action == NORTH), 0), config.rows - 1)
        to_column = min(max(column + (action == EAST) - (action == WEST), 0), config.columns - 1)
        blocked = False
        next_to = -1  # foods are three steps apart, so no agent is next to two of them
        for f in range(n_foods):
            there = food[e, f, 2] > 0
            blocked |= there & (food[e, f, 0] == to_row) & (food[e, f, 1] == to_column)
            if there & (abs(food[e, f, 0] - row) + abs(food[e, f, 1] - column) == 1):
                next_to = f
        target[e, i, 0] = row if blocked else to_row
        target[e, i, 1] = column if blocked else to_column
        loading[e, i] = next_to if action == LOAD else -1

    for i in range(n_agents):
        alone = True
        for j in range(n_agents):
            alone &= (j == i) | (target[e, j, 0] != target[e, i, 0]) | (target[e, j, 1] != target[e, i, 1])
        if alone:
            agent[e, i, 0] = target[e, i, 0]
            agent[e, i, 1] = target[e, i, 1]
        state.agent_rewards[e, i] = 0

    team_reward = 0.0
    for i in range(n_agents):
        f = loading[e, i]
        if f < 0 or food[e, f, 2] == 0:
            continue
        level = food[e, f, 2]
        loaders = 0
        for j in range(n_agents):
            loaders += agent[e, j, 2] if loading[e, j] == f else 0
        if loaders < level:
            continue
        for j in range(n_agents):
            if loading[e, j] == f:
                reward = agent[e, j, 2] * level / (loaders * state.food_total[e])
                state.agent_rewards[e, j] = reward
                team_reward += reward
        food[e, f, 2] = 0
        state.food_left[e] -= 1
    state.rewards[e] = team_reward
    state.score[e] += team_reward

    state.terminated[e] = state.food_left[e] == 0
    state.truncated[e] = state.food_left[e] > 0 and state.steps[e] == EPISODE_LIMIT


@compiled
def observe_env(state, config, e):
    """Write what each agent sees."""
    agent, food, observations = state.agent, state.food, state.observations
    n_agents, n_foods = agent.shape[1], food.shape[1]
    sight = config.sight
    for i in range(n_agents):
        row, column = agent[e, i, 0], agent[e, i, 1]
        top, left = max(row - sight, 0), max(column - sight, 0)
        seen = 0
        for f in range(n_foods):
            if food[e, f, 2] > 0 and abs(food[e, f, 0] - row) <= sight and abs(food[e, f, 1] - column) <= sight:
                observations[e, i, seen] = food[e, f, 0] - top
                observations[e, i, seen + 1] = food[e, f, 1] - left
                observations[e, i, seen + 2] = food[e, f, 2]
                seen += 3
        while seen < 3 * n_foods:
            observations[e, i, seen] = -1
            observations[e, i, seen + 1] = -1
            observations[e, i, seen + 2] = 0
            seen += 3
        observations[e, i, seen] = row - top
        observations[e, i, seen + 1] = column - left
        observations[e, i, seen + 2] = agent[e, i, 2]
        seen += 3
        for j in range(n_agents):
            r, c = agent[e, j, 0] - top, agent[e, j, 1] - left
            if j != i and 0 <= r <= 2 * sight and 0 <= c <= 2 * sight:
                observations[e, i, seen] = r
                observations[e, i, seen + 1] = c
                observations[e, i, seen + 2] = agent[e, j, 2]
                seen += 3
        while seen < 3 * (n_foods + n_agents):
            observations[e, i, seen] = -1
            observations[e, i, seen + 1] = -1
            observations[e, i, seen + 2] = 0
            seen += 3


# The loops take State and Config as plain tuples, since a NamedTuple costs 1 to 2 microseconds more at the border to
# Python; a step of ten boards takes 5.


@compiled
def reset_all(arrays, numbers, mask, seed, episodes):
    state, config = State(*arrays), Config(*numbers)
    for e in range(len(mask)):
        if mask[e]:
            state.random[e] = episode_state(seed, e, episodes[e])
            reset_env(state, config, e)
            observe_env(state, config, e)


@compiled
def step_all(arrays, numbers, action_mask, actions, playing):
    refused = forbidden_action(actions, action_mask)
    if refused >= 0:
        return refused
    state, config = State(*arrays), Config(*numbers)
    for e in range(len(playing)):
        if playing[e]:
            step_env(state, config, e, actions)
            observe_env(state, config, e)
    return -1


class Env(vector.VectorEnv):
    """Level-Based Foraging; see the module's docstring."""

    can_draw, picture = True, "envs.pictures.lbf"

    def __init__(
        self,
        name: str,
        num_envs: int,
        seed: int,
        copy: bool,
        *,
        rows: int,
        columns: int,
        n_agents: int,
        n_foods: int,
        sight: int,
        cooperative: bool,
        version: int,
    ) -> None:
        """version: 1 for the start of the paper's rules, 3 for that of today's lbforaging."""
        super().__init__(
            name,
            num_envs,
            seed,
            copy,
            n_agents=n_agents,
            n_actions=6,
            obs_size=3 * n_foods + 3 * n_agents,
            episode_limit=EPISODE_LIMIT,
            low=-1,
            high=max(rows - 1, columns - 1, 2 * min(n_agents, 3)),
        )
        self.game = State(
            random=np.zeros(num_envs, np.uint64),
            steps=np.zeros(num_envs, np.int64),
            score=np.zeros(num_envs),
            agent=np.zeros((num_envs, n_agents, 3), np.int64),
            target=np.zeros((num_envs, n_agents, 2), np.int64),
            loading=np.zeros((num_envs, n_agents), np.int64),
            food=np.zeros((num_envs, n_foods, 3), np.int64),
            food_left=np.zeros(num_envs, np.int64),
            food_total=np.zeros(num_envs, np.int64),
            observations=self.observations,
            agent_rewards=self.agent_rewards,
            rewards=self.rewards,
            terminated=self.terminated,
            truncated=self.truncated,
        )
        self.config = Config(rows, columns, sight, cooperative, version)
        self._arguments = (tuple(self.game), tuple(self.config))
        self._step_arguments = (*self._arguments, self.action_mask)

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """See `VectorEnv`."""
        reset_all(*self._arguments, mask, seed, episodes)

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        return step_all(*self._step_arguments, actions, playing)
