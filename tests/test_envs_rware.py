"""The multi-robot warehouse: step by step against the package rware, collisions made by hand, and its starts.

By default a tenth of the steps are compared with the package; ENVS_FULL=1 compares all.
"""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rware import warehouse as package
from rware.warehouse import Action, Direction, RewardType, Warehouse

import envs
from envs.families import rware
from envs.families.kernels import random_below

SHARE = 1 if os.environ.get("ENVS_FULL") == "1" else 10
AGAINST_PACKAGE = {  # steps; the package needs milliseconds for a step of many agents
    "rware-tiny-1p": 100_000,
    "rware-tiny-2p": 120_000,
    "rware-tiny-2p-hard": 30_000,
    "rware-tiny-3p-5s-easy": 3_000,
    "rware-tiny-4p": 18_000,
    "rware-small-4p": 10_000,
    "rware-tiny-6p-2s-hard": 4_000,
    "rware-medium-4p-easy": 8_000,
    "rware-tiny-10p": 3_000,
    "rware-tiny-20p-hard": 3_000,
    "rware-large-20p-easy": 3_000,
}
FAST = "rware-tiny-3p-5s-easy"  # in the fast set, too
BLOCKS = {"tiny": (1, 3), "small": (2, 3), "medium": (2, 5), "large": (3, 5)}  # rows and columns of blocks
UP, DOWN, LEFT, RIGHT = 0, 1, 2, 3
NOTHING, FORWARD, TURN_LEFT, TURN_RIGHT, TOGGLE = 0, 1, 2, 3, 4


def make(name: str, num_envs: int = 1, **others: Any) -> rware.Env:
    env = envs.make(name, num_envs, **others)
    assert isinstance(env, rware.Env)
    return env


def place(env: rware.Env, e: int, agents: Any, loads: Any, shelves: Any, requested: Any) -> None:
    """Put one sub-environment into a given state; its clock and its statistics go on.

    agents: (row, column, direction) of each; loads: the shelf that each carries, or -1; shelves: (row, column) of each;
    requested: numbers of shelves.
    """
    game, config = env.game, env.config
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


def place_theirs(theirs: Warehouse, env: rware.Env) -> None:
    """Put the package into the first sub-environment's state."""
    game = env.game
    theirs.reset(seed=0)
    for shelf, (row, column) in zip(theirs.shelfs, game.shelf[0, :, :2].tolist()):
        shelf.y, shelf.x = row, column
    theirs.request_queue = [theirs.shelfs[s] for s in np.flatnonzero(game.shelf[0, :, 2])]
    for agent, (row, column, direction, load) in zip(theirs.agents, game.agent[0].tolist()):
        agent.y, agent.x, agent.dir = row, column, Direction(direction)
        agent.carrying_shelf = theirs.shelfs[load] if load >= 0 else None
    theirs._recalc_grid()


class OurDraws:
    """Stands in for the package's random generator, so that it requests the shelves that ours requests."""

    def __init__(self, random: NDArray[np.uint64], shelves: list[Any]) -> None:
        self.random, self.shelves = random.copy(), shelves

    def choice(self, candidates: list[Any]) -> Any:
        while True:
            shelf = self.shelves[random_below(self.random, 0, len(self.shelves))]
            if shelf in candidates:
                return shelf


def choose_lowest_number(theirs: Warehouse, counts: Counter[str]) -> Callable[[Any], Any]:
    """networkx's longest path, but where queues of one length meet the agent with the lowest number is on it."""
    any_longest_path = package.nx.algorithms.dag_longest_path

    def longest_path(cells: Any) -> Any:
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


def count_circles(counts: Counter[str]) -> Callable[[Any], Any]:
    find_cycle = package.nx.algorithms.find_cycle

    def counting(cells: Any) -> Any:
        cycle = find_cycle(cells)
        counts["circles"] += len(cycle) > 2
        counts["swaps refused"] += len(cycle) == 2
        return cycle

    return counting


@cache
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


def lively_actions(theirs: Warehouse, warehouse: str, mood: int, rng: np.random.Generator) -> NDArray[np.int64]:
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


