"""QMIX: a monotonic mix of the agents' values.

Every agent learns the value Q_i of its own actions. A mixing network turns these into the value of
what the team does together. Its weights are made from the state and are never negative, so the mix
never falls where one agent's value rises: what is best for each agent is together best for the
team, and nobody has to search all joint actions.
One environment plays one episode, in which each agent takes its best action or, with probability
epsilon, any. Then one gradient step is made on a batch of whole episodes from the replay.

    Mix(q; s) = |w2(s)| . elu(|W1(s)| q + b1(s)) + b2(s)
    y_t       = r_t + gamma Mix'(Q'_1(o_1,t+1, a*_1,t+1), ..., Q'_n(o_n,t+1, a*_n,t+1); s_{t+1})
    L         = mean over steps of (y_t - Mix(Q_1(o_1,t, a_1,t), ..., Q_n(o_n,t, a_n,t); s_t))^2

r is the team's reward; where the episode ended, y_t is only r_t. Q' and Mix' are older or slowly
moving copies. Q chooses the next actions a*, its best; Q' values them (double Q-learning).
With --network gru, o_i,t stands for all that agent i has observed in the episode so far.

Algorithm: Rashid et al., "QMIX: Monotonic Value Function Factorisation for Deep Multi-Agent
Reinforcement Learning" (2018).
Double Q-learning: van Hasselt et al., "Deep Reinforcement Learning with Double Q-learning" (2016).
Hyperparameters: Papoudakis et al., "Benchmarking Multi-Agent Deep Reinforcement Learning Algorithms
in Cooperative Tasks" (2021). As there, a time-out counts as an end, and the replay holds a million
steps at most (2,000 episodes in RWARE). Their code, EPyMARL, had no such limit, and it counted
padding, the rows after an episode's end, when it standardised rewards.

    python algos/qmix.py --env lbf-8x8-2p-2f-c
    python algos/qmix.py --watch runs/lbf-8x8-2p-2f-c/qmix-shared/seed0
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
PAPER_BUDGET = "off_policy_timesteps"
PAPER_FLAGS = (
    "hidden_dim learning_rate reward_standardisation network "
    "target_update eval_epsilon epsilon_anneal"
)
PAPER = {
    # family, sharing           dim  rate    rewards  core   target  eps   anneal
    ("matrix", "shared"):      (64,  0.0003, "batch", "fc",  "soft", 0.0,  200_000),
    ("matrix", "independent"): (128, 0.0005, "batch", "fc",  "soft", 0.0,  50_000),
    ("mpe", "shared"):         (64,  0.0005, "batch", "gru", "soft", 0.0,  200_000),
    ("mpe", "independent"):    (128, 0.0003, "batch", "gru", "soft", 0.0,  200_000),
    ("smac", "shared"):        (128, 0.0005, "batch", "gru", "hard", 0.05, 50_000),  # printed 0.005
    ("smac", "independent"):   (64,  0.0005, "batch", "gru", "hard", 0.05, 50_000),
    ("lbf", "shared"):         (64,  0.0003, "batch", "gru", "soft", 0.05, 200_000),
    ("lbf", "independent"):    (64,  0.0001, "batch", "gru", "soft", 0.05, 50_000),
    ("rware", "shared"):       (64,  0.0005, "batch", "fc",  "soft", 0.05, 50_000),
    ("rware", "independent"):  (64,  0.0003, "batch", "fc",  "soft", 0.05, 50_000),
}  # fmt: skip
OTHER = (128, 0.0005, "none", "fc", "soft", 0.05, 200_000)  # for any other family


@dataclass
class Args:
    # task
    env: str = "lbf-8x8-2p-2f-c"  # the task; `python -m envs` lists them
    seed: int = 0  # decides the first weights, the episodes and the sampled actions
    total_timesteps: int = 2_000_000  # length of the training
    time_limit: Literal["bootstrap", "terminal"] = "terminal"  # after a time-out: value or 0
    individual_rewards: ClassVar[bool] = False  # no flag: one value is learned for the team
    # network
    parameter_sharing: bool = True  # one network for all agents, or one for each
    network: Literal["fc", "gru"] = "gru"  # the core of the agents' networks
    hidden_dim: int = 64  # width of the agents' layers; the mixer has its own
    # learning
    learning_rate: float = 0.0003  # of Adam
    gamma: float = 0.99  # discount
    epsilon_start: float = 1.0  # share of random actions at first
    epsilon_end: float = 0.05  # share of random actions at last
    epsilon_anneal: int = 200_000  # steps from the first share to the last
    batch_size: int = 32  # episodes of an update; each new episode brings one update
    buffer_size: int = 5000  # episodes in the replay, but at most a million steps of them
    max_grad_norm: float = 10.0  # gradients are clipped to this norm; or inf
    target_update: Literal["hard", "soft"] = "soft"  # copy every 200 updates, or move by 1 % each
    reward_standardisation: Literal["none", "batch", "running"] = "batch"  # by batch, or all so far
    # evaluation
    eval_points: int = 41  # evaluations at equal distances, the first before training
    eval_epsilon: float = 0.05  # share of random actions in evaluations
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


class Mixer(nn.Module):
    """Mix(q; s) of the docstring above. Small "hypernetworks" of the state make W1, b1, w2 and b2.

    Their sizes are the authors' code's: two layers for W1 and w2, where the paper has one.
    """

    def __init__(self, n_agents: int, state_size: int):
        def two_layers(hidden: int, size: int) -> nn.Module:
            return nn.Sequential(nn.Linear(state_size, hidden), nn.ReLU(), nn.Linear(hidden, size))

        super().__init__()
        self.first_weights = two_layers(64, n_agents * 32)
        self.first_bias = nn.Linear(state_size, 32)
        self.last_weights = two_layers(64, 32)
        self.last_bias = two_layers(32, 1)

    def forward(self, values: Tensor, states: Tensor) -> Tensor:
        """values: [time, env, agent]; states: [time, env, state]. Returns [time, env, 1]."""
        first = self.first_weights(states).abs().unflatten(-1, (-1, 32))  # [time, env, agent, 32]
        mixed = (values.unsqueeze(-1) * first).sum(2) + self.first_bias(states)  # [time, env, 32]
        last = self.last_weights(states).abs()
        return (nn.functional.elu(mixed) * last).sum(-1, keepdim=True) + self.last_bias(states)


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


def annealed_epsilon(args: Args, timestep: int) -> float:
    """The share of random actions: it falls linearly from --epsilon-start to --epsilon-end."""
    shares = [args.epsilon_start, args.epsilon_end]
    return float(np.interp(timestep, [0, max(args.epsilon_anneal, 1)], shares))


def double_q_values(q_values: Tensor, target_q_values: Tensor, action_masks: Tensor) -> Tensor:
    """The target network's values of the online network's best actions: [..., action] -> [...].

    If one network chose and valued, it would choose what it overrates (van Hasselt et al., 2016).
    """
    best = torch.where(action_masks, q_values, -torch.inf).argmax(-1, keepdim=True)
    return target_q_values.gather(-1, best).squeeze(-1)


def played_mean(x: Tensor, played: Tensor) -> Tensor:
    """Mean of x [time, env, agent or 1] over agents and over the played steps [time, env]."""
    return (x * played.unsqueeze(-1)).sum() / (played.sum() * x.shape[-1])


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


class EpsilonGreedyTeam:
    """Agents at play. Each takes its best action or, with probability epsilon, a random one."""

    def __init__(self, args: Args, agents: nn.Module, rng: torch.Generator, greedy: bool = False):
        self.args, self.agents, self.rng = args, agents, rng
        self.epsilon = 0.0 if greedy else args.eval_epsilon  # `train` sets its own
        self.reset()

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forgets the last episode. To be called before each new one. mask, [env]: only there."""
        self.hidden: list | None = None if mask is None else runs.forgotten(self.hidden, mask)

    @torch.inference_mode()
    def act(self, observations: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """observations: [env, agent, obs]. Returns the actions, [env, agent]."""
        inputs = torch.from_numpy(observations)[None].float().to(self.args.device)  # one time step
        masks = torch.from_numpy(info["action_mask"]).bool()  # [env, agent, action]
        q_values, self.hidden = self.agents(inputs, self.hidden)
        explores = torch.rand(masks.shape[:-1], generator=self.rng).unsqueeze(-1) < self.epsilon
        random_scores = torch.rand(masks.shape, generator=self.rng)  # the highest: any action
        scores = torch.where(explores, random_scores, q_values[0].cpu())
        return torch.where(masks, scores, -torch.inf).argmax(-1).numpy()


Team = EpsilonGreedyTeam  # what the common code at the end of this file calls it


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


class Replay:
    """The last episodes, kept on the disk by envs/runs/, and the batches drawn from them."""

    def __init__(self, args: Args, env: VectorEnv, storage: Batch, path: Path):
        self.args, self.env = args, env  # the environment counts the episodes
        self.size = max(min(args.buffer_size, 1_000_000 // env.episode_limit), args.batch_size)
        fields = {name: x[:, 0].numpy() for name, x in storage._asdict().items()}
        if env.state_is_observations:
            del fields["states"]  # `sample` makes them again
        self.file = runs.EpisodeFile(path, fields, self.size, env.episode)

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


def update(args: Args, learner: dict[str, Any], batch: Batch, updates: int) -> dict[str, Tensor]:
    """Learns from a batch in update number `updates`, from 1 on. Returns figures for the log."""
    agents, target_agents = learner["agents"], learner["target_agents"]
    rewards = learner["standardiser"](batch.rewards, batch.played)
    q_values = agents(batch.observations)[0]  # [time + 1, env, agent, action]
    taken = q_values[:-1].gather(-1, batch.actions.unsqueeze(-1)).squeeze(-1)  # [time, env, agent]
    values = learner["mixer"](taken, batch.states[:-1])  # [time, env, 1]
    with torch.no_grad():
        target_q_values = target_agents(batch.observations)[0]  # [time + 1, env, agent, action]
        best = double_q_values(q_values, target_q_values, batch.action_masks)  # as taken, time + 1
        next_values = learner["target_mixer"](best[1:], batch.states[1:])  # [time, env, 1]
        next_values = next_values.masked_fill(batch.no_bootstrap.unsqueeze(-1), 0.0)
        targets = rewards + args.gamma * next_values
    loss = played_mean((targets - values).square(), batch.played)
    norm = gradient_step(loss, learner["optimiser"], args.max_grad_norm)
    update_target(target_agents, agents, args.target_update, updates)
    update_target(learner["target_mixer"], learner["mixer"], args.target_update, updates)
    return {
        "loss/value": loss,
        "value/mean": played_mean(values.detach(), batch.played),
        "value/target_mean": played_mean(targets, batch.played),
        "gradient/norm": norm,
    }


# --- train ---
def train(args: Args) -> None:
    """Trains a team on a task."""
    rng = torch.manual_seed(args.seed)  # PyTorch's global one: draws weights and actions
    env = runs.make_for(args, 1, args.seed)
    runs.check_one_team(env, "QMIX learns one value for the team")
    agents = MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, args.network)
    mixer = Mixer(env.n_agents, env.state_size).to(args.device)
    learning = [*agents.parameters(), *mixer.parameters()]
    learner = {  # what a checkpoint keeps
        "agents": agents,
        "target_agents": deepcopy(agents).to(args.device),  # .to joins a GRU's weights, for cuDNN
        "mixer": mixer,
        "target_mixer": deepcopy(mixer),
        "standardiser": RewardStandardiser(args.reward_standardisation).to(args.device),
        "optimiser": torch.optim.Adam(learning, args.learning_rate, fused=True),
    }
    team = Team(args, agents, rng)
    storage = new_batch(args, env)
    run = Run(args, env, learner, rng)
    if run.timestep < args.total_timesteps:  # a complete run has no replay any more
        replay = Replay(args, env, storage, run.directory.path / "replay.bin")
        learner["replay"] = replay.file

    run.evaluate_if_due()
    while run.timestep < args.total_timesteps:
        team.epsilon = annealed_epsilon(args, run.timestep)
        episode, returns = collect(args, env, team, storage)
        replay.add(episode)
        metrics = {}
        if env.episode >= args.batch_size:  # the replay holds a batch
            run.updates += 1
            metrics = update(args, learner, replay.sample(rng), run.updates)
            metrics["policy/epsilon"] = torch.tensor(team.epsilon)
        run.advance(episode, returns, metrics)
        run.evaluate_if_due()
        if env.episode % replay.file.checkpoint_every == 0 or run.directory.save_is_due:
            run.save()  # before a slot of the replay that the last checkpoint needs is used again
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
