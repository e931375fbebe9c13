"""A training draws from a generator of its own: what a game does to the global generators changes nothing in it."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from scripts import NAMES, OFF_POLICY
from test_algos_runs import evaluations, main, stop_after
from toys import Reseeds

from envs import runs


def flags(name: str, reseeds: bool) -> list[Any]:
    """A short run; the replays hold a batch early."""
    when = "made reset step" if reseeds else ""
    few: list[Any] = ["--env", "pettingzoo:toy_reseeds", "--env-kwargs", f"what='random numpy torch', when='{when}'"]
    few += ["--hidden-dim", 8, "--total-timesteps", 240, "--eval-points", 3, "--eval-episodes", 2]
    return few + (["--batch-size", 3] if name in OFF_POLICY else ["--num-envs", 2])


@pytest.mark.parametrize("name", NAMES)
def test_a_game_that_seeds_global_generators_changes_nothing(monkeypatch, capsys, tmp_path, name):
    """First weights, actions, batches and noise, also after a resume."""
    monkeypatch.setitem(sys.modules, "toy_reseeds", SimpleNamespace(parallel_env=Reseeds))
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
