"""The multi-robot warehouse (Christianos et al., 2020; Papoudakis et al., 2021): bring the requested shelves to a goal.

    rware-<tiny|small|medium|large>-<n>p[-<r>s][-easy|-hard]

n agents, 1 to 20; -<r>s: they sense 2 to 5 cells far instead of 1. There are n requests, 2 n with -easy, n // 2 with
-hard; at least one, and fewer than shelves. The rules are those of the package rware 2.x, which are the paper's.

The warehouse: blocks of shelves, 2 wide and 8 high, with highways one cell wide around them. The lowest row is a
highway too, and the two cells in its middle are the goals. The two middle columns have no shelves in the lowest blocks.
    tiny     11 rows, 10 columns,  32 shelves        medium   20 rows, 16 columns, 144 shelves
    small    20 rows, 10 columns,  80 shelves        large    29 rows, 16 columns, 224 shelves

An agent without a load walks under shelves; one that carries a shelf cannot enter a cell in which a shelf stands. A
shelf can be put down in any cell without a shelf that is not a highway, so it need not go back to where it was. A
request is fulfilled when its shelf, carried by an agent, is on a goal at the end of a step. Another shelf, drawn from
those that are not requested, is then requested instead, so that the number of requests stays the same. The left goal
comes first; a shelf that waits on the right goal while it is drawn is delivered in the same step.

Actions: 0 nothing, 1 forward, 2 turn left, 3 turn right, 4 load or unload. The mask always allows all; an action that
cannot be done (forward into the wall or into a shelf while loaded, nothing to load, unload on a highway) is nothing.

Moves: all agents act at the same time, by the state before the step. An agent that wants to go into another's cell can
do so only if that one leaves it in this step. Agents behind one another therefore move as a queue, and three or more in
a circle turn around as one; two that face each other cannot change places. Of several that want the same cell, a
member of such a circle goes first, else the one with the longest queue behind it. Where the queues are of one length
the original's choice is arbitrary (it depends on the order in which Python's sets and networkx visit the cells); here
the agent with the lowest number goes, of those that want the cell. The same holds for a cell that a queue leaves.

Observation of an agent, 8 + 7 (2 r + 1)^2 values (71 where r = 1):
    0 column, 1 row, counted from the top left corner; 2 whether it carries a shelf; 3-6 its direction, one of up, down,
    left, right; 7 whether it is on a highway;
    then, of each cell up to r rows and columns away, row by row and its own cell included, 7 values:
    whether an agent is there; that agent's direction, one of up, down, left, right ("up" where there is no agent, a
    quirk of the original, kept); whether a shelf is there, standing or carried; whether that shelf is requested.
Cells beyond the walls look like empty ones. State: the observations of all agents, one after the other.

Reward of an agent: 1 for each request that it fulfils. The team's reward is the sum over the agents.
End: step 500, a truncation. There is no termination.
Statistics: "deliveries", the requests fulfilled in the episode; "collisions", how often an agent wanted to move and
could not because of other agents (a wall or a shelf before it does not count).

Start: agents in different cells, all cells alike (highways, goals, under shelves), in any direction, without a load;
all shelves in their places; each set of requested shelves is as likely as any other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.families.kernels import compiled, episode_state, forbidden_action, random_below

EPISODE_LIMIT = 500
SHELVES_HIGH = 8  # rows of shelves in a block
FORWARD, TURN_LEFT, TURN_RIGHT, TOGGLE_LOAD = 1, 2, 3, 4
UP, DOWN, LEFT, RIGHT = 0, 1, 2, 3
LEFT_OF, RIGHT_OF = (LEFT, RIGHT, DOWN, UP), (RIGHT, LEFT, UP, DOWN)  # of each direction
NONE = -1  # no agent, no shelf
OWN, SENSED = 8, 7  # values that an agent observes of itself, and of each cell


class State(NamedTuple):
    """One game per entry of the leading axis."""

    random: NDArray[np.uint64]  # [env] the generator's state
    steps: NDArray[np.int64]  # [env]
    agent: NDArray[np.int64]  # [env, agent, (row, column, direction, shelf that it carries or NONE)]
    shelf: NDArray[np.int64]  # [env, shelf, (row, column, whether it is requested)]
    cell: NDArray[np.int64]  # [env, row, column, (agent there, shelf there, agent that may come next)]; NONE: nothing
    sensed: NDArray[np.float32]  # [env, row, column * 7 + value] what is observed of cells; r cells wider on each side
    plan: NDArray[np.int64]  # [env, agent, (row it wants, column, agent it follows, queue it leads, whether it moves)]
    observations: NDArray[np.float32]  # [env, agent, value]
    agent_rewards: NDArray[np.float32]  # [env, agent]
    rewards: NDArray[np.float32]  # [env]
    truncated: NDArray[np.bool_]  # [env]
    deliveries: NDArray[np.float32]  # [env] in the episode so far
    collisions: NDArray[np.float32]  # [env] in the episode so far


# The last index of agent, shelf, cell and plan
ROW, COLUMN = 0, 1
DIRECTION, LOAD = 2, 3
REQUESTED = 2
AGENT, SHELF, NEXT = 0, 1, 2
AHEAD, QUEUE, MOVES = 2, 3, 4


class Config(NamedTuple):
    """What the name says."""

    rows: int
    columns: int
    n_requests: int
    sight: int


@compiled
def is_highway(config, row, column):
    """Whether a cell is not a place for shelves."""
    middle = config.columns // 2
    around_blocks = column % 3 == 0 or row % (SHELVES_HIGH + 1) == 0
    to_the_goals = row > config.rows - (SHELVES_HIGH + 3) and middle - 1 <= column <= middle
    return around_blocks or to_the_goals or row == config.rows - 1


@compiled
def put_agent(state, config, e, row, column, i):
    """Let agent i, or no agent, be in a cell, in whichever direction it looks."""
    state.cell[e, row, column, AGENT] = i
    direction = state.agent[e, i, DIRECTION] if i >= 0 else UP
    values = state.sensed[e, row + config.sight]
    first = (column + config.sight) * SENSED
    values[first] = i >= 0
    values[first + 1] = direction == UP
    values[first + 2] = direction == DOWN
    values[first + 3] = direction == LEFT
    values[first + 4] = direction == RIGHT


@compiled
def put_shelf(state, config, e, row, column, s):
    """Let shelf s, or no shelf, be in a cell."""
    state.cell[e, row, column, SHELF] = s
    values = state.sensed[e, row + config.sight]
    first = (column + config.sight) * SENSED
    values[first + 5] = s >= 0
    values[first + 6] = s >= 0 and state.shelf[e, s, REQUESTED] == 1


@compiled
def request(state, config, e):
    """Request one of the shelves that are not requested yet."""
    shelf = state.shelf
    s = random_below(state.random, e, shelf.shape[1])
    while shelf[e, s, REQUESTED] == 1:  # there are more shelves than requests
        s = random_below(state.random, e, shelf.shape[1])
    shelf[e, s, REQUESTED] = 1
    put_shelf(state, config, e, shelf[e, s, ROW], shelf[e, s, COLUMN], s)


@compiled
def reset_env(state, config, e):
    """Put all shelves into their places, request some of them, place agents."""
    agent, shelf, cell, random = state.agent, state.shelf, state.cell, state.random
    state.steps[e] = 0
    state.deliveries[e] = 0
    state.collisions[e] = 0

    s = 0
    for row in range(config.rows):
        for column in range(config.columns):
            put_agent(state, config, e, row, column, NONE)
            put_shelf(state, config, e, row, column, NONE)
            cell[e, row, column, NEXT] = NONE
            if not is_highway(config, row, column):
                shelf[e, s, ROW] = row
                shelf[e, s, COLUMN] = column
                shelf[e, s, REQUESTED] = 0
                put_shelf(state, config, e, row, column, s)
                s += 1
    for _ in range(config.n_requests):
        request(state, config, e)

    for i in range(agent.shape[1]):
        row = random_below(random, e, config.rows)
        column = random_below(random, e, config.columns)
        while cell[e, row, column, AGENT] >= 0:  # there are more cells than agents
            row = random_below(random, e, config.rows)
            column = random_below(random, e, config.columns)
        agent[e, i, ROW] = row
        agent[e, i, COLUMN] = column
        agent[e, i, DIRECTION] = random_below(random, e, 4)
        agent[e, i, LOAD] = NONE
        put_agent(state, config, e, row, column, i)


@compiled
def plan_moves(state, config, e, actions):
    """Find out where each agent wants to be, which is where it is unless it goes forward, and whom it follows there."""
    agent, cell, plan = state.agent, state.cell, state.plan
    for i in range(agent.shape[1]):
        row, column, direction = agent[e, i, ROW], agent[e, i, COLUMN], agent[e, i, DIRECTION]
        to_row, to_column = row, column
        if actions[e, i] == FORWARD:
            to_row = min(max(row + (direction == DOWN) - (direction == UP), 0), config.rows - 1)
            to_column = min(max(column + (direction == RIGHT) - (direction == LEFT), 0), config.columns - 1)
        other = cell[e, to_row, to_column, AGENT]
        standing_shelf = cell[e, to_row, to_column, SHELF] >= 0 and (other < 0 or agent[e, other, LOAD] < 0)
        if agent[e, i, LOAD] >= 0 and standing_shelf:
            to_row, to_column, other = row, column, i
        plan[e, i, ROW] = to_row
        plan[e, i, COLUMN] = to_column
        plan[e, i, AHEAD] = other if other != i else NONE
        plan[e, i, QUEUE] = 1


@compiled
def decide_moves(state, e):
    """Find out who moves: whole circles, and of those who want a free cell the one with the longest queue."""
    agent, cell, plan = state.agent, state.cell, state.plan
    n_agents = agent.shape[1]

    for i in range(n_agents):  # go along the agents ahead, to the first in the queue or around a circle
        length = 1
        j = plan[e, i, AHEAD]
        while j >= 0 and j != i and length < n_agents:
            length += 1
            plan[e, j, QUEUE] = max(plan[e, j, QUEUE], length)
            j = plan[e, j, AHEAD]
        plan[e, i, MOVES] = j == i and length > 2

    for i in range(n_agents):
        wanted = cell[e, plan[e, i, ROW], plan[e, i, COLUMN]]
        if wanted[AGENT] != i and (wanted[NEXT] < 0 or plan[e, i, QUEUE] > plan[e, wanted[NEXT], QUEUE]):
            wanted[NEXT] = i

    for i in range(n_agents):
        wanted = cell[e, plan[e, i, ROW], plan[e, i, COLUMN]]
        if wanted[AGENT] < 0 and wanted[NEXT] == i:
            j = i
            while j >= 0:  # each makes room for the next
                plan[e, j, MOVES] = 1
                j = cell[e, agent[e, j, ROW], agent[e, j, COLUMN], NEXT]


@compiled
def act(state, config, e, actions):
    """Let all move, turn, load and unload."""
    agent, shelf, cell, plan = state.agent, state.shelf, state.cell, state.plan
    n_agents = agent.shape[1]

    for i in range(n_agents):  # all leave their cells before one enters another's
        row, column = agent[e, i, ROW], agent[e, i, COLUMN]
        if plan[e, i, MOVES] == 1:
            put_agent(state, config, e, row, column, NONE)
            if agent[e, i, LOAD] >= 0:
                put_shelf(state, config, e, row, column, NONE)
        elif plan[e, i, ROW] != row or plan[e, i, COLUMN] != column:
            state.collisions[e] += 1

    for i in range(n_agents):
        cell[e, plan[e, i, ROW], plan[e, i, COLUMN], NEXT] = NONE
        s = agent[e, i, LOAD]
        if plan[e, i, MOVES] == 1:
            agent[e, i, ROW] = plan[e, i, ROW]
            agent[e, i, COLUMN] = plan[e, i, COLUMN]
            if s >= 0:
                shelf[e, s, ROW] = plan[e, i, ROW]
                shelf[e, s, COLUMN] = plan[e, i, COLUMN]
                put_shelf(state, config, e, shelf[e, s, ROW], shelf[e, s, COLUMN], s)
        row, column = agent[e, i, ROW], agent[e, i, COLUMN]
        if actions[e, i] == TURN_LEFT:
            agent[e, i, DIRECTION] = LEFT_OF[agent[e, i, DIRECTION]]
        elif actions[e, i] == TURN_RIGHT:
            agent[e, i, DIRECTION] = RIGHT_OF[agent[e, i, DIRECTION]]
        elif actions[e, i] == TOGGLE_LOAD and s < 0:
            agent[e, i, LOAD] = cell[e, row, column, SHELF]
        elif actions[e, i] == TOGGLE_LOAD and not is_highway(config, row, column):
            agent[e, i, LOAD] = NONE
        put_agent(state, config, e, row, column, i)


@compiled
def deliver(state, config, e):
    """Reward the agents with a requested shelf on a goal; request others instead."""
    state.agent_rewards[e, :] = 0
    state.rewards[e] = 0
    row = config.rows - 1
    for column in range(config.columns // 2 - 1, config.columns // 2 + 1):
        s = state.cell[e, row, column, SHELF]
        if s >= 0 and state.shelf[e, s, REQUESTED] == 1:
            request(state, config, e)  # another one: this one still counts as requested
            state.shelf[e, s, REQUESTED] = 0
            put_shelf(state, config, e, row, column, s)
            state.agent_rewards[e, state.cell[e, row, column, AGENT]] = 1
            state.rewards[e] += 1
            state.deliveries[e] += 1


@compiled
def step_env(state, config, e, actions):
    """Play one step."""
    plan_moves(state, config, e, actions)
    decide_moves(state, e)
    act(state, config, e, actions)
    deliver(state, config, e)
    state.steps[e] += 1
    state.truncated[e] = state.steps[e] == EPISODE_LIMIT


@compiled
def observe_env(state, config, e):
    """Write what each agent observes."""
    agent, sensed, observations = state.agent, state.sensed, state.observations
    side = 2 * config.sight + 1
    for i in range(agent.shape[1]):
        row, column, direction = agent[e, i, ROW], agent[e, i, COLUMN], agent[e, i, DIRECTION]
        observations[e, i, 0] = column
        observations[e, i, 1] = row
        observations[e, i, 2] = agent[e, i, LOAD] >= 0
        observations[e, i, 3] = direction == UP
        observations[e, i, 4] = direction == DOWN
        observations[e, i, 5] = direction == LEFT
        observations[e, i, 6] = direction == RIGHT
        observations[e, i, 7] = is_highway(config, row, column)
        k = OWN
        for r in range(row, row + side):  # `sensed` begins as many rows and columns outside the warehouse
            for value in range(column * SENSED, (column + side) * SENSED):
                observations[e, i, k] = sensed[e, r, value]
                k += 1


# The loops take State and Config as plain tuples, as in lbf.py.


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
    """The multi-robot warehouse; see the module's docstring."""

    can_draw, picture = True, "envs.pictures.rware"

    def __init__(
        self,
        name: str,
        num_envs: int,
        seed: int,
        copy: bool,
        *,
        rows: int,
        columns: int,
        n_shelves: int,
        n_agents: int,
        n_requests: int,
        sight: int,
    ) -> None:
        """sight: how many cells far an agent senses."""
        super().__init__(
            name,
            num_envs,
            seed,
            copy,
            n_agents=n_agents,
            n_actions=5,
            obs_size=OWN + SENSED * (2 * sight + 1) ** 2,
            episode_limit=EPISODE_LIMIT,
            low=0,
            high=max(rows, columns) - 1,
            statistics=["deliveries", "collisions"],
        )
        sensed = np.zeros((num_envs, rows + 2 * sight, columns + 2 * sight, SENSED), np.float32)
        sensed[..., 1 + UP] = 1  # beyond the walls too
        self.game = State(
            random=np.zeros(num_envs, np.uint64),
            steps=np.zeros(num_envs, np.int64),
            agent=np.zeros((num_envs, n_agents, 4), np.int64),
            shelf=np.zeros((num_envs, n_shelves, 3), np.int64),
            cell=np.zeros((num_envs, rows, columns, 3), np.int64),
            sensed=sensed.reshape(num_envs, rows + 2 * sight, -1),
            plan=np.zeros((num_envs, n_agents, 5), np.int64),
            observations=self.observations,
            agent_rewards=self.agent_rewards,
            rewards=self.rewards,
            truncated=self.truncated,
            deliveries=self.statistics["deliveries"],
            collisions=self.statistics["collisions"],
        )
        self.config = Config(rows, columns, n_requests, sight)
        self._arguments = (tuple(self.game), tuple(self.config))
        self._step_arguments = (*self._arguments, self.action_mask)

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """See `VectorEnv`."""
        reset_all(*self._arguments, mask, seed, episodes)

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        return step_all(*self._step_arguments, actions, playing)
