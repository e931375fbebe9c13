"""Trains the opponents of mpe-adversary and mpe-tag, chooses one for each, and puts it into the package.

    python benchmark/train_opponents.py [--tasks mpe-adversary mpe-tag] [--seeds 0 1 2] [--runs runs/opponents]

For each seed all agents of a task learn together, 25,000 episodes long, with the paper's hyperparameters of MADDPG:
    python algos/maddpg.py --env <task>-selfplay --individual-rewards --no-parameter-sharing --seed <k>
A run that was interrupted goes on, a complete one stays as it is: the same command can be given again at any time.

Each seed's adversary or prey is a candidate. It plays 1,000 episodes against two scripted teams whose returns against
the paper's own opponents are known (`PROBES`): too easy an opponent lets them earn more, too hard a one less. Of the
candidates with both returns within the bounds, that with the smallest sum of distances from the known returns, each in
units of half the distance of its bounds, is written to envs/opponents/<task>.npz, and what was measured to <task>.json.
An opponent that is there already is replaced only with --replace.
"""

import argparse
import csv
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

import envs
from envs import mpe

ROOT = Path(__file__).resolve().parent.parent
EPISODES = 1000
Actions = NDArray[np.int64]


class Probe(NamedTuple):
    """A scripted team, its mean return against the paper's opponent, and the bounds of what is accepted."""

    act: Callable[[mpe.State, np.random.Generator], Actions]
    known: float
    low: float
    high: float


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


def chase(game: mpe.State, rng: np.random.Generator) -> Actions:
    """Tag: each predator runs to where the prey is."""
    return towards(game.agent_position[:, mpe.PREY :] - game.agent_position[:, : mpe.PREY], 0.0)


PROBES = {
    "mpe-adversary": {
        "random": Probe(act_at_random, -2.6, -3.6, -1.6),
        "cover both landmarks": Probe(cover_both_landmarks, 12.1, 11.0, 13.0),
    },
    "mpe-tag": {
        "random": Probe(act_at_random, 0.2, 0.0, 1.0),
        "chase": Probe(chase, 8.0, 5.0, 15.0),
    },
}


def mean_return(env: mpe.Env, act: Callable[[mpe.State, np.random.Generator], Actions]) -> float:
    """A scripted team's mean return over one episode of each sub-environment."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(env.episode_limit):
        env.step(act(env.game, rng))
    return float(env.game.score.mean())


def evaluations(directory: Path) -> list[dict[str, str]]:
    """The rows of a run's evaluations.csv, none where it has not begun."""
    if not (directory / "evaluations.csv").exists():
        return []
    with open(directory / "evaluations.csv", newline="") as file:
        return list(csv.DictReader(file))


def train(task: str, seed: int, directory: Path) -> None:
    """Runs the script, or lets it go on, up to the budget. Ends the program where the script ends with an error."""
    rows = evaluations(directory)
    if rows and int(rows[-1]["timestep"]) >= envs.task(f"{task}-selfplay").off_policy_timesteps:
        return
    command = [sys.executable, str(ROOT / "algos" / "maddpg.py"), "--env", f"{task}-selfplay", "--individual-rewards"]
    command += ["--no-parameter-sharing", "--seed", str(seed), "--run-dir", str(directory), "--resume"]
    done = subprocess.run(command)
    if done.returncode != 0:
        sys.exit(f"Training {task} with seed {seed} did not end; the same command goes on with it.")


def network(directory: Path, agent: int) -> mpe.Network:
    """The network of one agent in a run's checkpoint."""
    weights = torch.load(directory / "checkpoint.pt")["parts"]["agents"]

    def layer(weight: str, bias: str) -> list[NDArray[np.float32]]:
        own = (weights[f"networks.{agent}.{name}"].numpy() for name in (weight, bias))
        return [np.ascontiguousarray(array.T) for array in own]  # [input, output]

    return mpe.Network(
        *layer("first.weight", "first.bias"),
        *layer("core.weight_ih_l0", "core.bias_ih_l0"),
        *layer("core.weight_hh_l0", "core.bias_hh_l0"),
        *layer("last.weight", "last.bias"),
    )


def candidate(task: str, directory: Path) -> dict[str, Any]:
    """Writes the opponent of one run to opponent.npz in its directory. Returns where it comes from and what it is."""
    agent = mpe.SCENARIOS[task.removeprefix("mpe-")].teams.index(1)
    archive = directory / "opponent.npz"
    np.savez(archive, **network(directory, agent)._asdict())
    env = mpe.Env(task, EPISODES, 0, False, **envs.task(task).settings, opponent=archive)
    figures = {name: round(mean_return(env, probe.act), 3) for name, probe in PROBES[task].items()}
    config = json.loads((directory / "config.json").read_text())
    curve = [[int(row["timestep"]), float(row["return_mean"])] for row in evaluations(directory)]
    return {"seed": config["flags"]["seed"], "agent": agent, "returns": figures, "origin": config, "curve": curve}


def distance(task: str, figures: dict[str, float]) -> float:
    """From the known returns; infinite where a return is out of bounds."""
    total = 0.0
    for name, probe in PROBES[task].items():
        if not probe.low <= figures[name] <= probe.high:
            return np.inf
        total += abs(figures[name] - probe.known) / ((probe.high - probe.low) / 2)
    return total


def install(task: str, archive: Path, chosen: dict[str, Any], found: list[dict[str, Any]]) -> None:
    """Puts an opponent into the package: the network, and in the file beside it what all the candidates measured."""
    mpe.OPPONENTS.mkdir(exist_ok=True)
    others = [{"seed": each["seed"], "returns": each["returns"]} for each in found]
    note = {"known": {name: probe.known for name, probe in PROBES[task].items()}, "candidates": others, **chosen}
    for name, content in ((f"{task}.npz", archive.read_bytes()), (f"{task}.json", json.dumps(note, indent=1).encode())):
        new = mpe.OPPONENTS / f"{name}.new"
        new.write_bytes(content)
        new.replace(mpe.OPPONENTS / name)


def main() -> None:
    """Trains, measures, chooses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", choices=list(PROBES), default=list(PROBES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--runs", type=Path, default=Path("runs", "opponents"), help="where the runs are kept")
    parser.add_argument("--replace", action="store_true", help="replace the opponents that the package has")
    args = parser.parse_args()

    for seed in args.seeds:
        for task in args.tasks:
            train(task, seed, args.runs / task / f"seed{seed}")
    for task in args.tasks:
        found = [candidate(task, args.runs / task / f"seed{seed}") for seed in args.seeds]
        for each in found:
            figures = ", ".join(f"{name} {figure:.2f}" for name, figure in each["returns"].items())
            print(f"{task} seed {each['seed']}: {figures}; distance {distance(task, each['returns']):.2f}")
        chosen = min(found, key=lambda each: distance(task, each["returns"]))
        if distance(task, chosen["returns"]) == np.inf:
            print(f"{task}: no candidate is within the bounds; try more seeds.")
        elif (mpe.OPPONENTS / f"{task}.npz").exists() and not args.replace:
            print(f"{task}: seed {chosen['seed']} is the best; --replace puts it in the place of the present opponent.")
        else:
            install(task, args.runs / task / f"seed{chosen['seed']}" / "opponent.npz", chosen, found)
            print(f"{task}: seed {chosen['seed']} is the opponent now.")


if __name__ == "__main__":
    main()
