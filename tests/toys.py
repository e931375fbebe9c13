"""Small environments of PettingZoo and Gymnasium with everything that an adapter must cope with."""

from __future__ import annotations

import os
import signal
import time
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class Queue(ParallelEnv):
    """Agent i leaves after its step i + 2, with a termination; agent 2 stays until the clock truncates it in step 6.

    Observations are [step, agent] and, for agent 1, one value more; its actions are 5, 6 and 7, of which 6 is forbidden
    in odd steps. Agent 0's mask is in its observation, agent 1's in its info. Each agent earns its number plus 1.
    """

    metadata = {"name": "queue"}  # noqa: RUF012
    possible_agents = ["a", "b", "c"]  # noqa: RUF012
    max_cycles = 6
    teams = {"a": 0, "b": 1, "c": 0}  # noqa: RUF012

    def observation_space(self, agent: str) -> Any:
        box = spaces.Box(0, 9, (3 if agent == "b" else 2,), np.int64)
        return spaces.Dict(observation=box, action_mask=spaces.MultiBinary(2)) if agent == "a" else box

    def action_space(self, agent: str) -> Any:
        return spaces.Discrete(3, start=5) if agent == "b" else spaces.Discrete(2)

    def state(self) -> Any:
        return np.array([self.steps, len(self.agents)])

    def seen(self) -> dict[str, Any]:
        vectors = {agent: np.array([self.steps, i, 7][: 3 if agent == "b" else 2]) for i, agent in enumerate("abc")}
        a = {"observation": vectors["a"], "action_mask": np.array([1, self.steps % 2], np.int8)}
        return {agent: a if agent == "a" else vectors[agent] for agent in self.agents}

    def infos(self) -> dict[str, Any]:
        masks = {"b": {"action_mask": np.array([1, self.steps % 2 == 0, 1], np.int8)}}
        return {agent: masks.get(agent, {}) for agent in self.agents}

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.steps, self.agents = 0, list("abc")
        return self.seen(), self.infos()

    def step(self, actions: dict[str, int]) -> Any:
        assert set(actions) == set(self.agents) and actions.get("b", 5) in (5, 6, 7)
        self.steps += 1
        seen, infos = self.seen(), self.infos()
        leaves = {agent: agent != "c" and self.steps == "abc".index(agent) + 2 for agent in self.agents}
        late = {agent: self.steps == self.max_cycles for agent in self.agents}
        rewards = {agent: "abc".index(agent) + 1 for agent in self.agents}
        self.agents = [agent for agent in self.agents if not leaves[agent] and not late[agent]]
        return seen, rewards, leaves, late, infos


class Tuples(gymnasium.Env):
    """Two agents; the variants differ in what they return."""

    def __init__(self, variant: str = "") -> None:
        self.variant = variant
        self.observation_space = spaces.Tuple([spaces.Box(0, 9, (1,), np.float32), spaces.Discrete(10)])
        self.action_space = spaces.Tuple([spaces.Discrete(2), spaces.Discrete(3)])
        if variant == "clock":
            self.max_steps = 4
        if variant == "teams from 1":
            self.teams = [1, 2]

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.steps = 0
        return (np.zeros(1, np.float32), 0), {}

    def step(self, actions: Any) -> Any:
        assert isinstance(actions, tuple)
        self.steps += 1
        reward: Any = 2.5 if self.variant == "one reward" else (1, 3)
        masks: Any = {"masks": [[1, 0], [0, 1, 1]], "one mask": [1, 0, 1], "masks by number": {0: [1, 0], 1: [0, 1, 1]}}
        info = {"action_mask": masks[self.variant]} if self.variant in masks else {}
        done: Any = [self.steps == 3] * 2 if self.variant == "lists" else self.steps == 4 and self.variant == "clock"
        if self.variant == "one by one":
            done = [self.steps >= 2, self.steps == 3]
        if self.variant == "flags by number":
            done = {0: False, 1: False}
        seen = (np.full(1, self.steps, np.float32), self.steps)
        return seen[:1] if self.variant == "one observation" else seen, reward, done, False, info


