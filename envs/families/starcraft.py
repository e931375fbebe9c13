"""The real SMAC (Samvelyan et al., 2019): StarCraft II, through the package `smac`, where both are installed.

    smac-<map>        3s5z, MMM2, ...: all maps of the package

To install: `pip install git+https://github.com/oxwhirl/smac.git` (the package of that name on PyPI is another one);
StarCraft II, Blizzard's package for Linux, version 4.10 or, for the paper's figures, 4.6.2; its folder in the
environment variable SC2PATH (default ~/StarCraftII); in it, as Maps/SMAC_Maps, the package's folder of maps. Without
them, `envs.families.smaclite` has battles on the same maps.

Observations, state (with last actions), masks and rewards are those of the package with its default options. End: the
battle is won, lost or drawn, a termination; the map's number of steps, a truncation. Statistics: battle_won,
dead_allies, dead_enemies.

Each sub-environment has a game of its own, a gigabyte of memory, in a worker process; close the environment to end
them. Evaluations play all their episodes at once, so --eval-episodes 10 needs ten games. The game takes its seed when
it starts: an episode depends on what was played before, so a resumed run goes on well, but not bit for bit as it would
have. Where the game crashes, the package starts a new one; the episode is truncated, and its statistics are not a
number.
"""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from envs import vector
from envs.vector import InputError
from envs.workers import Games

STATISTICS = ("battle_won", "dead_allies", "dead_enemies")
GAME_BYTES = 2**30  # of memory, roughly


def require(map_name: str) -> None:
    """Raises InputError, naming what is missing, unless the package, the game and the map are there."""
    instead = "smaclite-<map>, our own simulator, runs without."
    for package in ("smac", "pysc2"):
        if importlib.util.find_spec(package) is None:
            how = "pip install git+https://github.com/oxwhirl/smac.git"
            raise InputError(f"smac-{map_name} needs the package {package}; {how} installs it; {instead}")
    if importlib.util.find_spec("smac.env") is None:
        raise InputError(f"smac-{map_name}: the package smac that is installed is not the one of SMAC; {instead}")
    game = Path(os.environ.get("SC2PATH", "~/StarCraftII")).expanduser()
    if not list(game.glob("Versions/Base*")):
        raise InputError(f"smac-{map_name} needs StarCraft II, which is not in {game} (set SC2PATH); {instead}")
    place = game / "Maps" / "SMAC_Maps" / f"{map_name}.SC2Map"
    if not place.is_file():
        raise InputError(f"smac-{map_name}: there is no map {place}; {instead}")


class Battle:
    """One game, in a worker process."""

    def __init__(self, map_name: str) -> None:
        """map_name: of the package."""
        self.map_name = map_name
        self.game: Any = None

    def start(self, seed: int) -> dict[str, int]:
        """Starts StarCraft II anew. Returns what the package says of the task."""
        from smac.env import StarCraft2Env

        self.close()
        self.game = StarCraft2Env(map_name=self.map_name, seed=seed, continuing_episode=True)
        return dict(self.game.get_env_info())

    def reset(self) -> tuple[Any, ...]:
        """Begins an episode; see `seen`."""
        self.game.reset()
        return self.seen(0.0, False, {"battle_won": False})

    def step(self, actions: list[int]) -> tuple[Any, ...]:
        """Lets all agents act; see `seen`."""
        return self.seen(*self.game.step(actions))

    def seen(self, reward: float, done: bool, info: dict[str, Any]) -> tuple[Any, ...]:
        """Observations, state, mask, reward, terminated, truncated, and the statistics."""
        crashed = "battle_won" not in info
        if not crashed:  # else the new game has not begun yet, and the agents see what they saw last
            self.observations = np.array(self.game.get_obs(), np.float32)
            self.state = np.array(self.game.get_state(), np.float32)
            self.mask = np.array(self.game.get_avail_actions(), np.bool_)
        truncated = crashed or bool(info.get("episode_limit", False))
        statistics = [np.nan if crashed else float(info.get(name, 0)) for name in STATISTICS]
        return self.observations, self.state, self.mask, reward, done and not truncated, truncated, statistics

    def close(self) -> None:
        """Ends StarCraft II."""
        if self.game is not None:
            self.game.close()


class Env(vector.VectorEnv):
    """SMAC; see the module's docstring."""

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool, *, map_name: str) -> None:
        """map_name: of the package.

        Raises InputError where the package, the game or the map is missing, and for more games than fit into memory.
        """
        vector.check_number(num_envs)  # before games begin
        vector.check_seed(seed)
        require(map_name)
        room = int(psutil.virtual_memory().available // GAME_BYTES)
        if num_envs > room:
            raise InputError(
                f"{name}: {num_envs} games at once take a gigabyte of memory each, and {room} are free; "
                "`num_envs`, or in evaluations `eval_episodes`, says how many there are."
            )
        self._battles = Games(name, functools.partial(Battle, map_name), num_envs, n_workers=num_envs)
        self._started: dict[int, int] = {}  # of each game, the seed that it was started with
        sizes = self._start(seed, range(num_envs))
        super().__init__(
            name,
            num_envs,
            seed,
            copy,
            n_agents=sizes["n_agents"],
            n_actions=sizes["n_actions"],
            obs_size=sizes["obs_shape"],
            state_size=sizes["state_shape"],
            episode_limit=sizes["episode_limit"],
            low=-np.inf,
            high=np.inf,
            statistics=STATISTICS,
        )

    def reset_envs(self, mask: NDArray[np.bool_], seed: np.uint64, episodes: NDArray[np.int64]) -> None:
        """See `VectorEnv`."""
        chosen = np.flatnonzero(mask).tolist()
        if others := [e for e in chosen if self._started[e] != int(seed)]:
            self._start(int(seed), others)
        self._play("reset", {e: () for e in chosen})

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        refused = vector.forbidden_action(actions, self.action_mask)
        if refused < 0:
            self._play("step", {e: (actions[e].tolist(),) for e in np.flatnonzero(playing).tolist()})
        return refused

    def close_extras(self, **_: Any) -> None:
        """End the games and their processes; `close` calls it."""
        if hasattr(self, "_battles"):  # not where the package is missing
            self._battles.close()

    def _start(self, seed: int, chosen: Iterable[int]) -> dict[str, int]:
        """Start these games, each with a seed of its own; returns what the package says of the task."""
        seeds = {e: (int(np.random.SeedSequence([seed, e]).generate_state(1)[0]),) for e in chosen}
        self._started |= dict.fromkeys(seeds, seed)
        sizes: dict[str, int] = self._battles.call("start", seeds)[0]
        return sizes

    def _play(self, method: str, arguments: dict[int, tuple[Any, ...]]) -> None:
        """Let these sub-environments begin an episode, or make a step."""
        for e, seen in zip(arguments, self._battles.call(method, arguments)):
            self.observations[e], self.state[e], self.action_mask[e], reward, terminated, truncated, statistics = seen
            self.rewards[e] = self.agent_rewards[e] = reward
            self.terminated[e] = terminated
            self.truncated[e] = truncated
            for name, value in zip(STATISTICS, statistics):
                self.statistics[name][e] = value
