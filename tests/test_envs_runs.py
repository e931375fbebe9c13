"""What all runs need of the file system and the machine: flags, directories, tables, the file of a replay."""

import csv
import errno
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import psutil
import pytest
import torch
from kills import full_everywhere, killed_everywhere, note_order
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import envs
from envs import InputError, runs


@dataclass
class Args:
    # task
    env: str = "matrix-climbing"  # the task
    env_kwargs: str = ""  # of the task
    seed: int = 0  # of everything
    total_timesteps: int = 1000  # length
    parameter_sharing: bool = True  # one network for all agents, or one for each
    # learning
    network: Literal["fc", "gru"] = "fc"  # the core
    gamma: float = 0.99  # discount
    clip_coef: float = 0.2  # how far
    max_grad_norm: float = 10.0  # norm
    epsilon_anneal: int = 10  # steps
    threads: int = 1  # of PyTorch
    eval_points: int = 3  # evaluations
    run_dir: str = ""  # where the run is kept
    resume: bool = False  # go on
    track: bool = False  # somewhere
    watch: str = ""  # a run
    greedy: bool = False  # the best
    device: str = "cpu"  # where


WRITTEN = ("lock", "config.json", "evaluations.csv")


def open_directory(path: Path, **flags: Any) -> runs.RunDirectory:
    args = Args(run_dir=str(path), **flags)
    return runs.RunDirectory(__file__, args, Args())


def save(directory: runs.RunDirectory, rows: list[dict[str, float]], **counters: int) -> None:
    """A checkpoint with all that a run's has."""
    counters = {"episode": 0, "timestep": 0, "updates": 0, "budget": 1000} | counters
    rng = torch.Generator().get_state()
    parts = {"agents": {"weight": torch.zeros(2)}}
    directory.save(rows, network=(1, 2, 3, "fc"), parts=parts, rng=rng, **counters)


class TestFlags:
    def test_a_statistic_cannot_take_the_place_of_a_result(self, monkeypatch: Any) -> None:
        args = SimpleNamespace(env="own", env_kwargs="", max_episode_steps=0, flatten_images=False, env_workers=0)
        args.divide_images, args.action_bins = True, 0
        monkeypatch.setattr(envs, "make", lambda *_, **__: SimpleNamespace(name="own", statistics={"timestep": 0}))
        with pytest.raises(InputError, match="no statistic can have the name 'timestep'"):
            runs.make_for(args, 1)

    @pytest.mark.parametrize(
        "flag, value",
        [
            ("gamma", -0.1),
            ("gamma", 1.1),
            ("gamma", math.nan),
            ("clip_coef", 0.0),
            ("clip_coef", 1.0),
            ("max_grad_norm", -1.0),
            ("epsilon_anneal", -1),
            ("threads", 0),
            ("threads", 100_000),
            ("total_timesteps", 0),
            ("seed", -1),
            ("seed", 2**63),
        ],
    )
    def test_out_of_range(self, flag: str, value: float) -> None:
        with pytest.raises(InputError, match=f"--{flag.replace('_', '-')} .* must lie"):
            runs.check_flags(SimpleNamespace(**vars(Args()) | {flag: value}))

    @pytest.mark.parametrize(
        "flag, value",
        [("gamma", 0.0), ("gamma", 1.0), ("clip_coef", 0.99), ("max_grad_norm", math.inf), ("epsilon_anneal", 0)],
    )
    def test_in_range(self, flag: str, value: float) -> None:
        runs.check_flags(SimpleNamespace(**vars(Args()) | {flag: value}))

    def test_whole_numbers(self) -> None:
        """Those of the type int in any form; what is no whole number is refused."""
        for words, expected in (("1e6", 10**6), ("2.5e3", 2500), ("1000.0", 1000), ("7", 7)):
            args = runs.parse_flags(Args, lambda: Args(), ["--total-timesteps", words, "--epsilon-anneal=1e2"], "")
            assert (args.total_timesteps, args.epsilon_anneal) == (expected, 100)
        assert runs.parse_flags(Args, lambda: Args(), ["--seed", str(2**63 - 1)], "").seed == 2**63 - 1
        for words in ("1.5", "many", "inf", "nan", "1e-3"):
            with pytest.raises(InputError, match=f"{words} is not a whole number"):
                runs.parse_flags(Args, lambda: Args(), ["--total-timesteps", words], "")

    def test_every_number_of_the_scripts_has_a_range(self) -> None:
        from scripts import NAMES, script

        for name in NAMES:
            for flag, value in vars(script(name).paper_defaults()).items():
                assert isinstance(value, str | bool) or flag in runs.RANGES, flag

    def test_changed_flags(self) -> None:
        args = Args(seed=4, run_dir="here", network="gru", total_timesteps=5, parameter_sharing=False)
        assert runs.changed_flags(args, Args()) == {"network": "gru", "total_timesteps": 5}

    def test_what_is_played_is_named_before_how(self) -> None:
        """Wherever it stands in Args, so that directories of older versions keep their names."""
        args = SimpleNamespace(env="own:mine", gamma=0.5, env_kwargs="N=2", hidden_dim=64, max_episode_steps=9)
        default = SimpleNamespace(gamma=0.9, env_kwargs="", hidden_dim=128, max_episode_steps=0)
        assert list(runs.changed_flags(args, default)) == ["env_kwargs", "max_episode_steps", "gamma", "hidden_dim"]

    def test_names_of_directories(self, monkeypatch: Any, tmp_path: Path) -> None:
        monkeypatch.chdir(tmp_path)
        for name in ("mappo.py", "iql.py"):
            Path(name).touch()
        path = runs.RunDirectory("mappo.py", Args(seed=3), Args()).path
        assert path == Path("runs/matrix-climbing/mappo-shared/seed3")
        args = Args(env="a/b:c", parameter_sharing=False, gamma=0.5, total_timesteps=7, eval_points=9)
        path = runs.RunDirectory("iql.py", args, Args()).path
        assert path == Path("runs/a_b_c/iql-independent-gamma=0.5/seed0")

    def test_a_very_long_name_is_cut(self) -> None:
        first, second = (runs.safe_name("x" * 300 + end) for end in "ab")
        assert len(first) == len(second) < 255 and first != second


