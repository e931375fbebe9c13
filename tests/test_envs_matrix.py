"""The matrix games, against the paper's payoffs (climbing: see the note in envs/families/matrix.py)."""

from __future__ import annotations

import numpy as np
import pytest
from scripts import near

import envs
from envs import tasks
from envs.pictures import matrix as pictures

CLIMBING = [[11, -30, 0], [-30, 7, 0], [0, 6, 5]]


@pytest.mark.parametrize("k", [None, 0, 25, 50, 75, 100, 3])
def test_payoffs_and_ends(k: int | None) -> None:
    name = "matrix-climbing" if k is None else f"matrix-penalty-{k}"
    payoff = CLIMBING if k is None else [[-k, 0, 10], [0, 2, 0], [10, 0, -k]]
    joint = np.array([(row, column) for row in range(3) for column in range(3)])
    env = envs.make(name, 9)
    assert (env.n_agents, env.n_actions, env.obs_size, env.state_size, env.episode_limit) == (2, 3, 2, 4, 25)
    for _ in range(2):
        observations, info = env.reset()
        total = np.zeros(9)
        for step in range(1, 26):
            assert not observations.any() and info["action_mask"].all()
            observations, rewards, terminated, truncated, info = env.step(joint)
            total += rewards
            np.testing.assert_array_equal(rewards, np.array(payoff).ravel())
            np.testing.assert_array_equal(info["agent_rewards"], np.array(payoff).reshape(9, 1).repeat(2, axis=1))
            assert not terminated.any() and (truncated == (step == 25)).all()
        assert total.max() == (275 if k is None else 250)


def test_a_new_game_is_its_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any number of actions; a picture comes with it, and bounds of the return."""
    monkeypatch.setitem(tasks.MATRIX_GAMES, "four", tuple(tuple(range(row, row + 4)) for row in (0, -5, 8, 4)))
    env = envs.make("matrix-four", 16)
    env.reset()
    joint = np.array([(row, column) for row in range(4) for column in range(4)])
    _, rewards, *_ = env.step(joint)
    assert rewards.tolist() == [*range(0, 4), *range(-5, -1), *range(8, 12), *range(4, 8)]
    assert envs.task("matrix-four").returns == (-125, 275) and envs.task("matrix-four").family == "matrix"
    shown, smaller = env.frame(15), envs.make("matrix-climbing").frame()
    assert near(shown, pictures.LIT) > 2000 and shown.shape[0] > smaller.shape[0]  # the last row and column
