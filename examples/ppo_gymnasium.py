"""PPO in CleanRL's form on `gymnasium.make_vec`: a loop to copy into your own code.

All agents share an actor and a critic; each learns from its own observations and the team's reward. A finished
environment is reset by the step after its last one (Gymnasium's autoreset mode NEXT_STEP). That step ignores the
actions, so nothing may be learned from it: `ended[t]` says for which environments step t is such a step. The
observation before it, the last one of the episode, is not wasted: if time ran out, the return continues with its value.

    python examples/ppo_gymnasium.py --task lbf-5x5-2p-1f --seed 1
"""

import gymnasium
import torch
import tyro
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from torch import nn

from envs import runs  # to import envs registers the tasks in Gymnasium


def network(inputs: int, outputs: int) -> nn.Module:
    """Two hidden layers."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def main(task: str = "lbf-5x5-2p-1f", seed: int = 0, total_timesteps: int = 500_000, goal: float = 0.95) -> float:
    """Train until the last 100 episodes return as much as the goal on average; returns that average."""
    num_envs, num_steps, gamma, gae_lambda, clip_coef, entropy_coef = 16, 64, 0.99, 0.95, 0.2, 0.01
    torch.set_num_threads(1)  # more do not pay for networks this small
    torch.manual_seed(seed)
    env = RecordEpisodeStatistics(gymnasium.make_vec("marl/task", num_envs=num_envs, task=task, seed=seed))
    first, info = env.reset()
    _, n_agents, obs_size = first.shape
    n_actions = info["action_mask"].shape[-1]
    actor, critic = network(obs_size, n_actions), network(obs_size, 1)
    parameters = [*actor.parameters(), *critic.parameters()]
    optimiser = torch.optim.Adam(parameters, lr=1e-3)

    def policy(obs: torch.Tensor, masks: torch.Tensor) -> torch.distributions.Categorical:
        return torch.distributions.Categorical(logits=actor(obs).masked_fill(~masks, -1e9))

    # A batch. What it knows before step t has the index t, so these have one more entry than there are steps.
    obs = torch.zeros(num_steps + 1, num_envs, n_agents, obs_size)
    masks = torch.zeros(num_steps + 1, num_envs, n_agents, n_actions, dtype=torch.bool)
    ended, terminated = torch.zeros(2, num_steps + 1, num_envs, 1, dtype=torch.bool)
    actions, log_probs = torch.zeros(2, num_steps, num_envs, n_agents)
    rewards = torch.zeros(num_steps, num_envs, 1)  # the team's
    obs[-1], masks[-1] = torch.from_numpy(first), torch.from_numpy(info["action_mask"])

    mean = 0.0
    for update in range(1, total_timesteps // (num_envs * num_steps) + 1):
        for entries in (obs, masks, ended, terminated):
            entries[0] = entries[-1]  # go on where the last batch ended
        for t in range(num_steps):
            with torch.no_grad():
                pi = policy(obs[t], masks[t])
                actions[t] = pi.sample()
                log_probs[t] = pi.log_prob(actions[t])
            next_obs, reward, terminations, truncations, info = env.step(actions[t].long().numpy())
            obs[t + 1], masks[t + 1] = torch.from_numpy(next_obs), torch.from_numpy(info["action_mask"])
            rewards[t, :, 0] = torch.from_numpy(reward)
            terminated[t + 1, :, 0] = torch.from_numpy(terminations)
            ended[t + 1, :, 0] = torch.from_numpy(terminations | truncations)

        with torch.no_grad():
            values = critic(obs).squeeze(-1)  # [time, env, agent]
        advantages = torch.zeros(num_steps + 1, num_envs, n_agents)  # by generalised advantage estimation
        for t in reversed(range(num_steps)):
            errors = rewards[t] + gamma * values[t + 1] * ~terminated[t + 1] - values[t]
            advantages[t] = errors + gamma * gae_lambda * advantages[t + 1] * ~ended[t + 1]
        returns = advantages + values

        real = (~ended[:-1]).expand_as(actions).nonzero()  # (time, env, agent) of all that is experience
        for _ in range(4):
            for samples in real[torch.randperm(len(real))].chunk(4):
                i = samples.unbind(dim=1)
                pi = policy(obs[i], masks[i])
                advantage = (advantages[i] - advantages[i].mean()) / (advantages[i].std() + 1e-8)
                ratio = (pi.log_prob(actions[i]) - log_probs[i]).exp()
                clipped = ratio.clamp(1 - clip_coef, 1 + clip_coef)
                policy_loss = -torch.min(ratio * advantage, clipped * advantage).mean()
                value_loss = (critic(obs[i]).squeeze(-1) - returns[i]).square().mean()
                optimiser.zero_grad()
                (policy_loss + 0.5 * value_loss - entropy_coef * pi.entropy().mean()).backward()
                nn.utils.clip_grad_norm_(parameters, 0.5)
                optimiser.step()

        mean = sum(env.return_queue) / max(len(env.return_queue), 1)
        print(f"{update * num_envs * num_steps:>8,} steps: the last 100 episodes returned {mean:.3f}", flush=True)
        if len(env.return_queue) == 100 and mean >= goal:
            break
    return mean


if __name__ == "__main__":
    with runs.one_sentence(__file__):
        tyro.cli(main)