class TestDirectory:
    rows = ({"point": 0, "timestep": 0, "return_mean": 1.5},)

    def save(self, directory: runs.RunDirectory, rows: Sequence[dict[str, float]]) -> None:
        save(directory, list(rows), timestep=5)

    def test_the_checkpoint_comes_back(self, tmp_path: Path) -> None:
        first = open_directory(tmp_path / "run")
        assert first.checkpoint() is None
        self.save(first, self.rows)
        del first
        saved = open_directory(tmp_path / "run", resume=True).checkpoint()
        assert saved is not None and saved["timestep"] == 5 and saved["rows"] == list(self.rows)

    def test_a_new_column_shifts_no_old_row(self, tmp_path: Path) -> None:
        directory = open_directory(tmp_path / "run")
        self.save(directory, [*self.rows, {"point": 1, "return_mean": 2.0, "deliveries": 3.0, "timestep": 10}])
        with open(tmp_path / "run" / "evaluations.csv") as file:
            first, second = csv.DictReader(file)
        assert first == {"point": "0", "timestep": "0", "return_mean": "1.5", "deliveries": ""}
        assert second == {"point": "1", "timestep": "10", "return_mean": "2.0", "deliveries": "3.0"}

    def test_tables_are_written_whole_or_not_at_all(self, monkeypatch: Any, tmp_path: Path) -> None:
        directory = open_directory(tmp_path / "run")
        self.save(directory, self.rows)
        before = (tmp_path / "run" / "evaluations.csv").read_bytes()

        def full_disk(file: int) -> None:
            raise OSError("No space left on device")

        monkeypatch.setattr(os, "fsync", full_disk)
        with pytest.raises(OSError, match="No space"):
            self.save(directory, [*self.rows, {"point": 1, "timestep": 9, "return_mean": 0.0}])
        assert (tmp_path / "run" / "evaluations.csv").read_bytes() == before

    def test_the_disk_has_a_checkpoint_before_it_takes_the_last_ones_place(
        self, monkeypatch: Any, tmp_path: Path
    ) -> None:
        """And the new names, before anything is done that relies on them."""
        directory = open_directory(tmp_path / "run")
        self.save(directory, self.rows)
        order = note_order(monkeypatch)
        self.save(directory, self.rows)
        assert order == [
            "sync checkpoint.new.pt",
            "checkpoint.pt -> checkpoint.previous.pt",
            "checkpoint.new.pt -> checkpoint.pt",
            "sync run",
        ]
        order.clear()
        runs.write_whole(tmp_path / "run" / "config.json", "{}")
        assert order == ["sync config.json.new", "config.json.new -> config.json", "sync run"]

    def test_only_one_process_has_it(self, tmp_path: Path) -> None:
        first = open_directory(tmp_path / "run")
        with pytest.raises(InputError, match="Another run is using"):
            open_directory(tmp_path / "run", resume=True)
        first._lock.lock.release()
        open_directory(tmp_path / "run", resume=True)._lock.lock.release()

    def test_who_holds_it_for_a_moment_is_waited_for(self, tmp_path: Path) -> None:
        """As a campaign does that looks whether it is in use."""
        lock = runs.directory.filelock.FileLock(tmp_path / "lock", thread_local=False)
        lock.acquire()
        threading.Timer(0.1, lock.release).start()
        self.save(open_directory(tmp_path), self.rows)

    def test_seconds_add_up_and_never_run_backwards(self, monkeypatch: Any, tmp_path: Path) -> None:
        first = open_directory(tmp_path / "run")
        first._stopwatch = runs.Stopwatch(wall_seconds=100.0, cpu_seconds=50.0)
        self.save(first, self.rows)
        del first
        monkeypatch.setattr(time, "time", lambda: 0.0)  # somebody sets the clock back by half a century
        second = open_directory(tmp_path / "run", resume=True)
        second.checkpoint()
        seconds = second.seconds()
        assert 100 <= seconds["wall_seconds"] < 200 and 50 <= seconds["cpu_seconds"] < 150

    def test_a_table_that_another_program_holds_open(self, monkeypatch: Any, tmp_path: Path, capsys: Any) -> None:
        """As Windows has it: the run says so and goes on, and the next save writes it. Checkpoints are tried again."""
        directory = open_directory(tmp_path / "run")
        self.save(directory, self.rows)
        replace, refused = Path.replace, {"evaluations.csv": 99, "checkpoint.pt": 2}
        monkeypatch.setattr("envs.runs.directory.PAUSES", (0.0,) * 4)

        def as_on_windows(new: Path, path: Path) -> Any:
            if refused.get(path.name, 0):
                refused[path.name] -= 1
                raise PermissionError(errno.EACCES, "The process cannot access the file", str(path))
            return replace(new, path)

        monkeypatch.setattr(Path, "replace", as_on_windows)
        more = [*self.rows, {"point": 1, "timestep": 5, "return_mean": 2.0}]
        self.save(directory, more)
        assert "evaluations.csv cannot be written (The process cannot access the file)" in capsys.readouterr().err
        saved = runs.last_checkpoint(tmp_path / "run")
        assert saved is not None and saved["rows"] == more and refused["checkpoint.pt"] == 0
        assert len((tmp_path / "run" / "evaluations.csv").read_text().splitlines()) == 2
        refused.clear()
        self.save(directory, more)
        assert len((tmp_path / "run" / "evaluations.csv").read_text().splitlines()) == 3
        assert not capsys.readouterr().err

    def test_single_episodes(self, tmp_path: Path) -> None:
        """A row for each, whose means are those of the evaluation; a run's directory may hold the table."""
        env = envs.make("mpe-adversary-selfplay", 3)
        env.reset(seed=1)
        totals = envs.EpisodeTotals(env)
        while not totals.ended.all():
            _, rewards, terminated, truncated, info = env.step(np.ones((3, 3), np.int64))
            totals.add(rewards, terminated, truncated, info)
        directory = open_directory(tmp_path / "run")
        self.save(directory, self.rows)
        runs.write_episodes(tmp_path / "run", totals)
        directory._lock.lock.release()
        open_directory(tmp_path / "run", resume=True)
        with open(tmp_path / "run" / "episodes.csv") as file:
            rows = list(csv.DictReader(file))
        assert [row["episode"] for row in rows] == ["0", "1", "2"] and rows[0]["episode_length"] == "25.0"
        means = totals.means()
        for column, name in (
            ("return", "return_mean"),
            ("team_1_return", "team_1_return_mean"),
            *[["goal_distance"] * 2],
        ):
            assert np.mean([float(row[column]) for row in rows]) == pytest.approx(means[name])

    def test_the_one_before_is_kept(self, tmp_path: Path) -> None:
        directory = open_directory(tmp_path / "run")
        for timestep in (1, 2, 3):
            save(directory, list(self.rows), timestep=timestep)
        (tmp_path / "run" / "checkpoint.pt").write_bytes(b"damaged")
        saved = runs.last_checkpoint(tmp_path / "run")
        assert saved is not None and saved["timestep"] == 2

    @pytest.mark.parametrize("resume", [False, True])
    @pytest.mark.parametrize(
        "left", [["progress.json.new"], ["checkpoint.new.pt", "progress.json", "replay.bin", "events.out.tfevents.1"]]
    )
    def test_a_run_that_left_no_checkpoint_begins_anew(self, left: list[str], resume: bool, tmp_path: Path) -> None:
        """It was killed before it had written its first one, or the disk was full: there is nothing to lose."""
        for name in left:
            (tmp_path / name).write_bytes(b"begun")
        assert open_directory(tmp_path, resume=resume).checkpoint() is None

    @pytest.mark.parametrize("resume", [False, True])
    def test_a_first_checkpoint_that_has_no_name_yet(self, resume: bool, tmp_path: Path) -> None:
        """A run that goes on takes it; one that begins anew, here with other flags, does not."""
        first = open_directory(tmp_path / "run")
        self.save(first, self.rows)
        first._lock.lock.release()
        for name in ("evaluations.csv", "config.json"):
            (tmp_path / "run" / name).unlink()
        (tmp_path / "run" / "checkpoint.pt").rename(tmp_path / "run" / "checkpoint.new.pt")
        flags: dict[str, Any] = {"resume": True} if resume else {"gamma": 0.5}
        saved = open_directory(tmp_path / "run", **flags).checkpoint()
        assert (saved is not None and saved["timestep"] == 5) if resume else saved is None

    def test_what_came_back_from_a_cluster_is_placed(self, tmp_path: Path) -> None:
        """A campaign was killed before it did so, when a run's first files had come back, or only a part of them."""
        first = open_directory(tmp_path / "run")
        self.save(first, self.rows)
        first._lock.lock.release()
        for name, whole in (("arrived", True), ("arrived.new", False)):
            (tmp_path / name).mkdir()
            shutil.copytree(tmp_path / "run", tmp_path / name / name, ignore=shutil.ignore_patterns("lock"))
            if whole:
                with pytest.raises(InputError, match="holds a run: --resume goes on with it"):
                    open_directory(tmp_path / name)
            saved = open_directory(tmp_path / name, resume=True).checkpoint()
            assert (saved is not None and saved["rows"] == list(self.rows)) == whole
            assert not list((tmp_path / name).glob("arrived*"))

    def test_a_run_that_is_lengthened_says_where_its_evaluations_lie(self, tmp_path: Path, capsys: Any) -> None:
        first = open_directory(tmp_path)
        save(first, [], budget=1000)
        first._lock.lock.release()
        open_directory(tmp_path, resume=True, total_timesteps=50_000).checkpoint()
        assert "becomes longer; its evaluations stay 500 steps apart" in capsys.readouterr().err

    def test_a_run_whose_checkpoints_are_gone_is_not_begun_anew(self, tmp_path: Path) -> None:
        """That would overwrite its evaluations."""
        directory = tmp_path / "run"
        directory.mkdir()
        for name in ("progress.json", "evaluations.csv"):
            (directory / name).write_text("mine")
        with pytest.raises(InputError, match="they are gone"):
            open_directory(directory, resume=True).checkpoint()


