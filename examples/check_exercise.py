"""Holds a script of your own against updates that were recorded with the paper's reference implementation.

    python examples/check_exercise.py vdn mine.py

plays five recorded updates of VDN in mine.py and says which quantity differs first, or that none does. The first word
is the algorithm that mine.py should be: one of the nine. mine.py has the form of the scripts in algos/: `Args`,
`MultiAgentNetwork`, `Batch`, `new_storage`, `collect`, `update` (and `Mixer` for qmix).

Exit code 0: nothing differs; 1: something does, or the script stops; 2: wrong input.
`tests/data/updates/README.md` says how the updates were recorded; `tests/test_algos_recorded.py` plays them in the
nine scripts.
"""

from envs import InputError, runs  # isort: skip (before PyTorch, as in the scripts)
import argparse
import contextlib
import dataclasses
import importlib.util
import json
import sys
import traceback
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

UPDATES = Path(__file__).resolve().parents[1] / "tests/data/updates"
N_AGENTS, N_ACTIONS, OBS_SIZE = 3, 5, 7
CASES = ["fc_shared", "gru_shared", "fc_independent", "gru_independent"]
VALUE_BASED = ["iql", "vdn", "qmix"]
# How far a script may be from EPyMARL, in float64: weights; losses and norms of gradients. Rounding alone, except
# where EPyMARL takes log(p + 1e-10) and the scripts take log(p): in the on-policy five (COMA: in the entropy alone).
TOLERANCES = {name: (1e-12, 1e-12) for name in ("iql", "vdn", "maddpg")}
TOLERANCES |= {"qmix": (1e-12, 1e-11), "coma": (1e-12, 1e-10)}
TOLERANCES |= {"ia2c": (2e-9, 5e-8), "maa2c": (2e-9, 5e-8), "ippo": (1e-7, 1e-7), "mappo": (1e-7, 1e-7)}
LOSSES = {"value": "loss/value", "critic": "loss/critic", "actor": "loss/actor"}  # EPyMARL's names, and the scripts'
PARTS = {
    "agents": "the agents' networks",
    "target_agents": "the agents' target networks",
    "critic": "the critic",
    "target_critic": "the target critic",
    "mixer": "the mixer",
    "target_mixer": "the target mixer",
}


class Recording:
    """One case of a file: flags, start weights, batches, and what EPyMARL made of them."""

    def __init__(self, name: str, case: str):
        with np.load(UPDATES / f"{name}.npz") as file:
            self.arrays = {key: torch.from_numpy(file[key]) for key in file if file[key].dtype.kind != "U"}
            self.flags = json.loads(str(file[f"{case}.hyperparameters"]))
        self.name, self.case = name, case
        self.separate_states = self.flags["state"] == "separate_states"
        self.state_size = self.arrays["separate_states"].shape[-1] if self.separate_states else N_AGENTS * OBS_SIZE
        self.n_updates = len(self.arrays["steps"])

    def __getitem__(self, array: str) -> torch.Tensor:
        return self.arrays[f"{self.case}.{array}"]

    def cut(self, array: str, update: int, rows_after_the_last: int = 0) -> torch.Tensor:
        """An array of one batch, as long as the longest of its episodes."""
        return self.arrays[array][update, : self.arrays["steps"][update] + rows_after_the_last]

    def expected(self, part: str, update: int) -> torch.Tensor:
        """A part's parameters in a row after an update (0 or 4); of mixers, every 11th of them."""
        row = [0, 4].index(update)
        return self[f"{part}_samples"][row] if "mixer" in part else self[part][row + 1].flatten()


class Quantity(NamedTuple):
    """What a script computed in an update, counted from 0, and what EPyMARL did."""

    update: int
    part: str  # of the algorithm: a learner (key of LOSSES) or a network (key of PARTS)
    what: str  # "loss", "gradient" (its norms before clipping, one for each epoch) or "weights"
    ours: torch.Tensor
    theirs: torch.Tensor
    tolerance: float

    def agrees(self) -> bool:
        """Whether the difference is rounding."""
        return (
            self.ours.shape == self.theirs.shape
            and self.ours.dtype == self.theirs.dtype
            and bool(((self.ours - self.theirs).abs() <= self.tolerance).all())
        )


# --- the script's side: what a change of its classes concerns ---
def make_args(module: Any, recording: Recording) -> Any:
    """The recorded flags; what else stands beside them is no flag of a script."""
    others = {"algorithm", "epymarl_commit", "first_update", "state"}
    flags = {flag: value for flag, value in recording.flags.items() if flag not in others}
    flags["reward_standardisation"] = False  # recorded as "none"
    return dataclasses.replace(module.paper_defaults(), **flags)


