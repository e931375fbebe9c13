"""Runs a campaign: many runs of the scripts, as many at once as there are cores, collected as they finish.

    python benchmark/run.py --algorithms mappo ia2c --tasks lbf rware-tiny-4p --seeds 5 --sharing both [-- <flags>]
    python benchmark/run.py --algorithms all --tasks matrix --dry-run        what it would run, and how long that takes
    python benchmark/run.py --algorithms ia2c --tasks matrix-climbing --grid benchmark/grids/paper.csv       a search

Runs that the results have are left out, runs that were interrupted go on, complete ones are collected. Ctrl-C stops
all of them at their next checkpoint, and the same command goes on. A run that fails leaves its output beside its
directory (log-seed<k>.txt), and the others go on. Exit code 0: the results have the whole plan; 1: they do not;
2: wrong input; 128 and the number of the signal: stopped.

Flags behind -- are for the scripts, such as -- --total-timesteps 1000000. On a cluster see cluster.md.
"""

import argparse
import contextlib
import errno
import functools
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import filelock

import envs
import plan
import training
from collect import collect_run
from envs.runs import one_sentence, script_hash
from plan import Damaged, Run
from results import PAPER_FAMILIES, RESULTS, has_seed
from view import LineView, TableView, clock, make_view, read_progress

ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
STOPPED = {code for number in SIGNALS for code in (-number, 128 + number)}  # exit codes of a run that was asked to stop
DAMAGE = re.compile("is damaged|is gone|can be read")  # what a script says of a directory that it cannot go on with
FULL = [os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT)]  # the disk, or the user's part of it
TIMING_SECONDS = 1.0
LEAST_FREE = 2**20  # bytes; a run on a fuller disk cannot even say why it fails
MOST_LOSSES = 3  # a run whose node is lost more often has failed
GRID_SEEDS, SEEDS = 3, 5  # as in the paper


# --- jobs ---
class Job(Protocol):
    """A run that is being made."""

    lost: bool  # it ended because the machine that it was on is gone

    def poll(self) -> int | None:
        """The exit code, None while it goes on."""

    def stop(self) -> None:
        """Asks for an end at the next checkpoint."""


class LocalJob:
    """A run as a process of this machine."""

    lost = False

    def __init__(self, run: Run):
        run.directory.parent.mkdir(parents=True, exist_ok=True)
        command = plan.command(run, run.directory, training.ALGOS)
        with open(plan.log_path(run), "wb") as log:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | ONE_THREAD,
                start_new_session=True,  # the terminal's Ctrl-C is for the campaign, which passes it on once
            )

    def poll(self) -> int | None:
        """The exit code, None while it goes on."""
        return self.process.poll()

    def stop(self) -> None:
        """Asks for an end at the next checkpoint."""
        self.process.terminate()


