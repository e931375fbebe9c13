"""Training steps per second, on one thread, beside the reference passes measured in the same run.

    taskset -c 0 python benchmark/time_training.py [--algorithms mappo ...] [--env <task>] [--seconds 20] [-- <flags>]

The loop is the script's own `train`, without evaluations and files. Reference passes: what plain PyTorch needs for the
networks alone - forward and backward of each trained network on random inputs of a batch's size, as often as the
algorithm passes over a batch, and the target networks' forward; no optimiser, no loss but a mean square. Loop and
passes take turns, so that a noisy machine treats them alike. The parts of the loop are timed in it.

On AMD processors there is a line with MKL's fast kernels (envs/runs/fast_mkl.py) and one without them, again in turns.
"""

import argparse
import contextlib
import io
import math
import multiprocessing
import os
import signal
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

from envs import runs  # isort: skip (before PyTorch, as in the scripts)
import torch
from torch import nn

from campaign.scripts import load_script, script_names
from envs.runs import fast_mkl, one_sentence

TURNS = 3
Timer = Callable[[], float]


class Plain(nn.Module):
    """The networks of one algorithm in their plainest form: Linear - ReLU - (GRU or Linear - ReLU) - Linear."""

    def __init__(self, inputs: int, hidden: int, outputs: int, core: str):
        super().__init__()
        self.first, self.last = nn.Linear(inputs, hidden), nn.Linear(hidden, outputs)
        self.core = nn.GRU(hidden, hidden) if core == "gru" else nn.Linear(hidden, hidden)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """[time, row, input] -> [time, row, output]"""
        x = torch.relu(self.first(x))
        x = self.core(x)[0] if isinstance(self.core, nn.GRU) else torch.relu(self.core(x))
        return self.last(x)


def reference_passes(module: Any, args: Any, env: Any) -> Callable[[], None]:
    """One batch of whole episodes, all as long as the time limit: ten on-policy, 32 of a replay off-policy."""
    name, copies = module.__name__, 1 if args.parameter_sharing else env.n_agents
    ids = env.n_agents if args.parameter_sharing else 0
    replays = hasattr(args, "batch_size")
    steps = env.episode_limit + replays  # a replayed episode is valued in its last state too
    rows = (args.batch_size if replays else env.num_envs) * env.n_agents // copies
    view = env.state_size if name in ("coma", "maa2c", "mappo", "maddpg") else env.obs_size
    view += env.n_agents * env.n_actions if name in ("coma", "maddpg") else 0
    values = env.n_actions if name == "coma" else 1
    epochs = getattr(args, "update_epochs", 1)
    actor_x, critic_x = torch.randn(steps, rows, env.obs_size + ids), torch.randn(steps, rows, view + ids)
    actors = [
        (Plain(env.obs_size + ids, args.hidden_dim, env.n_actions, args.network), (actor_x,)) for _ in range(copies)
    ]
    critics = [(Plain(view + ids, args.hidden_dim, values, "fc"), (critic_x,)) for _ in range(copies)]
    mixers: list[Any] = []
    if name == "qmix":
        sizes = (steps, args.batch_size)
        inputs = torch.randn(*sizes, env.n_agents), torch.randn(*sizes, env.state_size)
        mixers = [(module.Mixer(env.n_agents, env.state_size), inputs)]
    trained, targets = [*actors, *critics], critics
    if name == "maddpg":  # the critic's second pass leads the actors
        trained, targets = [*actors, *critics, *critics], [*actors, *critics]
    elif replays:
        trained = targets = [*actors, *mixers]

    def passes() -> None:
        with torch.no_grad():
            for target, x in targets:
                target(*x)
        for _ in range(epochs):
            for network, x in trained:
                network.zero_grad()
                network(*x).square().mean().backward()

    return passes


class TimedRun:
    """Stands for a script's Run: stops after some seconds, and lets the reference passes run between the batches."""

    def __init__(self, module: Any, seconds: float, path: Path, timer: Timer):
        self.module, self.seconds, self.timer = module, seconds, timer
        self.path = path
        self.rates: list[float] = []
        self.reference_rates: list[float] = []
        self.n_updates = 0

    def __call__(self, script: Any, args: Any, paper_defaults: Any, env: Any, *others: Any) -> "TimedRun":
        self.env, self.passes = env, reference_passes(self.module, args, env)
        self.end = self.timer() + self.seconds
        return self

    @property
    def timestep(self) -> float:
        """Beyond every budget when the time is up."""
        return float("inf") if self.timer() > self.end and self.rates else 0

    def evaluate_if_due(self) -> None:
        """Nothing is evaluated; the next batch begins here."""
        self.started = self.timer()

    def count(self, played: Any, returns: Any, metrics: Any) -> None:
        """The batch has been learnt from; the reference passes have their turn."""
        steps = int(played.sum())
        between = self.timer()
        self.passes()
        passed = self.timer()
        if self.n_updates > 5:  # the first batches warm up
            self.rates.append(steps / (between - self.started))
            self.reference_rates.append(self.env.num_envs * self.env.episode_limit / (passed - between))

    def episode_file(self, fields: Any, size: int) -> runs.EpisodeFile:
        """A replay's file, which a benchmark does not keep."""
        return runs.EpisodeFile(self.path / "replay.bin", fields, size, 0)

    def save_if_due(self) -> None:
        """A benchmark keeps nothing."""

    stop_if_asked = complete = save_if_due


