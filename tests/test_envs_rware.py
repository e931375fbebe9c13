"""The multi-robot warehouse: step by step against the package rware, collisions made by hand, and its starts.

By default a tenth of the steps are compared with the package; ENVS_FULL=1 compares all.
"""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import networkx
import numpy as np
import pytest
from numpy.typing import NDArray
from rware.warehouse import Action, Direction, RewardType, Warehouse

import envs
from envs import rware
from envs.kernels import random_below

SHARE = 1 if os.environ.get("ENVS_FULL") == "1" else 10
AGAINST_PACKAGE = {  # steps; the package needs milliseconds for a step of many agents
    "rware-tiny-1p": 40_000,
    "rware-tiny-2p": 100_000,
    "rware-tiny-2p-hard": 40_000,
    "rware-tiny-3p-5s-easy": 5_000,
    "rware-tiny-4p": 60_000,
    "rware-small-4p": 30_000,
    "rware-tiny-6p-2s-hard": 10_000,
    "rware-medium-4p-easy": 20_000,
    "rware-tiny-10p": 6_000,
    "rware-tiny-20p-hard": 6_000,
    "rware-large-20p-easy": 5_000,
}
BLOCKS = {"tiny": (1, 3), "small": (2, 3), "medium": (2, 5), "large": (3, 5)}  # rows and columns of blocks
UP, DOWN, LEFT, RIGHT = 0, 1, 2, 3
NOTHING, FORWARD, TURN_LEFT, TURN_RIGHT, TOGGLE = 0, 1, 2, 3, 4


def make(name: str, num_envs: int = 1, **others: Any) -> rware.Env:
    env = envs.make(name, num_envs, **others)
    assert isinstance(env, rware.Env)
    return env


def place(env: rware.Env, e: int, agents: Any, loads: Any, shelves: Any, requested: Any) -> None:
    """Put one sub-environment into a given state.

    agents: (row, column, direction) of each; loads: the shelf that each carries, or -1; shelves: (row, column) of each;
    requested: numbers of shelves.
    """
    game, config = env.game, env.config
    game.steps[e] = 0
    game.deliveries[e] = 0
    game.collisions[e] = 0
    game.shelf[e, :, 2] = 0
    game.shelf[e, list(requested), 2] = 1
    for row in range(config.rows):
        for column in range(config.columns):
            rware.put_agent(game, config, e, row, column, -1)
            rware.put_shelf(game, config, e, row, column, -1)
    for s, (row, column) in enumerate(shelves):
        game.shelf[e, s, :2] = row, column
        rware.put_shelf(game, config, e, row, column, s)
    for i, (row, column, direction) in enumerate(agents):
        game.agent[e, i] = row, column, direction, loads[i]
        rware.put_agent(game, config, e, row, column, i)
    rware.observe_env(game, config, e)


# ---------------------------------------------------------------------------------------------------------------------
# Against the package
# ---------------------------------------------------------------------------------------------------------------------


def original(env: rware.Env) -> Warehouse:
    """The package's game; built directly, since it registers neither 20 agents nor, by default, longer sensors."""
    blocks_high, blocks_wide = BLOCKS[env.name.split("-")[1]]
    return Warehouse(
        shelf_columns=blocks_wide,
        column_height=8,
        shelf_rows=blocks_high,
        n_agents=env.n_agents,
        msg_bits=0,
        sensor_range=env.config.sight,
        request_queue_size=env.config.n_requests,
        max_inactivity_steps=None,
        max_steps=500,
        reward_type=RewardType.INDIVIDUAL,
    )


def place_like(env: rware.Env, theirs: Warehouse) -> None:
    """Put the first sub-environment into the package's state."""
    place(
        env,
        0,
        [(agent.y, agent.x, agent.dir.value) for agent in theirs.agents],
        [agent.carrying_shelf.id - 1 if agent.carrying_shelf else -1 for agent in theirs.agents],
        [(shelf.y, shelf.x) for shelf in theirs.shelfs],
        [shelf.id - 1 for shelf in theirs.request_queue],
    )


