"""Tasks from `gymnasium.make_vec`: ids, autoreset modes, and Gymnasium's own wrappers."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, NormalizeObservation, RecordEpisodeStatistics
from numpy.typing import NDArray

import envs

LBF = "lbf-5x5-2p-1f"  # terminates or runs out of time
SPEAKER = "mpe-speaker-listener"  # has forbidden actions and statistics
MODES = list(AutoresetMode)
GYMNASIUM = tuple(int(number) for number in gymnasium.__version__.split(".")[:2])


def make(task: str = LBF, num_envs: int = 3, **options: Any) -> Any:
    return gymnasium.make_vec("marl/task", num_envs=num_envs, task=task, **options)


def allowed_actions(info: dict[str, Any], rng: np.random.Generator) -> NDArray[np.int64]:
    """Random actions that the masks of an info allow."""
    return np.where(info["action_mask"], rng.random(info["action_mask"].shape), -1).argmax(axis=2)


# --- Ids ---------------------------------------------------------------------------------------------------------


def test_every_task_of_the_paper_has_an_id() -> None:
    for name in envs.task_names():
        assert gymnasium.spec(f"marl/{name}").kwargs == {"task": name}
    env = gymnasium.make_vec("marl/matrix-penalty-25", num_envs=4, seed=5)
    inner = env.unwrapped
    assert isinstance(inner, envs.VectorEnv)
    assert (inner.name, inner.num_envs, inner.seed) == ("matrix-penalty-25", 4, 5)
    assert env.spec is not None and env.spec.id == "marl/matrix-penalty-25"


def test_other_tasks_and_an_id_that_imports() -> None:
    program = (
        "import gymnasium; print(gymnasium.make_vec('envs:marl/task', num_envs=2, task='lbf-5x5-2p-1f').unwrapped)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "Env(marl/task, num_envs=2)", done.stderr


def test_registering_again_changes_nothing(recwarn: pytest.WarningsRecorder) -> None:
    before = dict(gymnasium.registry)
    envs.adapters.as_gymnasium.register()
    assert gymnasium.registry == before and not recwarn


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "lbf-5x5"}, "unknown task 'lbf-5x5'"),
        ({"autoreset_mode": "NextYear"}, "autoreset_mode is 'NextYear'; the modes are NextStep, SameStep, Disabled"),
        ({"render_mode": "human"}, "render_mode is 'human'; it must be 'rgb_array' or None"),
        ({"render_mode": "rgb_array", "task": "own:examples.meeting_numpy"}, "meeting_numpy has no pictures"),
    ],
)
def test_wrong_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(envs.InputError, match=message):
        make(**options)


def test_copies_without_a_seed_play_different_episodes() -> None:
    starts = [observation.tobytes() for _ in range(5) for observation in make("lbf-15x15-4p-5f", 20).reset()[0]]
    assert len(set(starts)) == 100
    env = make()
    first = env.reset(seed=3)[0]
    assert (env.reset()[0] != first).any()
    np.testing.assert_array_equal(env.reset(seed=3)[0], first)


def test_one_environment_in_tuple_form() -> None:
    """As lbforaging and rware have it: what EPyMARL's wrapper asks for, two episodes beside `envs.make`."""
    env: Any = gymnasium.make("marl/task", task=SPEAKER, seed=5)
    vector, inner = envs.make(SPEAKER, seed=5), env.unwrapped
    assert (inner.n_agents, inner.episode_limit) == (2, 25)
    assert max(env.action_space, key=lambda space: space.n).n == 5
    assert [gymnasium.spaces.flatdim(space) for space in env.observation_space] == [11, 11]
    rng = np.random.default_rng(0)
    for _ in range(2):
        (observations, info), (expected, _) = env.reset(), vector.reset()
        ended = False
        while not ended:
            assert env.observation_space.contains(observations)
            np.testing.assert_array_equal(observations, expected[0])
            assert [mask.tolist() for mask in info["action_mask"]] == [[1] * 3, [1] * 5]
            actions = [int(rng.integers(3)), int(rng.integers(5))]
            observations, rewards, terminated, truncated, info = env.step(actions)
            expected, _, *flags, theirs = vector.step([actions])
            assert rewards == theirs["agent_rewards"][0].tolist()
            assert [terminated, truncated] == [bool(flag[0]) for flag in flags]
            ended = terminated or truncated
        assert info["statistics"] == {name: values[0] for name, values in theirs["statistics"].items()}


def test_one_environment_of_every_id() -> None:
    for name in envs.task_names():
        env = gymnasium.make(f"marl/{name}", render_mode="rgb_array")
        env.reset(seed=1)
        assert len(env.step(env.action_space.sample())) == 5
        assert np.asarray(env.render()).dtype == np.uint8
        env.close()


# --- Autoreset modes ---------------------------------------------------------------------------------------------


