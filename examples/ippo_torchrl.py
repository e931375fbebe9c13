"""TorchRL's PPO on one of our tasks: how a library that trains on PettingZoo environments uses `envs.pettingzoo_env`.

TorchRL's `PettingZooWrapper` takes the environment as it is. It puts agent_0, agent_1 and so on into one group, finds
the action masks, and keeps time-outs apart from terminals. (Tasks with unequal agents or opposing teams have several
groups, by the agents' names.) All agents share an actor and a critic, see their own observations and learn from their
own rewards (IPPO).

    pip install torchrl
    python examples/ippo_torchrl.py --task lbf-8x8-2p-2f-c --total-timesteps 300000

With TorchRL 0.14.1, PyTorch 2.13 and PettingZoo 1.27, these 300,000 steps took ten minutes of CPU time. Seed 0 reached
a mean return of 0.915; that of a random team is 0.005.
"""

from functools import partial

import torch
import tyro
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import EnvBase, PettingZooWrapper, SerialEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

import envs
from envs import runs

NUM_ENVS, BATCH, EPOCHS, MINIBATCHES = 8, 1024, 4, 4


def make_env(task: str, seed: int) -> EnvBase:
    """One copy of the task."""
    return PettingZooWrapper(envs.pettingzoo_env(task, seed=seed))


def mean_return(env: EnvBase, policy: nn.Module | None, episodes: int) -> float:
    """The mean over episodes of what all agents together earn. Without a policy they take any action that is allowed.

    A policy draws its actions, as in training. By itself TorchRL would take the most probable ones in a rollout.
    """
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        rollouts = [env.rollout(10_000, policy) for _ in range(episodes)]
    return sum(float(rollout["next", "agent", "reward"].sum()) for rollout in rollouts) / episodes


def main(
    task: str = "lbf-8x8-2p-2f-c", seed: int = 0, total_timesteps: int = 300_000, eval_episodes: int = 100
) -> float:
    """Train, print the mean returns of a random team and of the trained team, and return the latter."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    env = make_env(task, seed)
    n_agents, obs_size = env.observation_spec["agent", "observation"].shape
    n_actions = env.observation_spec["agent", "action_mask"].shape[-1]
    print(f"random team: mean return {mean_return(env, None, eval_episodes):.3f}", flush=True)

    def network(outputs: int) -> nn.Module:
        hidden = {"num_cells": [64, 64], "activation_class": nn.Tanh}
        return MultiAgentMLP(obs_size, outputs, n_agents, centralized=False, share_params=True, **hidden)

    logits = TensorDictModule(network(n_actions), [("agent", "observation")], [("agent", "logits")])
    actor = ProbabilisticActor(
        logits,
        in_keys={"logits": ("agent", "logits"), "mask": ("agent", "action_mask")},
        out_keys=[("agent", "action")],
        spec=env.action_spec,
        distribution_class=MaskedCategorical,
        return_log_prob=True,
        log_prob_key=("agent", "log_prob"),
    )
    critic = TensorDictModule(network(1), [("agent", "observation")], [("agent", "value")])
    weights = {"entropy_coeff": 0.01, "critic_coeff": 0.5}
    loss = ClipPPOLoss(actor, critic, loss_critic_type="l2", normalize_advantage=True, **weights)
    loss.set_keys(**{key: ("agent", key) for key in ("action", "reward", "done", "terminated", "value", "advantage")})
    loss.set_keys(sample_log_prob=("agent", "log_prob"), value_target=("agent", "value_target"))
    loss.make_value_estimator(gamma=0.99, lmbda=0.95)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)

    seeds = [1000 * seed + 1 + i for i in range(NUM_ENVS)]  # with the same seed they would play the same episodes
    copies = SerialEnv(NUM_ENVS, [partial(make_env, task, each) for each in seeds])
    collector = Collector(copies, actor, frames_per_batch=BATCH, total_frames=total_timesteps)
    for number, batch in enumerate(collector):  # [env, time]
        with torch.no_grad():
            loss.value_estimator(batch)
        experience = batch.reshape(-1)
        for _ in range(EPOCHS):
            for chosen in torch.randperm(len(experience)).chunk(MINIBATCHES):
                losses = loss(experience[chosen])
                optimiser.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimiser.step()
        if number % 10 == 9:
            rewards, done = batch["next", "agent", "reward"].sum(), batch["next", "done"].sum()
            print(f"{(number + 1) * BATCH:>8,} steps: mean return {float(rewards / done):.3f}", flush=True)
    collector.shutdown()

    trained = mean_return(env, actor, eval_episodes)
    print(f"trained team: mean return {trained:.3f}", flush=True)
    return trained


if __name__ == "__main__":
    with runs.one_sentence(__file__):
        tyro.cli(main)