class Broken(Queue):
    """Breaks down in its second step, as its keyword argument says."""

    def __init__(self, how: str) -> None:
        self.how = how

    def step(self, actions: dict[str, int]) -> Any:
        if self.steps == 1 and self.how == "error":
            raise ZeroDivisionError("the toy is broken")
        if self.steps == 1 and self.how == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.steps == 1 and self.how.startswith("hangs"):
            if self.how == "hangs and is deaf":  # as in a call of a library in C
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
            time.sleep(600)
        if self.steps == 1 and self.how == "one is slow":
            if self.seed % 2 == 0:
                raise ZeroDivisionError("the toy is broken")
            time.sleep(1)
        return super().step(actions)

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.seed = seed or 0
        return super().reset()

    def close(self) -> None:
        print("closed")


class Odd(Queue):
    """One of the kinds that cannot be played, or only with help."""

    def __init__(self, kind: str, render_mode: str | None = None) -> None:
        if kind == "picture" and render_mode:
            raise TypeError("there is no such argument")
        self.kind = kind
        self.max_cycles = 0 if kind == "no limit" else 6  # 0: nothing says when it ends
        if kind == "wrong limit":
            self.max_steps, self.max_cycles = 3, 0
        if kind == "named teams":
            self.teams = {"red": ["a", "b"], "blue": ["c"]}  # type: ignore[dict-item]
        if kind == "nobody":
            self.possible_agents = []
        if kind == "picture of fractions":
            self.metadata = {"render_modes": ["rgb_array"]}  # type: ignore[dict-item]
        if kind == "picture":
            self.metadata = {"render_modes": ["rgb_array"]}  # type: ignore[dict-item]  # but see above
        if kind == "state is an array":
            self.state = np.zeros(3)  # type: ignore[method-assign, assignment]
        if kind == "wrong value":
            raise KeyError(kind)

    def state(self) -> Any:
        if self.kind == "state fails" and self.steps:
            raise ValueError("need at least one array")
        if self.kind == "state within":  # as PettingZoo's wrapper of an environment that keeps an array of this name
            return np.zeros(2)()  # type: ignore[operator]
        late = np.zeros(2) if self.steps else None
        kinds = {"no state": None, "late state": late, "growing state": np.zeros(1 + self.steps)}
        return kinds.get(self.kind, np.zeros(2))

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        seen, infos = super().reset()
        if self.kind == "newcomer":
            self.agents.append("d")
        return seen, infos

    def step(self, actions: dict[str, int]) -> Any:
        seen, rewards, *others, infos = super().step(actions)
        if self.kind == "blind":
            del seen["b"]
        if self.kind == "rewards in arrays":
            rewards = {agent: np.array([reward]) for agent, reward in rewards.items()}
        if self.kind == "two rewards":
            rewards["b"] = [1, 2]
        if self.kind == "unpaid":
            del rewards["b"]
        if self.kind == "no number as a reward":
            rewards["c"] = None
        return seen, rewards, *others, infos

    def seen(self) -> dict[str, Any]:
        seen = super().seen()
        if "b" in seen:
            kinds = {"half": seen["b"] + 0.5, "short": seen["b"][:1], "goal": {"observation": seen["b"], "goal": [8]}}
            seen["b"] = kinds.get(self.kind, seen["b"])
        if self.kind == "no number" and self.steps == 2:
            seen["c"] = np.array([np.nan, 2])
        return seen

    def render(self) -> Any:
        return np.full((4, 4, 3), 0.5)

    def infos(self) -> dict[str, Any]:
        kinds: dict[str, Any] = {"short mask": {"b": {"action_mask": [1]}}, "no infos": dict.fromkeys(self.agents)}
        return kinds.get(self.kind, super().infos())

    def observation_space(self, agent: str) -> Any:
        if self.kind == "wide":
            return spaces.Box(-np.inf, np.finfo(np.float64).max, (3 if agent == "b" else 2,), np.float64)
        if self.kind == "image":
            return spaces.Box(0, 1, (4, 4), np.float32)
        if self.kind == "goal" and agent == "b":
            return spaces.Dict(observation=super().observation_space(agent), goal=spaces.Box(0, 9, (1,), np.int64))
        return spaces.Sequence(spaces.Discrete(2)) if self.kind == "sequence" else super().observation_space(agent)

    def action_space(self, agent: str) -> Any:
        return spaces.Box(0, 1, (2,)) if self.kind == "continuous" else super().action_space(agent)


gymnasium.register("Tuples-v0", lambda **kwargs: Tuples(**kwargs))
gymnasium.register("ThreeTuples-v0", lambda **kwargs: Tuples(**kwargs), max_episode_steps=3)
