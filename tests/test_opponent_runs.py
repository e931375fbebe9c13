"""Runs against an opponent from a file: results name it by its contents, and keep it apart from the built-in one."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import programs
import pytest
from scripts import ROOT

from benchmark import store
from envs.families import mpe


def opponent(path: Path, seed: int) -> str:
    """Writes a prey with random weights; returns its fingerprint."""
    rng = np.random.default_rng(seed)
    shapes = [(16, 8), (8,), (8, 8), (8,), (8, 5), (5,)]
    network = mpe.Network(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))
    np.savez(path, **network._asdict())
    return mpe.fingerprint(network)


def run(folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "algos/ia2c.py"), "--env", "mpe-tag", "--total-timesteps", "500"]
    command += ["--eval-points", "2", "--eval-episodes", "3", *flags]
    return programs.run(command, cwd=folder)


@pytest.mark.slow
def test_a_run_against_an_opponent_from_a_file(tmp_path: Path) -> None:
    """It is begun, collected, gone on with where the file lies elsewhere, and refused where the file is another one."""
    first, second = opponent(tmp_path / "prey.npz", 0), opponent(tmp_path / "other.npz", 1)
    assert run(tmp_path, "--env-kwargs", "opponent='prey.npz'").returncode == 0
    directory = tmp_path / f"runs/mpe-tag/ia2c-shared-env-kwargs=opponent=_{first}_/seed0"
    config = json.loads((directory / "config.json").read_text())
    assert config["flags"]["env_kwargs"] == config["changed"]["env_kwargs"] == f"opponent='{first}'"
    assert config["changed"].keys() == {"env_kwargs", "total_timesteps", "eval_points", "eval_episodes"}
    table = store.collect(directory, tmp_path / "results")
    assert first in table.name and json.loads(table.with_suffix(".json").read_text())["changed"] == config["changed"]

    (tmp_path / "prey.npz").rename(tmp_path / "moved.npz")
    longer = ["--run-dir", str(directory), "--resume", "--total-timesteps", "1000"]
    assert run(tmp_path, *longer, "--env-kwargs", "opponent='moved.npz'").returncode == 0
    assert json.loads((directory / "config.json").read_text())["flags"]["total_timesteps"] == 1000
    done = run(tmp_path, *longer, "--env-kwargs", "opponent='other.npz'")
    assert done.returncode == 2 and first in done.stderr and "this cannot change" in done.stderr

    assert run(tmp_path, "--env-kwargs", "opponent='other.npz'").returncode == 0
    other = store.collect(Path(str(directory).replace(first, second)), tmp_path / "results")
    assert other != table

    done = run(tmp_path, "--env-kwargs", "opponent='prey.npz'")
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "no opponent's file 'prey.npz'" in done.stderr
