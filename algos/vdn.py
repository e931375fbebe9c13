# docs/algorithms/vdn.md has remarks on this code; benchmark/RESULTS.md has curves and tables.
# With seed 0, lbf-8x8-2p-2f-c ends at a return of 1.00 (the most is 1) after 2 million steps and 29
# minutes of one core.
"""VDN: value decomposition networks.

Every agent learns the value Q_i of its own actions, so that the sum of these values is the value of
what the team does together. The idea: the sum never falls where one agent's value rises. So the
actions that are best for each agent are together the best for the team, and nobody has to search
all joint actions.
One environment plays one episode, in which each agent takes its best action or, with probability
epsilon, any. Then one gradient step is made on a batch of whole episodes from the replay. Q' is an
older or a slowly moving copy of Q, so that the target does not follow every step of Q.

    a*_i,t+1 = argmax_a Q_i(o_i,t+1, a)
    y_t      = r_t + gamma sum_i Q'_i(o_i,t+1, a*_i,t+1)         only r_t where the episode ended
    L        = mean over steps of (y_t - sum_i Q_i(o_i,t, a_i,t))^2

r is the team's reward, standardised if --reward-standardisation. Q chooses the next actions and Q'
values them (double Q-learning).
With --network gru, o_i,t stands for all that agent i has observed in the episode so far.

Algorithm: Sunehag et al., "Value-Decomposition Networks For Cooperative Multi-Agent Learning"
(2017).
Double Q-learning: van Hasselt et al., "Deep Reinforcement Learning with Double Q-learning" (2016).
Hyperparameters: Papoudakis et al., "Benchmarking Multi-Agent Deep Reinforcement Learning Algorithms
in Cooperative Tasks" (2021). As there, a time-out counts as an end, and the replay holds a million
steps at most (2,000 episodes in RWARE). How their code, EPyMARL, differs: docs/algorithms/vdn.md.

    python algos/vdn.py --env lbf-8x8-2p-2f-c
    python algos/vdn.py --watch runs/lbf-8x8-2p-2f-c/vdn-shared/seed0
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
TUNED = (
    "hidden_dim learning_rate reward_standardisation network "
    "target_update eval_epsilon epsilon_anneal"
)
PAPER = {
    # family, sharing           dim  rate    rewards core   target  eps   anneal
    ("matrix", "shared"):      (64,  0.0001, True,   "fc",  "soft", 0.0,  200_000),
    ("matrix", "independent"): (128, 0.0005, True,   "fc",  "soft", 0.0,  50_000),
    ("mpe", "shared"):         (128, 0.0005, True,   "fc",  "hard", 0.0,  50_000),
    ("mpe", "independent"):    (128, 0.0005, True,   "fc",  "hard", 0.0,  50_000),
    ("smac", "shared"):        (128, 0.0005, True,   "gru", "hard", 0.05, 50_000),
    ("smac", "independent"):   (64,  0.0005, True,   "gru", "hard", 0.05, 50_000),
    ("lbf", "shared"):         (128, 0.0003, True,   "gru", "soft", 0.0,  200_000),
    ("lbf", "independent"):    (64,  0.0001, True,   "gru", "hard", 0.05, 50_000),
    ("rware", "shared"):       (64,  0.0005, True,   "fc",  "soft", 0.05, 50_000),
    ("rware", "independent"):  (64,  0.0005, True,   "fc",  "soft", 0.05, 50_000),
    ("other", "shared"):       (128, 0.0005, False,  "fc",  "soft", 0.05, 200_000),
    ("other", "independent"):  (128, 0.0005, False,  "fc",  "soft", 0.05, 200_000),
}  # fmt: skip


@dataclass(kw_only=True)
class Args(runs.Flags):
    # task
    env: str = "lbf-8x8-2p-2f-c"  # the task; `python -m envs` lists them
    seed: int = 0  # decides the first weights, the episodes and all that is drawn
    total_timesteps: int  # from the task: length of the training
    time_limit: Literal["bootstrap", "terminal"] = "terminal"  # after a time-out: a value, or 0
    # network
    parameter_sharing: bool = True  # one network for all agents, or one for each
    network: Literal["fc", "gru"]  # from PAPER: the core of the agents' networks
    hidden_dim: int  # from PAPER: width of all layers
    # learning
    learning_rate: float  # from PAPER: of Adam
    gamma: float = 0.99  # discount
    epsilon_start: float = 1.0  # share of random actions at first
    epsilon_end: float = 0.05  # share of random actions at last
    epsilon_anneal: int  # from PAPER: steps from the first share to the last
    batch_size: int = 32  # episodes of an update; each new episode brings one update
    buffer_size: int = 5000  # episodes in the replay; at most a million steps, at least a batch
    max_grad_norm: float = 10.0  # gradients are clipped to this norm; or inf
    target_update: Literal["hard", "soft"]  # from PAPER: a copy every 200 updates, or 1 % each
    reward_standardisation: bool  # from PAPER: to mean 0 and deviation 1 in each batch
    eval_epsilon: float  # from PAPER: share of random actions in evaluations


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


def annealed_epsilon(args: Args, timestep: int) -> float:
    """The share of random actions: it falls linearly from --epsilon-start to --epsilon-end."""
    shares = [args.epsilon_start, args.epsilon_end]
    return float(np.interp(timestep, [0, args.epsilon_anneal], shares))


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
    states: Tensor  # [time + 1, env, state]; may be a view of the observations
    action_masks: Tensor  # [time + 1, env, agent, action], bool: what each agent may do
    actions: Tensor  # [time, env, agent], int
    rewards: Tensor  # [time, env, 1], the team's
    played: Tensor  # [time, env], bool: False after the end, where only the first row matters
    no_bootstrap: Tensor  # [time, env], bool: the state after this step is worth 0


class Team:
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
        random_scores = torch.rand(masks.shape, generator=self.rng)
        # The highest of random scores is at each action equally often.
        scores = torch.where(explores, random_scores, q_values[0].cpu())
        return torch.where(masks, scores, -torch.inf).argmax(-1).numpy()


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
        rewards=torch.zeros(steps, n_envs, 1),
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
        arrays.rewards[t] = rewards[:, None]
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


def update(args: Args, parts: dict[str, Any], batch: Batch, n_updates: int) -> dict[str, Tensor]:
    """Learns from a batch in update number n_updates, from 1 on. Returns figures for the log."""
    played = batch.played
    agents, target_agents = parts["agents"], parts["target_agents"]
    rewards = standardised(batch.rewards, played) if args.reward_standardisation else batch.rewards
    q_values = agents(batch.observations)[0]  # [time + 1, env, agent, action]
    taken = q_values[:-1].gather(-1, batch.actions.unsqueeze(-1)).squeeze(-1)  # [time, env, agent]
    values = taken.sum(-1, keepdim=True)  # [time, env, 1]
    with torch.no_grad():
        target_q_values = target_agents(batch.observations)[0]  # [time + 1, env, agent, action]
        next_taken = double_q_values(q_values, target_q_values, batch.action_masks)[1:]
        next_values = next_taken.sum(-1, keepdim=True)  # [time, env, 1]
        next_values = next_values.masked_fill(batch.no_bootstrap.unsqueeze(-1), 0.0)
        targets = rewards + args.gamma * next_values
    loss = played_mean((targets - values).square(), played)
    norm = gradient_step(loss, parts["optimiser"], args.max_grad_norm)
    update_target(target_agents, agents, args.target_update, n_updates)
    return {
        "loss/value": loss,
        "value/mean": played_mean(values.detach(), played),
        "value/target_mean": played_mean(targets, played),
        "gradient/norm": norm,
    }


# --- train ---
def train(args: Args) -> None:
    """Trains a team on a task."""
    env = runs.make_for(args, 1, args.seed)
    runs.check_one_team(env, "VDN learns one value for the team")
    torch.manual_seed(args.seed)  # for the first weights
    agents = MultiAgentNetwork(args, env.n_agents, env.obs_size, env.n_actions, args.network)
    parts = {  # what a checkpoint keeps
        "agents": agents,
        "target_agents": deepcopy(agents).to(args.device),  # .to joins a GRU's weights, for cuDNN
        "optimiser": torch.optim.Adam(agents.parameters(), args.learning_rate, fused=True),
    }
    rng = runs.own_generator()  # continues PyTorch's; the training draws from it, and no game can
    run = runs.Run(__file__, args, paper_defaults, env, parts, Team, rng)
    team = Team(args, agents, rng)
    storage = new_storage(args, env)
    if run.timestep < args.total_timesteps:  # a complete run has no replay any more
        replay = Replay(args, env, storage, run)

    run.evaluate_if_due()  # the first point comes before training
    while run.timestep < args.total_timesteps:
        team.epsilon = annealed_epsilon(args, run.timestep)
        episode, episode_returns = collect(args, env, team, storage)
        replay.add(episode)
        metrics = {}
        if env.episode >= args.batch_size:  # the replay holds a batch
            run.n_updates += 1
            metrics = update(args, parts, replay.sample(rng), run.n_updates)
            metrics["policy/epsilon"] = torch.tensor(team.epsilon)
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
