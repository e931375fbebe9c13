"""The contract of an environment, for every family and for a small one of these tests' own."""

from __future__ import annotations

import copy
import pickle
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector import VectorEnv as GymnasiumVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from numpy.typing import NDArray
from scripts import ROOT

import envs
from envs.families import kernels
from envs.vector import NUMBERS, VectorEnv, episode_generator, episode_seed, forbidden_action

TASKS = ("matrix-climbing", "lbf-6x6-2p-2f", "lbf-7x9-3p-2f-2s-c-v3", "rware-tiny-3p-2s-easy")


class Counting(envs.VectorEnv):
    """Two agents count the steps; agent 1 may take action 2 only in even steps; the state is the number of steps.

    Sub-environment i ends truly in its step i + 2.
    """

    def __init__(self, num_envs: int = 3, copy: bool = True) -> None:
        super().__init__(
            "counting",
            num_envs,
            0,
            copy,
            n_agents=2,
            n_actions=3,
            obs_size=1,
            episode_limit=99,
            low=0,
            high=99,
            state_size=1,
            statistics=["steps"],
        )

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        self.observations[mask] = 0
        self.state[mask] = 0
        self.action_mask[mask, 1, 2] = True

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        refused = forbidden_action(actions, self.action_mask)
        if refused >= 0:
            return refused
        self.state[playing] += 1
        self.observations[:] = self.state[:, None]
        self.action_mask[:, 1, 2] = self.state[:, 0] % 2 == 0
        self.rewards[:] = 1
        self.agent_rewards[:] = 1
        self.terminated |= self.state[:, 0] == np.arange(self.num_envs) + 2
        self.statistics["steps"][:] = self.state[:, 0]
        return -1


def play(env: envs.VectorEnv, steps: int, seed: int = 0) -> list[Any]:
    """The observations of so many steps of random actions, which depend on the seed and the sub-environment alone."""
    actions = [np.random.default_rng([seed, i]).integers(0, 3, (steps, env.n_agents)) for i in range(env.num_envs)]
    return [env.step(np.stack([sub[t] for sub in actions]))[0].copy() for t in range(steps)]


