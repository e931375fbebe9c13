"""The particle environments: against episodes recorded from the paper's version, against today's mpe2, against returns
known of scripted teams; their starts, their opponents and their pictures.

By default some 6 % of the steps are compared with mpe2; ENVS_FULL=1 compares all.
"""

from __future__ import annotations

import copy
import csv
import json
import os
import pickle
import re
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from mpe2 import simple_adversary_v3, simple_speaker_listener_v4, simple_spread_v3, simple_tag_v3
from numpy.typing import NDArray
from scripts import ROOT, load_module, near, trained
from torch import nn

import envs
from envs import render, runs, tasks
from envs.families import mpe
from envs.pictures import mpe as pictures

RECORDED = sorted((Path(__file__).parent / "data").glob("mpe-*.npz"))
FULL = os.environ.get("ENVS_FULL") == "1"
EPISODES = 2_000 if FULL else 120  # of 25 steps, for each scenario
PACKAGE = {
    "mpe2-speaker-listener": simple_speaker_listener_v4,
    "mpe2-spread": simple_spread_v3,
    "mpe2-adversary-selfplay": simple_adversary_v3,
    "mpe2-tag-selfplay": simple_tag_v3,
}
ALL = [f"{rules}-{rest}" for rules in ("mpe", "mpe2") for rest in ("speaker-listener", "spread", "adversary", "tag")]
SELFPLAY = ["mpe-adversary-selfplay", "mpe-tag-selfplay", "mpe2-adversary-selfplay", "mpe2-tag-selfplay"]
AGAINST_OPPONENTS = ["mpe-adversary", "mpe-tag", "mpe2-adversary", "mpe2-tag"]
TRAINED = not any(tasks.lacks_opponent(name) for name in AGAINST_OPPONENTS)
needs_training = pytest.mark.skipif(not TRAINED, reason="the opponents are not trained yet")


