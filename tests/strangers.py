"""Small games of PettingZoo's kind that misbehave, as those of strangers do."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from envs import workers


class Line(ParallelEnv):
    """Two agents; action 1 earns 1. An episode has five steps."""

    metadata = {"name": "line", "render_modes": ["rgb_array"]}  # noqa: RUF012
    possible_agents = ["a", "b"]  # noqa: RUF012
    max_cycles = 5

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode

    def observation_space(self, agent: str) -> Any:
        return spaces.Box(-1, 1, (2,), np.float32)

    def action_space(self, agent: str) -> Any:
        return spaces.Discrete(2)

    def seen(self) -> dict[str, Any]:
        return {agent: np.array([self.steps / 5, i], np.float32) for i, agent in enumerate(self.agents)}

    def infos(self) -> dict[str, Any]:
        return {agent: {} for agent in self.possible_agents}

    def paid(self, action: Any) -> Any:
        return float(action)

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.steps, self.agents = 0, self.possible_agents[:]
        return self.seen(), self.infos()

    def step(self, actions: dict[str, Any]) -> Any:
        self.steps += 1
        seen, rewards = self.seen(), {agent: self.paid(action) for agent, action in actions.items()}
        flags = dict.fromkeys(self.agents, False), dict.fromkeys(self.agents, self.steps == self.max_cycles)
        if self.steps == self.max_cycles:
            self.agents = []
        return seen, rewards, *flags, self.infos()

    def render(self) -> Any:
        return np.zeros((8, 8, 3), np.uint8)


def simulate(stop: Any) -> None:
    """A simulator of its own."""
    while not stop.is_set():
        time.sleep(0.05)


class Simulator(Line):
    """Starts a process, not daemonic, which only `close` stops; writes what happens into the file of its argument."""

    def __init__(self, file: str, render_mode: str | None = None, how: str = "fork") -> None:
        super().__init__(render_mode)
        self.file = file
        self.context = multiprocessing.get_context(how)
        self.stop = self.context.Event()
        self.process = self.context.Process(target=simulate, args=(self.stop,))  # type: ignore[attr-defined]
        self.process.start()
        self.write("built")

    def write(self, word: str) -> None:
        with open(self.file, "a") as file:
            file.write(f"{word}\n")

    def step(self, actions: dict[str, Any]) -> Any:
        if self.steps == 3 and os.path.exists(f"{self.file}.die"):
            os.kill(os.getpid(), signal.SIGKILL)
        if self.steps == 3 and os.path.exists(f"{self.file}.fail"):
            raise ZeroDivisionError("by zero")
        return super().step(actions)

    def close(self) -> None:
        self.stop.set()
        self.process.join()
        self.write("closed")


class Settles(Line):
    """Sets what a whole program shares when it is built, or in a step: `double`, `no gradients`, `folder`, `raises`."""

    def __init__(self, what: str, when: str = "built", render_mode: str | None = None) -> None:
        super().__init__(render_mode)
        self.what, self.when, self.folder = what, when, tempfile.mkdtemp()
        self.done = False
        if when == "built":
            self.set()

    def set(self) -> None:
        import torch

        self.done = True
        {
            "double": lambda: torch.set_default_dtype(torch.float64),
            "no gradients": lambda: torch.set_grad_enabled(False),
            "folder": lambda: os.chdir(self.folder),
            "raises": lambda: np.seterr(all="raise"),
        }[self.what]()

    def step(self, actions: dict[str, Any]) -> Any:
        import torch

        if self.steps == 2 and not self.done:
            self.set()
        here = {
            "double": torch.get_default_dtype() == torch.float64,
            "no gradients": not torch.is_grad_enabled(),
            "folder": os.path.samefile(os.getcwd(), self.folder),
            "raises": np.geterr()["over"] == "raise",
        }
        assert here[self.what] == self.done
        return super().step(actions)


class Exits(Line):
    """Ends the program."""

    def __init__(self, words: Any = None, when: str = "step", render_mode: str | None = None) -> None:
        super().__init__(render_mode)
        self.words, self.when = words, when
        self.now("built")

    def now(self, when: str) -> None:
        if when == self.when:
            sys.exit(self.words)

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.now("reset")
        return super().reset(seed)

    def step(self, actions: dict[str, Any]) -> Any:
        self.now("step")
        return super().step(actions)


class Masked(Line):
    """Gives a mask of its argument; `actions` names its action space."""

    def __init__(self, mask: Any, nvec: Any = None, binary: int = 0) -> None:
        super().__init__()
        self.given, self.nvec, self.binary = mask, nvec, binary
        self.acted: list[Any] = []

    def action_space(self, agent: str) -> Any:
        if self.nvec:
            return spaces.MultiDiscrete(self.nvec, start=[1] * len(self.nvec))
        return spaces.MultiBinary(self.binary) if self.binary else spaces.Discrete(2)

    def infos(self) -> dict[str, Any]:
        given = self.given if self.given is None or isinstance(self.given, tuple) else np.array(self.given)
        return {agent: {"action_mask": given} for agent in self.possible_agents}

    def paid(self, action: Any) -> Any:
        self.acted.append(action)
        return 0.0


class Sees(Line):
    """Sees a value of its argument in a space of one of the kinds."""

    def __init__(self, kind: str, value: Any) -> None:
        super().__init__()
        self.kind, self.value = kind, value

    def observation_space(self, agent: str) -> Any:
        return {
            "discrete": spaces.Discrete(3, start=1),
            "multi": spaces.MultiDiscrete([3, 4]),
            "binary": spaces.MultiBinary(2),
            "nested": spaces.Dict(place=spaces.Box(-1, 1, (1,)), target=spaces.Tuple([spaces.Discrete(4)])),
            "tensor": spaces.Box(-1, 1, (2,)),
        }[self.kind]

    def seen(self) -> dict[str, Any]:
        value = self.value
        if self.kind == "tensor":
            import torch

            value = torch.zeros(2, requires_grad=True)
        if isinstance(value, float):
            value = np.float32(value)
        return dict.fromkeys(self.agents, value)


class Codes(Line):
    """An image of bytes, declared up to 255, whose values reach `most`."""

    def __init__(self, most: int = 5) -> None:
        super().__init__()
        self.most = most

    def observation_space(self, agent: str) -> Any:
        return spaces.Box(0, 255, (3, 3, 3), np.uint8)

    def seen(self) -> dict[str, Any]:
        return {agent: np.full((3, 3, 3), self.most, np.uint8) for agent in self.agents}


class Continuous(Line):
    """Actions are a Box of 2, with bounds of its argument, or of `dims` dimensions."""

    def __init__(self, high: float = 1.0, dims: int = 2) -> None:
        super().__init__()
        self.high, self.dims = high, dims
        self.acted: list[Any] = []

    def action_space(self, agent: str) -> Any:
        return spaces.Box(-1, self.high, (self.dims,), np.float32)

    def paid(self, action: Any) -> Any:
        self.acted.append(action)
        return 0.0


class Odd(Line):
    """`items`: takes actions as NumPy's numbers. `state`: a dictionary. `text`: a state that is none. `infos`: names
    that results have."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self.what = what

    def paid(self, action: Any) -> Any:
        return float(action.item())

    def state(self) -> Any:
        if self.what == "text":
            return {"map": "a map"}
        if self.what == "state":
            return {"units": np.array([3.0, 4.0]), "map": {"b": [2], "a": np.ones((1, 1))}}
        raise NotImplementedError

    def infos(self) -> dict[str, Any]:
        numbers = {"timestep": 7, "info_timestep": 8, "return": 9, "commit": 1, "": 5, "won": True, "a,b": 2}
        return dict.fromkeys(self.possible_agents, numbers if self.what == "infos" else {})


