"""Whole runs of the scripts: determinism, resuming, wrong input, learning, what a run leaves behind."""

import csv
import json
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scripts import NAMES, OFF_POLICY, ON_POLICY, ROOT, envs, script

from envs import matrix

SHORT = ["--env", "lbf-5x5-2p-1f", "--eval-points", "11", "--eval-episodes", "20", "--hidden-dim", "32"]
SHORT += ["--reward-standardisation", "running", "--network", "gru"]
STEPS = {name: 20_000 if name in ON_POLICY else 4000 for name in NAMES}
WRITTEN = ["checkpoint.previous.pt", "checkpoint.pt", "config.json", "evaluations.csv"]


def short(name):
    """The flags of a short run with 11 evaluations; a replay is full several times."""
    return [
        *SHORT,
        "--total-timesteps",
        STEPS[name],
        *(["--buffer-size", 40, "--batch-size", 8] * (name in OFF_POLICY)),
    ]


def command(name, *flags):
    return [sys.executable, str(ROOT / "algos" / f"{name}.py"), *map(str, flags)]


def run(name, *flags, cwd=None):
    return subprocess.run(command(name, *flags), capture_output=True, text=True, timeout=300, cwd=cwd)


def evaluations(directory):
    """The rows of evaluations.csv without the two columns of seconds."""
    with open(directory / "evaluations.csv") as file:
        rows = list(csv.DictReader(file))
    return [{key: value for key, value in row.items() if not key.endswith("seconds")} for row in rows]


def main(monkeypatch, capsys, name, *flags):
    """A script's main in this process: its exit code, and what it says on stderr."""
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, flags)])
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    code: object = 0
    try:
        script(name).main()
    except SystemExit as end:
        code = end.code
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return code, capsys.readouterr().err


@pytest.fixture(scope="module", params=NAMES)
def finished(request, tmp_path_factory):
    """A short run of each script, never interrupted: its name and directory."""
    directory = tmp_path_factory.mktemp(request.param) / "run"
    done = run(request.param, *short(request.param), "--run-dir", directory)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("return_mean") == 11  # a line for each evaluation where there is no terminal
    return request.param, directory


def test_what_a_run_leaves(finished):
    name, directory = finished
    names = sorted(path.name for path in directory.iterdir())
    events = [name for name in names if name.startswith("events.out.tfevents")]
    assert sorted({*WRITTEN, "lock"}) == sorted(set(names) - set(events)) and len(events) == 1
    rows = evaluations(directory)
    assert [int(row["point"]) for row in rows] == list(range(11))
    longest = 500 if name in ON_POLICY else 50  # of a batch: ten episodes, or one, of at most 50 steps
    for row in rows:  # due at the first end of a batch at or after its point
        due = int(row["point"]) * STEPS[name] // 10
        assert due <= int(row["timestep"]) < due + longest
    config = json.loads((directory / "config.json").read_text())
    assert config["flags"]["env"] == "lbf-5x5-2p-1f" and config["versions"]["torch"] == torch.__version__
    assert set(config) == {"flags", "command", "python", "versions", "commit", "machine", "preloaded"}


def test_same_seed_same_file(finished, tmp_path):
    name, directory = finished
    assert run(name, *short(name), "--run-dir", tmp_path / "again").returncode == 0
    assert evaluations(tmp_path / "again") == evaluations(directory)


def test_another_seed_another_file(finished, monkeypatch, capsys, tmp_path):
    name, directory = finished
    few = [*short(name), "--total-timesteps", "2000", "--eval-points", "2"]
    assert main(monkeypatch, capsys, name, *few, "--seed", 1, "--run-dir", tmp_path / "other")[0] == 0
    assert evaluations(tmp_path / "other")[0] != evaluations(directory)[0]


def rows_written(directory):
    """How many evaluations a run has on disk; 0 where there is no table yet."""
    path = directory / "evaluations.csv"
    return len(path.read_text().splitlines()) - 1 if path.exists() else 0