# --- the campaign ---
class Campaign:
    """Works off a plan.

    start: makes a job of a run. places: how many may run at once. failed: why, by run. elsewhere: runs whose
    directories another program holds.
    """

    def __init__(
        self,
        runs: list[Run],
        folder: Path,
        results: Path,
        start: Callable[[Run], Job],
        places: Callable[[], int],
        view: LineView | TableView,
    ):
        self.plan, self.folder, self.results, self.start, self.places = runs, folder, results, start, places
        self.view = view
        self.waiting = deque(runs)
        self.jobs: dict[Path, tuple[Run, Job]] = {}
        self.done: set[Path] = set()
        self.failed: dict[Path, str] = {}
        self.elsewhere: list[Run] = []
        self.stopped: list[Run] = []
        self.damaged: dict[Path, Damaged] = {}  # found when a run ended, to be kept aside when it begins anew
        self.attempts: dict[Path, int] = {}  # how often a run was damaged after all, or its node was lost
        self.told: set[Path] = set()  # the runs that were asked to stop
        self.stop_signal = 0
        self.problem = ""  # why no further run is started

    def go_on(self) -> None:
        """Runs until all is done or has failed, or a stop is asked for and all have stopped."""
        self.skip_collected()
        try:
            while self.jobs or (self.waiting and not self.stopping):
                while self.waiting and not self.stopping and len(self.jobs) < self.places():
                    self.begin(self.waiting.popleft())
                if self.stopping:
                    self.stop_jobs()
                self.look_at_jobs()
                self.view.show([run for run, _ in self.jobs.values()], self.summary())
                if not self.jobs and not self.waiting:
                    self.look_again()
                time.sleep(0.1)
        finally:  # an error of this program, too, leaves no run behind
            self.stop_jobs()
            while self.jobs:
                self.look_at_jobs()
                time.sleep(0.1)
            self.view.close()

    def skip_collected(self) -> None:
        """Counts what the results hold from the start. `begin` says which tables are damaged."""
        for run in self.plan:
            with contextlib.suppress(ValueError, OSError):
                if in_results(run, self.results):
                    self.done.add(run.directory)
        self.waiting = deque(run for run in self.plan if run.directory not in self.done)

    @property
    def stopping(self) -> bool:
        """Whether no further run is to start."""
        return bool(self.stop_signal or self.problem)

    def ask_to_stop(self, number: int, _: Any) -> None:
        """The handler of signals, heeded in the loop. A second signal changes nothing."""
        self.stop_signal = self.stop_signal or number

    def stop_jobs(self) -> None:
        """Asks each run for an end, once: a second signal might cut its checkpoint short."""
        for directory, (_, job) in self.jobs.items():
            if directory not in self.told:
                self.told.add(directory)
                job.stop()

    def look_at_jobs(self) -> None:
        """Finishes the jobs that have ended."""
        for run, job in list(self.jobs.values()):
            try:
                code = job.poll()
            except OSError as error:  # what has come back from a cluster cannot be written
                del self.jobs[run.directory]
                self.fail(run, str(error))
                continue
            if code is not None:
                del self.jobs[run.directory]
                self.finish(run, code, job.lost)

    def begin(self, run: Run) -> None:
        """Starts a run or goes on with it; collects it where it is complete; moves it away where it is damaged."""
        try:
            if in_results(run, self.results):
                self.done.add(run.directory)
                return
            if run.directory.exists():
                with filelock.FileLock(run.directory / "lock", timeout=0):
                    if self.make_ready(run) == "complete":
                        self.collect(run)
                        return
            self.jobs[run.directory] = run, self.start(run)
        except filelock.Timeout:
            self.elsewhere.append(run)
        except (ValueError, OSError) as error:  # ValueError: a table of the results is damaged
            self.fail(run, str(error))

    def make_ready(self, run: Run) -> str:
        """Moves what is damaged out of the way; gives what is there then, see `plan.condition`."""
        try:
            if damage := self.damaged.pop(run.directory, None):
                raise damage
            there = plan.condition(run)
        except Damaged as damage:
            place = plan.set_aside(run, self.folder)
            self.view.say(f"{run}: damaged, {damage}; kept in {place} and begun anew")
            return "new"
        if there == "begun":
            plan.check_same_flags(run)
            for name in plan.drop_damaged_checkpoints(run):
                self.view.say(f"{run}: {name} is damaged, it goes on from another checkpoint")
        return there

    def fail(self, run: Run, reason: str, where: Path | None = None) -> None:
        """A run cannot be completed, or not be collected. where: what is kept of it."""
        self.failed[run.directory] = reason if where is None else f"{reason} ({where})"
        self.view.say(f"{run}: failed, {reason}")
        full = shutil.disk_usage(self.folder).free < LEAST_FREE
        if full or any(sentence in reason for sentence in FULL):  # every other run would fail, too
            self.problem = "The disk is full: no further run is started. Once there is room, the same command goes on."

    def finish(self, run: Run, code: int, lost: bool) -> None:
        """A job has ended."""
        said = last_line(plan.log_path(run))
        damage = None
        try:
            there = plan.condition(run)
            if code == 0 and there != "complete":
                damage = Damaged("it ended without its last evaluation")
            if code == 2 and there == "begun" and DAMAGE.search(said):  # a damaged replay
                damage = Damaged(said)
        except Damaged as found:
            there, damage = "damaged", found
        if there == "complete":
            self.collect(run)
        elif lost or (damage and code in (0, 2)):
            self.try_again(run, damage)
        elif in_use(run.directory):
            self.elsewhere.append(run)
        elif code in STOPPED:
            plan.log_path(run).unlink(missing_ok=True)
            self.stopped.append(run)
        else:
            self.fail(run, f"exit code {code}: {said}", plan.log_path(run))

    def try_again(self, run: Run, damage: Damaged | None) -> None:
        """A run whose directory is damaged after all, or whose node was lost, goes on first, but not for ever."""
        self.attempts[run.directory] = self.attempts.get(run.directory, 0) + 1
        if self.attempts[run.directory] > (1 if damage else MOST_LOSSES):
            self.fail(run, str(damage or f"its node was lost {self.attempts[run.directory]} times"))
            return
        if damage:
            self.damaged[run.directory] = damage
        else:
            self.view.say(f"{run}: its node was lost, it goes on elsewhere from what came back")
        self.waiting.appendleft(run)

    def collect(self, run: Run) -> None:
        """Puts a complete run into the results."""
        try:
            plan.check_same_flags(run)
            collect_run(run.directory, self.results)
        except (ValueError, OSError) as error:  # ValueError: it is another run, or does not fit to the other seeds
            self.fail(run, f"complete, but not collected: {error}", run.directory)
        else:
            self.done.add(run.directory)
            plan.log_path(run).unlink(missing_ok=True)
            self.view.say(f"{run}: in the results ({len(self.done)} of {len(self.plan)})")

    def look_again(self) -> None:
        """Takes up the runs that were in use elsewhere and no longer are."""
        free = [run for run in self.elsewhere if not in_use(run.directory)]
        self.elsewhere = [run for run in self.elsewhere if run not in free]
        self.waiting.extend(free)

    def summary(self) -> str:
        """One line."""
        failed = f", {len(self.failed)} failed" if self.failed else ""
        stopping = "; stopping at the next checkpoints" if self.stopping else ""
        return f"{len(self.done)} of {len(self.plan)} runs in the results, {len(self.jobs)} running{failed}{stopping}"

    def report(self) -> int:
        """Says how it ended; gives the exit code."""
        if self.problem:
            print(self.problem)
        print(f"{len(self.done)} of {len(self.plan)} runs are in {self.results}.")
        for run in self.plan:
            if run.directory in self.failed:
                print(f"failed: {run}: {self.failed[run.directory]}")
        for run in self.elsewhere:
            print(f"in use by another program: {run} ({run.directory})")
        if self.stop_signal:
            print("Stopped; the same command goes on.")
            return 128 + self.stop_signal
        for run in self.stopped:
            print(f"stopped: {run}; the same command goes on with it")
        return 0 if len(self.done) == len(self.plan) else 1


