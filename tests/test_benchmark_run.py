"""Campaigns: what is planned, skipped, gone on with, kept aside, stopped, and run on a cluster.

Most tests run a stand-in for the training scripts: the same command line, files, locks, signals and exit codes, but it
only counts. Its flag --pace is how long a step takes.
"""

import contextlib
import csv
import errno
import importlib
import itertools
import json
import os
import pty
import random
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import psutil
import pytest
from kills import full_everywhere, killed_everywhere

import envs
from benchmark import campaign as campaigns
from benchmark import hyperparameters, measures, plan, run, store, tables
from envs.runs import is_whole, place_arrived

ROOT = Path(__file__).resolve().parent.parent
BENCHMARK = ROOT / "benchmark"

STAND_IN = """
import argparse, json, os, signal, sys, tempfile, time, zipfile
from dataclasses import dataclass
from pathlib import Path

import filelock

ALGORITHM = Path(__file__).stem


@dataclass
class Args:
    env: str = ""
    seed: int = 0
    total_timesteps: int = 40
    eval_points: int = 5
    learning_rate: float = 0.5
    pace: float = 0.002  # seconds for a step
    trouble: str = ""  # what goes wrong
    parameter_sharing: bool = True
    device: str = "cpu"
    run_dir: str = ""
    resume: bool = False
    watch: str = ""
    greedy: bool = False
    env_kwargs: str = ""


def paper_defaults(env="", parameter_sharing=True):
    return Args(env=env, parameter_sharing=parameter_sharing)


def parse(argv):
    parser = argparse.ArgumentParser(allow_abbrev=False)
    for name, value in vars(Args()).items():
        words = {"action": argparse.BooleanOptionalAction} if isinstance(value, bool) else {"type": type(value)}
        parser.add_argument("--" + name.replace("_", "-"), default=value, **words)
    return Args(**vars(parser.parse_args(argv)))


def progress_of(path):
    try:
        with zipfile.ZipFile(path) as file:
            return json.loads(file.read("progress"))
    except (OSError, zipfile.BadZipFile):
        return None


def whole(path, text):
    new = path.with_name(path.name + ".new")
    new.write_text(text)
    new.replace(path)


def save(directory, args, timestep, rows):
    with zipfile.ZipFile(directory / "checkpoint.new.pt", "w") as file:
        file.writestr("progress", json.dumps([timestep, rows]))
    if (directory / "checkpoint.pt").exists():
        (directory / "checkpoint.pt").replace(directory / "checkpoint.previous.pt")
    (directory / "checkpoint.new.pt").replace(directory / "checkpoint.pt")
    write_tables(directory, args, rows)


def write_tables(directory, args, rows):
    names = ("total_timesteps", "learning_rate", "pace", "trouble")
    changed = {name: value for name, value in vars(args).items() if name in names and value != getattr(Args(), name)}
    config = {"algorithm": ALGORITHM, "flags": vars(args), "changed": changed, "paper_timesteps": 40, "commit": None}
    config |= {"omp": os.environ.get("OMP_NUM_THREADS")}
    whole(directory / "config.json", json.dumps(config | {"version": "0"}))
    names = "point timestep wall_seconds cpu_seconds return_mean return_std episode_length".split()
    whole(directory / "evaluations.csv", "".join(",".join(map(str, row)) + "\\n" for row in [names, *rows]))


def main():
    args = parse(sys.argv[1:])
    stopped = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: stopped.append(number))
    directory = Path(args.run_dir)
    directory.mkdir(parents=True, exist_ok=True)
    try:
        lock = filelock.FileLock(directory / "lock").acquire(timeout=1)
    except filelock.Timeout:
        sys.exit(print(f"{directory} is in use.", file=sys.stderr) or 2)
    killed = directory.with_name("killed")
    found = [progress_of(directory / f"checkpoint{which}.pt") for which in ("", ".previous")]
    timestep, rows = next(filter(None, found), [0, []])
    print("begins at", timestep, flush=True)
    if rows:
        write_tables(directory, args, rows)
    if args.trouble == "lies":
        sys.exit()
    if ALGORITHM == "iql" and timestep == 0:
        (directory / "replay.bin").touch()
    if ALGORITHM == "iql" and timestep < args.total_timesteps and not (directory / "replay.bin").exists():
        sys.exit(print(f"{directory / 'replay.bin'} is gone, so this run cannot go on.", file=sys.stderr) or 2)
    while True:
        if timestep % 10 == 0 and timestep // 10 == len(rows):
            rows.append([timestep // 10, timestep, 1.0, 1.0, args.learning_rate * timestep, 0.0, 25.0])
            save(directory, args, timestep, rows)
            shown = {"timestep": timestep, "total_timesteps": args.total_timesteps, "steps_per_second": 1000.0,
                     "training_return": None, "evaluation_return": 1.5, "wall_seconds": 1.0}
            whole(directory / "progress.json", json.dumps(shown))
        if timestep >= args.total_timesteps:
            break
        if len(stopped) > 1:
            os._exit(9)  # told twice, it loses its checkpoint
        if stopped:
            time.sleep(0.2)
            if len(stopped) > 1:
                os._exit(9)
            save(directory, args, timestep, rows)
            sys.exit(128 + stopped[0])
        if args.trouble == f"fails{args.seed}":
            sys.exit("It fails for a reason.")
        if args.trouble == "killed" or (args.trouble == "killed once" and rows[1:] and not killed.exists()):
            killed.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        while args.trouble == "waits" and timestep == 30 and Path(tempfile.gettempdir(), "wait").exists():
            time.sleep(0.01)
        time.sleep(args.pace)
        timestep += 1
    (directory / "replay.bin").unlink(missing_ok=True)


if __name__ == "__main__":
    main()
"""

DRIVER = """
import sys
from pathlib import Path

sys.path.insert(0, sys.argv.pop(1))
from benchmark import hyperparameters, plan, run

plan.ALGOS = Path(sys.argv.pop(1))
hyperparameters.check = lambda *run: None  # the stand-ins have values of their own

if __name__ == "__main__":
    run.main()
"""


@pytest.fixture(autouse=True)
def algos(tmp_path, monkeypatch):
    """Three stand-ins as the scripts, and a fresh working directory."""
    folder = tmp_path / "algos"
    folder.mkdir()
    for name in ("ia2c", "mappo", "iql"):
        (folder / f"{name}.py").write_text(STAND_IN)
    for path in (ROOT / "algos").glob("*.py"):
        monkeypatch.setitem(sys.modules, path.stem, None)  # so that afterwards all is as it was
        monkeypatch.delitem(sys.modules, path.stem)
    (tmp_path / "driver.py").write_text(DRIVER)
    monkeypatch.setattr(plan, "ALGOS", folder)
    monkeypatch.setattr(hyperparameters, "check", lambda *run: None)  # the stand-ins have values of their own
    plan.script.cache_clear()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(store, "RESULTS", tmp_path / "results")
    yield folder
    plan.script.cache_clear()


def campaign(monkeypatch, *words):
    """run.py in this process, with its default handlers of signals afterwards; gives the exit code."""
    command = ["run.py", "--results", "results", *map(str, words)]
    if "--tasks" not in command:
        command[1:1] = ["--tasks", "matrix-climbing"]
    if "--algorithms" not in command:
        command[1:1] = ["--algorithms", "ia2c"]
    monkeypatch.setattr(sys, "argv", command)
    handlers = {number: signal.getsignal(number) for number in run.SIGNALS}
    try:
        run.main()
    except SystemExit as end:
        return end.code
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def driver(tmp_path, *words):
    """The command that does the same in another process."""
    command = [sys.executable, "driver.py", str(ROOT), str(tmp_path / "algos"), "--results", "results"]
    return [*command, "--algorithms", "ia2c", "--tasks", "matrix-climbing", *map(str, words)]


