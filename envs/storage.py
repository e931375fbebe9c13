"""Room for large files: what a replay needs, and what the machine has."""

from __future__ import annotations

import sys
from pathlib import Path

import psutil

from envs.tasks import InputError


def require_room(path: Path, size: int) -> None:
    """Say on stderr what a memory-mapped file of `size` bytes takes, and what is free.

    A file that is there already has its room on the disk. Raises InputError where memory or disk is too small.
    """
    memory, disk = psutil.virtual_memory().available, psutil.disk_usage(str(path.parent)).free
    disk += path.stat().st_size if path.exists() else 0
    print(
        f"{path} takes {size / 2**20:,.0f} MiB of the disk ({disk / 2**20:,.0f} free), "
        f"and as much memory while in use ({memory / 2**20:,.0f} free).",
        file=sys.stderr,
    )
    if size > min(memory, disk):
        missing = "memory" if size > memory else "disk"
        raise InputError(f"{path} would take {size / 2**20:,.0f} MiB, more than the free {missing}.")
