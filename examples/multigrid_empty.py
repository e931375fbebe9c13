"""MultiGrid, a Gymnasium environment with dictionaries by agent, as a PettingZoo environment.

    pip install multigrid aenum pygame-ce
    python algos/ippo.py --env pettingzoo:examples.multigrid_empty --flatten-images

Two agents look for a goal in an empty room. Other environments with dictionaries by agent need the same few lines.
"""

from typing import Any

import gymnasium
import multigrid.envs  # noqa: F401 (registers the ids)
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class ByAgent(ParallelEnv):
    """The agents of a Gymnasium environment, which numbers them, by names."""

    metadata = {"name": "multigrid"}  # noqa: RUF012

    def __init__(self, id: str = "MultiGrid-Empty-8x8-v0", agents: int = 2) -> None:
        self.game: Any = gymnasium.make(id, agents=agents, disable_env_checker=True)
        self.max_steps = self.game.get_wrapper_attr("max_steps")
        self.possible_agents = [f"agent_{i}" for i in range(agents)]
        self.agents: list[str] = []

    def observation_space(self, agent: str) -> spaces.Box:
        """The cells before the agent: type, colour and state of each. The mission, a text, is the same all the time."""
        return spaces.Box(0, 10, (7, 7, 3), np.float32)

    def action_space(self, agent: str) -> spaces.Discrete:
        """Turn, go on, take, drop, use, wait."""
        return spaces.Discrete(7)

    def named(self, values: dict[int, Any]) -> dict[str, Any]:
        """By name what is given by number."""
        return {agent: values[i] for i, agent in enumerate(self.possible_agents)}

    def seen(self, observations: dict[int, Any]) -> dict[str, Any]:
        """The images."""
        return {agent: np.array(view["image"], np.float32) for agent, view in self.named(observations).items()}

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        """Begin an episode."""
        observations, _ = self.game.reset(seed=seed)
        self.agents = list(self.possible_agents)
        return self.seen(observations), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> Any:
        """Agents that have found the goal wait for the others."""
        numbers = {i: int(actions[agent]) for i, agent in enumerate(self.possible_agents)}
        observations, rewards, ends, late, _ = self.game.step(numbers)
        agents, ended = self.agents, all(ends.values())
        self.agents = [] if ended or any(late.values()) else agents
        return (
            self.seen(observations),
            {agent: float(reward) for agent, reward in self.named(rewards).items()},
            dict.fromkeys(agents, ended),
            self.named(late),
            {agent: {} for agent in agents},
        )


parallel_env = ByAgent
