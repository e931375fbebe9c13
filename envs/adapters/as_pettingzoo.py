"""A task as a PettingZoo environment, for libraries that train on those.

    env = envs.pettingzoo_env("lbf-8x8-2p-2f-c")
    observations, infos = env.reset()
    while env.agents:
        actions = {agent: env.action_space(agent).sample(infos[agent]["action_mask"]) for agent in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)

    observations[agent]           float32 [obs_size]      padded at the end to the largest agent
    rewards[agent]                float                   the agent's own reward
    terminations[agent]           bool                    a real end: the value after it is zero
    truncations[agent]            bool                    the clock ran out: the state after it still has a value
    infos[agent]["action_mask"]   int8 [own actions]      1 for each action that is allowed now
    infos[agent]["statistics"]    dict of float           what the family reports about an episode; only at its end
    env.state()                   float32 [state_size]
    env.teams                     for each agent the number of its team; all 0 in cooperative tasks

All agents play until the episode ends, which it does for all of them at once. An agent that is out of the game earlier,
such as a dead unit, observes zeros, and its mask allows action 0 only.

Agents are called agent_0, agent_1, ... where they are equal. Otherwise their names tell the kind, speaker_0 and
listener_0, or the side, as in mpe-tag-selfplay: adversary_0, adversary_1, adversary_2 and agent_0.

Seeds are as Gymnasium has them. Without a seed, the first `reset()` draws one that nobody has chosen, so that copies
play different episodes, also those that a library makes by pickling an environment. A later `reset()` goes on with the
next episode, and reset(seed=...) begins the episodes of that seed.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

import envs
from envs.adapters.as_gymnasium import Window, rendering
from envs.vector import fresh_seed

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]


class PettingZooEnv(ParallelEnv):
    """One sub-environment of a task; see the module's docstring."""

    def __init__(
        self,
        name: str,
        seed: int | None = None,
        render_mode: str | None = None,
        strict: bool = False,
        env_kwargs: str | Mapping[str, Any] = "",
    ) -> None:
        """See `envs.pettingzoo_env`."""
        self.unseeded = seed is None  # until the first reset, before which SuperSuit, for one, pickles copies
        self.env = envs.make(name, seed=seed or 0, env_kwargs=env_kwargs, pictures=render_mode is not None)
        modes = rendering(self.env, render_mode, human=True)
        self.metadata = {"name": name, "is_parallelizable": True, **modes}
        self.window: Window | None = None
        if render_mode == "human" and "human" in modes["render_modes"]:
            self.window = Window(name)
        elif render_mode == "human":
            warnings.warn(f"{name}: there is no display here, so `render` returns arrays (rgb_array).", stacklevel=3)
            render_mode = "rgb_array"
        self.render_mode = render_mode
        self.np_random = np.random.default_rng(seed)  # for wrappers; the game draws from generators of its own
        self.strict = strict
        self.agents: list[str] = []
        self.possible_agents = list(self.env.agent_names)
        self.teams = dict(zip(self.possible_agents, self.env.teams))
        bounds = self.env.single_observation_space
        assert isinstance(bounds, Box)
        self.observation_spaces: dict[str, Box] = {}
        self.action_spaces: dict[str, Discrete] = {}
        for i, agent in enumerate(self.possible_agents):
            self.observation_spaces[agent] = Box(bounds.low[i], bounds.high[i], dtype=np.float32)
            self.action_spaces[agent] = Discrete(self.env.choices[i])
        self.state_space = Box(-np.inf, np.inf, (self.env.state_size,), np.float32)

    def observation_space(self, agent: str) -> Box:
        """The space of an agent's observations, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        """The space of an agent's own actions, always the same object. Its `sample` takes an action mask."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Begin the next episode, or with a seed the first one of that seed. There are no options."""
        if self.unseeded and seed is None:
            seed = fresh_seed()
        if seed is not None:
            self.unseeded = False
            self.np_random = np.random.default_rng(seed)
        observations, _ = self.env.reset(seed=seed)
        self.agents = self.possible_agents.copy()
        self._show()
        return dict(zip(self.agents, observations[0])), self._infos()

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let every agent act. When the episode has ended, `agents` is empty.

        Raises ValueError where an agent's action is missing or does not exist, and where it is forbidden if `strict`.
        Raises gymnasium.error.ResetNeeded where no episode is going on.
        """
        if not self.agents:
            raise ResetNeeded(f"{self.env.name}: call reset() before step().")
        chosen = [self._action(i, actions) for i in range(len(self.agents))]
        observations, _, terminated, truncated, info = self.env.step([chosen])
        self._show()
        agents, infos = self.agents, self._infos()
        if terminated[0] or truncated[0]:
            self.agents = []
            for agent in agents:
                infos[agent]["statistics"] = {name: float(values[0]) for name, values in info["statistics"].items()}
        return (
            dict(zip(agents, observations[0])),
            dict(zip(agents, info["agent_rewards"][0].tolist())),
            dict.fromkeys(agents, bool(terminated[0])),
            dict.fromkeys(agents, bool(truncated[0])),
            infos,
        )

    def _action(self, i: int, actions: dict[str, Any]) -> int:
        """What agent i does: its action, or the first allowed one if that is forbidden and we are not strict."""
        agent = self.possible_agents[i]
        if agent not in actions:
            raise ValueError(f"{self.env.name}: there is no action for {agent}.")
        action, space = actions[agent], self.action_spaces[agent]
        if not space.contains(action):
            raise ValueError(f"{self.env.name}: {agent} has no action {action!r}; its actions are 0 to {space.n - 1}.")
        allowed = self.env.action_mask[0, i]
        return int(action) if allowed[int(action)] or self.strict else int(allowed.argmax())

    def _infos(self) -> Infos:
        """The agents' masks."""
        masks = self.env.action_mask[0].astype(np.int8)
        return {agent: {"action_mask": masks[i, : self.action_spaces[agent].n]} for i, agent in enumerate(self.agents)}

    def state(self) -> NDArray[np.float32]:
        """The state of the whole game."""
        return self.env.state[0].copy()

    def render(self) -> NDArray[np.uint8] | None:
        """A frame, uint8 [height, width, 3], with the mode rgb_array; else None, as PettingZoo wants it.

        With the mode human, `reset` and `step` show the frames in a window by themselves.
        """
        return self.env.frame() if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        if self.window:
            self.window.show(self.env.frame())

    def close(self) -> None:
        """End what the environment has started, such as a window or StarCraft."""
        if self.window:
            self.window.close()
        self.env.close()