@pytest.mark.parametrize("name", TASKS)
def test_shapes_kinds_and_spaces(name: str) -> None:
    env = envs.make(name, 4, seed=3)
    assert isinstance(env, GymnasiumVectorEnv) and isinstance(env, envs.VectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert (env.name, env.num_envs, env.seed, env.episode) == (name, 4, 3, 0)
    agents, size = env.n_agents, env.obs_size
    observations, info = env.reset()
    for step in range(env.episode_limit):
        assert observations.shape == (4, agents, size) and observations.dtype == np.float32
        assert env.observation_space.contains(observations)
        assert env.single_observation_space.contains(observations[0])
        assert info.keys() == {"agent_rewards", "state", "action_mask", "statistics"}
        assert info["agent_rewards"].shape == (4, agents) and info["agent_rewards"].dtype == np.float32
        assert info["state"].shape == (4, env.state_size) and info["state"].dtype == np.float32
        assert np.shares_memory(info["state"], observations)
        np.testing.assert_array_equal(info["state"], observations.reshape(4, -1))
        assert info["action_mask"].shape == (4, agents, env.n_actions) and info["action_mask"].dtype == np.bool_
        assert info["action_mask"].any(axis=2).all()
        env.action_space.seed(step)
        actions = env.action_space.sample()
        assert actions.shape == (4, agents) and env.single_action_space.contains(actions[0])
        observations, rewards, terminated, truncated, info = env.step(actions)
        assert rewards.shape == (4,) and rewards.dtype == np.float32
        assert terminated.shape == truncated.shape == (4,) and terminated.dtype == truncated.dtype == np.bool_
        assert not (terminated & truncated).any()
    assert (terminated | truncated).all()
    env.close()


def test_a_state_of_its_own() -> None:
    env = Counting()
    _, info = env.reset()
    assert env.state_size == 1
    observations, *_, info = env.step(np.zeros((3, 2), int))
    assert info["state"].tolist() == [[1]] * 3
    assert not np.shares_memory(info["state"], observations)
    env.step(np.zeros((3, 2), int))
    assert info["state"].tolist() == [[1]] * 3  # a copy


def test_statistics_are_copied_too() -> None:
    env = Counting()
    _, info = env.reset()
    env.step(np.zeros((3, 2), int))
    assert info["statistics"].keys() == {"steps"} and not info["statistics"]["steps"].any()
    assert env.step(np.zeros((3, 2), int))[-1]["statistics"]["steps"].tolist() == [2, 2, 2]
    assert Counting(copy=False).reset()[1]["statistics"]["steps"].dtype == np.float32


def test_totals_of_episodes_of_unequal_length() -> None:
    """They end in steps 2, 3 and 4 and earn 1 in each; what a family reports is taken when an episode ends."""
    env = Counting()
    env.teams = (0, 1)
    env.reset()
    totals = envs.EpisodeTotals(env)
    while not totals.ended.all():
        _, rewards, terminated, truncated, info = env.step(np.zeros((3, 2), int))
        info["statistics"]["steps"][totals.ended] = 99  # nobody looks at those that wait
        totals.add(rewards, terminated, truncated, info)
    means = totals.means()
    assert means == {
        "return_mean": 3.0,
        "return_std": pytest.approx(np.std([2, 3, 4])),
        "episode_length": 3.0,
        "team_1_return_mean": 3.0,
        "steps": 3.0,
    }
    totals.statistics["steps"][:2] = np.nan, 5  # of a game that crashed
    assert totals.means()["steps"] == 4.5
    totals.statistics["steps"][:] = np.nan
    assert np.isnan(totals.means()["steps"])


def test_totals_of_a_team_of_two() -> None:
    """A team's return is the mean over its members."""
    env = envs.make(TASKS[0], 2)
    env.teams = (0, 1, 1)
    env.n_agents = 3
    totals = envs.EpisodeTotals(env)
    ends, none = np.array([True, True]), np.zeros(2, bool)
    own = np.array([[1, 2, 4], [1, 6, 8]], np.float32)
    totals.add(np.ones(2, np.float32), ends, none, {"agent_rewards": own, "statistics": {}})
    assert totals.means()["team_1_return_mean"] == 5


def test_a_seed_of_numpy_is_one_too() -> None:
    env = envs.make("lbf-5x5-2p-1f", seed=np.int64(3))  # type: ignore[arg-type]
    env.reset(seed=np.int64(4))  # type: ignore[arg-type]
    assert env.seed == 4 and type(env.seed) is int
    with pytest.raises(TypeError, match="interpreted as an integer"):
        env.reset(seed=1.7)  # type: ignore[arg-type]
    assert env.seed == 4


def test_an_episode_does_not_draw_what_other_code_draws() -> None:
    """A loop whose own generator has the environment's seed, for actions: they must not follow from the start."""
    ours = episode_generator(7, 0, 0).random(5).tolist()
    assert ours == episode_generator(7, 0, 0).random(5).tolist() != episode_generator(7, 1, 0).random(5).tolist()
    assert ours != np.random.default_rng(7).random(5).tolist() != episode_generator(7, 0, 1).random(5).tolist()


def test_one_team_unless_a_family_says_otherwise() -> None:
    assert envs.make("lbf-8x8-3p-2f").teams == (0, 0, 0)


def through_ray(env: envs.VectorEnv) -> Any:
    """As Ray hands objects to other processes: the arrays' memory is shared, so they cannot be written."""
    buffers: list[Any] = []
    text = pickle.dumps(env, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(text, buffers=[bytes(buffer) for buffer in buffers])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env)), through_ray])
@pytest.mark.parametrize("name", TASKS)
def test_a_copied_environment_goes_on_by_itself(name: str, duplicate: Callable[[envs.VectorEnv], Any]) -> None:
    """Its state remains a view of its own observations, and it plays what the original plays."""
    env = envs.make(name, 3, seed=4, copy=False)
    env.reset()
    twin = duplicate(env)
    for t in range(5):
        actions = np.full((3, env.n_agents), t % 3)
        ours, theirs = env.step(actions), twin.step(actions)
        for a, b in zip(arrays(ours), arrays(theirs), strict=True):
            np.testing.assert_array_equal(a, b)
            assert not np.shares_memory(a, b)
        assert np.shares_memory(theirs[-1]["state"], theirs[0])


