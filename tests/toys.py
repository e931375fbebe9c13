"""Small environments of PettingZoo and Gymnasium with everything that an adapter must cope with."""

from __future__ import annotations

import os
import random
import signal
import sys
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
        if kind == "asserts":
            assert not render_mode, kind
            raise AssertionError
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
        if kind in ("render fails", "render is None", "pictures grow"):
            self.metadata = {"render_modes": ["rgb_array"]}  # type: ignore[dict-item]
        if kind == "numpy's limit":
            self.max_cycles = np.int64(6)  # type: ignore[assignment]
        if kind == "a flag as a limit":
            self.max_steps, self.max_cycles = True, 0
        if kind == "spaces as attributes":
            self.observation_space = spaces.Dict()  # type: ignore[method-assign, assignment]
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
        if self.kind == "reset fails":
            raise ZeroDivisionError("by zero")
        seen, infos = super().reset()
        if self.kind == "newcomer":
            self.agents.append("d")
        return seen if self.kind == "reset without infos" else (seen, infos)

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
        if self.kind == "four values":
            return seen, rewards, others[0], infos
        if self.kind == "reports" and not self.agents:
            infos["c"] = {"won": True, "score": np.float32(3), "seed": 5, "name": "x", "nan": np.nan, "many": [1, 2]}
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
        if self.kind == "render fails":
            raise ZeroDivisionError("no screen")
        if self.kind == "render is None":
            return None
        if self.kind == "pictures grow":
            return np.zeros((4 + self.steps, 4, 3), np.uint8)
        return np.full((4, 4, 3), 0.5)

    def infos(self) -> dict[str, Any]:
        kinds: dict[str, Any] = {"short mask": {"b": {"action_mask": [1]}}, "no infos": dict.fromkeys(self.agents)}
        if self.kind == "mask at first" and self.steps:
            return {agent: {} for agent in self.agents}
        return kinds.get(self.kind, super().infos())

    def observation_space(self, agent: str) -> Any:
        if self.kind == "wide":
            return spaces.Box(-np.inf, np.finfo(np.float64).max, (3 if agent == "b" else 2,), np.float64)
        if self.kind == "image":
            return spaces.Box(0, 1, (4, 4, 3), np.float32)
        if self.kind == "goal" and agent == "b":
            return spaces.Dict(observation=super().observation_space(agent), goal=spaces.Box(0, 9, (1,), np.int64))
        return spaces.Sequence(spaces.Discrete(2)) if self.kind == "sequence" else super().observation_space(agent)

    def action_space(self, agent: str) -> Any:
        return spaces.Box(0, 1, (2,)) if self.kind == "continuous" else super().action_space(agent)


