"""Holds a script of your own against updates that were recorded with the paper's reference implementation.

    python examples/check_exercise.py vdn mine.py

plays five recorded updates of VDN in mine.py and says which quantity differs first, or that none does. Then it trains
with mine.py for a moment. The first word is the algorithm that mine.py should be: one of the nine. mine.py has the form
of the scripts in algos/: `Args`, `paper_defaults`, `MultiAgentNetwork`, `Batch`, `new_storage`, `collect`, `update`
(and `Mixer` for qmix). `--hint 1` also says where to look, and `--hint 2` what for.

    python examples/check_exercise.py mappo_yu mine.py

holds `gae` of mine.py, with the arguments that examples/mappo_yu.py gives it, against estimates made by hand.

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
import re
import subprocess
import sys
import tempfile
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

import envs

TASK = "lbf-5x5-2p-1f"  # for what has no task of its own
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


def wrong_in_collect(module: Any) -> "Finding | None":
    """What differs in the experience that `collect` gathers."""
    args, env = dataclasses.replace(module.paper_defaults(), time_limit="bootstrap"), TwoEpisodes()
    batch, returns = module.collect(args, env, StandStill(), module.new_storage(args, env))
    if batch.played.tolist() != [[True, True], [True, True], [False, True]]:
        found = "`played` of two episodes, of two and of three steps, is not as it should be", PLAYED_HINTS
    elif batch.rewards[..., 0][batch.played].tolist() != [1, 1, 2, 2, 3]:
        found = "`rewards` are not those of the steps", REWARD_HINTS
    elif list(returns)[1] != 6:
        found = (
            f"the return of an episode with the rewards 1, 2, 3 is {list(returns)[1]:g}, and should be 6",
            REWARD_HINTS,
        )
    elif not batch.no_bootstrap[1, 0] or batch.no_bootstrap[2, 1]:
        found = "`no_bootstrap` of two episodes is not as it should be", END_HINTS
    else:
        return None
    return Finding(f"collect: {found[0]}.", found[1])


# --- in words ---
Hints = tuple[str, str]  # where to look, and what for


class Finding(NamedTuple):
    """What is wrong, and the hints, which are said on request."""

    what: str
    hints: Hints = ("", "")


PLAYED_HINTS = (
    "Write down by hand which of the three steps each of the two episodes has played.",
    "The last step of an episode is played, those after it are not: when is a flag of the end noted?",
)
REWARD_HINTS = (
    "Print what `env.step` gives in each step, and what the batch then holds.",
    "Is every step's reward there once, at its own place, and the last one, too?",
)
END_HINTS = (
    "One of the two episodes ends because the game is over, the other one because the time is.",
    "`no_bootstrap` leaves out the value behind an episode's last step. After which of the two ends is there one?",
)
HINTS: dict[str, Hints] = {
    "loss": (
        "Print each part of the loss for one step: the values, the targets, and the numbers over which its mean goes.",
        "Hold each part, its shape and its masks against the formula on its page, docs/algorithms/{name}.md.",
    ),
    "gradient": (
        "The loss before it agrees. So the number is right, and the way in which it depends on the networks is not.",
        "Look at what is detached, at no_grad, and at which parameters are stepped.",
    ),
    "weights": (
        "The loss and the norm of its gradient agree before it. So look behind `backward`.",
        "Look at clipping, and at how often and with what the optimiser steps.",
    ),
    "target": (
        "The networks that learn agree before it. So look at those that follow them.",
        "Is there a line that moves them, how far does it, and in which updates?",
    ),
}


def in_words(case: str, found: Quantity, name: str) -> Finding:
    """A quantity that differs."""
    where = f"{case}, update {found.update + 1} of 5"
    first, second = HINTS["target" if found.part.startswith("target") else found.what]
    hints = first, second.format(name=name)
    if found.what == "weights":
        if found.ours.shape != found.theirs.shape:
            what = f"the weights are {len(found.ours)} instead of {len(found.theirs)} numbers"
        else:
            what = f"the weights are off by up to {(found.ours - found.theirs).abs().max():.2g}"
        return Finding(f"{where}: after it, {what} in {PARTS[found.part]}.", hints)
    quantity = {"loss": f"`{LOSSES[found.part]}`", "gradient": f"the norm of the {found.part} gradient"}[found.what]
    ours, theirs = (", ".join(f"{x:.8g}" for x in values.flatten().tolist()) for values in (found.ours, found.theirs))
    return Finding(f"{where}: {quantity} is {ours or 'never computed'}, and should be {theirs}.", hints)


NO_GRADIENT = (
    "Follow the loss back, name by name, to the line in which that network is called.",
    "On this way something is detached, or computed under no_grad. Which part of the loss may be, and which not?",
)
SHAPE_HINTS = (
    "Print the shapes of what meets in this line, and write beside each what its axes are: time, episode, agent.",
    "Which size does each axis have, and which one should it have? An axis of length 1 fits any length.",
)


def sizes(recording: Recording) -> str:
    """What a student has to know to read a shape."""
    _, steps, episodes = recording.arrays["played"].shape
    own = "with values of its own" if recording.separate_states else "the observations side by side"
    return (
        f" ({recording.case} has {steps} steps of {episodes} episodes with {N_AGENTS} agents, {N_ACTIONS} actions, "
        f"observations of {OBS_SIZE} values and a state of {recording.state_size}, {own})"
    )


def shapes_in_words(error: str, where: str) -> str:
    """PyTorch's message on shapes that do not fit as a sentence; the message itself where it is another one."""
    if found := re.search(r"mat1 and mat2 shapes cannot be multiplied \(\d+x(\d+) and (\d+)x\d+\)", error):
        return f"a network that was built for {found[2]} inputs is given {found[1]}{where}"
    pairs = r"size of (?:the )?tensor (?:a )?\((\d+)\) must match the (?:existing size|size of tensor b) \((\d+)\)"
    if found := re.search(pairs, error):
        return f"two tensors do not fit, since one has {found[1]} and the other {found[2]} entries along an axis{where}"
    return error


