"""The real SMAC (Samvelyan et al., 2019): StarCraft II, through the package `smac`, where both are installed.

    smac-<map>        3s5z, MMM2, ...: all maps of the package

To install: `pip install git+https://github.com/oxwhirl/smac.git` (the package of that name on PyPI is another one);
StarCraft II, Blizzard's package for Linux, version 4.10 or, for the paper's figures, 4.6.2; its folder in the
environment variable SC2PATH (default ~/StarCraftII); in it, as Maps/SMAC_Maps, the package's folder of maps. Without
them, `envs.smaclite` has battles on the same maps.

Observations, state (with last actions), masks and rewards are those of the package with its default options. End: the
battle is won, lost or drawn, a termination; the map's number of steps, a truncation. Statistics: battle_won,
dead_allies, dead_enemies.

Each sub-environment has a game of its own, a gigabyte of memory, in a worker process; close the environment to end
them. The game takes its seed when it starts: an episode depends on what was played before, so a resumed run goes on
well, but not bit for bit as it would have. Where the game crashes, the package starts a new one; the episode is
truncated, and its statistics are not a number.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envs import vector
from envs.tasks import InputError

STATISTICS = ("battle_won", "dead_allies", "dead_enemies")


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


def serve(connection: Connection, map_name: str) -> None:
    """A worker process: plays one game, on request, until the connection ends.

    Requests: ("start", seed), answered with what the package says of the task; ("reset", None) and ("step", actions),
    answered with observations, state, mask, reward, terminated, truncated and the statistics.
    """
    from smac.env import StarCraft2Env

    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # so that the game is closed
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then closes the connection
    game: Any = None
    try:
        while True:
            request, value = connection.recv()
            if request == "start":
                if game is not None:
                    game.close()
                game = StarCraft2Env(map_name=map_name, seed=value, continuing_episode=True)
                connection.send(game.get_env_info())
                continue
            reward, done, info = 0.0, False, {"battle_won": False}
            if request == "reset":
                game.reset()
            else:
                reward, done, info = game.step(value)
            crashed = "battle_won" not in info
            if not crashed:  # else the new game has not begun yet, and the agents see what they saw last
                observations = np.array(game.get_obs(), np.float32)
                state = np.array(game.get_state(), np.float32)
                mask = np.array(game.get_avail_actions(), np.bool_)
            truncated = crashed or bool(info.get("episode_limit", False))
            statistics = [np.nan if crashed else float(info.get(name, 0)) for name in STATISTICS]
            connection.send((observations, state, mask, reward, done and not truncated, truncated, statistics))
    except EOFError:
        pass
    finally:
        if game is not None:
            game.close()


class Env(vector.VectorEnv):
    """SMAC; see the module's docstring."""

    def __init__(self, name: str, num_envs: int, seed: int, copy: bool, *, map_name: str) -> None:
        """map_name: of the package. Raises InputError where the package, the game or the map is missing."""
        self._workers: list[Any] = []  # made first: `close` uses them, also where something is missing
        self._connections: list[Connection] = []
        require(map_name)
        context = multiprocessing.get_context("spawn")
        for _ in range(num_envs):
            ours, theirs = context.Pipe()
            worker = context.Process(target=serve, args=(theirs, map_name), daemon=True)
            worker.start()
            theirs.close()
            self._workers.append(worker)
            self._connections.append(ours)
        self.name = name
        sizes = self._start(seed)
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
        if int(seed) != self._started:
            self._start(int(seed))
        playing = np.flatnonzero(mask)
        for e in playing:
            self._connections[e].send(("reset", None))
        self._receive(playing)

    def step_envs(self, actions: NDArray[np.int64], playing: NDArray[np.bool_]) -> int:
        """See `VectorEnv`."""
        refused = vector.forbidden_action(actions, self.action_mask)
        if refused < 0:
            for e in np.flatnonzero(playing):
                self._connections[e].send(("step", actions[e].tolist()))
            self._receive(np.flatnonzero(playing))
        return refused

    def close_extras(self, **_: Any) -> None:
        """End the games and their processes; `close` calls it."""
        for connection in self._connections:
            connection.close()
        for worker in self._workers:
            worker.join(10)
            worker.terminate()

    def _start(self, seed: int) -> Any:
        """Let each worker make its game, with a seed of its own; returns what the package says of the task."""
        for e, connection in enumerate(self._connections):
            connection.send(("start", int(np.random.SeedSequence([seed, e]).generate_state(1)[0])))
        self._started = seed
        answers = [self._answer(e) for e in range(len(self._connections))]
        return answers[0]

    def _answer(self, e: int) -> Any:
        try:
            return self._connections[e].recv()
        except (EOFError, ConnectionError):
            self.close_extras()
            raise RuntimeError(
                f"{self.name}: the game of sub-environment {e} has ended; see its own message."
            ) from None

    def _receive(self, playing: NDArray[np.int64]) -> None:
        """Take the answers of these sub-environments to a reset or a step."""
        for e in playing:
            observations, state, mask, reward, terminated, truncated, statistics = self._answer(e)
            self.observations[e] = observations
            self.state[e] = state
            self.action_mask[e] = mask
            self.rewards[e] = self.agent_rewards[e] = reward
            self.terminated[e] = terminated
            self.truncated[e] = truncated
            for name, value in zip(STATISTICS, statistics):
                self.statistics[name][e] = value