class Varied(Line):
    """Differs from most games in one thing, named by its argument."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self.what, self.count = what, 0
        self.possible_agents = [f"a{i}" for i in range({"one agent": 1, "fifty agents": 50}.get(what, 4))]
        self.max_cycles = 1 if what == "one step" else 5
        self.buffer = np.zeros((4, 12))

    def observation_space(self, agent: str) -> Any:
        if self.what == "no observation":
            return spaces.Box(0, 1, (0,), np.float32)
        if self.what == "starts at 1":
            return spaces.MultiDiscrete([5, 4], start=[1, 1])
        return spaces.Box(-9, 9, (3,), np.float64)

    def action_space(self, agent: str) -> Any:
        return spaces.Discrete({"one action": 1, "many actions": 2_000}.get(self.what, 2))

    def seen(self) -> dict[str, Any]:
        if self.what == "no observation":
            return {agent: np.zeros(0, np.float32) for agent in self.agents}
        if self.what == "starts at 1":
            return {agent: np.array([1 + self.steps % 5, 1 + i]) for i, agent in enumerate(self.agents)}
        self.buffer[:] = np.arange(12) / 6 + self.steps / 10  # written again in every step
        kinds = [self.buffer[0, 2::-1], self.buffer[1, ::4], self.buffer[2, :3].astype(">f4"), self.buffer[3, :3]]
        if self.what == "no number at last" and self.count == 100:
            kinds[0] = np.full(3, np.nan)
        return {agent: kinds[i % 4] for i, agent in enumerate(self.agents)}

    def paid(self, action: Any) -> Any:
        return float(action == 1) * (1e9 if self.what == "large rewards" else 1)

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        if self.what == "forks" and self.count == 0:
            child = os.fork()
            if not child:
                os._exit(0)
            os.waitpid(child, 0)
        return super().reset(seed)

    def step(self, actions: dict[str, Any]) -> Any:
        self.count += 1
        if self.what == "prints":
            print("step", self.steps)
        return super().step(actions)


class Hands(Line):
    """Hands on what nobody expects, named by its argument."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self.what = what
        if what == "same names":
            self.possible_agents = ["a", "a"]
        if what == "no close":
            self.close = None
        if what == "no metadata":
            self.metadata = None  # type: ignore[assignment]

    def action_space(self, agent: str) -> Any:
        return spaces.Discrete(2**21 if self.what == "many actions" else 2)

    def observation_space(self, agent: str) -> Any:
        if self.what == "large observations":
            return spaces.Discrete(10**7)
        return spaces.Dict({}) if self.what == "an empty dictionary" else super().observation_space(agent)

    def seen(self) -> dict[str, Any]:
        odd: dict[str, Any] = {"nothing seen": None, "complex numbers": np.array([1j, 0]), "texts": ["1", "2"]}
        odd["an empty dictionary"] = {}
        return {agent: odd.get(self.what, each) for agent, each in super().seen().items()}

    def infos(self) -> dict[str, Any]:
        odd = {"words as infos": "ok", "odd infos": {"won": 10**400, "\ud800": 1, "lost": 2}}
        return dict.fromkeys(self.possible_agents, odd.get(self.what, {}))

    def paid(self, action: Any) -> Any:
        if self.what == "its main program":
            assert sys.modules["__main__"] is workers.NO_MAIN
        return "1" if self.what == "texts as rewards" else 1.0

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        result = super().reset(seed)
        if self.what == "nobody plays":
            self.agents = []
        return result

    def step(self, actions: dict[str, Any]) -> Any:
        result = super().step(actions)
        if self.what == "no list of agents":
            self.agents = None  # type: ignore[assignment]
        return result


class Lingers(Line):
    """Starts a thread or a process that nothing ends."""

    def __init__(self, what: str) -> None:
        super().__init__()
        kind: Any = {"thread": threading.Thread, "process": multiprocessing.get_context("fork").Process}[what]
        kind(target=time.sleep, args=(1000,)).start()
