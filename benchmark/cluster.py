"""Runs on a Ray cluster: each on one core of any node, all of its files going there and back through Ray.

The nodes need this project's dependencies and no shared disk: Ray sends them `algos/` and `envs/`, and this module what
the campaign has of a run. Every few minutes its last checkpoint comes back into its directory here, so this directory
looks like that of an interrupted run: one whose node is lost goes on from it on another node, and on this machine if
need be.

`Trainer` and what it calls live on the nodes, where the modules of benchmark/ are not: they are sent by value.
"""

import contextlib
import functools
import importlib.util
import json
import logging
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import filelock
import ray

import envs
from benchmark import plan
from benchmark.campaign import ONE_THREAD, ClusterLost
from benchmark.plan import PlannedRun
from envs.runs import ends_with_parent, place_arrived, provenance
from envs.runs.directory import ARRIVED

LOOK_SECONDS = 1.0  # between two looks at a run
CHECKPOINT_SECONDS = 300.0  # between two checkpoints that come back
LARGEST_REPLAY = 2**30  # bytes; a larger one comes back only when a run is stopped, and is lost with a node
PIECE = 2**26  # bytes of a file that travel at once; Ray moves pieces to its disk where they are too many
STAYS = {"lock", "progress.json"}  # files that do not travel with the others
Files = dict[str, list[ray.ObjectRef[bytes]]]  # by name, the pieces of each, which Ray keeps somewhere
RUN_FOLDERS = "marl-baselines-run-"  # how their names begin
ANSWER_SECONDS = 10.0  # a cluster that does not answer for so long is lost
COUNT_SECONDS = 5.0  # between two looks at how many cores the cluster has


# --- on the nodes ---
def read_files(directory: Path, largest_replay: float = math.inf) -> Files:
    """All that a run needs to go on elsewhere; nothing where it has no checkpoint, or makes one at this moment, or has
    a larger replay than wanted.

    What a checkpoint refers to in the replay stays as it is until the next checkpoint is there.
    """
    last = directory / "checkpoint.pt"
    replay = directory / "replay.bin"
    if not last.exists() or (replay.exists() and replay.stat().st_size > largest_replay):
        return {}
    try:
        before = last.stat()
        files: Files = {}
        for path in directory.iterdir():
            if path.is_file() and path.name not in STAYS:
                with open(path, "rb") as file:
                    files[path.name] = [ray.put(piece) for piece in iter(functools.partial(file.read, PIECE), b"")]
        after = last.stat()
    except FileNotFoundError:  # a file took another's place
        return {}
    return files if (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns) else {}


def write_files(directory: Path, files: Files) -> None:
    """Files that have arrived take the place of those that are there, all or none: they are written into a folder, and
    count once it has its name; see `place_arrived`. OSError on a full disk, RayError where pieces were lost with their
    node; both leave all as it was."""
    arriving = directory / f"{ARRIVED}.new"
    arriving.mkdir(parents=True)
    try:
        for name, pieces in files.items():
            with open(arriving / name, "wb") as file:
                file.writelines(ray.get(piece) for piece in pieces)
                file.flush()
                os.fsync(file.fileno())
    except (OSError, ray.exceptions.RayError):
        shutil.rmtree(arriving)
        raise
    arriving.rename(directory / ARRIVED)
    place_arrived(directory)


def make_folder() -> tuple[Path, filelock.FileLock]:
    """A new folder for a run, and the lock that holds it while its trainer lives; folders that nobody holds any more,
    since their trainers were killed, are removed."""
    there = Path(tempfile.gettempdir())
    with contextlib.ExitStack() as held:
        # On a shared node somebody else may have taken any of these names: then old folders stay.
        with contextlib.suppress(OSError, filelock.Timeout):
            held.enter_context(filelock.FileLock(there / f"{RUN_FOLDERS}{os.getuid()}.lock", timeout=ANSWER_SECONDS))
            for old in there.glob(f"{RUN_FOLDERS}{os.getuid()}-*"):
                if old.is_symlink() or old.stat().st_uid != os.getuid():
                    continue
                with contextlib.suppress(filelock.Timeout), filelock.FileLock(old / "trainer", timeout=0):
                    shutil.rmtree(old, ignore_errors=True)
        folder = Path(tempfile.mkdtemp(prefix=f"{RUN_FOLDERS}{os.getuid()}-"))
        lock = filelock.FileLock(folder / "trainer")
        lock.acquire()
    return folder, lock


class Trainer:
    """A run on a node: a process, and a directory that is gone when it has ended."""

    def __init__(self, algorithm: str, arguments: list[str], files: Files):
        self.folder, self.lock = make_folder()
        self.directory, self.log = self.folder / "run", self.folder / "log.txt"
        self.sent = 0  # when the last checkpoint that was sent was made
        if files:
            write_files(self.directory, files)
        script = importlib.util.find_spec(f"algos.{algorithm}")
        assert script is not None and script.origin is not None
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, script.origin, *arguments, "--run-dir", str(self.directory), "--resume"],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | ONE_THREAD,
                preexec_fn=ends_with_parent(),
            )

    def look(self, checkpoint: bool) -> dict[str, Any]:
        """After a second, or when it ends: its exit code (None before), its progress.json, its log at the end, and its
        files at the end or, where a checkpoint is asked for and there is a new one, with that."""
        try:
            code = self.process.wait(LOOK_SECONDS)
        except subprocess.TimeoutExpired:
            code = None
        progress = self.directory / "progress.json"
        shown = progress.read_bytes() if progress.exists() else b""
        seen: dict[str, Any] = {"code": code, "progress": shown, "files": {}, "log": b""}
        if code is not None:
            seen |= {"files": read_files(self.directory), "log": self.log.read_bytes()[-(2**20) :]}
            shutil.rmtree(self.folder, ignore_errors=True)
        elif checkpoint and (self.directory / "checkpoint.pt").exists():
            made = (self.directory / "checkpoint.pt").stat().st_mtime_ns
            if made != self.sent and (files := read_files(self.directory, LARGEST_REPLAY)):
                self.sent, seen["files"] = made, files
        return seen

    def stop(self) -> None:
        """Asks for an end at the next checkpoint."""
        self.process.terminate()