def check(module: Any, name: str) -> Finding | None:
    """The first difference; None where there is none."""
    if wrong := wrong_in_collect(module):
        return wrong
    for case in CASES:
        try:
            with double_precision():
                for found in replay(module, name, case):
                    if not found.agrees():
                        return in_words(case, found, name)
        except Exception as error:
            error.add_note(sizes(Recording(name, case)))
            raise
    return None


def stops(path: Path, error: Exception) -> Finding:
    """What an error of the student's file says, in a sentence."""
    if isinstance(error, AttributeError) and isinstance(error.obj, ModuleType):
        return Finding(f"{path} has no `{error.name}`, which this check uses.")
    own = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path.resolve()]
    line = f", line {own[0].lineno} (`{own[0].line}`)," if own else ""  # in `update`, not in a network that it calls
    if "does not require grad" in str(error):
        return Finding(f"{path}{line} stops: the loss does not depend on the network that should learn.", NO_GRADIENT)
    said = shapes_in_words(str(error), "".join(getattr(error, "__notes__", [])))
    if said == str(error):
        return Finding(f"{path}{line} stops: {type(error).__name__}: {said}")
    return Finding(f"{path}{line} stops: {said}.", SHAPE_HINTS)


def wrong_in_training(path: Path) -> Finding | None:
    """What a short training of the whole script says where it stops."""
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, str(path), "--env", TASK, "--total-timesteps", "2000", "--eval-points", "2"]
        words += ["--eval-episodes", "2", "--run-dir", f"{folder}/run"]
        done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode == 0:
        return None
    *_, last = done.stderr.strip().splitlines() or ["it said nothing"]
    env = envs.make(TASK)
    sizes = f" (an observation of {TASK} has {env.obs_size} values, its state {env.state_size})"
    return Finding(
        f"The updates are right, but a training with {path} stops: {shapes_in_words(last, sizes)}.",
        (
            "The check of the updates builds the networks itself. Here `train` builds them.",
            "Which of the two sizes does `train` give to each network?",
        ),
    )


def wrong_in_gae(module: Any) -> Finding | None:
    """What differs in `gae`, for gamma 1/2 and lambda 1/4, after each kind of end."""
    n_ends = len(BY_HAND)
    weights = torch.tensor([1.0, 0.0])  # a second agent, to whom no state is worth anything
    rewards = torch.tensor([1.0, 2.0, 3.0])[:, None, None].expand(-1, n_ends, 1)  # [time, env, 1]
    values = torch.tensor([10.0, 20.0, 30.0, 40.0])[:, None, None] * weights  # [time + 1, 1, agent]
    values = values.expand(-1, n_ends, -1)  # [time + 1, env, agent]
    played = torch.tensor([[True, True, True], [True, True, True], [True, True, False]])  # [time, env]
    no_bootstrap = torch.tensor([[False, False, False], [False, False, False], [False, True, False]])
    found = module.gae(rewards, values, played, no_bootstrap, 0.5, 0.25)
    if found.shape != (3, n_ends, 2):
        return Finding(f"gae: its shape is {[*found.shape]}, and should be [time, env, agent], here {[3, n_ends, 2]}.")
    for k, (end, (expected, hints)) in enumerate(BY_HAND.items()):
        ours = found[played[:, k], k, 0].tolist()
        if ours != expected:
            return Finding(f"gae: after {end} the advantages are {ours}, and should be {expected}.", hints)
    return None


GAE = "mappo_yu"
UPDATES_ARE_RIGHT = "collect is right, 5 updates in 4 cases are those of EPyMARL's {}"
GAE_HINTS = (
    "Begin with the last step, where the estimate is one error: reward plus discounted next value minus value.",
    "An earlier one is its own error plus gamma times lambda times the one behind it. What is the value after an end?",
)
SHORTER_HINTS = (
    "Another episode of the batch is longer by one step. So here the last row of the rewards is of no step.",
    "What does your sum take from a row that was not played?",
)
BY_HAND = {  # the estimates of the played steps, and hints
    "a time-out": ([0.515625, -3.875, -7.0], GAE_HINTS),
    "a real end": ([0.203125, -6.375, -27.0], GAE_HINTS),
    "a time-out one step earlier": ([0.625, -3.0], SHORTER_HINTS),
}


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
    parser = runs.Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("algorithm", choices=[*sorted(TOLERANCES), GAE], help="what the script should be")
    parser.add_argument("script", type=Path, help="your file")
    parser.add_argument(
        "--hint", type=int, default=0, choices=[1, 2], help="1: also say where to look; 2: and what for"
    )
    args = parser.parse_args()
    try:
        module = load(args.script)
        found = wrong_in_gae(module) if args.algorithm == GAE else check(module, args.algorithm)
        found = found or wrong_in_training(args.script)
    except InputError:
        raise
    except Exception as error:  # whatever a student's file does
        found = stops(args.script, error)
    if found:
        print(" ".join([found.what, *found.hints[: args.hint]]).strip())
        if args.hint == 0 and found.hints[0]:
            print("(--hint 1 says where to look.)")
        sys.exit(1)
    checked = "gae is right" if args.algorithm == GAE else UPDATES_ARE_RIGHT.format(args.algorithm.upper())
    print(f"{args.script}: {checked}, and it trains.")


if __name__ == "__main__":
    main()