def test_killed_and_resumed_is_never_interrupted(finished, tmp_path):
    """kill -9 at three random moments of the training, each time after it has got further than before."""
    name, directory = finished
    moments = random.Random(name)
    for _ in range(3):
        before = rows_written(tmp_path / "run")
        process = subprocess.Popen(command(name, *short(name), "--run-dir", tmp_path / "run", "--resume"))
        while rows_written(tmp_path / "run") <= before:
            assert process.poll() is None
            time.sleep(0.01)
        time.sleep(moments.uniform(0, 0.4 if name in ON_POLICY else 0.1))
        process.kill()
        process.wait()
    assert rows_written(tmp_path / "run") < 11  # it was killed before it was complete
    done = run(name, *short(name), "--run-dir", tmp_path / "run", "--resume")
    assert done.returncode == 0, done.stderr
    assert evaluations(tmp_path / "run") == evaluations(directory)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signals to other processes")
@pytest.mark.parametrize(
    ("name", "number"), [("mappo", signal.SIGINT), ("mappo", signal.SIGTERM), ("iql", signal.SIGINT)]
)
def test_a_signal_stops_with_a_checkpoint(name, number, tmp_path):
    longer = [*short(name), "--total-timesteps", "100000000", "--eval-points", "2"]
    process = subprocess.Popen(command(name, *longer, "--run-dir", tmp_path / "run"), stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "run" / "checkpoint.pt").exists():
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(1)
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1 and "--resume goes on" in said
    assert script(name).read_checkpoint(tmp_path / "run")["progress"][2] > 0  # timesteps
    assert (tmp_path / "run" / "replay.bin").exists() == (name in OFF_POLICY)
    assert len(evaluations(tmp_path / "run")) == 1


def stop_after(monkeypatch, capsys, name, directory, batches):
    """Begins a short run, or goes on with it, and stops it as Ctrl-C does when so many batches have been collected."""
    module, advance, left = script(name), script(name).Run.advance, iter(range(batches - 1, -1, -1))

    def stop(self, steps, losses):
        advance(self, steps, losses)
        if next(left) == 0:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(module.Run, "advance", stop)
        code, _ = main(patch, capsys, name, *short(name), "--run-dir", directory, "--resume")
    assert "--resume goes on" in code


def test_stopped_anywhere_and_resumed_is_never_interrupted(finished, monkeypatch, capsys, tmp_path):
    """Checkpoints between two evaluations: before a replay holds a batch, and when it does."""
    name, directory = finished
    for batches in (3, 9):
        stop_after(monkeypatch, capsys, name, tmp_path / "run", batches)
    assert main(monkeypatch, capsys, name, *short(name), "--run-dir", tmp_path / "run", "--resume")[0] == 0
    assert evaluations(tmp_path / "run") == evaluations(directory)


def test_the_replay_keeps_what_the_checkpoint_before_refers_to(finished, monkeypatch, capsys, tmp_path):
    """The last checkpoint is damaged, and since then the replay has gone on; the one before finds all its episodes."""
    name, directory = finished
    if name in ON_POLICY:
        pytest.skip("no replay")
    stop_after(monkeypatch, capsys, name, tmp_path / "run", 95)  # the replay holds 40, and saves at every tenth
    (tmp_path / "run" / "checkpoint.pt").write_bytes(b"damaged")
    assert main(monkeypatch, capsys, name, *short(name), "--run-dir", tmp_path / "run", "--resume")[0] == 0
    assert not (tmp_path / "run" / "replay.bin").exists()
    assert evaluations(tmp_path / "run") == evaluations(directory)


def copy_of(directory, target):
    target.mkdir()
    for name in WRITTEN:
        (target / name).write_bytes((directory / name).read_bytes())
    return target