class Painted(ParallelEnv):
    """Two agents; the one whose half of an image is bright should take action 1. A step is an episode.

    kind: "bytes", an image of 0 to 255; "fractions", the same image of 0 to 1; "binary", bytes of 0 and 1; "table", 27
    entities of 5 values; "high vector", numbers up to 1000.
    """

    metadata = {"name": "painted"}  # noqa: RUF012
    possible_agents = ["a_0", "a_1"]  # noqa: RUF012
    max_cycles = 20

    def __init__(self, kind: str = "bytes") -> None:
        self.kind = kind

    def observation_space(self, agent: str) -> Any:
        table, vector = spaces.Box(-1, 1, (27, 5), np.float32), spaces.Box(0, 1000, (3,), np.float32)
        binary = spaces.Box(0, 1, (8, 8), np.uint8)
        bright = (
            spaces.Box(0, 1, (8, 8, 3), np.float32)
            if self.kind == "fractions"
            else spaces.Box(0, 255, (8, 8, 3), np.uint8)
        )
        return {"table": table, "high vector": vector, "binary": binary}.get(self.kind, bright)

    def action_space(self, agent: str) -> Any:
        return spaces.Discrete(2)

    def seen(self) -> dict[str, Any]:
        self.bright = self.rng.random(2) < 0.5
        image = np.zeros((8, 8, 3), np.uint8)
        image[:4] = 255 * self.bright[0]
        image[4:] = 255 * self.bright[1]
        kinds = {
            "fractions": (image / 255).astype(np.float32),
            "binary": np.ones((8, 8), np.uint8),
            "table": np.full((27, 5), 0.5, np.float32),
            "high vector": np.full(3, 900, np.float32),
        }
        return dict.fromkeys(self.agents, kinds.get(self.kind, image))

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.steps, self.agents, self.rng = 0, list(self.possible_agents), np.random.default_rng(seed)
        return self.seen(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> Any:
        rewards = {agent: float(actions[agent] == self.bright[i]) / 2 for i, agent in enumerate(self.possible_agents)}
        self.steps += 1
        late = dict.fromkeys(self.agents, self.steps == self.max_cycles)
        seen, infos = self.seen(), {agent: dict[str, Any]() for agent in self.agents}
        self.agents = [] if self.steps == self.max_cycles else self.agents
        return seen, rewards, dict.fromkeys(late, False), late, infos


class Sides(Queue):
    """Two sides whose rewards add up to nothing; with `teams`, it says which."""

    possible_agents = ["red_0", "red_1", "blue_0"]  # noqa: RUF012

    def __init__(self, teams: bool = False, cooperative: bool = False) -> None:
        self.cooperative = cooperative
        self.teams = {"red_0": 0, "red_1": 0, "blue_0": 1} if teams else None  # type: ignore[assignment]

    def observation_space(self, agent: str) -> Any:
        return spaces.Box(0, 9, (1,), np.float32)

    def action_space(self, agent: str) -> Any:
        return spaces.Discrete(2)

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.steps, self.agents = 0, list(self.possible_agents)
        return dict.fromkeys(self.agents, np.zeros(1, np.float32)), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> Any:
        self.steps += 1
        rewards = dict.fromkeys(self.agents, 1.0) if self.cooperative else {"red_0": 1.0, "red_1": 1.0, "blue_0": -2.0}
        flags = dict.fromkeys(self.agents, False), dict.fromkeys(self.agents, self.steps == self.max_cycles)
        seen, infos = (
            dict.fromkeys(self.agents, np.ones(1, np.float32)),
            {agent: dict[str, Any]() for agent in self.agents},
        )
        self.agents = [] if self.steps == self.max_cycles else self.agents
        return seen, rewards, *flags, infos


class Reseeds(Painted):
    """Seeds generators that the whole program shares, in some of three moments: made, reset and step."""

    def __init__(self, what: str, when: str) -> None:
        super().__init__("table")
        self.what, self.when = what, when
        self.now("made")

    def now(self, when: str) -> None:
        torch = sys.modules["torch"].default_generator  # torch.manual_seed looks at every device's, too: milliseconds
        seeds = {"random": random.seed, "numpy": np.random.seed, "torch": torch.manual_seed}
        for what in self.what.split() if when in self.when.split() else ():
            seeds[what](0)

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.now("reset")
        return super().reset(seed)

    def step(self, actions: dict[str, int]) -> Any:
        self.now("step")
        return super().step(actions)


class ByAgent(gymnasium.Env[Any, Any]):
    """Dictionaries by agent, which Gymnasium has no form for."""

    observation_space = spaces.Dict({"0": spaces.Discrete(2), "1": spaces.Discrete(2)})
    action_space = observation_space


class OldGym(Tuples):
    """The interface that Gym had: a reset without an info, and four values of a step."""

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        seen, info = super().reset()
        return seen if self.variant == "no info" else (seen, info)

    def step(self, actions: Any) -> Any:
        seen, reward, done, late, info = super().step(actions)
        return (seen, reward, done, info) if self.variant == "four values" else (seen, reward, done, late, info)


class Unseeded(Tuples):
    """Its reset takes no seed."""

    def reset(self) -> Any:  # type: ignore[override]
        return super().reset()


gymnasium.register("ByAgent-v0", lambda **kwargs: ByAgent(**kwargs), max_episode_steps=5)
gymnasium.register("OldGym-v0", lambda **kwargs: OldGym(**kwargs), max_episode_steps=5)
gymnasium.register("Unseeded-v0", lambda **kwargs: Unseeded(**kwargs), max_episode_steps=5)
gymnasium.register("Tuples-v0", lambda **kwargs: Tuples(**kwargs))
gymnasium.register("ThreeTuples-v0", lambda **kwargs: Tuples(**kwargs), max_episode_steps=3)