# --- Randomness --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*TASKS[1:], "mpe-speaker-listener", "mpe2-spread", "mpe-tag"])
def test_an_episode_depends_on_seed_index_and_number_alone(name: str) -> None:
    few, many = envs.make(name, 2, seed=5), envs.make(name, 7, seed=5)
    seen = []
    for k in range(4):
        a, b = few.reset()[0], many.reset()[0]
        np.testing.assert_array_equal(a, b[:2])
        np.testing.assert_array_equal(np.array(play(few, 9)), np.array(play(many, 9))[:, :2])
        seen += [tuple(start.ravel()) for start in b]
        again = envs.make(name, 3, seed=5)
        again.episode = k
        np.testing.assert_array_equal(again.reset()[0], b[:3])
    assert len(set(seen)) == 28
    assert (envs.make(name, 2, seed=6).reset()[0] != envs.make(name, 2, seed=5).reset()[0]).any()


@pytest.mark.parametrize("name", TASKS[1:])
def test_restoring_the_episode_number(name: str) -> None:
    env = envs.make(name, 3, seed=1)
    for _ in range(3):
        env.reset()
        play(env, 5)
    assert env.episode == 3
    for mask in ([False, True, False], [False, True, True]):
        env.reset(options={"reset_mask": np.array(mask)})
    assert env.episode == 5  # sub-environment 1 has begun five, the others three and four
    restored = envs.make(name, 3, seed=1)
    restored.episode = env.episode
    for _ in range(2):
        np.testing.assert_array_equal(env.reset()[0], restored.reset()[0])
        np.testing.assert_array_equal(play(env, 5), play(restored, 5))
    assert env.episode == restored.episode == 7


def test_a_seed_starts_again() -> None:
    env = envs.make(TASKS[1], 3, seed=1)
    first = [env.reset()[0] for _ in range(3)]
    other, _ = env.reset(seed=2)
    assert (env.seed, env.episode) == (2, 1) and (other != first[0]).any()
    np.testing.assert_array_equal(env.reset(seed=1)[0], first[0])
    np.testing.assert_array_equal(env.reset()[0], first[1])
    np.testing.assert_array_equal(envs.make(TASKS[1], 3, seed=2).reset()[0], other)


@pytest.mark.parametrize("seed", [0, 2**63, 2**64 - 1])
def test_seeds_of_64_bits(seed: int) -> None:
    env = envs.make(TASKS[1], 2, seed=seed)
    np.testing.assert_array_equal(env.reset()[0], envs.make(TASKS[1], 2).reset(seed=seed)[0])


def test_sizes_out_of_range() -> None:
    for seed in (-1, 2**64):
        with pytest.raises(ValueError, match=r"seed is .* between 0 and 2\^64 - 1"):
            envs.make(TASKS[0], seed=seed)
    with pytest.raises(ValueError, match="num_envs is 0"):
        envs.make(TASKS[0], num_envs=0)


@pytest.mark.parametrize(("name", "num_envs"), [("lbf-8x8-2p-2f", 10**13), ("lbf-3000x3000-2000000p-2f", 1)])
def test_what_does_not_fit_into_memory(name: str, num_envs: int) -> None:
    with pytest.raises(envs.InputError, match=f"{name} with num_envs={num_envs} does not fit into this machine's mem"):
        envs.make(name, num_envs)


# --- Resets and ends ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("copy", [True, False])
def test_the_finished_stand_still(name: str, copy: bool) -> None:
    env = envs.make(name, 3, copy=copy)
    env.reset()
    play(env, env.episode_limit)
    last, flags = env.observations.copy(), (env.terminated.copy(), env.truncated.copy())
    assert (flags[0] | flags[1]).all()
    env.reset(options={"reset_mask": np.array([False, True, False])})
    fresh = env.observations[1].copy()
    assert (env.terminated | env.truncated).tolist() == [True, False, True]
    for _ in range(3):
        observations, rewards, terminated, truncated, info = env.step(np.full((3, env.n_agents), 2))
        np.testing.assert_array_equal(observations[[0, 2]], last[[0, 2]])
        assert (rewards[[0, 2]] == 0).all() and (info["agent_rewards"][[0, 2]] == 0).all()
        np.testing.assert_array_equal(terminated[[0, 2]], flags[0][[0, 2]])
        np.testing.assert_array_equal(truncated[[0, 2]], flags[1][[0, 2]])
        assert not terminated[1] and not truncated[1]
    if name != "matrix-climbing":
        assert (env.observations[1] != fresh).any()


