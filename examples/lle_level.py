"""A level of the Laser Learning Environment (LLE), whose interface is its own, as a PettingZoo environment.

    pip install laser-learning-environment
    python algos/vdn.py --env pettingzoo:examples.lle_level --env-kwargs "level=3" --max-episode-steps 50

Agents collect gems and go to exits; lasers kill agents of other colours. All agents share one reward. What LLE reports
(gems_collected, exit_rate) stands in evaluations.csv.
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from lle import LLE
from pettingzoo import ParallelEnv


class Level(ParallelEnv):
    """LLE counts no steps: --max-episode-steps says how long an episode lasts."""

    metadata = {"name": "lle", "render_modes": ["rgb_array"]}  # noqa: RUF012

    def __init__(self, level: Any = 1, render_mode: str | None = None) -> None:
        self.game = LLE.level(level).obs_type("flattened").build()
        self.render_mode = render_mode
        self.possible_agents = [f"agent_{i}" for i in range(self.game.n_agents)]
        self.agents: list[str] = []

    def observation_space(self, agent: str) -> spaces.Box:
        """Everything on the board, seen from the agent, as zeros and ones."""
        return spaces.Box(-1, 1, self.game.observation_shape, np.float32)

    def action_space(self, agent: str) -> spaces.Discrete:
        """North, south, east, west, stay."""
        return spaces.Discrete(self.game.n_actions)

    def seen(self, observation: Any) -> dict[str, Any]:
        """By agent: what it sees, and which of its actions are possible."""
        parts = zip(self.possible_agents, observation.data, observation.available_actions)
        return {agent: {"observation": data, "action_mask": mask} for agent, data, mask in parts}

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        """Begin an episode; the start may depend on the seed in levels that have several."""
        if seed is not None:
            self.game.world.seed(seed)  # LLE's own `seed` would also seed Python's generator, which all share
        observation, self.game_state = self.game.reset()
        self.agents = list(self.possible_agents)
        return self.seen(observation), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> Any:
        """All agents act at once."""
        step = self.game.step(np.array([actions[agent] for agent in self.agents]))
        self.game_state, agents = step.state, self.agents
        if step.done:
            self.agents = []
        share = float(step.reward.sum()) / len(agents)
        return (
            self.seen(step.obs),
            dict.fromkeys(agents, share),
            dict.fromkeys(agents, step.done),
            dict.fromkeys(agents, step.truncated),
            {agent: dict(step.info) for agent in agents},
        )

    def state(self) -> Any:
        """Positions, gems and who is alive."""
        return self.game_state.data

    def render(self) -> Any:
        """A picture of the board."""
        return np.asarray(self.game.get_image())[..., ::-1]  # LLE gives blue, green, red


parallel_env = Level
