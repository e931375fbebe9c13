"""MADDPG: multi-agent deep deterministic policy gradients.

Every agent has a policy of its own observation (the actor). A critic that sees the state and all agents' actions learns
what these are worth; the policies follow its gradient, through actions drawn as one-hots that pass the gradient of the
softmax (Gumbel-softmax). One environment plays one episode, then both make one gradient step on a batch of whole
episodes from the replay. Q', mu' are old or slowly moving copies; mu' takes the most probable action.

    y_i,t     = r_t + gamma Q'_i(s_t+1, mu'_1(o_1,t+1), ..., mu'_n(o_n,t+1))         r_t alone where the episode ended
    L(critic) = mean over agents and steps of (y_i,t - Q_i(s_t, a_t))^2
    L(actor)  = mean over agents and steps of - Q_i(s_t, (a_i, a_-i)) + actor_regularisation mean(logits^2),
                a_i drawn with a gradient, the others' a_-i drawn from their present policies without

Lowe et al., "Multi-Agent Actor-Critic for Mixed Cooperative-Competitive Environments", 2017. Tables: Papoudakis et al.,
"Benchmarking Multi-Agent Deep Reinforcement Learning Algorithms in Cooperative Tasks", 2021; as there, a time-out is an
end. Its code left out the steps that end an episode, trained on padding and began the target GRU one step late; we do
none of this, and expect better results in foraging than its column shows.

    python algos/maddpg.py --env lbf-8x8-2p-2f-c               train with the paper's hyperparameters
    python algos/maddpg.py --watch runs/lbf-8x8-2p-2f-c/maddpg-shared/seed0
"""

import json
import re
import signal
import sys
import time
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import filelock
import numpy as np
import torch
import tyro
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

import envs

# What the paper's search chose, by family of tasks: with parameter sharing, without; its budget is the off-policy one.
PAPER_BUDGET = "off_policy_timesteps"
PAPER_ARGS = "hidden_dim learning_rate reward_standardisation network target_update actor_regularisation".split()
PAPER = {
    "matrix": ((128, 0.0003, "batch", "fc", "hard", 0.001), (128, 0.0005, "batch", "fc", "hard", 0.001)),
    "mpe": ((128, 0.0005, "batch", "gru", "hard", 0.001), (128, 0.0005, "batch", "gru", "soft", 0.01)),
    "smac": ((128, 0.0005, "none", "gru", "soft", 0.01), (128, 0.0005, "batch", "fc", "soft", 0.001)),
    "lbf": ((64, 0.0003, "batch", "fc", "hard", 0.001), (64, 0.0003, "batch", "fc", "hard", 0.001)),
    "rware": ((64, 0.0005, "none", "fc", "soft", 0.001), (64, 0.0005, "none", "fc", "soft", 0.001)),
}


@dataclass
class Args:
    env: str = "lbf-8x8-2p-2f-c"  # the task; `python -m envs` lists them
    seed: int = 0  # of networks, environments and actions
    total_timesteps: int = 2_000_000  # steps of all environments together
    parameter_sharing: bool = True  # one set of networks for all agents, or one for each
    network: Literal["fc", "gru"] = "fc"  # core of the agents' networks; critics are always fc
    hidden_dim: int = 128  # width of all layers
    learning_rate: float = 0.0005  # of Adam, for actor and critic
    gamma: float = 0.99  # discount
    actor_regularisation: float = 0.001  # weight of the squared logits
    batch_size: int = 32  # episodes of an update; there is one update an episode
    buffer_size: int = 5000  # episodes in the replay, or fewer if they have a million steps
    max_grad_norm: float = 10.0  # gradients are clipped to this norm, actor and critic apart
    target_update: Literal["hard", "soft"] = "soft"  # copy every 200 updates, or move by 1 % after each
    reward_standardisation: Literal["none", "batch", "running"] = "none"  # over the batch, or all rewards so far
    time_limit: Literal["bootstrap", "terminal"] = "terminal"  # value of the state after a time-out, or zero
    individual_rewards: bool = False  # each agent learns from its own reward instead of the team's
    eval_points: int = 41  # evaluations at equal distances, the first before training
    eval_episodes: int = 100  # episodes of an evaluation, or of --watch
    device: Literal["cpu", "cuda"] = "cpu"  # where the networks live
    threads: int = 1  # CPU threads of PyTorch
    run_dir: str = ""  # default: runs/<task>/<algorithm>-<sharing>.../seed<seed>
    resume: bool = False  # go on from the last checkpoint if there is one
    watch: str = ""  # play the team of this run directory and film it instead of training
    track: bool = False  # follow the run in Weights & Biases


