"""Frames and films."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scripts import near

import envs
from envs import render
from envs.families import lbf
from envs.pictures import lbf as pictures
from envs.pictures import rware as warehouse
from envs.render import save_film

DRAWN = (
    "matrix-penalty-25",
    "lbf-5x5-2p-1f",
    "lbf-6x9-3p-2f-2s",
    "lbf-20x20-9p-5f-c-v3",
    "lbf-100x100-2p-1f",
    "rware-tiny-2p",
    "rware-large-20p",
)


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.slow
def test_frames_of_an_episode(name: str) -> None:
    env = envs.make(name, 2, seed=1)
    env.reset()
    assert env.can_draw
    frames = [env.frame(index=1)]
    for _ in range(6):
        env.step(np.random.default_rng(0).integers(0, env.n_actions, (2, env.n_agents)))
        frames.append(env.frame(index=1))
    assert {(frame.dtype, frame.shape) for frame in frames} == {(np.dtype(np.uint8), frames[0].shape)}
    assert frames[0].ndim == 3 and frames[0].shape[2] == 3
    assert (frames[0] != frames[1]).any() and (frames[0] != env.frame(index=0)).any()


def test_who_loads_is_seen() -> None:
    env = envs.make("lbf-6x6-2p-2f")
    assert isinstance(env, lbf.Env)
    env.reset()
    env.game.agent[0] = [(1, 1, 1), (1, 3, 2)]
    env.game.food[0] = [(1, 2, 3), (4, 4, 1)]
    assert near(env.frame(0), pictures.AMBER) == near(env.frame(0), pictures.GREEN) == 0
    apples = near(env.frame(0), pictures.APPLE)
    env.step([[5, 0]])
    assert near(env.frame(0), pictures.AMBER) > 300 and near(env.frame(0), pictures.GREEN) == 0
    env.step([[5, 5]])
    assert near(env.frame(0), pictures.GREEN) > 600 and near(env.frame(0), pictures.AMBER) == 0
    assert near(env.frame(0), pictures.APPLE) < 0.7 * apples
    env.step([[0, 0]])
    assert near(env.frame(0), pictures.GREEN) == 0


def test_agents_on_one_cell_are_both_seen() -> None:
    env = envs.make("lbf-6x6-2p-1f")
    assert isinstance(env, lbf.Env)
    env.reset()
    env.game.agent[0] = [(1, 1, 1), (1, 1, 2)]
    frame = env.frame(0)
    assert near(frame, render.AGENTS[0]) > 100 and near(frame, render.AGENTS[1]) > 100


def test_who_carries_and_what_is_delivered_is_seen() -> None:
    from envs.families import rware

    env = envs.make("rware-tiny-2p", seed=1)
    assert isinstance(env, rware.Env)
    env.reset()
    game = env.game
    requested = np.flatnonzero(game.shelf[0, :, 2])
    for i, column in enumerate((3, 6)):  # agent 0 stands under a requested shelf above the goals, agent 1 elsewhere
        row, across, _, _ = game.agent[0, i]
        rware.put_agent(game, env.config, 0, row, across, -1)
        game.agent[0, i] = (9, 4, 1, -1) if i == 0 else (0, column, 1, -1)
        rware.put_agent(game, env.config, 0, game.agent[0, i, 0], game.agent[0, i, 1], i)
    s = requested[0]
    rware.put_shelf(game, env.config, 0, game.shelf[0, s, 0], game.shelf[0, s, 1], -1)
    game.shelf[0, s, :2] = 9, 4
    rware.put_shelf(game, env.config, 0, 9, 4, s)
    before = env.frame(0)
    env.step([[4, 0]])
    carried = env.frame(0)
    assert near(carried, render.AGENTS[0]) > 1.3 * near(before, render.AGENTS[0])  # the frame around its shelf
    assert near(carried, render.AGENTS[1]) == near(before, render.AGENTS[1])
    env.step([[1, 0]])
    assert env.rewards[0] == 1
    delivered = env.frame(0)
    assert near(delivered, warehouse.DELIVERED) > near(carried, warehouse.DELIVERED) + 200
    env.step([[0, 2]])
    afterwards = env.frame(0)
    assert near(afterwards, warehouse.DELIVERED) < near(carried, warehouse.DELIVERED)  # agent and shelf hide a goal
    assert (afterwards != delivered).any()


def test_films(tmp_path: Path) -> None:
    env = envs.make("lbf-8x8-2p-2f-c", seed=1)
    env.reset()
    frames = [env.frame(0)]
    for t in range(12):
        env.step(np.full((1, 2), 1 + t % 2))
        frames.append(env.frame(0))
    save_film(frames, tmp_path / "film.gif", frames_per_second=4)
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.format, film.n_frames, film.size) == ("GIF", 13, frames[0].shape[1::-1])  # type: ignore[attr-defined]
        assert film.info["loop"] == 0
        durations = []
        for i, frame in enumerate(frames):
            film.seek(i)
            durations.append(film.info["duration"])
            shown = np.asarray(film.convert("RGB")).astype(int)
            assert np.abs(shown - frame).mean() < 2
        assert durations == [250] * 12 + [1000]


class Still:
    """A team that does nothing."""

    def reset(self) -> None:
        pass

    def act(self, observations: Any, info: Any) -> Any:
        return np.zeros(observations.shape[:2], np.int64)


@pytest.mark.slow
def test_long_films_are_played_faster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five episodes of 51 pictures, each end shown four times more: 275 pictures."""
    rng = np.random.default_rng(0)
    monkeypatch.setattr(lbf.Env, "frame", lambda env, index: rng.integers(0, 256, (4, 4, 3), np.uint8))
    for limit, duration in ((1000, 200), (30, 110), (1, 20)):
        monkeypatch.setattr(render, "FILM_SECONDS", limit)
        render.film(envs.make("lbf-5x5-2p-1f", 5), Still(), 0, tmp_path / "film.gif")
        with Image.open(tmp_path / "film.gif") as film:
            assert film.info["duration"] == duration  # milliseconds


def test_a_colour_of_few_frames_is_kept(tmp_path: Path) -> None:
    """An event of one step among 100, such as a touch, beside pictures of many colours."""
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 200, (60, 60, 3), np.uint8) for _ in range(100)]
    frames[33][:20, :20] = event = (250, 10, 90)
    save_film(frames, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        film.seek(33)
        assert near(np.asarray(film.convert("RGB")), event) >= 400


def test_films_that_cannot_be_made(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one frame"):
        save_film([], tmp_path / "film.gif")
    with pytest.raises(ValueError, match="one size"):
        save_film([np.zeros((4, 4, 3), np.uint8), np.zeros((4, 5, 3), np.uint8)], tmp_path / "film.gif")
