"""What every run needs of the file system, the terminal and the machine. It has nothing to do with learning.

The scripts of algos/ call these in one line each, so that a reader of an algorithm need not read them:

    parse_flags, describe                            flags, and the description of a run
    RunDirectory, read_checkpoint, fitting_checkpoint      what a run keeps on the disk
    EpisodeFile                                      the file of a replay
    Log                                              progress bar, TensorBoard, progress.json
    StopSignals, one_sentence                        the process
"""

from __future__ import annotations

import contextlib
import csv
import ctypes
import hashlib
import importlib
import importlib.metadata
import inspect
import io
import json
import math
import os
import platform
import re
import secrets
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
import zipfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import filelock
import numpy as np
import psutil
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from envs import fast_mkl
from envs.tasks import InputError

Flags = TypeVar("Flags")  # the Args of a script

# ---------------------------------------------------------------------------------------------------------------------
# Flags
# ---------------------------------------------------------------------------------------------------------------------

# These say nothing of the setting
OF_ONE_RUN = {"seed", "env_workers", "device", "threads", "run_dir", "resume", "watch", "track"}
MAY_CHANGE = OF_ONE_RUN - {"seed"} | {"total_timesteps"}  # when a run is resumed
NOT_IN_DIRECTORY = {"total_timesteps", "eval_points", "eval_episodes"}  # how long a run is, and when it is looked at


class Range(NamedTuple):
    """The values that a flag may have. Without `ends`, the two bounds themselves are not allowed."""

    lowest: float
    highest: float
    ends: bool = True


PROBABILITY = Range(0, 1)
SIZE = Range(1, 100_000)
COUNT = Range(1, 10**15)
WEIGHT = Range(0, 10**18)
RANGES = {
    "seed": Range(0, 2**63 - 1),
    "total_timesteps": COUNT,
    "max_episode_steps": Range(0, 10**9),
    "env_workers": Range(0, 10_000),
    "hidden_dim": Range(1, 16_384),
    "learning_rate": WEIGHT,
    "gamma": PROBABILITY,
    "n_step": COUNT,
    "entropy_coef": WEIGHT,
    "update_epochs": SIZE,
    "clip_coef": Range(0, 1, ends=False),
    "actor_regularisation": WEIGHT,
    "epsilon_start": PROBABILITY,
    "epsilon_end": PROBABILITY,
    "epsilon_anneal": Range(0, 10**15),
    "eval_epsilon": PROBABILITY,
    "batch_size": SIZE,
    "buffer_size": COUNT,
    "max_grad_norm": Range(0, math.inf),  # inf: gradients are not clipped
    "num_envs": SIZE,
    "eval_points": Range(1, 10**6),
    "eval_episodes": SIZE,
    "threads": Range(1, 256),
}


def parse_flags(args_class: type[Flags], defaults: Callable[..., Flags], argv: list[str], doc: str | None) -> Flags:
    """Reads the command line into a script's Args.

    defaults: makes the Args for a task and a kind of sharing. So these two flags are found first, in every spelling
    that tyro accepts. doc: the script's docstring, which heads its help.
    Raises InputError for a number out of range, and for a device that is not there.
    """
    others = [word for word in argv if word not in ("-h", "--help")]
    default, _ = tyro.cli(defaults, args=others, return_unknown_args=True)
    if len(others) < len(argv):
        with contextlib.suppress(BrokenPipeError):
            show_help(args_class, default, doc or "")
        flush_stdout()
        sys.exit()
    args: Any = tyro.cli(args_class, args=argv, default=default)
    check_flags(args)
    if args.watch == "" and any(word.partition("=")[0] == "--watch" for word in argv):
        raise InputError("--watch needs the directory of a run.")  # an unset variable of a shell, for example
    if args.device == "cuda":
        import torch

        if not torch.cuda.is_available():
            raise InputError("--device cuda: PyTorch finds no CUDA device here.")
    return args


