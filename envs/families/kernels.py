"""What the compiled families share: the compiler with its cache, the random generator, the check of actions.

Importing this module imports Numba, so only families with compiled rules do it.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np

Function = TypeVar("Function", bound=Callable[..., object])


@functools.cache
def cache_folder(sources: tuple[Path, ...]) -> str:
    """The folder in the user's cache directory for rules that lie in these folders, or "" where none can be written.

    Numba compiles a cached function again when the function's own file changes, but not when another file changes whose
    functions it calls. Old rules would then run silently. A folder that is named by a hash of all files that may belong
    to the rules never holds old ones.
    """
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or "~/AppData/Local"
    elif sys.platform == "darwin":
        base = "~/Library/Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    text = hashlib.sha256()
    try:
        for path in sorted(path for folder in sources for path in folder.glob("*.py")):
            if not path.name.startswith("."):  # an editor's lock file
                text.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        folder = Path(base).expanduser() / "marl-baselines" / text.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: there is no home directory
        return ""
    return str(folder) if os.access(folder, os.W_OK) else ""


NUMBA: Any = numba.config  # its attributes are made at run time


def compiled(function: Function) -> Function:
    """Compile a rule or a loop over rules; the result is kept on disk for the next process.

    The folder is set for this function alone, so that whatever else the process compiles stays where the user wants it.
    A NUMBA_CACHE_DIR that the user has set is respected. If no folder can be written, each process compiles anew.
    """
    here, there = Path(__file__).parent, Path(function.__code__.co_filename).parent
    users_folder = NUMBA.CACHE_DIR
    NUMBA.CACHE_DIR = users_folder or cache_folder((here,) if there == here else (here, there))
    # With the rules inlined a step takes half the time: calls with so many arrays are expensive.
    compile_it: Any = functools.partial(numba.njit, function, forceinline=True)
    try:
        result = compile_it(cache=NUMBA.CACHE_DIR != "")
    except RuntimeError:  # Numba finds no folder that it can write
        result = compile_it()
    finally:
        NUMBA.CACHE_DIR = users_folder
    if hasattr(result, "_cache"):
        make_optional(result._cache)
    return result


def make_optional(cache: Any) -> None:
    """Lets a program go on without Numba's cache of a function where the disk is full or a crash has damaged a file."""
    load, save = cache.load_overload, cache.save_overload

    def load_or_miss(*key: Any) -> Any:
        try:
            return load(*key)
        except Exception:  # pickle raises almost anything on a damaged file
            with contextlib.suppress(OSError):
                cache.flush()  # else it would be met again
            return None

    def save_if_possible(*entry: Any) -> None:
        with contextlib.suppress(OSError):
            save(*entry)

    cache.load_overload, cache.save_overload = load_or_miss, save_if_possible


def wrapping(function: Function) -> Function:
    """Silence NumPy's warnings about integer overflow if the rules run uncompiled; compiled code never warns."""
    return np.errstate(over="ignore")(function) if NUMBA.DISABLE_JIT else function


# ---------------------------------------------------------------------------------------------------------------------
# Random numbers: SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014). Its whole
# state is one unsigned integer, kept in an array with one entry per sub-environment. All constants are np.uint64,
# because Numba turns a uint64 times an int literal into an int64.
# ---------------------------------------------------------------------------------------------------------------------

WEYL = np.uint64(0x9E3779B97F4A7C15)
MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
MIX_2 = np.uint64(0x94D049BB133111EB)
SHIFT_27 = np.uint64(27)
SHIFT_30 = np.uint64(30)
SHIFT_31 = np.uint64(31)
SHIFT_32 = np.uint64(32)


@wrapping
@compiled
def mix(x):
    """Scramble a uint64: a bijection in which each input bit changes each output bit in about half of all cases."""
    x = (x ^ (x >> SHIFT_30)) * MIX_1
    x = (x ^ (x >> SHIFT_27)) * MIX_2
    return x ^ (x >> SHIFT_31)


@wrapping
@compiled
def episode_state(seed, index, episode):
    """The generator's state at the start of an episode: a hash of (seed, sub-environment, number of the episode)."""
    x = mix(np.uint64(seed) + WEYL)
    x = mix((x ^ np.uint64(index)) + WEYL)
    return mix((x ^ np.uint64(episode)) + WEYL)


@wrapping
@compiled
def random_below(random, e, bound):
    """A uniform integer in 0 .. bound-1 from the generator of sub-environment e, for bounds below 2^32.

    It is the upper half of the 64 bits, times the bound, divided by 2^32. The probabilities are equal up to a relative
    error of bound / 2^32.
    """
    random[e] += WEYL
    return np.int64(((mix(random[e]) >> SHIFT_32) * np.uint64(bound)) >> SHIFT_32)


@compiled
def forbidden_action(actions, action_mask):
    """Index (sub-environment times agents plus agent) of the first action that may not be taken, or -1.

    actions: int [env, agent]; action_mask: bool [env, agent, action].
    """
    n_envs, n_agents, n_actions = action_mask.shape
    for e in range(n_envs):
        for i in range(n_agents):
            action = actions[e, i]
            if action < 0 or action >= n_actions or not action_mask[e, i, action]:
                return e * n_agents + i
    return -1
