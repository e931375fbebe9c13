"""Games that are not compiled, played in this process or, several at once, in worker processes."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import select
import signal
import sys
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Iterator, Mapping
from multiprocessing import resource_tracker, util
from multiprocessing.connection import Connection
from types import ModuleType
from typing import Any

import numpy as np

from envs.vector import InputError, WorkerLost

HANGS = 2.0  # seconds after which a game that does not return is no longer waited for, but told to close
LOOK = 1.0  # seconds between two looks whether a worker that says nothing is still there
PATIENCE = 8.0  # seconds that it then has to close

NO_MAIN = ModuleType("__main__")  # see hidden_main
STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def ignore_stops(connection: Connection) -> None:
    """Makes a worker outlive what stops its parent, which first saves the run and then ends the connection.

    A closed terminal and `timeout` signal a group of processes; systemd and Slurm signal every single one.
    """
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)
    if not hasattr(signal, "pthread_sigmask"):  # Windows has neither groups nor masks
        return
    os.setsid()
    ended = select.poll()
    ended.register(connection, 0)  # of its events only the end, which is always reported
    # A game that hangs in a call does not see the connection's end: the parent then sends SIGTERM. The exit closes it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit() if ended.poll(0) else None)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)


def follow(parent: Any) -> None:
    """Ends this process some seconds after its parent, where a game that hangs keeps it from ending by itself.

    And what the game has started.
    """
    parent.join()
    time.sleep(PATIENCE)
    kill_group(os.getpid())
    os._exit(1)


def kill_group(leader: int) -> None:
    """Ends a process that leads a group, as `ignore_stops` has it, and what it has started. Windows has no groups."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(leader, signal.SIGKILL)


def end(connections: list[Connection], workers: list[Any]) -> None:
    """Tells workers that nobody needs their games any more, and ends those whose games do not let them."""
    for connection in connections:
        connection.close()
    for stop, seconds in (("terminate", HANGS), ("kill", PATIENCE)):
        begun = time.monotonic()
        for worker in workers:
            worker.join(max(begun + seconds - time.monotonic(), 0))
            if worker.is_alive():
                getattr(worker, stop)()
    for worker in workers:
        worker.join(HANGS)
        if worker.exitcode != 0:  # it could not end by itself, so what its games have started may still be there
            kill_group(worker.pid)


def read(connection: Connection) -> Any:
    """What the other process has sent, or None where it has ended, or does not need this one any more."""
    try:
        return connection.recv()
    except (EOFError, OSError):
        return None


def write(connection: Connection, message: Any) -> None:
    """Sends it; nothing where the other process has ended. What it said last can still be read."""
    with contextlib.suppress(OSError):
        connection.send(message)


def serve(connection: Connection, build: Callable[[], Any], n_games: int) -> None:
    """A worker process: builds its games and calls their methods on request, until the connection ends.

    A request is the name of a method and, for some of the games, the arguments. The answer is the list of results; or,
    before the process ends, an InputError, or the text of another error's traceback.
    """
    ignore_stops(connection)
    threading.Thread(target=follow, args=(multiprocessing.parent_process(),), daemon=True).start()
    games = []
    try:
        for _ in range(n_games):
            games.append(build())
        while (request := read(connection)) is not None:
            method, arguments = request
            write(connection, [getattr(games[i], method)(*values) for i, values in arguments])
    except InputError as error:
        write(connection, error)
    except Exception:
        write(connection, traceback.format_exc())
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the games are being closed
        close(games)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def close(games: list[Any]) -> None:
    """Closes games, each once, and also those behind one that fails. Says what fails: at an end nobody can mend it."""
    while games:
        try:
            games.pop(0).close()
        except InputError as error:
            print(error, file=sys.stderr)


@contextlib.contextmanager
def hidden_main() -> Iterator[None]:
    """A new process would import the main program again: a script, and with it PyTorch, which no game needs."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = NO_MAIN
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextlib.contextmanager
def held_signals() -> Iterator[None]:
    """A process that begins here is not stopped before `serve` has said what stops it. Windows has no such mask."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # the first process would begin it, and it lifts the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


OPEN: weakref.WeakSet[Games] = weakref.WeakSet()  # in this program


@contextlib.contextmanager
def closed_games() -> Iterator[None]:
    """A whole program: at its end it closes its games, and what they leave behind does not keep it from its end.

    Python waits for threads and processes, without a word and for ever.
    """
    before = {*threading.enumerate()}
    code = 1
    try:
        yield
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        raise
    finally:
        for games in [*OPEN]:
            games.close()
        if left_behind(before):
            threading.Thread(target=wait_no_longer, args=(before, code), daemon=True).start()


