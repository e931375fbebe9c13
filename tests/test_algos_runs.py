"""Whole runs of the scripts: determinism, resuming, wrong input, learning, what a run leaves behind.

The text of the run is the same in all nine scripts, so what only it decides is tested with few of them.
"""

import csv
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import programs
import pytest
import torch
from kills import note_order
from scripts import INDIVIDUAL, NAMES, NINE, OFF_POLICY, ON_POLICY, ROOT, envs, nine, parse, script, trained
from scripts import main as script_main
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from envs import runs
from envs.families import lbf, matrix
from envs.runs import fast_mkl
from envs.runs.origin import project_version

SHORT = ["--env", "lbf-5x5-2p-1f", "--eval-points", "11", "--eval-episodes", "20", "--hidden-dim", "32"]
SHORT += ["--reward-standardisation", "--network", "gru"]
STEPS = {name: 5000 if name in ON_POLICY else 3000 for name in NAMES}
WRITTEN = ["checkpoint.previous.pt", "checkpoint.pt", "config.json", "evaluations.csv"]
SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


def short(name):
    """The flags of a short run with 11 evaluations; a replay is full several times."""
    replay = ["--buffer-size", "40", "--batch-size", "8"] if name in OFF_POLICY else []
    return [*SHORT, "--total-timesteps", STEPS[name], *replay]


def command(name, *flags):
    return [sys.executable, str(ROOT / "algos" / f"{name}.py"), *map(str, flags)]


def run(name, *flags):
    """A script in a process of its own."""
    return programs.run(command(name, *flags))


def evaluations(directory):
    """The rows of evaluations.csv without the two columns of seconds."""
    with open(directory / "evaluations.csv") as file:
        rows = list(csv.DictReader(file))
    return [{key: value for key, value in row.items() if not key.endswith("seconds")} for row in rows]


def main(monkeypatch, capsys, name, *flags):
    """A script's main in this process: its exit code, and what it says on stderr."""
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, flags)])
    numbers = [getattr(signal, signal_name) for signal_name in SIGNALS if hasattr(signal, signal_name)]
    handlers = {number: signal.getsignal(number) for number in numbers}
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)  # tests in the background may ignore some of them
    code: object = 0
    try:
        script_main(name)
    except SystemExit as end:
        code = end.code
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return code, capsys.readouterr().err


@pytest.fixture(scope="module", params=NAMES)
def finished(request, made_once):
    """A short run of each script, never interrupted: its name and directory, which no test may change.

    Two are processes of their own, one of them with an interpreter of its own.
    """
    name = request.param

    def train(directory):
        flags = [*short(name), "--run-dir", directory]
        if name in ("mappo", "qmix"):
            alone: Any = {"capture_output": True, "text": True}
            done = run(name, *flags) if name == "qmix" else subprocess.run(command(name, *flags), **alone)
            assert done.returncode == 0, done.stderr
            assert done.stderr.count("return_mean") == 11  # a line for each evaluation where there is no terminal
        else:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(signal, "signal", lambda number, handler: None)
                script(name).train(parse(name, flags))

    return name, made_once(f"{name}-run", train)


@pytest.fixture(scope="module")
def mappo_run(tmp_path_factory):
    """A short run of MAPPO's for tests that only look at the common text."""
    directory = tmp_path_factory.mktemp("mappo") / "run"
    flags = [*short("mappo"), "--total-timesteps", 2000, "--eval-points", 3]
    assert run("mappo", *flags, "--run-dir", directory).returncode == 0
    return [*flags, "--run-dir"], directory


def copy_of(directory, target):
    """A copy of a run that a test may change."""
    return Path(shutil.copytree(directory, target, ignore=shutil.ignore_patterns("lock")))


# --- what a run leaves ---
@pytest.mark.slow
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


@pytest.mark.slow
def test_config_says_what_was_run(finished):
    name, directory = finished
    config = json.loads((directory / "config.json").read_text())
    assert config["algorithm"] == name and config["flags"]["env"] == "lbf-5x5-2p-1f"
    assert config["versions"]["torch"] == torch.__version__ and config["version"] == project_version()
    assert config["paper_timesteps"] == (20_000_000 if name in ON_POLICY else 2_000_000)
    changed = {"total_timesteps": STEPS[name], "hidden_dim": 32, "eval_points": 11}
    assert changed.items() <= config["changed"].items()
    assert not {"env", "seed", "run_dir", "gamma"} & config["changed"].keys()
    assert config["fast_mkl"] == fast_mkl.LOADED
    others = {"command", "python", "versions", "version", "script", "commit", "machine", "fast_mkl"}
    assert set(config) == {"algorithm", "flags", "changed", "paper_timesteps", *others}


def test_a_changed_copy_of_a_script_is_told_apart(monkeypatch, capsys, tmp_path):
    args = parse("mappo", [])
    (tmp_path / "mappo.py").write_text((ROOT / "algos" / "mappo.py").read_text() + "# changed\n")
    original, changed = (
        runs.describe(path, args, args)["script"] for path in (ROOT / "algos" / "mappo.py", tmp_path / "mappo.py")
    )
    assert original != changed