def test_a_damaged_checkpoint_gives_way_to_the_one_before(finished, monkeypatch, capsys, tmp_path):
    name, directory = finished
    damaged = copy_of(directory, tmp_path / "run")
    whole = (damaged / "checkpoint.pt").read_bytes()
    (damaged / "checkpoint.pt").write_bytes(whole[: len(whole) // 2])
    code, said = main(monkeypatch, capsys, name, *short(name), "--run-dir", damaged, "--resume")
    assert code == 0 and "checkpoint.pt is damaged" in said
    assert evaluations(damaged) == evaluations(directory)


def test_killed_while_a_checkpoint_takes_its_place(finished, monkeypatch, capsys, tmp_path):
    """Between the two renamings of a save that follows a damaged checkpoint only the new file is whole."""
    name, directory = finished
    copy = copy_of(directory, tmp_path / "run")
    (copy / "checkpoint.pt").rename(copy / "checkpoint.new.pt")
    (copy / "checkpoint.previous.pt").write_bytes(b"damaged")
    assert main(monkeypatch, capsys, name, *short(name), "--run-dir", copy, "--resume")[0] == 0
    assert evaluations(copy) == evaluations(directory)


def test_killed_in_the_first_checkpoint_starts_afresh(finished, monkeypatch, capsys, tmp_path):
    name, directory = finished
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "checkpoint.new.pt").write_bytes((directory / "checkpoint.pt").read_bytes()[:1000])
    assert main(monkeypatch, capsys, name, *short(name), "--run-dir", tmp_path / "run", "--resume")[0] == 0
    assert evaluations(tmp_path / "run") == evaluations(directory)


def test_nothing_but_damaged_checkpoints_is_refused(finished, monkeypatch, capsys, tmp_path):
    name, directory = finished
    damaged = copy_of(directory, tmp_path / "run")
    for file in ("checkpoint.pt", "checkpoint.previous.pt"):
        whole = (damaged / file).read_bytes()
        (damaged / file).write_bytes(whole[: len(whole) // 2])
    code, said = main(monkeypatch, capsys, name, *short(name), "--run-dir", damaged, "--resume")
    assert code == 2 and "no checkpoint of it that can be used" in said
    assert evaluations(damaged) == evaluations(directory)


def test_a_longer_run_continues_a_complete_one(finished, monkeypatch, capsys, tmp_path):
    """More timesteps on resume: what was there stays, and evaluations go on at the same distance."""
    name, directory = finished
    longer = copy_of(directory, tmp_path / "run")
    flags = [*short(name), "--total-timesteps", STEPS[name] * 12 // 10, "--run-dir", longer, "--resume"]
    code, said = main(monkeypatch, capsys, name, *flags)
    if name in OFF_POLICY:  # its replay is gone
        assert code == 2 and "a complete run deletes it" in said.strip().splitlines()[-1]
        for file in ("evaluations.csv", "config.json", "checkpoint.pt"):
            assert (longer / file).read_bytes() == (directory / file).read_bytes()
        return
    rows = evaluations(longer)
    assert code == 0 and rows[:11] == evaluations(directory)
    assert [int(row["timestep"]) // 2000 for row in rows] == list(range(13))


def test_a_complete_run_resumed_changes_nothing(finished, monkeypatch, capsys, tmp_path):
    name, directory = finished
    copy = copy_of(directory, tmp_path / "run")
    assert main(monkeypatch, capsys, name, *short(name), "--run-dir", copy, "--resume")[0] == 0
    for file in WRITTEN:  # config.json tells which commit completed it
        assert (copy / file).read_bytes() == (directory / file).read_bytes()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_ends_in_one_sentence(monkeypatch, capsys, tmp_path, name):
    (tmp_path / "checkpoint.new.pt").symlink_to("/dev/full")
    code, said = main(monkeypatch, capsys, name, *short(name), "--run-dir", tmp_path, "--resume")
    assert code == 2 and "No space left" in said.splitlines()[-1]


class TestWrongInput:
    def refused(self, monkeypatch, capsys, *flags, name="mappo"):
        code, said = main(monkeypatch, capsys, name, *flags)
        assert code == 2
        return said

    def one_sentence(self, said):
        assert len(said.strip().splitlines()) == 1
        return said

    def test_unknown_task_offers_the_nearest(self, monkeypatch, capsys):
        said = self.one_sentence(self.refused(monkeypatch, capsys, "--env", "lbf-15x15-3p-5"))
        assert "lbf-15x15-3p-5f" in said

    @pytest.mark.parametrize("env", ["lbf-2x2-9p-9f", "lbf-8x8-0p-2f", "matrix-penalty-x"])
    def test_impossible_sizes(self, monkeypatch, capsys, env):
        assert env in self.one_sentence(self.refused(monkeypatch, capsys, "--env", env))

    @pytest.mark.parametrize("flags", [["--network", "lstm"], ["--no-such-flag", "1"], ["--seed", "one"]])
    def test_what_the_flags_do_not_allow(self, monkeypatch, capsys, flags):
        assert flags[0] in self.refused(monkeypatch, capsys, "--env", "matrix-climbing", *flags)

    @pytest.mark.parametrize(
        "flag",
        [
            "total-timesteps",
            "num-envs",
            "n-step",
            "hidden-dim",
            "eval-points",
            "eval-episodes",
            "threads",
            "seed",
            "learning-rate",
            "gamma",
            "max-grad-norm",
            "entropy-coef",
            "clip-coef",
        ],
    )
    def test_negative_numbers(self, monkeypatch, capsys, flag):
        said = self.one_sentence(self.refused(monkeypatch, capsys, "--env", "matrix-climbing", f"--{flag}", "-1"))
        assert f"--{flag}" in said

    @pytest.mark.parametrize("flag", ["total-timesteps", "num-envs", "n-step", "hidden-dim", "threads"])
    def test_zero_where_it_makes_no_sense(self, monkeypatch, capsys, flag):
        assert f"--{flag}" in self.refused(monkeypatch, capsys, "--env", "matrix-climbing", f"--{flag}", "0")

    @pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a CUDA device")
    def test_no_cuda(self, monkeypatch, capsys):
        assert "CUDA" in self.one_sentence(self.refused(monkeypatch, capsys, "--device", "cuda"))

    def test_watching_nothing(self, monkeypatch, capsys, tmp_path):
        self.one_sentence(self.refused(monkeypatch, capsys, "--watch", tmp_path))

    def test_tracking_without_wandb(self, monkeypatch, capsys, tmp_path):
        monkeypatch.setitem(sys.modules, "wandb", None)
        said = self.refused(monkeypatch, capsys, *short("mappo"), "--track", "--run-dir", tmp_path / "run")
        assert "wandb" in self.one_sentence(said)

    def test_a_directory_that_holds_a_run(self, finished, monkeypatch, capsys):
        name, directory = finished
        before = {path.name: path.read_bytes() for path in directory.iterdir()}
        said = self.refused(monkeypatch, capsys, *short(name), "--run-dir", directory, name=name)
        assert "--resume" in self.one_sentence(said)
        assert {path.name: path.read_bytes() for path in directory.iterdir()} == before

    def test_a_directory_that_holds_something_else(self, monkeypatch, capsys, tmp_path):
        (tmp_path / "config.json").write_text("mine")
        self.one_sentence(self.refused(monkeypatch, capsys, *short("mappo"), "--run-dir", tmp_path))
        assert (tmp_path / "config.json").read_text() == "mine"

    def test_resume_where_there_is_no_run(self, monkeypatch, capsys, tmp_path):
        (tmp_path / "config.json").write_text("mine")
        self.one_sentence(self.refused(monkeypatch, capsys, *short("mappo"), "--run-dir", tmp_path, "--resume"))
        assert (tmp_path / "config.json").read_text() == "mine"

    @pytest.mark.parametrize("saved", [{"weights": torch.zeros(2)}, torch.zeros(2)])
    def test_watching_a_checkpoint_of_something_else(self, monkeypatch, capsys, tmp_path, saved):
        torch.save(saved, tmp_path / "checkpoint.pt")
        said = self.refused(monkeypatch, capsys, "--watch", tmp_path)
        assert "no checkpoint of mappo" in said.splitlines()[-1]

    @pytest.mark.parametrize("flag, value", [("seed", 2**64), ("hidden-dim", 2**63), ("learning-rate", "inf")])
    def test_numbers_without_measure(self, monkeypatch, capsys, flag, value):
        said = self.one_sentence(self.refused(monkeypatch, capsys, "--env", "matrix-climbing", f"--{flag}", value))
        assert f"--{flag}" in said

    def test_a_directory_that_is_a_file(self, monkeypatch, capsys, tmp_path):
        (tmp_path / "file").write_text("mine")
        self.one_sentence(self.refused(monkeypatch, capsys, *short("mappo"), "--run-dir", tmp_path / "file"))
        assert (tmp_path / "file").read_text() == "mine"

    def test_a_directory_in_use(self, finished, monkeypatch, capsys):
        name, directory = finished
        with script(name).filelock.FileLock(directory / "lock"):
            said = self.refused(monkeypatch, capsys, *short(name), "--run-dir", directory, "--resume", name=name)
        assert str(directory) in self.one_sentence(said)

    def test_resume_with_other_flags(self, finished, monkeypatch, capsys):
        name, directory = finished
        flags = [*short(name), "--gamma", "0.5", "--run-dir", directory, "--resume"]
        assert "--gamma 0.99" in self.one_sentence(self.refused(monkeypatch, capsys, *flags, name=name))

    def test_resume_with_fewer_timesteps(self, finished, monkeypatch, capsys):
        name, directory = finished
        flags = [*short(name), "--total-timesteps", "500", "--run-dir", directory, "--resume"]
        assert "--total-timesteps" in self.one_sentence(self.refused(monkeypatch, capsys, *flags, name=name))

    def test_resume_of_another_algorithm(self, finished, monkeypatch, capsys):
        name, directory = finished
        other = next(other for other in (ON_POLICY if name in ON_POLICY else OFF_POLICY) if other != name)
        flags = [*short(name), "--run-dir", directory, "--resume"]
        assert name in self.one_sentence(self.refused(monkeypatch, capsys, *flags, name=other))

    @pytest.mark.parametrize(("name", "reason"), [("coma", "joint"), ("vdn", "one value"), ("qmix", "one value")])
    def test_refused_individual_rewards(self, monkeypatch, capsys, tmp_path, name, reason):
        flags = [*short(name), "--individual-rewards", "--run-dir", tmp_path / "run"]
        assert reason in self.one_sentence(self.refused(monkeypatch, capsys, *flags, name=name))

    @pytest.mark.parametrize("flag", ["epsilon-anneal", "batch-size", "buffer-size"])
    def test_zero_in_a_replay_or_schedule(self, monkeypatch, capsys, flag):
        flags = ["--env", "matrix-climbing", f"--{flag}", "0"]
        assert f"--{flag}" in self.one_sentence(self.refused(monkeypatch, capsys, *flags, name="iql"))

    def test_a_replay_that_does_not_fit(self, monkeypatch, capsys, tmp_path):
        monkeypatch.setattr(envs.storage.psutil, "virtual_memory", lambda: SimpleNamespace(available=1000))
        said = self.refused(monkeypatch, capsys, *short("qmix"), "--run-dir", tmp_path / "run", name="qmix")
        assert "more than the free memory" in said.splitlines()[-1]
        assert not (tmp_path / "run" / "replay.bin").exists()

    def test_a_loss_that_is_no_number_stops_the_run(self, monkeypatch, capsys, tmp_path):
        flags = [*short("mappo"), "--learning-rate", "1e18", "--run-dir", tmp_path / "run"]
        code, _ = main(monkeypatch, capsys, "mappo", *flags)
        assert "loss is" in code and "step" in code


def test_default_directory_names_what_is_not_default(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    flags = ["--env", "matrix-penalty-25", "--total-timesteps", "500", "--eval-points", "2", "--eval-episodes", "2"]
    changed = ["--no-parameter-sharing", "--n-step", "3", "--individual-rewards"]
    assert main(monkeypatch, capsys, "mappo", *flags, *changed, "--seed", 7)[0] == 0
    expected = "runs/matrix-penalty-25/mappo-independent-n-step=3-individual-rewards=True/seed7"
    assert (tmp_path / expected / "evaluations.csv").exists()


def test_load_from_anywhere_and_watch(finished, monkeypatch, capsys, tmp_path):
    name, directory = finished
    program = f"""
        import sys
        sys.path.append({str(ROOT / "algos")!r})
        import envs, {name}
        team = {name}.load({str(directory)!r})
        env = envs.make("lbf-5x5-2p-1f", 4)
        observations, info = env.reset()
        print(team.act(observations, info).shape)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.stdout.strip() == "(4, 2)", done.stderr

    copy = copy_of(directory, tmp_path / "run")
    assert main(monkeypatch, capsys, name, "--watch", copy, "--eval-episodes", 3)[0] == 0
    from PIL import Image

    with Image.open(copy / "film.gif") as film:
        assert getattr(film, "n_frames", 1) > 3


def test_the_seed_says_which_episodes_are_watched(finished, monkeypatch, capsys):
    (name, directory), seen = finished, []
    monkeypatch.setattr(envs, "film", lambda env, team, path: seen.append((env.seed, team.rng.initial_seed())))
    assert main(monkeypatch, capsys, name, "--watch", directory, "--eval-episodes", 3, "--seed", 5)[0] == 0
    assert seen == [(5, 5)]


def test_the_loaded_team_plays_like_the_last_evaluation(finished):
    """Same networks, environment and seeds: the loaded team's return is the last row of evaluations.csv."""
    name, directory = finished
    module, last = script(name), evaluations(directory)[-1]
    seed = int(np.random.SeedSequence([0, int(last["point"])]).generate_state(1)[0])
    torch.set_num_threads(1)
    results = module.evaluate(envs.make("lbf-5x5-2p-1f", 20), module.load(directory, seed), seed)
    assert {key: str(value) for key, value in results.items()} == {key: last[key] for key in results}


def test_scripts_run_from_any_folder(tmp_path):
    flags = ["--env", "matrix-climbing", "--total-timesteps", "300", "--eval-points", "2", "--eval-episodes", "2"]
    done = run("mappo", *flags, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs/matrix-climbing/mappo-shared/seed0/evaluations.csv").exists()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [0, 1])
def test_learns_the_penalty_game(name, seed, tmp_path, monkeypatch, capsys):
    """k = 0: every equilibrium that pays 10 a step is found, 250 an episode; random play earns 61."""
    steps = 150_000 if name in ON_POLICY else 10_000
    flags = ["--env", "matrix-penalty-0", "--seed", seed, "--total-timesteps", steps, "--eval-points", "2"]
    assert main(monkeypatch, capsys, name, *flags, "--run-dir", tmp_path / "run")[0] == 0
    rows = evaluations(tmp_path / "run")
    assert float(rows[0]["return_mean"]) < 150 and float(rows[1]["return_mean"]) > 240


class Opponents(matrix.Env):
    """The row pays the column's loss: with its own rewards in view, row 1 plays against column 1, for 2 a step."""

    PAYOFF = np.array([[3, 1, 4], [5, 2, 6], [1, 0, 7]], np.float32)  # as a team they would play 7, or 0

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self._step_arrays = (*self._step_arrays[:-1], self.PAYOFF)

    def step_envs(self, actions):
        refused = super().step_envs(actions)  # the team's reward remains the row's
        self.agent_rewards[:, 1] *= -1
        return refused


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("coma", "qmix", "vdn")])
def test_opponents_learn_from_their_own_rewards(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(matrix, "Env", Opponents)
    steps = 100_000 if name in ON_POLICY else 10_000
    flags = ["--env", "matrix-climbing", "--seed", 1, "--total-timesteps", steps, "--eval-points", "2"]
    flags += ["--individual-rewards", "--no-parameter-sharing", "--run-dir", tmp_path / "run"]
    assert main(monkeypatch, capsys, name, *flags)[0] == 0
    rows = evaluations(tmp_path / "run")
    assert float(rows[0]["return_mean"]) > 70
    assert float(rows[1]["return_mean"]) == pytest.approx(50, abs=3)
