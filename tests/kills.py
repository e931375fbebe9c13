"""What a process leaves that is killed, or meets a full disk, at any one of its file operations; and their order."""

import builtins
import errno
import io
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

NAMES = ("mkdir", "rename", "replace", "rmdir", "remove", "unlink")  # of os: pathlib and shutil call these


class Operations:
    """Counts a process's file operations, as a context: opening for writing, writing, and those of NAMES.

    fault: what happens in place of number `at`, from 0 on; of what is to be written, the first half is.
    """

    def __init__(self, at: int, fault: Callable[[], Any]) -> None:
        self.left, self.fault, self.patches = at, fault, [mock.patch.object(os, name, self.of(name)) for name in NAMES]
        self.patches += [mock.patch.object(owner, "open", self.open(owner.open)) for owner in (builtins, io)]

    def __enter__(self) -> "Operations":
        for patch in self.patches:
            patch.start()
        return self

    def __exit__(self, *_: object) -> None:
        for patch in self.patches:
            patch.stop()

    def count(self) -> None:
        self.left -= 1
        if self.left == -1:
            self.fault()

    def of(self, name: str) -> Callable[..., Any]:
        function = getattr(os, name)

        def counted(*words: Any, **more: Any) -> Any:
            self.count()
            return function(*words, **more)

        return counted

    def open(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def opened(file: Any, mode: str = "r", *words: Any, **more: Any) -> Any:
            if mode[0] not in "wax+":
                return function(file, mode, *words, **more)
            self.count()
            made = function(file, mode, *words, **more)
            write = made.write

            def counted(content: Any) -> Any:
                if self.left == 0:
                    write(content[: len(content) // 2])
                    made.flush()
                self.count()
                return write(content)

            writer = mock.MagicMock(wraps=made)
            writer.__enter__.return_value = writer
            writer.__exit__.side_effect = made.__exit__
            writer.write.side_effect = counted
            writer.writelines.side_effect = lambda pieces: [counted(piece) for piece in pieces]
            return writer

        return opened


def killed_everywhere(before: Path, place: Path, act: Callable[[], Any]) -> Iterator[int]:
    """Yields after each kill -9 of a process that acts on a copy of `before` in `place`: at its first file operation,
    at its second, and so on, until it comes to its end; then once more."""
    for at in range(1000):
        _copy(before, place)
        child = os.fork()
        if child == 0:
            try:
                with Operations(at, lambda: os.kill(os.getpid(), signal.SIGKILL)):
                    act()
                os._exit(0)
            finally:
                os._exit(1)  # an error of the act
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert code in (0, -signal.SIGKILL)
        yield at
        if code == 0:
            return


def full_everywhere(before: Path, place: Path, act: Callable[[], Any]) -> Iterator[OSError | None]:
    """The same with a full disk in place of the kill: yields the error that came out of the act, or None."""

    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for at in range(1000):
        _copy(before, place)
        error = None
        with Operations(at, full) as operations:
            try:
                act()
            except OSError as raised:
                error = raised
        if operations.left >= 0:
            return
        yield error


def _copy(before: Path, place: Path) -> None:
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(before, place)


def note_order(monkeypatch: Any) -> list[str]:
    """What is done from now on for the disk: which files are waited for, which take the place of others, and when a
    replay is flushed."""
    order: list[str] = []
    fsync, replace, flush = os.fsync, os.replace, np.memmap.flush

    def note_fsync(number: int) -> None:
        path = next(path for path in Path("/proc/self/fd").iterdir() if path.name == str(number))
        order.append(f"sync {path.readlink().name}")
        fsync(number)

    def note_replace(new: Any, path: Any) -> None:
        order.append(f"{Path(new).name} -> {Path(path).name}")
        replace(new, path)

    def note_flush(slots: Any) -> None:
        order.append("flush replay")
        flush(slots)

    monkeypatch.setattr(os, "fsync", note_fsync)
    monkeypatch.setattr(os, "replace", note_replace)
    monkeypatch.setattr(np.memmap, "flush", note_flush)
    return order
