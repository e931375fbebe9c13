"""A training draws from a generator of its own: what a game does to the global generators changes nothing in it."""

import random
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from pettingzoo import ParallelEnv
from scripts import NAMES, OFF_POLICY
from test_algos_runs import evaluations, main, stop_after

from envs import runs


class Meeting(ParallelEnv):
    """Two agents earn 1 where they act alike, for five steps. It seeds all global generators, if it is asked to."""

    metadata = {"name": "meeting"}  # noqa: RUF012
    possible_agents = ["a", "b"]  # noqa: RUF012
    max_cycles = 5

    def __init__(self, reseeds: bool = False) -> None:
        self.reseeds = reseeds
        self.disturb()

    def disturb(self) -> None:
        if self.reseeds:
            torch.manual_seed(0)
            np.random.seed(0)
            random.seed(0)

    def observation_space(self, agent: str) -> Any:
        return spaces.Box(0, 1, (2,), np.float32)

    def action_space(self, agent: str) -> Any:
        return spaces.Discrete(3)

    def seen(self) -> dict[str, Any]:
        self.disturb()
        vector = np.array([self.steps / 5, self.luck], np.float32)
        return {agent: vector for agent in self.agents}

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.steps, self.agents = 0, ["a", "b"]
        self.luck = np.random.default_rng(seed).random()
        return self.seen(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> Any:
        self.steps += 1
        seen = self.seen()
        nothing: dict[str, Any] = {agent: {} for agent in self.agents}
        rewards = {agent: float(actions["a"] == actions["b"]) for agent in self.agents}
        late = {agent: self.steps == 5 for agent in self.agents}
        if self.steps == 5:
            self.agents = []
        return seen, rewards, dict.fromkeys(late, False), late, nothing


def flags(name: str, reseeds: bool) -> list[Any]:
    """A short run; the replays hold a batch early."""
    few = ["--env", "pettingzoo:reseeding_meeting", "--env-kwargs", f"reseeds={reseeds}", "--hidden-dim", 8]
    few += ["--total-timesteps", 60, "--eval-points", 3, "--eval-episodes", 2]
    return few + (["--batch-size", 3] if name in OFF_POLICY else ["--num-envs", 2])


@pytest.mark.parametrize("name", NAMES)
def test_a_game_that_seeds_global_generators_changes_nothing(monkeypatch, capsys, tmp_path, name):
    """First weights, actions, batches and noise, also after a resume."""
    monkeypatch.setitem(sys.modules, "reseeding_meeting", SimpleNamespace(parallel_env=Meeting))
    for reseeds in (False, True):
        stop_after(monkeypatch, capsys, name, tmp_path / f"{reseeds}", 4, flags=flags(name, reseeds))
        more = [*flags(name, reseeds), "--run-dir", tmp_path / f"{reseeds}", "--resume"]
        assert main(monkeypatch, capsys, name, *more)[0] == 0
    quiet, disturbed = (runs.read_checkpoint(tmp_path / which, name) for which in ("False", "True"))
    assert quiet["updates"] > 3 and torch.equal(quiet["rng"], disturbed["rng"])
    for part in [part for part in quiet["parts"] if not part.endswith("optimiser")]:
        for weights, x in quiet["parts"][part].items():
            assert torch.equal(x, disturbed["parts"][part][weights]), (part, weights)
    assert evaluations(tmp_path / "False") == evaluations(tmp_path / "True")