@pytest.fixture(scope="module", autouse=True)
def somebody_to_play_against(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Where the opponents are not trained yet, networks with random weights stand in for them."""
    with pytest.MonkeyPatch.context() as patch:
        if not TRAINED:
            folder = tmp_path_factory.mktemp("opponents")
            random_network(folder / "mpe-adversary.npz", 10)
            random_network(folder / "mpe-tag.npz", 16)
            patch.setattr(tasks, "OPPONENTS", folder)
            patch.setattr(mpe, "OPPONENTS", folder)
        yield


def make(name: str, num_envs: int = 1, **others: Any) -> mpe.Env:
    env = envs.make(name, num_envs, **others)
    assert isinstance(env, mpe.Env)
    return env


def place(env: mpe.Env, e: int, agents: Any, landmarks: Any, goal: int = -1, velocities: Any = 0.0) -> None:
    """Put one sub-environment, just reset, into a given start."""
    env.game.agent_position[e] = agents
    env.game.agent_velocity[e] = velocities
    env.game.landmark_position[e] = landmarks
    env.game.goal[e] = goal
    mpe.observe_env(env.game, env.config, e)


def random_actions(env: mpe.Env, rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.integers(0, env.action_mask.sum(axis=2))


# ---------------------------------------------------------------------------------------------------------------------
# The rules
# ---------------------------------------------------------------------------------------------------------------------


def test_all_four_tasks_of_the_paper_are_recorded() -> None:
    assert {path.stem for path in RECORDED} == {name for name in envs.task_names() if name.startswith("mpe-")}


@pytest.mark.parametrize("path", RECORDED, ids=lambda path: path.stem)
def test_recorded_episodes_follow(path: Path) -> None:
    """All agents act, as recorded; where an opponent is built in, the others see and earn the same beside it."""
    recorded = np.load(path)
    episodes = len(recorded["goal"])
    scenario = mpe.SCENARIOS[path.stem.removeprefix("mpe-")]
    names = [path.stem, f"{path.stem}-selfplay"] if 1 in scenario.teams else [path.stem]
    for name in names:
        env = make(name, episodes)
        env.reset()
        for e in range(episodes):
            start = (recorded[x][e] for x in ("agent_position", "landmark_position", "goal", "agent_velocity"))
            place(env, e, *start)
        learning = slice(env.config.first, env.config.first + env.n_agents)
        team = [i for i, number in enumerate(scenario.teams) if number == 0]
        np.testing.assert_allclose(env.observations, recorded["observations"][:, 0, learning], rtol=0, atol=1e-5)
        for t in range(25):
            actions = recorded["actions"][:, t].astype(np.int64)
            env.game.opponent_action[:] = actions[:, env.config.opponent]
            observations, rewards, terminated, truncated, info = env.step(actions[:, learning])
            seen, own = recorded["observations"][:, t + 1], recorded["rewards"][:, t]
            np.testing.assert_allclose(observations, seen[:, learning], rtol=0, atol=1e-5)
            np.testing.assert_allclose(env.game.views, seen, rtol=0, atol=1e-5)
            np.testing.assert_allclose(info["agent_rewards"], own[:, learning], rtol=0, atol=1e-5)
            np.testing.assert_allclose(rewards, own[:, team].mean(axis=1), rtol=0, atol=1e-5)
            assert not terminated.any() and (truncated == (t == 24)).all()


@pytest.mark.parametrize("name", PACKAGE)
@pytest.mark.slow
def test_every_step_equals_the_package(name: str) -> None:
    theirs, env = PACKAGE[name].parallel_env(max_cycles=25), make(name)
    names, world = theirs.possible_agents, theirs.unwrapped.world
    rng = np.random.default_rng(1)
    pushed, away = 0, 0
    for episode in range(EPISODES):
        theirs.reset(seed=episode)
        for agent in world.agents[: episode % 2 * len(world.agents)]:  # every second episode begins in a crowd
            agent.state.p_pos *= 0.3
        chosen = getattr(world.agents[0], "_goal_b", None) or getattr(world.agents[0], "_goal_a", None)
        goal = world.landmarks.index(chosen) if chosen is not None else -1
        env.reset()
        place(
            env, 0, [agent.state.p_pos for agent in world.agents], [mark.state.p_pos for mark in world.landmarks], goal
        )
        held = random_actions(env, rng)  # some actions are held for a while, so that agents get fast and far
        for t in range(25):
            held = np.where(rng.random(held.shape) < 0.4, random_actions(env, rng), held)
            observed, own, _, ended, _ = theirs.step(dict(zip(names, held[0].tolist())))
            observations, rewards, terminated, truncated, info = env.step(held)
            for i, agent in enumerate(names):
                n = len(observed[agent])
                np.testing.assert_allclose(observations[0, i, :n], observed[agent], rtol=0, atol=1e-5)
                assert not observations[0, i, n:].any()
                assert abs(info["agent_rewards"][0, i] - own[agent]) < 1e-5
            team = [own[agent] for agent, number in zip(names, env.teams) if number == 0]
            assert abs(rewards[0] - np.mean(team)) < 1e-5
            assert truncated[0] == ended[names[0]] == (t == 24) and not terminated[0]
            pushed += bool((np.abs(env.game.force[0]) % 1 > 1e-6).any())
            away += bool((np.abs(env.game.agent_position) > 1).any())
    print(f"{name}: {25 * EPISODES} steps, {pushed} with a push, {away} with an agent outside")
    assert away > 100 and (pushed > 100) == name.startswith(("mpe2-spread", "mpe2-tag"))


def test_discs_on_one_spot_do_not_end_the_world() -> None:
    """The original divides by the distance; we have no direction to push to."""
    env = make("mpe-spread")
    env.reset()
    place(env, 0, np.zeros((3, 2)), np.ones((3, 2)))
    observations, rewards, *_ = env.step([[0, 0, 1]])
    assert np.isfinite(observations).all() and np.isfinite(rewards).all()


# ---------------------------------------------------------------------------------------------------------------------
# The scale of the paper's returns
# ---------------------------------------------------------------------------------------------------------------------

opponents = load_module(ROOT / "tools" / "train_opponents.py")


def mean_return(name: str, act: Callable[[mpe.State, np.random.Generator], Any]) -> float:
    return opponents.mean_return(make(name, 3_000), act)


@needs_training
@pytest.mark.parametrize("task", opponents.PROBES)
def test_returns_against_the_opponents_of_this_package(task: str) -> None:
    """As in 1,000 episodes when they were chosen."""
    note = json.loads((mpe.OPPONENTS / f"{task}.json").read_text())
    for name, figure in note["returns"].items():
        assert abs(mean_return(task, opponents.PROBES[task][name].act) - figure) < 0.5, name


# ---------------------------------------------------------------------------------------------------------------------
# The start of an episode, and what depends on chance
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "reach"), [("mpe-spread", 1.0), ("mpe-adversary-selfplay", 1.0), ("mpe-tag", 0.9)])
def test_starts_are_uniform(name: str, reach: float) -> None:
    number, cells = 20_000, 10
    env = make(name, number, seed=2)
    env.reset()
    assert not env.game.agent_velocity.any()
    for places, half in ((env.game.agent_position, 1.0), (env.game.landmark_position, reach)):
        assert half - 1e-3 < np.abs(places).max() < half
        for i in range(places.shape[1]):
            counts, *_ = np.histogram2d(places[:, i, 0], places[:, i, 1], bins=cells, range=[[-half, half]] * 2)
            statistic = ((counts - number / cells**2) ** 2).sum() / (number / cells**2)
            assert abs(statistic - 99) < 5 * np.sqrt(2 * 99)
    everything = np.concatenate([env.game.agent_position, env.game.landmark_position], axis=1).reshape(number, -1)
    correlations = np.corrcoef(everything.T) - np.eye(everything.shape[1])
    assert np.abs(correlations).max() < 5 / np.sqrt(number)


@pytest.mark.parametrize(("name", "goals"), [("mpe-speaker-listener", 3), ("mpe-adversary", 2), ("mpe-tag", 0)])
def test_every_landmark_is_the_goal_equally_often(name: str, goals: int) -> None:
    env = make(name, 9_000, seed=2)
    env.reset()
    if goals == 0:
        assert (env.game.goal == -1).all()
    else:
        counts = np.bincount(env.game.goal, minlength=goals)
        assert len(counts) == goals and (np.abs(counts - 9_000 / goals) < 5 * np.sqrt(9_000 / goals)).all()


def play(env: mpe.Env, steps: int) -> NDArray[np.float32]:
    """Observations [step, env, agent, value] of random actions that depend on the sub-environment alone."""
    actions = [np.random.default_rng(i).integers(0, 3, (steps, env.n_agents)) for i in range(env.num_envs)]
    return np.array([env.step(np.stack([own[t] for own in actions]))[0] for t in range(steps)])


@pytest.mark.parametrize("name", ["mpe-speaker-listener", "mpe-adversary", "mpe-tag"])
def test_a_masked_reset_leaves_the_others_alone(name: str) -> None:
    """Also the opponents: they do not decide twice."""
    one, other = make(name, 3, seed=5), make(name, 3, seed=5)
    one.reset()
    other.reset()
    play(one, 4)
    play(other, 4)
    one.reset(options={"reset_mask": np.array([False, True, False])})
    assert one.game.steps.tolist() == [4, 0, 4] and (one.game.symbol[1], one.game.score[1]) == (-1, 0)
    np.testing.assert_array_equal(play(one, 9)[:, [0, 2]], play(other, 9)[:, [0, 2]])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("name", ["mpe-spread", "mpe-tag"])
def test_a_copied_environment_goes_on_by_itself(name: str, duplicate: Callable[[mpe.Env], mpe.Env]) -> None:
    """With the opponent's next move, and statistics of its own."""
    env = make(name, 3, seed=4)
    env.reset()
    play(env, 5)
    twin = duplicate(env)
    alone = play(twin, 9)
    np.testing.assert_array_equal(play(env, 9), alone)
    assert twin.statistics["contacts"] is twin.game.contacts is not env.game.contacts


# ---------------------------------------------------------------------------------------------------------------------
# Shapes, teams, statistics
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "agents", "size", "teams"),
    [
        ("mpe-speaker-listener", 2, 11, (0, 0)),
        ("mpe-spread", 3, 18, (0, 0, 0)),
        ("mpe-adversary", 2, 10, (0, 0)),
        ("mpe-tag", 3, 16, (0, 0, 0)),
        ("mpe-adversary-selfplay", 3, 10, (1, 0, 0)),
        ("mpe-tag-selfplay", 4, 16, (0, 0, 0, 1)),
    ],
)
@pytest.mark.parametrize("rules", ["mpe", "mpe2"])
def test_sizes_and_teams(name: str, agents: int, size: int, teams: tuple[int, ...], rules: str) -> None:
    env = make(name.replace("mpe", rules), 2)
    assert (env.n_agents, env.obs_size, env.state_size, env.n_actions) == (agents, size, agents * size, 5)
    assert (env.teams, env.episode_limit) == (teams, 25)
    observations, info = env.reset()
    assert env.observation_space.contains(observations)
    np.testing.assert_array_equal(info["state"], observations.reshape(2, -1))