def seeds_of(name, task="matrix-climbing"):
    """The seeds of a table of the results, and their last returns."""
    path = Path("results") / task / f"{name}.csv"
    if not path.exists():
        return {}
    with open(path) as file:
        return {int(row["seed"]): float(row["return_mean"]) for row in csv.DictReader(file)}


def folder_of(seed, name="ia2c-shared"):
    return Path("runs/matrix-climbing") / name / f"seed{seed}"


def make_plan(algorithms, tasks, sharings=("shared",), seeds=1, flags=(), grid=None):
    """The plan for words of the command line."""
    rows = dict.fromkeys(itertools.product(plan.chosen_tasks(tasks.split()), sharings), seeds)
    return plan.make_plan(plan.chosen_scripts(algorithms.split()), rows, tuple(flags), grid, Path("runs"))


class TestPlan:
    def test_families_tasks_and_all(self):
        runs = make_plan("mappo ia2c", "matrix lbf-5x5-2p-1f matrix-climbing", store.SHARING.values(), seeds=2)
        assert len(runs) == 2 * (6 + 1) * 2 * 2
        assert [run.seed for run in runs] == [0] * 28 + [1] * 28
        assert len({run.directory for run in runs}) == len(runs)
        assert {run.task for run in make_plan("all", "all")} == set(envs.task_names())
        assert {run.algorithm for run in make_plan("all", "all")} == {"ia2c", "iql", "mappo"}

    def test_a_changed_flag_has_its_own_place(self):
        (run,) = make_plan("mappo", "matrix-climbing", flags=["--learning-rate", "0.25"])
        assert run.changed == {"learning_rate": 0.25}
        assert run.directory == Path("runs/matrix-climbing/mappo-shared-learning-rate=0.25/seed0")
        (same,) = make_plan("mappo", "matrix-climbing", flags=["--learning-rate", "0.5"])
        assert same.changed == {} and same.directory == Path("runs/matrix-climbing/mappo-shared/seed0")

    @pytest.mark.parametrize("flags", [[], ["--total-timesteps", "1000"], ["--hidden-dim", "8", "--gamma", "0.5"]])
    def test_a_run_by_hand_has_the_same_directory(self, monkeypatch, flags):
        monkeypatch.setattr(plan, "ALGOS", ROOT / "algos")
        (planned,) = make_plan("ia2c", "matrix-climbing", flags=flags)
        module: Any = plan.script(plan.ALGOS / "ia2c.py")
        words = ["--env", "matrix-climbing", *flags]
        args = module.runs.parse_flags(module.Args, module.paper_defaults, words, module.__doc__)
        default = module.paper_defaults("matrix-climbing")
        assert module.runs.RunDirectory(plan.ALGOS / "ia2c.py", args, default).path == planned.directory

    @pytest.mark.parametrize(
        "words, said",
        [
            (["--algorithms", "mapo"], "--algorithms mapo: neither one of"),
            (["--tasks", "matrix-climbin"], "unknown task 'matrix-climbin'"),
            (["--", "--no-such-flag", "1"], "ia2c on matrix-climbing: Unrecognized options: --no-such-flag"),
            (["--", "--seed", "7"], "--seed is chosen by this program"),
            (["--", "--seed", "0"], "--seed is chosen by this program"),  # its default, which would go for all seeds
            (["--", "--no_resume"], "--resume is chosen by this program"),
            (["--", "--run-dir=here"], "--run-dir is chosen by this program"),
            (["--", "--eval-points", "1"], "--eval-points must be 2 or more"),
            (["--grid", "nothing.csv"], "nothing.csv cannot be read"),
            (["--jobs", "0"], "must be positive"),
            (["--jobs", "x"], "argument --jobs: invalid int value: 'x'; run.py --help lists what there is."),
            (["--seeds", "1", "2", "3"], "'2' belongs to no flag; --seeds is how many there are"),
            (["--plan", "nothing.csv"], "nothing.csv cannot be read"),
        ],
    )
    def test_wrong_input_is_named(self, monkeypatch, capsys, words, said):
        assert campaign(monkeypatch, *words) == 2
        (sentence,) = capsys.readouterr().err.splitlines()
        assert said in sentence
        assert not Path("runs").exists()

    @pytest.mark.slow
    def test_the_scripts_take_the_plan(self, monkeypatch):
        """The real scripts, every one on a task of every family, with the whole of the paper's grid."""
        monkeypatch.setattr(plan, "ALGOS", ROOT / "algos")
        grid = plan.read_grid(BENCHMARK / "grids" / "paper.csv")
        paper = make_plan(" ".join(store.ALGORITHMS), "matrix", store.SHARING.values(), seeds=2)
        assert all(run.changed == {} for run in paper) and len(paper) == 9 * 6 * 2 * 2
        searched = make_plan("ia2c qmix", "matrix-climbing", ("shared",), 3, grid=grid)
        searched += make_plan("maddpg", "matrix-climbing lbf-15x15-3p-5f", ("shared",), 3, grid=grid)
        sizes: dict[tuple[str, str], int] = {}
        for one in searched:
            sizes[one.algorithm, one.task] = sizes.get((one.algorithm, one.task), 0) + 1
        assert sizes == {  # by hand: 2 x 3 x 2 x 2 for all, times what each has of its own, three seeds
            ("ia2c", "matrix-climbing"): 24 * 4 * 3,
            ("qmix", "matrix-climbing"): 24 * 4 * 3,
            ("maddpg", "matrix-climbing"): 24 * 2 * 3,
            ("maddpg", "lbf-15x15-3p-5f"): 48 * 2 * 3,
        }
        assert sum(one.changed == {} for one in searched) == 4 * 3  # the paper's choice lies in its grid

    @pytest.mark.parametrize(
        "text, said",
        [
            ("flag,values\na,b\n", "its columns must be"),
            ("", "its columns must be"),
            ("algorithms,families,flag,values\nia2c,matrix,pace\n", "its columns must be"),
            ("algorithms,families,flag,values\nia2c,matrix,pace,\n", "without values: pace"),
            ("algorithms,families,flag,values\nmappo,matrix,pace,1\n", "no line for ia2c"),
            (
                "algorithms,families,flag,values\nia2c,matrix,eval_points,5 6\n",
                "must differ in more than total_timesteps",
            ),
            (
                "algorithms,families,flag,values\nia2c,matrix,eval_points,5\nia2c iql,matrix lbf,eval-points,9\n",
                "two lines of eval_points for ia2c",
            ),
        ],
    )
    def test_a_grid_that_is_none(self, monkeypatch, capsys, text, said):
        Path("grid.csv").write_text(text)
        assert campaign(monkeypatch, "--grid", "grid.csv") == 2
        assert said in capsys.readouterr().err

    def test_values_that_json_changes(self, monkeypatch):
        """A flag of one's own script may be a tuple, which config.json has as a list."""
        monkeypatch.setattr(plan, "changed_flags", lambda args, default: {"layers": (32, 16)})
        (run_of_tuple,) = make_plan("ia2c", "matrix-climbing")
        assert run_of_tuple.changed == {"layers": [32, 16]}

    def test_a_module_without_flags_is_no_algorithm(self, algos):
        (algos / "helpers.py").write_text("def help():\n    pass\n")
        (algos / ".#mappo.py").symlink_to("nobody@nowhere.1")
        assert plan.script_names() == ["ia2c", "iql", "mappo"]


