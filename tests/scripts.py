"""The scripts of algos/ as modules, and the pieces that their tests share."""

import dataclasses
import importlib.util
import re
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from envs import runs  # isort: skip (before PyTorch, as in the scripts)
import numpy as np
import torch

import envs
from benchmark.store import ALGORITHMS

torch.set_num_threads(1)  # as the scripts do: tiny networks, and tests run side by side

ROOT = Path(__file__).resolve().parent.parent
NAMES = sorted(path.stem for path in (ROOT / "algos").glob("*.py"))  # every script, also one that is new
NINE = sorted(ALGORITHMS)  # those of the paper: what a new script cannot have is asked of these alone


def with_flag(flag: str) -> list[str]:
    """The scripts that have this flag of their own."""
    field = re.compile(rf"^    {flag}: (?!ClassVar)", re.MULTILINE)
    return [name for name in NAMES if field.search((ROOT / "algos" / f"{name}.py").read_text(encoding="utf-8"))]


OFF_POLICY = with_flag("buffer_size")
ON_POLICY = [name for name in NAMES if name not in OFF_POLICY]
VALUE_BASED = with_flag("eval_epsilon")
INDIVIDUAL = with_flag("individual_rewards")  # learn from agents' own rewards


def nine(names: list[str]) -> list[str]:
    """Those of the paper among these."""
    return [name for name in names if name in NINE]


SCRIPTS: dict[str, ModuleType] = {}


def load_module(path: Path) -> ModuleType:
    """A program of the repository as a module, made anew."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def script(name: str) -> ModuleType:
    """algos/<name>.py as a module, the same one each time."""
    path = ROOT / "algos" / f"{name}.py"
    if name not in sys.modules or sys.modules[name].__file__ != str(path):  # a test of run.py has a stand-in there
        SCRIPTS[name] = SCRIPTS.get(name) or load_module(path)
        sys.modules[name] = SCRIPTS[name]
    return sys.modules[name]


def main(name: str) -> None:
    """The program of a script, in this process."""
    module = script(name)
    runs.main(str(module.__file__), module.__doc__, module.Args, module.paper_defaults, module.train, module.load)


def args_of(module: ModuleType, **flags: Any) -> Any:
    """A script's Args for its own task, with some flags changed."""
    return dataclasses.replace(module.paper_defaults(), **flags)


def own_rewards(individual: bool) -> dict[str, bool]:
    """The flag of individual rewards where it is on: not every algorithm has it."""
    return {"individual_rewards": True} if individual else {}


class FakeRun:
    """Stands for runs.Run: notes the parts that `train` builds, and lets it collect some batches."""

    def __init__(self, batches: int):
        self.left, self.steps, self.n_updates = batches, 0, 0
        self.folder = tempfile.TemporaryDirectory()  # gone with this object
        self.path = Path(self.folder.name)

    def __call__(self, script, args, paper_defaults, env, parts, team_class, rng):
        self.args, self.env, self.parts, self.rng = args, env, parts, rng
        return self

    @property
    def timestep(self) -> float:
        """Beyond every budget when enough batches have been collected."""
        return self.steps if self.left > 0 else float("inf")

    def episode_file(self, fields, size) -> runs.EpisodeFile:
        return runs.EpisodeFile(self.path / "replay.bin", fields, size, self.env.episode)

    def count(self, played, returns, metrics) -> None:
        assert played.any() and len(returns) == self.env.num_envs
        self.steps += int(played.sum())
        self.left -= 1
        self.metrics = metrics

    def evaluate_if_due(self) -> None:
        """Nothing is evaluated, saved or stopped."""

    stop_if_asked = save_if_due = complete = evaluate_if_due


def trained(monkeypatch, name: str, batches: int, env: str = "lbf-5x5-2p-1f", **flags) -> FakeRun:
    """What `train` of a script builds and has changed after some batches; no file stays."""
    module, run = script(name), FakeRun(batches)
    monkeypatch.setattr(runs, "Run", run)
    args = module.paper_defaults(env, flags.pop("parameter_sharing", True))
    for flag, value in flags.items():
        assert hasattr(args, flag)
        setattr(args, flag, value)
    module.train(args)
    return run


def parse(name: str, flags: list[str]):
    """The Args of a script for a command line."""
    module = script(name)
    return runs.parse_flags(module.Args, module.paper_defaults, [str(flag) for flag in flags], module.__doc__)


def near(frame: np.ndarray, colour: tuple[int, int, int]) -> int:
    """How many pixels of a picture have that colour."""
    return int((np.abs(frame.astype(int) - colour).max(axis=2) < 3).sum())


__all__ = [
    "INDIVIDUAL",
    "NAMES",
    "NINE",
    "OFF_POLICY",
    "ON_POLICY",
    "ROOT",
    "VALUE_BASED",
    "FakeRun",
    "args_of",
    "envs",
    "load_module",
    "main",
    "near",
    "nine",
    "own_rewards",
    "parse",
    "script",
    "trained",
]
