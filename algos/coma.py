"""COMA: counterfactual multi-agent policy gradients.

Every agent has a policy (the actor), which chooses an action from the agent's own observation. A
critic, needed in training only, sees the state and what the other agents do (a_-i), and values each
action that agent i could take. So an action is compared with the policy's average over all actions,
while the others' actions stay as they are: this is the counterfactual baseline, and it shows each
agent its own part in the team's success. Q' is an older or a slowly moving copy of Q.

    G_i,t     = r_t + gamma r_{t+1} + ... + gamma^{n-1} r_{t+n-1} + gamma^n Q'_i(s_{t+n}, a_{t+n})
    A_i,t     = Q_i(s_t, a_t) - sum_a pi_i(a | o_i,t) Q_i(s_t, (a, a_-i,t))
    L(critic) = mean over steps of sum over agents of (G_i,t - Q_i(s_t, a_t))^2
    L(actor)  = - mean over agents and steps of [ A_i,t log pi_i(a_i,t | o_i,t) + e H(pi_i) ]

r is the team's reward, G the n-step return, A the advantage, H the entropy, e --entropy-coef.
With --network gru, o_i,t in pi_i stands for all that agent i has observed in the episode so far.
The baseline only reduces noise. It does not bias the gradient: it is the same number b whatever
action agent i takes, and the policy's mean of b grad log pi is b grad sum_a pi(a) = b grad 1 = 0.

Algorithm: Foerster et al., "Counterfactual Multi-Agent Policy Gradients" (2018). There the targets
are TD(lambda), the critic also sees o_i and the last actions, and a least probability of each
action (epsilon) stands in the place of the entropy.
Hyperparameters: Papoudakis et al., "Benchmarking Multi-Agent Deep Reinforcement Learning Algorithms
in Cooperative Tasks" (2021). Their code, EPyMARL, differs in two points. It replaced the rewards of
a batch's last step by values; here they stay, and after a time-out the value of the next state is
added. It also counted padding, the rows after an episode's end, when it standardised rewards.
As a third, it gave COMA's actors their ids without parameter sharing.

    python algos/coma.py --env lbf-15x15-3p-5f
    python algos/coma.py --watch runs/lbf-15x15-3p-5f/coma-shared/seed0
"""

import envs  # before PyTorch, which then multiplies matrices faster on AMD processors
from envs import VectorEnv, runs

import sys
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

# What the paper's search chose for each family of tasks, with and without parameter sharing.
PAPER_BUDGET = "on_policy_timesteps"
PAPER_FLAGS = (
    "hidden_dim learning_rate reward_standardisation network entropy_coef target_update n_step"
)
PAPER = {
    # family, sharing           dim  rate    rewards  core   entropy target  n_step
    ("matrix", "shared"):      (64,  0.0005, "batch", "fc",  0.01,   "soft", 5),
    ("matrix", "independent"): (128, 0.0003, "batch", "fc",  0.01,   "soft", 10),
    ("mpe", "shared"):         (64,  0.0003, "batch", "gru", 0.001,  "hard", 10),
    ("mpe", "independent"):    (128, 0.0005, "batch", "gru", 0.01,   "soft", 10),
    ("smac", "shared"):        (128, 0.0005, "batch", "fc",  0.01,   "soft", 5),
    ("smac", "independent"):   (128, 0.0005, "batch", "gru", 0.01,   "soft", 5),
    ("lbf", "shared"):         (128, 0.0001, "batch", "gru", 0.001,  "hard", 10),
    ("lbf", "independent"):    (128, 0.0001, "batch", "gru", 0.001,  "soft", 5),
    ("rware", "shared"):       (64,  0.0005, "batch", "fc",  0.01,   "soft", 5),
    ("rware", "independent"):  (64,  0.0005, "none",  "fc",  0.01,   "soft", 5),
}  # fmt: skip
OTHER = (128, 0.0005, "none", "fc", 0.001, "soft", 5)  # for any other family