def as_flag(name: str, value: Any) -> str:
    """A flag and its value as they are written on the command line."""
    flag = name.replace("_", "-")
    if isinstance(value, bool):
        return f"--{flag}" if value else f"--no-{flag}"
    return f"--{flag} {value}"


def check_flags(args: Any) -> None:
    """Raises InputError for the first flag of a script's Args whose number is out of range (see RANGES)."""
    for name, value in vars(args).items():
        allowed = RANGES.get(name)
        if allowed is None:
            continue
        inside = allowed.lowest <= value <= allowed.highest
        if not inside or (not allowed.ends and value in allowed[:2]):
            low, high = allowed.lowest, allowed.highest
            bounds = f"between {low:,} and {high:,}" if allowed.ends else f"above {low:,} and below {high:,}"
            raise InputError(f"{as_flag(name, value)}: the value must lie {bounds}.")


def changed_flags(args: Any, default: Any) -> dict[str, Any]:
    """The flags of a setting that differ from the default. Task, sharing and seed are named elsewhere."""
    named = OF_ONE_RUN | {"env", "parameter_sharing"}
    return {name: value for name, value in vars(args).items() if name not in named and value != getattr(default, name)}


def show_help(args_class: type, default: Any, description: str) -> None:
    """Prints the flags of a script's Args in groups, wrapped to the terminal.

    Each line `# title` in the class begins a group, and the comment behind a field is its help.
    """
    width = max(min(shutil.get_terminal_size().columns, 120) - 1, 20)
    column = 30  # where the explanations begin
    for paragraph in description.strip().split("\n\n"):
        if paragraph.startswith("    "):  # formulas and commands keep their lines
            print(paragraph, end="\n\n")
        else:
            print(textwrap.fill(" ".join(paragraph.split()), width, break_on_hyphens=False), end="\n\n")
    for line in inspect.getsource(args_class).splitlines():
        title = re.fullmatch(r" {4}# (.+)", line)
        field = re.fullmatch(r" {4}(\w+): (.+?) = .+?  # (.+)", line)
        if title:
            print(f"\n{title[1]}:")
        if field:
            name, kind, text = field.groups()
            flag = f"--{name.replace('_', '-')}"
            if kind == "bool":
                flag += f", --no-{name.replace('_', '-')}"
            elif kind.startswith("Literal"):
                flag += " {" + ",".join(re.findall(r'"(\w+)"', kind)) + "}"
            else:
                flag += {"int": " INTEGER", "float": " NUMBER", "str": " TEXT"}.get(kind, " VALUE")
            value = getattr(default, name)
            if value != "":
                text += f" (default: {value})"
            head = f"  {flag}".ljust(column)
            if len(head) > column:  # the flag takes a line of its own
                print(head)
                head = " " * column
            wrapper = textwrap.TextWrapper(max(width, column + 30), head, " " * column, break_on_hyphens=False)
            print(wrapper.fill(text))


# ---------------------------------------------------------------------------------------------------------------------
# The directory of a run
# ---------------------------------------------------------------------------------------------------------------------

CHECKPOINTS = ("checkpoint.pt", "checkpoint.previous.pt", "checkpoint.new.pt")
OTHER_FILES = ("lock", "replay.bin", "progress.json", "config.json", "evaluations.csv", "film.gif", "wandb-id")

SAVE_SECONDS = 300  # between checkpoints, about the most that a killed run loses

SYSTEMS = re.compile(r"\.DS_Store$|\.nfs")  # files that macOS and NFS put into any folder


