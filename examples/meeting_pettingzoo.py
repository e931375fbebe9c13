"""The game of meeting_numpy.py as a PettingZoo environment, which our scripts play through an adapter.

python -m envs check pettingzoo:examples.meeting_pettingzoo
python algos/ippo.py --env pettingzoo:examples.meeting_pettingzoo --total-timesteps 200000
"""

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from pettingzoo import ParallelEnv

CELLS, STEPS = 9, 20
MOVES = (0, -1, 1)


class Meeting(ParallelEnv):
    """Two agents on a line of cells."""

    metadata = {"name": "meeting"}  # noqa: RUF012 (typed like this by PettingZoo)
    max_cycles = STEPS  # where our adapter looks for the length of an episode

    def __init__(self) -> None:
        self.possible_agents = ["anna", "ben"]
        self.agents: list[str] = []

    def observation_space(self, agent: str) -> Box:
        return Box(0, CELLS - 1, (2,), np.float32)

    def action_space(self, agent: str) -> Discrete:
        return Discrete(3)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        self.cell = np.random.default_rng(seed).choice(CELLS, 2, replace=False)
        self.steps = 0
        self.agents = list(self.possible_agents)
        return self.observe(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> tuple[dict, dict, dict, dict, dict]:
        moves = [MOVES[actions[agent]] for agent in self.possible_agents]
        self.cell = np.clip(self.cell + moves, 0, CELLS - 1)
        self.steps += 1
        met = bool(self.cell[0] == self.cell[1])
        late = not met and self.steps == STEPS
        observations = self.observe()
        everyone = list(self.possible_agents)
        if met or late:
            self.agents = []
        return (
            observations,
            dict.fromkeys(everyone, (met - 0.05) / 2),
            dict.fromkeys(everyone, met),
            dict.fromkeys(everyone, late),
            {agent: {} for agent in everyone},
        )

    def observe(self) -> dict[str, np.ndarray]:
        anna, ben = self.cell.astype(np.float32)
        return {"anna": np.array([anna, ben]), "ben": np.array([ben, anna])}


parallel_env = Meeting
