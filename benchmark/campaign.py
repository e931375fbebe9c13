"""A campaign: as many runs of a plan at once as there is room for, each collected when it is complete."""

import contextlib
import json
import math
import os
import signal
import subprocess
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import filelock
from tqdm import tqdm

from benchmark import store
from benchmark.plan import PlannedRun
from envs.runs import KILLED, ends_with_parent, place_arrived, say

ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
STOPPED = {code for number in SIGNALS for code in (-number, 128 + number)}  # exit codes of a run that was asked to stop
MOST_LOSSES = 3  # a run that is lost more often has failed
LINES_EVERY = 300  # seconds between two looks at how far the runs are
HEADER = f"{'task':<24} {'algorithm':<20} {'seed':>4} {'done':>5} {'steps/s':>9} {'return':>9} {'time left':>10}"


class ClusterLost(Exception):
    """The cluster that runs were started on no longer answers; the message is one sentence."""


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

    def __init__(self, run: PlannedRun):
        run.directory.parent.mkdir(parents=True, exist_ok=True)
        with open(run.log, "wb") as log:
            self.process = subprocess.Popen(
                run.command(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | ONE_THREAD,
                process_group=0,  # the terminal's Ctrl-C is for the campaign, which passes it on once
                preexec_fn=ends_with_parent(),  # else it would go on beside the runs of the next campaign
            )

    def poll(self) -> int | None:
        """The exit code, None while it goes on."""
        return self.process.poll()

    def stop(self) -> None:
        """Asks for an end at the next checkpoint."""
        self.process.terminate()


class Campaign:
    """Works off a plan.

    start: makes a job of a run. places: how many may run at once; raises ClusterLost. failed: why, by run. elsewhere:
    runs whose directories another program holds.
    """

    def __init__(
        self,
        runs: list[PlannedRun],
        results: Path,
        start: Callable[[PlannedRun], Job],
        places: Callable[[], int],
    ):
        self.plan, self.results, self.start, self.places = runs, results, start, places
        self.waiting = deque(runs)
        self.jobs: dict[Path, tuple[PlannedRun, Job]] = {}
        self.done: set[Path] = set()
        self.failed: dict[Path, str] = {}
        self.elsewhere: list[PlannedRun] = []
        self.stopped: list[PlannedRun] = []
        self.losses: dict[Path, int] = {}  # how often a run was lost
        self.told: set[Path] = set()  # the runs that were asked to stop
        self.stop_signal = 0
        self.problem = ""  # why no further run is started
        self.shown = -math.inf  # when one saw last how far the runs are

    def go_on(self) -> None:
        """Runs until all is done or has failed, or a stop is asked for and all have stopped."""
        self.skip_collected()
        try:
            while self.jobs or (self.waiting and not self.stopping):
                places = self.places()
                while self.waiting and not self.stopping and len(self.jobs) < places:
                    self.begin(self.waiting.popleft())
                if self.stopping:
                    self.stop_jobs()
                self.look_at_jobs()
                if time.monotonic() - self.shown >= LINES_EVERY:
                    self.show()
                if not self.jobs and not self.waiting:
                    self.look_again()
                time.sleep(0.1)
        except ClusterLost as lost:
            self.problem = f"{lost} On another, or without --ray, the same command goes on from what came back."
            self.jobs.clear()
        finally:  # an error of this program, too, leaves no run behind
            self.stop_jobs()
            while self.jobs:
                self.look_at_jobs()
                time.sleep(0.1)

    def skip_collected(self) -> None:
        """Counts what the results hold from the start. `begin` says which tables are damaged."""
        for run in self.plan:
            with contextlib.suppress(ValueError, OSError):
                if store.has(run, self.results):
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
                if code is not None:
                    del self.jobs[run.directory]
                    self.finish(run, code, job.lost)
            except (ValueError, OSError) as error:  # its files are damaged, or what came back cannot be written
                self.jobs.pop(run.directory, None)
                self.fail(run, str(error))

    def begin(self, run: PlannedRun) -> None:
        """Starts a run or goes on with it; collects it where it is complete."""
        try:
            with contextlib.ExitStack() as held:
                if run.directory.exists():
                    held.enter_context(filelock.FileLock(run.directory / "lock", timeout=0))
                    place_arrived(run.directory)
                there = store.bring_in(run, self.results)
            if there == "in the results":
                self.count(run)
            else:
                self.jobs[run.directory] = run, self.start(run)
        except filelock.Timeout:
            self.elsewhere.append(run)
        except (ValueError, OSError) as error:  # ValueError: a table of the results, or a run, is damaged or another
            self.fail(run, str(error))

    def fail(self, run: PlannedRun, reason: str) -> None:
        """A run cannot be completed, or not be collected."""
        self.failed[run.directory] = reason
        say(f"{run}: failed, {reason}")

    def finish(self, run: PlannedRun, code: int, lost: bool) -> None:
        """A job has ended. ValueError where its files are damaged."""
        used = in_use(run.directory)  # asked first: whoever holds it may complete the run meanwhile, and let go
        if store.bring_in(run, self.results) == "in the results":
            self.count(run)
        elif lost:
            self.try_again(run, "its node was lost")
        elif code in (-signal.SIGKILL, KILLED):
            self.try_again(run, "it was killed, perhaps out of memory")
        elif used:
            self.elsewhere.append(run)
        elif code in STOPPED:
            run.log.unlink(missing_ok=True)
            self.stopped.append(run)
        else:
            self.fail(run, f"exit code {code}: {last_line(run.log)} ({run.log})")

    def try_again(self, run: PlannedRun, reason: str) -> None:
        """A lost run goes on, before others begin, but not for ever."""
        self.losses[run.directory] = self.losses.get(run.directory, 0) + 1
        if self.losses[run.directory] > MOST_LOSSES:
            self.fail(run, f"{reason}; it was lost {self.losses[run.directory]} times")
        else:
            say(f"{run}: {reason}; it goes on from its last checkpoint")
            self.waiting.appendleft(run)

    def count(self, run: PlannedRun) -> None:
        """A run is in the results."""
        self.done.add(run.directory)
        run.log.unlink(missing_ok=True)
        say(f"{run}: in the results ({len(self.done)} of {len(self.plan)})")

    def look_again(self) -> None:
        """Takes up the runs that were in use elsewhere and no longer are."""
        free = [run for run in self.elsewhere if not in_use(run.directory)]
        self.elsewhere = [run for run in self.elsewhere if run not in free]
        self.waiting.extend(free)

    def show(self) -> None:
        """Says how far the campaign and the runs that are being made are."""
        self.shown = time.monotonic()
        failed = f", {len(self.failed)} failed" if self.failed else ""
        stopping = "; stopping at the next checkpoints" if self.stopping else ""
        done = f"{len(self.done)} of {len(self.plan)} runs in the results"
        say(f"{time.strftime('%H:%M:%S')} {done}, {len(self.jobs)} running{failed}{stopping}")
        say("\n".join([HEADER, *(table_row(run) for run, _ in self.jobs.values())]))

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


def share_done(directory: Path) -> float:
    """How much of its budget the run in this directory has played, by its progress.json."""
    said = read_progress(directory)
    return min(said["timestep"] / said["total_timesteps"], 1.0) if said else 0.0


def read_progress(directory: Path) -> dict[str, Any]:
    """What the run in this directory says of itself in its progress.json; nothing before it says anything."""
    try:
        said = json.loads((directory / "progress.json").read_text())
    except (OSError, ValueError, RecursionError):
        return {}
    numbers, returns = ("timestep", "total_timesteps", "steps_per_second"), ("training_return", "evaluation_return")
    good = isinstance(said, dict) and all(isinstance(said.get(name), int | float) for name in numbers)
    good = good and all(isinstance(said.get(name), int | float | None) for name in returns)
    good = good and said["total_timesteps"] > 0
    return said if good else {}


def table_row(run: PlannedRun) -> str:
    """A run's line: how far it is, its last evaluation or else the return of its training, and what is left."""
    said, rate, last, left = read_progress(run.directory), "", "", ""
    if said and said["steps_per_second"]:
        rate = f"{said['steps_per_second']:,.0f}"
        left = tqdm.format_interval(max(said["total_timesteps"] - said["timestep"], 0) / said["steps_per_second"])
    for key in ("training_return", "evaluation_return"):
        last = last if said.get(key) is None else f"{said[key]:,.2f}"
    name = f"{run.algorithm} {run.sharing}"
    return f"{run.task:<24} {name:<20} {run.seed:>4} {share_done(run.directory):>5.0%} {rate:>9} {last:>9} {left:>10}"