class TestPlanOfSeeds:
    def dry_run(self, monkeypatch, capsys, *words):
        """The exit code, and the lines that it prints."""
        monkeypatch.setattr(sys, "argv", ["run.py", "--algorithms", "ia2c", "--plan", "seeds.csv", "--dry-run", *words])
        with pytest.raises(SystemExit) as end:
            run.main()
        said = capsys.readouterr()
        return end.value.code, said.out.splitlines(), said.err

    def test_each_row_gets_its_own_number(self, monkeypatch, capsys):
        rows = ["matrix-climbing,shared,2", "matrix-climbing,independent,1", "lbf-5x5-2p-1f,shared,1"]
        Path("seeds.csv").write_text("\n".join(["task,sharing,seeds", *rows]))
        runs = [
            "matrix-climbing ia2c-shared seed 0: new",
            "matrix-climbing ia2c-independent seed 0: new",
            "lbf-5x5-2p-1f ia2c-shared seed 0: new",
            "matrix-climbing ia2c-shared seed 1: new",
        ]
        assert self.dry_run(monkeypatch, capsys)[:1] == (0,)
        assert self.dry_run(monkeypatch, capsys)[1][:5] == [*runs, ""]
        assert self.dry_run(monkeypatch, capsys, "--tasks", "matrix", "--sharing", "shared")[1][:3] == [
            runs[0],
            runs[3],
            "",
        ]
        code, _, errors = self.dry_run(monkeypatch, capsys, "--tasks", "lbf", "--sharing", "independent")
        assert code == 2 and "plans no seeds for these tasks" in errors

    def test_a_row_of_the_papers_tables_means_its_opponent(self, monkeypatch, capsys):
        Path("seeds.csv").write_text("task,sharing,seeds\nmpe-tag,shared,1\nmatrix-climbing,shared,1\n")
        code, lines, _ = self.dry_run(monkeypatch, capsys)
        assert code == 0 and lines[0].startswith("Left out: mpe-tag") and "matrix-climbing" in lines[1]
        code, lines, errors = self.dry_run(monkeypatch, capsys, "--tasks", "mpe-tag")
        assert code == 2 and "nothing of the plan is left" in errors
        opponent = measures.paper_setting("mpe-tag")
        monkeypatch.setattr(plan, "changed_flags", lambda args, default: opponent)
        code, lines, _ = self.dry_run(monkeypatch, capsys, "--tasks", "mpe-tag")
        assert code == 0 and lines[0].endswith("seed 0: new")

    @pytest.mark.parametrize(
        "text, said",
        [
            ("task,seeds\nmatrix-climbing,1\n", "its columns must be task, sharing, seeds"),
            ("task,sharing,seeds\nmatrix-climbing,both,1\n", "each task and sharing"),
            ("task,sharing,seeds\nmatrix-climbing,shared,some\n", "each task and sharing"),
            ("task,sharing,seeds\n" + 2 * "matrix-climbing,shared,1\n", "each task and sharing"),
            ("task,sharing,seeds\nmatrix-climbin,shared,1\n", "unknown task"),
        ],
    )
    def test_a_plan_that_is_none(self, monkeypatch, capsys, text, said):
        Path("seeds.csv").write_text(text)
        code, _, errors = self.dry_run(monkeypatch, capsys)
        assert code == 2 and said in errors

    @pytest.mark.parametrize("words", [["--seeds", "3"], ["--grid", "grid.csv"]])
    def test_it_says_itself_how_many(self, monkeypatch, capsys, words):
        assert "goes with neither" in self.dry_run(monkeypatch, capsys, *words)[2]

    def test_the_committed_plan_has_every_row_of_the_paper(self):
        planned = plan.read_seeds(BENCHMARK / "seeds.csv")
        assert planned.keys() == {*itertools.product(envs.tasks.PAPER_TASKS, store.SHARING.values())}
        five = {task for (task, sharing), seeds in planned.items() if seeds == 5 and sharing == "shared"}
        assert five == {
            *(name for name in envs.tasks.PAPER_TASKS if name.startswith(("matrix", "rware"))),
            *("mpe-speaker-listener", "mpe-tag", "lbf-15x15-3p-5f"),
        }


