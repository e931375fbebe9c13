"""The on-policy scripts: whole updates, one after another, against slow, obvious loops."""

from copy import deepcopy

import numpy as np
import pytest
import torch
from scripts import ON_POLICY, args_of, nine, own_rewards, script
from slow import (
    LENGTHS,
    N_ACTIONS,
    N_AGENTS,
    OBS_SIZE,
    STATE_SIZE,
    assert_learnt_alike,
    make_batch,
    one_hot,
    slow_rewards,
    slow_step,
    slow_target,
    step_by_step,
)


def slow_values(name, critic, batch, t, e, actions):
    """What the critics say in step t of environment e, [agent, 1], or in COMA for each own action, [agent, action]."""
    if name in ("ia2c", "ippo"):
        rows = [batch.observations[t, e, i] for i in range(N_AGENTS)]
    elif name in ("maa2c", "mappo"):
        rows = [batch.states[t, e]] * N_AGENTS
    else:
        others = [[one_hot(actions[j]) * (j != i) for j in range(N_AGENTS)] for i in range(N_AGENTS)]
        rows = [torch.cat([batch.states[t, e], *others[i]]) for i in range(N_AGENTS)]
    return critic(torch.stack(rows)[None, None])[0][0, 0]


def slow_returns(name, args, parts, batch, last_actions):
    """For each environment its n-step returns [time, agent], by their definition, with the target critic."""
    rewards, returns = slow_rewards(args, batch), []
    for e, length in enumerate(LENGTHS):
        returns.append(torch.zeros(length, N_AGENTS))
        for t in range(length):
            end = min(t + args.n_step, length)
            total = sum(args.gamma ** (k - t) * rewards[k, e] for k in range(t, end))
            if end < length or not batch.no_bootstrap[length - 1, e]:
                actions = batch.actions[end, e] if end < len(batch.actions) else last_actions[e]
                values = slow_values(name, parts["target_critic"], batch, end, e, actions).detach()
                taken = [values[i, actions[i] if name == "coma" else 0] for i in range(N_AGENTS)]
                total = total + args.gamma ** (end - t) * torch.stack(taken)
            returns[e][t] = total
    return returns


def slow_update(name, args, parts, batch, clips):
    """An update by loops over environments, steps and agents. Returns its figures; notes in clips where PPO clipped."""
    steps = [(t, e) for e, length in enumerate(LENGTHS) for t in range(length)]
    played = [(t, e, i) for t, e in steps for i in range(N_AGENTS)]
    logits = torch.stack([step_by_step(parts["agents"], batch.observations[:, e])[-1] for e in range(len(LENGTHS))])
    noise = torch.empty(logits.shape).exponential_(generator=torch.manual_seed(1)).log()
    last_actions = (logits - noise).masked_fill(~batch.action_masks[-1], -torch.inf).argmax(-1)  # [env, agent]
    returns, old, losses = slow_returns(name, args, parts, batch, last_actions), dict[tuple, float](), {}
    for _ in range(getattr(args, "update_epochs", 1)):
        outputs = [step_by_step(parts["agents"], batch.observations[:, e]) for e in range(len(LENGTHS))]
        judged = {(t, e): slow_values(name, parts["critic"], batch, t, e, batch.actions[t, e]) for t, e in steps}
        errors, advantages, values_taken = [], {}, []
        for t, e, i in played:
            values = judged[t, e][i]
            value = values[batch.actions[t, e, i] if name == "coma" else 0]
            errors.append((returns[e][t, i] - value) ** 2)
            values_taken.append(value.item())
            advantages[t, e, i] = (returns[e][t, i] - value).item()
            if name == "coma":
                available = batch.action_masks[t, e, i]
                policy = outputs[e][t][i][available].softmax(-1)
                advantages[t, e, i] = (value - (policy * values[available]).sum()).item()
        losses["loss/critic"] = torch.stack(errors).mean() * (N_AGENTS if name == "coma" else 1)
        norm = slow_step(parts["critic_optimiser"], losses["loss/critic"], args.max_grad_norm)
        losses["gradient/critic_norm"] = torch.tensor(norm)
        unexplained = [float(returns[e][t, i] - value) for (t, e, i), value in zip(played, values_taken)]
        variance = np.var([float(returns[e][t, i]) for t, e, i in played], ddof=1)
        losses["value/explained_variance"] = torch.tensor(1 - np.var(unexplained, ddof=1) / variance).float()

        gains, entropies, divergences, outside = [], [], [], []
        for t, e, i in played:
            available, advantage = batch.action_masks[t, e, i], advantages[t, e, i]
            policy = torch.zeros(N_ACTIONS).masked_scatter(available, outputs[e][t][i][available].softmax(-1))
            probability = policy[batch.actions[t, e, i]]
            entropies.append(-(policy[available] * policy[available].log()).sum())
            if "ppo" in name:
                ratio = probability / old.setdefault((t, e, i), probability.item())
                bound = 1 + args.clip_coef if advantage > 0 else 1 - args.clip_coef
                clipped = ratio > bound if advantage > 0 else ratio < bound
                clips.append(bool(clipped))
                divergences.append(float(ratio - 1 - ratio.log()))
                outside.append(abs(float(ratio) - 1) > args.clip_coef)
                gains.append(torch.tensor(bound * advantage) if clipped else ratio * advantage)
            else:
                gains.append(probability.log() * advantage)
        losses["policy/entropy"] = torch.stack(entropies).mean()
        losses["loss/actor"] = -torch.stack(gains).mean() - args.entropy_coef * losses["policy/entropy"]
        norm = slow_step(parts["actor_optimiser"], losses["loss/actor"], args.max_grad_norm)
        losses["gradient/actor_norm"] = torch.tensor(norm)
        if "ppo" in name:
            losses["policy/approximate_kl"] = torch.tensor(np.mean(divergences)).float()
            losses["policy/clip_fraction"] = torch.tensor(np.mean(outside)).float()
    slow_target(parts["target_critic"], parts["critic"])
    return losses


