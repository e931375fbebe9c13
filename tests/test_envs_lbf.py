"""Level-Based Foraging, compared with episodes recorded from the paper's version and with today's lbforaging.

The starts of its episodes are compared with exact probabilities. By default a tenth of the steps are compared with
lbforaging; ENVS_FULL=1 compares all of them.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Tuple
from lbforaging.foraging import ForagingEnv
from numpy.typing import NDArray

import envs
from envs.families import lbf

RECORDED = sorted((Path(__file__).parent / "data").glob("lbf-*.npz"))
STEPS = 18_000 if os.environ.get("ENVS_FULL") == "1" else 1_800  # for each of the tasks below
AGAINST_PACKAGE = (
    "lbf-8x8-2p-2f-c-v3",
    "lbf-8x8-2p-2f-2s-c-v3",
    "lbf-10x10-3p-3f-v3",
    "lbf-10x10-3p-3f-2s-v3",
    "lbf-15x15-3p-5f-v3",
    "lbf-15x15-4p-5f-v3",
    "lbf-5x5-2p-1f-v3",
    "lbf-5x5-2p-2f-2s-v3",  # foods do not always fit
    "lbf-6x9-3p-2f-v3",
    "lbf-11x5-4p-3f-2s-v3",
    "lbf-4x13-3p-2f-c-v3",
    "lbf-6x6-8p-2f-c-v3",  # crowded: agents stand in each other's way
    "lbf-20x20-9p-9f-v3",
    "lbf-7x7-1p-3f-v3",
)


def make(name: str, num_envs: int = 1, **others: Any) -> lbf.Env:
    env = envs.make(name, num_envs, **others)
    assert isinstance(env, lbf.Env)
    return env


def place(env: lbf.Env, e: int, positions: Any, levels: Any, field: NDArray[Any]) -> None:
    """Put one sub-environment into a given start: field holds the foods' levels [row, column]."""
    game = env.game
    game.agent[e, :, :2] = positions
    game.agent[e, :, 2] = levels
    game.food[e] = 0
    cells = np.argwhere(field)  # in row-major order
    game.food[e, : len(cells), :2] = cells
    game.food[e, : len(cells), 2] = field[tuple(cells.T)]
    game.food_left[e] = len(cells)
    game.food_total[e] = field.sum()
    game.steps[e] = 0
    game.score[e] = 0
    lbf.observe_env(game, env.config, e)


def board(env: lbf.Env, e: int) -> NDArray[np.int64]:
    """The foods' levels [row, column]."""
    field = np.zeros((env.config.rows, env.config.columns), np.int64)
    for row, column, level in env.game.food[e]:
        field[row, column] += level
    return field


# ---------------------------------------------------------------------------------------------------------------------
# The rules
# ---------------------------------------------------------------------------------------------------------------------


def test_all_seven_tasks_of_the_paper_are_recorded() -> None:
    assert {path.stem for path in RECORDED} == {name for name in envs.task_names() if name.startswith("lbf-")}


@pytest.mark.parametrize("path", RECORDED, ids=lambda path: path.stem)
def test_recorded_episodes_follow(path: Path) -> None:
    recorded = np.load(path)
    episodes = len(recorded["length"])
    env = make(path.stem, episodes)
    env.reset()
    for e in range(episodes):
        place(env, e, recorded["position"][e], recorded["level"][e], recorded["field"][e])
    np.testing.assert_array_equal(env.observations, recorded["observations"][:, 0])
    for t in range(50):
        observations, rewards, terminated, truncated, info = env.step(recorded["actions"][:, t])
        played = t < recorded["length"]
        own = recorded["rewards"][:, t]
        np.testing.assert_array_equal(observations[played], recorded["observations"][played, t + 1])
        np.testing.assert_array_equal(info["agent_rewards"][played], own[played].astype(np.float32))
        np.testing.assert_array_equal(rewards[played], own[played].sum(axis=1).astype(np.float32))
        np.testing.assert_array_equal((terminated | truncated)[played], (t + 1 == recorded["length"])[played])
        assert not rewards[~played].any() and not info["agent_rewards"][~played].any()


