"""Trains the opponents of mpe-adversary and mpe-tag, chooses one for each, and puts it into the package.

    python tools/train_opponents.py [--tasks mpe-adversary mpe-tag] [--seeds 0 1 2] [--runs runs/opponents]

For each seed all agents of a task learn together, with the paper's hyperparameters of MADDPG but for the GRU:
    python algos/maddpg.py --env <task>-selfplay --individual-rewards --no-parameter-sharing --network fc --seed <k>
A run that was interrupted goes on, a complete one stays as it is: the same command can be given again at any time.

At each evaluation of a run its adversary or prey is a candidate. It plays 1,000 episodes against scripted teams whose
returns against the paper's own opponents were measured (`PROBES`): too easy an opponent lets them earn more, too hard a
one less. Of the candidates with all returns within the tolerances, that with the smallest sum of distances from the
measured returns, each in units of its tolerance, is written to envs/families/opponents/<task>.npz, and what was
measured to <task>.json. An opponent that is there already is replaced only with --replace.

The present opponents were chosen earlier, by returns of which two were wrong ("known" in their JSON files: 12.1 for
leading the adversary away, 8 for the plain chase), and the adversary also by what MAA2C earned against three
candidates: docs/environments/mpe.md tells it. By the returns below no adversary is near enough: of the 250 candidates
of seeds 0 to 9 the nearest misses one of them by 1.39. A prey is: seed 1 after 453,125 steps. tools/opponents has this
prey and what all these candidates measured, in 3,000 episodes each; it is to take the place of the present one when the
runs of mpe-tag are made anew.
"""

import argparse
import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import envs  # isort: skip (before PyTorch, as in the scripts)
import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.plan import ALGOS, load_script
from envs import runs
from envs.families import mpe
from envs.runs import one_sentence

EPISODES = 1000
Actions = NDArray[np.int64]


class Probe(NamedTuple):
    """A scripted team, its mean return against the paper's opponent (5,000 episodes), and what distance is accepted."""

    act: Callable[[mpe.State, np.random.Generator], Actions]
    measured: float
    tolerance: float


def act_at_random(game: mpe.State, rng: np.random.Generator) -> Actions:
    """[env, agent]: any move."""
    learning = game.agent_rewards.shape
    return rng.integers(0, 5, learning)


def towards(offset: NDArray[np.float64], reach: float) -> Actions:
    """[env, agent]: a step along the longer side of the offset, [env, agent, (x, y)]; none if that is within reach."""
    axis = np.abs(offset).argmax(axis=2)
    along = np.take_along_axis(offset, axis[:, :, None], 2)[:, :, 0]
    return np.where(np.abs(along) > reach, 1 + 2 * axis + (along < 0), 0)


def towards_and_stay(game: mpe.State, first: int, targets: NDArray[np.float64]) -> Actions:
    """[env, agent]: lets the agents from the first one on go to their targets, [env, agent, (x, y)], and rest there."""
    rests = game.agent_position[:, first:] + 0.3 * game.agent_velocity[:, first:]  # where each would roll to
    return towards(targets - rests, 0.1)  # one push carries 0.2 far


def cover_both_landmarks(game: mpe.State, rng: np.random.Generator) -> Actions:
    """Adversary: each good agent goes to a landmark of its own, so that both ways together are shortest."""
    landmarks, agents = game.landmark_position, game.agent_position[:, 1:]
    straight, crossed = (
        np.linalg.norm(agents - places, axis=2).sum(axis=1) for places in (landmarks, landmarks[:, ::-1])
    )
    return towards_and_stay(game, 1, np.where((straight < crossed)[:, None, None], landmarks, landmarks[:, ::-1]))


def lead_away(game: mpe.State, rng: np.random.Generator) -> Actions:
    """Adversary: the nearest good agent goes to the goal, the other far beyond the other landmark.

    This earns more where the adversary follows agents. Learning teams find such weaknesses too.
    """
    rows, agents = np.arange(len(game.goal)), game.agent_position[:, 1:]
    goal, other = game.landmark_position[rows, game.goal], game.landmark_position[rows, 1 - game.goal]
    nearest = np.linalg.norm(agents - goal[:, None], axis=2).argmin(axis=1)
    goes = (np.arange(2) == nearest[:, None])[:, :, None]
    return towards_and_stay(game, 1, np.where(goes, goal[:, None], (2 * other - goal)[:, None]))