class OurDraws:
    """Stands in for the package's random generator, so that it requests the shelves that ours requests."""

    def __init__(self, random: NDArray[np.uint64], shelves: list[Any]) -> None:
        self.random, self.shelves = random.copy(), shelves

    def choice(self, candidates: list[Any]) -> Any:
        while True:
            shelf = self.shelves[random_below(self.random, 0, len(self.shelves))]
            if shelf in candidates:
                return shelf


def choose_lowest_number(theirs: Warehouse, counts: Counter[str]) -> Callable[[networkx.DiGraph], Any]:
    """networkx's longest path, but where queues of one length meet the agent with the lowest number is on it."""
    any_longest_path = networkx.algorithms.dag_longest_path

    def longest_path(cells: networkx.DiGraph) -> Any:
        def length(cell: Any) -> int:
            return 1 + max(map(length, cells.pred[cell]), default=0)

        theirs_path = any_longest_path(cells)
        path, tie = [theirs_path[-1]], False
        while behind := list(cells.pred[path[0]]):
            longest = [cell for cell in behind if length(cell) == max(map(length, behind))]
            tie |= len(longest) > 1
            path.insert(0, min(longest, key=lambda cell: theirs.grid[0, cell[1], cell[0]]))
        assert len(path) == len(theirs_path)
        counts["ties"] += tie
        counts["ties that the package breaks in another way"] += path != theirs_path
        return path

    return longest_path


def count_circles(counts: Counter[str]) -> Callable[[networkx.DiGraph], Any]:
    find_cycle = networkx.algorithms.find_cycle

    def counting(cells: networkx.DiGraph) -> Any:
        cycle = find_cycle(cells)
        counts["circles"] += len(cycle) > 2
        counts["swaps refused"] += len(cycle) == 2
        return cycle

    return counting


@lru_cache(maxsize=None)
def distances(warehouse: str, to_row: int, to_column: int) -> NDArray[np.int64]:
    """Steps to a cell from each [row, column] on highways alone. warehouse: "." for each cell of a highway, by rows."""
    rows = warehouse.split()
    steps = np.full((len(rows), len(rows[0])), 999)
    steps[to_row, to_column] = 0
    reached = deque([(to_row, to_column)])
    while reached:
        row, column = reached.popleft()
        for r, c in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            if 0 <= r < len(rows) and 0 <= c < len(rows[0]) and steps[r, c] == 999:
                steps[r, c] = steps[row, column] + 1
                if rows[r][c] == ".":
                    reached.append((r, c))
    return steps


def purposeful_action(theirs: Warehouse, agent: Any, warehouse: str) -> int:
    """Fetch the nearest requested shelf, carry it to a goal, and then to the nearest place that is free."""
    row, column = agent.y, agent.x
    goals: list[Any] = []
    if not agent.carrying_shelf:
        carried = [other.carrying_shelf for other in theirs.agents]
        goals = [(shelf.y, shelf.x) for shelf in theirs.request_queue if shelf not in carried]
    elif agent.carrying_shelf in theirs.request_queue:
        goals = [(y, x) for x, y in theirs.goals]
    else:
        goals = np.argwhere((theirs.grid[1] == 0) & (theirs.highways == 0)).tolist()
    if not goals:
        return NOTHING
    steps = min((distances(warehouse, *goal) for goal in goals), key=lambda steps: steps[row, column])
    if steps[row, column] == 0:
        return TOGGLE
    around = {UP: (row - 1, column), DOWN: (row + 1, column), LEFT: (row, column - 1), RIGHT: (row, column + 1)}
    inside = {d: cell for d, cell in around.items() if 0 <= cell[0] < len(steps) and 0 <= cell[1] < len(steps[0])}
    free = {d: cell for d, cell in inside.items() if theirs.highways[cell] or steps[cell] == 0}
    wanted = min(free, key=lambda d: steps[free[d]])
    if agent.dir.value == wanted:
        return FORWARD
    clockwise = [UP, RIGHT, DOWN, LEFT]
    quarters = (clockwise.index(wanted) - clockwise.index(agent.dir.value)) % 4
    return TURN_LEFT if quarters == 3 else TURN_RIGHT