def in_results(run: Run, results: Path) -> bool:
    """Whether a run has been collected. ValueError where its table is damaged, or of another text of its script."""
    script = script_hash(training.ALGOS / f"{run.algorithm}.py")
    return has_seed(results, run.algorithm, run.task, run.sharing, run.changed, run.seed, script)


def in_use(directory: Path) -> bool:
    """Whether a script, or another campaign, holds this directory."""
    if not directory.exists():
        return False
    try:
        with filelock.FileLock(directory / "lock", timeout=0):
            return False
    except filelock.Timeout:
        return True


def last_line(log: Path) -> str:
    """What a program said last."""
    lines = log.read_text(errors="replace").split("\n") if log.exists() else []
    return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")


# --- before it runs ---
def dry_run(runs: list[Run], results: Path, jobs: int) -> int:
    """Prints the plan, and what is left of it in core hours, from a short timing of each setting. Gives the exit code:
    1 where a run would fail, as with a damaged table of the results.

    The timing counts the processor's time, so that what else the machine does hardly matters.
    """
    left = 0  # runs
    steps: dict[tuple[str, str, bool], float] = {}
    examples: dict[tuple[str, str, bool], Run] = {}
    code = 0
    for run in runs:
        try:
            if in_results(run, results):
                print(f"{run}: in the results")
                continue
            there = plan.condition(run)
            if there != "new":
                plan.check_same_flags(run)
        except Damaged as damage:
            there = f"damaged, {damage}: to be kept aside and begun anew"
        except (ValueError, OSError) as error:
            print(f"{run}: would fail, {error}")
            code = 1
            continue
        print(f"{run}: {there}")
        if there != "complete":
            left += 1
            setting = run.task, run.algorithm, run.sharing
            examples.setdefault(setting, run)
            share = read_progress(run.directory).share if there == "begun" else 0.0
            steps[setting] = steps.get(setting, 0) + run.total_timesteps * (1 - share)
    if not examples:
        print("Nothing is left to run.")
        return code
    print(
        f"\nTiming {len(examples)} settings for some {TIMING_SECONDS:g} s of the processor each: one thread, training"
    )
    print("without evaluations, and of a grid the first variant ...")
    hours = 0.0
    for setting, run in examples.items():
        flags = plan.script_flags(run.task, run.sharing, run.flags)
        rate = training.measure(run.algorithm, flags, TIMING_SECONDS, time.process_time).rate
        needed = steps[setting] / rate / 3600
        hours += needed
        name = f"{run.task} {run.algorithm} {'shared' if run.sharing else 'independent'}"
        print(f"{name}: {rate:,.0f} steps/s, {needed:.2f} core hours", flush=True)
    wait = clock(hours * 3600 / min(jobs, left))
    print(f"\nIn all {hours:.1f} core hours, with --jobs {jobs} about {wait} (h:min:s).")
    return code


