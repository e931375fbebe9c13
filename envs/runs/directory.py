"""The directory of a run: its lock, its checkpoints, and the tables that people read."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import math
import os
import re
import shlex
import shutil
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import filelock

from envs.runs.checkpoints import check_checkpoint, check_counters
from envs.runs.flags import MAY_CHANGE, NOT_IN_DIRECTORY, as_flag, changed_flags, named_flags
from envs.runs.origin import project_version, provenance, script_hash
from envs.runs.process import Stopwatch
from envs.runs.terminal import say
from envs.runs.valid import Invalid, is_whole
from envs.tasks import OF_OTHERS
from envs.vector import EpisodeTotals, InputError

CHECKPOINTS = ("checkpoint.pt", "checkpoint.previous.pt", "checkpoint.new.pt")
REPLAY = "replay.bin"
ARRIVED = "arrived"  # a folder with files that have come back from a cluster, until each is in its place
OTHER_FILES = (
    "lock",
    REPLAY,
    ARRIVED,
    "progress.json",
    "config.json",
    "evaluations.csv",
    "episodes.csv",
    "film.gif",
    "wandb-id",
)

SAVE_SECONDS = 300  # between checkpoints, about the most that a killed run loses

PAUSES = (0.05, 0.15, 0.3, 0.5)  # seconds between the tries to put a file in the place of one that is open elsewhere

SYSTEMS = re.compile(r"\.DS_Store$|\.nfs")  # files that macOS and NFS put into any folder


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """An error of the file system names this path: what goes wrong in a write, unlike in `open`, names none."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


def put(new: Path, path: Path) -> None:
    """Puts a file in the place of another one.

    On Windows this is refused while another program has the other one open, such as a virus scanner for a moment. So it
    is tried for about a second. Raises PermissionError after that.
    """
    for pause in PAUSES:
        with contextlib.suppress(PermissionError):
            new.replace(path)
            return
        time.sleep(pause)
    new.replace(path)


