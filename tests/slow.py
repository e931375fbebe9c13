"""A made-up batch, and the slow, obvious computations that the tests of on-policy and off-policy scripts share."""

import numpy as np
import torch
from scripts import script

N_AGENTS, N_ACTIONS, OBS_SIZE, STATE_SIZE = 3, 4, 5, 7
LENGTHS = [6, 1, 4, 6, 3]  # of episodes
REAL_ENDS = [True, False, False, False, True]  # the others run out of time


def one_hot(action):
    """An action [] as a vector [action]."""
    return torch.eye(N_ACTIONS)[action]


def make_batch(args, garbage=False):
    """Random episodes of unequal lengths that end in both ways. garbage: what stands in the rows that nobody played."""
    generator = torch.Generator().manual_seed(0)
    steps, n_envs = max(LENGTHS), len(LENGTHS)
    n_rewards = N_AGENTS if getattr(args, "individual_rewards", False) else 1
    masks = torch.rand(steps + 1, n_envs, N_AGENTS, N_ACTIONS, generator=generator) < 0.5
    available = torch.randint(N_ACTIONS, masks.shape[:-1], generator=generator)  # at least this one
    batch = script("mappo").Batch(
        observations=torch.randn(steps + 1, n_envs, N_AGENTS, OBS_SIZE, generator=generator),
        states=torch.randn(steps + 1, n_envs, STATE_SIZE, generator=generator),
        action_masks=masks.scatter(-1, available.unsqueeze(-1), True),
        actions=available[:-1].clone(),
        rewards=torch.randn(steps, n_envs, n_rewards, generator=generator) + 2.0,
        played=torch.zeros(steps, n_envs, dtype=torch.bool),
        no_bootstrap=torch.zeros(steps, n_envs, dtype=torch.bool),
    )
    for e, length in enumerate(LENGTHS):
        batch.played[:length, e] = True
        batch.no_bootstrap[length - 1 :, e] = REAL_ENDS[e] or args.time_limit == "terminal"
        for rows in (batch.observations, batch.states, batch.action_masks):
            rows[length + 1 :, e] = 1e6 * garbage
        batch.rewards[length:, e] = 1e6 * garbage
        batch.actions[length:, e] = garbage
        if garbage:
            batch.no_bootstrap[length:, e] = False
    return batch


def step_by_step(agents, observations):
    """Outputs [time][agent, action] for one episode's observations [time, agent, obs], one step after another."""
    outputs, hidden = [], None
    for row in observations:
        output, hidden = agents(row[None, None], hidden)
        outputs.append(output[0, 0])
    return outputs


def slow_rewards(args, batch):
    """Rewards [time, env, agent], of the team or of each, standardised over what was played."""
    if not args.reward_standardisation:
        return batch.rewards.expand(-1, -1, N_AGENTS)
    standardised = torch.zeros_like(batch.rewards)
    for i in range(batch.rewards.shape[-1]):
        seen = [float(x) for e, length in enumerate(LENGTHS) for x in batch.rewards[:length, e, i]]
        standardised[..., i] = (batch.rewards[..., i] - np.mean(seen)) / (np.std(seen, ddof=1) + 1e-5)
    return standardised.expand(-1, -1, N_AGENTS)


def slow_step(optimiser, loss, max_grad_norm):
    """A step down the loss, its gradient clipped over all parameters. Returns the norm that the gradient had."""
    parameters = optimiser.param_groups[0]["params"]
    gradients = torch.autograd.grad(loss, parameters)
    norm = float(torch.cat([x.flatten() for x in gradients]).norm())
    for parameter, gradient in zip(parameters, gradients):
        parameter.grad = gradient * min(1.0, max_grad_norm / norm)
    optimiser.step()
    return norm


def slow_target(target, online):
    """One hundredth of the way to the online network."""
    with torch.no_grad():
        for old, new in zip(target.parameters(), online.parameters()):
            old.copy_(0.99 * old + 0.01 * new)


def assert_learnt_alike(parts, slow, start):
    """All networks are those of the slow computation, and have moved from the start."""
    for part in [x for x in parts if isinstance(parts[x], torch.nn.Module)]:
        moved = 0.0
        for ours, theirs, before in zip(parts[part].parameters(), slow[part].parameters(), start[part].parameters()):
            torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=1e-5)
            moved = max(moved, float((ours - before).detach().abs().max()))
        assert moved > (1e-4 if part.startswith("target") else 1e-2)
