"""The process of a run and the machine: streams, signals, seconds, how it ends, where its results come from."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import functools
import hashlib
import importlib.metadata
import io
import math
import os
import platform
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from tqdm import tqdm

from envs.runs import fast_mkl
from envs.vector import InputError, WorkerLost

KILLED = 128 + 9  # the exit code of a shell whose program was killed, and of a run whose worker was
ECHO_SECONDS = 3.0  # within which a signal is the same one again


def show(text: str) -> None:
    """Writes a line to stdout. A reader such as `head`, which has seen enough, is no failure."""
    with contextlib.suppress(BrokenPipeError):
        print(text)
    flush_stdout()


def flush_stdout() -> None:
    """Writes what is left of the output, to nowhere where nobody reads it any more."""
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


def open_streams() -> None:
    """Gives a process that was started with closed output (`2>&-`) streams that lead nowhere.

    What a terminal cannot show of a name, such as an accent, it shows as a number, and the process goes on.
    """
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 (it stays open)
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


class Parser(argparse.ArgumentParser):
    """Reads a command line; what is wrong with it is one sentence."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """See `argparse`. An empty word, mostly an unset variable of a shell, is wrong where it is not the default."""
        words = sys.argv[1:] if args is None else [*args]
        ours = words[: words.index("--")] if "--" in words else words
        for before, word in zip(["", *ours], ours):
            option, equals, value = word.partition("=")
            name = before if not word else option
            empty = not word or (option.startswith("--") and equals and not value)
            if empty and self.get_default(name.removeprefix("--").replace("-", "_")) != "":
                self.error(f"{word.removesuffix('=') or name or 'the first word'} is given an empty value")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Raises InputError, which `one_sentence` shows."""
        raise InputError(f"{message}; {self.prog} --help lists what there is.")


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

    Since an environment may hang, the third Ctrl-C, the second SIGTERM and the second SIGHUP end the process at once;
    its last checkpoints stay as they are. What comes within ECHO_SECONDS is the same SIGTERM again: `timeout`, for one,
    sends it to a process and then to its group.
    """

    advice = "the same command with --resume goes on"

    def __init__(self) -> None:
        self.received: int | None = None
        self.before: dict[int, Any] = {}  # what each did before
        self.counted: dict[int, int] = {}  # how often each has come
        self.since = -math.inf  # when the last one came that was no Ctrl-C
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            ignored = name == "SIGHUP" and number and signal.getsignal(number) is signal.SIG_IGN  # by `nohup`
            if number is not None and not ignored:
                self.counted[number] = 0
                self.before[number] = signal.signal(number, self._note)

    def keep(self) -> None:
        """Takes them again where a game has taken one for itself."""
        for number in self.counted:
            if signal.getsignal(number) != self._note:
                signal.signal(number, self._note)

    def give_back(self) -> None:
        """From here on each does what it did before: nothing is left to save, and what follows can be ended."""
        for number, handler in self.before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: Any) -> None:
        first = self.received is None
        self.received = number
        needed = 2
        if number == signal.SIGINT:
            needed = 3
        elif time.monotonic() - self.since < ECHO_SECONDS:
            return
        else:
            self.since = time.monotonic()
        self.counted[number] += 1
        if self.counted[number] == needed:
            for each in self.counted:
                signal.signal(each, signal.SIG_DFL)  # should what follows hang, too
            raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)
        if first:
            times = "twice" if needed == 3 else "once"
            line = f"Stopping after this batch; {times} more ends the process at once.\n"
            with contextlib.suppress(OSError):  # not by `say`: this may have interrupted a line that is being written
                os.write(2, f"{os.linesep if os.isatty(2) else ''}{line}".encode())

    def exit(self, timestep: int) -> None:
        """Ends the process as a shell expects it, with 128 plus the signal's number: 130, 143 or 129."""
        say(f"Stopped at step {timestep:,}; {self.advice}.")
        sys.exit(128 + (self.received or 0))


def ends_with_parent() -> Callable[[], Any] | None:
    """For `preexec_fn` of subprocess.Popen: the new process is killed when this one ends, however that happens.

    None where the system is not Linux, which alone can do that.
    """
    pr_set_pdeathsig = 1  # as in sys/prctl.h
    if sys.platform != "linux":
        return None
    return functools.partial(ctypes.CDLL(None).prctl, pr_set_pdeathsig, signal.SIGKILL)


class Diverged(Exception):
    """A training has come to a loss that is no finite number; the message is one sentence."""


def with_flags(sentence: str) -> str:
    """A sentence of `envs` for the command line: `env_kwargs` becomes --env-kwargs."""
    return re.sub("`([a-z]+_[a-z_]+)`", lambda option: "--" + option[1].replace("_", "-"), sentence)


@contextlib.contextmanager
def one_sentence(script: str | os.PathLike[str]) -> Iterator[None]:
    """What goes wrong in a script for a reason that is not the script's ends with one sentence and exit code 2.

    Such reasons are wrong input, a full disk or a lack of memory. Where a training diverges the code is 1, after Ctrl-C
    before a run can save anything 130, and where others have killed a worker process 137.
    """
    open_streams()
    try:
        yield
        flush_stdout()
    except (InputError, OSError, MemoryError) as error:
        say(f"{Path(script).stem}: {with_flags(str(error)) or 'there is not enough memory.'}")
        if isinstance(error, BrokenPipeError):
            flush_stdout()
        sys.exit(KILLED if isinstance(error, WorkerLost) else 2)
    except Diverged as error:
        say(f"{Path(script).stem}: {error}")
        sys.exit(1)
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


def project_version() -> str:
    """This project's version. A checkout says it itself, and need not be installed."""
    project = Path(__file__).parents[2] / "pyproject.toml"
    if project.exists():
        return tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"]
    return importlib.metadata.version("marl-baselines")


def _commit() -> str | None:
    """The checkout's commit, "-dirty" behind it where files were changed; None outside a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    if not Path(__file__).parents[2].joinpath(".git").exists():  # installed somewhere, perhaps in another checkout
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