@dataclass
class Args:
    # task
    env: str = "lbf-8x8-2p-2f-c"  # the task; `python -m envs` lists them
    seed: int = 0  # decides the first weights, the episodes and the sampled actions
    total_timesteps: int = 20_000_000  # length of the training; steps of all environments count
    num_envs: int = 10  # environments side by side; a batch is one episode of each
    time_limit: Literal["bootstrap", "terminal"] = "bootstrap"  # after a time-out: value or 0
    individual_rewards: ClassVar[bool] = False  # no flag: the critic values what all do
    # network
    parameter_sharing: bool = True  # one network for all agents, or one for each
    network: Literal["fc", "gru"] = "gru"  # the core of the actors; a critic's core is always fc
    hidden_dim: int = 128  # width of all layers
    # learning
    learning_rate: float = 0.0001  # of Adam, for actor and critic
    gamma: float = 0.99  # discount
    n_step: int = 10  # rewards in a return before it continues with a value
    entropy_coef: float = 0.001  # weight of the policies' entropy
    max_grad_norm: float = 10.0  # norm to which actor's and critic's gradients are clipped; or inf
    target_update: Literal["hard", "soft"] = "hard"  # copy every 200 updates, or move by 1 % each
    reward_standardisation: Literal["none", "batch", "running"] = "batch"  # by batch, or all so far
    # evaluation
    eval_points: int = 41  # evaluations at equal distances, the first before training
    eval_episodes: int = 100  # episodes of an evaluation, or of --watch
    # run
    device: Literal["cpu", "cuda"] = "cpu"  # where the networks live
    threads: int = 1  # CPU threads of PyTorch
    run_dir: str = ""  # where the run is kept; empty: runs/<task>/<algorithm>-.../seed<seed>
    resume: bool = False  # go on from the last checkpoint, if there is one
    watch: str = ""  # play and film the team of this run directory instead of training
    track: bool = False  # follow the run in Weights & Biases
    # foreign environments
    env_kwargs: str = ""  # of a pettingzoo:, gymnasium: or own: environment, such as "N=2, k=0.5"
    max_episode_steps: int = 0  # cut episodes of a pettingzoo: or gymnasium: one here (0: do not)
    flatten_images: bool = False  # make vectors of the images of a pettingzoo: or gymnasium: one
    env_workers: int = 0  # processes that play a pettingzoo: or gymnasium: one (0: this one)


