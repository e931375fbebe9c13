"""The adapter to SMAC, with a small stand-in for the package and the game, which need not be installed."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

import envs

# As `smac.env.StarCraft2Env`: two agents, three actions (0 only for the dead), four steps. Agent 1 dies in step 2.
# Action 2 of agent 0 wins; in step 3 of the second episode the game crashes.
STAND_IN = """
import os
import numpy as np

class StarCraft2Env:
    def __init__(self, map_name, seed, continuing_episode):
        assert map_name == "3m" and continuing_episode
        self.seed, self.episode, self.log = seed, 0, os.environ["STAND_IN_LOG"]
        self.write(f"made {seed}")

    def write(self, text):
        with open(self.log, "a") as file:
            file.write(text + "\\n")

    def get_env_info(self):
        return {"n_agents": 2, "n_actions": 3, "obs_shape": 3, "state_shape": 4, "episode_limit": 4}

    def reset(self):
        self.episode, self.steps, self.broken = self.episode + 1, 0, False
        return self.get_obs(), self.get_state()

    def step(self, actions):
        assert all(type(action) is int for action in actions)
        assert [bool(mask[action]) for action, mask in zip(actions, self.get_avail_actions())] == [True, True]
        self.steps += 1
        if actions[0] == 2 and self.steps == 4:
            os._exit(1)
        if self.episode == 2 and self.steps == 3:
            self.broken = True
            return 0, True, {}
        won = actions[0] == 2
        info = {"battle_won": won, "dead_allies": int(self.steps > 1), "dead_enemies": 3 * won}
        if self.steps == 4:
            info["episode_limit"] = True
        return 0.5, won or self.steps == 4, info

    def get_obs(self):
        assert not self.broken
        return [np.full(3, self.steps + 10 * i) for i in range(2)]

    def get_state(self):
        return np.full(4, self.steps + 100 * self.episode)

    def get_avail_actions(self):
        return [[0, 1, 1], [0, 1, 1] if self.steps < 2 else [1, 0, 0]]

    def close(self):
        self.write(f"closed {self.seed}")
"""


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install the stand-in; what its games write is in the file that this gives."""
    package = tmp_path / "packages" / "smac" / "env"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").touch()
    (package / "__init__.py").write_text(STAND_IN)
    (tmp_path / "packages" / "pysc2.py").touch()
    (tmp_path / "game" / "Versions" / "Base75689").mkdir(parents=True)
    maps = tmp_path / "game" / "Maps" / "SMAC_Maps"
    maps.mkdir(parents=True)
    (maps / "3m.SC2Map").touch()
    monkeypatch.syspath_prepend(str(tmp_path / "packages"))
    monkeypatch.setenv("SC2PATH", str(tmp_path / "game"))
    monkeypatch.setenv("STAND_IN_LOG", str(tmp_path / "log"))
    yield tmp_path / "log"
    for name in [name for name in sys.modules if name.split(".")[0] in ("smac", "pysc2")]:
        del sys.modules[name]
    importlib.invalidate_caches()


def test_episodes(log: Path) -> None:
    env = envs.make("smac-3m", 2, seed=7)
    sizes = (env.n_agents, env.n_actions, env.obs_size, env.state_size, env.episode_limit)
    assert sizes == (2, 3, 3, 4, 4) and envs.task("smac-3m").family == "smac"
    observations, info = env.reset()
    assert observations.dtype == np.float32 and observations[:, :, 0].tolist() == [[0, 10]] * 2
    assert info["state"].tolist() == [[100] * 4] * 2
    assert info["action_mask"].tolist() == [[[False, True, True]] * 2] * 2

    with pytest.raises(ValueError, match="sub-environment 0, agent 1: action 0 is forbidden"):
        env.step([[1, 0], [1, 1]])
    with pytest.raises(ValueError, match="sub-environment 1, agent 0: action 3 does not exist"):
        env.step([[1, 1], [3, 1]])
    observations, rewards, terminated, truncated, info = env.step([[1, 1], [2, 1]])  # the second battle is won
    assert rewards.tolist() == [0.5, 0.5] and info["agent_rewards"].tolist() == [[0.5, 0.5]] * 2
    assert terminated.tolist() == [False, True] and not truncated.any()
    assert info["statistics"]["battle_won"].tolist() == [0, 1]
    assert info["statistics"]["dead_enemies"].tolist() == [0, 3]
    observations, rewards, *_, info = env.step([[1, 1], [1, 1]])  # and stands still
    assert rewards.tolist() == [0.5, 0] and observations[:, 0, 0].tolist() == [2, 1]
    assert info["action_mask"][0, 1].tolist() == [True, False, False]
    env.step([[1, 0], [1, 1]])
    *_, terminated, truncated, info = env.step([[1, 0], [1, 1]])
    assert terminated.tolist() == [False, True] and truncated.tolist() == [True, False]
    assert info["statistics"]["dead_allies"].tolist() == [1, 0]

    env.reset()  # the second episode, in which the games crash
    env.step([[1, 1]] * 2)
    before = env.step([[1, 1]] * 2)
    after = env.step([[1, 0]] * 2)
    assert not after[2].any() and after[3].all() and not after[1].any()
    np.testing.assert_array_equal(after[0], before[0])
    assert np.isnan(after[4]["statistics"]["battle_won"]).all()
    assert env.reset(options={"reset_mask": np.array([True, False])})[1]["state"][:, 0].tolist() == [300, 202]

    env.close()
    lines = log.read_text().split("\n")
    made = {line.split()[1] for line in lines if line.startswith("made")}
    assert len(made) == 2 and {line.split()[1] for line in lines if line.startswith("closed")} == made


