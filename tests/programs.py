"""Programs in processes of their own that begin at once.

Each is forked from a server, one for each process of pytest, that has imported what programs import: this takes them
several seconds otherwise. Only this differs from a start by `subprocess`, so what a test asks of the imports
themselves, of the interpreter's flags or of another checkout needs a new interpreter. Where forks are not safe
(macOS) or not there (Windows), programs start as usual.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[1]
FORKS = sys.platform == "linux"

Words = Sequence[object]


class Program:
    """As subprocess.Popen(words, cwd=cwd, stdout=DEVNULL, stderr=PIPE, text=True); `words` begin with sys.executable.

    stdout, stderr: files that get the program's output in the place of these.
    """

    def __init__(
        self,
        words: Words,
        cwd: object = None,
        env: Mapping[str, str] | None = None,
        stdout: IO[str] | None = None,
        stderr: IO[str] | None = None,
    ) -> None:
        assert words[0] == sys.executable
        program = {"words": [*map(str, words[1:])], "cwd": str(cwd or os.getcwd()), "env": dict(env or os.environ)}
        said, says = os.pipe()
        self.stderr = os.fdopen(said, encoding="utf-8")
        with open(os.devnull, "w") as nowhere, os.fdopen(says, "w") as pipe:
            files = [(stdout or nowhere).fileno(), (stderr or pipe).fileno()]
            self.pid = int(_ask(program, files)["pid"])
        self.returncode: int | None = None

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.stderr.close()
        self.wait()

    def poll(self) -> int | None:
        """The exit code, once the program has ended."""
        if self.returncode is None:
            self.returncode = _ask({"ended": self.pid})["code"]
        return self.returncode

    def wait(self, timeout: float = 300) -> int:
        """Waits for the end. Raises subprocess.TimeoutExpired, after a kill."""
        deadline = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > deadline:
                self.kill()
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(0.01)
        return code

    def communicate(self, timeout: float = 300) -> tuple[None, str]:
        """Waits for the end; what is left of stderr."""
        self.wait(timeout)
        return None, self.stderr.read()

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def start(words: Words) -> Program | subprocess.Popen[str]:
    """A program that runs beside the test."""
    if FORKS:
        return Program(words)
    return subprocess.Popen([str(word) for word in words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def run(
    words: Words, cwd: object = None, env: Mapping[str, str] | None = None, timeout: float = 300
) -> subprocess.CompletedProcess[str]:
    """As subprocess.run(words, cwd=cwd, env=env, timeout=timeout, capture_output=True, text=True)."""
    command = [str(word) for word in words]
    if not FORKS:
        options: Any = {"cwd": cwd, "env": env, "timeout": timeout}
        return subprocess.run(command, capture_output=True, text=True, **options)
    with tempfile.TemporaryFile("w+") as stdout, tempfile.TemporaryFile("w+") as stderr:
        with Program(words, cwd, env, stdout, stderr) as program:
            code = program.wait(timeout)
        stdout.seek(0)
        stderr.seek(0)
        return subprocess.CompletedProcess(command, code, stdout.read(), stderr.read())


_server: dict[str, Any] = {}  # "connection" and "process", from the first program on


def _ask(request: dict[str, Any], files: Sequence[int] = ()) -> Any:
    if not _server:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            command = [sys.executable, __file__, str(theirs.fileno())]
            process = subprocess.Popen(command, pass_fds=[theirs.fileno()], cwd=ROOT, stdin=subprocess.DEVNULL)
        _server.update(connection=ours, process=process)
        atexit.register(_end)
    socket.send_fds(_server["connection"], [json.dumps(request).encode()], files)
    return json.loads(_server["connection"].recv(1000))


def _end() -> None:
    _server["connection"].close()
    _server["process"].wait()


def _serve(connection: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Forks for each program. Returns in a fork, with the program and its files, and where no more programs come."""
    while True:
        message, files, _, _ = socket.recv_fds(connection, 2**20, 2)
        if not message:
            return None
        request = json.loads(message)
        if "ended" in request:
            process, status = os.waitpid(request["ended"], os.WNOHANG)
            answer = {"code": os.waitstatus_to_exitcode(status) if process else None}
        else:
            process = os.fork()
            if process == 0:
                connection.close()
                return request, files
            answer = {"pid": process}
            for file in files:
                os.close(file)
        connection.send(json.dumps(answer).encode())


def _main() -> None:
    from envs import runs  # isort: skip  # noqa: F401 (before PyTorch, as in the scripts)
    import torch._dynamo  # by the first optimiser
    import torch.utils.tensorboard  # noqa: F401

    import benchmark.store  # noqa: F401
    import envs

    for task in ("matrix-climbing", "lbf-5x5-2p-1f"):  # compiled rules
        env = envs.make(task)
        env.reset()
        env.step(env.action_mask.argmax(axis=2))
    gc.freeze()  # or each program's collections would look at, and copy, all that was imported
    started = _serve(socket.socket(fileno=int(sys.argv[1])))
    if started is None:
        return
    program, files = started
    for stream, file in zip((1, 2), files):
        os.dup2(file, stream)
        os.close(file)
    os.environ.clear()
    os.environ.update(program["env"])
    os.chdir(program["cwd"])
    how, *words = program["words"]
    if how in ("-c", "-m"):
        what, *words = words
        sys.path[0] = os.getcwd()
    if how == "-m":
        sys.argv = ["-m", *words]
        runpy.run_module(what, run_name="__main__", alter_sys=True)
    elif how == "-c":
        sys.argv = ["-c", *words]
        exec(compile(what, "<string>", "exec"), {"__name__": "__main__"})
    else:
        sys.argv, sys.path[0] = [how, *words], str(Path(how).resolve().parent)
        runpy.run_path(how, run_name="__main__")


if __name__ == "__main__":
    _main()