class TestKills:
    """A run that is killed, or meets a full disk, at any file operation of a save."""

    def rows(self, timestep: int) -> list[dict[str, float]]:
        return [{"point": point, "timestep": point, "return_mean": 0.5 * point} for point in range(timestep + 1)]

    def go_on(self, path: Path, timestep: int) -> None:
        """Opens the run, makes sure that its tables are those of its checkpoint, and saves at this timestep."""
        directory = open_directory(path, resume=True)
        try:
            saved = directory.checkpoint()
            if saved is not None:
                with open(path / "evaluations.csv") as file:
                    assert len(list(csv.DictReader(file))) == len(saved["rows"]) == saved["timestep"] + 1
            save(directory, self.rows(timestep), timestep=timestep, budget=1)
        finally:
            directory._lock.lock.release()

    def before(self, path: Path, saves: int) -> Path:
        """A run with so many saves."""
        path.mkdir()
        for timestep in range(saves):
            self.go_on(path, timestep)
        return path

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
    @pytest.mark.parametrize("saves", [0, *(pytest.param(saves, marks=pytest.mark.slow) for saves in (1, 3))])
    def test_a_kill_leaves_the_last_checkpoint_or_the_new_one(self, saves: int, tmp_path: Path) -> None:
        before, path, found = self.before(tmp_path / "before", saves), tmp_path / "run", []
        for _ in killed_everywhere(before, path, lambda: self.go_on(path, saves)):
            saved = runs.last_checkpoint(path)
            found.append(-1 if saved is None else saved["timestep"])
            self.go_on(path, saves)
            saved = runs.last_checkpoint(path)
            assert saved is not None and saved["timestep"] == saves
            assert {file.name for file in path.iterdir()} <= {*runs.directory.CHECKPOINTS[:2], *WRITTEN}
        assert found == sorted(found) and set(found) == {saves - 1, saves} and len(found) > 8

    @pytest.mark.parametrize("saves", [0, 3])
    def test_a_full_disk_costs_no_checkpoint_and_keeps_no_torn_one(self, saves: int, tmp_path: Path) -> None:
        """A table that cannot be written costs nothing at all: the next save does it."""
        before, path, errors = self.before(tmp_path / "before", saves), tmp_path / "run", []
        for error in full_everywhere(before, path, lambda: self.go_on(path, saves)):
            saved = runs.last_checkpoint(path) if saves or error is None else {"timestep": -1}
            assert saved is not None
            if saves:  # what fails after the checkpoint has its name is no error
                assert saved["timestep"] == (saves if error is None else saves - 1)
            assert all(runs.is_whole(file) for file in path.glob("*.pt")) and not list(path.glob("*.new"))
            errors.append(error)
            self.go_on(path, saves)
        assert None in errors and len(errors) > 8
        assert any(str(error).endswith(f"'{path / 'checkpoint.new.pt'}'") for error in errors)


