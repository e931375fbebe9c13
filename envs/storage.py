"""Room for the file of a replay: what it needs, and what the machine has."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import psutil

from envs.tasks import InputError


def reserve(path: Path, size: int, new: bool) -> None:
    """Make a file of `size` bytes to be mapped into memory, or find the one that is there if it is not new.

    Says on stderr what it takes and what is free. Its room on the disk is taken at once where the system can do that.
    Raises InputError where memory or disk is too small, or where a file to go on with is gone.
    """
    memory = psutil.virtual_memory().available
    if not new and not path.exists():
        raise InputError(f"{path} is gone (a complete run deletes it), so this run cannot go on.")
    if new:
        path.unlink(missing_ok=True)
        disk = psutil.disk_usage(str(path.parent)).free
        where = f"on the disk ({disk / 2**20:,.0f} free) and "
    else:
        disk, where = size, ""
    print(
        f"{path} takes {size / 2**20:,.0f} MiB {where}in memory ({memory / 2**20:,.0f} free) while the run lasts.",
        file=sys.stderr,
    )
    if size > min(memory, disk):
        missing = "memory" if size > memory else "disk"
        raise InputError(f"{path} would take {size / 2**20:,.0f} MiB, more than the free {missing}.")
    if new:
        with open(path, "wb") as file:
            file.truncate(size)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