def chase(game: mpe.State, rng: np.random.Generator) -> Actions:
    """Tag: each predator runs to where the prey is."""
    return towards(game.agent_position[:, mpe.PREY :] - game.agent_position[:, : mpe.PREY], 0.0)


def chase_ahead(game: mpe.State, rng: np.random.Generator) -> Actions:
    """Tag: each predator runs to where the prey will be, seen from where the predator would roll to, in 0.3 s."""
    offset = game.agent_position[:, mpe.PREY :] - game.agent_position[:, : mpe.PREY]
    return towards(offset + 0.3 * (game.agent_velocity[:, mpe.PREY :] - game.agent_velocity[:, : mpe.PREY]), 0.0)


PROBES = {
    "mpe-adversary": {
        "random": Probe(act_at_random, -2.72, 0.5),
        "cover both landmarks": Probe(cover_both_landmarks, 12.38, 0.5),
        "lead away": Probe(lead_away, 10.41, 0.5),
    },
    "mpe-tag": {
        "random": Probe(act_at_random, 0.23, 0.5),
        "chase": Probe(chase, 3.24, 0.5),
        "chase ahead": Probe(chase_ahead, 7.86, 1.5),
    },
}


def mean_return(env: mpe.Env, act: Callable[[mpe.State, np.random.Generator], Actions]) -> float:
    """A scripted team's mean return over one episode of each sub-environment."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(env.episode_limit):
        env.step(act(env.game, rng))
    return float(env.game.score.mean())


class Training(NamedTuple):
    """How long a task is trained, and how often a candidate is taken."""

    total_timesteps: int
    eval_points: int


# The paper's opponents were trained for 25,000 episodes, 625,000 steps. Our adversaries go between the landmarks long
# before, which is too hard: after 11,500 steps those of seeds 0, 1 and 2 leave a random team -4.3, -5.4 and -4.8; that
# of seed 0, trained to the end, -5.1. Yet a team that learns beats them by tricks: MAA2C earned 20 against that of step
# 437,500. Early ones, on the way to that place, are as hard as the paper's.
TRAININGS = {"mpe-adversary": Training(12_000, 25), "mpe-tag": Training(625_000, 41)}


def opponent_of(task: str) -> int:
    """The number of the agent that is the adversary or the prey."""
    return mpe.SCENARIOS[task.removeprefix("mpe-")].teams.index(1)


def network(agents: Any, agent: int) -> mpe.Network:
    """The network of one of the script's agents, as arrays."""
    own = agents.networks[agent]
    layers = (own.first, own.core, own.last)
    arrays = [array.detach().numpy() for layer in layers for array in (layer.weight.T, layer.bias)]
    return mpe.Network(*(np.ascontiguousarray(array) for array in arrays))


def train(task: str, seed: int, directory: Path) -> None:
    """Trains one seed, or goes on with it, and keeps its candidates as <directory>-candidates/<timestep>.npz."""
    module: Any = load_script(ALGOS / "maddpg.py")
    kept = directory.with_name(f"{directory.name}-candidates")

    class KeepsCandidates(runs.Run):
        def __init__(self, *what: Any) -> None:
            super().__init__(*what)
            self.signals.advice = "the same command goes on"

        def save(self) -> None:
            super().save()
            if self.rows[-1]["timestep"] == self.timestep:
                kept.mkdir(exist_ok=True)
                np.savez(kept / f"{self.timestep}.npz", **network(self.parts["agents"], opponent_of(task))._asdict())

    flags = ["--env", f"{task}-selfplay", "--individual-rewards", "--no-parameter-sharing", "--network", "fc"]
    flags += ["--seed", str(seed), "--run-dir", str(directory), "--resume"]
    for name, value in TRAININGS[task]._asdict().items():
        flags += [f"--{name.replace('_', '-')}", str(value)]
    runs.keep_freed_memory()
    torch.set_num_threads(1)
    usual, module.runs.Run = runs.Run, KeepsCandidates
    try:
        module.train(runs.parse_flags(module.Args, module.paper_defaults, flags, module.__doc__))
    finally:
        module.runs.Run = usual