# --- networks ---
class Network(nn.Module):
    """Linear - ReLU - core - Linear. The core is a GRU, or Linear - ReLU.

    Agents that share a network also feed it their one-hot ids. These are never built: since
    W [x, onehot(i)] + b = W_x x + W_id[:, i] + b, an id only adds a column of the weights. Where
    the state is large this saves time: 17 % of an update of MAPPO on rware-tiny-4p.
    """

    def __init__(self, input_size: int, n_ids: int, hidden_dim: int, output_size: int, core: str):
        super().__init__()
        self.input_sizes = [input_size, n_ids]
        self.first = nn.Linear(input_size + n_ids, hidden_dim)
        layer = nn.GRU if core == "gru" else nn.Linear
        self.core = layer(hidden_dim, hidden_dim)
        self.last = nn.Linear(hidden_dim, output_size)

    def forward(self, x: Tensor, hidden: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        """x: [time, env, agent (or 1: all see the same), input] -> [time, env, agent, output].

        hidden: the GRU's state, [1, env * agent, hidden_dim]; None at the start of an episode.
        """
        weight, id_weight = self.first.weight.split(self.input_sizes, dim=1)
        x = nn.functional.linear(x, weight, self.first.bias)  # [time, env, agent or 1, hidden_dim]
        if id_weight.numel() > 0:
            x = x + id_weight.T.contiguous()  # [time, env, agent, hidden_dim]; faster than a view
        x = torch.relu(x)
        if isinstance(self.core, nn.GRU):
            outputs, hidden = self.core(x.flatten(1, 2), hidden)  # [time, env * agent, hidden_dim]
            return self.last(outputs.view_as(x)), hidden
        return self.last(torch.relu(self.core(x))), None


class MultiAgentNetwork(nn.Module):
    """One network for all agents (parameter sharing), or one for each. For policies and values."""

    def __init__(self, args: Args, n_agents: int, inputs: int, outputs: int, core: str = "fc"):
        super().__init__()
        copies = 1 if args.parameter_sharing else n_agents
        n_ids = n_agents if args.parameter_sharing else 0
        networks = [Network(inputs, n_ids, args.hidden_dim, outputs, core) for _ in range(copies)]
        self.networks = nn.ModuleList(networks).to(args.device)

    def forward(self, x: Tensor, hidden: list | None = None) -> tuple[Tensor, list]:
        """x -> outputs, as in Network, and the networks' states; hidden: the states before."""
        n = len(self.networks)
        if hidden is None:
            hidden = [None] * n
        if n == 1:
            output, state = self.networks[0](x, hidden[0])
            return output, [state]
        inputs = x.expand(-1, -1, n, -1).split(1, dim=2)  # what each agent sees
        outputs, states = zip(*(self.networks[i](inputs[i], hidden[i]) for i in range(n)))
        return torch.cat(outputs, dim=2), list(states)


# --- maths ---
class RewardStandardiser(nn.Module):
    """Rewards with mean 0 and standard deviation 1: in each batch, or in all so far ("running")."""

    def __init__(self, method: str):
        super().__init__()
        self.method = method
        self.seen = nn.Buffer(torch.zeros(3, dtype=torch.float64))  # count, mean, sum of squares

    def forward(self, rewards: Tensor, played: Tensor) -> Tensor:
        """rewards: [time, env, 1 or agent]; played: [time, env]. Only played steps are counted."""
        if self.method == "none":
            return rewards
        sample = rewards[played].double()
        count = sample.numel()
        mean = sample.mean()
        squares = (sample - mean).square().sum()
        if self.method == "running":  # joins the sample with what was seen (Chan et al., 1979)
            seen_count, seen_mean, seen_squares = self.seen.clone()
            total = seen_count + count
            shift = mean - seen_mean
            squares += seen_squares + shift.square() * seen_count * count / total
            mean = seen_mean + shift * count / total
            count = total
            self.seen.copy_(torch.stack([count, mean, squares]))
        std = (squares / max(count - 1, 1)).sqrt()  # the standard deviation
        return ((rewards - mean) / (std + 1e-5)).float()


def n_step_returns(
    rewards: Tensor, values: Tensor, played: Tensor, no_bootstrap: Tensor, gamma: float, n: int
) -> Tensor:
    """The discounted sum of the next n rewards, plus the discounted value of the state after them.

    Where fewer than n are left, the value is that of the last state; or 0, if the game was over.
    rewards: [time, env, 1 or agent]; values: [time + 1, env, agent]; the last one is after the end;
    played, no_bootstrap: [time, env], as in Batch. Returns [time, env, agent].
    """
    after = values[1:].masked_fill(no_bootstrap.unsqueeze(-1), 0.0)
    values = torch.cat([values[:1], after])
    returns = values  # those of 0 steps; each round of the loop makes them one step longer
    for _ in range(min(n, len(rewards))):
        longer = rewards + gamma * returns[1:]
        # Beyond the end the value stays, so that a return which reaches the end continues with it.
        longer = torch.where(played.unsqueeze(-1), longer, values[:-1])
        returns = torch.cat([longer, values[-1:]])
    return returns[:-1]


def log_probabilities(logits: Tensor, action_masks: Tensor) -> Tensor:
    """log pi(. | o), [..., action]. Not -inf for masked actions, so p log p is 0 and not NaN."""
    logits = torch.where(action_masks, logits, torch.finfo(logits.dtype).min)
    return logits - logits.logsumexp(-1, keepdim=True)


def played_mean(x: Tensor, played: Tensor) -> Tensor:
    """Mean of x [time, env, agent or 1] over agents and over the played steps [time, env]."""
    return (x * played.unsqueeze(-1)).sum() / (played.sum() * x.shape[-1])


def explained_variance(values: Tensor, returns: Tensor, played: Tensor) -> Tensor:
    """The share of the returns' variance that the critic foresees: 1 is all, 0 is nothing.

    Below 0 the returns' mean would foresee more. No finite number if all returns are the same.
    """
    return 1 - (returns - values)[played].var() / returns[played].var()


def counterfactual_inputs(states: Tensor, actions: Tensor, n_actions: int) -> Tensor:
    """What each agent's critic sees: the state, and the one-hot actions of the others.

    states: [time, env, state]; actions: [time, env, agent]. The agent's own action is zeroed.
    Returns [time, env, agent, state + agents * actions].
    """
    n_agents = actions.shape[-1]
    joint = nn.functional.one_hot(actions, n_actions).unsqueeze(2)  # [time, env, 1, other, action]
    others = 1 - torch.eye(n_agents, device=actions.device).unsqueeze(-1)  # [agent, other, 1]
    seen = (joint * others).flatten(3)  # [time, env, agent, agents * actions]
    return torch.cat([states.unsqueeze(2).expand(-1, -1, n_agents, -1), seen], dim=-1)


def sample_actions(logits: Tensor, action_masks: Tensor, rng: torch.Generator) -> Tensor:
    """Draws from softmax(logits) over the available actions: [..., action] -> [...].

    The largest of the logits plus Gumbel noise is such a draw (this is the Gumbel-max trick), and
    the logarithm of an exponential variable is minus such noise.
    """
    minus_gumbel = torch.empty(logits.shape).exponential_(generator=rng).log_().to(logits.device)
    return torch.where(action_masks, logits - minus_gumbel, -torch.inf).argmax(-1)


# --- experience ---
class Batch(NamedTuple):
    """Whole episodes side by side. `time + 1`: there is also a row for the state after the end."""

    observations: Tensor  # [time + 1, env, agent, obs]
    states: Tensor  # [time + 1, env, state]; if the state is the observations: the same memory
    action_masks: Tensor  # [time + 1, env, agent, action], bool: what each agent may do
    actions: Tensor  # [time, env, agent], int
    rewards: Tensor  # [time, env, 1], the team's; or [time, env, agent], each agent's own
    played: Tensor  # [time, env], bool: False after the end; there other fields may hold anything
    no_bootstrap: Tensor  # [time, env], bool: the state after this step is worth 0


class SamplingTeam:
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
        masks = torch.from_numpy(info["action_mask"]).bool().to(self.args.device)  # [..., action]
        logits, self.hidden = self.agents(inputs, self.hidden)
        if self.greedy:
            return torch.where(masks, logits[0], -torch.inf).argmax(-1).cpu().numpy()
        return sample_actions(logits[0], masks, self.rng).cpu().numpy()


Team = SamplingTeam  # what the common code at the end of this file calls it


def new_batch(args: Args, env: VectorEnv) -> Batch:
    """Storage for one episode of each sub-environment."""
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
    """Plays one whole episode in each sub-environment; those that end early wait for the others.

    Returns the batch, cut to the longest episode, and the team's returns, [env]. On the CPU the
    batch is a view of `storage`, so it is valid until the next one is collected.
    """
    rows: Any = Batch._make(x.numpy() for x in storage)  # the same memory, as NumPy arrays
    rows.observations[0], info = env.reset()
    team.reset()
    ended = np.zeros(env.num_envs, dtype=bool)
    returns = np.zeros(env.num_envs)
    t = 0
    while True:
        rows.states[t] = info["state"]
        rows.action_masks[t] = info["action_mask"]
        if ended.all():  # what was written last is the state after the end
            break
        rows.actions[t] = team.act(rows.observations[t], info)
        rows.played[t] = ~ended
        rows.observations[t + 1], rewards, terminated, truncated, info = env.step(rows.actions[t])
        rows.rewards[t] = info["agent_rewards"] if args.individual_rewards else rewards[:, None]
        returns += rewards
        ended = terminated | truncated
        rows.no_bootstrap[t] = ended if args.time_limit == "terminal" else terminated
        t += 1
    unused = env.episode_limit - t  # rows, as many in fields of `time` as of `time + 1`
    return Batch(*(x[: len(x) - unused].to(args.device) for x in storage)), returns


# --- update ---
def gradient_step(loss: Tensor, optimiser: torch.optim.Optimizer, max_grad_norm: float) -> Tensor:
    """Moves the optimiser's parameters down the loss. Returns their gradient's unclipped norm."""
    parameters = [x for group in optimiser.param_groups for x in group["params"]]
    optimiser.zero_grad()
    loss.backward(inputs=parameters)  # only these: MADDPG's actors learn through its critic
    norm = nn.utils.clip_grad_norm_(parameters, max_grad_norm)
    optimiser.step()
    return norm


@torch.no_grad()
def update_target(target: nn.Module, online: nn.Module, method: str, updates: int) -> None:
    """Hard: a copy at every 200th update. Soft: 1 % of the way to the online network, each time."""
    if method == "hard" and updates % 200 != 0:
        return
    share = 0.01 if method == "soft" else 1.0
    for old, new in zip(target.parameters(), online.parameters()):
        old.lerp_(new, share)


def update(
    args: Args, learner: dict[str, Any], batch: Batch, updates: int, rng: torch.Generator
) -> dict[str, Tensor]:
    """Learns from a batch in update number `updates`, from 1 on. Returns figures for the log."""
    agents, critic, target_critic = learner["agents"], learner["critic"], learner["target_critic"]
    logits = agents(batch.observations)[0]  # [time + 1, env, agent, action]
    # Q' of the state after a time-out needs actions there. Where an environment waits for others,
    # its agents have gone on acting in `collect`; for the batch's last state they act here.
    last = sample_actions(logits[-1:].detach(), batch.action_masks[-1:], rng)
    actions = torch.cat([batch.actions, last])  # [time + 1, env, agent]
    critic_inputs = counterfactual_inputs(batch.states, actions, logits.shape[-1])
    rewards = learner["standardiser"](batch.rewards, batch.played)
    with torch.no_grad():
        target_q_values = target_critic(critic_inputs)[0]  # [time + 1, env, agent, action]
        target_values = target_q_values.gather(-1, actions.unsqueeze(-1)).squeeze(-1)
    returns = n_step_returns(
        rewards, target_values, batch.played, batch.no_bootstrap, args.gamma, args.n_step
    )

    q_values = critic(critic_inputs[:-1])[0]  # [time, env, agent, action]
    values = q_values.gather(-1, batch.actions.unsqueeze(-1)).squeeze(-1)  # [time, env, agent]
    errors = (returns - values).square()
    # Summed over agents, as in EPyMARL. Adam hardly notices the factor; clipping begins earlier.
    critic_loss = played_mean(errors, batch.played) * errors.shape[-1]
    critic_norm = gradient_step(critic_loss, learner["critic_optimiser"], args.max_grad_norm)

    log_probs = log_probabilities(logits[:-1], batch.action_masks[:-1])
    probs = log_probs.exp()  # [time, env, agent, action]
    baseline = (probs * q_values).sum(-1)  # the policy's mean value: [time, env, agent]
    advantages = (values - baseline).detach()
    log_pi = log_probs.gather(-1, batch.actions.unsqueeze(-1)).squeeze(-1)  # [time, env, agent]
    entropy = -(probs * log_probs).sum(-1)
    actor_loss = -played_mean(advantages * log_pi + args.entropy_coef * entropy, batch.played)
    actor_norm = gradient_step(actor_loss, learner["actor_optimiser"], args.max_grad_norm)

    update_target(target_critic, critic, args.target_update, updates)
    with torch.no_grad():
        return {
            "loss/critic": critic_loss,
            "loss/actor": actor_loss,
            "policy/entropy": played_mean(entropy, batch.played),
            "value/explained_variance": explained_variance(values, returns, batch.played),
            "gradient/critic_norm": critic_norm,
            "gradient/actor_norm": actor_norm,
        }


# --- train ---
def train(args: Args) -> None:
    """Trains a team on a task."""
    rng = torch.manual_seed(args.seed)  # PyTorch's global one: draws weights and actions
    env = runs.make_for(args, args.num_envs, args.seed)
    runs.check_one_team(env, "COMA's critic values joint actions by the team's reward")
    agents = MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, args.network)
    critic_size = env.state_size + env.n_agents * env.n_actions
    critic = MultiAgentNetwork(args, env.n_agents, critic_size, env.n_actions)
    learner = {  # what a checkpoint keeps
        "agents": agents,
        "critic": critic,
        "target_critic": deepcopy(critic),
        "standardiser": RewardStandardiser(args.reward_standardisation).to(args.device),
        "actor_optimiser": torch.optim.Adam(agents.parameters(), args.learning_rate, fused=True),
        "critic_optimiser": torch.optim.Adam(critic.parameters(), args.learning_rate, fused=True),
    }
    team = Team(args, agents, rng)
    storage = new_batch(args, env)
    run = Run(args, env, learner, rng)

    run.evaluate_if_due()
    while run.timestep < args.total_timesteps:
        batch, returns = collect(args, env, team, storage)
        run.updates += 1
        metrics = update(args, learner, batch, run.updates, rng)
        run.advance(batch, returns, metrics)
        run.evaluate_if_due()
        if run.directory.save_is_due:
            run.save()
    run.complete()