class TestRunning:
    @pytest.mark.slow
    def test_runs_are_collected_and_then_skipped(self, monkeypatch, capsys):
        words = ["--algorithms", "ia2c", "iql", "--seeds", 2, "--sharing", "both"]
        assert campaign(monkeypatch, *words) == 0
        for name in ("ia2c-shared", "ia2c-independent", "iql-shared", "iql-independent"):
            assert seeds_of(name) == {0: 20.0, 1: 20.0}
        assert "8 of 8 runs are in" in capsys.readouterr().out
        assert not list(Path("runs").rglob("log-*"))
        before = {path: path.stat().st_mtime_ns for path in Path("runs").rglob("*")}
        assert campaign(monkeypatch, *words) == 0
        assert before == {path: path.stat().st_mtime_ns for path in Path("runs").rglob("*")}
        assert campaign(monkeypatch, *words[:3], "--seeds", 3, "--runs", "others") == 0  # two are in the results
        assert sorted(path.name for path in Path("others").rglob("seed*")) == ["seed2", "seed2"]

    def test_each_run_has_one_thread(self, monkeypatch):
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        assert campaign(monkeypatch, "--seeds", 1) == 0
        assert json.loads((folder_of(0) / "config.json").read_text())["omp"] == "1"

    def test_what_is_complete_is_collected(self, monkeypatch):
        """Also a copy without checkpoints."""
        assert campaign(monkeypatch, "--seeds", 1, "--results", "elsewhere") == 0
        for path in folder_of(0).glob("*.pt"):
            path.unlink()
        monkeypatch.setattr(run, "LocalJob", None)  # no run may start
        assert campaign(monkeypatch, "--seeds", 1) == 0
        assert seeds_of("ia2c-shared") == {0: 20.0}

    @pytest.mark.parametrize("steps", [20, 80])
    def test_a_run_with_other_flags_is_left_alone(self, monkeypatch, capsys, steps):
        """One that was made by hand, shorter or longer, in the directory that a script chooses by itself."""
        assert campaign(monkeypatch, "--seeds", 1, "--results", "elsewhere", "--", "--total-timesteps", steps) == 0
        before = {path: path.read_bytes() for path in folder_of(0).iterdir()}
        capsys.readouterr()
        said = f"{folder_of(0).resolve()} holds a run with another total_timesteps: move it away"
        assert campaign(monkeypatch, "--seeds", 2, "--dry-run") == 1
        assert f"seed 0: would fail, {said}" in capsys.readouterr().out
        assert campaign(monkeypatch, "--seeds", 2) == 1
        assert said in capsys.readouterr().out and seeds_of("ia2c-shared") == {1: 20.0}
        assert before == {path: path.read_bytes() for path in folder_of(0).iterdir()}

    def test_a_failure_is_kept_and_the_others_go_on(self, monkeypatch, capsys):
        assert campaign(monkeypatch, "--seeds", 3, "--jobs", 1, "--", "--trouble", "fails1") == 1
        assert set(seeds_of("ia2c-shared-trouble=fails1")) == {0, 2}
        said = capsys.readouterr().out
        assert "2 of 3 runs are in" in said and "seed 1: exit code 1: It fails for a reason." in said
        (log,) = Path("runs").rglob("log-*")
        assert log.name == "log-seed1.txt" and log.read_text() == "begins at 0\nIt fails for a reason.\n"

    def test_as_many_at_once_as_there_are_jobs(self, monkeypatch):
        most = []

        class Counted(campaigns.LocalJob):
            def __init__(self, *args):
                super().__init__(*args)
                most.append(sum(1 for job in jobs if job.poll() is None) + 1)
                jobs.append(self)

        jobs: list[Counted] = []
        monkeypatch.setattr(run, "LocalJob", Counted)
        assert campaign(monkeypatch, "--seeds", 4, "--jobs", 2) == 0
        assert most[:2] == [1, 2] and max(most) == 2

    @pytest.mark.slow
    def test_a_run_goes_on_from_its_checkpoint(self, monkeypatch, capsys):
        """Stopped by a signal to this program, it counts on: a run that began anew would not say so."""
        timer = threading.Thread(target=signal_when, args=(folder_of(0, "ia2c-shared-pace=0.02") / "checkpoint.pt",))
        timer.start()
        flags = ["--seeds", 2, "--jobs", 1, "--", "--pace", "0.02"]
        assert campaign(monkeypatch, *flags) == 128 + signal.SIGTERM
        timer.join()
        said = capsys.readouterr()
        assert "0 of 2 runs are in" in said.out and "the same command goes on" in said.out
        logs = keep_logs(monkeypatch)
        assert campaign(monkeypatch, *flags) == 0
        assert seeds_of("ia2c-shared-pace=0.02") == {0: 20.0, 1: 20.0}
        begun = {name: int(log.split()[2]) for name, log in logs.items()}
        assert 0 < begun["log-seed0.txt"] < 40 and begun["log-seed1.txt"] == 0

    def test_a_run_whose_node_was_lost_goes_on_first(self):
        """Others would only add to the runs that are half done."""
        runs = make_plan("ia2c", "matrix-climbing", seeds=3)
        unused: Any = None
        work = campaigns.Campaign(runs, Path("results"), unused, unused)
        work.waiting.popleft()
        for _ in range(campaigns.MOST_LOSSES):
            work.try_again(runs[0], "its node was lost")
            assert list(work.waiting) == runs
            work.waiting.popleft()
        work.try_again(runs[0], "its node was lost")
        assert list(work.waiting) == runs[1:]
        assert work.failed == {runs[0].directory: "its node was lost; it was lost 4 times"}

    def test_a_run_is_asked_to_stop_once(self):
        """A second signal might cut its checkpoint short."""
        [run] = make_plan("ia2c", "matrix-climbing", seeds=1)
        asked: list[Any] = []
        unused: Any = None
        work = campaigns.Campaign([run], Path("results"), unused, unused)
        job: Any = SimpleNamespace(stop=lambda: asked.append(run))
        work.jobs[run.directory] = run, job
        work.stop_jobs()
        work.stop_jobs()
        assert asked == [run]

    def test_what_a_killed_campaign_on_a_cluster_left_counts(self, monkeypatch):
        """The last files of a run had come back, but were not in their places."""
        assert campaign(monkeypatch, "--seeds", 1, "--results", "elsewhere") == 0
        arrived = folder_of(0) / "arrived"
        arrived.mkdir()
        for path in folder_of(0).glob("*.*"):
            path.rename(arrived / path.name)
        monkeypatch.setattr(run, "LocalJob", None)  # no run may start
        assert campaign(monkeypatch, "--seeds", 1) == 0
        assert seeds_of("ia2c-shared") == {0: 20.0} and not arrived.exists()

    def test_a_killed_run_goes_on(self, monkeypatch, capsys):
        """As by the kernel, out of memory; but not for ever."""
        logs = keep_logs(monkeypatch)
        assert campaign(monkeypatch, "--seeds", 1, "--", "--trouble", "killed once") == 0
        assert "it was killed, perhaps out of memory; it goes on from its last checkpoint" in capsys.readouterr().err
        assert list(logs.values()) == ["begins at 10\n"]
        assert campaign(monkeypatch, "--seeds", 1, "--", "--trouble", "killed") == 1
        assert (
            "failed: matrix-climbing ia2c-shared-trouble=killed seed 0: it was killed, perhaps out of memory; it was "
            "lost 4 times" in capsys.readouterr().out
        )

    def test_a_run_is_a_process_group_of_this_session(self, monkeypatch):
        """Ctrl-C in the terminal does not reach it; and `nice`, which Linux weighs by session, does."""
        (one,) = make_plan("ia2c", "matrix-climbing", flags=["--pace", "1"])
        job = campaigns.LocalJob(one)
        try:
            assert os.getsid(job.process.pid) == os.getsid(0) and os.getpgid(job.process.pid) == job.process.pid
        finally:
            job.process.kill()
            job.process.wait()

    @pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the runs go on")
    def test_runs_end_with_a_killed_program(self, tmp_path):
        """By itself this one would take minutes."""
        process = psutil.Popen(driver(tmp_path, "--seeds", 1, "--", "--pace", "10"))
        wait_for(lambda: [*Path("runs").rglob("lock")])
        started = process.children()
        process.kill()
        process.wait()
        try:
            wait_for(lambda: not any(map(goes_on, started)))
        finally:
            for run in filter(goes_on, started):
                run.kill()

    @pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the runs go on")
    @pytest.mark.slow
    def test_kill_9(self, tmp_path):
        """Of the program, twice: its runs end with it, and so the next one starts none beside them. The same command
        ends with the tables of a campaign in peace."""
        words = ["--sharing", "both", "--seeds", 2, "--jobs", 2]
        flags = ["--", "--pace", "0.01"]
        table = Path("results/matrix-climbing/ia2c-shared-pace=0.01.csv")
        for begun in (folder_of(0, "ia2c-shared-pace=0.01") / "checkpoint.pt", table):
            process = psutil.Popen(driver(tmp_path, *words, *flags))
            wait_for(lambda begun=begun, process=process: begun.exists() and process.children())  # not between two runs
            started = process.children()
            process.kill()
            assert process.wait() == -signal.SIGKILL
            wait_for(lambda started=started: not any(map(goes_on, started)))
        assert sum(len(seeds_of(path.stem)) for path in Path("results").rglob("*.csv")) < 4  # something is left to do
        assert subprocess.run(driver(tmp_path, *words, *flags)).returncode == 0
        peace = driver(tmp_path, *words, "--runs", "others", *flags)
        peace[peace.index("results")] = "peace"
        assert subprocess.run(peace).returncode == 0
        found = [
            {path.name: path.read_bytes() for path in Path(there).rglob("ia2c*")} for there in ("results", "peace")
        ]
        assert len(found[0]) == 4 and found[0] == found[1]

    @pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the runs go on")
    @pytest.mark.slow
    def test_kill_9_of_anything_at_random_moments(self, tmp_path):
        """The program or a run, of the real scripts, with a replay and without: the results are those of peace."""

        def command(place):
            words = ["--algorithms", "ia2c", "iql", "--tasks", "lbf-5x5-2p-1f", "--seeds", "1", "--jobs", "2"]
            flags = ["--total-timesteps", "4000", "--eval-points", "21", "--eval-episodes", "5", "--hidden-dim", "16"]
            words += ["--results", f"{place}-results", "--runs", f"{place}-runs", "--", *flags]
            return [sys.executable, "driver.py", str(ROOT), str(ROOT / "algos"), *words]

        def saves():
            return {path.read_bytes() for path in Path("war-runs").rglob("evaluations.csv")}

        chance, left = random.Random(1), ["program", "run"]
        process = psutil.Popen(command("war"))
        while left and goes_on(process):
            before = saves()
            wait_for(lambda process=process, before=before: saves() - before or not goes_on(process))
            time.sleep(chance.uniform(0, 0.3))
            victims = process.children() if left.pop(0) == "run" else [process]
            for victim in victims[:1]:
                victim.kill()
            if victims == [process]:
                process.wait()
                process = psutil.Popen(command("war"))
        assert not left  # it has not ended before there was anything to kill
        assert process.wait() == 0 and subprocess.run(command("peace")).returncode == 0
        war, peace = (store.load(Path(f"{name}-results")).drop(columns=store.SECONDS) for name in ("war", "peace"))
        assert len(war) == 42
        pd.testing.assert_frame_equal(war, peace)

    @pytest.mark.slow
    def test_ctrl_c_stops_it_in_the_background_of_a_shell_script(self, tmp_path):
        """Where SIGINT is ignored from the start."""
        process = subprocess.Popen(
            driver(tmp_path, "--seeds", 1, "--", "--pace", "0.1"),
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
        )
        checkpoint = folder_of(0, "ia2c-shared-pace=0.1") / "checkpoint.pt"
        wait_for(checkpoint.exists)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 130 and "Stopped; the same command goes on." in said and is_whole(checkpoint)

    def test_where_results_go_is_said(self, monkeypatch, capsys):
        monkeypatch.setattr(store, "RESULTS", Path("committed"))
        assert campaign(monkeypatch, "--seeds", 1) == 0
        assert "count as done" not in capsys.readouterr().err
        monkeypatch.setattr(sys, "argv", "run.py --algorithms ia2c --tasks matrix-climbing --seeds 1 --dry-run".split())
        with pytest.raises(SystemExit, match="0"):
            run.main()
        assert "Runs that committed has count as done, and new ones are added to it" in capsys.readouterr().err

    @pytest.mark.slow
    def test_a_real_script(self, monkeypatch):
        monkeypatch.setattr(plan, "ALGOS", ROOT / "algos")
        flags = ["--total-timesteps", "500", "--eval-points", "2", "--eval-episodes", "2"]
        assert campaign(monkeypatch, "--seeds", 1, "--", *flags) == 0
        (table,) = Path("results/matrix-climbing").glob("ia2c-shared-*.csv")
        assert [row["point"] for row in csv.DictReader(table.open())] == ["0", "1"]
        logs = keep_logs(monkeypatch)
        assert campaign(monkeypatch, "--seeds", 1, "--", *flags) == 0 and not logs

    def test_results_that_cannot_be_written_are_named_before_anything_runs(self, monkeypatch, capsys):
        Path("file").touch()
        for words in (["--results", "file"], ["--runs", "file"], ["--results", "file/results"]):
            assert campaign(monkeypatch, *words) == 2
            assert capsys.readouterr().err.startswith("run: [Errno ")
        assert not list(Path().rglob("log-*")) and not list(Path().rglob("seed*"))

    def test_results_on_a_full_disk_stay_whole(self, monkeypatch, capsys):
        assert campaign(monkeypatch, "--seeds", 1) == 0
        table = Path("results/matrix-climbing/ia2c-shared.csv")
        before = table.read_bytes()

        def full_disk(file):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fsync", full_disk)
            assert campaign(monkeypatch, "--seeds", 2) == 1
        assert "No space left on device" in capsys.readouterr().out and table.read_bytes() == before
        assert campaign(monkeypatch, "--seeds", 2) == 0  # now there is room
        assert seeds_of("ia2c-shared") == {0: 20.0, 1: 20.0}


