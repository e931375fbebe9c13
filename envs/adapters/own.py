"""Environments of a user's own: own:<module>, where the module has a class `Env`, by the contract in `envs.vector`."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from envs.adapters.foreign import import_module
from envs.settings import Settings
from envs.vector import InputError, VectorEnv


def Env(name: str, num_envs: int, seed: int, copy: bool, *, target: str, env_kwargs: Mapping[str, Any]) -> VectorEnv:
    """Builds one of the module `target`.

    Raises InputError where there is no such class, where it takes other arguments, and where it goes to another folder.
    Other settings of the whole program are then as before.
    """
    before = Settings.now()
    module = import_module(name, target)
    if not hasattr(module, "Env"):
        raise InputError(f"{name}: the module {target} has no class Env.")
    try:
        inspect.signature(module.Env).bind(name, num_envs, seed, copy, **env_kwargs)
    except TypeError as error:
        raise InputError(f"{name}: {error}.") from None
    try:
        env: VectorEnv = module.Env(name, num_envs, seed, copy, **env_kwargs)
    finally:
        changed = before.changed(after := Settings.now())
        before.hold(after)
    if "folder" in changed:
        raise InputError(f"{name} changes the working directory, in which a run finds and keeps its files.")
    env.checks_numbers = True
    return env