def make_parts(module: Any, args: Any, recording: Recording) -> dict[str, Any]:
    """What `update` learns with, at the recorded start."""
    name, state_size = recording.name, recording.state_size
    seen = {
        "ia2c": OBS_SIZE,
        "ippo": OBS_SIZE,
        "maa2c": state_size,
        "mappo": state_size,
        "coma": state_size + N_AGENTS * N_ACTIONS,
        "maddpg": state_size + N_AGENTS * N_ACTIONS,
    }
    parts: dict[str, Any] = {}
    for part in PARTS:
        if f"{recording.case}.{part}" in recording.arrays:
            is_critic = part.endswith("critic")
            inputs = seen[name] if is_critic else OBS_SIZE
            outputs = 1 if is_critic and name != "coma" else N_ACTIONS
            core = "fc" if is_critic else args.network
            parts[part] = module.MultiAgentNetwork(args, N_AGENTS, inputs, outputs, core)
            start = recording[part][0].flatten()
        elif f"{recording.case}.{part}_start" in recording.arrays:
            parts[part] = module.Mixer(N_AGENTS, state_size)
            start = recording[f"{part}_start"]
        else:
            continue
        vector_to_parameters(start, parts[part].parameters())
    if name in VALUE_BASED:
        learning = [x for part in ("agents", "mixer") if part in parts for x in parts[part].parameters()]
        parts["optimiser"] = torch.optim.Adam(learning, args.learning_rate, fused=True)
    else:
        parts["actor_optimiser"] = torch.optim.Adam(parts["agents"].parameters(), args.learning_rate, fused=True)
        parts["critic_optimiser"] = torch.optim.Adam(parts["critic"].parameters(), args.learning_rate, fused=True)
    return parts


def make_batch(module: Any, recording: Recording, update: int) -> Any:
    """One recorded batch as `update` takes it."""
    observations = recording.cut("observations", update, 1)
    separate = recording.separate_states
    return module.Batch(
        observations=observations,
        states=recording.cut("separate_states", update, 1) if separate else observations.flatten(2),
        action_masks=recording.cut("action_masks", update, 1),
        actions=recording.cut("actions", update),
        rewards=recording.cut("rewards", update),
        played=recording.cut("played", update),
        no_bootstrap=recording.cut("terminated", update),
    )


# --- the replay ---
@contextlib.contextmanager
def double_precision() -> Iterator[None]:
    """The recordings are in float64."""
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


def gumbel_softmax_with(noise: torch.Tensor) -> Any:
    """`gumbel_softmax` with recorded noise in the place of its own."""

    def gumbel_softmax(logits: torch.Tensor, rng: Any) -> torch.Tensor:
        soft = (logits + noise).softmax(-1)
        drawn = torch.nn.functional.one_hot(soft.argmax(-1), logits.shape[-1])
        return drawn + soft - soft.detach()

    return gumbel_softmax


def replay(module: Any, name: str, case: str) -> Iterator[Quantity]:
    """Five updates by a script, quantity by quantity, in the order in which an update makes them.

    To be used up within `double_precision`.
    """
    recording = Recording(name, case)
    args = make_args(module, recording)
    parts = make_parts(module, args, recording)
    near_weights, near = TOLERANCES[name]
    clip = torch.nn.utils.clip_grad_norm_
    norms = defaultdict(list)  # of the gradients of an update, before clipping

    def noted(parameters: Any, *arguments: Any, **keywords: Any) -> torch.Tensor:
        parameters = list(parameters)
        learner = "value" if name in VALUE_BASED else "actor"
        if "critic" in parts and parameters[0] is next(parts["critic"].parameters()):
            learner = "critic"
        norm = clip(parameters, *arguments, **keywords)
        norms[learner].append(norm)
        return norm

    for update in range(recording.n_updates):
        with contextlib.ExitStack() as patches:
            patches.enter_context(patch.object(torch.nn.utils, "clip_grad_norm_", noted))
            if name == "maddpg":
                noise = recording.cut("gumbel_noise", update)
                patches.enter_context(patch.object(module, "gumbel_softmax", gumbel_softmax_with(noise)))
            if name == "coma":
                last_actions = recording.arrays["last_actions"][update][None]
                patches.enter_context(patch.object(module, "sample_actions", lambda *_, drawn=last_actions: drawn))
            rng = [torch.Generator()] if name in ("coma", "maddpg") else []
            batch = make_batch(module, recording, update)
            losses = module.update(args, parts, batch, recording.flags["first_update"] + update, *rng)
        for learner in ["value"] if name in VALUE_BASED else ["critic", "actor"]:
            loss = losses[LOSSES[learner]].detach()
            yield Quantity(update, learner, "loss", loss, recording[f"{learner}_loss"][update], near)
            made = torch.stack(norms.pop(learner)) if norms[learner] else torch.empty(0)
            yield Quantity(update, learner, "gradient", made, recording[f"{learner}_gradient_norm"][update], near)
        if update in (0, 4):
            for part in [part for part in PARTS if part in parts]:
                weights = parameters_to_vector(parts[part].parameters()).detach()
                weights = weights[::11] if "mixer" in part else weights
                yield Quantity(update, part, "weights", weights, recording.expected(part, update), near_weights)