def test_another_seed_starts_other_games(log: Path) -> None:
    env = envs.make("smac-3m", 1, seed=7)
    env.reset()
    env.reset(seed=7)
    assert log.read_text().count("made") == 1
    assert env.reset(seed=8)[1]["state"][0, 0] == 100
    env.close()
    assert log.read_text().count("made") == log.read_text().count("closed") == 2


def test_another_seed_for_some_games(log: Path) -> None:
    """The others go on, and take the seed when they are reset."""
    env = envs.make("smac-3m", 2, seed=7)
    env.reset()
    env.step([[1, 1]] * 2)
    first, second = np.array([True, False]), np.array([False, True])
    assert env.reset(seed=8, options={"reset_mask": first})[1]["state"][:, 0].tolist() == [100, 101]
    assert env.step([[1, 1]] * 2)[4]["state"][:, 0].tolist() == [101, 102]
    assert log.read_text().count("made") == 3
    assert env.reset(options={"reset_mask": second})[1]["state"][:, 0].tolist() == [101, 100]
    made = [line for line in log.read_text().split("\n") if line.startswith("made")]
    env.close()
    env = envs.make("smac-3m", 2, seed=8)
    env.close()
    again = [line for line in log.read_text().split("\n") if line.startswith("made")]
    assert len(made) == 4 and sorted(again[4:]) == sorted(made[2:])


def test_a_game_that_ends_by_itself_is_an_error(log: Path) -> None:
    env = envs.make("smac-3m", 1)
    env.reset()
    for actions in ([1, 1], [1, 1], [1, 0]):
        env.step([actions])
    with pytest.raises(envs.InputError, match=r"smac-3m: worker process 0 has ended without a word \(exit code 1\)"):
        env.step([[2, 0]])


def test_what_is_missing_is_named(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(envs.InputError, match=r"there is no map .*4m\.SC2Map; smaclite-<map>"):
        envs.make("smac-4m")
    monkeypatch.setenv("SC2PATH", "/nowhere")
    with pytest.raises(envs.InputError, match="needs StarCraft II, which is not in /nowhere"):
        envs.make("smac-3m")
    (log.parent / "packages" / "pysc2.py").unlink()
    importlib.invalidate_caches()
    if importlib.util.find_spec("pysc2") is None:
        with pytest.raises(envs.InputError, match="needs the package pysc2; pip install"):
            envs.make("smac-3m")


def test_more_games_than_memory(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=2.9 * 2**30))
    envs.make("smac-3m", 2).close()
    with pytest.raises(envs.InputError, match="3 games at once take a gigabyte of memory each, and 2 are free"):
        envs.make("smac-3m", 3)


@pytest.mark.parametrize(("number", "seed", "said"), [(0, 0, "num_envs is 0"), (1, -1, "seed is -1")])
def test_what_cannot_be_begins_no_game(log: Path, number: int, seed: int, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        envs.make("smac-3m", number, seed)
    assert not log.exists()


@pytest.mark.skipif(importlib.util.find_spec("smac") is not None, reason="a package of that name is installed")
def test_without_the_package() -> None:
    with pytest.raises(envs.InputError, match=r"smac-3m needs the package smac; pip install .*smaclite-<map>"):
        envs.make("smac-3m")