# --- from here on the text is the same in all nine scripts; files are made in envs/runs/ ---
def evaluate(env: VectorEnv, team: Team, seed: int) -> dict[str, float]:
    """Plays one episode in each sub-environment, all drawn from the seed. Returns their means."""
    observations, info = env.reset(seed=seed)
    team.reset()
    totals = envs.EpisodeTotals(env)
    while not totals.ended.all():
        actions = team.act(observations, info)
        observations, rewards, terminated, truncated, info = env.step(actions)
        totals.add(rewards, terminated, truncated, info)
    return totals.means()


class Run:
    """One run: its evaluations, checkpoints and log. learner: what has a state_dict, by name."""

    def __init__(self, args: Args, env: VectorEnv, learner: dict[str, Any], rng: torch.Generator):
        self.args, self.env, self.learner, self.rng = args, env, learner, rng
        self.timestep = self.updates = 0  # a timestep is a step of one environment
        self.budget = args.total_timesteps  # at the first start; spaces the evaluations for good
        self.rows: list[dict[str, float]] = []  # of evaluations.csv
        self.eval_env = runs.make_for(args, args.eval_episodes)
        paper = paper_defaults(args.env, args.parameter_sharing)
        self.directory = runs.RunDirectory(__file__, args, paper)
        saved = self.directory.checkpoint()
        if saved is not None:
            with runs.fitting_checkpoint(self.directory.path):
                self.restore(saved)
        self.log = runs.Log(self.directory.path, args, self.timestep, resumed=saved is not None)
        self.signals = runs.StopSignals()

    def restore(self, saved: dict[str, Any]) -> None:
        """Goes on where a checkpoint was made."""
        for name, part in self.learner.items():
            part.load_state_dict(saved["parts"][name])
        self.rng.set_state(saved["rng"])
        self.env.episode = saved["episode"]
        self.timestep, self.updates = saved["timestep"], saved["updates"]
        self.budget, self.rows = saved["budget"], saved["rows"]

    def save(self) -> None:
        """Writes a checkpoint, and with it config.json and evaluations.csv."""
        self.directory.save(
            rows=self.rows,
            network=(self.env.n_agents, self.env.obs_size, self.env.n_actions, self.args.network),
            parts={name: part.state_dict() for name, part in self.learner.items()},
            rng=self.rng.get_state(),
            episode=self.env.episode,  # all that the environments' randomness depends on
            timestep=self.timestep,
            updates=self.updates,
            budget=self.budget,
        )

    def evaluate_if_due(self) -> None:
        """Evaluates and saves when the steps have reached or passed the next evaluation point."""
        steps = min(self.timestep, self.args.total_timesteps)  # no point lies beyond the total
        # Point p is due at p * budget / (eval_points - 1) steps; in integers nothing is rounded.
        while len(self.rows) * self.budget <= steps * (self.args.eval_points - 1):
            point = len(self.rows)  # has a seed of its own: evaluations change nothing in training
            seed = int(np.random.SeedSequence([self.args.seed, point]).generate_state(1)[0])
            team = Team(self.args, self.learner["agents"], torch.Generator().manual_seed(seed))
            results = evaluate(self.eval_env, team, seed)
            seconds = self.directory.seconds()
            self.rows.append({"point": point, "timestep": self.timestep, **seconds, **results})
            self.log.evaluation(self.timestep, results)
            self.save()

    def advance(self, batch: Batch, returns: np.ndarray, metrics: dict[str, Tensor]) -> None:
        """Counts and logs a batch. returns: of its episodes; metrics: what `update` returned."""
        lengths = batch.played.sum(0).tolist()  # of each episode
        self.timestep += sum(lengths)
        self.log.batch(self.timestep, returns.tolist(), lengths, metrics)
        if self.signals.received:  # Ctrl-C, for example
            self.save()
            self.log.close()
            self.signals.exit(self.timestep)

    def complete(self) -> None:
        """Saves the end of the training, and deletes what only a running run needs."""
        if self.rows[-1]["timestep"] < self.timestep:
            self.save()
        self.directory.complete()
        self.log.close()


