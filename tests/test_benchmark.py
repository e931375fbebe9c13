"""The programs of benchmark/: results are collected without loss, and the timing programs time."""

import csv
import json
import shutil
import subprocess
import sys

import pytest
from scripts import ROOT, load_module


@pytest.fixture
def collect(monkeypatch, tmp_path):
    """benchmark/collect.py as a module, with a results folder of its own."""
    module = load_module(ROOT / "benchmark" / "collect.py")
    monkeypatch.setattr(module, "RESULTS", tmp_path / "benchmark" / "results")
    return module


def make_run(folder, seed, timesteps, budget=2_500_000, name="mappo-shared", gamma=0.99):
    """A run directory as a script leaves it, with one evaluation at each of the timesteps."""
    directory = folder / "matrix-climbing" / name / f"seed{seed}"
    directory.mkdir(parents=True)
    flags = {"env": "matrix-climbing", "seed": seed, "total_timesteps": budget, "gamma": gamma, "threads": 1}
    (directory / "config.json").write_text(json.dumps({"flags": flags, "commit": "abc", "command": ["mappo.py"]}))
    lines = ["point,timestep,wall_seconds,cpu_seconds,return_mean,return_std,episode_length"]
    lines += [f"{point},{step},{1.23456 * point},0.5,{10.5 * point},1.0,25.0" for point, step in enumerate(timesteps)]
    (directory / "evaluations.csv").write_text("\n".join(lines) + "\n")


def run_collect(collect, monkeypatch, folder):
    monkeypatch.setattr(sys, "argv", ["collect.py", str(folder)])
    collect.main()


def table(collect, name):
    with open(collect.RESULTS / "matrix-climbing" / f"{name}.csv") as file:
        return list(csv.DictReader(file))


def test_seeds_come_together_and_stay(collect, monkeypatch, tmp_path):
    make_run(tmp_path / "first", 1, [0, 2_500_000])
    make_run(tmp_path / "first", 0, [0, 2_500_010])
    run_collect(collect, monkeypatch, tmp_path / "first")
    make_run(tmp_path / "second", 2, [0, 2_500_000])
    run_collect(collect, monkeypatch, tmp_path / "second")
    rows = table(collect, "mappo-shared")
    assert [(row["seed"], row["timestep"], row["return_mean"]) for row in rows] == [
        ("0", "0", "0.0"),
        ("0", "2500010", "10.5"),
        ("1", "0", "0.0"),
        ("1", "2500000", "10.5"),
        ("2", "0", "0.0"),
        ("2", "2500000", "10.5"),
    ]
    settings = json.loads((collect.RESULTS / "matrix-climbing" / "mappo-shared.json").read_text())
    assert settings["flags"] == {"env": "matrix-climbing", "total_timesteps": 2_500_000, "gamma": 0.99}
    assert settings["seeds"] == {seed: {"commit": "abc"} for seed in "012"}


def test_incomplete_runs_are_left_out(collect, monkeypatch, tmp_path, capsys):
    make_run(tmp_path / "runs", 0, [0, 2_499_999])
    run_collect(collect, monkeypatch, tmp_path / "runs")
    assert "not complete" in capsys.readouterr().out and not collect.RESULTS.exists()


def test_another_budget_is_another_table(collect, monkeypatch, tmp_path):
    make_run(tmp_path / "runs", 0, [0, 1000], budget=1000)
    run_collect(collect, monkeypatch, tmp_path / "runs")
    assert len(table(collect, "mappo-shared-total-timesteps=1000")) == 2


def test_other_flags_do_not_mix(collect, monkeypatch, tmp_path, capsys):
    make_run(tmp_path / "first", 0, [0, 2_500_000])
    run_collect(collect, monkeypatch, tmp_path / "first")
    make_run(tmp_path / "second", 1, [0, 2_500_000], gamma=0.5)
    make_run(tmp_path / "second", 2, [0, 2_500_000])
    with pytest.raises(SystemExit, match="2"):
        run_collect(collect, monkeypatch, tmp_path / "second")
    assert "seed1: left out" in (said := capsys.readouterr().err) and "another gamma" in said
    assert {row["seed"] for row in table(collect, "mappo-shared")} == {"0", "2"}


def test_a_flag_that_only_the_table_knows_is_named(collect, monkeypatch, tmp_path, capsys):
    make_run(tmp_path / "runs", 0, [0, 2_500_000])
    run_collect(collect, monkeypatch, tmp_path / "runs")
    path = collect.RESULTS / "matrix-climbing" / "mappo-shared.json"
    settings = json.loads(path.read_text())
    settings["flags"]["clip_coef"] = 0.2
    path.write_text(json.dumps(settings))
    with pytest.raises(SystemExit):
        run_collect(collect, monkeypatch, tmp_path / "runs")
    assert "another clip_coef" in capsys.readouterr().err


