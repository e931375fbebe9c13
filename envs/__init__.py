"""Multi-agent tasks by name, as vectorised environments.

    env = envs.make("lbf-15x15-3p-5f", num_envs=10, seed=1)
    observations, info = env.reset()
    observations, rewards, terminated, truncated, info = env.step(actions)

`envs.vector` states the contract of an environment, and `envs.tasks` the grammar of the names.
"""

from __future__ import annotations

from envs import needed  # isort: skip  # noqa: F401 (before whatever imports packages that may be missing)
import importlib
import numbers
import os
from collections.abc import Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from envs.adapters import as_gymnasium
from envs.adapters.foreign import check_memory, parse_kwargs
from envs.tasks import OPTIONS, Task, task, task_names
from envs.vector import EpisodeTotals, InputError, VectorEnv

__all__ = [
    "EpisodeTotals",
    "InputError",
    "Task",
    "VectorEnv",
    "film",
    "make",
    "optional",
    "pettingzoo_env",
    "task",
    "task_names",
]

if TYPE_CHECKING:
    from envs.adapters.as_pettingzoo import PettingZooEnv

as_gymnasium.register()


def make(
    name: str,
    num_envs: int = 1,
    seed: int = 0,
    copy: bool = True,
    *,
    env_kwargs: str | Mapping[str, Any] = "",
    max_episode_steps: int = 0,
    flatten_images: bool = False,
    divide_images: bool = True,
    action_bins: int = 0,
    env_workers: int = 0,
    pictures: bool = False,
) -> VectorEnv:
    """Build num_envs sub-environments of a task.

    seed: what sub-environment i plays in its k-th episode depends on (seed, i, k) alone.
    copy: with False, `reset` and `step` return the same arrays each time and allocate nothing.

    For pettingzoo: and gymnasium: environments (see `envs.adapters.foreign`):
    env_kwargs: keyword arguments of the environment, as a mapping or as they stand in a call; also for own: ones, and
    for the tasks of MPE with a built-in opponent, whose network "opponent='<file>'" replaces.
    max_episode_steps: episodes are cut after so many steps; 0: by the environment's own clock.
    flatten_images: make vectors of observations that are images.
    divide_images: divide images of bytes by 255; False where they have codes, and not brightness.
    action_bins: the number of values that each dimension of a continuous action gets; 0: there are no such actions.
    env_workers: the number of processes in which the sub-environments are played; 0: this process.
    pictures: build them so that they can draw themselves, where they can.

    Raises InputError for an unknown or impossible name and for what does not fit into memory, ValueError for a num_envs
    or seed out of range.
    """
    asked: dict[str, Any] = {
        "env_kwargs": parse_kwargs(env_kwargs) if isinstance(env_kwargs, str) else dict(env_kwargs),
        "max_episode_steps": max_episode_steps,
        "flatten_images": flatten_images,
        "divide_images": divide_images,
        "action_bins": action_bins,
        "env_workers": env_workers,
        "pictures": pictures,
    }
    for option in ("max_episode_steps", "action_bins", "env_workers"):
        if not isinstance(value := asked[option], numbers.Integral) or value < 0:
            raise InputError(f"{option} is {value}; it must be a whole number from 0 on.")
    described = task(name)
    for option, usual in OPTIONS.items():
        if asked[option] != usual and option not in (*described.takes, "pictures"):  # a wish
            others = ", or of your own" if option == "env_kwargs" else ""
            raise InputError(
                f"`{option}` is for environments of PettingZoo and Gymnasium{others}; {name} has its own rules."
            )
    options = {option: asked[option] for option in described.takes}
    if described.arguments:
        options = options["env_kwargs"]
        if options.keys() - set(described.arguments):
            raise InputError(f"the only `env_kwargs` that {name} takes is {', '.join(described.arguments)}.")
    module = importlib.import_module(described.module)
    try:
        env: VectorEnv = module.Env(name, num_envs, seed, copy, **described.settings, **options)
    except MemoryError:
        raise InputError(f"{name} with num_envs={num_envs} does not fit into this machine's memory.") from None
    check_memory(name, num_envs, sum(array.nbytes for array in vars(env).values() if isinstance(array, np.ndarray)))
    return env


def named_kwargs(name: str, env_kwargs: str) -> str:
    """A task's keyword arguments as results name them: an opponent's file by what it holds, not by where it lies.

    Raises InputError where it is not the file of an opponent.
    """
    if not env_kwargs or not task(name).arguments:
        return env_kwargs
    from envs.families import mpe  # imports Numba

    given = parse_kwargs(env_kwargs)
    if given.get("opponent") is not None:
        given["opponent"] = mpe.fingerprint(mpe.read_network(given["opponent"], task(name).settings["scenario"]))
    return ", ".join(f"{option}={value!r}" for option, value in given.items())


def optional(package: str, extra: str | None = None) -> ModuleType:
    """Imports a package that only an extra of ours brings along (by default one of the package's own name).

    Raises InputError, naming the extra, where it is not installed, or where it needs another package that is not.
    """
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        if error.name and not f"{package}.".startswith(f"{error.name}."):
            raise InputError(
                f"{package} needs {error.name}, which is not installed; pip install {error.name} does it."
            ) from None
        raise InputError(f"{package} is not installed; pip install -e '.[{extra or package}]' does it.") from None


def film(env: VectorEnv, team: Any, seed: int, path: str | os.PathLike[str], episodes: int = 5) -> str:
    """Play episodes drawn from the seed with a team that a script's `load` returned, and save the first ones as a GIF.

    Returns a line that says where the film is, or why there is none.
    """
    if not env.can_draw:
        return f"{env.name} has no pictures, so there is no film."
    from envs import render  # imports Pillow

    try:
        render.film(env, team, seed, path, episodes)
    except OSError as error:  # a directory that cannot be written, a full disk
        return f"There is no place for the film: {error}"
    except InputError as error:  # a game of others that cannot draw what it promised
        return f"There is no film: {error}"
    return f"film: {path}"


def pettingzoo_env(
    name: str,
    *,
    seed: int | None = None,
    render_mode: str | None = None,
    strict: bool = False,
    env_kwargs: str | Mapping[str, Any] = "",
) -> PettingZooEnv:
    """Build one sub-environment of a task as a `pettingzoo.ParallelEnv`; `envs.adapters.as_pettingzoo` describes it.

    seed: as in `make`; None for one that nobody has chosen, another one for each copy.
    render_mode: None, "rgb_array" or "human", which shows a window where there is a display.
    strict: whether an action that the mask forbids is an error. If not, the agent's first allowed action takes its
    place, because PettingZoo's own tests, and libraries that know no masks, choose any action of the action space.
    env_kwargs: as in `make`.
    Raises InputError as `make` does, and for a render mode that the task does not have.
    """
    from envs.adapters.as_pettingzoo import PettingZooEnv  # imports PettingZoo

    return PettingZooEnv(name, seed, render_mode, strict, env_kwargs)