@pytest.mark.parametrize("name", nine(ON_POLICY))
@pytest.mark.parametrize("time_limit", ["bootstrap", "terminal"])
@pytest.mark.parametrize(
    "sharing, network, standardisation, individual",
    [(True, "fc", False, False), (False, "gru", True, False), (True, "gru", True, True)],
)
@pytest.mark.slow
def test_updates_in_a_row(name, time_limit, sharing, network, standardisation, individual):
    """Losses, and with Adam, clipping and a target that is not the critic what all networks become."""
    if name == "coma" and individual:
        pytest.skip("COMA learns from the team's reward alone")
    module = script(name)
    flags = {"network": network, "reward_standardisation": standardisation, "parameter_sharing": sharing}
    args = args_of(module, **flags, **own_rewards(individual))
    args.time_limit, args.target_update = time_limit, "soft"
    args.hidden_dim, args.n_step, args.max_grad_norm, args.entropy_coef = 8, 3, 0.5, 0.1
    if "ppo" in name:
        args.update_epochs, args.clip_coef = 2, 0.02
    torch.manual_seed(0)
    view = {"ia2c": OBS_SIZE, "ippo": OBS_SIZE, "coma": STATE_SIZE + N_AGENTS * N_ACTIONS}.get(name, STATE_SIZE)
    parts: dict = {"agents": module.MultiAgentNetwork(args, N_AGENTS, OBS_SIZE, N_ACTIONS, network)}
    for part in ("critic", "target_critic"):
        parts[part] = module.MultiAgentNetwork(args, N_AGENTS, view, N_ACTIONS if name == "coma" else 1)
    parts["actor_optimiser"] = torch.optim.Adam(parts["agents"].parameters(), lr=0.01, fused=True)
    parts["critic_optimiser"] = torch.optim.Adam(parts["critic"].parameters(), lr=0.01, fused=True)
    slow, start, batch, clips = deepcopy(parts), deepcopy(parts), make_batch(args), list[bool]()
    for updates in (1, 2):
        expected = slow_update(name, args, slow, batch, clips)
        rng = [torch.manual_seed(1)] if name == "coma" else []  # COMA draws actions in the last state
        losses = module.update(args, parts, batch, updates, *rng)
        assert set(losses) == set(expected)
        for term, loss in losses.items():
            torch.testing.assert_close(loss, expected[term], rtol=1e-4, atol=1e-5)
    assert any(clips) == ("ppo" in name)
    assert_learnt_alike(parts, slow, start)
