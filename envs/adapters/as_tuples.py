"""A task as one environment of Gymnasium in which agents act by tuples: the form that lbforaging and rware have.

    env = gymnasium.make("marl/lbf-8x8-2p-2f-c")
    observations, info = env.reset(seed=1)
    observations, rewards, terminated, truncated, info = env.step(env.action_space.sample())

    observations           a tuple: float32 [obs_size] for each agent
    rewards                a list: each agent's own reward
    info["action_mask"]    a tuple: int8 [own actions] for each agent
    info["statistics"]     what the family reports about an episode; only at its end
    unwrapped              has n_agents, episode_limit, and the agents by name: agent_names

EPyMARL's wrapper calls such environments. Seeds, pictures and forbidden actions are those of
`envs.adapters.as_pettingzoo`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from envs.adapters.as_pettingzoo import Infos, PettingZooEnv

Observations = tuple[NDArray[np.float32], ...]


class TupleEnv(gymnasium.Env[Observations, Any]):
    """See the module's docstring."""

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"]}  # noqa: RUF012 (typed like this by Gymnasium)

    def __init__(self, task: str, **options: Any) -> None:
        """options: those of `envs.pettingzoo_env`."""
        self.game = PettingZooEnv(task, **options)
        self.metadata, self.render_mode = self.game.metadata, self.game.render_mode
        self.agent_names, self.episode_limit = self.game.possible_agents, self.game.env.episode_limit
        self.n_agents = len(self.agent_names)
        self.observation_space = spaces.Tuple(list[Any](self.game.observation_spaces.values()))
        self.action_space = spaces.Tuple(self.game.action_spaces.values())

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin the next episode, or with a seed the first one of that seed. There are no options."""
        super().reset(seed=seed)
        observations, infos = self.game.reset(seed)
        return tuple(observations.values()), self._info(infos)

    def step(self, action: Any) -> tuple[Observations, Any, bool, bool, dict[str, Any]]:
        """Let every agent act. Raises what `PettingZooEnv` raises."""
        actions = dict(zip(self.agent_names, action, strict=True))
        observations, rewards, terminations, truncations, infos = self.game.step(actions)
        terminated, truncated = any(terminations.values()), any(truncations.values())
        return tuple(observations.values()), list(rewards.values()), terminated, truncated, self._info(infos)

    def _info(self, infos: Infos) -> dict[str, Any]:
        """The agents' masks, and at the end of an episode the statistics."""
        first = infos[self.agent_names[0]]
        masks = tuple(info["action_mask"] for info in infos.values())
        return {"action_mask": masks} | {name: first[name] for name in first if name != "action_mask"}

    def render(self) -> Any:
        """See `PettingZooEnv.render`."""
        return self.game.render()

    def close(self) -> None:
        """End what the environment has started."""
        self.game.close()