def test_a_lengthened_run_does_not_mix(collect, monkeypatch, tmp_path, capsys):
    """Begun with a smaller budget, it has more evaluations than the others, at other steps."""
    make_run(tmp_path / "runs", 0, [0, 2_500_000])
    make_run(tmp_path / "runs", 1, [0, 1_250_000, 2_500_000])
    with pytest.raises(SystemExit):
        run_collect(collect, monkeypatch, tmp_path / "runs")
    assert "3 evaluations" in capsys.readouterr().err
    assert {row["seed"] for row in table(collect, "mappo-shared")} == {"0"}
    make_run(tmp_path / "again", 0, [0, 1_250_000, 2_500_000])  # alone in its table, it takes its own place
    run_collect(collect, monkeypatch, tmp_path / "again")
    assert len(table(collect, "mappo-shared")) == 3


def test_a_run_that_lacks_its_settings_does_not_stop_the_others(collect, monkeypatch, tmp_path, capsys):
    make_run(tmp_path / "runs", 0, [0, 2_500_000])
    make_run(tmp_path / "runs", 1, [0, 2_500_000])
    (tmp_path / "runs" / "matrix-climbing" / "mappo-shared" / "seed0" / "config.json").unlink()
    with pytest.raises(SystemExit):
        run_collect(collect, monkeypatch, tmp_path / "runs")
    assert "config.json" in capsys.readouterr().err
    assert {row["seed"] for row in table(collect, "mappo-shared")} == {"1"}


@pytest.mark.parametrize(
    "command, said",
    [
        ("collect.py nowhere", "no runs in nowhere"),
        ("report.py nothing", "no results of nothing"),
        ("stepping.py --tasks nothing", "unknown task 'nothing'"),
        ("stepping.py --num-envs 0", "must be positive"),
    ],
)
def test_wrong_input_is_named(command, said):
    name, *flags = command.split()
    done = subprocess.run([sys.executable, f"benchmark/{name}", *flags], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr


def run_training(monkeypatch, *flags):
    """benchmark/training.py in this process: a process of its own would spend seconds on importing torch."""
    monkeypatch.setattr(sys, "argv", ["training.py", *flags])
    load_module(ROOT / "benchmark" / "training.py").main()


@pytest.mark.parametrize(
    "flags, said",
    [(["--env", "nothing"], "unknown task 'nothing'"), (["--algos", "nothing"], "invalid choice: 'nothing'")],
)
def test_wrong_input_of_training_is_named(monkeypatch, capsys, flags, said):
    with pytest.raises(SystemExit, match="2"):
        run_training(monkeypatch, *flags)
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "algorithms, flags", [(["mappo", "coma", "qmix", "maddpg"], []), (["iql"], ["--", "--no-parameter-sharing"])]
)
def test_training_speed(monkeypatch, capsys, algorithms, flags):
    run_training(monkeypatch, "--env", "matrix-climbing", "--seconds", "0.1", "--algos", *algorithms, *flags)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == algorithms
    assert all("reference passes" in line and ("independent" in line) == bool(flags) for line in lines)


def test_report_computes_as_the_paper_does(monkeypatch, tmp_path, capsys):
    """Two seeds with the curves (0, 4, 2) and (2, 6, 8): by hand, the maximum is 5 at the last two points."""
    module = load_module(ROOT / "benchmark" / "report.py")
    folder = tmp_path / "results" / "matrix-climbing"
    folder.mkdir(parents=True)
    lines = ["seed,point,return_mean", "0,0,0", "0,1,4", "0,2,2", "1,0,2", "1,1,6", "1,2,8"]
    (folder / "mappo-shared.csv").write_text("\n".join(lines))
    (folder / "mappo-shared.json").write_text(json.dumps({"flags": {"total_timesteps": 2_500_000}}))
    shutil.copytree(ROOT / "benchmark" / "paper", tmp_path / "paper")
    monkeypatch.setattr(module, "HERE", tmp_path)
    monkeypatch.setattr(sys, "argv", ["report.py"])
    module.main()
    # ties go to the first best point: 4 and 6, deviation sqrt(2); own means 2 and 16 / 3; last 2 and 8
    cells = [cell.strip() for cell in capsys.readouterr().out.splitlines()[-1].split("|")[1:-1]]
    assert cells == [
        *["matrix-climbing", "mappo", "2*", "5.00 +- 2.00", "175.00 +- 0.00"],
        *["3.67 +- 3.33", "170.76 +- 1.79", "5.00 +- 6.00"],
    ]

    lines = ["seed,point,return_mean", "0,0,9", "0,1,4", "0,2,2"]
    (folder / "mappo-shared.csv").write_text("\n".join(lines))
    module.main()
    assert "| 9.00 at step 0 |" in capsys.readouterr().out

    changed = "mappo-independent-network=gru-total-timesteps=1000-learning-rate=1e-05"
    (folder / "mappo-shared.csv").rename(folder / f"{changed}.csv")
    (folder / "mappo-shared.json").unlink()
    (folder / f"{changed}.json").write_text(json.dumps({"flags": {"total_timesteps": 1000}}))
    module.main()
    label = "| mappo, no sharing, network=gru, 1,000 steps, learning-rate=1e-05 | 1* |"
    assert label in capsys.readouterr().out