def original(name: str) -> ForagingEnv:
    """The package's game of that name, built directly, because the package does not register all sizes."""
    match = re.fullmatch(r"lbf-(\d+)x(\d+)-(\d+)p-(\d+)f(-2s)?(-c)?-v3", name)
    assert match is not None
    rows, columns, players, foods = (int(match[i]) for i in range(1, 5))
    env = ForagingEnv(
        players=players,
        min_player_level=1,
        max_player_level=2,
        min_food_level=1,
        max_food_level=None,
        field_size=(rows, columns),
        max_num_food=foods,
        sight=2 if match[5] else max(rows, columns),
        max_episode_steps=50,
        force_coop=match[6] is not None,
    )
    # The package bounds rows by the number of columns and the other way round, and checks every observation.
    env.observation_space = Tuple([Box(-1, 99, env.observation_space[0].shape)] * players)
    return env


def lively_actions(env: lbf.Env, e: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Random actions, most of them towards the first food, so that agents meet, get in each other's way and collect."""
    actions = rng.integers(0, 6, env.n_agents)
    foods = env.game.food[e][env.game.food[e, :, 2] > 0]
    for i in np.flatnonzero(rng.random(env.n_agents) < 0.7):
        row, column = foods[0, :2] - env.game.agent[e, i, :2]
        if abs(row) + abs(column) == 1:
            actions[i] = 5
        elif abs(row) > abs(column):
            actions[i] = 2 if row > 0 else 1
        else:
            actions[i] = 4 if column > 0 else 3
    return actions


@pytest.mark.parametrize("name", AGAINST_PACKAGE)
@pytest.mark.slow
def test_every_step_equals_the_package(name: str) -> None:
    """State by state. It compares with np.array_equal: assert_array_equal would take a quarter of the time."""
    theirs, env = original(name), make(name)
    rng = np.random.default_rng(1)
    env.reset()
    done, episodes, collected, shared = True, 0, 0, 0
    for _ in range(STEPS):
        if done:
            env.reset()
            theirs_observed, _ = theirs.reset(seed=episodes)
            place(env, 0, [p.position for p in theirs.players], [p.level for p in theirs.players], theirs.field)
            assert np.array_equal(env.observations[0], np.stack(theirs_observed))
            episodes += 1
        actions = lively_actions(env, 0, rng)
        theirs_observed, own, theirs_done, _, _ = theirs.step(list(actions))
        observations, rewards, terminated, truncated, info = env.step(actions[None])
        assert np.array_equal(observations[0], np.stack(theirs_observed))
        assert np.array_equal(info["agent_rewards"][0], np.array(own, np.float32))
        assert rewards[0] == np.float32(sum(own))
        assert np.array_equal(env.game.agent[0, :, :2], [p.position for p in theirs.players])
        assert np.array_equal(env.game.agent[0, :, 2], [p.level for p in theirs.players])
        assert np.array_equal(board(env, 0), theirs.field)
        assert terminated[0] == (theirs.field.sum() == 0)
        assert truncated[0] == (theirs_done and not terminated[0])
        done = theirs_done
        collected += rewards[0] > 0
        shared += len({p.position for p in theirs.players}) < env.n_agents
    print(f"{name}: {STEPS} steps, {episodes} episodes, {collected} with a food collected, {shared} with a shared cell")
    assert collected > 0


def test_clearing_the_board_in_the_last_step_is_a_termination() -> None:
    env = make("lbf-5x5-2p-1f")
    env.reset()
    field = np.zeros((5, 5), np.int64)
    field[1, 1] = 2
    place(env, 0, [(0, 1), (4, 4)], [2, 1], field)
    env.game.steps[0] = 49
    _, rewards, terminated, truncated, info = env.step([[5, 5]])
    assert (rewards[0], terminated[0], truncated[0]) == (1, True, False)
    assert info["agent_rewards"].tolist() == [[1, 0]]
    env.reset()
    place(env, 0, [(0, 1), (4, 4)], [1, 2], field)
    env.game.steps[0] = 49
    _, rewards, terminated, truncated, _ = env.step([[5, 5]])
    assert (rewards[0], terminated[0], truncated[0]) == (0, False, True)


# ---------------------------------------------------------------------------------------------------------------------
# The start of an episode
# ---------------------------------------------------------------------------------------------------------------------


def starts(name: str, number: int) -> lbf.State:
    """The first states of so many episodes."""
    env = make(name, number, seed=11)
    env.reset()
    return env.game


def assert_frequencies(counts: Counter[Any], expected: dict[Any, float]) -> None:
    """Only expected values occur, and Pearson's chi-square is within five standard deviations of its mean."""
    number = counts.total()
    assert set(counts) <= set(expected)
    assert abs(sum(expected.values()) - 1) < 1e-9
    statistic = sum((counts[key] - number * p) ** 2 / (number * p) for key, p in expected.items())
    degrees = len(expected) - 1
    assert abs(statistic - degrees) < 5 * np.sqrt(2 * degrees) + 5


def uniform(values: Any) -> dict[Any, float]:
    values = list(values)
    return {value: 1 / len(values) for value in values}


@pytest.mark.parametrize(("suffix", "rows", "columns"), [("", 6, 8), ("-v3", 7, 9)])
def test_agents_start_anywhere_they_may(suffix: str, rows: int, columns: int) -> None:
    game = starts(f"lbf-7x9-3p-2f{suffix}", 60_000)
    for i in range(3):
        cells = Counter((int(row), int(column)) for row, column, _ in game.agent[:, i])
        assert_frequencies(cells, uniform(product(range(rows), range(columns))))
    levels = Counter(tuple(levels) for levels in game.agent[:, :, 2].tolist())
    assert_frequencies(levels, uniform(product((1, 2), repeat=3)))
    places = game.agent[:, :, 0] * 9 + game.agent[:, :, 1]
    assert all((places[:, i] != places[:, j]).all() for i, j in ((0, 1), (0, 2), (1, 2)))


@pytest.mark.parametrize("n_agents", [1, 2, 4])
@pytest.mark.parametrize("cooperative", ["", "-c"])
@pytest.mark.parametrize("version", ["", "-v3"])
def test_food_levels(n_agents: int, cooperative: str, version: str) -> None:
    game = starts(f"lbf-9x9-{n_agents}p-2f{cooperative}{version}", 30_000)
    three = np.sort(game.agent[:, :, 2], axis=1)[:, :3].sum(axis=1)
    assert (game.food_total == game.food[:, :, 2].sum(axis=1)).all() and (game.food_left == 2).all()
    for total in np.unique(three):
        levels = game.food[three == total, :, 2]
        if cooperative:
            assert (levels == total).all()
        else:
            highest = total if version else max(1, total - 1)
            pairs = Counter(tuple(pair) for pair in levels.tolist())
            assert_frequencies(pairs, uniform(product(range(1, highest + 1), repeat=2)))


@pytest.mark.parametrize("name", ["lbf-8x8-4p-4f", "lbf-6x6-2p-4f-c-v3", "lbf-15x15-4p-5f", "lbf-5x12-3p-3f-v3"])
def test_foods_keep_their_distances_and_their_order(name: str) -> None:
    env = make(name, 2_000)
    env.reset()
    for agents, foods, left in zip(env.game.agent, env.game.food, env.game.food_left, strict=True):
        there = foods[:left]
        assert (there[:, 2] > 0).all() and not foods[left:].any() and left >= 1
        assert (there[:, :2] >= 1).all() and (there[:, :2] <= (env.config.rows - 2, env.config.columns - 2)).all()
        cells = [(int(row), int(column)) for row, column, _ in there]
        assert cells == sorted(cells)
        field = np.zeros((env.config.rows, env.config.columns), np.int64)
        for row, column in cells:  # as the package's own rule says it: eight neighbours, and two steps straight ahead
            assert not field[row - 1 : row + 2, column - 1 : column + 2].any()
            assert not field[max(row - 2, 0) : row + 3, column].any() and not field[row, max(column - 2, 0) :][:5].any()
            field[row, column] = 1
        assert not field[agents[:, 0], agents[:, 1]].any()


def features(env: lbf.Env, agents: Any, levels: Any, field: NDArray[Any]) -> dict[str, int]:
    rows, columns = env.config.rows, env.config.columns
    cells = np.argwhere(field)
    near = min(abs(r - row) + abs(c - column) for row, column in agents for r, c in cells)
    apart = min((int(np.abs(a - b).sum()) for a, b in pairwise(cells)), default=0)
    return {
        "foods": len(cells),
        "food levels": int(field.sum()),
        "agent levels": int(sum(levels)),
        "rows": int(sum(row for row, _ in agents)),
        "border": sum(row in (0, rows - 1) or column in (0, columns - 1) for row, column in agents),
        "last": sum(row == rows - 1 or column == columns - 1 for row, column in agents),
        "near": int(near),
        "apart": apart,
        "food rows": int(cells[:, 0].sum()),
    }


def our_features(env: lbf.Env) -> list[dict[str, int]]:
    """Of the starts of all sub-environments."""
    env.reset()
    agents = env.game.agent
    return [features(env, agents[e, :, :2].tolist(), agents[e, :, 2], board(env, e)) for e in range(env.num_envs)]


def assert_same_distribution(ours: list[dict[str, int]], theirs: list[dict[str, int]]) -> None:
    """The two-sample chi-square statistic of each feature is within five standard deviations of its mean."""
    for feature in ours[0]:
        a, b = Counter(start[feature] for start in ours), Counter(start[feature] for start in theirs)
        values = [value for value in a | b if a[value] + b[value] >= 20]
        if len(values) < 2:
            continue
        scale = np.sqrt(b.total() / a.total())
        statistic = sum((a[v] * scale - b[v] / scale) ** 2 / (a[v] + b[v]) for v in values)
        assert statistic < len(values) + 5 * np.sqrt(2 * len(values)) + 5, feature


@pytest.mark.parametrize("name", ["lbf-8x8-2p-2f-c-v3", "lbf-15x15-3p-5f-v3", "lbf-5x5-2p-2f-v3", "lbf-5x9-4p-3f-v3"])
@pytest.mark.slow
def test_starts_like_the_package(name: str) -> None:
    env, theirs, number = make(name, 4_000, seed=3), original(name), 2_000
    samples = []
    theirs.reset(seed=5)
    for _ in range(number):
        for player in theirs.players:
            player.position = None  # otherwise the package keeps the last episode's places free
        theirs.reset()
        agents, levels = [p.position for p in theirs.players], [p.level for p in theirs.players]
        samples.append(features(env, agents, levels, theirs.field))
    assert_same_distribution(our_features(env), samples)


@pytest.mark.parametrize("path", RECORDED, ids=lambda path: path.stem)
def test_starts_like_the_recorded_ones(path: Path) -> None:
    recorded = np.load(path)
    env = make(path.stem, 4_000, seed=3)
    ours = our_features(env)
    theirs = [
        features(env, recorded["position"][e].tolist(), recorded["level"][e], recorded["field"][e])
        for e in range(len(recorded["length"]))
    ]
    for feature in ("last", "foods"):
        assert {start[feature] for start in theirs} <= {start[feature] for start in ours}
    assert_same_distribution(ours, theirs)