def test_a_masked_reset_leaves_the_others_alone() -> None:
    env = envs.make(TASKS[1], 3, seed=4)
    untouched = envs.make(TASKS[1], 3, seed=4)
    env.reset(), untouched.reset()
    play(env, 6), play(untouched, 6)
    options = {"reset_mask": np.array([False, True, False])}
    observations, _ = env.reset(options=options)
    assert options.keys() == {"reset_mask"}  # wrappers read it afterwards
    np.testing.assert_array_equal(observations[[0, 2]], untouched.observations[[0, 2]])
    np.testing.assert_array_equal(play(env, 6, 1)[-1][[0, 2]], play(untouched, 6, 1)[-1][[0, 2]])


@pytest.mark.parametrize("copy", [True, False])
def test_the_flags_themselves_are_a_mask(copy: bool) -> None:
    """Though a reset clears them."""
    env = Counting(2, copy)
    env.reset()
    *_, terminated, _, _ = [env.step([[0, 0]] * 2) for _ in range(2)][-1]
    assert terminated.tolist() == [True, False]
    env.reset(options={"reset_mask": terminated})
    assert env.episode == 2 and env.state[:, 0].tolist() == [0, 2] and not env.terminated.any()
    env.step([[0, 0]] * 2)
    env.reset(options={"reset_mask": env.terminated})
    assert env.state[:, 0].tolist() == [1, 0]


@pytest.mark.parametrize(
    ("mask", "error", "message"),
    [
        ([True, False], TypeError, "NumPy array of booleans"),
        (np.array([1, 0]), TypeError, "NumPy array of booleans"),
        (np.array([True]), ValueError, "shape"),
        (np.array([False, False]), ValueError, "names no sub-environment"),
    ],
)
def test_wrong_masks(mask: Any, error: type[Exception], message: str) -> None:
    env = envs.make(TASKS[0], 2)
    with pytest.raises(error, match=message):
        env.reset(options={"reset_mask": mask})
    assert env.episode == 0


def test_a_refused_reset_changes_nothing() -> None:
    env = envs.make(TASKS[1], 2)
    env.reset()
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match="seed is -1"):
        env.reset(seed=-1)
    assert env._episodes.tolist() == [2, 1]


def test_stepping_before_a_reset() -> None:
    env = envs.make(TASKS[1], 2)
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step([[0, 0], [0, 0]])
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match="every sub-environment"):
        env.step([[0, 0], [0, 0]])
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step([[0, 0], [0, 0]])


@pytest.mark.parametrize("name", ["lbf-6x6-2p-2f", "matrix-penalty-25"])
@pytest.mark.parametrize("copy", [True, False])
def test_gymnasium_counts_episodes_right(name: str, copy: bool) -> None:
    """RecordEpisodeStatistics, which also writes into the info that a step returns."""
    env = envs.make(name, 5, seed=2, copy=copy)
    recording = RecordEpisodeStatistics(env, buffer_length=10_000)
    rng = np.random.default_rng(0)
    recording.reset()
    returns, lengths = np.zeros(5), np.zeros(5, int)
    expected: list[tuple[float, int]] = []
    for _ in range(400):
        actions = rng.integers(0, env.n_actions, (5, env.n_agents))
        _, rewards, terminated, truncated, info = recording.step(actions)
        returns += rewards
        lengths += 1
        done = terminated | truncated
        assert ("episode" in info) == done.any()
        if done.any():
            np.testing.assert_allclose(info["episode"]["r"][done], returns[done])
            np.testing.assert_array_equal(info["episode"]["l"][done], lengths[done])
            expected += list(zip(returns[done], lengths[done].tolist(), strict=True))
            recording.reset(options={"reset_mask": done.copy()})
            returns[done], lengths[done] = 0, 0
    assert recording.episode_count == len(expected) >= 40
    np.testing.assert_allclose(recording.return_queue, [r for r, _ in expected])
    assert list(recording.length_queue) == [length for _, length in expected]