class TestEpisodeFile:
    """Episodes of at most four steps: the number of the episode in each step, and what was played."""

    @pytest.fixture(autouse=True)
    def machine(self, monkeypatch: Any) -> dict[str, int]:
        """With a gibibyte of free memory and disk."""
        free = {"memory": 2**30, "disk": 2**30}
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=free["memory"]))
        monkeypatch.setattr(psutil, "disk_usage", lambda path: SimpleNamespace(free=free["disk"]))
        return free

    def begin(self, folder: Path, size: int = 6, played: int = 0) -> runs.EpisodeFile:
        fields = {"value": np.zeros(5, np.float32), "played": np.zeros(4, np.bool_)}
        return runs.EpisodeFile(folder / "replay.bin", fields, size, played)

    def play(self, file: runs.EpisodeFile, numbers: range) -> None:
        for number in numbers:
            steps = 1 + number % 4
            played = np.ones(steps, np.bool_)
            file.write(number, {"value": np.full(steps + 1, number, np.float32), "played": played})

    def test_what_was_written_is_read_cut_to_the_longest(self, tmp_path: Path) -> None:
        file = self.begin(tmp_path)
        self.play(file, range(1, 40))
        read = file.read(np.array([34, 36, 37]))  # of 3, 1 and 2 steps
        assert read["value"].shape == (3, 4) and read["played"].shape == (3, 3)
        assert read["played"].tolist() == [[True] * 3, [True, False, False], [True, True, False]]
        assert (read["value"][0] == 34).all() and (read["value"][1, :2] == 36).all()

    def test_a_new_file_takes_its_room_at_once(self, tmp_path: Path, capsys: Any) -> None:
        path = tmp_path / "replay.bin"
        path.write_bytes(b"of a run that left no checkpoint")
        file = self.begin(tmp_path, size=100_000)
        assert len(file.slots) == 150_000 and path.stat().st_size == 150_000 * (20 + 4 + 8)
        assert not file.slots["number"].any()
        if hasattr(os, "posix_fallocate"):
            assert path.stat().st_blocks * 512 >= path.stat().st_size
        (said,) = capsys.readouterr().err.splitlines()
        assert "takes 5 MiB on the disk (1,024 free) and in memory (1,024 free)" in said

    def test_it_is_opened_again_as_it_was(self, tmp_path: Path, machine: dict[str, int]) -> None:
        self.play(self.begin(tmp_path), range(1, 14))
        machine["disk"] = 0  # it has its room already
        again = self.begin(tmp_path, played=13)
        assert again.read(np.array([13]))["value"][0, 0] == 13

    @pytest.mark.parametrize("missing", ["memory", "disk"])
    def test_a_machine_without_room_is_refused(self, tmp_path: Path, machine: dict[str, int], missing: str) -> None:
        """One byte less than the file takes is too little, and nothing is written then."""
        size = 10 * (20 + 4 + 8)  # six slots and twice two spare ones
        machine |= {"memory": size, "disk": size}
        self.begin(tmp_path)
        (tmp_path / "replay.bin").unlink()
        machine[missing] -= 1
        with pytest.raises(InputError, match=f"would take 0 MiB, more than the free {missing}"):
            self.begin(tmp_path)
        assert not (tmp_path / "replay.bin").exists()

    def test_what_is_too_large_says_what_makes_it_smaller(self, tmp_path: Path, machine: dict[str, int]) -> None:
        """An episode beyond 2 GiB has no type in NumPy; a file beyond the memory is refused before it is made."""
        large: Any = np.broadcast_to(np.float32(0), (5, 2**27))  # takes no memory itself
        with pytest.raises(InputError, match=r"An episode takes 2,560 MiB.* up to 2,047; `max_episode_steps` makes"):
            runs.EpisodeFile(tmp_path / "replay.bin", {"value": large, "played": np.zeros(4, np.bool_)}, 6, 0)
        machine["memory"] = 1
        with pytest.raises(InputError, match="`buffer_size` makes it smaller, and `max_episode_steps` makes"):
            self.begin(tmp_path)
        assert not list(tmp_path.iterdir())

    def test_a_file_in_use_is_closed_before_it_is_deleted(self, tmp_path: Path, monkeypatch: Any) -> None:
        """Windows deletes no file that is mapped."""
        directory = open_directory(tmp_path / "run")
        file = self.begin(tmp_path / "run")
        self.play(file, range(1, 4))
        unlink = Path.unlink

        def as_on_windows(path: Path, missing_ok: bool = False) -> None:
            if path.exists() and str(path) in Path("/proc/self/maps").read_text():
                raise PermissionError(errno.EACCES, "The process cannot access the file", str(path))
            unlink(path, missing_ok)

        if Path("/proc/self/maps").exists():
            monkeypatch.setattr(Path, "unlink", as_on_windows)
        file.close()  # as `Run.complete` does
        directory.complete()
        assert not (tmp_path / "run" / "replay.bin").exists()

    def test_a_damaged_slot_is_refused(self, tmp_path: Path) -> None:
        """A flipped bit, anywhere in an episode that the run still needs."""
        self.play(self.begin(tmp_path), range(1, 14))
        path, size = tmp_path / "replay.bin", 20 + 4 + 8
        whole = path.read_bytes()
        for episode in range(4, 14):  # later ones have the slots of the first three
            for byte in range(size):
                damaged = bytearray(whole)
                damaged[(episode - 1) % 10 * size + byte] ^= 4
                path.write_bytes(damaged)
                if episode < 8:
                    self.begin(tmp_path, played=13)
                    continue
                with pytest.raises(InputError, match="is damaged: "):
                    self.begin(tmp_path, played=13)

    def test_a_file_of_an_older_version_has_no_check_sums(self, tmp_path: Path) -> None:
        """The number of an episode had eight bytes, where now are four, and four of the check sum."""
        file = self.begin(tmp_path)
        self.play(file, range(1, 14))
        older = np.dtype([("value", np.float32, 5), ("played", np.bool_, 4), ("number", np.int64)])
        file.slots.view(older)["number"] = file.slots["number"]
        again = self.begin(tmp_path, played=13)
        assert again.read(np.array([13]))["value"][0, 0] == 13
        self.play(again, range(14, 16))
        self.begin(tmp_path, played=15)

    def test_another_file_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="complete run deletes it"):
            self.begin(tmp_path, played=3)
        self.play(self.begin(tmp_path), range(1, 14))
        with pytest.raises(InputError, match="another length"):
            self.begin(tmp_path, size=7, played=13)
        with pytest.raises(InputError, match="does not hold the last episodes"):
            self.begin(tmp_path, played=14)


