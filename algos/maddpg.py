# docs/algorithms/maddpg.md has remarks on this code; benchmark/RESULTS.md has curves and tables.
# With seed 0, lbf-8x8-2p-2f-c ends at a return of 0.98 (the most is 1) after 2 million steps and 12
# minutes of one core. Trained without the steps that end an episode, as by EPyMARL, it came to 0.50
# at its best (the paper: 0.46).
"""MADDPG: multi-agent deep deterministic policy gradients.

Every agent has a policy (the actor), which chooses an action from the agent's own observation. A
critic, needed in training only, sees the state and the actions of all agents, and learns what they
are worth. The policies follow the critic's gradient towards better actions. So an action needs a
gradient: it is drawn as a one-hot vector with the gradient of the softmax of logits plus noise.
One environment plays one episode. Then actors and critic make one gradient step each, on a batch of
whole episodes from the replay. Q' and mu' are older or slowly moving copies of critic and policies.

    y_i,t     = r_t + gamma Q'_i(s_{t+1}, mu'_1(o_1,t+1), ..., mu'_n(o_n,t+1))  only r_t at the end
    L(critic) = mean over agents and steps of (y_i,t - Q_i(s_t, a_t))^2
    L(actor)  = mean over agents and steps of [ c mean_a logit_i(a)^2 - Q_i(s_t, (a_i, a_-i)) ]

r is the team's reward (with --individual-rewards agent i's own), standardised if
--reward-standardisation, and mu' takes the likeliest action. In L(actor) the present policies draw
all actions, a_i with a gradient and a_-i without; c, --actor-regularisation, keeps them from
becoming certain early. With --network gru, o_i,t stands for all that agent i has observed in the
episode so far.

Algorithm: Lowe et al., "Multi-Agent Actor-Critic for Mixed Cooperative-Competitive Environments"
(2017). Unlike there, a_-i in L(actor) does not come from the replay.
Hyperparameters: Papoudakis et al., "Benchmarking Multi-Agent Deep Reinforcement Learning Algorithms
in Cooperative Tasks" (2021). As there, a time-out counts as an end, and the replay holds a million
steps at most (2,000 episodes in RWARE). How their code, EPyMARL, differs:
docs/algorithms/maddpg.md.

    python algos/maddpg.py --env lbf-8x8-2p-2f-c
    python algos/maddpg.py --watch runs/lbf-8x8-2p-2f-c/maddpg-shared/seed0
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))  # where envs lies, if it is not installed
from envs import VectorEnv, runs  # before PyTorch, which is faster on AMD processors then

from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

# Hyperparameters by family and sharing, as the paper's search chose them; "other" is our choice.
PAPER_BUDGET = "off_policy_timesteps"  # this field of a Task, see envs/tasks.py
TUNED = "hidden_dim learning_rate reward_standardisation network target_update actor_regularisation"
PAPER = {
    # family, sharing           dim  rate    rewards core   target  regularisation
    ("matrix", "shared"):      (128, 0.0003, True,   "fc",  "hard", 0.001),
    ("matrix", "independent"): (128, 0.0005, True,   "fc",  "hard", 0.001),
    ("mpe", "shared"):         (128, 0.0005, True,   "gru", "hard", 0.001),
    ("mpe", "independent"):    (128, 0.0005, True,   "gru", "soft", 0.01),
    ("smac", "shared"):        (128, 0.0005, False,  "gru", "soft", 0.01),
    ("smac", "independent"):   (128, 0.0005, True,   "fc",  "soft", 0.001),
    ("lbf", "shared"):         (64,  0.0003, True,   "fc",  "hard", 0.001),
    ("lbf", "independent"):    (64,  0.0003, True,   "fc",  "hard", 0.001),
    ("rware", "shared"):       (64,  0.0005, False,  "fc",  "soft", 0.001),
    ("rware", "independent"):  (64,  0.0005, False,  "fc",  "soft", 0.001),
    ("other", "shared"):       (128, 0.0005, False,  "fc",  "soft", 0.001),
    ("other", "independent"):  (128, 0.0005, False,  "fc",  "soft", 0.001),
}  # fmt: skip


@dataclass(kw_only=True)
class Args(runs.Flags):
    # task
    env: str = "lbf-8x8-2p-2f-c"  # the task; `python -m envs` lists them
    seed: int = 0  # decides the first weights, the episodes and all that is drawn
    total_timesteps: int  # from the task: length of the training
    time_limit: Literal["bootstrap", "terminal"] = "terminal"  # after a time-out: a value, or 0
    individual_rewards: bool = False  # each agent learns from its own reward, not from the team's
    # network
    parameter_sharing: bool = True  # one network for all agents, or one for each
    network: Literal["fc", "gru"]  # from PAPER: the actors' core; a critic's is always fc
    hidden_dim: int  # from PAPER: width of all layers
    # learning
    learning_rate: float  # from PAPER: of Adam, for actor and critic
    gamma: float = 0.99  # discount
    actor_regularisation: float  # from PAPER: weight of the squared logits
    batch_size: int = 32  # episodes of an update; each new episode brings one update
    buffer_size: int = 5000  # episodes in the replay; at most a million steps, at least a batch
    max_grad_norm: float = 10.0  # norm to which actor's and critic's gradients are clipped; or inf
    target_update: Literal["hard", "soft"]  # from PAPER: a copy every 200 updates, or 1 % each
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


# --- maths ---
def standardised(rewards: Tensor, played: Tensor) -> Tensor:
    """Rewards with mean 0 and standard deviation 1 over the played steps of a batch.

    rewards: [time, env, 1 or agent]; played: [time, env]. Each agent has its own mean and std.
    """
    sample = rewards[played].double()  # [step, 1 or agent]
    std, mean = torch.std_mean(sample, 0, correction=min(len(sample) - 1, 1))
    return (rewards - mean.to(rewards)) / (std + 1e-5).to(rewards)


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


def gumbel_softmax(logits: Tensor, rng: torch.Generator) -> Tensor:
    """One-hot draws with the gradient of the softmax of logits plus noise (Jang et al., 2017)."""
    gumbel = -torch.empty(logits.shape).exponential_(generator=rng).log_().to(logits.device)
    soft = (logits + gumbel).softmax(-1)
    return nn.functional.one_hot(soft.argmax(-1), soft.shape[-1]) - soft.detach() + soft


def with_joint_actions(states: Tensor, joint: Tensor) -> Tensor:
    """What each agent's critic sees: the state, and one-hot actions of all agents.

    states: [time, env, state]. joint: [time, env, i, j, action], agent j's action as critic i sees
    it; an axis i of 1 shows the same to all. Returns [time, env, i, state + agents * actions].
    """
    actions = joint.flatten(3)
    states = states.unsqueeze(2).expand(-1, -1, actions.shape[2], -1)
    return torch.cat([states, actions], dim=-1)


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


class Replay:
    """The last episodes, kept on the disk by envs/runs/, and the batches drawn from them."""

    def __init__(self, args: Args, env: VectorEnv, storage: Batch, run: runs.Run):
        self.args, self.env = args, env  # the environment counts the episodes
        self.size = max(min(args.buffer_size, 1_000_000 // env.episode_limit), args.batch_size)
        fields = {name: x[:, 0].numpy() for name, x in storage._asdict().items()}
        if env.state_is_observations:
            del fields["states"]  # `sample` makes them again
        self.file = run.episode_file(fields, self.size)

    def add(self, batch: Batch) -> None:
        """Adds the one episode of a batch, the last that the environment has played."""
        episode = {name: x[:, 0].cpu().numpy() for name, x in batch._asdict().items()}
        self.file.write(self.env.episode, episode)

    def sample(self, rng: torch.Generator) -> Batch:
        """A batch of different episodes, all equally likely, cut to the longest of them."""
        ages = torch.randperm(min(self.env.episode, self.size), generator=rng)  # 0: the newest
        numbers = self.env.episode - ages[: self.args.batch_size].numpy()  # counted from 1
        fields = {}
        for name, x in self.file.read(numbers).items():  # [env, time, ...] becomes [time, env, ...]
            fields[name] = torch.from_numpy(x).transpose(0, 1).contiguous().to(self.args.device)
        if self.env.state_is_observations:
            fields["states"] = fields["observations"].flatten(2)
        return Batch(**fields)


# --- update ---
def gradient_step(loss: Tensor, optimiser: torch.optim.Optimizer, max_grad_norm: float) -> Tensor:
    """Moves the optimiser's parameters down the loss. Returns their gradient's unclipped norm."""
    parameters = [x for group in optimiser.param_groups for x in group["params"]]
    optimiser.zero_grad()
    loss.backward(inputs=parameters)  # only these: a loss may pass through other networks
    norm = nn.utils.clip_grad_norm_(parameters, max_grad_norm)
    optimiser.step()
    return norm


@torch.no_grad()
def update_target(target: nn.Module, online: nn.Module, method: str, n_updates: int) -> None:
    """Hard: a copy at every 200th update. Soft: 1 % of the way to the online network, each time."""
    if method == "hard" and n_updates % 200 != 0:
        return
    tau = 0.01 if method == "soft" else 1.0
    for slow, fast in zip(target.parameters(), online.parameters()):
        slow.lerp_(fast, tau)  # slow += tau * (fast - slow)


def update(
    args: Args, parts: dict[str, Any], batch: Batch, n_updates: int, rng: torch.Generator
) -> dict[str, Tensor]:
    """Learns from a batch in update number n_updates, from 1 on. Returns figures for the log."""
    played = batch.played
    agents, target_agents = parts["agents"], parts["target_agents"]
    critic, target_critic = parts["critic"], parts["target_critic"]
    n_agents, n_actions = batch.action_masks.shape[2:]
    rewards = standardised(batch.rewards, played) if args.reward_standardisation else batch.rewards
    with torch.no_grad():
        target_logits = target_agents(batch.observations)[0]  # [time + 1, env, agent, action]
        likeliest = torch.where(batch.action_masks, target_logits, -torch.inf).argmax(-1)
        next_actions = nn.functional.one_hot(likeliest[1:], n_actions)  # [time, env, agent, action]
        next_inputs = with_joint_actions(batch.states[1:], next_actions.unsqueeze(2))
        next_values = target_critic(next_inputs)[0].squeeze(-1)  # [time, env, agent]
        next_values = next_values.masked_fill(batch.no_bootstrap.unsqueeze(-1), 0.0)
        targets = rewards + args.gamma * next_values

    actions = nn.functional.one_hot(batch.actions, n_actions)  # [time, env, agent, action]
    critic_inputs = with_joint_actions(batch.states[:-1], actions.unsqueeze(2))
    values = critic(critic_inputs)[0].squeeze(-1)  # [time, env, agent]
    critic_loss = played_mean((targets - values).square(), played)
    critic_norm = gradient_step(critic_loss, parts["critic_optimiser"], args.max_grad_norm)

    logits = agents(batch.observations[:-1])[0]  # [time, env, agent, action]
    log_probs = log_probabilities(logits, batch.action_masks[:-1])
    drawn = gumbel_softmax(log_probs, rng)  # [time, env, agent, action]
    # Critic i passes its gradient to agent i's own action alone.
    own = torch.eye(n_agents, dtype=torch.bool, device=logits.device).unsqueeze(-1)  # [i, j, 1]
    joint = torch.where(own, drawn.unsqueeze(2), drawn.detach().unsqueeze(2))  # [..., i, j, action]
    actor_values = critic(with_joint_actions(batch.states[:-1], joint))[0].squeeze(-1)
    squares = (logits * batch.action_masks[:-1]).square().mean(-1)  # masked logits count as 0
    actor_loss = played_mean(args.actor_regularisation * squares - actor_values, played)
    actor_norm = gradient_step(actor_loss, parts["actor_optimiser"], args.max_grad_norm)

    update_target(target_agents, agents, args.target_update, n_updates)
    update_target(target_critic, critic, args.target_update, n_updates)
    with torch.no_grad():
        entropy = -(log_probs.exp() * log_probs).sum(-1)
        return {
            "loss/critic": critic_loss,
            "loss/actor": actor_loss,
            "policy/entropy": played_mean(entropy, played),
            "value/mean": played_mean(values, played),
            "value/target_mean": played_mean(targets, played),
            "gradient/critic_norm": critic_norm,
            "gradient/actor_norm": actor_norm,
        }


# --- train ---
def train(args: Args) -> None:
    """Trains a team on a task."""
    env = runs.make_for(args, 1, args.seed)
    runs.check_teams(env, args.individual_rewards, args.parameter_sharing)
    torch.manual_seed(args.seed)  # for the first weights
    agents = MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, args.network)
    critic = MultiAgentNetwork(args, env.n_agents, env.state_size + env.n_agents * env.n_actions, 1)
    parts = {  # what a checkpoint keeps
        "agents": agents,
        "target_agents": deepcopy(agents).to(args.device),  # .to joins a GRU's weights, for cuDNN
        "critic": critic,
        "target_critic": deepcopy(critic),
        "actor_optimiser": torch.optim.Adam(agents.parameters(), args.learning_rate, fused=True),
        "critic_optimiser": torch.optim.Adam(critic.parameters(), args.learning_rate, fused=True),
    }
    rng = runs.own_generator()  # continues PyTorch's; the training draws from it, and no game can
    run = runs.Run(__file__, args, paper_defaults, env, parts, Team, rng)
    team = Team(args, agents, rng)
    storage = new_storage(args, env)
    if run.timestep < args.total_timesteps:  # a complete run has no replay any more
        replay = Replay(args, env, storage, run)

    run.evaluate_if_due()  # the first point comes before training
    while run.timestep < args.total_timesteps:
        episode, episode_returns = collect(args, env, team, storage)
        replay.add(episode)
        metrics = {}
        if env.episode >= args.batch_size:  # the replay holds a batch
            run.n_updates += 1
            metrics = update(args, parts, replay.sample(rng), run.n_updates, rng)
        run.count(episode.played, episode_returns, metrics)  # ends if a loss is not finite
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