@pytest.mark.slow
def test_tensorboard_has_what_practitioners_look_for(finished):
    name, directory = finished
    events = EventAccumulator(str(directory))
    events.Reload()
    expected = {"training/return_mean", "training/episode_length", "training/steps_per_second"}
    expected |= {"evaluation/return_mean", "evaluation/return_std", "evaluation/episode_length"}
    if name in nine(ON_POLICY):
        expected |= {"loss/critic", "loss/actor", "policy/entropy", "value/explained_variance"}
        expected |= {"gradient/critic_norm", "gradient/actor_norm"}
    if name in ("ippo", "mappo"):
        expected |= {"policy/approximate_kl", "policy/clip_fraction"}
    if name in nine(OFF_POLICY):
        expected |= {"value/mean", "value/target_mean"}
    if name == "maddpg":
        expected |= {"loss/critic", "loss/actor", "policy/entropy", "gradient/critic_norm", "gradient/actor_norm"}
    elif name in nine(OFF_POLICY):
        expected |= {"loss/value", "policy/epsilon", "gradient/norm"}
    shown = set(events.Tags()["scalars"])
    assert expected == (shown if name in NINE else shown & expected)
    for tag in expected:
        points = events.Scalars(tag)
        assert all(np.isfinite(point.value) for point in points if tag != "value/explained_variance")
        assert points[-1].step <= STEPS[name] + 500 and len(points) > 5
    last = float(evaluations(directory)[-1]["return_mean"])
    assert events.Scalars("evaluation/return_mean")[-1].value == pytest.approx(last)


# --- other seeds, and the same run after interruptions ---
def rows_written(directory):
    """How many evaluations a run has on disk; 0 where there is no table yet."""
    path = directory / "evaluations.csv"
    return len(path.read_text().splitlines()) - 1 if path.exists() else 0


with_and_without_replay = pytest.mark.parametrize("finished", ["mappo", "qmix"], indirect=True)


@with_and_without_replay
@pytest.mark.slow
def test_killed_and_resumed_is_never_interrupted(finished, tmp_path):
    """kill -9 at a random moment of the training, after the second evaluation."""
    name, directory = finished
    process = programs.start(command(name, *short(name), "--run-dir", tmp_path / "run"))
    while rows_written(tmp_path / "run") < 2:
        assert process.poll() is None
        time.sleep(0.01)
    time.sleep(random.Random(name).uniform(0, 0.2 if name in ON_POLICY else 0.1))
    process.kill()
    process.wait()
    assert rows_written(tmp_path / "run") < 11  # it was killed before it was complete
    done = run(name, *short(name), "--run-dir", tmp_path / "run", "--resume")
    assert done.returncode == 0, done.stderr
    assert evaluations(tmp_path / "run") == evaluations(directory)


def stop_after(monkeypatch, capsys, name, directory, batches, number=signal.SIGINT, flags=None):
    """Begins a short run, or goes on with it, and stops it by a signal when so many batches have been collected."""
    log, left = runs.Log.batch, iter(range(batches - 1, -1, -1))

    def stop(self, *args):
        log(self, *args)
        if next(left) == 0:
            signal.raise_signal(number)

    with monkeypatch.context() as patch:
        patch.setattr(runs.Log, "batch", stop)
        code, said = main(patch, capsys, name, *(flags or short(name)), "--run-dir", directory, "--resume")
    assert "--resume goes on" in said
    return code