def timed(function: Callable, seconds: dict[str, list[float]], name: str, timer: Timer) -> Callable:
    """The function, noting how long each call takes."""

    def wrapper(*args: Any, **kwargs: Any) -> Any:
        start = timer()
        result = function(*args, **kwargs)
        seconds[name].append(timer() - start)
        return result

    return wrapper


@dataclass(frozen=True)
class Measurement:
    """Medians over batches. rate, reference: steps per second; the others: shares of the loop's time."""

    setting: str
    rate: float
    reference: float
    update: float
    acting: float
    stepping: float


def measure(name: str, flags: list[str], seconds: float, timer: Timer = time.perf_counter) -> Measurement:
    """Trains for some seconds. timer: `time.process_time` counts this process alone, whatever else the machine does."""
    module: Any = load_script(name)
    args = runs.parse_flags(module.Args, module.paper_defaults, flags, module.__doc__)
    if hasattr(args, "buffer_size"):  # the whole replay may be larger than the disk that has temporary files
        args.buffer_size = min(args.buffer_size, 20 * args.batch_size)
    runs.keep_freed_memory()
    torch.set_num_threads(1)
    parts: dict[str, list[float]] = defaultdict(list)
    module.collect = timed(module.collect, parts, "acting", timer)
    module.update = timed(module.update, parts, "update", timer)
    make, run = runs.make_for, runs.Run

    def make_timed(*args: Any, **kwargs: Any) -> Any:
        env: Any = make(*args, **kwargs)
        env.step = timed(env.step, parts, "step", timer)
        return env

    with tempfile.TemporaryDirectory() as directory:
        timed_run: Any = TimedRun(module, seconds, Path(directory), timer)
        module.runs.make_for, module.runs.Run = make_timed, timed_run
        with contextlib.redirect_stderr(io.StringIO()):  # what a replay takes, which is cut here
            module.train(args)
    module.runs.make_for, module.runs.Run = make, run
    rate, reference = statistics.median(timed_run.rates), statistics.median(timed_run.reference_rates)
    acting, update = statistics.median(parts["acting"]), statistics.median(parts["update"])
    stepping = statistics.median(parts["step"]) * len(parts["step"]) / len(parts["acting"])
    whole = acting + update
    setting = f"{name} {args.network} {args.hidden_dim} {'shared' if args.parameter_sharing else 'independent'}"
    return Measurement(setting, rate, reference, update / whole, (acting - stepping) / whole, stepping / whole)


@one_sentence(__file__)
def main() -> None:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = script_names()
    parser.add_argument(
        "--algorithms", nargs="+", default=["mappo"], choices=names, metavar="name", help=", ".join(names)
    )
    parser.add_argument("--env", default="lbf-15x15-3p-5f", help="a task; default: lbf-15x15-3p-5f")
    parser.add_argument("--seconds", type=float, default=20, help="for each algorithm and line; default: 20")
    parser.add_argument("flags", nargs="*", help="flags for the scripts, behind --")
    chosen = parser.parse_args()
    if not 0 < chosen.seconds < math.inf:
        parser.error("--seconds must be a positive number")
    seconds = chosen.seconds / TURNS
    os.environ[fast_mkl.SWITCH] = "0"  # for the process that starts below; this one has its kernels already
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as without:
        for name in chosen.algorithms:
            flags = ["--env", chosen.env, *chosen.flags]
            fast: list[Measurement] = []
            plain: list[Measurement] = []
            for _ in range(TURNS):
                (fast if fast_mkl.LOADED else plain).append(measure(name, flags, seconds))
                if fast_mkl.LOADED:
                    plain.append(without.submit(measure, name, flags, seconds).result())
            for kernels, found in (("plain", plain), ("fast", fast)):
                if found:
                    print(medians(kernels, found), flush=True)


def medians(kernels: str, found: list[Measurement]) -> str:
    """The medians of some measurements in one line."""
    rate, reference, update, acting, stepping = map(statistics.median, zip(*(astuple(each)[1:] for each in found)))
    return (
        f"{found[0].setting:32s} {kernels:5s} {rate:8,.0f} steps/s, reference passes {reference:8,.0f}, "
        f"share {rate / reference:.2f}; of the loop: update {update:.0%}, acting {acting:.0%}, stepping {stepping:.0%}"
    )


if __name__ == "__main__":
    main()
