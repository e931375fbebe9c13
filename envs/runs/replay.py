"""The file of a replay."""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from envs.runs.directory import naming
from envs.runs.terminal import say
from envs.vector import InputError


class EpisodeFile:
    """Episodes in one memory-mapped file, as many as a replay holds and some more.

    Episode number k, from 1 on, fills slot (k - 1) % n_slots. The spare slots keep what the last two checkpoints refer
    to while later episodes are written, so that a checkpoint need not contain any episode. At its end a slot has the
    number of its episode and a check sum of all before it, 0 in files of older versions.
    """

    def __init__(self, path: Path, fields: Mapping[str, NDArray[Any]], size: int, played: int) -> None:
        """fields: an array for each field of an episode, time first; only shapes and types count. `played` is one.

        size: how many episodes the replay holds. played: episodes played so far; 0 makes a new file.
        Says on stderr what the file takes and what is free. Raises InputError where memory or disk is too small, and
        where the file of a resumed run is gone, has another length or does not hold the last episodes as they were.
        """
        self.checkpoint_every = -(-size // 4)  # episodes
        self.names = list(fields)
        n_slots = size + 2 * self.checkpoint_every
        smaller = "`max_episode_steps` makes episodes of environments that are not ours shorter"
        episode = sum(x.nbytes for x in fields.values()) + 8
        if episode >= 2**31:
            raise InputError(
                f"An episode takes {episode / 2**20:,.0f} MiB, and a replay holds episodes of up to 2,047; {smaller}."
            )
        smaller = f"`buffer_size` makes it smaller, and {smaller}"
        slot = np.dtype(
            [*((name, x.dtype, x.shape) for name, x in fields.items()), ("number", "<u4"), ("check", "<u4")]
        )
        room = n_slots * slot.itemsize
        mib = f"{room / 2**20:,.0f} MiB"
        memory = psutil.virtual_memory().available
        where = "in memory"
        if played == 0:
            path.unlink(missing_ok=True)
            disk = psutil.disk_usage(str(path.parent)).free
            where = f"on the disk ({disk / 2**20:,.0f} free) and in memory"
            if room > disk:
                raise InputError(f"{path} would take {mib}, more than the free disk; {smaller}.")
        elif not path.exists():
            raise InputError(f"{path} is gone (a complete run deletes it), so this run cannot go on.")
        elif path.stat().st_size != room:
            raise InputError(f"{path} is damaged: it has another length than the replay of this run.")
        say(f"{path} takes {mib} {where} ({memory / 2**20:,.0f} free) while the run lasts.")
        if room > memory:
            raise InputError(f"{path} would take {mib}, more than the free memory; {smaller}.")
        if played == 0:
            with naming(path), open(path, "wb") as file:
                file.truncate(room)
                if hasattr(os, "posix_fallocate"):  # take the room at once, not when the disk is full
                    os.posix_fallocate(file.fileno(), 0, room)
        self.slots: Any = np.memmap(path, slot, "r+")
        numbers = np.arange(max(played - size, 0), played) + 1
        chosen = (numbers - 1) % n_slots
        if not np.array_equal(self.slots["number"][chosen], numbers):
            raise InputError(f"{path} is damaged: it does not hold the last episodes of this run.")
        for number, k in zip(numbers.tolist(), chosen.tolist()):
            if self.slots["check"][k] not in (0, self.check_sum(k)):
                raise InputError(f"{path} is damaged: episode {number} is not as it was written.")

    def check_sum(self, k: int) -> int:
        """Of what slot k holds before its check sum."""
        return zlib.crc32(self.slots[k : k + 1].view(np.uint8)[:-4])

    def flush(self) -> None:
        """Writes what is still in memory only: a checkpoint refers to what it finds on the disk."""
        self.slots.flush()

    def close(self) -> None:
        """Ends the use of the file, so that it can be deleted; it holds no episodes any more."""
        self.slots = np.empty(0, self.slots.dtype)  # nothing refers to the mapped memory any more

    def write(self, number: int, episode: Mapping[str, NDArray[Any]]) -> None:
        """Writes an episode; its arrays may be shorter than the fields."""
        k = (number - 1) % len(self.slots)
        slot = self.slots[k]
        slot["number"] = number
        slot["played"] = False
        for name in self.names:
            slot[name][: len(episode[name])] = episode[name]
        slot["check"] = self.check_sum(k)

    def read(self, numbers: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """The episodes of these numbers, [episode, time, ...] for each field, cut to the longest of them."""
        chosen = (numbers - 1) % len(self.slots)
        played = self.slots["played"][chosen]
        unused = played.shape[1] - int(played.sum(1).max())
        return {name: self.slots[name][chosen, : self.slots[name].shape[1] - unused] for name in self.names}