@pytest.mark.parametrize("signal_name, code", [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_a_signal_stops_with_a_checkpoint(signal_name, code, monkeypatch, capsys, tmp_path):
    if not hasattr(signal, signal_name):
        pytest.skip(f"this system has no {signal_name}")
    number = getattr(signal, signal_name)
    assert stop_after(monkeypatch, capsys, "mappo", tmp_path / "run", 3, number) == code
    assert runs.read_checkpoint(tmp_path / "run", "mappo")["updates"] == 3


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signals to other processes")
@pytest.mark.slow
def test_ctrl_c_in_a_process_of_its_own(tmp_path):
    longer = [*short("iql"), "--total-timesteps", "100000000", "--eval-points", "2"]
    process = programs.start(command("iql", *longer, "--run-dir", tmp_path / "run"))
    while not (tmp_path / "run" / "checkpoint.pt").exists():
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and "--resume goes on" in said
    assert runs.read_checkpoint(tmp_path / "run", "iql")["timestep"] > 0
    assert (tmp_path / "run" / "replay.bin").exists()
    assert len(evaluations(tmp_path / "run")) == 1


@pytest.mark.slow
def test_stopped_anywhere_and_resumed_is_never_interrupted(finished, monkeypatch, capsys, tmp_path):
    """Checkpoints between two evaluations: before a replay holds a batch, and when it does."""
    name, directory = finished
    for batches in (3, 9):
        stop_after(monkeypatch, capsys, name, tmp_path / "run", batches)
    assert main(monkeypatch, capsys, name, *short(name), "--run-dir", tmp_path / "run", "--resume")[0] == 0
    assert evaluations(tmp_path / "run") == evaluations(directory)


@with_and_without_replay
@pytest.mark.slow
def test_a_killed_run_goes_on_from_minutes_ago(finished, monkeypatch, capsys, tmp_path):
    """Evaluations may be hours apart, so a run is also saved when the last checkpoint is old; here: always."""
    name, directory = finished
    log, left = runs.Log.batch, iter(range(8, -1, -1))

    def end(self, *args):
        log(self, *args)
        if next(left) == 0:
            raise KeyError("killed in the ninth batch")

    with monkeypatch.context() as patch, pytest.raises(KeyError):
        patch.setattr(runs.directory, "SAVE_SECONDS", 0)
        patch.setattr(runs.Log, "batch", end)
        main(patch, capsys, name, *short(name), "--run-dir", tmp_path / "run")
    assert runs.read_checkpoint(tmp_path / "run", name)["episode"] == 8
    assert main(monkeypatch, capsys, name, *short(name), "--run-dir", tmp_path / "run", "--resume")[0] == 0
    assert evaluations(tmp_path / "run") == evaluations(directory)


def test_updates_are_counted_on_after_a_resume(monkeypatch, capsys, tmp_path):
    """By their number the targets are copied."""
    for updates in (3, 6):
        stop_after(monkeypatch, capsys, "mappo", tmp_path / "run", 3)
        assert runs.read_checkpoint(tmp_path / "run", "mappo")["updates"] == updates


def test_a_batch_beyond_the_end_adds_no_evaluations(monkeypatch, capsys, tmp_path):
    """The last batch of ten episodes goes several evaluation points further."""
    flags = [*short("mappo"), "--total-timesteps", 100, "--run-dir", tmp_path / "run"]
    assert main(monkeypatch, capsys, "mappo", *flags)[0] == 0
    rows = evaluations(tmp_path / "run")
    assert len(rows) == 11 and int(rows[-1]["timestep"]) > 130


@pytest.mark.slow
def test_the_replay_keeps_what_the_checkpoint_before_refers_to(monkeypatch, capsys, tmp_path):
    """The last checkpoint is damaged, and since then the replay has gone on; the one before finds all its episodes."""
    assert main(monkeypatch, capsys, "vdn", *short("vdn"), "--run-dir", tmp_path / "whole")[0] == 0
    stop_after(monkeypatch, capsys, "vdn", tmp_path / "run", 75)  # the replay holds 40, and saves at every tenth
    (tmp_path / "run" / "checkpoint.pt").write_bytes(b"damaged")
    code, said = main(monkeypatch, capsys, "vdn", *short("vdn"), "--run-dir", tmp_path / "run", "--resume")
    assert code == 0 and "checkpoint.pt is damaged; checkpoint.previous.pt takes its place." in said
    assert not (tmp_path / "run" / "replay.bin").exists()
    assert evaluations(tmp_path / "run") == evaluations(tmp_path / "whole")


@pytest.mark.slow
def test_a_longer_run_continues_a_complete_one(mappo_run, monkeypatch, capsys, tmp_path):
    """More timesteps on resume: what was there stays, and evaluations go on at the same distance."""
    flags, directory = mappo_run
    longer = copy_of(directory, tmp_path / "run")
    code, _ = main(monkeypatch, capsys, "mappo", *flags, longer, "--resume", "--total-timesteps", 3000)
    rows = evaluations(longer)
    assert code == 0 and rows[:3] == evaluations(directory)
    assert [int(row["timestep"]) // 1000 for row in rows] == list(range(4))


def test_a_longer_run_ends_with_an_evaluation(mappo_run, monkeypatch, capsys, tmp_path):
    """At 1,000 steps' distance there would be none at 2,600, and the run would never count as complete."""
    flags, directory = mappo_run
    longer = copy_of(directory, tmp_path / "run")
    code, said = main(monkeypatch, capsys, "mappo", *flags, longer, "--resume", "--total-timesteps", 2600)
    assert code == 2 and "--total-timesteps 2000 or 3000 fits" in said
    assert evaluations(longer) == evaluations(directory)


def test_a_checkpoint_with_a_hole_is_not_taken(mappo_run, tmp_path):
    """As a power cut may leave it: PyTorch would load the zeros as weights."""
    directory = copy_of(mappo_run[1], tmp_path / "run")
    rows = [len(torch.load(directory / name)["rows"]) for name in ("checkpoint.previous.pt", "checkpoint.pt")]
    last = directory / "checkpoint.pt"
    content = bytearray(last.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 64] = bytes(64)
    last.write_bytes(content)
    assert torch.load(last)["rows"]
    assert len(runs.read_checkpoint(directory, "mappo")["rows"]) == rows[0] < rows[1]


def test_a_complete_run_of_a_replay_cannot_grow(monkeypatch, capsys, tmp_path):
    flags = [*short("iql"), "--total-timesteps", 500, "--eval-points", 2, "--run-dir", tmp_path / "run"]
    assert main(monkeypatch, capsys, "iql", *flags)[0] == 0
    before = {path: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    code, said = main(monkeypatch, capsys, "iql", *flags, "--resume", "--total-timesteps", 1000)
    assert code == 2 and "a complete run deletes it" in said.strip().splitlines()[-1]
    assert {path: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before  # nothing else, either


@pytest.mark.slow
def test_a_complete_run_resumed_changes_nothing(finished, monkeypatch, capsys, tmp_path):
    name, directory = finished
    copy = copy_of(directory, tmp_path / "run")
    monkeypatch.chdir(ROOT)
    code, said = main(monkeypatch, capsys, name, *short(name), "--run-dir", copy, "--resume")
    assert code == 0
    play = f"python {Path('algos', name)}.py --watch {copy}"
    assert said.splitlines()[-1] == f"{copy} is complete; this plays what was learnt: {play}"
    for file in WRITTEN:  # config.json tells which commit completed it
        assert (copy / file).read_bytes() == (directory / file).read_bytes()
    assert not (copy / "progress.json").exists()


def test_tables_of_a_complete_run_are_made_again(mappo_run, monkeypatch, capsys, tmp_path):
    """A run that was killed after its last checkpoint, before its tables: one is cut off, the other missing."""
    flags, directory = mappo_run
    copy = copy_of(directory, tmp_path / "run")
    table = (copy / "evaluations.csv").read_text()
    (copy / "evaluations.csv").write_text(table[: len(table) // 2])
    (copy / "config.json").unlink()
    assert main(monkeypatch, capsys, "mappo", *flags, copy, "--resume")[0] == 0
    for file in ("evaluations.csv", "config.json"):
        assert (copy / file).read_text() == (directory / file).read_text()


def test_progress_for_whoever_watches(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(runs.log, "PROGRESS_SECONDS", 0)
    stop_after(monkeypatch, capsys, "mappo", tmp_path / "run", 4)
    progress = json.loads((tmp_path / "run" / "progress.json").read_text())
    assert progress["timestep"] == runs.read_checkpoint(tmp_path / "run", "mappo")["timestep"]
    assert progress["total_timesteps"] == STEPS["mappo"] and progress["steps_per_second"] > 0
    assert 0 <= progress["training_return"] <= 1 and 0 <= progress["evaluation_return"] <= 1


def test_each_evaluation_has_a_seed_of_its_own(monkeypatch, capsys, tmp_path):
    """Of its episodes and of the team's draws; derived from the run's seed and the number of the point alone."""
    seeds = []

    def evaluate(env, team, seed):
        assert team.rng.initial_seed() == seed
        seeds.append(seed)
        return {"return_mean": 0.0, "return_std": 0.0, "episode_length": 1.0}

    monkeypatch.setattr(runs.run, "evaluate", evaluate)
    flags = ["--env", "matrix-climbing", "--total-timesteps", 1000, "--eval-points", 5]
    assert main(monkeypatch, capsys, "mappo", *flags, "--seed", 3, "--run-dir", tmp_path / "run")[0] == 0
    assert seeds == [np.random.SeedSequence([3, point]).generate_state(1)[0] for point in range(5)]


def test_the_disk_has_the_replay_before_a_checkpoint_that_refers_to_it(monkeypatch, capsys, tmp_path):
    order = note_order(monkeypatch)
    flags = ["--env", "matrix-climbing", "--total-timesteps", 100, "--eval-points", 2, "--eval-episodes", 2]
    assert main(monkeypatch, capsys, "iql", *flags, "--run-dir", tmp_path / "run")[0] == 0
    saves = [step for step in order if step in ("flush replay", "sync checkpoint.new.pt")]
    assert len(saves) >= 3 and saves[-2:] == ["flush replay", "sync checkpoint.new.pt"]


# --- wrong input and a hostile machine ---
@pytest.mark.parametrize("name", ["mappo", "iql"])
def test_a_full_disk_ends_in_one_sentence(monkeypatch, capsys, tmp_path, name):
    synced = os.fsync

    def full_disk(file):
        if os.fstat(file).st_size > 1000:  # a checkpoint
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        synced(file)

    monkeypatch.setattr(os, "fsync", full_disk)
    code, said = main(monkeypatch, capsys, name, *short(name), "--run-dir", tmp_path)
    assert code == 2 and said.splitlines()[-1].endswith(f"No space left on device: '{tmp_path / 'checkpoint.new.pt'}'")


@pytest.mark.skipif(sys.platform == "win32", reason="needs resource limits")
@pytest.mark.slow
def test_a_disk_that_fills_while_tensorboard_writes(tmp_path):
    """Its thread meets the error first; only the main thread says so. The checkpoints are small enough."""
    import resource

    def little_room():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))

    flags = ["--env", "matrix-climbing", "--hidden-dim", "8", "--total-timesteps", "50000", "--eval-points", "2"]
    words = command("ia2c", *flags, "--run-dir", tmp_path / "run")
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, preexec_fn=little_room)
    assert done.returncode == 0 and "Traceback" not in done.stderr and len(evaluations(tmp_path / "run")) == 2
    said = f"{tmp_path / 'run'}: TensorBoard's file cannot be written (File too large); the run goes on without it."
    assert done.stderr.splitlines().count(said) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
@pytest.mark.slow
def test_closed_streams_in_any_folder(tmp_path):
    flags = ["--env", "matrix-climbing", "--total-timesteps", "500", "--eval-points", "2", "--eval-episodes", "2"]
    line = " ".join(command("mappo", *flags))
    assert subprocess.run(f"{line} >&- 2>&-", shell=True, cwd=tmp_path).returncode == 0
    assert len(evaluations(tmp_path / "runs/matrix-climbing/mappo-shared/seed0")) == 2


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
@pytest.mark.slow
def test_a_reader_that_leaves(tmp_path):
    """Help for `head`, and a run behind `tee`, which Ctrl-C ends too."""
    flags = ["--env", "matrix-climbing", "--total-timesteps", "500", "--eval-points", "2", "--eval-episodes", "2"]
    for line in (command("mappo", "--help"), command("mappo", *flags, "--run-dir", tmp_path / "run")):
        shell = f"{' '.join(line)} 2>&1 | true; exit ${{PIPESTATUS[0]}}"
        assert subprocess.run(["bash", "-c", shell]).returncode == 0
    assert len(evaluations(tmp_path / "run")) == 2


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

    @pytest.mark.parametrize("flags", [["--network", "lstm"], ["--no-such-flag", "1"], ["--seed", "one"]])
    def test_what_the_flags_do_not_allow(self, monkeypatch, capsys, flags):
        assert flags[0] in self.refused(monkeypatch, capsys, "--env", "matrix-climbing", *flags)

    @pytest.mark.parametrize("flag, value", [("gamma", "1.5"), ("clip-coef", "1"), ("threads", "100000")])
    def test_a_number_out_of_range(self, monkeypatch, capsys, flag, value):
        said = self.one_sentence(self.refused(monkeypatch, capsys, "--env", "matrix-climbing", f"--{flag}", value))
        assert f"--{flag} {value}" in said.replace(".0:", ":")

    def test_an_option_of_the_environment_is_named_as_a_flag(self, monkeypatch, capsys):
        said = self.one_sentence(self.refused(monkeypatch, capsys, "--env", "lbf-5x5-2p-1f", "--env-workers", "2"))
        assert "--env-workers is for environments of PettingZoo" in said

    @pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a CUDA device")
    def test_no_cuda(self, monkeypatch, capsys):
        assert "CUDA" in self.one_sentence(self.refused(monkeypatch, capsys, "--device", "cuda"))

    @pytest.mark.parametrize("flags", [["--watch", "."], ["--watch", ""], ["--watch="]])
    def test_watching_nothing(self, monkeypatch, capsys, tmp_path, flags):
        monkeypatch.chdir(tmp_path)
        self.one_sentence(self.refused(monkeypatch, capsys, *flags))
        assert not list(tmp_path.iterdir())

    def test_tracking_without_wandb(self, monkeypatch, capsys, tmp_path):
        monkeypatch.setitem(sys.modules, "wandb", None)
        said = self.refused(monkeypatch, capsys, *short("mappo"), "--track", "--run-dir", tmp_path / "run")
        assert "wandb" in self.one_sentence(said)
        assert [path.name for path in (tmp_path / "run").iterdir()] == ["lock"]  # it can be begun without --track

    @pytest.mark.slow
    def test_a_directory_that_holds_a_run(self, finished, monkeypatch, capsys):
        name, directory = finished
        before = {path.name: path.read_bytes() for path in directory.iterdir()}
        said = self.refused(monkeypatch, capsys, *short(name), "--run-dir", directory, name=name)
        assert "--resume" in self.one_sentence(said)
        assert {path.name: path.read_bytes() for path in directory.iterdir()} == before

    @pytest.mark.parametrize("resume", [[], ["--resume"]])
    @pytest.mark.parametrize("file", ["config.json", "thesis.tex", "lock.txt"])
    def test_a_directory_that_holds_something_else(self, monkeypatch, capsys, tmp_path, file, resume):
        """It is named, and nothing is left there."""
        (tmp_path / file).write_text("mine")
        said = self.refused(monkeypatch, capsys, *short("mappo"), "--run-dir", tmp_path, *resume)
        assert file in self.one_sentence(said)
        assert [path.name for path in tmp_path.iterdir()] == [file] and (tmp_path / file).read_text() == "mine"

    @pytest.mark.parametrize("saved", [{"weights": torch.zeros(2)}, torch.zeros(2), {"config": {}, "rows": []}])
    def test_a_checkpoint_of_something_else(self, monkeypatch, capsys, tmp_path, saved):
        """It can be neither watched nor resumed, and it stays as it is."""
        torch.save(saved, tmp_path / "checkpoint.pt")
        before = (tmp_path / "checkpoint.pt").read_bytes()
        for flags in (["--watch", tmp_path], [*short("mappo"), "--run-dir", tmp_path, "--resume"]):
            said = self.one_sentence(self.refused(monkeypatch, capsys, *flags))
            assert "checkpoint.pt" in said
        assert (tmp_path / "checkpoint.pt").read_bytes() == before

    @pytest.mark.parametrize("lost", ["parts", "network", "timestep"])
    def test_a_checkpoint_that_lacks_something(self, mappo_run, monkeypatch, capsys, tmp_path, lost):
        flags, directory = mappo_run
        copy = copy_of(directory, tmp_path / "run")
        saved = torch.load(copy / "checkpoint.pt", weights_only=True)
        del saved[lost]
        torch.save(saved, copy / "checkpoint.pt")
        (copy / "checkpoint.previous.pt").unlink()  # it would take the place
        said = self.one_sentence(self.refused(monkeypatch, capsys, *flags, copy, "--resume"))
        assert ("does not say where its run goes on" if lost == "timestep" else "no checkpoint of ours") in said
        if lost != "timestep":
            assert "no checkpoint of ours" in self.one_sentence(self.refused(monkeypatch, capsys, "--watch", copy))

    def test_all_checkpoints_damaged(self, mappo_run, monkeypatch, capsys, tmp_path):
        """A run is never begun anew over them, also where its table is gone."""
        flags, directory = mappo_run
        copy = copy_of(directory, tmp_path / "run")
        (copy / "evaluations.csv").unlink()
        for file in ("checkpoint.pt", "checkpoint.previous.pt"):
            (copy / file).write_bytes(b"damaged")
        said = self.one_sentence(self.refused(monkeypatch, capsys, *flags, copy, "--resume"))
        assert "checkpoint.pt, checkpoint.previous.pt" in said
        assert (copy / "checkpoint.pt").read_bytes() == b"damaged"

    def test_a_directory_that_is_a_file(self, monkeypatch, capsys, tmp_path):
        (tmp_path / "file").write_text("mine")
        self.one_sentence(self.refused(monkeypatch, capsys, *short("mappo"), "--run-dir", tmp_path / "file"))
        assert (tmp_path / "file").read_text() == "mine"

    def test_a_name_that_the_file_system_cannot_write(self, monkeypatch, capsys, tmp_path):
        for name in ("\ud800", "a\0b"):
            flags = [*short("mappo"), "--run-dir", tmp_path / name]
            assert "No directory can have the name" in self.one_sentence(self.refused(monkeypatch, capsys, *flags))

    @pytest.mark.slow
    def test_a_name_in_a_terminal_without_unicode(self, tmp_path):
        flags = [*short("mappo"), "--total-timesteps", 500, "--eval-points", 2, "--run-dir", tmp_path / "ü"]
        terminal = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
        words: dict[str, Any] = {"args": command("mappo", *flags), "capture_output": True, "text": True}
        done = subprocess.run(**words, env=terminal)
        assert done.returncode == 2 and "PYTHONUTF8=1 changes that." in self.one_sentence(done.stderr)
        assert not any(tmp_path.iterdir())
        assert subprocess.run(**words, env=terminal | {"PYTHONUTF8": "1"}).returncode == 0

    @pytest.mark.slow
    def test_a_directory_in_use(self, mappo_run, monkeypatch, capsys):
        flags, directory = mappo_run
        with runs.directory.filelock.FileLock(directory / "lock"):
            said = self.refused(monkeypatch, capsys, *flags, directory, "--resume")
        assert "Another run is using" in self.one_sentence(said)

    @pytest.mark.parametrize(
        "change", [["--gamma", "0.5"], ["--seed", "1"], ["--no-parameter-sharing"], ["--individual-rewards"]]
    )
    def test_resume_with_other_flags(self, mappo_run, monkeypatch, capsys, change):
        """The flags that are named are real ones."""
        flags, directory = mappo_run
        said = self.one_sentence(self.refused(monkeypatch, capsys, *flags, directory, "--resume", *change))
        named = {"--gamma": "--gamma 0.99", "--seed": "--seed 0", "--no-parameter-sharing": "--parameter-sharing"}
        assert f"begun with {named.get(change[0], '--no-individual-rewards')}" in said

    def test_resume_with_fewer_timesteps(self, mappo_run, monkeypatch, capsys):
        flags, directory = mappo_run
        said = self.refused(monkeypatch, capsys, *flags, directory, "--total-timesteps", "500", "--resume")
        assert "--total-timesteps 2000" in self.one_sentence(said)

    def test_resume_of_another_algorithm(self, mappo_run, monkeypatch, capsys):
        flags, directory = mappo_run
        said = self.refused(monkeypatch, capsys, *flags, directory, "--resume", name="maa2c")
        assert "holds a run of mappo.py" in self.one_sentence(said)

    def test_a_replay_that_does_not_fit(self, monkeypatch, capsys, tmp_path):
        monkeypatch.setattr(runs.replay.psutil, "virtual_memory", lambda: SimpleNamespace(available=1000))
        said = self.refused(monkeypatch, capsys, *short("qmix"), "--run-dir", tmp_path / "run", name="qmix")
        assert "more than the free memory" in said.splitlines()[-1]
        assert not (tmp_path / "run" / "replay.bin").exists()

    @pytest.mark.parametrize("damage", ["gone", "shortened", "overwritten"])
    def test_a_damaged_replay(self, monkeypatch, capsys, tmp_path, damage):
        stop_after(monkeypatch, capsys, "iql", tmp_path / "run", 20)
        path = tmp_path / "run" / "replay.bin"
        content = path.read_bytes()
        if damage == "gone":
            path.unlink()
        else:
            path.write_bytes(content[:-100] if damage == "shortened" else b"\7" * len(content))
        flags = [*short("iql"), "--run-dir", tmp_path / "run", "--resume"]
        said = self.refused(monkeypatch, capsys, *flags, name="iql").strip().splitlines()[-1]
        assert str(path) in said and ("gone" if damage == "gone" else "damaged") in said

    def test_a_loss_that_is_no_number_stops_the_run(self, monkeypatch, capsys, tmp_path):
        flags = [*short("mappo"), "--learning-rate", "1e18", "--run-dir", tmp_path / "run"]
        code, said = main(monkeypatch, capsys, "mappo", *flags)
        assert code == 1 and said.splitlines()[-1].startswith("mappo: loss/") and "at step" in said.splitlines()[-1]


# --- using what was trained ---
def test_a_third_way_of_standardising_is_told_when_a_run_goes_on(mappo_run, monkeypatch, capsys, tmp_path):
    """It is no more; such a team still plays."""
    flags, directory = mappo_run
    copy = copy_of(directory, tmp_path / "run")
    saved = torch.load(copy / "checkpoint.pt", weights_only=True)
    saved["config"]["flags"]["reward_standardisation"] = "running"
    torch.save(saved, copy / "checkpoint.pt")
    assert script("mappo").load(copy).args.env == "lbf-5x5-2p-1f"
    code, said = main(monkeypatch, capsys, "mappo", *flags, copy, "--resume")
    assert code == 2 and "was begun with --reward-standardisation running, and this cannot change." in said


# --- first weights from another run ---
def networks_of(directory, name):
    """The weights of a checkpoint's networks, by part."""
    parts = runs.read_checkpoint(directory, name)["parts"]
    return {part: weights for part, weights in parts.items() if not part.endswith("optimiser")}


@pytest.mark.parametrize("name", ["mappo", "qmix"])
def test_first_weights_from_another_run(monkeypatch, capsys, tmp_path, name):
    """All networks have them, targets begin as copies; config.json says which run it was, and no path."""
    few = [*short(name), "--total-timesteps", 300, "--eval-points", 2, "--eval-episodes", 2]
    assert main(monkeypatch, capsys, name, *few, "--run-dir", tmp_path / "first")[0] == 0
    learnt = networks_of(tmp_path / "first", name)
    begun = trained(monkeypatch, name, 0, hidden_dim=32, network="gru").parts  # other weights
    runs.run.start_from(str(tmp_path / "first"), name, begun)
    for part, weights in learnt.items():
        source = learnt[part.removeprefix("target_")]
        for key in weights:
            assert torch.equal(begun[part].state_dict()[key], source[key])
    monkeypatch.undo()
    start = ["--start-from", tmp_path / "first", "--seed", 4]
    assert main(monkeypatch, capsys, name, *few, *start, "--run-dir", tmp_path / "second")[0] == 0
    config = json.loads((tmp_path / "second" / "config.json").read_text())
    hash_of_script = runs.script_hash(ROOT / "algos" / f"{name}.py")
    origin = f"lbf-5x5-2p-1f {name}-shared seed 0 script {hash_of_script}"
    assert config["flags"]["start_from"] == config["changed"]["start_from"] == origin
    # The first evaluation is that of the run it started from, not of new weights.
    seed = int(np.random.SeedSequence([4, 0]).generate_state(1)[0])
    results = runs.evaluate(envs.make("lbf-5x5-2p-1f", 2), script(name).load(tmp_path / "first", seed), seed)
    assert evaluations(tmp_path / "second")[0]["return_mean"] == str(results["return_mean"])


def test_first_weights_from_a_team_that_has_its_agents_alone(monkeypatch, capsys, tmp_path):
    place = next(path.parent for path in (ROOT / "benchmark/teams").glob("*/config.json") if path.parent.name[0] == "m")
    config = json.loads((place / "config.json").read_text())
    name, task = config["algorithm"], config["flags"]["env"]
    few = ["--env", task, "--total-timesteps", 1, "--eval-points", 1]
    assert main(monkeypatch, capsys, name, *few, "--start-from", place, "--run-dir", tmp_path / "run")[0] == 0
    assert runs.read_checkpoint(tmp_path / "run", name)["rows"]


@pytest.mark.parametrize(
    "change, name, shape",
    [
        (["--env", "lbf-6x6-3p-1f"], "first", "(32, 11)"),
        (["--no-parameter-sharing"], "first", "(32, 11)"),
        (["--hidden-dim", "16"], "first", "(32, 11)"),
        (["--network", "fc"], "core", "none"),
    ],
)
def test_first_weights_that_do_not_fit(mappo_run, monkeypatch, capsys, tmp_path, change, name, shape):
    """One sentence names the network and both shapes."""
    flags, directory = mappo_run
    start = ["--start-from", directory, "--run-dir", tmp_path / "run"]
    code, words = main(monkeypatch, capsys, "mappo", *flags[:-1], *change, *start)
    assert code == 2 and len(words.strip().splitlines()) == 1
    said = f"agents of {directory} does not fit: the shape of networks.0.{name}.weight is {shape} there"
    assert words.startswith(f"mappo: --start-from: {said}")


def test_first_weights_from_nowhere(monkeypatch, capsys, tmp_path):
    code, said = main(monkeypatch, capsys, "mappo", "--start-from", tmp_path, "--run-dir", tmp_path / "run")
    assert code == 2 and said == f"mappo: --start-from: {tmp_path} holds no run.\n"


# --- watching ---
def watched(monkeypatch, capsys, name, *flags):
    """What --watch prints: exit code, results and where the film is, and what stands on stderr."""
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, flags)])
    code: object = 0
    try:
        script_main(name)
    except SystemExit as end:
        code = end.code
    said = capsys.readouterr()
    return code, said.out.splitlines(), said.err


@pytest.mark.slow
def test_another_task_is_played_where_the_networks_fit(mappo_run, monkeypatch, capsys, tmp_path):
    """The film and the results are of the task of the command line."""
    copy, played, make = copy_of(mappo_run[1], tmp_path / "run"), [], runs.make_for

    def noted(args, *more, **also):
        played.append(args)
        return make(args, *more, **also)

    monkeypatch.setattr(runs.run, "make_for", noted)
    watch = ["--watch", copy, "--eval-episodes", 2]
    assert watched(monkeypatch, capsys, "mappo", *watch)[0] == 0
    assert watched(monkeypatch, capsys, "mappo", *watch, "--env", "lbf-6x6-2p-1f")[0] == 0
    assert [args.env for args in played] == ["lbf-5x5-2p-1f", "lbf-6x6-2p-1f"]
    code, _, said = watched(monkeypatch, capsys, "mappo", *watch, "--env", "lbf-6x6-3p-1f")
    assert code == 2 and said == (
        f"mappo: The team of {copy} does not fit: it has 2 agents with 9 observations and 6 actions; "
        "lbf-6x6-3p-1f has 3 with 12 and 6.\n"
    )


def test_options_of_the_environment_reach_what_is_watched(mappo_run, monkeypatch, capsys, tmp_path):
    copy = copy_of(mappo_run[1], tmp_path / "run")
    code, _, said = watched(monkeypatch, capsys, "mappo", "--watch", copy, "--max-episode-steps", 3)
    assert code == 2 and "--max-episode-steps is for environments of PettingZoo" in said


@pytest.mark.parametrize("flags", [["--gamma", "0.99"], ["--resume"], ["--no_parameter_sharing"], ["--eval-points=3"]])
def test_flags_of_a_training_are_refused_with_watch(mappo_run, monkeypatch, capsys, flags):
    """Also where they say what is the default."""
    code, _, said = watched(monkeypatch, capsys, "mappo", "--watch", mappo_run[1], *flags)
    name = flags[0].partition("=")[0].replace("_", "-").replace("--no-", "--")
    assert code == 2 and said == f"mappo: --watch plays what was trained; {name} is for a training.\n"


@pytest.mark.slow
def test_watching_greedily(mappo_run, monkeypatch, capsys, tmp_path):
    copy, greedy = copy_of(mappo_run[1], tmp_path / "run"), []
    film = envs.film

    def noted(env, team, *others):
        greedy.append(team.greedy)
        return film(env, team, *others)

    monkeypatch.setattr(envs, "film", noted)
    for flags in ([], ["--greedy"]):
        code, printed, _ = watched(monkeypatch, capsys, "mappo", "--watch", copy, "--eval-episodes", 30, *flags)
        assert code == 0
        team = script("mappo").load(copy, 0, greedy=bool(flags))
        results = runs.evaluate(envs.make("lbf-5x5-2p-1f", 30), team, 0)
        assert printed[0] == runs.in_words(results)
    assert greedy == [False, True]


def test_greedy_is_for_watching(monkeypatch, capsys, tmp_path):
    code, said = main(monkeypatch, capsys, "mappo", "--greedy", "--run-dir", tmp_path / "run")
    assert code == 2 and said.startswith("mappo: --greedy is for --watch")


@with_and_without_replay
@pytest.mark.slow
def test_watching_prints_and_films(finished, monkeypatch, capsys, tmp_path):
    from PIL import Image

    name, directory = finished
    copy = copy_of(directory, tmp_path / "run")
    _, said, _ = watched(monkeypatch, capsys, name, "--watch", copy, "--eval-episodes", 3)
    assert said[0].startswith("return_mean ") and "episode_length" in said[0]
    assert said[1:] == [f"film: {copy / 'film.gif'}", f"episodes: {copy / 'episodes.csv'}"]
    with open(copy / "episodes.csv") as file:
        returns = [float(row["return"]) for row in csv.DictReader(file)]
    assert len(returns) == 3 and said[0].startswith(f"return_mean {np.mean(returns):.3f}")
    with Image.open(copy / "film.gif") as film:
        assert getattr(film, "n_frames", 1) > 3


@pytest.mark.slow
def test_watching_where_nothing_can_be_written(mappo_run, monkeypatch, capsys, tmp_path):
    copy = copy_of(mappo_run[1], tmp_path / "run")
    (copy / "film.gif").mkdir()
    _, said, _ = watched(monkeypatch, capsys, "mappo", "--watch", copy, "--eval-episodes", 3)
    assert said[0].startswith("return_mean ") and said[1].startswith("There is no place for the film: [Errno")


@with_and_without_replay
@pytest.mark.slow
def test_the_film_shows_the_episodes_of_the_printed_results(finished, monkeypatch, capsys, tmp_path):
    """Those of the seed, played by a team that has drawn nothing yet."""
    (name, directory), returns, film = finished, np.zeros(3), envs.film
    copy = copy_of(directory, tmp_path / "run")

    def film_of_a_fresh_team(env, team, *others):
        assert torch.equal(team.rng.get_state(), torch.Generator().manual_seed(5).get_state())
        return film(env, team, *others)

    def frame(env, index):
        assert env.seed == 5
        returns[index] += env.rewards[index]
        return np.zeros((4, 4, 3), np.uint8)

    monkeypatch.setattr(envs, "film", film_of_a_fresh_team)
    monkeypatch.setattr(lbf.Env, "frame", frame)
    _, said, _ = watched(monkeypatch, capsys, name, "--watch", copy, "--eval-episodes", 3, "--seed", 5)
    assert said[0].startswith(f"return_mean {returns.mean():.3f}, return_std {returns.std():.3f},")


@pytest.mark.slow
def test_the_loaded_team_plays_like_the_last_evaluation(finished):
    """Same networks, environment and seeds: the loaded team's return is the last row of evaluations.csv."""
    name, directory = finished
    module, last = script(name), evaluations(directory)[-1]
    seed = int(np.random.SeedSequence([0, int(last["point"])]).generate_state(1)[0])
    torch.set_num_threads(1)
    results = runs.evaluate(envs.make("lbf-5x5-2p-1f", 20), module.load(directory, seed), seed)
    assert {key: str(value) for key, value in results.items()} == {key: last[key] for key in results}


@pytest.mark.slow
def test_a_greedy_team_is_deterministic(finished):
    """Whatever its seed; and its actions are the best ones that may be taken."""
    name, directory = finished
    env = envs.make("lbf-5x5-2p-1f", 50)
    observations, info = env.reset()
    info["action_mask"][:, 0, 3] = False
    first, second = (script(name).load(directory, seed, greedy=True) for seed in (1, 2))
    actions = first.act(observations, info)
    np.testing.assert_array_equal(actions, second.act(observations, info))
    outputs = first.agents(torch.from_numpy(observations).unsqueeze(0))[0][0].detach()
    outputs[torch.from_numpy(~info["action_mask"])] = -torch.inf
    np.testing.assert_array_equal(actions, outputs.argmax(-1))
    drawn = [script(name).load(directory, seed).act(observations, info) for seed in (1, 2)]
    alike = name == "vdn"  # the paper evaluates it in foraging without random actions
    assert np.array_equal(*drawn) == alike


# --- learning ---
SOON = {name: ["--total-timesteps", 10_000] for name in nine(OFF_POLICY)}  # flags for learning it in a few seconds
SOON |= {name: ["--total-timesteps", 50_000, "--learning-rate", 0.003] for name in ("ia2c", "maa2c", "coma")}
SOON |= {name: ["--total-timesteps", 30_000] for name in ("ippo", "mappo")}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_learns_the_penalty_game(name, tmp_path, monkeypatch, capsys):
    """k = 0: every equilibrium that pays 10 a step is found, 250 an episode; random play earns 61."""
    assert name in SOON, f"the table SOON in {__file__} must say with which flags {name} learns a game in a few seconds"
    flags = ["--env", "matrix-penalty-0", *SOON[name], "--eval-points", "2"]
    assert main(monkeypatch, capsys, name, *flags, "--run-dir", tmp_path / "run")[0] == 0
    rows = evaluations(tmp_path / "run")
    assert float(rows[0]["return_mean"]) < 150 and float(rows[1]["return_mean"]) > 240


class Opponents(matrix.Env):
    """The row pays the column's loss: with its own rewards in view, row 1 plays against column 1, for 2 a step."""

    PAYOFF = np.array([[3, 1, 4], [5, 2, 6], [1, 0, 7]], np.float32)  # as a team they would play 7, or 0

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self._step_arrays = (*self._step_arrays[:-1], self.PAYOFF)
        self.teams = (0, 1)

    def step_envs(self, actions, playing):
        refused = super().step_envs(actions, playing)  # the team's reward remains the row's
        self.agent_rewards[:, 1] *= -1
        return refused


@pytest.mark.parametrize("name", INDIVIDUAL)
@pytest.mark.slow
def test_opponents_learn_from_their_own_rewards(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(matrix, "Env", Opponents)
    flags = ["--env", "matrix-climbing", "--seed", 1, *SOON[name], "--eval-points", "2"]
    flags += ["--total-timesteps", 5000] if name in OFF_POLICY else []
    flags += ["--individual-rewards", "--no-parameter-sharing", "--run-dir", tmp_path / "run"]
    assert main(monkeypatch, capsys, name, *flags)[0] == 0
    rows = evaluations(tmp_path / "run")
    assert float(rows[0]["return_mean"]) > 70
    assert float(rows[1]["return_mean"]) == pytest.approx(50, abs=3)
    for row in rows:  # a column for the other team
        assert float(row["team_1_return_mean"]) == pytest.approx(-float(row["return_mean"]), rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("flags", [[], ["--individual-rewards"], ["--no-parameter-sharing"]])
def test_opponents_need_their_own_rewards_and_networks(name, flags, monkeypatch, capsys):
    if "--individual-rewards" in flags and name not in INDIVIDUAL:
        pytest.skip("it has no such flag")
    monkeypatch.setattr(matrix, "Env", Opponents)
    code, said = main(monkeypatch, capsys, name, "--env", "matrix-climbing", *flags)
    assert code == 2 and len(said.strip().splitlines()) == 1 and "opposing teams" in said
    assert ("--no-parameter-sharing" in said) == (name in INDIVIDUAL)
