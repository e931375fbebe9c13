"""The teams of benchmark/teams/: each plays as well as its run said, in the script that it names."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import programs
import pytest
import torch
from scripts import NAMES, ROOT, runs, script

from benchmark import collect

PLACES = sorted(path.parent for path in collect.TEAMS.glob("*/config.json"))


def config_of(place: Path) -> dict:
    return json.loads((place / "config.json").read_text())


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.name)
def test_a_team_plays_as_its_run_said(place):
    """In the episodes of its last evaluation; where rounding differs, in others that are as good."""
    module, last = script(config_of(place)["algorithm"]), pd.read_csv(place / "evaluations.csv").iloc[-1]
    seed = int(np.random.SeedSequence([0, int(last["point"])]).generate_state(1)[0])
    team = module.load(place, seed)
    assert team.args.env.replace(":", "_") == place.name
    returned = runs.evaluate(runs.make_for(team.args, team.args.eval_episodes), team, seed)
    of_means = last["return_std"] * np.sqrt(2 / team.args.eval_episodes)  # standard deviation of their difference
    assert returned["return_mean"] == pytest.approx(last["return_mean"], abs=4 * of_means + 1e-3)


def test_they_are_small_and_of_no_machine():
    files = [path for place in PLACES for path in place.iterdir() if path.name not in ("film.gif", "episodes.csv")]
    assert sum(path.stat().st_size for path in files) <= 12 * 2**20
    assert {path.name for path in files} == {"checkpoint.pt", "config.json", "evaluations.csv"}
    for place in PLACES:
        saved = torch.load(place / "checkpoint.pt", weights_only=True)
        assert list(saved["parts"]) == ["agents"]
        assert {tensor.dtype for tensor in saved["parts"]["agents"].values()} == {torch.float32}
        assert not {"command", "machine"} & config_of(place).keys() and not saved["config"]["flags"]["run_dir"]


@pytest.mark.slow
def test_watching_one_and_the_wrong_script(tmp_path, monkeypatch, capsys):
    place = shutil.copytree(PLACES[0], tmp_path / "team")
    algorithm = config_of(place)["algorithm"]
    other = next(name for name in NAMES if name != algorithm)
    words = [str(ROOT / "algos" / f"{algorithm}.py"), "--watch", str(place), "--eval-episodes", "5"]
    films = programs.run([sys.executable, *words])
    assert films.returncode == 0 and "return_mean" in films.stdout and (place / "film.gif").exists()
    monkeypatch.setattr(sys, "argv", words)
    module: Any = script(other)
    with pytest.raises(SystemExit) as end:
        runs.main(module.__file__, module.__doc__, module.Args, module.paper_defaults, module.train, module.load)
    assert end.value.code == 2
    assert capsys.readouterr().err == f"{other}: {place} holds a run of {algorithm}.py, not of {other}.py.\n"


def test_films_stay_out_of_the_repository():
    ignored = subprocess.run(["git", "check-ignore", "benchmark/teams/any/film.gif"], cwd=ROOT, capture_output=True)
    assert ignored.returncode in (0, 128)  # 128: this is no checkout


class TestKeeping:
    @pytest.fixture
    def run(self, tmp_path):
        """A complete run of IA2C, as its script leaves it."""
        module = script("ia2c")
        args = module.paper_defaults("matrix-climbing")
        args.run_dir = str(tmp_path / "run")
        env = runs.make_for(args, 1)
        agents = module.MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, args.network)
        parts = {"agents": agents.state_dict(), "critic": agents.state_dict(), "optimiser": {}}
        directory = module.runs.RunDirectory(ROOT / "algos" / "ia2c.py", args, module.paper_defaults("matrix-climbing"))
        network = (env.n_agents, env.obs_size, env.n_actions, args.network)
        rows = [{"point": 0, "timestep": 0, "return_mean": 1.0}]
        directory.save(rows, network=network, parts=parts, rng=torch.zeros(1))
        return tmp_path / "run"

    def test_the_best_algorithm_of_a_task(self, run, tmp_path):
        returns = pd.Series({("matrix-climbing", name): 5.0 for name in ("ia2c", "mappo")} | {("other", "iql"): 6.0})
        place = tmp_path / "teams" / "matrix-climbing"
        assert collect.keep_team(run, returns, tmp_path / "teams") == place
        team = script("ia2c").load(place)
        assert (place / "checkpoint.pt").stat().st_size < (run / "checkpoint.pt").stat().st_size
        assert team.args.env == "matrix-climbing" and config_of(place)["flags"]["run_dir"] == ""
        assert collect.keep_team(run, returns, tmp_path / "teams") is None  # not better than itself
        for algorithm, kept in (("mappo", None), ("coma", place)):  # as good, and none in the results
            (place / "config.json").write_text(json.dumps({"algorithm": algorithm}))
            assert collect.keep_team(run, returns, tmp_path / "teams") == kept
        returns["matrix-climbing", "qmix"] = 6.0
        assert collect.keep_team(run, returns, tmp_path / "elsewhere") is None

    @pytest.mark.parametrize("change", [{"seed": 1}, {"parameter_sharing": False}, {"env": "lbf-9x9-2p-2f"}])
    def test_other_runs_are_not_kept(self, run, tmp_path, change):
        config = config_of(run)
        (run / "config.json").write_text(json.dumps(config | {"flags": config["flags"] | change}))
        assert collect.keep_team(run, pd.Series(dtype=float), tmp_path / "teams") is None
