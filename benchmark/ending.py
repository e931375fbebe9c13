"""How the programs of this folder end where the user, and not the program, is the reason."""

import contextlib
import os
import signal
import sys
from collections.abc import Iterator

from envs import runs


@contextlib.contextmanager
def quiet_end(program: str | os.PathLike[str]) -> Iterator[None]:
    """Wrong input, a full disk or a lack of memory: one sentence and exit code 2. Ctrl-C: exit code 130."""
    with runs.one_sentence(program):
        try:
            yield
        except KeyboardInterrupt:
            sys.exit(128 + signal.SIGINT)