def test_a_closed_terminal_is_no_failure(monkeypatch: Any) -> None:
    """Nor is what Python still flushes when the process ends."""

    def closed(*text: str) -> None:
        raise OSError(errno.EIO, "the terminal is gone")

    monkeypatch.setattr(sys, "stderr", SimpleNamespace(write=closed, flush=closed))
    runs.say("one")
    assert sys.stderr.name == os.devnull
    runs.say("two")


class TestTracking:
    """Weights & Biases, by a stand-in."""

    @pytest.fixture
    def wandb(self, monkeypatch: Any) -> list[str]:
        """The ids of the runs that were begun or gone on with; the first is refused."""
        ids: list[str] = []

        class Error(Exception):
            pass

        def init(id: str, **_: Any) -> None:
            ids.append(id)
            if len(ids) == 1:
                raise Error("nobody is logged in")

        stand_in = SimpleNamespace(init=init, errors=SimpleNamespace(Error=Error))
        monkeypatch.setitem(sys.modules, "wandb", stand_in)
        return ids

    def test_each_run_has_its_own_id_and_keeps_it(self, wandb: list[str], tmp_path: Path) -> None:
        for name in ("first", "first", "second", "second"):
            directory = open_directory(tmp_path / name, track=True, resume=len(wandb) > 1)
            if not wandb:
                with pytest.raises(InputError, match="--track: nobody is logged in"):
                    runs.Log(directory.path, directory.args, 0, False)
            else:
                runs.Log(directory.path, directory.args, 0, False).close()
            directory._lock.lock.release()
        assert wandb[0] == wandb[1] != wandb[2] == wandb[3]