def lively_actions(
    theirs: Warehouse, warehouse: str, mood: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Random actions, in mood 1 mostly forward, in the moods above it mostly purposeful."""
    actions = rng.integers(0, 5, theirs.n_agents)
    if mood == 1:
        actions[rng.random(theirs.n_agents) < 0.6] = FORWARD
    elif mood > 1:
        for i in np.flatnonzero(rng.random(theirs.n_agents) < 0.9):
            actions[i] = purposeful_action(theirs, theirs.agents[i], warehouse)
    return actions


def held_up(theirs: Warehouse, actions: NDArray[np.int64]) -> list[tuple[Any, tuple[int, int]]]:
    """The agents, with their cells, that neither walls nor standing shelves keep from going forward."""
    carriers = {agent.carrying_shelf.id for agent in theirs.agents if agent.carrying_shelf}
    found = []
    for agent, action in zip(theirs.agents, actions):
        agent.req_action = Action(action)
        x, y = agent.req_location(theirs.grid_size)
        standing = theirs.grid[1, y, x] > 0 and theirs.grid[1, y, x] not in carriers
        if (x, y) != (agent.x, agent.y) and not (agent.carrying_shelf and standing):
            found.append((agent, (agent.x, agent.y)))
    return found


@pytest.mark.parametrize("name", AGAINST_PACKAGE)
def test_every_step_equals_the_package(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make(name)
    theirs, game = original(env), env.game
    warehouse = "\n".join("".join(".x"[not highway] for highway in row) for row in theirs.highways)
    counts: Counter[str] = Counter()
    monkeypatch.setattr(networkx.algorithms, "dag_longest_path", choose_lowest_number(theirs, counts))
    monkeypatch.setattr(networkx.algorithms, "find_cycle", count_circles(counts))
    rng = np.random.default_rng(1)
    env.reset()
    mood = 2
    for step in range(AGAINST_PACKAGE[name] // SHARE):
        if step % 500 == 0:
            env.reset()
            theirs_observed, _ = theirs.reset(seed=step)
            place_like(env, theirs)
            assert np.array_equal(env.observations[0], np.stack(theirs_observed))
            deliveries = collisions = 0
        if step % 50 == 0 and step % 500 >= 200:
            mood = int(rng.integers(0, 5))
        actions = lively_actions(theirs, warehouse, mood, rng)
        theirs.np_random = OurDraws(game.random, theirs.shelfs)
        free_to_go = held_up(theirs, actions)
        loads = [agent.carrying_shelf for agent in theirs.agents]

        theirs_observed, theirs_rewards, theirs_done, _, _ = theirs.step(list(actions))
        observations, rewards, terminated, truncated, info = env.step(actions[None])

        assert np.array_equal(observations[0], np.stack(theirs_observed))
        assert np.array_equal(info["agent_rewards"][0], theirs_rewards)
        assert rewards[0] == sum(theirs_rewards)
        assert truncated[0] == theirs_done == (step % 500 == 499) and not terminated[0]
        assert game.random[0] == theirs.np_random.random[0]
        assert game.agent[0].tolist() == [
            [agent.y, agent.x, agent.dir.value, agent.carrying_shelf.id - 1 if agent.carrying_shelf else -1]
            for agent in theirs.agents
        ]
        assert game.shelf[0, :, :2].tolist() == [[shelf.y, shelf.x] for shelf in theirs.shelfs]
        assert set(np.flatnonzero(game.shelf[0, :, 2])) == {shelf.id - 1 for shelf in theirs.request_queue}
        assert np.array_equal(game.cell[0, :, :, 0], theirs.grid[0] - 1)
        assert np.array_equal(game.cell[0, :, :, 1], theirs.grid[1] - 1)
        blocked = sum((agent.x, agent.y) == before for agent, before in free_to_go)
        deliveries += int(rewards[0])
        collisions += blocked
        assert (info["statistics"]["deliveries"][0], info["statistics"]["collisions"][0]) == (deliveries, collisions)

        counts["moves"] += len(free_to_go) - blocked
        counts["collisions"] += blocked
        counts["deliveries"] += int(rewards[0])
        for agent, load in zip(theirs.agents, loads):
            counts["loads"] += load is None and agent.carrying_shelf is not None
            counts["unloads"] += load is not None and agent.carrying_shelf is None
    print(name, AGAINST_PACKAGE[name] // SHARE, "steps", dict(counts))
    assert min(counts["moves"], counts["loads"], counts["unloads"], counts["deliveries"]) > 0
    assert env.n_agents == 1 or counts["collisions"] > 0