# --- where the campaign is ---
class RayJob:
    """A run on the cluster, whose directory here is locked meanwhile."""

    def __init__(self, run: PlannedRun, cluster: "Connection"):
        self.run, self.cluster, self.lost = run, cluster, False
        run.directory.mkdir(parents=True, exist_ok=True)
        self.lock = filelock.FileLock(run.directory / "lock")
        self.lock.acquire(timeout=0)
        self.trainer = cluster.begin(run.algorithm, run.arguments(), read_files(run.directory))
        self.seen, self.asked = self.trainer.look.remote(True), time.monotonic()
        self.began, self.stopping = False, False  # began: the cluster had a core for it

    def poll(self) -> int | None:
        """The exit code, None while it goes on; keeps what has come back. OSError where it cannot be written,
        ClusterLost."""
        if self.stopping and not self.began:
            return self.end(128 + signal.SIGTERM)
        if not ray.wait([self.seen], timeout=0)[0]:
            return None
        try:
            seen = ray.get(self.seen)
            self.began = True
            if seen["files"]:
                write_files(self.run.directory, self.with_commit(seen["files"]))
            if seen["progress"]:
                with contextlib.suppress(OSError):  # it is only there to be looked at
                    (self.run.directory / "progress.json").write_bytes(seen["progress"])
        except ray.exceptions.RayTaskError as error:  # the node's disk is full, for one
            return self.end(1, str(error.cause).encode())
        except ray.exceptions.RayError as error:
            if isinstance(error, ray.exceptions.ActorDiedError) and error.actor_init_failed:
                return self.end(1, str(error).encode())  # the same before the run could begin
            self.cluster.check()
            self.lost = True
            return self.end(1)
        except OSError:
            self.end(1)
            raise
        if seen["code"] is not None:
            return self.end(seen["code"], seen["log"])
        checkpoint = time.monotonic() - self.asked >= CHECKPOINT_SECONDS
        if checkpoint:
            self.asked = time.monotonic()
        self.seen = self.trainer.look.remote(checkpoint)
        return None

    def with_commit(self, files: Files) -> Files:
        """The files of a run, its config.json naming the commit that was sent: a node has no checkout to ask."""
        if "config.json" not in files:
            return files
        config = json.loads(b"".join(map(ray.get, files["config.json"]))) | {"commit": self.cluster.commit}
        return files | {"config.json": [ray.put(json.dumps(config, indent=2).encode())]}

    def end(self, code: int, log: bytes = b"") -> int:
        """Frees the core and the directory."""
        ray.kill(self.trainer)
        if code == 0:
            (self.run.directory / "progress.json").unlink(missing_ok=True)
        if log:
            with contextlib.suppress(OSError):
                self.run.log.write_bytes(log)
        self.lock.release()
        return code

    def stop(self) -> None:
        """Asks for an end at the next checkpoint."""
        self.stopping = True
        if self.began:
            self.trainer.stop.remote()


class Connection:
    """A cluster that was joined, and how many jobs it has room for."""

    def __init__(self, address: str, jobs: int | None):
        """jobs: how many at most; None: as many as the cluster has cores. InputError where no cluster answers."""
        host, _, port = address.removeprefix("ray://").rpartition(":")
        try:
            if host:  # Ray itself would try for five minutes
                socket.create_connection((host, int(port)), ANSWER_SECONDS).close()
            sent = {"py_modules": [str(plan.ALGOS), str(Path(envs.__file__).parent)]}
            ray.init(address, runtime_env=sent, log_to_driver=False, logging_level=logging.WARNING)
        except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: another version of Ray or Python
            raise envs.InputError(f"no Ray cluster answers at {address}: {error}") from None
        if not host:
            host, _, port = ray.get_runtime_context().gcs_address.rpartition(":")
        self.address, self.jobs, self.commit = (host, int(port)), jobs, provenance()["commit"]
        ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
        self.begin: Callable[..., Any] = ray.remote(num_cpus=1)(Trainer).remote
        self.cores, self.counted = 0, -math.inf

    def check(self) -> None:
        """Raises ClusterLost where it does not answer. Ray itself would wait a minute, and end this process."""
        try:
            socket.create_connection(self.address, ANSWER_SECONDS).close()
        except OSError as error:
            raise ClusterLost(f"The Ray cluster at {':'.join(map(str, self.address))} is lost: {error}.") from None

    def places(self) -> int:
        """How many jobs there is room for. Raises ClusterLost."""
        if time.monotonic() - self.counted > COUNT_SECONDS:
            self.check()
            self.cores, self.counted = int(ray.cluster_resources().get("CPU", 0)), time.monotonic()
        return self.jobs or max(self.cores, 1)