class TestTensorBoard:
    """The points of TensorBoard's file, as TensorBoard itself reads them."""

    def points(self, path: Path, tag: str) -> list[tuple[int, float]]:
        events = EventAccumulator(str(path))
        events.Reload()
        return [(point.step, point.value) for point in events.Scalars(tag)]

    def test_a_resumed_run_takes_back_what_came_after_its_checkpoint(self, tmp_path: Path) -> None:
        for begins, ends, resumed in ((0, 4, False), (2, 5, True)):
            if resumed:
                # TensorBoard reads its files in the order of their names. They begin with the second of their
                # making; within one second a number decides, and as text 10 comes before 9.
                time.sleep(1)
            log = runs.Log(tmp_path, Args(), begins, resumed)
            for timestep in range(begins + 1, ends + 1):
                log.evaluation(timestep, {"return_mean": float(10 * ends + timestep)})
            log.close()
        assert self.points(tmp_path, "evaluation/return_mean") == [(1, 41), (2, 42), (3, 53), (4, 54), (5, 55)]

    def test_means_are_those_of_the_last_hundred_episodes(self, tmp_path: Path) -> None:
        log = runs.Log(tmp_path, Args(), 0, False)
        for timestep, score, n_episodes in ((10, 9.0, 60), (20, 1.0, 100), (30, 3.0, 50)):
            log.batch(timestep, [score] * n_episodes, [10 * score] * n_episodes, {})
        log.close()
        assert self.points(tmp_path, "training/return_mean") == [(10, 9), (20, 1), (30, 2)]
        assert self.points(tmp_path, "training/episode_length") == [(10, 90), (20, 10), (30, 20)]

    def test_the_speed_is_that_of_this_process(self, tmp_path: Path) -> None:
        log = runs.Log(tmp_path, Args(), 500, False)
        log.started -= 1000  # seconds ago
        log.batch(700, [1.0], [1.0], {})
        log.close()
        assert self.points(tmp_path, "training/steps_per_second") == [(700, pytest.approx(0.2, rel=0.05))]

    def test_a_thousand_points_a_run(self, tmp_path: Path) -> None:
        log = runs.Log(tmp_path, Args(total_timesteps=10_000), 0, False)
        for timestep in (4, 8, 12, 16, 20, 24):
            log.batch(timestep, [1.0], [1.0], {"loss/critic": np.float64(timestep)})
        log.close()
        assert self.points(tmp_path, "loss/critic") == [(12, 12), (20, 20)]  # the first at or after each ten

    @pytest.mark.parametrize(
        "env, own, results, hint",
        [
            ("pettingzoo:pettingzoo.classic.rps_v2", False, (0.0, 0.0), True),
            ("pettingzoo:pettingzoo.classic.rps_v2", True, (0.0, 0.0), False),
            ("pettingzoo:pettingzoo.classic.rps_v2", False, (0.0, 1.0), False),
            ("rware-tiny-2p", False, (0.0, 0.0), False),
        ],
    )
    def test_rewards_that_cancel_out(self, tmp_path: Path, capsys: Any, env: str, own: bool, results: Any, hint: bool):
        args = SimpleNamespace(env=env, individual_rewards=own, total_timesteps=10, track=False)
        log = runs.Log(tmp_path, args, 0, False)
        log.evaluation(0, dict(zip(("return_mean", "return_std"), results)))
        log.close()
        assert ("--individual-rewards" in capsys.readouterr().err) == hint