def left_behind(before: set[threading.Thread]) -> list[Any]:
    """Processes, and threads that were not there before, for which Python would wait."""
    threads: list[Any] = [each for each in threading.enumerate() if each not in before and not each.daemon]
    return threads + [each for each in multiprocessing.active_children() if not each.daemon]


def wait_no_longer(before: set[threading.Thread], code: int) -> None:
    """Ends this program after some seconds, with its exit code, if it is still there."""
    time.sleep(PATIENCE)
    left = left_behind(before)
    if not left:  # the last has just ended, and the program ends by itself
        return
    number = f"{len(left)} threads or processes, such as {left[0].name}"
    print(f"Something that a game has started has not ended by itself: {number}.", file=sys.stderr)
    for process in multiprocessing.active_children():
        process.kill()
    os._exit(code)


class Games:
    """One game for each sub-environment. What they return does not depend on where they are played."""

    def __init__(self, name: str, build: Callable[[], Any], n_games: int, n_workers: int) -> None:
        """build: makes a game, in the process where it is played. n_workers: 0 plays all games in this process.

        Each worker plays a block of consecutive games, one after the other.
        """
        self.name = name
        OPEN.add(self)
        self._here: list[Any] = []
        self._workers: list[Any] = []
        self._connections: list[Connection] = []
        self._place: list[tuple[int, int]] = []  # of each game: its worker, and its number there
        # A program that ends without `close` closes its games, and says to the workers that it ends, before it waits
        # for processes that games have started.
        if n_workers == 0:
            util.Finalize(self, close, [self._here], exitpriority=0)
            for _ in range(n_games):
                self._here.append(build())
            return
        util.Finalize(self, end, [self._connections, self._workers], exitpriority=0)
        context = multiprocessing.get_context("spawn")
        for worker, block in enumerate(np.array_split(np.arange(n_games), min(n_workers, n_games))):
            self._place += [(worker, i) for i in range(len(block))]
            ours, theirs = context.Pipe()
            process = context.Process(target=serve, args=(theirs, build, len(block)))
            with hidden_main(), held_signals():
                process.start()
            theirs.close()
            self._workers.append(process)
            self._connections.append(ours)

    def call(self, method: str, arguments: Mapping[int, tuple[Any, ...]]) -> list[Any]:
        """Call a method of some of the games. Returns the results, in the order of the arguments.

        Raises what the game raises; from a worker process a RuntimeError with the worker's traceback, and WorkerLost
        where others have killed the process. After that, and after an interrupted call, the workers have ended.
        """
        if self._here:
            return [getattr(self._here[game], method)(*values) for game, values in arguments.items()]
        if not self._connections or self._connections[0].closed:
            raise RuntimeError(f"{self.name}: it was closed, or a call to its worker processes was interrupted.")
        requests: dict[int, list[tuple[int, tuple[Any, ...]]]] = {}
        for game, values in arguments.items():
            worker, i = self._place[game]
            requests.setdefault(worker, []).append((i, values))
        try:
            for worker, request in requests.items():
                write(self._connections[worker], (method, request))
            answers = {worker: iter(self._answer(worker)) for worker in requests}
        except BaseException:  # interrupted: an answer that is still to come would be taken for that to the next call
            end(self._connections, self._workers)
            raise
        return [next(answers[self._place[game][0]]) for game in arguments]

    def close(self) -> None:
        """End the games and their processes."""
        close(self._here)
        end(self._connections, self._workers)

    def _answer(self, worker: int) -> list[Any]:
        # A process that a game has started has the worker's end of the connection, too, and may keep it open.
        while not self._connections[worker].poll(LOOK) and self._workers[worker].is_alive():
            pass
        answer = read(self._connections[worker]) if self._connections[worker].poll(0) else None
        if isinstance(answer, list):
            return answer
        self.close()
        if isinstance(answer, InputError):
            raise answer
        if answer is None:
            code = self._workers[worker].exitcode
            if code == -getattr(signal, "SIGKILL", 0):
                raise WorkerLost(f"{self.name}: worker process {worker} was killed, perhaps since memory ran out.")
            raise InputError(f"{self.name}: worker process {worker} has ended without a word (exit code {code}).")
        raise RuntimeError(f"{self.name}: worker process {worker} has ended with this error:\n\n{answer}")