def paper_defaults(env: str = Args.env, parameter_sharing: bool = True) -> Args:
    """The paper's budget and hyperparameters for a task; OTHER for a family that it lacks."""
    task = envs.task(env)
    table = task.family, "shared" if parameter_sharing else "independent"
    chosen: dict[str, Any] = dict(zip(PAPER_FLAGS.split(), PAPER.get(table, OTHER)))
    chosen["total_timesteps"] = getattr(task, PAPER_BUDGET)
    chosen["eval_points"] = task.eval_points
    return Args(env=env, parameter_sharing=parameter_sharing, **chosen)


def load(run_dir: str | Path, seed: int = 0, greedy: bool = False) -> Team:
    """The trained team of a run, on the CPU; it acts as in evaluations, or always greedily."""
    saved = runs.read_checkpoint(run_dir, Path(__file__).stem)
    with runs.fitting_checkpoint(run_dir):
        args = Args(**saved["config"]["flags"] | {"device": "cpu"})
        agents = MultiAgentNetwork(args, *saved["network"])
        agents.load_state_dict(saved["parts"]["agents"])
    return Team(args, agents, torch.Generator().manual_seed(seed), greedy)


def watch(args: Args) -> None:
    """Plays what was trained and prints the results, then films the first of the same episodes."""
    team = load(args.watch, args.seed)
    env = runs.make_for(team.args, args.eval_episodes, pictures=True)
    print(runs.in_words(evaluate(env, team, args.seed)), flush=True)
    print(envs.film(env, load(args.watch, args.seed), args.seed, Path(args.watch, "film.gif")))


def main() -> None:
    """Trains or plays. Wrong input ends with one sentence and exit code 2."""
    with runs.one_sentence(__file__):
        args = runs.parse_flags(Args, paper_defaults, sys.argv[1:], __doc__)
        runs.keep_freed_memory()
        torch.set_num_threads(args.threads)
        watch(args) if args.watch else train(args)


if __name__ == "__main__":
    main()