def test_the_loop_of_the_contract_counts_each_episode_once() -> None:
    """The loop as it stands in the docstring; sub-environment i takes i + 2 steps an episode."""
    assert envs.vector.__doc__ is not None
    loop = textwrap.dedent(envs.vector.__doc__[envs.vector.__doc__.index("    recording = ") :])
    names = {"RecordEpisodeStatistics": RecordEpisodeStatistics, "env": Counting(), "steps": 12}
    names["act"] = lambda observations, info: np.zeros((3, 2), int)
    exec(loop, names)
    recording = names["recording"]
    assert isinstance(recording, RecordEpisodeStatistics)
    assert sorted(recording.length_queue) == 6 * [2] + 4 * [3] + 3 * [4]
    assert recording.episode_count == 13


def test_a_loop_that_waits_makes_gymnasium_count_again() -> None:
    """What the contract warns of; it may say less once this test fails."""
    recording = RecordEpisodeStatistics(Counting())
    recording.reset()
    flags = np.zeros(3, bool)
    while not flags.all():
        _, _, terminated, truncated, _ = recording.step(np.zeros((3, 2), int))
        flags = terminated | truncated
    assert recording.episode_count == 3 + 2 + 1


# --- Copies ------------------------------------------------------------------------------------------------------


def arrays(outcome: tuple[Any, ...]) -> list[NDArray[Any]]:
    info = dict(outcome[-1])
    return [*outcome[:-1], *info.pop("statistics").values(), *info.values()]


@pytest.mark.parametrize("name", TASKS)
def test_copies_are_the_callers(name: str) -> None:
    env = envs.make(name, 3, copy=True)
    outcomes: list[tuple[Any, ...]] = [env.reset()]
    kept = [[array.copy() for array in arrays(outcomes[0])]]
    for t in range(60):
        outcomes.append(env.step(np.full((3, env.n_agents), t % 3)))
        kept.append([array.copy() for array in arrays(outcomes[-1])])
    for outcome, then in zip(outcomes, kept, strict=True):
        for array, copied in zip(arrays(outcome), then, strict=True):
            np.testing.assert_array_equal(array, copied)
    for array in arrays(outcomes[1]):
        assert not any(np.shares_memory(array, other) for other in arrays(outcomes[2]))
    twin = envs.make(name, 3, copy=True)
    env.reset(seed=1), twin.reset(seed=1)
    for array in arrays(env.step(np.zeros((3, env.n_agents), int))):
        array.fill(True)  # what the caller does with them changes nothing
    twin.step(np.zeros((3, env.n_agents), int))
    np.testing.assert_array_equal(play(env, 5), play(twin, 5))


@pytest.mark.parametrize("name", TASKS)
def test_without_copies_the_same_arrays_return(name: str) -> None:
    env, copying = envs.make(name, 3, copy=False), envs.make(name, 3, copy=True)
    first, info = env.reset()
    copying.reset()
    outcome = env.step(np.zeros((3, env.n_agents), int))
    copying.step(np.zeros((3, env.n_agents), int))
    assert outcome[0] is first and outcome[-1]["state"] is info["state"]
    for t in range(60):
        actions = np.full((3, env.n_agents), t % 3)
        again, copied = env.step(actions), copying.step(actions)
        assert all(a is b for a, b in zip(arrays(again), arrays(outcome), strict=True))
        for a, b in zip(arrays(again), arrays(copied), strict=True):
            np.testing.assert_array_equal(a, b)


def test_what_a_wrapper_does_with_an_info_is_gone_in_the_next() -> None:
    env = envs.make("lbf-5x5-2p-1f", 2, copy=False)
    _, info = env.reset()
    state = info["state"]
    info["state"], info["mine"] = info["state"] / 10, 1
    del info["statistics"]
    info = env.step([[0, 0]] * 2)[-1]
    assert info["state"] is state and set(info) == {"agent_rewards", "state", "action_mask", "statistics"}