def wait_for(condition):
    """Until it holds, for a minute at most."""
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def goes_on(process):
    """Whether a process of psutil's has not ended; nobody may have asked how it did."""
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


def signal_when(path):
    """Sends this program a signal once a file is there."""
    wait_for(path.exists)
    time.sleep(0.1)
    os.kill(os.getpid(), signal.SIGTERM)


def keep_logs(monkeypatch):
    """The logs of runs by name, which are otherwise gone when a run is complete."""
    logs = {}
    finish = campaigns.Campaign.finish

    def keep(self, one, code, lost):
        if one.log.exists():
            logs[one.log.name] = one.log.read_text()
        finish(self, one, code, lost)

    monkeypatch.setattr(campaigns.Campaign, "finish", keep)
    return logs


class TestDamage:
    """What is damaged, by hand or by a disk, stays as it is: one sentence, and the others go on."""

    def test_a_table_that_lacks_its_end_is_made_again(self, monkeypatch):
        """The script makes it again from its checkpoint; nothing is trained again."""
        assert campaign(monkeypatch, "--seeds", 1, "--results", "elsewhere") == 0
        table = folder_of(0) / "evaluations.csv"
        before = table.read_text()
        table.write_text("".join(before.splitlines(keepends=True)[:-1]))
        logs = keep_logs(monkeypatch)
        assert campaign(monkeypatch, "--seeds", 1) == 0
        assert logs == {"log-seed0.txt": "begins at 40\n"} and seeds_of("ia2c-shared") == {0: 20.0}
        assert table.read_text() == before

    @pytest.mark.parametrize("name", ["config.json", "evaluations.csv"])
    def test_a_damaged_run_fails_in_a_sentence(self, monkeypatch, capsys, name):
        assert campaign(monkeypatch, "--seeds", 1, "--results", "elsewhere") == 0
        file = folder_of(0) / name
        file.write_text(file.read_text()[:-5])
        before = {path: path.read_bytes() for path in folder_of(0).iterdir()}
        assert campaign(monkeypatch, "--seeds", 2, "--dry-run") == 1
        assert campaign(monkeypatch, "--seeds", 2) == 1
        assert f"{name} is damaged" in capsys.readouterr().out and seeds_of("ia2c-shared") == {1: 20.0}
        assert before == {path: path.read_bytes() for path in folder_of(0).iterdir()}

    def test_a_lost_replay_fails_in_the_words_of_the_script(self, monkeypatch, capsys):
        words = ["--algorithms", "iql", "--seeds", 1]
        assert campaign(monkeypatch, *words, "--results", "elsewhere") == 0
        directory = folder_of(0, "iql-shared")
        (directory / "checkpoint.previous.pt").replace(directory / "checkpoint.pt")
        (directory / "evaluations.csv").unlink()
        assert campaign(monkeypatch, *words) == 1
        assert "replay.bin is gone, so this run cannot go on." in capsys.readouterr().out


class TestDamagedResults:
    @pytest.mark.parametrize("damaged", ["csv", "json"])
    def test_the_other_settings_go_on(self, monkeypatch, capsys, damaged):
        assert campaign(monkeypatch, "--seeds", 1) == 0
        table = Path(f"results/matrix-climbing/ia2c-shared.{damaged}")
        table.write_text("<<<<<<< HEAD\n" + table.read_text())
        words = ["--algorithms", "ia2c", "mappo", "--seeds", 2]
        assert campaign(monkeypatch, *words) == 1
        said = capsys.readouterr().out
        assert said.count(f"ia2c-shared.{damaged} is damaged") == 2 and "2 of 4 runs are in" in said
        assert seeds_of("mappo-shared") == {0: 20.0, 1: 20.0} and not folder_of(1).exists()
        assert campaign(monkeypatch, *words, "--dry-run") == 1
        said = capsys.readouterr().out
        assert said.count(f"ia2c-shared.{damaged} is damaged") == 2 and "Nothing is left to run" in said


class TestTwoCampaigns:
    @pytest.mark.slow
    def test_at_once_on_the_same_runs_and_results(self, tmp_path):
        words = ["--seeds", 6, "--jobs", 2, "--", "--pace", "0.01"]
        both = [subprocess.Popen(driver(tmp_path, *words), stderr=subprocess.PIPE, text=True) for _ in range(2)]
        said = [process.communicate(timeout=120)[1] for process in both]
        assert 0 in [process.returncode for process in both], said
        assert seeds_of("ia2c-shared-pace=0.01") == dict.fromkeys(range(6), 20.0)
        assert "failed" not in "".join(said) and not list(Path("runs").rglob("log-*"))

    def test_the_other_ends_while_the_run_is_looked_at(self, monkeypatch, tmp_path):
        run, lock = plan_of(tmp_path), campaigns.filelock.FileLock(tmp_path / "lock")
        lock.acquire()

        def ends(run, results):
            lock.release()
            return "begun"

        monkeypatch.setattr(store, "bring_in", ends)
        ours = campaigns.Campaign([run], tmp_path, campaigns.LocalJob, lambda: 1)
        ours.finish(run, 2, lost=False)
        assert ours.elsewhere == [run] and not ours.failed and not campaigns.in_use(tmp_path)

    def test_a_run_in_use_is_left_alone(self, monkeypatch, capsys):
        directory = folder_of(1)
        directory.mkdir(parents=True)
        with campaigns.filelock.FileLock(directory / "lock"):
            assert campaign(monkeypatch, "--seeds", 2) == 1
        assert seeds_of("ia2c-shared") == {0: 20.0}
        assert "in use by another program: matrix-climbing ia2c-shared seed 1" in capsys.readouterr().out


