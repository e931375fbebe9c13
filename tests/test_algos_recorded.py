"""Updates recorded with EPyMARL's own learners, replayed in the nine scripts (tests/data/updates/README.md)."""

import json
from collections import defaultdict

import numpy as np
import pytest
import torch
from scripts import NAMES, ROOT, VALUE_BASED, script
from torch.nn.utils import parameters_to_vector, vector_to_parameters

N_AGENTS, N_ACTIONS, OBS_SIZE = 3, 5, 7
CASES = ["fc_shared", "gru_shared", "fc_independent", "gru_independent"]
# How far the scripts may be from EPyMARL, in float64: weights; losses and norms of gradients. Rounding alone, except
# where EPyMARL takes log(p + 1e-10) and the scripts take log(p): in the on-policy five (COMA: in the entropy alone).
TOLERANCES = {name: (1e-12, 1e-12) for name in ("iql", "vdn", "maddpg")}
TOLERANCES |= {"qmix": (1e-12, 1e-11), "coma": (1e-12, 1e-10)}
TOLERANCES |= {"ia2c": (2e-9, 5e-8), "maa2c": (2e-9, 5e-8), "ippo": (1e-7, 1e-7), "mappo": (1e-7, 1e-7)}


class Recording:
    """One case of a file: flags, start weights, batches, and what EPyMARL made of them."""

    def __init__(self, name: str, case: str):
        with np.load(ROOT / "tests/data/updates" / f"{name}.npz") as file:
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


# --- the scripts' side: what a change of their classes concerns ---
def make_args(module, recording):
    """The recorded flags; what else stands beside them is no flag of a script."""
    others = {"algorithm", "epymarl_commit", "first_update", "state"}
    flags = {flag: value for flag, value in recording.flags.items() if flag not in others}
    return module.Args(**flags | {"reward_standardisation": False})  # recorded as "none"


def make_parts(module, args, recording):
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
    parts: dict = {}
    for part in ("agents", "target_agents", "critic", "target_critic", "mixer", "target_mixer"):
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


def make_batch(module, recording, update):
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


LOSSES = {"value": "loss/value", "critic": "loss/critic", "actor": "loss/actor"}  # EPyMARL's names, and the scripts'


# --- the replay ---
@pytest.fixture
def double_precision():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def gumbel_softmax_with(noise):
    """`gumbel_softmax` with recorded noise in the place of its own."""

    def gumbel_softmax(logits, rng):
        soft = (logits + noise).softmax(-1)
        drawn = torch.nn.functional.one_hot(soft.argmax(-1), logits.shape[-1])
        return drawn + soft - soft.detach()

    return gumbel_softmax


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.slow
def test_five_updates_are_those_of_epymarl(monkeypatch, double_precision, name, case):
    """Weights after the first and the last update; losses and norms of the gradients in each."""
    module, recording = script(name), Recording(name, case)
    args = make_args(module, recording)
    parts = make_parts(module, args, recording)
    networks = [part for part in parts if part.endswith(("agents", "critic", "mixer"))]
    near_weights, near = TOLERANCES[name]
    clip = torch.nn.utils.clip_grad_norm_
    norms = defaultdict(list)  # of the gradients of an update, before clipping

    def noted(parameters, *arguments, **keywords):
        parameters = list(parameters)
        learner = "value" if name in VALUE_BASED else "actor"
        if "critic" in parts and parameters[0] is next(parts["critic"].parameters()):
            learner = "critic"
        norm = clip(parameters, *arguments, **keywords)
        norms[learner].append(norm)
        return norm

    def assert_near(ours, theirs, tolerance):
        assert ours.dtype == torch.float64
        torch.testing.assert_close(ours, theirs, rtol=0.0, atol=tolerance)

    monkeypatch.setattr(torch.nn.utils, "clip_grad_norm_", noted)
    for update in range(recording.n_updates):
        if name == "maddpg":
            noise = recording.cut("gumbel_noise", update)
            monkeypatch.setattr(module, "gumbel_softmax", gumbel_softmax_with(noise))
        if name == "coma":
            last_actions = recording.arrays["last_actions"][update][None]
            monkeypatch.setattr(module, "sample_actions", lambda *inputs, drawn=last_actions: drawn)
        rng = [torch.Generator()] if name in ("coma", "maddpg") else []
        batch = make_batch(module, recording, update)
        losses = module.update(args, parts, batch, recording.flags["first_update"] + update, *rng)
        for learner in ["value"] if name in VALUE_BASED else ["critic", "actor"]:
            assert_near(losses[LOSSES[learner]].detach(), recording[f"{learner}_loss"][update], near)
            assert_near(torch.stack(norms.pop(learner)), recording[f"{learner}_gradient_norm"][update], near)
        if update in (0, 4):
            for part in networks:
                weights = parameters_to_vector(parts[part].parameters()).detach()
                weights = weights[::11] if "mixer" in part else weights
                assert_near(weights, recording.expected(part, update), near_weights)
    assert len(networks) == {"iql": 2, "vdn": 2, "qmix": 4, "maddpg": 4}.get(name, 3)