class Single(gymnasium.Env[Any, Any]):
    """One sub-environment of a task as a plain Gymnasium environment."""

    def __init__(self, task: str, num_envs: int, index: int) -> None:
        self.env = envs.make(task, num_envs, seed=7)
        self.env.reset()
        self.index = index
        self.mask = np.arange(num_envs) == index
        self.begun = False
        self.observation_space, self.action_space = self.env.single_observation_space, self.env.single_action_space

    def own(self, info: dict[str, Any]) -> dict[str, Any]:
        """This sub-environment's part of an info."""
        return {key: self.own(v) if isinstance(v, dict) else v[self.index] for key, v in info.items()}

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        if self.begun:
            self.env.reset(options={"reset_mask": self.mask})
        self.begun = True
        return self.env.observations[self.index].copy(), self.own(copy.deepcopy(self.env.info))

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        actions = self.env.action_mask.argmax(axis=2)  # the others do anything that is allowed
        actions[self.index] = action
        observations, rewards, terminated, truncated, info = self.env.step(actions)
        i = self.index
        return observations[i], rewards[i], bool(terminated[i]), bool(truncated[i]), self.own(info)


def assert_same(ours: dict[str, Any], theirs: dict[str, Any], exactly: bool = False) -> None:
    """Equal infos; ours may lack the masks _<key>, which name the sub-environments that have an entry."""
    masks = {key for key in theirs.keys() - ours.keys() if key.startswith("_") and theirs[key].all() and not exactly}
    assert ours.keys() == theirs.keys() - masks
    for key, value in ours.items():
        if isinstance(value, dict):
            assert_same(value, theirs[key], exactly or key == "final_info")
        elif value.dtype == object:
            for a, b in zip(value, theirs[key], strict=True):
                np.testing.assert_array_equal(a, b)
        else:
            np.testing.assert_array_equal(value, theirs[key], key)
            assert value.dtype == theirs[key].dtype


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("task", [LBF, SPEAKER])
def test_each_step_is_that_of_gymnasiums_own_vector(task: str, mode: AutoresetMode) -> None:
    num_envs, rng = 3, np.random.default_rng(0)
    ours = make(task, num_envs, seed=7, autoreset_mode=mode)
    theirs = SyncVectorEnv([partial(Single, task, num_envs, i) for i in range(num_envs)], autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"] is mode
    (observations, info), (their_observations, their_info) = ours.reset(), theirs.reset()
    np.testing.assert_array_equal(observations, their_observations)
    assert_same(info, their_info)
    finished, ends = np.zeros(num_envs, bool), 0
    for t in range(120):
        if t in (9, 30, 77):  # some begin anew, so that not all end together
            mask = np.arange(num_envs) == t % num_envs
            observations, info = ours.reset(options={"reset_mask": mask})
            np.testing.assert_array_equal(observations, theirs.reset(options={"reset_mask": mask})[0])
            finished &= ~mask
        actions = allowed_actions(info, rng)
        if mode is AutoresetMode.NEXT_STEP:
            actions[finished] = 99  # nobody looks at it
        kept = actions.copy()
        *outcome, info = ours.step(actions)
        *their_outcome, their_info = theirs.step(actions)
        for a, b in zip(outcome, their_outcome, strict=True):
            np.testing.assert_array_equal(a, b)
        assert_same(info, their_info)
        np.testing.assert_array_equal(actions, kept)
        finished = outcome[2] | outcome[3]
        ends += finished.sum()
    assert ends >= 9


def test_the_episodes_are_the_same_in_all_modes() -> None:
    """Nobody moves, so that all episodes end in step 50."""
    starts: dict[AutoresetMode, list[NDArray[np.float32]]] = {}
    for mode in MODES:
        env = make(seed=3, autoreset_mode=mode)
        starts[mode] = [env.reset()[0]]
        for _ in range(3):
            for _ in range(50):
                observations, _, _, truncated, _ = env.step(np.zeros((3, 2), int))
            assert truncated.all()
            if mode is AutoresetMode.NEXT_STEP:
                observations, rewards, *flags, _ = env.step(np.zeros((3, 2), int))
                assert not np.any(flags) and not rewards.any()
            if mode is AutoresetMode.DISABLED:
                np.testing.assert_array_equal(env.step(np.zeros((3, 2), int))[0], observations)  # stands still
                observations, _ = env.reset(options={"reset_mask": truncated})
            starts[mode].append(observations)
    for mode in MODES:
        np.testing.assert_array_equal(starts[mode], starts[AutoresetMode.DISABLED])
    assert len({start.tobytes() for start in starts[AutoresetMode.DISABLED]}) == 4


def test_the_default_is_gymnasiums() -> None:
    assert make().metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert make(autoreset_mode="SameStep").metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert make().metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.make(LBF).metadata["autoreset_mode"] is AutoresetMode.DISABLED


@pytest.mark.parametrize("mode", MODES)
def test_wrong_actions_in_any_step(mode: AutoresetMode) -> None:
    env = make(autoreset_mode=mode)
    env.reset()
    for step in range(51):  # the last one is a step that resets
        with pytest.raises(ValueError, match="have the shape"):
            env.step(np.zeros(2, int))
        if step < 50 or mode is AutoresetMode.SAME_STEP:
            with pytest.raises(ValueError, match="sub-environment 1, agent 0: action 9 does not exist"):
                env.step([[0, 0], [9, 0], [0, 0]])
        env.step(np.zeros((3, 2), int))


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("mode", MODES)
def test_a_copy_goes_on_by_itself(mode: AutoresetMode, duplicate: Callable[[Any], Any]) -> None:
    env = make(autoreset_mode=mode)
    env.reset()
    for _ in range(50):
        env.step(np.zeros((3, 2), int))
    twin = duplicate(env)
    for t in range(9):
        *outcome, info = env.step(np.full((3, 2), t % 5))
        *expected, their_info = twin.step(np.full((3, 2), t % 5))
        for a, b in zip(outcome, expected, strict=True):
            np.testing.assert_array_equal(a, b)
        assert_same(info, their_info)


# --- Gymnasium's wrappers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_gymnasium_counts_episodes_right(mode: AutoresetMode) -> None:
    if mode is AutoresetMode.SAME_STEP and GYMNASIUM < (1, 4):
        pytest.skip("Gymnasium 1.2 and 1.3 forget the reward of an episode's first step in this mode")
    env = RecordEpisodeStatistics(make(num_envs=5, seed=0, autoreset_mode=mode), buffer_length=10_000)
    rng = np.random.default_rng(0)
    _, info = env.reset()
    returns, lengths, waiting = np.zeros(5), np.zeros(5, int), np.zeros(5, bool)
    expected: list[tuple[float, int]] = []
    for _ in range(300):
        _, rewards, terminated, truncated, info = env.step(allowed_actions(info, rng))
        returns += rewards
        lengths += ~waiting
        done = terminated | truncated
        expected += list(zip(returns[done], lengths[done].tolist(), strict=True))
        returns[done], lengths[done] = 0, 0
        waiting = done & (mode is AutoresetMode.NEXT_STEP)
    assert env.episode_count == len(expected) >= 30
    np.testing.assert_allclose(env.return_queue, [r for r, _ in expected])
    assert list(env.length_queue) == [length for _, length in expected]
    assert len(set(env.length_queue)) > 5


def test_normalised_observations() -> None:
    env = NormalizeObservation(make(num_envs=8, seed=0))
    rng = np.random.default_rng(0)
    _, info = env.reset()
    seen = []
    for _ in range(200):
        observations, *_, info = env.step(allowed_actions(info, rng))
        seen.append(observations)
    values = np.array(seen[100:])
    assert env.single_observation_space.shape == values.shape[2:] == (2, 9)
    np.testing.assert_allclose(values.mean((0, 1)), 0, atol=0.3)
    np.testing.assert_allclose(values.std((0, 1)), 1, atol=0.3)


@pytest.mark.skipif(GYMNASIUM < (1, 3), reason="Gymnasium 1.2 makes no lists of infos without masks")
def test_infos_as_lists() -> None:
    env = DictInfoToList(make(SPEAKER, num_envs=2, autoreset_mode="SameStep"))
    env.reset()
    for t in range(25):
        *_, infos = env.step(np.zeros((2, 2), int))
        assert ("final_info" in infos[0]) == ("final_obs" in infos[1]) == (t == 24)
    for info in infos:
        assert info["final_info"]["statistics"]["goal_distance"] > 0
        assert info["state"].shape == info["final_info"]["state"].shape
        assert (info["state"] != info["final_info"]["state"]).any()


def test_sampling_with_a_mask() -> None:
    env = make(SPEAKER, num_envs=4)
    _, info = env.reset()
    choices = env.single_action_space.nvec
    assert choices.tolist() == [3, 5]
    mask = tuple(
        tuple(own[:n].astype(np.int8) for own, n in zip(agents, choices, strict=True)) for agents in info["action_mask"]
    )
    env.action_space.seed(0)
    sampled = {tuple(actions) for _ in range(100) for actions in env.action_space.sample(mask)}
    assert len(sampled) == 15  # each pair of their own actions
    env.step(env.action_space.sample(mask))


# --- Pictures ----------------------------------------------------------------------------------------------------


def test_frames() -> None:
    env = make(num_envs=2, seed=0, render_mode="rgb_array")
    env.reset()
    frames = env.render()
    assert env.render_mode == "rgb_array" and env.metadata["render_fps"] == 5
    assert isinstance(frames, tuple) and len(frames) == 2
    for i, frame in enumerate(frames):
        assert frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] == 3
        np.testing.assert_array_equal(frame, env.unwrapped.frame(i))
    assert (frames[0] != frames[1]).any()
    with pytest.raises(envs.InputError, match='made with render_mode="rgb_array"'):
        make().render()


def test_videos(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    from gymnasium.wrappers.vector import RecordVideo  # Gymnasium 1.2 does not have it

    env = RecordVideo(
        make(num_envs=4, render_mode="rgb_array"), str(tmp_path / "videos"), episode_trigger=lambda k: k < 2
    )
    _, info = env.reset()
    rng = np.random.default_rng(0)
    for _ in range(120):
        *_, info = env.step(allowed_actions(info, rng))
    env.close()
    videos = sorted((tmp_path / "videos").iterdir())
    assert [path.name for path in videos] == ["rl-video-episode-0.mp4", "rl-video-episode-1.mp4"]
    assert all(path.stat().st_size > 1000 for path in videos)