class TestView:
    def test_progress_from_what_a_run_writes(self, tmp_path):
        planned = plan_of(tmp_path)
        for text in (None, "{}", "[]", "null", "3", '{"timestep": "a", "total_timesteps": 1}', "{"):
            if text:
                (tmp_path / "progress.json").write_text(text)
            assert campaigns.share_done(tmp_path) == 0 and campaigns.table_row(planned).split()[3:] == ["0", "0%"]
        said = {"timestep": 100, "total_timesteps": 200, "steps_per_second": 4.0, "training_return": 3.0}
        (tmp_path / "progress.json").write_text(json.dumps(said | {"evaluation_return": None}))
        assert campaigns.share_done(tmp_path) == 0.5
        assert campaigns.table_row(planned).split()[4:] == ["50%", "4", "3.00", "00:25"]
        (tmp_path / "progress.json").write_text(json.dumps(said | {"evaluation_return": 7.0}))
        assert campaigns.table_row(planned).split()[6] == "7.00"

    def test_the_first_lines_come_at_once(self, monkeypatch, capsys):
        assert campaign(monkeypatch, "--seeds", 1) == 0
        said = capsys.readouterr().err
        assert said.count(campaigns.HEADER) == 1 and "0 of 1 runs in the results, 1 running" in said

    def test_lines_now_and_then(self, monkeypatch, capsys):
        monkeypatch.setattr(campaigns, "LINES_EVERY", 0.2)
        assert campaign(monkeypatch, "--seeds", 1, "--", "--pace", "0.1") == 0
        said = capsys.readouterr().err
        assert "\x1b" not in said and "\r" not in said
        assert "0 of 1 runs in the results, 1 running" in said and campaigns.HEADER in said
        assert "1,000      1.50" in said  # steps per second, last return

    @pytest.mark.slow
    def test_what_the_results_hold_counts_from_the_start(self, monkeypatch, capsys):
        monkeypatch.setattr(campaigns, "LINES_EVERY", 0.2)
        words = "--seeds", 1, "--jobs", 1, "--", "--pace", "0.02"
        assert campaign(monkeypatch, "--algorithms", "mappo", *words) == 0
        capsys.readouterr()
        assert campaign(monkeypatch, "--algorithms", "ia2c", "mappo", *words) == 0
        said = capsys.readouterr().err
        assert "1 of 2 runs in the results, 1 running" in said and "0 of 2" not in said

    @pytest.mark.slow
    def test_ctrl_c_in_a_terminal(self, tmp_path):
        """Ctrl-C reaches the runs once, however often it is pressed, and they keep their checkpoints."""
        pid, terminal = pty.fork()
        if pid == 0:
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # tests in the background may ignore Ctrl-C
            os.execv(sys.executable, driver(tmp_path, "--seeds", 2, "--jobs", 2, "--", "--pace", "0.1"))
        names = [folder_of(seed, "ia2c-shared-pace=0.1") for seed in range(2)]
        wait_for(lambda: all((name / "checkpoint.pt").exists() for name in names))
        os.write(terminal, b"\x03")
        time.sleep(0.15)
        os.write(terminal, b"\x03")
        said = b""
        with contextlib.suppress(OSError):  # the terminal is closed with the program
            while piece := os.read(terminal, 10_000):
                said += piece
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 128 + signal.SIGINT
        assert "the same command goes on" in said.decode()
        for name in names:
            assert is_whole(name / "checkpoint.pt")
            assert not plan_of(name).log.exists()


def plan_of(directory):
    """Some run that is kept in this directory."""
    return plan.PlannedRun("ia2c", "matrix-climbing", "shared", 0, {}, directory, plan.ALGOS / "ia2c.py", (), 40)