# --- Actions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TASKS)
def test_actions_of_any_integer_kind(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    env = envs.make(name, 2, seed=8)
    expected = None
    actions = np.array([[1, 2, 0], [0, 1, 2]])[:, : env.n_agents]
    kinds = [actions, actions.astype(np.int32), actions.astype(np.uint8), actions.tolist(), np.asfortranarray(actions)]
    kinds += [np.repeat(actions, 2, axis=1)[:, ::2], np.frombuffer(actions.tobytes(), np.int64).reshape(actions.shape)]
    plain = env.step_envs

    def step_envs(actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        assert actions.flags.carray  # Numba would compile the rules anew for others
        return plain(actions, playing)

    monkeypatch.setattr(env, "step_envs", step_envs)
    for kind in kinds:
        env.reset(seed=8)
        outcome = [array.copy() for array in arrays(env.step(kind))]
        expected = expected or outcome
        assert all((a == b).all() for a, b in zip(outcome, expected, strict=True))


@pytest.mark.parametrize("name", TASKS)
def test_actions_that_do_not_exist(name: str) -> None:
    env = envs.make(name, 3)
    env.reset()
    for action in (-1, env.n_actions, 2**40):
        actions = np.zeros((3, env.n_agents), np.int64)
        actions[0] = 1
        actions[2, 1] = action
        before = env.observations.copy()
        with pytest.raises(ValueError, match=f"sub-environment 2, agent 1: action {action} does not exist"):
            env.step(actions)
        np.testing.assert_array_equal(env.observations, before)
    for wrong, message in (
        (np.zeros((3, env.n_agents + 1), int), "shape"),
        (np.zeros(3, int), "shape"),
        (0, "shape"),
        (np.zeros((3, env.n_agents)), "float64, not integers"),
        (np.zeros((3, env.n_agents), bool), "bool, not integers"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(wrong)


def test_forbidden_actions() -> None:
    env = Counting()
    env.reset()
    *_, info = env.step([[0, 2]] * 3)
    assert not info["action_mask"][:, 1, 2].any()
    with pytest.raises(
        ValueError, match="counting: sub-environment 1, agent 1: action 2 is forbidden by the action mask"
    ):
        env.step([[0, 0], [0, 2], [0, 2]])
    assert env.state.tolist() == [[1]] * 3
    env.step([[0, 0]] * 3)
    env.step([[0, 2]] * 3)


@pytest.mark.parametrize("copy", [True, False])
@pytest.mark.parametrize("name", NUMBERS)
def test_what_is_not_a_number_is_named(name: str, copy: bool) -> None:
    """At once, and in no other step: also after an episode that was not played to its end."""

    class Faulty(Counting):
        checks_numbers = True
        value, steps_made = 0.0, 0

        def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
            refused = super().step_envs(actions, playing)
            if self.steps_made == 5:
                getattr(self, name)[1] = self.value
            self.steps_made += 1
            return refused

    for value in (np.nan, np.inf, -np.inf, 3e38):
        env = Faulty(copy=copy)
        env.value = value
        for steps in (3, 2):
            env.reset()
            for _ in range(steps):
                env.step(np.zeros((3, 2), int))
        env.reset(options={"reset_mask": np.array([True, False, True])})
        if np.isfinite(value):
            env.step(np.zeros((3, 2), int))
            continue
        message = f"counting: sub-environment 1 gives {NUMBERS[name]} that is not a finite number, in step 3 of"
        with pytest.raises(envs.InputError, match=message):
            env.step(np.zeros((3, 2), int))


def test_the_numbers_of_an_own_environment_are_looked_at(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """And a copy of it looks as well; the time goes to others' environments alone."""
    (tmp_path / "own_faulty.py").write_text(
        "import examples.meeting_numpy as m\n\nclass Env(m.Env):\n    def reset_env(self, e, rng):\n"
        "        super().reset_env(e, rng)\n        self.observations[e] = float('nan') if self.seed == 1 else 0\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(ROOT)
    for env in (envs.make("own:own_faulty"), copy.deepcopy(envs.make("own:own_faulty"))):
        env.reset()
        with pytest.raises(envs.InputError, match=r"own:own_faulty: sub-environment 0 gives an obs.* in step 0 of"):
            env.reset(seed=1)
    assert not any(envs.make(name).checks_numbers for name in TASKS)


def test_a_family_without_pictures() -> None:
    env = Counting()
    env.reset()
    assert not env.can_draw
    with pytest.raises(ValueError, match="no picture"):
        env.frame()


# ---------------------------------------------------------------------------------------------------------------------
# Families without compiled rules
# ---------------------------------------------------------------------------------------------------------------------


class Dice(envs.VectorEnv):
    """One agent throws a die in each step, until it is a six; it may not take action 1 after an odd number."""

    def __init__(self, num_envs: int, seed: int = 0) -> None:
        super().__init__(
            "dice", num_envs, seed, True, n_agents=1, n_actions=2, obs_size=1, episode_limit=99, low=0, high=6
        )

    def reset_env(self, e: int, rng: np.random.Generator) -> None:
        self.throw(e, rng)

    def step_env(self, e: int, actions: NDArray[np.int64], rng: np.random.Generator) -> None:
        self.throw(e, rng)
        self.rewards[e] = self.agent_rewards[e] = 1

    def throw(self, e: int, rng: np.random.Generator) -> None:
        self.observations[e] = rng.integers(1, 7)
        self.terminated[e] = self.observations[e, 0, 0] == 6
        self.action_mask[e, 0, 1] = self.observations[e, 0, 0] % 2 == 0


def test_a_plain_family_draws_from_the_generator_of_the_episode() -> None:
    env = Dice(3, seed=5)
    for episode in range(4):
        observations, _ = env.reset()
        throws = [observations[:, 0, 0]]
        while not env.terminated.all():
            stood = env.terminated.copy()
            observations, rewards, *_ = env.step(np.zeros((3, 1), int))
            assert rewards.tolist() == (~stood).tolist()
            throws.append(observations[:, 0, 0])
        for index in range(3):
            rng = episode_generator(5, index, episode)
            alone = [rng.integers(1, 7)]
            while alone[-1] != 6:
                alone.append(rng.integers(1, 7))
            assert [throw[index] for throw in throws] == alone + [6] * (len(throws) - len(alone))


def test_a_plain_family_refuses_what_the_mask_forbids() -> None:
    env = Dice(20)
    observations, _ = env.reset()
    odd = int(np.flatnonzero(observations[:, 0, 0] % 2)[0])
    actions = np.zeros((20, 1), int)
    actions[odd] = 1
    with pytest.raises(ValueError, match=f"sub-environment {odd}, agent 0: action 1 is forbidden"):
        env.step(actions)
    np.testing.assert_array_equal(env.observations, observations)


def test_the_two_checks_of_actions_agree() -> None:
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        mask = rng.random((4, 2, 3)) < 0.9
        actions = rng.integers(-1, 4, (4, 2)) if rng.random() < 0.3 else rng.integers(0, 3, (4, 2))
        found = forbidden_action(actions, mask)
        assert found == kernels.forbidden_action(actions, mask)
        refused += found >= 0
    assert 50 < refused < 280


def test_seeds_of_episodes_for_other_generators() -> None:
    places = [(seed, index, episode) for seed in (0, 1, 2**63) for index in range(20) for episode in range(20)]
    seeds = [episode_seed(*place) for place in places]
    assert len(set(seeds)) == len(places) and all(0 <= seed < 2**31 for seed in seeds)
    assert episode_seed(1, 2, 3) == episode_seed(1, 2, 3)


def test_choices_of_unequal_agents() -> None:
    """The spaces and the mask know them."""
    env = envs.make("mpe-speaker-listener", 2)
    assert env.choices == (3, 5) and env.action_space.shape == (2, 2)
    _, info = env.reset()
    assert info["action_mask"].sum(axis=2).tolist() == [[3, 5], [3, 5]]
    draws = np.array([env.action_space.sample() for _ in range(200)])
    assert draws[:, :, 0].max() == 2 and draws[:, :, 1].max() == 4


@pytest.mark.parametrize("choices", [(2,), (2, 3, 2), (0, 3), (2, 4)])
def test_wrong_choices(choices: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="it must have a number from 1 to 3 for each agent"):
        VectorEnv(
            "toy", 1, 0, False, n_agents=2, n_actions=3, obs_size=1, episode_limit=5, low=0, high=1, choices=choices
        )