def write_new(new: Path, content: bytes | memoryview) -> None:
    """Writes a file that is to take another one's place, and waits until the disk has it.

    Raises OSError, on a full disk for example, and then leaves no file: a torn one would keep the disk full.
    """
    try:
        new.unlink(missing_ok=True)  # it may be a symbolic link
        with naming(new), open(new, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        new.unlink(missing_ok=True)
        raise


def keep_names(folder: Path) -> None:
    """Waits until the disk has the new names of files in a folder, where the system can: Windows cannot."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def write_whole(path: Path, content: str | bytes) -> None:
    """Writes a file whole or not at all: whoever reads it finds the old content or the new one. Text is UTF-8.

    Raises OSError, on a full disk for example, and then leaves what was there. Where the name is that of a symbolic
    link, a file takes its place.
    """
    new = path.with_name(f"{path.name}.new")
    write_new(new, content.encode() if isinstance(content, str) else content)
    try:
        put(new, path)
    except OSError:
        new.unlink(missing_ok=True)
        raise
    keep_names(path.parent)


def place_arrived(directory: Path) -> None:
    """Puts the files of the folder ARRIVED, which `benchmark/cluster.py` has written, in the places of older ones.

    They belong together, as a checkpoint and its replay do, so a process that is killed in the middle leaves the rest
    to the next one: whoever goes on with a run calls this first, and holds its lock. Files that arrived in part are
    removed. The checkpoint comes first, as it does when a run saves; the replay comes last, so that while anything is
    left one knows whether there is a new one. An old one without a new one belongs to older checkpoints, and goes.
    """
    shutil.rmtree(directory / f"{ARRIVED}.new", ignore_errors=True)
    arrived = directory / ARRIVED
    if not arrived.is_dir():
        return
    names = sorted(os.listdir(arrived), key=lambda name: (name != CHECKPOINTS[0], name == REPLAY))
    if names and REPLAY not in names:
        (directory / REPLAY).unlink(missing_ok=True)
    for name in names:
        put(arrived / name, directory / name)
    arrived.rmdir()
    keep_names(directory)


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """A table as text, with the columns of all rows in the order in which they come up; a later row may have more."""
    table = io.StringIO()
    writer = csv.DictWriter(
        table, list(dict.fromkeys(name for row in rows for name in row)), restval="", lineterminator="\n"
    )
    writer.writeheader()
    writer.writerows(rows)
    return table.getvalue()


def write_episodes(directory: str | os.PathLike[str], totals: EpisodeTotals) -> Path:
    """Writes episodes.csv, a row for each episode of an evaluation, into a run's directory. Returns its path."""
    path = Path(directory, "episodes.csv")
    write_whole(path, as_csv(totals.episodes()))
    return path


def read_checkpoint(directory: str | os.PathLike[str], algorithm: str) -> dict[str, Any]:
    """The last whole checkpoint of an algorithm's run. Raises InputError where a directory has none."""
    saved = last_checkpoint(directory)
    if saved is None:
        raise InputError(f"{directory} holds no checkpoint.")
    if saved["config"]["algorithm"] != algorithm:
        raise InputError(f"{directory} holds a run of {saved['config']['algorithm']}.py, not of {algorithm}.py.")
    return saved


def last_checkpoint(directory: str | os.PathLike[str]) -> dict[str, Any] | None:
    """The last checkpoint in a directory that is whole, or None where there has never been one.

    Says so where a later one is damaged. Raises InputError where there are checkpoints, but none that can be read.
    """
    import torch

    damaged = []
    for path in (Path(directory, name) for name in CHECKPOINTS):
        if not path.exists():
            continue
        if not is_whole(path):
            damaged.append(path.name)
            continue
        try:
            saved = torch.load(path, map_location="cpu", weights_only=True)
            check_checkpoint(saved, path.stat().st_size)
        except Exception:  # torch.load raises almost anything on a damaged file
            damaged.append(path.name)
            continue
        if damaged:
            say(f"{directory}: {damaged[0]} is damaged; {path.name} takes its place.")
        return saved
    if damaged in ([], ["checkpoint.new.pt"]) and not Path(directory, "evaluations.csv").exists():
        return None  # the very first one has not been written, or not to its end
    raise InputError(f"{directory}: no checkpoint of ours can be read ({', '.join(damaged) or 'they are gone'}).")


@contextlib.contextmanager
def fitting_checkpoint(directory: str | os.PathLike[str]) -> Iterator[None]:
    """Raises InputError where what a checkpoint holds does not fit the script that loads it.

    Networks that are made here have no more weights than the checkpoint: its flags may name larger ones.
    """
    from envs.runs.weights import AtMost  # imports PyTorch

    places = (Path(directory, name) for name in CHECKPOINTS)
    try:
        with AtMost(max((path.stat().st_size for path in places if path.exists()), default=0)):
            yield
    except InputError:
        raise
    except Exception as error:
        why = error if isinstance(error, Invalid) else type(error).__name__
        raise InputError(f"{directory}: the checkpoint does not fit this script ({why}).") from error


def safe_name(text: str) -> str:
    """The text as a name that every file system accepts, and that is no other folder's, as ".." is.

    A very long one is cut and told apart by a hash.
    """
    name = re.sub(r"[^A-Za-z0-9_.=-]", "_", text)
    if not name.strip("."):
        name = name.replace(".", "_") or "_"
    if len(name) > 200:
        name = f"{name[:180]}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    return name


def run_path(runs: Path, algorithm: str, task: str, sharing: bool, seed: int, changed: Mapping[str, Any]) -> Path:
    """<runs>/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...]/seed<seed>, safe for every file system.

    changed: the flags that differ from the paper's. How long a run is does not count, since it may be lengthened.
    """
    named = {name: value for name, value in changed.items() if name not in NOT_IN_DIRECTORY}
    return runs / safe_name(task) / file_name(algorithm, sharing, named) / f"seed{seed}"


def file_name(algorithm: str, sharing: bool, changed: Mapping[str, Any]) -> str:
    """What directories of runs and tables of results are called: <algorithm>-<shared|independent>[-<flag>=<value>]."""
    flags = (f"-{name.replace('_', '-')}={value}" for name, value in changed.items())
    return safe_name("".join([algorithm, "-shared" if sharing else "-independent", *flags]))


class RunDirectory:
    """The directory of one run. It is locked while the process lives, and its files are written whole or not at all."""

    def __init__(self, script: str | os.PathLike[str], args: Any, default: Any) -> None:
        """Makes the directory, or opens it to go on with the run in it.

        script: the file that runs. args, default: its Args as they are, and as the paper has them for this task.
        Raises InputError where it holds a run and --resume is missing, where it holds anything else, where another
        process uses it, and where the file system cannot write its name. A run that has ended before its first
        checkpoint, as on a full disk, is none: another one begins in its place.
        """
        self.script, self.args = script, args
        self.config = describe(script, args, default)
        self._stopwatch = Stopwatch()
        self._saved_at = time.monotonic()
        usual = run_path(
            Path("runs"), self.config["algorithm"], args.env, args.parameter_sharing, args.seed, self.config["changed"]
        )
        self.path = path = Path(args.run_dir) if args.run_dir else usual
        try:
            str(path).encode()  # TensorBoard writes it like this
            found = sorted(name for name in os.listdir(path) if not SYSTEMS.match(name)) if path.exists() else []
            has_checkpoint = bool({*CHECKPOINTS[:2]} & set(found))
            if links := [name for name in found if (path / name).is_symlink()]:
                raise InputError(f"{path} holds a symbolic link, {links[0]!r}; a run would write where it leads.")
            # A file of somebody else's, such as a spreadsheet's lock, does not matter beside a checkpoint.
            foreign = [name for name in found if not self._is_ours(name)] if not has_checkpoint else []
            begun = any(name.removesuffix(".new") in (*CHECKPOINTS, ARRIVED, "progress.json") for name in found)
            if foreign or (set(found) - {"lock", "wandb-id"} and not begun):
                raise InputError(f"{path} holds what is not a run of ours, such as {(foreign or found)[0]!r}.")
            if not args.resume and {*CHECKPOINTS[:2], ARRIVED, "evaluations.csv"} & set(found):
                raise InputError(f"{path} holds a run: --resume goes on with it, another --run-dir begins a new one.")
            path.mkdir(parents=True, exist_ok=True)
            # It is waited for, since a campaign that looks whether a directory is in use holds it for a moment.
            self._lock = filelock.FileLock(path / "lock").acquire(timeout=1)
            place_arrived(path)
        except filelock.Timeout:
            raise InputError(f"Another run is using {path}.") from None
        except InputError:
            raise
        except ValueError as error:  # a character that the file system's encoding lacks, or a NUL
            encoding = sys.getfilesystemencoding()
            advice = (
                "" if encoding == "utf-8" else f" Python reads names as {encoding} here; PYTHONUTF8=1 changes that."
            )
            raise InputError(f"No directory can have the name {str(path)!a}: {error}.{advice}") from None

    @staticmethod
    def _is_ours(name: str) -> bool:
        """Whether a run leaves a file of this name."""
        known = (*CHECKPOINTS, *OTHER_FILES)
        return name in known or name.removesuffix(".new") in known or name.startswith("events.out.tfevents")

    def checkpoint(self) -> dict[str, Any] | None:
        """The last checkpoint, or None. The tables that people read are made again from it where they differ.

        Without --resume there is none to go on with: what a first save has left without its name does not count.
        Raises InputError where it was made by another algorithm or with other flags.
        """
        saved = last_checkpoint(self.path) if self.args.resume else None
        if saved is None:
            return None
        with fitting_checkpoint(self.path):
            check_counters(saved)
        self._check_flags(saved["config"])
        if self.args.total_timesteps > saved["config"]["flags"]["total_timesteps"]:
            self._lengthen(saved["config"]["flags"], saved["budget"])
        self._stopwatch = Stopwatch(**saved["seconds"])
        self._write_tables(saved)
        return saved

    def _check_flags(self, then: Mapping[str, Any]) -> None:
        """Raises InputError where a run with this config cannot go on with what the command line says."""
        now = self.config
        if then["algorithm"] != now["algorithm"]:
            raise InputError(f"{self.path} holds a run of {then['algorithm']}.py.")
        flags = then["flags"]
        changed = [name for name in flags if name not in MAY_CHANGE and flags[name] != now["flags"].get(name)]
        if changed:
            words = ", ".join(as_flag(name, flags[name]) for name in changed)
            raise InputError(f"{self.path} was begun with {words}, and this cannot change.")
        if now["flags"]["total_timesteps"] < flags["total_timesteps"]:
            words = as_flag("total_timesteps", flags["total_timesteps"])
            raise InputError(f"{self.path} was begun with {words}; timesteps can only be added.")

    def _lengthen(self, then: Mapping[str, Any], budget: int) -> None:
        """Says where the evaluations of a run with these flags lie that becomes longer; budget: when it was begun.

        Raises InputError where there would be none at its end.
        """
        intervals, total = then["eval_points"] - 1, self.args.total_timesteps
        if intervals == 0:
            return
        apart = f"its evaluations stay {budget / intervals:,.0f} steps apart"
        if total * intervals % budget:
            step = budget // math.gcd(budget, intervals)
            fitting = max(total // step * step, then["total_timesteps"])
            words = f"{as_flag('total_timesteps', fitting)} or {fitting + step}"
            raise InputError(f"{self.path} cannot become so long, since {apart}: {words} fits.")
        say(f"{self.path} becomes longer; {apart}.")

    def seconds(self) -> dict[str, float]:
        """wall_seconds and cpu_seconds spent on the run so far, also before it was resumed; without --env-workers'."""
        return self._stopwatch.seconds()

    def save(self, rows: Sequence[Mapping[str, Any]], **state: Any) -> None:
        """Keeps a checkpoint, and the one before it; then writes config.json, and the rows as evaluations.csv.

        rows, state: tensors and plain types only. A process that is killed in the middle leaves older tables, which
        `checkpoint` renews.
        """
        import torch

        saved = {"config": self.config, "rows": rows, "seconds": self.seconds(), **state}
        last, previous, new = (self.path / name for name in CHECKPOINTS)
        in_memory = io.BytesIO()  # on a full disk torch.save itself would end with a RuntimeError
        torch.save(saved, in_memory)
        write_new(new, in_memory.getbuffer())
        if last.exists():
            put(last, previous)
        put(new, last)
        keep_names(self.path)
        self._write_tables(saved)
        self._saved_at = time.monotonic()

    @property
    def save_is_due(self) -> bool:
        """Whether the last checkpoint is older than SAVE_SECONDS, as where evaluations are far apart."""
        return time.monotonic() - self._saved_at > SAVE_SECONDS

    def _write_tables(self, saved: Mapping[str, Any]) -> None:
        """Writes what a checkpoint says for people. Where this fails nothing is lost, and the run goes on."""
        texts = {"evaluations.csv": as_csv(saved["rows"]), "config.json": json.dumps(saved["config"], indent=2) + "\n"}
        for name, text in texts.items():
            path = self.path / name
            try:
                if not path.exists() or path.read_bytes() != text.encode():
                    write_whole(path, text)
            except OSError as error:  # a full disk; on Windows a spreadsheet that has it open
                words = f"{path} cannot be written ({error.strerror}) and stays as it is"
                say(f"{words}; the next save, or --resume, writes it.")

    def complete(self) -> None:
        """Deletes what only a running run needs, and says how to watch what has been learnt."""
        for name in ("progress.json", REPLAY):
            try:
                (self.path / name).unlink(missing_ok=True)
            except OSError as error:
                say(f"{self.path / name} is no longer needed, but cannot be deleted: {error.strerror}.")
        script = Path(self.script).resolve()
        with contextlib.suppress(ValueError):  # it lies elsewhere
            script = script.relative_to(Path.cwd())
        words = ["python", str(script), "--watch", str(self.path)]
        if self.args.env.startswith(OF_OTHERS):  # `watch` runs code of others only where the command line names it
            words += ["--env", self.args.env]
        say(f"{self.path} is complete; this plays what was learnt: {shlex.join(words)}")


def describe(script: str | os.PathLike[str], args: Any, default: Any) -> dict[str, Any]:
    """What config.json says of a run: what was computed, and where a result came from, in plain types.

    script: the file of the running script; its text is named by a hash, so that a changed copy is told apart.
    args, default: the script's Args as they are, and as the paper has them for this task.
    """
    return {
        "algorithm": Path(script).stem,
        "flags": named_flags(args),
        "changed": changed_flags(args, default),
        "paper_timesteps": default.total_timesteps,
        "version": project_version(),
        "script": script_hash(script),
        **provenance(),
    }