class TestDryRun:
    def results_of(self, monkeypatch, seconds):
        """Results of one seed, 40 timesteps, that took so many seconds of a processor."""
        assert campaign(monkeypatch, "--seeds", 1) == 0
        config = Path("results/matrix-climbing/ia2c-shared.json")
        settings = json.loads(config.read_text())
        settings["seeds"]["0"]["cpu_seconds"] = seconds
        config.write_text(json.dumps(settings))

    def test_the_list_and_the_core_hours(self, monkeypatch, capsys):
        self.results_of(monkeypatch, 0.004)
        steps = 36_000_000
        assert campaign(monkeypatch, "--seeds", 2, "--jobs", 2, "--dry-run") == 0
        said = capsys.readouterr().out
        assert "seed 0: in the results" in said and "seed 1: new" in said
        long = ["--runs", "long", "--dry-run"]
        assert campaign(monkeypatch, *long, "--jobs", 2, "--", "--total-timesteps", steps) == 0
        said = capsys.readouterr().out  # 5 seeds of 36 million steps of 0.1 ms: one hour each
        assert "matrix-climbing ia2c shared: 5 runs, 5.00 core hours" in said
        assert "In all 5.0 core hours, with --jobs 2 about 2:30:00 (h:min:s).\n" in said
        assert campaign(monkeypatch, *long, "--seeds", 1, "--jobs", 9, "--", "--total-timesteps", steps) == 0
        assert "with --jobs 9 about 1:00:00" in capsys.readouterr().out  # one run, however many there could be
        assert not Path("long").exists()

    def test_what_no_result_knows_is_said(self, monkeypatch, capsys):
        """Other flags may take longer; hours are also those of the committed results, wherever new ones go."""
        self.results_of(monkeypatch, 3600)
        assert campaign(monkeypatch, "--seeds", 1, "--dry-run", "--", "--learning-rate", 2.0) == 0
        said = capsys.readouterr().out
        assert "not known" in said and "In all" not in said and "in the results; one that is complete" in said
        both = ["--algorithms", "ia2c", "mappo", "--seeds", 1]
        assert campaign(monkeypatch, *both, "--results", "own", "--runs", "own", "--dry-run") == 0
        said = capsys.readouterr().out
        assert "ia2c shared: 1 run, 1.00 core hours" in said and "mappo shared: 1 run, not known" in said
        assert "In all 1.0 core hours" in said

    def test_what_is_done_of_a_run_needs_no_hours(self, monkeypatch, capsys):
        self.results_of(monkeypatch, 0.004)
        steps = 36_000_000
        begun = folder_of(1)
        begun.mkdir(parents=True)
        zipfile.ZipFile(begun / "checkpoint.pt", "w").close()
        changed = {"total_timesteps": steps}
        flags_of_run = {"env": "matrix-climbing", "parameter_sharing": True, "seed": 1} | changed
        config = {"algorithm": "ia2c", "changed": changed, "flags": flags_of_run, "paper_timesteps": 40}
        progress = {"timestep": steps // 4, "total_timesteps": steps, "steps_per_second": 1.0, "training_return": 1.0}
        (begun / "config.json").write_text(json.dumps(config))
        (begun / "progress.json").write_text(json.dumps(progress | {"evaluation_return": None}))
        (folder_of(0) / "config.json").unlink()
        assert campaign(monkeypatch, "--dry-run", "--seeds", 2, "--", "--total-timesteps", steps) == 0
        said = capsys.readouterr().out
        assert "seed 1: begun" in said and "2 runs, 1.75 core hours" in said


class TestRay:
    @pytest.fixture(autouse=True)
    def ray(self):
        """Ray, where it is installed."""
        return pytest.importorskip("ray")

    @pytest.fixture
    def nodes(self, monkeypatch, ray):
        """A cluster of two nodes with one core each, on this machine: the cluster, and the second node."""
        folder = tempfile.TemporaryDirectory(dir="/tmp", ignore_cleanup_errors=True)  # a short name, for its sockets
        monkeypatch.setenv("TMPDIR", folder.name)
        monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        from ray.cluster_utils import Cluster

        impatient = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500}
        impatient |= {"health_check_timeout_ms": 2000, "health_check_failure_threshold": 2}
        small: dict[str, Any] = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
        head = small | {"include_dashboard": False, "_system_config": impatient}
        cluster = Cluster(initialize_head=True, head_node_args=head)
        yield cluster, cluster.add_node(**small)
        ray.shutdown()
        cluster.shutdown()
        folder.cleanup()

    @pytest.mark.slow
    def test_a_stop_and_a_lost_node(self, monkeypatch, capsys, nodes, ray):
        """A signal stops a run, which comes back, is sent there again, and comes back once more, each time with its
        replay, however large that is. Then there are two runs on two nodes, one of which is killed: its run goes on
        elsewhere, from the checkpoint that came."""
        from benchmark import cluster

        machines, second = nodes
        monkeypatch.setattr(cluster, "LOOK_SECONDS", 0.1)
        monkeypatch.setattr(cluster, "CHECKPOINT_SECONDS", 0.0)
        words = ["--ray", machines.address, "--algorithms", "iql", "--seeds", 1, "--", "--pace", "0.1"]
        stopped = folder_of(0, "iql-shared-pace=0.1")
        logs, began = keep_logs(monkeypatch), []
        with monkeypatch.context() as large:
            large.setattr(cluster, "LARGEST_REPLAY", -1)
            for _ in range(2):
                stopper = threading.Thread(target=signal_when, args=(stopped / "progress.json",))
                stopper.start()
                assert campaign(monkeypatch, *words) == 128 + signal.SIGTERM
                stopper.join()
                began.append(int(logs["log-seed0.txt"].split()[2]))
                assert is_whole(stopped / "checkpoint.pt") and not campaigns.in_use(stopped)
                (stopped / "progress.json").unlink()
                ray.shutdown()
        assert campaign(monkeypatch, *words[2:]) == 0  # it goes on without the cluster
        began.append(int(logs["log-seed0.txt"].split()[2]))
        assert 0 == began[0] < began[1] < began[2] and seeds_of("iql-shared-pace=0.1") == {0: 20.0}
        assert not (stopped / "replay.bin").exists()

        directories = [folder_of(seed, "ia2c-shared-trouble=waits") for seed in range(2)]
        wait = Path(os.environ["TMPDIR"], "wait")
        wait.touch()

        def kill():
            try:
                wait_for(lambda: all((directory / "checkpoint.previous.pt").exists() for directory in directories))
                machines.remove_node(second, allow_graceful=False)
                wait_for(lambda: [node["Alive"] for node in ray.nodes()].count(True) == 1)
            finally:
                wait.unlink()

        logs.clear()
        capsys.readouterr()
        killer = threading.Thread(target=kill)
        killer.start()
        assert campaign(monkeypatch, "--ray", machines.address, "--seeds", 2, "--", "--trouble", "waits") == 0
        killer.join()
        assert seeds_of("ia2c-shared-trouble=waits") == {0: 20.0, 1: 20.0}
        said = capsys.readouterr().err
        assert said.count("its node was lost; it goes on") == 1
        assert sorted(log.split()[2] == "0" for log in logs.values()) == [False, True]
        config = json.loads((directories[0] / "config.json").read_text())
        assert config["commit"] == envs.runs.provenance()["commit"]
        assert not (directories[0] / "progress.json").exists() and not campaigns.in_use(directories[0])

    @pytest.mark.slow
    def test_a_lost_cluster_ends_it_in_a_sentence(self, tmp_path, nodes):
        """Ray itself would wait a minute, and then end the process."""
        machines, _ = nodes
        process = subprocess.Popen(
            driver(tmp_path, "--ray", machines.address, "--seeds", 1, "--", "--pace", "1"),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        wait_for((folder_of(0, "ia2c-shared-pace=1.0") / "progress.json").exists)
        for node in machines.list_all_nodes():
            node.kill_all_processes(check_alive=False)
        said, errors = process.communicate(timeout=45)
        assert process.returncode == 1 and "0 of 1 runs are in" in said and "Traceback" not in errors
        assert f"The Ray cluster at {machines.address} is lost" in said and "the same command goes on" in said

    def test_what_a_killed_trainer_leaves_is_removed_by_the_next(self, monkeypatch, tmp_path):
        """Its folder, and the training that it has started."""
        from benchmark import cluster

        monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
        monkeypatch.setattr(tempfile, "tempdir", None)
        (tmp_path / "tmp").mkdir()
        program = """
            import sys, time
            sys.path.append(sys.argv[1])
            from benchmark import cluster
            trainer = cluster.Trainer("ia2c", ["--pace", "1"], {})
            print(trainer.folder, trainer.process.pid, flush=True)
            time.sleep(60)
        """
        command = [sys.executable, "-c", textwrap.dedent(program), str(ROOT)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as killed:
            assert killed.stdout is not None
            folder, pid = killed.stdout.readline().split()
            killed.kill()
        monkeypatch.syspath_prepend(tmp_path)
        trainers = [cluster.Trainer("ia2c", ["--pace", "1"], {}) for _ in range(2)]
        try:
            wait_for(lambda: not psutil.pid_exists(int(pid)) or psutil.Process(int(pid)).status() == "zombie")
            assert not Path(folder).exists() and all(trainer.folder.exists() for trainer in trainers)
        finally:
            for trainer in trainers:
                trainer.process.kill()
                trainer.process.wait()

    @pytest.fixture
    def no_cluster(self, monkeypatch, ray):
        """Pieces of files that travel nowhere, three bytes each."""
        from benchmark import cluster

        here = SimpleNamespace(put=bytes, get=bytes, exceptions=ray.exceptions)
        monkeypatch.setattr(cluster, "ray", here)
        monkeypatch.setattr(cluster, "PIECE", 3)
        return here

    def test_files_take_the_place_of_others(self, tmp_path, no_cluster, ray):
        from benchmark import cluster

        directory = tmp_path / "run"
        (directory / "wandb").mkdir(parents=True)
        for name in ("checkpoint.previous.pt", "checkpoint.pt", "config.json", "lock"):
            (directory / name).write_text("old")
        new: Any = {"checkpoint.pt": [b"new", b"er"], "replay.bin": [b"new"]}
        cut_off: Any = {"checkpoint.pt": [b"new", b"lost"]}
        complete: Any = {"checkpoint.pt": [b"end"]}
        cluster.write_files(directory, new)
        older = {"checkpoint.previous.pt": [b"old"], "config.json": [b"old"]}
        kept = {"checkpoint.pt": [b"new", b"er"], "replay.bin": [b"new"], **older}
        assert cluster.read_files(directory) == kept and (directory / "lock").read_text() == "old"

        def get(piece):
            if piece == b"lost":
                raise ray.exceptions.OwnerDiedError("", None, "")
            return piece

        no_cluster.get = get
        with pytest.raises(ray.exceptions.RayError):
            cluster.write_files(directory, cut_off)
        assert cluster.read_files(directory) == kept and not list(directory.glob("arrived*"))
        cluster.write_files(directory, complete)  # which has no replay any more
        assert cluster.read_files(directory) == {"checkpoint.pt": [b"end"], **older}

    def test_a_checkpoint_without_its_replay_stays(self, tmp_path, no_cluster):
        from benchmark import cluster

        directory = tmp_path / "run"
        directory.mkdir()
        (directory / "checkpoint.pt").write_text("whole")
        (directory / "replay.bin").write_text("much too large")
        assert cluster.read_files(directory, 5) == {}
        assert sorted(cluster.read_files(directory, 100)) == ["checkpoint.pt", "replay.bin"]

    @pytest.mark.slow
    @pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
    @pytest.mark.parametrize(
        "there, comes",
        [("nothing", "a replay"), ("a replay", "a replay"), ("a replay", "no replay"), ("no replay", "a replay")],
    )
    def test_a_kill_leaves_one_whole_set_of_files(self, there, comes, tmp_path, no_cluster):
        """The old one or the new one: a checkpoint with another replay would be of no use. The next program that goes
        on with the run puts the rest in its place."""
        from benchmark import cluster

        names = ["checkpoint.pt", "checkpoint.previous.pt", "config.json"]
        with_replay = [*names, "replay.bin"]
        old: Any = {name: [b"old"] for name in {"a replay": with_replay, "no replay": names, "nothing": []}[there]}
        new: Any = {name: [b"new"] for name in {"a replay": with_replay, "no replay": names}[comes]}
        before, directory, found = tmp_path / "before", tmp_path / "run", []
        before.mkdir()
        if old:
            cluster.write_files(before, old)
        for _ in killed_everywhere(before, directory, lambda: cluster.write_files(directory, new)):
            checkpoint = directory / "checkpoint.pt"
            if old or checkpoint.exists():  # whoever only reads it finds a whole one, too
                assert checkpoint.read_bytes() in (b"old", b"new")
            again = []
            if (directory / "arrived").exists():  # the next program may be killed, too
                for _ in killed_everywhere(directory, tmp_path / "again", lambda: place_arrived(tmp_path / "again")):
                    place_arrived(tmp_path / "again")
                    again.append(cluster.read_files(tmp_path / "again"))
            place_arrived(directory)
            found.append(cluster.read_files(directory))
            assert again == [found[-1]] * len(again)
            assert not [path for path in directory.iterdir() if path.name not in found[-1]]
            cluster.write_files(directory, new)
            assert cluster.read_files(directory) == new
        assert found == [old] * found.count(old) + [new] * found.count(new)
        assert found[0] == old and found[-1] == new and len(found) > 10

    def test_a_full_disk_leaves_the_old_files(self, tmp_path, no_cluster):
        """Until the new ones are written; then the next program that goes on with the run places them."""
        from benchmark import cluster

        before, directory = tmp_path / "before", tmp_path / "run"
        before.mkdir()
        old: Any = {name: [b"old"] for name in ("checkpoint.pt", "replay.bin")}
        new: Any = {name: [b"new"] for name in ("checkpoint.pt", "replay.bin")}
        cluster.write_files(before, old)
        found: list[Any] = []
        for error in full_everywhere(before, directory, lambda: cluster.write_files(directory, new)):
            assert error is not None or found
            place_arrived(directory)
            found.append(cluster.read_files(directory))
            assert sorted(path.name for path in directory.iterdir()) == ["checkpoint.pt", "replay.bin"]
        assert found == [old] * found.count(old) + [new] * found.count(new) and found.count(old) > 4

    def test_a_checkpoint_that_changes_meanwhile_does_not_travel(self, tmp_path, no_cluster):
        from benchmark import cluster

        directory = tmp_path / "run"
        directory.mkdir()
        (directory / "checkpoint.pt").write_text("old")
        (tmp_path / "new").write_text("new")

        def put(piece):
            if (tmp_path / "new").exists():
                (tmp_path / "new").replace(directory / "checkpoint.pt")
            return piece

        no_cluster.put = put
        assert cluster.read_files(directory) == {}
        assert cluster.read_files(directory) == {"checkpoint.pt": [b"new"]}

    @pytest.mark.slow
    def test_a_run_that_cannot_begin_says_why(self, monkeypatch, capsys, nodes):
        """As where a node's disk is full; it is no lost node, on which it would begin again and again."""
        from benchmark import cluster

        def make_folder():
            raise OSError("No space left on device")

        monkeypatch.setattr(cluster, "make_folder", make_folder)
        assert campaign(monkeypatch, "--ray", nodes[0].address, "--seeds", 1) == 1
        assert "OSError: No space left on device" in capsys.readouterr().out

    @pytest.mark.parametrize("taken", ["lock", "folder"])
    def test_names_that_somebody_else_has_taken(self, monkeypatch, tmp_path, taken):
        """In the temporary folder of a node that several people use."""
        from benchmark import cluster

        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        name = f"{cluster.RUN_FOLDERS}{os.getuid()}"
        (tmp_path / "theirs").mkdir()
        (tmp_path / "theirs" / "file").touch()
        (tmp_path / (f"{name}.lock" if taken == "lock" else f"{name}-x")).symlink_to("theirs")
        folder, lock = cluster.make_folder()
        lock.release()
        assert folder.parent == tmp_path and {path.name for path in (tmp_path / "theirs").iterdir()} == {"file"}

    # Not "auto": it would find the cluster of another test that runs at the same time.
    @pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1"])
    def test_no_cluster(self, monkeypatch, capsys, address):
        assert campaign(monkeypatch, "--ray", address) == 2
        assert f"no Ray cluster answers at {address}" in capsys.readouterr().err


class TestSearch:
    @pytest.mark.slow
    def test_a_grid_from_its_file_to_its_winner(self, monkeypatch, capsys, tmp_path):
        """The stand-in's return is 40 times its learning rate; 0.5 is its paper's choice."""
        lines = ["ia2c mappo,matrix lbf,learning_rate,0.25 0.5 1.0", "ia2c,matrix,device,cpu"]
        Path("grid.csv").write_text("\n".join(["algorithms,families,flag,values", *lines]))
        assert campaign(monkeypatch, "--grid", "grid.csv", "--results", "searches") == 0
        assert "9 of 9 runs are in" in capsys.readouterr().out
        monkeypatch.setattr(sys, "argv", ["report.py", "--grid", "searches"])
        importlib.import_module("benchmark.report").main()
        assert capsys.readouterr().out.splitlines() == [
            "| task | algorithm | sharing | changed flags | seeds | maximum | average | last |",
            "| --- | --- | --- | --- | --- | --- | --- | --- |",
            "| matrix-climbing | IA2C | shared | learning_rate 1.0 | 3 | 40.00 ± 0.00 | 20.00 ± 0.00 | 40.00 ± 0.00 |",
            "| matrix-climbing | IA2C | shared |  | 3 | 20.00 ± 0.00 | 10.00 ± 0.00 | 20.00 ± 0.00 |",
            "| matrix-climbing | IA2C | shared | learning_rate 0.25 | 3 | 10.00 ± 0.00 | 5.00 ± 0.00 | 10.00 ± 0.00 |",
        ]

    def test_the_best_point_of_the_mean_and_then_the_average(self):
        """By hand: A has (0 + 8) / 2 at its second point, B the same at its last, with more on the way. C learns and
        forgets. D had a larger budget, so it stands apart."""
        curves = {"A": [[0, 0, 0], [0, 8, 0]], "B": [[0, 2, 4], [0, 2, 4]], "C": [[-9, 4, -9], [-9, 5, -9]]}
        curves["D"] = [[0, 0, 1]]
        rows = [
            {"task": "lbf-5x5-2p-1f", "algorithm": "a", "sharing": "shared", "setting": json.dumps({"flag": name})}
            | {"seed": seed, "point": point, "return_mean": float(value)}
            | {"total_timesteps": 80 if name == "D" else 40}
            for name, seeds in curves.items()
            for seed, values in enumerate(seeds)
            for point, value in enumerate(values)
        ]
        lines = [line.split(" | ") for line in tables.variants(pd.DataFrame(rows)).splitlines()[2:]]
        assert [(line[3], line[5].split()[0]) for line in lines] == [
            ("flag D", "1.00"),
            ("flag C", "4.50"),
            ("flag B", "4.00"),
            ("flag A", "4.00"),
        ]

    def test_a_search_has_a_folder_of_its_own(self, monkeypatch):
        """Its runs are no part of the benchmark."""
        Path("small.csv").write_text("algorithms,families,flag,values\nia2c,matrix,learning_rate,0.25 0.5\n")
        monkeypatch.setattr(store, "HERE", Path("benchmark").resolve())
        words = ["--algorithms", "ia2c", "--tasks", "matrix-climbing", "--grid", "small.csv", "--seeds", "1"]
        monkeypatch.setattr(sys, "argv", ["run.py", *words])
        monkeypatch.setattr(run, "SIGNALS", [])  # the handlers of this process stay
        assert run.run_campaign(run.parse()) == 0
        tables = sorted(path.name for path in Path("benchmark").rglob("*.csv"))
        assert tables == ["ia2c-shared-learning-rate=0.25.csv", "ia2c-shared.csv"]
        assert [path.name for path in Path("benchmark").iterdir()] == ["searches"]
