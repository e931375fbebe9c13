"""The matrix games, against the paper's payoffs (climbing: see the note in envs/families/matrix.py)."""

from __future__ import annotations

import numpy as np
import pytest

import envs

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