class TestCommit:
    """The commit in config.json."""

    def test_changed_files_make_it_dirty(self, tmp_path: Path, monkeypatch: Any) -> None:
        def git(*words: str) -> str:
            identity = ("-c", "user.name=nobody", "-c", "user.email=nobody@example.org")
            done = subprocess.run(["git", *identity, *words], cwd=tmp_path, check=True, capture_output=True, text=True)
            return done.stdout.strip()

        module = tmp_path / "envs" / "runs" / "process.py"
        module.parent.mkdir(parents=True)
        monkeypatch.setattr(runs.origin, "__file__", str(module))
        for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
        assert runs.origin._commit() is None
        git("init")
        module.write_text("1")
        git("add", "envs")
        git("commit", "-m", "first")
        git("tag", "a-tag")
        assert runs.origin._commit() == git("rev-parse", "HEAD")
        module.write_text("2")
        assert runs.origin._commit() == git("rev-parse", "HEAD") + "-dirty"
        installed = tmp_path / "site-packages" / "envs" / "runs" / "process.py"  # in another project's checkout
        installed.parent.mkdir(parents=True)
        monkeypatch.setattr(runs.origin, "__file__", str(installed))
        assert runs.origin._commit() is None


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no SIGHUP")
@pytest.mark.parametrize(
    ("numbers", "echo", "end", "said"),
    [
        (["INT", "TERM", "TERM", "TERM", "INT", "INT"], 60, KeyboardInterrupt, "twice more"),
        (["TERM", "TERM"], 0, SystemExit, "once more"),
        (["HUP", "INT", "INT", "HUP"], 0, SystemExit, "once more"),
    ],
)
def test_what_ends_a_process_that_hangs(
    numbers: list[str], echo: float, end: type[BaseException], said: str, monkeypatch: Any, capfd: Any
) -> None:
    """An environment may hang, and then no batch ends. The first signal says so; what follows that one ends."""
    monkeypatch.setattr(runs.process, "ECHO_SECONDS", echo)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        signals = runs.StopSignals()
        *others, last = (getattr(signal, f"SIG{name}") for name in numbers)
        for number in others:
            signal.raise_signal(number)
            assert signals.received == number
        with pytest.raises(end) as ended:
            signal.raise_signal(last)
        assert getattr(ended.value, "code", 130) == 128 + last
        assert all(signal.getsignal(number) is signal.SIG_DFL for number in before)
        assert capfd.readouterr().err == f"Stopping after this batch; {said} ends the process at once.\n"
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_too_little_memory_ends_in_one_sentence(capsys: Any) -> None:
    import torch

    with pytest.raises(SystemExit, match="2"), runs.one_sentence(__file__):
        torch.empty(2**60)
    assert capsys.readouterr().err.strip().endswith("there is not enough memory.")
    with pytest.raises(RuntimeError, match="something else"), runs.one_sentence(__file__):
        raise RuntimeError("something else")