def write_whole(path: Path, text: str) -> None:
    """Writes a text file whole or not at all: whoever reads it finds the old text or the new one.

    Raises OSError, on a full disk for example, and then leaves what was there.
    """
    new = path.with_name(f"{path.name}.new")
    try:
        with open(new, "w", newline="\n", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def read_checkpoint(directory: str | os.PathLike[str], algorithm: str) -> dict[str, Any]:
    """The last whole checkpoint of an algorithm's run. Raises InputError where a directory has none."""
    saved = last_checkpoint(directory)
    if saved is None or saved["config"]["algorithm"] != algorithm:
        raise InputError(f"{directory} holds no checkpoint of {algorithm}.")
    return saved


def is_whole(checkpoint: Path) -> bool:
    """Whether every byte of a checkpoint is as it was written. PyTorch writes zip files, and does not look at their
    check sums itself."""
    try:
        with zipfile.ZipFile(checkpoint) as file:
            return file.testzip() is None
    except Exception:  # zipfile raises almost anything on a damaged file
        return False


def last_checkpoint(directory: str | os.PathLike[str]) -> dict[str, Any] | None:
    """The last checkpoint in a directory that is whole, or None where there has never been one.

    Raises InputError where there are checkpoints, but none that can be read.
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
            saved["config"]["algorithm"], saved["config"]["flags"], saved["rows"], saved["seconds"]
            return dict(saved)
        except Exception:  # torch.load raises almost anything on a damaged file
            damaged.append(path.name)
    if damaged in ([], ["checkpoint.new.pt"]) and not Path(directory, "evaluations.csv").exists():
        return None  # the very first one has not been written, or not to its end
    raise InputError(f"{directory}: no checkpoint of ours can be read ({', '.join(damaged) or 'they are gone'}).")


@contextlib.contextmanager
def fitting_checkpoint(directory: str | os.PathLike[str]) -> Iterator[None]:
    """Raises InputError where what a checkpoint holds does not fit the script that loads it."""
    try:
        yield
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise InputError(f"{directory}: the checkpoint does not fit this script ({type(error).__name__}).") from error


def safe_name(text: str) -> str:
    """The text as a name that every file system accepts; a very long one is cut and told apart by a hash."""
    name = re.sub(r"[^A-Za-z0-9_.=-]", "_", text)
    if len(name) > 200:
        name = f"{name[:180]}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    return name


class RunDirectory:
    """The directory of one run. It is locked while the process lives, and its files are written whole or not at all."""

    def __init__(self, script: str | os.PathLike[str], args: Any, default: Any) -> None:
        """Makes the directory, or opens it to go on with the run in it.

        script: the file that runs. args, default: its Args as they are, and as the paper has them for this task.
        Raises InputError where it holds a run and --resume is missing, where it holds anything else, where another
        process uses it, and where the file system cannot write its name.
        """
        self.args = args
        self.config = describe(script, args, default)
        self._stopwatch = Stopwatch()
        self._saved_at = time.monotonic()
        self.path = path = Path(args.run_dir) if args.run_dir else self._default_path()
        try:
            found = sorted(name for name in os.listdir(path) if not SYSTEMS.match(name)) if path.exists() else []
            foreign = [name for name in found if not self._is_ours(name)]
            begun = any(name.removesuffix(".new") in (*CHECKPOINTS, "progress.json") for name in found)
            if foreign or (set(found) - {"lock", "wandb-id"} and not begun):
                raise InputError(f"{path} holds what is not a run of ours, such as {(foreign or found)[0]!r}.")
            if begun and not args.resume:
                raise InputError(f"{path} holds a run: --resume goes on with it, another --run-dir begins a new one.")
            path.mkdir(parents=True, exist_ok=True)
            self._lock = filelock.FileLock(path / "lock").acquire(timeout=0)
        except filelock.Timeout:
            raise InputError(f"Another run is using {path}.") from None
        except InputError:
            raise
        except ValueError as error:  # a character that the file system's encoding lacks, or a NUL
            raise InputError(f"No directory can have the name {str(path)!a}: {error}.") from None

    def _default_path(self) -> Path:
        """runs/<task>/<algorithm>-<shared|independent>[-<flag>=<value>...]/seed<seed>, safe for every file system."""
        setting = f"{self.config['algorithm']}-{'shared' if self.args.parameter_sharing else 'independent'}"
        for name, value in self.config["changed"].items():
            if name not in NOT_IN_DIRECTORY:
                setting += f"-{name.replace('_', '-')}={value}"
        return Path("runs", safe_name(self.args.env), safe_name(setting), f"seed{self.args.seed}")

    @staticmethod
    def _is_ours(name: str) -> bool:
        """Whether a run leaves a file of this name."""
        known = (*CHECKPOINTS, *OTHER_FILES)
        return name in known or name.removesuffix(".new") in known or name.startswith("events.out.tfevents")

    def checkpoint(self) -> dict[str, Any] | None:
        """The last checkpoint, or None. The tables that people read are made again from it where they differ.

        Raises InputError where it was made by another algorithm or with other flags.
        """
        saved = last_checkpoint(self.path)
        if saved is None:
            return None
        then, now = saved["config"], self.config
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
        if now["flags"]["total_timesteps"] > flags["total_timesteps"] and flags["eval_points"] > 1:
            intervals, total = flags["eval_points"] - 1, now["flags"]["total_timesteps"]
            apart = f"its evaluations stay {saved['budget'] / intervals:,.0f} steps apart"
            if total * intervals % saved["budget"]:  # else there would be none at its end
                step = saved["budget"] // math.gcd(saved["budget"], intervals)
                fitting = max(total // step * step, flags["total_timesteps"])
                words = f"{as_flag('total_timesteps', fitting)} or {fitting + step}"
                raise InputError(f"{self.path} cannot become so long, since {apart}: {words} fits.")
            say(f"{self.path} becomes longer; {apart}.")
        self._stopwatch = Stopwatch(**saved["seconds"])
        self._write_tables(saved)
        return saved

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
        with open(new, "wb") as file:
            file.write(in_memory.getbuffer())
            file.flush()
            os.fsync(file.fileno())  # it takes the place of a good one
        if last.exists():
            last.replace(previous)
        new.replace(last)
        self._write_tables(saved)
        self._saved_at = time.monotonic()

    @property
    def save_is_due(self) -> bool:
        """Whether the last checkpoint is older than SAVE_SECONDS, as where evaluations are far apart."""
        return time.monotonic() - self._saved_at > SAVE_SECONDS

    def _write_tables(self, saved: Mapping[str, Any]) -> None:
        table = io.StringIO()
        columns = list(dict.fromkeys(name for row in saved["rows"] for name in row))  # a later row may have more
        writer = csv.DictWriter(table, columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(saved["rows"])
        texts = {"evaluations.csv": table.getvalue(), "config.json": json.dumps(saved["config"], indent=2) + "\n"}
        for name, text in texts.items():
            path = self.path / name
            if not path.exists() or path.read_bytes() != text.encode():
                write_whole(path, text)

    def complete(self) -> None:
        """Deletes what only a running run needs."""
        for name in ("progress.json", "replay.bin"):
            (self.path / name).unlink(missing_ok=True)


# ---------------------------------------------------------------------------------------------------------------------
# The file of a replay
# ---------------------------------------------------------------------------------------------------------------------


class EpisodeFile:
    """Episodes in one memory-mapped file, as many as a replay holds and some more.

    Episode number k, from 1 on, fills slot (k - 1) % n_slots. The spare slots keep what the last two checkpoints refer
    to while later episodes are written, so that a checkpoint need not contain any episode.
    """

    def __init__(self, path: Path, fields: Mapping[str, NDArray[Any]], size: int, played: int) -> None:
        """fields: an array for each field of an episode, time first; only shapes and types count. `played` is one.

        size: how many episodes the replay holds. played: episodes played so far; 0 makes a new file.
        Says on stderr what the file takes and what is free. Raises InputError where memory or disk is too small, and
        where the file of a resumed run is gone, has another length or does not hold the last episodes.
        """
        self.checkpoint_every = -(-size // 4)  # episodes
        self.names = list(fields)
        n_slots = size + 2 * self.checkpoint_every
        slot = np.dtype([*((name, x.dtype, x.shape) for name, x in fields.items()), ("number", np.int64)])
        room = n_slots * slot.itemsize
        mib = f"{room / 2**20:,.0f} MiB"
        memory = psutil.virtual_memory().available
        where = "in memory"
        if played == 0:
            path.unlink(missing_ok=True)
            disk = psutil.disk_usage(str(path.parent)).free
            where = f"on the disk ({disk / 2**20:,.0f} free) and in memory"
            if room > disk:
                raise InputError(f"{path} would take {mib}, more than the free disk.")
        elif not path.exists():
            raise InputError(f"{path} is gone (a complete run deletes it), so this run cannot go on.")
        elif path.stat().st_size != room:
            raise InputError(f"{path} is damaged: it has another length than the replay of this run.")
        say(f"{path} takes {mib} {where} ({memory / 2**20:,.0f} free) while the run lasts.")
        if room > memory:
            raise InputError(f"{path} would take {mib}, more than the free memory.")
        if played == 0:
            with open(path, "wb") as file:
                file.truncate(room)
                if hasattr(os, "posix_fallocate"):  # take the room at once, not when the disk is full
                    os.posix_fallocate(file.fileno(), 0, room)
        self.slots = np.memmap(path, slot, "r+")
        numbers = np.arange(max(played - size, 0), played) + 1
        if not np.array_equal(self.slots["number"][(numbers - 1) % n_slots], numbers):
            raise InputError(f"{path} is damaged: it does not hold the last episodes of this run.")

    def state_dict(self) -> dict[str, Any]:
        """Nothing: a checkpoint refers to what it finds on the disk."""
        self.slots.flush()
        return {}

    def write(self, number: int, episode: Mapping[str, NDArray[Any]]) -> None:
        """Writes an episode; its arrays may be shorter than the fields."""
        slot = self.slots[(number - 1) % len(self.slots)]
        slot["number"] = number
        slot["played"] = False
        for name in self.names:
            slot[name][: len(episode[name])] = episode[name]

    def read(self, numbers: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """The episodes of these numbers, [episode, time, ...] for each field, cut to the longest of them."""
        chosen = (numbers - 1) % len(self.slots)
        played = self.slots["played"][chosen]
        unused = played.shape[1] - int(played.sum(1).max())
        return {name: self.slots[name][chosen, : self.slots[name].shape[1] - unused] for name in self.names}


# ---------------------------------------------------------------------------------------------------------------------
# What a run shows
# ---------------------------------------------------------------------------------------------------------------------

PROGRESS_SECONDS = 2.0  # between two writes of progress.json


def flush_stdout() -> None:
    """Writes what is left of the output. A reader such as `head`, which has seen enough, is no failure."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more when it exits


def say(text: str) -> None:
    """Writes a line to stderr, above a progress bar. A closed terminal, or a pipe that nobody reads, is no failure."""
    try:
        tqdm.write(text, file=sys.stderr)
        sys.stderr.flush()
    except OSError:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (it stays open)


def in_words(results: Mapping[str, float]) -> str:
    """The results of an evaluation in one line."""
    return ", ".join(f"{name} {value:.3f}" for name, value in results.items())


class Log:
    """The progress bar, TensorBoard's file, progress.json for whoever watches many runs, and Weights & Biases."""

    def __init__(self, path: Path, args: Any, timestep: int, resumed: bool) -> None:
        """path: of the run's directory. What TensorBoard's file says of steps after `timestep` is taken back."""
        from torch.utils.tensorboard import SummaryWriter

        if args.track:
            wandb = optional("wandb")
            if not (path / "wandb-id").exists():
                write_whole(path / "wandb-id", f"{secrets.token_hex(8)}\n")
            identity = (path / "wandb-id").read_text().strip()
            try:
                wandb.init(id=identity, name=str(path), config=vars(args), resume="allow", sync_tensorboard=True)
            except wandb.errors.Error as error:  # nobody is logged in, for one
                raise InputError(f"--track: {error}") from error
        write_whole(path / "progress.json", "{}\n")  # on a full disk it ends here, and not in a thread of TensorBoard
        self.path, self.total = path, args.total_timesteps
        self.begun_at = self.timestep = timestep
        self.started = self.shown = time.monotonic()
        self.last_evaluation: float | None = None
        self.returns: deque[float] = deque(maxlen=100)  # of the last training episodes
        self.lengths: deque[float] = deque(maxlen=100)
        threading.excepthook = show_error
        self.writer = SummaryWriter(str(path), purge_step=timestep + 1 if resumed else None)
        self.bar = tqdm(total=self.total, initial=timestep, unit=" steps", unit_scale=True, disable=None)
        say(f"This run is kept in {path}")

    def evaluation(self, timestep: int, results: Mapping[str, float]) -> None:
        """Shows an evaluation."""
        self.last_evaluation = results["return_mean"]
        for name, value in results.items():
            self.writer.add_scalar(f"evaluation/{name}", value, timestep)
        say(f"step {timestep:,}: {in_words(results)}")

    def batch(
        self, timestep: int, returns: Sequence[float], lengths: Sequence[float], metrics: Mapping[str, Any]
    ) -> None:
        """Shows a batch of training episodes that ends at this timestep.

        returns, lengths: of its episodes.
        metrics: tensors of one number, by group and name. TensorBoard gets a thousand points a run. A loss that is not
        finite ends the process.
        """
        figures = {name: value.item() for name, value in metrics.items()}
        for name, value in figures.items():
            if name.startswith("loss/") and not math.isfinite(value):
                sys.exit(f"{name} is {value} at step {timestep:,}; the last checkpoint is kept.")
        self.returns.extend(returns)
        self.lengths.extend(lengths)
        now = time.monotonic()
        speed = (timestep - self.begun_at) / max(now - self.started, 1e-9)
        recent = fmean(self.returns)
        if now - self.shown >= PROGRESS_SECONDS:
            self.shown = now
            progress = {
                "timestep": timestep,
                "total_timesteps": self.total,
                "steps_per_second": speed,
                "training_return": recent,
                "evaluation_return": self.last_evaluation,
            }
            write_whole(self.path / "progress.json", json.dumps(progress) + "\n")
        said = "" if self.last_evaluation is None else f", evaluation {self.last_evaluation:.3f}"
        self.bar.set_postfix_str(f"return {recent:.3f}{said}", refresh=False)
        self.bar.update(timestep - self.timestep)
        due = timestep * 1000 // self.total > self.timestep * 1000 // self.total
        self.timestep = timestep
        if due:
            self.writer.add_scalar("training/return_mean", recent, timestep)
            self.writer.add_scalar("training/episode_length", fmean(self.lengths), timestep)
            self.writer.add_scalar("training/steps_per_second", speed, timestep)
            for name, value in figures.items():
                self.writer.add_scalar(name, value, timestep)

    def close(self) -> None:
        """Ends the progress bar and TensorBoard's file."""
        self.bar.close()
        self.writer.close()


def show_error(failure: threading.ExceptHookArgs) -> None:
    """Shows what went wrong in a thread, but not in TensorBoard's: it keeps an error, such as a full disk, for the next
    call of its writer, and so the main thread ends with a sentence."""
    if not type(failure.thread).__module__.startswith("tensorboard."):
        threading.__excepthook__(failure)


def optional(package: str, extra: str | None = None) -> ModuleType:
    """Imports a package that only an extra of ours brings along (by default one of the package's own name).

    Raises InputError, naming the extra, where it is not installed.
    """
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError:
        raise InputError(f"{package} is not installed; pip install -e '.[{extra or package}]' does it.") from None


# ---------------------------------------------------------------------------------------------------------------------
# The process and the machine
# ---------------------------------------------------------------------------------------------------------------------


class Stopwatch:
    """Wall and CPU seconds of a run, summed over its processes. A clock that is set anew does not disturb it."""

    def __init__(self, wall_seconds: float = 0.0, cpu_seconds: float = 0.0) -> None:
        """The seconds that earlier processes have spent on the run."""
        self._wall_start = time.monotonic() - wall_seconds
        self._cpu_start = time.process_time() - cpu_seconds

    def seconds(self) -> dict[str, float]:
        """The seconds spent so far."""
        return {
            "wall_seconds": time.monotonic() - self._wall_start,
            "cpu_seconds": time.process_time() - self._cpu_start,
        }


class StopSignals:
    """Notes Ctrl-C, SIGTERM and SIGHUP instead of dying at once, so that a run can save what it has.

    The third Ctrl-C ends it at once, since an environment may hang. Its last checkpoints stay as they are.
    """

    advice = "the same command with --resume goes on"

    def __init__(self) -> None:
        self.received: int | None = None
        self.interrupts = 0
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            ignored = name == "SIGHUP" and number and signal.getsignal(number) is signal.SIG_IGN  # by `nohup`
            if number is not None and not ignored:
                signal.signal(number, self._note)

    def _note(self, number: int, frame: Any) -> None:
        self.received = number
        self.interrupts += number == signal.SIGINT
        if self.interrupts > 2:
            raise KeyboardInterrupt

    def exit(self, timestep: int) -> None:
        """Ends the process as a shell expects it, with 128 plus the signal's number: 130, 143 or 129."""
        say(f"Stopped at step {timestep:,}; {self.advice}.")
        sys.exit(128 + (self.received or 0))


def open_streams() -> None:
    """Gives a process that was started with closed output (`2>&-`) streams that lead nowhere."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 (it stays open)
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115


@contextlib.contextmanager
def one_sentence(script: str | os.PathLike[str]) -> Iterator[None]:
    """What goes wrong in a script for a reason that is not the script's ends with one sentence and exit code 2.

    Such reasons are wrong input, a full disk or a lack of memory. Ctrl-C before a run can save anything ends with exit
    code 130.
    """
    open_streams()
    try:
        yield
        flush_stdout()
    except (InputError, OSError, MemoryError) as error:
        say(f"{Path(script).stem}: {str(error) or 'there is not enough memory.'}")
        if isinstance(error, BrokenPipeError):
            flush_stdout()
        sys.exit(2)
    except RuntimeError as error:
        if not re.search("allocate memory|out of memory", str(error)):  # PyTorch's words, of a CPU or a GPU
            raise
        say(f"{Path(script).stem}: there is not enough memory.")
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)


def keep_freed_memory() -> None:
    """Tells glibc to keep the memory that PyTorch's intermediate results leave.

    They are 0.1 to 3 MB large. By default glibc gives so much back to the system, and fetches it again for the next
    one. Where there is another C library nothing happens.
    """
    m_trim_threshold, m_mmap_threshold = -1, -3  # as in malloc.h
    with contextlib.suppress(OSError, AttributeError, TypeError):  # TypeError: Windows has no library without a name
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(m_mmap_threshold, 2**25)
        mallopt(m_trim_threshold, 2**31 - 1)


PACKAGES = ("torch", "numpy", "gymnasium", "numba")


def describe(script: str | os.PathLike[str], args: Any, default: Any) -> dict[str, Any]:
    """What config.json says of a run: what was computed, and where a result came from, in plain types.

    script: the file of the running script; its text is named by a hash, so that a changed copy is told apart.
    args, default: the script's Args as they are, and as the paper has them for this task.
    """
    return {
        "algorithm": Path(script).stem,
        "flags": vars(args),
        "changed": changed_flags(args, default),
        "paper_timesteps": default.total_timesteps,
        "version": importlib.metadata.version("marl-baselines"),
        "script": script_hash(script),
        **provenance(),
    }


def script_hash(script: str | os.PathLike[str]) -> str:
    """Names the text of a script."""
    return hashlib.sha256(Path(script).read_bytes()).hexdigest()[:16]


def provenance() -> dict[str, Any]:
    """Where a result came from, in plain types: command, packages, commit, machine, MKL's fast kernels."""
    return {
        "command": sys.argv,
        "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
        "commit": _commit(),
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
        "fast_mkl": fast_mkl.LOADED,
    }


def _commit() -> str | None:
    """The checkout's commit, "-dirty" behind it where files were changed; None outside a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    if not Path(__file__).parents[1].joinpath(".git").exists():  # installed somewhere, perhaps in another checkout
        return None
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def _processor() -> str:
    """The processor's model; `platform` knows only its architecture on Linux."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor()
