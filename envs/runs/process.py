"""The process of a run: its seconds, the signals that stop it, what ends with it, its memory."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

from envs.runs.terminal import say

ECHO_SECONDS = 3.0  # within which a signal is the same one again


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