def step_both(env: rware.Env, theirs: Warehouse, actions: Any) -> bool:
    """Step ours and the package's game, which are in the same state, and compare. Returns whether theirs is done."""
    game = env.game
    theirs.np_random = OurDraws(game.random, theirs.shelfs)
    theirs_observed, theirs_rewards, theirs_done, _, _ = theirs.step(list(actions))
    observations, rewards, terminated, _, info = env.step(np.array([actions]))
    assert np.array_equal(observations[0], np.stack(theirs_observed))
    assert np.array_equal(info["agent_rewards"][0], theirs_rewards)
    assert rewards[0] == sum(theirs_rewards) and not terminated[0]
    assert game.random[0] == theirs.np_random.random[0]
    assert game.agent[0].tolist() == [
        [agent.y, agent.x, agent.dir.value, agent.carrying_shelf.id - 1 if agent.carrying_shelf else -1]
        for agent in theirs.agents
    ]
    assert game.shelf[0, :, :2].tolist() == [[shelf.y, shelf.x] for shelf in theirs.shelfs]
    assert set(np.flatnonzero(game.shelf[0, :, 2])) == {shelf.id - 1 for shelf in theirs.request_queue}
    assert np.array_equal(game.cell[0, :, :, 0], theirs.grid[0] - 1)
    assert np.array_equal(game.cell[0, :, :, 1], theirs.grid[1] - 1)
    return theirs_done


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name != FAST else ()) for name in AGAINST_PACKAGE]
)
def test_every_step_equals_the_package(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make(name)
    theirs = original(env)
    warehouse = "\n".join("".join(".x"[not highway] for highway in row) for row in theirs.highways)
    counts: Counter[str] = Counter()
    monkeypatch.setattr(package.nx.algorithms, "dag_longest_path", choose_lowest_number(theirs, counts))
    monkeypatch.setattr(package.nx.algorithms, "find_cycle", count_circles(counts))
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
        free_to_go = held_up(theirs, actions)
        loads = [agent.carrying_shelf for agent in theirs.agents]
        theirs_done = step_both(env, theirs, actions)
        rewards, truncated, statistics = env.rewards, env.truncated, env.statistics
        assert truncated[0] == theirs_done == (step % 500 == 499)
        blocked = sum((agent.x, agent.y) == before for agent, before in free_to_go)
        deliveries += int(rewards[0])
        collisions += blocked
        assert (statistics["deliveries"][0], statistics["collisions"][0]) == (deliveries, collisions)

        counts["moves"] += len(free_to_go) - blocked
        counts["collisions"] += blocked
        counts["deliveries"] += int(rewards[0])
        for agent, load in zip(theirs.agents, loads):
            counts["loads"] += load is None and agent.carrying_shelf is not None
            counts["unloads"] += load is not None and agent.carrying_shelf is None
    print(name, AGAINST_PACKAGE[name] // SHARE, "steps", dict(counts))
    assert min(counts["moves"], counts["loads"], counts["unloads"], counts["deliveries"]) > 0
    assert env.n_agents == 1 or counts["collisions"] > 0


@pytest.mark.parametrize("loaded", [False, True])
@pytest.mark.slow
def test_crowds_equal_the_package(loaded: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty agents in 24 cells, most of which want to go forward: circles, and queues that meet."""
    env = make("rware-tiny-20p")
    theirs, counts = original(env), Counter[str]()
    monkeypatch.setattr(package.nx.algorithms, "dag_longest_path", choose_lowest_number(theirs, counts))
    monkeypatch.setattr(package.nx.algorithms, "find_cycle", count_circles(counts))
    rng = np.random.default_rng(2)
    for _ in range(2_000 // SHARE):
        env.reset()
        shelves = env.game.shelf[0, :, :2].copy()
        free = [(row, column) for row in range(5, 11) for column in range(3, 7)]  # all of them highways
        agents = [(*free[k], int(rng.integers(4))) for k in rng.permutation(len(free))[:20]]
        loads = [i if loaded and rng.random() < 0.7 else -1 for i in range(20)]
        for i, load in enumerate(loads):
            if load >= 0:
                shelves[load] = agents[i][:2]
        place(env, 0, agents, loads, shelves, rng.choice(32, 20, replace=False))
        place_theirs(theirs, env)
        step_both(env, theirs, np.where(rng.random(20) < 0.9, FORWARD, rng.integers(0, 5, 20)))
    print(dict(counts))
    assert min(counts["circles"], counts["ties"], counts["swaps refused"]) > 0


# ---------------------------------------------------------------------------------------------------------------------
# By hand. The tiny warehouse has shelves in the columns 1, 2, 7 and 8 of the rows 1 to 8, numbered by rows; its goals
# are the columns 4 and 5 of row 10.
# ---------------------------------------------------------------------------------------------------------------------


def by_hand(agents: Any, loads: Any = None, requested: Any = None, suffix: str = "") -> rware.Env:
    """A tiny warehouse in which all shelves but the carried ones are in their places."""
    env = make(f"rware-tiny-{len(agents)}p{suffix}", seed=4)
    env.reset()
    shelves = env.game.shelf[0, :, :2].copy()
    loads = loads or [-1] * len(agents)
    for (row, column, _), load in zip(agents, loads):
        if load >= 0:
            shelves[load] = row, column
    place(env, 0, agents, loads, shelves, range(20, 20 + len(agents)) if requested is None else requested)
    return env


CASES = {  # agents (row, column, direction), loads, actions ("f" forward, "t" load or unload, "-" nothing), who moves
    "a queue moves as one": ([(0, 1, RIGHT), (0, 2, RIGHT), (0, 3, RIGHT)], [-1, -1, -1], "fff", "yyy"),
    "a queue stops behind one who stands": ([(0, 1, RIGHT), (0, 2, RIGHT), (0, 3, RIGHT)], [-1, -1, -1], "ff-", "nnn"),
    "a queue stops at the wall": ([(0, 7, RIGHT), (0, 8, RIGHT), (0, 9, RIGHT)], [-1, -1, -1], "fff", "nnn"),
    "nobody follows one who turns": ([(0, 1, RIGHT), (0, 2, RIGHT)], [-1, -1], "fl", "nn"),
    "two do not change places": ([(0, 1, RIGHT), (0, 2, LEFT)], [-1, -1], "ff", "nn"),
    "nor does one behind them move": ([(0, 0, RIGHT), (0, 1, RIGHT), (0, 2, LEFT)], [-1, -1, -1], "fff", "nnn"),
    "four go round": ([(0, 0, RIGHT), (0, 1, DOWN), (1, 1, LEFT), (1, 0, UP)], [-1, -1, -1, -1], "ffff", "yyyy"),
    "four loaded go round": ([(9, 3, RIGHT), (9, 4, DOWN), (10, 4, LEFT), (10, 3, UP)], [0, 1, 2, 3], "ffff", "yyyy"),
    "a circle broken by one stops": ([(0, 0, RIGHT), (0, 1, DOWN), (1, 1, LEFT), (1, 0, UP)], [-1] * 4, "fff-", "nnnn"),
    "a circle goes before a queue": (
        [(9, 0, RIGHT), (9, 1, RIGHT), (9, 2, RIGHT), (9, 3, RIGHT), (9, 4, DOWN), (10, 4, LEFT), (10, 3, UP)],
        [-1] * 7,
        "fffffff",
        "nnnyyyy",
    ),
    "the lower number first": ([(9, 5, LEFT), (9, 3, RIGHT)], [-1, -1], "ff", "yn"),
    "also of three": ([(8, 4, DOWN), (9, 5, LEFT), (9, 3, RIGHT)], [-1, -1, -1], "-ff", "nyn"),
    "the longer queue first": ([(9, 5, LEFT), (9, 3, RIGHT), (9, 2, RIGHT)], [-1, -1, -1], "fff", "nyy"),
    "queues meet in a queue": (
        [(9, 3, RIGHT), (9, 4, RIGHT), (8, 4, DOWN), (10, 4, UP), (7, 4, DOWN)],
        [-1] * 5,
        "fffff",
        "nyyny",
    ),
    "the lower number first where queues meet": (
        [(9, 4, RIGHT), (10, 4, UP), (8, 4, DOWN), (9, 3, RIGHT)],
        [-1] * 4,
        "ffff",
        "yynn",
    ),
    "a shelf stops the loaded": ([(1, 0, RIGHT), (2, 0, RIGHT)], [31, -1], "ff", "ny"),
    "a shelf whose agent leaves stops them too": ([(1, 0, RIGHT), (1, 1, UP)], [31, -1], "ff", "ny"),
    "a shelf being loaded stops them too": ([(1, 0, RIGHT), (1, 1, UP)], [31, -1], "ft", "nn"),
    "a shelf that is carried away does not": ([(1, 0, RIGHT), (1, 1, UP)], [31, 0], "ff", "yy"),
    "a shelf being put down does": ([(1, 0, RIGHT), (1, 1, UP)], [31, 0], "ft", "nn"),
    "one held back by a shelf holds others": ([(1, 0, RIGHT), (2, 0, UP)], [31, -1], "ff", "nn"),
}


@pytest.mark.parametrize("case", CASES)
def test_who_moves(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    agents, loads, letters, who = CASES[case]
    env = by_hand(agents, loads)
    theirs = original(env)
    monkeypatch.setattr(package.nx.algorithms, "dag_longest_path", choose_lowest_number(theirs, Counter()))
    place_theirs(theirs, env)
    before = env.game.agent[0].copy()
    step_both(env, theirs, ["-flrt".index(letter) for letter in letters])
    after = env.game.agent[0]
    moved = (before[:, :2] != after[:, :2]).any(axis=1)
    assert "".join("ny"[int(m)] for m in moved) == who
    ahead = {UP: (-1, 0), DOWN: (1, 0), LEFT: (0, -1), RIGHT: (0, 1)}
    for i in np.flatnonzero(moved):
        assert tuple(after[i, :2] - before[i, :2]) == ahead[before[i, 2]]
        assert after[i, 3] == loads[i]
        if loads[i] >= 0:
            assert env.game.shelf[0, loads[i], :2].tolist() == after[i, :2].tolist()


def test_collisions_are_what_other_agents_prevent() -> None:
    at_the_wall, behind_it = (0, 9, RIGHT), (0, 8, RIGHT)
    env = by_hand([at_the_wall, behind_it, (1, 0, RIGHT), (0, 0, DOWN)], [-1, -1, 31, -1])
    env.step([[FORWARD, FORWARD, FORWARD, FORWARD]])  # the third is stopped by a shelf, the fourth by the third
    assert env.statistics["collisions"][0] == 2
    env.step([[FORWARD, NOTHING, FORWARD, TOGGLE]])
    assert env.statistics["collisions"][0] == 2
    env.reset()
    assert env.statistics["collisions"][0] == 0


def test_a_shelf_requested_while_it_is_on_the_second_goal_is_delivered() -> None:
    """All shelves but number 9 are requested, so number 9 must be the next; the package does the same."""
    env = by_hand([(9, 4, DOWN), (10, 5, DOWN)], [7, 9], requested=set(range(32)) - {9})
    theirs = original(env)
    place_theirs(theirs, env)
    step_both(env, theirs, [FORWARD, NOTHING])
    assert env.rewards[0] == 2 and env.agent_rewards.tolist() == [[1, 1]]
    assert set(np.flatnonzero(env.game.shelf[0, :, 2])) == set(range(32)) - {9}


def test_an_episode_ends_at_step_500_and_stands_still() -> None:
    env = make("rware-tiny-2p", 3, copy=False)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(499):
        _, _, terminated, truncated, _ = env.step(rng.integers(0, 5, (3, 2)))
        assert not truncated.any() and not terminated.any()
    shelves = env.game.shelf[0, :, :2].copy()
    shelves[7] = 9, 4
    place(env, 0, [(9, 4, DOWN), (0, 0, UP)], [7, -1], shelves, [7, 3])
    observations, rewards, terminated, truncated, info = env.step(np.full((3, 2), FORWARD))
    assert truncated.all() and not terminated.any()
    assert rewards[0] == info["agent_rewards"][0, 0] == 1
    last = observations.copy()
    env.reset(options={"reset_mask": np.array([False, True, False])})
    for _ in range(3):
        observations, rewards, _, truncated, info = env.step(np.full((3, 2), TURN_LEFT))
        assert truncated.tolist() == [True, False, True]
        assert not rewards.any() and not info["agent_rewards"].any()
        np.testing.assert_array_equal(observations[[0, 2]], last[[0, 2]])
    assert env.game.steps.tolist() == [500, 3, 500]


# ---------------------------------------------------------------------------------------------------------------------
# The start of an episode, and the draws
# ---------------------------------------------------------------------------------------------------------------------


def assert_uniform(counts: Counter[Any], values: int) -> None:
    """So many values, all alike: Pearson's chi-square is within five standard deviations of its mean."""
    expected = counts.total() / values
    assert len(counts) == values and expected > 5
    statistic = sum((count - expected) ** 2 / expected for count in counts.values())
    assert abs(statistic - (values - 1)) < 5 * np.sqrt(2 * (values - 1)) + 5


Start = tuple[list[list[int]], tuple[int, ...]]


def starts(number: int) -> list[Start]:
    """(row, column, direction) of two agents, and the requested shelves."""
    env = make("rware-tiny-2p", number, seed=8)
    env.reset()
    assert (env.game.agent[:, :, 3] == -1).all()
    requested = [tuple(np.flatnonzero(shelves).tolist()) for shelves in env.game.shelf[:, :, 2]]
    return list(zip(env.game.agent[:, :, :3].tolist(), requested))


def starts_of_the_package(number: int) -> list[Start]:
    """The same of the package; without observations, which take most of its time."""
    theirs = original(make("rware-tiny-2p"))
    theirs._make_obs = lambda agent: None
    theirs.reset(seed=0)
    found = []
    for _ in range(number):
        theirs.reset()
        agents = [[int(agent.y), int(agent.x), agent.dir.value] for agent in theirs.agents]
        found.append((agents, tuple(sorted(shelf.id - 1 for shelf in theirs.request_queue))))
    return found


@pytest.mark.parametrize(("draw", "number"), [(starts, 30_000), (starts_of_the_package, 5_000)])
@pytest.mark.slow
def test_starts(draw: Callable[[int], Any], number: int) -> None:
    found = draw(number)
    for i in range(2):
        assert_uniform(Counter((agents[i][0], agents[i][1]) for agents, _ in found), 110)
    assert_uniform(Counter((agents[0][2], agents[1][2]) for agents, _ in found), 16)
    assert_uniform(Counter(requested for _, requested in found), 32 * 31 // 2)
    assert all(agents[0][:2] != agents[1][:2] for agents, _ in found)
    together = Counter((first[1] < 5, second[1] < 5, requested[0] < 4) for (first, second), requested in found)
    assert len(together) == 8


def test_new_requests() -> None:
    """Each shelf that is not requested is as likely as any other; the delivered one is still requested."""
    number = 20_000
    env = make("rware-tiny-2p", number, seed=9)
    env.reset()
    shelves = env.game.shelf[0, :, :2].copy()
    shelves[7] = 9, 4
    place(env, 0, [(9, 4, DOWN), (0, 0, UP)], [7, -1], shelves, [3, 7])
    for array in env.game:
        if array is not env.game.random:
            array[1:] = array[:1]
    _, rewards, *_ = env.step(np.tile([FORWARD, NOTHING], (number, 1)))
    assert (rewards == 1).all()
    requested = env.game.shelf[:, :, 2]
    assert (requested.sum(axis=1) == 2).all() and (requested[:, 3] == 1).all()
    others = Counter(np.flatnonzero(np.delete(requested, 3, axis=1)) % 31)
    assert 6 not in others  # number 7 itself
    assert_uniform(others, 30)
