"""Training steps per second of the scripts' own loop, on one thread, with MKL's fast kernels and without them.

    taskset -c 0 python benchmark/time_training.py [--algorithms mappo ...] [--env <task>] [--seconds 20] [-- <flags>]

The loop is a script's own `train`, without evaluations and checkpoints, after some updates that warm it up. Beside its
rate stand the shares of its time that updates, acting and the environment's steps take. The two lines of an algorithm
are measured in turns, in processes of their own, so that a noisy machine treats them alike. On processors without the
fast kernels (envs/runs/fast_mkl.py) there is one line.
"""

import argparse
import contextlib
import io
import math
import multiprocessing
import os
import signal
import statistics
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any
from unittest import mock

if not __package__:  # as a program, from any folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark  # isort: skip  # noqa: F401 (says which packages are missing, before one is imported)
import envs
from benchmark.plan import ALGOS, load_script, script_names
from envs import runs
from envs.runs import Parser, fast_mkl, one_sentence

TURNS = 3
WARM_UP = 5  # updates


def measure(name: str, flags: list[str], seconds: float) -> tuple[str, list[float]]:
    """Trains for some seconds. Returns the setting in words; steps per second and the shares of updates, acting and
    stepping. Ends the program where the script does not take the flags."""
    import torch

    module: Any = load_script(ALGOS / f"{name}.py")
    args: Any = runs.parse_flags(module.Args, module.paper_defaults, flags, module.__doc__)
    if hasattr(args, "buffer_size"):  # the whole replay may be larger than the disk that has temporary files
        args.buffer_size = min(args.buffer_size, 20 * args.batch_size)
    args.total_timesteps, args.eval_episodes = sys.maxsize, 1
    spent: dict[str, float] = {}  # seconds in each function, and since the loop is warm
    begun, steps = 0.0, 0

    def timed(owner: Any, function_name: str) -> Any:
        """In place of the owner's function one that counts its time."""
        function = getattr(owner, function_name)

        def in_its_place(*words: Any) -> Any:
            start = time.perf_counter()
            result = function(*words)
            spent[function_name] = spent.get(function_name, 0.0) + time.perf_counter() - start
            return result

        return mock.patch.object(owner, function_name, in_its_place)

    def count(run: runs.Run, played: torch.Tensor, *_: Any) -> None:
        """In place of a run's own: nothing is logged, and the training ends when the time is up."""
        nonlocal begun, steps
        now = time.perf_counter()
        if run.n_updates <= WARM_UP:
            begun = now
            spent.clear()
            return
        steps, spent["loop"] = steps + int(played.sum()), now - begun
        if spent["loop"] > seconds:
            run.timestep = args.total_timesteps

    with contextlib.ExitStack() as stack:
        args.run_dir = stack.enter_context(tempfile.TemporaryDirectory())
        stack.enter_context(contextlib.redirect_stderr(io.StringIO()))  # its progress
        for owner, function_name in ((module, "update"), (module, "collect"), (envs.VectorEnv, "step")):
            stack.enter_context(timed(owner, function_name))
        stack.enter_context(mock.patch("envs.runs.run.StopSignals"))
        stack.enter_context(mock.patch.object(runs.Run, "count", count))
        for method in ("evaluate_if_due", "stop_if_asked", "save_if_due", "complete"):
            stack.enter_context(mock.patch.object(runs.Run, method))
        runs.keep_freed_memory()
        torch.set_num_threads(1)
        module.train(args)
    setting = f"{name} {args.network} {args.hidden_dim} {'shared' if args.parameter_sharing else 'independent'}"
    parts = spent["update"], spent["collect"] - spent["step"], spent["step"]
    return setting, [steps / spent["loop"], *(part / (spent["update"] + spent["collect"]) for part in parts)]


def process(switch: str) -> ProcessPoolExecutor:
    """A process with MKL's fast kernels ("1") or without ("0"), which Ctrl-C leaves to this one."""
    spawn = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(1, spawn, signal.signal, (signal.SIGINT, signal.SIG_IGN))
    with mock.patch.dict(os.environ, {fast_mkl.SWITCH: switch}):
        executor.submit(int).result()  # it starts with its first task
    return executor


@one_sentence(__file__)
def main() -> None:
    """See the module's docstring."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--algorithms", nargs="+", default=["mappo"], choices=script_names(), help="default: mappo")
    parser.add_argument("--env", default="lbf-15x15-3p-5f", help="a task; default: lbf-15x15-3p-5f")
    parser.add_argument("--seconds", type=float, default=20, help="for each line; default: 20")
    parser.add_argument("flags", nargs="*", help="flags for the scripts, behind --")
    chosen = parser.parse_args()
    if not 0 < chosen.seconds < math.inf:
        parser.error("--seconds must be a positive number")
    flags = ["--env", chosen.env, *chosen.flags]
    with process("0") as plain, process("1") as fast:
        processes = {"plain": plain} | ({"fast": fast} if fast_mkl.LOADED else {})
        for name in chosen.algorithms:
            found: dict[str, list[list[float]]] = {kernels: [] for kernels in processes}
            for _ in range(TURNS):
                for kernels, executor in processes.items():
                    setting, figures = executor.submit(measure, name, flags, chosen.seconds / TURNS).result()
                    found[kernels].append(figures)
            for kernels, turns in found.items():
                rate, update, acting, stepping = map(statistics.median, zip(*turns))
                print(f"{setting:32s} {kernels:5s} {rate:8,.0f} steps/s; of the loop: ", end="")
                print(f"update {update:.0%}, acting {acting:.0%}, stepping {stepping:.0%}", flush=True)


if __name__ == "__main__":
    main()
