"""Tasks as PettingZoo environments."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete
from pettingzoo import ParallelEnv
from pettingzoo.test import parallel_api_test, parallel_seed_test
from pettingzoo.test.render_test import render_test
from pettingzoo.utils import parallel_to_aec

import envs
from envs.adapters import as_gymnasium
from envs.vector import kinds_of, numbered

LBF = "lbf-5x5-2p-1f"
SPEAKER = "mpe-speaker-listener"
BATTLE = "smaclite-2s3z"
TASKS = ("matrix-climbing", LBF, "rware-tiny-2p", SPEAKER, "mpe2-spread", "mpe-tag-selfplay", BATTLE)


def allowed_actions(env: Any, infos: dict[str, Any], seed: int | None = None) -> dict[str, Any]:
    """Random actions that the masks allow; with a seed for the action spaces, the same ones each time."""
    for i, agent in enumerate(env.agents):
        if seed is not None:
            env.action_space(agent).seed(seed + i)
    return {agent: env.action_space(agent).sample(infos[agent]["action_mask"]) for agent in env.agents}


@pytest.mark.parametrize("name", TASKS)
def test_pettingzoos_own_tests(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(envs.pettingzoo_env(name), num_cycles=200)
        parallel_seed_test(lambda: envs.pettingzoo_env(name), num_cycles=200)


@pytest.mark.parametrize("name", TASKS)
def test_the_game_is_the_vectors(name: str) -> None:
    """Two episodes beside one sub-environment of `envs.make`."""
    env, vector = envs.pettingzoo_env(name, seed=5), envs.make(name, seed=5)
    assert isinstance(env, ParallelEnv) and not env.agents
    agents = env.possible_agents
    assert agents == list(vector.agent_names)
    assert list(env.teams.values()) == list(vector.teams) and list(env.teams) == agents
    for episode in range(2):
        (observations, infos), (expected, info) = env.reset(), vector.reset()
        ended = False
        while not ended:
            assert env.agents == agents == list(observations) == list(infos)
            for i, agent in enumerate(agents):
                n_actions = env.action_space(agent).n
                assert env.observation_space(agent).contains(observations[agent])
                np.testing.assert_array_equal(observations[agent], expected[0, i])
                assert infos[agent].keys() == {"action_mask"}
                mask = infos[agent]["action_mask"]
                assert mask.dtype == np.int8 and mask.shape == (n_actions,)
                np.testing.assert_array_equal(mask, info["action_mask"][0, i, :n_actions])
                assert not info["action_mask"][0, i, n_actions:].any()
            np.testing.assert_array_equal(env.state(), info["state"][0])
            assert env.state_space.contains(env.state())
            actions = allowed_actions(env, infos, seed=episode)
            observations, rewards, terminations, truncations, infos = env.step(actions)
            expected, _, terminated, truncated, info = vector.step([list(actions.values())])
            assert list(rewards.values()) == info["agent_rewards"][0].tolist()
            assert set(terminations.values()) == {bool(terminated[0])}
            assert set(truncations.values()) == {bool(truncated[0])}
            ended = bool(terminated[0] | truncated[0])
        assert not env.agents and list(observations) == list(infos) == list(terminations) == list(truncations) == agents
        for agent in agents:
            assert infos[agent]["statistics"] == {name: values[0] for name, values in info["statistics"].items()}
        with pytest.raises(ResetNeeded, match=f"{name}: call reset"):
            env.step(actions)


def test_own_actions_and_rewards() -> None:
    env = envs.pettingzoo_env(SPEAKER)
    assert [env.action_space(agent) for agent in env.possible_agents] == [Discrete(3), Discrete(5)]
    env = envs.pettingzoo_env("mpe-adversary-selfplay")
    assert env.teams == {"adversary_0": 1, "agent_0": 0, "agent_1": 0}
    env.reset()
    rewards = env.step(dict.fromkeys(env.agents, 0))[1]
    assert rewards["adversary_0"] < 0 and rewards["adversary_0"] != rewards["agent_0"] == rewards["agent_1"]


@pytest.mark.parametrize(
    ("name", "agents"),
    [
        (LBF, "agent_0 agent_1"),
        (SPEAKER, "speaker_0 listener_0"),
        ("mpe2-adversary-selfplay", "adversary_0 agent_0 agent_1"),
        ("mpe-tag-selfplay", "adversary_0 adversary_1 adversary_2 agent_0"),
        ("mpe-tag", "agent_0 agent_1 agent_2"),  # the prey is part of the game
        ("pettingzoo:mpe2.simple_speaker_listener_v4", "speaker_0 listener_0"),
    ],
)
def test_names_tell_kind_and_side(name: str, agents: str) -> None:
    """Libraries such as TorchRL and AgileRL make a group of the agents whose names differ in the last number only."""
    env = envs.pettingzoo_env(name)
    assert env.possible_agents == agents.split()
    groups: dict[str, set[Any]] = {}
    for agent in env.possible_agents:
        kind = env.teams[agent], env.action_space(agent).n
        groups.setdefault(agent.rpartition("_")[0], set()).add(kind)
    assert all(len(kinds) == 1 for kinds in groups.values()), groups


def test_names_where_nobody_gives_any() -> None:
    assert numbered(kinds_of((0, 0), (3, 3))) == ("agent_0", "agent_1")
    assert numbered(kinds_of((0, 1, 0), (3, 3, 3))) == ("team0_0", "team1_0", "team0_1")
    assert numbered(kinds_of((0, 0, 0), (3, 5, 3))) == (
        "agent_with_3_actions_0",
        "agent_with_5_actions_0",
        "agent_with_3_actions_1",
    )


def test_a_time_out_is_a_truncation_and_the_end_of_a_game_is_not() -> None:
    ends = []
    env = envs.pettingzoo_env(LBF, seed=0)
    for episode in range(20):
        _, infos = env.reset()
        length = 0
        while env.agents:
            _, _, terminations, truncations, infos = env.step(allowed_actions(env, infos, seed=100 * episode + length))
            length += 1
        ends.append((length == 50, terminations["agent_0"], truncations["agent_1"]))
    assert set(ends) >= {(True, False, True), (False, True, False)}
    assert set(ends) <= {(True, False, True), (False, True, False), (True, True, False)}


@pytest.mark.parametrize("name", ["lbf-15x15-4p-5f", "rware-tiny-4p", SPEAKER, "mpe-tag", "mpe2-adversary-selfplay"])
def test_copies_without_a_seed_play_different_episodes(name: str) -> None:
    """100 starts of 20 copies. Matrix games and battles are not here, since all their episodes begin alike; nor are
    small boards and rware-tiny-2p, where two of 100 starts may be equal by chance (there once in 70 runs)."""
    starts = set()
    for _ in range(20):
        env = envs.pettingzoo_env(name)
        for _ in range(5):
            observations, _ = env.reset()
            starts.add(np.concatenate([*observations.values(), env.state()]).tobytes())
    assert len(starts) == 100


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_of_one_that_was_not_seeded_differ(duplicate: Callable[[Any], Any]) -> None:
    """SuperSuit, and with it SB3, makes its copies like this, before the first reset."""
    env = envs.pettingzoo_env("mpe-tag")
    starts = {each.reset()[0]["agent_0"].tobytes() for each in (env, *(duplicate(env) for _ in range(9)))}
    assert len(starts) == 10
    first = [duplicate(envs.pettingzoo_env(LBF, seed=4)).reset()[0]["agent_0"].tolist() for _ in range(2)]
    assert first[0] == first[1]


def test_seeds() -> None:
    starts = [envs.pettingzoo_env(LBF, seed=seed).reset()[0]["agent_0"].tolist() for seed in (3, 3, 4)]
    assert starts[0] == starts[1] != starts[2]
    env = envs.pettingzoo_env(LBF, seed=4)
    first, second = (env.reset()[0]["agent_0"].tolist() for _ in range(2))
    assert first == starts[2] != second
    assert env.reset(seed=3)[0]["agent_0"].tolist() == starts[0]
    assert env.reset(seed=4)[0]["agent_0"].tolist() == first
    assert env.reset()[0]["agent_0"].tolist() == second


def test_forbidden_actions() -> None:
    """At the start of a battle nobody may do nothing (action 0), and stopping is action 1."""
    env, strict, stops = (envs.pettingzoo_env(BATTLE, strict=strict) for strict in (False, True, True))
    for each in (env, strict, stops):
        each.reset(seed=2)
    observations = env.step(dict.fromkeys(env.agents, 0))[0]
    expected = stops.step(dict.fromkeys(env.agents, 1))[0]
    for agent, observation in observations.items():
        np.testing.assert_array_equal(observation, expected[agent])
    with pytest.raises(ValueError, match="agent 0: action 0 is forbidden by the action mask"):
        strict.step(dict.fromkeys(env.agents, 0))


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"speaker_0": 1}, "there is no action for listener_0"),
        ({"speaker_0": 3, "listener_0": 4}, "speaker_0 has no action 3; its actions are 0 to 2"),
        ({"speaker_0": 0, "listener_0": -1}, "listener_0 has no action -1; its actions are 0 to 4"),
        ({"speaker_0": 1.0, "listener_0": 1}, r"speaker_0 has no action 1\.0"),
    ],
)
def test_wrong_actions(actions: dict[str, Any], message: str) -> None:
    env = envs.pettingzoo_env(SPEAKER)
    with pytest.raises(ResetNeeded):
        env.step(actions)
    env.reset()
    before = env.state()
    with pytest.raises(ValueError, match=f"^{SPEAKER}: {message}"):
        env.step(actions)
    np.testing.assert_array_equal(env.state(), before)
    env.step({"speaker_0": np.int32(2), "listener_0": np.array(4)})
    env.step({"speaker_0": True, "listener_0": True})  # Python and Gymnasium take a bool for an int


def test_what_is_returned_is_the_callers() -> None:
    env, untouched = envs.pettingzoo_env(LBF, seed=0), envs.pettingzoo_env(LBF, seed=0)
    observations, infos = env.reset()
    untouched.reset()
    for agent in env.agents:
        observations[agent].fill(9)
        infos[agent]["action_mask"].fill(0)
    env.state().fill(9)
    assert (env.state() != 9).any()
    outcomes = [each.step({"agent_0": 1, "agent_1": 2}) for each in (env, untouched)]
    for agent in env.agents:
        np.testing.assert_array_equal(outcomes[0][0][agent], outcomes[1][0][agent])
        assert outcomes[0][4][agent]["action_mask"].all()


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("name", ["rware-tiny-2p", BATTLE])
def test_a_copied_environment_goes_on_by_itself(name: str, duplicate: Callable[[Any], Any]) -> None:
    env = envs.pettingzoo_env(name, seed=4)
    _, infos = env.reset()
    twin = duplicate(env)
    for t in range(5):
        actions = allowed_actions(env, infos, seed=t)
        outcome, expected = env.step(actions), twin.step(actions)
        infos = outcome[-1]
        np.testing.assert_equal(outcome, expected)
        np.testing.assert_array_equal(env.state(), twin.state())


def test_pictures() -> None:
    env = envs.pettingzoo_env(LBF, render_mode="rgb_array")
    env.reset()
    frame = env.render()
    assert frame is not None and frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] == 3
    assert (env.render_mode, env.metadata["render_fps"]) == ("rgb_array", 5)
    assert env.metadata["render_modes"] == ["rgb_array", "human"]
    assert envs.pettingzoo_env(LBF).render() is None
    assert envs.pettingzoo_env("own:examples.meeting_numpy").metadata["render_modes"] == []


@pytest.mark.parametrize("display", [False, True])
@pytest.mark.parametrize("name", [LBF, "rware-tiny-2p", SPEAKER, "matrix-climbing", BATTLE])
def test_pettingzoos_render_test(monkeypatch: pytest.MonkeyPatch, name: str, display: bool) -> None:
    """With a window, which a backend without windows stands for here, and without: arrays, and a sentence."""
    monkeypatch.setattr(as_gymnasium, "has_display", lambda: display)
    monkeypatch.setattr("matplotlib.pyplot.pause", lambda seconds: None)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        render_test(lambda render_mode: parallel_to_aec(envs.pettingzoo_env(name, render_mode=render_mode)))
    assert [str(each.message) for each in said] == [
        f"{name}: there is no display here, so `render` returns arrays (rgb_array)."
    ] * (not display)


def test_a_window_shows_each_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(as_gymnasium, "has_display", lambda: True)
    monkeypatch.setattr("matplotlib.pyplot.pause", lambda seconds: None)
    env, twin = (envs.pettingzoo_env(LBF, seed=1, render_mode=mode) for mode in ("human", "rgb_array"))
    env.reset()
    twin.reset()
    for _ in range(2):
        assert env.window is not None
        np.testing.assert_array_equal(env.window.image.get_array(), twin.render())
        env.step({"agent_0": 1, "agent_1": 2})
        twin.step({"agent_0": 1, "agent_1": 2})
    assert env.render() is None
    env.close()


def test_a_generator_for_wrappers() -> None:
    """SuperSuit's frame_skip draws from `unwrapped.np_random`."""
    draws = []
    for _ in range(2):
        env = envs.pettingzoo_env(LBF)
        env.reset(seed=3)
        draws.append(env.unwrapped.np_random.integers(1000, size=5).tolist())
    assert draws[0] == draws[1]


@pytest.mark.parametrize(
    ("name", "render_mode", "message"),
    [
        ("lbf-5x5", None, "unknown task 'lbf-5x5'"),
        (LBF, "ansi", "render_mode is 'ansi'; it must be 'rgb_array', 'human' or None"),
        ("own:examples.meeting_numpy", "rgb_array", "meeting_numpy has no pictures"),
    ],
)
def test_wrong_input(name: str, render_mode: str | None, message: str) -> None:
    with pytest.raises(envs.InputError, match=message):
        envs.pettingzoo_env(name, render_mode=render_mode)


def test_pettingzoo_is_imported_only_for_this() -> None:
    program = "import sys, envs; envs.make('matrix-climbing'); sys.exit('pettingzoo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
