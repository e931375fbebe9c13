# algos/mappo.py with what Yu et al. add; `diff algos/mappo.py examples/mappo_yu.py` shows it.
"""MAPPO as Yu et al. use it: with GAE, normalised advantages and normalised values.

algos/mappo.py is MAPPO as the benchmark's paper has it: n-step returns, and nothing normalised. Here

    delta_i,t = r_t + gamma V_i(s_{t+1}) - V_i(s_t)
    A_i,t     = delta_i,t + gamma lambda A_i,t+1         up to the episode's end
    G_i,t     = A_i,t + V_i(s_t)

A is the generalised advantage estimate (GAE) of Schulman et al., "High-Dimensional Continuous
Control Using Generalized Advantage Estimation" (2016), with lambda --gae-lambda. Where the episode
ends, V(s_{t+1}) is 0 after a real end, and a value after a time-out. Advantages get mean 0 and
deviation 1 over the agents and played steps of a batch. The critic learns G with the mean and
deviation of the returns so far taken out; its outputs, with them put in again, are V. Of these
statistics 1 % is forgotten with each batch (in the paper's code 0.001 % with each of the critic's
steps). There is no target network: V is the critic before the batch's first update.

Algorithm: Yu et al., "The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games" (2021).
Of what they do besides, value clipping, the Huber loss, orthogonal first weights and more epochs are
left out, so that the difference from algos/mappo.py is what this file is about. All other
hyperparameters are those of algos/mappo.py; nobody has tuned them for this file.

    python examples/mappo_yu.py --env lbf-8x8-2p-2f
"""

from envs import VectorEnv, runs  # before PyTorch, which is faster on AMD processors then

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

# Hyperparameters by family and sharing, as the paper's search chose them; "other" is our choice.
PAPER_BUDGET = "on_policy_timesteps"  # this field of a Task, see envs/tasks.py
TUNED = "hidden_dim learning_rate reward_standardisation network entropy_coef"
PAPER = {
    # family, sharing           dim  rate    rewards core   entropy
    ("matrix", "shared"):      (64,  0.0005, True,   "fc",  0.001),
    ("matrix", "independent"): (64,  0.0005, True,   "fc",  0.001),
    ("mpe", "shared"):         (64,  0.0005, True,   "fc",  0.01),
    ("mpe", "independent"):    (128, 0.0001, True,   "fc",  0.01),
    ("smac", "shared"):        (64,  0.0005, False,  "gru", 0.001),
    ("smac", "independent"):   (64,  0.0005, True,   "gru", 0.001),
    ("lbf", "shared"):         (128, 0.0003, False,  "fc",  0.001),
    ("lbf", "independent"):    (128, 0.0001, False,  "fc",  0.001),
    ("rware", "shared"):       (128, 0.0005, False,  "fc",  0.001),
    ("rware", "independent"):  (128, 0.0005, False,  "fc",  0.001),
    ("other", "shared"):       (128, 0.0005, False,  "fc",  0.001),
    ("other", "independent"):  (128, 0.0005, False,  "fc",  0.001),
}  # fmt: skip


@dataclass(kw_only=True)
class Args(runs.Flags):
    # task
    env: str = "lbf-8x8-2p-2f-c"  # the task; `python -m envs` lists them
    seed: int = 0  # decides the first weights, the episodes and all that is drawn
    total_timesteps: int  # from the task: length of the training, in steps of all environments
    num_envs: int = 10  # environments side by side; a batch is one episode of each
    time_limit: Literal["bootstrap", "terminal"] = "bootstrap"  # after a time-out: a value, or 0
    individual_rewards: bool = False  # each agent learns from its own reward, not from the team's
    # network
    parameter_sharing: bool = True  # one network for all agents, or one for each
    network: Literal["fc", "gru"]  # from PAPER: the actors' core; a critic's is always fc
    hidden_dim: int  # from PAPER: width of all layers
    # learning
    learning_rate: float  # from PAPER: of Adam, for actor and critic
    gamma: float = 0.99  # discount
    gae_lambda: Annotated[float, runs.Range(0, 1)] = 0.95  # 0: trusts the critic; 1: the rewards
    entropy_coef: float  # from PAPER: weight of the policies' entropy
    update_epochs: int = 4  # passes over a batch
    clip_coef: float = 0.2  # a ratio of probabilities gains nothing beyond 1 +- this
    max_grad_norm: float = 10.0  # norm to which actor's and critic's gradients are clipped; or inf
    reward_standardisation: bool  # from PAPER: to mean 0 and deviation 1 in each batch


