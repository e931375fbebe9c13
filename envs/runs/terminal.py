"""How a program reads its command line, what it says, and how it ends."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from tqdm import tqdm

from envs.vector import InputError, WorkerLost

KILLED = 128 + 9  # the exit code of a shell whose program was killed, and of a run whose worker was


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