@pytest.mark.parametrize("name", ["mpe-speaker-listener", "mpe2-speaker-listener"])
def test_the_speaker_has_three_actions(name: str) -> None:
    env = make(name, 2)
    observations, info = env.reset()
    assert info["action_mask"][0].tolist() == [[True, True, True, False, False], [True] * 5]
    assert not observations[:, 1, 8:].any()  # nothing has been said
    with pytest.raises(ValueError, match="sub-environment 1, agent 0: action 3 is forbidden"):
        env.step([[0, 4], [3, 4]])
    for symbol in range(3):
        before = env.game.agent_position[:, 0].copy()
        observations, *_ = env.step([[symbol, 0]] * 2)
        assert observations[:, 1, 8:].tolist() == np.eye(3)[[symbol] * 2].tolist()
        np.testing.assert_array_equal(env.game.agent_position[:, 0], before)
        for e in range(2):
            colours = [0.65 if k == env.game.goal[e] else 0.15 for k in range(3)]
            np.testing.assert_allclose(observations[e, 0], colours + [0] * 8, rtol=1e-6)


def test_statistics_of_spread_and_tag() -> None:
    env = make("mpe-spread", 2)
    env.reset()
    corners = np.array([[0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
    place(env, 0, corners + np.array([[0.09, 0], [0.11, 0], [0, 0.05]]), corners)  # two of them on their landmarks
    row = [[0, 0], [0.28, 0], [0.56, 0]]  # neighbours touch, and press on
    place(env, 1, row, corners, velocities=[[1, 0], [0, 0], [-1, 0]])
    statistics = env.step([[0, 0, 0]] * 2)[-1]["statistics"]
    assert statistics["occupied_landmarks"].tolist() == [2, 0] and statistics["contacts"].tolist() == [0, 2]
    for _ in range(24):
        statistics = env.step([[0, 0, 0]] * 2)[-1]["statistics"]
    assert statistics["contacts"][0] == 0 and statistics["contacts"][1] >= 2
    env.reset()
    assert not env.game.contacts.any()

    env = make("mpe2-tag-selfplay")
    env.reset()
    for contacts in (2, 4):
        place(env, 0, [[0, 0], [0.1, 0], [0.9, 0.9], [0.05, 0.05]], [[-0.9, -0.9]] * 2)
        _, rewards, _, _, info = env.step([[0, 0, 0, 0]])
        assert info["statistics"]["contacts"].tolist() == [contacts] and rewards.tolist() == [20]
        assert info["agent_rewards"].tolist() == [[20, 20, 20, -20]]


def test_statistics_of_distances() -> None:
    env = make("mpe-adversary-selfplay")
    env.reset()
    place(env, 0, [[0.3, 0.4], [0, 0.1], [0, 0.9]], [[0, 0], [1, 1]], goal=0)
    _, rewards, _, _, info = env.step([[0, 0, 0]])
    assert {name: round(float(x[0]), 6) for name, x in info["statistics"].items()} == {
        "goal_distance": 0.1,
        "adversary_distance": 0.5,
    }
    np.testing.assert_allclose(info["agent_rewards"], [[-0.25, 0.4, 0.4]], rtol=1e-6)
    np.testing.assert_allclose(rewards, [0.4], rtol=1e-6)

    env = make("mpe-speaker-listener")
    env.reset()
    place(env, 0, [[1, 1], [0.3, 0.4]], [[1, 0], [0, 0], [0, 1]], goal=1)
    _, rewards, _, _, info = env.step([[0, 0]])
    np.testing.assert_allclose(info["statistics"]["goal_distance"], [0.5])
    np.testing.assert_allclose(rewards, [-0.5])


# ---------------------------------------------------------------------------------------------------------------------
# Built-in opponents
# ---------------------------------------------------------------------------------------------------------------------


def in_torch(network: mpe.Network) -> nn.Sequential:
    """The same network in PyTorch."""
    n_hidden = len(network.first_bias)
    first, core = nn.Linear(len(network.first_weight), n_hidden), nn.Linear(n_hidden, n_hidden)
    layers = nn.Sequential(first, nn.ReLU(), core, nn.ReLU(), nn.Linear(n_hidden, len(network.last_bias)))
    with torch.no_grad():
        for parameter, array in zip(layers.parameters(), network, strict=True):
            parameter.copy_(torch.from_numpy(array.T))
    return layers


def random_network(path: Path, inputs: int, hidden: int = 20) -> Path:
    """A network whose hidden layers matter: its weights are large."""
    rng = np.random.default_rng(0)
    shapes = [(inputs, hidden), (hidden,), (hidden, hidden), (hidden,), (hidden, 5), (5,)]
    arrays = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    np.savez(path, **mpe.Network(*arrays)._asdict())
    return path


@pytest.mark.parametrize("name", AGAINST_OPPONENTS)
@pytest.mark.parametrize("shipped", [True, False])
def test_opponents_act_as_their_networks_say(name: str, shipped: bool, tmp_path: Path) -> None:
    """Greedily, on the observation before the step, and in the paper's directions."""
    path = mpe.OPPONENTS / f"{name.replace('mpe2', 'mpe')}.npz"
    task = envs.task(name)
    if not shipped:
        path = random_network(tmp_path / "network.npz", 10 if "adversary" in name else 16)
    env = mpe.Env(name, 4, 1, True, **task.settings, opponent=path)
    all_learn = make(f"{name}-selfplay", 4, seed=1)
    network = in_torch(mpe.read_network(path, "tag" if "tag" in name else "adversary"))
    opponent = all_learn.teams.index(1)
    rng = np.random.default_rng(3)
    taken = set()
    for _ in range(2):
        env.reset()
        observations, _ = all_learn.reset()
        for _ in range(25):
            with torch.no_grad():
                moves = network(torch.from_numpy(observations[:, opponent])).argmax(1).numpy()
            taken |= set(moves.tolist())
            if name.startswith("mpe2"):
                moves = np.array([0, 2, 1, 4, 3])[moves]
            actions = random_actions(env, rng)
            joint = np.insert(actions, opponent, moves, axis=1)
            observations, rewards, _, _, info = all_learn.step(joint)
            ours, our_rewards, _, _, our_info = env.step(actions)
            learning = [i for i in range(all_learn.n_agents) if i != opponent]
            np.testing.assert_array_equal(ours, observations[:, learning])
            np.testing.assert_array_equal(our_rewards, rewards)
            np.testing.assert_array_equal(our_info["agent_rewards"], info["agent_rewards"][:, learning])
    assert len(taken) > 1


@pytest.mark.parametrize("name", AGAINST_OPPONENTS)
def test_an_opponent_of_ones_own(name: str, tmp_path: Path) -> None:
    """In all the ways to build an environment."""
    path = random_network(tmp_path / "it's mine.npz", 10 if "adversary" in name else 16)
    kwargs = f"opponent={str(path)!r}"
    env = envs.make(name, 1, 3, env_kwargs=kwargs)
    usual = envs.make(name, 1, 3)
    vectors = gymnasium.make_vec("marl/task", num_envs=1, task=name, seed=3, env_kwargs=kwargs)
    parallel = envs.pettingzoo_env(name, seed=3, env_kwargs={"opponent": path})
    for each in (env, usual, vectors, parallel):
        each.reset()
    still = np.zeros((1, env.n_agents), int)
    differs = False
    for _ in range(20):
        observations, *_ = env.step(still)
        differs |= not np.array_equal(observations, usual.step(still)[0])
        np.testing.assert_array_equal(vectors.step(still)[0], observations)
        seen = parallel.step(dict.fromkeys(parallel.agents, 0))[0]
        np.testing.assert_array_equal(np.stack(list(seen.values())), observations[0])
    assert differs


@pytest.mark.parametrize(
    ("name", "file", "said"),
    [
        ("mpe-tag", "missing.npz", "there is no opponent's file '.*missing.npz'"),
        ("mpe2-adversary", "915a50e2ce129bc1", "Results name a network by its contents, `env_kwargs` by its file"),
        ("mpe-tag", "damaged.npz", "'.*damaged.npz' is not the file of an opponent's network, or is damaged"),
        ("mpe-tag", "other.npz", "is not the file of an opponent's network"),
        ("mpe-tag", ".", "is not the file of an opponent's network"),
        ("mpe-tag", "narrow.npz", r"is no opponent for tag: .* from 16 values to 5 actions .* \(10, 20\), \(20,\)"),
        ("mpe-adversary", "wide.npz", r"is no opponent for adversary: .* from 10 values .* \(16, 20\)"),
        ("mpe-tag", "infinite.npz", "is no opponent for tag: its network must be finite"),
        ("mpe-tag-selfplay", "wide.npz", "mpe-tag-selfplay has its own rules"),
        ("mpe-spread", "wide.npz", "mpe-spread has its own rules"),
    ],
)
def test_wrong_files_of_opponents(name: str, file: str, said: str, tmp_path: Path) -> None:
    random_network(tmp_path / "narrow.npz", 10)
    random_network(tmp_path / "wide.npz", 16)
    arrays = dict(np.load(tmp_path / "wide.npz"))
    np.savez(tmp_path / "infinite.npz", **arrays | {"last_bias": np.full(5, np.nan, np.float32)})
    np.savez(tmp_path / "other.npz", first_weight=np.zeros(3))
    whole = (tmp_path / "wide.npz").read_bytes()
    (tmp_path / "damaged.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(envs.InputError, match=said):
        envs.make(name, env_kwargs={"opponent": tmp_path / file})


def test_other_arguments_than_an_opponent_are_refused() -> None:
    with pytest.raises(envs.InputError, match="the only `env_kwargs` that mpe-tag takes is opponent"):
        envs.make("mpe-tag", env_kwargs="speed=3")


def test_an_opponent_is_named_by_its_contents(tmp_path: Path) -> None:
    """Not by its place; and another one has another name."""
    first = random_network(tmp_path / "first.npz", 16)
    copy = tmp_path / "copy.npz"
    np.savez_compressed(copy, **dict(np.load(first)))
    other = random_network(tmp_path / "other.npz", 16, hidden=21)
    names = [envs.named_kwargs("mpe-tag", f"opponent={str(path)!r}") for path in (first, copy, other)]
    assert re.fullmatch("opponent='[0-9a-f]{16}'", names[0])
    assert names[0] == names[1] != names[2]
    assert envs.named_kwargs("own:mine", "opponent='x'") == "opponent='x'"


def test_a_refused_step_does_not_let_the_opponent_decide() -> None:
    env = make("mpe-tag")
    env.reset()
    env.game.opponent_action[:] = 4  # not what it would decide now
    with pytest.raises(ValueError, match="does not exist"):
        env.step([[0, 0, 5]])
    assert env.game.opponent_action.tolist() == [4]


@needs_training
@pytest.mark.parametrize("task", opponents.PROBES)
def test_where_the_opponents_come_from(task: str) -> None:
    note = json.loads((mpe.OPPONENTS / f"{task}.json").read_text())
    assert note["origin"]["flags"]["env"] == f"{task}-selfplay" and note["origin"]["flags"]["seed"] == note["seed"]
    assert not note["origin"]["flags"]["parameter_sharing"] and note["origin"]["flags"]["individual_rewards"]
    assert {"command", "commit", "versions"} <= note["origin"].keys()
    training = opponents.TRAININGS[task]
    assert len(note["curve"]) == training.eval_points and note["curve"][-1][0] == training.total_timesteps
    assert note["agent"] == mpe.SCENARIOS[task.removeprefix("mpe-")].teams.index(1)
    assert {name: note[name] for name in ("seed", "timestep", "returns")} in note["candidates"]


def test_the_prey_that_is_near_the_papers() -> None:
    """tools/opponents has it, what it earns, and no adversary that is near enough."""
    with open(ROOT / "tools/opponents/candidates.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    near = {}
    for task, probes in opponents.PROBES.items():
        figures = [{name: float(row[name]) for name in probes} for row in rows if row["task"] == task]
        near[task] = min(figures, key=lambda each: opponents.distance(task, each))
        assert (opponents.distance(task, near[task]) < np.inf) == (task == "mpe-tag")
    archive = ROOT / "tools/opponents/prey.npz"
    prey = mpe.Env("mpe-tag", 3_000, 0, False, **envs.task("mpe-tag").settings, opponent=archive)
    for name, figure in near["mpe-tag"].items():
        assert abs(opponents.mean_return(prey, opponents.PROBES["mpe-tag"][name].act) - figure) < 0.01, name


def test_a_networks_arrays_act_as_the_scripts_own(monkeypatch: pytest.MonkeyPatch) -> None:
    flags = {"parameter_sharing": False, "individual_rewards": True, "batch_size": 1, "network": "fc"}
    agents = trained(monkeypatch, "maddpg", 1, "mpe-tag-selfplay", **flags).parts["agents"]
    views = torch.randn(5, 2, 4, 16)  # [time, env, agent, value]
    with torch.no_grad():
        theirs = agents(views)[0][:, :, 3]
        ours = in_torch(opponents.network(agents, 3))(views[:, :, 3])
    torch.testing.assert_close(ours, theirs)


def test_a_short_training_keeps_its_candidates(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """At each evaluation; a complete run stays as it is."""
    monkeypatch.setitem(opponents.TRAININGS, "mpe-adversary", opponents.Training(100, 3))
    monkeypatch.setattr(opponents, "EPISODES", 20)
    monkeypatch.setitem(sys.modules, "maddpg", None)  # so that afterwards all is as it was
    directory = tmp_path / "mpe-adversary" / "seed2"
    opponents.train("mpe-adversary", 2, directory)
    flags = json.loads((directory / "config.json").read_text())["flags"]
    assert (flags["env"], flags["network"], flags["parameter_sharing"]) == ("mpe-adversary-selfplay", "fc", False)
    found = opponents.candidates("mpe-adversary", directory)
    assert [(each["seed"], each["timestep"]) for each in found] == [(2, 0), (2, 50), (2, 100)]
    assert found[0]["returns"].keys() == {"random", "cover both landmarks", "lead away"}
    when = (directory / "checkpoint.pt").stat().st_mtime_ns
    opponents.train("mpe-adversary", 2, directory)
    assert (directory / "checkpoint.pt").stat().st_mtime_ns == when
    shutil.rmtree(tmp_path / "mpe-adversary" / "seed2-candidates")
    with pytest.raises(envs.InputError, match="is complete; move that run away"):
        opponents.candidates("mpe-adversary", directory)


@pytest.fixture
def two_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Two complete runs with one candidate each; seed 1 has the better one. The package's folder is a new one."""
    figures = {
        0: {"random": 0.2, "chase": 3.6, "chase ahead": 8.5},
        1: {"random": 0.4, "chase": 3.3, "chase ahead": 7.5},
    }

    def candidates(task: str, directory: Path) -> list[dict[str, Any]]:
        seed = int(directory.name[-1])
        return [{"seed": seed, "timestep": 50, "returns": figures[seed], "archive": directory / "50.npz"}]

    for seed in (0, 1):
        directory = tmp_path / "runs" / "mpe-tag" / f"seed{seed}"
        directory.mkdir(parents=True)
        (directory / "50.npz").write_text(f"network {seed}")
        (directory / "config.json").write_text("{}")
        (directory / "evaluations.csv").write_text("timestep,return_mean\n0,1.5\n")
    monkeypatch.setattr(opponents, "train", lambda *_: None)
    monkeypatch.setattr(opponents, "candidates", candidates)
    monkeypatch.setattr(mpe, "OPPONENTS", tmp_path / "opponents")
    arguments = ["train_opponents.py", "--tasks", "mpe-tag", "--seeds", "0", "1", "--runs", str(tmp_path / "runs")]
    monkeypatch.setattr(sys, "argv", arguments)
    return tmp_path


def test_an_interrupted_opponent_says_how_it_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any
) -> None:
    """Not with --resume, which this program does not have."""
    told = {"received": signal.SIGINT, "counted": {}, "before": {}}
    monkeypatch.setattr(runs.StopSignals, "__init__", lambda self: self.__dict__.update(told))
    with pytest.raises(SystemExit):
        opponents.train("mpe-tag", 0, tmp_path / "run")
    assert "; the same command goes on." in capsys.readouterr().err


def test_the_best_candidate_is_installed_and_not_replaced_silently(two_runs: Path, monkeypatch: Any) -> None:
    opponents.main()
    archive = two_runs / "opponents" / "mpe-tag.npz"
    note = json.loads(archive.with_suffix(".json").read_text())
    assert archive.read_text() == "network 1" and (note["seed"], note["timestep"]) == (1, 50)
    assert len(note["candidates"]) == 2 and note["curve"] == [[0, 1.5]]
    assert {path.suffix for path in archive.parent.iterdir()} == {".npz", ".json"}
    archive.write_text("precious")
    opponents.main()
    assert archive.read_text() == "precious"
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--replace"])
    opponents.main()
    assert archive.read_text() == "network 1"


@pytest.mark.parametrize(
    "figures",
    [{"random": 1.5, "chase": 3.2, "chase ahead": 7.9}, {"random": 0.2, "chase": 3.2, "chase ahead": 9.5}],
)
def test_a_candidate_out_of_bounds_is_not_installed(
    figures: dict[str, float], two_runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opponents, "candidates", lambda *_: [{"seed": 0, "timestep": 50, "returns": figures}])
    opponents.main()
    assert not (two_runs / "opponents").exists()


# ---------------------------------------------------------------------------------------------------------------------
# Pictures, and the rules without the compiler
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*ALL[:4], "mpe2-tag-selfplay"])
@pytest.mark.slow
def test_frames_of_an_episode(name: str) -> None:
    env = make(name, 2, seed=1)
    env.reset()
    frames = [env.frame(index=1)]
    for _ in range(25):
        env.step(np.ones((2, env.n_agents), int))  # far to one side
        frames.append(env.frame(index=1))
    assert {(frame.dtype, frame.shape) for frame in frames} == {(np.dtype(np.uint8), frames[0].shape)}
    assert (frames[0] != frames[1]).any() and (frames[0] != env.frame(index=0)).any()
    assert near(frames[-1], render.AGENTS[0]) > 100
    assert (near(frames[-1], render.AGENTS[1]) > 50) == ("adversary" in name or "tag" in name)
    assert (near(frames[-1], pictures.GOAL) > 30) == ("adversary" in name or "listener" in name)


def test_who_touches_is_seen() -> None:
    env = make("mpe-tag-selfplay")
    env.reset()
    obstacles = [[-0.9, -0.9], [0.9, 0.9]]
    place(env, 0, [[0, 0], [0.05, 0], [0.5, 0.5], [-0.5, 0.5]], obstacles)
    assert near(env.frame(), pictures.TOUCH) == 0  # predators among themselves do not count
    place(env, 0, [[0, 0], [0.05, 0], [0.5, 0.5], [0.45, 0.5]], obstacles)
    assert near(env.frame(), pictures.TOUCH) > 100


def test_the_symbol_is_seen() -> None:
    env = make("mpe-speaker-listener")
    env.reset()
    place(env, 0, [[0, 0], [0.9, 0.9]], [[-0.5, -0.5], [0.5, -0.5], [0.9, -0.9]], goal=2)
    silent = env.frame()
    frames = [env.step([[symbol, 0]]) and env.frame() for symbol in (0, 1)]
    corner = (slice(280, 310), slice(280, 330))  # right above the speaker
    assert (silent[corner] != frames[0][corner]).any() and (frames[0][corner] != frames[1][corner]).any()