@pytest.mark.parametrize(
    ("writes", "code", "said"),
    [
        ("print(1)", 0, ""),
        ("print(1, flush=True)", 2, "x: [Errno 32] Broken pipe\n"),
        ("runs.terminal.show('a'); runs.terminal.show('b'); print('c', file=sys.stderr)", 0, "c\n"),
    ],
)
def test_a_reader_that_has_seen_enough(writes: str, code: int, said: str) -> None:
    """As `python algos/mappo.py --watch ... | head -1`, which shows its lines; Python's own flush would complain."""
    program = f"import sys\nfrom envs import runs\nwith runs.one_sentence('x.py'):\n    {writes}"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    ours, theirs = os.pipe()
    os.close(ours)
    done = subprocess.run(
        [sys.executable, "-c", program], stdout=theirs, stderr=subprocess.PIPE, text=True, env=environment
    )
    os.close(theirs)
    assert (done.returncode, done.stderr) == (code, said)


def test_a_terminal_that_cannot_show_a_name() -> None:
    program = "from envs import runs\nwith runs.one_sentence('x.py'):\n    print('\\xe4')"
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (0, "\\xe4\n", "")


def test_what_the_system_puts_into_a_folder_does_not_matter(tmp_path: Path) -> None:
    open_directory(tmp_path / "run")._lock.lock.release()
    (tmp_path / "run" / "progress.json").write_text("{}")
    (tmp_path / "run" / ".DS_Store").touch()
    open_directory(tmp_path / "run", resume=True)._lock.lock.release()
    (tmp_path / "run" / "notes.txt").touch()
    with pytest.raises(InputError, match=r"not a run of ours, such as 'notes\.txt'"):
        open_directory(tmp_path / "run", resume=True)


def test_lines_where_there_is_no_terminal(monkeypatch: Any, capsys: Any, tmp_path: Path) -> None:
    """The first after ten seconds, each later one after twice the time; an evaluation is a line, too."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(runs.log.time, "monotonic", lambda: clock.now)
    log = runs.Log(tmp_path, Args(), 0, resumed=False)
    for second in range(1, 100):
        clock.now = second
        log.batch(second * 10, [0.5], [5], {})
        if second == 25:
            log.evaluation(250, {"return_mean": 0.25})
    log.close()
    lines = capsys.readouterr().err.splitlines()[1:]
    assert lines[0] == "step 100 of 1,000: return 0.500, 10 steps/s, 01:30 left"
    assert [line.split()[1] for line in lines] == ["100", "250:", "450", "850"]


def test_a_run_goes_on_where_nobody_can_be_told_how(monkeypatch: Any, capsys: Any, tmp_path: Path) -> None:
    """Neither progress.json nor TensorBoard's file can be written: one sentence, said once."""
    (tmp_path / "progress.json.new").mkdir()
    monkeypatch.setattr(runs.log, "PROGRESS_SECONDS", 0)
    event_file = "tensorboard.summary.writer.event_file_writer.EventFileWriter"
    log = runs.Log(tmp_path, Args(), 0, resumed=False)

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for name in ("add_event", "flush", "close", "__init__"):
        monkeypatch.setattr(f"{event_file}.{name}", full)
    for timestep in (100, 200):
        log.batch(timestep, [1.0], [1.0], {})
        log.evaluation(timestep, {"return_mean": 1.0})
    log.close()
    runs.Log(tmp_path, Args(), 0, resumed=False).close()
    said = f"{tmp_path}: TensorBoard's file cannot be written (No space left on device); the run goes on without it."
    assert capsys.readouterr().err.splitlines().count(said) == 2  # once for each of the two


def test_a_full_disk_is_named(monkeypatch: Any, tmp_path: Path) -> None:
    def full_disk(file: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match=r"No space left on device: .*progress\.json\.new"):
        runs.write_whole(tmp_path / "progress.json", "{}")


def test_ctrl_c_before_there_is_anything_to_save() -> None:
    with pytest.raises(SystemExit) as ended, runs.one_sentence("mappo.py"):
        raise KeyboardInterrupt
    assert ended.value.code == 130


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no SIGHUP")
def test_what_is_ignored_stays_ignored() -> None:
    """A run that was started with nohup goes on when its terminal is closed."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        signals = runs.StopSignals()
        signal.raise_signal(signal.SIGHUP)
        assert signals.received is None
        signal.raise_signal(signal.SIGTERM)
        assert signals.received == signal.SIGTERM
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