def candidates(task: str, directory: Path) -> list[dict[str, Any]]:
    """What the candidates of a run are: seed, timestep, returns against the scripted teams, file."""
    seed = json.loads((directory / "config.json").read_text())["flags"]["seed"]
    kept = directory.with_name(f"{directory.name}-candidates")
    found = []
    for archive in sorted(kept.glob("*.npz"), key=lambda p: int(p.stem)):
        settings = {**envs.task(f"{task}-selfplay").settings, "selfplay": False}
        env = mpe.Env(task, EPISODES, 0, False, **settings, opponent=archive)
        figures = {name: round(mean_return(env, probe.act), 3) for name, probe in PROBES[task].items()}
        found.append({"seed": seed, "timestep": int(archive.stem), "returns": figures, "archive": archive})
    if not found:
        raise envs.InputError(f"{kept} is empty, though {directory} is complete; move that run away to train it anew.")
    return found


def distance(task: str, figures: dict[str, float]) -> float:
    """From the measured returns; infinite where one is further off than its tolerance."""
    total = 0.0
    for name, probe in PROBES[task].items():
        apart = abs(figures[name] - probe.measured) / probe.tolerance
        if apart > 1:
            return np.inf
        total += apart
    return total


def install(task: str, chosen: dict[str, Any], directory: Path, found: list[dict[str, Any]]) -> None:
    """Puts an opponent into the package: the network, and in the file beside it what all the candidates measured.

    directory: of the run that it comes from.
    """
    rows = csv.DictReader((directory / "evaluations.csv").read_text().splitlines())
    note = {
        "agent": opponent_of(task),
        "known": {name: probe.measured for name, probe in PROBES[task].items()},
        "seed": chosen["seed"],
        "timestep": chosen["timestep"],
        "returns": chosen["returns"],
        "candidates": [{name: each[name] for name in ("seed", "timestep", "returns")} for each in found],
        "curve": [[int(row["timestep"]), float(row["return_mean"])] for row in rows],
        "origin": json.loads((directory / "config.json").read_text()),
    }
    mpe.OPPONENTS.mkdir(exist_ok=True)
    new = mpe.OPPONENTS / f"{task}.npz.new"
    new.write_bytes(chosen["archive"].read_bytes())
    new.replace(mpe.OPPONENTS / f"{task}.npz")
    runs.write_whole(mpe.OPPONENTS / f"{task}.json", json.dumps(note, indent=1) + "\n")


@one_sentence(__file__)
def main() -> None:
    """Trains, measures, chooses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", choices=list(PROBES), default=list(PROBES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--runs", type=Path, default=Path("runs", "opponents"), help="where the runs are kept")
    parser.add_argument("--replace", action="store_true", help="replace the opponents that the package has")
    args = parser.parse_args()
    for seed in args.seeds:
        runs.check_flags(argparse.Namespace(seed=seed))  # all of them before the first one trains for hours

    for seed in args.seeds:
        for task in args.tasks:
            train(task, seed, args.runs / task / f"seed{seed}")
    for task in args.tasks:
        found = [each for seed in args.seeds for each in candidates(task, args.runs / task / f"seed{seed}")]
        for each in found:
            figures = ", ".join(f"{name} {figure:.2f}" for name, figure in each["returns"].items())
            print(f"{task} seed {each['seed']}, step {each['timestep']:,}: {figures}")
        chosen = min(found, key=lambda each: distance(task, each["returns"]))
        name = f"seed {chosen['seed']} after {chosen['timestep']:,} steps"
        if distance(task, chosen["returns"]) == np.inf:
            print(f"{task}: no candidate is near enough; try more seeds.")
        elif (mpe.OPPONENTS / f"{task}.npz").exists() and not args.replace:
            print(f"{task}: {name} is the best; --replace puts it in the place of the present opponent.")
        else:
            install(task, chosen, args.runs / task / f"seed{chosen['seed']}", found)
            print(f"{task}: {name} is the opponent now.")


if __name__ == "__main__":
    main()
