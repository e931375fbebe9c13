"""Makes opponents for mpe-adversary and mpe-tag of the networks that the paper's teams played against.

    python examples/paper_opponents.py <adv_params.pt> <prey_params.pt> [--output <folder>]
    python algos/mappo.py --env mpe-tag --env-kwargs "opponent='<folder>/paper-tag.npz'"

The two files are the paper's authors' work and not included here. They lie in the repository uoe-agents/epymarl
(Apache License 2.0), in the folder src/envs/pretrained.

Each has a list `agent_params` with an entry for each agent. Its "policy" is a network BatchNorm - Linear - ReLU -
Linear - ReLU - Linear, whose largest output is the action. In use the normalisation of a value x is the linear map
scale * (x - mean) + shift with scale = weight / sqrt(variance + 1e-5), so it is folded into the first linear layer.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch

from envs import InputError
from envs.families import mpe
from envs.runs import Parser, one_sentence

EPSILON = 1e-5  # of PyTorch's BatchNorm


def converted(params: Any, scenario: str) -> mpe.Network:
    """The scenario's opponent among the agents of one of the authors' files, as `mpe.Env` plays it."""
    game = mpe.SCENARIOS[scenario]
    policy = params["agent_params"][game.teams.index(1)]["policy"]
    normalisation, layers = list(policy.values())[:4], list(policy.values())[5:]  # the fifth counts batches
    weight, shift, mean, variance = (x.double().numpy() for x in normalisation)
    w1, b1, w2, b2, w3, b3 = (x.double().numpy() for x in layers)  # w: [output, input]
    scale = weight / np.sqrt(variance + EPSILON)
    first_bias = b1 + w1 @ (shift - scale * mean)
    first_weight = np.zeros((game.obs_size, len(b1)))  # shorter observations are filled up with zeros
    first_weight[: len(scale)] = (w1 * scale).T
    return mpe.Network(*(x.astype(np.float32) for x in (first_weight, first_bias, w2.T, b2, w3.T, b3)))


@one_sentence(__file__)
def main() -> None:
    """Converts both files. Wrong input ends with one sentence and exit code 2."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("adversary", type=Path, metavar="adv_params.pt")
    parser.add_argument("prey", type=Path, metavar="prey_params.pt")
    parser.add_argument("--output", type=Path, default=Path("opponents"), help="a folder; default: opponents")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    for scenario, source in (("adversary", args.adversary), ("tag", args.prey)):
        try:
            network = converted(torch.load(source, map_location="cpu", weights_only=True), scenario)
        except OSError:
            raise
        except Exception:  # PyTorch raises almost anything on a file that is not one of its own
            raise InputError(f"{source} is not the authors' file for {scenario}, or is damaged.") from None
        path = args.output / f"paper-{scenario}.npz"
        np.savez(path, **network._asdict())
        mpe.read_network(path, scenario)
        print(f"{path}: in results it is called {mpe.fingerprint(network)}")


if __name__ == "__main__":
    main()