# --- collect ---
class TwoEpisodes:
    """A game that is over after two steps in the first environment, and out of time after three in the second."""

    num_envs, n_agents, obs_size, state_size, n_actions, episode_limit = 2, N_AGENTS, OBS_SIZE, 4, N_ACTIONS, 3
    state_is_observations = False

    def seen(self) -> tuple[np.ndarray, dict[str, Any]]:
        observations = np.full((2, N_AGENTS, OBS_SIZE), self.t, np.float32)
        masks = np.ones((2, N_AGENTS, N_ACTIONS), bool)
        return observations, {"state": np.full((2, 4), self.t, np.float32), "action_mask": masks}

    def reset(self) -> tuple[np.ndarray, dict[str, Any]]:
        self.t = 0
        return self.seen()

    def step(self, actions: np.ndarray) -> tuple:
        self.t += 1
        observations, info = self.seen()
        info["agent_rewards"] = np.full((2, N_AGENTS), self.t, np.float32)
        terminated = np.array([self.t >= 2, False])  # flags stay, as in envs.VectorEnv
        truncated = np.array([False, self.t == 3])
        return observations, np.full(2, self.t, np.float32), terminated, truncated, info


class StandStill:
    """Always takes action 1."""

    def reset(self) -> None:
        """Has no memory."""

    def act(self, observations: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        return np.ones(observations.shape[:2], np.int64)


def wrong_in_collect(module: Any) -> str:
    """What differs in the experience that `collect` gathers, as a sentence; empty where nothing does."""
    args, env = dataclasses.replace(module.paper_defaults(), time_limit="bootstrap"), TwoEpisodes()
    batch, returns = module.collect(args, env, StandStill(), module.new_storage(args, env))
    if batch.played.tolist() != [[True, True], [True, True], [False, True]]:
        return "`played` is not True for the steps up to an episode's end, the last one included, and False after it"
    if batch.rewards[..., 0][batch.played].tolist() != [1, 1, 2, 2, 3]:
        return "`rewards` are not those of the steps"
    if list(returns)[1] != 6:
        return f"the return of an episode with the rewards 1, 2, 3 is {list(returns)[1]:g}, and should be 6"
    if not batch.no_bootstrap[1, 0]:
        return "`no_bootstrap` is False where the game was over: a value is added that nobody can earn"
    if batch.no_bootstrap[2, 1]:
        return "`no_bootstrap` is True after a time-out: the game would have gone on, and its value is cut off"
    return ""


# --- in words ---
HINTS = {
    "loss": "What goes into it is the target, the values, the mean over agents and played steps.",
    "gradient": "The loss before it agrees: look at what is detached, at no_grad and at which parameters are stepped.",
    "weights": "The loss and the norm of its gradient before it agree: look at clipping and at the optimiser's step.",
    "target": "The networks that learn agree before it: look at when and how far targets follow them.",
}


def in_words(case: str, found: Quantity) -> str:
    """A quantity that differs."""
    where = f"{case}, update {found.update + 1} of 5"
    if found.what == "weights":
        hint = HINTS["target" if found.part.startswith("target") else "weights"]
        if found.ours.shape != found.theirs.shape:
            what = f"the weights are {len(found.ours)} instead of {len(found.theirs)} numbers"
        else:
            what = f"the weights are off by up to {(found.ours - found.theirs).abs().max():.2g}"
        return f"{where}: after it, {what} in {PARTS[found.part]}. {hint}"
    name = {"loss": f"`{LOSSES[found.part]}`", "gradient": f"the norm of the {found.part} gradient"}[found.what]
    ours, theirs = (", ".join(f"{x:.8g}" for x in values.flatten().tolist()) for values in (found.ours, found.theirs))
    return f"{where}: {name} is {ours or 'never computed'}, and should be {theirs}. {HINTS[found.what]}"


def check(module: Any, name: str) -> str:
    """The first difference in words; empty where there is none."""
    if wrong := wrong_in_collect(module):
        return f"collect: {wrong}."
    for case in CASES:
        with double_precision():
            for found in replay(module, name, case):
                if not found.agrees():
                    return in_words(case, found)
    return ""


def load(path: Path) -> ModuleType:
    """A script as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise InputError(f"{path} is no Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # where its flags are looked for
    spec.loader.exec_module(module)
    return module


@runs.one_sentence(__file__)
def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("algorithm", choices=sorted(TOLERANCES), help="what the script should be")
    parser.add_argument("script", type=Path, help="your file")
    args = parser.parse_args()
    try:
        difference = check(load(args.script), args.algorithm)
    except InputError:
        raise
    except Exception as error:  # whatever a student's file does
        last = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(args.script)]
        where = f", line {last[-1].lineno}" if last else ""
        print(f"{args.script}{where} stops: {type(error).__name__}: {error}")
        sys.exit(1)
    if difference:
        print(difference)
        sys.exit(1)
    print(f"{args.script}: collect is right, and 5 updates in 4 cases are those of EPyMARL's {args.algorithm.upper()}.")


if __name__ == "__main__":
    main()