def parse() -> argparse.Namespace:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--algorithms", nargs="+", required=True, metavar="name", help="scripts of algos/, or all")
    parser.add_argument(
        "--tasks",
        nargs="+",
        required=True,
        metavar="name",
        help=f"tasks, families ({', '.join(PAPER_FAMILIES)}; smac: the five smaclite-...-sc2) or all",
    )
    parser.add_argument(
        "--sharing",
        choices=["shared", "independent", "both"],
        default="shared",
        help="one network for all agents (default), one for each, or runs of both kinds",
    )
    parser.add_argument("--seeds", type=int, help=f"how many, from 0 on; default {SEEDS}, {GRID_SEEDS} with --grid")
    parser.add_argument("--grid", type=Path, metavar="csv", help="search: run every combination of these flags")
    parser.add_argument("--dry-run", action="store_true", help="only say what would run, and how long it would take")
    parser.add_argument("--jobs", type=int, help="runs at once; default: one for each core")
    parser.add_argument("--ray", metavar="address", help='run on this Ray cluster ("auto": the one of this machine)')
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where runs are kept; default: runs")
    parser.add_argument("--results", type=Path, help="default: benchmark/results, or searches/<grid>")
    parser.add_argument("flags", nargs="*", help="flags for the scripts, behind --")
    args, unknown = parser.parse_known_args()
    if unknown:
        parser.error(f"unknown: {' '.join(unknown)} (flags for the scripts go behind --)")
    if any(number is not None and number < 1 for number in (args.jobs, args.seeds)):
        parser.error("--jobs and --seeds must be positive")
    return args


def run_campaign(args: argparse.Namespace) -> int:
    """Plans, runs and reports; gives the exit code."""
    sharings = {"shared": [True], "independent": [False], "both": [True, False]}[args.sharing]
    seeds = args.seeds or (GRID_SEEDS if args.grid else SEEDS)
    results = args.results or (RESULTS.with_name("searches") / args.grid.stem if args.grid else RESULTS)
    grid = plan.read_grid(args.grid) if args.grid else None
    algorithms, tasks = plan.chosen_algorithms(args.algorithms), plan.chosen_tasks(args.tasks)
    runs = plan.make_plan(algorithms, tasks, sharings, seeds, tuple(args.flags), grid, args.runs.resolve())
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    jobs = args.jobs or cores
    if args.dry_run:
        return dry_run(runs, results, jobs)
    start: Callable[[Run], Job] = LocalJob
    places: Callable[[], int] = functools.partial(int, jobs)
    if args.ray:
        envs.optional("ray")
        import cluster

        start, places = cluster.connect(args.ray, args.jobs)
    for folder in (args.runs, results):
        folder.mkdir(parents=True, exist_ok=True)
    (results / ".lock").touch()  # collecting begins with it; what is not possible is to be known before hours of runs
    campaign = Campaign(runs, args.runs.resolve(), results, start, places, make_view())
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup has SIGHUP ignored
            signal.signal(number, campaign.ask_to_stop)
    campaign.go_on()
    return campaign.report()


@one_sentence(__file__)
def main() -> None:
    """See the module's docstring."""
    sys.exit(run_campaign(parse()))


if __name__ == "__main__":
    main()