# --- networks ---
class Network(nn.Module):
    """Linear - ReLU - core - Linear, the core a GRU or Linear - ReLU; if agents share it, it sees their one-hot ids."""

    def __init__(self, input_size: int, n_ids: int, hidden_dim: int, output_size: int, core: str):
        super().__init__()
        self.sizes = [input_size, n_ids]
        self.first = nn.Linear(input_size + n_ids, hidden_dim)
        self.core = nn.GRU(hidden_dim, hidden_dim) if core == "gru" else nn.Linear(hidden_dim, hidden_dim)
        self.last = nn.Linear(hidden_dim, output_size)

    def forward(self, x: Tensor, hidden: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        """x: [time, env, agent, input] -> [time, env, agent, output]; hidden: [1, env * agent, hidden_dim] or None."""
        weight, id_weight = self.first.weight.split(self.sizes, dim=1)
        x = nn.functional.linear(x, weight, self.first.bias)  # [time, env, agent or 1, hidden_dim]
        if id_weight.numel() > 0:  # times a one-hot id: one column for each agent
            x = x + id_weight.T.contiguous()
        x = torch.relu(x)
        if isinstance(self.core, nn.GRU):
            rows, hidden = self.core(x.flatten(1, 2), hidden)
            return self.last(rows.view_as(x)), hidden
        return self.last(torch.relu(self.core(x))), None


class AgentNetworks(nn.Module):
    """One network for all agents (parameter sharing), or one for each."""

    def __init__(self, args: Args, n_agents: int, input_size: int, output_size: int, core: str = "fc"):
        super().__init__()
        copies, n_ids = (1, n_agents) if args.parameter_sharing else (n_agents, 0)
        sizes = (input_size, n_ids, args.hidden_dim, output_size)
        self.networks = nn.ModuleList(Network(*sizes, core) for _ in range(copies))

    def forward(self, x: Tensor, hidden: list | None = None) -> tuple[Tensor, list]:
        """x: [time, env, agent (1 if all see the same), input] -> [time, env, agent, output]; hidden: one a network."""
        n = len(self.networks)
        views = [x] if n == 1 else x.expand(-1, -1, n, -1).split(1, dim=2)
        outputs, latest = zip(*(net(view, h) for net, view, h in zip(self.networks, views, hidden or [None] * n)))
        return outputs[0] if n == 1 else torch.cat(outputs, dim=2), list(latest)


# --- maths ---
class RewardStandardiser(nn.Module):
    """Rewards to mean 0 and deviation 1, over each batch ("batch") or over all batches so far ("running")."""

    def __init__(self, method: str):
        super().__init__()
        self.method = method
        self.seen = nn.Buffer(torch.zeros(3, dtype=torch.float64))  # count, mean, sum of squared deviations

    def forward(self, rewards: Tensor, played: Tensor) -> Tensor:
        """rewards: [time, env, 1 or agent]; played: [time, env]. Statistics pool played steps, and agents."""
        if self.method == "none":
            return rewards
        sample = rewards[played].double()
        count, mean, squares = sample.numel(), sample.mean(), (sample - sample.mean()).square().sum()
        if self.method == "running":  # join this sample and what was seen before (Chan et al., 1979)
            seen_count, seen_mean, seen_squares = self.seen.clone()
            total, shift = seen_count + count, mean - seen_mean
            squares += seen_squares + shift.square() * seen_count * count / total
            count, mean = total, seen_mean + shift * count / total
            self.seen.copy_(torch.stack([count, mean, squares]))
        return ((rewards - mean) / ((squares / max(count - 1, 1)).sqrt() + 1e-5)).float()


def played_mean(x: Tensor, played: Tensor) -> Tensor:
    """Mean of x [time, env, agent] over agents and over the steps that were played [time, env]."""
    return (x * played.unsqueeze(-1)).sum() / (played.sum() * x.shape[-1])


def sample_actions(logits: Tensor, action_masks: Tensor, rng: torch.Generator) -> Tensor:
    """Draws from softmax(logits) over the available actions (the Gumbel-max trick): [..., action] -> [...]"""
    minus_gumbel = torch.empty(logits.shape).exponential_(generator=rng).log_().to(logits.device)
    return torch.where(action_masks, logits - minus_gumbel, -torch.inf).argmax(-1)


def critic_inputs(states: Tensor, actions: Tensor) -> Tensor:
    """States [time, env, state] beside actions [time, env, critic or 1, agent, action]: one row for each critic."""
    actions = actions.flatten(3)
    return torch.cat([states.unsqueeze(2).expand(-1, -1, actions.shape[2], -1), actions], dim=-1)


# --- experience ---
class SamplingTeam:
    """Agents at play, drawing actions from their policies."""

    def __init__(self, args: Args, agents: AgentNetworks, rng: torch.Generator):
        self.args, self.agents, self.rng = args, agents, rng
        self.reset()

    def reset(self) -> None:
        """To be called before each episode: forgets the last one."""
        self.hidden: list | None = None

    @torch.inference_mode()
    def act(self, observations: np.ndarray, info: dict) -> np.ndarray:
        """observations: [env, agent, obs]; info["action_mask"]: [env, agent, action]. Returns actions, [env, agent]."""
        inputs, masks = torch.from_numpy(observations)[None], torch.from_numpy(info["action_mask"])
        logits, self.hidden = self.agents(inputs.to(self.args.device), self.hidden)
        return sample_actions(logits[0], masks.to(self.args.device), self.rng).cpu().numpy()


Team = SamplingTeam  # the name by which the code that is the same in all scripts knows it


def new_batch(args: Args, env: Any) -> SimpleNamespace:
    """Arrays for one episode of each sub-environment. Three have a row more than steps, for what follows the last."""
    steps, n_envs, n_agents = env.episode_limit, env.num_envs, env.n_agents
    observations = torch.zeros(steps + 1, n_envs, n_agents, env.obs_size)
    return SimpleNamespace(
        observations=observations,  # [time + 1, env, agent, obs]
        states=observations.flatten(2) if env.state_is_observations else torch.zeros(steps + 1, n_envs, env.state_size),
        action_masks=torch.zeros(steps + 1, n_envs, n_agents, env.n_actions, dtype=torch.bool),
        actions=torch.zeros(steps, n_envs, n_agents, dtype=torch.int64),  # [time, env, agent]
        rewards=torch.zeros(steps, n_envs, n_agents if args.individual_rewards else 1),  # the team's, or each agent's
        played=torch.zeros(steps, n_envs, dtype=torch.bool),  # False once the episode has ended
        terminated=torch.zeros(steps, n_envs, dtype=torch.bool),  # True from an end on after which the value is zero
    )


def collect(args: Args, env: Any, team: Team, batch: SimpleNamespace) -> SimpleNamespace:
    """Plays one whole episode in each sub-environment. Returns the batch, cut to the longest of them."""
    arrays = SimpleNamespace(**{name: x.numpy() for name, x in vars(batch).items()})
    arrays.observations[0], info = env.reset()
    team.reset()
    ended, t = np.zeros(env.num_envs, dtype=bool), 0
    while True:
        arrays.states[t], arrays.action_masks[t] = info["state"], info["action_mask"]
        if ended.all():
            cut = {name: x[: t + len(x) - env.episode_limit].to(args.device) for name, x in vars(batch).items()}
            return SimpleNamespace(**cut)
        arrays.actions[t] = team.act(arrays.observations[t], info)
        arrays.played[t] = ~ended
        arrays.observations[t + 1], rewards, real_end, time_out, info = env.step(arrays.actions[t])
        arrays.rewards[t] = info["agent_rewards"] if args.individual_rewards else rewards[:, None]
        ended = real_end | time_out
        arrays.terminated[t] = ended if args.time_limit == "terminal" else real_end
        t += 1


class Replay:
    """The last episodes, in a memory-mapped file; spare slots keep what the last two checkpoints refer to."""

    def __init__(self, args: Args, env: Any, arrays: SimpleNamespace, path: Path):
        kept = {x: y[:, 0].numpy() for x, y in vars(arrays).items() if x != "states" or not env.state_is_observations}
        self.args, self.env, self.names = args, env, list(kept)  # the environment counts the episodes
        self.size = max(min(args.buffer_size, 1_000_000 // env.episode_limit), args.batch_size)
        self.spare = -(-self.size // 4)  # a checkpoint is due after so many episodes
        episode = np.dtype([(x, y.dtype, y.shape) for x, y in kept.items()])
        envs.reserve(path, (self.size + 2 * self.spare) * episode.itemsize, new=env.episode == 0)
        self.slots = np.memmap(path, episode, "r+")  # [slot]

    def state_dict(self) -> dict[str, Any]:
        """Nothing: a checkpoint refers to what it finds on the disk."""
        self.slots.flush()
        return {}

    def add(self, batch: SimpleNamespace) -> None:
        """Adds the one episode of a batch, the last that the environment has played."""
        slot = self.slots[(self.env.episode - 1) % len(self.slots)]
        slot["played"] = False
        for name in self.names:
            slot[name][: len(vars(batch)[name])] = vars(batch)[name][:, 0].cpu()

    def sample(self, rng: torch.Generator) -> SimpleNamespace:
        """A batch of different episodes, all equally likely, cut to the longest of them."""
        lots = torch.randperm(min(self.env.episode, self.size), generator=rng)[: self.args.batch_size].numpy()
        chosen = (self.env.episode - 1 - lots) % len(self.slots)
        unplayed = int((~self.slots["played"][chosen]).sum(1).min())  # steps that none of them has
        arrays = {x: self.slots[x][chosen, : -unplayed or None] for x in self.names}  # [env, time, ...]
        batch = {x: torch.from_numpy(y).transpose(0, 1).to(self.args.device) for x, y in arrays.items()}
        return SimpleNamespace(**{"states": batch["observations"].flatten(2)} | batch)


# --- update ---
def gradient_step(loss: Tensor, optimiser: torch.optim.Optimizer, max_grad_norm: float) -> None:
    """One step of the optimiser down the loss, with the gradient of all its parameters together clipped in norm."""
    optimiser.zero_grad()
    loss.backward(inputs=optimiser.param_groups[0]["params"])
    nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], max_grad_norm)
    optimiser.step()


@torch.no_grad()
def update_target(target: nn.Module, online: nn.Module, method: str, updates: int) -> None:
    """Hard: a copy at every 200th of the updates. Soft: each time 1 % of the way to the online network."""
    if method == "soft" or updates % 200 == 0:
        for old, new in zip(target.parameters(), online.parameters()):
            old.lerp_(new, 0.01 if method == "soft" else 1.0)


def update(args: Args, parts: dict[str, Any], batch: SimpleNamespace, updates: int) -> dict[str, Tensor]:
    """Learns from a batch, in update number `updates` (from 1). Returns its losses."""
    agents, critic, masks = parts["agents"], parts["critic"], batch.action_masks
    rewards = parts["standardiser"](batch.rewards, batch.played)
    with torch.no_grad():
        logits = parts["target_agents"](batch.observations)[0]  # [time + 1, env, agent, action]
        greedy = nn.functional.one_hot(torch.where(masks, logits, -torch.inf).argmax(-1), masks.shape[-1])
        next_values = parts["target_critic"](critic_inputs(batch.states[1:], greedy[1:].unsqueeze(2)))[0].squeeze(-1)
    targets = rewards + args.gamma * next_values.masked_fill(batch.terminated.unsqueeze(-1), 0.0)  # [time, env, agent]

    taken = nn.functional.one_hot(batch.actions, masks.shape[-1])  # [time, env, agent, action]
    values = critic(critic_inputs(batch.states[:-1], taken.unsqueeze(2)))[0].squeeze(-1)  # [time, env, agent]
    critic_loss = played_mean((targets - values).square(), batch.played)
    gradient_step(critic_loss, parts["critic_optimiser"], args.max_grad_norm)

    logits, masks = agents(batch.observations[:-1])[0], masks[:-1]
    drawn = nn.functional.gumbel_softmax(logits.masked_fill(~masks, -1e9), hard=True)  # [time, env, agent, action]
    own = torch.eye(logits.shape[2], dtype=torch.bool, device=logits.device).unsqueeze(-1)  # [agent, other, 1]
    joint = torch.where(own, drawn.unsqueeze(2), drawn.detach().unsqueeze(2))  # [time, env, agent, other, action]
    values = critic(critic_inputs(batch.states[:-1], joint))[0].squeeze(-1)
    squares = (logits.square() * masks).mean(-1)  # [time, env, agent]; masked logits count as zero
    actor_loss = played_mean(args.actor_regularisation * squares - values, batch.played)
    gradient_step(actor_loss, parts["actor_optimiser"], args.max_grad_norm)
    update_target(parts["target_agents"], agents, args.target_update, updates)
    update_target(parts["target_critic"], critic, args.target_update, updates)
    return {"critic": critic_loss, "actor": actor_loss}


# --- evaluation ---
def evaluate(env: Any, team: Team, seed: int) -> dict[str, float]:
    """Plays one episode in each sub-environment, all of them drawn from the seed."""
    observations, info = env.reset(seed=seed)
    team.reset()
    ended, returns, lengths = np.zeros(env.num_envs, bool), np.zeros(env.num_envs), np.zeros(env.num_envs)
    while not ended.all():
        observations, rewards, terminated, truncated, info = env.step(team.act(observations, info))
        returns, lengths = returns + rewards, lengths + ~ended
        ended = terminated | truncated
    results = {"return_mean": returns.mean(), "return_std": returns.std(), "episode_length": lengths.mean()}
    return {name: float(value) for name, value in results.items()}


# --- the run: flags, directory, checkpoints, progress ---
ALGORITHM = Path(__file__).stem
NOT_IN_NAME = {"env", "seed", "parameter_sharing", "eval_points", "eval_episodes"}  # of the directory
MAY_CHANGE = {"total_timesteps", "device", "threads", "run_dir", "resume", "watch", "track"}  # on --resume


def paper_defaults(env: str = Args.env, parameter_sharing: bool = Args.parameter_sharing) -> Args:
    """The paper's budget and hyperparameters for the task's family (Args' own values where it has none)."""
    task = envs.task(env)
    chosen: dict[str, Any] = dict(zip(PAPER_ARGS, PAPER.get(task.family, ((), ()))[not parameter_sharing]))
    chosen |= {"total_timesteps": getattr(task, PAPER_BUDGET), "eval_points": task.eval_points}
    return Args(env=env, parameter_sharing=parameter_sharing, **chosen)


def parse(argv: list[str]) -> Args:
    """Reads the flags twice: first those that decide on the defaults, then, with these, all of them."""
    paper, _ = tyro.cli(paper_defaults, args=[x for x in argv if x not in ("-h", "--help")], return_unknown_args=True)
    args = tyro.cli(Args, args=argv, default=paper, description=__doc__)
    for name, value in vars(args).items():
        if type(value) in (int, float) and not (type(value) is int and name != "seed") <= value < 2**63:  # counts: 1 on
            raise envs.InputError(f"--{name.replace('_', '-')} cannot be {value}.")
    if args.device == "cuda" and not torch.cuda.is_available():
        raise envs.InputError("--device cuda: PyTorch finds no CUDA device here.")
    return args


def read_checkpoint(directory: Path) -> dict[str, Any] | None:
    """The last checkpoint that is whole; None where there is none yet. InputError where all are damaged."""
    for path in filter(Path.exists, (directory / f"checkpoint{which}.pt" for which in ("", ".previous", ".new"))):
        try:  # what is not a checkpoint has no algorithm
            return {"algorithm": None} | torch.load(path, map_location="cpu", weights_only=True)
        except Exception:  # torch.load raises almost anything on a damaged file
            print(f"{path} is damaged and cannot be used.", file=sys.stderr)
    if (directory / "evaluations.csv").exists():  # it is written after a checkpoint
        raise envs.InputError(f"{directory} holds a run, but no checkpoint of it that can be used.")
    return None


def load(run_dir: str | Path, seed: int = 0) -> Team:
    """The trained team of a run, on the CPU. seed: of the actions that it draws."""
    saved = read_checkpoint(Path(run_dir))
    if saved is None or saved["algorithm"] != ALGORITHM:
        raise envs.InputError(f"{run_dir} holds no checkpoint of {ALGORITHM}.")
    args = Args(**saved["flags"] | {"device": "cpu"})
    agents = AgentNetworks(args, *saved["sizes"])
    agents.load_state_dict(saved["parts"]["agents"])
    return Team(args, agents, torch.Generator().manual_seed(seed))


class Run:
    """What a run keeps and shows; parts: everything with a state_dict, by name ("agents": the networks that act)."""

    def __init__(self, args: Args, env: Any, parts: dict[str, Any], rng: torch.Generator):
        self.args, self.env, self.parts, self.rng, self.stop_signal = args, env, parts, rng, 0
        self.timestep, self.updates, self.budget, self.rows = 0, 0, args.total_timesteps, list[dict[str, float]]()
        self.wall_start, self.cpu_start, self.begun = time.time(), time.process_time(), 0
        self.eval_env = envs.make(args.env, args.eval_episodes, copy=False)
        name = f"{ALGORITHM}-{'shared' if args.parameter_sharing else 'independent'}"
        for flag, default in vars(paper_defaults(args.env, args.parameter_sharing)).items():
            if flag not in NOT_IN_NAME | MAY_CHANGE and getattr(args, flag) != default:
                name += f"-{flag.replace('_', '-')}={getattr(args, flag)}"
        safe = (re.sub(r"[^A-Za-z0-9_.=-]", "_", part) for part in (args.env, name, f"seed{args.seed}"))
        self.directory = Path(args.run_dir or Path("runs", *safe))
        self.lock = filelock.FileLock(self.directory / "lock").acquire(timeout=0)
        found = {path.name.split(".")[0] for path in self.directory.iterdir()} - {"lock"}
        if found and not (args.resume and found & {"events", "checkpoint"}):
            raise envs.InputError(f"{self.directory} is not empty: --resume goes on with a run; or choose a --run-dir.")
        if saved := read_checkpoint(self.directory):  # go on where it was made, if that was with the same flags
            then, now = saved["flags"] | {"algorithm": saved["algorithm"]}, vars(args) | {"algorithm": ALGORITHM}
            changed = [x for x in then if x not in MAY_CHANGE and then[x] != now.get(x)]
            if changed or args.total_timesteps < then["total_timesteps"]:
                names = ", ".join(f"--{x.replace('_', '-')} {then[x]}" for x in [*changed, "total_timesteps"])
                raise envs.InputError(f"{self.directory} was begun with {names}: only the timesteps may grow.")
            for name, part in self.parts.items():
                part.load_state_dict(saved["parts"][name])
            self.env.episode, self.rows, self.timestep, self.updates, self.budget, wall, cpu = saved["progress"]
            self.rng.set_state(saved["rng"])
            self.wall_start, self.cpu_start, self.begun = self.wall_start - wall, self.cpu_start - cpu, self.timestep
        if args.track:
            name = re.sub(r"[^A-Za-z0-9_.-]", "-", str(self.directory))
            envs.optional("wandb").init(id=name, config=vars(args), resume="allow", sync_tensorboard=True)
        self.writer = SummaryWriter(str(self.directory), purge_step=self.timestep + 1 if saved else None)
        self.bar = tqdm(total=args.total_timesteps, initial=self.timestep, unit=" steps", unit_scale=True, disable=None)
        self.bar.write(f"This run is kept in {self.directory}", file=sys.stderr)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda number, _: setattr(self, "stop_signal", number))  # heeded after an update

    def save(self) -> None:
        """Writes the checkpoint, whole or not at all, keeps the one before, and writes config.json, evaluations.csv."""
        saved: dict[str, Any] = {"algorithm": ALGORITHM, "flags": vars(self.args), "rng": self.rng.get_state()}
        saved["sizes"] = (self.env.n_agents, self.env.obs_size, self.env.n_actions, self.args.network)
        saved["parts"] = {name: part.state_dict() for name, part in self.parts.items()}
        saved["progress"] = (self.env.episode, self.rows, self.timestep, self.updates, self.budget, self.wall, self.cpu)
        last, previous, new = (self.directory / f"checkpoint{which}.pt" for which in ("", ".previous", ".new"))
        with open(new, "wb") as file:  # given a path, torch.save ends on a full disk with a RuntimeError
            torch.save(saved, file)
        if last.exists():
            last.replace(previous)
        new.replace(last)
        (self.directory / "config.json").write_text(json.dumps({"flags": saved["flags"]} | envs.provenance(), indent=2))
        table = [self.rows[0], *(row.values() for row in self.rows)]
        (self.directory / "evaluations.csv").write_text("".join(",".join(map(str, line)) + "\n" for line in table))

    def goes_on(self) -> bool:
        """Evaluates and saves where that is due. False when the budget is spent; a stop asked for ends the process."""
        self.wall, self.cpu = time.time() - self.wall_start, time.process_time() - self.cpu_start
        reached = min(self.timestep, self.args.total_timesteps) * (self.args.eval_points - 1)
        while (point := len(self.rows)) * self.budget <= reached:
            seed = int(np.random.SeedSequence([self.args.seed, point]).generate_state(1)[0])
            team = Team(self.args, self.parts["agents"], torch.Generator().manual_seed(seed))
            results = evaluate(self.eval_env, team, seed)
            row = {"point": point, "timestep": self.timestep, "wall_seconds": self.wall, "cpu_seconds": self.cpu}
            self.rows.append(row | results)
            self.writer.add_scalar("evaluation/return_mean", results["return_mean"], self.timestep)
            shown = ", ".join(f"{name} {value:.3f}" for name, value in results.items())
            self.bar.write(f"step {self.timestep:,} after {self.wall:,.0f} s: {shown}", file=sys.stderr)
            self.bar.set_postfix_str(shown)
            self.save()
        if self.timestep < self.args.total_timesteps and not self.stop_signal:
            return True
        if self.timestep > self.begun:  # a complete run stays as it is
            self.save()
        self.bar.close()
        self.writer.close()
        if self.stop_signal:
            sys.exit(f"Stopped at step {self.timestep:,}; the same command with --resume goes on.")
        return False

    def advance(self, steps: int, losses: dict[str, Tensor]) -> None:
        """Counts steps, and an update if there was one; logs its losses a thousand times a run."""
        before, self.timestep, self.updates = self.timestep, self.timestep + steps, self.updates + bool(losses)
        for term, loss in losses.items():
            if not torch.isfinite(loss):
                sys.exit(f"The {term} loss is {loss.item()} at step {self.timestep:,}; the last checkpoint is kept.")
            if self.timestep * 1000 // self.budget > before * 1000 // self.budget:
                self.writer.add_scalar(f"loss/{term}", loss, self.timestep)
        self.bar.update(steps)


def train(args: Args) -> None:
    """Trains a team on a task."""
    rng = torch.manual_seed(args.seed)
    env = envs.make(args.env, 1, args.seed, copy=False)
    agents = AgentNetworks(args, env.n_agents, env.obs_size, env.n_actions, args.network).to(args.device)
    seen = env.state_size + env.n_agents * env.n_actions
    critic = AgentNetworks(args, env.n_agents, seen, 1).to(args.device)
    team, arrays = Team(args, agents, rng), new_batch(args, env)
    parts = {
        "agents": agents,
        "target_agents": deepcopy(agents),
        "critic": critic,
        "target_critic": deepcopy(critic),
        "standardiser": RewardStandardiser(args.reward_standardisation).to(args.device),
        "actor_optimiser": torch.optim.Adam(agents.parameters(), args.learning_rate, fused=True),
        "critic_optimiser": torch.optim.Adam(critic.parameters(), args.learning_rate, fused=True),
    }
    run = Run(args, env, parts, rng)
    if run.timestep < args.total_timesteps:  # a complete run has no replay any more
        parts["replay"] = replay = Replay(args, env, arrays, run.directory / "replay.bin")
    while run.goes_on():
        replay.add(episode := collect(args, env, team, arrays))
        losses = update(args, parts, replay.sample(rng), run.updates + 1) if env.episode >= args.batch_size else {}
        run.advance(int(episode.played.sum()), losses)
        if env.episode % replay.spare == 0:
            run.save()
    (run.directory / "replay.bin").unlink(missing_ok=True)


def main() -> None:
    """Trains, or plays what was trained. Wrong input ends with one sentence and exit code 2."""
    try:
        args = parse(sys.argv[1:])
        torch.set_num_threads(args.threads)
        if not args.watch:
            return train(args)
        team = load(args.watch, args.seed)
        env = envs.make(team.args.env, args.eval_episodes)
        print(evaluate(env, team, args.seed), envs.film(env, team, Path(args.watch, "film.gif")), sep="\n")
    except (envs.InputError, OSError) as error:  # OSError: a directory in use or not to be written, a full disk
        print(f"{ALGORITHM}: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