def paper_defaults(env: str = Args.env, parameter_sharing: bool = Args.parameter_sharing) -> Args:
    """The flags for a task. Those without a value in Args get PAPER's and the task's."""
    return runs.filled(Args, env, parameter_sharing, PAPER, TUNED, PAPER_BUDGET)


# --- networks ---
class Network(nn.Module):
    """Linear - ReLU - core - Linear. The core is a GRU, or Linear - ReLU.

    Where agents share a network, the input of agent i ends with its one-hot id. But since
    W [x, onehot(i)] + b = W_x x + W_id[:, i] + b, it is enough to add a column of the weights. For
    critics of a large state this saves time: 17 % of an update of MAPPO on rware-tiny-4p.
    """

    def __init__(self, input_size: int, n_ids: int, hidden_dim: int, output_size: int, core: str):
        super().__init__()
        self.input_size, self.n_ids = input_size, n_ids  # 0 ids where nothing is shared
        self.first = nn.Linear(input_size + n_ids, hidden_dim)
        layer = nn.GRU if core == "gru" else nn.Linear
        self.core = layer(hidden_dim, hidden_dim)
        self.last = nn.Linear(hidden_dim, output_size)

    def forward(self, x: Tensor, hidden: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        """x: [time, env, agent (or 1: all see the same), input] -> [time, env, agent, output].

        hidden: the GRU's state, [1, env * agent, hidden_dim]; None at the start of an episode.
        """
        W_x, W_id = self.first.weight.split([self.input_size, self.n_ids], dim=1)
        x = nn.functional.linear(x, W_x, self.first.bias)  # [time, env, agent or 1, hidden_dim]
        if self.n_ids > 0:
            x = x + W_id.T.contiguous()  # [time, env, agent, hidden_dim]; faster than a view
        x = torch.relu(x)
        if isinstance(self.core, nn.GRU):
            outputs, hidden = self.core(x.flatten(1, 2), hidden)  # [time, env * agent, hidden_dim]
            return self.last(outputs.view_as(x)), hidden
        return self.last(torch.relu(self.core(x))), None


class MultiAgentNetwork(nn.Module):
    """One network for all agents (parameter sharing), or one for each. For policies and values."""

    def __init__(self, args: Args, n_agents: int, inputs: int, outputs: int, core: str = "fc"):
        super().__init__()
        n_networks, n_ids = (1, n_agents) if args.parameter_sharing else (n_agents, 0)
        sizes = inputs, n_ids, args.hidden_dim, outputs
        networks = [Network(*sizes, core) for _ in range(n_networks)]
        self.networks = nn.ModuleList(networks).to(args.device)

    def forward(self, x: Tensor, hidden: list | None = None) -> tuple[Tensor, list]:
        """x, hidden -> output, hidden as in Network; here hidden has one entry for each network."""
        n = len(self.networks)
        inputs = x.expand(-1, -1, n, -1).split(1, dim=2) if n > 1 else [x]  # what each agent sees
        memories = hidden or [None] * n
        results = [network(x, h) for network, x, h in zip(self.networks, inputs, memories)]
        outputs, new_hidden = zip(*results)
        return torch.cat(outputs, dim=2) if n > 1 else outputs[0], list(new_hidden)


class ValueNorm(nn.Module):
    """Mean and deviation of all returns so far, by which the critic's targets are normalised."""

    mean: Tensor
    square: Tensor
    share: Tensor

    def __init__(self, device: str):
        super().__init__()
        for name in ("mean", "square", "share"):  # buffers: a checkpoint keeps them
            self.register_buffer(name, torch.zeros((), dtype=torch.float64, device=device))

    def add(self, returns: Tensor) -> None:
        """Brings in a batch. Older ones count less and less: a batch's weight falls by 1 % each."""
        returns = returns.double()
        self.mean.lerp_(returns.mean(), 0.01)
        self.square.lerp_(returns.square().mean(), 0.01)
        self.share.lerp_(torch.ones_like(self.share), 0.01)  # what is missing to 1 is the first zeros

    def moments(self) -> tuple[Tensor, Tensor]:
        """Mean and deviation, as numbers; 0 and 1 before the first batch."""
        if self.share == 0:
            return torch.tensor(0.0), torch.tensor(1.0)
        mean = self.mean / self.share
        variance = (self.square / self.share - mean.square()).clamp(min=1e-2)
        return mean.float(), variance.sqrt().float()


# --- maths ---
def standardised(rewards: Tensor, played: Tensor) -> Tensor:
    """Rewards with mean 0 and standard deviation 1 over the played steps of a batch.

    rewards: [time, env, 1 or agent]; played: [time, env]. Each agent has its own mean and std.
    """
    sample = rewards[played].double()  # [step, 1 or agent]
    std, mean = torch.std_mean(sample, 0, correction=min(len(sample) - 1, 1))
    return (rewards - mean.to(rewards)) / (std + 1e-5).to(rewards)


def gae(
    rewards: Tensor, values: Tensor, played: Tensor, no_bootstrap: Tensor, gamma: float, lam: float
) -> Tensor:
    """Generalised advantage estimates: discounted sums of one-step errors, up to the episode's end.

    rewards: [time, env, 1 or agent]; values: [time + 1, env, agent], of all states, also of the one
    after the last step; played, no_bootstrap: [time, env], as in Batch. Returns [time, env, agent];
    0 where nothing was played.
    """
    next_values = values[1:].masked_fill(no_bootstrap.unsqueeze(-1), 0.0)  # 0 after a real end
    errors = rewards + gamma * next_values - values[:-1]
    errors = errors.masked_fill(~played.unsqueeze(-1), 0.0)  # nothing comes back from beyond the end
    advantages = torch.zeros_like(values)
    for t in reversed(range(len(rewards))):
        advantages[t] = errors[t] + gamma * lam * advantages[t + 1]
    return advantages[:-1]


def log_probabilities(logits: Tensor, action_masks: Tensor) -> Tensor:
    """log pi(. | o), [..., action]. Not -inf for masked actions, so p log p is 0 and not NaN."""
    logits = torch.where(action_masks, logits, torch.finfo(logits.dtype).min)
    return logits - logits.logsumexp(-1, keepdim=True)


def played_mean(x: Tensor, played: Tensor) -> Tensor:
    """Mean of x [time, env, agent or 1] over agents and over the played steps [time, env]."""
    return (x * played.unsqueeze(-1)).sum() / (played.sum() * x.shape[-1])


def sample_actions(logits: Tensor, action_masks: Tensor, rng: torch.Generator) -> Tensor:
    """Draws from softmax(logits) over the available actions: [..., action] -> [...].

    The largest of logits plus Gumbel noise is such a draw. -log(exponential noise) is Gumbel noise.
    """
    gumbel = -torch.empty(logits.shape).exponential_(generator=rng).log_().to(logits.device)
    return torch.where(action_masks, logits + gumbel, -torch.inf).argmax(-1)


# --- experience ---
class Batch(NamedTuple):
    """Whole episodes side by side. `time + 1`: there is also a row for the state after the end."""

    observations: Tensor  # [time + 1, env, agent, obs]
    states: Tensor  # [time + 1, env, state]; may be a view of the observations
    action_masks: Tensor  # [time + 1, env, agent, action], bool: what each agent may do
    actions: Tensor  # [time, env, agent], int
    rewards: Tensor  # [time, env, 1], the team's; or [time, env, agent], each agent's own
    played: Tensor  # [time, env], bool: False after the end, where only the first row matters
    no_bootstrap: Tensor  # [time, env], bool: the state after this step is worth 0


class Team:
    """Agents at play. They draw their actions from their policies, or always take the likeliest."""

    def __init__(self, args: Args, agents: nn.Module, rng: torch.Generator, greedy: bool = False):
        self.args, self.agents, self.rng, self.greedy = args, agents, rng, greedy
        self.reset()

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forgets the last episode. To be called before each new one. mask, [env]: only there."""
        self.hidden: list | None = None if mask is None else runs.forgotten(self.hidden, mask)

    @torch.inference_mode()
    def act(self, observations: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """observations: [env, agent, obs]. Returns the actions, [env, agent]."""
        inputs = torch.from_numpy(observations)[None].float().to(self.args.device)  # one time step
        masks = torch.from_numpy(info["action_mask"]).bool()  # [env, agent, action]
        logits, self.hidden = self.agents(inputs, self.hidden)
        logits = logits[0].cpu()
        if self.greedy:
            return torch.where(masks, logits, -torch.inf).argmax(-1).numpy()
        return sample_actions(logits, masks, self.rng).numpy()


def new_storage(args: Args, env: VectorEnv) -> Batch:
    """Room for one episode of each environment."""
    steps, n_envs, n_agents = env.episode_limit, env.num_envs, env.n_agents
    observations = torch.zeros(steps + 1, n_envs, n_agents, env.obs_size)
    states = torch.zeros(steps + 1, n_envs, env.state_size)
    if env.state_is_observations:
        states = observations.flatten(2)  # a view: what is written into one stands in the other
    return Batch(
        observations=observations,
        states=states,
        action_masks=torch.zeros(steps + 1, n_envs, n_agents, env.n_actions, dtype=torch.bool),
        actions=torch.zeros(steps, n_envs, n_agents, dtype=torch.int64),
        rewards=torch.zeros(steps, n_envs, n_agents if args.individual_rewards else 1),
        played=torch.zeros(steps, n_envs, dtype=torch.bool),
        no_bootstrap=torch.zeros(steps, n_envs, dtype=torch.bool),
    )


def collect(args: Args, env: VectorEnv, team: Team, storage: Batch) -> tuple[Batch, np.ndarray]:
    """Plays one whole episode in each environment; those that end early wait for the others.

    Returns the batch, cut to the longest episode, and the team's episode returns, [env]. On the CPU
    the batch is a view of `storage`, so it is valid until the next one is collected.
    """
    arrays: Any = Batch._make(x.numpy() for x in storage)  # the same memory, for NumPy
    observations, info = env.reset()
    team.reset()
    ended = np.zeros(env.num_envs, dtype=bool)
    episode_returns = np.zeros(env.num_envs)
    for t in range(env.episode_limit + 1):
        arrays.observations[t], arrays.states[t] = observations, info["state"]
        arrays.action_masks[t] = info["action_mask"]
        if ended.all():
            break
        actions = team.act(observations, info)
        arrays.actions[t], arrays.played[t] = actions, ~ended
        observations, rewards, terminated, truncated, info = env.step(actions)
        arrays.rewards[t] = info["agent_rewards"] if args.individual_rewards else rewards[:, None]
        episode_returns += rewards
        ended = terminated | truncated
        arrays.no_bootstrap[t] = ended if args.time_limit == "terminal" else terminated
    unplayed = env.episode_limit - t  # rows at the end that no episode has reached
    batch = Batch._make(x[: len(x) - unplayed].to(args.device) for x in storage)
    return batch, episode_returns


# --- update ---
def gradient_step(loss: Tensor, optimiser: torch.optim.Optimizer, max_grad_norm: float) -> Tensor:
    """Moves the optimiser's parameters down the loss. Returns their gradient's unclipped norm."""
    parameters = [x for group in optimiser.param_groups for x in group["params"]]
    optimiser.zero_grad()
    loss.backward(inputs=parameters)  # only these: a loss may pass through other networks
    norm = nn.utils.clip_grad_norm_(parameters, max_grad_norm)
    optimiser.step()
    return norm


def update(args: Args, parts: dict[str, Any], batch: Batch, n_updates: int) -> dict[str, Tensor]:
    """Learns from a batch in update number n_updates, from 1 on. Returns figures for the log."""
    played = batch.played
    agents, critic, value_norm = parts["agents"], parts["critic"], parts["value_norm"]
    # All agents see the same state; a shared critic adds their ids and so has a value for each.
    critic_inputs = batch.states.unsqueeze(2)  # [time + 1, env, 1, state]
    rewards = standardised(batch.rewards, played) if args.reward_standardisation else batch.rewards
    with torch.no_grad():
        mean, deviation = value_norm.moments()
        old_values = critic(critic_inputs)[0].squeeze(-1) * deviation + mean  # [time + 1, env, agent]
        advantages = gae(
            rewards, old_values, played, batch.no_bootstrap, args.gamma, args.gae_lambda
        )
        returns = advantages + old_values[:-1]
        value_norm.add(returns[played])
        mean, deviation = value_norm.moments()
        normalised_returns = (returns - mean) / deviation
        sample = advantages[played]  # [step, agent]; one mean and deviation for all agents
        advantages = (advantages - sample.mean()) / (sample.std() + 1e-5)

    for epoch in range(args.update_epochs):
        values = critic(critic_inputs[:-1])[0].squeeze(-1)  # [time, env, agent]
        critic_loss = played_mean((normalised_returns - values).square(), played)
        critic_norm = gradient_step(critic_loss, parts["critic_optimiser"], args.max_grad_norm)

        logits = agents(batch.observations[:-1])[0]  # [time, env, agent, action]
        log_probs = log_probabilities(logits, batch.action_masks[:-1])
        log_pi = log_probs.gather(-1, batch.actions.unsqueeze(-1)).squeeze(-1)  # [time, env, agent]
        if epoch == 0:  # before its first step the policy is still the one that acted
            old_log_pi = log_pi.detach()
        log_ratios = log_pi - old_log_pi
        ratios = log_ratios.exp()
        clipped = ratios.clamp(1 - args.clip_coef, 1 + args.clip_coef)
        surrogate = torch.minimum(ratios * advantages, clipped * advantages)
        entropy = -(log_probs.exp() * log_probs).sum(-1)
        actor_loss = -played_mean(surrogate + args.entropy_coef * entropy, played)
        actor_norm = gradient_step(actor_loss, parts["actor_optimiser"], args.max_grad_norm)

    with torch.no_grad():
        errors = normalised_returns - values
        unforeseen, total = (x[played].var(correction=0) for x in (errors, normalised_returns))
        explained = torch.where(total > 0, 1 - unforeseen / total, 0.0)  # 0 where nothing varies
        return {
            "loss/critic": critic_loss,
            "loss/actor": actor_loss,
            "policy/entropy": played_mean(entropy, played),
            # The estimator k3 of Schulman, "Approximating KL Divergence" (2020).
            "policy/approximate_kl": played_mean(ratios - 1 - log_ratios, played),
            "policy/clip_fraction": played_mean((ratios != clipped).float(), played),
            "value/explained_variance": explained,
            "gradient/critic_norm": critic_norm,
            "gradient/actor_norm": actor_norm,
        }


# --- train ---
def train(args: Args) -> None:
    """Trains a team on a task."""
    env = runs.make_for(args, args.num_envs, args.seed)
    runs.check_teams(env, args.individual_rewards, args.parameter_sharing)
    torch.manual_seed(args.seed)  # for the first weights
    agents = MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, args.network)
    critic = MultiAgentNetwork(args, env.n_agents, env.state_size, 1)
    parts = {  # what a checkpoint keeps
        "agents": agents,
        "critic": critic,
        "value_norm": ValueNorm(args.device),
        "actor_optimiser": torch.optim.Adam(agents.parameters(), args.learning_rate, fused=True),
        "critic_optimiser": torch.optim.Adam(critic.parameters(), args.learning_rate, fused=True),
    }
    rng = runs.own_generator()  # continues PyTorch's; the training draws from it, and no game can
    run = runs.Run(__file__, args, paper_defaults, env, parts, Team, rng)
    team = Team(args, agents, rng)
    storage = new_storage(args, env)

    run.evaluate_if_due()  # the first point comes before training
    while run.timestep < args.total_timesteps:
        batch, episode_returns = collect(args, env, team, storage)
        run.n_updates += 1
        metrics = update(args, parts, batch, run.n_updates)
        run.count(batch.played, episode_returns, metrics)  # ends if a loss is not finite
        run.stop_if_asked()  # after Ctrl-C or SIGTERM: saves, and ends the process
        run.evaluate_if_due()
        run.save_if_due()
    run.complete()


# --- load ---
def load(run_dir: str | Path, seed: int = 0, greedy: bool = False) -> Team:
    """The trained team of a run, on the CPU; it acts as in evaluations, or always greedily."""
    saved = runs.read_checkpoint(run_dir, Path(__file__).stem)
    with runs.fitting_checkpoint(run_dir):
        args = Args(**dict(saved["config"]["flags"], device="cpu"))
        agents = MultiAgentNetwork(args, *saved["network"])
        agents.load_state_dict(saved["parts"]["agents"])
    return runs.careful(Team(args, agents, torch.Generator().manual_seed(seed), greedy), saved)


if __name__ == "__main__":
    runs.main(__file__, __doc__, Args, paper_defaults, train, load)
